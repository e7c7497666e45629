"""Errors of frames against reference images: bias, relMSE and SMAPE, by region and frame.

Regions are tiles of a grid, at most 8 × 8. All errors are errors of the luminance.
References count as exact: they should have far more samples than the frames.
Intervals are computed from the spread of the sequences, which are independent.
Frames of one view count as sequences of length 1.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from glob import escape, glob
from os import PathLike, fspath
from pathlib import Path
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import student_t
from mcspectra.core.display import shown
from mcspectra.core.errors import FileFormatError, Parameter, ParameterError
from mcspectra.core.images import luminance
from mcspectra.estimators.moments import Moments
from mcspectra.rendering.frame_files import FrameReader

__all__ = [
    "ReferenceErrors",
    "References",
    "reference_errors",
    "references_of",
    "tile_centers",
    "tile_means",
]

_TILES = 8  # largest number of tiles along an axis
_LEAST_TILE = 8  # smallest side of a tile in pixels, unless the image is smaller
# Added to denominators so that dark pixels do not dominate [Rousselle2011]_
_DARK = 0.01
_NAMES = ("bias", "relative", "symmetric")
_FRAME = "{frame}"


@final
@dataclass(frozen=True, kw_only=True)
class ReferenceErrors:
    """Errors by tile (tile_y, tile_x), by frame and of the whole image, with 95 % intervals.

    Errors of tiles and of the image are means over the frames of a sequence.

    Attributes
    ----------
    bias
        Mean error divided by the mean of the reference.
    relative
        relMSE of a frame x against the reference r: mean of (x − r)² / (r² + 0.01).
    symmetric
        SMAPE of a frame x against the reference r: mean of |x − r| / (|x| + |r| + 0.01).
    whole, frames
        Bias, relMSE and SMAPE of the whole image, and of each frame of a sequence (frame,).
    square
        Mean over pixels of the squared bias, an unbiased estimate that may be negative.
    apart
        Mean of all frames minus their references, (y, x).
    """

    bias: Array
    bias_ci: Array
    relative: Array
    relative_ci: Array
    symmetric: Array
    symmetric_ci: Array
    whole: dict[str, tuple[float, Array]]
    frames: dict[str, tuple[Array, Array]]
    square: float
    apart: Array


@final
@dataclass(frozen=True, kw_only=True)
class References:
    """True images of the frames of a sequence, or one image for all frames.

    Attributes
    ----------
    files
        One file for each frame of a sequence, or one file for all frames.
    read
        Reads the files.
    shape
        Height and width of the frames.
    """

    files: tuple[Path, ...]
    read: FrameReader
    shape: tuple[int, int]

    def color(self, time: int) -> Array:
        """Return the colors of the reference of a frame (y, x, band).

        Raises
        ------
        ParameterError
            If the reference has another size than the frames, or no pixel is finite.
        FileFormatError
            If the file is missing, broken or tone-mapped.
        """
        file = self.files[time if len(self.files) > 1 else 0]
        image = self.read.color(file)
        if image.shape[:2] != self.shape:
            raise ParameterError(
                f"{file} has the size {image.shape[:2]}, but the frames have {self.shape}; give a "
                "reference of the same view."
            )
        if not np.isfinite(image).any():
            raise ParameterError(f"{file} has no finite pixel; give another reference.")
        return image

    def plane(self, time: int) -> Array:
        """Return the luminance of the reference of a frame (y, x)."""
        return np.asarray(luminance(self.color(time)))


def references_of(
    given: str | PathLike[str], read: FrameReader, shape: tuple[int, int], numbers: Sequence[int]
) -> References:
    """Return the references of frames.

    Parameters
    ----------
    given
        A file, or a name with ``{frame}``, such as ``truth/t{frame}.exr``.
    read
        Reads the files.
    shape
        Height and width of the frames.
    numbers
        Numbers of the frames of a sequence; empty for frames of one view.

    Raises
    ------
    ParameterError
        If a frame has no reference, or frames of one view have numbered references.
    FileFormatError
        If no file has the given name.
    """
    name = fspath(given)
    if _FRAME not in name:
        return References(files=(Path(name),), read=read, shape=shape)
    if not numbers or name.count(_FRAME) > 1:
        raise ParameterError(
            Parameter("reference"),
            f" is {shown(name)}, but "
            + ("{frame} can stand there once" if numbers else "these are frames of one view")
            + "; give "
            + ("a name with one {frame}." if numbers else "one file."),
        )
    before, after = name.split(_FRAME)
    search = re.compile(re.escape(before) + r"(\d+)" + re.escape(after))
    found: dict[int, Path] = {}
    for file in glob(f"{escape(before)}*{escape(after)}"):  # noqa: PTH207 - absolute patterns
        if match := search.fullmatch(file):
            number = int(match[1])
            if number in found:
                raise ParameterError(
                    f"{file} and {found[number]} are references of one frame; remove one of them."
                )
            found[number] = Path(file)
    if not found:
        raise FileFormatError(
            f"There is no reference {shown(name)}; give names such as truth/t{{frame}}.exr."
        )
    for number in numbers:
        if number not in found:
            raise ParameterError(
                f"Frame {number} of the sequences has no reference {shown(name)}; give a reference "
                "of every frame."
            )
    return References(files=tuple(found[number] for number in numbers), read=read, shape=shape)


def reference_errors(
    files: Sequence[Path], times: int, read: FrameReader, truth: References
) -> ReferenceErrors:
    """Compare sequences with references.

    Parameters
    ----------
    files
        Frames with the same number of samples. The frames of a sequence are adjacent in the list.
    times
        Number of frames of each sequence.
    read
        Reads the frames.
    truth
        The references.
    """
    count = len(files) // times
    sums, levels, square = [], [], 0.0
    apart = np.zeros(truth.shape)
    for t in range(times):
        true = truth.plane(t)
        levels.append(_by_tile(true))
        moments: Moments | None = None
        own = []
        for k in range(count):
            plane = read.plane(files[k * times + t], None)[0]
            off = plane - true
            squares = off**2 / (true**2 + _DARK)
            ratios = np.abs(off) / (np.abs(plane) + np.abs(true) + _DARK)
            own.append([_by_tile(each) for each in (off, squares, ratios)])
            each = Moments.of(off[None])
            moments = each if moments is None else moments.merge(each)
        assert moments is not None
        sums.append(own)
        square += float(np.nanmean(moments.mean**2 - moments.variance / count)) / times
        apart += moments.mean / times
    every: Array = np.array(
        sums
    )  # dims (frame, sequence, kind, tile); the last tile is the whole image
    level = np.array(levels)
    value, ends = _intervals(every.mean(axis=0), level.mean(axis=0))
    frames = [_intervals(own[..., -1:], of[-1:]) for own, of in zip(every, level, strict=True)]
    tiles = tile_means(apart).shape
    return ReferenceErrors(
        **{name: value[k, :-1].reshape(tiles) for k, name in enumerate(_NAMES)},
        **{f"{name}_ci": ends[k, :-1].reshape(*tiles, 2) for k, name in enumerate(_NAMES)},
        whole={name: (float(value[k, -1]), ends[k, -1]) for k, name in enumerate(_NAMES)},
        frames={
            name: (np.array([v[k, 0] for v, _ in frames]), np.array([e[k, 0] for _, e in frames]))
            for k, name in enumerate(_NAMES)
        },
        square=square,
        apart=apart,
    )


def _by_tile(plane: Array) -> Array:
    """Return the means of finite values over the tiles, and over the image as the last value."""
    return np.append(tile_means(plane).ravel(), np.nanmean(plane))


def _intervals(each: Array, level: Array) -> tuple[Array, Array]:
    """Return errors (kind, tile) with intervals, from sequences (sequence, kind, tile).

    The first kind of error, bias, is divided by the level, the mean of the reference.
    relMSE and SMAPE are positive, so their intervals are symmetric on a logarithmic axis.
    """
    count = len(each)
    with np.errstate(invalid="ignore", divide="ignore"):
        each = np.concatenate([each[:, :1] / level, each[:, 1:]], axis=1)
        value = each.mean(axis=0)
        half = student_t(count) * each.std(axis=0, ddof=1) / math.sqrt(count)
        ends = np.stack([value - half, value + half], axis=-1)
        factor = np.exp(np.where(value > 0, half / value, 0.0))[1:]
    ends[1:] = np.stack([value[1:] / factor, value[1:] * factor], axis=-1)
    return value, ends


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
