"""Results in other formats: tables (CSV, Parquet), JSON, netCDF, and the store itself elsewhere.

What is exported is checked against its checksums first, where there is a manifest.

Numbers are written exactly: floats with all their digits. Attributes are kept: as a first line that
is a comment in CSV, as metadata in Parquet, as members in JSON, as attributes in netCDF.
"""

from __future__ import annotations

import contextlib
import csv
import fnmatch
import importlib
import importlib.util
import itertools
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import MissingDependency, ParameterError, StorageError, StoreError
from mcspectra.studies._consolidated import check_consolidated
from mcspectra.studies.checksums import Checksum, damage_of
from mcspectra.studies.copying import copy_to_folder, copy_to_url, copy_to_zip
from mcspectra.studies.links import check_tree_links
from mcspectra.studies.manifest import in_place, read_manifest
from mcspectra.studies.opening import open_results
from mcspectra.studies.places import first_line, is_url
from mcspectra.core.memory import check_memory
from mcspectra.studies.store import STORE_NAME, root_document
from mcspectra.studies.tidy import FIXED, VALUES, cells_of, coordinate_columns, tidy

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["FORMATS", "export_results"]

FORMATS = (".csv", ".parquet", ".nc", ".json", ".zarr.zip", ".zarr")
"""Ends of names of files that results are exported to."""

_KEY = "mcspectra"


def export_results(source: str | Path, file: str | Path, select: str | None = None) -> Path | str:
    """Write results to a file whose format its name's end tells.

    ``.csv`` and ``.parquet`` are one long table, a row for each number; ``.json`` has a list of cells
    with their arrays; ``.nc`` is netCDF 3 with variables ``<path of the cell>.<variable>``, slashes
    as dots; ``.zarr.zip`` and ``.zarr`` are the store itself, in a zip file, in a folder, or at a URL
    that fsspec writes to.

    Parameters
    ----------
    source
        What `open_results` takes.
    file
        A file is replaced if it is there, as a whole or not at all; a ``.zarr`` must not be there.
    select
        Pattern of the paths of cells; all by default, and always all of a store.

    Returns
    -------
    Path or str
        What was written; a str if it is a URL.

    Raises
    ------
    ParameterError
        The name has another end, a URL is given for something else than ``.zarr``, or ``select``
        for a store.
    StoreError
        The results cannot be read, are damaged, or a netCDF file cannot hold them.
    StorageError
        The file cannot be written.
    MissingDependency
        Parquet without pyarrow, URLs without fsspec.
    """
    end = _end_of(file)
    if end in _STORES and select is not None:
        raise ParameterError(f"A {end} holds all cells; leave the selection out.")
    _check_cells(source, select)
    if is_url(file):
        copy_to_url(source, str(file))
        return str(file)
    target = Path(file)
    if end == ".zarr":
        if target.exists():
            raise StorageError(f"{str(target)!r} exists already; give another name.")
        return _replaced(target, lambda partial: copy_to_folder(source, partial))
    if end == ".zarr.zip":
        return _replaced(target, lambda partial: copy_to_zip(source, partial))
    tree = open_results(source, select)
    return _replaced(target, lambda partial: _WRITERS[end](tree, partial))


_STORES = (".zarr.zip", ".zarr")


def _end_of(file: str | Path) -> str:
    """The one of `FORMATS` that a name ends with."""
    name = str(file).lower()
    end = next((end for end in FORMATS if name.endswith(end)), None)
    if end is None:
        raise ParameterError(
            f"{str(file)!r} has none of the ends {', '.join(FORMATS)}; the end chooses the format."
        )
    if is_url(file) and end != ".zarr":
        raise ParameterError(
            f"{str(file)!r} is a URL, where only a store can be written, with the end .zarr; export "
            "to a file of this machine, and copy it."
        )
    return end


def _check_cells(source: str | Path, select: str | None) -> None:
    """Refuse cells of a folder that are not those that its manifest tells of."""
    place = Path() if is_url(source) else Path(source)
    folder = place.parent if place.name == STORE_NAME else place
    if is_url(source) or not folder.is_dir():
        return
    manifest = read_manifest(folder)
    if manifest is None:
        return
    tree = folder / STORE_NAME
    chosen = manifest.cells if select is None else fnmatch.filter(manifest.cells, select)
    for path in in_place(tree, manifest, chosen):
        check_tree_links(tree, path)
        line = manifest.cells[path]
        reason = damage_of(tree / path, Checksum(line.sha256, line.parts, line.bytes))
        if reason is not None:
            raise _damaged(path, reason)
    check_consolidated(tree, root_document(tree), None if select is None else chosen)


def _damaged(path: str, reason: str) -> StoreError:
    return StoreError(
        f"The cell {path} is damaged: {reason}; `mcspectra run` with --resume computes it again."
    )


def _replaced(target: Path, write: Callable[[Path], Any]) -> Path:
    """Write a file, or a folder, beside its place and put it there when it is whole."""
    partial = target.with_name(f".{target.name}.partial")
    try:
        _remove(partial)
        write(partial)
        partial.replace(target)
    except OSError as error:
        raise StorageError(f"{str(target)!r} cannot be written: {error.strerror}.") from None
    finally:
        _remove(partial)
    return target


def _remove(partial: Path) -> None:
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        if partial.is_dir() and not partial.is_symlink():
            shutil.rmtree(partial)
        else:
            partial.unlink()


def _loaded(tree: xr.DataTree) -> Iterator[tuple[str, xr.Dataset]]:
    """Paths and datasets of the cells, each read as a whole, and held only by who asked."""
    for path, cell in cells_of(tree):
        try:
            whole = cell.compute()
        except StoreError:
            raise
        except (OSError, ValueError, RuntimeError) as error:  # zarr's codecs raise any of them
            raise _damaged(path, first_line(error)) from None
        yield path, whole


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
        for i, (path, cell) in enumerate(_loaded(tree)):
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
    for path, cell in _loaded(tree):
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
    return itertools.chain.from_iterable(tidy(tree, cell) for _, cell in _loaded(tree))


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


_WRITERS: dict[str, Callable[[xr.DataTree, Path], None]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
    ".json": _write_json,
    ".nc": _write_netcdf,
}
