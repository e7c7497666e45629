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
def _filled_buckets(points: Array, placed: int, room: int) -> Any:
    # Buckets for `room` points, about one a cell when full, with the first `placed` in them.
    dims = points.shape[1]
    buckets = empty_buckets(room, dims, max(1, int(room ** (1.0 / min(dims, 3)))))
    for i in range(placed):
        add_to_buckets(i, points[i], buckets)
    return buckets


@kernel
def pick_candidates(keys: Array, candidates: int, out: Array) -> None:
    """Fill out (R, n, d): point i is the farthest from those before it of candidates·i places."""
    count, n, dims = out.shape
    x = np.empty(dims)
    for r in range(count):
        points, at = out[r], 0
        buckets = _filled_buckets(points, 0, 1)
        room = 1
        for i in range(n):
            if i == room:  # smaller cells
                room *= 2
                buckets = _filled_buckets(points, i, room)
            best = -1.0
            for _ in range(max(1, candidates * i)):
                for j in range(dims):
                    x[j] = mix_uniform(keys[r, 0], keys[r, 1], at + j)
                at += dims
                near = clearance(x, points, buckets, True, best, 1.0 * dims)
                if near > best:
                    best = near
                    points[i] = x
            add_to_buckets(i, points[i], buckets)
