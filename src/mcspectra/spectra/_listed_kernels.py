"""Numba kernels of spectra at listed frequencies; arguments are not checked.

Indices: point k, axis j, frequency f, factor u.
Frequencies are stored as compressed rows, which hold only their nonzero axes.
The entry start[f] is the position where the row of frequency f begins.
Points are stored axis by axis, (d, n), so that inner loops access neighbors in memory.
Loops process the points in blocks that fit into the first-level cache.
"""

from __future__ import annotations

import math

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["phase_sum", "product_sum", "unit_phases"]

_BLOCK = 256
_ROUND = 1.5 * 2.0**52  # t + _ROUND − _ROUND rounds |t| < 2^51 without a function call
# Taylor coefficients of cos a and of (−sin a)/a, in powers of a²
_C = tuple((-1) ** i / math.factorial(2 * i) for i in range(9))
_S = tuple(-((-1) ** i) / math.factorial(2 * i + 1) for i in range(8))


@kernel
def unit_phases(turns: Array, real: Array, imag: Array) -> None:
    """Compute exp(−2πi t) for each number of turns t, accurate to 1e-15 and without branches.

    Turns are reduced to |t| ≤ 1/8. A Taylor series gives the phase of t/4, which is squared twice.
    The first omitted term of the series is (π/4)^17/17! = 5e-17.
    Compilers vectorize this loop, but would not vectorize divisions or calls of sin and cos.
    """
    for k in range(turns.size):
        t = turns[k]
        a = (t - ((t + _ROUND) - _ROUND)) * (0.5 * np.pi)
        z = a * a
        c = _C[5] + z * (_C[6] + z * (_C[7] + z * _C[8]))
        c = _C[0] + z * (_C[1] + z * (_C[2] + z * (_C[3] + z * (_C[4] + z * c))))
        s = _S[4] + z * (_S[5] + z * (_S[6] + z * _S[7]))
        s = a * (_S[0] + z * (_S[1] + z * (_S[2] + z * (_S[3] + z * s))))
        c, s = c * c - s * s, 2 * c * s
        real[k] = c * c - s * s
        imag[k] = 2 * c * s


@kernel
def _sum(values: Array) -> float:
    """Sum `values` pairwise and in place, with little rounding and with vector instructions."""
    size = values.size
    while size > 8:
        odd = size & 1
        size = size // 2
        for k in range(size):
            values[k] += values[size + odd + k]
        size += odd
    total = 0.0
    for k in range(size):
        total += values[k]
    return total


@kernel
def phase_sum(
    points: Array, weights: Array, start: Array, axes: Array, values: Array, out: Array
) -> None:
    """Write Σ_k w_k exp(−2πi ν_f·x_k) to out (F,), with one phase per point and frequency."""
    n = weights.size
    turns, real, imag = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    out[:] = 0.0
    for low in range(0, n, _BLOCK):
        size = min(_BLOCK, n - low)
        w = weights[low : low + size]
        for f in range(out.size):
            turns[:size] = 0.0
            for e in range(start[f], start[f + 1]):
                x = points[axes[e], low : low + size]
                for k in range(size):
                    t = values[e] * x[k]
                    # Remove whole turns after each axis, to reduce rounding errors
                    turns[k] += t - ((t + _ROUND) - _ROUND)
            unit_phases(turns[:size], real, imag)
            for k in range(size):
                real[k] *= w[k]
                imag[k] *= w[k]
            out[f] += complex(_sum(real[:size]), _sum(imag[:size]))


@kernel
def product_sum(
    points: Array,
    weights: Array,
    start: Array,
    entries: Array,
    axes: Array,
    values: Array,
    out: Array,
) -> None:
    """Same as `phase_sum`, but each phase is a product of tabulated factors exp(−2πi v_u x_{a_u}).

    Factor u has the axis a_u = axes[u] and the number v_u = values[u].
    The array entries lists the indices u of the factors of each frequency.
    """
    n = weights.size
    table = np.empty((axes.size, 2, _BLOCK))
    turns, real, imag = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    out[:] = 0.0
    for low in range(0, n, _BLOCK):
        size = min(_BLOCK, n - low)
        for u in range(axes.size):
            for k in range(size):
                turns[k] = values[u] * points[axes[u], low + k]
            unit_phases(turns[:size], table[u, 0], table[u, 1])
        for f in range(out.size):
            real[:size] = weights[low : low + size]
            imag[:size] = 0.0
            for e in range(start[f], start[f + 1]):
                c, s = table[entries[e], 0], table[entries[e], 1]
                for k in range(size):
                    a = real[k] * c[k] - imag[k] * s[k]
                    imag[k] = real[k] * s[k] + imag[k] * c[k]
                    real[k] = a
            out[f] += complex(_sum(real[:size]), _sum(imag[:size]))
