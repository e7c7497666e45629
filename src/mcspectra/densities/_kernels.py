"""Inversion of tabulated cdfs. Legend: `borders` are cdf values at cell borders, from 0 to 1.

Tables of points in 1-D have one row. Cell i of k covers [i/k, (i+1)/k) *as rounded*, for the look-up
as for the samples: no sample is counted to the cell next to its own.
"""

from __future__ import annotations

import math

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["below", "cell_at", "last_at_most", "look_up", "unwarp", "warp"]


@kernel
def below(x: float) -> float:
    """The float before x, for x in (0, 1]."""
    return np.nextafter(x, 0.0)  # type: ignore[no-any-return]


@kernel
def cell_at(x: float, cells: int) -> int:
    """i with i/cells <= x < (i+1)/cells; points outside belong to the end cells."""
    i = min(max(math.floor(x * cells), 0), cells - 1)
    if i > 0 and x < i / cells:
        return i - 1
    if i < cells - 1 and x >= (i + 1) / cells:
        return i + 1
    return i


@kernel
def last_at_most(borders: Array, low: int, size: int, u: float) -> int:
    """Largest i of low … low + size − 1 with borders[i] <= u, where borders[low] <= u.

    Halving without a branch: which half is as good as random, and mispredicted jumps cost more than
    the arithmetic.
    """
    while size > 1:
        half = size >> 1
        low += half * (borders[low + half] <= u)
        size -= half
    return low


@kernel
def _stretch(borders: Array, u: float) -> tuple[int, float]:
    """The cell of u and the point in it."""
    cells = borders.size - 1
    i = last_at_most(borders, 0, cells, u)  # never a cell without mass, as u < 1 = borders[-1]
    x = (i + (u - borders[i]) / (borders[i + 1] - borders[i])) / cells
    return i, min(max(x, i / cells), below((i + 1) / cells))


@kernel
def _shrink(borders: Array, x: float) -> tuple[int, float]:
    """The cell of x and the share up to it."""
    cells = borders.size - 1
    i = cell_at(x, cells)
    width = borders[i + 1] - borders[i]
    u = borders[i] + (x * cells - i) * width
    return i, max(borders[i], min(u, below(borders[i + 1]) if width > 0 else borders[i]))


@kernel
def warp(rows: Array, columns: Array, u: Array, x: Array) -> None:
    """Fill x (N, d) from u (N, d): `rows` (h+1,) by the last coordinate, then columns[row] (w+1,)."""
    row = 0
    for k in range(u.shape[0]):
        if u.shape[1] == 2:
            row, x[k, 1] = _stretch(rows, u[k, 1])
        _, x[k, 0] = _stretch(columns[row], u[k, 0])


@kernel
def unwarp(rows: Array, columns: Array, x: Array, u: Array) -> None:
    """Undo `warp`."""
    row = 0
    for k in range(x.shape[0]):
        if x.shape[1] == 2:
            row, u[k, 1] = _shrink(rows, x[k, 1])
        _, u[k, 0] = _shrink(columns[row], x[k, 0])


@kernel
def look_up(table: Array, x: Array, out: Array) -> None:
    """Fill out (N,) with the entries of `table` (h, w) at x (N, d)."""
    row = 0
    for k in range(x.shape[0]):
        if x.shape[1] == 2:
            row = cell_at(x[k, 1], table.shape[0])
        out[k] = table[row, cell_at(x[k, 0], table.shape[1])]
