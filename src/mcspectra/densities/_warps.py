"""Warps of piecewise constant tables: one interface, four ways (compared in `tabulated`).

All take the cells (h, w) of a table, one row for 1-D, scaled so that sums do not overflow. All send
[0,1)^d to the cells with the same masses, evenly within each: they differ in order only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.densities import (
    _alias_kernels,
    _hierarchical_kernels,
    _hilbert_kernels,
    _kernels,
)

__all__ = ["WARPS", "Alias", "Hierarchical", "Hilbert", "Marginal", "TableWarp", "make_warp"]

WARPS = ("marginal", "hierarchical", "alias", "hilbert")

_MOST_BREAKS = 2**12  # more lines than that, and quadrature between them costs more than it gives
_SAME_ROWS = 1e-12  # relative; rows that are proportional but for rounding


class TableWarp(Protocol):
    """A warp T of a table; points are contiguous (N, d) arrays in [0,1)."""

    one_to_one: ClassVar[bool]

    def sample(self, u: Array, x: Array) -> None:
        """Fill x with T(u)."""

    def invert(self, x: Array, u: Array) -> None:
        """Fill u with T^-1(x)."""

    def breaks(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Whole lines u_0 = b and u_1 = b at which T or its slope may jump, in (0,1)."""


@final
@dataclass(frozen=True, eq=False)
class Marginal:
    """u_1 chooses the row by the marginal cdf, u_0 the column by the cdf within that row."""

    one_to_one: ClassVar[bool] = True
    cells: Array
    rows: Array
    columns: Array

    @staticmethod
    def of(cells: Array) -> Marginal:
        """Cdf of the rows (h+1,) and in each row (h, w+1)."""
        return Marginal(cells, cdf(cells.sum(axis=1)), cdf(cells))

    def sample(self, u: Array, x: Array) -> None:
        """Bisect twice."""
        _kernels.warp(self.rows, self.columns, u, x)

    def invert(self, x: Array, u: Array) -> None:
        """Look both cdfs up."""
        _kernels.unwarp(self.rows, self.columns, x, u)

    def breaks(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Marginal cdf between different rows; column borders where they are those of all rows."""
        across = inner(self.columns[0], np.diff(self.cells[0])) if self._separable() else ()
        return across, inner(self.rows, np.asarray(np.diff(self.cells, axis=0).any(axis=1)))

    def _separable(self) -> bool:
        """Whether all rows that hold mass are proportional to the first such row."""
        columns = self.columns[self.cells.any(axis=1)]
        return bool(np.abs(columns - columns[0]).max() <= _SAME_ROWS)


@final
@dataclass(frozen=True, eq=False)
class Hierarchical:
    """Binary splits of the longer side down to the cells, each by the coordinate along that side."""

    one_to_one: ClassVar[bool] = True
    cells: Array
    shares: Array
    axes: Array

    @staticmethod
    def of(cells: Array) -> Hierarchical:
        """Pad to powers of two, and sum pairs from the cells up."""
        bits = [(size - 1).bit_length() for size in cells.shape]
        axes = _split_axes(*bits)
        table = np.pad(cells, [(0, 2**b - size) for b, size in zip(bits, cells.shape, strict=True)])
        levels = []
        for depth in range(axes.size - 1, -1, -1):
            first, second = _halves(table, int(axes[depth]))
            table = first + second
            share = np.divide(first, table, out=np.full(table.shape, 0.5), where=table > 0)
            levels.append(_heap_order(share, axes[:depth]))
        return Hierarchical(cells, np.concatenate([*levels[::-1], np.empty(0)]), axes)

    def sample(self, u: Array, x: Array) -> None:
        """Descend to a cell."""
        _hierarchical_kernels.descend(self.shares, self.axes, *size_of(self.cells), u, x)

    def invert(self, x: Array, u: Array) -> None:
        """Return from the cell to the root."""
        _hierarchical_kernels.return_to_root(self.shares, self.axes, *size_of(self.cells), x, u)

    def breaks(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Borders of the splits before the first one along the other axis: those cut all lines."""
        found: list[tuple[float, ...]] = [(), ()]
        if self.axes.size:
            axis = int(self.axes[0])
            changed = np.flatnonzero(self.axes != axis)
            kept = int(changed[0]) if changed.size else self.axes.size
            block = 2 ** (int(np.count_nonzero(self.axes == axis)) - kept)
            borders = cdf(self.cells.sum(axis=axis))[::block]
            found[axis] = inner(np.append(borders, 1.0))
        return found[0], found[1]


@final
@dataclass(frozen=True, eq=False)
class Alias:
    """u_0 chooses a bin and one of its two cells; its remainder places along x_0, u_1 along x_1."""

    one_to_one: ClassVar[bool] = False
    cells: Array
    keep: Array
    other: Array
    dims: int

    @staticmethod
    def of(cells: Array, dims: int) -> Alias:
        """Fill bins of equal size."""
        keep, other = _alias_kernels.build((cells / cells.mean()).ravel())
        return Alias(cells, keep, other, dims)

    def sample(self, u: Array, x: Array) -> None:
        """Look a bin up."""
        _alias_kernels.jump(self.keep, self.other, *size_of(self.cells), u, x)

    def invert(self, x: Array, u: Array) -> None:
        """Never called: a cell fills from its own bin and again from each that names it."""
        raise NotImplementedError

    def breaks(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Borders of the bins, and the border in each."""
        starts = np.arange(self.keep.size)
        return inner(np.concatenate([starts, starts + self.keep]) / self.keep.size), ()


@final
@dataclass(frozen=True, eq=False)
class Hilbert:
    """u_0 runs through the cells along a Hilbert curve and places along it, u_1 across it."""

    one_to_one: ClassVar[bool] = True
    cells: Array
    borders: Array
    guide: Array
    order: Array
    places: Array
    headings: Array

    @staticmethod
    def of(cells: Array) -> Hilbert:
        """Order the cells by the curve through the smallest square of 2^k cells around them."""
        side = 1 << (max(cells.shape) - 1).bit_length()
        numbers = np.empty(cells.size, np.int64)
        headings = np.zeros(cells.size, np.int8)
        _hilbert_kernels.places_on_curve(side, *size_of(cells), numbers, headings)
        order = np.argsort(numbers)
        places = np.empty_like(order)
        places[order] = np.arange(order.size)
        borders = cdf(cells.ravel()[order])
        shares = np.linspace(0.0, 1.0, (1 << (cells.size - 1).bit_length()) + 1)
        guide = np.minimum(np.searchsorted(borders, shares, side="right") - 1, cells.size - 1)
        return Hilbert(cells, borders, guide, order, places, headings[order])

    def sample(self, u: Array, x: Array) -> None:
        """Search along the curve, from a guide."""
        _hilbert_kernels.follow(
            self.borders, self.guide, self.order, self.headings, *size_of(self.cells), u, x
        )

    def invert(self, x: Array, u: Array) -> None:
        """Look the cdf along the curve up."""
        _hilbert_kernels.return_along(
            self.borders, self.places, self.headings, *size_of(self.cells), x, u
        )

    def breaks(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Cdf along the curve: where it turns T jumps, where it goes straight its slope does."""
        return inner(self.borders), ()


def make_warp(name: str, cells: Array, dims: int) -> TableWarp:
    """The warp of cells (h, w); in 1-D all but alias tables are the one monotone warp."""
    if name == "alias":
        return Alias.of(cells, dims)
    if dims == 1 or name == "marginal":
        return Marginal.of(cells)
    return Hierarchical.of(cells) if name == "hierarchical" else Hilbert.of(cells)


def size_of(cells: Array) -> tuple[int, int]:
    """Height and width."""
    height, width = cells.shape
    return height, width


def cdf(masses: Array) -> Array:
    """Cdf along the last axis, (..., k+1) from 0 to exactly 1; uniform where there is no mass."""
    sums = np.zeros((*masses.shape[:-1], masses.shape[-1] + 1))
    np.cumsum(masses, axis=-1, out=sums[..., 1:])
    total = sums[..., -1:]
    even = np.broadcast_to(np.linspace(0.0, 1.0, sums.shape[-1]), sums.shape)
    return np.divide(sums, total, out=even.copy(), where=total > 0)


def inner(borders: Array, differ: Array | None = None) -> tuple[float, ...]:
    """Ascending borders within (0,1), of those between cells that differ; none beyond 4096."""
    kept = borders if differ is None else borders[1:-1][differ != 0]
    found = np.unique(kept)
    found = found[(found > 0) & (found < 1)]
    return tuple(found.tolist()) if found.size <= _MOST_BREAKS else ()


def _split_axes(row_bits: int, column_bits: int) -> Array:
    """The axis of each split from the root: always the longer side, rows where both are equal."""
    axes = []
    while row_bits or column_bits:
        axes.append(int(row_bits >= column_bits))
        row_bits, column_bits = row_bits - axes[-1], column_bits - (1 - axes[-1])
    return np.array(axes, np.int64)


def _halves(table: Array, axis: int) -> tuple[Array, Array]:
    """Even and odd rows (axis 1) or columns (axis 0)."""
    return (table[0::2], table[1::2]) if axis else (table[:, 0::2], table[:, 1::2])


def _heap_order(table: Array, axes: Array) -> Array:
    """Flatten nodes of one level: from row bits, then column bits, to the order of the splits."""
    rows = int(axes.sum())
    by_row, by_column = iter(range(rows)), iter(range(rows, axes.size))
    order = [next(by_row) if axis else next(by_column) for axis in axes]
    return table.reshape((2,) * axes.size).transpose(order).ravel()
