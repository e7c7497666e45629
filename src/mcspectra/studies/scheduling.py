"""Which task next: cells largest first, cut into chunks of about a second, merged as they come.

A cell that is expected to take no longer than a chunk is one task as a whole.

Sizes and order are for speed alone: chunks are nodes of a fixed tree (`mcspectra.core.staged`), so that
the result is the same bits for all of them, and for chunks of an earlier run that was cut otherwise.
"""

from __future__ import annotations

import asyncio
import math
import statistics
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar, final

from mcspectra.core.checks import Array
from mcspectra.core.staged import Chunk, MergeTree, Run, Staged, Whole
from mcspectra.studies.engines import Outcome
from mcspectra.studies.foreign_code import explain
from mcspectra.studies.plan import Cell
from mcspectra.studies.tasks import WHOLE, Task, task_of, unpack_payload

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Pace", "PartialRun", "Recorded", "Schedule", "Settled", "task_seconds"]

State = TypeVar("State")
_TARGET = 1.0  # seconds of a chunk
_OF_LIMIT = 0.2  # and at most this part of the time limit
_SAMPLES = 9  # latest measurements that the pace of an analysis is the median of
# An interrupt in this thread is the user's; what else ends a thread is of the code of others.
_FAILURES = (Exception, SystemExit, asyncio.CancelledError)
_INSTANT = 1e-9  # seconds: what takes less counts as this


def task_seconds(limit: float | None, target: float = _TARGET) -> float:
    """Seconds that a task should take, with a time limit in seconds or without."""
    return target if limit is None else min(target, _OF_LIMIT * limit)


@final
class Pace:
    """Seconds for a unit of cost, measured for each cell and each analysis.

    Parameters
    ----------
    target
        Seconds that a chunk should take: 2^k blocks come within √2 of it, unless one takes longer.
    """

    def __init__(self, target: float = _TARGET) -> None:
        self._target = target
        self._seconds: dict[str, deque[float]] = {}

    def learn(self, names: Iterable[str], cost: float, seconds: float) -> None:
        """A task of `cost` took `seconds`: remembered for its cell and for its analysis."""
        if cost > 0.0:
            for name in names:
                found = self._seconds.setdefault(name, deque(maxlen=_SAMPLES))
                found.append(seconds / cost)

    def forget(self, name: str) -> None:
        """Forget a cell, which is done."""
        self._seconds.pop(name, None)

    def blocks(self, names: Iterable[str], block_cost: float) -> int:
        """Blocks of a chunk, a power of two: of the first name that was measured, else one."""
        seconds = self.seconds(names, block_cost)
        if seconds is None:
            return 1
        return 1 << max(0, round(math.log2(self._target / max(seconds, _INSTANT))))

    def is_short(self, names: Iterable[str], cost: float) -> bool:
        """Whether work is known to take no longer than a chunk should."""
        seconds = self.seconds(names, cost)
        return seconds is not None and seconds <= self._target

    def seconds(self, names: Iterable[str], cost: float) -> float | None:
        """Expected seconds: by the first name that was measured; None if none was."""
        found = next((self._seconds[name] for name in names if name in self._seconds), None)
        return None if found is None else statistics.median(found) * cost


@final
class PartialRun(Generic[State]):
    """A run on its way: which chunks are merged, which are asked for, which are left.

    Chunks may come in any order; two that are halves of a node are merged at once.
    """

    def __init__(self, analysis: Staged[State], run: Run) -> None:
        self.run = run
        self._analysis = analysis
        self._nodes: dict[int, tuple[int, State]] = {}
        self._gaps: deque[Chunk] = deque([(0, run.blocks)])
        self._missing = run.blocks

    @property
    def complete(self) -> bool:
        """Whether all chunks are there."""
        return self._missing == 0

    def restore(self, found: Iterable[Chunk], load: Callable[[Chunk], State | None]) -> None:
        """Begin with chunks of an earlier run: as many as tile; those that `load` has not are left."""
        self._gaps.clear()
        position = 0
        # Aligned chunks lie inside one another or apart, so that of each nest the largest is taken.
        for first, count in sorted(found, key=lambda chunk: (chunk[0], -chunk[1])):
            if first < position or not self._aligned(first, count):
                continue
            state = load((first, count))
            if state is not None:
                self._leave(position, first)
                self.add((first, count), state)
                position = first + count
        self._leave(position, self.run.blocks)

    def next_chunk(self, size: int) -> Chunk | None:
        """The next chunk to compute, of at most `size` blocks; None if all are asked for."""
        if not self._gaps:
            return None
        first, left = self._gaps.popleft()
        while first % size:
            size //= 2
        if size > left and first + left < self.run.blocks:
            size = 1 << (left.bit_length() - 1)
        count = min(size, left)
        if count < left:
            self._gaps.appendleft((first + count, left - count))
        return first, count

    def add(self, chunk: Chunk, state: State) -> None:
        """Take in the state of a chunk."""
        first, count = chunk
        self._missing -= count
        while count & (count - 1) == 0 and self._nodes.get(first ^ count, (0,))[0] == count:
            other = self._nodes.pop(first ^ count)[1]
            left, right = (state, other) if first & count == 0 else (other, state)
            state = self._analysis.merge(left, right)
            first, count = first & ~count, 2 * count
        self._nodes[first] = count, state

    def total(self) -> State:
        """State of the whole run; of a complete one."""
        tree = MergeTree(self._analysis.merge)
        for first in sorted(self._nodes):
            count, state = self._nodes[first]
            tree.add(state, count)
        self._nodes.clear()
        return tree.total()

    def _aligned(self, first: int, count: int) -> bool:
        """Whether blocks are a `Chunk` of this run."""
        if count < 1 or first < 0 or first + count > self.run.blocks:
            return False
        size = 1 << (count - 1).bit_length()
        return first % size == 0 and (size == count or first + count == self.run.blocks)

    def _leave(self, first: int, stop: int) -> None:
        if stop > first:
            self._gaps.append((first, stop - first))


Recorded = Mapping[str, Iterable[tuple[str, Chunk]]]
"""Chunks of an earlier run: for each cell's path the keys of their runs and their blocks."""


@final
@dataclass(frozen=True)
class Settled:
    """A cell that is done, or failed.

    Attributes
    ----------
    cell
        Which.
    result
        Its dataset; None if it failed.
    error
        One sentence about why it failed.
    """

    cell: Cell
    result: xr.Dataset | None = None
    error: str | None = None


@final
class _Active:
    """A cell under way: its analysis, driven stage by stage."""

    def __init__(
        self, cell: Cell, source: Source, found: Iterable[tuple[str, Chunk]], pace: Pace
    ) -> None:
        self.cell = cell
        self.result: xr.Dataset | None = None
        self.seconds = 0.0  # of its tasks so far
        self._source = source
        self._runs: dict[str, PartialRun[Any]] = {}
        self._found: dict[str, list[Chunk]] = {}
        for key, chunk in found:
            self._found.setdefault(key, []).append(chunk)
        # A wanted precision may take any number of realisations, whatever the first ones took.
        fixed = getattr(cell.settings, "relative_error", None) is None and not self._found
        if fixed and pace.is_short((_whole_name(cell),), cell.cost):
            self._take_whole()
            return
        self._analysis: Staged[Any] = source.analysis(cell)
        self._stages = self._analysis.stages()
        self._go_on(None)
        cost = sum(part.run.cost for part in self._runs.values())
        if fixed and self._runs and pace.is_short((cell.analysis,), cost):
            self._take_whole()

    def next_task(self, pace: Pace) -> Task | None:
        """The next chunk of the costliest run that has some left."""
        names = (self.cell.path, self.cell.analysis)
        for part in sorted(self._runs.values(), key=lambda part: -part.run.cost):
            run = part.run
            chunk = part.next_chunk(pace.blocks(names, run.cost / run.blocks))
            if chunk is not None:
                return task_of(self.cell.path, run, chunk)
        return None

    def add(self, task: Task, payload: bytes) -> None:
        """Take in what a task gave; the next stage begins when it was the last of this one."""
        state = self._analysis.unpack(unpack_payload(payload))
        self._runs[task.run.key].add(task.chunk, state)
        if all(part.complete for part in self._runs.values()):
            self._go_on([part.total() for part in self._runs.values()])

    def _take_whole(self) -> None:
        """Have a worker compute all stages: fewer tasks, and nothing is left to do here."""
        whole = Whole(_elsewhere, self.cell.cost)
        self._analysis = whole
        self._stages = whole.stages()
        runs = [replace(run, part=WHOLE) for run in next(self._stages)]
        self._runs = {run.key: PartialRun(whole, run) for run in runs}

    def _go_on(self, states: list[Any] | None) -> None:
        """Send the states of a stage, until one needs something computed or all is done."""
        try:
            while True:
                runs = next(self._stages) if states is None else self._stages.send(states)
                self._runs = {run.key: self._begun(run) for run in runs}
                if not all(part.complete for part in self._runs.values()):
                    return
                states = [part.total() for part in self._runs.values()]
        except StopIteration as end:
            self._runs = {}
            self.result = end.value

    def _begun(self, run: Run) -> PartialRun[Any]:
        part = PartialRun(self._analysis, run)

        def load(chunk: Chunk) -> Any:
            arrays = self._source.load(task_of(self.cell.path, run, chunk).key)
            return None if arrays is None else self._analysis.unpack(arrays)

        part.restore(self._found.get(run.key, ()), load)
        return part


def _whole_name(cell: Cell) -> str:
    """Name for the pace of whole cells, in units of their own costs."""
    return f"all of {cell.analysis}"


def _elsewhere() -> xr.Dataset:
    raise AssertionError("whole cells are computed by workers")


class Source(Protocol):
    """Where a schedule's analyses and recorded chunks come from."""

    def analysis(self, cell: Cell) -> Staged[Any]:
        """The analysis of a cell."""

    def load(self, key: str) -> dict[str, Array] | None:
        """Arrays that an earlier run recorded; None if they are damaged."""


@final
class Schedule:
    """All cells to compute: hands out tasks and takes in what they gave.

    Cells begin only when no cell that has begun has tasks left, so that few are held in memory.

    Parameters
    ----------
    cells
        In any order.
    source
        Their analyses, and chunks of earlier runs.
    recorded
        What of those there is.
    pace
        Measured so far.
    """

    def __init__(
        self, cells: Iterable[Cell], source: Source, recorded: Recorded, pace: Pace
    ) -> None:
        self._waiting = deque(sorted(cells, key=lambda cell: -cell.cost))
        self._source = source
        self._recorded = recorded
        self._pace = pace
        self._active: dict[str, _Active] = {}
        self._under_way: dict[str, Task] = {}
        self._settled: deque[Settled] = deque()

    @property
    def under_way(self) -> int:
        """Number of tasks that were handed out and have not come back."""
        return len(self._under_way)

    def next_task(self) -> Task | None:
        """The next task; None if all have been handed out, or others must come back first.

        None too as soon as a cell is done that an earlier run recorded as a whole, so that of many
        such cells one result at a time is held: take `settled`, then ask again.
        """
        while True:
            for active in self._active.values():
                task = active.next_task(self._pace)
                if task is not None:
                    self._under_way[task.key] = task
                    return task
            if not self._waiting:
                return None
            if self._begin(self._waiting.popleft()):
                return None

    def take(self, outcome: Outcome) -> Task | None:
        """Take in an outcome; returns its task if its cell is still under way and wants more."""
        task = self._under_way.pop(outcome.key)
        active = self._active.get(task.path)
        if active is None:  # another task of its cell has failed
            return None
        if outcome.payload is None:
            self._settle(active.cell, error=outcome.error or "It failed without a reason.")
            return None
        self._learn(active, task, outcome.seconds)
        try:
            active.add(task, outcome.payload)
        except _FAILURES as error:  # of the estimator, or of a payload that cannot be read
            self._settle(active.cell, error=explain(error))
            return None
        if active.result is None:
            return task
        self._pace.learn((_whole_name(active.cell),), active.cell.cost, active.seconds)
        self._settle(active.cell, active.result)
        return None

    def _learn(self, active: _Active, task: Task, seconds: float) -> None:
        active.seconds += seconds
        if task.run_part != WHOLE:
            self._pace.learn((task.path, active.cell.analysis), task.cost, seconds)

    def settled(self) -> Iterator[Settled]:
        """Cells that were done or have failed since the last call."""
        while self._settled:
            yield self._settled.popleft()

    def _begin(self, cell: Cell) -> bool:
        """Begin a cell; whether that was all, as everything of it was recorded."""
        if cell.error is not None:
            self._settle(cell, error=cell.error)
            return False
        try:
            active = _Active(cell, self._source, self._recorded.get(cell.path, ()), self._pace)
        except _FAILURES as error:  # of the estimator, in what comes before the first realisation
            self._settle(cell, error=explain(error))
            return False
        if active.result is None:
            self._active[cell.path] = active
            return False
        self._settle(cell, active.result)
        return True

    def _settle(
        self, cell: Cell, result: xr.Dataset | None = None, error: str | None = None
    ) -> None:
        self._active.pop(cell.path, None)
        self._pace.forget(cell.path)
        self._settled.append(Settled(cell, result, error))
