"""Studies: overhead of a cell, and speedup by two workers.

Cells of about half a second are computed by a study, with its tasks and files, and in a bare loop.
The overhead is the time of the study minus the time of the loop.
Efficiency is the time with one worker divided by w times the time with w workers.
Tasks that sleep show the cost of scheduling.
Real tasks also share Python's lock (threads) and a memory bus.
Without a study, two processes each loop over half of the cells.
The speedup by two plain processes is the upper bound for a study on two processors.
All methods take turns in several rounds. If times vary, the shortest time is used.
"""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from benchmarks.scaling import Napping
from mcspectra.studies import StudyConfig, decode_study, make_plan, run_study
from mcspectra.studies.executors import Cluster, Dask, Threads
from mcspectra.studies.run import MakeExecutor

SECONDS = 0.5
LONG = 1.5  # seconds for each long cell, so that the start of processes matters less
ROUNDS = 3
CELLS = 16
STUDY = """
title = "benchmark"
samplers = ["jittered"]
[convergence]
counts = [256]
realizations = 1000
[[estimators]]
name = "gaussian {width}"
integrand = "gaussian(width={width})"
dims = 2
grid = { width = [WIDTHS] }
"""


def study(realizations: int) -> StudyConfig:
    """Return a study whose cells all take the same time."""
    widths = ", ".join(f"{0.2 + 0.01 * i:.2f}" for i in range(CELLS))
    config = decode_study(STUDY.replace("WIDTHS", widths))
    table = msgspec.structs.replace(config.analyses["convergence"], realizations=realizations)
    return msgspec.structs.replace(config, analyses={"convergence": table})


def calibrated(seconds: float) -> StudyConfig:
    """Return the study with the number of realizations that takes `seconds` per cell."""
    few = 20_000
    _loop(study(few))  # the first run compiles
    each = min(_loop(study(few)) for _ in range(ROUNDS)) / CELLS
    return study(max(2, round(few * seconds / each)))


def main() -> None:
    """Print the overhead relative to a bare loop, and the efficiencies."""
    real = calibrated(SECONDS)
    rounds = [(_loop(real), _run(real, _threads(1))) for _ in range(ROUNDS)]
    loop, run = min(rounds, key=lambda pair: pair[1] / pair[0])
    print(
        f"{CELLS} cells of {loop / CELLS:.2f} s: bare loop {loop:.2f} s, study {run:.2f} s, "
        "overhead "
        f"{run / loop - 1:+.1%} ({1e3 * (run - loop) / CELLS:.0f} ms per cell)"
    )
    naps = study(2)
    one = _run(naps, _napping(1))
    for workers in (2, 4, 8):
        _print_efficiency("sleeping, threads", one, _run(naps, _napping(workers)), workers)
    _print_real(real, ROUNDS)
    _print_real(calibrated(LONG), 2)


def _print_real(config: StudyConfig, rounds: int) -> None:
    """Print the efficiency of two workers on real cells, and of two plain processes."""
    works: dict[str, Callable[[], float]] = {
        "bare": lambda: _loop(config),
        "two": lambda: _side_by_side(config),
        "thread": lambda: _run(config, _threads(1)),
        "threads": lambda: _run(config, _threads(2)),
        "processes": lambda: _run(config, _processes(2)),
    }
    times = [{name: work() for name, work in works.items()} for _ in range(rounds)]
    best = {name: min(each[name] for each in times) for name in works}
    print(f"cells of {best['bare'] / CELLS:.2f} s, best of {rounds} rounds:")
    _print_efficiency("  loops in two processes, no study", best["bare"], best["two"], 2)
    _print_efficiency("  threads", best["thread"], best["threads"], 2)
    _print_efficiency("  processes, their start included", best["thread"], best["processes"], 2)


def _print_efficiency(what: str, one: float, several: float, workers: int) -> None:
    print(
        f"{what}: 1 worker {one:.2f} s, {workers} workers {several:.2f} s, efficiency "
        f"{one / several / workers:.2f}"
    )


def _side_by_side(config: StudyConfig) -> float:
    """Return the seconds that two processes need if each computes half of the cells."""
    context = multiprocessing.get_context("spawn")
    gate = context.Barrier(3, timeout=600)  # raises an error unless both processes start
    halves = [context.Process(target=_half, args=(config, i, gate)) for i in range(2)]
    for half in halves:
        half.start()
    gate.wait()
    start = time.perf_counter()
    for half in halves:
        half.join()
    return time.perf_counter() - start


def _half(config: StudyConfig, first: int, gate: Any) -> None:
    plan = make_plan(config, Path())
    make_plan(study(2), Path()).cells[0].compute(config.seed)  # import modules and compile first
    gate.wait()
    for cell in plan.cells[first::2]:
        cell.compute(config.seed)


def _threads(workers: int) -> MakeExecutor:
    return lambda _: Threads(workers)


def _napping(workers: int) -> MakeExecutor:
    return lambda _: Napping(workers, SECONDS)


def _processes(workers: int) -> MakeExecutor:
    return lambda text: Dask(text, Cluster(workers=workers))


def _loop(config: StudyConfig) -> float:
    plan = make_plan(config, Path())
    start = time.perf_counter()
    for cell in plan.cells:
        cell.compute(config.seed)
    return time.perf_counter() - start


def _run(config: StudyConfig, engine: MakeExecutor) -> float:
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        run_study(config, folder, engine=engine)
        return time.perf_counter() - start


if __name__ == "__main__":
    main()
