"""Numba kernels of the integrands. They take arrays and do not check arguments."""

from __future__ import annotations

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["fill_squared_distances"]


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
