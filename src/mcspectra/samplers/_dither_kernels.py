"""Numba kernels of void and cluster: arrays only, nothing checked.

Legend: a ``pattern`` bool (s, s) on the torus has ones where points are; ``energy`` float64 (s, s) is
the sum of Gaussians around the ones; ``weights`` (2·reach + 1,) is one Gaussian along an axis;
``heads`` int64 (2, s) holds, for each row, the column of the one of highest energy (tightest cluster)
and that of the zero of lowest energy (largest void), -1 where the row has none. A cell is i·s + j.

The Gaussian's width is 1.5 cells, as Ulichney's, but grows with the spacing of the ones where that is
more than three cells: a Gaussian that does not reach the next point cannot tell where that is.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform
from mcspectra.samplers._kernels import _mix_below, _shuffle

__all__ = ["fill_mask", "jitter_cells", "random_pattern", "rank_pattern", "relax", "start"]

_BELOW_ONE = 1.0 - 2.0**-53

_SIGMA = 1.5  # cells, Ulichney (1993)
_SIGMA_PER_SPACING = 0.47  # what 1.5 cells are at his density, one point in ten cells
_REACH = 6.0  # widths, where the Gaussian is cut off: 1.5e-8
_CLEAR = 1e-9  # gain of energy that is more than rounding: relaxation must come to an end
_CLUSTER, _VOID = 0, 1


@kernel
def random_pattern(k0: np.uint64, k1: np.uint64, ones: int, pattern: Array) -> None:
    """Set `ones` random cells of an empty pattern."""
    side = pattern.shape[0]
    order = np.empty(side * side, np.int64)
    _shuffle(k0, k1, 0, order)
    for cell in order[:ones]:
        pattern[cell // side, cell % side] = True


@kernel
def _gaussian(side: int, ones: int) -> Array:
    sigma = max(_SIGMA, _SIGMA_PER_SPACING * side / np.sqrt(ones))
    reach = min(int(np.ceil(_REACH * sigma)), (side - 1) // 2)
    weights: Array = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return weights


@kernel
def _spread(cell: Any, sign: float, weights: Array, energy: Array) -> None:
    # Add the Gaussian around a cell, times `sign`, to the energy.
    side, reach = energy.shape[0], weights.size // 2
    for k in range(weights.size):
        row = energy[(cell // side + k - reach) % side]
        height = sign * weights[k]
        j = (cell - reach) % side
        for m in range(weights.size):
            row[j] += height * weights[m]
            j = j + 1 if j + 1 < side else 0


@kernel
def _find_heads(i: int, pattern: Array, energy: Array, heads: Array) -> None:
    # Find the heads of row i.
    high, low = -np.inf, np.inf
    heads[_CLUSTER, i] = heads[_VOID, i] = -1
    for j in range(pattern.shape[0]):
        e = energy[i, j]
        if pattern[i, j]:
            if e > high:
                high, heads[_CLUSTER, i] = e, j
        elif e < low:
            low, heads[_VOID, i] = e, j


@kernel
def _flip(cell: int, pattern: Array, weights: Array, energy: Array, heads: Array) -> None:
    # Turn a one into a zero, or back.
    side, reach = pattern.shape[0], weights.size // 2
    i, j = cell // side, cell % side
    pattern[i, j] = not pattern[i, j]
    _spread(cell, 1.0 if pattern[i, j] else -1.0, weights, energy)
    for k in range(weights.size):
        _find_heads((i + k - reach) % side, pattern, energy, heads)


@kernel
def _head(kind: int, energy: Array, heads: Array) -> int:
    # Cell of the tightest cluster or of the largest void; there must be one.
    sign = 1.0 if kind == _CLUSTER else -1.0
    best, cell = -np.inf, -1
    for i in range(energy.shape[0]):
        j = heads[kind, i]
        if j >= 0 and sign * energy[i, j] > best:
            best, cell = sign * energy[i, j], i * energy.shape[0] + j
    return cell


@kernel
def start(pattern: Array, energy: Array, heads: Array) -> Array:
    """Fill energy and heads of a pattern, which has ones; return the weights."""
    side = pattern.shape[0]
    cells = np.flatnonzero(pattern)
    weights = _gaussian(side, cells.size)
    energy[:] = 0.0
    for cell in cells:
        _spread(cell, 1.0, weights, energy)
    for i in range(side):
        _find_heads(i, pattern, energy, heads)
    return weights


@kernel
def relax(pattern: Array, weights: Array, energy: Array, heads: Array, steps: int) -> bool:
    """Move tightest clusters into largest voids, at most `steps` times; return whether that is all."""
    side = pattern.shape[0]
    for _ in range(steps):
        cluster = _head(_CLUSTER, energy, heads)
        before = energy[cluster // side, cluster % side] - 1.0
        _flip(cluster, pattern, weights, energy, heads)
        void = _head(_VOID, energy, heads)
        if energy[void // side, void % side] > before - _CLEAR:
            _flip(cluster, pattern, weights, energy, heads)
            return True
        _flip(void, pattern, weights, energy, heads)
    return False


@kernel
def rank_pattern(pattern: Array, energy: Array, heads: Array, order: Array) -> None:
    """Clear the pattern, tightest cluster first: order (ones,) its cells, that one last."""
    weights, again = start(pattern, energy, heads), order.size // 2
    for rank in range(order.size - 1, -1, -1):
        order[rank] = _head(_CLUSTER, energy, heads)
        _flip(order[rank], pattern, weights, energy, heads)
        if rank == again and rank > 0:  # points are farther apart now
            weights, again = start(pattern, energy, heads), again // 2


@kernel
def _fill_voids(pattern: Array, energy: Array, heads: Array, order: Array, ones: Any) -> None:
    # Set cells until half of them are ones, largest void first: order[ones:] from the `ones` there.
    weights = start(pattern, energy, heads)
    for rank in range(ones, order.size // 2):
        order[rank] = _head(_VOID, energy, heads)
        _flip(order[rank], pattern, weights, energy, heads)


@kernel
def fill_mask(pattern: Array, energy: Array, heads: Array, order: Array) -> None:
    """Rank all cells from a relaxed pattern of at most half of them: order (s²,)."""
    ones = np.count_nonzero(pattern)
    first = pattern.copy()
    rank_pattern(pattern, energy, heads, order[:ones])
    _fill_voids(first, energy, heads, order, ones)
    # Beyond a half the zeros are the minority, and their tightest cluster is next.
    rest = order[order.size // 2 :]
    pattern[:] = ~first
    rank_pattern(pattern, energy, heads, rest)
    rest[:] = rest[::-1].copy()


@kernel
def jitter_cells(k0: np.uint64, k1: np.uint64, cells: Array, side: int, out: Array) -> None:
    """Uniform points in cells (n,) after one random translation of all by whole cells; out (n, 2)."""
    number = side * side  # numbers below that shuffled the first pattern
    down, across = _mix_below(k0, k1, number, side), _mix_below(k0, k1, number + 1, side)
    for p in range(cells.size):
        number += 2
        x = (cells[p] // side + down) % side + mix_uniform(k0, k1, number)
        y = (cells[p] + across) % side + mix_uniform(k0, k1, number + 1)
        out[p, 0], out[p, 1] = min(x / side, _BELOW_ONE), min(y / side, _BELOW_ONE)
