"""Which task next: cells largest first, cut into chunks of about a second, merged as they come.

A cell that is expected to take no longer than a chunk is one task as a whole.

Sizes and order are for speed alone: chunks are nodes of a fixed tree (`mcspectra.core.analysis`), so
that the result is the same bits for all of them, and for chunks of an earlier run that was cut otherwise.
"""

from __future__ import annotations

import asyncio
import functools
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar, final

import xarray as xr

from mcspectra.core.analysis import Chunk, MergeTree, Reduction, compute_chunk, steps_of
from mcspectra.core.errors import StoreError
from mcspectra.core.records import pack, unpack
from mcspectra.core.streams import Stream
from mcspectra.studies.foreign_code import explain
from mcspectra.studies.ledger import Ledger, scalars_of
from mcspectra.studies.plan import StudyCell
from mcspectra.studies.tasks import Outcome, StudyTask

__all__ = ["PartialRun", "Schedule", "Settled", "Work", "task_seconds"]

State = TypeVar("State")
Work = tuple[StudyTask, Callable[[], Any]]
"""A task, and what computes it in a thread of this process."""

_TARGET = 1.0  # seconds of a chunk
_OF_LIMIT = 0.2  # and at most this part of the time limit
_RECORDED_AFTER = 1.0  # seconds of a cell's work, which a kill may lose: recording costs too
_INSTANT = 1e-9  # seconds: what takes less counts as this
# An interrupt in this thread is the user's; what else ends a thread is of the code of others.
_FAILURES = (Exception, SystemExit, asyncio.CancelledError)


def task_seconds(limit: float | None) -> float:
    """Seconds that a task should take, with a time limit in seconds or without."""
    return _TARGET if limit is None else min(_TARGET, _OF_LIMIT * limit)


@final
class PartialRun(Generic[State]):
    """A reduction on its way: which chunks are merged, which are asked for, which are left.

    Chunks may come in any order; two that are halves of a node are merged at once.
    """

    def __init__(self, reduction: Reduction[State]) -> None:
        self.reduction = reduction
        self._tree: MergeTree[State] = MergeTree()
        self._gaps: deque[Chunk] = deque([(0, reduction.blocks)])
        self._missing = reduction.blocks
        self._fresh: set[int] = set()  # first blocks of nodes that are not recorded

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
                self._missing -= count
                self._tree.put((first, count), state)
                position = first + count
        self._leave(position, self.reduction.blocks)

    def next_chunk(self, size: int) -> Chunk | None:
        """The next chunk to compute, of at most `size` blocks; None if all are asked for."""
        if not self._gaps:
            return None
        first, left = self._gaps.popleft()
        while first % size:
            size //= 2
        if size > left and first + left < self.reduction.blocks:
            size = 1 << (left.bit_length() - 1)
        count = min(size, left)
        if count < left:
            self._gaps.appendleft((first + count, left - count))
        return first, count

    def add(self, chunk: Chunk, state: State) -> None:
        """Take in the state of a chunk that was computed."""
        self._missing -= chunk[1]
        self._fresh.add(self._tree.put(chunk, state))

    def fresh(self) -> Iterator[tuple[Chunk, State]]:
        """Merged chunks in which something is that was computed since the last call."""
        while self._fresh:
            first = self._fresh.pop()
            if first in self._tree.nodes:
                count, state = self._tree.nodes[first]
                yield (first, count), state

    def total(self) -> State:
        """State of all blocks; of a complete one."""
        return self._tree.total()

    def _aligned(self, first: int, count: int) -> bool:
        """Whether blocks are a `Chunk` of this run."""
        if count < 1 or first < 0 or first + count > self.reduction.blocks:
            return False
        size = 1 << (count - 1).bit_length()
        return first % size == 0 and (size == count or first + count == self.reduction.blocks)

    def _leave(self, first: int, stop: int) -> None:
        if stop > first:
            self._gaps.append((first, stop - first))


@final
@dataclass(frozen=True)
class Settled:
    """A cell that is done, or failed.

    Attributes
    ----------
    cell
        Which.
    payload, scalars
        Its dataset as bytes, and the scalars of it; None if it failed.
    error
        One sentence about why it failed.
    """

    cell: StudyCell
    payload: bytes | None = None
    scalars: Mapping[str, float] = field(default_factory=dict)
    error: str | None = None


@final
class _Active:
    """A cell under way: its analysis, driven step by step, or all of it as one task."""

    def __init__(self, cell: StudyCell, seed: int, ledger: Ledger, *, whole: bool) -> None:
        self.cell = cell
        self.settled: Settled | None = None
        self.pace: float | None = None  # seconds for a unit of cost
        self._seed = seed
        self._ledger = ledger
        self._parts: dict[str, PartialRun[Any]] = {}
        self._whole = whole
        self._unrecorded = 0.0  # seconds
        if not whole:
            self._found: dict[str, list[Chunk]] = {}
            for key, chunk in ledger.tasks(cell.path):
                self._found.setdefault(key, []).append(chunk)
            self._steps = steps_of(cell.analysis, cell.subject, Stream.from_rng(seed))
            self.advance(None)

    @property
    def complete(self) -> bool:
        """Whether all of a step is there."""
        return all(part.complete for part in self._parts.values())

    def next_work(self, size: Callable[[float], int]) -> Work | None:
        """The next chunk of the costliest reduction that has some left; `size` by a block's cost."""
        path = self.cell.path
        if self._whole:
            self._whole = False
            task = StudyTask(path=path, run=None, cost=self.cell.need.cost)
            return task, functools.partial(self.cell.compute, self._seed)
        for key, part in self._parts.items():
            reduction = part.reduction
            each = reduction.cost / reduction.blocks
            chunk = part.next_chunk(size(each))
            if chunk is not None:
                task = StudyTask(path=path, run=key, chunk=chunk, cost=each * chunk[1])
                return task, functools.partial(compute_chunk, reduction, chunk)
        return None

    def add(self, outcome: Outcome) -> None:
        """Take in what a task gave."""
        task, payload, state = outcome.task, outcome.payload, outcome.state
        if task.run is None:
            if payload is not None:
                state = unpack(xr.Dataset, payload)  # raises where it is damaged
            self._settle(state, payload)
            return
        part = self._parts[task.run]
        if payload is not None:
            state = unpack(part.reduction.kind, payload)
        part.add(task.chunk, state)
        self._unrecorded += outcome.seconds

    def record(self, host: str, *, least: float) -> None:
        """Record what is merged, where it took `least` seconds since the last time."""
        if self._unrecorded >= least:
            for key, part in self._parts.items():
                for chunk, state in part.fresh():
                    self._ledger.record(self.cell.path, key, chunk, pack(state), host)
            self._unrecorded = 0.0

    def advance(self, states: list[Any] | None) -> None:
        """Send the states of a step, until one needs something computed or all is done."""
        try:
            while True:
                found = next(self._steps) if states is None else self._steps.send(states)
                begun = [(each, self._begun(each)) for each in found]
                parts = {each.key: part for each, part in begun}
                # Tasks of the costliest first; states go back in the order of the analysis.
                self._order = list(parts)
                self._parts = dict(sorted(parts.items(), key=lambda p: -p[1].reduction.cost))
                if not self.complete:
                    return
                states = self.totals()
        except StopIteration as end:
            self._parts = {}
            self._settle(self.cell.finished(end.value, self._seed))

    def _settle(self, result: xr.Dataset, payload: bytes | None = None) -> None:
        """Keep the result, perhaps as bytes from elsewhere, and its scalars."""
        self.settled = Settled(self.cell, payload or pack(result), scalars_of(result))

    def totals(self) -> list[Any]:
        """States of a complete step."""
        return [self._parts[key].total() for key in self._order]

    def _begun(self, reduction: Reduction[Any]) -> PartialRun[Any]:
        part = PartialRun(reduction)

        def load(chunk: Chunk) -> Any:
            payload = self._ledger.state(self.cell.path, reduction.key, chunk)
            return None if payload is None else unpack(reduction.kind, payload)

        part.restore(self._found.get(reduction.key, ()), load)
        return part


@final
class Schedule:
    """All cells to compute: hands out tasks and takes in what they gave.

    Cells begin only when no cell that has begun has tasks left, so that few are held in memory.

    Parameters
    ----------
    cells
        In any order.
    seed
        Of all realizations.
    ledger
        What earlier runs left, and where states go that took long.
    seconds
        That a task should take: 2^k blocks come within √2 of it, unless one takes longer.
    """

    def __init__(
        self, cells: Iterable[StudyCell], seed: int, ledger: Ledger, seconds: float = _TARGET
    ) -> None:
        self._waiting = deque(sorted(cells, key=lambda cell: -cell.need.cost))
        self._seed = seed
        self._ledger = ledger
        self._target = seconds
        self._paces: dict[str, float] = {}  # seconds for a unit of cost, by the analysis
        self._active: dict[str, _Active] = {}
        self._settled: deque[Settled] = deque()
        self.under_way = 0

    def next_work(self) -> Work | None:
        """The next task; None if all have been handed out, or others must come back first.

        None too as soon as a cell is done that an earlier run recorded as a whole, so that of many
        such cells one result at a time is held: take `settled`, then ask again.
        """
        while True:
            for active in self._active.values():
                work = active.next_work(functools.partial(self._size, active))
                if work is not None:
                    self.under_way += 1
                    return work
            if not self._waiting:
                return None
            if self._begin(self._waiting.popleft()):
                return None

    def take(self, outcome: Outcome) -> None:
        """Take in an outcome."""
        self.under_way -= 1
        active = self._active.get(outcome.task.path)
        if active is None:  # another task of its cell has failed
            return
        if outcome.error is not None:
            self._settle(Settled(active.cell, error=outcome.error))
            return
        # Seconds for a unit of cost: the last of many count, as the first ones may compile
        if outcome.task.cost > 0.0:
            pace = max(outcome.seconds, _INSTANT) / outcome.task.cost
            kind = type(active.cell.analysis).__name__
            active.pace = pace if active.pace is None else 0.5 * (active.pace + pace)
            self._paces[kind] = 0.5 * (self._paces.get(kind, pace) + pace)
        if not self._guarded(active.cell, lambda: active.add(outcome)):
            return
        # What stops at a precision may have many steps; else a complete one is nearly the end.
        if not active.complete or _is_adaptive(active.cell):
            active.record(outcome.host, least=_RECORDED_AFTER)
        if active.settled is None and active.complete:
            self._guarded(active.cell, lambda: active.advance(active.totals()))
        self._settle(active.settled)

    def settled(self) -> Iterator[Settled]:
        """Cells that were done or have failed since the last call."""
        while self._settled:
            yield self._settled.popleft()

    def record(self) -> None:
        """Record all that unfinished cells have, as the run ends."""
        for active in self._active.values():
            active.record("", least=0.0)

    def _begin(self, cell: StudyCell) -> bool:
        """Begin a cell; whether that was all, as everything of it was recorded."""
        if cell.error is not None:
            self._settle(Settled(cell, error=cell.error))
            return False
        seconds = self._paces.get(type(cell.analysis).__name__, math.inf) * cell.need.cost
        # A wanted precision may take any number of realizations, whatever the first ones took.
        whole = (
            seconds <= self._target and not _is_adaptive(cell) and not self._ledger.tasks(cell.path)
        )

        def begin() -> None:
            self._active[cell.path] = _Active(cell, self._seed, self._ledger, whole=whole)

        if not self._guarded(cell, begin):  # the estimator, in what comes before the first task
            return False
        settled = self._active[cell.path].settled
        self._settle(settled)
        return settled is not None

    def _size(self, active: _Active, cost: float) -> int:
        """Blocks of a chunk, a power of two; one block costs `cost`."""
        pace = active.pace or self._paces.get(type(active.cell.analysis).__name__)
        if pace is None:
            return 1
        return 1 << max(0, round(math.log2(self._target / max(pace * cost, _INSTANT))))

    def _guarded(self, cell: StudyCell, step: Callable[[], None]) -> bool:
        """Do what calls the code of others; what it raises fails the cell."""
        try:
            step()
        except StoreError:  # of the ledger
            raise
        except _FAILURES as error:
            self._settle(Settled(cell, error=explain(error)))
            return False
        return True

    def _settle(self, settled: Settled | None) -> None:
        if settled is not None:
            self._active.pop(settled.cell.path, None)
            self._settled.append(settled)


def _is_adaptive(cell: StudyCell) -> bool:
    """Whether it stops at a precision, after a number of steps that nobody knows before."""
    return getattr(cell.analysis, "relative_error", None) is not None
