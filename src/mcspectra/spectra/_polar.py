"""Means of power over rings and wedges of frequencies, realisation by realisation.

Frequencies of one set are not independent: under a density they share the fluctuation of its weights.
Errors of means over many of them are therefore taken from the means themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.spectra._kernels import group_power
from mcspectra.spectra.transforms import FrequencyGrid

__all__ = ["PolarSums", "wedge_labels"]


@dataclass
class PolarSums:
    """Sums over realisations of means over rings and wedges, and of their squares.

    Attributes
    ----------
    label
        Cell of each frequency of the half grid, ring · (wedges + 1) + wedge, −1 for m = 0 and what
        is beyond the rings: int64 (H,). The last wedge is beyond the circle of the half width.
    cells
        Frequencies of each cell: (rings, wedges + 1).
    radius
        Mean |m|/step of each ring.
    total, squares
        (rings + wedges,).
    """

    label: Array
    cells: Array
    radius: Array
    total: Array
    squares: Array

    @staticmethod
    def of(grid: FrequencyGrid, wedges: int) -> PolarSums:
        """Sums of no realisations: rings of one frequency step, and wedges in two dims."""
        index = grid.half_indices()
        length = np.sqrt((index**2).sum(axis=1))
        ring = np.rint(length).astype(np.int64) - 1
        parts = wedges if grid.dims == 2 else 0
        wedge = np.full(len(ring), parts)
        if parts:
            inside = length <= grid.half_width
            wedge[inside] = wedge_labels(index[inside], parts)
        label = np.where((ring >= 0) & (ring < grid.half_width), ring * (parts + 1) + wedge, -1)
        shape = (grid.half_width, parts + 1)
        used = label >= 0
        cells = np.bincount(label[used], minlength=shape[0] * shape[1]).reshape(shape)
        sums = np.bincount(ring[used], length[used], minlength=shape[0])
        zeros = np.zeros(grid.half_width + parts)
        return PolarSums(label, cells, sums / np.maximum(cells.sum(axis=1), 1), zeros, zeros.copy())

    def empty(self) -> PolarSums:
        """Sums of the same rings and wedges of no realisations."""
        zeros = np.zeros(self.total.shape)
        return replace(self, total=zeros, squares=zeros.copy())

    def take(self, packed: Array, pair: bool) -> None:
        """Add one set or the two of a pair, as `power_sums`."""
        sums = np.zeros((2, self.cells.size))
        group_power(packed, pair, self.label, sums)
        for own in sums[: 1 + pair]:
            means = self._means(own.reshape(self.cells.shape))
            self.total += means
            self.squares += means * means

    def add(self, other: PolarSums) -> None:
        """Take in the sums of others."""
        self.total += other.total
        self.squares += other.squares

    def means(self, count: int) -> tuple[Array, Array]:
        """Means over `count` realisations and their standard errors (NaN for one): (2, .)."""
        mean = self.total / count
        if count < 2:
            return mean, np.full_like(mean, np.nan)
        spread = np.maximum(self.squares / count - mean * mean, 0.0)
        return mean, np.sqrt(spread / (count - 1))

    def _means(self, sums: Array) -> Array:
        """Of rings, then of wedges; NaN for wedges that hold no frequency."""
        with np.errstate(invalid="ignore"):
            rings = sums.sum(axis=1) / self.cells.sum(axis=1)
            wedges = sums[:, :-1].sum(axis=0) / self.cells[:, :-1].sum(axis=0)
        return np.concatenate([rings, wedges])


def wedge_labels(index: Array, wedges: int) -> Array:
    """Which of `wedges` parts of the half turn, the first centred on the m0 axis; index (H, 2)."""
    turn = np.arctan2(index[:, 1], index[:, 0]) / np.pi
    return np.asarray(np.floor(turn * wedges + 0.5).astype(np.int64) % wedges)
