"""Numba kernels of the spectra; arguments are not checked.

Indices: r for realizations, h for the half spectrum, k for points, j for axes.
The half spectrum holds the frequencies before 0 in C order, and 0 itself, as a flat array.
In the full spectrum of M frequencies, index M − 1 − h is the frequency −m_h.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["UNLABELLED", "bin_weights", "crop_scaled", "pair_mean", "power_sums", "split_pair"]


UNLABELLED = np.empty(0, np.int64)


@kernel
def crop_scaled(
    negative: Array, others: Array, rows: Array, row_factors: Array, factors: Array, out: Array
) -> None:
    """Join the values at frequencies −K … −1 and 0 … K in each chosen row: out (rows, 2K + 1).

    Every value is multiplied by a factor of its row and a factor of its column.
    """
    width = negative.shape[1]
    for r in range(rows.size):
        row, factor = rows[r], row_factors[r]
        for j in range(width):
            out[r, j] = negative[row, j] * (factor * factors[j])
        for j in range(width + 1):
            out[r, width + j] = others[row, j] * (factor * factors[width + j])


@kernel
def split_pair(packed: Array, first: Array, second: Array) -> None:
    """Split the transform F = S1 + i S2 of two real-weighted sets by Hermitian symmetry.

    `packed` contains F at the M frequencies of the full grid.
    S1 and S2 are written to `first` and `second`, at half of the frequencies: (H,), H = (M+1)/2.
    S1(m) = (F(m) + conj F(−m))/2, S2(m) = (F(m) − conj F(−m))/(2i).
    """
    last = packed.size - 1
    for h in range(first.size):
        a = packed[h]
        b = np.conj(packed[last - h])
        first[h] = 0.5 * (a + b)
        second[h] = -0.5j * (a - b)


@kernel
def power_sums(
    packed: Array, pair: bool, total: Array, squares: Array, label: Array, groups: Array
) -> None:
    """Add |S|² and |S|⁴ of one set, or of the two sets of a pair, to total and squares (H,).

    Also add |S|² to groups of frequencies: `groups` (sets, G).
    The array `label` (H,) has the number of each frequency's group. Without groups it is empty.
    """
    last, grouped = packed.size - 1, label.size > 0
    for h in range(total.size):
        a = packed[h]
        if pair:
            b = packed[last - h]
            # |a ± conj b|² / 4, in real arithmetic
            p = 0.25 * ((a.real + b.real) ** 2 + (a.imag - b.imag) ** 2)
            q = 0.25 * ((a.real - b.real) ** 2 + (a.imag + b.imag) ** 2)
        else:
            p = a.real * a.real + a.imag * a.imag
            q = 0.0 * p
        total[h] += p + q
        squares[h] += p * p + q * q
        if grouped:
            groups[0, label[h]] += p
            if pair:
                groups[1, label[h]] += q


@kernel
def pair_mean(packed: Array, total: Array) -> None:
    """Add the transforms of a pair of sets, packed as F = S1 + i S2, to total (H,)."""
    last = packed.size - 1
    for h in range(total.size):
        a = packed[h]
        b = np.conj(packed[last - h])
        total[h] += 0.5 * ((a + b) - 1j * (a - b))


@kernel
def bin_weights(points: Array, weights: Array, size: int, out: Array) -> None:
    """Add the weights of points (R, n, d) to size^d equal cells; out (R, size^d) starts at 0."""
    count, n, dims = points.shape
    for r in range(count):
        for k in range(n):
            cell = 0
            for j in range(dims):
                cell = cell * size + int(points[r, k, j] * size)
            out[r, cell] += weights[r, k]
