"""Tests by relabeling: exact tests of the image, tiles, pixels, and the noise.

Method
------
Frames of one renderer with different seeds are exchangeable: any frame could be in any set.
Each statistic is therefore computed for many relabelings of the frames into two sets.
The true labels are one of these relabelings.
The largest statistic of the true labels is compared with those of the other relabelings.
This test of all statistics together is exact for any noise, also for fireflies
[WestfallYoung1993]_.
Pairs of frames with the same seed are relabeled within pairs, which flips differences.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.rendering.gate_tests import (
    FOUND_QUANTILE,
    ROUNDING,
    Contrast,
    Found,
    Level,
    Outcome,
    finite_median,
    frame_features,
    lower_tiles,
    single_p,
)

__all__ = ["relabelled"]

# In tiles of at least this width in pixels, variances are averaged over neighboring tiles
_SHARED = 4
# Variances are averaged over neighbors only if there are at least this many tiles
_MANY = 64
# Most bugs change the mean of the whole image, so this number is added to its score −log p
_FAVOR = 1.5
# Least degrees of freedom for tests of single pixels.
# With few frames, pixels that are lit in half of the frames often separate the sets by chance
_FREE = 12
# Least number of tiles for the test that averages the differences of all tiles
_TILES = 16
_TINY = 1e-30  # smallest sum of squares by which float32 can divide
# The largest difference is searched only if tiles × relabelings are at most this number
_WORK = 2**33
_BLOCK = 2**23  # number of values that are computed together
_MEDIAN = math.log(2.0)  # median of −log p if there is no bias
# For the smallest p of many tests, the median of −log p exceeds its 10 % quantile by this number
_SPREAD = 1.2


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
    single = single_p(levels[0], contrast)
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
                detectable=(needed + FOUND_QUANTILE) * (family.standard_error or math.nan),
            )
        )
        if family.own is not None:
            lower_tiles(smallest, p_of(family.score_of(family.own)), family.size // levels[0].size)
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
    rounding = len(rows) * (ROUNDING * mean) ** 2
    valid = valid & (total > _TINY)
    if not valid.any():
        return
    total = np.where(valid, total + rounding, 1.0).astype(rows.dtype)
    rows[:, ~valid] = 0
    count, rank = int(valid.sum()), None
    if count * len(weights) <= _WORK:
        family, rank = _largest_family(rows, total, valid, mean, each, contrast, weights)
        if not 0 < each.size < _SHARED or contrast.degrees >= _FREE:
            yield family
    if each.size and len(rows) >= 4 and count >= _TILES:
        yield _spread_family(rows, total, each, contrast, weights, rank)


def _largest_family(
    rows: Array,
    total: Array,
    valid: Array,
    mean: Array,
    each: Level,
    contrast: Contrast,
    weights: Array,
) -> tuple[_Family, Array | None]:
    """Test the largest difference among tiles of one size; also return p-values of the tiles."""
    count = int(valid.sum())
    largest, own, degrees, error, rank = _largest(rows, total, valid, each, contrast, weights)
    surprise = _surprise(largest, degrees, count)
    low, shift = np.quantile(surprise, [0.1, 0.5])
    # Noise with heavy tails makes the distribution of −log p wider.
    # The width is measured in the lower half of the distribution, which a bias does not affect
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
        standard_error=finite_median(relative[:1] if not each.size else relative),
    )
    return family, rank


def _spread_family(
    rows: Array,
    total: Array,
    each: Level,
    contrast: Contrast,
    weights: Array,
    rank: Array | None,
) -> _Family:
    """Test whether the differences of frames of one set look alike over the image."""
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
    return _Family(name="spread", size=each.size, score=score, statistic=t, alone=alone)


def _one_sided(share: Array, degrees: int) -> tuple[Array, float]:
    """Return −log p for the correlation of each relabeling, and the t value of the true labels."""
    share = np.clip(share, -1.0 + 1e-12, 1.0 - 1e-12)
    t = share * np.sqrt(degrees / (1.0 - share**2))
    score = _surprise(t**2, degrees, 1) + _MEDIAN
    # The test looks for positive correlations, so a negative correlation gets a small score
    return np.where(t > 0, score, -np.log1p(-0.5 * np.exp(_MEDIAN - score))), float(t[0])


def _largest(
    rows: Array, total: Array, valid: Array, each: Level, contrast: Contrast, weights: Array
) -> tuple[Array, Array, float, Array, Array | None]:
    """Return the largest t² for each relabeling, and for the true labels t², error and p-value.

    The variance in t² is computed within the two sets of each relabeling.
    In wide tiles, the variance is averaged with the mean over the 3 × 3 neighborhood.
    Single pixels and the image use their own variance: t² = ν r²/(1 − r²).
    Here ν is the number of degrees of freedom, and r is the correlation of values and labels.
    For pixels and the image, exact p-values of each difference alone are also returned.
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


def _noise_families(finest: Level, contrast: Contrast, weights: Array) -> Iterator[_Family]:
    """Yield one-sided tests: is the noise larger, and do neighboring errors correlate more?"""
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
