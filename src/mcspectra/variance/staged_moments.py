"""Moments of estimates as a staged analysis: what every measured variance is a sum of.

A *cell* is a count of points of a sampler, with the estimators that draw the same sets. How many
realisations of it there will be is found by its *search*: a generator of runs, which is sent what
they gave (`mcspectra.variance.stopping`). The searches of all cells go on side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.packing import pack_record, unpack_record
from mcspectra.core.parallel import Block, RealizationBlocks, realization_blocks, slices
from mcspectra.core.staged import Run, Stages, in_step
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator, Moments
from mcspectra.samplers import Sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Found", "MomentsCell", "Search", "StagedMoments", "merge_moments"]

Found: TypeAlias = tuple[Moments, bool]
"""Moments, and whether the wanted precision was reached (true where none was asked for)."""

Search: TypeAlias = Generator[Run, list[Moments], list[Found]]
"""Yields runs of a cell, is sent the moments of its estimators, returns those of all runs."""

_PARTS = 2  # a block is half the usual: a thousand realisations of a thousand points are two


@final
@dataclass(frozen=True)
class MomentsCell:
    """Estimators that draw the same sets of n points of a sampler."""

    estimators: tuple[AbstractEstimator, ...]
    sampler: Sampler
    n: int
    stream: Stream

    @property
    def numbers(self) -> int:
        """Coordinates of a realisation."""
        return self.n * self.estimators[0].dims * sum(self.estimators[0].counts)

    def blocks(self, first: int, realizations: int) -> RealizationBlocks:
        """Atomic blocks of a run."""
        return realization_blocks(realizations, _PARTS * self.numbers, first=first)

    def run(self, part: int, first: int, realizations: int) -> Run:
        """The run of so many realisations from the first."""
        return Run(
            part=part,
            first=first,
            realizations=realizations,
            blocks=len(self.blocks(first, realizations)),
            cost=float(realizations * self.numbers * len(self.estimators)),
        )

    def moments(self, block: Block) -> list[Moments]:
        """Moments of the estimates of a block, of each estimator."""
        inner = slices(block, self.numbers)
        parts = zip(*map(self._estimates, inner), strict=True)
        return [Moments.of(np.concatenate(part)) for part in parts]

    def _estimates(self, block: Block) -> list[Array]:
        points = self.estimators[0].draw(self.sampler, self.n, self.stream, *block)
        return [e.estimate(points).reshape(block[1], -1) for e in self.estimators]


def merge_moments(left: list[Moments], right: list[Moments]) -> list[Moments]:
    """Moments of both sets of realisations together, of each estimator."""
    return [a.merge(b) for a, b in zip(left, right, strict=True)]


@final
@dataclass(frozen=True)
class StagedMoments:
    """Moments of cells, each with its own search, and the dataset that is made of them.

    Attributes
    ----------
    cells
        The part of a run is the place of its cell.
    search
        Search of a cell, given its part.
    result
        Makes the dataset of what was found: for each cell, for each of its estimators.
    """

    cells: tuple[MomentsCell, ...]
    search: Callable[[MomentsCell, int], Search]
    result: Callable[[list[list[Found]]], xr.Dataset]

    def stages(self) -> Stages:
        """The next run of every cell that needs one."""
        found = yield from in_step([self.search(c, part) for part, c in enumerate(self.cells)])
        return self.result(found)

    def block(self, run: Run, index: int) -> list[Moments]:
        """Moments of one block, of each estimator of the cell."""
        cell = self.cells[run.part]
        return cell.moments(cell.blocks(run.first, run.realizations)[index])

    def merge(self, left: list[Moments], right: list[Moments]) -> list[Moments]:
        """Moments of both."""
        return merge_moments(left, right)

    def pack(self, state: list[Moments]) -> dict[str, Array]:
        """Fields of the moments after the place of their estimator."""
        packed: dict[str, Any] = {}
        for place, moments in enumerate(state):
            packed |= pack_record(moments, f"{place}.")
        return packed

    def unpack(self, arrays: dict[str, Array]) -> list[Moments]:
        """Inverse of `pack`."""
        places = range(sum(name.endswith(".count") for name in arrays))
        return [unpack_record(Moments, arrays, f"{place}.") for place in places]
