"""Progressive multi-jittered sequences in the plane: stratified at every power of two points.

Each pass of a sequence doubles the number of points.
Before pass k, each of 2^k equal intervals of an axis has one point, in one half of the interval.
Pass k puts a second point into each interval, in the half that is still empty.
The rule that assigns new points to intervals determines in which boxes points are stratified.
Within its half of the interval, each new point has a random position.
Random positions make the sequence Owen-scrambled without permutations of digits [Helmer2021]_.

Notation of the kernels: ``keys`` uint64 (R, 2) from `Stream.keys`; ``out`` float64 (R, n, 2).
A coordinate is a word of 53 bits; its level-ℓ bit is worth 2^-(ℓ+1).
Random numbers 2i and 2i + 1 of a realization are the low bits of point i.
Choices and shuffles use random numbers with higher indices than the points.
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
_SETS = 16  # number of random sets that represent the distribution of pmj
_ONE, _S11 = np.uint64(1), np.uint64(11)
_EVEN_BITS = np.uint64(0x5555555555555555)
# The leading bits of a coordinate give the cell of a point. The next 5 bits are optimized.
# Optimizing finer bits would change little.
_BITS = 5
_UNIT_53 = 2.0**-53
_CHOICES, _SHUFFLES = 1 << 40, 1 << 41  # indices of random numbers for choices and shuffles


class _PlaneSequence(PlaneSampler):
    """Points in the plane that are balanced at powers of two; with `sweeps`, (0,2)-sequences."""

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

    Any count. The first 2^k points have one point in each interval of width 2^-k along either axis.
    If 2^k is a square 4^j, there is also one point in each of 2^j × 2^j cells.
    If 2^k is 2·4^j, each of 2^j × 2^j cells has two points, diagonal to each other.
    Other counts cause a warning (`NotPowerOfTwoWarning`).

    Notes
    -----
    Free intervals are assigned by a shuffle, without a search.

    References
    ----------
    [Christensen2018]_.
    """

    sequence: ClassVar[bool] = True

    def _law(self, n: int) -> Law:
        # Each set is Owen-scrambled by construction.
        # In different sets, two points have different numbers of common leading digits.
        # The mean over a few random sets represents all sets.
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

    Any count. The first 2^k points have one point in each elementary interval of area 2^-k.
    Other counts cause a warning (`NotPowerOfTwoWarning`).

    Notes
    -----
    The points are those of the Sobol' sequence in another order, Owen-scrambled.
    As in Christensen et al., the second point of a cell is diagonal to its first.
    In each pass it is random whether the third point is in the column or in the row of the first.

    References
    ----------
    [Christensen2018]_, [Helmer2021]_.
    """

    sequence: ClassVar[bool] = True

    def _law(self, n: int) -> Law:
        # The points are Sobol' points, which are Owen-scrambled by construction.
        # Scrambling the digits of a single set therefore gives the law of all sets
        if not is_power(n, 2):
            return Unknown(n=n, dims=2)
        return scrambled(Fixed(n=n, dims=2, bases=(2, 2)).of(self), "nested", (2, 2))


@final
@dataclass(frozen=True, kw_only=True)
class PMJ02BlueNoise(_PlaneSequence):
    """Progressive (0,2)-sequence whose points are spread out as blue noise (2-D).

    Any count up to 2^18, best at powers of two; other counts cause a `NotPowerOfTwoWarning`.
    4096 points take a fifth of a second.

    Attributes
    ----------
    sweeps
        Number of sweeps of the optimization, from 1 to 100. Each sweep reconsiders all random bits.

    Notes
    -----
    The random bits of pmj02 are chosen by descent, pass by pass, from coarse to fine.
    The bits of a whole strip of the square are flipped if this lowers an energy.
    The energy is the sum of distance^-8 over all pairs on the torus.
    In the whole set, the nearest two points are two to three times as far apart as in pmj02.
    The first points of a set are also a (0,2)-sequence, but spread no better than in pmj02.
    The mean is unbiased up to the width of the intervals, because each interval has one point.
    A single point is not uniform: its density over sixteenths of an axis varies by up to a tenth.

    The papers choose the best of some candidates for each point in turn.
    The candidates for a new point hardly differ, because they lie in narrow free intervals.
    Flips of whole strips can move points farther than such a choice among candidates.

    References
    ----------
    [Christensen2018]_, [Helmer2021]_.
    """

    unbiased: ClassVar[bool] = False
    max_count: ClassVar[int] = 2**18
    sweeps: int = whole(2, least=1, most=100)


@lru_cache(maxsize=1)
def pairings() -> Array:
    """Return numbers from which the partner of each point in pmj02 follows: out, uint64 (2, 31).

    On each axis, each new point of pass k shares an interval with an earlier point, its partner.
    On axis j, the points i and i xor out[j, k] are partners.
    The bits of the index are the coefficients of a polynomial in t over GF(2).
    The basis of the polynomials is 1, t, b, b·t, b², b²·t, … with b = t² + t.
    The digits of x are the polynomial's coefficients in powers of t.
    The digits of y are its coefficients in powers of t + 1.
    The numbers x and y with these digits are the first two coordinates of Sobol' points.

    Multiples of b^m do not change the first m digits of x or y.
    Each block of 4^m points therefore has one point in each of 2^m × 2^m cells.
    Two partners of pass k on the first axis differ only in digit k of x.
    The difference of the polynomials of these two points is therefore t^k.
    Two partners of pass k on the second axis differ only in digit k of y.
    The difference of the polynomials of these two points is therefore (t + 1)^k.
    """
    even = 0x5555555555555555
    out = np.empty((2, _PASSES), np.uint64)
    x = y = 1
    for k in range(_PASSES):
        out[0, k], out[1, k] = x, y
        x = x << 1 ^ x & ~even  # multiply by t: b^m → b^m t, b^m t → b^(m+1) + b^m t
        y = y << 1 ^ y & even  # multiply by t + 1
    out.setflags(write=False)
    return out


@kernel
def _complete(k0: np.uint64, k1: np.uint64, number: int, high: Any, level: int) -> Any:
    # Keep the bits of a word down to bit `level`, and replace the lower bits by random bits.
    low = (_ONE << np.uint64(52 - level)) - _ONE
    return (high & ~low) | ((mix_bits(k0, k1, number) >> _S11) & low)


@kernel
def _free_intervals(
    k0: np.uint64, k1: np.uint64, level: int, words: Array, free: Array, starts: Array
) -> None:
    # List the intervals of width 2^-(level+1) that points 0 … 2^level − 1 leave free.
    # The axis is divided into columns of equal width.
    # The free intervals of a column are listed together, in random order.
    # The entries of column c begin at starts[c], where starts has shape (columns + 1,).
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
            # For each point of the pass, choose a quarter of its cell: column and row.
            # The second point of a cell is diagonal to its first.
            # The third point of a cell takes one of the two quarters that are still empty.
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

            # Assign to each new point a free interval of its column, and a free interval of its row
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
    # Distances are on the torus; at this high power, only the smallest distances matter.
    dx, dy = dx - np.rint(dx), dy - np.rint(dy)
    square = dx * dx + dy * dy
    return 1.0 / (square * square * square * square)


@kernel
def _gain(i: int, axis: int, bit: Any, members: Any, words: Array, owner: Array) -> float:
    # Return the decrease of the energy of point i if `bit` is flipped for all points of a strip.
    # A strip contains all points whose coordinates have the same leading bits.
    # `members` is the pair (strip, shift): the points with word >> shift equal to `strip`.
    # owner (columns, rows) is the point in each cell.
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
            # If both points of a pair lie in the flipped strip, the flip moves both points.
            # The pair is then counted twice, so half of the gain is added each time
            if word >> shift == strip:
                there = np.float64(word ^ bit) * _UNIT_53
                gain += 0.5 * (before - _pair_energy(there - moved, far))
            else:
                gain += before - _pair_energy(there - moved, far)
    return gain


@kernel
def _try_flips(axis: int, level: int, size: int, words: Array, owner: Array) -> None:
    # For strips of width 2^-level, swap the halves if this lowers the energy of `size` points.
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
    # Fill `out` with points of a (0,2)-sequence.
    # In pass k, the points i and i xor xors[j, k] share one interval of axis j.
    # With `sweeps`, existing points are spread out before the points of the next pass are made.
    count, n, _ = out.shape
    passes = 0
    while 1 << passes < n:
        passes += 1
    room = 1 << passes if sweeps else n
    own, words = np.empty(xors.shape, np.int64), np.empty((2, room), np.uint64)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]

        # One random bit for each pass: the axis along which the third point of a cell is placed
        coins = mix_bits(k0, k1, _CHOICES) & _EVEN_BITS
        for j in range(2):
            words[j, 0] = mix_bits(k0, k1, j) >> _S11
            for level in range(xors.shape[1]):
                own[j, level] = np.int64(xors[j, level] ^ ((xors[j, level] >> _ONE) & coins))

        for level in range(passes):
            # Each point goes to the free half of its partner's interval, which has width 2^-level
            size, half = 2 << level, _ONE << np.uint64(52 - level)
            for i in range(size >> 1, min(size, room)):
                for j in range(2):
                    high = words[j, i ^ own[j, level]] ^ half
                    words[j, i] = _complete(k0, k1, 2 * i + j, high, level)
            if not sweeps:
                continue

            # Find the cell of each point. Each cell has one point, numbered by its leading bits.
            # Then try to flip lower bits, which move a point within its cell
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
