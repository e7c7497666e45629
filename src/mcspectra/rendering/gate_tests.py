"""Common parts of the tests that compare new renders with a reference: frames and results.

Tests by relabeling are in `gate_relabelings`, and t tests for few frames are in `gate_t_tests`.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array

__all__ = [
    "FOUND_QUANTILE",
    "ROUNDING",
    "Contrast",
    "Found",
    "Level",
    "Outcome",
    "finite_median",
    "frame_features",
    "levels_of",
    "lower_tiles",
    "relabelling_count",
    "single_p",
]

ROUNDING = 1e-5
"""Differences below this fraction of the mean are rounding of float32 sums, not errors."""

FOUND_QUANTILE = 1.2815515655446004
"""Normal quantile: a bias is called detectable if it is found with 90 % probability."""


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
        Statistic of the test: the largest difference in standard errors, or a t value.
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
        With few frames and in t tests, this p-value is an approximation by Student's t.
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


def frame_features(finest: Level) -> dict[str, Array]:
    """Return two numbers of each frame: error power, and correlation of neighboring errors.

    Errors are deviations from the mean of all frames, divided by the error size in their pixel.
    """
    frames = finest.rows
    error = frames - frames.mean(axis=0, dtype=np.float64).astype(np.float32)
    scale = np.sqrt(np.einsum("ryx,ryx->yx", error, error, dtype=np.float64))
    mean = np.abs(frames.mean(axis=0, dtype=np.float64))
    known = finest.valid & (scale > ROUNDING * mean)
    error *= np.where(known, 1.0 / np.where(known, scale, 1.0), 0.0).astype(np.float32)
    power = np.einsum("ryx,ryx->r", error, error, dtype=np.float64)
    beside = np.einsum("ryx,ryx->r", error[:, :, 1:], error[:, :, :-1], dtype=np.float64)
    below = np.einsum("ryx,ryx->r", error[:, 1:], error[:, :-1], dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        return {"noise": power, "filter": np.nan_to_num((beside + below) / (2.0 * power))}


def single_p(finest: Level, contrast: Contrast) -> Array:
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
    within += (ROUNDING * size) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        p = 2.0 * stdtr(contrast.degrees, -np.sqrt(square / within))
    return np.asarray(np.where(finest.valid & (total > 0), p, np.nan))


def lower_tiles(smallest: Array, p: Array, times: int) -> None:
    """Lower the p-values of the finest tiles to the p-value of the wide tile that contains them."""
    wide = np.repeat(np.repeat(p, times, axis=0), times, axis=1)
    part = smallest[: wide.shape[0], : wide.shape[1]]
    np.minimum(part, wide, out=part)


def finite_median(values: Array) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else None
