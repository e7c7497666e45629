"""The terms of techniques as a staged analysis: a run for each count of points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from mcspectra.core.checks import Array
from mcspectra.core.packing import pack_record, unpack_record
from mcspectra.core.parallel import RealizationBlocks, realization_blocks
from mcspectra.core.staged import Run, Stages
from mcspectra.core.streams import Stream
from mcspectra.samplers import Sampler
from mcspectra.variance.technique_sums import TechniqueBatches, TechniqueSums, TechniqueView

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["StagedTechniques", "TechniqueCell", "TechniqueTotal"]

_BATCHES = 20


@dataclass(frozen=True)
class TechniqueTotal:
    """Sums over realisations, and what each block says by itself."""

    sums: TechniqueSums
    batches: TechniqueBatches


@final
@dataclass(frozen=True)
class TechniqueCell:
    """Realisations of one count of points."""

    view: TechniqueView
    sampler: Sampler
    n: int
    stream: Stream
    realizations: int

    @property
    def blocks(self) -> RealizationBlocks:
        """Atomic blocks, each a batch."""
        return realization_blocks(self.realizations, self._numbers, multiple=2, least=_BATCHES)

    @property
    def _numbers(self) -> int:
        """Numbers of a realisation: coordinates or, where they are more, those of its spectra."""
        estimator = self.view.estimator
        techniques = len(estimator.counts)
        coordinates = self.n * estimator.dims * sum(estimator.counts)
        return max(coordinates, 4 * techniques * self.view.basis.stored)

    def run(self, part: int) -> Run:
        """The run of all realisations."""
        return Run(
            part=part,
            first=0,
            realizations=self.realizations,
            blocks=len(self.blocks),
            cost=float(self.realizations * self._numbers * len(self.view.estimator.counts)),
        )

    def total(self, index: int) -> TechniqueTotal:
        """Sums of one block."""
        points = self.view.estimator.draw(self.sampler, self.n, self.stream, *self.blocks[index])
        sums = TechniqueSums.of(self.view, points)
        return TechniqueTotal(sums, TechniqueBatches.of(sums, self.view))


@final
@dataclass(frozen=True)
class StagedTechniques:
    """Counts of points, the part of a run being their place, and the dataset made of them."""

    cells: tuple[TechniqueCell, ...]
    result: Callable[[list[TechniqueTotal]], xr.Dataset]

    def stages(self) -> Stages:
        """The runs of all counts at once."""
        totals = yield [cell.run(part) for part, cell in enumerate(self.cells)]
        return self.result(totals)

    def block(self, run: Run, index: int) -> TechniqueTotal:
        """Sums of one block of a count."""
        return self.cells[run.part].total(index)

    def merge(self, left: TechniqueTotal, right: TechniqueTotal) -> TechniqueTotal:
        """Sums of both."""
        return TechniqueTotal(left.sums.merge(right.sums), left.batches.merge(right.batches))

    def pack(self, state: TechniqueTotal) -> dict[str, Array]:
        """Fields of the sums and batches."""
        return pack_record(state)

    def unpack(self, arrays: dict[str, Array]) -> TechniqueTotal:
        """Inverse of `pack`."""
        return unpack_record(TechniqueTotal, arrays)
