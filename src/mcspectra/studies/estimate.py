"""Estimate the time, memory and storage of every cell of a study from short trial runs.

For an analysis of a scene, the trial run measures a few pixels (`Analysis.trial`).
For an analysis with many realizations, two trial runs use few realizations, and a third uses more.
The time per realization follows from the extra time of the third run.
The time of a cell without a trial run is estimated in proportion to the cell's cost.
"""

from __future__ import annotations

import contextlib
import functools
import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import replace

import msgspec

from mcspectra.core.analysis import steps_of
from mcspectra.core.checks import as_real
from mcspectra.core.display import shown
from mcspectra.core.errors import ConfigError
from mcspectra.core.streams import Stream
from mcspectra.studies.foreign_code import TookTooLong, within
from mcspectra.studies.plan import StudyCell, StudyPlan
from mcspectra.studies.schedule import task_seconds

__all__ = ["CellEstimate", "estimate_study", "wall_time"]

_FEW, _MORE = 4, (36, 324, 2916, 26_244)  # Numbers of realizations in trial runs
_PATIENCE = 20.0  # Extra seconds that a trial run may take, for example to compile a kernel
_NOMINAL = 1e-7  # Assumed seconds per unit of cost if there were no trial runs
_ARRAY_BYTES = 1500  # Bytes of metadata per stored array
_CELL_BYTES = 30_000  # Stored bytes of a cell without a trial run


class CellEstimate(msgspec.Struct, frozen=True, kw_only=True):
    """Estimated seconds, bytes of memory and bytes of storage of a cell.

    Attributes
    ----------
    tried
        Whether the estimate comes from a trial run of this cell.
    tasks
        Approximate number of tasks: one per second of work, or a single one for a short cell.
    error
        Reason why the cell will fail, if planning found one.
    alone
        Whether the cell uses all processors by itself, as renderers do.
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
    alone: bool = False


def estimate_study(plan: StudyPlan, *, probe_seconds: float = 10.0) -> list[CellEstimate]:
    """Estimate every cell of a plan, in the order of the plan.

    Parameters
    ----------
    plan
        The plan of a study.
    probe_seconds
        Approximate time for all trial runs in seconds; with 0 there are no trial runs.

    Returns
    -------
    list of CellEstimate
        One estimate per cell. An analysis that may stop early is assumed to use all realizations.
    """
    if not isinstance(plan, StudyPlan):
        raise ConfigError(f"{shown(plan)} is not a plan; pass the result of make_plan.")
    probe_seconds = as_real("probe_seconds", probe_seconds, least=0.0)
    seed = plan.config.seed

    # Try as many cells as time allows; begin with one cell per analysis and estimator
    seen: set[tuple[str, str]] = set()
    first: list[StudyCell] = []
    later: list[StudyCell] = []
    for cell in plan.cells:
        if hasattr(cell.analysis, "realizations") and cell.error is None:
            kind = (cell.estimator_name, cell.analysis_name)
            (later if kind in seen else first).append(cell)
            seen.add(kind)
    tried: dict[str, tuple[float, int]] = {}
    end = time.monotonic() + probe_seconds
    for cell in (*first, *later):
        left = end - time.monotonic()
        if left <= 0:
            break
        with contextlib.suppress(TookTooLong):
            found = within(left + _PATIENCE, functools.partial(_measured, cell, seed, left))
            tried |= {} if found is None else {cell.path: found}

    # Estimate the times of the other cells in proportion to their cost
    known = [(cell, *tried[cell.path]) for cell in plan.cells if cell.path in tried]
    paces = _medians([(each.analysis_name, seconds / each.need.cost) for each, seconds, _ in known])
    sizes = _medians([(each.analysis_name, float(size)) for each, _, size in known])
    target = task_seconds(plan.config.time_limit)
    cut: dict[str, bool] = {}
    estimates = []
    for cell in plan.cells:
        name = cell.analysis_name
        pace = paces.get(name, paces.get("", _NOMINAL))
        guess = pace * cell.need.cost, sizes.get(name, _CELL_BYTES)
        seconds, storage = tried.get(cell.path, guess)
        if seconds > target and name not in cut:
            cut[name] = False
            with contextlib.suppress(Exception):  # The run of the study will report the error
                steps = steps_of(cell.analysis, cell.subject, Stream.from_rng(seed))
                cut[name] = sum(each.blocks for each in next(steps)) > 1
        estimates.append(
            CellEstimate(
                path=cell.path,
                estimator=cell.estimator_name,
                sampler=cell.sampler_spec,
                analysis=name,
                seconds=seconds,
                memory=cell.need.memory,
                storage=int(storage),
                tried=cell.path in tried,
                tasks=math.ceil(seconds / target) if seconds > target and cut[name] else 1,
                error=cell.error,
                alone=cell.analysis.about == "scene",
            )
        )
    return estimates


def wall_time(estimates: Sequence[CellEstimate], workers: int) -> float:
    """Return the estimated seconds of a study with this number of workers.

    The estimate is at least the time of the longest cell.
    """
    alone = sum(each.seconds for each in estimates if each.alone)
    seconds = [each.seconds for each in estimates if not each.alone]
    return alone + max(sum(seconds) / workers, max(seconds, default=0.0))


def _measured(cell: StudyCell, seed: int, left: float) -> tuple[float, int] | None:
    """Return seconds of all realizations and stored bytes, or None if a cell fails or is large."""
    realizations: int = cell.analysis.realizations  # type: ignore[attr-defined]
    scene = cell.analysis.about == "scene"
    if not scene and cell.need.cost / realizations * _FEW * _NOMINAL > left:
        return None
    few = min(_FEW, realizations)
    try:
        found = cell.analysis.trial(cell.subject, Stream.from_rng(seed), 0.5 * left)
        if found is not None:
            return found
        first, size = _timed(cell, few, seed)  # The first run may include compilation
        again, _ = _timed(cell, few, seed)
        if 2 * again > left:
            return first + again * realizations / few, size
        # Add realizations until their time is clearly longer than the fixed cost of a call
        for more in _MORE if _MORE[0] / _FEW * again < 0.1 * left else (2 * _FEW,):
            count = min(more, realizations)
            seconds, _ = _timed(cell, count, seed)
            if count == realizations or seconds > min(2 * again, 0.01 * left):
                break
    except BaseException:  # noqa: BLE001 - user code may raise anything
        return None
    each = (seconds - again) / (count - few) if seconds > again and count > few else seconds / count
    return seconds + each * (realizations - count), size


def _timed(cell: StudyCell, realizations: int, seed: int) -> tuple[float, int]:
    """Run a cell with `realizations`; return the seconds, and the size of the result in bytes."""
    analysis = msgspec.structs.replace(cell.analysis, realizations=realizations)
    start = time.perf_counter()
    result = replace(cell, analysis=analysis).compute(seed)
    seconds = time.perf_counter() - start
    return seconds, int(result.nbytes) + _ARRAY_BYTES * len(result.variables)


def _medians(values: list[tuple[str, float]]) -> dict[str, float]:
    """Return the median value of each analysis by name; the key ``""`` has the overall median."""
    groups: dict[str, list[float]] = {}
    for analysis, value in values:
        groups.setdefault(analysis, []).append(value)
        groups.setdefault("", []).append(value)
    return {name: statistics.median(group) for name, group in groups.items()}
