"""The three terms as a staged analysis: spectral sums, moments and batch means of blocks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from mcspectra.core.checks import Array
from mcspectra.core.packing import pack_record, unpack_record
from mcspectra.core.parallel import RealizationBlocks, realization_blocks
from mcspectra.core.staged import Run, Stages
from mcspectra.core.streams import Stream
from mcspectra.estimators import Moments
from mcspectra.samplers import Sampler
from mcspectra.variance.batches import Batches
from mcspectra.variance.sums import Partition, SpectralSums
from mcspectra.variance.views import View

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["StagedTerms", "TermSums"]

_BATCHES = 20  # blocks of realisations at least, whose spread gives the errors of the terms


@final
@dataclass(frozen=True)
class TermSums:
    """Sums over realisations, and what each block of them says by itself.

    Attributes
    ----------
    batches
        None if no block has two realisations.
    """

    sums: SpectralSums
    measured: Moments
    batches: Batches | None

    @property
    def of_blocks(self) -> Batches:
        """The batches of a whole run, of which the first block has two realisations at least."""
        assert self.batches is not None
        return self.batches

    def merge(self, other: TermSums) -> TermSums:
        """Sums of both; takes over the memory of this one."""
        return TermSums(
            self.sums.merge(other.sums),
            self.measured.merge(other.measured),
            _merged(self.batches, other.batches),
        )


def _merged(left: Batches | None, right: Batches | None) -> Batches | None:
    if left is None or right is None:
        return left or right
    return left.merge(right)


@final
@dataclass(frozen=True)
class StagedTerms:
    """One run of realisations of a view of an estimator.

    Attributes
    ----------
    result
        Makes the dataset of the sums over all blocks.
    """

    sampler: Sampler
    n: int
    stream: Stream
    realizations: int
    view: View
    partition: Partition
    result: Callable[[TermSums], xr.Dataset]

    @property
    def _blocks(self) -> RealizationBlocks:
        return realization_blocks(self.realizations, self._numbers, multiple=2, least=_BATCHES)

    @property
    def _numbers(self) -> int:
        """Numbers of a realisation: coordinates or, where they are more, those of its spectra."""
        estimator = self.view.estimator
        coordinates = self.n * estimator.dims * sum(estimator.counts)
        return max(coordinates, 2 * self.partition.double.size)

    def stages(self) -> Stages:
        """One run of all realisations."""
        (total,) = yield [
            Run(
                part=0,
                first=0,
                realizations=self.realizations,
                blocks=len(self._blocks),
                cost=float(self.realizations * self._numbers),
            )
        ]
        return self.result(total)

    def block(self, run: Run, index: int) -> TermSums:  # noqa: ARG002
        """Sums of one block, which is a batch too."""
        block, estimator = self._blocks[index], self.view.estimator
        points = estimator.draw(self.sampler, self.n, self.stream, *block)
        measured = Moments.of(estimator.estimate(points).reshape(block[1], -1))
        sums = SpectralSums.of(self.view.coefficients(points), self.partition)
        return TermSums(sums, measured, Batches.of(sums, measured, self.partition))

    def merge(self, left: TermSums, right: TermSums) -> TermSums:
        """Sums of both."""
        return left.merge(right)

    def pack(self, state: TermSums) -> dict[str, Array]:
        """Fields of the sums, moments and batches."""
        return pack_record(state)

    def unpack(self, arrays: dict[str, Array]) -> TermSums:
        """Inverse of `pack`."""
        return unpack_record(TermSums, arrays)
