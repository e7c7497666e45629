"""Numba kernels of hyperuniform sets: normal numbers, power of chosen frequencies and its gradient.

Legend: R realisations, n points, d dims, K frequencies.
"""

from __future__ import annotations

from math import cos, log, pi, sin, sqrt

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform

__all__ = ["fill_normals", "power_sum"]


@kernel
def fill_normals(keys: Array, start: int, out: Array) -> None:
    """Independent standard normal numbers, out (R, size), from the numbers `start` on."""
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        for i in range(0, out.shape[1], 2):
            radius = sqrt(-2.0 * log(1.0 - mix_uniform(k0, k1, start + i)))
            angle = 2.0 * pi * mix_uniform(k0, k1, start + i + 1)
            out[r, i] = radius * cos(angle)
            if i + 1 < out.shape[1]:
                out[r, i + 1] = radius * sin(angle)


@kernel
def _fill_waves(points: Array, c: Array, s: Array) -> None:
    # cos and sin of 2π m x of each coordinate: (d, orders, n).
    dims, orders, n = c.shape
    for j in range(dims):
        for m in range(orders):
            for i in range(n):
                c[j, m, i] = cos(2.0 * pi * m * points[i, j])
                s[j, m, i] = sin(2.0 * pi * m * points[i, j])


@kernel
def _fill_phases(m: Array, c: Array, s: Array, re: Array, im: Array) -> None:
    # exp(2π i m·x) of every point, as a product over the coordinates.
    re[:] = 1.0
    im[:] = 0.0
    for j in range(m.size):
        if m[j] == 0:
            continue
        sign = 1.0 if m[j] > 0 else -1.0
        cj, sj = c[j, abs(m[j])], s[j, abs(m[j])]
        for i in range(re.size):
            a, b = re[i], im[i]
            re[i] = a * cj[i] - sign * b * sj[i]
            im[i] = sign * a * sj[i] + b * cj[i]


@kernel
def power_sum(points: Array, frequencies: Array, orders: int, gradient: Array) -> float:
    """Return Σ_m |Σ_i exp(2π i m·x_i)|²/n over K frequencies; `gradient` (n, d) is overwritten.

    No frequency has a component of `orders` or more.
    """
    n, dims = points.shape
    c, s = np.empty((dims, orders, n)), np.empty((dims, orders, n))
    _fill_waves(points, c, s)
    re, im = np.empty(n), np.empty(n)
    slope = np.zeros((dims, n))
    total = 0.0
    for k in range(frequencies.shape[0]):
        m = frequencies[k]
        _fill_phases(m, c, s, re, im)
        a, b = 0.0, 0.0
        for i in range(n):
            a += re[i]
            b += im[i]
        total += (a * a + b * b) / n
        for j in range(dims):
            factor = 4.0 * pi * m[j] / n
            if factor != 0.0:
                for i in range(n):
                    slope[j, i] += factor * (b * re[i] - a * im[i])
    gradient[:] = slope.T
    return total
