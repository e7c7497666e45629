"""Scrambled digital nets in base 2, computed in Dr.Jit's kernels instead of drawn as tables.

Method
------
Coordinate j of point i: XOR those columns of generator matrix j that the bits of i select.
Nested uniform scrambling is computed by the hash of ``owen(method='hash')``.
The class `NetPoints` computes the points of the sampler from its keys, rounded to float32.
Renderers request one or two numbers at a time and need point sets in a random order.
Sets for requests of one or two numbers (`Pads`) are scrambled by one round of the hash function.
Each scramble takes 63 random bits, and the order of the points is random.
Nets with ``digital-shift(jitter=True)`` are shifted instead, by m random bits per coordinate.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, final, runtime_checkable

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.streams import Stream
from mcspectra.samplers import Sampler
from mcspectra.samplers.base import Randomized
from mcspectra.samplers.scrambles import DigitalShift, Owen

__all__ = [
    "JointPoints",
    "JointSets",
    "Net",
    "NetPoints",
    "Pads",
    "net_of",
    "scramble_key",
    "shifted_net_of",
]

# The table of permutations has at least this many numbers, which take 256 KiB.
# The table is larger if 16 permutations, the smallest number allowed, do not fit
_ORDER_NUMBERS = 2**16
_FEWEST_ORDERS = 16
_FIRST_STEP = 1 << 16  # label of the random stream of a sampler's first randomization
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
    return stream.child(_FIRST_STEP).key


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
    """Return the number in [0,1) whose bits are reversed in `word`: its lowest bit stands for ½."""
    import drjit

    return module.Float(drjit.brev(word) >> 8) * 2.0**-24


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
            return [_unit(module, _hashed(w, *k)) for w, k in zip(words, keys, strict=True)]

        return points


def _hashed(x: Any, *keys: tuple[Any, Any]) -> Any:
    """Scramble a number in one or two rounds. Each bit depends only on lower bits, as in `Owen`."""
    x = x ^ (x * 0x3D20ADEA)
    x = (x + keys[0][0]) * keys[0][1]
    x ^= x * 0x05526C56
    for summand, factor in keys[1:]:
        x = (x + summand) * factor
    return x ^ (x * 0x53A22864)


def _shifted(module: Any, word: Any, key: Any, index: Any, last: int) -> Any:
    """Shift the first m digits of a word by a random key; random digits of each point follow."""
    own = module.UInt32(mix_bits(module, key, ~key, index) >> 16)
    return ((word ^ module.UInt32(key >> 32)) & last) | (own & module.UInt32(0xFFFFFFFF ^ last))


class Pads:
    """Sets of 2^m net points in one and two dims, in random orders, computed one by one.

    Each order is a row of a table of random permutations, which is the same in every process.
    Random numbers shift the argument of a permutation, and are combined with its values by XOR.
    Sets are scrambled independently, so images are unbiased for any table of permutations.
    """

    def __init__(
        self,
        module: Any,
        nets: tuple[Net, Net],
        count: int,
        stream: Stream,
        *,
        shifted: bool = False,
    ) -> None:
        import drjit

        self._module, self._nets, self._count, self._shifted = module, nets, count, shifted
        self._key = [drjit.opaque(module.UInt64, int(k)) for k in stream.keys(0, 1)[0]]
        orders = _orders(count)
        self._orders, self._last = module.UInt32(orders.ravel()), len(orders) - 1

    def following(self, request: Any) -> Any:
        """Return the number of the next request for random numbers."""
        return request + 1

    def draw(self, dims: int, pixel: Any, request: Any, index: Any, _: Any = True) -> list[Any]:
        """Return point `index` of the 1-D or 2-D set that answers a request at a pixel."""
        import drjit

        module, (k0, k1) = self._module, self._key
        wide, last, net = module.UInt64, self._count - 1, self._nets[dims - 1]
        address = (wide(pixel) << 32) | wide((2 * request + dims - 1) << 2)
        bits = mix_bits(module, k0, k1, address)
        low, high = module.UInt32(bits), module.UInt32(bits >> 32)
        row = (high & self._last) * self._count
        place = drjit.gather(module.UInt32, self._orders, row + ((index + low) & last))
        words = net_words(module, net, self._count, place ^ ((low >> 16) & last))
        keys = [mix_bits(module, k0, k1, address + 1 + j) for j in range(len(words))]
        if self._shifted:
            both = zip(words[:dims], keys, strict=False)
            return [_unit(module, _shifted(module, w, k, index, last)) for w, k in both]
        halves = (_halves(module, key) for key in keys)
        made = [_unit(module, _hashed(w, h)) for w, h in zip(words, halves, strict=True)]
        return made[:dims]


class JointSets:
    """Sets of randomized net points in several dims, one set per pixel, in the order of the net.

    With `shifted`, the points are shifted with jitter instead of scrambled.
    """

    def __init__(
        self, module: Any, net: Net, count: int, stream: Stream, *, shifted: bool = False
    ) -> None:
        import drjit

        self.dims, self._module, self._net, self._count = net.dims, module, net, count
        self._shifted = shifted
        keys = stream.child(3).keys(0, 1)[0]
        self._key = [drjit.opaque(module.UInt64, int(k)) for k in keys]

    def at(self, pixel: Any, index: Any) -> JointPoints:
        """Return the points `index` of the sets of pixels, with all their coordinates."""
        module, (k0, k1) = self._module, self._key
        address = module.UInt64(pixel) << 32
        made = []
        for j, word in enumerate(net_words(module, self._net, self._count, index)):
            if self._shifted:
                key = mix_bits(module, k0, k1, address + 2 * j)
                made.append(_unit(module, _shifted(module, word, key, index, self._count - 1)))
                continue
            both = [mix_bits(module, k0, k1, address + 2 * j + part) for part in (0, 1)]
            made.append(_unit(module, _hashed(word, *(_halves(module, key) for key in both))))
        return JointPoints(self, made)


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
    sets = max(_FEWEST_ORDERS, _ORDER_NUMBERS // count)
    numbers = np.broadcast_to(np.arange(count, dtype=np.uint32), (sets, count))
    return np.asarray(Stream(0).generator(0).permuted(numbers, axis=1))
