"""Analyses as sums over blocks of realisations: cut anywhere, merged always in the same tree.

An analysis draws realisations in *runs*; a run is cut into atomic blocks, whose number and limits
depend on the size of the problem alone. What a block gives is a mergeable state, and states merge in
a fixed binary tree over the blocks of their run (`MergeTree`), so that the result is the same bits
whether one thread computes all blocks, or many machines compute chunks of them: a chunk is an aligned
run of 2^k blocks, which is a node of that tree.

Which realisations come next may depend on what was seen (stopping at a precision), but on merged
results alone: an analysis is a generator that yields runs, is sent their merged states, and returns
its dataset. `compute` drives one in this process, `mcspectra.studies` many at once.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeAlias, TypeVar, final

from mcspectra.core.checks import Array
from mcspectra.core.packing import pack_dataset, unpack_dataset
from mcspectra.core.parallel import map_in_order
from mcspectra.core.progress import report

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "Chunk",
    "MergeTree",
    "Run",
    "Staged",
    "Stages",
    "Whole",
    "chunks",
    "compute",
    "compute_chunk",
    "in_step",
]

State = TypeVar("State")
Result = TypeVar("Result")

Chunk: TypeAlias = tuple[int, int]
"""First atomic block and number of blocks: a power of two that divides the first, or the last ones."""


@final
@dataclass(frozen=True, kw_only=True)
class Run:
    """Realisations ``first`` … ``first + realizations − 1`` of one part of an analysis.

    Attributes
    ----------
    part
        Which part of the analysis it belongs to: usually the index of a count. A name for people
        and a key for `Staged.block`.
    blocks
        Number of atomic blocks.
    cost
        Work of all blocks in arbitrary units, about proportional to time.
    """

    part: int
    first: int
    realizations: int
    blocks: int
    cost: float

    @property
    def key(self) -> str:
        """A name, unique within the analysis."""
        return f"{self.part}-{self.first}-{self.realizations}"


Stages: TypeAlias = "Generator[list[Run], list[Any], xr.Dataset]"
"""Yields the runs of a stage, is sent their merged states in that order, returns the result."""


class Staged(Protocol[State]):
    """An analysis that is a sum over realisations."""

    def stages(self) -> Stages:
        """Runs stage by stage, and the dataset at the end."""

    def block(self, run: Run, index: int) -> State:
        """State of one atomic block of a run."""

    def merge(self, left: State, right: State) -> State:
        """State of two neighbours together; may reuse `left`."""

    def pack(self, state: State) -> dict[str, Array]:
        """Named numeric arrays that say all of a state, bit for bit."""

    def unpack(self, arrays: dict[str, Array]) -> State:
        """Inverse of `pack`."""


@final
@dataclass(frozen=True)
class Whole:
    """An analysis that cannot be cut: one run of one block, whose state is the dataset itself.

    Attributes
    ----------
    function
        Computes the dataset, in one thread.
    cost
        As of a `Run`.
    """

    function: Callable[[], xr.Dataset]
    cost: float = 1.0

    def stages(self) -> Stages:
        """One run; its state is the result."""
        (state,) = yield [Run(part=0, first=0, realizations=1, blocks=1, cost=self.cost)]
        result: xr.Dataset = state
        return result

    def block(self, run: Run, index: int) -> xr.Dataset:  # noqa: ARG002
        """Compute all of it."""
        return self.function()

    def merge(self, left: xr.Dataset, right: xr.Dataset) -> xr.Dataset:  # noqa: ARG002
        """There is one block, which has no neighbour."""
        raise AssertionError("an analysis of one block has nothing to merge")

    def pack(self, state: xr.Dataset) -> dict[str, Array]:
        """Variables as arrays, the rest as JSON (`mcspectra.core.packing`)."""
        return pack_dataset(state)

    def unpack(self, arrays: dict[str, Array]) -> xr.Dataset:
        """Inverse of `pack`."""
        return unpack_dataset(arrays)


class MergeTree(Generic[State]):
    """Merges states of consecutive blocks as a binary counter does: neighbours of equal size first.

    What remains at the end merges from the right. The tree depends on the number of blocks alone,
    not on the chunks they came in; only log₂ of their number are held at once.
    """

    def __init__(self, merge: Callable[[State, State], State]) -> None:
        self._merge = merge
        self._nodes: list[tuple[int, State]] = []

    def add(self, state: State, blocks: int = 1) -> None:
        """Take in the state of the next `blocks` blocks, which make a `Chunk`."""
        while self._nodes and self._nodes[-1][0] == blocks:
            _, left = self._nodes.pop()
            state, blocks = self._merge(left, state), 2 * blocks
        self._nodes.append((blocks, state))

    def total(self) -> State:
        """State of all blocks together; of at least one."""
        _, total = self._nodes.pop()
        while self._nodes:
            _, left = self._nodes.pop()
            total = self._merge(left, total)
        return total


def chunks(blocks: int, size: int) -> Iterator[Chunk]:
    """Cut blocks into chunks of `size`, a power of two; the last may be shorter."""
    return ((first, min(size, blocks - first)) for first in range(0, blocks, size))


def in_step(
    parts: Sequence[Generator[Run, State, Result]],
) -> Generator[list[Run], list[State], list[Result]]:
    """Drive generators of one run at a time side by side: a stage has the next run of each.

    Returns what each returned, in their order.
    """
    results: dict[int, Result] = {}
    states: dict[int, Any] = dict.fromkeys(range(len(parts)))
    while states:
        runs: dict[int, Run] = {}
        for place, state in states.items():
            try:
                runs[place] = parts[place].send(state)
            except StopIteration as end:
                results[place] = end.value
        states = dict(zip(runs, (yield list(runs.values())), strict=True)) if runs else {}
    return [results[place] for place in range(len(parts))]


def compute_chunk(analysis: Staged[State], run: Run, chunk: Chunk) -> State:
    """State of a chunk of a run, computed in this thread."""
    tree = MergeTree(analysis.merge)
    first, count = chunk
    for index in range(first, first + count):
        tree.add(analysis.block(run, index))
    return tree.total()


def compute(analysis: Staged[Any], workers: int, reported: str | None = None) -> xr.Dataset:
    """Compute an analysis with `workers` threads; the result does not depend on their number.

    Progress of each stage is told as that of `reported` (`mcspectra.core.progress`), if it has a
    name.
    """
    stages = analysis.stages()
    try:
        runs = next(stages)
        while True:
            told = _StageProgress(reported, runs)
            runs = stages.send([_compute_run(analysis, run, workers, told) for run in runs])
    except StopIteration as end:
        result: xr.Dataset = end.value
        return result


class _StageProgress:
    """Tells how much of the cost of a stage's runs is done."""

    def __init__(self, what: str | None, runs: Sequence[Run]) -> None:
        self._what = what
        ends = itertools.accumulate((run.cost for run in runs), initial=0.0)
        self._done = dict(zip((run.key for run in runs), ends, strict=False))
        self._total = max(sum(run.cost for run in runs), 1e-300)

    def tell(self, run: Run, share: float) -> None:
        """Report that a share of a run is done, and all runs before it."""
        if self._what is not None:
            done = (self._done[run.key] + share * run.cost) / self._total
            report(self._what, 1.0 if done > 1.0 - 1e-9 else done)


def _compute_run(
    analysis: Staged[State], run: Run, workers: int, progress: _StageProgress
) -> State:
    tree = MergeTree(analysis.merge)
    states = map_in_order(lambda i: analysis.block(run, i), range(run.blocks), workers)
    for done, state in enumerate(states, 1):
        tree.add(state)
        progress.tell(run, done / run.blocks)
    return tree.total()
