"""ANOVA of a variance as a staged analysis: the estimates of every realisation, block by block."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.parallel import Block, RealizationBlocks
from mcspectra.core.staged import Run, Stages

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["StagedAnova"]


@final
@dataclass(frozen=True)
class StagedAnova:
    """One run, whose state is the estimates themselves: covariances need the means of all.

    Attributes
    ----------
    estimates
        Of one block of realisations, for each mask: (S, R, channels).
    blocks
        Of all realisations.
    cost
        As of a `Run`.
    result
        The dataset, made of the estimates of all realisations.
    """

    estimates: Callable[[Block], Array]
    blocks: RealizationBlocks
    cost: float
    result: Callable[[Array], xr.Dataset]

    def stages(self) -> Stages:
        """One run of all realisations."""
        first, stop, count = self.blocks.first, self.blocks.stop, len(self.blocks)
        (found,) = yield [
            Run(part=0, first=first, realizations=stop - first, blocks=count, cost=self.cost)
        ]
        return self.result(found)

    def block(self, run: Run, index: int) -> Array:  # noqa: ARG002
        """Estimates of one block."""
        return self.estimates(self.blocks[index])

    def merge(self, left: Array, right: Array) -> Array:
        """Estimates of both, in the order of their realisations."""
        return np.concatenate([left, right], axis=1)

    def pack(self, state: Array) -> dict[str, Array]:
        """The array, by a name."""
        return {"estimates": state}

    def unpack(self, arrays: dict[str, Array]) -> Array:
        """Inverse of `pack`."""
        return arrays["estimates"]
