"""Run a study in this process: cells on a thread pool, largest first, each committed when done."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcspectra.core.errors import McspectraError
from mcspectra.core.parallel import available_workers
from mcspectra.studies.cells import compute_cell
from mcspectra.studies.config import StudyConfig
from mcspectra.studies.plan import Cell, Plan, make_plan
from mcspectra.studies.store import Store
from mcspectra.studies.trust import Trust

__all__ = ["CellFailed", "Progress", "run_study"]


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
    workers: int | None = None,
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
        Output folder; results go to ``out/results.zarr``.
    folder
        Where relative paths in spec strings start: the study file's folder.
    resume
        Continue an existing store.
    workers
        Threads; all processors by default. Results do not depend on it, bit for bit.
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
    ConfigError, StoreError
        Before anything runs.
    CellFailed
        After everything else has run.
    KeyboardInterrupt
        Passed on; the store keeps every finished cell and can be resumed.
    """
    plan = make_plan(config, Path(folder), trust, force=force)
    store = Store.create(Path(out), config, resume=resume)
    missing = [cell for cell in plan.cells if not store.done(cell.path)]
    total = sum(cell.cost for cell in plan.cells)
    done_cost = total - sum(cell.cost for cell in missing)
    done = len(plan.cells) - len(missing)
    failures: dict[str, str] = {}
    for cell, outcome in _outcomes(missing, config.seed, available_workers(workers)):
        if isinstance(outcome, McspectraError):
            failures[cell.path] = str(outcome)
        else:
            store.write(cell.path, outcome)
        done, done_cost = done + 1, done_cost + cell.cost
        if report is not None:
            report(Progress(cell, done, len(plan.cells), done_cost, total))
    store.finish()
    if failures:
        raise _failure(failures, plan)
    return store


def _outcomes(cells: list[Cell], seed: int, workers: int) -> Any:
    """Yield (cell, dataset or error) as cells finish; unexpected exceptions propagate."""
    queue = sorted(cells, key=lambda cell: -cell.cost)

    def attempt(cell: Cell) -> Any:
        try:
            return compute_cell(cell, seed)
        except McspectraError as error:
            return error

    with ThreadPoolExecutor(workers) as pool:
        running: dict[Future[Any], Cell] = {}
        try:
            while queue or running:
                # One cell ahead of the workers: results wait in memory for one writer only.
                while queue and len(running) <= workers:
                    cell = queue.pop(0)
                    running[pool.submit(attempt, cell)] = cell
                finished, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield running.pop(future), future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _failure(failures: dict[str, str], plan: Plan) -> CellFailed:
    path, message = next(iter(failures.items()))
    return CellFailed(
        f"{len(failures)} of {len(plan.cells)} cells failed; the others are stored, and --resume "
        f"tries these again. First: {path}: {message}",
        failures,
    )
