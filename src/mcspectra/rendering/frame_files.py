"""Files of frames: find them, group them by samples per pixel, and read their values.

Frames are independent renders of one view, one file each, by any renderer.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from glob import glob
from os import PathLike
from pathlib import Path
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array, is_path
from mcspectra.core.display import QUOTED, printable
from mcspectra.core.errors import FileFormatError, Parameter, ParameterError
from mcspectra.core.images import (
    ENCODED_EXTENSIONS,
    LINEAR_EXTENSIONS,
    exr_attributes,
    luminance,
    read_image,
)

__all__ = ["MOST_SPP", "FrameFiles", "FrameReader", "Frames", "described_paths", "frame_files"]

Frames = str | PathLike[str] | Sequence[str | PathLike[str]]
"""Frames: a folder, a file name pattern, or a list of files."""

MOST_SPP = 2**40
_SPP = re.compile(r"(?<![a-z0-9])(?:spp[_-]?(\d+)|(\d+)[_-]?spp)(?![a-z0-9])", re.IGNORECASE)


@final
@dataclass(frozen=True, kw_only=True)
class FrameReader:
    """Reads frames according to the options."""

    layer: str | None
    tone_mapped: bool
    spp: int | None

    def color(self, file: Path) -> Array:
        """Return the values of a frame (y, x, 1 or 3), with NaN for nonfinite values."""
        if file.suffix.lower() in ENCODED_EXTENSIONS and not self.tone_mapped:
            raise FileFormatError(
                f"{file} is a tone-mapped picture, which no longer has the renderer's noise; give "
                "EXR, PFM or .npy, or set tone_mapped=True (--tone-mapped) to undo the sRGB curve."
            )
        image = read_image(file, layer=self.layer, finite=False)
        image[~np.isfinite(image)] = np.nan
        return image[..., :3] if image.shape[2] > 2 else image[..., :1]

    def plane(self, file: Path, shape: tuple[int, ...] | None) -> tuple[Array, Array]:
        """Check the shape of a frame, and return its luminance (y, x) and its colors."""
        image = self.color(file)
        if shape is not None and image.shape != shape:
            raise ParameterError(
                f"{file} has the shape {image.shape}, but earlier frames have {shape}; give "
                "frames of one view."
            )
        return luminance(image), image

    def about(self, file: Path) -> tuple[int | None, float | None]:
        """Return samples per pixel and seconds of a frame, if its name or header contains them."""
        named = _SPP.search(file.stem) or _SPP.search(file.parent.name)
        own = int(named[1] or named[2]) if named else None
        told, seconds = None, None
        header = exr_attributes(file) if file.suffix.lower() == ".exr" else {}
        try:
            for key, value in header.items():
                if key == "samplesPerPixel" or re.fullmatch(r"cycles\..*\.samples", key):
                    told = told or int(str(value))
                elif key == "renderTimeSeconds":
                    seconds = float(str(value))
                elif key == "RenderTime":  # Blender's format is [hours:]minutes:seconds
                    parts = reversed(str(value).split(":"))
                    seconds = sum(float(part) * 60.0**k for k, part in enumerate(parts))
        except ValueError:
            raise FileFormatError(
                f"{file} has {key} = {value!r} in its header; give ",
                Parameter("spp"),
                " and ",
                Parameter("seconds"),
                ".",
            ) from None
        spp = told if own is None else own
        if self.spp is None and None not in (own, told) and own != told:
            raise ParameterError(
                f"{file} has {own} samples per pixel in its name and {told} in its header; give ",
                Parameter("spp"),
                ", or change the name.",
            )
        if self.spp is None and spp is not None and not 1 <= spp <= MOST_SPP:
            raise ParameterError(
                f"{file} has {spp} samples per pixel in its name or header; give ",
                Parameter("spp"),
                ".",
            )
        return spp, seconds if seconds and seconds > 0 else None


@final
@dataclass(frozen=True, kw_only=True)
class FrameFiles:
    """Frames with the same number of samples per pixel.

    Attributes
    ----------
    spp
        Samples per pixel, or None if neither names nor headers contain them.
    files
        Files in order of their names.
    seconds
        Mean render time of a frame, or None if no header contains it.
    times
        Number of frames of each sequence. The files of a sequence are adjacent in the list.
        Frames without a sequence count as sequences of one frame.
    numbers
        Numbers of the frames of a sequence; empty without a sequence.
    """

    spp: int | None
    files: list[Path]
    seconds: float | None
    times: int = 1
    numbers: tuple[int, ...] = ()


def frame_files(paths: Frames, read: FrameReader, *, least: int = 2) -> list[FrameFiles]:
    """Group files by number of samples per pixel, ascending.

    Parameters
    ----------
    paths
        A folder, a pattern, or a list of files.
    read
        Options for reading the files. Samples per pixel given here are assumed for all files.
    least
        Least number of files per group, 1 or 2.

    Returns
    -------
    list of FrameFiles
        At least one group, each with at least `least` files.

    Raises
    ------
    FileFormatError
        If there are no files, or a header is broken.
    ParameterError
        If a group has too few files, or the samples per pixel in names or headers disagree.
    """
    groups: dict[int | None, list[tuple[Path, float | None]]] = defaultdict(list)
    for file in _listed_files(paths):
        spp, seconds = read.about(file)
        groups[spp].append((file, seconds))
    if read.spp is not None:
        told = sorted(spp for spp in groups if spp is not None)
        if len(told) > 1:
            raise ParameterError(
                Parameter("spp"),
                f" is {read.spp}, but the frames have {' and '.join(map(str, told))} samples per "
                "pixel in their names or headers; give frames with one number of samples, or "
                "leave ",
                Parameter("spp"),
                " out.",
            )
        groups = {read.spp: [each for members in groups.values() for each in members]}
    if None in groups and len(groups) > 1:
        raise ParameterError(
            f"{groups[None][0][0]} has no number of samples per pixel in its name, but other "
            "frames do; rename it, such as x_64spp.exr, or give ",
            Parameter("spp"),
            ".",
        )
    for spp, members in groups.items():
        if len(members) < least:
            count = "" if spp is None else f" of {spp} samples per pixel"
            raise ParameterError(
                f"There is one frame{count}, {members[0][0]}; give two or more independent renders "
                "of each number of samples."
            )
    found = []
    for spp, members in sorted(groups.items(), key=lambda item: item[0] or 0):
        known = [seconds for _, seconds in members if seconds is not None]
        found.append(
            FrameFiles(
                spp=spp,
                files=[file for file, _ in members],
                seconds=float(np.mean(known)) if known else None,
            )
        )
    return found


def _listed_files(paths: Any) -> list[Path]:
    """Return the files of a folder, a pattern or a list, in order."""
    if not isinstance(paths, str | PathLike):
        if not isinstance(paths, Sequence) or not paths or not all(map(is_path, paths)):
            raise ParameterError(f"paths is {paths!r:.80}; give a folder, a pattern or files.")
        if folder := next((each for each in paths if Path(each).is_dir()), None):
            raise ParameterError(
                f"{folder} is a folder in a list; give one folder alone, or files such as "
                f"{folder}/*.exr."
            )
        return [Path(each) for each in paths]
    place = Path(paths)
    if not place.is_dir():
        named = glob(str(paths), recursive=True)  # noqa: PTH207 - Path.glob does not accept absolute patterns
        matching = sorted(map(Path, named))
        if not matching:
            raise FileFormatError(
                f"There is no {printable(place, QUOTED)}; give a folder of frames, a pattern or "
                "files."
            )
        return matching
    inside = sorted([*place.glob("*"), *place.glob("*/*")])
    inside = [f for f in inside if f.name != "frames.exr" or not f.with_suffix(".json").exists()]
    for kinds in (
        LINEAR_EXTENSIONS,
        ENCODED_EXTENSIONS,
    ):  # PNG and JPEG files next to linear frames are only previews
        if files := [file for file in inside if file.suffix.lower() in kinds]:
            return files
    raise FileFormatError(
        f"{place} holds no {', '.join(LINEAR_EXTENSIONS + ENCODED_EXTENSIONS)} files; give a "
        "folder of frames."
    )


def described_paths(paths: Frames) -> str:
    """Return a folder, a pattern or a list of files as text."""
    return str(paths) if isinstance(paths, str | PathLike) else ", ".join(map(str, paths))
