"""Run a study: tasks on an executor, what they give in a ledger, at the end all of it for others to read."""

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
"""Makes what computes the tasks of a study."""

_AHEAD = 2  # tasks under way for each worker: one that it computes, one that waits
_NAMED = 5  # in a warning


@dataclass(frozen=True)
class Progress:
    """State after a cell."""

    cell: StudyCell
    done: int
    cells: int


class CellFailed(McspectraError, RuntimeError):
    """One or more cells raised; the others are kept."""

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
    """Run all cells of a study that are not in its folder yet; tell `mcspectra.core.progress` how far.

    Parameters
    ----------
    config
        The study.
    out
        Output folder: ``out/study.sqlite`` is the ledger of the run, ``out/results.zarr`` has the
        results at its end.
    folder
        Where relative paths in spec strings start: the study file's folder.
    resume
        Continue what is in the folder. Cells that failed stay so.
    retry
        With `resume`: try cells that failed again, and compute again those that depend on files
        (images, point sets, scenes, sources of functions) that have changed.
    workers
        Threads, or processes with a time limit; all processors by default. Results do not depend
        on it, bit for bit.
    time_limit
        Seconds that a task may take, by default the study's own; tasks then run in processes of their
        own, and one that takes longer is stopped and fails its cell.
    engine
        Makes what computes the tasks instead, such as a cluster's `mcspectra.studies.executors.Dask`.
    trust
        What the study may reach beyond `folder`; nothing by default.
    force
        Run however many evaluations it takes.
    report
        Called in this thread after every cell.

    Raises
    ------
    ConfigError, ParameterError, StoreError
        Before anything runs; StoreError also when results cannot be written.
    ClusterError
        Workers cannot be started or reached, cannot build the study, or are gone.
    CellFailed
        After everything else has run.
    MissingDependency
        A time limit, or an engine, needs the extra ``cluster``.
    KeyboardInterrupt
        Passed on, with a text; finished cells and finished tasks are kept, and the run can be resumed.

    Warns
    -----
    DamagedResultsWarning
        Results of an earlier run are damaged: they are computed again.
    OtherVersionsWarning
        An earlier run had other versions of packages that numbers depend on.
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
            ledger.forget(list(ledger.failures()))  # with their states: code may have been mended

        # Name what is computed again: the first few, and how many there are
        damaged = [f"{name} ({reason})" for name, reason in ledger.damaged.items()]
        if damaged:
            more = f" and {len(damaged) - _NAMED} more" if len(damaged) > _NAMED else ""
            parts = counted(len(damaged), "part")
            verb = "is" if len(damaged) == 1 else "are"
            warn(
                f"{parts} of the results in {str(out)!r} {verb} damaged, and what is lost is "
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
                executor = Dask(text, Cluster(workers=count, time_limit=limit))
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
            f"{len(failed)} of {counted(len(plan.cells), 'cell')} failed; the others are stored, and --resume "
            f"--retry tries these again. First: {path}: {message}",
            failed,
        )


@contextlib.contextmanager
def _told_where(out: Path) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"what was finished is in {out}, --resume continues") from None


def drive(schedule: Schedule, executor: Executor) -> Iterator[Settled]:
    """Have an executor compute a schedule; yields cells as they are done or fail."""
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
    """`drive`, and whatever ends it: what was computed is recorded, the workers are stopped."""
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
    """Paths of cells that depend on files that have changed since the folder's results were begun."""
    if not (out / LEDGER_NAME).exists():
        return frozenset()
    with Ledger.read(out) as begun:
        changed = set(changed_inputs(begun.study.inputs, plan.inputs))
    gone = changed - plan.inputs.keys()  # no cell names these any more: a scene did
    return frozenset(
        cell.path
        for cell in plan.cells
        if cell.inputs and (gone or not changed.isdisjoint(cell.inputs))
    )
