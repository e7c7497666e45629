"""Parts of the variance that samples miss: ∫f²/p where no sample falls, and growth at the border.

∫1/p and the variance may be finite and yet far larger than any simulation can measure.
As an example, let f = 1, and let p be normal about ½ with σ = 0.02. Then ∫f²/p is 4e131.
Points x within 0.005 of 0 or 1 contribute 99.8 % of ∫f²/p; one sample in 3e134 falls there.

If f grows without bound toward a face of the cube,
the outermost stratum causes most of the variance of stratified points.
If f ∝ t^−κ at the distance t, the error of a point set is proportional to u^−κ.
Here u is a uniform random number.
For a few point sets, Student's t of errors proportional to u^−κ has a skewed distribution.
The quantiles of this skewed distribution depend only on κ and on the number of point sets.
`growing_interval` computes these quantiles by simulation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.estimators.base import AbstractEstimator
from mcspectra.estimators.importance import Estimator
from mcspectra.estimators.moments import Moments, mean_interval
from mcspectra.estimators.support import probe_points

__all__ = [
    "BorderGrowth",
    "TailSettings",
    "border_growth",
    "doubt",
    "few_note",
    "growing_interval",
    "growth_exponents",
    "growth_note",
    "tail_note",
    "tied_error",
    "unsampled_note",
    "unsampled_share",
]

_LEAST, _POINTS = 2**12, 2**16
_LARGE = 0.1  # Smallest share of ∫f²/p in regions without samples that causes a note


@final
@dataclass(frozen=True)
class TailSettings:
    """Settings that detect from values at points whether f grows at the border."""

    # The exponent is fitted to the values at the points closest to a face.
    # The fit uses at most `most` points, and at most the fraction 1/`part` of all points
    most: int = 64
    part: int = 16
    # Least number of points in a fit, which has three parameters
    least: int = 16
    # Largest number of points of which the closest to a face are searched, to save time.
    # Of 2^16 points, the 64 closest have distances of at most 0.001
    tested: int = 2**16
    # Candidates for the exponent κ: the smallest, the largest, and their number.
    # κ is −1 for smooth functions, and 1 for a pole of order 1
    exponents: tuple[float, float, int] = (-1.0, 1.3, 116)
    # If the exponent exceeds this limit, errors of strata are skewed.
    # The exponent is −1 for smooth bounded functions, −½ for square roots, and 0 for logarithms
    skewed: float = -0.25
    # f counts as growing toward a face if the fitted slope exceeds this many standard errors.
    # The limit is high because up to 100 faces are tested
    sure: float = 4.0
    # f may grow toward a face if the median of f close to the face exceeds this quantile of f.
    # The median is over the closest quarter of the points to which the growth is fitted.
    # At most 1/16 of all points are fitted, so the median is over at most 1/64 of all points
    outermost: float = 0.95
    # Exponents above the first limit make the variance infinite; above the second, ∫f diverges.
    # In theory, the limits of the exponent are ½ and 1.
    # Both limits are lower here because an exponent that is fitted to 64 points has an error
    no_variance: float = 0.48
    no_integral: float = 0.95
    # Least exponent for which ∫f⁴ is infinite, so that the error of a variance is unknown: ¼
    infinite_error: float = 0.25
    # Largest exponent for which quantiles are computed.
    # If the exponent is larger, the interval of the mean is infinite,
    # provided that the lower end of the exponent's interval exceeds `surely`.
    # Among 2,700 integrals of exp(x + y), five had an exponent above `largest` by chance
    largest: float = 0.46
    surely: float = 0.25
    # If f grows without bound, one end of the interval of the integral is moved outward.
    # Probability that the integral lies beyond the end that is moved.
    # The other end comes from Student's t, and the integral hardly ever lies beyond this other end
    beyond: float = 0.04
    # If only 4 values hold half of the variance, most sets miss important regions.
    # Of 8,192 values of a smooth function, 700 or more hold half of the variance.
    # For x^−0.3, 60 values hold half of the variance; for a peak on 1 % of the square, 45 values.
    # For three narrow peaks in 8 dims, a single value holds half of the variance
    few: int = 4
    # Number of simulated values of Student's t from which a quantile is estimated.
    # With 40,000 values, the quantile for the probability `beyond` has an error of about 1 %
    samples: int = 40_000


TAIL_SETTINGS = TailSettings()
"""Default settings for growth at the border."""


@final
@dataclass(frozen=True)
class BorderGrowth:
    """Growth of f toward a face of the cube, about as t^−κ, where t is the distance to the face.

    Attributes
    ----------
    axis, high
        The face: x_axis = 1 if `high`, and x_axis = 0 otherwise.
    exponent, low
        The exponent κ and the lower end of its 95 % interval. A logarithm has κ = 0.
    sign
        1 if f grows to +∞, and −1 if f falls to −∞.
    nearest
        Smallest distance of any point from the face.
    """

    axis: int
    high: bool
    exponent: float
    low: float
    sign: int
    nearest: float

    def endless(self, settings: TailSettings = TAIL_SETTINGS) -> bool:
        """Return whether the variance may be infinite if f grows with this exponent."""
        return self.exponent > settings.largest and self.low > settings.surely

    def without_integral(self, settings: TailSettings = TAIL_SETTINGS) -> bool:
        """Return whether ∫f does not exist if f keeps growing with this exponent up to the face."""
        return self.low >= settings.no_integral


def border_growth(
    points: Array, values: Array, settings: TailSettings = TAIL_SETTINGS
) -> list[BorderGrowth]:
    """Return the faces toward which f grows, from its values (N,) at points (N, d).

    The model c + b (t^−κ − 1)/κ is fitted to the values closest to each face.
    The error of a value is assumed to be proportional to its distance from the median.
    """
    count = min(settings.most, len(values) // settings.part)
    if count < settings.least:
        return []
    exponents = np.linspace(*settings.exponents)[:, None]
    zero = exponents == 0.0
    centre = float(np.median(values))

    def fitted(logs: Array, y: Array) -> tuple[float, float, float, float]:
        """Return the exponent and its lower end, and the slope and its error, by weighted fits."""
        size, free = np.abs(y - centre), len(y) - 3
        weight = np.maximum(size, 1e-3 * size.max()) ** -2.0
        weight /= weight.sum()
        shape = np.where(zero, -logs, np.expm1(-exponents * logs) / (exponents + zero))
        x, z = shape - (shape @ weight)[:, None], y - y @ weight
        square = (x**2) @ weight
        slope = (x * z) @ weight / square
        rest = ((z - slope[:, None] * x) ** 2) @ weight
        best = int(np.argmin(rest))
        near = exponents[rest <= rest[best] * (1.0 + 4.0 / free), 0]
        error = math.sqrt(rest[best] / square[best] / free)
        return float(exponents[best, 0]), float(near.min()), float(slope[best]), error

    found = []
    for axis, high in itertools.product(range(points.shape[1]), (False, True)):
        t = 1.0 - points[:, axis] if high else points[:, axis]
        closest = np.argpartition(t, count)[:count]
        closest = closest[np.argsort(t[closest])]
        logs, y = np.log(np.maximum(t[closest], 1e-300)), values[closest]
        if not np.ptp(y[1:]) or not np.ptp(logs[1:]) or not (y != centre).any():
            continue
        # A single value that is large by chance does not count as growth
        fits = [fitted(logs, y), fitted(logs[1:], y[1:])]
        exponent, low = (min(fit[k] for fit in fits) for k in (0, 1))
        sign = 1 if fits[0][2] > 0.0 else -1
        # f grows toward a face if values close to the face are far above (or below) the median.
        # "Far" means farther than 95 % of all values of f (the setting `outermost`)
        usual = np.quantile(sign * (values - centre), settings.outermost)
        grows = np.median(sign * (y[: count // 4] - centre)) > usual
        grows &= all(sign * slope > settings.sure * error for _, _, slope, error in fits)
        if grows and low > settings.skewed:
            found.append(BorderGrowth(axis, high, exponent, low, sign, float(t[closest[0]])))
    return found


def growth_exponents(points: Array, values: Array, settings: TailSettings = TAIL_SETTINGS) -> Array:
    """Return the largest lower end of an exponent κ for each column of values (N, C), or 0, (C,).

    At most `tested` points (N, d) are used.
    """
    few = slice(settings.tested)
    found = [border_growth(points[few], column, settings) for column in values[few].T]
    return np.array([max((each.low for each in growths), default=0.0) for growths in found])


def growing_interval(
    estimates: Array, growths: Sequence[BorderGrowth], settings: TailSettings = TAIL_SETTINGS
) -> tuple[float, float]:
    """Return a 95 % interval of the mean of stratified estimates (R,) if f grows at a border.

    The interval is `mean_interval`, but it extends farther on the side toward which f grows.
    The end on the side of the growth is computed from a quantile of Student's t.
    This quantile is simulated for samples of numbers u^−κ, where u is uniform in [0, 1].
    If the exponent is close to ½ or above, the interval is infinite.
    """
    low, high = mean_interval(estimates)
    mean = float(estimates.mean())
    error = float(estimates.std(ddof=1)) / math.sqrt(len(estimates))
    for growth in growths:
        if growth.endless(settings):
            return -math.inf, math.inf
        exponent = math.ceil(50.0 * min(growth.exponent, settings.largest)) / 50.0
        away = _growing_quantile(exponent, len(estimates), settings) * error
        low, high = (
            (low, max(high, mean + away)) if growth.sign > 0 else (min(low, mean - away), high)
        )
    return low, high


@lru_cache(maxsize=256)
def _growing_quantile(exponent: float, count: int, settings: TailSettings) -> float:
    """Return a quantile of Student's t for the mean of `count` numbers u^−κ, with reversed sign.

    The result q is a number of standard errors.
    The mean is too low by more than q standard errors with probability `settings.beyond`.
    """
    rng = np.random.default_rng((count, round(1000.0 * (exponent + 1.0))))
    u = rng.random((max(1000, min(settings.samples, 10_000_000 // count)), count))
    x = -np.log(u) if exponent == 0.0 else (u**-exponent - 1.0) / exponent
    t = (x.mean(axis=1) - 1.0 / (1.0 - exponent)) / x.std(axis=1, ddof=1) * math.sqrt(count)
    return -float(np.quantile(t, settings.beyond))


def tied_error(values: Array) -> float:
    """Return a bound for the error of the mean if all R estimates are equal, from all values of f.

    A function with jumps and few values, such as an indicator, may have equal estimates by chance.
    Let a point cross the i-th jump with probability p_i in one set of n points.
    The probability that no point of R sets crosses a jump is (1 − Σp_i)^R.
    If all estimates are equal, Σp_i < ln(20)/R therefore holds with 95 % confidence.
    A point that crosses a jump changes an estimate by at most (max f − min f)/n.
    The result is therefore ln(20) (max f − min f)/(R n), where R n is the number of all values.
    If most values of f differ, equal estimates do not occur by chance, so they are exact.
    The result for exact estimates is 0.

    Parameters
    ----------
    values
        Values of f, (R, n).
    """
    if 2 * np.unique(values).size > values.size:
        return 0.0
    return math.log(20.0) * float(np.ptp(values)) / values.size


def few_note(values: Array, settings: TailSettings = TAIL_SETTINGS) -> str | None:
    """Return a sentence if few of the values (N,) cause half of their variance."""
    squares = (values - values.mean()) ** 2
    if len(values) < settings.least * settings.part:  # Too few values to judge a tail
        return None
    largest = np.partition(squares, 1 - settings.few)[1 - settings.few :]
    if not 2.0 * largest.sum() > squares.sum() > 0.0:
        return None
    held = int(np.searchsorted(np.sort(largest)[::-1].cumsum(), 0.5 * squares.sum())) + 1
    return (
        f"{held} of {len(values)} evaluations {'holds' if held == 1 else 'hold'} half of the "
        "variance: most sets miss the important region, so the error has no upper bound; give a "
        "density that concentrates there, or far more points"
    )


def growth_note(
    growths: Sequence[BorderGrowth], settings: TailSettings = TAIL_SETTINGS
) -> str | None:
    """Return a warning if f grows so fast that its variance or its integral is infinite."""
    endless = [growth for growth in growths if growth.endless(settings)]
    if not endless:
        return None
    most = max(endless, key=lambda growth: growth.exponent)
    said = (
        f"f grows about as t^−{most.exponent:.2f} with the distance t to x_{most.axis} = "
        f"{int(most.high)}, down to t = {most.nearest:.1g}"
    )
    if most.without_integral(settings):
        return f"{said}: if that continues, f has no integral (κ ≥ 1)"
    if most.low >= settings.no_variance:
        return (
            f"{said}: if that continues, the variance is infinite (κ ≥ ½) and no interval holds; "
            "use a density that grows there"
        )
    return f"{said}: the variance would be infinite for κ ≥ ½, so the error has no upper bound"


def doubt(
    points: Array | None, values: Array, settings: TailSettings = TAIL_SETTINGS
) -> tuple[str, bool] | None:
    """Return why values (N, channels) at points (N, d) give no upper bound of their variance.

    Returns
    -------
    tuple or None
        A sentence on the tail, and whether the variance is completely unknown.
        It is unknown if the variance may be infinite, or may come from a region without points.
        The result is None if the values bound the variance.
        If no points are given, growth at the border is not tested.
    """
    for each in values.T:
        if not np.ptp(each):
            return (
                f"f is {each[0]:.6g} at all {len(each)} points: either it is constant, or it "
                f"differs only in a region smaller than about {3 / len(each):.1g} of the volume, "
                "which no point hit"
            ), True
        growths = [] if points is None else border_growth(points, each, settings)
        if said := growth_note(growths, settings) or few_note(each, settings):
            return said, True
        steep = [growth for growth in growths if growth.exponent >= settings.infinite_error]
        if steep:
            most = max(steep, key=lambda growth: growth.exponent)
            return (
                f"f grows about as t^−{most.exponent:.2f} with the distance t to x_{most.axis} = "
                f"{int(most.high)}: for κ ≥ ¼ the error of a measured variance has no bound"
            ), False
        if not Moments.of(each, tails=True).resolved:
            return (
                f"a few of {len(each)} evaluations cause most of the variance, which may be far "
                "larger; give a density that concentrates there, or a larger max_evaluations"
            ), False
    return None


def unsampled_share(estimator: AbstractEstimator, samples: int) -> float:
    """Return the share of ∫f²/p in the region of smallest p, where less than one sample falls.

    Parameters
    ----------
    estimator
        The estimator. If it has no density p, no region counts as unsampled, and the result is 0.
    samples
        Number N of samples in all realizations together.
        Under the density, the region of smallest p has the probability 1/N.

    Notes
    -----
    The share of ∫f²/p is a mean over points of an additive recurrence.
    The number of points is the number of samples, but at least 4096 and at most 65,536.
    For N ≥ 4096, computing the share therefore costs no more than a simulation with N samples.
    A region without any of these points counts as empty.
    Therefore, in many dims the returned share is more likely too small than too large.
    With several channels, the largest share of any channel is returned.
    """
    if not isinstance(estimator, Estimator) or estimator.density is None:
        return 0.0
    count = int(np.clip(samples, _LEAST, _POINTS))
    x = probe_points(estimator.integrand.dims, count)
    p = estimator.density.pdf(x)
    order = np.argsort(p)
    unsampled = int(np.searchsorted(np.cumsum(p[order]) / count, 1.0 / samples))
    values = np.asarray(estimator.integrand(x[order])).reshape(count, -1)

    # Divide f²/p by its largest value in each channel. Use logarithms, as p may be 1e-300
    with np.errstate(divide="ignore"):
        floor = np.maximum(p[order, None], np.finfo(float).tiny)
        logarithms = 2 * np.log(np.abs(values)) - np.log(floor)
    largest = logarithms.max(axis=0)
    squares = np.exp(logarithms - np.where(np.isfinite(largest), largest, 0.0))
    totals = squares.sum(axis=0)
    shares = squares[:unsampled].sum(axis=0) / np.where(totals > 0, totals, 1.0)
    return float(shares.max())


def unsampled_note(estimator: AbstractEstimator, samples: int) -> str | None:
    """Return a sentence if regions where no sample is expected hold at least a tenth of ∫f²/p.

    A black box is not called: the result is None.
    """
    share = 0.0 if estimator.is_black_box else unsampled_share(estimator, samples)
    if share < _LARGE:
        return None
    return (
        f"{100 * share:.3g} % of ∫f²/p lies where less than one of the {samples} samples is "
        "expected: the true variance may be far above the measured one and its interval; choose a "
        "density with heavier tails, such as defensive(density=…)"
    )


def tail_note(moments: Moments) -> str | None:
    """Return a sentence about tails if the estimates of some channel do not resolve their tails."""
    unresolved = ~np.atleast_1d(moments.resolved)
    if not unresolved.any():
        return None
    index = np.atleast_1d(moments.tail_index)[unresolved]
    found = "" if np.isnan(index).all() else f", tail index k̂ = {np.nanmax(index):.2f}"
    return (
        f"tails not resolved (one or a few of {moments.count} estimates cause most of the "
        f"variance{found}): the variance may be far above the measured one and has no upper bound; "
        "use more points or a density with heavier tails; more realizations only reveal it"
    )
