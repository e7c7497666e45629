"""Point-set files: UTK text and binary, npz, csv, parquet, each a list of sets of points.

============  ====================================================================================
``.dat``      UTK text: a point a line, coordinates between blanks; a line that begins
              with ``#`` starts the next set (at the top of the file it is a comment)
``.bin``      UTK binary: five 32-bit words (magic 0x214B5455 = "UTK!", type code, number
              of sets, of points in a set, of dims), then all coordinates in order
``.npz``      array ``points`` of shape (n, d) or (R, n, d), text ``meta`` (JSON)
``.csv``      commas or semicolons, optional line of names; sets in a column ``set``, else
              between blank lines
``.parquet``  columns of numbers, one for each axis; sets in a column ``set``; written
              with ``x0``, ``x1``, …; needs pyarrow
============  ====================================================================================

UTK is the Uni{corn|form} toolkit, https://github.com/utk-team/utk, whose
``include/utk/utils/PointsetIO.hpp`` defines its formats: the type codes are 0 int32, 1 int64,
2 uint32, 3 uint64, 4 float, 5 double, in the first byte of the second word; bytes are in the
writer's order, which the magic word shows. Integers are read as fractions of their type's range.

The sets of a file may differ in size; whether coordinates lie in [0,1) is for samplers to say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from mcspectra.core._pointbytes import format_bin, format_npz, read_bin, read_npz
from mcspectra.core._pointparquet import format_parquet, read_parquet
from mcspectra.core._pointtext import format_csv, format_dat, parse_dat, read_csv, read_dat
from mcspectra.core.checks import Array
from mcspectra.core.errors import FileFormatError

__all__ = ["EXTENSIONS", "format_dat", "parse_dat", "read_points", "write_points"]

EXTENSIONS = (".dat", ".bin", ".npz", ".csv", ".parquet")
"""The file name extensions that `read_points` and `write_points` know."""


def read_points(path: str | PathLike[str]) -> list[Array]:
    """Read the point sets of a file: float64 arrays of shape (n, d), one for each set.

    Raises
    ------
    FileFormatError
        The file is missing, empty, truncated, of an unknown or another format, or holds
        something else than finite numbers; the message names the line or the byte.
    """
    file, extension = _file(path)
    try:
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise FileFormatError(f"{file} is a device or a pipe; give a point-set file.")
        return _READERS[extension](file)
    except FileNotFoundError:
        raise FileFormatError(f"There is no file {file}; give the path of a point set.") from None
    except IsADirectoryError:
        raise FileFormatError(f"{file} is a folder; give a point-set file.") from None
    except OSError as error:
        raise FileFormatError(f"{file} cannot be read: {error.strerror or error}.") from None


def write_points(
    path: str | PathLike[str], sets: Iterable[object], *, meta: Mapping[str, Any] | None = None
) -> None:
    """Write point sets, arrays of shape (n, d), in the format of the file name's extension.

    Parameters
    ----------
    path
        File to write; an existing one is replaced.
    sets
        One array (n, d) for each set; ``.bin`` and ``.npz`` need sets of equal shape.
    meta
        What to say about the points, as JSON: kept by ``.npz``, ``.parquet`` and, as a comment, by
        ``.dat``; the other formats have no place for it.

    Raises
    ------
    FileFormatError
        Unknown extension, sets that do not fit the format, or a file that cannot be written.
    """
    file, extension = _file(path)
    content = _encoded(extension, _clean_sets(sets, str(file)), meta, str(file))
    try:
        file.write_bytes(content)
    except OSError as error:
        raise FileFormatError(f"{file} cannot be written: {error.strerror or error}.") from None


def _file(path: object) -> tuple[Path, str]:
    """Return the path and its extension, one of `EXTENSIONS`."""
    if not isinstance(path, str | PathLike) or "\0" in str(path):
        raise FileFormatError(f"{path!r} is not a path; give the name of a point-set file.")
    file = Path(path)
    extension = file.suffix.lower()
    if extension not in EXTENSIONS:
        given = f"the extension {file.suffix!r}" if file.suffix else "no extension"
        raise FileFormatError(f"{file} has {given}; point sets are {', '.join(EXTENSIONS)} files.")
    return file, extension


def _clean_sets(sets: Iterable[object], name: str) -> list[Array]:
    """Return the sets as float64 arrays (n, d)."""
    clean = []
    for k, points in enumerate(sets):
        try:
            array = np.asarray(points, dtype=np.float64)
        except (TypeError, ValueError):
            raise FileFormatError(f"Set {k} for {name} is not an array of numbers.") from None
        if array.ndim != 2 or array.size == 0 or not np.isfinite(array).all():
            raise FileFormatError(
                f"Set {k} for {name} has shape {array.shape}; give finite numbers of shape (n, d)."
            )
        clean.append(array)
    if not clean:
        raise FileFormatError(f"There are no sets to write to {name}; give at least one.")
    return clean


def _encoded(extension: str, sets: list[Array], meta: Mapping[str, Any] | None, name: str) -> bytes:
    if extension == ".dat":
        return format_dat(sets, meta).encode()
    if extension == ".csv":
        return format_csv(sets, name).encode()
    if extension == ".parquet":
        return format_parquet(sets, meta or {}, name)
    return format_npz(sets, meta or {}, name) if extension == ".npz" else format_bin(sets, name)


_READERS: dict[str, Callable[[Path], list[Array]]] = {
    ".dat": read_dat,
    ".bin": read_bin,
    ".npz": read_npz,
    ".csv": read_csv,
    ".parquet": read_parquet,
}
