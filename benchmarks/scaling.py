"""Scaling of studies: overhead of tasks and workers, efficiency, memory.

Parts by name: ``python -m benchmarks.scaling tasks workers``; all of them without. Wall times depend on
what else the machine does, processor times hardly; both are printed.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
from mcspectra.studies.engines import Engine, LocalEngine, Outcome, attempt
from mcspectra.studies.processes import ProcessEngine

from mcspectra.studies import StudyConfig, decode_study, run_study
from mcspectra.studies.run import Progress
from mcspectra.studies.tasks import StudyText, Task

_NAP = 0.2  # seconds of a calibrated task
_STUDY = """
title = "scaling"
samplers = ["random"]
[convergence]
counts = [4]
realizations = 2
[[estimators]]
name = "gaussian {width}"
integrand = "gaussian(width={width})"
dims = 1
grid = { width = [WIDTHS] }
"""


def main(*names: str) -> None:
    """Run the parts that are named, or all."""
    parts: dict[str, Callable[[], None]] = {
        "tasks": tasks,
        "workers": workers,
        "efficiency": efficiency,
        "memory": memory,
    }
    for name in names or parts:
        parts[name]()


def tasks() -> None:
    """What a task costs beyond its computation: one cell of thousands of chunks that take no time."""
    for count in (10_000, 40_000):
        with _timed(f"{count:,} one-block tasks through schedule, engine and merge", count):
            _drive_many(count)


def workers() -> None:
    """What a worker costs: its start, and the first task in it."""
    config = _study(16)
    for count in (1, 2):
        with _timed(f"16 short cells on {count} worker processes, their start included"):
            _run(config, lambda text, count=count: ProcessEngine(text, count))
    with _timed("the same on 1 thread"):
        _run(config, lambda text: LocalEngine(text, 1))
    for count in (1, 2):
        _dask(config, count)


def efficiency() -> None:
    """Time with one worker over that with w, divided by w, of tasks that sleep."""
    config = _study(64)
    one = None
    for count in (1, 2, 4, 8):
        start = time.perf_counter()
        _run(config, lambda text, count=count: LocalEngine(text, count, _napping))
        seconds = time.perf_counter() - start
        one = one or seconds
        print(
            f"64 tasks of {_NAP} s, {count} workers: {seconds:.2f} s, efficiency "
            f"{one / seconds / count:.3f}, against sleep alone {64 * _NAP / seconds / count:.3f}"
        )


def memory() -> None:
    """Memory of the command while a study of ten thousand cells goes on."""
    count = 10_000

    def told(progress: Progress) -> None:
        if progress.done in (100, 500) or progress.done % 1000 == 0:
            used = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
            print(f"{progress.done:6,} of {count:,} short cells: {used / 1e6:.0f} MB", flush=True)

    with tempfile.TemporaryDirectory() as folder, _timed(f"{count:,} short cells", count):
        run_study(_study(count), folder, workers=1, report=told)


def _drive_many(count: int) -> None:
    from mcspectra.studies.scheduling import Pace, Schedule

    from mcspectra.studies.plan import Cell
    from mcspectra.studies.run import drive

    source = _Numbers(count)
    cell = Cell("a/s/k", "k", "a", "s", None, None, None, 1.0)  # type: ignore[arg-type]
    schedule = Schedule([cell], source, {}, Pace(1e-12))  # type: ignore[arg-type]
    text = StudyText(config_json="", folder="", seed=0, version="")
    engine = LocalEngine(text, 1, source.compute)
    (settled,) = drive(schedule, engine, lambda _: None)
    engine.close(cancel=False)
    assert settled.result == count


class _Numbers:
    """An analysis of many blocks that counts them, and where a schedule gets it from."""

    def __init__(self, blocks: int) -> None:
        from mcspectra.core.staged import Run

        self._run = Run(part=0, first=0, realizations=blocks, blocks=blocks, cost=float(blocks))

    def analysis(self, _: object) -> _Numbers:
        return self

    def stages(self):  # type: ignore[no-untyped-def]
        (total,) = yield [self._run]
        return total

    def merge(self, left: int, right: int) -> int:
        return left + right

    def unpack(self, arrays: dict[str, np.ndarray]) -> int:
        return int(arrays["n"])

    def compute(self, _: StudyText, task: Task) -> Outcome:
        from mcspectra.studies.tasks import pack_payload

        payload = pack_payload({"n": np.array(task.chunk_blocks)})
        return Outcome(key=task.key, payload=payload, seconds=1.0)


def _dask(config: StudyConfig, count: int) -> None:
    from mcspectra.studies.cluster import ClusterOptions, DaskEngine

    options = ClusterOptions(address="local", workers=count)
    with _timed(f"the same on {count} dask workers of this machine, their start included"):
        _run(config, lambda text: DaskEngine(text, options))
    with _timed("400 short cells more", 400):
        _run(_study(400), lambda text: DaskEngine(text, options))


def _napping(text: StudyText, task: Task) -> Outcome:
    start = time.perf_counter()
    outcome = attempt(text, task)
    time.sleep(max(0.0, _NAP - (time.perf_counter() - start)))
    return msgspec.structs.replace(outcome, seconds=_NAP)


def _text(count: int) -> str:
    return _STUDY.replace("WIDTHS", ", ".join(f"{0.2 + i / count:.6f}" for i in range(count)))


def _study(count: int) -> StudyConfig:
    return decode_study(_text(count))


def _run(config: StudyConfig, engine: Callable[[StudyText], Engine]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        run_study(config, folder, engine=engine)


def _processor() -> float:
    """Processor seconds of this process and of those that it began and that have ended."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


@contextmanager
def _timed(what: str, times: int = 1) -> Iterator[None]:
    wall, processor = time.perf_counter(), _processor()
    yield
    wall, processor = time.perf_counter() - wall, _processor() - processor
    unit, scale = ("s", 1.0) if times == 1 else ("ms each", 1000.0 / times)
    print(f"{what:64s} {wall * scale:8.3f} {unit}, processor {processor * scale:8.3f}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
