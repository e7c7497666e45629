"""Errors of frames against a reference image: bias, relMSE and SMAPE, by region of the image.

Regions are tiles of a grid, at most 8 × 8. All errors are errors of the luminance.
The reference counts as exact: it should have far more samples than the frames.
Intervals are computed from the spread of the frames, which are independent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import student_t
from mcspectra.core.errors import ParameterError
from mcspectra.rendering.frame_files import FrameReader

__all__ = ["ReferenceErrors", "read_reference", "reference_errors", "tile_centers", "tile_means"]

_TILES = 8  # largest number of tiles along an axis
_LEAST_TILE = 8  # smallest side of a tile in pixels, unless the image is smaller
# Added to denominators so that dark pixels do not dominate [Rousselle2011]_
_DARK = 0.01


@final
@dataclass(frozen=True, kw_only=True)
class ReferenceErrors:
    """Errors by tile (tile_y, tile_x) and of the whole image, each with 95 % intervals.

    Attributes
    ----------
    bias
        Mean error divided by the mean of the reference.
    relative
        relMSE of a frame x against the reference r: mean of (x − r)² / (r² + 0.01).
    symmetric
        SMAPE of a frame x against the reference r: mean of |x − r| / (|x| + |r| + 0.01).
    square
        Mean over pixels of the squared bias, an unbiased estimate that may be negative.
    """

    bias: Array
    bias_ci: Array
    relative: Array
    relative_ci: Array
    symmetric: Array
    symmetric_ci: Array
    whole: dict[str, tuple[float, Array]]
    square: float


def read_reference(file: str | PathLike[str], read: FrameReader, shape: tuple[int, ...]) -> Array:
    """Return the colors of a reference (y, x, band), and check its size.

    Raises
    ------
    ParameterError
        If the reference has another size than the frames, or no pixel is finite.
    FileFormatError
        If the file is missing, broken or tone-mapped.
    """
    image = read.color(Path(file))
    if image.shape[:2] != shape[:2]:
        raise ParameterError(
            f"{file} has the size {image.shape[:2]}, but the frames have {shape[:2]}; give a "
            "reference of the same view."
        )
    if not np.isfinite(image).any():
        raise ParameterError(f"{file} has no finite pixel; give another reference.")
    return image


def reference_errors(
    files: Sequence[Path], read: FrameReader, truth: Array, mean: Array, variance: Array
) -> ReferenceErrors:
    """Compare frames with a reference.

    Parameters
    ----------
    files
        Frames with the same number of samples.
    read
        Reads the frames.
    truth
        Luminance of the reference (y, x).
    mean, variance
        Mean of the frames, and variance of one frame (y, x).
    """
    count, rows = len(files), []
    level = tile_means(truth)
    for file in files:
        plane = read.plane(file, None)[0]
        apart = plane - truth
        rows.append(
            np.stack(
                [
                    tile_means(apart) / level,
                    tile_means(apart**2 / (truth**2 + _DARK)),
                    tile_means(np.abs(apart) / (np.abs(plane) + np.abs(truth) + _DARK)),
                ]
            )
        )
        rows[-1] = np.concatenate(
            [
                rows[-1].reshape(3, -1),
                [
                    [np.nanmean(apart) / np.nanmean(truth)],
                    [np.nanmean(apart**2 / (truth**2 + _DARK))],
                    [np.nanmean(np.abs(apart) / (np.abs(plane) + np.abs(truth) + _DARK))],
                ],
            ],
            axis=1,
        )
    each = np.stack(rows)  # (frame, kind, tile), and the whole image as the last tile
    value = each.mean(axis=0)
    half = student_t(count) * each.std(axis=0, ddof=1) / math.sqrt(count)
    ends = np.stack([value - half, value + half], axis=-1)
    # Errors are positive, so their intervals are symmetric on a logarithmic axis
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.exp(np.where(value > 0, half / value, 0.0))[1:]
    ends[1:] = np.stack([value[1:] / factor, value[1:] * factor], axis=-1)
    tiles = level.shape
    names = ("bias", "relative", "symmetric")
    return ReferenceErrors(
        **{name: value[k, :-1].reshape(tiles) for k, name in enumerate(names)},
        **{f"{name}_ci": ends[k, :-1].reshape(*tiles, 2) for k, name in enumerate(names)},
        whole={name: (float(value[k, -1]), ends[k, -1]) for k, name in enumerate(names)},
        square=float(np.nanmean((mean - truth) ** 2 - variance / count)),
    )


def tile_means(plane: Array) -> Array:
    """Return the means of finite values over tiles (tile_y, tile_x)."""
    known = np.isfinite(plane)
    starts = [_edges(size)[:-1] for size in plane.shape]
    sums = (
        np.add.reduceat(np.add.reduceat(each, starts[0], axis=0), starts[1], axis=1)
        for each in (np.where(known, plane, 0.0), known.astype(float))
    )
    total, number = sums
    return np.asarray(np.divide(total, number, out=np.full_like(total, np.nan), where=number > 0))


def tile_centers(size: int) -> Array:
    """Return the centers of the tiles along an axis, in pixels."""
    edges = _edges(size)
    return np.asarray((edges[1:] + edges[:-1] - 1) / 2)


def _edges(size: int) -> Array:
    count = max(1, min(_TILES, size // _LEAST_TILE))
    return np.linspace(0, size, count + 1).astype(int)
