"""What an exhibit is: plots, a caption and claims, each with a verdict that is computed.

The interval of a finding is the one that decides its verdict. Of `GALLERY_FINDINGS` true statements
with 95 % intervals a dozen would be taken for wrong by chance, so the interval has the level of Šidák
[Sidak1967]_, 0.95^(1/250) = 99.98 %, at which all of them hold together with 95 %.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import ROUND_CEILING, Decimal
from typing import Protocol, TypeAlias, final

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.estimators.moments import Measured
from mcspectra.plots.description import Plot
from mcspectra.plots.text import number, power_of_ten, rate

__all__ = [
    "GALLERY_FINDINGS",
    "VERDICT_WIDENING",
    "Claim",
    "Exhibit",
    "ExhibitFunction",
    "Finding",
    "Measured",
    "judge",
    "known_rate",
    "largest_distance",
    "mean_and_error",
    "normal_limit",
    "pixel_rate",
    "rate_claim",
    "rate_text",
    "slope",
]

GALLERY_FINDINGS = 250
"""Number of findings for which the verdicts are made to hold together."""

_VERDICT_Z = 3.7125862298839247  # normal quantile of (1 + 0.95^(1/250)) / 2

VERDICT_WIDENING = _VERDICT_Z / CONFIDENCE_Z
"""By what the distance of a 95 % interval's ends is multiplied for a verdict."""

_VISIBLE = 5e-4  # tolerances of rates from here on are shown with the rate
_PIXEL_TOLERANCE = 0.125
_PIXEL_NOTE = (
    "Tolerance: a quarter of the distance between −1.5 (edges) and −2 (smooth). Curves bend "
    "toward their limits, and exact variances of pixels are not known."
)

Interval: TypeAlias = tuple[float, float]
"""Lower and upper end."""


@final
@dataclass(frozen=True)
class Claim:
    """A statement, what theory expects and what was measured; `judge` finds the verdict.

    What is expected is one of four: a number (`expected`), a bound (`above`, `below`), an error that
    is rounding or quadrature (`at_most`), or something that the exhibit decides itself (`holds`).

    Attributes
    ----------
    statement
        A sentence, which names the source of the expected number: theory, a closed form, quadrature.
    measured
        With its interval; a plain number has no error of sampling; words, or None where nothing
        could be measured.
    expected
        It agrees where the interval at the level of verdicts comes within `tolerance` of it.
    tolerance
        By how much theory itself may be off (a limit not yet reached, say); `note` has to say why.
    digits
        With which the expected number is shown.
    above, below
        It agrees where the whole interval at the level of verdicts is beyond them, and does not
        where the whole interval is on the other side. Else the interval decides nothing.
    at_most
        Limit of the size of an error.
    holds
        The verdict; None where there is none.
    shown
        What to show as expected, where that is not the number, bound or limit itself.
    note
        How it is judged, or why it does not agree.
    """

    statement: str
    measured: Measured | float | str | None
    expected: float | None = None
    tolerance: float = 0.0
    digits: int = 3
    above: float = -math.inf
    below: float = math.inf
    at_most: float | None = None
    holds: bool | None = None
    shown: str = ""
    note: str = ""

    @property
    def value(self) -> float:
        """The measured number; NaN where it is none."""
        if isinstance(self.measured, Measured):
            return self.measured.value
        return self.measured if isinstance(self.measured, float) else math.nan


@final
@dataclass(frozen=True, kw_only=True)
class Finding:
    """A claim with its verdict, as it is shown and written.

    Attributes
    ----------
    statement, note
        Of the claim.
    expected
        What theory says, as ``"−3"`` or ``"≤ 10⁻¹²"``.
    measured
        A number, words, or None where nothing could be measured.
    interval
        Interval of a number with the level of verdicts, None where it has no error of sampling.
    agrees
        The verdict; None where the statement has none, or where the interval holds its bound.
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
    """One figure or statement of the slides, made again; ``slides.toml`` has its texts and layouts.

    Attributes
    ----------
    numbers
        What the texts name in braces, as it is shown.
    plots
        In the order in which they are shown; their texts and layouts are found by their kinds.
    claims
        In the order in which they are shown.
    caption
        What was found: filled in with the texts.
    """

    plots: tuple[Plot, ...]
    claims: tuple[Claim, ...]
    numbers: Mapping[str, object] = field(default_factory=dict)
    caption: str = ""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Its claims, judged."""
        return tuple(map(judge, self.claims))


class ExhibitFunction(Protocol):
    """Makes an exhibit: with `quick` in seconds, else at full quality; the same for the same seed."""

    def __call__(self, *, quick: bool, seed: int) -> Exhibit:
        """Compute and describe."""


def judge(claim: Claim) -> Finding:
    """Hold what was measured against what is expected."""
    measured, shown, agrees, interval = claim.measured, claim.shown, claim.holds, None
    note = claim.note
    low = high = claim.value
    if isinstance(measured, Measured):
        low, high = measured.widened(VERDICT_WIDENING)
        finite = math.isfinite(measured.value)  # else the widened ends are NaN: it does not agree
        interval = (low, high) if finite else (measured.low, measured.high)
        measured = measured.value
    if claim.expected is not None:
        shown = shown or number(claim.expected, claim.digits)
        agrees = bool(low - claim.tolerance <= claim.expected <= high + claim.tolerance)
    elif claim.at_most is not None:
        shown = shown or f"≤ {_limit(claim.at_most)}"
        agrees = bool(abs(claim.value) <= claim.at_most)
    elif math.isfinite(claim.above) or math.isfinite(claim.below):
        limits = [f"> {number(claim.above)}"] if math.isfinite(claim.above) else []
        limits += [f"< {number(claim.below)}"] if math.isfinite(claim.below) else []
        shown = shown or " and ".join(limits)
        agrees = bool(claim.above < low and high < claim.below)
        if not agrees and claim.above < high and low < claim.below:
            agrees, note = None, f"{note} So few realizations do not decide it.".strip()
    return Finding(
        statement=claim.statement,
        expected=shown,
        measured=measured,
        interval=interval,
        agrees=agrees,
        note=note,
    )


def _limit(at_most: float) -> str:
    """A limit as ``10⁻¹⁰`` or ``1.3×10⁻³``: of two digits, never less than it is."""
    exact = Decimal(f"{at_most:.12e}")
    step = Decimal(1).scaleb(exact.adjusted() - 1)
    digits, exponent = f"{exact.quantize(step, ROUND_CEILING):.1e}".replace(".0e", "e").split("e")
    return ("" if digits == "1" else f"{digits}×") + power_of_ten(int(exponent))


def mean_and_error(values: Array) -> tuple[Array, Array]:
    """Return mean and standard error over the first axis."""
    return values.mean(axis=0), values.std(axis=0, ddof=1) / len(values) ** 0.5


def slope(counts: Sequence[int], variances: Array) -> float:
    """Return the exponent of variances at the counts, all weighing alike."""
    return float(np.polyfit(np.log(counts), np.log(variances), 1)[0])


def rate_text(curve: xr.Dataset) -> str:
    """Return the rate of a curve of `mcspectra.convergence` as ``−1.52 ± 0.03``."""
    return rate(float(curve["rate"]), *map(float, curve["rate_ci"].values))


def rate_claim(
    statement: str, curve: xr.Dataset, expected: float, tolerance: float = 0.0, note: str = ""
) -> Claim:
    """Claim the rate of one curve of `mcspectra.convergence`."""
    shown = number(expected, 2)
    return Claim(
        statement,
        Measured.of(curve, "rate"),
        expected=expected,
        tolerance=tolerance,
        shown=f"{shown} ± {number(tolerance, 2)}" if tolerance >= _VISIBLE else shown,
        note=note,
    )


def known_rate(statement: str, curve: xr.Dataset, expected: float, exact: Array) -> Claim:
    """Claim a rate whose limit is known, with the slope of the exact variances for a tolerance."""
    here = slope(curve["n"].values.tolist(), exact)
    note = f"Tolerance: the exact variances at these N have the slope {number(here, 5)}."
    return rate_claim(statement, curve, expected, abs(here - expected), note)


def pixel_rate(statement: str, curve: xr.Dataset, expected: float) -> Claim:
    """Claim a rate in the plane, −1.5 or −2; the note says where the other of them would agree too."""
    claim, rival = (
        rate_claim(statement, curve, limit, _PIXEL_TOLERANCE, _PIXEL_NOTE)
        for limit in (expected, -3.5 - expected)
    )
    if judge(claim).agrees and judge(rival).agrees:
        weak = f"So few realizations do not rule out {number(-3.5 - expected, 2)}."
        return replace(claim, note=f"{_PIXEL_NOTE} {weak}")
    return claim


def normal_limit(count: int, freedom: int = 0) -> float:
    """Return what the largest of `count` normal errors exceeds with the gallery's level for one finding.

    With degrees of freedom, of so many Student variables.
    """
    from scipy.special import ndtri, stdtrit

    p = (1 + 0.95 ** (1 / (GALLERY_FINDINGS * count))) / 2
    return float(stdtrit(freedom, p) if freedom else ndtri(p))


def largest_distance(statement: str, away: Array, se: Array, freedom: int = 0) -> Claim:
    """Claim that differences vanish, all of them at once.

    Parameters
    ----------
    statement
        Without a full stop; what was measured is added.
    away, se
        Measured minus expected and standard errors above 0, of one shape.
    freedom
        Degrees of freedom of standard errors from a few batches.
    """
    limit = normal_limit(away.size, freedom)
    batches = "as many Student variables, of the batches,"
    return Claim(
        f"{statement}: largest distance in standard errors.",
        float(np.max(np.abs(away) / se)),
        at_most=limit,
        shown=f"≤ {limit:.1f}",
        note=f"The limit is that of {batches if freedom else f'{away.size} normal errors'} at the gallery's level.",
    )
