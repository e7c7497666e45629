"""Numba kernels of the pair route: sums over pairs of points of a tabulated function on the torus."""

from __future__ import annotations

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["pair_sum_1d", "pair_sum_2d"]


@kernel
def pair_sum_1d(points: Array, table: Array) -> float:
    """Σ_{i<k} A(x_i − x_k) of points (n, 1); table (N,) holds A(j/N), linear in between."""
    size = table.size
    total = 0.0
    for a in range(len(points)):
        for b in range(a):
            place = (points[a, 0] - points[b, 0]) % 1.0 * size
            i = int(place)
            t = place - i
            total += (1.0 - t) * table[i % size] + t * table[(i + 1) % size]
    return total


@kernel
def pair_sum_2d(points: Array, table: Array) -> float:
    """Σ_{i<k} A(x_i − x_k) of points (n, 2); table (N, N) holds A(j/N), bilinear in between."""
    size = len(table)
    total = 0.0
    for a in range(len(points)):
        for b in range(a):
            x = (points[a, 0] - points[b, 0]) % 1.0 * size
            y = (points[a, 1] - points[b, 1]) % 1.0 * size
            i, j = int(x), int(y)
            t, u = x - i, y - j
            low, high = table[i % size], table[(i + 1) % size]
            left, right = j % size, (j + 1) % size
            total += (1.0 - t) * ((1.0 - u) * low[left] + u * low[right])
            total += t * ((1.0 - u) * high[left] + u * high[right])
    return total
