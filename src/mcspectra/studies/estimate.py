"""What a study would take: time, memory and storage of every cell, from short tries of some.

A cell that repeats realisations is computed with few of them, twice, and the difference gives the
time of one more. Cells that are not tried, because the time for tries is over or they have no
realisations, are scaled by their cost from those that were.
"""

from __future__ import annotations

import contextlib
import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec

from mcspectra.core.staged import Whole
from mcspectra.studies.cells import compute_cell, staged_cell
from mcspectra.studies.foreign_code import TookTooLong, within
from mcspectra.studies.plan import Cell, Plan
from mcspectra.studies.scheduling import task_seconds

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["CellEstimate", "estimate_study", "wall_time"]

_FEW, _MORE = 4, 36
_TRIED = ("convergence", "terms", "techniques", "spectrum", "pcf", "anova")
_PATIENCE = 20.0  # seconds that a try may take beyond its time, as for the compilation of a kernel
_NOMINAL = 1e-7  # seconds for a unit of cost, where nothing was tried
_ARRAY_BYTES = 1500  # of metadata for every stored array
_CELL_BYTES = 30_000  # of a cell whose size is not known from a try


class CellEstimate(msgspec.Struct, frozen=True, kw_only=True):
    """Estimated seconds, bytes of memory and of storage of a cell; whether it was tried.

    Attributes
    ----------
    tasks
        Into how many tasks it will be cut, about: chunks of about a second, of the shortest cells one.
    error
        Why it will fail, if that is known already.
    """

    path: str
    estimator: str
    sampler: str
    analysis: str
    seconds: float
    memory: int
    storage: int
    tried: bool
    tasks: int = 1
    error: str | None = None


def estimate_study(plan: Plan, *, probe_seconds: float = 10.0) -> list[CellEstimate]:
    """Estimate every cell of a plan, in its order.

    Parameters
    ----------
    plan
        The study.
    probe_seconds
        Time for tries, about; 0 tries nothing.

    Returns
    -------
    list of CellEstimate
        With ``relative_error`` seconds are those of all realisations: the most.
    """
    measured: dict[str, tuple[float, int]] = {}
    end = time.monotonic() + probe_seconds
    for cell in _spread(plan.cells):
        left = end - time.monotonic()
        if left <= 0:
            break
        found = _tried(cell, plan.config.seed, left)
        if found is not None:
            measured[cell.path] = found
    known = [(cell, *measured[cell.path]) for cell in plan.cells if cell.path in measured]
    paces = _medians([(cell.analysis, seconds / cell.cost) for cell, seconds, _ in known])
    sizes = _medians([(cell.analysis, size) for cell, _, size in known])
    estimates = [_estimate(cell, measured.get(cell.path), paces, sizes) for cell in plan.cells]
    return _with_tasks(plan, estimates)


def wall_time(estimates: Sequence[CellEstimate], workers: int) -> float:
    """Seconds with so many workers: no less than the longest cell."""
    seconds = [each.seconds for each in estimates]
    return max(sum(seconds) / workers, max(seconds, default=0.0))


def _spread(cells: Sequence[Cell]) -> list[Cell]:
    """Cells that can be tried: the first of every analysis of every estimator before the others."""
    seen: set[tuple[str, str]] = set()
    first: list[Cell] = []
    later: list[Cell] = []
    for cell in cells:
        if cell.analysis in _TRIED and cell.error is None:
            kind = (cell.estimator_name, cell.analysis)
            (later if kind in seen else first).append(cell)
            seen.add(kind)
    return [*first, *later]


def _tried(cell: Cell, seed: int, left: float) -> tuple[float, int] | None:
    """Seconds and bytes of storage, or None if it fails or is too large to be tried."""
    settings: Any = cell.settings
    realizations = settings.realizations
    if cell.cost / realizations * _FEW * _NOMINAL > left:
        return None
    with contextlib.suppress(TookTooLong):
        return within(left + _PATIENCE, lambda: _measured(cell, realizations, seed, left))
    return None


def _measured(cell: Cell, realizations: int, seed: int, left: float) -> tuple[float, int] | None:
    """Seconds of all realisations and bytes of storage; None if the estimator fails."""
    try:
        first, result = _timed(cell, min(_FEW, realizations), seed)  # pays what is paid once
        few, _ = _timed(cell, min(_FEW, realizations), seed)
        if few * _MORE / _FEW > 0.1 * left:
            return first + few * realizations / _FEW, _storage(result)
        more, _ = _timed(cell, min(_MORE, realizations), seed)
    except BaseException:  # noqa: BLE001 - whatever the code of others does
        return None
    each = max(0.0, more - few) / (_MORE - _FEW)
    return more + each * max(0, realizations - _MORE), _storage(result)


def _timed(cell: Cell, realizations: int, seed: int) -> tuple[float, xr.Dataset]:
    changes: dict[str, Any] = {"realizations": realizations}
    if cell.analysis == "convergence":
        changes["relative_error"] = None
    settings = msgspec.structs.replace(cell.settings, **changes)
    start = time.perf_counter()
    result = compute_cell(replace(cell, settings=settings), seed)
    return time.perf_counter() - start, result


def _storage(result: xr.Dataset) -> int:
    return int(result.nbytes) + _ARRAY_BYTES * len(result.variables)


def _medians(values: list[tuple[str, float]]) -> dict[str, float]:
    """Median of each analysis, and of all as ``""``."""
    groups: dict[str, list[float]] = {}
    for analysis, value in values:
        groups.setdefault(analysis, []).append(value)
        groups.setdefault("", []).append(value)
    return {name: statistics.median(group) for name, group in groups.items()}


def _estimate(
    cell: Cell,
    found: tuple[float, int] | None,
    paces: dict[str, float],
    sizes: dict[str, float],
) -> CellEstimate:
    pace = paces.get(cell.analysis, paces.get("", _NOMINAL))
    storage = sizes.get(cell.analysis, _CELL_BYTES)
    return CellEstimate(
        path=cell.path,
        estimator=cell.estimator_name,
        sampler=cell.sampler_spec,
        analysis=cell.analysis,
        seconds=pace * cell.cost if found is None else found[0],
        memory=cell.memory,
        storage=int(storage) if found is None else found[1],
        tried=found is not None,
        error=cell.error,
    )


def _with_tasks(plan: Plan, estimates: Sequence[CellEstimate]) -> list[CellEstimate]:
    """Estimates with numbers of tasks, where an analysis can be cut and takes longer than a task."""
    target = task_seconds(plan.config.time_limit)
    cut: dict[str, bool] = {}
    found = []
    for cell, each in zip(plan.cells, estimates, strict=True):
        if each.seconds > target and cell.error is None:
            if cell.analysis not in cut:
                cut[cell.analysis] = _can_be_cut(cell, plan.config.seed)
            tasks = math.ceil(each.seconds / target) if cut[cell.analysis] else 1
            each = msgspec.structs.replace(each, tasks=tasks)
        found.append(each)
    return found


def _can_be_cut(cell: Cell, seed: int) -> bool:
    try:
        return not isinstance(staged_cell(cell, seed), Whole)
    except Exception:  # noqa: BLE001 - then it fails in the run too, as one task
        return False
