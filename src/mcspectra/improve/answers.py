"""The answer to "what should I use?": candidates, results of candidates, and advice.

A *candidate* is a changed estimator or sampler.
The *result* of a candidate compares its error with the error of the given set-up, at a budget.
An *answer* names the best candidate.
If no candidate is significantly better, the answer names the given set-up.
`mcspectra.profile`, `mcspectra.remedies`, and studies of pixels and paths print an `Answer`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal, final

from mcspectra.core.display import escape_html
from mcspectra.core.errors import ParameterError
from mcspectra.estimators import AbstractEstimator
from mcspectra.explain.causes import Cause
from mcspectra.measure.setup import Setup

if TYPE_CHECKING:
    from mcspectra.samplers import Sampler

__all__ = [
    "Answer",
    "AnswerSettings",
    "Candidate",
    "CandidateResult",
    "Verdict",
    "rounded",
    "simultaneous_z",
]


@final
@dataclass(frozen=True)
class AnswerSettings:
    """Limits of the numbers that an answer reports."""

    # If a change needs more evaluations than this for the same error, no number is reported.
    # 10^15 evaluations take 11 days at 10^9 per second.
    many: float = 1e15
    # An undecided change is mentioned if it may lower the variance by this factor or more.
    # For a smaller gain, a larger budget is not worthwhile.
    may_gain: float = 2.0
    # If the ends of the interval of an RMSE differ by more than this factor, only the upper end
    # is stated: the number between them would suggest a precision that it does not have.
    # In 200 profiles (the cases of `benchmarks battery`, five seeds each), 40 of 44 stated RMSEs
    # were within a factor of 1.5 of the measured error. With 100 instead of 20, 42 of 52 were.
    wide: float = 20.0


_SETTINGS = AnswerSettings()

Verdict = Literal["given", "better", "worse", "undecided"]
"""How a candidate compares with the given set-up. The interval of the gain decides."""


@final
@dataclass(frozen=True)
class Candidate:
    """A changed estimator or sampler that may lower the noise.

    Attributes
    ----------
    kind
        Kind of the change: one of `mcspectra.improve.candidates.KINDS`, or ``"given"``.
    name, change
        A short unique label of the candidate, and an imperative that describes the change.
    setup
        The estimator and the sampler after the change.
    biased
        Whether the candidate estimates another integral.
        The error of a biased candidate is measured about the integral of the given estimator.
    pilot
        Number of evaluations, in addition to the budget, that the search for the change took.
        If the budget includes a pilot, its evaluations are counted in `Setup.overhead` instead.
    effort
        Cost of an evaluation divided by its cost in the given set-up. Longer paths cost more.
    ratio
        Expected variance divided by the given estimator's variance at equal cost; NaN if unknown.
    finite_below
        If g grows as t^−a at the border, the variance is finite for exponents a below this limit.
    note
        A sentence that is appended to the reason in the report.
    """

    kind: str
    name: str
    change: str
    setup: Setup
    biased: bool = False
    pilot: int = 0
    effort: float = 1.0
    ratio: float = math.nan
    finite_below: float = 0.5
    note: str = ""

    @property
    def key(self) -> str:
        """Text that is the same for two changes that lead to the same set-up."""
        specs = f"{self.setup.estimator.spec} with {self.setup.sampler.spec}"
        return specs if self.setup.at_count is None else f"{specs}, {self.name}"


@final
@dataclass(frozen=True)
class CandidateResult:
    """The error of a candidate for a given budget, and its gain in variance over the given set-up.

    Attributes
    ----------
    name, change
        The label of the candidate, and an imperative that describes the change.
    specs
        The estimator and the sampler after the change, as texts.
    n
        Number of points of one estimate that uses the whole budget.
    rmse, rmse_ci
        Root mean square error of an estimate, and its 95 % interval.
        The interval includes the error of extrapolation beyond the measured counts.
        RMSE and interval are NaN if the error cannot be determined.
    gain, gain_ci
        Ratio of the variances before and after the change, and the interval of this ratio.
        The intervals of all candidates are simultaneous, at 95 %.
    rate, rate_ci
        Slope of log variance against log n.
    needed, needed_ci
        Number of evaluations that the given set-up needs for the same RMSE, with its interval.
    verdict
        Whether the interval of the gain lies above 1 (better), below 1 (worse) or contains 1.
    setup
        The estimator and the sampler after the change. None for stored results and drawn sets.
    """

    name: str
    change: str
    specs: tuple[str, str]
    n: int
    rmse: float
    rmse_ci: tuple[float, float]
    gain: float = 1.0
    gain_ci: tuple[float, float] = (1.0, 1.0)
    rate: float = math.nan
    rate_ci: tuple[float, float] = (math.nan, math.nan)
    needed: float = math.nan
    needed_ci: tuple[float, float] = (math.nan, math.nan)
    verdict: Verdict = "given"
    setup: Setup | None = None

    @property
    def is_bounded(self) -> bool:
        """Whether the interval of the RMSE is so wide that only its upper end is stated."""
        low, high = self.rmse_ci
        return _SETTINGS.wide * low < high < math.inf

    @property
    def estimator(self) -> AbstractEstimator:
        """The estimator after the change, for `mcspectra.convergence` and similar functions."""
        return self._sampled.estimator

    @property
    def sampler(self) -> Sampler:
        """The sampler after the change."""
        return self._sampled.sampler

    @property
    def _sampled(self) -> Setup:
        if self.setup is None:
            raise ParameterError(f"{self.name} has no estimator, because nothing is sampled here.")
        return self.setup

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers and texts."""
        plain = {k: list(v) if isinstance(v, tuple) else v for k, v in vars(self).items()}
        del plain["setup"], plain["specs"]
        return {**plain, **dict(zip(("estimator", "sampler"), self.specs, strict=True))}


@final
@dataclass(frozen=True)
class Answer:
    """The recommended set-up at a budget, its error, and the causes of the noise.

    Attributes
    ----------
    budget
        Number of evaluations of the integrand in an estimate.
    given
        The given set-up, with which all candidates are compared.
    best
        The first result that is better than the given set-up. If no result is better, `given`.
    runner_up
        The second best candidate, or the undecided candidate with the least RMSE, or None.
    causes
        Causes of the noise, the most important first.
    results
        Results of all compared candidates, the given set-up first.
    tried, not_tried
        Names of the tested candidates, and names of untested candidates with reasons.
    instead
        A sentence that is shown instead of the advice.
    why
        Sentences that are shown after the advice.
    """

    budget: int
    given: CandidateResult
    best: CandidateResult
    runner_up: CandidateResult | None = None
    causes: tuple[Cause, ...] = ()
    results: tuple[CandidateResult, ...] = ()
    tried: tuple[str, ...] = ()
    not_tried: tuple[str, ...] = ()
    instead: str = ""
    why: str = ""

    @staticmethod
    def of(budget: int, results: Sequence[CandidateResult], **said: Any) -> Answer:
        """Make the answer from results: the given set-up first, then changes by preference.

        The keyword arguments `said` set further fields of the answer, such as `why`.
        """
        given, *others = results
        better = [result for result in others if result.verdict == "better"]
        best, runner_up = [*better, None, None][:2]
        if runner_up is None:
            open_ones = [
                each
                for each in others
                if each.verdict == "undecided"
                and each.gain > _SETTINGS.may_gain
                and each.rmse < (best or given).rmse
            ]
            runner_up = min(open_ones, key=lambda result: result.rmse, default=None)
        said.setdefault("results", tuple(results))
        said.setdefault("tried", tuple(result.name for result in others))
        return Answer(budget, given, best or given, runner_up, **said)

    @property
    def changes(self) -> bool:
        """Whether some change is better than the given set-up."""
        return self.best is not self.given

    @property
    def n(self) -> int:
        """Number of points of one estimate that uses the whole budget."""
        return self.best.n

    @property
    def rmse(self) -> float:
        """Root mean square error of an estimate with the best candidate."""
        return self.best.rmse

    @property
    def rmse_ci(self) -> tuple[float, float]:
        """95 % interval of `rmse`."""
        return self.best.rmse_ci

    @property
    def gain(self) -> float:
        """Ratio of the variances with the given set-up and with the best candidate."""
        return self.best.gain

    @property
    def gain_ci(self) -> tuple[float, float]:
        """95 % interval of `gain`."""
        return self.best.gain_ci

    @property
    def advice(self) -> str:
        """The first sentence of the answer."""
        if self.instead:
            return self.instead
        best, given = self.best, self.given
        name = given.specs[1]  # The sampler's spec
        if not self.changes:
            many = f"none of the {len(self.tried)} tested changes is significantly better"
            none = many if len(self.tried) > 1 else "no tested change is significantly better"
            return f"Keep {name}: {none}.{self._perhaps()}"
        what = f"{best.change[0].upper()}{best.change[1:]}"
        if math.isnan(best.gain):
            return (
                f"{what}: it was better where both were measured, but its gain at {self.budget} "
                "evaluations could not be extrapolated."
            )
        before = f"{given.rmse:.2g}" if math.isfinite(given.rmse) else "an infinite one"
        text = f"{what}: RMSE {_stated(best)} at {self.budget} evaluations instead of {before}"
        least = best.needed_ci[0]
        if best.is_bounded and self.budget < least < _SETTINGS.many:
            text += f"; {name} would need at least {rounded(least)} evaluations for this RMSE"
        elif not best.is_bounded and self.budget < best.needed < _SETTINGS.many:
            needed = f"{rounded(best.needed)}{_between(best.needed_ci)}"
            text += f"; {name} would need about {needed} evaluations for the same RMSE"
        return f"{text}.{self._perhaps() if best.gain < _SETTINGS.may_gain else ''}"

    def _perhaps(self) -> str:
        """Mention an undecided change that may be better, if there is one."""
        other = self.runner_up
        if other is None or other.verdict != "undecided":
            return ""
        return (
            f" With {other.name} the RMSE may be {other.rmse:.2g}{_between(other.rmse_ci)} instead "
            f"of {self.given.rmse:.2g}; a larger budget would decide."
        )

    def __str__(self) -> str:
        return f"{self.advice} {self.why}".strip()

    def _repr_html_(self) -> str:
        return f"<p><b>{escape_html(str(self))}</b></p>"

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, texts and lists."""
        return {
            "text": str(self),
            "budget": self.budget,
            "given": self.given.to_dict(),
            "best": self.best.to_dict(),
            "runner_up": None if self.runner_up is None else self.runner_up.to_dict(),
            "causes": [{**asdict(cause), "kinds": list(cause.kinds)} for cause in self.causes],
            "tried": list(self.tried),
            "not_tried": list(self.not_tried),
        }


def simultaneous_z(comparisons: int) -> float:
    """Return the half width of simultaneous 95 % intervals, in standard errors [Šidák 1967]."""
    from scipy.special import ndtri

    single = 0.95 ** (1.0 / max(1, comparisons))
    return float(ndtri(0.5 * (1.0 + single)))


def rounded(value: float) -> str:
    """Format a number of evaluations with two digits, in millions or larger units."""
    for size, name in ((1e12, " trillion"), (1e9, " billion"), (1e6, " million"), (10.0, "")):
        if size <= value < _SETTINGS.many:
            scale = 1.0 if size < 1e6 else size
            return f"{float(f'{value / scale:.2g}'):.{0 if value / scale >= 10.0 else 1}f}{name}"
    return f"{value:.2g}"


def _stated(result: CandidateResult) -> str:
    """Format an RMSE with its interval. If the interval begins at zero, name only its upper end."""
    if result.is_bounded:
        return f"at most {result.rmse_ci[1]:.2g}"
    return f"{result.rmse:.2g}{_between(result.rmse_ci)}"


def _between(ends: tuple[float, float]) -> str:
    """Format an interval in parentheses.

    Return "" if the width is infinite or zero, also if it is zero after rounding to two digits.
    """
    low, high = ends
    if math.isinf(high) and 0.0 < low < math.inf:
        return f" ({rounded(low)} or more)"
    if not (math.isfinite(high - low) and high > low):
        return ""
    shown = rounded(low), rounded(high)
    return "" if shown[0] == shown[1] else f" ({' to '.join(shown)})"
