"""Results in other formats: tables (CSV, Parquet), JSON, netCDF, and the store in a zip file.

Numbers are written exactly: floats with all their digits. Attributes are kept: as a first line that
is a comment in CSV, as metadata in Parquet, as members in JSON, as attributes in netCDF.
"""

from __future__ import annotations

import csv
import importlib
import importlib.util
import itertools
import json
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import MissingDependency, ParameterError, StorageError, StoreError
from mcspectra.studies.opening import open_results
from mcspectra.studies.sizes import check_memory
from mcspectra.studies.store import STORE_NAME, root_document
from mcspectra.studies.tidy import FIXED, VALUES, cells_of, coordinate_columns, tidy

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["FORMATS", "export_results", "write_zip"]

FORMATS = (".csv", ".parquet", ".nc", ".json", ".zarr.zip")
"""Ends of names of files that results are exported to."""

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first that a zip file can hold: same results, same bytes
_KEY = "mcspectra"


def export_results(source: str | Path, file: str | Path, select: str | None = None) -> Path:
    """Write results to a file whose format its name's end tells.

    ``.csv`` and ``.parquet`` are one long table, a row for each number; ``.json`` has a list of cells
    with their arrays; ``.nc`` is netCDF 3 with variables ``<path of the cell>.<variable>``, slashes
    as dots; ``.zarr.zip`` is the store itself.

    Parameters
    ----------
    source
        What `open_results` takes; for ``.zarr.zip`` a folder.
    file
        It is replaced if it is there, as a whole or not at all.
    select
        Pattern of the paths of cells; all by default, and always all of ``.zarr.zip``.

    Raises
    ------
    ParameterError
        The name has another end, or ``select`` is given for ``.zarr.zip``.
    StoreError
        The results cannot be read, or a netCDF file cannot hold them.
    StorageError
        The file cannot be written.
    MissingDependency
        Parquet without pyarrow.
    """
    target = Path(file)
    end = next((end for end in FORMATS if target.name.lower().endswith(end)), None)
    if end is None:
        raise ParameterError(
            f"{str(file)!r} has none of the ends {', '.join(FORMATS)}; the end chooses the format."
        )
    if end == ".zarr.zip":
        if select is not None:
            raise ParameterError("A .zarr.zip holds all cells; leave the selection out.")
        return _replaced(target, lambda partial: write_zip(Path(source), partial))
    tree = open_results(source, select)
    return _replaced(target, lambda partial: _WRITERS[end](tree, partial))


def write_zip(folder: Path, file: Path) -> Path:
    """Put the store of a folder into a zip file that zarr and `open_results` read.

    Raises
    ------
    StoreError
        There is no store, or a file of it leads elsewhere.
    """
    tree = folder if folder.suffix == ".zarr" else folder / STORE_NAME
    root_document(tree)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for path in sorted(tree.rglob("*")):
            if path.is_symlink():
                raise StoreError(f"{str(path)!r} is a link; results hold files only.")
            if path.is_file():
                _add(archive, path, path.relative_to(tree).as_posix())
    return file


def _add(archive: zipfile.ZipFile, path: Path, name: str) -> None:
    with path.open("rb") as source, archive.open(zipfile.ZipInfo(name, _EPOCH), "w") as out:
        while piece := source.read(2**20):
            out.write(piece)


def _replaced(target: Path, write: Callable[[Path], Any]) -> Path:
    """Write a file beside its place and put it there when it is whole."""
    partial = target.with_name(f".{target.name}.partial")
    try:
        write(partial)
        partial.replace(target)
    except OSError as error:
        raise StorageError(f"{str(target)!r} cannot be written: {error.strerror}.") from None
    finally:
        partial.unlink(missing_ok=True)
    return target


def _write_csv(tree: xr.DataTree, file: Path) -> None:
    columns = (*FIXED, *coordinate_columns(tree), *VALUES)
    with file.open("w", encoding="utf-8", newline="") as stream:
        stream.write(f"# {json.dumps(_attributes(tree))}\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        for table in _tables(tree):
            given = [np.asarray(table[c]).tolist() if c in table else None for c in columns]
            length = len(table["value"])
            writer.writerows(zip(*(g or itertools.repeat("", length) for g in given), strict=True))


def _write_parquet(tree: xr.DataTree, file: Path) -> None:
    if importlib.util.find_spec("pyarrow") is None:
        raise MissingDependency(
            "Parquet needs pyarrow, which is not installed: pip install 'mcspectra[parquet]'."
        )
    pa, parquet = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    texts = dict.fromkeys(FIXED, True) | coordinate_columns(tree) | dict.fromkeys(VALUES, False)
    schema = pa.schema(
        [(name, pa.string() if text else pa.float64()) for name, text in texts.items()],
        metadata={_KEY: json.dumps(_attributes(tree))},
    )
    with parquet.ParquetWriter(file, schema) as writer:
        for table in _tables(tree):
            length = len(table["value"])
            columns = {name: _column(table.get(name), text, length) for name, text in texts.items()}
            writer.write_table(pa.table(columns, schema=schema))


def _column(values: Any, text: bool, length: int) -> Any:
    """A column of text or float64; None where a variable has no such coordinate."""
    if values is None:
        return [None] * length
    return [str(v) for v in values] if text else np.asarray(values, dtype=np.float64)


def _write_json(tree: xr.DataTree, file: Path) -> None:
    with file.open("w", encoding="utf-8") as stream:
        stream.write(f'{{"attributes": {_json(dict(tree.attrs))}, "cells": [')
        for i, (path, cell) in enumerate(cells_of(tree)):
            variables = {
                str(name): {
                    "dims": list(map(str, variable.dims)),
                    "attributes": dict(variable.attrs),
                    "values": _nested(np.asarray(variable.values)),
                }
                for name, variable in cell.variables.items()
            }
            document = {"path": path, "attributes": dict(cell.attrs), "variables": variables}
            stream.write(f"{',' if i else ''}\n{_json(document)}")
        stream.write("\n]}\n")


def _nested(values: Array) -> Any:
    """Lists of numbers: NaN and infinities as texts, complex numbers as pairs."""
    if values.dtype.kind == "c":
        return _nested(np.stack([values.real, values.imag], axis=-1))
    if values.dtype.kind != "f" or np.isfinite(values).all():
        return values.tolist()
    plain = values.astype(object)
    plain[~np.isfinite(values)] = [str(v) for v in values[~np.isfinite(values)]]
    return plain.tolist()


def _write_netcdf(tree: xr.DataTree, file: Path) -> None:
    import xarray as xr

    check_memory(2 * sum(cell.nbytes for _, cell in cells_of(tree)), "The netCDF file")
    attributes = {key: _netcdf_attribute(value) for key, value in tree.attrs.items()}
    variables: dict[str, Any] = {}
    for path, cell in cells_of(tree):
        prefix = path.replace("/", ".")
        attributes[prefix] = _json(dict(cell.attrs))
        for name, variable in cell.variables.items():
            dims = [f"{prefix}.{dim}" for dim in variable.dims]
            own = {key: _netcdf_attribute(value) for key, value in variable.attrs.items()}
            for end, values in _netcdf_arrays(np.asarray(variable.values)):
                variables[f"{prefix}.{name}{end}"] = (dims, values, own)
    xr.Dataset(variables, attrs=attributes).to_netcdf(
        file,
        engine="scipy",
        format="NETCDF3_64BIT",
        encoding={name: {"_FillValue": None} for name in variables},
    )


def _netcdf_arrays(values: Array) -> Iterator[tuple[str, Array]]:
    """Values in the types that netCDF 3 has, with the ends of their names."""
    if values.dtype.kind == "c":
        yield ".real", values.real.astype(np.float64)
        yield ".imag", values.imag.astype(np.float64)
    elif values.dtype.kind == "b":
        yield "", values.astype(np.int8)
    elif values.dtype.kind in "iu":
        low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
        small = low >= -(2**31) and high < 2**31
        if max(-low, high) > 2**53:
            raise StoreError("netCDF 3 holds no whole numbers beyond 2⁵³; export to .json instead.")
        yield "", values.astype(np.int32 if small else np.float64)
    else:
        yield "", values.astype(np.float64 if values.dtype.itemsize > 4 else np.float32)


def _netcdf_attribute(value: Any) -> Any:
    """Texts, floats and whole numbers of 32 bits as they are, all else as JSON."""
    whole = isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**31
    return value if whole or isinstance(value, str | float) else _json(value)


def _attributes(tree: xr.DataTree) -> dict[str, Any]:
    """Attributes of the study and of its cells."""
    return {"study": dict(tree.attrs), "cells": {p: dict(c.attrs) for p, c in cells_of(tree)}}


def _tables(tree: xr.DataTree) -> Iterator[dict[str, Any]]:
    return itertools.chain.from_iterable(tidy(tree, cell) for _, cell in cells_of(tree))


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


_WRITERS: dict[str, Callable[[xr.DataTree, Path], None]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
    ".json": _write_json,
    ".nc": _write_netcdf,
}
