"""Numba kernels that scramble binary digits: XOR, nested uniform, by hash, by random matrices.

Legend: R realisations, n points, d dims; ``keys`` uint64 (R, 2) from `Stream.keys`; ``points`` and
``out`` float64 (R, n, d). A coordinate is a word of 32 (or 53) bits, the highest standing for ½.
Random numbers below 2^62 and those from 2^63 on are those of digits here; other bases have theirs
between.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_bits
from mcspectra.samplers._digital_kernels import BLOCK, block_words, low_words

__all__ = [
    "fill_hashed",
    "fill_mixed",
    "mix_matrices",
    "scramble_hashed",
    "scramble_nested",
    "xor_digits",
]

_ONE, _TAIL = np.uint64(1), np.uint64(1 << 63)
_S11, _S21, _S32, _S43 = np.uint64(11), np.uint64(21), np.uint64(32), np.uint64(43)
_TO_53, _UNIT_53, _TO_32 = 2.0**53, 2.0**-53, 2.0**32
_LEVELS = 6  # a binary subtree of 6 levels has 63 nodes: one 64-bit hash flips them all


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
def _with_tail(k0: np.uint64, k1: np.uint64, number: int, word: Any) -> Any:
    # The point of a 32-bit word, independent uniform bits below.
    address: Any = _TAIL | np.uint64(number)
    tail = mix_bits(k0, k1, address) >> _S43
    return np.float64(np.int64((np.uint64(word) << _S21) | tail)) * _UNIT_53


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
                flipped = _flip_nested(k0, k1, j, np.int64(points[r, i, j] * _TO_32))
                out[r, i, j] = _with_tail(k0, k1, i * dims + j, flipped)


@kernel
def _reversed(word: Any) -> Any:
    # Bits of a 32-bit word in reverse, by halves (compilers know it).
    x = np.uint32(word)
    x = np.uint32(np.uint32(x >> 16) | np.uint32(x << 16))
    x = np.uint32(np.uint32((x >> 8) & 0x00FF00FF) | np.uint32((x & 0x00FF00FF) << 8))
    x = np.uint32(np.uint32((x >> 4) & 0x0F0F0F0F) | np.uint32((x & 0x0F0F0F0F) << 4))
    x = np.uint32(np.uint32((x >> 2) & 0x33333333) | np.uint32((x & 0x33333333) << 2))
    return np.uint32(np.uint32((x >> 1) & 0x55555555) | np.uint32((x & 0x55555555) << 1))


@kernel
def _hashed(word: Any, add: Any, factor: Any, add_2: Any, factor_2: Any) -> Any:
    # Hash of a reversed word in which every bit hangs on those below it only: products by even
    # numbers XORed in, and odd multiples of sums, do just that. All uint32, factors odd.
    x = np.uint32(word)
    x = np.uint32(x ^ np.uint32(x * np.uint32(0x3D20ADEA)))
    x = np.uint32(np.uint32(x + add) * factor)
    x = np.uint32(x ^ np.uint32(x * np.uint32(0x05526C56)))
    x = np.uint32(np.uint32(x + add_2) * factor_2)
    return np.uint32(x ^ np.uint32(x * np.uint32(0x53A22864)))


@kernel
def _hash_keys(k0: np.uint64, k1: np.uint64, out: Array) -> None:
    # out uint32 (d, 4)
    for j in range(out.shape[0]):
        for part in range(2):
            bits = mix_bits(k0, k1, 2 * j + part)
            out[j, 2 * part] = np.uint32(bits >> _S32)
            out[j, 2 * part + 1] = np.uint32(bits) | np.uint32(1)


@kernel
def scramble_hashed(keys: Array, points: Array, out: Array) -> None:
    """Owen scrambling by hash of 32 bits, independent uniform digits below."""
    count, n, dims = out.shape
    hash_keys = np.empty((dims, 4), np.uint32)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        _hash_keys(k0, k1, hash_keys)
        for i in range(n):
            for j in range(dims):
                word = _reversed(np.uint32(np.int64(points[r, i, j] * _TO_32)))
                add, factor, add_2, factor_2 = hash_keys[j]
                word = _reversed(_hashed(word, add, factor, add_2, factor_2))
                out[r, i, j] = _with_tail(k0, k1, i * dims + j, word)


@kernel
def _hash_block(low: Array, high: Any, key: Array, out: Array) -> None:
    add, factor, add_2, factor_2 = key[0], key[1], key[2], key[3]
    for t in range(low.size):
        out[t] = _reversed(_hashed(low[t] ^ high, add, factor, add_2, factor_2))


@kernel
def fill_hashed(keys: Array, directions: Array, out: Array) -> None:
    """What `scramble_hashed` makes of points 0 … n−1 of the sequence of uint32 (d, 32) columns."""
    count, n, dims = out.shape
    backwards = np.empty_like(directions)
    for j in range(dims):
        for k in range(directions.shape[1]):
            backwards[j, k] = _reversed(directions[j, k])
    low = low_words(backwards, n)
    size = low.shape[1]
    words, high = np.empty(size * dims, np.uint32), np.empty(dims, np.uint32)
    hash_keys = np.empty((dims, 4), np.uint32)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        _hash_keys(k0, k1, hash_keys)
        row = out[r].reshape(n * dims)
        for start in range(0, n, size):
            block_words(backwards, start // BLOCK, high)
            for j in range(dims):
                _hash_block(low[j], high[j], hash_keys[j], words[j::dims])
            for t in range(min(size, n - start) * dims):
                number = start * dims + t
                row[number] = _with_tail(k0, k1, number, words[t])


@kernel
def _draw_matrices(k0: np.uint64, k1: np.uint64, shift: bool, columns: Array, words: Array) -> None:
    # Lower triangular, ones on the diagonal: columns uint64 (d, 53); words (d,) of the shift
    dims = words.size
    for j in range(dims):
        for c in range(53):
            below = mix_bits(k0, k1, dims + j * 53 + c) >> np.uint64(c + 12)
            columns[j, c] = (_ONE << np.uint64(52 - c)) | (below if c < 52 else np.uint64(0))
        words[j] = mix_bits(k0, k1, j) >> _S11 if shift else np.uint64(0)


@kernel
def _product(columns: Array, digits: Any) -> Any:
    # Matrix times bits, the first of which is the highest of 64
    product, c = np.uint64(0), 0
    while digits:
        if digits & _TAIL:
            product ^= columns[c]
        digits, c = digits << _ONE, c + 1
    return product


@kernel
def mix_matrices(keys: Array, shift: bool, points: Array, out: Array) -> None:
    """Random lower triangular matrices of ones on the diagonal, times the 53 bits of points.

    With `shift` a random word is added (XOR) afterwards, the same for all points.
    """
    count, n, dims = out.shape
    columns, words = np.empty((dims, 53), np.uint64), np.empty(dims, np.uint64)
    for r in range(count):
        _draw_matrices(keys[r, 0], keys[r, 1], shift, columns, words)
        for i in range(n):
            for j in range(dims):
                digits = np.uint64(points[r, i, j] * _TO_53) << _S11
                mixed = _product(columns[j], digits) ^ words[j]
                out[r, i, j] = np.float64(np.int64(mixed)) * _UNIT_53


@kernel
def fill_mixed(keys: Array, shift: bool, directions: Array, out: Array) -> None:
    """What `mix_matrices` makes of points 0 … n−1 of the sequence of uint32 (d, 32) columns."""
    count, n, dims = out.shape
    columns, words = np.empty((dims, 53), np.uint64), np.empty(dims, np.uint64)
    mixed, high = np.zeros((dims, 32), np.uint64), np.empty(dims, np.uint64)
    for r in range(count):
        _draw_matrices(keys[r, 0], keys[r, 1], shift, columns, words)
        for j in range(dims):
            k = 0
            while k < 32 and (1 << k) < n:
                mixed[j, k] = _product(columns[j], np.uint64(directions[j, k]) << _S32)
                k += 1
        low = low_words(mixed, n)
        size = low.shape[1]
        for start in range(0, n, size):
            block_words(mixed, start // BLOCK, high)
            for j in range(dims):
                base: Any = high[j] ^ words[j]
                for t in range(min(size, n - start)):
                    out[r, start + t, j] = np.float64(np.int64(low[j, t] ^ base)) * _UNIT_53
