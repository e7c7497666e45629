"""Exhibits: plots, sliders and claims. Each claim has a computed verdict.

The interval of a finding decides its verdict. The gallery has at most `GALLERY_FINDINGS` findings.
With 95 % intervals, chance would reject a dozen true statements.
The interval therefore has the Šidák level [Sidak1967]_, which is 0.95^(1/300) = 99.98 %.
At this level, all intervals hold simultaneously with 95 % probability.
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
from mcspectra.report.page import Slider

__all__ = [
    "GALLERY_FINDINGS",
    "VERDICT_WIDENING",
    "Claim",
    "Exhibit",
    "ExhibitFunction",
    "Finding",
    "Measured",
    "about",
    "correction",
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

GALLERY_FINDINGS = 300
"""Number of findings whose verdicts hold simultaneously with 95 % probability."""

_VERDICT_Z = 3.7584590197611987  # (1 + 0.95^(1/300)) / 2 quantile of the normal distribution

VERDICT_WIDENING = _VERDICT_Z / CONFIDENCE_Z
"""Factor from the half width of a 95 % interval to the half width that verdicts use."""

_VISIBLE = 5e-4  # smallest tolerance that is shown in a claim about a rate
_PIXEL_TOLERANCE = 0.125
_PIXEL_NOTE = (
    "Tolerance: a quarter of the distance between −1.5 (edges) and −2 (smooth). The curves have "
    "not reached their limits, and exact variances of pixels are not known."
)

Interval: TypeAlias = tuple[float, float]
"""Lower and upper end of an interval."""


@final
@dataclass(frozen=True)
class Claim:
    """A statement with its expected and its measured value. `judge` computes the verdict.

    The expectation is a number (`expected`), a bound (`above`, `below`) or a limit (`at_most`).
    Use a limit if the measured value is an error of rounding or quadrature.
    If there is no expectation, the exhibit itself gives the verdict (`holds`).

    Attributes
    ----------
    statement
        A sentence that names the source of the expectation: theory, a closed form or quadrature.
    measured
        Measured value: a number with an interval, a number without sampling error, or words.
        None if nothing could be measured.
    expected
        Expected value. The claim agrees if this value is at most `tolerance` outside the interval.
    tolerance
        Allowed error of the theory, for example if n is too small for it; `note` has the reason.
    digits
        Number of digits of the expected value that are shown.
    above, below
        Bounds. The claim agrees if the whole interval of the measured value is within the bounds.
        The claim disagrees if the whole interval is beyond a bound. Otherwise there is no verdict.
    at_most
        Largest allowed magnitude of an error.
    holds
        The verdict, or None for no verdict.
    shown
        Text that is shown as the expectation, instead of the number, bound or limit.
    note
        Explanation of the verdict.
    about
        Kind of the plot on the slide that shows the claim. Default: the first slide of the exhibit.
    corrects
        True if a confirmed claim shows that the slide is wrong, or true only in certain cases.
        For example, the claim may describe a counterexample to a statement of the slide.
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
    about: str = ""
    corrects: bool = False

    @property
    def value(self) -> float:
        """The measured number, or NaN."""
        if isinstance(self.measured, Measured):
            return self.measured.value
        return self.measured if isinstance(self.measured, float) else math.nan


@final
@dataclass(frozen=True, kw_only=True)
class Finding:
    """A claim with its verdict, as the page shows it and as it is written to ``findings.json``.

    Attributes
    ----------
    statement, note
        The statement of the claim, and the explanation of the verdict.
    expected
        Expectation as text, such as ``"−3"`` or ``"≤ 10⁻¹²"``.
    measured
        A number, words, or None if nothing could be measured.
    interval
        Interval that decides the verdict, or None if the number has no sampling error.
    agrees
        The verdict. None if the claim has no verdict, or if its bound lies inside the interval.
    corrects
        True if a confirmed claim shows that the slide is wrong, or true only in certain cases.
    """

    statement: str
    expected: str
    measured: float | str | None
    interval: Interval | None
    agrees: bool | None
    note: str = ""
    corrects: bool = False


@final
@dataclass(frozen=True, kw_only=True)
class Exhibit:
    """Reproduced figures and statements of slides. Texts and layouts are in ``slides.toml``.

    Attributes
    ----------
    numbers
        Values that replace the names in braces in the texts.
    plots
        Plots in the order of the page. Plots of one kind have the same texts and layout.
    claims
        Claims in the order in which the page shows them.
    sliders
        Sliders by kind of plot. The plot shows the value at which the slider starts.
    """

    plots: tuple[Plot, ...]
    claims: tuple[Claim, ...]
    numbers: Mapping[str, object] = field(default_factory=dict)
    sliders: Mapping[str, Slider] = field(default_factory=dict)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The claims with their verdicts."""
        return tuple(map(judge, self.claims))


class ExhibitFunction(Protocol):
    """A function that computes an exhibit with its figures and claims.

    If `quick` is True, the function takes only seconds, and its numbers are less accurate.
    For the same seed, the function returns the same plots and numbers.
    """

    def __call__(self, *, quick: bool, seed: int) -> Exhibit:
        """Compute the numbers of the exhibit, and describe its figures and claims."""


def judge(claim: Claim) -> Finding:
    """Compare the measured value of a claim with the expected value."""
    measured, shown, agrees, interval = claim.measured, claim.shown, claim.holds, None
    note = claim.note
    low = high = claim.value
    if isinstance(measured, Measured):
        low, high = measured.widened(VERDICT_WIDENING)
        finite = math.isfinite(measured.value)  # widening an infinite value would give NaN
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
            agrees, note = None, f"{note} More realizations are needed to decide.".strip()
    return Finding(
        statement=claim.statement,
        expected=shown,
        measured=measured,
        interval=interval,
        agrees=agrees,
        note=note,
        corrects=claim.corrects,
    )


def about(plot: str, *claims: Claim) -> tuple[Claim, ...]:
    """Assign claims to the slide that shows this kind of plot."""
    return tuple(replace(claim, about=plot) for claim in claims)


def correction(claim: Claim) -> Claim:
    """Mark a claim that, if confirmed, limits or contradicts a statement of its slide."""
    return replace(claim, corrects=True)


def _limit(at_most: float) -> str:
    """Format a limit as ``10⁻¹⁰`` or ``1.3×10⁻³``, rounded up to two digits."""
    exact = Decimal(f"{at_most:.12e}")
    step = Decimal(1).scaleb(exact.adjusted() - 1)
    digits, exponent = f"{exact.quantize(step, ROUND_CEILING):.1e}".replace(".0e", "e").split("e")
    return ("" if digits == "1" else f"{digits}×") + power_of_ten(int(exponent))


def mean_and_error(values: Array) -> tuple[Array, Array]:
    """Return the mean over the first axis, and its standard error."""
    return values.mean(axis=0), values.std(axis=0, ddof=1) / len(values) ** 0.5


def slope(counts: Sequence[int], variances: Array) -> float:
    """Return the slope of log variance against log count, fitted with equal weights."""
    return float(np.polyfit(np.log(counts), np.log(variances), 1)[0])


def rate_text(curve: xr.Dataset) -> str:
    """Format the rate of a curve of `mcspectra.convergence` as ``−1.52 ± 0.03``."""
    return rate(float(curve["rate"]), *map(float, curve["rate_ci"].values))


def rate_claim(
    statement: str, curve: xr.Dataset, expected: float, tolerance: float = 0.0, note: str = ""
) -> Claim:
    """Return the claim that a curve of `mcspectra.convergence` has the expected rate."""
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
    """Return a claim about a rate with a known limit; the tolerance is the error of the limit."""
    here = slope(curve["n"].values.tolist(), exact)
    note = f"Tolerance: the exact variances at these N have the slope {number(here, 5)}."
    return rate_claim(statement, curve, expected, abs(here - expected), note)


def pixel_rate(statement: str, curve: xr.Dataset, expected: float) -> Claim:
    """Return a claim that a rate is −1.5 or −2. A note says if the other rate also agrees."""
    claim, rival = (
        rate_claim(statement, curve, limit, _PIXEL_TOLERANCE, _PIXEL_NOTE)
        for limit in (expected, -3.5 - expected)
    )
    if judge(claim).agrees and judge(rival).agrees:
        weak = f"More realizations are needed to exclude {number(-3.5 - expected, 2)}."
        return replace(claim, note=f"{_PIXEL_NOTE} {weak}")
    return claim


def normal_limit(count: int, freedom: int = 0) -> float:
    """Return a limit that the largest of `count` normal errors rarely exceeds.

    With probability 99.98 %, the confidence level of a single finding, no error exceeds the limit.
    If `freedom` is given, the errors follow Student's t distribution.
    """
    from scipy.special import ndtri, stdtrit

    p = (1 + 0.95 ** (1 / (GALLERY_FINDINGS * count))) / 2
    return float(stdtrit(freedom, p) if freedom else ndtri(p))


def largest_distance(statement: str, away: Array, se: Array, freedom: int = 0) -> Claim:
    """Return the claim that several differences are all zero.

    Parameters
    ----------
    statement
        Statement without a full stop. A description of the measured value is added.
    away, se
        Differences (measured minus expected) and their standard errors, which are positive.
    freedom
        Degrees of freedom, for standard errors from a few batches.
    """
    limit = normal_limit(away.size, freedom)
    batches = "the same number of Student variables (batches)"
    return Claim(
        f"{statement}: largest distance in standard errors.",
        float(np.max(np.abs(away) / se)),
        at_most=limit,
        shown=f"≤ {limit:.1f}",
        note="Limit: largest of "
        f"{batches if freedom else f'{away.size} normal errors'} at the level of the gallery.",
    )
