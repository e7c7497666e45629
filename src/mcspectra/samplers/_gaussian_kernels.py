"""Numba kernels of Gaussian blue noise: energy of all pairs of points and its gradient.

Legend: n points, d dims; `points` float64 in [0,1), `force` is overwritten with the gradient.
"""

from __future__ import annotations

from math import cos, exp, pi, sin

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["near_energy", "series_energy"]


@kernel
def _sort_into_cells(points: Array, cells: Array, start: Array, order: Array) -> None:
    # Counting sort by cell: the points of cell c are order[start[c]:start[c + 1]].
    n = points.shape[0]
    cell = np.empty(n, np.int64)
    start[:] = 0
    for i in range(n):
        c = 0
        for j in range(3):
            c = c * cells[j] + min(int(points[i, j] * cells[j]), cells[j] - 1)
        cell[i] = c
        start[c + 1] += 1
    for c in range(start.size - 1):
        start[c + 1] += start[c]
    for i in range(n - 1, -1, -1):
        start[cell[i] + 1] -= 1
        order[start[cell[i] + 1]] = i
    for c in range(start.size - 1):
        start[c] = start[c + 1]
    start[start.size - 1] = n


@kernel
def _add_cell_pair(
    points: Array, a: Array, b: Array, image: Array, sigma: float, force: Array
) -> float:
    # Energy between the points a and the points b moved by `image`; each pair once if a is b.
    factor, far = -0.5 / sigma**2, 72.0 * sigma**2 / 2.0
    same = image[0] == 0.0 and image[1] == 0.0 and image[2] == 0.0
    energy = 0.0
    for s in range(a.size):
        i = a[s]
        for t in range(b.size):
            k = b[t]
            if same and a[0] == b[0] and t <= s:
                continue
            x = points[i, 0] - points[k, 0] - image[0]
            y = points[i, 1] - points[k, 1] - image[1]
            z = points[i, 2] - points[k, 2] - image[2]
            square = x * x + y * y + z * z
            if square < far:
                e = exp(factor * square)
                energy += e
                pull = 2.0 * factor * e
                force[i, 0] += pull * x
                force[i, 1] += pull * y
                force[i, 2] += pull * z
                force[k, 0] -= pull * x
                force[k, 1] -= pull * y
                force[k, 2] -= pull * z
    return energy


@kernel
def near_energy(points: Array, cells: Array, offsets: Array, sigma: float, force: Array) -> float:
    """Return the energy of points (n, 3) up to 6 σ apart, in cells; fewer dims: zeros, one cell.

    `offsets` (K, 3) are the steps to neighbouring cells, one of each opposite pair, the first
    zero; they may go around the torus several times, so that all images of a point count.
    """
    n = points.shape[0]
    start, order = np.empty(cells[0] * cells[1] * cells[2] + 1, np.int64), np.empty(n, np.int64)
    _sort_into_cells(points, cells, start, order)
    force[:] = 0.0
    energy, image = 0.0, np.zeros(3)
    for c0 in range(cells[0]):
        for c1 in range(cells[1]):
            for c2 in range(cells[2]):
                a = (c0 * cells[1] + c1) * cells[2] + c2
                if start[a] == start[a + 1]:
                    continue
                for o in range(offsets.shape[0]):
                    b0, b1, b2 = c0 + offsets[o, 0], c1 + offsets[o, 1], c2 + offsets[o, 2]
                    image[0], image[1] = b0 // cells[0], b1 // cells[1]
                    image[2] = b2 // cells[2]
                    b = ((b0 % cells[0]) * cells[1] + b1 % cells[1]) * cells[2] + b2 % cells[2]
                    energy += _add_cell_pair(
                        points,
                        order[start[a] : start[a + 1]],
                        order[start[b] : start[b + 1]],
                        image,
                        sigma,
                        force,
                    )
    return energy


@kernel
def _waves(points: Array, orders: int) -> tuple[Array, Array]:
    # cos and sin of 2π m x for m = 1 … orders: (n, d, orders).
    n, dims = points.shape
    c, s = np.empty((n, dims, orders)), np.empty((n, dims, orders))
    for i in range(n):
        for j in range(dims):
            for m in range(orders):
                c[i, j, m] = cos(2.0 * pi * (m + 1) * points[i, j])
                s[i, j, m] = sin(2.0 * pi * (m + 1) * points[i, j])
    return c, s


@kernel
def series_energy(points: Array, weights: Array, force: Array) -> float:
    """Return Σ over pairs of Π_j (1 + Σ_m weights[m−1] cos 2πm(x_j − y_j)), any number of dims."""
    n, dims = points.shape
    c, s = _waves(points, weights.size)
    value, slope, after = np.empty(dims), np.empty(dims), np.empty(dims + 1)
    force[:] = 0.0
    energy = 0.0
    for i in range(n):
        for k in range(i):
            for j in range(dims):
                value[j], slope[j] = 1.0, 0.0
                for m in range(weights.size):
                    w = weights[m]
                    value[j] += w * (c[i, j, m] * c[k, j, m] + s[i, j, m] * s[k, j, m])
                    turn = s[i, j, m] * c[k, j, m] - c[i, j, m] * s[k, j, m]
                    slope[j] -= 2.0 * pi * (m + 1) * w * turn
            after[dims] = 1.0
            for j in range(dims - 1, -1, -1):
                after[j] = after[j + 1] * value[j]
            energy += after[0]
            before = 1.0
            for j in range(dims):
                pull = before * slope[j] * after[j + 1]
                before *= value[j]
                force[i, j] += pull
                force[k, j] -= pull
    return energy
