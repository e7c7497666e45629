"""Checksums of a stored cell: of all of its files together, and of each."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeAlias

import msgspec

__all__ = ["Checksum", "checksum", "checksum_of", "damage_of"]

_PIECE = 2**20

_Digest: TypeAlias = tuple[int, str, int]
"""Bytes, SHA-256 and CRC-32 of a file."""


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
    return _together(
        (file.relative_to(group).as_posix(), _digest(_pieces(file))) for file in _files(group)
    )


def checksum_of(files: Mapping[str, bytes]) -> Checksum:
    """Checksum of a cell of these files, by their paths inside, before they are written."""
    return _together((name, _digest([files[name]])) for name in sorted(files))


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


def _together(digests: Iterable[tuple[str, _Digest]]) -> Checksum:
    whole, parts, total = hashlib.sha256(), [], 0
    for name, (size, sha256, crc) in digests:
        whole.update(f"{name}\0{size}\0{sha256}\n".encode())
        parts.append(f"{crc:08x}")
        total += size
    return Checksum(whole.hexdigest(), "".join(parts), total)


def _pieces(file: Path) -> Iterator[bytes]:
    with file.open("rb") as stream:
        while piece := stream.read(_PIECE):
            yield piece


def _digest(pieces: Iterable[bytes]) -> _Digest:
    """Digest of a file, piece by piece."""
    size, sha256, crc = 0, hashlib.sha256(), 0
    for piece in pieces:
        size += len(piece)
        sha256.update(piece)
        crc = zlib.crc32(piece, crc)
    return size, sha256.hexdigest(), crc
