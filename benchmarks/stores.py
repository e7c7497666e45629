"""Ledgers of many cells: seconds to write, resume, list, open and export a ledger."""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import mcspectra as mcs
from mcspectra.core.records import pack
from mcspectra.core.results import package_versions
from mcspectra.studies import export_results, open_results, study_status
from mcspectra.studies.ledger import LEDGER_NAME, Ledger, StudyNote

_NOTE = StudyNote(
    title="many", seed=0, config="{}", study_hash="0" * 64, versions=package_versions(), inputs={}
)


def main(*counts: str) -> None:
    """Print a line for each step and each number of cells, by default 1,000 and 100,000."""
    curve = mcs.convergence(
        mcs.Estimator(mcs.integrand("gaussian", dims=2)),
        mcs.sampler("random", dims=2),
        [16, 64, 256],
    )
    with _timed("pack the result of a convergence", 1000):
        for _ in range(1000):
            payload = pack(curve)
    for count in map(int, counts or ("1000", "100000")):
        with tempfile.TemporaryDirectory() as folder:
            _cells(Path(folder), count, payload)
    with tempfile.TemporaryDirectory() as folder:
        _states(Path(folder), 20_000, 1000)
    with tempfile.TemporaryDirectory() as folder:
        _states(Path(folder), 1000, 100_000)


def _cells(folder: Path, count: int, payload: bytes) -> None:
    paths = [f"e{i // 100}/s{i % 100}/convergence" for i in range(count)]
    print(f"{count:,} cells of {len(payload):,} bytes")
    with _timed("begin", count), Ledger.create(folder, _NOTE, paths):
        pass
    with _timed("resume and finish all", count), Ledger.resume(folder, _NOTE, paths) as ledger:
        for path in paths:
            ledger.finish(path, payload)
    print(f"  file: {(folder / LEDGER_NAME).stat().st_size / count:.0f} bytes a cell")
    with _timed("resume, all verified", count):
        Ledger.resume(folder, _NOTE, paths).close()
    with _timed("status"):
        study_status(folder)
    with _timed("open a cell", 25):
        for path in paths[:: count // 25][:25]:
            open_results(folder, path)
    with _timed("open an estimator of 100 cells"):
        open_results(folder, "e3/*")
    with _timed("write these as a store", 100):
        export_results(folder, folder / "x.zarr", "e3/*")
    with _timed("open the store", 100):
        open_results(folder / "x.zarr")
    print(f"  memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000:.0f} MB at most")


def _states(folder: Path, count: int, size: int) -> None:
    payload = np.random.default_rng(0).bytes(size)
    with (
        _timed(f"record {count:,} states of {size:,} bytes", count),
        Ledger.create(folder, _NOTE, ["a/b/c"]) as ledger,
    ):
        for block in range(count):
            ledger.record("a/b/c", "0-0-10", (block, 1), payload)
    print(f"  file: {(folder / LEDGER_NAME).stat().st_size / count:.0f} bytes a state")
    with _timed("resume, all verified", count):
        Ledger.resume(folder, _NOTE, ["a/b/c"]).close()


@contextmanager
def _timed(what: str, times: int = 1) -> Iterator[None]:
    wall, processor = time.perf_counter(), time.process_time()
    yield
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    unit, scale = ("s", 1.0) if times == 1 else ("ms each", 1000.0 / times)
    print(
        f"  {what:44s} {wall * scale:8.3f} {unit}, processor {processor * scale:8.3f}", flush=True
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
