"""Run a study: tasks on an engine, results in a journal, finished cells in the store."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import msgspec

from mcspectra.core.checks import Array
from mcspectra.core.errors import DamagedResultsWarning, McspectraError, warn
from mcspectra.core.parallel import available_workers
from mcspectra.core.staged import Chunk, Staged
from mcspectra.studies.cells import finished_cell
from mcspectra.studies.config import StudyConfig
from mcspectra.studies.engines import Engine, LocalEngine, Outcome
from mcspectra.studies.inputs import changed_inputs
from mcspectra.studies.journal import Journal
from mcspectra.studies.lock import FolderLock
from mcspectra.studies.places import output_folder
from mcspectra.studies.plan import Cell, Plan, make_plan
from mcspectra.studies.processes import ProcessEngine, check_time_limit
from mcspectra.studies.scheduling import Pace, Recorded, Schedule, Settled, task_seconds
from mcspectra.studies.store import Store, config_hash, noted_inputs
from mcspectra.studies.tasks import StudyText, analysis_of, keep_plan, unpack_payload
from mcspectra.studies.trust import Trust
from mcspectra.version import __version__

__all__ = ["CellFailed", "MakeEngine", "Progress", "drive", "run_study"]

MakeEngine = Callable[[StudyText], Engine]
"""Makes the engine that computes the tasks of a study."""

_AHEAD = 2  # tasks under way for each worker: one that it computes, one that waits
_NAMED = 5  # in a warning
_TARGET = 1.0  # seconds of a task


@dataclass(frozen=True)
class Progress:
    """State after a cell: costs in the plan's units."""

    cell: Cell
    done: int
    cells: int
    done_cost: float
    total_cost: float


class CellFailed(McspectraError, RuntimeError):
    """One or more cells raised; the others are in the store."""

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
    engine: MakeEngine | None = None,
    trust: Trust | None = None,
    force: bool = False,
    report: Callable[[Progress], Any] | None = None,
) -> Store:
    """Run all cells of a study that are not in its store yet.

    Parameters
    ----------
    config
        The study.
    out
        Output folder; results go to ``out/results.zarr``, those of tasks of unfinished cells to
        ``out/journal``.
    folder
        Where relative paths in spec strings start: the study file's folder.
    resume
        Continue an existing store. Cells that failed stay so.
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
        Makes what computes the tasks instead, such as a cluster's.
    trust
        What the study may reach beyond `folder`; nothing by default.
    force
        Run however many evaluations it takes.
    report
        Called in this thread after every cell.

    Returns
    -------
    Store
        The finished store.

    Raises
    ------
    ConfigError, ParameterError, StoreError
        Before anything runs; StoreError also when results cannot be written.
    CellFailed
        After everything else has run.
    KeyboardInterrupt
        Passed on; finished cells and finished tasks are kept, and the run can be resumed.

    Warns
    -----
    DamagedResultsWarning
        Results of an earlier run are damaged: they are computed again.
    StaleLockWarning
        An earlier run ended without a word, as when it was killed.
    OtherVersionsWarning
        An earlier run had other versions of packages that numbers depend on.
    """
    out = output_folder(out)
    limit = check_time_limit(config.time_limit if time_limit is None else time_limit)
    count = available_workers(workers)
    config = msgspec.structs.replace(config, time_limit=limit)
    plan = make_plan(config, Path(folder), trust, force=force)
    text = StudyText.of(config, Path(folder), trust, force=force, inputs=plan.inputs)
    keep_plan(text, plan)
    make = engine or _own_engine(count, limit)
    paths = [cell.path for cell in plan.cells]
    with FolderLock.take(Path(out)) as lock:
        outdated = _outdated(plan, Path(out)) if retry else None
        store = Store.create(
            Path(out),
            config,
            resume=resume,
            paths=paths,
            lock=lock,
            inputs=plan.inputs,
            outdated=outdated,
        )
        begun = _journal(Path(out), plan, lock, resume=resume, retry=retry)
        with contextlib.closing(begun) as journal:
            run = _StudyRun(plan, text, store, journal, report)
            run.begin(retry=retry)
            _warn_of_damage(store, journal)
            pace = Pace(task_seconds(limit, _TARGET))
            try:
                run.compute(make, pace)
            finally:
                store.finish()
            journal.compact()
            failures = journal.failures()
    if failures:
        raise _failure(failures, plan)
    return store


def drive(
    schedule: Schedule, engine: Engine, record: Callable[[Outcome], Any]
) -> Iterator[Settled]:
    """Have an engine compute a schedule; yields cells as they are done or fail.

    Parameters
    ----------
    record
        Called with what is not yet part of a finished cell.
    """
    outcomes = engine.outcomes()
    while True:
        while schedule.under_way < _AHEAD * engine.workers:
            task = schedule.next_task()
            settled = list(schedule.settled())
            yield from settled
            if task is not None:
                engine.submit(task)
            elif not settled:
                break
        if not schedule.under_way:
            return
        outcome = next(outcomes)
        if schedule.take(outcome):
            record(outcome)
        yield from schedule.settled()


def _own_engine(workers: int, limit: float | None) -> MakeEngine:
    if limit is None:
        return lambda text: LocalEngine(text, workers)
    return lambda text: ProcessEngine(text, workers, limit)


def _journal(out: Path, plan: Plan, lock: FolderLock, *, resume: bool, retry: bool) -> Journal:
    header = {
        "study_hash": config_hash(plan.config),
        "seed": plan.config.seed,
        "version_mcspectra": __version__,
        "inputs": dict(plan.inputs),
    }
    if not resume:
        return Journal.create(out, header, lock=lock)
    # The store, which is of this study, has refused changed files, unless they are to be retried.
    return Journal.resume(out, header, lock=lock, renew=retry)


def _outdated(plan: Plan, out: Path) -> frozenset[str]:
    """Paths of cells that depend on files that have changed since the folder's results were begun."""
    changed = set(changed_inputs(noted_inputs(out), plan.inputs))
    gone = changed - plan.inputs.keys()  # no cell names these any more: a scene did
    return frozenset(
        cell.path
        for cell in plan.cells
        if cell.inputs and (gone or not changed.isdisjoint(cell.inputs))
    )


def _warn_of_damage(store: Store, journal: Journal) -> None:
    """Name what is computed again: the first few of each kind, and how many there are."""
    cells = [f"{path} ({reason})" for path, reason in store.damaged.items()]
    kinds = {"stored analyses": cells, "records of the journal": list(journal.damaged)}
    for kind, names in kinds.items():
        if names:
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            warn(
                f"{len(names)} {kind} in {str(store.folder)!r} are damaged and are computed again: "
                f"{', '.join(names[:_NAMED])}{more}.",
                DamagedResultsWarning,
            )


@final
class _StudyRun:
    """A run: what is stored, what is recorded, and how far it is."""

    def __init__(
        self,
        plan: Plan,
        text: StudyText,
        store: Store,
        journal: Journal,
        report: Callable[[Progress], Any] | None,
    ) -> None:
        self._plan = plan
        self._text = text
        self._store = store
        self._journal = journal
        self._report = report
        self._missing: list[Cell] = []
        self._keys: dict[str, list[str]] = {}  # what the journal has, by the path of its cell
        self._total = sum(cell.cost for cell in plan.cells)
        self._done_cost = self._total
        self._done = len(plan.cells)

    def begin(self, *, retry: bool) -> None:
        """Find out what is missing."""
        if retry:
            self._forget_failures()
        failed = self._journal.failures()
        done = {cell.path for cell in self._plan.cells if self._store.done(cell.path)}
        self._journal.forget([path for path in failed if path in done])
        self._missing = [
            cell for cell in self._plan.cells if cell.path not in done and cell.path not in failed
        ]
        self._done -= len(self._missing)
        self._done_cost -= sum(cell.cost for cell in self._missing)
        for key in tuple(self._journal.keys()):
            self._keys.setdefault(_path_of(key), []).append(key)
        stale = self._keys.keys() - {cell.path for cell in self._missing} - failed.keys()
        self._journal.forget([key for path in stale for key in self._keys.pop(path)])

    def _forget_failures(self) -> None:
        """Failures, and what else there is of those cells: code may have been mended meanwhile."""
        failed = self._journal.failures()
        parts = [key for key in self._journal.keys() if _path_of(key) in failed]  # noqa: SIM118
        self._journal.forget([*failed, *parts])

    def compute(self, make: MakeEngine, pace: Pace) -> None:
        """Compute what is missing."""
        if not self._missing:
            return
        schedule = Schedule(self._missing, self, self._recorded(), pace)
        engine = make(self._text)
        finished = False
        try:
            for settled in drive(schedule, engine, self._record):
                self._keep(settled)
            finished = True
        finally:
            engine.close(cancel=not finished)

    def analysis(self, cell: Cell) -> Staged[Any]:
        """The analysis of a cell: the one that threads of this process take too."""
        return analysis_of(self._text, cell.path)

    def load(self, key: str) -> dict[str, Array] | None:
        """What the journal has of a task; None if it is damaged."""
        try:
            return unpack_payload(self._journal.payload(key))
        except McspectraError:
            return None

    def _recorded(self) -> Recorded:
        return {path: [_chunk_of(key) for key in keys] for path, keys in self._keys.items()}

    def _record(self, outcome: Outcome) -> None:
        info = {"seconds": outcome.seconds, "host": outcome.host}
        self._journal.append(outcome.key, outcome.payload, None, info)
        self._keys.setdefault(_path_of(outcome.key), []).append(outcome.key)

    def _keep(self, settled: Settled) -> None:
        """Store a cell that is done, note why one has failed."""
        cell = settled.cell
        if settled.result is None:
            self._journal.append(cell.path, None, settled.error, {})
        else:
            self._store.write(cell.path, finished_cell(cell, settled.result))
            self._journal.forget(self._keys.pop(cell.path, ()))
        self._done, self._done_cost = self._done + 1, self._done_cost + cell.cost
        if self._report is not None:
            self._report(
                Progress(cell, self._done, len(self._plan.cells), self._done_cost, self._total)
            )


def _path_of(key: str) -> str:
    """The path of the cell that a task's key begins with."""
    return key.rsplit("/", 2)[0]


def _chunk_of(key: str) -> tuple[str, Chunk]:
    """The run's key and the blocks that a task's key ends with; no blocks where it does not."""
    *_, run, blocks = key.rsplit("/", 2)
    first, _, count = blocks.partition("+")
    return run, (int(first), int(count)) if first.isdigit() and count.isdigit() else (0, 0)


def _failure(failures: dict[str, str], plan: Plan) -> CellFailed:
    path, message = next(iter(failures.items()))
    return CellFailed(
        f"{len(failures)} of {len(plan.cells)} cells failed; the others are stored, and --resume "
        f"--retry tries these again. First: {path}: {message}",
        failures,
    )
