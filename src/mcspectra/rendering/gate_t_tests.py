"""t tests of two sets of frames, for few frames or sets with unequal noise.

If the significance level requires more relabelings than exist, t tests replace them.
The t tests are also used if the noise of the sets differs: frames are then not exchangeable.
The t tests use a conservative variance: it is too large rather than too small.
No t test is applied to single pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

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

__all__ = ["cautious"]

# Least width in pixels of tiles whose means are treated as normal by the t tests
_NORMAL = 8
# Largest skewness at which a difference of tile means is treated as normal
_SKEW = 0.25
# Skewness below which the tails of a difference of image means count as normal
_EVEN = 0.02
# Few frames underestimate the tail, so the skewness is multiplied by this factor.
# With the factor, 1,000 tests of 1 against 8 unbiased frames at level 0.01 give 15 false alarms.
# The frames are skewed. Without the factor, 1,000 tests give 17 false alarms
_UNSEEN = 1.5


def cautious(
    levels: list[Level], contrast: Contrast, level: float, *, alike: bool, noise: bool
) -> Outcome:
    """Test the image, tiles of 8 pixels or more, and the noise by t values, with few assumptions.

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

    tests = _mean_tests(levels, contrast, alike=alike)
    if noise and min(contrast.first, contrast.second) > 1:
        tests += _noise_tests(levels[0], contrast)
    found, smallest = [], np.ones(levels[0].valid.shape)
    for test in tests:
        factor = test.count * len(tests)
        sides = 2 if test.two_sided else 1
        beyond = float(stdtr(test.degrees, -math.sqrt(test.squares.max())))
        wanted = level / factor / sides
        if test.name == "image":
            skewness = _image_skewness(levels, contrast)
            beyond, wanted = _skewed_tail(beyond, skewness), _even_tail(wanted, skewness)
        p = min(1.0, factor * sides * beyond)
        critical = -stdtrit(test.degrees, wanted)
        found.append(
            Found(
                name=test.name,
                size=test.size,
                p=float(p),
                statistic=math.sqrt(test.squares.max()),
                detectable=float((critical + FOUND_QUANTILE) * test.error),
            )
        )
        if test.size:
            tails = 2 * stdtr(test.degrees, -np.sqrt(test.squares))
            lower_tiles(smallest, np.minimum(1.0, factor * tails), test.size // levels[0].size)
    smallest[~levels[0].valid] = np.nan
    return Outcome(
        p=min((each.p for each in found), default=1.0),
        relabelings=0,
        tests=found,
        smallest=smallest,
        single=single_p(levels[0], contrast),
    )


@final
@dataclass(frozen=True, kw_only=True)
class _Test:
    """A test of the largest of several t values.

    Attributes
    ----------
    size
        Width of the tiles in pixels, or 0.
    count, degrees
        Number of t values, and their degrees of freedom.
    squares
        t², of tiles as (y, x); for a one-sided test, 0 where t has the opposite sign.
    error
        Median relative standard error of the difference; NaN for tests of the noise.
    """

    name: str
    size: int
    count: int
    degrees: int
    squares: Array
    error: float = math.nan
    two_sided: bool = True


def _mean_tests(levels: list[Level], contrast: Contrast, *, alike: bool) -> list[_Test]:
    """Return tests of the image mean and of the means of wide tiles."""
    tests: list[_Test] = []
    first, second = contrast.first, contrast.second
    pooled = alike or contrast.paired
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
        variance = variance + (ROUNDING * mean) ** 2 * contrast.factor
        use = each.valid.ravel() & (variance > 0)
        if not use.any() or (each.size and _skewness(frames[:, use], contrast) > _SKEW):
            continue
        squares = np.where(use, difference**2 / np.where(use, variance, 1.0), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(use & (mean > 0), np.sqrt(variance) / mean, np.nan)
        test = _Test(
            name="tiles" if each.size else "image",
            size=each.size,
            count=int(use.sum()),
            degrees=contrast.degrees if pooled else min(first, second) - 1,
            squares=squares.reshape(each.valid.shape),
            error=finite_median(relative[:1] if not each.size else relative) or math.nan,
        )
        tests.append(test)
    return tests


def _noise_tests(finest: Level, contrast: Contrast) -> list[_Test]:
    """Return tests whether the new frames are noisier, or more correlated between pixels."""
    tests, first = [], contrast.first
    for name, values in frame_features(finest).items():
        if contrast.paired:
            rows = contrast.of(values)
            t = rows.mean() / max(rows.std(ddof=1) / math.sqrt(first), 1e-300)
        else:
            ours, theirs = values[:first], values[first:]
            inner = ours.var() * first + theirs.var() * contrast.second
            spread = math.sqrt(inner / contrast.degrees * contrast.factor)
            t = (ours.mean() - theirs.mean()) / max(spread, 1e-300)
        squares = np.array([t**2 if t > 0 else 0.0])
        test = _Test(
            name=name,
            size=0,
            count=1,
            degrees=contrast.degrees,
            squares=squares,
            two_sided=False,
        )
        tests.append(test)
    return tests


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
        # These factors remove the bias of the second and third moments of few values
        squares += float((error**2).sum()) * count / (count - 1)
        cubes += float((error**3).sum()) * count**2 / ((count - 1) * (count - 2))
    total = sum(part.size for part in parts)
    if not total:
        return math.inf
    one = abs(cubes / total) / (squares / total) ** 1.5
    return float(one * abs(1 / first**2 - 1 / second**2) / contrast.factor**1.5)


def _skewed_tail(probability: float, skewness: float) -> float:
    """Replace a normal tail probability by the tail of a Pearson III law at the same point.

    The law has the given skewness. The returned probability is that of its longer tail.
    """
    from scipy.special import gammaincc, ndtri

    if skewness < _EVEN:
        return float(probability)
    shape = 4.0 / skewness**2
    away = -float(ndtri(max(probability, 1e-300)))
    return max(float(gammaincc(shape, shape + 2.0 * away / skewness)), float(probability))


def _even_tail(probability: float, skewness: float) -> float:
    """Replace a tail probability of a Pearson III law by the normal one at the same point.

    This function is the inverse of `_skewed_tail`.
    """
    from scipy.special import gammainccinv, ndtr

    if skewness < _EVEN:
        return float(probability)
    shape = 4.0 / skewness**2
    away = (float(gammainccinv(shape, probability)) - shape) * skewness / 2.0
    return min(float(ndtr(-away)), float(probability))


def _image_skewness(levels: list[Level], contrast: Contrast) -> float:
    """Return the absolute skewness of the difference of image means.

    The image is a mean of tiles. Errors of tiles of 8 pixels are nearly independent.
    The skewness of the image's mean therefore falls as 1/√(number of tiles).
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
