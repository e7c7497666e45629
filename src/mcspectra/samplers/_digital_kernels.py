"""Numba kernels of digital nets: points from generator matrices, in base 2 and in any base.

Legend: n points, d dims; ``directions`` uint32 (d, 32): column k of each generator matrix, its
first digit the highest bit, so that 2^31 stands for ½; ``out`` float64 (n, d).
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["direction_numbers", "fill_base", "fill_binary"]

_UNIT_32 = 2.0**-32


@kernel
def direction_numbers(polynomials: Array, initial: Array, out: Array) -> None:
    """Continue Sobol' direction numbers by their recurrence; out uint32 (d, 32), 2^31 is ½.

    polynomials (d,): bit k is the coefficient of x^k; initial (d, s): the odd m_1 … m_s.
    """
    for j in range(out.shape[0]):
        degree = 0
        while polynomials[j] >> (degree + 1):
            degree += 1
        v = out[j]
        for i in range(32):
            if degree == 0 or i < degree:
                v[i] = (initial[j, i] if degree else 1) << (31 - i)
                continue
            word = v[i - degree] ^ (v[i - degree] >> degree)
            for k in range(1, degree):
                if (polynomials[j] >> (degree - k)) & 1:
                    word ^= v[i - k]
            v[i] = word


@kernel
def fill_binary(directions: Array, out: Array) -> None:
    """Points 0 … n−1 of a digital sequence in base 2, in natural order."""
    n, dims = out.shape
    words = np.zeros(n, np.uint32)
    for j in range(dims):
        # Each bit of the index doubles the words there are
        k, size = 0, 1
        while size < n:
            new, column = words[size : 2 * size], directions[j, k]
            for i in range(new.size):
                new[i] = words[i] ^ column
            k, size = k + 1, 2 * size
        for i in range(n):
            out[i, j] = np.float64(words[i]) * _UNIT_32


@kernel
def fill_base(columns: Array, base: int, out: Array) -> None:
    """Points 0 … n−1 of a digital net in any base; columns int64 (d, m, rows), base^rows ≤ 2^53.

    An odometer: where a digit of the index goes up by one, or from base − 1 to 0 (which is one up,
    too, modulo the base), its column is added once.
    """
    n, dims = out.shape
    _, places, rows = columns.shape
    scale = float(base) ** rows
    index = np.zeros(places + 1, np.int64)
    y = np.zeros((dims, rows), np.int64)
    for i in range(n):
        k = 0
        while i and k < places:
            for j in range(dims):
                for r in range(rows):
                    s = y[j, r] + columns[j, k, r]
                    y[j, r] = s - base if s >= base else s
            index[k] += 1
            if index[k] < base:
                break
            index[k] = 0
            k += 1
        for j in range(dims):
            v = 0.0
            for r in range(rows):
                v = v * base + y[j, r]
            out[i, j] = v / scale
