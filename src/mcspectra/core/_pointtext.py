"""Point sets as text: the formats .dat (UTK) and .csv of `mcspectra.core.pointfiles`."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import FileFormatError

__all__ = ["format_csv", "format_dat", "parse_dat", "read_csv", "read_dat"]

Row = tuple[int, list[str]]
"""Number of a line of text, from 1, and its fields."""


def read_dat(file: Path) -> list[Array]:
    """Read UTK text, one array (n, d) for each set."""
    return parse_dat(_read_text(file), str(file))


def read_csv(file: Path) -> list[Array]:
    """Read comma- or semicolon-separated values, one array (n, d) for each set."""
    lines = list(enumerate(_read_text(file).splitlines(), start=1))
    lines = [(number, line) for number, line in lines if not line.lstrip().startswith("#")]
    semicolons = any(";" in line for _, line in lines)
    groups: list[list[Row]] = [[]]
    for number, line in lines:
        # "1,5;2,5" is how spreadsheets of half the world write two numbers.
        cells = line.replace(",", ".").split(";") if semicolons else line.split(",")
        fields = [cell.strip().strip('"') for cell in cells]
        if any(fields):
            groups[-1].append((number, fields))
        else:
            groups.append([])
    return _sets_of(_without_names([group for group in groups if group], str(file)), str(file))


def parse_dat(text: str, name: str) -> list[Array]:
    """Read UTK text; `name` is what messages call its source."""
    groups: list[list[Row]] = [[]]
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.split()
        if fields and fields[0].startswith("#"):
            groups.append([])
        elif fields:
            groups[-1].append((number, fields))
    return _sets_of(groups, name)


def format_dat(sets: Sequence[Array], meta: Mapping[str, Any] | None = None) -> str:
    """Write UTK text; every float64 is read back to the same bits."""
    comment = f"# {json.dumps(dict(meta), default=str)}\n" if meta else ""
    return comment + "#\n".join("".join(_lines(points, " ")) for points in sets)


def format_csv(sets: Sequence[Array], name: str) -> str:
    """Write a column for each dim and, where there are several sets, a first one ``set``."""
    dims = {points.shape[1] for points in sets}
    if len(dims) > 1:
        raise FileFormatError(f"{name} needs sets of the same dims; write them to several files.")
    header = ",".join(f"x{i}" for i in range(dims.pop()))
    if len(sets) == 1:
        return f"{header}\n{''.join(_lines(sets[0], ','))}"
    rows = ["".join(_lines(points, ",", f"{k},")) for k, points in enumerate(sets)]
    return f"set,{header}\n{''.join(rows)}"


def _read_text(file: Path) -> str:
    data = file.read_bytes()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{file} is not text: byte {error.start} is no character.") from None


def _sets_of(groups: Iterable[list[Row]], name: str) -> list[Array]:
    """Make an array of each group of lines that has any."""
    sets = [_array(rows, name) for rows in groups if rows]
    if not sets:
        raise FileFormatError(f"{name} holds no points; give a line of coordinates for each.")
    return sets


def _array(rows: list[Row], name: str) -> Array:
    width = len(rows[0][1])
    if not width:
        raise FileFormatError(f"{name} has no coordinates; give a column of numbers for each axis.")
    for number, fields in rows:
        if len(fields) != width:
            raise FileFormatError(
                f"{name}, line {number}, has {len(fields)} numbers, but the set began with {width} "
                f"on line {rows[0][0]}; give all points of a set the same number of dims."
            )
    try:
        points = np.array([fields for _, fields in rows], dtype=np.float64)
    except ValueError:
        points = None
    # Python reads 1_0 as 10, nobody else does.
    underscores = any("_" in field for _, fields in rows for field in fields)
    if points is None or underscores or not np.isfinite(points).all():
        number, text = next((k, f) for k, fields in rows for f in fields if not _is_finite(f))
        raise FileFormatError(f"{name}, line {number}: {text[:40]!r} is not a finite number.")
    return points


def _is_finite(text: str) -> bool:
    try:
        return "_" not in text and bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _without_names(groups: list[list[Row]], file: str) -> list[list[Row]]:
    """Take off the line of column names; split at its column ``set`` where there is one."""
    if not groups or any(_is_number(field) for field in groups[0][0][1]):
        return groups
    names = [name.lower() for name in groups[0].pop(0)[1]]
    if "" in names:
        raise FileFormatError(
            f"{file} has a column without a name, such as the index that pandas writes; "
            "write it with index=False, or name all columns."
        )
    if "set" not in names:
        return groups
    if names.count("set") > 1:
        raise FileFormatError(f"{file} has two columns 'set'; name each column differently.")
    column = names.index("set")
    split: dict[str, list[Row]] = {}
    for number, fields in (row for group in groups for row in group):
        label = fields[column] if column < len(fields) else ""
        split.setdefault(label, []).append((number, fields[:column] + fields[column + 1 :]))
    return list(split.values())


def _lines(points: Array, blank: str, start: str = "") -> list[str]:
    return [start + blank.join(map(repr, row)) + "\n" for row in points.tolist()]
