"""Frames for the gate: means over tiles of each frame, and files of stored references.

A stored reference is one EXR file with the mean image and the pixel variance of one frame.
The file also stores the mean of every 4 × 4 tile of each frame, as a mosaic of small pictures.
The tests can therefore relabel each frame, although frames are not separate layers of the file.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array, is_path
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.core.images import exr_attributes, luminance, read_image
from mcspectra.core.progress import report
from mcspectra.rendering.files import check_image_path, write_exr
from mcspectra.rendering.frame_files import (
    FrameFiles,
    FrameReader,
    Frames,
    described_paths,
    frame_files,
)
from mcspectra.rendering.frame_sequences import sequence_files

__all__ = [
    "FrameSet",
    "Source",
    "coarsened",
    "finest_size",
    "read_set",
    "source_of",
    "write_reference",
]

TILE = 4
"""Width in pixels of the tiles whose means a stored reference holds for each frame."""

_ACROSS = TILE  # number of small pictures along each side of a mosaic
_MARK = "mcspectra_reference"  # name of the header entry that marks a stored reference
_MOST = 2**28  # largest number of tile means in memory (1 GiB)


@final
@dataclass(frozen=True, kw_only=True)
class FrameSet:
    """Frames with the same number of samples per pixel.

    Attributes
    ----------
    name
        The paths of the files as text.
    spp
        Samples per pixel, or None if not known.
    names
        Names of the frames.
    rows
        Mean luminance of tiles, float32 (frame, y, x); NaN where a pixel is not finite.
    size
        Width of a tile in pixels.
    shape
        Height and width of the image in pixels.
    channels
        Mean of each channel of each frame (frame, channel).
    missing
        Number of pixels without a finite value in all frames.
    """

    name: str
    spp: int | None
    names: list[str]
    rows: Array
    size: int
    shape: tuple[int, int]
    channels: Array
    missing: int

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.names)

    def only(self, frames: Sequence[int]) -> FrameSet:
        """Return a set of the frames with the given indices, in the given order."""
        chosen = list(frames)
        return replace(
            self,
            names=[self.names[k] for k in chosen],
            rows=self.rows[chosen],
            channels=self.channels[chosen],
        )


@final
@dataclass(frozen=True, kw_only=True)
class Source:
    """Frames that are not read yet: files grouped by samples per pixel, or a stored reference.

    Attributes
    ----------
    about
        Header of the stored reference, or None for files of frames.
    shape
        Height and width in pixels.
    """

    name: str
    groups: list[FrameFiles]
    about: dict[str, Any] | None
    shape: tuple[int, int]

    def count(self, spp: int | None) -> int:
        """Return the number of frames with this number of samples per pixel."""
        return next(self._frames(each) for each in self.groups if each.spp == spp)

    def _frames(self, group: FrameFiles) -> int:
        return len(self.about["names"]) if self.about else len(group.files)

    @property
    def finest(self) -> int:
        """Width in pixels of the finest tiles whose means are known for each frame."""
        return TILE if self.about else 1


def source_of(paths: Frames, read: FrameReader) -> Source:
    """Find the files of frames, or read the header of a stored reference.

    Raises
    ------
    FileFormatError
        If there are no files, or a file is broken.
    ParameterError
        If names and headers of files disagree.
    """
    if is_path(paths) and Path(str(paths)).suffix.lower() == ".exr" and Path(str(paths)).is_file():
        about = _header(Path(str(paths)))
        if about is not None:
            spp = about["spp"] if read.spp is None else read.spp
            group = FrameFiles(spp=spp, files=[Path(str(paths))], seconds=None)
            height, width = about["shape"]
            return Source(
                name=described_paths(paths), groups=[group], about=about, shape=(height, width)
            )
    groups = sequence_files(frame_files(paths, read, least=1), None)
    _check_one_time(groups)
    height, width = read.plane(groups[-1].files[0], None)[0].shape
    return Source(name=described_paths(paths), groups=groups, about=None, shape=(height, width))


def _check_one_time(groups: list[FrameFiles]) -> None:
    """Refuse sequences, because frames of different times are not renders of one view."""
    for group in groups:
        if group.times > 1:
            raise ParameterError(
                f"The frames like {group.files[0]} are sequences of {group.times} times; give the "
                "frames of one time, such as '*_t012.exr'."
            )


def _header(file: Path) -> dict[str, Any] | None:
    """Return the header of a stored reference, or None for other EXR files."""
    try:
        about = json.loads(str(exr_attributes(file).get("comments")))
    except ValueError:
        return None
    return about if isinstance(about, dict) and about.get(_MARK) == 1 else None


def finest_size(sources: Sequence[tuple[Source, int | None]]) -> int:
    """Return the width of the finest tiles: 1 pixel, or more to limit the memory."""
    size = max(source.finest for source, _ in sources)
    height, width = sources[0][0].shape
    frames = sum(source.count(spp) for source, spp in sources)
    while frames * (height // size) * (width // size) > _MOST:
        size *= 2
    return size


def read_set(source: Source, spp: int | None, size: int, read: FrameReader) -> FrameSet:
    """Read the frames with one number of samples per pixel, one file at a time.

    Parameters
    ----------
    source
        Frames that are not read yet, from `source_of`.
    spp
        Samples per pixel; one of the numbers in the source.
    size
        Width of the tiles; a power of two.
    read
        How files are read.
    """
    if source.about is not None:
        return _stored(source, spp, size)
    group = next(each for each in source.groups if each.spp == spp)
    rows = np.empty((len(group.files), source.shape[0] // size, source.shape[1] // size), "f4")
    shape, channels = None, []
    bad = np.zeros(source.shape, bool)
    for k, file in enumerate(group.files):
        plane, image = read.plane(file, shape)
        shape = image.shape
        bad |= ~np.isfinite(plane)
        channels.append(np.nanmean(image, axis=(0, 1)) if np.isfinite(plane).any() else np.nan)
        if np.ndim(channels[-1]) == 0:
            raise ParameterError(f"{file} has no finite pixel; leave it out.")
        with np.errstate(over="ignore"):  # values beyond the range of float32 count as infinite
            rows[k] = coarsened(plane, size)
        rows[k][~np.isfinite(rows[k])] = np.nan
        report("frames", k / len(group.files))
    return FrameSet(
        name=source.name,
        spp=spp,
        names=[str(file) for file in group.files],
        rows=rows,
        size=size,
        shape=source.shape,
        channels=np.array(channels, float),
        missing=int(bad.sum()),
    )


def coarsened(planes: Array, size: int) -> Array:
    """Return means over tiles (…, y // size, x // size); NaN where a pixel is NaN."""
    if size == 1:
        return planes
    height, width = (each // size for each in planes.shape[-2:])
    cut = planes[..., : height * size, : width * size]
    parts = cut.reshape(*planes.shape[:-2], height, size, width, size)
    return np.asarray(parts.mean(axis=(-3, -1)))


def write_reference(
    paths: Frames,
    file: str | PathLike[str],
    *,
    spp: int | None = None,
    layer: str | None = None,
    tone_mapped: bool = False,
) -> Path:
    """Store frames as one reference file for `gate`: mean, variance, and small pictures.

    Parameters
    ----------
    paths
        A folder, a pattern, or a list of at least two files, as for `frames`.
        If the frames have several numbers of samples per pixel, the largest is stored.
    file
        Name of the reference, which ends in ``.exr``.
    spp, layer, tone_mapped
        Same as in `gate`.

    Returns
    -------
    Path
        The written file. Its layers are the mean image, ``variance`` of the luminance of one frame,
        and the mosaics ``frames0``, ``frames1``, … of 16 frames each.

    Raises
    ------
    FileFormatError
        If a frame cannot be read, or the reference cannot be written.
    ParameterError
        If there are fewer than two frames, or the image is narrower than 4 pixels.
    """
    target = check_image_path(file, (".exr",))
    read = FrameReader(layer=layer, tone_mapped=tone_mapped, spp=spp)
    group = frame_files(paths, read)[-1]
    _check_one_time(sequence_files([group], None))
    files, shape = group.files, None
    rows, channels = [], []
    total: Any = 0.0
    mean: Any = 0.0
    squares: Any = 0.0
    for k, each in enumerate(files):
        plane, image = read.plane(each, shape)
        shape = image.shape
        if min(plane.shape) < TILE:
            raise ParameterError(
                f"{each} has the size {plane.shape}; a reference needs at least {TILE} pixels "
                "along each side."
            )
        # Welford's update of the mean and the sum of squared deviations
        change = plane - mean
        mean = mean + change / (k + 1)
        squares = squares + change * (plane - mean)
        total = total + image
        rows.append(coarsened(plane, TILE).astype(np.float32))
        channels.append(np.nanmean(image, axis=(0, 1)).tolist())
        report("frames", k / len(files))
    image = total / len(files)
    layers = {"": image if image.shape[2] == 3 else image[..., 0]}
    layers["variance"] = squares / (len(files) - 1)
    height, width = mean.shape
    tall, wide = height // TILE, width // TILE
    for first in range(0, len(files), _ACROSS**2):
        plane = np.zeros((height, width), np.float32)
        for k, row in enumerate(rows[first : first + _ACROSS**2]):
            y, x = (k // _ACROSS) * tall, (k % _ACROSS) * wide
            plane[y : y + tall, x : x + wide] = row
        layers[f"frames{first // _ACROSS**2}"] = plane
    about = {
        _MARK: 1,
        "spp": group.spp,
        "shape": [height, width],
        "names": [each.name for each in files],
        "channels": channels,
        "missing": int(np.isnan(mean).sum()),
    }
    write_exr(target, layers, comment=json.dumps(about))
    return target


def _stored(source: Source, spp: int | None, size: int) -> FrameSet:
    """Read the frames of a stored reference from its mosaics."""
    about, file = source.about, source.groups[0].files[0]
    assert about is not None
    height, width = source.shape
    tall, wide = height // TILE, width // TILE
    rows = np.empty((len(about["names"]), tall, wide), np.float32)
    plane: Array = np.empty((0, 0))
    for k in range(len(rows)):
        if k % _ACROSS**2 == 0:
            layer = f"frames{k // _ACROSS**2}"
            plane = luminance(read_image(file, layer=layer, finite=False))
            if plane.shape != (height, width):
                raise FileFormatError(f"{file} is a damaged reference; make it again.")
        own = k % _ACROSS**2
        y, x = (own // _ACROSS) * tall, (own % _ACROSS) * wide
        rows[k] = plane[y : y + tall, x : x + wide]
    return FrameSet(
        name=source.name,
        spp=spp,
        names=list(about["names"]),
        rows=coarsened(rows, size // TILE),
        size=size,
        shape=source.shape,
        channels=np.array(about["channels"], float),
        missing=int(about["missing"]),
    )
