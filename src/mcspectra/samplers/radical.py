"""Halton points: radical inverses in prime bases, plain or with permuted digits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _kernels
from mcspectra.samplers.base import MAX_COUNT, Sampler, Structure, check_dims

__all__ = ["Halton"]


@final
@dataclass(frozen=True, kw_only=True)
class Halton(Sampler):
    """Halton points: coordinate j is the radical inverse of the index in the j-th prime.

    Attributes
    ----------
    skip
        Index of the first point.
    scramble
        ``"none"``: the same points every time. ``"permute"``: an independent random permutation
        of the digits at every position, of every realisation; all points are then uniform.

    Notes
    -----
    Permuting *all* digit positions [Owen2017]_ takes the zeros beyond the last digit to random
    digits too, the same for all points: one uniform number a coordinate.

    References
    ----------
    .. [Halton1960] doi 10.1007/BF01386213.
    .. [Owen2017] "A randomized Halton algorithm in R", arXiv 1706.02808.
    """

    name: ClassVar[str] = "halton"
    structure: ClassVar[Structure] = Structure.DIGITS
    max_dims: ClassVar[int | None] = 1000
    dims: int = DEFAULT_DIMS
    skip: int = 0
    scramble: str = "none"

    def __post_init__(self) -> None:
        check_dims(self)
        object.__setattr__(self, "skip", as_integer("skip", self.skip, least=0, most=MAX_COUNT))
        as_choice("scramble", self.scramble, ("none", "permute"))

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Only permuted digits make every point uniform."""
        return self.scramble == "permute"

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        bases = _primes(self.dims)
        digits = np.array([_digits_needed(self.skip + n, int(b)) for b in bases])
        if self.scramble == "none":
            points = np.empty((n, self.dims))
            _kernels.fill_halton(self.skip, bases, digits, points)
            return np.tile(points, (count, 1, 1))
        out = np.empty((count, n, self.dims))
        keys = stream.keys(first, count)
        _kernels.fill_scrambled_halton(keys, self.skip, bases, digits, out)
        return out


@lru_cache
def _primes(count: int) -> Array:
    """The first `count` primes, int64; the 1,000th is 7,919."""
    sieve = np.ones(8000, dtype=bool)
    sieve[:2] = False
    for i in range(2, 90):
        sieve[i * i :: i] &= not sieve[i]
    return np.flatnonzero(sieve)[:count]


def _digits_needed(indices: int, base: int) -> int:
    """Smallest K ≥ 1 with base^K ≥ indices: digits of the largest index."""
    digits = 1
    while base**digits < indices:
        digits += 1
    return digits
