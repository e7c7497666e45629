"""Adaptive quadrature on the unit cube for integrals that may diverge. All levels are recorded.

Method
------
The domain of integration is divided into equal cells.
A Gauss-Legendre rule on a cell is compared with the same rule on the 2^d halves of the cell.
If the two integrals agree, the cell is *resolved*. All other cells are split, level by level.
The unresolved part at level L lies within about 2^-L of the singularities and jumps.
The integral U_L over the unresolved part at level L shows the kind of singularity:
U_L is approximately a sum over shells around the singularities, with radii 2^-L, 2^-L-1, ….
If f ~ r^-a at the distance r from a line, the integral U_L shrinks like 2^{-(1-a)L}.
If the integral diverges, U_L stays constant or grows.

The quadrature is deterministic: it uses fixed points and fixed offsets, and no seed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.streams import Stream, golden_vector

__all__ = [
    "CELLS",
    "MOST_CELLS",
    "SETS",
    "SET_SIZE",
    "Quadrature",
    "integrate",
    "mean_or_infinity",
    "positive_integral",
    "recurrences",
]

# The orders of the Gauss rules are even, so that no node is the center of a cell.
# The orders of the two axes differ, so that no node lies on the diagonal of a cell.
# If a density were 0 only at the center or on the diagonal, a node there would find 1/0
_ORDERS = {1: (8,), 2: (6, 4)}
_DEPTH = {1: 36, 2: 28}
_FULL_DEPTH = {1: 6, 2: 2}  # at least 4096 cells, so that nodes do not miss narrow steps
MOST_CELLS = 2**16
"""Splitting ends at this number of cells in a level, in 2-D after 1.6 million evaluations."""
_RELATIVE = 1e-10
_ABSOLUTE = 1e-13  # tolerance of the error, relative to the whole integral
_FORCED_DEPTH = {1: 16, 2: 8}

CELLS = {1: 64, 2: 16}
"""Default number of starting cells along each axis, by dims."""
SETS, SET_SIZE = 32, 4096
"""Number of shifted low-discrepancy sets, whose spread estimates the error, and their size."""
# If the unresolved parts of successive levels have a larger ratio, the integral counts as infinite.
# For a density p ~ r^a, the integral of 1/p then counts as infinite if a > 0.97
_SLOWEST = 0.98
_NEGLIGIBLE = 1e-6
# Largest ratio between the unresolved volumes of successive levels.
# In 2-D, the ratio is ½ for unresolved cells along a line, and ¼ for unresolved cells at a point
_SHRINKING = 0.8
# Number of first levels of cells that are left out when `Quadrature.ratio` is computed.
# On the first levels, cells near a zero of the density are split even if they do not contain it
_FIRST_LEVELS = 4
_WINDOW = 8
_TAIL = 256
_LARGEST_TAIL_INDEX = 1.0 - 3.0 / math.sqrt(_TAIL)


@dataclass(frozen=True)
class Quadrature:
    """Integrals over the starting cells, row-major (k^d,), and a record of all levels.

    `errors` bounds the error of each integral.
    `totals` holds the estimate of the whole integral after each level.
    `unresolved` is the part of each total that comes from unresolved cells.
    `volumes` is the total volume of the unresolved cells of each level.
    """

    cells: Array
    errors: Array
    totals: tuple[float, ...]
    unresolved: tuple[float, ...]
    volumes: tuple[float, ...]

    @property
    def isolated(self) -> bool:
        """Whether the volume of unresolved cells shrinks so quickly that `limit` can be used.

        `isolated` is also true if the integral is infinite or all cells are resolved.
        """
        if not math.isfinite(self.totals[-1]) or self.unresolved[-1] == 0:
            return True
        volumes = self.volumes
        return len(volumes) > _FIRST_LEVELS + 1 and volumes[-1] < _SHRINKING**3 * volumes[-4]

    @property
    def ratio(self) -> float:
        """Ratio of the unresolved parts of successive levels. It is 0 if everything is resolved.

        The ratio compares two sums: over the last k levels, and over the k levels before them.
        Ratios of just two successive levels would depend on where the zero lies in its cell.
        """
        parts = self.unresolved
        half = min(_WINDOW, (len(parts) - _FIRST_LEVELS) // 2)
        if half < 1 or parts[-1] == 0:
            return 0.0
        return float((sum(parts[-half:]) / sum(parts[-2 * half : -half])) ** (1 / half))

    @property
    def limit(self) -> float:
        """Limit of the integral for infinitely many levels; infinite if it appears to diverge."""
        last = self.totals[-1]
        if not math.isfinite(last):
            return math.inf
        if self.unresolved[-1] <= _NEGLIGIBLE * last:
            return last
        return math.inf if self.ratio >= _SLOWEST else _aitken(*self.totals[-3:])

    @property
    def bounds(self) -> Array:
        """Bounds of the error: `errors` plus a geometric series for all deeper levels."""
        return 2.0 * self.errors / (1.0 - min(self.ratio, _SLOWEST))


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
        Function of points (..., d). An infinite value makes the whole integral infinite.
    dims
        Number of dims d.
    cells
        Number of starting cells along each axis.
    points
        Points (M, d) where narrow peaks may be.
        Cells that contain one of these points are always split to level 16 (8 in 2-D).
    most_cells
        Maximum number of cells in a level; at this number, cells are not split further.

    Notes
    -----
    In 1-D, the cost is at most 36 levels of 2^16 cells with 8 evaluations each.
    In 2-D, the cost is at most 28 levels of cells, with 24 evaluations in each cell.
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


def mean_or_infinity(
    function: Callable[[Array], Array], dims: int, *, most_cells: int = MOST_CELLS
) -> float:
    """Return the integral of a function ≥ 0 in d dims. It is infinite if it appears to diverge.

    The notes of `mcspectra.densities.reciprocal_integral` describe the accuracy.
    `most_cells` limits the number of cells in a level, as in `positive_integral`.
    """
    if dims <= 2:
        with np.errstate(over="ignore", invalid="ignore"):
            found = integrate(function, dims, cells=CELLS[dims], most_cells=most_cells)
        if found.isolated:
            return found.limit
    values = function(recurrences(dims).reshape(-1, dims))
    if not np.isfinite(values).all():
        return math.inf
    # Hill's estimate of the tail index tells whether the tail is too heavy for a mean
    tail = np.sort(values)[-_TAIL - 1 :]
    index = float(np.log(tail[1:] / tail[0]).mean())
    return math.inf if index > _LARGEST_TAIL_INDEX else float(values.mean())


def positive_integral(
    function: Callable[[Array], Array], dims: int, *, most_cells: int = MOST_CELLS
) -> tuple[float, float]:
    """Return the integral of a non-negative function over [0,1)^d, and an estimate of its error.

    Parameters
    ----------
    function
        Function of points (..., d) that returns values (...).
    dims
        Number of dims d, 1 or 2.
    most_cells
        Maximum number of cells in a level; at this number, cells are not split further.

    Returns
    -------
    tuple of float
        Integral and error. Usually, the error is the sum over the cells.
        If the unresolved part does not shrink, the integral is infinite and the error is 0.
        Poles r^-a with a > 0.97 count as divergent.
        See `mcspectra.densities.reciprocal_integral`.
        The integral may be extrapolated: the limit of a geometric series of levels with ratio r.
        The error of an extrapolated limit is its last change, times the larger of 1 and r/(1 − r).
        If lines of poles cross, the sums of the levels are a geometric series only approximately.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        found = integrate(function, dims, cells=CELLS[dims], most_cells=most_cells)
    if not found.isolated:
        return found.totals[-1], found.unresolved[-1]
    value = found.limit
    if math.isinf(value):
        return value, 0.0
    if value == found.totals[-1]:
        return value, float(found.errors.sum())
    before, last = np.diff(found.totals[-3:])
    ratio = min(max(last / before, 0.0), 0.99) if before else 0.0
    rest = max(1.0, ratio / (1.0 - ratio))
    return value, rest * abs(value - _aitken(*found.totals[-4:-1]))


def recurrences(dims: int, key: int = 0) -> Array:
    """Return 32 point sets (32, 4096, d): additive recurrences by `golden_vector`, each shifted."""
    shifts = Stream(key).uniforms(0, SETS, dims)[:, None, :]
    return np.asarray((shifts + np.arange(SET_SIZE)[:, None] * golden_vector(dims)) % 1.0)


def _aitken(a: float, b: float, c: float) -> float:
    """Return the limit of a geometric series with last sums a, b, c; c if it is not geometric."""
    steady = 0 < abs(c - b) < abs(b - a)
    return c + (c - b) ** 2 / ((b - a) - (c - b)) if steady else c


def _grid(cells: int, dims: int) -> Array:
    """Return integer corners (cells^d, d) of a grid, row-major."""
    return np.array(list(itertools.product(range(cells), repeat=dims)), np.int64)


def _gauss(function: Callable[[Array], Array], corners: Array, side: int) -> Array:
    """Return integrals over cells with integer corners (..., d) and edges 1/side."""
    dims = corners.shape[-1]
    rules = [np.polynomial.legendre.leggauss(order) for order in _ORDERS[dims]]
    grids = np.meshgrid(*(0.5 * (node + 1.0) for node, _ in rules), indexing="ij")
    nodes = np.stack([g.ravel() for g in grids], axis=-1)
    weights = np.prod(np.meshgrid(*(0.5 * w for _, w in rules), indexing="ij"), axis=0).ravel()
    values = function((corners[..., None, :] + nodes) / side)
    return np.asarray((values @ weights) / float(side) ** dims)


def _holding(corners: Array, points: Array, side: int) -> Array:
    """Return which of the cells (M, d) of edge 1/side contain at least one of `points`."""
    inside = np.minimum((points * side).astype(np.int64), side - 1)
    steps = side ** np.arange(corners.shape[-1])[::-1]
    return np.isin(corners @ steps, inside @ steps)
