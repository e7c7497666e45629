"""Scaling of studies: overhead of tasks, cells and workers, efficiency, and memory.

Select parts by name: ``python -m benchmarks.scaling tasks workers``.
Without names, all parts run except ``million``, which takes minutes and 2 GB of disk.
Wall times depend on other load of the machine, but processor times hardly do. Both are printed.
"""

from __future__ import annotations

import itertools
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import xarray as xr

from mcspectra.core.analysis import Analysis, Need, Reduction, Subject
from mcspectra.core.records import SUM, pack
from mcspectra.core.results import Variable
from mcspectra.core.streams import Stream
from mcspectra.studies import (
    StudyConfig,
    decode_study,
    make_plan,
    open_results,
    result_scalars,
    run_study,
    study_status,
)
from mcspectra.studies.executors import Cluster, Dask, Threads
from mcspectra.studies.ledger import LEDGER_NAME, Ledger, StudyNote, scalars_of
from mcspectra.studies.plan import StudyCell, StudyPlan
from mcspectra.studies.run import MakeExecutor, Progress, drive
from mcspectra.studies.schedule import Schedule
from mcspectra.studies.tasks import StudyTask

_NAP = 0.2  # duration of a calibrated task, in seconds
_STUDY = """
title = "scaling"
samplers = ["random"]
grid = { width = [WIDTHS] }
[convergence]
counts = [4]
realizations = 2
[[estimators]]
name = "gaussian {width}"
integrand = "gaussian(width={width})"
dims = 1
"""


def main(*names: str) -> None:
    """Run the named parts, or all parts."""
    parts: dict[str, Callable[[], None]] = {
        "tasks": tasks,
        "cells": cells,
        "workers": workers,
        "efficiency": efficiency,
        "memory": memory,
        "million": million,
    }
    for name in names or (name for name in parts if name != "million"):
        parts[name]()


def tasks() -> None:
    """Print the overhead of a task: one cell has thousands of chunks that take no time."""
    for count in (10_000, 40_000):
        with _timed(f"{count:,} one-block tasks through schedule, thread and merge", count):
            _drive_many(count)


def cells() -> None:
    """Print the overhead of a cell: plan, schedule and row of the ledger."""
    count = 3000  # a run with more than 2,000 cells does not write a store at its end
    with _timed(f"decode and plan {count:,} short cells", count):
        plan = make_plan(_study(count), Path())
    plan.cells[0].compute(0)  # The first call imports modules and compiles
    with _timed("compute them", count):
        results = [cell.compute(0) for cell in plan.cells]
    with _timed("make bytes of their results", count):
        payloads = [(pack(result), scalars_of(result)) for result in results]
    with tempfile.TemporaryDirectory() as folder:
        _record(plan, Path(folder), payloads)
    with tempfile.TemporaryDirectory() as folder, _timed("all of it: the study on 1 thread", count):
        run_study(_study(count), folder, workers=1)


def million(count: int = 10**6) -> None:
    """Print times and memory for a million cells: plan, ledger, status and one cell."""
    samplers = ("random", "jittered", "halton", "sobol", "latin-hypercube")
    samplers += tuple(f"{name} | shift" for name in samplers)
    with _timed(f"decode {count:,} cells"):
        config = decode_study(
            _text(count // len(samplers)).replace('"random"', str(samplers)[1:-1])
        )
    with _timed("plan them", count):
        plan = make_plan(config, Path(), force=True)
    _print_memory("with the plan")
    assert len(plan.cells) == count
    result = plan.cells[0].compute(0)
    paths = [cell.path for cell in plan.cells]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _record(plan, folder, itertools.repeat((pack(result), scalars_of(result)), count))
        _print_memory("with the ledger written")
        with _timed("resume it, all verified", count):
            Ledger.resume(folder, StudyNote.of(config, plan.inputs), paths).close()
        with _timed("status"):
            assert len(study_status(folder).done) == count
        with _timed("open a cell by its path", 10):
            for path in paths[:: count // 10]:
                open_results(folder, path)
        _print_memory("at the end")
        with _timed("scalars of all"):
            assert len(result_scalars(folder)) == count


def _record(
    plan: StudyPlan, folder: Path, payloads: Iterable[tuple[bytes, dict[str, float]]]
) -> None:
    """Write a ledger of finished cells."""
    count = len(plan.cells)
    paths = [cell.path for cell in plan.cells]
    with _timed("begin their ledger", count):
        ledger = Ledger.create(folder, StudyNote.of(plan.config, plan.inputs), paths)
    with _timed("finish them in the ledger", count), ledger:
        for path, (payload, scalars) in zip(paths, payloads, strict=True):
            ledger.finish(path, payload, scalars)
    size = (folder / LEDGER_NAME).stat().st_size
    print(f"{size / count:.0f} bytes of ledger per cell, {size / 1e6:.0f} MB")


def workers() -> None:
    """Print the overhead of a worker: its start and its first task."""
    config = _study(16)
    for count in (1, 2):
        with _timed(f"16 short cells on {count} worker processes, their start included"):
            _run(config, lambda text, count=count: Dask(text, Cluster(workers=count)))
    with _timed("the same on 1 thread"):
        _run(config, lambda _: Threads(1))
    with _timed("400 short cells on 2 worker processes", 400):
        _run(_study(400), lambda text: Dask(text, Cluster(workers=2)))


def efficiency() -> None:
    """Print the time of one worker divided by w times the time of w workers; the tasks sleep."""
    config = _study(64)
    one = None
    for count in (1, 2, 4, 8):
        start = time.perf_counter()
        _run(config, lambda _, count=count: Napping(count, _NAP))
        seconds = time.perf_counter() - start
        one = one or seconds
        print(
            f"64 tasks of {_NAP} s, {count} workers: {seconds:.2f} s, efficiency "
            f"{one / seconds / count:.3f}, against sleep alone {64 * _NAP / seconds / count:.3f}"
        )


def memory() -> None:
    """Print the memory of the command that runs a study of ten thousand cells."""
    count = 10_000

    def told(progress: Progress) -> None:
        if progress.done in (100, 500) or progress.done % 1000 == 0:
            _print_memory(f"{progress.done:6,} of {count:,} short cells")

    with tempfile.TemporaryDirectory() as folder, _timed(f"{count:,} short cells", count):
        run_study(_study(count), folder, workers=1, report=told)


def _print_memory(when: str) -> None:
    """Print the current and the peak memory of this process."""
    now = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    most = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(f"{when}: {now / 1e6:.0f} MB, {most / 1e6:.0f} MB at most", flush=True)


@dataclass
class _Count:
    """Number of blocks."""

    blocks: SUM


class _Blocks(Analysis, frozen=True, kw_only=True):
    """An analysis of many blocks, whose result is the number of blocks."""

    variables = (Variable("number of blocks", "1", None, "f", "blocks"),)
    blocks: int

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[_Count]:  # noqa: ARG002
        return Reduction(
            kind=_Count,
            block=lambda _: _Count(np.ones(1)),
            blocks=self.blocks,
            cost=float(self.blocks),
            result=lambda state: xr.Dataset({"blocks": ((), state.blocks[0])}),
        )


class _Nothing:
    """A substitute for the database of a study; it stores nothing."""

    def tasks(self, path: str) -> list[Any]:  # noqa: ARG002
        return []

    def record(self, *_: object) -> None:
        pass


def _drive_many(count: int) -> None:
    cell = StudyCell(
        "a/s/k", _Blocks(blocks=count), "a", "s", Subject(None, None), Need(cost=count)
    )
    schedule = Schedule([cell], 0, _Nothing(), 1e-12)  # type: ignore[arg-type]
    threads = Threads(1)
    (settled,) = drive(schedule, threads)
    threads.close(cancel=False)
    assert settled.error is None


class Napping:
    """Threads that sleep until `seconds` have passed since the start of a task."""

    def __init__(self, workers: int, seconds: float) -> None:
        self._threads = Threads(workers)
        self._seconds = seconds
        self.workers = workers
        self.outcomes, self.close = self._threads.outcomes, self._threads.close

    def submit(self, task: StudyTask, compute: Callable[[], Any]) -> None:
        def nap() -> Any:
            start = time.perf_counter()
            state = compute()
            time.sleep(max(0.0, self._seconds - (time.perf_counter() - start)))
            return state

        self._threads.submit(task, nap)


def _text(count: int) -> str:
    return _STUDY.replace("WIDTHS", ", ".join(f"{0.2 + i / count:.6f}" for i in range(count)))


def _study(count: int) -> StudyConfig:
    return decode_study(_text(count))


def _run(config: StudyConfig, engine: MakeExecutor) -> None:
    with tempfile.TemporaryDirectory() as folder:
        run_study(config, folder, engine=engine)


def _processor() -> float:
    """Return processor seconds of this process and of ended child processes.

    A permanent helper process forks the workers. At the end of a study, all workers have ended.
    """
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    running = (each.cpu_times() for each in psutil.Process().children())
    return sum(each.ru_utime + each.ru_stime for each in used) + sum(
        t.user + t.system + t.children_user + t.children_system for t in running
    )


@contextmanager
def _timed(what: str, times: int = 1) -> Iterator[None]:
    wall, processor = time.perf_counter(), _processor()
    yield
    wall, processor = time.perf_counter() - wall, _processor() - processor
    unit, scale = ("s", 1.0) if times == 1 else ("ms each", 1000.0 / times)
    print(f"{what:64s} {wall * scale:8.3f} {unit}, processor {processor * scale:8.3f}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
