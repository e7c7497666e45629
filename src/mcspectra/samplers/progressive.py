"""Progressive multi-jittered sequences in the plane: stratified at every power of two points.

A pass of a sequence doubles it. Before pass k each of 2^k equal intervals along an axis has one point;
pass k fills the free half of each. Which new point goes to which interval decides what is stratified
besides, and where in the half it lies is random: that makes an Owen-scrambled sequence without digit
permutations [Helmer2021]_.

Legend of the kernels: ``keys`` uint64 (R, 2) from `Stream.keys`; ``out`` float64 (R, n, 2). A coordinate
is a word of 53 bits, its level-ℓ bit the one worth 2^-(ℓ+1). Numbers 2i and 2i + 1 of a realization are
the low bits of point i, the rest has higher addresses.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.fields import whole
from mcspectra.core.jit import kernel
from mcspectra.core.streams import Stream, mix_bits
from mcspectra.samplers._kernels import _mix_below
from mcspectra.samplers.base import PlaneSampler, Structure
from mcspectra.samplers.law import Choice, Fixed, Law, Unknown, is_power, scrambled

__all__ = ["PMJ", "PMJ02", "PMJ02BlueNoise", "pairings"]

_PASSES = 31
_SETS = 16  # Sets of pmj that represent all sets in its law
_ONE, _S11 = np.uint64(1), np.uint64(11)
_EVEN_BITS = np.uint64(0x5555555555555555)
_BITS = 5  # of each word that are chosen below those of its cell; finer ones matter little
_UNIT_53 = 2.0**-53
_CHOICES, _SHUFFLES = 1 << 40, 1 << 41  # where the addresses of other random numbers begin


class _PlaneSequence(PlaneSampler):
    """Points in the plane that are balanced at powers of two: (0,2)-sequences, spread out in `sweeps`."""

    structure: ClassVar[Structure] = Structure.DIGITS
    other_dims: ClassVar[str] = "for other dims use sobol | owen"
    sweeps: int = 0

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        out = np.empty((count, n, 2))
        _fill_pmj02(stream.keys(first, count), pairings(), self.sweeps, out)
        return out

    def _count_warning(self, n: int) -> str | None:
        if not n & (n - 1):
            return None
        below = 1 << (n.bit_length() - 1)
        return f"{n} points of {self.name} are not balanced; {below} and {2 * below} would be."


@final
@dataclass(frozen=True, kw_only=True)
class PMJ(_PlaneSequence):
    """Progressive multi-jittered sequence (2-D).

    Any count. The first 2^k points are one in each interval of width 2^-k along either axis; 4^k of
    them are also one in each of 2^k × 2^k cells, and 2·4^k two diagonal ones in each. Other counts are
    made with a `NotPowerOfTwoWarning`.

    Notes
    -----
    Free intervals are dealt out by shuffling them, not found by search.

    References
    ----------
    [Christensen2018]_.
    """

    sequence: ClassVar[bool] = True

    def _law(self, n: int) -> Law:
        # Scrambled by their making; which digits agree is random, here that of some sets
        sets = (Fixed(n=n, dims=2, bases=(2, 2), seed=k).of(self) for k in range(_SETS))
        return Choice(n=n, dims=2, laws=tuple(scrambled(each, "nested", (2, 2)) for each in sets))

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        out = np.empty((count, n, 2))
        _fill_pmj(stream.keys(first, count), out)
        return out


@final
@dataclass(frozen=True, kw_only=True)
class PMJ02(_PlaneSequence):
    """Progressive multi-jittered (0,2)-sequence (2-D).

    Any count. The first 2^k points are one in each elementary interval of area 2^-k, whatever its
    shape. Other counts are made with a `NotPowerOfTwoWarning`.

    Notes
    -----
    The points are those of the Sobol' sequence in another order, Owen-scrambled. In the order of
    Christensen et al. the second point of a cell is diagonal to its first; whether the third shares
    its columns or its rows is a coin for each pass.

    References
    ----------
    [Christensen2018]_, [Helmer2021]_.
    """

    sequence: ClassVar[bool] = True

    def _law(self, n: int) -> Law:
        # Sobol' points that are Owen-scrambled by their making: one set has the digits of all
        if not is_power(n, 2):
            return Unknown(n=n, dims=2)
        return scrambled(Fixed(n=n, dims=2, bases=(2, 2)).of(self), "nested", (2, 2))


@final
@dataclass(frozen=True, kw_only=True)
class PMJ02BlueNoise(_PlaneSequence):
    """Progressive (0,2)-sequence whose points are spread out as blue noise (2-D).

    Any count up to 2^18, at its best at powers of two; others are made with a
    `NotPowerOfTwoWarning`. 4096 points take a fifth of a second.

    Attributes
    ----------
    sweeps
        Number of passes over all choices, from 1 to 100.

    Notes
    -----
    The random bits of pmj02 are chosen instead: pass by pass, coarse to fine, those of a whole strip
    of the square are flipped where that lowers the sum of distance^-8 on the torus. The nearest two
    points are two to three times as far apart as those of pmj02, in the whole set: its first points
    are a (0,2)-sequence too, but spread out no better than those of pmj02. The mean is unbiased up to
    the width of the intervals, since these have one point each. A given point alone is not uniform:
    over sixteenths of an axis its density differs by up to a tenth.

    The papers pick the best of some candidates for each point in turn. By then its choices are as
    narrow as its intervals: hence the strips.

    References
    ----------
    [Christensen2018]_, [Helmer2021]_.
    """

    unbiased: ClassVar[bool] = False
    max_count: ClassVar[int] = 2**18
    sweeps: int = whole(2, least=1, most=100)


@lru_cache(maxsize=1)
def pairings() -> Array:
    """Partners of pmj02: on axis j in pass k that of point i is i xor out[j, k]; uint64 (2, 31).

    Read the bits of the index as coefficients, over GF(2), in the basis 1, t, b, b·t, b², b²·t, …
    with b = t² + t. The digits of x are those of this polynomial in powers of t, those of y in powers
    of t + 1: the first two axes of Sobol'. Multiples of b^m change neither's first m digits, so that
    the m-th four blocks of points share the cells of the first. The partner differs in digit k alone:
    by t^k, or (t + 1)^k, in that basis.
    """
    even = 0x5555555555555555
    out = np.empty((2, _PASSES), np.uint64)
    x = y = 1
    for k in range(_PASSES):
        out[0, k], out[1, k] = x, y
        x = x << 1 ^ x & ~even  # times t: b^m → b^m t, b^m t → b^(m+1) + b^m t
        y = y << 1 ^ y & even  # times t + 1
    out.setflags(write=False)
    return out


@kernel
def _complete(k0: np.uint64, k1: np.uint64, number: int, high: Any, level: int) -> Any:
    # The word whose bits up to that of `level` are those of `high`, and random below.
    low = (_ONE << np.uint64(52 - level)) - _ONE
    return (high & ~low) | ((mix_bits(k0, k1, number) >> _S11) & low)


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
def _fill_pmj(keys: Array, out: Array) -> None:
    count, n, _ = out.shape
    words = np.empty((2, n), np.uint64)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        for j in range(2):
            words[j, 0] = mix_bits(k0, k1, j) >> _S11
        level = 0
        while 1 << level < n:
            # Choose column and row of the quarter of a cell where each point of the pass goes: a
            # cell's second point is diagonal to its first, the third takes either of the other two
            size, side = 1 << level, level // 2 + 1
            columns, cells, shift = 1 << side, 1 << (2 * side - 2), np.uint64(53 - side)
            to = np.empty((2, size), np.int64)
            for i in range(size):
                base = i % cells
                column, row = np.int64(words[0, base] >> shift), np.int64(words[1, base] >> shift)
                if level % 2 == 0:
                    to[0, i], to[1, i] = column ^ 1, row ^ 1
                else:
                    bits = mix_bits(k0, k1, _CHOICES + cells + base)
                    coin = np.int64(bits & _ONE) ^ (i >= cells)
                    to[0, i], to[1, i] = column ^ coin, row ^ coin ^ 1

            # Deal out the free intervals of these columns and rows
            free, starts = np.empty(size, np.int64), np.empty(columns + 1, np.int64)
            for j in range(2):
                k = k0 ^ mix_bits(k0, k1, _SHUFFLES + j)
                _free_intervals(k, k1, level, words[j], free, starts)
                for i in range(size, min(2 * size, n)):
                    column = to[j, i - size]
                    high = np.uint64(free[starts[column]]) << np.uint64(52 - level)
                    words[j, i] = _complete(k0, k1, 2 * i + j, high, level)
                    starts[column] += 1
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
def _fill_pmj02(keys: Array, xors: Array, sweeps: int, out: Array) -> None:
    # (0,2)-sequence; the partner of i on axis j in pass k is i xor xors[j, k]. With `sweeps`, the
    # points of all passes so far are spread out before the next are made.
    count, n, _ = out.shape
    passes = 0
    while 1 << passes < n:
        passes += 1
    room = 1 << passes if sweeps else n
    own, words = np.empty(xors.shape, np.int64), np.empty((2, room), np.uint64)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]

        # A coin for each pass: which axis the third quarter of each cell's points goes along
        coins = mix_bits(k0, k1, _CHOICES) & _EVEN_BITS
        for j in range(2):
            words[j, 0] = mix_bits(k0, k1, j) >> _S11
            for level in range(xors.shape[1]):
                own[j, level] = np.int64(xors[j, level] ^ ((xors[j, level] >> _ONE) & coins))

        for level in range(passes):
            # Each point goes to the other half of its partner's interval of width 2^-level
            size, half = 2 << level, _ONE << np.uint64(52 - level)
            for i in range(size >> 1, min(size, room)):
                for j in range(2):
                    high = words[j, i ^ own[j, level]] ^ half
                    words[j, i] = _complete(k0, k1, 2 * i + j, high, level)
            if not sweeps:
                continue

            # Flip bits below those that number the cells, one point in each
            down = (level + 1) // 2
            across = level + 1 - down
            columns, rows = 1 << across, 1 << down
            owner = np.empty((columns, rows), np.int64)
            for i in range(size):
                column = np.int64(words[0, i] * _UNIT_53 * columns)
                owner[column, np.int64(words[1, i] * _UNIT_53 * rows)] = i
            for _ in range(sweeps):
                for below in range(min(_BITS, down + 1)):
                    _try_flips(0, across + below, size, words, owner)
                    _try_flips(1, down + below, size, words, owner)
        for i in range(n):
            for j in range(2):
                out[r, i, j] = words[j, i] * _UNIT_53
