"""Set-ups compared on the same random numbers: ratios of errors and differences of rates.

Realisation r of every set-up uses the random numbers of realisation r of every other (as far as they
use them alike), and so do all counts. What an error measure log v, or a slope fitted to several, owes to
realisation r is its *influence*; the influence of a difference is the difference of influences, and its
standard error the root of their mean square over √R. Correlation, between set-ups and between counts,
is thereby in the error, whichever way it goes: no pairing has to be assumed.

For the mean squared error v = Σ_c mean_r (e_rc − I_c)² the influence on log v is
ψ_r = Σ_c (e_rc − I_c)²/v − 1; for an unbiased estimator I_c is the mean of the estimates, and v the
variance, summed over channels.

Estimates that are all alike have no variance, or none of them has met what makes it: a rare event. The
integral tells the two apart. Where they miss it their error is unknown (NaN), not 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.parallel import Block, realization_blocks
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator
from mcspectra.estimators.moments import rounding_floor
from mcspectra.samplers import Sampler
from mcspectra.variance.fit import RateFit, fit_rate, widening

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
        Mean estimate minus the integral, (N, C).
    influence
        ψ, (N, R).
    noise
        v below which the estimates differ by rounding only, (N,).
    blind
        Whether the estimates are all alike, but not the integral, (N,).
    """

    cost: Array
    error: Array
    bias: Array
    influence: Array
    noise: Array
    blind: Array

    @staticmethod
    def of(
        cost: Sequence[int],
        estimates: Sequence[Array],
        integral: Array,
        *,
        biased: bool = False,
        tolerance: float = 1e-9,
    ) -> Errors:
        """Errors of estimates (R, C) at each cost.

        Parameters
        ----------
        cost, estimates
            One array (R, C) for each cost.
        integral
            What is estimated, (C,).
        biased
            Take the error about the integral; else about the mean of the estimates.
        tolerance
            How well the integral is known, relative to it.
        """
        # Mean squared errors and influences (R,), about the integral or the mean
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
        miss = np.abs(bias).max(axis=1) > tolerance * np.abs(integral).max()
        alike = np.array(
            [
                np.ptp(v, axis=0).max() <= 4 * math.sqrt(f)
                for v, f in zip(estimates, noise, strict=True)
            ]
        )
        return Errors(
            cost=np.asarray(cost, np.float64),
            error=error,
            bias=bias,
            influence=np.stack([influence for _, influence in parts]),
            noise=noise,
            blind=alike & miss & (not biased),
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

    def widening(self) -> float:
        """By what the lack of fit widens the interval of the rate."""
        degrees = int(self.used.sum()) - 2
        return widening(degrees, self.fit().chi2) if degrees > 0 else 1.0

    def at(self, budget: float) -> tuple[float, Array]:
        """log v at a cost of `budget`, and its influences (R,): the last error, carried by the rate."""
        last = len(self.cost) - 1
        if not self.used[last]:
            unknown = math.nan if self.blind[last] else -math.inf
            return unknown, np.zeros(self.influence.shape[1])
        gap = math.log(budget / self.cost[last])
        log_error, influence = math.log(self.error[last]), self.influence[last]
        if gap == 0.0:
            return log_error, influence
        rate, slope = self.rate()
        if math.isnan(rate):
            return log_error, influence
        return log_error + gap * rate, influence + gap * slope


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
    bend = max(e.widening() for e in (errors, reference))
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
    """Estimates of realisations 0 … realizations − 1, (R, channels or 1)."""

    def block(part: Block) -> Array:
        return estimator.estimate(estimator.draw(sampler, n, stream, *part)).reshape(part[1], -1)

    numbers = n * estimator.dims * sum(estimator.counts)
    return np.concatenate([block(part) for part in realization_blocks(realizations, numbers)])


def simultaneous_z(comparisons: int, confidence: float = 0.95) -> float:
    """Half width, in standard errors, of intervals that all hold together [Šidák 1967]."""
    from scipy.special import ndtri

    single = confidence ** (1.0 / max(1, comparisons))
    return float(ndtri(0.5 * (1.0 + single)))


def _standard_error(influence: Array, prior: int = _PRIOR) -> float:
    """Root of the mean square over √R; few values are drawn towards those of normal estimates."""
    count = len(influence)
    square = (np.square(influence).sum() + 2.0 * prior) / (count + prior)
    return math.sqrt(square / count)
