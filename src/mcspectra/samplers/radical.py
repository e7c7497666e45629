"""Radical inverses: van der Corput, Halton and Hammersley points, plain or with scrambled digits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _radical_kernels
from mcspectra.samplers._repeated import repeated
from mcspectra.samplers.base import MAX_COUNT, Sampler, Structure, check_dims

__all__ = ["Halton", "Hammersley", "VanDerCorput"]

_SCRAMBLES = ("none", "permute", "owen")
_LARGEST_BASE = 2**13


@final
@dataclass(frozen=True, kw_only=True)
class Halton(Sampler):
    """Halton points: coordinate j is the radical inverse of the index in the j-th prime.

    Up to 1000 dims, any count.

    Attributes
    ----------
    skip
        Index of the first point.
    scramble
        ``"none"``: the same points every time. ``"permute"``: an independent random permutation
        of the digits at every position, of every realisation. ``"owen"``: nested uniform, the
        permutation at a position hangs on all digits above it. All points are uniform after either.

    Notes
    -----
    Permuting *all* digit positions [Owen2017]_ takes the zeros beyond the last digit to random
    digits too, the same for all points: one uniform number a coordinate. Nested scrambling
    [Owen1995]_ is done level by level down to where no two points agree; below that the digits of
    every point are independent of those of the others.

    References
    ----------
    .. [Halton1960] "On the efficiency of certain quasi-random sequences of points in evaluating
       multi-dimensional integrals", doi 10.1007/BF01386213.
    .. [Owen1995] "Randomly permuted (t, m, s)-nets and (t, s)-sequences",
       doi 10.1007/978-1-4612-2552-2_19.
    .. [Owen2017] "A randomized Halton algorithm in R", arXiv 1706.02808.
    """

    name: ClassVar[str] = "halton"
    structure: ClassVar[Structure] = Structure.DIGITS
    sequence: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1000
    dims: int = DEFAULT_DIMS
    skip: int = 0
    scramble: str = "none"

    def __post_init__(self) -> None:
        check_dims(self)
        object.__setattr__(self, "skip", as_integer("skip", self.skip, least=0, most=MAX_COUNT))
        as_choice("scramble", self.scramble, _SCRAMBLES)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Only scrambled digits make every point uniform."""
        return self.scramble != "none"

    @property
    def fixed(self) -> bool:  # type: ignore[override]
        """Unless digits are scrambled."""
        return self.scramble == "none"

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """The first primes."""
        return _primes(self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        keys = stream.keys(first, count)
        return _inverses(self.digit_bases, self.scramble, self.skip, n, keys)


@final
@dataclass(frozen=True, kw_only=True)
class VanDerCorput(Sampler):
    """Van der Corput points: the radical inverses of 0, 1, 2, … in one base (1-D).

    Any count.

    Attributes
    ----------
    base
        Base of the digits, from 2.
    scramble
        As for halton: ``"none"``, ``"permute"`` or ``"owen"``.

    References
    ----------
    van der Corput (1935), "Verteilungsfunktionen I", Proc. Kon. Ned. Akad. v. Wetensch. 38,
    813–821.
    """

    name: ClassVar[str] = "van-der-corput"
    structure: ClassVar[Structure] = Structure.DIGITS
    sequence: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1
    dims: int = 1
    base: int = 2
    scramble: str = "none"

    def __post_init__(self) -> None:
        if self.dims != 1:
            raise ParameterError(
                f"van-der-corput: dims is {self.dims!r}; it must be 1, "
                "for other dims use halton or hammersley."
            )
        check_dims(self)
        base = as_integer("base", self.base, least=2, most=_LARGEST_BASE)
        object.__setattr__(self, "base", base)
        as_choice("scramble", self.scramble, _SCRAMBLES)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Only scrambled digits make every point uniform."""
        return self.scramble != "none"

    @property
    def fixed(self) -> bool:  # type: ignore[override]
        """Unless digits are scrambled."""
        return self.scramble == "none"

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """The base."""
        return (self.base,)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        return _inverses((self.base,), self.scramble, 0, n, stream.keys(first, count))


@final
@dataclass(frozen=True, kw_only=True)
class Hammersley(Sampler):
    """Hammersley points: i/n, then the radical inverses of i in the first primes.

    Up to 1000 dims, any count.

    Attributes
    ----------
    scramble
        As for halton: ``"none"``, ``"permute"`` or ``"owen"``.

    Notes
    -----
    The n-ths i/n have binary digits of their own only for n = 2^m: they are then the radical
    inverses of the reversed indices and are scrambled in base 2, which keeps the balance of the set
    because runs of 2^k indices that start at multiples of 2^k go to such runs. For other n the
    n-ths keep their order, and only what lies below the first n-th is random: one offset for all
    points (``"permute"``) or one for each (``"owen"``). Either way each n-th of the first axis
    holds one point. Randomisations of digits (``| owen``) take the first coordinate in base 2:
    they fit n = 2^m only.

    References
    ----------
    Hammersley (1960), "Monte Carlo methods for solving multivariable problems",
    doi 10.1111/j.1749-6632.1960.tb42846.x.
    """

    name: ClassVar[str] = "hammersley"
    structure: ClassVar[Structure] = Structure.DIGITS
    max_dims: ClassVar[int | None] = 1000
    dims: int = DEFAULT_DIMS
    scramble: str = "none"

    def __post_init__(self) -> None:
        check_dims(self)
        as_choice("scramble", self.scramble, _SCRAMBLES)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Only scrambled digits make every point uniform."""
        return self.scramble != "none"

    @property
    def fixed(self) -> bool:  # type: ignore[override]
        """Unless digits are scrambled."""
        return self.scramble == "none"

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """2 for the first coordinate, then the first primes."""
        return (2, *_primes(self.dims - 1))

    @property
    def powers_only(self) -> bool:
        """True: the n-ths have binary digits for n = 2^m only."""
        return True

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        out = np.empty((count, n, self.dims))
        out[..., 0] = self._fractions(n, stream.child(0), first, count)
        if self.dims > 1:
            keys = stream.keys(first, count)
            out[..., 1:] = _inverses(self.digit_bases[1:], self.scramble, 0, n, keys)
        return out

    def _fractions(self, n: int, stream: Stream, first: int, count: int) -> Array:
        """Return the first coordinates (count or 1, n)."""
        indices = np.arange(n)
        if self.scramble == "none":
            return indices[None] / n
        if n & (n - 1) == 0:
            keys = stream.keys(first, count)
            plain = _inverses((2,), "none", 0, n, keys[:1])[0, :, 0]
            backwards = (plain * n).astype(np.int64)  # bits of the index reversed
            scrambled = _inverses((2,), self.scramble, 0, n, keys)[..., 0]
            return np.asarray(scrambled[:, backwards])
        below = stream.uniforms(first, count, 1 if self.scramble == "permute" else n)
        return np.minimum((indices + below) / n, np.nextafter(1.0, 0.0))


def _inverses(bases: tuple[int, ...], scramble: str, start: int, n: int, keys: Array) -> Array:
    """Radical inverses of start … start+n−1, one realisation for each row of `keys`: (R, n, d)."""
    fixed = scramble == "none"
    out = np.empty((1 if fixed else len(keys), n, len(bases)))
    radices = np.array(bases)
    if scramble == "owen":
        _radical_kernels.fill_nested(keys, start, radices, out)
        return out
    digits = np.array([_digits_needed(start + n, base) for base in bases])
    _radical_kernels.fill_permuted(keys, not fixed, start, radices, digits, out)
    return repeated(out[0], len(keys)) if fixed else out


@lru_cache
def _primes(count: int) -> tuple[int, ...]:
    """Return the first `count` primes; the 1,000th is 7,919."""
    sieve = np.ones(8000, dtype=bool)
    sieve[:2] = False
    for i in range(2, 90):
        sieve[i * i :: i] &= not sieve[i]
    return tuple(np.flatnonzero(sieve)[:count].tolist())


def _digits_needed(indices: int, base: int) -> int:
    """Smallest K ≥ 1 with base^K ≥ indices: digits of the largest index."""
    digits = 1
    while base**digits < indices:
        digits += 1
    return digits
