"""Means over realisations as a staged analysis: a block is one realisation, a state two sums."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.staged import Run, Stages

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["StagedMean", "Sums", "mean_and_error", "merge_sums"]

Sums: TypeAlias = tuple[Array, Array]
"""Sum of values, and of their squares."""


@final
@dataclass(frozen=True)
class StagedMean:
    """One run of realisations that each give an array.

    Attributes
    ----------
    one
        Array of a realisation, by its number.
    cost
        Of all realisations, as of a `Run`.
    result
        Makes the dataset of the mean and its standard error.
    """

    one: Callable[[int], Array]
    realizations: int
    cost: float
    result: Callable[[Array, Array], xr.Dataset]

    def stages(self) -> Stages:
        """One run of all realisations."""
        count = self.realizations
        (total,) = yield [Run(part=0, first=0, realizations=count, blocks=count, cost=self.cost)]
        return self.result(*mean_and_error(total, count))

    def block(self, run: Run, index: int) -> Sums:  # noqa: ARG002
        """Values of one realisation and their squares."""
        values = self.one(index)
        return values, values * values

    def merge(self, left: Sums, right: Sums) -> Sums:
        """Sums of both."""
        return merge_sums(left, right)

    def pack(self, state: Sums) -> dict[str, Array]:
        """Both sums."""
        return {"total": state[0], "squares": state[1]}

    def unpack(self, arrays: dict[str, Array]) -> Sums:
        """Inverse of `pack`."""
        return arrays["total"], arrays["squares"]


def merge_sums(left: Sums, right: Sums) -> Sums:
    """Sums of both sets of realisations."""
    return left[0] + right[0], left[1] + right[1]


def mean_and_error(sums: Sums, realizations: int) -> tuple[Array, Array]:
    """Mean over realisations and its standard error, NaN for a single one."""
    mean, squares = (total / realizations for total in sums)
    if realizations == 1:
        return mean, np.full(mean.shape, np.nan)
    spread = np.maximum(squares - mean * mean, 0.0)
    return mean, np.sqrt(spread / (realizations - 1))
