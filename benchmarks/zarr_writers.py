"""Seconds to write the results of a study as a Zarr store: our writer, xarray, and zarr alone."""

from __future__ import annotations

import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr
from xarray.conventions import encode_dataset_coordinates

from mcspectra.studies import results

Writer = Callable[[Path], None]


def main(folder: str, repeats: str = "5") -> None:
    """Print the least and the median time of each writer; all writers take turns in one loop."""
    attributes, cells = results._opened(folder, None)
    arrays = sum(len(cell.variables) for cell in cells.values())
    size = sum(cell.nbytes for cell in cells.values()) / 1e6
    print(f"{len(cells)} cells, {arrays} arrays, {size:.0f} MB")
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs=attributes), **cells})
    encoding = {f"/{path}": _encoding(cell) for path, cell in cells.items()}

    def own(target: Path) -> None:
        results._write_store(attributes, cells.items(), target)

    def in_memory(target: Path) -> None:
        files: dict[str, Any] = {}
        store = zarr.storage.MemoryStore(files)
        tree.to_zarr(store, encoding=encoding, zarr_format=3, consolidated=False)
        zarr.consolidate_metadata(store)
        _copy(files, target)

    def alone(target: Path) -> None:
        files: dict[str, Any] = {}
        store = zarr.storage.MemoryStore(files)
        root = zarr.create_group(store, attributes=attributes)
        for path, cell in cells.items():
            variables, attrs = encode_dataset_coordinates(cell)
            group = root.create_group(path, attributes=attrs)
            for name, variable in variables.items():
                group.create_array(
                    str(name),
                    data=np.asarray(variable.values),
                    chunks=_chunks(variable),
                    compressors=None,
                    attributes=dict(variable.attrs),
                    dimension_names=variable.dims or None,
                )
        zarr.consolidate_metadata(store)
        _copy(files, target)

    def direct(target: Path) -> None:
        tree.to_zarr(target, encoding=encoding, zarr_format=3, consolidated=True)

    _compare({"mcspectra": own, "xarray in memory": in_memory, "zarr alone": alone}, int(repeats))
    _compare({"DataTree.to_zarr": direct}, 1)


def _compare(writers: dict[str, Writer], repeats: int) -> None:
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in writers}
    for _ in range(repeats):
        for name, write in writers.items():
            with tempfile.TemporaryDirectory() as place:
                wall, processor = time.perf_counter(), time.process_time()
                write(Path(place) / "x.zarr")
                spent = time.perf_counter() - wall, time.process_time() - processor
                times[name].append(spent)
    for name, found in times.items():
        (wall, processor), (wall_median, processor_median) = np.min(found, 0), np.median(found, 0)
        print(
            f"{name:17s} wall {wall:6.2f} s (median {wall_median:6.2f}), "
            f"processor {processor:6.2f} s (median {processor_median:6.2f})",
            flush=True,
        )


def _encoding(cell: xr.Dataset) -> dict[Any, dict[str, Any]]:
    plain = {"compressors": None, "_FillValue": None}
    return {name: {**plain, "chunks": _chunks(each)} for name, each in cell.variables.items()}


def _chunks(variable: xr.Variable) -> tuple[int, ...]:
    return tuple(max(1, size) for size in variable.shape)


def _copy(files: dict[str, Any], target: Path) -> None:
    for name, content in files.items():
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        (target / name).write_bytes(content.to_bytes())


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # consolidated metadata are not yet in Zarr's specification
    main(*sys.argv[1:])
