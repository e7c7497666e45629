"""Variances of several samplers at all counts, from one array of evaluations.

The integrand is evaluated once at R scrambled nets of N points.
Runs of 2^k successive points that start at multiples of 2^k are scrambled nets themselves.
Therefore a mean over one of these runs has the same variance as a net of 2^k points.
Different nets have independent points in each stratum.
The variance within strata, estimated from pairs of nets, gives the variance of jittered points.
The variance within slabs across an axis gives the variance of Latin hypercubes.
The variance of g over the whole cube gives the variance of random points.
Products of values from the same net are omitted, because these values are correlated.

Standard errors come from a jackknife over nets, which includes correlations between all n.
A rate is fitted to each curve and is assumed to be constant over the last octaves of n.
In earlier octaves, the rate is assumed to change by a random walk.
Fits with several step sizes of the random walk are averaged, weighted by their likelihood.
If the curve is straight, all counts contribute to its rate.
If the curve is bent, its rate depends on the last counts only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import rounding_floor
from mcspectra.core.images import REC709
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator
from mcspectra.estimators.tails import border_growth, growing_interval, tied_error
from mcspectra.samplers import as_sampler

__all__ = [
    "CURVE_SETTINGS",
    "NETS",
    "Curve",
    "CurveSettings",
    "Sets",
    "curve_of",
    "scalar",
]

NETS = "sobol | owen"
"""The scrambled nets at which the estimator is evaluated."""


@final
@dataclass(frozen=True)
class CurveSettings:
    """Settings of curves of variance from nets, and of fits of rates to these curves.

    "The same results" means that the right cause of noise is found in all test cases.
    The cases are those of ``python -m benchmarks settings``, as in `CauseSettings`.
    Numbers for rates come from ``python -m benchmarks settings --rates``.
    This benchmark repeats each of five functions with known rates 50 times.
    """

    # Number of slabs along each axis that stand for the strata of a Latin hypercube.
    # Values from 16 to 64 give the same results.
    # A Latin hypercube of n > 32 points has finer strata than 32 slabs.
    # The variance that is estimated from 32 slabs is therefore an upper bound.
    # For sums of functions of one axis, the upper bound is (n/32)² times the true variance.
    slabs: int = 32
    # Largest number of dims in which the variance of jittered points is estimated.
    # Values from 2 to 6 give the same results.
    # 8,192 evaluations allow nets of at most 256 points, which have 4 cells along each of 4 axes.
    # In 4 dims, the variance of jittered points is therefore known at only three values of n.
    jittered_dims: int = 3
    # Number of octaves at the end of a curve over which the rate is assumed to be constant.
    # With 2 octaves, intervals of rates are 1.4 times as wide and contain the rate equally often.
    # With 6 octaves, intervals contain the true rate in 63 % instead of 93 % of cases.
    octaves: int = 3
    # Fits assume that the rate changes at random from one octave to the next.
    # The standard deviation of this change is not known, so each of these values is tried.
    # The standard deviation 0.05 suits curves that are nearly straight on logarithmic axes.
    # The standard deviation 0.4 suits bent curves: their rates change by 1 to 3 in a few octaves.
    # If all values of `drifts` are halved, intervals contain the true rate in 94 % of cases.
    # If all values of `drifts` are doubled, intervals contain the true rate in 92 % of cases.
    # If 0.2 is the only value of `drifts`, the result is also 92 %.
    drifts: tuple[float, ...] = (0.05, 0.1, 0.2, 0.4)
    # If a rate is not known, the rate −1 is assumed, with this standard error.
    # Every rate from −2 to 0 is at most two standard errors away from the assumed rate −1.
    unknown: float = 0.5
    # Least standard error of a logarithm of the variance.
    # Measured curves of variance deviate from straight lines by 2 % or more.
    # With the value 0.01 or 0.04, rates change by at most 0.01.
    floor: float = 0.02
    # A measured rate agrees with a theoretical rate if it is within this number of standard errors.
    # Two standard errors correspond to a confidence of 95 % for normal errors.
    agrees: float = 2.0


CURVE_SETTINGS = CurveSettings()
"""Default settings of curves of variance."""


@final
@dataclass(frozen=True)
class Curve:
    """Variance as a function of the number of points.

    Attributes
    ----------
    counts, variance, relative_se
        Arrays (N,). The standard error belongs to the logarithm of the variance.
    rate, rate_se
        Slope of the logarithmic curve over the last octaves, and its standard error.
        Slope and error are NaN if there is no fit, for example because the variance is zero.
    degrees
        Degrees of freedom of the standard errors.
    drift
        Standard deviation of the changes of the slope from octave to octave, as estimated.
        The slope is assumed to change in the same way beyond the largest measured count.
    vanishes
        Smallest count at which all sets gave equal estimates.
    level, scatter
        `level` is log(fitted variance / measured variance) at the last count.
        `scatter` is the standard deviation of log variances about the fitted line.
        Curves that are not straight lines are extrapolated with `level` and `scatter`.
    bend
        Expected change of the slope beyond the measured counts, with an error of the same size.
    noise
        Variance that rounding alone may cause. Extrapolated variances are not smaller.
    """

    counts: Array
    variance: Array
    relative_se: Array
    rate: float
    rate_se: float
    degrees: int
    drift: float = 0.0
    vanishes: float = math.inf
    level: float = 0.0
    scatter: float = 0.0
    bend: float = 0.0
    noise: float = 0.0

    def at(self, n: float) -> tuple[float, float]:
        """Return the variance at n points, and the standard error of its logarithm.

        Beyond the measured counts, the variance is extrapolated with the rate.
        """
        if n >= self.vanishes or not len(self.counts):
            return 0.0, 0.0
        if n <= self.counts[-1]:
            x, y = np.log(self.counts), np.log(self.variance)
            return (
                math.exp(float(np.interp(math.log(n), x, y))),
                float(np.interp(math.log(n), x, self.relative_se)),
            )
        known = math.isfinite(self.rate)
        slope, error = (self.rate, self.rate_se) if known else (-1.0, CURVE_SETTINGS.unknown)
        slope, error = slope + self.bend, math.hypot(error, self.bend)
        away = math.log(n / self.counts[-1])
        value = float(self.variance[-1]) * math.exp(self.level + slope * away)
        walk = self.drift * math.sqrt(away**3 / (3.0 * math.log(2.0)))
        error = math.hypot(float(self.relative_se[-1]), away * error, walk, self.scatter)
        if 0.0 < value < self.noise:
            # The variance lies between the extrapolated value and the limit of rounding
            return self.noise, max(error, math.log(self.noise / value))
        return value, error

    def towards(self, rate: float, error: float) -> Curve:
        """Return the weighted mean of the measured and a theoretical rate if these rates agree."""
        if not abs(self.rate - rate) <= CURVE_SETTINGS.agrees * math.hypot(self.rate_se, error):
            return self
        share = error**2 / (error**2 + self.rate_se**2)
        mean = share * self.rate + (1.0 - share) * rate
        return replace(
            self,
            rate=mean,
            rate_se=math.sqrt(share) * self.rate_se,
            drift=math.sqrt(share) * self.drift,
        )

    def leveled(self) -> Curve:
        """Return the curve with the level and the scatter of its points about a straight line.

        If an edge of g happens to lie at a border of strata, the variance at one count is far
        below the line through the other counts. Extrapolated from this count alone, the variance
        would be far too small.
        """
        if not math.isfinite(self.rate):
            return self
        last = self.counts >= self.counts[-1] / 2.0**CURVE_SETTINGS.octaves
        n, variance = self.counts[last], self.variance[last]
        off = np.log(variance / variance[-1]) - self.rate * np.log(n / n[-1])
        if len(off) < 3:
            return self
        return replace(self, level=float(off.mean()), scatter=float(off.std(ddof=1)))

    @property
    def rate_ci(self) -> tuple[float, float]:
        """95 % interval of the rate, by Student's t."""
        from scipy.special import stdtrit

        half = float(stdtrit(max(self.degrees, 1), 0.975)) * self.rate_se
        return self.rate - half, self.rate + half


@final
@dataclass(frozen=True)
class _Part:
    """Values of one technique at R nets: points (R, N·c, d) and values (R, N·c)."""

    points: Array
    values: Array

    def between(self, cell: Array, cells: int) -> Array:
        """Average g(x) g(y) over pairs of points x, y of different nets that share a cell."""
        r = len(self.values)
        place = (np.arange(r)[:, None] * cells + cell).ravel()
        sums = np.bincount(place, self.values.ravel(), r * cells).reshape(r, cells)
        numbers = np.bincount(place, minlength=r * cells).reshape(r, cells)
        pairs = _sums(numbers) ** 2 - _sums(numbers**2)
        products = _sums(sums) ** 2 - _sums(sums**2)
        return np.asarray(np.mean(products / np.maximum(pairs, 1), axis=1, where=pairs > 0))


# The estimate from all R nets, followed by R estimates that leave out one net each: (1 + R,)
_Estimate = Callable[[_Part, int], Array]


def _sums(x: Array) -> Array:
    """Return the sum over all R nets, and R sums that leave out one net each: (1 + R, …)."""
    whole = x.sum(axis=0)
    return np.concatenate([whole[None], whole - x])


def _means(x: Array) -> Array:
    """Return the mean over all R nets, and R means that leave out one net each: (1 + R,)."""
    return np.asarray(_sums(x) / _sums(np.ones(len(x))))


@final
@dataclass(frozen=True)
class Sets:
    """Values of an estimator at R scrambled nets, from which variances of samplers follow.

    Attributes
    ----------
    points, values
        Points and values of each technique t: (R, N·c_t, d) and (R, N·c_t), with N a power of two.
    counts
        Number c_t of points of technique t for each point of a net.
    """

    points: Sequence[Array]
    values: Sequence[Array]
    counts: tuple[int, ...]

    @staticmethod
    def of(estimator: AbstractEstimator, n: int, nets: int, stream: Stream) -> Sets:
        """Evaluate an estimator at scrambled nets of n points."""
        source = estimator.randomized(as_sampler(NETS, estimator.dims))
        points = estimator.draw(source, n, stream, 0, nets)
        return Sets(
            [np.asarray(p) for p in points],
            [scalar(estimator, estimator.primary_values(t, u)) for t, u in enumerate(points)],
            estimator.counts,
        )

    @property
    def dims(self) -> int:
        """Number d of dims."""
        return int(self.points[0].shape[2])

    @property
    def n(self) -> int:
        """Number N of points of each net."""
        return int(self.values[0].shape[1]) // self.counts[0]

    @cached_property
    def estimates(self) -> Array:
        """Estimates of the nets, (R,)."""
        return np.asarray(sum(v.mean(axis=1) for v in self.values))

    @cached_property
    def pooled(self) -> Array:
        """Values of g at the points of all nets, for the technique whose g varies most."""
        return np.asarray(max(self.values, key=lambda v: float(v.var()))).ravel()

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mean over all nets, widened if |g| grows toward the border."""
        growths = []
        if len(self.values) == 1:
            growths = border_growth(self.points[0].reshape(-1, self.dims), self.values[0].ravel())
        low, high = growing_interval(self.estimates, growths)
        if self.estimates.var(ddof=1) <= rounding_floor(self.estimates.mean()):
            error = sum(tied_error(values) for values in self.values)
            low, high = low - error, high + error
        return low, high

    def curves(
        self, settings: CurveSettings = CURVE_SETTINGS, names: Collection[str] | None = None
    ) -> dict[str, Curve]:
        """Return curves of variance for the samplers in `names`, or for all possible samplers."""
        counts = 2 ** np.arange(self.n.bit_length())
        found = {
            NETS: self._curve(_of_strata if self.dims == 1 else _of_nets, counts, settings),
            "random": self._curve(lambda part, n: _of_nets(part, 1) / n, counts, settings, -1.0),
        }
        if set(self.counts) == {1} and 1 < self.dims <= settings.jittered_dims:
            sides = 2 ** np.arange((self.n.bit_length() - 1) // self.dims + 1)
            found["jittered"] = self._curve(_of_strata, sides**self.dims, settings)
        slabs = names is None or "latin-hypercube" in names
        if slabs and self.dims > 1 and self.n >= settings.slabs:
            of_slabs = partial(_of_slabs, slabs=settings.slabs)
            many = counts[counts >= settings.slabs]
            found["latin-hypercube"] = self._curve(of_slabs, many, settings, -1.0)
        # Variances within strata or slabs are differences of estimates, and may lack significance.
        # Omit curves without any significant value
        if len(found["random"].counts):
            found = {name: curve for name, curve in found.items() if len(curve.counts)}
        return found

    def technique_curves(self, settings: CurveSettings = CURVE_SETTINGS) -> list[Curve]:
        """Return the variance of each technique with scrambled nets of all sizes."""
        counts = 2 ** np.arange(self.n.bit_length())
        parts = zip(self.points, self.values, self.counts, strict=True)
        return [Sets((p,), (v,), (c,))._curve(_of_nets, counts, settings) for p, v, c in parts]

    def _curve(
        self,
        estimate: _Estimate,
        counts: Array,
        settings: CurveSettings,
        rate: float | None = None,
    ) -> Curve:
        """Return the curve of the variances that `estimate` gives, with errors from a jackknife."""
        parts = [_Part(p, v - v.mean()) for p, v in zip(self.points, self.values, strict=True)]

        found = np.stack([
            np.sum([
                estimate(p, int(n) * c) for p, c in zip(parts, self.counts, strict=True)
            ], axis=0)
            for n in counts
        ], axis=1)  # fmt: skip
        size = float(self.estimates.mean())
        return _fitted(
            counts, found[0], found[1:], size, rate, settings, exact=estimate is _of_nets
        )


def scalar(estimator: AbstractEstimator, values: Array) -> Array:
    """Return one value per point: the luminance of three channels, otherwise their mean."""
    if not estimator.channels:
        return np.asarray(values, float)
    weights = (
        REC709
        if estimator.channels == len(REC709)
        else np.full(estimator.channels, 1.0 / estimator.channels)
    )
    return np.asarray(values @ weights)


def curve_of(
    counts: Sequence[int], estimates: Sequence[Array], settings: CurveSettings = CURVE_SETTINGS
) -> Curve:
    """Return the variances of independent estimates as a curve: R estimates for each count."""
    found = np.array([e.var(ddof=1) for e in estimates])
    left = np.stack([
        [np.delete(e, r).var(ddof=1) for e in estimates] for r in range(len(estimates[0]))
    ])  # fmt: skip
    return _fitted(
        np.array(counts), found, left, float(estimates[-1].mean()), None, settings, exact=True
    )


def _fitted(
    counts: Array,
    found: Array,
    left: Array,
    size: float,
    rate: float | None,
    settings: CurveSettings,
    *,
    exact: bool,
) -> Curve:
    """Return the curve of variances `found`, (N,), with errors from a jackknife.

    `left` contains variances from all realizations but one, for each realization: (R, N).
    If `rate` is None, the rate is fitted.
    If `exact` is true, a variance of zero means that the true variance is zero.
    If `exact` is false, each variance is a difference of two estimates.
    If the difference is zero, the true variance is smaller than the error of the difference.
    """
    degrees = len(left) - 1
    floor = rounding_floor(np.array(size))
    used = found > floor
    # Pairwise sums have a rounding error of about one ulp. Measured differences need more
    noise = float(np.finfo(float).eps * abs(size)) ** 2
    gone = counts[np.maximum.accumulate(used[::-1])[::-1].sum() :]
    vanishes = float(gone[0]) if exact and len(gone) else math.inf
    counts, found, left = counts[used], found[used], left[:, used]
    if not len(counts):
        return Curve(
            counts, found, found, math.nan, math.nan, degrees, vanishes=vanishes, noise=noise
        )
    pseudo = np.log(np.maximum(left, np.maximum(floor, np.finfo(float).tiny))) - np.log(found)
    covariance = degrees * np.cov(pseudo.T, ddof=0).reshape(len(counts), -1)
    error = np.sqrt(np.diag(covariance))
    if rate is not None:
        return Curve(counts, found, error, rate, 0.0, degrees, vanishes=vanishes, noise=noise)
    if len(counts) < 2 or math.isfinite(vanishes):
        return Curve(
            counts, found, error, math.nan, math.nan, degrees, vanishes=vanishes, noise=noise
        )
    x, y = np.log(counts / counts[-1]), np.log(found)
    line, octave = np.stack([np.ones_like(x), x], axis=1), math.log(2.0)
    turns = octave * np.arange(settings.octaves, max(round(-x[0] / octave), settings.octaves))
    bends = np.maximum(-x[:, None] - turns, 0.0)
    fits = np.empty((3, len(settings.drifts)))
    for k, drift in enumerate(settings.drifts):
        bent = drift**2 * bends @ bends.T
        inverse = np.linalg.inv(np.diag(error**2 + settings.floor**2) + bent)
        square = np.linalg.inv(line.T @ inverse @ line)
        weights = square @ line.T @ inverse
        rest = y - line @ weights @ y
        sizes = np.linalg.slogdet(inverse)[1] + np.linalg.slogdet(square)[1]
        spread = max(weights[1] @ (covariance + bent) @ weights[1], square[1, 1])
        fits[:, k] = 0.5 * (sizes - rest @ inverse @ rest), weights[1] @ y, spread
    share = np.exp(fits[0] - fits[0].max())
    share /= share.sum()
    slope = float(share @ fits[1])
    spread = float(share @ (fits[2] + (fits[1] - slope) ** 2))
    drift = math.sqrt(share @ np.square(settings.drifts))
    return Curve(
        counts, found, error, slope, math.sqrt(spread), degrees, drift, vanishes, noise=noise
    )


def _of_nets(part: _Part, n: int) -> Array:
    """Return the variance of means over n points of a scrambled net."""
    r = len(part.values)
    squares = (part.values.reshape(r, -1, n).mean(axis=2) ** 2).mean(axis=1)
    own = part.values.mean(axis=1)
    mean = _means(own)
    # Correct the square of a mean, which is too large by the variance of that mean
    return np.asarray(
        _means(squares) - mean**2 + (_means(own**2) - mean**2) / (_sums(np.ones(r)) - 1.0)
    )


def _of_strata(part: _Part, n: int) -> Array:
    """Return the variance of means over n jittered points."""
    side = round(n ** (1.0 / part.points.shape[2]))
    index = np.floor(part.points * side).astype(np.int64)
    cell = index @ side ** np.arange(part.points.shape[2])
    rest = _means((part.values**2).mean(axis=1)) - part.between(cell, n)
    return np.asarray(np.maximum(rest, 0.0) / n)


def _of_slabs(part: _Part, n: int, slabs: int) -> Array:
    """Return the variance of means over n points of a Latin hypercube, estimated from slabs."""
    whole = _of_nets(part, 1)
    mean = part.between(np.zeros(part.values.shape, np.int64), 1)
    for axis in range(part.points.shape[2]):
        slab = np.floor(part.points[..., axis] * slabs).astype(np.int64)
        whole -= np.maximum(part.between(slab, slabs) - mean, 0.0)
    return np.asarray(np.maximum(whole, 0.0) / n)
