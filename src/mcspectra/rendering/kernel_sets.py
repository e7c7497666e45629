"""Point sets computed in Dr.Jit's kernels instead of drawn as tables.

Method
------
A `Rule` describes the sets of a sampler. Three steps make a coordinate of a point:

1. All sets share one number for each place of a set: a coordinate of a net or of a drawn set,
   or the lower corner of a cell.
2. The set moves its numbers: by a shift modulo 1, by an XOR of their binary digits,
   or by a hash that scrambles digits like ``owen(method='hash')``.
   A mask or random bits give the shift. In each round, the hash takes two random bits per digit.
   For each request, the mask is at another random place: shifts of requests are independent.
3. Random bits of the point place it in the cell that its moved number belongs to.

Random points have one cell. Jittered points have n cells, and no set moves them.
A net with ``digital-shift(jitter=True)`` is moved by XOR and placed in cells of side 2^-m.
A net with ``owen`` is placed in cells that contain at most one coordinate of its points each:
scrambled digits after the first digits that no two points share are independent random digits.
``decorrelate`` moves a drawn set, and has no cells.
Coordinate j of point i of a net: XOR those columns of generator matrix j that the bits of i select.

Numbers are 32 bits of a binary fraction (`straight`), or the same bits in reversed order.
Points are rounded down to multiples of 2^-24, which are exact in float32.

Random bits are words of 32 bits, a hash of two keys and the number of the word (`_Bits`).
Multiplications of 64 bits would take a third of the time of all random numbers.
The keys of a pixel, and those of a point, are 64 bits from the streams of `core.streams`.

Renderers request one or two numbers at a time and need point sets in a random order (`Pads`).
Numbers that come jointly from one set are in the order of the sampler (`JointSets`).
The class `NetPoints` computes the points of ``owen(method='hash')`` from the sampler's keys.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from math import gcd
from typing import Any, Literal, Protocol, TypeAlias, final, runtime_checkable

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.streams import Stream
from mcspectra.samplers import Sampler
from mcspectra.samplers.base import FIRST_STEP, Randomized
from mcspectra.samplers.lattice import golden_steps
from mcspectra.samplers.law import Fixed, Independent, Law, Scrambled, Shifted, Strata
from mcspectra.samplers.randomizations import Decorrelate
from mcspectra.samplers.scrambles import DigitalShift, Owen

__all__ = [
    "JointPoints",
    "JointSets",
    "Net",
    "NetPoints",
    "Pads",
    "Rounds",
    "Rule",
    "net_of",
    "rule_of",
    "scramble_key",
    "shifted_net_of",
]

# The table of permutations has at least this many numbers, which take 32 KiB.
# The table is larger if 16 permutations, the smallest number allowed, do not fit
_ORDER_NUMBERS = 2**13
_FEWEST_ORDERS = 16
_MOST_NUMBERS = 2**27  # maximum number of values in one table (512 MiB)
_FEWEST_SETS = 509  # minimum number of sets in a table, a prime; later requests reuse them
_GOLDEN = (5**0.5 - 1) / 2
_DIGITS = 24  # binary digits of the numbers in float32
_WORD = 0x9E3779B1  # step between the addresses of two words of random bits, an odd number
_WORDS = 8  # largest number of words for one request of a set, or of a point
_M1, _M2, _M3 = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


@runtime_checkable
class Net(Protocol):
    """A digital net or sequence in base 2."""

    @property
    def dims(self) -> int:
        """Number of dims."""

    def direction_numbers(self, n: int) -> Array:
        """Columns of the generator matrices for n points: uint32 (dims, 32); 2^31 stands for ½."""


def net_of(sampler: Sampler | None) -> Net | None:
    """Return the net that `sampler` scrambles by owen alone, or None for other samplers."""
    if not isinstance(sampler, Randomized) or not isinstance(sampler.base, Net):
        return None
    first, *others = sampler.steps
    if others or not isinstance(first, Owen) or not np.all(np.equal(first.base or 2, 2)):
        return None
    return sampler.base


def shifted_net_of(sampler: Sampler | None) -> Net | None:
    """Return the net that `sampler` shifts with jitter alone; None for other samplers."""
    if not isinstance(sampler, Randomized) or not isinstance(sampler.base, Net):
        return None
    first, *others = sampler.steps
    if others or not isinstance(first, DigitalShift) or not first.jitter:
        return None
    return sampler.base if np.all(np.equal(first.base or 2, 2)) else None


def scramble_key(stream: Stream) -> int:
    """Random key by which a sampler scrambles realizations, if owen is its only randomization."""
    return stream.child(FIRST_STEP).key


Move: TypeAlias = Literal["none", "shift", "digital-shift", "owen"]


@final
@dataclass(frozen=True, kw_only=True)
class Rule:
    """How kernels compute the sets of a sampler.

    Attributes
    ----------
    dims
        Number of coordinates.
    shared
        The numbers that all sets share: a net, or a function that draws points (n, dims).
        The function gets the random stream of the sets.
        If None, the numbers are the lower corners of the cells, in row-major order.
    move
        How each set moves the shared numbers: by a shift modulo 1, a digital shift or a scramble.
    cells
        Number of cells along each axis. Each point is uniform in a cell; without cells, it is
        not jittered. After a digital shift or a scramble, they must be powers of two.
    mask
        The randomization whose mask gives the shifts of pixels.
        If None, each set has its own random bits.
    mask_label
        Label of the mask's random stream.
    """

    dims: int
    shared: Net | Callable[[Stream], Array] | None = None
    move: Move = "none"
    cells: tuple[int, ...] | None = None
    mask: Decorrelate | None = None
    mask_label: int = 0


def rule_of(sampler: Sampler, n: int) -> Rule | None:
    """Return the rule for sets of `n` points, or None if kernels cannot compute the sampler's sets.

    The rule follows from the sampler's law, except for nets and for sets that pixels share.
    """
    dims = sampler.dims
    if any(isinstance(step, Decorrelate) for step in sampler.randomizations):
        return _shared_by_pixels(sampler, n)
    if not sampler.independent:
        return None
    if (net := net_of(sampler)) is not None:
        cells = (1 << _own_digits(net, n),) * dims
        return Rule(dims=dims, shared=net, move="owen", cells=cells)
    if (net := shifted_net_of(sampler)) is not None:
        cells = (1 << (n - 1).bit_length(),) * dims
        return Rule(dims=dims, shared=net, move="digital-shift", cells=cells)
    return _rule_of_law(sampler.law(n))


def _own_digits(net: Net, n: int) -> int:
    """Return the number of leading digits with which the coordinates of n points of a net differ.

    Columns of a generator matrix that are cut to this number of rows are linearly independent.
    The result is the least such number for all dims, but at most `_DIGITS`.
    """
    bits, most = (n - 1).bit_length(), 0
    for columns in net.direction_numbers(n):
        digits = bits
        while digits < _DIGITS:
            rest, rank = [int(each) >> (32 - digits) for each in columns[:bits]], 0
            while any(rest):
                pivot = max(rest)
                rest = [min(each, each ^ pivot) for each in rest]
                rank += 1
            if rank == bits:
                break
            digits += 1
        most = max(most, digits)
    return most


def _rule_of_law(law: Law) -> Rule | None:
    """Return the rule for sets with the given joint distribution of the points."""
    match law:
        case Independent():
            return Rule(dims=law.dims, cells=(1,) * law.dims)
        case Strata(jittered=True):
            return Rule(dims=law.dims, cells=law.sides)
        case Fixed():
            return Rule(dims=law.dims, shared=lambda _: law.points)
        case Shifted(inner=Fixed() as inner):
            return Rule(dims=law.dims, shared=lambda _: inner.points, move="shift")
        case Scrambled(inner=Fixed() as inner, shifts=True) if set(law.bases) == {2}:
            move: Move | None = "digital-shift" if law.xor else None
            move = "owen" if law.kind == "nested" else move
            return move and Rule(dims=law.dims, shared=lambda _: inner.points, move=move)
    return None


def _shared_by_pixels(sampler: Sampler, n: int) -> Rule | None:
    """Return the rule of a sampler that ends in decorrelate: all sets are one set, moved."""
    *before, step = sampler.randomizations
    inner = sampler.plain
    if before:
        inner = Randomized(base=inner, steps=tuple(before))
    if not isinstance(step, Decorrelate) or step.advance:
        return None
    if step.mode != "shift" and not set(inner.digit_bases) <= {2}:
        return None

    def drawn(stream: Stream) -> Array:
        return np.asarray(inner.draw_stream(n, stream, 0, 1)[0])

    move: Any = step.mode
    return Rule(
        dims=inner.dims,
        shared=inner if isinstance(inner, Net) else drawn,
        move=move,
        mask=None if step.mask == "white" else step,
        mask_label=FIRST_STEP + inner.plain.scrambles + len(before),
    )


def net_words(module: Any, net: Net, count: int, index: Any) -> list[Any]:
    """Coordinates of net points as UInt32 numbers of reversed bits: the lowest bit stands for ½."""
    bits = max(1, (count - 1).bit_length())
    chosen = [module.UInt32(0) - ((index >> k) & 1) for k in range(bits)]
    words = []
    for columns in net.direction_numbers(count):
        if all(int(column) << k == 2**31 for k, column in enumerate(columns[:bits])):
            words.append(index)  # coordinates of van der Corput's sequence
            continue
        word = module.UInt32(0)
        for mask, column in zip(chosen, columns[:bits], strict=True):
            if column:
                word ^= mask & int(f"{int(column):032b}"[::-1], 2)
        words.append(word)
    return words


def mix_bits(module: Any, k0: Any, k1: Any, i: Any) -> Any:
    """Mix bits in the same way as `core.streams.mix_bits`, for UInt64."""
    x = (module.UInt64(i) ^ k0) * _M1
    x ^= x >> 32
    x = (x + k1) * _M2
    x ^= x >> 29
    x *= _M3
    return x ^ (x >> 32)


def _philox(module: Any, key: Any, number: Any) -> tuple[Any, Any]:
    """Same as `core.streams.Stream.keys`, for realization numbers below 2^32."""
    wide, low = module.UInt64, 0xFFFFFFFF
    a, b, c, d = wide(number), wide(0), wide(0), wide(0)
    k0, k1 = key & low, key >> 32
    for _ in range(10):
        p, q = a * 0xD2511F53, c * 0xCD9E8D57
        a, b, c, d = (q >> 32) ^ b ^ k0, q & low, (p >> 32) ^ d ^ k1, p & low
        k0, k1 = (k0 + 0x9E3779B9) & low, (k1 + 0xBB67AE85) & low
    return (a << 32) | b, (c << 32) | d


def _halves(module: Any, bits: Any) -> tuple[Any, Any]:
    """Split 64 random bits into two parameters of a hash: a summand and an odd factor."""
    return module.UInt32(bits >> 32), module.UInt32(bits) | 1


def _unit(module: Any, word: Any) -> Any:
    """Return a binary fraction of 32 bits as a number in [0,1), rounded down."""
    return module.Float(module.Int32(word >> (32 - _DIGITS))) * 2.0**-_DIGITS


def _hashed(x: Any, *keys: tuple[Any, Any]) -> Any:
    """Scramble a number in one or two rounds. Each bit depends only on lower bits, as in `Owen`."""
    x = x ^ (x * 0x3D20ADEA)
    x = (x + keys[0][0]) * keys[0][1]
    x ^= x * 0x05526C56
    for summand, factor in keys[1:]:
        x = (x + summand) * factor
    return x ^ (x * 0x53A22864)


@final
@dataclass(frozen=True)
class NetPoints:
    """The first `count` points of scrambled nets, for realizations of one or more random streams.

    The points are those of ``owen(method='hash')``, rounded down to float32.
    `streams`, uint64 (S,), are the seeds of the random streams.
    `numbers` (R,) are the indices of the realizations.
    """

    net: Net
    count: int
    streams: Array
    numbers: Array

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of sets, points per set, and dims."""
        return len(self.streams) * len(self.numbers), self.count, self.net.dims

    def lanes(self, module: Any, row: Any) -> Callable[[Any], list[Any]]:
        """Return a function from the index of a point to its coordinates. Each lane is one set."""
        import drjit

        stream = row // drjit.opaque(module.UInt32, len(self.numbers))
        own = row - stream * drjit.opaque(module.UInt32, len(self.numbers))
        number = drjit.gather(module.UInt32, module.UInt32(self.numbers), own)
        key = drjit.gather(module.UInt64, module.UInt64(self.streams), stream)
        k0, k1 = _philox(module, key, number)
        keys = [
            [_halves(module, mix_bits(module, k0, k1, 2 * j + part)) for part in (0, 1)]
            for j in range(self.net.dims)
        ]

        def points(index: Any) -> list[Any]:
            words = net_words(module, self.net, self.count, index)
            hashed = (_hashed(w, *k) for w, k in zip(words, keys, strict=True))
            return [_unit(module, drjit.brev(word)) for word in hashed]

        return points


def _words(module: Any, bits: Any) -> tuple[Any, Any]:
    """Split 64 random bits into two words, the keys of a hash."""
    return module.UInt32(bits >> 32), module.UInt32(bits)


class _Bits:
    """Random bits of a set or of a point, taken in pieces of at most 32 bits.

    Word k is a hash of the two keys and of the address plus k times `_WORD`.
    Without the keys, it is the hash of 32 bits with two multiplications and the least bias that
    the program ``hash-prospector`` found.
    The second key enters after a first nonlinear step.
    Therefore two pixels have equal words, in another order, only if both of their keys fit.
    Words are computed only when the bits of earlier words do not suffice.
    """

    def __init__(self, module: Any, keys: tuple[Any, Any], address: Any) -> None:
        self._module, self._key, self._start = module, keys[1], address + keys[0]
        self._taken: list[tuple[Any, int]] = []  # words, and how many bits are used

    def _word(self, number: int) -> Any:
        x = self._start + number * _WORD % 2**32
        x = ((x ^ (x >> 16)) + self._key) * 0x21F0AAAD
        x = (x ^ (x >> 15)) * 0xD35A2D97
        return x ^ (x >> 15)

    def take(self, count: int) -> Any:
        """Return `count` random bits as a UInt32 number."""
        if count == 0:
            return self._module.UInt32(0)
        free = (k for k, (_, used) in enumerate(self._taken) if used + count <= 32)
        place = next(free, len(self._taken))
        if place == len(self._taken):
            self._taken.append((self._word(place), 0))
        word, used = self._taken[place]
        self._taken[place] = word, used + count
        if count == 32:
            return word
        # The highest bits need no AND
        return word >> used if used + count == 32 else (word >> used) & (2**count - 1)

    def below(self, bound: int, opaque: Any) -> Any:
        """Return a random whole number below `bound`, at most 2^16; `opaque` is the same number."""
        import drjit

        if bound & (bound - 1) == 0:
            return self.take(bound.bit_length() - 1)
        return drjit.mul_hi(self.take(32), opaque)


class _Sets:
    """The sets of one rule: shared numbers, in tables unless they are a net, and a mask."""

    def __init__(self, module: Any, rule: Rule, count: int, stream: Stream, rounds: int) -> None:
        self._module, self._rule, self._count, self._rounds = module, rule, count, rounds
        self._tables: list[Any] = []
        self._net = rule.shared if isinstance(rule.shared, Net) else None
        self._mask: _Mask | None = None
        cells = rule.cells or ()
        self.one_cell = rule.shared is None and cells == (1,) * rule.dims
        if rule.shared is None and any(s & (s - 1) for s in cells):
            grid = np.indices(cells).reshape(rule.dims, -1)
            corners = (((k << 32) + s - 1) // s for k, s in zip(grid, cells, strict=True))
            self._tables = [module.UInt32(c.astype(np.uint32)) for c in corners]
        elif self._net is None and rule.shared is not None:
            draw: Any = rule.shared
            self._tables = _columns(module, draw(stream))
        if rule.mask is not None:
            self._mask = _Mask(module, rule.mask, rule.dims, stream.child(rule.mask_label))

    def at(self, pixel: Any) -> _Sets:
        """Return these sets for lanes at other pixels."""
        lanes = copy(self)
        if self._mask is not None:
            lanes._mask = self._mask.at(pixel)
        return lanes

    def moves(self, bits: _Bits, address: Any) -> list[list[Any]]:
        """Return the random numbers that move each coordinate of a set."""
        rule, module, dims = self._rule, self._module, self._rule.dims
        if rule.move == "none":
            return [[] for _ in range(dims)]
        if self._mask is not None:
            return [[shift] for shift in self._mask.shifts(bits, address)]
        digits = [s.bit_length() - 1 for s in rule.cells or (1 << _DIGITS,) * dims]
        if rule.move == "owen":
            # The first digits of a hash depend only on as many bits of the summand and the factor
            return [
                [(bits.take(m), (bits.take(max(m - 1, 0)) << 1) | 1) for _ in range(self._rounds)]
                for m in digits
            ]
        return [[bits.take(m) << (32 - m) if m else module.UInt32(0)] for m in digits]

    def points(self, place: Any, moves: list[list[Any]], own: _Bits, dims: int) -> list[Any]:
        """Return the first `dims` coordinates of the points at the given places of moved sets."""
        import drjit

        rule, module, found = self._rule, self._module, []
        reversed_digits = self._net is not None
        for j, x in enumerate(self._shared(place)[:dims]):
            if rule.move == "owen":
                word = x if reversed_digits else drjit.brev(x)
                x = drjit.brev(_hashed(word, *moves[j]))
            elif reversed_digits:
                x = drjit.brev(x)
            if rule.move == "shift":
                x = x + moves[j][0]
            elif rule.move == "digital-shift":
                x = x ^ moves[j][0]
            if rule.cells is not None:
                x = _in_cell(module, x, rule.cells[j], own)
            found.append(_unit(module, x))
        return found

    def _shared(self, place: Any) -> list[Any]:
        """Return the shared numbers of a place; the digits of nets are in reversed order."""
        import drjit

        rule, module = self._rule, self._module
        if self._net is not None:
            return net_words(module, self._net, self._count, place)
        if self._tables:
            return [drjit.gather(module.UInt32, table, place) for table in self._tables]
        # The digits of a place are those of the cell's number along each axis, in row-major order
        assert rule.cells is not None
        corners, above = [], 0
        rest = place << (32 - self._count.bit_length() + 1) if self._count > 1 else place
        for cells in rule.cells:
            digits = cells.bit_length() - 1
            corners.append((rest << above) & (2**32 - 2 ** (32 - digits)))
            above += digits
        return corners


class _Mask:
    """Shifts of pixels by a mask of ``decorrelate``, at a random place for each request.

    In each dim, the mask starts at its own place, which is the same for all requests.
    A request moves the masks of all dims together.
    Without this move, all requests of a pixel would have nearly the same shift if the number of
    pixels is a multiple of the mask's; images of integrands of two requests would be biased.
    """

    _cell: list[Any]
    _added: list[Any]

    def __init__(self, module: Any, step: Decorrelate, dims: int, stream: Stream) -> None:
        import drjit

        self._module, self._step, self._dims = module, step, dims
        keys = stream.child(1).keys(0, 1)[0]
        self._keys = _words(module, drjit.opaque(module.UInt64, int(keys[0])))
        self._tables: list[Any] = []
        if step.mask != "r2":
            ranks = step.ranks(stream, dims).reshape(dims, -1)
            self._size = ranks.shape[1]
            # The table holds the lower corners of the cells, one cell for each rank
            corners = ((ranks.astype(np.uint64) << np.uint64(32)) + self._size - 1) // self._size
            self._tables = [module.UInt32(np.ascontiguousarray(c, np.uint32)) for c in corners]

    def at(self, pixel: Any) -> _Mask:
        """Return the mask for lanes at other pixels."""
        import drjit

        lanes, module, step, width = copy(self), self._module, self._step, self._step.width

        def golden(number: Any, dims: int) -> list[Any]:
            steps = (module.UInt64(number) * int(each) for each in golden_steps(dims))
            return [module.UInt32(each >> 32) for each in steps]

        lanes._added = []
        if step.mask == "r2":
            lanes._added = golden(pixel, self._dims)
            return lanes
        frame = pixel // (width * width)
        place = pixel - frame * (width * width)
        row = place // width
        column = place - row * width
        if step.time == "golden":
            lanes._added = golden(frame, self._dims)
        elif step.time == "move":
            across, down = (drjit.mul_hi(u, module.UInt32(width)) for u in golden(frame, 2))
            column, row = _wrapped(column + across, width), _wrapped(row + down, width)
        lanes._cell = [frame % (self._size // (width * width)), row, column]
        return lanes

    def shifts(self, bits: _Bits, address: Any) -> list[Any]:
        """Return the shift of each dim, from the mask at its place for a request.

        Random bits of the set place the shift in the interval of its rank.
        """
        import drjit

        module, width = self._module, self._step.width
        place = _Bits(module, self._keys, address)
        if not self._tables:
            return [added + place.take(32) for added in self._added]
        index = module.UInt32(0)
        for each, side in zip(self._cell, (self._size // width**2, width, width), strict=True):
            start = place.below(side, module.UInt32(side))
            index = index * side + _wrapped(each + start, side)
        found = []
        for table in self._tables:
            corner = drjit.gather(module.UInt32, table, index)
            found.append(_in_cell(module, corner, self._size, bits))
        return [x + y for x, y in zip(found, self._added or [0] * self._dims, strict=True)]


def _wrapped(number: Any, side: int) -> Any:
    """Return a number below 2·side modulo `side`."""
    import drjit

    if side & (side - 1) == 0:
        return number & (side - 1)
    return drjit.select(number >= side, number - side, number)


def _columns(module: Any, points: Array) -> list[Any]:
    """Return the coordinates of points (n, d) as tables of binary fractions of 32 bits."""
    words = np.ldexp(points, 32).astype(np.uint64).astype(np.uint32)
    return [module.UInt32(np.ascontiguousarray(column)) for column in words.T]


def _in_cell(module: Any, x: Any, cells: int, own: _Bits) -> Any:
    """Return a random number of the cell that contains x; `cells` cells have equal sides."""
    import drjit

    if cells & (cells - 1) == 0:
        m = cells.bit_length() - 1
        jitter = own.take(_DIGITS - m) << (32 - _DIGITS)
        return (x & (2**32 - 2 ** (32 - m))) | jitter if m else jitter
    # The given x is the lower corner. Rounding down must not move the point to the cell below
    y = x + drjit.mul_hi(own.take(32), module.UInt32(2**32 // cells))
    lost = 2 ** (32 - _DIGITS) - 1
    return drjit.maximum(y, x + lost)


@final
@dataclass(frozen=True)
class Rounds:
    """Assigns sets to requests: the number of the set is (pixel + request · stride) mod size.

    The stride is relatively prime to the size.
    The first `size` requests of a pixel therefore use different sets.
    If the sets have the shifts of a mask, the stride is far from multiples of the mask.
    """

    size: int
    stride: int

    @staticmethod
    def of(pixels: int, requests: int, numbers_each: int, *, independent: bool = True) -> Rounds:
        """Choose the number of sets and the stride for the first `requests` requests of a pixel.

        The memory of the table limits the number of sets.
        """
        size = max(_FEWEST_SETS, pixels * requests + 1)
        size = min(size, _MOST_NUMBERS // numbers_each)
        golden = int(size * _GOLDEN)
        first = (pixels,) if independent else ()
        strides = (s for s in (*first, *range(golden, size)) if s < size and gcd(s, size) == 1)
        return Rounds(size, next(strides, 1))


class _Lanes:
    """Sets whose points are computed for lanes: each lane has a pixel and the index of a sample.

    The keys of lanes are mixed before the loop over the bounces of a path.
    The key of a set depends on the pixel. The key of a point also depends on its index.
    """

    _pixel: Any
    _index: Any
    _set_keys: tuple[Any, Any]
    _point_keys: tuple[Any, Any]

    def __init__(self, module: Any, stream: Stream) -> None:
        import drjit

        self._module = module
        self._keys = [drjit.opaque(module.UInt64, int(k)) for k in stream.keys(0, 1)[0]]

    def at(self, pixel: Any, index: Any) -> Any:
        """Return these sets for lanes with other pixels or indices."""
        module, (k0, k1) = self._module, self._keys
        lanes, wide = copy(self), module.UInt64
        lanes._pixel, lanes._index = pixel, index
        point = ((wide(pixel) + 1) << 32) | wide(index)
        lanes._set_keys = _words(module, mix_bits(module, k0, k1, wide(pixel)))
        lanes._point_keys = _words(module, mix_bits(module, k0, k1, point))
        return lanes


class Pads(_Lanes):
    """Sets of n points in one and two dims, in random orders, computed one by one.

    The order of a set is v(i + a) + b modulo n, where v is one of many random permutations.
    The permutation and the numbers a and b are random bits of the set.
    The permutations are rows of a table, which is the same in every process.
    If n is a power of two, an XOR replaces each addition.
    In the order of one set, each place of another set follows with the probability 1/n.
    Images are therefore unbiased for any table of permutations.
    """

    def __init__(self, module: Any, rules: Sequence[Rule], count: int, stream: Stream) -> None:
        import drjit

        super().__init__(module, stream)
        self._count, self._sets = count, {}
        for k, rule in enumerate(rules, 1):
            points = stream.child(k).child(0)
            self._sets[k] = _Sets(module, rule, count, points, rounds=1)
        orders = _orders(count)
        self._rows, self._orders = len(orders), module.UInt32(orders.ravel())
        self._opaque = drjit.opaque(module.UInt32, count)

    def at(self, pixel: Any, index: Any) -> Pads:
        """Return these sets for lanes with other pixels or indices."""
        lanes: Pads = super().at(pixel, index)
        lanes._sets = {k: sets.at(pixel) for k, sets in self._sets.items()}
        return lanes

    def following(self, address: Any) -> Any:
        """Return the address of the random bits of the next request."""
        return address + 2 * _WORDS * _WORD % 2**32

    def draw(self, dims: int, _: Any, address: Any, __: Any, ___: Any = True) -> list[Any]:
        """Return the coordinates of each lane's point in the 1-D or 2-D set of a request."""
        module, sets = self._module, self._sets[dims]
        address = module.UInt32(address) + (dims - 1) * _WORDS * _WORD % 2**32
        bits = _Bits(module, self._set_keys, address)
        own = _Bits(module, self._point_keys, address)
        moves = sets.moves(bits, address)
        place = module.UInt32(0) if sets.one_cell else self._place(bits)
        return sets.points(place, moves, own, dims)

    def _place(self, bits: _Bits) -> Any:
        """Return the place of each lane's point in the random order of its set."""
        import drjit

        n, gather = self._count, drjit.gather
        word, table, rows = self._module.UInt32, self._orders, self._rows.bit_length() - 1
        if n & (n - 1) == 0:
            # Small pieces fit into bits that the moves of the set have left
            digits = n.bit_length() - 1
            row, first, last = (bits.take(k) for k in (rows, digits, digits))
            return gather(word, table, (row << digits) ^ first ^ self._index) ^ last
        row = bits.take(rows) * self._opaque
        first, last = (bits.below(n, self._opaque) for _ in range(2))
        return self._sum(gather(word, table, row + self._sum(self._index, first)), last)

    def _sum(self, a: Any, b: Any) -> Any:
        """Return the sum of two places modulo n."""
        import drjit

        both = a + b
        return drjit.select(both >= self._opaque, both - self._opaque, both)


class JointSets(_Lanes):
    """Sets in several dims, one set per pixel, in the order of the sampler."""

    def __init__(self, module: Any, rule: Rule, count: int, stream: Stream) -> None:
        super().__init__(module, stream.child(3))
        self.dims = rule.dims
        self._sets = _Sets(module, rule, count, stream.child(3).child(0), rounds=2)

    def at(self, pixel: Any, index: Any) -> JointPoints:
        """Return the points `index` of the sets of pixels, with all their coordinates."""
        lanes, zero = super().at(pixel, index), self._module.UInt32(0)
        bits = _Bits(self._module, lanes._set_keys, zero)
        own = _Bits(self._module, lanes._point_keys, zero)
        sets = self._sets.at(pixel)
        return JointPoints(self, sets.points(index, sets.moves(bits, zero), own, self.dims))


class JointPoints:
    """One point for each lane, whose coordinates serve all bounces of a path.

    The coordinates are computed before the loop over the bounces of a path.
    Inside this loop, each request for a random number would compute all coordinates again.
    """

    def __init__(self, sets: JointSets, coordinates: list[Any]) -> None:
        self.dims, self._sets, self._made = sets.dims, sets, coordinates

    def at(self, pixel: Any, index: Any) -> JointPoints:
        """Return points of the same joint sets with other indices, or at other pixels."""
        return self._sets.at(pixel, index)

    def draw(self, dims: int, _: Any, start: Any, __: Any, ___: Any = True) -> list[Any]:
        """Return `dims` coordinates of the points, starting at `start`."""
        import drjit

        made = self._made
        # In a recorded loop, the index `start` of the first coordinate is known only at run time.
        # Select the requested coordinates among all of them
        found = []
        for k in range(dims):
            value = made[k]
            for j in range(k + 1, len(made)):
                value = drjit.select(start == j - k, made[j], value)
            found.append(value)
        return found


@functools.lru_cache(maxsize=4)
def _orders(count: int) -> Array:
    """Random permutations of `count` numbers: uint32 (T, count), where T is a power of two."""
    sets = 1 << (max(_FEWEST_ORDERS, _ORDER_NUMBERS // count).bit_length() - 1)
    numbers = np.broadcast_to(np.arange(count, dtype=np.uint32), (sets, count))
    return np.asarray(Stream(0).generator(0).permuted(numbers, axis=1))
