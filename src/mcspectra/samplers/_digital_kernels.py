"""Numba kernels of digital nets: points from generator matrices, and tests of balance.

Notation: n points, d dims; ``out`` float64 (n, d).
The array ``directions`` uint32 (d, 32) holds the columns of each generator matrix.
The first digit of a column is its highest bit, so that 2^31 means ½.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = [
    "all_balanced",
    "direction_numbers",
    "double_words",
    "fill_base",
    "fill_binary",
    "leading_digits",
]


@kernel
def direction_numbers(polynomials: Array, initial: Array, out: Array) -> None:
    """Compute Sobol' direction numbers by their recurrence: out uint32 (d, 32), where 2^31 means ½.

    Bit k of an entry of polynomials (d,) is the coefficient of x^k.
    Each row of initial (d, s) has the odd numbers m_1 … m_s, which start the recurrence.
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
def double_words(columns: Array, words: Array) -> None:
    """Write points 0, 1, … of a binary net as words (n,); each pass doubles the number of words."""
    k, size = 0, 1
    while size < words.size:
        new = words[size : 2 * size]
        for i in range(new.size):
            new[i] = words[i] ^ columns[k]
        k, size = k + 1, 2 * size


@kernel
def fill_binary(directions: Array, out: Array) -> None:
    """Fill `out` with points 0 … n − 1 of a binary net."""
    words = np.empty(out.shape[0], np.uint32)
    for j in range(out.shape[1]):
        words[0] = 0
        double_words(directions[j], words)
        for i in range(words.size):
            out[i, j] = np.float64(np.int64(words[i])) * 2.0**-32


@kernel
def fill_base(columns: Array, base: int, out: Array) -> None:
    """Fill `out` with points 0 … n − 1 of a digital net; columns int64 (d, m, rows).

    The kernel counts like an odometer. A column is added whenever its digit increases by one.
    When a digit returns from base − 1 to 0, its column is added too: modulo the base, this is +1.
    Requires base^rows ≤ 2^53, so that all numbers are exact.
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


def leading_digits(x: Array, base: int, places: int) -> Array:
    """Return the first digits of each coordinate as a whole number: int64 (d, n)."""
    scale = float(base**places)
    nudge = 0.0 if base & (base - 1) == 0 else scale * 2.0**-52
    return np.minimum(np.floor(x.T * scale + nudge), scale - 1.0).astype(np.int64)


@kernel
def _next_parts(parts: Array) -> bool:
    # Replace `parts` by the next tuple of whole numbers ≥ 0 that have the same sum.
    # Return False after the last tuple, which is (0, …, 0, sum).
    h = 0
    while parts[h] == 0:
        h += 1
    if h == parts.size - 1:
        return False
    first = parts[h]
    parts[h] = 0
    parts[0] = first - 1
    parts[h + 1] += 1
    return True


@kernel
def _balanced(digits: Array, base: int, places: int, parts: Array, cells: Array) -> bool:
    # Whether all intervals of one shape contain the same number of points.
    cells[:] = 0
    boxes = 1
    for j in range(parts.size):
        if parts[j]:
            below = base ** (places - parts[j])
            width = base ** parts[j]
            boxes *= width
            for i in range(cells.size):
                cells[i] = cells[i] * width + digits[j, i] // below
    room = np.full(boxes, cells.size // boxes)
    for i in range(cells.size):
        room[cells[i]] -= 1
        if room[cells[i]] < 0:
            return False
    return True


@kernel
def all_balanced(digits: Array, base: int, places: int, level: int) -> bool:
    """Return whether every elementary interval of volume base^-level contains n/base^level points.

    The shapes of these intervals are the ways to write `level` as a sum of d ordered parts k_j ≥ 0.
    The shapes are enumerated in the order of Nijenhuis and Wilf's algorithm NEXCOM.

    digits int64 (d, n): the first `places` ≥ level digits of each coordinate as a whole number.
    """
    parts = np.zeros(digits.shape[0], np.int64)
    parts[0] = level
    cells = np.empty(digits.shape[1], np.int64)
    while True:
        if not _balanced(digits, base, places, parts, cells):
            return False
        if level == 0 or not _next_parts(parts):
            return True
