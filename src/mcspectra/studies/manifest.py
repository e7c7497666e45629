"""The manifest of a store: which study it is, which cells are planned, which are there.

``DIR/manifest.jsonl`` is a text file that is only added to: a line of JSON and its CRC-32 for each
event. It is the index of the store: 100,000 cells are listed by reading one file. A cell's line comes
before the cell is renamed into place, so that a cell counts if it is there with that checksum.
"""

from __future__ import annotations

import datetime as dt
import itertools
import os
import re
import socket
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO, Literal, TypeAlias, TypeVar

import msgspec

from mcspectra.core.errors import StorageError, StoreError

__all__ = [
    "FORMAT",
    "MANIFEST_NAME",
    "CellLine",
    "Line",
    "Manifest",
    "PlanLine",
    "StateLine",
    "StudyLine",
    "append_line",
    "in_place",
    "now",
    "read_manifest",
    "state_line",
    "study_line",
    "write_manifest",
]

FORMAT = 2
"""Of stores; 1 had no manifest."""

MANIFEST_NAME = "manifest.jsonl"
_MOST_LINE = 2**24
_PATHS = 10_000  # of a line
_PATH = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*(/[A-Za-z0-9][A-Za-z0-9._-]*)*")


class StudyLine(msgspec.Struct, frozen=True, tag="study"):
    """The first line: which study the store holds, and what began it, when and where.

    Attributes
    ----------
    inputs
        SHA-256 of the files that its results depend on, by their names; None if they were not noted.
    """

    format: int
    study_hash: str
    seed: int
    versions: dict[str, str]
    host: str
    at: str
    inputs: dict[str, str] | None = None


class PlanLine(msgspec.Struct, frozen=True, tag="plan"):
    """Paths of cells that the study has: those of all such lines together."""

    paths: tuple[str, ...]


class CellLine(msgspec.Struct, frozen=True, tag="cell", gc=False):
    """A cell that is being put in place.

    Attributes
    ----------
    sha256
        Over the names, sizes and bytes of its files.
    parts
        CRC-32 of each file, eight digits a file, in the order of their names.
    bytes
        Of all files.
    at
        When, UTC, ISO 8601.
    """

    path: str
    sha256: str
    parts: str
    bytes: int
    at: str


class StateLine(msgspec.Struct, frozen=True, tag="state"):
    """The run was resumed, or it went through all cells."""

    state: Literal["resumed", "finished"]
    host: str
    at: str


Line: TypeAlias = StudyLine | PlanLine | CellLine | StateLine

_decoder = msgspec.json.Decoder(Line)
AnyLine = TypeVar("AnyLine", StudyLine, PlanLine, CellLine, StateLine)


class Manifest(msgspec.Struct, frozen=True):
    """What a manifest says.

    Attributes
    ----------
    study
        None if its line is damaged.
    paths
        Of the planned cells; empty if none were named.
    cells
        The last line of each cell.
    states
        In their order.
    damaged
        Numbers of lines that cannot be read, from 1.
    end
        Bytes up to the end of the last whole line.
    """

    study: StudyLine | None
    paths: tuple[str, ...]
    cells: dict[str, CellLine]
    states: tuple[StateLine, ...]
    damaged: tuple[int, ...]
    end: int

    @property
    def finished(self) -> str | None:
        """When the last run went through all cells; None while it has not."""
        last = self.states[-1] if self.states else None
        return last.at if last is not None and last.state == "finished" else None


def in_place(tree: Path, manifest: Manifest, paths: Iterable[str] | None = None) -> Iterator[str]:
    """Cells of a manifest, or those of `paths`, that are in the tree.

    One that a crash kept from being renamed into place is not. Of 100,000 cells a `Path` each would
    take longer than all the rest.
    """
    base = str(tree)
    cells = manifest.cells if paths is None else paths
    return (path for path in cells if os.path.isfile(f"{base}/{path}/zarr.json"))  # noqa: PTH113


def now() -> str:
    """The time, UTC, ISO 8601; for people, nothing depends on it."""
    return dt.datetime.now(dt.UTC).isoformat(timespec="seconds")


def study_line(
    study_hash: str, seed: int, versions: dict[str, str], inputs: Mapping[str, str] | None = None
) -> StudyLine:
    """The first line of a store that this process begins now."""
    files = None if inputs is None else dict(inputs)
    return StudyLine(FORMAT, study_hash, seed, versions, socket.gethostname(), now(), files)


def state_line(state: Literal["resumed", "finished"]) -> StateLine:
    """The line of a run of this process."""
    return StateLine(state, socket.gethostname(), now())


def write_manifest(
    folder: Path, study: StudyLine, paths: Sequence[str], further: Iterable[Line] = ()
) -> None:
    """Write a manifest in place of any other; it is there as a whole or not at all.

    Raises
    ------
    OSError
        It cannot be written.
    """
    partial = folder / f".{MANIFEST_NAME}.partial"
    plans = (
        PlanLine(tuple(paths[first : first + _PATHS])) for first in range(0, len(paths), _PATHS)
    )
    with partial.open("wb") as stream:
        stream.writelines(map(_encoded, itertools.chain([study], plans, further)))
    partial.replace(folder / MANIFEST_NAME)


def append_line(folder: Path, line: Line) -> None:
    """Add a line to the manifest of a folder; what remains of a torn one is cut off.

    Raises
    ------
    StorageError
        It cannot be written; the earlier lines are kept.
    """
    file = folder / MANIFEST_NAME
    try:
        with file.open("r+b", buffering=0) as stream:
            end = _whole_lines(stream)
            try:
                stream.seek(end)
                _write(stream, _encoded(line))
            except OSError:
                stream.truncate(end)
                raise
    except OSError as error:
        raise StorageError(
            f"{str(file)!r} cannot be written: {error.strerror}; what was finished is kept, and "
            "--resume continues it."
        ) from None


def read_manifest(folder: Path) -> Manifest | None:
    """Read the manifest of a folder; None if there is none.

    Raises
    ------
    StoreError
        It cannot be read.
    """
    file = folder / MANIFEST_NAME
    try:
        with file.open("rb") as stream:
            return _collected(stream)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise StoreError(f"{str(file)!r} cannot be read: {error.strerror}.") from None


def _collected(stream: BinaryIO) -> Manifest:
    lines, damaged, end = [], [], 0
    for number, (text, line) in enumerate(_lines(stream), 1):
        end += len(text)
        if line is None:
            damaged.append(number)
        else:
            lines.append(line)
    cells = {line.path: line for line in lines if isinstance(line, CellLine)}
    plans = _of(lines, PlanLine)
    studies = _of(lines, StudyLine)
    return Manifest(
        studies[0] if studies else None,
        tuple(path for plan in plans for path in plan.paths),
        cells,
        tuple(_of(lines, StateLine)),
        tuple(damaged),
        end,
    )


def _lines(stream: BinaryIO) -> Iterator[tuple[bytes, Line | None]]:
    """Whole lines of a manifest: their bytes, and what they say, None if that is damaged."""
    while (text := stream.readline(_MOST_LINE)).endswith(b"\n"):
        yield text, _decoded(text)


def _decoded(text: bytes) -> Line | None:
    body, _, crc = text[:-1].rpartition(b"\t")
    if crc != b"%08x" % zlib.crc32(body):
        return None
    try:
        line = _decoder.decode(body)
    except (msgspec.DecodeError, RecursionError):
        return None
    paths = line.paths if isinstance(line, PlanLine) else ()
    paths = (line.path,) if isinstance(line, CellLine) else paths
    # Names that lead out of the store are not those of a store that this package wrote.
    return line if all(map(_PATH.fullmatch, paths)) else None


def _of(lines: list[Line], kind: type[AnyLine]) -> list[AnyLine]:
    return [line for line in lines if isinstance(line, kind)]


def _encoded(line: Line) -> bytes:
    body = msgspec.json.encode(line)
    return body + b"\t%08x\n" % zlib.crc32(body)


def _whole_lines(stream: BinaryIO) -> int:
    """Bytes up to the last line's end: at a torn line, where it begins."""
    size = stream.seek(0, os.SEEK_END)
    while size:
        start = max(size - 4096, 0)
        stream.seek(start)
        at = stream.read(size - start).rfind(b"\n")
        if at >= 0:
            return start + at + 1
        size = start
    return 0


def _write(stream: BinaryIO, data: bytes) -> None:
    rest = memoryview(data)
    while rest:
        rest = rest[stream.write(rest) :]
