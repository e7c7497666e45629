"""What lies in a journal's file: an index of its sound records, and the names of the others."""

from __future__ import annotations

import hashlib
import itertools
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import msgspec

from mcspectra.core.errors import StoreError
from mcspectra.studies._records import Damage, Found, Record, scan

__all__ = ["MAGIC", "OtherRun", "Survey", "study_digest", "survey"]

MAGIC = b"mcspectra journal 1\n"
"""First line of the file."""

_PIECE = 2**20


class OtherRun(StoreError):
    """A journal has another header than the one that is asked for."""


def study_digest(header: dict[str, Any]) -> bytes:
    """Eight bytes that stand for the header in every record."""
    return hashlib.sha256(msgspec.json.encode(header, order="sorted")).digest()[:8]


@final
@dataclass(frozen=True)
class Survey:
    """What lies in a journal: records by key, names of damage, offset of a torn tail, bytes."""

    index: dict[str, Record]
    damaged: tuple[str, ...]
    torn: int | None
    size: int


def survey(path: Path, header: dict[str, Any] | None, *, verify: bool) -> Survey:
    """Read through a journal, without its payloads in memory."""
    with path.open("rb", buffering=_PIECE) as file:
        size = os.fstat(file.fileno()).st_size
        line = file.read(len(MAGIC))
        found = scan(file, min(len(MAGIC), size), size, verify=verify)
        first = next(found, None)
        damaged = _checked_format(line, first, path)
        study = _checked_study(first, header, path)
        if isinstance(first, Record) and first.head.key == "":
            return _indexed(found, study, damaged, size)
        every = itertools.chain([first], found) if isinstance(first, Record) else found
        return _indexed(every, study, (*damaged, "header"), size)


def _indexed(
    found: Iterable[Found], study: bytes | None, damaged: tuple[str, ...], size: int
) -> Survey:
    """The last record of each key; one of another study counts as damaged."""
    index: dict[str, Record] = {}
    names, torn = list(damaged), None
    for each in found:
        if isinstance(each, Damage):
            torn = each.start if each.torn else torn
            names += [] if each.torn else [each.name]
        elif study not in (None, each.study):
            names.append(each.head.key)
        elif each.head.key:
            index[each.head.key] = each
    return Survey(index, tuple(names), torn, size)


def _checked_study(first: Found | None, header: dict[str, Any] | None, path: Path) -> bytes | None:
    """Digest of the study that the records must have; None if nothing says it."""
    given = None if header is None else study_digest(header)
    if not isinstance(first, Record) or first.head.key:
        return given
    if given is not None and first.study != given:
        other = ", ".join(_differing(first.head.info, header or {}))
        raise OtherRun(
            f"The journal {str(path)!r} belongs to another run ({other} differ); give another --out."
        )
    return first.study


def _differing(one: dict[str, Any], two: dict[str, Any]) -> list[str]:
    """Keys whose values differ as JSON, or are in one only."""
    text = [{key: msgspec.json.encode(value) for key, value in each.items()} for each in (one, two)]
    return [key for key in sorted({*one, *two}) if text[0].get(key) != text[1].get(key)]


def _checked_format(line: bytes, first: Found | None, path: Path) -> tuple[str, ...]:
    """Refuse a journal of another format; name the line if it is damaged."""
    name = MAGIC[:-2]
    other = line.startswith(name) and line != MAGIC and line[len(name) : -1].isdigit()
    if other and not isinstance(first, Record):
        raise StoreError(
            f"{str(path)!r} has journal format {line[len(name) : -1].decode()}; this version reads 1: "
            "give another --out."
        )
    return () if line == MAGIC else ("first line",)
