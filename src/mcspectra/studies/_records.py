"""Records of a journal: how they are laid out in the file, and found again in a damaged one.

A record is a prefix (marker, digest of the study, two lengths, their CRC-32), a head (JSON: key,
error, information, SHA-256 of the payload), the first half of the SHA-256 of prefix and head, and
the payload. So every byte is under a checksum, lengths are checked before anything is read by them,
and after a damaged prefix the next record is found by its marker.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterator
from typing import Any, BinaryIO, TypeAlias

import msgspec

from mcspectra.core.errors import StoreError

__all__ = [
    "MOST_PAYLOAD",
    "Damage",
    "Found",
    "Head",
    "Record",
    "encode_record",
    "scan",
]

MOST_PAYLOAD = 2**32
"""Bytes of the largest payload: 4 GiB."""

_MARKER = b"\xf1mcsRec\n"
_LENGTHS = struct.Struct("<8s8sIQ")  # marker, study, bytes of the head, bytes of the payload
_CRC = struct.Struct("<I")
_PREFIX = _LENGTHS.size + _CRC.size
_CHECK = 16
_MOST_HEAD = 2**20
_PIECE = 2**20


class Head(msgspec.Struct, frozen=True):
    """What a record says of itself.

    Attributes
    ----------
    key
        Name of the task.
    sha256
        Of the payload, hexadecimal.
    error
        Sentence of a task that failed; such a record has no payload.
    info
        Whatever else is to be known: seconds, host.
    """

    key: str
    sha256: str
    error: str | None = None
    info: dict[str, Any] = {}


class Record(msgspec.Struct, frozen=True, gc=False):
    """A sound record: its study's digest, its head, and where it lies in the file."""

    study: bytes
    head: Head
    start: int
    payload: int
    end: int


class Damage(msgspec.Struct, frozen=True):
    """Bytes that are no sound record; `torn` if they are the beginning of one at the file's end."""

    name: str
    start: int
    end: int
    torn: bool = False


Found: TypeAlias = Record | Damage


def encode_record(study: bytes, head: Head, payload_bytes: int) -> bytes:
    """All of a record but its payload; `study` is the digest of the study, 8 bytes.

    Raises
    ------
    StoreError
        The head is too large.
    """
    text = msgspec.json.encode(head)
    if len(text) > _MOST_HEAD:
        raise StoreError(
            f"What is noted with {head.key[:60]!r} has {len(text):,} bytes; {_MOST_HEAD:,} are the most."
        )
    lengths = _LENGTHS.pack(_MARKER, study, len(text), payload_bytes)
    start = lengths + _CRC.pack(zlib.crc32(lengths)) + text
    return start + hashlib.sha256(start).digest()[:_CHECK]


def scan(file: BinaryIO, start: int, size: int, *, verify: bool) -> Iterator[Found]:
    """Yield what lies between two offsets of a file, in its order, without holding payloads.

    `verify` checks the payloads too, which reads all of the file.
    """
    while start < size:
        found = _found_at(file, start, size, verify)
        yield found
        start = found.end


def _found_at(file: BinaryIO, start: int, size: int, verify: bool) -> Found:
    file.seek(start)
    prefix = file.read(min(_PREFIX, size - start))
    if len(prefix) < _PREFIX:
        return Damage(_place(start), start, size, torn=True)
    lengths = _lengths(prefix)
    if lengths is None:
        return Damage(_place(start), start, _next_record(file, start + 1, size))
    payload = start + _PREFIX + lengths[0] + _CHECK
    end = payload + lengths[1]
    if end > size:  # unless other records follow, what comes of a crash while writing
        after = _next_record(file, start + 1, size)
        return Damage(_place(start), start, after, torn=after == size)
    head = _head(prefix, file.read(lengths[0] + _CHECK))
    if head is None:
        return Damage(_place(start), start, end)
    if verify and _digest(file, lengths[1]) != head.sha256:
        return Damage(head.key, start, end)
    return Record(prefix[8:16], head, start, payload, end)


def _lengths(prefix: bytes) -> tuple[int, int] | None:
    """Bytes of head and payload, or None if this is no prefix or one that claims too much."""
    marker, _, head, payload = _LENGTHS.unpack_from(prefix)
    sound = marker == _MARKER and _CRC.unpack_from(prefix, _LENGTHS.size)[0] == zlib.crc32(
        prefix[: _LENGTHS.size]
    )
    return (head, payload) if sound and head <= _MOST_HEAD and payload <= MOST_PAYLOAD else None


def _head(prefix: bytes, text_and_check: bytes) -> Head | None:
    text, check = text_and_check[:-_CHECK], text_and_check[-_CHECK:]
    if hashlib.sha256(prefix + text).digest()[:_CHECK] != check:
        return None
    try:
        return msgspec.json.decode(text, type=Head)
    except (msgspec.DecodeError, RecursionError):
        return None


def _digest(file: BinaryIO, length: int) -> str:
    """SHA-256 of the next `length` bytes of a file, read piece by piece."""
    found = hashlib.sha256()
    while length > 0:
        piece = file.read(min(_PIECE, length))
        if not piece:
            break
        found.update(piece)
        length -= len(piece)
    return found.hexdigest()


def _next_record(file: BinaryIO, start: int, size: int) -> int:
    """Offset of the first sound prefix from `start` on; `size` if there is none."""
    while size - start >= _PREFIX:
        file.seek(start)
        piece = file.read(min(_PIECE, size - start))
        at = piece.find(_MARKER)
        while at >= 0:
            file.seek(start + at)
            prefix = file.read(_PREFIX)
            if len(prefix) == _PREFIX and _lengths(prefix) is not None:
                return start + at
            at = piece.find(_MARKER, at + 1)
        start += max(len(piece) - len(_MARKER) + 1, 1)  # a marker may lie across two pieces
    return size


def _place(start: int) -> str:
    return f"record at byte {start}"
