"""Numba kernels of the samplers: arrays only, nothing checked.

Legend: R realisations, n points, d dims; ``keys`` uint64 (R, 2) from `Stream.keys`; ``out``
float64 (R, n, d) unless said. Number i·d + j of a realisation belongs to coordinate j of point i;
numbers for shuffles come after those.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_bits, mix_uniform

__all__ = [
    "fill_jittered",
    "fill_latin",
    "fill_multi_jittered",
    "random_offsets",
    "scramble_nested",
    "translate",
    "xor_digits",
]

_BELOW_ONE = 1.0 - 2.0**-53  # (s − 1 + u)/s, u < 1, can round up to 1
_S11, _S32, _S43 = np.uint64(11), np.uint64(32), np.uint64(43)
_LOW32 = np.uint64(0xFFFFFFFF)
_ONE, _TAIL = np.uint64(1), np.uint64(1 << 63)
_TO_53, _UNIT_53 = 2.0**53, 2.0**-53
_LEVELS = 6  # a binary subtree of 6 levels has 63 nodes: one 64-bit hash flips them all


@kernel
def _mix_below(k0: np.uint64, k1: np.uint64, i: int, bound: int) -> Any:
    # Integer in [0, bound): upper word of bits · bound. Bias below bound/2^64 < 2^-32.
    x, b = mix_bits(k0, k1, i), np.uint64(bound)
    return np.int64(((x >> _S32) * b + (((x & _LOW32) * b) >> _S32)) >> _S32)


@kernel
def _shuffle(k0: np.uint64, k1: np.uint64, start: int, order: Array) -> None:
    # Make `order` a uniform random permutation (Fisher and Yates, inside out).
    for i in range(order.size):
        j = _mix_below(k0, k1, start + i, i + 1)
        order[i] = order[j]
        order[j] = i


@kernel
def fill_jittered(keys: Array, corners: Array, side: float, out: Array) -> None:
    """One point in each cell; lower corners (n·d,), out (R, n·d)."""
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        row = out[r]
        for i in range(row.size):
            row[i] = min(corners[i] + side * mix_uniform(k0, k1, i), _BELOW_ONE)


@kernel
def fill_latin(keys: Array, out: Array) -> None:
    """Latin hypercube: each coordinate its own permutation of n strata, jittered within."""
    count, n, dims = out.shape
    order = np.empty(n, np.int64)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        for j in range(dims):
            _shuffle(k0, k1, n * dims + j * n, order)
            for i in range(n):
                u = mix_uniform(k0, k1, i * dims + j)
                out[r, i, j] = min((order[i] + u) / n, _BELOW_ONE)


@kernel
def fill_multi_jittered(keys: Array, columns: int, rows: int, out: Array) -> None:
    """Multi-jittered: point (i, j) is in column i and row j, and alone in its n-th of each axis."""
    n = columns * rows
    down, across = np.empty(rows, np.int64), np.empty(columns, np.int64)
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        points = out[r]
        # The points of a column share it out among themselves, those of a row likewise.
        for i in range(columns):
            _shuffle(k0, k1, 2 * n + i * rows, down)
            for j in range(rows):
                p = i * rows + j
                x = i * rows + down[j] + mix_uniform(k0, k1, 2 * p)
                points[p, 0] = min(x / n, _BELOW_ONE)
        for j in range(rows):
            _shuffle(k0, k1, 3 * n + j * columns, across)
            for i in range(columns):
                p = i * rows + j
                y = j * columns + across[i] + mix_uniform(k0, k1, 2 * p + 1)
                points[p, 1] = min(y / n, _BELOW_ONE)


@kernel
def random_offsets(keys: Array, out: Array) -> None:
    """One uniform vector a realisation; out (R, d)."""
    for r in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[r, j] = mix_uniform(keys[r, 0], keys[r, 1], j)


@kernel
def translate(points: Array, offsets: Array, out: Array) -> None:
    """Toroidal translation by offsets (R or 1, d) in [0,1).

    x + δ is at most 2 − 2^-52, which is a float64, and for 1 ≤ x + δ < 2 the subtraction is exact:
    the result cannot be 1.
    """
    count, n, dims = out.shape
    for r in range(count):
        offset = offsets[r % offsets.shape[0]]
        for i in range(n):
            for j in range(dims):
                x = points[r, i, j] + offset[j]
                out[r, i, j] = x - 1.0 if x >= 1.0 else x


@kernel
def xor_digits(keys: Array, points: Array, out: Array) -> None:
    """Digital shift: XOR of the 53 leading bits with one random word a coordinate."""
    count, n, dims = out.shape
    words = np.empty(dims, np.uint64)
    for r in range(count):
        for j in range(dims):
            words[j] = mix_bits(keys[r, 0], keys[r, 1], j) >> _S11
        for i in range(n):
            for j in range(dims):
                digits = np.uint64(points[r, i, j] * _TO_53)
                out[r, i, j] = np.float64(digits ^ words[j]) * _UNIT_53


@kernel
def _flip_nested(k0: np.uint64, k1: np.uint64, dim: int, word: Any) -> np.uint64:
    # Nested uniform scramble of a 32-bit word: the flip of a bit hangs on all the bits above it.
    flips = np.uint64(0)
    for level in range(0, 32, _LEVELS):
        prefix = np.uint64(word >> (32 - level))
        address: Any = (np.uint64(dim) << _S32) | (_ONE << np.uint64(level)) | prefix
        bits = mix_bits(k0, k1, address)
        node = 1  # heap order: the children of node v are 2v and 2v + 1
        for depth in range(level, min(level + _LEVELS, 32)):
            flips = (flips << _ONE) | ((bits >> np.uint64(node)) & _ONE)
            node = 2 * node + ((word >> (31 - depth)) & 1)
    return flips ^ np.uint64(word)


@kernel
def scramble_nested(keys: Array, points: Array, out: Array) -> None:
    """Owen's nested uniform scrambling in base 2: 32 levels, independent uniform digits below."""
    count, n, dims = out.shape
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        for i in range(n):
            for j in range(dims):
                word = np.int64(points[r, i, j] * 2.0**32)
                flipped = _flip_nested(k0, k1, j, word)
                address: Any = _TAIL | np.uint64(i * dims + j)
                tail = mix_bits(k0, k1, address) >> _S43
                out[r, i, j] = np.float64((flipped << np.uint64(21)) | tail) * _UNIT_53
