"""The share of ∫f²/p where no sample will fall: a measured variance misses it.

∫1/p and the variance may be finite and yet far larger than any simulation can measure: with f = 1 and
p normal about ½ with σ = 0.02, ∫f²/p is 4e131, and 99.8 % of it come from x within 0.005 of the
ends, where one sample in 3e134 falls.

Where f grows without bound toward a face of the cube, the outermost stratum makes most of the
variance of stratified points. With f ∝ t^−κ at the distance t, the error of a set is that of the
variable u^−κ, u uniform, whatever the scale. Student's t for few such errors is skewed, and its
quantiles depend on κ and on the number of sets alone: `growing_interval` takes them from samples.
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
    "growth_note",
    "tail_note",
    "unsampled_note",
    "unsampled_share",
]

_LEAST, _POINTS = 2**12, 2**16
_LARGE = 0.1  # of the second moment; what a note is worth


@final
@dataclass(frozen=True)
class TailSettings:
    """How growth at the border is found in the values at points, and what it means."""

    # Points closest to a face whose values are fitted, and the largest part of all points that
    # they may be: 1/16 of the cube is a neighborhood of a face.
    most: int = 64
    part: int = 16
    # Least number of these points: a fit has three parameters.
    least: int = 16
    # Exponents κ that are tried, from a smooth function (−1) to beyond a pole of order 1.
    exponents: tuple[float, float, int] = (-1.0, 1.3, 116)
    # Exponent above which errors of strata are skewed: bounded smooth functions have −1 and
    # square roots −½. A logarithm has 0.
    skewed: float = -0.25
    # Standard errors by which the slope must differ from 0, for up to 100 faces.
    sure: float = 4.0
    # Quantile of all values that the median of the values closest to a face exceeds. These are the
    # closest 1/64 of all or fewer.
    outermost: float = 0.95
    # Exponents from which on f has no variance, and no integral. The limits are ½ and 1; the
    # difference is the error of a fit of 64 points.
    no_variance: float = 0.48
    no_integral: float = 0.95
    # Least exponent at which f⁴ has no integral, so that the error of a measured variance is not
    # known: ¼.
    infinite_error: float = 0.25
    # Largest exponent whose quantiles are computed: above it the interval has no end, if the lower
    # end of the exponent's own interval is above the second value. Of 2,700 integrals of
    # exp(x + y) five had an exponent above the first by chance.
    largest: float = 0.46
    surely: float = 0.25
    # Probability that the integral is beyond the end on the side of the growth. It is hardly ever
    # beyond the other one, which Student's t gives.
    beyond: float = 0.04
    # Number of values that may hold half of the variance at points: with fewer, most sets miss what
    # matters. Of 8,192 points 700 or more hold it for smooth functions, 60 for x^−0.3, 45 for a
    # peak of 1 % of the square, and one for three narrow peaks in 8 dims.
    few: int = 4
    # Samples that give the quantiles of Student's t: those of 4 % have errors of 1 %.
    samples: int = 40_000


TAIL_SETTINGS = TailSettings()
"""Settings of growth at the border, unless others are passed."""


@final
@dataclass(frozen=True)
class BorderGrowth:
    """Growth of f toward a face of the cube, about as t^−κ with the distance t.

    Attributes
    ----------
    axis, high
        The face: x_axis = 0, or 1 if `high`.
    exponent, low
        κ, which is 0 for a logarithm, and the lower end of its 95 % interval.
    sign
        1 if f grows to +∞, −1 if to −∞.
    nearest
        Smallest distance of a point.
    """

    axis: int
    high: bool
    exponent: float
    low: float
    sign: int
    nearest: float

    def endless(self, settings: TailSettings = TAIL_SETTINGS) -> bool:
        """Whether the variance may be infinite."""
        return self.exponent > settings.largest and self.low > settings.surely

    def without_integral(self, settings: TailSettings = TAIL_SETTINGS) -> bool:
        """Whether the integral does not exist if the growth goes on."""
        return self.low >= settings.no_integral


def border_growth(
    points: Array, values: Array, settings: TailSettings = TAIL_SETTINGS
) -> list[BorderGrowth]:
    """Faces toward which f grows, from its values (N,) at points (N, d).

    c + b (t^−κ − 1)/κ is fitted to the values that are closest to each face, with errors
    proportional to the distance of a value from the median.
    """
    count = min(settings.most, len(values) // settings.part)
    if count < settings.least:
        return []
    exponents = np.linspace(*settings.exponents)[:, None]
    zero = exponents == 0.0
    centre = float(np.median(values))

    def fitted(logs: Array, y: Array) -> tuple[float, float, float, float]:
        """Weighted least squares: exponent, its lower end, slope, and the slope's standard error."""
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
        # A single value, which is large by chance, does not make growth
        fits = [fitted(logs, y), fitted(logs[1:], y[1:])]
        exponent, low = (min(fit[k] for fit in fits) for k in (0, 1))
        sign = 1 if fits[0][2] > 0.0 else -1
        # Growth leads away from the median, to values that are rare elsewhere
        usual = np.quantile(sign * (values - centre), settings.outermost)
        grows = np.median(sign * (y[: count // 4] - centre)) > usual
        grows &= all(sign * slope > settings.sure * error for _, _, slope, error in fits)
        if grows and low > settings.skewed:
            found.append(BorderGrowth(axis, high, exponent, low, sign, float(t[closest[0]])))
    return found


def growing_interval(
    estimates: Array, growths: Sequence[BorderGrowth], settings: TailSettings = TAIL_SETTINGS
) -> tuple[float, float]:
    """95 % interval of the mean of estimates (R,) by strata of a function that grows at the border.

    `mean_interval`, and on the side of the growth at least the quantile of Student's t for errors
    u^−κ; infinite for exponents close to ½ and above.
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
    """Number of standard errors by which the mean of `count` values u^−κ is too small at most."""
    rng = np.random.default_rng((count, round(1000.0 * (exponent + 1.0))))
    u = rng.random((max(1000, min(settings.samples, 10_000_000 // count)), count))
    x = -np.log(u) if exponent == 0.0 else (u**-exponent - 1.0) / exponent
    t = (x.mean(axis=1) - 1.0 / (1.0 - exponent)) / x.std(axis=1, ddof=1) * math.sqrt(count)
    return -float(np.quantile(t, settings.beyond))


def few_note(values: Array, settings: TailSettings = TAIL_SETTINGS) -> str | None:
    """Return a sentence if half of the variance of values (N,) comes from a few of them."""
    squares = (values - values.mean()) ** 2
    if len(values) < settings.least * settings.part:  # so few values show no tail
        return None
    largest = np.partition(squares, 1 - settings.few)[1 - settings.few :]
    if not 2.0 * largest.sum() > squares.sum() > 0.0:
        return None
    held = int(np.searchsorted(np.sort(largest)[::-1].cumsum(), 0.5 * squares.sum())) + 1
    return (
        f"{held} of {len(values)} evaluations {'holds' if held == 1 else 'hold'} half of the variance: "
        "most sets miss what matters, so that the error has no upper bound; give a density that "
        "finds it, or far more points"
    )


def growth_note(
    growths: Sequence[BorderGrowth], settings: TailSettings = TAIL_SETTINGS
) -> str | None:
    """Return a sentence if the growth of f leaves it without a variance, or without an integral."""
    endless = [growth for growth in growths if growth.endless(settings)]
    if not endless:
        return None
    most = max(endless, key=lambda growth: growth.exponent)
    said = (
        f"f grows about as t^−{most.exponent:.2f} with the distance t to x_{most.axis} = "
        f"{int(most.high)}, down to t = {most.nearest:.1g}"
    )
    if most.without_integral(settings):
        return f"{said}: it has no integral if that goes on (from 1 on)"
    if most.low >= settings.no_variance:
        return (
            f"{said}: its variance is infinite if that goes on (from ½ on), so that no interval holds; "
            "use a density that grows there"
        )
    return f"{said}: from ½ on its variance is infinite, so that the error has no upper bound"


def doubt(
    points: Array | None, values: Array, settings: TailSettings = TAIL_SETTINGS
) -> tuple[str, bool] | None:
    """Return why values (N, channels) at points (N, d) do not bound their variance from above.

    Returns
    -------
    tuple or None
        A sentence, and whether the values say nothing about the variance at all: it may be infinite,
        or lie where there is no point. None if they bound it. Without points growth is not looked for.
    """
    for each in values.T:
        if not np.ptp(each):
            return (
                f"f is {each[0]:.6g} at all {len(each)} points: either it is constant, or what varies, "
                f"in less than about {3 / len(each):.1g} of the volume, was not met"
            ), True
        growths = [] if points is None else border_growth(points, each, settings)
        if said := growth_note(growths, settings) or few_note(each, settings):
            return said, True
        steep = [growth for growth in growths if growth.exponent >= settings.infinite_error]
        if steep:
            most = max(steep, key=lambda growth: growth.exponent)
            return (
                f"f grows about as t^−{most.exponent:.2f} with the distance t to x_{most.axis} = "
                f"{int(most.high)}: from ¼ on the error of a measured variance has no bound"
            ), False
        if not Moments.of(each, tails=True).resolved:
            return (
                f"a few of {len(each)} evaluations make the variance, which may be far larger; give a "
                "density that finds them, or a larger max_evaluations"
            ), False
    return None


def unsampled_share(estimator: AbstractEstimator, samples: int) -> float:
    """Return the share of ∫f²/p over the region of smallest p that holds less than one sample.

    Parameters
    ----------
    estimator
        The share is 0 for anything but an `Estimator` with a density.
    samples
        Number N of all samples, over all realizations: the region has the mass 1/N.

    Notes
    -----
    Means over points of an additive recurrence, as many as samples but 4096 to 65 536, so that this
    costs no more than the simulation: a region that holds none of them counts as
    empty, so in many dims the share is too small rather than too large. With several channels the
    largest share is returned.
    """
    if not isinstance(estimator, Estimator) or estimator.density is None:
        return 0.0
    count = int(np.clip(samples, _LEAST, _POINTS))
    x = probe_points(estimator.integrand.dims, count)
    p = estimator.density.pdf(x)
    order = np.argsort(p)
    unsampled = int(np.searchsorted(np.cumsum(p[order]) / count, 1.0 / samples))
    values = np.asarray(estimator.integrand(x[order])).reshape(count, -1)

    # f²/p relative to the largest of its channel, by logarithms: p may be 1e-300
    with np.errstate(divide="ignore"):
        floor = np.maximum(p[order, None], np.finfo(float).tiny)
        logarithms = 2 * np.log(np.abs(values)) - np.log(floor)
    largest = logarithms.max(axis=0)
    squares = np.exp(logarithms - np.where(np.isfinite(largest), largest, 0.0))
    totals = squares.sum(axis=0)
    shares = squares[:unsampled].sum(axis=0) / np.where(totals > 0, totals, 1.0)
    return float(shares.max())


def unsampled_note(estimator: AbstractEstimator, samples: int) -> str | None:
    """Return a sentence if a tenth or more of ∫f²/p lies where no sample is expected.

    A black box is not called for it: None.
    """
    share = 0.0 if estimator.is_black_box else unsampled_share(estimator, samples)
    if share < _LARGE:
        return None
    return (
        f"{100 * share:.3g} % of ∫f²/p lies where less than one of the {samples} samples is expected: "
        "the true variance may be far above the measured one and its interval; choose a density "
        "with heavier tails, such as defensive(density=…)"
    )


def tail_note(moments: Moments) -> str | None:
    """Return a sentence if the tails of the estimates are not resolved: of the channel that is worst."""
    unresolved = ~np.atleast_1d(moments.resolved)
    if not unresolved.any():
        return None
    index = np.atleast_1d(moments.tail_index)[unresolved]
    found = "" if np.isnan(index).all() else f", tail index k̂ = {np.nanmax(index):.2f}"
    return (
        f"tails not resolved (one or a few of {moments.count} estimates make the variance{found}): it "
        "may be far above the measured one and has no upper bound; more points or a density with "
        "heavier tails help, more realizations show it"
    )
