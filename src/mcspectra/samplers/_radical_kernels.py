"""Numba kernels of radical inverses: digits of the index in any base, permuted or scrambled.

Legend: ``keys`` uint64 (R, 2) from `Stream.keys`; ``bases`` and ``digits`` int64 (d,), with
base^digits greater than every index; ``start`` is the index of the first point; ``out`` float64
(R, n, d). Sums of digits are whole numbers below 2^53, kept as floats: they are exact.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform
from mcspectra.samplers._kernels import _mix_below

__all__ = ["fill_nested", "fill_permuted"]

_BELOW_ONE = 1.0 - 2.0**-53
_BLOCK = 1024  # indices of one table of low digits: 8 kB, half the nearest cache at most


@kernel
def _draw_digits(k0: np.uint64, k1: np.uint64, number: int, count: int, order: Array) -> None:
    # Make order[:count] a uniform sample without replacement of `order`, some permutation before.
    base = order.size
    for t in range(min(count, base - 1)):
        chosen = t + _mix_below(k0, k1, number + t, base - t)
        order[t], order[chosen] = order[chosen], order[t]


@kernel
def _low_table(images: Array, n: int) -> tuple[Array, int]:
    # What the lowest digits contribute, for every value of as many of them as are worth a table,
    # and how many they are
    digits, base = images.shape
    size, low = base, 1
    while low < digits and size * base <= min(n, _BLOCK):
        size, low = size * base, low + 1
    table = np.zeros(size)
    width, weight = 1, float(base) ** (digits - 1)
    for k in range(low):
        for digit in range(base - 1, -1, -1):  # digit 0 last: it overwrites what the others read
            added = images[k, digit] * weight
            for v in range(width):
                table[digit * width + v] = table[v] + added
        width, weight = width * base, weight / base
    return table, low


@kernel
def _inverses(start: int, images: Array, tail: float, out: Array) -> None:
    # Radical inverses of start, start+1, … into out (n,), `tail` added below the last digit.
    # images (K, b): what digit value v at position k (0 = lowest of the index) is replaced by.
    digits, base = images.shape
    table, low = _low_table(images, out.size)
    scale = float(base) ** digits
    i, v, block = 0, start % table.size, start // table.size
    while i < out.size:
        high, weight, rest = 0.0, scale / base / table.size, block
        for k in range(low, digits):
            high += images[k, rest % base] * weight
            weight, rest = weight / base, rest // base
        high += tail
        stop = min(out.size, i + table.size - v)
        for t in range(i, stop):
            out[t] = min((table[v + t - i] + high) / scale, _BELOW_ONE)
        i, v, block = stop, 0, block + 1


@kernel
def fill_permuted(
    keys: Array, permuted: bool, start: int, bases: Array, digits: Array, out: Array
) -> None:
    """Radical inverses, if `permuted` with a random permutation at every position of the digits.

    Beyond the last position that differs between points, permuted zeros are one uniform number.
    """
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        number = 0
        for j in range(out.shape[2]):
            base = bases[j]
            images = np.empty((digits[j], base), np.int64)
            for k in range(digits[j]):
                for digit in range(base):
                    images[k, digit] = digit
                if permuted:
                    _draw_digits(k0, k1, number, base, images[k])
                number += base
            tail = mix_uniform(k0, k1, number) if permuted else 0.0
            number += 1
            _inverses(start, images, tail, out[r, :, j])


@kernel
def _nested(
    k0: np.uint64, k1: np.uint64, number: int, start: int, order: Array, sums: Array, out: Array
) -> int:
    # Scrambled radical inverses of start, start+1, … into out (n,); returns the next free number.
    # order (b,): room for a permutation. sums (n,): room for the scrambled digits of the residues
    # modulo `width`, the tree of permutations so far.
    n, base = out.size, order.size
    for digit in range(base):
        order[digit] = digit
    sums[0] = 0.0
    width = 1
    while width * base < n:
        for v in range(width):
            _draw_digits(k0, k1, number, base, order)
            number += base
            above = sums[v] * base
            for digit in range(base):
                sums[v + digit * width] = above + order[digit]
        width *= base
    # No two of the n indices agree modulo width·base: one more level tells all of them apart, and
    # what lies below is a subtree of its own for each, a uniform number.
    scale = float(width * base)
    for v in range(width):
        i = v - start % width
        i += width if i < 0 else 0  # the first point whose index leaves v modulo width
        count = (n - i + width - 1) // width
        _draw_digits(k0, k1, number, count, order)
        number += base
        for t in range(count):
            x = sums[v] * base + order[t] + mix_uniform(k0, k1, number)
            out[i + t * width] = min(x / scale, _BELOW_ONE)
            number += 1
    return number


@kernel
def fill_nested(keys: Array, start: int, bases: Array, out: Array) -> None:
    """Radical inverses with Owen's nested uniform scrambling in the base of each coordinate."""
    order, sums = np.empty(bases.max(), np.int64), np.empty(out.shape[1])
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        number = 0
        for j in range(out.shape[2]):
            room = order[: bases[j]]
            number = _nested(k0, k1, number, start, room, sums, out[r, :, j])
