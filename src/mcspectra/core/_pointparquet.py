"""Point sets as tables: the format .parquet of `mcspectra.core.pointfiles`, through pyarrow."""

from __future__ import annotations

import importlib
import importlib.util
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import FileFormatError, MissingDependency

__all__ = ["format_parquet", "read_parquet"]

_META = b"mcspectra"
_PANDAS_INDEX = "__index_level_"  # columns in which pandas keeps an index


def read_parquet(file: Path) -> list[Array]:
    """Read all columns but ``set`` as coordinates, one array (n, d) for each value of that one."""
    table = _table(file)
    names = [name for name in table.column_names if not name.startswith(_PANDAS_INDEX)]
    tells = [name for name in names if name.lower() == "set"]
    if len(set(names)) < len(names) or len(tells) > 1:
        raise FileFormatError(f"{file} has two columns of one name; name each differently.")
    labels = _labels(table, tells[0] if tells else None, file)
    names = [name for name in names if name not in tells]
    if not names or not len(labels):
        raise FileFormatError(f"{file} holds no points; give a column of numbers for each axis.")
    points = np.column_stack([_numbers(table, name, file) for name in names])
    _, first, index = np.unique(labels, return_index=True, return_inverse=True)
    return [points[index == k] for k in np.argsort(first)]


def format_parquet(sets: Sequence[Array], meta: Mapping[str, Any], name: str) -> bytes:
    """Write columns ``x0``, ``x1``, … and, for several sets, a first one ``set``."""
    pyarrow = _pyarrow()
    if len({points.shape[1] for points in sets}) > 1:
        raise FileFormatError(f"{name} needs sets of the same dims; write them to several files.")
    points = np.concatenate(sets)
    columns = {f"x{i}": points[:, i] for i in range(points.shape[1])}
    if len(sets) > 1:
        columns = {"set": np.repeat(np.arange(len(sets)), [len(x) for x in sets]), **columns}
    table = pyarrow.table(columns)
    table = table.replace_schema_metadata({_META: json.dumps(dict(meta), default=str)})
    buffer = pyarrow.BufferOutputStream()
    pyarrow.parquet.write_table(table, buffer)
    return bytes(buffer.getvalue())


def _table(file: Path) -> Any:
    pyarrow = _pyarrow()
    data = file.read_bytes()
    try:
        return pyarrow.parquet.read_table(pyarrow.BufferReader(data))
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        reason = str(error).splitlines()[0].rstrip(".")[:200] if str(error) else "it is damaged"
        raise FileFormatError(f"{file} is not a sound .parquet file: {reason}.") from None


def _labels(table: Any, name: str | None, file: Path) -> Array:
    """What tells the set of each row."""
    if name is None:
        return np.zeros(table.num_rows)
    labels = table.column(name).combine_chunks()
    if labels.null_count:
        raise FileFormatError(f"{file}: column {name!r} is empty in a row; give the set of each.")
    try:
        text = labels.cast("string")
    except _pyarrow().ArrowException:  # lists, bytes that are no text
        raise FileFormatError(
            f"{file}: column {name!r} holds {labels.type}; give text or numbers."
        ) from None
    return np.asarray(text.to_numpy(zero_copy_only=False).astype(str))


def _numbers(table: Any, name: str, file: Path) -> Array:
    column = table.column(name)
    types = _pyarrow().types
    if not (types.is_integer(column.type) or types.is_floating(column.type)):
        raise FileFormatError(
            f"{file}: column {name!r} holds {column.type}; all columns but 'set' must be numbers."
        )
    numbers = np.asarray(column.to_numpy(), dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(numbers))
    if bad.size:
        raise FileFormatError(
            f"{file}: column {name!r}, row {bad[0]} (from 0) is empty or not finite; "
            "give finite numbers."
        )
    return numbers


def _pyarrow() -> Any:
    if importlib.util.find_spec("pyarrow") is None:
        raise MissingDependency(
            "Files .parquet need the package pyarrow; install it with: "
            "pip install 'mcspectra[parquet]'"
        )
    importlib.import_module("pyarrow.parquet")
    return importlib.import_module("pyarrow")
