"""Void and cluster: the order in which cells of a toroidal grid are filled, each time the emptiest."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.samplers import _dither_kernels
from mcspectra.samplers.base import check_dims
from mcspectra.samplers.optimised import OptimisedSampler, check_sets

__all__ = ["VoidAndCluster", "dither_mask"]

_MOST_SIDE = 2048
_ONES = 0.1  # share of ones in the first pattern of a mask, Ulichney (1993)


def dither_mask(size: int, keys: Array) -> Array:
    """Make a blue-noise dither mask, all ranks on a torus of size × size cells.

    Parameters
    ----------
    size
        Cells along a side, at most 2048.
    keys
        Keys of the random numbers, uint64 (2,), from `Stream.keys`.

    Returns
    -------
    ndarray
        int64 (size, size): the ranks 0 … size² − 1. Cells of rank below k are a blue-noise set of
        k cells, for every k.

    References
    ----------
    Ulichney (1993), "The void-and-cluster method for dither array generation",
    doi 10.1117/12.152707.
    """
    size = as_integer("size", size, least=1, most=_MOST_SIDE)
    if size == 1:
        return np.zeros((1, 1), np.int64)
    grid = _Grid(size, max(1, round(_ONES * size * size)), keys)
    while not grid.relax(size * size):
        pass
    ranks = np.empty(size * size, np.int64)
    ranks[grid.order_all()] = np.arange(size * size)
    return ranks.reshape(size, size)


@final
@dataclass(frozen=True, kw_only=True)
class VoidAndCluster(OptimisedSampler):
    """Void and cluster: blue noise in cells of a fine grid, jittered within; 2-D, progressive.

    Up to 65,536 points. They come in the order of their ranks: the first k of them are spread evenly
    for every k. A set of 4096 points takes a quarter of a second, one of 16,384 two.

    Attributes
    ----------
    cells
        Cells of the grid for each point, from 4 to 256: more of them, less grid in the points.
    sets
        Largest number of different sets, None for one for each realisation: see `OptimisedSampler`.

    References
    ----------
    Ulichney (1993), "The void-and-cluster method for dither array generation",
    doi 10.1117/12.152707.
    """

    name: ClassVar[str] = "void-and-cluster"
    max_dims: ClassVar[int | None] = 2
    dims: int = 2
    cells: int = 16

    def __post_init__(self) -> None:
        if self.dims != 2:
            raise ParameterError(
                f"void-and-cluster: dims is {self.dims!r}; it must be 2, "
                "for other dims use poisson-disk."
            )
        check_dims(self)
        check_sets(self)
        object.__setattr__(self, "cells", as_integer("cells", self.cells, least=4, most=256))

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        side = math.isqrt(self.cells * n - 1) + 1
        grid = _Grid(side, n, keys)
        rounds = 0
        while not grid.relax(n):
            rounds += 1
            report(1.0 - 0.5 ** (rounds / 4))  # how many will follow is not known
        points = np.empty((n, 2))
        _dither_kernels.jitter_cells(keys[0], keys[1], grid.order_ones(), side, points)
        return points


class _Grid:
    """A pattern on its way to a ranking."""

    def __init__(self, side: int, ones: int, keys: Array) -> None:
        self.ones = ones
        self.pattern = np.zeros((side, side), np.bool_)
        self.energy = np.empty((side, side))
        self.heads = np.empty((2, side), np.int64)
        _dither_kernels.random_pattern(keys[0], keys[1], ones, self.pattern)
        self.weights = _dither_kernels.start(self.pattern, self.energy, self.heads)

    def relax(self, steps: int) -> bool:
        """Move ones out of clusters into voids; return whether no more moves are left."""
        return _dither_kernels.relax(self.pattern, self.weights, self.energy, self.heads, steps)

    def order_ones(self) -> Array:
        """Return the cells of the pattern, which is lost, by rank."""
        order = np.empty(self.ones, np.int64)
        _dither_kernels.rank_pattern(self.pattern, self.energy, self.heads, order)
        return order

    def order_all(self) -> Array:
        """Return all cells by rank; the pattern is lost."""
        order = np.empty(self.pattern.size, np.int64)
        _dither_kernels.fill_mask(self.pattern, self.energy, self.heads, order)
        return order
