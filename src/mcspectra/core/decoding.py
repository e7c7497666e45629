"""Reading of untrusted files, with a limit on the memory for decoding.

A few kilobytes of a compressed format can expand to gigabytes.
Therefore each reader first computes the peak memory from the headers of the file.
Peak memory includes the decoding and the conversion to float64.
The reader then calls `check_decoded_size`, before it decodes anything.
"""

from __future__ import annotations

import io
import json
import math
import os
import stat
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from mcspectra.core.checks import Array, is_path
from mcspectra.core.errors import FileFormatError, McspectraError, reason_of

__all__ = [
    "check_decoded_size",
    "check_zarr",
    "known_path",
    "opened",
    "path_to_write",
    "read_npy",
    "read_npz",
]

_MOST_BYTES = 2**31
_MOST_RATIO = 64  # largest number of bytes of memory for each byte of the file
# Bytes of memory that every file may take: an uncompressed image of 3840 x 2160 pixels
_ALWAYS_READ = 2**28
_CHUNK_BYTES = 4096  # bytes assumed for each chunk of Zarr, because many tiny chunks take time
# Codecs of Zarr that only compress or reorder numbers and texts. Others, like pickle, may run code
_CODECS = {
    *("blosc", "bytes", "bz2", "crc32c", "gzip", "lz4", "lzma", "shuffle"),
    *("transpose", "vlen-utf8", "zlib", "zstd"),
}
_TEXT_BYTES = 64  # bytes of memory that are assumed for a text of unknown length
_NPY_HEADER = 2**14  # largest header of a .npy file in bytes; NumPy allows 10,000 characters


def known_path(path: object, what: str, extensions: Sequence[str] = ()) -> Path:
    """Return `path` as a `Path`. In error messages, the file is called `what`.

    If `extensions` are given, the name of the file must end in one of them.

    Raises
    ------
    FileFormatError
        If `path` is not a path, or has another extension.
    """
    if not is_path(path) or not str(path):
        raise FileFormatError(f"{path!r:.80} is not a path, or too long; give the path of {what}.")
    file = Path(path)  # type: ignore[arg-type]
    if extensions and file.suffix.lower() not in extensions:
        raise FileFormatError(
            f"{file} does not end in one of {', '.join(extensions)}; give {what}."
        )
    return file


def path_to_write(path: object, what: str, extensions: Sequence[str]) -> Path | None:
    """Check before the work starts that a file can be written. Return its path, or None.

    Raises
    ------
    FileFormatError
        If the path has another extension (see `known_path`), or is a folder.
        If the folder of the file does not exist, or cannot be written.
    """
    if path is None:
        return None
    file = known_path(path, what, extensions)
    if file.is_dir() or not os.access(file if file.exists() else file.parent, os.W_OK):
        raise FileFormatError(
            f"{str(file)!r} cannot be written; give {what} in a folder that exists and can be "
            "written."
        )
    return file


@contextmanager
def opened(
    path: object, what: str, extensions: Sequence[str] = ()
) -> Iterator[tuple[IO[bytes], int, str, str]]:
    """Open a file for a parser. Yield its stream, size, name for messages, and extension.

    Raises
    ------
    FileFormatError
        If the path has another extension (see `known_path`), or if the file does not exist.
        If the file is a folder or a device, or if parsing fails.
    """
    file = known_path(path, what, extensions)
    try:
        status = file.stat()
        if not stat.S_ISREG(status.st_mode):
            kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a device or a pipe"
            raise FileFormatError(f"{file} is {kind}; give the path of {what}.")
        with file.open("rb") as stream:
            yield stream, status.st_size, str(file), file.suffix.lower()
    except McspectraError:
        raise
    except FileNotFoundError:
        raise FileFormatError(f"There is no file {file}; give the path of {what}.") from None
    except Exception as error:  # noqa: BLE001 - parsers raise any error for a broken file
        said = f"it is truncated, damaged or of another format ({reason_of(error, 200)})"
        # Prefer the message of the operating system
        reason = getattr(error, "strerror", None) or said
        raise FileFormatError(f"{file} cannot be read as {what}: {reason}.") from None


def check_decoded_size(name: object, size: int, decoded: float) -> None:
    """Reject a file of `size` bytes if reading takes too much memory. The peak is `decoded` bytes.

    Raises
    ------
    FileFormatError
        If `decoded` exceeds 2 GiB, or exceeds both 256 MiB and 64 times the file's size.
    """
    most = min(_MOST_BYTES, max(_ALWAYS_READ, _MOST_RATIO * size))
    if decoded > most:
        raise FileFormatError(
            f"{name}, of {size} bytes, would take {decoded / 1e6:,.0f} MB of memory to read; a "
            f"file of this size may take {most / 1e6:,.0f} MB: make a smaller version of it."
        )


def read_npy(stream: IO[bytes], size: int, name: str, held: int | None = None) -> Array:
    """Return the array of a .npy stream from a file of `size` bytes.

    `held` is the number of bytes in the stream, if it is only a part of the file.

    Raises
    ------
    FileFormatError
        If the array takes too much memory, or the header announces more bytes than the file has.
    ValueError
        If the stream is not a .npy stream, or contains Python objects.
    """
    header = io.BytesIO(stream.read(_NPY_HEADER))
    first = np.lib.format.read_magic(header) == (1, 0)
    read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(header)
    count, held = math.prod(shape), size if held is None else held
    if min(shape, default=0) < 0 or count * dtype.itemsize > held:
        raise FileFormatError(
            f"{name} announces an array of shape {shape}, {count * dtype.itemsize} bytes, but has "
            f"{held}."
        )
    # Peak memory: the array, a float64 copy if the type differs, and two masks
    check_decoded_size(name, size, count * (dtype.itemsize + 8 * (dtype != np.float64) + 2))
    stream.seek(0)
    return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))


def read_npz(
    stream: IO[bytes], size: int, name: str, array: str, *, or_only: bool = False
) -> Array:
    """Return the array called `array` of a .npz file.

    With `or_only`, a single array in the file may have another name.

    Raises
    ------
    FileFormatError
        If there is no such array, or if its compression method is not one of NumPy's.
        If `read_npy` rejects the array.
    """
    with zipfile.ZipFile(stream) as archive:
        names = [entry[:-4] for entry in archive.namelist() if entry.endswith(".npy")]
        if or_only and len(names) == 1:
            array = names[0]
        if array not in names:
            found = ", ".join(map(repr, names))[:200] or "nothing"
            raise FileFormatError(
                f"{name} has no array {array!r}; it holds {found}: rename the intended "
                f"array to {array!r}."
            )
        member = archive.getinfo(f"{array}.npy")
        # Reject other compression methods, because the size of their content could not be limited
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise FileFormatError(f"{name} is not compressed as NumPy does; use savez_compressed.")
        with archive.open(member) as content:
            return read_npy(content, size, name, member.file_size)


def check_zarr(folder: Path) -> None:
    """Check a Zarr store of format 2 or 3 before another reader opens it.

    The reader must ignore consolidated metadata, which this function does not check.

    Raises
    ------
    FileFormatError
        If the store has links, devices or pipes, or takes too much memory.
        If a codec of an array does more than compress and reorder.
    ValueError, LookupError, TypeError, OSError
        If a document of the store (its JSON metadata) cannot be read.
    """
    size, decoded = 0, 0.0
    for base, *names in os.walk(folder):
        for place in (Path(base, name) for each in names for name in each):
            status = place.lstat()
            if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
                raise FileFormatError(
                    f"{place} is a link, a device or a pipe; give a store that holds files only."
                )
            size += status.st_size
            if place.name in (".zarray", "zarr.json"):
                decoded += _decoded_zarr(str(place), json.loads(place.read_bytes()))
    check_decoded_size(folder, size, decoded)


def _decoded_zarr(name: str, document: dict[str, Any]) -> float:
    """Return the memory in bytes of a Zarr array, from its metadata document; 0 for a group."""
    if document.get("node_type") == "group":
        return 0.0
    kind: Any = document.get("dtype", document.get("data_type"))
    given = [document.get("compressor"), *(document.get("filters") or ())]
    given += document.get("codecs") or ()
    codecs = {each.get("id", each.get("name")) for each in given if each is not None}
    if not codecs <= _CODECS or not isinstance(kind, str | dict):
        others = ", ".join(sorted(map(repr, codecs - _CODECS))) or f"the type {kind!r:.80}"
        raise FileFormatError(
            f"{name} needs {others:.200}, which is not read from a file: give a store whose arrays "
            "hold numbers or texts, without other codecs than compression."
        )
    width = kind["configuration"]["length_bytes"] if isinstance(kind, dict) else _TEXT_BYTES
    if isinstance(kind, str) and kind not in ("string", "|O"):
        width = np.dtype(kind).itemsize
    grid = document.get("chunk_grid") or {"configuration": {"chunk_shape": document.get("chunks")}}
    sides = list(zip(document["shape"], grid["configuration"]["chunk_shape"], strict=True))
    chunks = math.prod(math.ceil(length / max(1, chunk)) for length, chunk in sides)
    # A chunk is decoded as a whole, even if the array is smaller than the chunk
    entries = math.prod(max(length, chunk) for length, chunk in sides)
    return float(max(0, entries) * max(0, int(width)) + max(0, chunks) * _CHUNK_BYTES)
