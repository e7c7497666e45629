"""What an exhibit is: figures, a caption and findings, each with a verdict that is computed.

A finding shows its 95 % interval. Its verdict takes a wider one: of `GALLERY_FINDINGS` true statements
with 95 % intervals a dozen would be taken for wrong by chance, so each is judged at the level of
Šidák [Sidak1967]_, 0.95^(1/250), 99.98 %, at which all of them hold together with 95 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from decimal import ROUND_CEILING, Decimal
from typing import TYPE_CHECKING, Literal, Protocol, TypeAlias, final

from mcspectra.estimators.moments import CONFIDENCE_Z
from mcspectra.report.formatting import number

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.report.gallery import Picture

__all__ = [
    "GALLERY_FINDINGS",
    "VERDICT_WIDENING",
    "Exhibit",
    "ExhibitFunction",
    "Finding",
    "agreement",
    "comparison",
    "identity",
    "normal_interval",
    "rate_finding",
    "verdict_interval",
]

GALLERY_FINDINGS = 250
"""Number of findings for which the verdicts are made to hold together."""

_VERDICT_Z = 3.7125862298839247  # normal quantile of (1 + 0.95^(1/250)) / 2

VERDICT_WIDENING = _VERDICT_Z / CONFIDENCE_Z
"""By what the distance of a 95 % interval's ends is multiplied for a verdict."""

_VISIBLE = 5e-4  # tolerances of rates from here on are shown with the rate

Interval: TypeAlias = tuple[float, float]
"""Lower and upper end."""


@final
@dataclass(frozen=True, kw_only=True)
class Finding:
    """One statement, what theory says of it, and what was measured.

    Attributes
    ----------
    statement
        A sentence.
    expected
        What theory says, as ``"−3"`` or ``"≤ 1e-12"``.
    measured
        A number, words, or None where nothing could be measured.
    interval
        95 % interval of a number, None where it has no error of sampling.
    agrees
        The verdict; None where the statement has none.
    note
        Why it does not agree, or how it is judged.
    """

    statement: str
    expected: str
    measured: float | str | None
    interval: Interval | None
    agrees: bool | None
    note: str = ""


@final
@dataclass(frozen=True, kw_only=True)
class Exhibit:
    """One figure or statement of the slides, made again.

    Attributes
    ----------
    name
        Its kebab-case name in the registry.
    title
        A few words.
    slide
        The statement or figure of the slides, quoted.
    caption
        What was found, with the measured figures.
    pictures, findings
        In the order in which they are shown.
    formula
        LaTeX, shown beside the quotation; none by default.
    """

    name: str
    title: str
    slide: str
    caption: str
    pictures: tuple[Picture, ...]
    findings: tuple[Finding, ...]
    formula: str = field(default="")


class ExhibitFunction(Protocol):
    """Makes an exhibit: with `quick` in seconds, else at full quality; the same for the same seed."""

    def __call__(self, *, quick: bool, seed: int) -> Exhibit:
        """Compute and draw."""


def normal_interval(value: float, se: float) -> Interval:
    """Return the 95 % interval of a value with a normal error of standard deviation `se`."""
    return value - CONFIDENCE_Z * se, value + CONFIDENCE_Z * se


def verdict_interval(
    measured: float, interval: Interval, scale: Literal["linear", "log"] = "linear"
) -> Interval:
    """Widen a 95 % interval to the level of verdicts, about the measured value.

    Parameters
    ----------
    scale
        On which the distances of the ends are widened: ``log`` for variances, whose intervals are
        ratios.
    """
    if scale == "log" and min(measured, *interval) > 0:
        low, high = (measured * (end / measured) ** VERDICT_WIDENING for end in interval)
    else:
        low, high = (measured + (end - measured) * VERDICT_WIDENING for end in interval)
    return low, high


def comparison(
    statement: str,
    *,
    expected: float,
    measured: float,
    interval: Interval,
    tolerance: float = 0.0,
    scale: Literal["linear", "log"] = "linear",
    text: str = "",
    note: str = "",
) -> Finding:
    """Judge whether a measured number is the expected one.

    It agrees where the interval at the level of verdicts comes within `tolerance` of `expected`.

    Parameters
    ----------
    expected, measured, interval
        Numbers, and the 95 % interval of the measured one.
    tolerance
        By how much theory itself may be off (a limit not yet reached, say); `note` has to say why.
    text
        What to show for the expected number; the number itself by default.
    """
    low, high = verdict_interval(measured, interval, scale)
    return Finding(
        statement=statement,
        expected=text or number(expected),
        measured=measured,
        interval=interval,
        agrees=bool(low - tolerance <= expected <= high + tolerance),
        note=note,
    )


def rate_finding(
    statement: str,
    curve: xr.Dataset,
    *,
    expected: float,
    tolerance: float = 0.0,
    note: str = "",
) -> Finding:
    """Judge the rate of one curve of `mcspectra.convergence`; see `comparison`."""
    low, high = (float(end) for end in curve["rate_ci"].values)
    text = number(expected, 2)
    return comparison(
        statement,
        expected=expected,
        measured=float(curve["rate"]),
        interval=(low, high),
        tolerance=tolerance,
        text=f"{text} ± {number(tolerance, 2)}" if tolerance >= _VISIBLE else text,
        note=note,
    )


def agreement(
    statement: str,
    *,
    measured: float,
    interval: Interval,
    below: float = math.inf,
    above: float = -math.inf,
    scale: Literal["linear", "log"] = "linear",
    note: str = "",
) -> Finding:
    """Judge whether a measured number lies beyond a bound: its whole interval of verdicts does.

    Parameters
    ----------
    below, above
        Limits, one or both.
    """
    low, high = verdict_interval(measured, interval, scale)
    limits = [f"> {number(above)}"] if math.isfinite(above) else []
    limits += [f"< {number(below)}"] if math.isfinite(below) else []
    return Finding(
        statement=statement,
        expected=" and ".join(limits),
        measured=measured,
        interval=interval,
        agrees=bool(above < low and high < below),
        note=note,
    )


def identity(statement: str, *, error: float, at_most: float, note: str = "") -> Finding:
    """Judge an identity by the size of its error, which is one of rounding or quadrature."""
    return Finding(
        statement=statement,
        expected=f"≤ {_limit(at_most)}",
        measured=error,
        interval=None,
        agrees=bool(abs(error) <= at_most),
        note=note,
    )


def _limit(at_most: float) -> str:
    """A limit as ``1e-10`` or ``1.3e-3``: of two digits, never less than it is."""
    exact = Decimal(f"{at_most:.12e}")
    step = Decimal(1).scaleb(exact.adjusted() - 1)
    digits, exponent = f"{exact.quantize(step, ROUND_CEILING):.1e}".replace(".0e", "e").split("e")
    return f"{digits}e{int(exponent)}"
