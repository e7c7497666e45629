"""Progressive multi-jittered sequences in the plane: stratified at every power of two points.

A pass of a sequence doubles it. Before pass k each of 2^k equal intervals along an axis has one point;
pass k fills the free half of each. Which new point goes to which interval decides what is stratified
besides, and where in the half it lies is random: that makes an Owen-scrambled sequence without digit
permutations (Helmer, Christensen, Kensler 2021).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import _progressive_kernels
from mcspectra.samplers.base import Sampler, Structure, check_dims

__all__ = ["PMJ", "PMJ02", "PMJ02BlueNoise"]

_PASSES = 31


@final
@dataclass(frozen=True, kw_only=True)
class PMJ(Sampler):
    """Progressive multi-jittered sequence (2-D).

    Any count. The first 2^k points are one in each interval of width 2^-k along either axis; 4^k of
    them are also one in each of 2^k × 2^k cells, and 2·4^k two diagonal ones in each. Other counts are
    made with a `NotPowerOfTwoWarning`.

    References
    ----------
    Christensen, Kensler, Kilpatrick (2018), "Progressive multi-jittered sample sequences",
    doi 10.1111/cgf.13472. Free intervals are dealt out by shuffling them, not found by search.
    """

    name: ClassVar[str] = "pmj"
    structure: ClassVar[Structure] = Structure.DIGITS
    sequence: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 2
    dims: int = 2

    def __post_init__(self) -> None:
        _check_plane(self)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        out = np.empty((count, n, 2))
        _progressive_kernels.fill_pmj(stream.keys(first, count), out)
        return out

    def _count_warning(self, n: int) -> str | None:
        return _not_a_power(n, self.name)


@final
@dataclass(frozen=True, kw_only=True)
class PMJ02(Sampler):
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
    Christensen, Kensler, Kilpatrick (2018), "Progressive multi-jittered sample sequences",
    doi 10.1111/cgf.13472. Helmer, Christensen, Kensler (2021), "Stochastic generation of (t, s)
    sample sequences", doi 10.2312/sr.20211287.
    """

    name: ClassVar[str] = "pmj02"
    structure: ClassVar[Structure] = Structure.DIGITS
    sequence: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 2
    dims: int = 2

    def __post_init__(self) -> None:
        _check_plane(self)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        out = np.empty((count, n, 2))
        _progressive_kernels.fill_pmj02(stream.keys(first, count), _pairings(), out)
        return out

    def _count_warning(self, n: int) -> str | None:
        return _not_a_power(n, self.name)


@final
@dataclass(frozen=True, kw_only=True)
class PMJ02BlueNoise(Sampler):
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

    References
    ----------
    Christensen, Kensler, Kilpatrick (2018), "Progressive multi-jittered sample sequences",
    doi 10.1111/cgf.13472, and Helmer, Christensen, Kensler (2021), "Stochastic generation of (t, s)
    sample sequences", doi 10.2312/sr.20211287, pick the best of some candidates for each point in
    turn. By then its choices are as narrow as its intervals: hence the strips.
    """

    name: ClassVar[str] = "pmj02-blue-noise"
    structure: ClassVar[Structure] = Structure.DIGITS
    unbiased: ClassVar[bool] = False
    max_dims: ClassVar[int | None] = 2
    max_count: ClassVar[int] = 2**18
    dims: int = 2
    sweeps: int = 2

    def __post_init__(self) -> None:
        _check_plane(self)
        object.__setattr__(self, "sweeps", as_integer("sweeps", self.sweeps, least=1, most=100))

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        out = np.empty((count, n, 2))
        keys = stream.keys(first, count)
        _progressive_kernels.fill_pmj02_blue_noise(keys, _pairings(), self.sweeps, out)
        return out

    def _count_warning(self, n: int) -> str | None:
        return _not_a_power(n, self.name)


def _check_plane(sampler: PMJ | PMJ02 | PMJ02BlueNoise) -> None:
    if sampler.dims != 2:
        raise ParameterError(
            f"{sampler.name}: dims is {sampler.dims!r}; it must be 2, for other dims use sobol | owen."
        )
    check_dims(sampler)


def _not_a_power(n: int, name: str) -> str | None:
    if not n & (n - 1):
        return None
    below = 1 << (n.bit_length() - 1)
    return f"{n} points of {name} are not balanced; {below} and {2 * below} would be."


@lru_cache(maxsize=1)
def _pairings() -> Array:
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
