"""Hierarchical warping of a table: binary splits from the whole table down to its cells.

Legend: `shares` is a heap: node k has the children 2k+1 (lower indices) and 2k+2, and shares[k] is the
part of its mass that the first child holds. `axes` (levels,) is the axis that each level splits: 0
columns, 1 rows. Tables are padded with empty cells to powers of two, which no sample enters.
"""

from __future__ import annotations

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.densities._kernels import below, cell_at

__all__ = ["descend", "return_to_root"]


@kernel
def descend(shares: Array, axes: Array, height: int, width: int, u: Array, x: Array) -> None:
    """Fill x (N, 2) from u (N, 2), in [0,1): each split takes its part of u and stretches it."""
    one = below(1.0)
    for k in range(u.shape[0]):
        node, column, row = 0, 0, 0
        rest_x, rest_y = u[k, 0], u[k, 1]
        for axis in axes:
            share = shares[node]
            rest = rest_y if axis else rest_x
            second = int(rest >= share)
            # Without a branch on `second`, which is as good as random
            start = share * second
            length = share + second * (1.0 - 2.0 * share)
            rest = min((rest - start) / length, one)
            node = 2 * node + 1 + second
            if axis:
                row, rest_y = 2 * row + second, rest
            else:
                column, rest_x = 2 * column + second, rest
        x[k, 0] = min((column + rest_x) / width, below((column + 1) / width))
        x[k, 1] = min((row + rest_y) / height, below((row + 1) / height))


@kernel
def _leaf(axes: Array, row: int, column: int) -> int:
    """Heap index of a cell: its bits, the highest first, in the order of the splits."""
    rows = 0
    for axis in axes:
        rows += axis
    columns = axes.size - rows
    node = 0
    for axis in axes:
        if axis:
            rows -= 1
            node = 2 * node + 1 + ((row >> rows) & 1)
        else:
            columns -= 1
            node = 2 * node + 1 + ((column >> columns) & 1)
    return node


@kernel
def return_to_root(shares: Array, axes: Array, height: int, width: int, x: Array, u: Array) -> None:
    """Undo `descend`."""
    for k in range(x.shape[0]):
        column, row = cell_at(x[k, 0], width), cell_at(x[k, 1], height)
        rest_x = max(x[k, 0] * width - column, 0.0)
        rest_y = max(x[k, 1] * height - row, 0.0)
        node = _leaf(axes, row, column)
        for level in range(axes.size - 1, -1, -1):
            second = node % 2 == 0
            node = (node - 1) >> 1
            share = shares[node]
            rest = rest_y if axes[level] else rest_x
            rest = share + (1.0 - share) * rest if second else share * rest
            if axes[level]:
                rest_y = rest
            else:
                rest_x = rest
        u[k, 0], u[k, 1] = rest_x, rest_y
