"""Numba kernels of classic dart throwing and of Mitchell's best candidates, on the torus in any dims.

Legend: as in `_spacing_kernels`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform
from mcspectra.samplers._spacing_kernels import add_to_buckets, clearance, empty_buckets

__all__ = ["pick_candidates", "throw_darts"]

_MOST_AXES = 3  # of grids
# In cells, which are about a quarter of the points' spacing: more than any distance to the nearest
_REACH = 7
_ROUNDING = 1e-9  # of a cell


@kernel
def _throw_set(
    k0: Any, k1: Any, at: int, limit: float, side: int, trials: int, points: Array
) -> tuple[int, int]:
    # Throw until all points (n, d) stick or `trials` darts in a row do not; return how many do.
    n, dims = points.shape
    buckets = empty_buckets(n, dims, side)
    placed, missed = 0, 0
    while placed < n and missed < trials:
        x = points[placed]
        for j in range(dims):
            x[j] = mix_uniform(k0, k1, at + j)
        at += dims
        missed += 1
        if clearance(x, points, buckets, True, limit, limit) >= limit:
            add_to_buckets(placed, x, buckets)
            placed += 1
            missed = 0
    return placed, at


@kernel
def throw_darts(
    keys: Array, limit: float, side: int, trials: int, attempts: int, out: Array
) -> bool:
    """Fill out (R, n, d) with points of squared distances ≥ `limit`; False if a set does not fit."""
    for r in range(out.shape[0]):
        at: Any = np.int64(0)  # a literal 0 would compile _throw_set twice
        placed, attempt = 0, 0
        while placed < out.shape[1]:
            if attempt == attempts:
                return False
            placed, at = _throw_set(keys[r, 0], keys[r, 1], at, limit, side, trials, out[r])
            attempt += 1
    return True


@kernel
def _lower_ceilings(x: Array, side: int, ceilings: Array) -> None:
    # What a new point at x means for the cells around it: no place is farther from it than the
    # centre of the cell is, plus half the diagonal. Cells beyond the reach keep their ceilings.
    dims = x.size
    half = 0.5 * np.sqrt(dims) + _ROUNDING
    reach = min(_REACH, side // 2)
    for code in range((2 * reach + 1) ** dims if dims <= _MOST_AXES else 0):
        rest, cell, square = code, 0, 0.0
        for j in range(dims):
            c = int(x[j] * side) + rest % (2 * reach + 1) - reach
            square += (c + 0.5 - x[j] * side) ** 2
            cell = cell * side + c % side
            rest //= 2 * reach + 1
        ceilings[cell] = min(ceilings[cell], ((np.sqrt(square) + half) / side) ** 2)


@kernel
def _ceiling(x: Array, side: int, ceilings: Array) -> float:
    # Bound of the squared distance from x to the nearest point.
    cell = 0
    for j in range(x.size if side > 1 else 0):
        cell = cell * side + min(int(x[j] * side), side - 1)
    return float(ceilings[cell])


@kernel
def _grids(points: Array, placed: int, room: int) -> Any:
    # For `room` points, of which the first `placed` are there: buckets, about one point in each when
    # full, and ceilings of much smaller cells (of one cell in many dims, which knows nothing).
    dims = points.shape[1]
    buckets = empty_buckets(room, dims, max(1, int(room ** (1.0 / min(dims, _MOST_AXES)))))
    side = 4 * buckets[0] if dims <= _MOST_AXES else 1
    ceilings = np.full(side ** min(dims, _MOST_AXES), 1.0 * dims)
    for i in range(placed):
        add_to_buckets(i, points[i], buckets)
        _lower_ceilings(points[i], side, ceilings)
    return buckets, side, ceilings


@kernel
def _pick(k0: Any, k1: Any, at: int, picks: int, points: Array, grids: Any, place: Array) -> None:
    # Put the best of the candidates made of numbers `at` … into `place`.
    buckets, side, ceilings = grids
    dims = place.size
    best, x = -1.0, np.empty(dims)
    for i in range(picks):
        for j in range(dims):
            x[j] = mix_uniform(k0, k1, at + i * dims + j)
        if _ceiling(x, side, ceilings) <= best:
            continue
        near = clearance(x, points, buckets, True, best, 1.0 * dims)
        if near > best:
            best = near
            place[:] = x


@kernel
def pick_candidates(keys: Array, candidates: int, out: Array) -> None:
    """Fill out (R, n, d): point i is the farthest from those before it of candidates·i places."""
    count, n, dims = out.shape
    for r in range(count):
        points, at, room = out[r], 0, 1
        grids = _grids(points, 0, room)
        for i in range(n):
            if i == room:  # smaller cells
                room *= 2
                grids = _grids(points, i, room)
            picks = max(1, candidates * i)
            _pick(keys[r, 0], keys[r, 1], at, picks, points, grids, points[i])
            at += picks * dims
            add_to_buckets(i, points[i], grids[0])
            _lower_ceilings(points[i], grids[1], grids[2])
