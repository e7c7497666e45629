"""Schedule the tasks of a study in chunks of about a second.

Cells on the first screen of the report come first, in order of increasing cost.
An interrupted study therefore has a report with pictures of every estimator.
The largest of the remaining cells come first, which keeps all workers busy until the end.

A cell that is expected to take no longer than one chunk becomes a single task.

The sizes and the order of chunks affect speed only.
Chunks are added up in the order of a fixed binary tree (`mcspectra.core.analysis`).
The bits of a result therefore do not depend on the sizes and the order of chunks.
This also holds if some chunks were computed in an earlier run.
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
"""A task, with the function that computes it in a thread of this process."""

_TARGET = 1.0  # Target duration of a chunk in seconds
_OF_LIMIT = 0.2  # Largest duration of a chunk as a fraction of the time limit
# Seconds of a cell's work between two recordings; a killed run loses at most this work.
# More frequent recordings would be slow
_RECORDED_AFTER = 1.0
_INSTANT = 1e-9  # Shortest duration in seconds; shorter durations are rounded up
# Exceptions of user code, without KeyboardInterrupt, which comes from the user in this thread
_FAILURES = (Exception, SystemExit, asyncio.CancelledError)


def task_seconds(limit: float | None) -> float:
    """Return the target duration of a task in seconds, given a time limit in seconds or None."""
    return _TARGET if limit is None else min(_TARGET, _OF_LIMIT * limit)


@final
class PartialRun(Generic[State]):
    """A sum over blocks of realizations, in progress: which chunks are done, and which remain.

    Chunks may arrive in any order. Two halves of a larger chunk are merged once both are available.
    """

    def __init__(self, reduction: Reduction[State]) -> None:
        self.reduction = reduction
        self._tree: MergeTree[State] = MergeTree()
        self._gaps: deque[Chunk] = deque([(0, reduction.blocks)])
        self._missing = reduction.blocks
        self._fresh: set[int] = set()  # merged chunks not yet in the ledger, by first block

    @property
    def complete(self) -> bool:
        """Whether all chunks have arrived."""
        return self._missing == 0

    def restore(self, found: Iterable[Chunk], load: Callable[[Chunk], State | None]) -> None:
        """Reuse stored chunks that do not overlap, and skip a chunk if `load` returns None."""
        self._gaps.clear()
        position = 0
        # Of two aligned chunks that overlap, one contains the other. Take the largest chunks
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
        """Return the next chunk to compute, of at most `size` blocks; None if nothing remains."""
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
        """Add the partial sum of a computed chunk."""
        self._missing -= chunk[1]
        self._fresh.add(self._tree.put(chunk, state))

    def fresh(self) -> Iterator[tuple[Chunk, State]]:
        """Yield merged chunks that contain new work since the last call."""
        while self._fresh:
            first = self._fresh.pop()
            if first in self._tree.nodes:
                count, state = self._tree.nodes[first]
                yield (first, count), state

    def total(self) -> State:
        """Return the sum over all blocks; all chunks must have arrived."""
        return self._tree.total()

    def _aligned(self, first: int, count: int) -> bool:
        """Whether a chunk has 2^k blocks and starts at a multiple of 2^k.

        A chunk that ends with the last of all blocks may have fewer than 2^k blocks.
        """
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
    """A finished or failed cell, with its result.

    Attributes
    ----------
    cell
        The cell.
    payload, scalars
        The cell's dataset as bytes, and its scalars; None and empty if the cell failed.
    error
        One sentence on why the cell failed.
    """

    cell: StudyCell
    payload: bytes | None = None
    scalars: Mapping[str, float] = field(default_factory=dict)
    error: str | None = None


@final
class _Active:
    """A cell in progress: its analysis runs step by step, or the whole cell is one task."""

    def __init__(self, cell: StudyCell, seed: int, ledger: Ledger, *, whole: bool) -> None:
        self.cell = cell
        self.settled: Settled | None = None
        self.pace: float | None = None  # Seconds per unit of cost
        self._seed = seed
        self._ledger = ledger
        self._parts: dict[str, PartialRun[Any]] = {}
        self._whole = whole
        self._unrecorded = 0.0  # Seconds of work that the ledger does not contain
        if not whole:
            self._found: dict[str, list[Chunk]] = {}
            for key, chunk in ledger.tasks(cell.path):
                self._found.setdefault(key, []).append(chunk)
            self._steps = steps_of(cell.analysis, cell.subject, Stream.from_rng(seed))
            self.advance(None)

    @property
    def complete(self) -> bool:
        """Whether all chunks of the current step have arrived."""
        return all(part.complete for part in self._parts.values())

    def next_work(self, size: Callable[[float], int]) -> Work | None:
        """Return the next chunk of this cell as a task, or None if each chunk already has a task.

        The chunks of costly sums become tasks first.
        The function `size` returns the number of blocks in a chunk, given the cost of a block.
        """
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
        """Add the result of a task."""
        task, payload, state = outcome.task, outcome.payload, outcome.state
        if task.run is None:
            if payload is not None:
                state = unpack(xr.Dataset, payload)  # Raises an error if the bytes are damaged
            self._settle(state, payload)
            return
        part = self._parts[task.run]
        if payload is not None:
            state = unpack(part.reduction.kind, payload)
        part.add(task.chunk, state)
        self._unrecorded += outcome.seconds

    def record(self, host: str, *, least: float) -> None:
        """Record merged chunks if at least `least` seconds of work are not recorded yet."""
        if self._unrecorded >= least:
            for key, part in self._parts.items():
                for chunk, state in part.fresh():
                    self._ledger.record(self.cell.path, key, chunk, pack(state), host)
            self._unrecorded = 0.0

    def advance(self, states: list[Any] | None) -> None:
        """Pass the sums of a finished step to the analysis, and start its next step.

        If the sums of the next steps are already stored, the analysis gets these sums too.
        The first step whose sums are not all stored has to be computed.
        """
        try:
            while True:
                found = next(self._steps) if states is None else self._steps.send(states)
                begun = [(each, self._begun(each)) for each in found]
                parts = {each.key: part for each, part in begun}
                # Compute costly sums first, but return the sums in the order of the analysis
                self._order = list(parts)
                self._parts = dict(sorted(parts.items(), key=lambda p: -p[1].reduction.cost))
                if not self.complete:
                    return
                states = self.totals()
        except StopIteration as end:
            self._parts = {}
            self._settle(self.cell.finished(end.value, self._seed))

    def _settle(self, result: xr.Dataset, payload: bytes | None = None) -> None:
        """Keep the result and its scalars; `payload` is the result as bytes from a worker."""
        self.settled = Settled(self.cell, payload or pack(result), scalars_of(result))

    def totals(self) -> list[Any]:
        """Return all sums over blocks that the analysis asked for in its current step."""
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
    """Hand out the tasks of all cells and collect their results.

    To save memory, a new cell begins only when all chunks of earlier cells have become tasks.

    Parameters
    ----------
    cells
        Cells to compute, in any order.
    seed
        Seed of all realizations.
    ledger
        Ledger with the partial sums of earlier runs; sums that take long are stored in it.
    seconds
        Target duration of a task in seconds.
        A task has 2^k blocks, and takes the target time up to a factor of √2.
        A task takes longer only if a single block takes longer.
    """

    def __init__(
        self, cells: Iterable[StudyCell], seed: int, ledger: Ledger, seconds: float = _TARGET
    ) -> None:
        self._waiting = deque(sorted(cells, key=_turn))
        self._seed = seed
        self._ledger = ledger
        self._target = seconds
        self._paces: dict[str, float] = {}  # Seconds per unit of cost, by analysis
        self._active: dict[str, _Active] = {}
        self._settled: deque[Settled] = deque()
        self.under_way = 0

    def next_work(self) -> Work | None:
        """Return the next task; None if no task is left, or if results must arrive first.

        If an earlier run recorded all of a cell, the cell is restored, and None is returned.
        Take the result from `settled` before the next call, so that only one result is in memory.
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
        """Process the outcome of a task."""
        self.under_way -= 1
        active = self._active.get(outcome.task.path)
        if active is None:  # Another task of the same cell has failed
            return
        if outcome.error is not None:
            self._settle(Settled(active.cell, error=outcome.error))
            return
        # Give later tasks more weight in the average pace: the first may include compilation
        if outcome.task.cost > 0.0:
            pace = max(outcome.seconds, _INSTANT) / outcome.task.cost
            kind = type(active.cell.analysis).__name__
            active.pace = pace if active.pace is None else 0.5 * (active.pace + pace)
            self._paces[kind] = 0.5 * (self._paces.get(kind, pace) + pace)
        if not self._guarded(active.cell, lambda: active.add(outcome)):
            return
        # If all chunks of a cell are done, do not record them: the result of the cell follows soon.
        # Only a cell with a target precision may need many further steps
        if not active.complete or _is_adaptive(active.cell):
            active.record(outcome.host, least=_RECORDED_AFTER)
        if active.settled is None and active.complete:
            self._guarded(active.cell, lambda: active.advance(active.totals()))
        self._settle(active.settled)

    def settled(self) -> Iterator[Settled]:
        """Yield cells that finished or failed since the last call."""
        while self._settled:
            yield self._settled.popleft()

    def record(self) -> None:
        """Record the chunks of all unfinished cells at the end of a run."""
        for active in self._active.values():
            active.record("", least=0.0)

    def _begin(self, cell: StudyCell) -> bool:
        """Begin a cell; return True if an earlier run had recorded all of it."""
        if cell.error is not None:
            self._settle(Settled(cell, error=cell.error))
            return False
        seconds = self._paces.get(type(cell.analysis).__name__, math.inf) * cell.need.cost
        # An adaptive cell may need any number of realizations, so it is never a single task
        whole = (
            seconds <= self._target and not _is_adaptive(cell) and not self._ledger.tasks(cell.path)
        )

        def begin() -> None:
            self._active[cell.path] = _Active(cell, self._seed, self._ledger, whole=whole)

        if not self._guarded(cell, begin):  # The estimator failed before the first task
            return False
        settled = self._active[cell.path].settled
        self._settle(settled)
        return settled is not None

    def _size(self, active: _Active, cost: float) -> int:
        """Return the number of blocks of a chunk, a power of two; one block costs `cost`."""
        pace = active.pace or self._paces.get(type(active.cell.analysis).__name__)
        if pace is None:
            return 1
        return 1 << max(0, round(math.log2(self._target / max(pace * cost, _INSTANT))))

    def _guarded(self, cell: StudyCell, step: Callable[[], None]) -> bool:
        """Call `step`, which may run user code; return False and fail the cell if it raises."""
        try:
            step()
        except StoreError:  # The ledger failed, not the cell
            raise
        except _FAILURES as error:
            self._settle(Settled(cell, error=explain(error)))
            return False
        return True

    def _settle(self, settled: Settled | None) -> None:
        if settled is not None:
            self._active.pop(settled.cell.path, None)
            self._settled.append(settled)


def _turn(cell: StudyCell) -> tuple[bool, float]:
    """Return the sort key: cells with pictures by ascending cost, others by descending cost."""
    pictured = type(cell.analysis).pictured
    return not pictured, cell.need.cost if pictured else -cell.need.cost


def _is_adaptive(cell: StudyCell) -> bool:
    """Whether the cell stops at a given precision, so that its number of steps is unknown."""
    return getattr(cell.analysis, "relative_error", None) is not None
