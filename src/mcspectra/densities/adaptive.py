"""Adaptive quadrature of integrals over the unit cube that may diverge, with a record of its levels.

Method
------
The domain starts as equal cells. A cell is *resolved* where a Gauss-Legendre rule on it agrees with
the same rule on its 2^d halves; the others are split, level by level. The unresolved part at
level L lies within about 2^-L of the singularities and jumps, so that its total U_L, a sum over
dyadic shells of a sort, tells singularities apart: next to f ~ r^-a along a line U_L shrinks like
2^{-(1-a)L}; it stays or grows where the integral diverges.

Everything here is deterministic: fixed points, fixed offsets, no seed.
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

CELLS = {1: 64, 2: 16}
"""Starting cells along each axis where nothing else is asked for, by dims."""
SETS, SET_SIZE = 32, 4096
"""Shifted low-discrepancy sets, whose spread is an error bar, and points of each."""
_SLOWEST = 0.98  # a ratio of levels: p ~ r^a with a above 0.97 counts as divergent
_NEGLIGIBLE = 1e-6
_SHRINKING = 0.8  # a level; next to a line or a point the unresolved volume shrinks by ½ or ¼
_FIRST_LEVELS = 4  # these also split cells that are merely near a zero
_WINDOW = 8
_TAIL = 256
_LARGEST_TAIL_INDEX = 1.0 - 3.0 / math.sqrt(_TAIL)


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

    @property
    def isolated(self) -> bool:
        """Whether the record decides: infinite, resolved, or unresolved on a shrinking volume."""
        if not math.isfinite(self.totals[-1]) or self.unresolved[-1] == 0:
            return True
        volumes = self.volumes
        return len(volumes) > _FIRST_LEVELS + 1 and volumes[-1] < _SHRINKING**3 * volumes[-4]

    @property
    def ratio(self) -> float:
        """Ratio of the unresolved parts of successive levels; 0 where nothing is left.

        Sums over half of the last levels against the half before: where a zero lies within its cell
        changes from level to level, and single ratios with it.
        """
        parts = self.unresolved
        half = min(_WINDOW, (len(parts) - _FIRST_LEVELS) // 2)
        if half < 1 or parts[-1] == 0:
            return 0.0
        return float((sum(parts[-half:]) / sum(parts[-2 * half : -half])) ** (1 / half))

    @property
    def limit(self) -> float:
        """Infinite where the unresolved part does not shrink, else the limit of the totals."""
        last = self.totals[-1]
        if not math.isfinite(last):
            return math.inf
        if self.unresolved[-1] <= _NEGLIGIBLE * last:
            return last
        return math.inf if self.ratio >= _SLOWEST else _aitken(*self.totals[-3:])

    @property
    def bounds(self) -> Array:
        """`errors` plus the estimated sum of all deeper levels, a geometric series."""
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


def mean_or_infinity(
    function: Callable[[Array], Array], dims: int, *, most_cells: int = MOST_CELLS
) -> float:
    """Return ∫ of a function ≥ 0 of points (..., d), any d: infinite where it seems to diverge.

    The notes of `mcspectra.densities.reciprocal_integral` say what to expect of the value; `most_cells` is
    as for `positive_integral`.
    """
    if dims <= 2:
        with np.errstate(over="ignore", invalid="ignore"):
            found = integrate(function, dims, cells=CELLS[dims], most_cells=most_cells)
        if found.isolated:
            return found.limit
    values = function(recurrences(dims).reshape(-1, dims))
    if not np.isfinite(values).all():
        return math.inf
    # Hill's estimate says whether the tail is too heavy for a mean
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
        Points (..., d) to (...).
    dims
        d, 1 or 2.
    most_cells
        Cells of a level, beyond which no more are split.

    Returns
    -------
    tuple of float
        Infinite, with error 0, where the unresolved part does not shrink: poles r^-a with a > 0.97
        count as that, see `mcspectra.densities.reciprocal_integral`. Else the error is that of the cells, or, where
        the rest was added as a geometric series, what this changed from the last level to the one before and
        would go on to change at the ratio of the series: it is no more than nearly one where poles cross.
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
    """Additive recurrences (32, 4096, d) by `golden_vector`, each under a random shift of its own."""
    shifts = Stream(key).uniforms(0, SETS, dims)[:, None, :]
    return np.asarray((shifts + np.arange(SET_SIZE)[:, None] * golden_vector(dims)) % 1.0)


def _aitken(a: float, b: float, c: float) -> float:
    """Limit of a geometric series with these last sums; the last where it is none."""
    steady = 0 < abs(c - b) < abs(b - a)
    return c + (c - b) ** 2 / ((b - a) - (c - b)) if steady else c


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
