"""Assessment of candidates: errors at several costs with common random numbers, and verdicts.

Each realization of a candidate is compared with the same realization of the given set-up.
The comparison uses influence functions (docs/theory.md, "Intervals of variances, and stopping").
All estimates of a set-up may be equal because the set-up has no variance.
Estimates may also be equal because all of them have missed a rare event.
If equal estimates differ from the integral, the error is unknown (NaN), not 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import rounding_floor
from mcspectra.core.fits import RateFit, fit_rate, widening
from mcspectra.core.ordered import weighted_sum
from mcspectra.core.parallel import Block, realization_blocks
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator
from mcspectra.estimators.moments import variance_interval
from mcspectra.explain.diagnosis import jumps_inside
from mcspectra.improve.answers import Candidate, CandidateResult, Verdict, simultaneous_z
from mcspectra.samplers import Sampler

__all__ = [
    "AssessSettings",
    "Assessed",
    "Comparison",
    "Errors",
    "MeasuredCandidate",
    "assessed",
    "compare",
    "estimates_of",
]


@final
@dataclass(frozen=True)
class AssessSettings:
    """Settings of the comparison of candidates with the given set-up."""

    # In fits of rates, standard errors are moved toward the standard errors of normal estimates.
    # For this, fictitious realizations with a normal distribution are added to the measured ones.
    # This is the number of fictitious realizations. Comparisons of two set-ups do not use them.
    # For 100 normal realizations, adding 20 reduces the scatter of standard errors from 12 to 10 %.
    # With 0 to 40 added realizations, intervals contain the true rate in 93 to 95 % of cases.
    prior: int = 20
    # Equal estimates of a candidate count as exact if they are near the mean of the given set-up.
    # Their difference from this mean may be at most this number of standard errors of the mean.
    # A normal mean is wrong by more than 4 standard errors with probability 6e-5.
    sigmas: float = 4.0


_SETTINGS = AssessSettings()


@dataclass(frozen=True)
class Errors:
    """Errors of one set-up at several costs."""

    cost: Array  # evaluations of the integrand in an estimate, (N,)
    error: Array  # mean squared error v, summed over channels, (N,)
    mean: Array  # mean estimate, (N, C)
    bias: Array  # mean estimate minus the integral, (N, C), NaN if the integral is not known
    influence: Array  # influence functions ψ of the realizations, (N, R)
    noise: Array  # Value of v below which the estimates differ by rounding only, (N,)
    blind: Array  # Whether the estimates are all equal, but differ from the integral, (N,)
    # Number of evaluations before the first point of an estimate, for example in a pilot.
    # The rate is fitted without evaluations before the first point: they do not grow with n
    overhead: int = 0

    @staticmethod
    def of(
        cost: Sequence[int],
        estimates: Sequence[Array],
        integral: Array,
        *,
        biased: bool = False,
        tolerance: float = 1e-9,
        overhead: int = 0,
    ) -> Errors:
        """Compute errors from estimates (R, C): for each cost, R estimates of C channels.

        If `biased` is true, errors are taken about the integral, else about the mean estimate.
        `tolerance` is the relative tolerance of the integral.
        """
        # Compute mean squared errors about the integral or the mean, (N,).
        # Also compute the influence of each realization on these errors, (R,)
        parts = []
        for values in estimates:
            count = len(values)
            centre = integral if biased else values.mean(axis=0)
            squares = ((values - centre) ** 2).sum(axis=1)
            mean = squares.mean()
            influence = squares / mean - 1.0 if mean > 0 else np.zeros(count)
            parts.append((float(squares.sum() / (count if biased else count - 1)), influence))
        error = np.array([error for error, _ in parts])
        bias = np.stack([values.mean(axis=0) - integral for values in estimates])
        noise = np.array([rounding_floor(np.abs(v).mean(axis=0)).sum() for v in estimates])
        # If the integral is unknown, the bias is NaN; it counts as larger than the tolerance
        miss = ~(np.abs(bias).max(axis=1) <= tolerance * np.abs(integral).max())
        alike = np.array(
            [
                np.ptp(v, axis=0).max() <= 4 * math.sqrt(f)
                for v, f in zip(estimates, noise, strict=True)
            ]
        )
        return Errors(
            cost=np.asarray(cost, np.float64),
            error=error,
            mean=np.stack([values.mean(axis=0) for values in estimates]),
            bias=bias,
            influence=np.stack([influence for _, influence in parts]),
            noise=noise,
            blind=alike & miss & (not biased),
            overhead=overhead,
        )

    def checked(self, reference: Errors) -> Errors:
        """Set the variance to 0 where equal estimates agree with the mean of the given set-up.

        The integral is unknown here, and the mean of the given set-up has a standard error.
        """
        if not np.isnan(self.bias).any() or reference.blind[-1]:
            return self
        count = self.influence.shape[1]
        away = np.abs(self.mean - reference.mean[-1]).sum(axis=1)
        same = away <= _SETTINGS.sigmas * math.sqrt(float(reference.error[-1]) / count)
        return replace(self, blind=self.blind & ~same)

    @property
    def used(self) -> Array:
        """Whether each error is larger than rounding noise, (N,)."""
        return np.asarray(self.error > self.noise)

    @property
    def relative_se(self) -> Array:
        """Relative standard error of v, (N,)."""
        return np.array([_standard_error(psi) for psi in self.influence])

    def rate(self) -> tuple[float, Array]:
        """Return the rate, the slope of log v over log(cost − overhead), and influences (R,).

        The fit uses weighted least squares as in `mcspectra.core.fits`.
        The slope is NaN if there are fewer than two errors.
        """
        used = self.used
        if used.sum() < 2:
            return math.nan, np.full(self.influence.shape[1], np.nan)
        x, y = np.log(self.cost[used] - self.overhead), np.log(self.error[used])
        weight = self.relative_se[used] ** -2.0
        centred = weight * (x - np.average(x, weights=weight))
        slope = centred / (centred * x).sum()
        return float((slope * y).sum()), weighted_sum(slope, self.influence[used])

    def fit(self) -> RateFit:
        """Fit the rate, its interval and the lack of fit; see `mcspectra.convergence`."""
        return fit_rate(self.cost - self.overhead, self.error, self.relative_se, self.noise)

    def at(self, budget: float, *, carry: bool = True) -> tuple[float, Array]:
        """Return the logarithm of the error at the cost `budget`, extrapolated along the rate.

        Also return the influence of each realization on the log error, (R,).

        If the set-up needs a pilot, the error at the largest cost is returned, not extrapolated.
        After a pilot, nets often have only half of the points that the budget allows.
        """
        last = len(self.cost) - 1
        if not self.used[last]:
            unknown = math.nan if self.blind[last] else -math.inf
            return unknown, np.zeros(self.influence.shape[1])
        gap = math.log(budget / self.cost[last]) if carry and not self.overhead else 0.0
        log_error, influence = math.log(self.error[last]), self.influence[last]
        if gap == 0.0:
            return log_error, influence
        rate, slope = self.rate()
        if math.isnan(rate):
            return log_error, influence
        return log_error + gap * rate, influence + gap * slope


@dataclass(frozen=True)
class Comparison:
    """Ratio of the variances of two set-ups at a budget, and difference of their rates."""

    # Logarithm of v/v_reference, and its standard error
    log_ratio: float
    log_ratio_se: float
    # Rate minus the rate of the reference, and its standard error; NaN if a rate is NaN
    rate_difference: float
    rate_difference_se: float


def compare(errors: Errors, reference: Errors, budget: float, pilot: int = 0) -> Comparison:
    """Compare two set-ups with the same number of realizations and the same random numbers.

    `pilot` is the number of evaluations in a pilot, in addition to the budget.
    The reference set-up is compared at the budget plus the evaluations of the pilot.
    """
    carry = not errors.overhead and not reference.overhead
    own, own_influence = errors.at(budget, carry=carry)
    other, other_influence = reference.at(budget + pilot, carry=carry)
    rate, slope = errors.rate()
    other_rate, other_slope = reference.rate()
    # Increase the error of the slope if log errors deviate from a line by more than their noise
    points = ((e, int(e.used.sum()) - 2) for e in (errors, reference))
    bend = max(widening(free, e.fit().chi2) if free > 0 else 1.0 for e, free in points)
    return Comparison(
        own - other,
        _standard_error(own_influence - other_influence, prior=0),
        rate - other_rate,
        bend * _standard_error(slope - other_slope, prior=0),
    )


def estimates_of(
    estimator: AbstractEstimator,
    sampler: Sampler,
    n: int,
    realizations: int,
    stream: Stream,
) -> Array:
    """Return the estimates of the first realizations, (R, channels or 1)."""

    def block(part: Block) -> Array:
        return estimator.estimate(estimator.draw(sampler, n, stream, *part)).reshape(part[1], -1)

    numbers = n * estimator.dims * sum(estimator.counts)
    return np.concatenate([block(part) for part in realization_blocks(realizations, numbers)])


def _standard_error(influence: Array, prior: int = _SETTINGS.prior) -> float:
    """Return the standard error of an estimate, from the influences of R realizations on it.

    The influence of a realization is R times the change that it causes in the estimate.
    For normal realizations, influences on the logarithm of a variance have the variance 2.
    `prior` influences with variance 2 are added to the given influences.
    """
    count = len(influence)
    square = (np.square(influence).sum() + 2.0 * prior) / (count + prior)
    return math.sqrt(square / count)


@final
@dataclass(frozen=True)
class MeasuredCandidate:
    """A candidate in a form that can be stored: its description as texts, its errors as numbers.

    Attributes
    ----------
    kind, name, change
        The kind of the candidate, its name, and a description of the change, as in `Candidate`.
    biased, pilot
        Whether the candidate is biased, and the evaluations of its pilot, as in `Candidate`.
    note, key
        A sentence for the report, and a text that identifies the set-up, as in `Candidate`.
    specs
        The estimator and the sampler, as texts.
    n
        Number of points of an estimate at the largest budget.
    errors
        Errors of the candidate at several numbers of evaluations.
    infinite_weights, jumps
        Whether a change of the warp makes weights infinite, and whether g jumps inside the cube.
        `infinite_weights` is False for all other changes.
        `jumps` is None if jumps were not tested.
    """

    kind: str
    name: str
    change: str
    specs: tuple[str, str]
    key: str
    n: int
    errors: Errors
    biased: bool = False
    pilot: int = 0
    note: str = ""
    infinite_weights: bool = False
    jumps: bool | None = None

    @staticmethod
    def of(candidate: Candidate, errors: Errors) -> MeasuredCandidate:
        """Describe a candidate by texts, and store the measured errors of its estimates."""
        setup = candidate.setup
        warp = candidate.kind == "warp"
        known = warp and not setup.is_black_box
        return MeasuredCandidate(
            candidate.kind,
            candidate.name,
            candidate.change,
            (setup.estimator.spec, setup.sampler.spec),
            candidate.key,
            round((errors.cost[-1] - errors.overhead) / (setup.cost * candidate.effort)),
            errors,
            biased=candidate.biased,
            pilot=candidate.pilot,
            note=candidate.note,
            infinite_weights=warp and setup.estimator.infinite_weights,
            jumps=jumps_inside(setup.estimator, setup.sampler) if known else None,
        )


@final
@dataclass(frozen=True)
class Assessed:
    """A candidate compared with the given set-up, by its error and by its rate.

    Attributes
    ----------
    measured
        The candidate with its errors at several costs.
    result
        The error of the candidate at the budget, compared with the error of the given set-up.
    error, error_ci
        Variance or mean squared error at the budget, with its 95 % interval.
    ratio, ratio_ci
        The error of the candidate divided by the error of the given set-up, with its interval.
    rate_difference, rate_difference_ci
        The rate of the candidate minus the rate of the given set-up, with its interval.
    rate_verdict
        Whether the rate of the candidate is better or worse than the rate of the given set-up.
    """

    measured: MeasuredCandidate
    result: CandidateResult
    error: float
    error_ci: tuple[float, float]
    ratio: float
    ratio_ci: tuple[float, float]
    rate_difference: float
    rate_difference_ci: tuple[float, float]
    rate_verdict: Verdict

    @property
    def blind(self) -> bool:
        """Whether all estimates at the budget are equal and differ from the integral."""
        return bool(self.measured.errors.blind[-1])


def assessed(measured: Sequence[MeasuredCandidate], budget: int) -> list[Assessed]:
    """Compare all candidates with the given set-up, which is first; intervals are simultaneous."""
    # Each candidate is compared twice with the given set-up: by its error and by its rate
    z = simultaneous_z(2 * (len(measured) - 1))
    reference = measured[0].errors
    slope = reference.rate()[0]

    def needed(log_ratio: float) -> float:
        """Return how many evaluations the given set-up needs to reach the candidate's error."""
        if not slope < 0.0 or math.isnan(log_ratio):
            return math.nan
        return budget * math.exp(min(log_ratio / slope, 700.0))

    found = []
    for each in measured:
        errors = each.errors.checked(reference)
        candidate = replace(each, errors=errors)
        against = compare(errors, reference, budget, candidate.pilot)
        log_error, influence = errors.at(budget)
        spread = max(math.sqrt(float(np.mean(influence**2)) / len(influence)), 1e-9)
        fit = RateFit() if candidate.biased else errors.fit()
        ratio = _around(against.log_ratio, z * against.log_ratio_se)
        difference = math.nan if candidate.biased else against.rate_difference
        differences = _around(difference, z * against.rate_difference_se)
        given = candidate.kind == "given"
        ends = variance_interval(np.asarray(math.exp(log_error)), np.asarray(spread))
        own = CandidateResult(
            name=candidate.name,
            change=candidate.change,
            specs=candidate.specs,
            n=candidate.n,
            rmse=math.exp(0.5 * log_error),
            rmse_ci=(math.sqrt(float(ends[0])), math.sqrt(float(ends[1]))),
            gain=_exp(-against.log_ratio),
            gain_ci=(_exp(-ratio[1]), _exp(-ratio[0])),
            rate=fit.rate,
            rate_ci=(float(fit.interval[0]), float(fit.interval[1])),
            needed=needed(against.log_ratio),
            needed_ci=(needed(ratio[1]), needed(ratio[0])),
            verdict="given" if given else _verdict(ratio),
        )
        found.append(
            Assessed(
                candidate,
                own,
                error=math.exp(log_error),
                error_ci=(float(ends[0]), float(ends[1])),
                ratio=math.exp(against.log_ratio),
                ratio_ci=(math.exp(ratio[0]), math.exp(ratio[1])),
                rate_difference=difference,
                rate_difference_ci=differences,
                rate_verdict="given" if given else _verdict(differences),
            )
        )
    return found


def _exp(x: float) -> float:
    return math.exp(x) if x < 700.0 else math.inf


def _around(center: float, half: float) -> tuple[float, float]:
    return center - half, center + half


def _verdict(interval: tuple[float, float]) -> Verdict:
    """Return the verdict of an interval of a log ratio or a difference; lower values are better."""
    low, high = interval
    return "better" if high < 0 else "worse" if low > 0 else "undecided"
