"""Checksums of a stored cell: of all of its files together, and of each."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator
from pathlib import Path

import msgspec

__all__ = ["Checksum", "checksum", "damage_of"]

_PIECE = 2**20


class Checksum(msgspec.Struct, frozen=True):
    """SHA-256 over names, sizes and bytes of all files, CRC-32 of each (hexadecimal), all bytes."""

    sha256: str
    parts: str
    bytes: int


def checksum(group: Path) -> Checksum:
    """Checksum of a cell: its metadata (names, dtypes, shapes, attributes) and its chunks.

    Raises
    ------
    OSError
        A file cannot be read.
    """
    whole, parts, total = hashlib.sha256(), [], 0
    for file in _files(group):
        size, sha256, crc = _digest(file)
        whole.update(f"{file.relative_to(group).as_posix()}\0{size}\0{sha256}\n".encode())
        parts.append(f"{crc:08x}")
        total += size
    return Checksum(whole.hexdigest(), "".join(parts), total)


def damage_of(group: Path, expected: Checksum) -> str | None:
    """What is wrong with a cell, in words that name its file; None if nothing is."""
    if not (group / "zarr.json").is_file():
        return "it is gone"
    try:
        found = checksum(group)
    except OSError as error:
        return f"it cannot be read ({error.strerror})"
    if found.sha256 == expected.sha256:
        return None
    if len(found.parts) != len(expected.parts):
        return f"{len(found.parts) // 8} of {len(expected.parts) // 8} files are there"
    changed = [
        file.relative_to(group).as_posix()
        for i, file in enumerate(_files(group))
        if found.parts[8 * i : 8 * i + 8] != expected.parts[8 * i : 8 * i + 8]
    ]
    return f"{', '.join(changed[:3]) or 'a file'} has changed"


def _files(group: Path) -> list[Path]:
    return sorted(_regular(group), key=lambda file: file.relative_to(group).as_posix())


def _regular(group: Path) -> Iterator[Path]:
    return (file for file in group.rglob("*") if file.is_file())


def _digest(file: Path) -> tuple[int, str, int]:
    """Bytes, SHA-256 and CRC-32 of a file, read piece by piece."""
    size, sha256, crc = 0, hashlib.sha256(), 0
    with file.open("rb") as stream:
        while piece := stream.read(_PIECE):
            size += len(piece)
            sha256.update(piece)
            crc = zlib.crc32(piece, crc)
    return size, sha256.hexdigest(), crc
