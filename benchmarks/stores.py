"""Stores of many cells: seconds to write, open, list and verify them; and the journal's."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import xarray as xr

from mcspectra.studies import Store, decode_study, open_results, result_paths, study_status
from mcspectra.studies.checksums import checksum
from mcspectra.studies.journal import Journal
from mcspectra.studies.manifest import CellLine, now, read_manifest, write_manifest

_STUDY = """
title = "many"
samplers = ["random"]
[convergence]
counts = [4]
[[estimators]]
name = "a"
integrand = "linear"
dims = 1
"""
_MANY = 100_000
_WRITTEN = 500


def main() -> None:
    """Print a line for each step."""
    folder = Path(tempfile.mkdtemp())
    try:
        _cells(folder / "some")
        _index(folder / "many")
        _journal(folder / "journal")
    finally:
        shutil.rmtree(folder)


def _cell() -> xr.Dataset:
    n = np.arange(8)
    values = {f"v{i}": ("n", np.linspace(i, 1.0, 8)) for i in range(8)}
    return xr.Dataset({**values, "ci": (("n", "bound"), np.ones((8, 2)))}, coords={"n": n})


def _cells(folder: Path) -> None:
    """What a cell costs, of 10 arrays: written here and by xarray, checked, opened."""
    cell, paths = _cell(), [f"e{i // 25}/s{i % 25}/convergence" for i in range(_WRITTEN)]
    store = Store.create(folder, decode_study(_STUDY), paths=paths)
    with _timed("write a cell (checksum, manifest, rename)", _WRITTEN):
        for path in paths:
            store.write(path, cell)
    with _timed("the same arrays by Dataset.to_zarr", 50):
        for i in range(50):
            cell.to_zarr(folder / "x" / str(i), zarr_format=3, consolidated=False)
    with _timed("consolidate, a cell", _WRITTEN):
        store.finish()
    with _timed("resume: verify a cell", _WRITTEN):
        again = Store.create(folder, decode_study(_STUDY), resume=True, paths=paths)
        assert all(again.done(path) for path in paths)
    again.finish()
    with _timed("open_results, a cell of the tree", _WRITTEN):
        open_results(folder)
    with _timed("open_results with select, a cell", 25):
        open_results(folder, "e3/*")


def _index(folder: Path) -> None:
    """A store of 100,000 cells: their list, their status, and a part of the tree."""
    paths = [f"e{i // 1000}/s{i % 1000}/convergence" for i in range(_MANY)]
    store = Store.create(folder, decode_study(_STUDY), paths=paths)
    for first in range(0, _MANY, 1000):
        store.write(paths[first], _cell())
    model = store.path / paths[0]
    line, manifest = checksum(model), read_manifest(folder)
    assert manifest is not None
    assert manifest.study is not None
    for path in paths:  # metadata of the group alone: a whole cell has twenty files more
        (store.path / path).mkdir(parents=True, exist_ok=True)
        if not (store.path / path / "zarr.json").exists():
            shutil.copyfile(model / "zarr.json", store.path / path / "zarr.json")
    lines = (CellLine(path, line.sha256, line.parts, line.bytes, now()) for path in paths)
    write_manifest(folder, manifest.study, paths, lines)
    with _timed("100,000 cells: read the manifest (budget 2 s)"):
        read_manifest(folder)
    with _timed("100,000 cells: result_paths (budget 2 s)"):
        assert len(result_paths(folder)) == _MANY
    with _timed("100,000 cells: open_results(select) of one (budget 2 s)"):
        open_results(folder, paths[0])
    with _timed("100,000 cells: study_status (budget 2 s)"):
        assert len(study_status(folder).done) == _MANY


def _journal(folder: Path) -> None:
    """100,000 records of 1 kB: append, resume with all checksums."""
    with Journal.create(folder, {}) as journal, _timed("append a record of 1 kB", _MANY):
        for i in range(_MANY):
            journal.append(f"estimator/sampler/{i}", bytes(1000), None, {})
    with _timed("100,000 records: resume, verified (budget 2 s)"):
        Journal.resume(folder, {}).close()


@contextmanager
def _timed(what: str, times: int = 1) -> Iterator[None]:
    wall, processor = time.perf_counter(), time.process_time()
    yield
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    unit = "s" if times == 1 else "ms"
    scale = 1.0 if times == 1 else 1000.0 / times
    print(f"{what:60s} {wall * scale:8.3f} {unit}, processor {processor * scale:8.3f} {unit}")


if __name__ == "__main__":
    main()
