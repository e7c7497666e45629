"""Point sets as bytes: the formats .bin (UTK) and .npz of `mcspectra.core.pointfiles`."""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import FileFormatError

__all__ = ["format_bin", "format_npz", "read_bin", "read_npz"]

_MAGIC = 0x214B5455
_HEADER_BYTES = 20
_TYPES = ("i4", "i8", "u4", "u8", "f4", "f8")
_DOUBLE = _TYPES.index("f8")


def read_bin(file: Path) -> list[Array]:
    """Read UTK binary, one array (n, d) for each set."""
    with file.open("rb") as stream:
        order, kind, shape = _bin_header(stream.read(_HEADER_BYTES), file)
        dtype = np.dtype(order + kind)
        expected = shape[0] * shape[1] * shape[2] * dtype.itemsize  # Python ints: no overflow
        found = file.stat().st_size - _HEADER_BYTES
        if found != expected:
            raise FileFormatError(
                f"{file} announces {shape[0]} sets of {shape[1]} points in {shape[2]} dims, that is "
                f"{expected} bytes after the header, but has {found}."
            )
        data = np.frombuffer(stream.read(expected), dtype).reshape(shape)
    return _finite_sets(_fractions(data), str(file))


def read_npz(file: Path) -> list[Array]:
    """Read the array ``points`` of shape (n, d) or (R, n, d), one array (n, d) for each set."""
    try:
        with zipfile.ZipFile(file) as archive:
            points = _npz_member(archive, file)
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, MemoryError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"{file} is not a sound .npz file: {error}.") from None
    if points.dtype.kind not in "fiu" or points.ndim not in (2, 3) or points.size == 0:
        raise FileFormatError(
            f"{file} holds 'points' of type {points.dtype} and shape {points.shape}; give numbers "
            "of shape (n, d) or (R, n, d)."
        )
    points = points.astype(np.float64)
    return _finite_sets(points if points.ndim == 3 else points[None], str(file))


def format_bin(sets: Sequence[Array], name: str) -> bytes:
    """Write UTK binary: doubles, lowest byte first."""
    points = _stacked(sets, name)
    return struct.pack("<5I", _MAGIC, _DOUBLE, *points.shape) + points.astype("<f8").tobytes()


def format_npz(sets: Sequence[Array], meta: Mapping[str, Any], name: str) -> bytes:
    """Write ``points`` of shape (R, n, d) and ``meta`` as JSON."""
    buffer = io.BytesIO()
    text = json.dumps(dict(meta), default=str)
    np.savez(buffer, points=_stacked(sets, name), meta=np.array(text))
    return buffer.getvalue()


def _bin_header(data: bytes, file: Path) -> tuple[str, str, tuple[int, int, int]]:
    """Return byte order, type, and (sets, points, dims)."""
    if len(data) < _HEADER_BYTES:
        raise FileFormatError(
            f"{file} ends at byte {len(data)}, within the header of {_HEADER_BYTES} bytes."
        )
    order = next((o for o in "<>" if struct.unpack_from(o + "I", data)[0] == _MAGIC), None)
    if order is None:
        raise FileFormatError(
            f"{file} starts with {data[:4].hex()}, not with the magic word 55544b21 (UTK!) of UTK "
            "binary files."
        )
    code, sizes = data[4], struct.unpack_from(order + "3I", data, 8)
    if code >= len(_TYPES):
        raise FileFormatError(
            f"{file}, byte 4: {code} is no type code; UTK has 0 to {len(_TYPES) - 1}."
        )
    if 0 in sizes:
        raise FileFormatError(
            f"{file} announces {sizes[0]} sets of {sizes[1]} points in {sizes[2]} dims; "
            "each must be at least 1."
        )
    return order, _TYPES[code], (sizes[0], sizes[1], sizes[2])


def _fractions(data: Array) -> Array:
    """Return float64, integers as fractions of their range (UTK's integer nets fill it)."""
    if data.dtype.kind == "f":
        return data.astype(np.float64)
    bits = 8 * data.dtype.itemsize - (data.dtype.kind == "i")
    spare = max(0, bits - 53)  # drop what a double cannot hold, lest 2^64 - 1 becomes 1.0
    shifted = data.astype(data.dtype.newbyteorder("=")) >> spare
    return np.ldexp(shifted.astype(np.float64), spare - bits)


def _npz_member(archive: zipfile.ZipFile, file: Path) -> Array:
    """Read the array ``points``, after comparing its announced size with the bytes there are."""
    try:
        info = archive.getinfo("points.npy")
    except KeyError:
        held = ", ".join(repr(n.removesuffix(".npy")) for n in archive.namelist()) or "nothing"
        raise FileFormatError(f"{file} has no array 'points'; it holds {held}.") from None
    with archive.open(info) as stream:
        shape, dtype = _npy_header(stream)
        expected = int(np.prod([int(s) for s in shape], dtype=object)) * dtype.itemsize
        if expected > info.file_size:
            raise FileFormatError(
                f"{file} announces 'points' of shape {shape}, {expected} bytes, but has "
                f"{info.file_size}."
            )
    with archive.open(info) as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))


def _npy_header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0
    shape, _, dtype = (read if version == (1, 0) else np.lib.format.read_array_header_2_0)(stream)
    return shape, dtype


def _finite_sets(points: Array, name: str) -> list[Array]:
    """Split (R, n, d) into sets after a check for NaN and infinity."""
    good = np.isfinite(points)
    if not good.all():
        where = [int(i) for i in np.argwhere(~good)[0]]
        raise FileFormatError(
            f"{name}: coordinate {where[2]} of point {where[1]} of set {where[0]} (from 0) is "
            f"{points[tuple(where)]}; give finite numbers."
        )
    return list(points)


def _stacked(sets: Sequence[Array], name: str) -> Array:
    if len({points.shape for points in sets}) > 1:
        raise FileFormatError(
            f"{name} needs sets of equal shape; write sets of different sizes as .dat or .csv."
        )
    return np.stack(sets)
