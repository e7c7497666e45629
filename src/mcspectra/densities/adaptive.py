"""Adaptive quadrature over the unit interval or square that keeps a record of how it converged.

Method
------
The domain starts as equal cells. A cell is *resolved* where a Gauss-Legendre rule on it agrees with
the same rule on its 2^d halves; the others are split, level by level. What is left unresolved at
level L lies within about 2^-L of the singularities and jumps, so that its total U_L, a sum over
dyadic shells of a sort, tells singularities apart: next to f ~ r^-a along a line U_L shrinks like
2^{-(1-a)L}; it stays or grows where the integral diverges.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["MOST_CELLS", "Quadrature", "integrate"]

# Even, so that no node is a cell center, and different, so that none lies on the diagonal: a density
# that is 0 only there must not look as if it were 0 on an area.
_ORDERS = {1: (8,), 2: (6, 4)}
_DEPTH = {1: 36, 2: 28}
_FULL_DEPTH = {1: 6, 2: 2}  # 4096 cells at least: narrow steps must not fall between the nodes
MOST_CELLS = 2**16
"""Cells of a level beyond which no more are split: in 2-D 1.6 million evaluations."""
_RELATIVE = 1e-10
_ABSOLUTE = 1e-13  # of the whole integral
_FORCED_DEPTH = {1: 16, 2: 8}


@dataclass(frozen=True)
class Quadrature:
    """Integrals over the starting cells, row-major (k^d,), and the record of levels.

    `errors` bounds the error of each; `totals` is the estimate of the whole after each level,
    `unresolved` the part of it in cells where the rules disagree and `volumes` their volume.
    """

    cells: Array
    errors: Array
    totals: tuple[float, ...]
    unresolved: tuple[float, ...]
    volumes: tuple[float, ...]


def integrate(
    function: Callable[[Array], Array],
    dims: int,
    *,
    cells: int,
    points: Array | None = None,
    most_cells: int = MOST_CELLS,
) -> Quadrature:
    """Integrate a non-negative function over [0,1)^d, d = 1 or 2.

    Parameters
    ----------
    function
        Points (..., d) to (...). Infinite values make the whole infinite.
    dims
        d.
    cells
        Starting cells along each axis.
    points
        Points (M, d) where narrow peaks may be: cells that hold one are split to level 16 (8 in
        2-D) whatever the rule says.
    most_cells
        Cells of a level beyond which no more are split.

    Notes
    -----
    Costs at most 36 (28) levels of 2^16 cells of 8 (24) evaluations.
    """
    corners = _grid(cells, dims)
    owner = np.arange(len(corners))
    values = _gauss(function, corners, cells)
    sums, errors = np.zeros(len(corners)), np.zeros(len(corners))
    totals, unresolved, volumes = [float(values.sum())], [], []
    for level in range(1, _DEPTH[dims] + 1):
        side = cells * 2**level
        halves = 2 * corners[:, None, :] + _grid(2, dims)
        parts = _gauss(function, halves, side)
        new = parts.sum(axis=1)
        difference = np.abs(new - values)
        total = float(sums.sum() + new.sum())
        totals.append(total)
        if not np.isfinite(total):
            break
        split = difference > _RELATIVE * new + _ABSOLUTE * abs(total)
        unresolved.append(float(new[split].sum()))
        volumes.append(np.count_nonzero(split) * (2.0 / side) ** dims)
        split |= level <= _FULL_DEPTH[dims]
        if points is not None and level <= _FORCED_DEPTH[dims]:
            split |= _holding(corners, points, side // 2)
        done = ~split
        np.add.at(sums, owner[done], new[done])
        np.add.at(errors, owner[done], difference[done])
        full = split.sum() * 2**dims > most_cells
        if full or level == _DEPTH[dims] or not split.any():
            np.add.at(sums, owner[split], new[split])
            np.add.at(errors, owner[split], difference[split])
            break
        corners, values = halves[split].reshape(-1, dims), parts[split].ravel()
        owner = np.repeat(owner[split], 2**dims)
    return Quadrature(sums, errors, tuple(totals), tuple(unresolved), tuple(volumes))


def _grid(cells: int, dims: int) -> Array:
    """Integer corners (cells^d, d) of a grid, row-major."""
    return np.array(list(itertools.product(range(cells), repeat=dims)), np.int64)


def _gauss(function: Callable[[Array], Array], corners: Array, side: int) -> Array:
    """Integrals over cells with integer corners (..., d) and edges 1/side."""
    dims = corners.shape[-1]
    rules = [np.polynomial.legendre.leggauss(order) for order in _ORDERS[dims]]
    grids = np.meshgrid(*(0.5 * (node + 1.0) for node, _ in rules), indexing="ij")
    nodes = np.stack([g.ravel() for g in grids], axis=-1)
    weights = np.prod(np.meshgrid(*(0.5 * w for _, w in rules), indexing="ij"), axis=0).ravel()
    values = function((corners[..., None, :] + nodes) / side)
    return np.asarray((values @ weights) / float(side) ** dims)


def _holding(corners: Array, points: Array, side: int) -> Array:
    """Which cells (M, d) of edge 1/side hold one of `points`."""
    inside = np.minimum((points * side).astype(np.int64), side - 1)
    steps = side ** np.arange(corners.shape[-1])[::-1]
    return np.isin(corners @ steps, inside @ steps)
