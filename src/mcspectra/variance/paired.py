"""Set-ups compared on the same random numbers: ratios of errors and differences of rates.

Realisation r of every set-up uses the random numbers of realisation r of every other (as far as they
use them alike), and so do all counts. What an error measure log v, or a slope fitted to several, owes to
realisation r is its *influence*; the influence of a difference is the difference of influences, and its
standard error the root of their mean square over √R. Correlation, between set-ups and between counts,
is thereby in the error, whichever way it goes: no pairing has to be assumed.

For the mean squared error v = Σ_c mean_r (e_rc − I_c)² the influence on log v is
ψ_r = Σ_c (e_rc − I_c)²/v − 1; for an unbiased estimator I_c is the mean of the estimates, and v the
variance, summed over channels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.parallel import Block, map_in_order, realization_blocks
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator
from mcspectra.estimators.moments import rounding_floor
from mcspectra.samplers import Sampler
from mcspectra.variance.fit import RateFit, fit_rate

__all__ = ["Comparison", "Errors", "compare", "estimates_of", "simultaneous_z"]

_PRIOR = 20  # realisations' worth of the belief that estimates are normal: Var(ψ) = 2


@dataclass(frozen=True)
class Errors:
    """Errors of one set-up at several costs.

    Attributes
    ----------
    cost
        Evaluations of the integrand in an estimate, (N,).
    error
        Mean squared error v, summed over channels, (N,).
    bias
        Mean estimate minus the truth, (N, C); 0 where the estimator is taken to be unbiased.
    influence
        ψ, (N, R).
    noise
        v below which the estimates differ by rounding only, (N,).
    """

    cost: Array
    error: Array
    bias: Array
    influence: Array
    noise: Array

    @staticmethod
    def of(cost: Sequence[int], estimates: Sequence[Array], truth: Array | None) -> Errors:
        """Errors of estimates (R, C) at each cost; about `truth` (C,), or their mean where None."""
        parts = [_spread(values, truth) for values in estimates]
        return Errors(
            np.asarray(cost, np.float64),
            np.array([error for error, _, _ in parts]),
            np.stack([bias for _, bias, _ in parts]),
            np.stack([influence for _, _, influence in parts]),
            np.array([rounding_floor(np.abs(values).mean(axis=0)).sum() for values in estimates]),
        )

    @property
    def used(self) -> Array:
        """Which errors are more than rounding noise, (N,)."""
        return np.asarray(self.error > self.noise)

    @property
    def relative_se(self) -> Array:
        """Standard error of v relative to it, (N,)."""
        return np.array([_standard_error(psi) for psi in self.influence])

    def rate(self) -> tuple[float, Array]:
        """Slope of log v against log cost, and the influence of each realisation on it, (R,).

        Weighted least squares as in `mcspectra.variance.fit`; NaN where fewer than two can be fitted.
        """
        used = self.used
        if used.sum() < 2:
            return math.nan, np.full(self.influence.shape[1], np.nan)
        x, y = np.log(self.cost[used]), np.log(self.error[used])
        weight = self.relative_se[used] ** -2.0
        centred = weight * (x - np.average(x, weights=weight))
        slope = centred / (centred * x).sum()
        return float(slope @ y), np.asarray(slope @ self.influence[used])

    def fit(self) -> RateFit:
        """The rate with its interval and lack of fit, as `mcspectra.convergence` gives it."""
        return fit_rate(self.cost, self.error, self.relative_se, self.noise)

    def at(self, budget: float) -> tuple[float, Array]:
        """log v at a cost of `budget`, and its influences (R,): the last error, carried by the rate."""
        last = len(self.cost) - 1
        if not self.used[last]:
            return -math.inf, np.zeros(self.influence.shape[1])
        gap = math.log(budget / self.cost[last])
        log_error, influence = math.log(self.error[last]), self.influence[last]
        if gap == 0.0:
            return log_error, influence
        rate, slope = self.rate()
        return (
            (log_error, influence)
            if math.isnan(rate)
            else (
                log_error + gap * rate,
                influence + gap * slope,
            )
        )


@dataclass(frozen=True)
class Comparison:
    """One set-up against another: the ratio of errors at a budget, and the difference of rates.

    Attributes
    ----------
    log_ratio, log_ratio_se
        log(v/v_reference) and its standard error.
    rate_difference, rate_difference_se
        Rate minus the reference's, and its standard error; NaN where a rate is.
    """

    log_ratio: float
    log_ratio_se: float
    rate_difference: float
    rate_difference_se: float


def compare(errors: Errors, reference: Errors, budget: float) -> Comparison:
    """Compare two set-ups of as many realisations on the same random numbers."""
    own, own_influence = errors.at(budget)
    other, other_influence = reference.at(budget)
    rate, slope = errors.rate()
    other_rate, other_slope = reference.rate()
    # Curves that bend or wobble know their slope less well than their scatter says
    bend = math.sqrt(max(1.0, *(np.nan_to_num(e.fit().chi2) for e in (errors, reference))))
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
    workers: int = 1,
) -> Array:
    """Estimates of realisations 0 … realizations − 1, (R, channels or 1)."""

    def block(part: Block) -> Array:
        return estimator.estimate(estimator.draw(sampler, n, stream, *part)).reshape(part[1], -1)

    numbers = n * estimator.dims * sum(estimator.counts)
    return np.concatenate(
        list(map_in_order(block, realization_blocks(realizations, numbers), workers))
    )


def simultaneous_z(comparisons: int, confidence: float = 0.95) -> float:
    """Half width, in standard errors, of intervals that all hold together [Šidák 1967]."""
    from scipy.special import ndtri

    single = confidence ** (1.0 / max(1, comparisons))
    return float(ndtri(0.5 * (1.0 + single)))


def _spread(values: Array, truth: Array | None) -> tuple[float, Array, Array]:
    """Mean squared error, bias (C,) and influences (R,) of estimates (R, C)."""
    count = len(values)
    bias = np.zeros(values.shape[1]) if truth is None else values.mean(axis=0) - truth
    centre = values.mean(axis=0) if truth is None else truth
    squares = ((values - centre) ** 2).sum(axis=1)
    error = float(squares.sum() / (count - 1 if truth is None else count))
    mean = squares.mean()
    return error, bias, squares / mean - 1.0 if mean > 0 else np.zeros(count)


def _standard_error(influence: Array, prior: int = _PRIOR) -> float:
    """Root of the mean square over √R; few values are drawn towards those of normal estimates."""
    count = len(influence)
    square = (np.square(influence).sum() + 2.0 * prior) / (count + prior)
    return math.sqrt(square / count)
