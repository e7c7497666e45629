"""Tests of two sets of frames: do they have the same mean image and the same noise?

Method
------
Frames of one renderer with different seeds are exchangeable: any frame could be in any set.
Each statistic is therefore computed for many relabelings of the frames into two sets.
The true labels are one of these relabelings.
The largest statistic of the true labels is compared with those of the other relabelings.
This test of all statistics together is exact for any noise, also for fireflies
[WestfallYoung1993]_.
Pairs of frames with the same seed are relabeled within pairs, which flips differences.

If the significance level requires more relabelings than exist, t tests replace them.
The t tests are also used if the noise of the sets differs: frames are then not exchangeable.
The t tests use a conservative variance, which is rather too large, and ignore single pixels.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array

__all__ = [
    "Contrast",
    "Found",
    "Level",
    "Outcome",
    "cautious",
    "levels_of",
    "relabelled",
    "relabelling_count",
]

# Differences below this fraction of the mean are rounding of float32 sums, not errors
_ROUNDING = 1e-5
# In tiles of at least this width in pixels, variances are averaged over neighboring tiles
_SHARED = 4
# Variances are averaged over neighbors only if there are at least this many tiles
_MANY = 64
# The score −log p of the whole image is increased by this number.
# Most errors of a renderer change the mean of the whole image
_FAVOR = 1.5
# Least width in pixels of tiles whose means are treated as normal by the t tests
_NORMAL = 8
# Least degrees of freedom for tests of single pixels. With few frames, a pixel that is lit
# in half of them would often separate the two sets perfectly by chance
_FREE = 12
# Largest skewness at which a difference of tile means is treated as normal
_SKEW = 0.25
# Skewness below which the tails of a difference of image means count as normal
_EVEN = 0.02
# Few frames underestimate the tail, so the skewness is multiplied by this factor.
# At level 0.01, one frame was compared with 8 frames without bias, all with skewed noise.
# The gate then failed in 15 of 1,000 cases with this factor, and in 17 without it
_UNSEEN = 1.5
# Least number of tiles for the test that averages the differences of all tiles
_TILES = 16
_TINY = 1e-30  # smallest sum of squares by which float32 can divide
# The largest difference is searched only if tiles × relabelings are at most this number
_WORK = 2**33
_BLOCK = 2**23  # number of values that are computed together
_POWER = 1.2815515655446004  # normal quantile: a stated bias is found with 90 % probability
_MEDIAN = math.log(2.0)  # median of −log p if there is no bias
# If p is the smallest of many p-values, the median of −log p exceeds its 10 % quantile by this
_SPREAD = 1.2


@final
@dataclass(frozen=True, kw_only=True)
class Level:
    """Means of all frames over the tiles of one size.

    Attributes
    ----------
    size
        Width of a tile in pixels. 0 stands for the whole image, where each "tile" is a channel.
    rows
        Mean of each tile in each frame, float32 (frame, y, x); 0 where `valid` is false.
    valid
        Whether each tile is tested, bool (y, x).
    """

    size: int
    rows: Array
    valid: Array

    @property
    def count(self) -> int:
        """Number of tested tiles."""
        return int(self.valid.sum())


@final
@dataclass(frozen=True, kw_only=True)
class Contrast:
    """How two sets of frames are compared: as whole sets, or by pairs of frames.

    Attributes
    ----------
    first, second
        Numbers of frames of the new set and of the reference.
    paired
        Whether frame k of one set has the same seed as frame k of the other set.
    """

    first: int
    second: int
    paired: bool

    @property
    def degrees(self) -> int:
        """Degrees of freedom of the variance within the sets."""
        return self.first - 1 if self.paired else self.first + self.second - 2

    @property
    def factor(self) -> float:
        """Variance of the difference of means, divided by the variance of one frame or pair."""
        return 1 / self.first + (0.0 if self.paired else 1 / self.second)

    def of(self, frames: Array) -> Array:
        """Return differences of pairs, or else deviations from the mean of all frames."""
        if self.paired:
            return np.asarray(frames[: self.first] - frames[self.first :])
        return np.asarray(frames - frames.mean(axis=0, dtype=np.float64).astype(frames.dtype))

    def relabelings(self, most: int, rng: np.random.Generator) -> Array:
        """Return weights of frames or pairs (relabeling, row); the first row has the true labels.

        All relabelings are listed if their number is at most `most`; otherwise `most` are drawn.
        """
        rows = self.first if self.paired else self.first + self.second
        if self.paired:
            if 2**rows <= most:
                signs = 1.0 - 2.0 * np.array(list(itertools.product((0, 1), repeat=rows)))
            else:
                signs = rng.choice([-1.0, 1.0], size=(most, rows))
                signs[0] = 1.0
            return np.asarray(signs / rows)
        if math.comb(rows, self.first) <= most:
            chosen = np.array(list(itertools.combinations(range(rows), self.first)))
        else:
            order = rng.permuted(np.tile(np.arange(rows), (most, 1)), axis=1)
            chosen = order[:, : self.first]
            chosen[0] = np.arange(self.first)
        weights = np.full((len(chosen), rows), -1.0 / self.second)
        np.put_along_axis(weights, chosen, 1.0 / self.first, axis=1)
        return weights


def relabelling_count(contrast: Contrast) -> float:
    """Return the number of relabelings with different two-sided test statistics."""
    if contrast.paired:
        return float(2.0 ** (contrast.first - 1))
    every = float(math.comb(contrast.first + contrast.second, contrast.first))
    return every / 2 if contrast.first == contrast.second else every


@final
@dataclass(frozen=True, kw_only=True)
class Found:
    """Result of one test.

    Attributes
    ----------
    name
        ``image``, ``tiles``, ``pixels``, ``spread``, ``noise`` or ``filter``.
    size
        Width of the tiles in pixels, or 0.
    p
        p-value after the correction for all tests together.
    statistic
        Largest difference in standard errors, or the t value in other tests.
    detectable
        Smallest relative bias that this test finds with 90 % probability; NaN if not known.
    """

    name: str
    size: int
    p: float
    statistic: float
    detectable: float = math.nan


@final
@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Results of all tests.

    Attributes
    ----------
    p
        p-value of all tests together.
    relabelings
        Number of relabelings, or 0 if t tests were used.
    tests
        Results by test.
    smallest
        p-value of the most significant tile around each point (y, x), corrected for all tests.
    single
        p-value of each finest tile alone (y, x), without any correction.
        With few frames and in t tests, Student's t approximates this value.
    """

    p: float
    relabelings: int
    tests: list[Found]
    smallest: Array
    single: Array


def levels_of(
    rows: Array, bad: Array, size: int, channels: Array, *, least: int = 2
) -> list[Level]:
    """Average frames over tiles of 2, 4, 8, … times the finest size, and over the image.

    Parameters
    ----------
    rows
        Frames at the finest size, float32 (frame, y, x). Values where `bad` is true are set to 0.
    bad
        Tiles that lack a finite value in some frame.
    size
        Width of a finest tile in pixels.
    channels
        Mean of each channel of each frame (frame, channel).
    least
        Least number of tiles along an axis.
    """
    rows[:, bad] = 0.0
    found = [Level(size=size, rows=rows, valid=~bad)]
    weight: Array = (~bad).astype(np.float32)
    mean = rows
    while min(mean.shape[1:]) >= 2 * least:
        height, width = (each // 2 for each in mean.shape[1:])

        def pooled(values: Array, height: int = height, width: int = width) -> Array:
            cut = values[..., : 2 * height, : 2 * width]
            parts = cut.reshape(*cut.shape[:-2], height, 2, width, 2)
            return np.asarray(parts.mean(axis=(-3, -1)))

        own = pooled(weight)
        mean = pooled(mean * weight) / np.where(own > 0, own, 1.0)
        weight, size = own, 2 * size
        found.append(Level(size=size, rows=mean, valid=own >= 0.5))
    # The weighted mean over all finest tiles, followed by the means of the channels
    flat = rows.reshape(len(rows), -1) @ (weight_of := (~bad).ravel().astype(np.float32))
    whole = flat[:, None] / max(float(weight_of.sum()), 1.0)
    if channels.shape[1] > 1:
        whole = np.concatenate([whole, channels], axis=1)
    image = whole[:, None, :].astype(np.float64)
    found.append(Level(size=0, rows=image, valid=np.ones(image.shape[1:], bool)))
    return found


def relabelled(levels: list[Level], contrast: Contrast, weights: Array, level: float) -> Outcome:
    """Test tiles of all sizes together by relabeling, as the description of the module says.

    Parameters
    ----------
    levels
        Result of `levels_of`.
    contrast
        How the sets are compared.
    weights
        Result of `Contrast.relabelings`.
    level
        Significance level. It determines the smallest bias that can be found.
    """
    families: list[_Family] = []
    single = _single(levels[0], contrast)
    for each in levels:
        if each.count:
            families += _level_families(each, contrast, weights)
    for family in families:
        if family.alone is not None and family.size == levels[0].size:
            single = np.where(np.isnan(single), np.nan, family.alone)
    families += _noise_families(levels[0], contrast, weights)
    scores = np.array([family.score for family in families])
    top = scores.max(axis=0)
    ordered = np.sort(top)

    def p_of(score: Any) -> Array:
        # Equal statistics must count as equal, even if they differ by rounding
        return np.asarray((ordered.size - np.searchsorted(ordered, score - 1e-4)) / ordered.size)

    allowed = math.floor(level * ordered.size + 1e-9)
    critical = float(ordered[-allowed]) if allowed else math.inf
    tests, smallest = [], np.ones(levels[0].valid.shape)
    for family in families:
        known = family.standard_error is not None and math.isfinite(critical)
        needed = family.t_of(critical) if known else math.nan
        tests.append(
            Found(
                name=family.name,
                size=family.size,
                p=float(p_of(family.score[0])),
                statistic=family.statistic,
                detectable=(needed + _POWER) * (family.standard_error or math.nan),
            )
        )
        if family.own is not None:
            _spread(smallest, p_of(family.score_of(family.own)), family.size // levels[0].size)
    smallest[~levels[0].valid] = np.nan
    return Outcome(
        p=float(p_of(top[0])),
        relabelings=len(weights),
        tests=tests,
        smallest=smallest,
        single=single,
    )


@final
@dataclass(frozen=True, kw_only=True)
class _Family:
    """Values of one test statistic for all relabelings.

    Attributes
    ----------
    score
        Score (relabeling,): −log p, rescaled so that all statistics are comparable.
    own
        t² of every tile (y, x) with the true labels.
    alone
        p-value of every tile alone (y, x).
    degrees, count
        Degrees of freedom of t, and the number of tiles over which the largest t² is taken.
    shift, stretch, favor
        The score is (−log p − shift) / stretch + median + favor.
    standard_error
        Relative standard error of the difference, as a median over the tiles.
    """

    name: str
    size: int
    score: Array
    statistic: float
    own: Array | None = None
    alone: Array | None = None
    degrees: float = math.nan
    count: int = 1
    shift: float = _MEDIAN
    stretch: float = 1.0
    favor: float = 0.0
    standard_error: float | None = None

    def score_of(self, squares: Array) -> Array:
        """Convert values of t² to scores."""
        surprise = _surprise(squares, self.degrees, self.count)
        return (surprise - self.shift) / self.stretch + _MEDIAN + self.favor

    def t_of(self, score: float) -> float:
        """Convert a score to the value of t, by interpolation."""
        t = np.geomspace(1e-2, 1e4, 2000)
        return float(np.interp(score, self.score_of(t**2), t, right=math.inf))


def _surprise(squares: Array, degrees: float, count: int) -> Array:
    """Return −log of the two-sided p-values of t², Bonferroni-corrected for `count` values."""
    from scipy.special import stdtr

    squares = np.asarray(squares, np.float64)
    p = 2.0 * stdtr(degrees, -np.sqrt(squares))
    far = 0.5 * degrees * np.log1p(squares / degrees) + 0.5 * math.log(degrees)
    return np.where(p > 1e-280, -np.log(np.maximum(p, 1e-300)), far) - math.log(count)


def _level_families(each: Level, contrast: Contrast, weights: Array) -> Iterator[_Family]:
    """Yield two test statistics for one tile size: the largest difference, and an average."""
    valid = each.valid.ravel()
    frames = each.rows.reshape(len(each.rows), -1)
    rows = contrast.of(frames)
    total = np.einsum("rk,rk->k", rows, rows, dtype=np.float64)
    mean = np.abs(frames.mean(axis=0, dtype=np.float64))
    rounding = len(rows) * (_ROUNDING * mean) ** 2
    valid = valid & (total > _TINY)
    if not valid.any():
        return
    total = np.where(valid, total + rounding, 1.0).astype(rows.dtype)
    rows[:, ~valid] = 0
    count, rank = int(valid.sum()), None
    if count * len(weights) <= _WORK:
        largest, own, degrees, error, rank = _largest(rows, total, valid, each, contrast, weights)
        surprise = _surprise(largest, degrees, count)
        low, shift = np.quantile(surprise, [0.1, 0.5])
        # Heavy tails stretch −log p. The lower half of its distribution is not affected by a bias
        stretch = max(1.0, (shift - low) / _SPREAD) if count > 1 else 1.0
        favor = 0.0 if each.size else _FAVOR
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(valid & (mean > 0), error / mean, np.nan)
        family = _Family(
            name="image" if not each.size else "pixels" if each.size == 1 else "tiles",
            size=each.size,
            score=(surprise - shift) / stretch + _MEDIAN + favor,
            statistic=math.sqrt(largest[0]),
            own=own.reshape(each.valid.shape) if each.size else None,
            degrees=degrees,
            count=count,
            shift=float(shift),
            stretch=float(stretch),
            favor=favor,
            standard_error=_median(relative[:1] if not each.size else relative),
        )
        if not 0 < each.size < _SHARED or contrast.degrees >= _FREE:
            yield family
    if not each.size or len(rows) < 4 or count < _TILES:
        return

    # Are the differences of frames within a set alike over the whole image?
    gram = (rows / total).astype(np.float64) @ rows.T.astype(np.float64)
    first, second = np.triu_indices(len(rows), 1)
    sign = np.sign(weights)
    together = sign[:, first] * sign[:, second]
    alike = gram[first, second]
    if not contrast.paired:
        together = together - together.mean(axis=1, keepdims=True)
        alike = alike - alike.mean()
    size = np.sqrt((together**2).sum(axis=1) * (alike**2).sum())
    share = np.divide(together @ alike, size, out=np.zeros_like(size), where=size > 0)
    score, t = _one_sided(share, first.size - (1 if contrast.paired else 2))
    alone = None if rank is None else rank.reshape(each.valid.shape)
    yield _Family(name="spread", size=each.size, score=score, statistic=t, alone=alone)


def _median(values: Array) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else None


def _one_sided(share: Array, degrees: int) -> tuple[Array, float]:
    """Return −log p of one-sided t tests of correlations, and the first t value."""
    share = np.clip(share, -1.0 + 1e-12, 1.0 - 1e-12)
    t = share * np.sqrt(degrees / (1.0 - share**2))
    score = _surprise(t**2, degrees, 1) + _MEDIAN
    # A negative correlation contradicts the alternative hypothesis
    return np.where(t > 0, score, -np.log1p(-0.5 * np.exp(_MEDIAN - score))), float(t[0])


def _largest(
    rows: Array, total: Array, valid: Array, each: Level, contrast: Contrast, weights: Array
) -> tuple[Array, Array, float, Array, Array | None]:
    """Return the largest t² for each relabeling, and results of each tile for the true labels.

    The results of a tile are t², the standard error and a p-value.
    The variance in t² is the one within the relabeled sets.
    In wide tiles, the variance is averaged with the mean over the 3 × 3 neighborhood.
    For single pixels and for the image, the variance is not averaged over neighbors.
    Then t² is a function of the squared correlation of values and labels.
    The p-value of a single pixel or the image is its rank among relabelings.
    This p-value is exact for any noise. Other tiles have no p-value.
    """
    from scipy.ndimage import uniform_filter

    degrees, factor = contrast.degrees, contrast.factor
    labels = weights.astype(rows.dtype)
    if each.size < _SHARED or each.count < _MANY:
        largest, own = np.zeros(len(labels)), np.empty(rows.shape[1])
        above = np.empty(rows.shape[1])
        step = max(1, _BLOCK // len(labels))
        for begin in range(0, rows.shape[1], step):
            part = slice(begin, begin + step)
            share = np.square(labels @ rows[:, part])
            share *= (1.0 / factor) / total[part]
            own[part] = share[0]
            above[part] = (share >= share[0] * (1.0 - 1e-5)).sum(axis=0)
            np.maximum(largest, share.max(axis=1), out=largest)
        within = np.maximum(total * (1.0 - own), 0.0) / degrees
        tops, mine = (np.minimum(v, 1.0 - 1e-7) for v in (largest, own))
        largest, own = (degrees * v / (1.0 - v) for v in (tops, mine))
        rank = above / len(labels)
        return largest, own, float(degrees), np.sqrt(within * factor), rank
    shape = each.valid.shape
    around = uniform_filter(valid.reshape(shape).astype(np.float32), 3, mode="constant").ravel()
    around = np.where(around > 0, around, 1.0)
    largest = np.empty(len(labels))
    step = max(1, _BLOCK // rows.shape[1])
    own = within = np.empty(0)
    for begin in range(0, len(labels), step):
        square = np.square(labels[begin : begin + step] @ rows) / np.float32(factor)
        variance = np.where(valid, np.maximum(total - square, 0.0), 0.0)
        near = uniform_filter(
            variance.reshape(len(square), *shape), (0, 3, 3), mode="constant"
        ).reshape(square.shape)
        variance = (variance + near / around) / (2 * degrees)
        squares = np.divide(square, variance, out=np.zeros_like(square), where=variance > 0)
        largest[begin : begin + step] = squares.max(axis=1)
        if not begin:
            own, within = squares[0], variance[0]
    return largest, own, 2.0 * degrees, np.sqrt(within * factor), None


def frame_features(finest: Level) -> dict[str, Array]:
    """Return two numbers of each frame: error power, and correlation of neighboring errors.

    Errors are deviations from the mean of all frames, divided by the error size in their pixel.
    """
    frames = finest.rows
    error = frames - frames.mean(axis=0, dtype=np.float64).astype(np.float32)
    scale = np.sqrt(np.einsum("ryx,ryx->yx", error, error, dtype=np.float64))
    mean = np.abs(frames.mean(axis=0, dtype=np.float64))
    known = finest.valid & (scale > _ROUNDING * mean)
    error *= np.where(known, 1.0 / np.where(known, scale, 1.0), 0.0).astype(np.float32)
    power = np.einsum("ryx,ryx->r", error, error, dtype=np.float64)
    beside = np.einsum("ryx,ryx->r", error[:, :, 1:], error[:, :, :-1], dtype=np.float64)
    below = np.einsum("ryx,ryx->r", error[:, 1:], error[:, :-1], dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        return {"noise": power, "filter": np.nan_to_num((beside + below) / (2.0 * power))}


def _noise_families(finest: Level, contrast: Contrast, weights: Array) -> Iterator[_Family]:
    """Yield one-sided tests of whether the new frames have more noise than the reference.

    Also test whether neighboring errors correlate more in the new frames.
    """
    if min(contrast.first, contrast.second) < 2:
        return
    for name, values in frame_features(finest).items():
        rows = contrast.of(values)
        total = float((rows**2).sum())
        if total <= 1e-12 * float((values**2).sum()):
            continue
        share = weights @ rows / math.sqrt(contrast.factor * total)
        score, t = _one_sided(share, contrast.degrees)
        yield _Family(name=name, size=0, score=score, statistic=t)


def cautious(
    levels: list[Level], contrast: Contrast, level: float, *, alike: bool, noise: bool
) -> Outcome:
    """Test by t values with few assumptions: the image, tiles of 8 pixels or more, and the noise.

    Parameters
    ----------
    levels, contrast, level
        Same as in `relabelled`.
    alike
        Whether both sets have the same variance.
        Otherwise Welch's t has the degrees of freedom of the smaller set, which is conservative.
    noise
        Whether to test if the new frames are noisier, or more correlated between pixels.
    """
    from scipy.special import stdtr, stdtrit

    tests: list[tuple[str, int, int, float, float, Array | None, Array]] = []
    first, second = contrast.first, contrast.second
    pooled = alike or contrast.paired
    degrees = contrast.degrees if pooled else min(first, second) - 1
    for each in levels:
        if 0 < each.size < _NORMAL or not each.count:
            continue
        frames = each.rows.astype(np.float64).reshape(len(each.rows), -1)
        mean = np.abs(frames.mean(axis=0))
        if contrast.paired:
            rows = contrast.of(frames)
            difference, variance = rows.mean(axis=0), rows.var(axis=0, ddof=1) / first
        else:
            ours, theirs = frames[:first], frames[first:]
            difference = ours.mean(axis=0) - theirs.mean(axis=0)
            own, other = (v.var(axis=0) * len(v) for v in (ours, theirs))
            if alike:
                variance = (own + other) / contrast.degrees * contrast.factor
            else:
                variance = own / (first * (first - 1)) + other / (second * (second - 1))
        if each.size:
            variance = np.maximum(variance, _near(variance, each))
        variance = variance + (_ROUNDING * mean) ** 2 * contrast.factor
        use = each.valid.ravel() & (variance > 0)
        if not use.any() or (each.size and _skewness(frames[:, use], contrast) > _SKEW):
            continue
        squares = np.where(use, difference**2 / np.where(use, variance, 1.0), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(use & (mean > 0), np.sqrt(variance) / mean, np.nan)
        error = _median(relative[:1] if not each.size else relative)
        name = "tiles" if each.size else "image"
        own_squares = squares.reshape(each.valid.shape)
        tests.append(
            (name, each.size, int(use.sum()), degrees, error or math.nan, own_squares, squares)
        )
    if noise and min(first, second) > 1:
        for name, values in frame_features(levels[0]).items():
            rows = contrast.of(values)
            if contrast.paired:
                t = rows.mean() / max(rows.std(ddof=1) / math.sqrt(first), 1e-300)
            else:
                inner = values[:first].var() * first + values[first:].var() * second
                spread = math.sqrt(inner / contrast.degrees * contrast.factor)
                t = (values[:first].mean() - values[first:].mean()) / max(spread, 1e-300)
            # One-sided: half of the two-sided p-value, or 1 for negative t
            half = np.array([t**2 if t > 0 else 0.0])
            tests.append((name, 0, 1, contrast.degrees, math.nan, None, half))
    found, smallest = [], np.ones(levels[0].valid.shape)
    for name, size, count, df, error, own_map, squares in tests:
        sides = 1 if own_map is None else 2
        factor = count * len(tests)
        beyond = stdtr(df, -np.sqrt(squares.max()))
        wanted = level / factor / sides
        if name == "image":
            skewness = _image_skewness(levels, contrast)
            beyond, wanted = _skewed_tail(beyond, skewness), _even_tail(wanted, skewness)
        p = np.minimum(1.0, factor * sides * beyond)
        critical = -stdtrit(df, wanted)
        found.append(
            Found(
                name=name,
                size=size,
                p=float(p),
                statistic=float(np.sqrt(squares.max())),
                detectable=float((critical + _POWER) * error),
            )
        )
        if own_map is not None and size:
            mine = np.minimum(1.0, factor * 2 * stdtr(df, -np.sqrt(own_map)))
            _spread(smallest, mine, size // levels[0].size)
    smallest[~levels[0].valid] = np.nan
    return Outcome(
        p=min((each.p for each in found), default=1.0),
        relabelings=0,
        tests=found,
        smallest=smallest,
        single=_single(levels[0], contrast),
    )


def _skewness(frames: Array, contrast: Contrast) -> float:
    """Return the absolute skewness of the differences of means, from the skewness of the errors.

    The skewness of a difference of means vanishes for sets of equal size, and for pairs.
    """
    first, second = contrast.first, contrast.second
    if contrast.paired or first == second:
        return 0.0
    parts = [part for part in (frames[:first], frames[first:]) if len(part) > 2]
    cubes = squares = 0.0
    for part in parts:
        count = len(part)
        error = part - part.mean(axis=0)
        scale = math.sqrt(float((error**2).mean() * count / (count - 1))) or 1.0
        error /= scale
        # The factors with `count` make the second and third moments of few values unbiased
        squares += float((error**2).sum()) * count / (count - 1)
        cubes += float((error**3).sum()) * count**2 / ((count - 1) * (count - 2))
    total = sum(part.size for part in parts)
    if not total:
        return math.inf
    one = abs(cubes / total) / (squares / total) ** 1.5
    return float(one * abs(1 / first**2 - 1 / second**2) / contrast.factor**1.5)


def _skewed_tail(probability: float, skewness: float) -> float:
    """Replace a normal tail probability by that of a Pearson III distribution.

    Both are probabilities to exceed the same number of standard deviations.

    The distribution has the given skewness, and its longer tail is used.
    """
    from scipy.special import gammaincc, ndtri

    if skewness < _EVEN:
        return float(probability)
    shape = 4.0 / skewness**2
    away = -float(ndtri(max(probability, 1e-300)))
    return max(float(gammaincc(shape, shape + 2.0 * away / skewness)), float(probability))


def _even_tail(probability: float, skewness: float) -> float:
    """Return the normal tail probability that `_skewed_tail` maps to the given probability."""
    from scipy.special import gammainccinv, ndtr

    if skewness < _EVEN:
        return float(probability)
    shape = 4.0 / skewness**2
    away = (float(gammainccinv(shape, probability)) - shape) * skewness / 2.0
    return min(float(ndtr(-away)), float(probability))


def _image_skewness(levels: list[Level], contrast: Contrast) -> float:
    """Return the absolute skewness of the difference of image means.

    The image is a mean of tiles. Errors of tiles of 8 pixels are nearly independent.
    The skewness of their mean therefore falls as 1/√(number of tiles).
    """
    tiles = [each for each in levels if 0 < each.size <= _NORMAL and each.count]
    if not tiles:
        return 0.0
    coarsest = max(tiles, key=lambda each: each.size)
    frames = coarsest.rows.astype(np.float64).reshape(len(coarsest.rows), -1)
    frames = frames[:, coarsest.valid.ravel()]
    return _UNSEEN * _skewness(frames, contrast) / math.sqrt(max(frames.shape[1], 1))


def _near(variance: Array, each: Level) -> Array:
    """Return the mean variance of the valid tiles in a 3 × 3 neighborhood."""
    from scipy.ndimage import uniform_filter

    shape = each.valid.shape
    weight = uniform_filter(each.valid.astype(float), 3, mode="constant").ravel()
    known = np.where(each.valid.ravel(), variance, 0.0).reshape(shape)
    mean = uniform_filter(known, 3, mode="constant").ravel()
    return np.where(weight > 0, mean / np.where(weight > 0, weight, 1.0), 0.0)


def _single(finest: Level, contrast: Contrast) -> Array:
    """Return two-sided p-values of each finest tile from its own t value, without correction."""
    from scipy.special import stdtr

    rows = contrast.of(finest.rows)
    mean = rows[: contrast.first].mean(axis=0, dtype=np.float64)
    if not contrast.paired:
        mean = mean - rows[contrast.first :].mean(axis=0, dtype=np.float64)
    total = np.einsum("ryx,ryx->yx", rows, rows, dtype=np.float64)
    square = mean**2 / contrast.factor
    within = np.maximum(total - square, 0.0) / contrast.degrees
    size = np.abs(finest.rows.mean(axis=0, dtype=np.float64))
    within += (_ROUNDING * size) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        p = 2.0 * stdtr(contrast.degrees, -np.sqrt(square / within))
    return np.asarray(np.where(finest.valid & (total > 0), p, np.nan))


def _spread(smallest: Array, p: Array, times: int) -> None:
    """Lower the p-value of each finest tile to the p-value of the wide tile that contains it."""
    wide = np.repeat(np.repeat(p, times, axis=0), times, axis=1)
    part = smallest[: wide.shape[0], : wide.shape[1]]
    np.minimum(part, wide, out=part)
