"""Numba kernels of the quality of nets: all elementary intervals of one volume at a time.

The shapes of the intervals of volume base^-level are the ways to write `level` as a sum of d
ordered parts k_j ≥ 0: side base^-k_j along axis j. They are gone through in the order of Nijenhuis
and Wilf's NEXCOM.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["all_balanced", "all_independent"]


@kernel
def _next_parts(parts: Array) -> bool:
    # The next composition, in place; False after the last, (0, …, 0, level).
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
    # Whether all intervals of one shape hold equally many points.
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
    """Whether every elementary interval of volume base^-level holds n/base^level points.

    digits int64 (d, n): the first `places` ≥ level digits of each coordinate, as a whole number.
    """
    parts = np.zeros(digits.shape[0], np.int64)
    parts[0] = level
    cells = np.empty(digits.shape[1], np.int64)
    while True:
        if not _balanced(digits, base, places, parts, cells):
            return False
        if level == 0 or not _next_parts(parts):
            return True


@kernel
def _inverse(value: int, base: int) -> int:
    # 1/value modulo a prime, by Fermat
    result, power, exponent = 1, value % base, base - 2
    while exponent:
        if exponent & 1:
            result = result * power % base
        power, exponent = power * power % base, exponent >> 1
    return result


@kernel
def _independent(rows: Array, count: int, base: int) -> bool:
    # Whether the first `count` rows are linearly independent modulo a prime; they are overwritten.
    for i in range(count):
        pivot = -1
        for c in range(rows.shape[1]):
            if rows[i, c]:
                pivot = c
                break
        if pivot < 0:
            return False
        inverse = _inverse(rows[i, pivot], base)
        for k in range(i + 1, count):
            factor = rows[k, pivot] * inverse % base
            if factor:
                for c in range(pivot, rows.shape[1]):
                    rows[k, c] = (rows[k, c] + (base - factor) * rows[i, c]) % base
    return True


@kernel
def all_independent(matrices: Array, base: int, level: int) -> bool:
    """Whether the first k_j rows of all matrices together are independent for all k of `level`.

    matrices int64 (d, rows ≥ level, columns), entries modulo the prime `base`.
    """
    parts = np.zeros(matrices.shape[0], np.int64)
    parts[0] = level
    rows = np.empty((max(level, 1), matrices.shape[2]), np.int64)
    while True:
        count = 0
        for j in range(parts.size):
            for r in range(parts[j]):
                rows[count] = matrices[j, r]
                count += 1
        if not _independent(rows, count, base):
            return False
        if level == 0 or not _next_parts(parts):
            return True
