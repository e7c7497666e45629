"""Cells as zarr v3 groups, written file by file.

A cell is some ten small arrays. xarray's own writer takes tens of milliseconds for them, most of it
for appending, chunking and other engines, so that short cells would wait for it; here an array is its
metadata (zarr.json) and one chunk, side by side: new folders are what a file system is slowest at.
Chunks hold a checksum of their own (zstd's), so that any reader notices damage. Large or unusual arrays
go through xarray.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.studies.checksums import Checksum, checksum, checksum_of

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["array_documents", "write_cell"]

_METADATA = "zarr.json"
_LEVEL = 0  # zstd's own default
_MOST_BYTES = 2**26  # of an array in one chunk


def write_cell(group: Path, dataset: xr.Dataset) -> Checksum:
    """Write a dataset as a zarr group that ``xarray.open_dataset`` reads; `group` must be new.

    Returns
    -------
    Checksum
        Of what is meant to be there.

    Raises
    ------
    OSError
        It cannot be written.
    """
    if not all(_is_simple(variable.dtype, variable.shape) for variable in _variables(dataset)):
        _write_by_xarray(group, dataset)
        return checksum(group)
    files = _cell_files(dataset)
    group.mkdir(parents=True)
    for folder in sorted({name.partition("/")[0] for name in files if "/" in name}):
        (group / folder).mkdir()
    for name, content in files.items():
        (group / name).write_bytes(content)
    return checksum_of(files)


def array_documents(group: Path) -> dict[str, dict[str, Any]]:
    """Metadata of a group and of its arrays, by their names; that of the group under ``""``."""
    files = [group / _METADATA, *sorted(group.glob(f"*/{_METADATA}"))]
    return {
        "" if file.parent == group else file.parent.name: json.loads(file.read_bytes())
        for file in files
    }


def _variables(dataset: xr.Dataset) -> list[Any]:
    return list(dataset.variables.values())


def _is_simple(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bool:
    """Whether an array of numbers fits into one chunk."""
    size = int(np.prod(shape, dtype=np.int64))
    return dtype.kind in "biufc" and 0 < size * dtype.itemsize <= _MOST_BYTES


def _cell_files(dataset: xr.Dataset) -> dict[str, bytes]:
    """Files of a group: metadata before the chunk of each array, the group's own at the end."""
    from xarray.conventions import encode_dataset_coordinates

    variables, attributes = encode_dataset_coordinates(dataset)
    files: dict[str, bytes] = {}
    for name, variable in variables.items():
        files |= {f"{name}/{file}": content for file, content in _array_files(variable).items()}
    document = {"attributes": _plain(attributes), "zarr_format": 3, "node_type": "group"}
    return files | {_METADATA: _json(document)}


def _array_files(variable: Any) -> dict[str, bytes]:
    from numcodecs.zstd import Zstd  # type: ignore[import-untyped]

    values: Array = np.asarray(variable.values)
    values = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).reshape(values.shape)
    chunk = ".".join(["c", *("0" for _ in values.shape)])
    return {
        _METADATA: _json(_document(values, variable.dims, variable.attrs)),
        chunk: Zstd(level=_LEVEL, checksum=True).encode(values.tobytes()),
    }


def _document(
    values: Array, dims: tuple[Any, ...], attributes: Mapping[Any, Any]
) -> dict[str, Any]:
    """Metadata of an array in one chunk (Zarr core specification, version 3)."""
    order = {"configuration": {"endian": "little"}} if values.dtype.itemsize > 1 else {}
    zero = {"b": False, "c": [0.0, 0.0], "f": 0.0}.get(values.dtype.kind, 0)
    return {
        "shape": list(values.shape),
        "data_type": values.dtype.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(values.shape)}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "."}},
        "fill_value": zero,
        "codecs": [
            {"name": "bytes", **order},
            {"name": "zstd", "configuration": {"level": _LEVEL, "checksum": True}},
        ],
        "attributes": _plain(attributes),
        "dimension_names": list(dims),
        "zarr_format": 3,
        "node_type": "array",
        "storage_transformers": [],
    }


def _plain(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes as JSON holds them."""
    return {
        str(key): value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        for key, value in attributes.items()
    }


def _json(document: dict[str, Any]) -> bytes:
    return json.dumps(document).encode()


def _write_by_xarray(group: Path, dataset: xr.Dataset) -> None:
    from zarr.codecs import ZstdCodec

    codec = ZstdCodec(level=_LEVEL, checksum=True)
    dataset.to_zarr(
        group,
        mode="w",
        zarr_format=3,
        consolidated=False,
        write_empty_chunks=True,
        encoding={name: {"compressors": [codec]} for name in dataset.variables},
    )
