"""Numba kernels of progressive sets: arrays only, nothing checked.

Legend: ``keys`` uint64 (R, 2) from `Stream.keys`; ``out`` float64 (R, n, 2). A coordinate is a word
of 53 bits, its level-ℓ bit the one worth 2^-(ℓ+1). Points 2^k … 2^(k+1) − 1 are one pass: the points
before it are one in each interval of width 2^-k along an axis, and it fills the free halves of these.
Numbers 2i and 2i + 1 of a realisation are the low bits of point i, the rest has higher addresses.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_bits
from mcspectra.samplers._kernels import _mix_below

__all__ = ["fill_pmj", "fill_pmj02", "fill_pmj02_blue_noise"]

_ONE, _S11 = np.uint64(1), np.uint64(11)
_EVEN_BITS = np.uint64(0x5555555555555555)
_BITS = 5  # of each word that are chosen below those of its cell; finer ones matter little
_TO_53, _UNIT_53 = 2.0**53, 2.0**-53
_CHOICES, _SHUFFLES = 1 << 40, 1 << 41  # where the addresses of other random numbers begin


@kernel
def _complete(k0: np.uint64, k1: np.uint64, number: int, high: Any, level: int) -> Any:
    # The word whose bits up to that of `level` are those of `high`, and random below.
    low = (_ONE << np.uint64(52 - level)) - _ONE
    return (high & ~low) | ((mix_bits(k0, k1, number) >> _S11) & low)


@kernel
def _pair(k0: np.uint64, k1: np.uint64, i: int, j: int, level: int, partner: Any) -> Any:
    # The word in the other half of the partner's interval of width 2^-level.
    return _complete(k0, k1, 2 * i + j, partner ^ (_ONE << np.uint64(52 - level)), level)


@kernel
def _partners(k0: np.uint64, k1: np.uint64, xors: Array, own: Array) -> None:
    # Which axis the third quarter of each cell's points goes along, by a coin for each pass.
    coins = mix_bits(k0, k1, _CHOICES) & _EVEN_BITS
    for j in range(2):
        for level in range(xors.shape[1]):
            x = xors[j, level]
            own[j, level] = np.int64(x ^ ((x >> _ONE) & coins))


@kernel
def fill_pmj02(keys: Array, xors: Array, out: Array) -> None:
    """Progressive (0,2)-sequence; the partner of i on axis j in pass k is i xor xors[j, k]."""
    count, n, _ = out.shape
    own = np.empty(xors.shape, np.int64)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        points = out[r]
        _partners(k0, k1, xors, own)
        for j in range(2):
            points[0, j] = np.float64(mix_bits(k0, k1, j) >> _S11) * _UNIT_53
        level, size = 0, 1
        while size < n:
            for i in range(size, min(2 * size, n)):
                for j in range(2):
                    partner = np.uint64(points[i ^ own[j, level], j] * _TO_53)
                    word = _pair(k0, k1, i, j, level, partner)
                    points[i, j] = np.float64(word) * _UNIT_53
            level, size = level + 1, 2 * size


@kernel
def _free_intervals(
    k0: np.uint64, k1: np.uint64, level: int, words: Array, free: Array, starts: Array
) -> None:
    # List the intervals of width 2^-(level+1) that points 0 … 2^level − 1 leave free, those of
    # each of the equal columns together and shuffled; starts (columns + 1,).
    size, columns = 1 << level, starts.size - 1
    width = 2 * size // columns
    taken = np.zeros(2 * size, np.bool_)
    for i in range(size):
        taken[words[i] >> np.uint64(52 - level)] = True
    end = 0
    for column in range(columns):
        start = starts[column] = end
        for interval in range(column * width, (column + 1) * width):
            if not taken[interval]:
                chosen = start + _mix_below(k0, k1, 2 * size + interval, end - start + 1)
                free[end] = free[chosen]
                free[chosen] = interval
                end += 1
    starts[columns] = end


@kernel
def _choose_quarters(k0: np.uint64, k1: np.uint64, level: int, words: Array, to: Array) -> None:
    # Column and row of the quarter of a cell where each point of a pass goes; to (2, 2^level).
    # A cell's second point is diagonal to its first, the third takes either of the other two.
    side = level // 2 + 1
    cells = 1 << (2 * side - 2)
    shift = np.uint64(53 - side)
    for i in range(1 << level):
        base = i % cells
        column, row = np.int64(words[0, base] >> shift), np.int64(words[1, base] >> shift)
        if level % 2 == 0:
            to[0, i], to[1, i] = column ^ 1, row ^ 1
        else:
            coin = np.int64(mix_bits(k0, k1, _CHOICES + cells + base) & _ONE) ^ (i >= cells)
            to[0, i], to[1, i] = column ^ coin, row ^ coin ^ 1


@kernel
def _pass_pmj(k0: np.uint64, k1: np.uint64, level: int, words: Array) -> None:
    # Make points 2^level … 2^(level+1) − 1, as many as there is room for; words (2, n).
    size, columns = 1 << level, 1 << (level // 2 + 1)
    to, free = np.empty((2, size), np.int64), np.empty(size, np.int64)
    starts = np.empty(columns + 1, np.int64)
    _choose_quarters(k0, k1, level, words, to)
    for j in range(2):
        k = k0 ^ mix_bits(k0, k1, _SHUFFLES + j)
        _free_intervals(k, k1, level, words[j], free, starts)
        for i in range(size, min(2 * size, words.shape[1])):
            column = to[j, i - size]
            high = np.uint64(free[starts[column]]) << np.uint64(52 - level)
            words[j, i] = _complete(k0, k1, 2 * i + j, high, level)
            starts[column] += 1


@kernel
def fill_pmj(keys: Array, out: Array) -> None:
    """Progressive multi-jittered sequence."""
    count, n, _ = out.shape
    words = np.empty((2, n), np.uint64)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        for j in range(2):
            words[j, 0] = mix_bits(k0, k1, j) >> _S11
        level = 0
        while 1 << level < n:
            _pass_pmj(k0, k1, level, words)
            level += 1
        out[r] = words.T * _UNIT_53


@kernel
def _pair_energy(dx: float, dy: float) -> float:
    # Toroidal; only the smallest distances matter to this power.
    dx, dy = dx - np.rint(dx), dy - np.rint(dy)
    square = dx * dx + dy * dy
    return 1.0 / (square * square * square * square)


@kernel
def _gain(i: int, axis: int, bit: Any, members: Any, words: Array, owner: Array) -> float:
    # What point i gains by the flip of `bit` in all words of a strip: `members` is its number and
    # the shift that numbers words. owner (columns, rows) is the point in each cell.
    strip, shift = members
    columns, rows = owner.shape
    here = np.float64(words[axis, i]) * _UNIT_53
    moved = np.float64(words[axis, i] ^ bit) * _UNIT_53
    across = np.float64(words[1 - axis, i]) * _UNIT_53
    column = np.int64(words[0, i] * _UNIT_53 * columns)
    row = np.int64(words[1, i] * _UNIT_53 * rows)
    a, b, gain = min(2, (columns - 1) // 2), min(2, (rows - 1) // 2), 0.0
    for u in range(column - a, column + a + 1):
        for v in range(row - b, row + b + 1):
            other = owner[u & (columns - 1), v & (rows - 1)]
            if other == i:
                continue
            word = words[axis, other]
            there = np.float64(word) * _UNIT_53
            far = np.float64(words[1 - axis, other]) * _UNIT_53 - across
            before = _pair_energy(there - here, far)
            if word >> shift == strip:  # it moves as well, and counts this pair again
                there = np.float64(word ^ bit) * _UNIT_53
                gain += 0.5 * (before - _pair_energy(there - moved, far))
            else:
                gain += before - _pair_energy(there - moved, far)
    return gain


@kernel
def _try_flips(axis: int, level: int, size: int, words: Array, owner: Array) -> None:
    # Swap the halves of each strip of width 2^-level where the first `size` points gain by it.
    order = np.empty(size, np.int64)
    shift = np.uint64(53 - level)
    bit = _ONE << np.uint64(52 - level)
    for i in range(size):
        order[np.int64(words[axis, i] * _UNIT_53 * size)] = i
    width = size >> level
    for strip in range(1 << level):
        gain = 0.0
        members = (np.uint64(strip), shift)
        for i in order[strip * width : (strip + 1) * width]:
            gain += _gain(i, axis, bit, members, words, owner)
        if gain > 0.0:
            for i in order[strip * width : (strip + 1) * width]:
                words[axis, i] ^= bit


@kernel
def _spread_out(level: int, sweeps: int, words: Array) -> None:
    # Flip bits of the first 2^level points below those that number their cells, one point in each.
    size, down = 1 << level, level // 2
    across = level - down
    columns, rows = 1 << across, 1 << down
    owner = np.empty((columns, rows), np.int64)
    for i in range(size):
        column = np.int64(words[0, i] * _UNIT_53 * columns)
        owner[column, np.int64(words[1, i] * _UNIT_53 * rows)] = i
    for _ in range(sweeps):
        for below in range(min(_BITS, down + 1)):
            _try_flips(0, across + below, size, words, owner)
            _try_flips(1, down + below, size, words, owner)


@kernel
def fill_pmj02_blue_noise(keys: Array, xors: Array, sweeps: int, out: Array) -> None:
    """Progressive (0,2)-sequence, of which 2^k points are spread out before the next are made."""
    count, n, _ = out.shape
    own = np.empty(xors.shape, np.int64)
    passes = 0
    while 1 << passes < n:
        passes += 1
    words = np.empty((2, 1 << passes), np.uint64)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        _partners(k0, k1, xors, own)
        words[0, 0], words[1, 0] = mix_bits(k0, k1, 0) >> _S11, mix_bits(k0, k1, 1) >> _S11
        for level in range(passes):
            for i in range(1 << level, 2 << level):
                for j in range(2):
                    words[j, i] = _pair(k0, k1, i, j, level, words[j, i ^ own[j, level]])
            _spread_out(level + 1, sweeps, words)
        for i in range(n):
            for j in range(2):
                out[r, i, j] = words[j, i] * _UNIT_53
