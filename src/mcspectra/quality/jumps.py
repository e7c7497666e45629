"""Discontinuities of functions on the unit interval or square, found by refinement.

The interval between two neighboring grid points is halved repeatedly.
At each step, the half in which the function changes more is kept.
If the change between the ends shrinks with the interval, the function has a slope there.
If the change stays the same, there is a jump. If it grows, there is a pole.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["Jumps", "curve_length", "find_jumps", "grid_centers"]

# An interval between cells is halved six times, and discarded if the function is smooth there.
# Otherwise the interval is halved twelve times, and then twelve times more, to find a jump
_FIRST, _NEXT = 6, 12
# The function is smooth in an interval if six halvings leave less than this fraction of its change.
# On a straight line, six halvings of the interval leave 1/64 of the change
_SLOPE = 1 / 32
# Fraction of a change that must remain after the last twelve halvings if the change is a jump.
# For example, √x has no jump at 0: twelve halvings leave 2^-6 of its change
_STAYS = 0.5
_GROWS = 2.0  # At a pole, the last twelve halvings increase the change by more than this factor
_NEGLIGIBLE = 1e-7  # Fraction of the scale below which changes are ignored
_BLOCK = 8  # Blocks of 8 × 8 cells, in which a curve is treated as straight

Function = Callable[[Array], Array]


@dataclass(frozen=True)
class Jumps:
    """Discontinuities between neighboring cells of a grid.

    Attributes
    ----------
    heights
        Size of the jump between a cell and its next neighbor along each axis, (d, N) or (d, N, N).
        If there is no jump, the size is 0. The last cell of each axis has no next neighbor.
    poles
        Whether the function grows without bound at the jump, as an array like `heights`.
        A pole is not detected if the values on both its sides are similar.
    """

    heights: Array
    poles: Array

    @property
    def length(self) -> float:
        """Total length of the jump curves. In 1-D, the number of jumps."""
        return curve_length(self.heights > 0)

    @property
    def mean_height(self) -> float:
        """Mean height of the jumps. It is 0 if there are no jumps."""
        found = self.heights[self.heights > 0]
        return float(found.mean()) if found.size else 0.0


def grid_centers(side: int, dims: int) -> Array:
    """Return the cell centers, (side, dims) or (side, side, dims), with the first axis first."""
    line = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(*[line] * dims, indexing="ij"), axis=-1)


def find_jumps(function: Function, dims: int, side: int, *, scale: float) -> Jumps:
    """Find jumps of a function between neighboring cell centers of a grid.

    Parameters
    ----------
    function
        Function of points (k, d) with values (k, c). The change of a value is its Euclidean length.
    dims
        Number of dims d, 1 or 2.
    side
        Number of cells along each axis.
    scale
        Typical size of the values. Jumps smaller than 1e-7 · scale are ignored.

    Notes
    -----
    Jumps below about 1/60 of the smooth change between two cells are taken for slopes.
    If an interval has several jumps, only the largest is found.
    The grid has d·side^d intervals. The search takes about 7 evaluations for each interval.
    The search takes 24 further evaluations for each possible jump.
    """
    heights = np.zeros((dims, *[side] * dims))
    poles = np.zeros(heights.shape, bool)
    centers = grid_centers(side, dims)
    for axis in range(dims):
        # Halve the intervals between cells, and discard intervals in which the function is smooth.
        # Halve the remaining intervals in two steps, and compare the changes after each step
        shape = np.moveaxis(centers, axis, 0)[:-1].shape
        near = np.moveaxis(centers, axis, 0)[:-1].reshape(-1, dims)
        far = near.copy()
        far[:, axis] += 1.0 / side
        ends = np.stack([near, far])
        values = np.stack([function(near), function(far)])
        change = _change(values)
        alive = np.flatnonzero(change > _NEGLIGIBLE * scale)
        ends, values = _halve(function, ends[:, alive], values[:, alive], _FIRST)
        kept = _change(values) > _SLOPE * change[alive]
        ends, values = _halve(function, ends[:, kept], values[:, kept], _NEXT)
        before = _change(values)
        _, values = _halve(function, ends, values, _NEXT)
        after = _change(values)
        jump = (after > _STAYS * before) & (after > _NEGLIGIBLE * scale)
        found, pole = np.zeros(len(near)), np.zeros(len(near), bool)
        found[alive[kept][jump]] = after[jump]
        pole[alive[kept]] = jump & (after > _GROWS * before)
        np.moveaxis(heights[axis], axis, 0)[:-1] = found.reshape(shape[:-1])
        np.moveaxis(poles[axis], axis, 0)[:-1] = pole.reshape(shape[:-1])
    return Jumps(heights, poles)


def curve_length(crossed: Array) -> float:
    """Estimate the length of curves from the intervals between cells that they cross.

    Parameters
    ----------
    crossed
        Booleans (1, N) or (2, N, N), one for each cell and axis.
        Each boolean states whether a curve passes between a cell and its neighbor on the axis.

    Notes
    -----
    A curve is treated as straight in blocks of 8 × 8 cells.
    If a curve crosses c_0 and c_1 intervals along the axes, its length is √(c_0² + c_1²)/N.
    The length of a straight line is exact, except at its ends.
    """
    if len(crossed) == 1:
        return float(np.count_nonzero(crossed))
    side = crossed.shape[1]
    pad = -side % _BLOCK
    padded = np.pad(crossed, [(0, 0), (0, pad), (0, pad)])
    blocks = padded.shape[1] // _BLOCK
    counts = padded.reshape(2, blocks, _BLOCK, blocks, _BLOCK).sum(axis=(2, 4))
    return float(np.hypot(counts[0], counts[1]).sum() / side)


def _halve(function: Function, ends: Array, values: Array, times: int) -> tuple[Array, Array]:
    """Halve intervals (2, k, d) with values (2, k, c). Keep the half with the larger change."""
    for _ in itertools.repeat(None, times):
        if not ends.shape[1]:
            break
        middle = 0.5 * (ends[0] + ends[1])
        between = function(middle)
        first = _change(np.stack([values[0], between])) >= _change(np.stack([between, values[1]]))
        choose = first[:, None]
        ends = np.stack([np.where(choose, ends[0], middle), np.where(choose, middle, ends[1])])
        values = np.stack(
            [np.where(choose, values[0], between), np.where(choose, between, values[1])]
        )
    return ends, values


def _change(values: Array) -> Array:
    """Return how much a function changes over k intervals; `values` (2, k, c) are at the ends."""
    return np.asarray(np.sqrt(((values[1] - values[0]) ** 2).sum(axis=-1)))
