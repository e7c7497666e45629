"""Studies: what a cell costs beyond its own time, and what two workers gain.

Overhead: cells of about half a second through tasks, journal and store, against a bare loop over the
same cells. Efficiency: time with one worker over that with w, divided by w; for tasks that sleep, which
shows what the scheduling costs, and for real ones, which share a memory bus too.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from mcspectra.studies import StudyConfig, decode_study, make_plan, run_study
from mcspectra.studies.cells import compute_cell
from mcspectra.studies.engines import Engine, LocalEngine, Outcome, attempt
from mcspectra.studies.processes import ProcessEngine
from mcspectra.studies.tasks import StudyText, Task

SECONDS = 0.5
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
    """A study of equal cells."""
    widths = ", ".join(f"{0.2 + 0.01 * i:.2f}" for i in range(CELLS))
    config = decode_study(STUDY.replace("WIDTHS", widths))
    assert config.convergence is not None
    table = msgspec.structs.replace(config.convergence, realizations=realizations)
    return msgspec.structs.replace(config, convergence=table)


def calibrated() -> StudyConfig:
    """The study with as many realisations as take `SECONDS` in a cell."""
    few = 4000
    _loop(study(few))  # compile
    each = _loop(study(few)) / CELLS
    return study(max(2, round(few * SECONDS / each)))


def napping(text: StudyText, task: Task) -> Outcome:
    """A task that takes `SECONDS` and no processor."""
    time.sleep(SECONDS)
    return attempt(text, task)


def main() -> None:
    """Print the overhead over a bare loop, and efficiencies."""
    real = calibrated()
    rounds = [(_loop(real), _run(real, _threads(1))) for _ in range(3)]
    loop, run = min(rounds, key=lambda pair: pair[1] / pair[0])
    print(
        f"{CELLS} cells of {loop / CELLS:.2f} s: bare loop {loop:.2f} s, study {run:.2f} s, overhead "
        f"{run / loop - 1:+.1%} ({1e3 * (run - loop) / CELLS:.0f} ms a cell)"
    )
    naps = study(2)
    for workers in (2, 4, 8):
        _print_efficiency("sleeping, threads", naps, workers, _napping_threads)
    _print_efficiency("real, threads", real, 2, _threads)
    _print_efficiency("real, processes (their start included)", real, 2, _processes)


def _print_efficiency(
    what: str,
    config: StudyConfig,
    workers: int,
    make: Callable[[int], Callable[[StudyText], Engine]],
) -> None:
    one, several = _run(config, make(1)), _run(config, make(workers))
    print(
        f"{what}: 1 worker {one:.2f} s, {workers} workers {several:.2f} s, efficiency "
        f"{one / several / workers:.2f}"
    )


def _threads(workers: int) -> Callable[[StudyText], Engine]:
    return lambda text: LocalEngine(text, workers)


def _napping_threads(workers: int) -> Callable[[StudyText], Engine]:
    return lambda text: LocalEngine(text, workers, napping)


def _processes(workers: int) -> Callable[[StudyText], Engine]:
    return lambda text: ProcessEngine(text, workers)


def _loop(config: StudyConfig) -> float:
    plan = make_plan(config, Path())
    start = time.perf_counter()
    for cell in plan.cells:
        compute_cell(cell, config.seed)
    return time.perf_counter() - start


def _run(config: StudyConfig, engine: Callable[[StudyText], Engine]) -> float:
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        run_study(config, folder, engine=engine)
        return time.perf_counter() - start


if __name__ == "__main__":
    main()
