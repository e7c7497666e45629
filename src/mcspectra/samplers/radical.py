"""Radical inverses: van der Corput, Halton and Hammersley points, plain or scrambled."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.fields import choice, whole
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers._primes import LARGEST_BASE
from mcspectra.samplers._scramble_kernels import fill_inverses, fill_nested
from mcspectra.samplers.base import MAX_COUNT, FixedSet, Sampler, Structure
from mcspectra.samplers.law import Fixed, Law, Unknown, is_power
from mcspectra.samplers.registry import RANDOMIZATIONS

__all__ = ["Halton", "Hammersley", "RadicalInverses", "VanDerCorput"]


class RadicalInverses(FixedSet):
    """Abstract sampler of radical inverses, plain or scrambled.

    Attributes
    ----------
    skip
        Index of the first point.
    of_one_index
        Whether all coordinates of a point are radical inverses of its index.
    """

    structure: ClassVar[Structure] = Structure.DIGITS
    skip: int = 0
    of_one_index: ClassVar[bool] = True
    scramble: str

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether every point is uniform: true if digits are scrambled."""
        return self.scramble != "none"

    @property
    def fixed(self) -> bool:  # type: ignore[override]
        """Whether all realizations are the same set: true if digits are not scrambled."""
        return self.scramble == "none"

    @property
    def scrambles(self) -> int:  # type: ignore[override]
        """Number of built-in randomizations; further randomizations use other random streams."""
        return int(self.scramble != "none")

    def draw_nested(self, n: int, stream: Stream, first: int, count: int) -> Array:
        """Draw points with nested scrambling, each from an earlier point: (count, n, dims)."""
        return _nested(self.digit_bases, n, stream.keys(first, count))

    def as_chain(self, n: int) -> Sampler:  # noqa: ARG002
        """Return the sampler and the randomization that the parameter `scramble` stands for."""
        if self.scramble == "none":
            return self
        plain: Sampler = replace(self, scramble="none")  # type: ignore[type-var]
        return plain.then(RANDOMIZATIONS.load(self.scramble)())

    def _law(self, n: int) -> Law:
        if not self.fixed:
            chain = self.as_chain(n)
            return Unknown(n=n, dims=self.dims) if chain is self else chain.law(n)
        bases = self.digit_bases
        digital = len(set(bases)) == 1 and is_power(n, bases[0]) and self.skip % n == 0
        return Fixed(n=n, dims=self.dims, bases=bases, digital=digital)

    def _set(self, n: int) -> Array:
        return _inverses(self.digit_bases, self.skip, n)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        if self.scramble == "none":
            return FixedSet._points(self, n, stream, first, count)
        return self.as_chain(n).draw_stream(n, stream, first, count)


@final
@dataclass(frozen=True, kw_only=True)
class Halton(RadicalInverses):
    """Halton points: coordinate j is the radical inverse of the index in the j-th prime.

    Up to 1000 dims, any count.

    Attributes
    ----------
    skip
        Index of the first point.
    scramble
        ``"none"``: the same points every time.
        ``"permute"`` and ``"owen"`` apply the randomization of this name and make points uniform.

    References
    ----------
    [Halton1960]_, [Owen2017]_
    """

    sequence: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1000
    dims: int = DEFAULT_DIMS
    skip: int = whole(0, least=0, most=MAX_COUNT)
    scramble: str = choice("none", "permute", "owen")

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """The first primes."""
        return _primes(self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class VanDerCorput(RadicalInverses):
    """Van der Corput points: the radical inverses of 0, 1, 2, … in one base (1-D).

    Any count.

    Attributes
    ----------
    base
        Base of the digits, at least 2.
    scramble
        Scrambling, same as for halton: ``"none"``, ``"permute"`` or ``"owen"``.

    References
    ----------
    [VanDerCorput1935]_
    """

    sequence: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 1
    other_dims: ClassVar[str] = "for other dims use halton or hammersley"
    dims: int = 1
    base: int = whole(2, least=2, most=LARGEST_BASE)
    scramble: str = choice("none", "permute", "owen")

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """Base of the digits of the only coordinate."""
        return (self.base,)


@final
@dataclass(frozen=True, kw_only=True)
class Hammersley(RadicalInverses):
    """Hammersley points: i/n, then the radical inverses of i in the first primes.

    Up to 1000 dims, any count.

    Attributes
    ----------
    scramble
        Scrambling, same as for halton: ``"none"``, ``"permute"`` or ``"owen"``.

    Notes
    -----
    For n = 2^m the first coordinates i/n are scrambled in base 2.
    For other n, the fractions i/n have no exact binary digits; permute and owen raise an error.
    For other n, the parameter `scramble` keeps the order of i/n, and adds random offsets below 1/n.
    With ``"permute"`` all points have the same offset; with ``"owen"`` each point has its own.
    After either scramble, each interval [i/n, (i+1)/n) of the first axis contains one point.

    References
    ----------
    [Hammersley1960]_
    """

    max_dims: ClassVar[int | None] = 1000
    of_one_index: ClassVar[bool] = False
    dims: int = DEFAULT_DIMS
    scramble: str = choice("none", "permute", "owen")

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """Bases of the digits: 2 for the first coordinate, then the first primes."""
        return (2, *_primes(self.dims - 1))

    @property
    def powers_only(self) -> bool:
        """Whether digits can be scrambled only for n = 2^m: always True.

        The first coordinates i/n are multiples of 1/n, which have binary digits only for n = 2^m.
        """
        return True

    def _set(self, n: int) -> Array:
        out = np.empty((n, self.dims))
        out[:, 0] = np.arange(n) / n
        out[:, 1:] = _inverses(self.digit_bases[1:], 0, n)
        return out

    def draw_nested(self, n: int, stream: Stream, first: int, count: int) -> Array:
        """Draw points with nested scrambling; i/n is the radical inverse of the reversed index."""
        reversed_ = (_inverses((2,), 0, n)[:, 0] * n).astype(np.int64)
        nths = _nested((2,), n, stream.child(0).keys(first, count))[:, reversed_]
        rest = _nested(self.digit_bases[1:], n, stream.keys(first, count))
        return np.concatenate([nths, rest], axis=2)

    def as_chain(self, n: int) -> Sampler:
        """Return the plain sampler followed by its randomization if n = 2^m, else this sampler."""
        return self if n & (n - 1) else RadicalInverses.as_chain(self, n)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        if self.scramble == "none" or n & (n - 1) == 0:
            return RadicalInverses._points(self, n, stream, first, count)

        # The multiples of 1/n have no digits to scramble: add offsets below 1/n
        out = np.empty((count, n, self.dims))
        own = stream.child(0).uniforms(first, count, 1 if self.scramble == "permute" else n)
        out[..., 0] = np.minimum((np.arange(n) + own) / n, BELOW_ONE)
        if self.dims > 1:
            rest = Halton(dims=self.dims - 1, scramble=self.scramble)
            out[..., 1:] = rest.draw_stream(n, stream, first, count)
        return out


@lru_cache
def _primes(count: int) -> tuple[int, ...]:
    """Return the first `count` primes; the 1,000th is 7,919."""
    sieve = np.ones(8000, dtype=bool)
    sieve[:2] = False
    for i in range(2, 90):
        sieve[i * i :: i] &= not sieve[i]
    return tuple(np.flatnonzero(sieve)[:count].tolist())


def _inverses(bases: tuple[int, ...], start: int, n: int) -> Array:
    """Return radical inverses of start … start + n − 1: float64 (n, d)."""
    out = np.empty((n, len(bases)))
    fill_inverses(np.array(bases, np.int64), start, out)
    return out


def _nested(bases: tuple[int, ...], n: int, keys: Array) -> Array:
    """Return nested-scrambled radical inverses, one realization per row of `keys`: (R, n, d)."""
    out = np.empty((len(keys), n, len(bases)))
    fill_nested(keys, np.array(bases, np.int64), out)
    return out
