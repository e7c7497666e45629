"""Numba kernels of the spectra: arrays only, no checks.

Legend: r realisations, h flat index over the half spectrum (the frequencies up to and including 0
in C order; index M−1−h is the frequency −m_h), k points, j axes.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["bin_weights", "crop_scaled", "group_power", "pair_mean", "power_sums", "split_pair"]


@kernel
def crop_scaled(fine: Array, rows: Array, row_factors: Array, factors: Array, out: Array) -> None:
    """Frequencies −K … K of each of the chosen rows of fine (F, n), scaled: out (rows, 2K + 1).

    Negative ones are the last of a row.
    """
    size, width = fine.shape[1], factors.size // 2
    for r in range(rows.size):
        row, factor = fine[rows[r]], row_factors[r]
        for j in range(width):
            out[r, j] = row[size - width + j] * (factor * factors[j])
        for j in range(width + 1):
            out[r, width + j] = row[j] * (factor * factors[width + j])


@kernel
def split_pair(packed: Array, first: Array, second: Array) -> None:
    """Split F = S1 + i S2 of two real-weighted sets by Hermitian symmetry.

    packed (M,) over the full grid; first, second (H,), H = (M+1)/2:
    S1(m) = (F(m) + conj F(−m))/2, S2(m) = (F(m) − conj F(−m))/(2i).
    """
    last = packed.size - 1
    for h in range(first.size):
        a = packed[h]
        b = np.conj(packed[last - h])
        first[h] = 0.5 * (a + b)
        second[h] = -0.5j * (a - b)


@kernel
def power_sums(packed: Array, pair: bool, total: Array, squares: Array) -> None:
    """Add |S|² and |S|⁴ of one set, or of the two sets of a pair, to total and squares (H,)."""
    last = packed.size - 1
    for h in range(total.size):
        a = packed[h]
        if pair:
            b = packed[last - h]
            # |a ± conj b|² / 4, written out in real arithmetic
            p = 0.25 * ((a.real + b.real) ** 2 + (a.imag - b.imag) ** 2)
            q = 0.25 * ((a.real - b.real) ** 2 + (a.imag + b.imag) ** 2)
            total[h] += p + q
            squares[h] += p * p + q * q
        else:
            p = a.real * a.real + a.imag * a.imag
            total[h] += p
            squares[h] += p * p


@kernel
def group_power(packed: Array, pair: bool, label: Array, sums: Array) -> None:
    """Add |S|² of one set, or of each of a pair, to sums (2, G) by label (H,); −1 is left out."""
    last = packed.size - 1
    for h in range(label.size):
        group = label[h]
        if group < 0:
            continue
        a = packed[h]
        if pair:
            b = packed[last - h]
            sums[0, group] += 0.25 * ((a.real + b.real) ** 2 + (a.imag - b.imag) ** 2)
            sums[1, group] += 0.25 * ((a.real - b.real) ** 2 + (a.imag + b.imag) ** 2)
        else:
            sums[0, group] += a.real * a.real + a.imag * a.imag


@kernel
def pair_mean(packed: Array, total: Array) -> None:
    """Add S1 + S2 of a pair F = S1 + i S2 to total (H,): see `split_pair`."""
    last = packed.size - 1
    for h in range(total.size):
        a = packed[h]
        b = np.conj(packed[last - h])
        total[h] += 0.5 * ((a + b) - 1j * (a - b))


@kernel
def bin_weights(points: Array, weights: Array, size: int, out: Array) -> None:
    """Add the weights (R, n) of points (R, n, d) to size^d equal cells; out (R, size^d) zeros."""
    count, n, dims = points.shape
    for r in range(count):
        for k in range(n):
            cell = 0
            for j in range(dims):
                cell = cell * size + int(points[r, k, j] * size)
            out[r, cell] += weights[r, k]
