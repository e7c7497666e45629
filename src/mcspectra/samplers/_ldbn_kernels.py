"""Numba kernels of low-discrepancy blue noise: arrays only, nothing checked.

Legend: ``points`` float64 (s, s, 2) has one point in each of s × s cells, in units of cells: that of
cell (i, j) is in [i, i+1) × [j, j+1), on the torus.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform
from mcspectra.samplers._kernels import _mix_below

__all__ = ["jittered_cells", "relax_in_cells", "snap_in_chunks"]

_SIGMA = 0.5  # of the Gaussians that repel each other, in cells
_REACH = 2  # cells to either side whose points are felt
_BELOW_ONE = 1.0 - 2.0**-53


@kernel
def jittered_cells(k0: np.uint64, k1: np.uint64, points: Array) -> None:
    """Draw a point in each cell."""
    side = points.shape[0]
    for i in range(side):
        for j in range(side):
            number = 2 * (i * side + j)
            points[i, j, 0] = i + mix_uniform(k0, k1, number)
            points[i, j, 1] = j + mix_uniform(k0, k1, number + 1)


@kernel
def _energy(i: int, j: int, x: float, y: float, points: Array) -> float:
    # Energy of the point of cell (i, j), were it at (x, y).
    side, total = points.shape[0], 0.0
    reach = min(_REACH, (side - 1) // 2)
    for u in range(i - reach, i + reach + 1):
        for v in range(j - reach, j + reach + 1):
            if u != i or v != j:
                other = points[u % side, v % side]
                # by the whole cells between them, since other cells may be across the border
                dx = other[0] - u % side + u - x
                dy = other[1] - v % side + v - y
                total += np.exp(-(dx * dx + dy * dy) / (2 * _SIGMA * _SIGMA))
    return total


@kernel
def relax_in_cells(k0: np.uint64, k1: np.uint64, number: int, step: float, points: Array) -> None:
    """Move each point by up to `step` if that lowers its energy and it stays in its cell."""
    side = points.shape[0]
    for i in range(side):
        for j in range(side):
            here = points[i, j]
            x = here[0] + step * (2.0 * mix_uniform(k0, k1, number) - 1.0)
            y = here[1] + step * (2.0 * mix_uniform(k0, k1, number + 1) - 1.0)
            number += 2
            if x < i or x >= i + 1 or y < j or y >= j + 1:
                continue
            if _energy(i, j, x, y, points) < _energy(i, j, here[0], here[1], points):
                here[0], here[1] = x, y


@kernel
def _reverse(i: int, digits: int) -> int:
    # Binary digits of i, the last one first.
    out = 0
    for k in range(digits):
        out |= ((i >> k) & 1) << (digits - 1 - k)
    return out


@kernel
def _fill_chunk(positions: Array, low: int, digits: int, spots: Array) -> None:
    # Spots (t,): of t·2^digits equal intervals of a cell, those that follow the order of the
    # positions (t,); their high digits are the rank, the low ones the same for all.
    for spot, index in enumerate(np.argsort(positions)):
        spots[index] = (spot << digits) | low


@kernel
def _snap_line(low: int, chunk: int, line: int, positions: Array, out: Array) -> None:
    # Give the cells of a line, whose points are at `positions` (s,) across it, one each of the s
    # intervals of its width; out (s,) intervals. The digits of `low` shift van der Corput's.
    side, digits = positions.size, 0
    while chunk << digits < side:
        digits += 1
    spots = np.empty(chunk, np.int64)
    for block in range(side // chunk):
        cells = slice(block * chunk, (block + 1) * chunk)
        mine = _reverse(block, digits) ^ (low & ((1 << digits) - 1))
        _fill_chunk(positions[cells], mine, digits, spots)
        out[cells] = line * side + spots


@kernel
def snap_in_chunks(
    k0: np.uint64, k1: np.uint64, number: int, chunk: int, points: Array, out: Array
) -> None:
    """Move points to a low-discrepancy set that keeps their order in chunks; out (s, s, 2) in [0,1).

    In each column of cells, and likewise in each row, s cells share out the s intervals of their
    width: those of a chunk by the order of their points, the chunks among themselves by the van der
    Corput sequence, its digits shifted by random ones. Within its interval a point is random.
    """
    side = points.shape[0]
    for line in range(side):
        x, y = _mix_below(k0, k1, number, side), _mix_below(k0, k1, number + 1, side)
        _snap_line(x, chunk, line, points[line, :, 0], out[line, :, 0])
        _snap_line(y, chunk, line, points[:, line, 1], out[:, line, 1])
        number += 2
    for i in range(side):
        for j in range(side):
            for axis in range(2):
                value = (out[i, j, axis] + mix_uniform(k0, k1, number)) / (side * side)
                out[i, j, axis] = min(value, _BELOW_ONE)
                number += 1
