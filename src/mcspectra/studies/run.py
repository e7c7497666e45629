"""Run a study: compute its tasks, store results in a ledger, and export them at the end."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from mcspectra.core import progress
from mcspectra.core.display import counted
from mcspectra.core.errors import DamagedResultsWarning, McspectraError, StoreError, warn
from mcspectra.core.parallel import available_workers
from mcspectra.studies.executors import Cluster, Dask, Executor, Threads, check_time_limit
from mcspectra.studies.files import StudyConfig, as_study
from mcspectra.studies.ledger import LEDGER_NAME, Ledger, StudyNote
from mcspectra.studies.plan import StudyCell, StudyPlan, make_plan
from mcspectra.studies.results import output_folder, write_zarr
from mcspectra.studies.schedule import Schedule, Settled, task_seconds
from mcspectra.studies.tasks import StudyText
from mcspectra.studies.vetting import Trust, changed_inputs

__all__ = ["CellFailed", "MakeExecutor", "Progress", "drive", "run_study"]

MakeExecutor = Callable[[StudyText], Executor]
"""A function that makes the executor of a study."""

_AHEAD = 2  # Tasks submitted per worker: one is computed, one waits
_NAMED = 5  # Maximum number of damaged parts named in a warning


@dataclass(frozen=True)
class Progress:
    """Progress of a run after a cell finished or failed."""

    cell: StudyCell
    done: int
    cells: int


class CellFailed(McspectraError, RuntimeError):
    """One or more cells failed; the results of the other cells are stored."""

    def __init__(self, message: str, failures: dict[str, str]) -> None:
        super().__init__(message)
        self.failures = failures


def run_study(
    config: StudyConfig,
    out: str | Path,
    *,
    folder: str | Path = ".",
    resume: bool = False,
    retry: bool = False,
    workers: int | None = None,
    time_limit: float | None = None,
    engine: MakeExecutor | None = None,
    trust: Trust | None = None,
    force: bool = False,
    report: Callable[[Progress], Any] | None = None,
) -> None:
    """Run all cells that a study's folder lacks, and report to `mcspectra.core.progress`.

    Parameters
    ----------
    config
        The study.
    out
        Output folder. The run writes its ledger ``out/study.sqlite``.
        At the end, the run writes the results ``out/results.zarr``.
    folder
        Folder that relative paths in specs start from, the folder of the study file.
    resume
        Continue the study in the folder. Failed cells stay failed.
    retry
        With `resume`, try failed cells again, and recompute cells that depend on changed files.
        Cells depend on files such as images, point sets, scenes, and sources of functions.
    workers
        Number of threads, or of processes with a time limit; all processors by default.
        Results have the same bits for any number of workers.
    time_limit
        Time limit of a task in seconds; by default the study's limit.
        With a limit, tasks run in separate processes.
        A task that exceeds the limit is stopped, and its cell fails.
    engine
        Function that makes an executor, such as `mcspectra.studies.executors.Dask` for a cluster.
    trust
        Files and functions that the study may use beyond `folder`; none by default.
    force
        Allow a study of any size.
    report
        Function called in this thread after every cell.

    Raises
    ------
    ConfigError, ParameterError, StoreError
        If the input is wrong, before anything runs. A StoreError may also come from a failed write.
    ClusterError
        If workers cannot be started or reached, cannot build the study, or are lost.
    CellFailed
        If cells failed. The error is raised after all other cells have run.
    MissingDependency
        If a time limit or an engine needs the missing extra ``cluster``.
    KeyboardInterrupt
        If the user interrupts the run. Finished cells and tasks are stored, and the run can resume.

    Warns
    -----
    DamagedResultsWarning
        If results of an earlier run are damaged; they are computed again.
    OtherVersionsWarning
        If an earlier run used other versions of packages that results depend on.
    """
    out = Path(output_folder(out))
    limit = check_time_limit(as_study(config).time_limit if time_limit is None else time_limit)
    count = available_workers(workers)
    config = msgspec.structs.replace(config, time_limit=limit)
    plan = make_plan(config, folder, trust, force=force)
    text = StudyText.of(config, Path(folder), trust, force=force, inputs=plan.inputs)
    note, paths = StudyNote.of(config, plan.inputs), [cell.path for cell in plan.cells]
    with (
        _told_where(out),
        Ledger.resume(out, note, paths, outdated=_outdated(plan, out) if retry else ())
        if resume
        else Ledger.create(out, note, paths) as ledger,
    ):
        if resume and retry:
            ledger.forget(list(ledger.failures()))  # Code may have changed since these cells failed

        # Name the first few damaged parts, and count the others
        damaged = [f"{name} ({reason})" for name, reason in ledger.damaged.items()]
        if damaged:
            more = f" and {len(damaged) - _NAMED} more" if len(damaged) > _NAMED else ""
            parts = counted(len(damaged), "part")
            verb = "is" if len(damaged) == 1 else "are"
            warn(
                f"{parts} of the results in {str(out)!r} {verb} damaged, and lost results are "
                f"computed again: {', '.join(damaged[:_NAMED])}{more}.",
                DamagedResultsWarning,
            )
        failed = ledger.failures()
        missing = [c for c in plan.cells if c.path not in ledger.done and c.path not in failed]
        if missing:
            schedule = Schedule(missing, config.seed, ledger, task_seconds(limit))
            if engine is not None:
                executor = engine(text)
            elif limit is None:
                executor = Threads(count)
            else:
                executor = Dask(text, Cluster(workers=count, dashboard=None, time_limit=limit))
            total, left = (sum(c.need.cost for c in cells) for cells in (plan.cells, missing))
            with contextlib.closing(_computed(schedule, executor)) as computed:
                for done, settled in enumerate(computed, len(plan.cells) - len(missing) + 1):
                    cell = settled.cell
                    if settled.payload is None:
                        ledger.fail(cell.path, settled.error or "It failed without a reason.")
                    else:
                        ledger.finish(cell.path, settled.payload, settled.scalars)
                    left -= cell.need.cost
                    share = 1.0 if done == len(plan.cells) else 1.0 - left / max(total, 1e-300)
                    progress.report(f"study of {counted(len(plan.cells), 'cell')}", share)
                    if report is not None:
                        report(Progress(cell, done, len(plan.cells)))
        failed = ledger.failures()
        ledger.commit()
        write_zarr(out)
    if failed:
        path, message = next(iter(failed.items()))
        raise CellFailed(
            f"{len(failed)} of {counted(len(plan.cells), 'cell')} failed; the others are stored. "
            f"To try them again, use --resume --retry. First failure: {path}: {message}",
            failed,
        )


@contextlib.contextmanager
def _told_where(out: Path) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"finished work is in {out}; --resume continues") from None


def drive(schedule: Schedule, executor: Executor) -> Iterator[Settled]:
    """Compute a schedule on an executor; yield cells as they finish or fail."""
    outcomes = executor.outcomes()
    while True:
        while schedule.under_way < _AHEAD * executor.workers:
            work = schedule.next_work()
            settled = list(schedule.settled())
            yield from settled
            if work is not None:
                executor.submit(*work)
            elif not settled:
                break
        if not schedule.under_way:
            return
        schedule.take(next(outcomes))
        yield from schedule.settled()


def _computed(schedule: Schedule, executor: Executor) -> Generator[Settled]:
    """Call `drive`; however it ends, record the computed chunks and stop the workers."""
    finished = False
    try:
        yield from drive(schedule, executor)
        finished = True
    finally:
        if not finished:
            with contextlib.suppress(StoreError):
                schedule.record()
        executor.close(cancel=not finished)


def _outdated(plan: StudyPlan, out: Path) -> frozenset[str]:
    """Return the paths of cells whose input files changed since the stored run began."""
    if not (out / LEDGER_NAME).exists():
        return frozenset()
    with Ledger.read(out) as begun:
        changed = set(changed_inputs(begun.study.inputs, plan.inputs))
    # Files that were inputs of the stored run, but are not inputs of the study any more
    gone = changed - plan.inputs.keys()
    return frozenset(
        cell.path
        for cell in plan.cells
        if cell.inputs and (gone or not changed.isdisjoint(cell.inputs))
    )
