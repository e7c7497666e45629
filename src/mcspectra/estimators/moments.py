"""Mergeable moments: mean, variance and confidence interval, computed block by block.

All arrays have the realization axis first.
Blocks merge without cancellation, by formulas of [ChanGolubLeVeque1983]_ and Pébay (2008).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z, rounding_floor, student_t

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "Measured",
    "Moments",
    "StoredSets",
    "mean_interval",
    "variance_interval",
]

# Weight of the prior for the kurtosis, which assumes normal estimates.
# The prior counts as much as this number of values
_PRIOR = 20
_LEAST = 10  # Fewer values than this cannot show a tail
# Number of smallest and of largest values that are stored; the tail index is fitted to these values
_TAIL = 64
_LEAST_TAIL = 300  # With fewer values, no tail index is fitted
_CLUMPS = 4.0  # Values with at most this kurtosis do not count as heavy-tailed
_LEAST_POINTS = 3000  # With fewer points, no tail is fitted to the values of g at the points
# Limits for the share of the variance that comes from values beyond all sampled values.
# If g is bounded, values beyond the sampled values have a small share of the variance.
# A tail is fitted to the 16, 64 and 256 values farthest from the mean, with a limit for each fit
_BEYOND = {16: 0.005, 64: 0.02, 256: 0.15}
# Values of g beyond all sampled values also have a share in the variance of the estimates.
# Strata and nets remove much of the variance of g, but not this part of it.
# If the share exceeds `_UNSEEN`, the estimates give no upper bound of their variance.
# For 100 estimates with 256 points each, the median of the share is 0.02 for an exponential,
# 0.14 for a lognormal, and 0.26 for x^−0.3 (`jittered`).
_UNSEEN = 0.05
# The share is computed if there are `_LEAST_UNSEEN` values and their tail index exceeds `_HEAVY`.
# The tail is a 25th of the values, from 64 to 256 of them. A larger part is not the tail alone:
# it would show heavy tails of bounded functions with a peak.
# The tail index has a standard error of 0.08 to 0.16. It counts as at most `_FINITE`.
_HEAVY, _FINITE, _LEAST_UNSEEN, _PART = 0.12, 0.45, 1024, 25
# Largest allowed square of the standard error of log s².
# If the squared error exceeds 2, the sample variance s² has less than one degree of freedom.
# The upper end of the interval of the variance would then be above 100 s²
_MOST_ERROR = 2.0
# If the tail index is above `_TAILED`, the upper end of the variance accounts for the tail.
# `_INDEX_ERROR` is the standard error of a tail index that is fitted to 64 values.
# If the tail index is above `_MOST_INDEX`, the values give no upper bound of their variance.
# At index ¼ the kurtosis is infinite. Take 1,000 values u^−0.3 as an example:
# Intervals that use the kurtosis but not the tail index contain the variance in 85 % of cases.
# Intervals that also use the tail index contain the variance in 96 % of cases.
# The tail index does not change the intervals for uniform, normal and exponential values.
_TAILED, _INDEX_ERROR, _MOST_INDEX = 0.05, 0.16, 0.32
# Quantile of log(σ²/s²) at 97.5 %, for R values u^−k with uniform u. Rows are R and columns are k.
# Each entry of the table comes from 1,200 to 20,000 simulated sets
_TAIL_INDICES = (0.21, 0.26, 0.31, 0.36, 0.41, 0.46)
_TAIL_COUNTS = (300, 1000, 3000, 10_000, 30_000, 100_000)
_TAIL_ENDS = (
    (0.614, 0.742, 0.918, 1.167, 1.556, 2.322),
    (0.374, 0.471, 0.608, 0.815, 1.158, 1.876),
    (0.231, 0.302, 0.409, 0.584, 0.888, 1.558),
    (0.136, 0.188, 0.270, 0.412, 0.674, 1.292),
    (0.084, 0.122, 0.188, 0.302, 0.534, 1.114),
    (0.048, 0.073, 0.122, 0.216, 0.415, 0.945),
)
_GROUPS = 32  # Maximum number of groups of sets in the jackknife


@final
@dataclass(frozen=True)
class Measured:
    """A measured number with its 95 % interval.

    Attributes
    ----------
    log
        Whether the interval is symmetric on a logarithmic scale, as intervals of variances are.
    """

    value: float
    low: float
    high: float
    log: bool = False

    @classmethod
    def normal(cls, value: float, se: float) -> Measured:
        """Return a number whose error is normal with the standard deviation `se`."""
        value, half = float(value), CONFIDENCE_Z * float(se)
        return cls(value, value - half, value + half)

    @classmethod
    def mean(cls, values: Array) -> Measured:
        """Return the mean of independent values, with its normal error."""
        return cls.normal(values.mean(), values.std(ddof=1) / len(values) ** 0.5)

    @classmethod
    def of(cls, data: xr.Dataset, name: str, *, log: bool = False) -> Measured:
        """Return a variable of a result, with its interval ``NAME_ci``."""
        low, high = (float(end) for end in data[f"{name}_ci"].values)
        return cls(float(data[name]), low, high, log)

    def __truediv__(self, other: Measured | float) -> Measured:
        """Divide by a number without error, or by a variance with an independent error.

        With common random numbers both variances vary together, so the interval is too wide.
        If a variance is not positive or has no upper bound, the ratio is NaN.
        """
        if not isinstance(other, Measured):
            return Measured(self.value / other, self.low / other, self.high / other, self.log)
        ends = [(each.low, each.value, each.high) for each in (self, other)]
        if not all(0.0 < end < math.inf for three in ends for end in three):
            return Measured(math.nan, math.nan, math.nan, log=True)
        value = self.value / other.value
        half = math.hypot(*(math.log(high / low) / 2 for low, _, high in ends))
        return Measured(value, value * math.exp(-half), value * math.exp(half), log=True)

    def __sub__(self, other: Measured) -> Measured:
        """Return this number minus another number, whose error is independent of this one."""
        value = self.value - other.value
        half = math.hypot(*((each.high - each.low) / 2 for each in (self, other)))
        return Measured(value, value - half, value + half)

    def widened(self, factor: float) -> tuple[float, float]:
        """Return the ends of the interval, widened by a given factor."""
        ends = (self.low, self.high)
        if self.log and min(self.value, *ends) > 0:
            low, high = (self.value * (end / self.value) ** factor for end in ends)
        else:
            low, high = (self.value + (end - self.value) * factor for end in ends)
        return low, high


@final
@dataclass(frozen=True)
class StoredSets:
    """Moments for groups of stored sets, for samplers that reuse a limited number of sets.

    Realization r uses the set r mod `sets`. Realizations with the same set are not independent.
    Therefore standard errors come from a jackknife, which omits one group of sets at a time.
    """

    sets: int
    count: Array  # Number of values in each group, (G,)
    mean: Array  # (G, …)
    m2: Array

    @staticmethod
    def of(values: Array, first: int, sets: int) -> StoredSets:
        """Return moments of values (R, …) by group of sets; `first` is the first value's index."""
        groups = min(sets, _GROUPS)
        label = (first + np.arange(len(values))) % sets % groups
        count = np.bincount(label, minlength=groups).astype(float)
        mean = np.zeros((groups, *values.shape[1:]))
        m2 = np.zeros_like(mean)
        for group in np.flatnonzero(count):
            own = values[label == group]
            mean[group] = own.mean(axis=0)
            m2[group] = ((own - mean[group]) ** 2).sum(axis=0)
        return StoredSets(sets, count, mean, m2)

    def merge(self, other: StoredSets) -> StoredSets:
        """Return the moments of the sets of both objects, merged group by group."""
        count = self.count + other.count
        part = self._by_group(np.divide(other.count, count, out=0.0 * count, where=count > 0))
        delta = other.mean - self.mean
        m2 = self.m2 + other.m2 + self._by_group(self.count) * part * delta**2
        return StoredSets(self.sets, count, self.mean + part * delta, m2)

    def errors(self) -> tuple[Array, Array]:
        """Return standard errors of the variance and of the mean, computed from all values.

        The error of the variance is divided by the variance.
        Both standard errors are infinite for a single group. Each group must have values.
        """
        groups, total = len(self.count), self.count.sum()
        if groups < 2:
            infinite = np.full(self.mean.shape[1:], np.inf)
            return infinite, infinite
        count = self._by_group(self.count)
        mean = (count * self.mean).sum(axis=0) / total
        away = count * (self.mean - mean) ** 2
        m2 = (self.m2 + away).sum(axis=0)
        left = total - count
        variances = (m2 - self.m2 - away * total / left) / np.maximum(left - 1.0, 1.0)
        means = (total * mean - count * self.mean) / left
        factor = (groups - 1) / groups
        spreads = [
            np.sqrt(factor * ((each - each.mean(axis=0)) ** 2).sum(axis=0))
            for each in (variances, means)
        ]
        variance = m2 / max(total - 1.0, 1.0)
        relative = np.divide(spreads[0], variance, out=np.zeros_like(variance), where=variance > 0)
        return relative, spreads[1]

    def _by_group(self, values: Array) -> Array:
        return values.reshape(-1, *[1] * (self.mean.ndim - 1))


@dataclass(frozen=True)
class Moments:
    """Count, mean, and sums of the 2nd, 3rd and 4th powers of deviations, for each column."""

    count: int
    mean: Array
    m2: Array
    m3: Array
    m4: Array
    # Smallest and largest values, sorted along the first axis; None if tails are not examined
    extremes: Array | None = None
    kept: int = field(default=_TAIL, kw_only=True)  # Number of extreme values at each end
    # If each value is a mean of g over a set of points, `points` has moments of g at single points.
    # Values of g at single points show tails that means hide
    points: Moments | None = field(default=None, kw_only=True)
    # Moments for each stored set, if the sampler has only a few stored sets.
    # Errors are computed from these moments if a set is used more than once
    stored: StoredSets | None = field(default=None, kw_only=True)
    # Lower end of the exponent with which g grows toward a face of the cube, or None if not tested
    growth: Array | None = field(default=None, kw_only=True)
    # If each value is a mean of g over a set of points, whether g has a light tail at some points.
    # None if not tested
    light: Array | None = field(default=None, kw_only=True)

    @staticmethod
    def of(
        values: Array,
        *,
        tails: bool = False,
        kept: int = _TAIL,
        first: int = 0,
        sets: int | None = None,
    ) -> Moments:
        """Return moments of values (R, ...) over the first axis; with `tails`, store extremes.

        `sets` is the number of sets that the sampler stores.
        `first` is the index of the first realization.
        """
        mean = values.mean(axis=0)
        deviation = values - mean
        square = deviation * deviation
        return Moments(
            count=values.shape[0],
            mean=mean,
            m2=square.sum(axis=0),
            m3=(square * deviation).sum(axis=0),
            m4=(square * square).sum(axis=0),
            extremes=_outermost(values, kept) if tails else None,
            kept=kept,
            stored=None if sets is None else StoredSets.of(values, first, sets),
        )

    @staticmethod
    def of_points(values: Array) -> Moments:
        """Return moments of values (N, ...) at single points.

        The smallest and largest values are stored as well, because `beyond` needs them.
        """
        return Moments.of(values, tails=True, kept=max(_BEYOND))

    def merge(self, other: Moments) -> Moments:
        """Return the moments of the values of both objects together."""
        a, b = self.count, other.count
        n = a + b
        delta = other.mean - self.mean
        d2 = delta * delta
        extremes = None
        if self.extremes is not None and other.extremes is not None:
            extremes = _outermost(np.concatenate([self.extremes, other.extremes]), self.kept)
        points = self.points
        if points is not None and other.points is not None:
            points = points.merge(other.points)
        stored = None
        if self.stored is not None and other.stored is not None:
            stored = self.stored.merge(other.stored)
        tested = [each.growth for each in (self, other) if each.growth is not None]
        light = [each.light for each in (self, other) if each.light is not None]
        return Moments(
            growth=np.max(tested, axis=0) if tested else None,
            light=np.all(light, axis=0) if light else None,
            extremes=extremes,
            kept=self.kept,
            points=points,
            stored=stored,
            count=n,
            mean=self.mean + delta * (b / n),
            m2=self.m2 + other.m2 + d2 * (a * b / n),
            m3=self.m3
            + other.m3
            + d2 * delta * (a * b * (a - b) / n**2)
            + 3 * delta * (a * other.m2 - b * self.m2) / n,
            m4=self.m4
            + other.m4
            + d2 * d2 * (a * b * (a * a - a * b + b * b) / n**3)
            + 6 * d2 * (a * a * other.m2 + b * b * self.m2) / n**2
            + 4 * delta * (a * other.m3 - b * self.m3) / n,
        )

    @property
    def variance(self) -> Array:
        """Unbiased variance (ddof = 1); NaN for a single value."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.m2 / np.float64(self.count - 1))

    @property
    def largest_share(self) -> Array:
        """Share of the largest square in Σ (value − mean)²; 0 if all values are equal."""
        assert self.extremes is not None
        square = np.maximum(self.extremes[-1] - self.mean, self.mean - self.extremes[0]) ** 2
        return np.asarray(np.divide(square, self.m2, out=np.zeros_like(self.m2), where=self.m2 > 0))

    @property
    def relative_se(self) -> Array:
        """Relative standard error of the variance, from the kurtosis of the values.

        Var(s²)/σ⁴ = (κ − (R−3)/(R−1))/R [Kenney & Keeping 1951].
        Few values underestimate the kurtosis κ.
        Therefore κ is averaged with 3, the kurtosis of a normal distribution.
        The weight of κ is the number of values, and the weight of the normal kurtosis 3 is 20.
        If stored sets are reused, the result is at least the error from the jackknife.
        """
        return np.maximum(self._alone_se, self._stored_errors()[0])

    @property
    def widening(self) -> Array:
        """Factor of at least 1 by which reused stored sets increase the error of the variance."""
        alone = self._alone_se
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(alone > 0, np.maximum(self.relative_se / alone, 1.0), 1.0)

    @property
    def degrees(self) -> int:
        """Number of independent values or of groups of stored sets that determine the errors."""
        return len(self.stored.count) if self.stored is not None and self._reused else self.count

    @property
    def _reused(self) -> bool:
        return self.stored is not None and self.count > self.stored.sets

    def _stored_errors(self) -> tuple[Array, Array]:
        """Return jackknife errors of the relative variance and the mean; 0 if no set is reused."""
        if self.stored is None or not self._reused:
            none = np.zeros_like(self.m2)
            return none, none
        return self.stored.errors()

    @property
    def _alone_se(self) -> Array:
        """Relative standard error of the variance under the assumption of independent values."""
        n = self.count
        if n < 2:
            return np.full_like(self.m2, np.nan)
        with np.errstate(invalid="ignore", divide="ignore"):
            kurtosis = np.where(self.m2 > 0, n * self.m4 / self.m2**2, 3.0)
        drawn = (n * kurtosis + 3.0 * _PRIOR) / (n + _PRIOR)
        spread = (drawn - (n - 3) / (n - 1)) / n
        return np.asarray(np.sqrt(np.maximum(spread, 0.5 / n)))

    @property
    def known_se(self) -> Array:
        """Relative standard error of the variance; infinite if the variance is not `resolved`."""
        return np.where(self.resolved, self.relative_se, np.inf)

    @property
    def variance_ci(self) -> Array:
        """95 % interval of the variance, (..., 2). Its upper end is infinite unless `resolved`.

        The interval is logarithmic and uses the kurtosis, as in [Bonett2006]_.
        The kurtosis is taken about a center that depends on the skewness.
        [Bonett2006]_ takes the kurtosis about a trimmed mean instead.
        The interval is wider upward: values that miss a tail make s² and its error too small.
        If the tail index is above 0.05, the upper end is at least the quantile for values u^−k.
        The exponent k is the estimated tail index plus one standard error.
        The tail index is not used if the values are means of a function with a light tail.
        For 20 or more values, 93 to 97 % of the intervals contain the true variance.
        The tests by ``python -m benchmarks coverage`` covered kurtoses up to 10.
        The tested laws were skewed, heavy-tailed, flat and two-peaked.
        Some constants of the interval are chosen; their effect falls as the number of values grows.
        """
        low, high = self._log_errors()
        few = student_t(self.degrees) * self._stored_errors()[0]
        down = -np.maximum(CONFIDENCE_Z * low * np.maximum(1.0 - low / 4, 0.5), few)
        up = np.where(
            self.resolved, np.maximum(CONFIDENCE_Z * high * (1.0 + high / 2), few), np.inf
        )
        if self.extremes is not None and self.count >= _LEAST_TAIL:
            index = self.tail_index
            tailed = index > _TAILED
            if self.light is not None:
                tailed &= ~self.light  # means over points have a light tail if g has one
            up = np.maximum(up, np.where(tailed, _tail_end(index, self.count), 0.0))
        variance = self.variance
        return np.stack([variance * np.exp(down), variance * np.exp(up)], axis=-1)

    @property
    def resolved(self) -> Array:
        """Whether the values suffice for an upper bound of the variance.

        In three cases the values do not bound the variance.
        First, one or two values may have most of the variance.
        Second, the squared values may have a tail index above 0.64 and a kurtosis above 4.
        Above the tail index 0.64, means of feasible samples are far from normal [Vehtari2024]_.
        Values that form a few clumps have a kurtosis of at most 4, so they do not count as a tail.
        Third, each value may be a mean over points, and g at these points may follow a power law.
        Values of g larger than all sampled values may then cause much of the variance.
        If the points are stratified, less variance is left to other values of g (`unseen`).
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            few = self._log_errors()[1] ** 2 > _MOST_ERROR
            heavy = self.tail_index > _MOST_INDEX
            heavy &= self.count * self.m4 > _CLUMPS * self.m2**2
        if self.points is not None and self.points.count >= _LEAST_POINTS:
            heavy |= np.all([self.points.beyond(m) > most for m, most in _BEYOND.items()], axis=0)
        if self.points is not None and self.points.count >= _LEAST_UNSEEN:
            heavy |= self.unseen > _UNSEEN
        return np.asarray((self.count < _LEAST) | ~(few | heavy))

    @property
    def tail_index(self) -> Array:
        """Index k̂ of a generalized Pareto distribution that is fitted to the farthest values.

        An index of 0 means an exponential tail, and ½ means infinite variance.
        The index is fitted to the 64 values of the longer tail that are farthest from the mean.
        The least extreme of the 64 values is subtracted from the other 63 values.
        Probability-weighted moments of the differences give the index [HoskingWallis1987]_.
        The two tails are not combined, because one tail may end where the other tail begins.
        The index is NaN for fewer than 300 values, or without `tails`.
        """
        if self.extremes is None or self.count < _LEAST_TAIL:
            return np.full_like(self.m2, np.nan)
        return self._farthest(_TAIL)[1]

    @property
    def exponent(self) -> Array:
        """Exponent with which g grows toward a face of the cube, at least; 0 if not known."""
        known = self.points is not None and self.points.growth is not None
        return self.points.growth if known else np.zeros_like(self.m2)  # type: ignore[union-attr,return-value]

    @property
    def unseen(self) -> Array:
        """Share of the variance that comes from values of g beyond all N values at the points.

        A generalized Pareto law with index k and scale σ is fitted to the M farthest values.
        By this law, a value of g lies beyond all N values with probability 1/N.
        Its mean squared distance from them is then 2 s² / ((1 − k)(1 − 2k)), where s = σ M^k.
        This square, divided by N, is a part of n times the variance of the estimates.
        The share is 0 if the tail of g is not heavy.
        """
        assert self.points is not None
        count, many = self.points.count, self.points._tail_size()
        far, index = self.points._farthest(many)
        index = np.minimum(index, _FINITE)
        size = (far[1:] - far[0]).mean(axis=0) * (1.0 - index) * many**index
        square = 2.0 * size**2 / ((1.0 - index) * (1.0 - 2.0 * index))
        # The points are N/R in each of R values
        left = count / self.count * self.variance * count
        share = np.divide(square, left, out=np.zeros_like(left), where=left > 0)
        return np.asarray(np.where(index > _HEAVY, share, 0.0))

    def has_light_tail(self) -> Array | None:
        """Return whether these values of g have a light tail; None if they are too few to tell."""
        if self.count < _LEAST_UNSEEN:
            return None
        return np.asarray(~(self._farthest(self._tail_size())[1] > _HEAVY))

    def _tail_size(self) -> int:
        """Return the number of values of g at points that form its tail."""
        return min(max(_TAIL, self.count // _PART), max(_BEYOND))

    def beyond(self, many: int) -> Array:
        """Return the share of the variance that comes from values beyond all sampled ones.

        A tail t^-k is fitted to the `many` farthest values. Let M values lie in this tail.
        In expectation, values beyond the sampled ones contribute M^(2k − 1) of the sum of squares.
        """
        far, index = self._farthest(many)
        share = np.divide((far**2).sum(axis=0), self.m2, out=0.0 * self.m2, where=self.m2 > 0)
        law = many ** np.minimum(2.0 * index - 1.0, 0.0)
        return np.asarray(np.where(np.isfinite(index), share * law, 0.0))

    def _farthest(self, many: int) -> tuple[Array, Array]:
        """Return the largest distances from the mean, and the tail index fitted to them.

        Of the two tails, the one that reaches farther from the mean is used.
        """
        assert self.extremes is not None
        below = (self.mean - self.extremes[:many])[::-1]
        above = self.extremes[-many:] - self.mean
        far = np.where(above[-1] >= below[-1], above, below)
        excess = far[1:] - far[0]

        # Some values lie on a grid, for example the fraction of points that hit a light.
        # A value on a grid represents the grid cell around it.
        # The smallest value of the tail is the center of its grid cell.
        # The tail begins at the lower border of this cell, which is half a cell lower
        step = np.where(excess > 0, excess, np.inf).min(axis=0)
        grid = (excess[0] == 0) & (far[0] > 0) & np.isfinite(step)
        excess = excess + np.where(grid, step / 2, 0.0)
        weight = np.linspace(1.0, 0.0, len(excess)).reshape(-1, *[1] * self.m2.ndim)
        first, second = excess.mean(axis=0), (weight * excess).mean(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return far, np.asarray(2.0 - first / (first - 2.0 * second))

    def _log_errors(self) -> tuple[Array, Array]:
        """Return two standard errors of log s², for the lower and the upper end of the interval."""
        n = self.count
        if n < 2:
            return np.full_like(self.m2, np.nan), np.full_like(self.m2, np.nan)
        normal = (n - 3) / (n - 1)
        with np.errstate(invalid="ignore", divide="ignore"):
            kurtosis = np.where(self.m2 > 0, n * self.m4 / self.m2**2, 3.0)
            skewness = np.where(self.m2 > 0, np.sqrt(n) * self.m3 / self.m2**1.5, 0.0)
        # Take the fourth moment about a point that lies farther from the longer tail than the mean.
        # Add the part of the kurtosis that a small number of values misses
        shift = 0.5 * n**-0.25 * skewness
        kurtosis = kurtosis + 4 * shift * skewness + 6 * shift**2 + shift**4
        unseen = 36.0 * n ** (-2 / 3) * np.sqrt(np.maximum(kurtosis - 2.0, 0.0))
        low, high = (
            np.sqrt((np.maximum(each, 1.0 + n ** (-2 / 3)) - normal) / (n - 1))
            for each in (kurtosis, kurtosis + unseen)
        )
        return low, high

    @property
    def mean_se(self) -> Array:
        """Standard error of the mean."""
        alone = np.sqrt(self.variance / self.count)
        return np.asarray(np.maximum(alone, self._stored_errors()[1]))


def _tail_end(index: Array, count: int) -> Array:
    """Return the upper end of log(σ²/s²) for values with a tail, interpolated in the table."""
    k = np.clip(index + _INDEX_ERROR, _TAIL_INDICES[0], _TAIL_INDICES[-1])
    columns = np.arange(len(_TAIL_INDICES))
    place, rows = np.interp(k, _TAIL_INDICES, columns), np.log(_TAIL_COUNTS)
    # Between two counts of the table, interpolate the end by a power law in the count.
    # For counts outside the table, use the power that fits the two nearest counts
    x = math.log(count)
    row = int(np.clip(np.searchsorted(rows, x) - 1, 0, len(rows) - 2))
    part = (x - rows[row]) / (rows[row + 1] - rows[row])
    first, second = np.log(_TAIL_ENDS[row]), np.log(_TAIL_ENDS[row + 1])
    return np.asarray(np.exp(np.interp(place, columns, first + part * (second - first))))


def _outermost(values: Array, kept: int) -> Array:
    """Return the smallest and the largest of the values (R, ...), in ascending order."""
    if len(values) > 2 * kept:
        parted = np.partition(values, (kept, len(values) - kept - 1), axis=0)
        values = np.concatenate([parted[:kept], parted[-kept:]])
    return np.sort(values, axis=0)


def variance_interval(variance: Array, relative_se: Array) -> Array:
    """Return a 95 % interval of a variance, (..., 2), from χ² quantiles.

    The number of degrees of freedom is ν = 2/relative_se².
    For R normal values, ν is R − 1, and the interval is exact. For heavier tails ν is smaller.
    """
    from scipy.special import gammaincinv

    half = 1.0 / np.square(relative_se)
    with np.errstate(divide="ignore"):  # If ν is tiny, the upper end is infinite
        low, high = (variance * half / gammaincinv(half, p) for p in (0.975, 0.025))
    return np.stack([low, high], axis=-1)


def mean_interval(values: Array) -> tuple[float, float]:
    """Return a 95 % interval of the mean of independent estimates, (R,).

    The interval contains Student's t interval and the interval by Hall's cubic transform.
    Hall's interval depends on the skewness [Hall1992]_. Both intervals agree for normal estimates.
    For skewed estimates, the interval extends farther on the side of the tail.
    """
    count = len(values)
    mean, spread = float(values.mean()), float(values.std(ddof=1))
    below = above = t = student_t(count)
    skew = math.sqrt(count) / ((count - 1) * (count - 2))
    skew *= float((((values - mean) / max(spread, 1e-300)) ** 3).sum())
    if spread**2 > rounding_floor(np.array(mean)) and skew:
        below = max(t, 3.0 * (math.cbrt(1.0 + skew * (t - skew / 6.0)) - 1.0) / skew)
        above = max(t, 3.0 * (1.0 - math.cbrt(1.0 - skew * (t + skew / 6.0))) / skew)
    error = spread / math.sqrt(count)
    return mean - below * error, mean + above * error
