"""Numba kernels of the integrands. They take arrays and do not check arguments."""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["fill_squared_distances", "subtract_polynomials"]


@kernel
def fill_squared_distances(x: Array, center: Array, scale: float, out: Array) -> None:
    """Fill out (P,) with Σ_i (scale (x_i − c_i))² at points x (P, d)."""
    count, dims = x.shape
    if dims == 2:  # the compiler vectorizes this common case
        for k in range(count):
            a, b = scale * (x[k, 0] - center[0]), scale * (x[k, 1] - center[1])
            out[k] = a * a + b * b
        return
    for k in range(count):
        total = 0.0
        for i in range(dims):
            step = scale * (x[k, i] - center[i])
            total += step * step
        out[k] = total


@kernel
def subtract_polynomials(
    values: Array, points: Array, low: Array, size: Array, inverse: Array, cell: Array, out: Array
) -> None:
    """Subtract from out (K, C) the polynomials of cells at points (K, d) in these cells.

    The polynomial of each of the N cells interpolates the values (N, q^d C) at q nodes per axis.
    There are at least two nodes per axis.
    `low` and `size` are corners and sides of the cells, (N, d).
    `inverse` (q, q) turns Legendre polynomials into the basis of the nodes.
    """
    dims, order, width = points.shape[1], len(inverse), out.shape[1]
    rest = np.empty(values.shape[1] // order)
    legendre, factor = np.empty(order), np.empty(order)
    for p in range(len(cell)):
        c, step = cell[p], values.shape[1]
        for axis in range(dims):
            t = 2.0 * (points[p, axis] - low[c, axis]) / size[c, axis] - 1.0
            legendre[0], legendre[1] = 1.0, t
            for k in range(2, order):
                legendre[k] = (legendre[k - 1] * t * (2 * k - 1) - legendre[k - 2] * (k - 1)) / k
            for i in range(order):
                factor[i] = 0.0
                for k in range(order):
                    factor[i] += legendre[k] * inverse[k, i]
            # Interpolate along the axis: sum over the nodes, each with `step` values
            step //= order
            given = values[c] if axis == 0 else rest
            for j in range(step):
                rest[j] = factor[0] * given[j]
            for i in range(1, order):
                for j in range(step):
                    rest[j] += factor[i] * given[i * step + j]
        for k in range(width):
            out[p, k] -= rest[k]
