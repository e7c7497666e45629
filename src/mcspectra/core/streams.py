"""Counter-based random streams: direct access to any number of any realization.

Method
------
A *stream* has a 64-bit key. `Stream.from_rng` makes a stream from a user's seed.
The seed is an integer, a NumPy generator, a `SeedSequence` or None (SPEC 7).
`Stream.child` derives independent streams for parts of a sampler, such as points and shift.

For realization r, Philox4x32-10 maps the key of the stream and r to a new key [Salmon2011]_.
Philox is a bijection of its 128-bit counter.
Therefore different realizations of one stream always have *different* 128-bit keys (k0, k1).
Number i of a realization is a 64-bit mix of i with these keys,

    x = (i xor k0) M1;  x ^= x >> 32;  x = (x + k1) M2;  x ^= x >> 29;  x *= M3;  x ^= x >> 32

The multipliers M1, M2 and M3 are those of SplitMix64 [Steele2014]_.
The key k0 enters before the first nonlinear step, and k1 enters after this step.
Therefore a stream is a shifted or permuted copy of another only if both have the same k1.

Philox alone would be enough, but with 7 rounds it takes 1.8 ns per double.
The mix takes 1.3 ns, and NumPy's PCG64 takes 3.7 ns (one core, AVX-512, 2^17 doubles).
`tests/core/test_streams.py` tests moments, χ² and serial correlation.
Other tests of the file count equal numbers across realizations, indices and seeds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.display import shown
from mcspectra.core.errors import ParameterError
from mcspectra.core.jit import kernel

__all__ = ["RngLike", "Stream", "golden_vector", "mix_bits", "mix_uniform", "uniforms"]

# Largest size of a seed in bits. Such a seed has 1234 digits, and Python prints at most 4300
_SEED_BITS = 4096

RngLike: TypeAlias = "int | np.random.Generator | np.random.SeedSequence | None"

_M1 = np.uint64(0x9E3779B97F4A7C15)
_M2 = np.uint64(0xBF58476D1CE4E5B9)
_M3 = np.uint64(0x94D049BB133111EB)
_S11, _S29, _S32 = np.uint64(11), np.uint64(29), np.uint64(32)
_LOW32 = np.uint64(0xFFFFFFFF)
_UNIT = 2.0**-53


@kernel
def mix_bits(k0: np.uint64, k1: np.uint64, i: int) -> np.uint64:
    """Return 64 random bits: number `i` of the realization with the keys (k0, k1)."""
    x = (np.uint64(i) ^ k0) * _M1
    x ^= x >> _S32
    x = (x + k1) * _M2
    x ^= x >> _S29
    x *= _M3
    x ^= x >> _S32
    return x


@kernel
def mix_uniform(k0: np.uint64, k1: np.uint64, i: int) -> float:
    """Return number `i` of the realization with the keys (k0, k1): uniform in [0,1), 53 bits."""
    return np.float64(mix_bits(k0, k1, i) >> _S11) * _UNIT


@kernel
def _fill_uniforms(keys: Array, out: Array) -> None:
    # shapes: keys is (R, 2), and out is (R, size)
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        row = out[r]
        for i in range(row.size):
            row[i] = mix_uniform(k0, k1, i)


@kernel
def _philox4x32(key: Any, c0: Any, c1: Any, c2: Any, c3: Any) -> tuple[np.uint64, np.uint64]:
    # Ten rounds of Philox4x32 [Salmon2011]. The result is the 128-bit block, as two 64-bit words
    m0, m1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
    w0, w1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
    a, b, c, d = np.uint64(c0), np.uint64(c1), np.uint64(c2), np.uint64(c3)
    k0, k1 = key & _LOW32, key >> _S32
    for _ in range(10):
        p, q = m0 * a, m1 * c
        a, b, c, d = (q >> _S32) ^ b ^ k0, q & _LOW32, (p >> _S32) ^ d ^ k1, p & _LOW32
        k0, k1 = (k0 + w0) & _LOW32, (k1 + w1) & _LOW32
    return (a << _S32) | b, (c << _S32) | d


@kernel
def _fill_keys(key: np.uint64, first: int, out: Array) -> None:
    for r in range(out.shape[0]):
        i = np.uint64(first + r)
        out[r, 0], out[r, 1] = _philox4x32(key, i & _LOW32, i >> _S32, 0, 0)


def golden_vector(dims: int) -> Array:
    """Return steps (d,) of an additive recurrence whose points fill the cube evenly [Roberts2018]_.

    The points are k·α modulo 1, where α_j = g^−j and g is the root of g^(d+1) = g + 1.
    """
    root = 1.5
    for _ in range(64):  # each iteration at least halves the error of the root
        root = (1.0 + root) ** (1.0 / (dims + 1))
    return np.asarray(root ** -np.arange(1.0, dims + 1))


def uniforms(keys: Array, size: int) -> Array:
    """Return the first `size` uniform numbers of realizations with keys (R, 2): (R, size)."""
    out = np.empty((len(keys), size))
    _fill_uniforms(keys, out)
    return out


@dataclass(frozen=True)
class Stream:
    """A source of random numbers with direct access: one 64-bit key for all realizations.

    Attributes
    ----------
    key
        64-bit key. Streams with different keys are independent.
    """

    key: int

    @staticmethod
    def from_rng(rng: RngLike = None) -> Stream:
        """Make a stream from a seed, as defined in SPEC 7.

        An integer or `SeedSequence` always gives the same stream, and None uses fresh entropy.
        A `Generator` is advanced by one draw of 64 bits.

        Raises
        ------
        ParameterError
            If `rng` has another type, or is a negative integer, or one of more than 4096 bits.
        """
        if isinstance(rng, np.random.Generator):
            return Stream(int(rng.integers(0, 2**64, dtype=np.uint64)))
        if isinstance(rng, int) and rng.bit_length() > _SEED_BITS:
            raise ParameterError(f"rng is {shown(rng)}; give a seed of at most {_SEED_BITS} bits.")
        if isinstance(rng, int | np.integer) and not isinstance(rng, bool):
            rng = np.random.SeedSequence(as_integer("rng", rng, least=0))
        elif rng is None:
            rng = np.random.SeedSequence()
        if not isinstance(rng, np.random.SeedSequence):
            raise ParameterError(
                f"rng is {shown(rng)}; give a non-negative integer, a numpy Generator, "
                "a SeedSequence or None."
            )
        return Stream(int(rng.generate_state(1, np.uint64)[0]))

    def child(self, label: int) -> Stream:
        """Return an independent stream for one part of the work, identified by an integer."""
        word, _ = _philox4x32(np.uint64(self.key), label, 0, 0, 1)
        return Stream(int(word))

    def keys(self, first: int, count: int) -> Array:
        """Return the keys (k0, k1) of realizations first … first+count−1, uint64 (count, 2)."""
        out = np.empty((count, 2), np.uint64)
        _fill_keys(np.uint64(self.key), first, out)
        return out

    def uniforms(self, first: int, count: int, size: int) -> Array:
        """Return uniform numbers for several realizations: (count, size)."""
        return uniforms(self.keys(first, count), size)

    def generator(self, realization: int) -> np.random.Generator:
        """Return a NumPy generator for one realization, for libraries that need one.

        The generator has a SeedSequence that can spawn, because `scipy.stats.qmc` needs one.
        """
        k0, k1 = self.keys(realization, 1)[0]
        return np.random.Generator(np.random.Philox(np.random.SeedSequence([int(k0), int(k1)])))
