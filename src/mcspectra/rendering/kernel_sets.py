"""Point sets computed in Dr.Jit's kernels instead of drawn as tables.

Method
------
A `Rule` describes the sets of a sampler. Three steps make a coordinate of a point:

1. All sets share one number for each place of a set: a coordinate of a net or of a drawn set,
   or the lower corner of a cell.
2. The set moves its numbers: by a shift modulo 1, by an XOR of their binary digits,
   or by a hash that scrambles digits like ``owen(method='hash')``.
   A mask or random bits give the shift. The hash takes 47 random bits in each round.
3. Random bits of the point place it in the cell that its moved number belongs to.

Random points have one cell. Jittered points have n cells, and no set moves them.
A net with ``digital-shift(jitter=True)`` is moved by XOR and placed in cells of side 2^-m.
``decorrelate`` moves a drawn set, and has no cells.
Coordinate j of point i of a net: XOR those columns of generator matrix j that the bits of i select.

Numbers are 32 bits of a binary fraction (`straight`), or the same bits in reversed order.
Points are rounded down to multiples of 2^-24, which are exact in float32.

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
from mcspectra.core.parallel import available_workers, map_in_order
from mcspectra.core.streams import Stream
from mcspectra.samplers import Sampler
from mcspectra.samplers.base import FIRST_STEP, Randomized
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
_BLOCK_SETS = 2**14  # number of sets whose shifts are drawn at once, by one of several threads
_DIGITS = 24  # binary digits of the numbers in float32
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
        not jittered. After a digital shift, the numbers of cells must be powers of two.
    offsets
        Function that returns the shifts (count, dims) of sets first … first + count − 1.
        Its arguments are the random stream of the sets, first, and count.
        If None, each set has its own random bits.
    """

    dims: int
    shared: Net | Callable[[Stream], Array] | None = None
    move: Move = "none"
    cells: tuple[int, ...] | None = None
    offsets: Callable[[Stream, int, int], Array] | None = None


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
        return Rule(dims=dims, shared=net, move="owen")
    if (net := shifted_net_of(sampler)) is not None:
        cells = (1 << (n - 1).bit_length(),) * dims
        return Rule(dims=dims, shared=net, move="digital-shift", cells=cells)
    return _rule_of_law(sampler.law(n))


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
    label = FIRST_STEP + inner.plain.scrambles + len(before)

    def shared(stream: Stream) -> Array:
        return np.asarray(inner.draw_stream(n, stream, 0, 1)[0])

    def offsets(stream: Stream, first: int, count: int) -> Array:
        return step.offsets(stream.child(label), first, count, inner.dims)

    white = step.mask == "white"
    move: Any = step.mode
    return Rule(dims=inner.dims, shared=shared, move=move, offsets=None if white else offsets)


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


class _Bits:
    """Random bits of a set or of a point, taken in pieces of at most 32 bits.

    Numbers of 64 random bits are mixed only when the bits of earlier numbers do not suffice.
    """

    def __init__(self, module: Any, keys: tuple[Any, Any], address: Any) -> None:
        self._module, self._keys, self._address = module, keys, address
        self._numbers: list[tuple[Any, int]] = []  # random numbers, and how many bits are used

    def take(self, count: int) -> Any:
        """Return `count` random bits as a UInt32 number."""
        if count == 0:
            return self._module.UInt32(0)
        free = (k for k, (_, used) in enumerate(self._numbers) if used + count <= 64)
        place = next(free, len(self._numbers))
        if place == len(self._numbers):
            bits = mix_bits(self._module, *self._keys, self._address + place)
            self._numbers.append((bits, 0))
        bits, used = self._numbers[place]
        self._numbers[place] = bits, used + count
        return self._module.UInt32(bits >> used) & (2**count - 1)

    def below(self, bound: int, opaque: Any) -> Any:
        """Return a random whole number below `bound`, at most 2^16; `opaque` is the same number."""
        import drjit

        if bound & (bound - 1) == 0:
            return self.take(bound.bit_length() - 1)
        return drjit.mul_hi(self.take(32), opaque)


class _Sets:
    """The sets of one rule: shared numbers, and shifts of the first `size` sets, in tables."""

    def __init__(
        self, module: Any, rule: Rule, count: int, stream: Stream, size: int, rounds: int
    ) -> None:
        self._module, self._rule, self._count, self._rounds = module, rule, count, rounds
        self._tables: list[Any] = []
        self._offsets: list[Any] = []
        cells = rule.cells or ()
        self.one_cell = rule.shared is None and cells == (1,) * rule.dims
        if rule.shared is None and any(s & (s - 1) for s in cells):
            grid = np.indices(cells).reshape(rule.dims, -1)
            corners = (((k << 32) + s - 1) // s for k, s in zip(grid, cells, strict=True))
            self._tables = [module.UInt32(c.astype(np.uint32)) for c in corners]
        elif rule.shared is not None and not isinstance(rule.shared, Net):
            self._tables = _columns(module, rule.shared(stream))
        if rule.offsets is not None:
            block = functools.partial(_offsets, rule.offsets, stream, size)
            parts = map_in_order(block, range(0, size, _BLOCK_SETS), available_workers())
            self._offsets = _columns(module, np.concatenate(list(parts)))

    def moves(self, bits: _Bits, number: Any) -> list[list[Any]]:
        """Return the random numbers that move each coordinate of a set."""
        import drjit

        rule, module, dims = self._rule, self._module, self._rule.dims
        if rule.move == "none":
            return [[] for _ in range(dims)]
        if rule.offsets is not None:
            return [[drjit.gather(module.UInt32, table, number)] for table in self._offsets]
        if rule.move == "owen":
            # The first digits of a hash depend only on as many bits of the summand and the factor
            count = self._rounds * dims
            rounds = [(bits.take(_DIGITS), (bits.take(_DIGITS - 1) << 1) | 1) for _ in range(count)]
            return [rounds[j::dims] for j in range(dims)]
        cells = rule.cells or (1 << _DIGITS,) * dims
        digits = [s.bit_length() - 1 for s in cells]
        return [[bits.take(m) << (32 - m) if m else module.UInt32(0)] for m in digits]

    def points(self, place: Any, moves: list[list[Any]], own: _Bits, dims: int) -> list[Any]:
        """Return the first `dims` coordinates of the points at the given places of moved sets."""
        import drjit

        rule, module, found = self._rule, self._module, []
        reversed_digits = isinstance(rule.shared, Net)
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
        if isinstance(rule.shared, Net):
            return net_words(module, rule.shared, self._count, place)
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


def _offsets(
    draw: Callable[[Stream, int, int], Array], stream: Stream, size: int, first: int
) -> Array:
    """Return the shifts of a block of sets."""
    return draw(stream, first, min(_BLOCK_SETS, size - first))


def _columns(module: Any, points: Array) -> list[Any]:
    """Return the coordinates of points (n, d) as tables of binary fractions of 32 bits."""
    words = np.ldexp(points, 32).astype(np.uint64).astype(np.uint32)
    return [module.UInt32(np.ascontiguousarray(column)) for column in words.T]


def _in_cell(module: Any, x: Any, cells: int, own: _Bits) -> Any:
    """Return a random number of the cell that contains x; `cells` cells have equal sides."""
    import drjit

    if cells & (cells - 1) == 0:
        m = cells.bit_length() - 1
        jitter = own.take(32) >> m
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
    """

    size: int
    stride: int

    @staticmethod
    def of(pixels: int, requests: int, numbers_each: int) -> Rounds:
        """Choose the number of sets and the stride for the first `requests` requests of a pixel.

        The memory of the table limits the number of sets.
        """
        size = max(_FEWEST_SETS, pixels * requests + 1)
        size = min(size, _MOST_NUMBERS // numbers_each)
        golden = int(size * _GOLDEN)
        strides = (s for s in (pixels, *range(golden, size)) if s < size and gcd(s, size) == 1)
        return Rounds(size, next(strides, 1))


class _Lanes:
    """Sets whose points are computed for lanes: each lane has a pixel and the index of a sample.

    The keys of lanes are mixed before the loop over the bounces of a path.
    The key of a set depends on the pixel. The key of a point also depends on its index.
    """

    _pixel: Any
    _index: Any
    _set_key: Any
    _point_key: Any

    def __init__(self, module: Any, stream: Stream) -> None:
        import drjit

        self._module = module
        self._keys = [drjit.opaque(module.UInt64, int(k)) for k in stream.keys(0, 1)[0]]

    def at(self, pixel: Any, index: Any) -> Any:
        """Return these sets for lanes with other pixels or indices."""
        module, (k0, k1) = self._module, self._keys
        lanes, wide = copy(self), module.UInt64
        lanes._pixel, lanes._index = pixel, index
        lanes._set_key = mix_bits(module, k0, k1, wide(pixel))
        lanes._point_key = mix_bits(module, k0, k1, ((wide(pixel) + 1) << 32) | wide(index))
        return lanes


class Pads(_Lanes):
    """Sets of n points in one and two dims, in random orders, computed one by one.

    The order of a set is v(i + a) + b modulo n, where v is one of many random permutations.
    The permutation and the numbers a and b are random bits of the set.
    The permutations are rows of a table, which is the same in every process.
    If n is a power of two, an XOR replaces the second addition.
    In the order of one set, each place of another set follows with the probability 1/n.
    Images are therefore unbiased for any table of permutations.

    If a mask moves the sets, `Rounds` assigns the sets of the mask to requests.
    """

    _first: Any

    def __init__(
        self, module: Any, rules: Sequence[Rule], count: int, stream: Stream, rounds: Rounds
    ) -> None:
        import drjit

        super().__init__(module, stream)
        self._count, self._sets = count, {}
        for k, rule in enumerate(rules, 1):
            points = stream.child(k).child(0)
            self._sets[k] = _Sets(module, rule, count, points, rounds.size, rounds=1)
        orders = _orders(count)
        self._rows, self._orders = len(orders), module.UInt32(orders.ravel())
        self._opaque = drjit.opaque(module.UInt32, count)
        self._rounds: Any = None
        if any(rule.offsets is not None for rule in rules):
            self._rounds = [drjit.opaque(module.UInt32, k) for k in (rounds.size, rounds.stride)]

    def at(self, pixel: Any, index: Any) -> Pads:
        """Return these sets for lanes with other pixels or indices."""
        lanes: Pads = super().at(pixel, index)
        if lanes._rounds is not None:
            lanes._first = pixel % lanes._rounds[0]
        return lanes

    def following(self, request: Any) -> Any:
        """Return the number of the next request; with masks, the offset of its set."""
        return request + 1 if self._rounds is None else self._in_round(request + self._rounds[1])

    def draw(self, dims: int, _: Any, request: Any, __: Any, ___: Any = True) -> list[Any]:
        """Return the coordinates of each lane's point in the 1-D or 2-D set of a request."""
        module, sets = self._module, self._sets[dims]
        # A set and a point need at most 4 numbers of 64 random bits each
        address = (2 * module.UInt32(request) + (dims - 1)) << 2
        bits = _Bits(module, (self._set_key, self._keys[1]), address)
        own = _Bits(module, (self._point_key, self._keys[1]), address)
        number = None
        if self._rounds is not None:
            number = self._in_round(self._first + request)
        moves = sets.moves(bits, number)
        place = module.UInt32(0) if sets.one_cell else self._place(bits)
        return sets.points(place, moves, own, dims)

    def _in_round(self, number: Any) -> Any:
        import drjit

        size = self._rounds[0]
        return drjit.select(number >= size, number - size, number)

    def _place(self, bits: _Bits) -> Any:
        """Return the place of each lane's point in the random order of its set."""
        import drjit

        n = self._count
        row = bits.take(self._rows.bit_length() - 1) * self._opaque
        first, last = (bits.below(n, self._opaque) for _ in range(2))
        powers = n & (n - 1) == 0
        column = (self._index + first) & (n - 1) if powers else self._sum(self._index, first)
        place = drjit.gather(self._module.UInt32, self._orders, row + column)
        return place ^ last if powers else self._sum(place, last)

    def _sum(self, a: Any, b: Any) -> Any:
        """Return the sum of two places modulo n."""
        import drjit

        both = a + b
        return drjit.select(both >= self._opaque, both - self._opaque, both)


class JointSets(_Lanes):
    """Sets in several dims, one set per pixel, in the order of the sampler."""

    def __init__(self, module: Any, rule: Rule, count: int, stream: Stream, pixels: int) -> None:
        super().__init__(module, stream.child(3))
        self.dims = rule.dims
        self._sets = _Sets(module, rule, count, stream.child(3).child(0), pixels, rounds=2)

    def at(self, pixel: Any, index: Any) -> JointPoints:
        """Return the points `index` of the sets of pixels, with all their coordinates."""
        lanes, module = super().at(pixel, index), self._module
        bits = _Bits(module, (lanes._set_key, self._keys[1]), module.UInt32(0))
        own = _Bits(module, (lanes._point_key, self._keys[1]), module.UInt32(0))
        moves = self._sets.moves(bits, pixel)
        return JointPoints(self, self._sets.points(index, moves, own, self.dims))


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
