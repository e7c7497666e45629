"""Discontinuities of functions on the unit interval or square, found by refinement.

Between two neighboring points of a grid the half in which the function changes more is halved again
and again. A change that shrinks with the interval is a slope, one that does not is a jump, one that
grows a pole.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["Jumps", "curve_length", "find_jumps", "grid_centers"]

_FIRST, _NEXT = 6, 12  # halvings: to drop what is a slope, and between two looks at the rest
_SLOPE = (
    1 / 32
)  # of the change left after the first halvings, where 1/64 is that of a straight line
_STAYS = 0.5  # of the change left by the last halvings; a root would leave 2^-6
_GROWS = 2.0
_NEGLIGIBLE = 1e-7  # of the scale
_BLOCK = 8  # cells a side, in which a curve counts as straight

Function = Callable[[Array], Array]


@dataclass(frozen=True)
class Jumps:
    """Discontinuities between neighboring cells of a grid.

    Attributes
    ----------
    heights
        (d, N) or (d, N, N): size of the jump from a cell to the next along each axis, 0 where there
        is none. The last cells of an axis have no next.
    poles
        Whether the function grows without bound there, same shape. A pole of about the same height
        on both sides is not found.
    """

    heights: Array
    poles: Array

    @property
    def length(self) -> float:
        """Total length of the curves of jumps; their number in 1-D."""
        return curve_length(self.heights > 0)

    @property
    def mean_height(self) -> float:
        """Mean of the jumps, 0 without any."""
        found = self.heights[self.heights > 0]
        return float(found.mean()) if found.size else 0.0


def grid_centers(side: int, dims: int) -> Array:
    """Centers of cells, (side, dims) or (side, side, dims), first axis first."""
    line = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(*[line] * dims, indexing="ij"), axis=-1)


def find_jumps(function: Function, dims: int, side: int, *, scale: float) -> Jumps:
    """Find where a function jumps between neighboring centers of a grid.

    Parameters
    ----------
    function
        Points (k, d) to values (k, c); sizes of changes are Euclidean lengths in c dims.
    dims
        d, 1 or 2.
    side
        Cells along each axis.
    scale
        Size of typical values: jumps below 1e-7 of it are ignored.

    Notes
    -----
    A jump smaller than about a sixtieth of the smooth change from one cell to the next is not
    distinguished from it; of several jumps in one interval the largest is found. Costs
    about 7 evaluations for each of d·side^d intervals and 24 more where there may be a jump.
    """
    heights = np.zeros((dims, *[side] * dims))
    poles = np.zeros(heights.shape, bool)
    centers = grid_centers(side, dims)
    for axis in range(dims):
        # Halve the intervals to the next cells: first to drop slopes, then twice to compare
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
    """Length of curves from the intervals that they cross.

    Parameters
    ----------
    crossed
        Booleans (1, N) or (2, N, N): for each axis, whether a curve passes between a cell and the
        next.

    Notes
    -----
    In blocks of 8 × 8 cells a curve is taken as straight: crossing c_0 and c_1 intervals along the
    axes it has the length √(c_0² + c_1²)/N. Exact but for ends for straight lines of any direction.
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
    """Halve intervals (2, k, d) with their values (2, k, c), keeping the half that changes more."""
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
    """Distance (k,) between both ends' values (2, k, c)."""
    return np.asarray(np.sqrt(((values[1] - values[0]) ** 2).sum(axis=-1)))
