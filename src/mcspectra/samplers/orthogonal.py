"""Latin hypercubes and orthogonal arrays: projections onto one, two or more axes are stratified."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import MAX_DIMS, Array, as_choice, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _kernels, _orthogonal_kernels
from mcspectra.samplers.base import MAX_COUNT, Sampler, Structure, check_dims
from mcspectra.samplers.stratified import cell_side, root

__all__ = ["LatinHypercube", "NRooks", "OrthogonalArray"]

_JITTERS = ("jittered", "multi-jittered", "correlated-multi-jittered")
_MOST_STRENGTH = 8


@final
@dataclass(frozen=True, kw_only=True)
class LatinHypercube(Sampler):
    """Each coordinate has n strata in a random order of its own, with one jittered point in each.

    Any dims and any count; strength 2: counts p² for primes p ≥ d − 1, up to 1024 dims.

    Attributes
    ----------
    strength
        1, or 2: every two coordinates are also stratified into p × p cells.

    Notes
    -----
    Strength 2 is Tang's: an orthogonal array says in which p-th each coordinate of a point is, and
    the p points of a p-th share it out at random. It is the same as orthogonal-array with its
    default jitter.

    References
    ----------
    McKay, Beckman, Conover (1979), "A comparison of three methods for selecting values of input
    variables in the analysis of output from a computer code", doi 10.1080/00401706.1979.10489755.

    Tang (1993), "Orthogonal array-based Latin hypercubes", doi 10.1080/01621459.1993.10476423.
    """

    name: ClassVar[str] = "latin-hypercube"
    structure: ClassVar[Structure] = Structure.STRATA
    dims: int = DEFAULT_DIMS
    strength: int = 1

    def __post_init__(self) -> None:
        check_dims(self)
        strength = as_integer("strength", self.strength, least=1, most=2)
        object.__setattr__(self, "strength", strength)
        if strength == 2 and self.dims > MAX_DIMS:
            raise ParameterError(
                f"latin-hypercube: dims is {self.dims}; strength 2 allows at most {MAX_DIMS}."
            )

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        if self.strength == 2:
            return _orthogonal(n, self.dims, 2, "multi-jittered", stream.keys(first, count))
        return _latin(n, self.dims, stream.keys(first, count))

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return (n, n) if self.strength == 1 else _prime_powers_near(n, 2, self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class NRooks(Sampler):
    """N rooks that do not threaten each other: the Latin hypercube in 2-D.

    2-D, any count.

    References
    ----------
    Shirley (1991), "Discrepancy as a quality measure for sample distributions",
    doi 10.2312/egtp.19911013.
    """

    name: ClassVar[str] = "n-rooks"
    structure: ClassVar[Structure] = Structure.STRATA
    max_dims: ClassVar[int | None] = 2
    dims: int = 2

    def __post_init__(self) -> None:
        if self.dims != 2:
            raise ParameterError(
                f"n-rooks: dims is {self.dims!r}; it must be 2, for other dims use latin-hypercube."
            )
        check_dims(self)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        return _latin(n, self.dims, stream.keys(first, count))


@final
@dataclass(frozen=True, kw_only=True)
class OrthogonalArray(Sampler):
    """Orthogonal array of strength t: every t coordinates are stratified into s^t cells.

    From t to s + 1 dims (1024 at most); counts s^t for primes s ≥ max(t, d) − 1.

    Attributes
    ----------
    strength
        t, from 2 to 8.
    jitter
        Where a point is within its s-th of each axis. ``"jittered"``: anywhere.
        ``"multi-jittered"``: the points of each s-th share it out at random, so that each n-th of
        the axis holds one [Tang1993]_. ``"correlated-multi-jittered"``: they share it out in the
        order of their levels on the t − 1 axes that follow, shuffled alike in all the s-ths.

    Notes
    -----
    The arrays are those of Bush [Bush1952]_, for t = 2 of Bose, over the integers modulo s: row i
    holds the values of a polynomial of degree below t at 0 … s − 1, and its leading coefficient.
    Any t columns hold each of the s^t combinations of levels once. The levels of each column are
    renamed by a random permutation, as Owen does [Owen1992]_. Points come in the order of the
    array. Powers of primes would take arithmetic in finite fields.

    References
    ----------
    .. [Jarosz2019] Jarosz, Enayet, Kensler, Kilpatrick, Christensen, "Orthogonal array sampling for
       Monte Carlo rendering", doi 10.1111/cgf.13777.
    .. [Bush1952] "Orthogonal arrays of index unity", doi 10.1214/aoms/1177729387.
    .. [Owen1992] "Orthogonal arrays for computer experiments, integration and visualization",
       Statistica Sinica 2, 439–452.
    .. [Tang1993] "Orthogonal array-based Latin hypercubes", doi 10.1080/01621459.1993.10476423.
    """

    name: ClassVar[str] = "orthogonal-array"
    structure: ClassVar[Structure] = Structure.STRATA
    max_dims: ClassVar[int | None] = MAX_DIMS
    dims: int = DEFAULT_DIMS
    strength: int = 2
    jitter: str = "multi-jittered"

    def __post_init__(self) -> None:
        check_dims(self)
        strength = as_integer("strength", self.strength, least=2, most=_MOST_STRENGTH)
        object.__setattr__(self, "strength", strength)
        as_choice("jitter", self.jitter, _JITTERS)
        if self.dims < strength:
            raise ParameterError(
                f"orthogonal-array: dims is {self.dims}, but strength {strength} needs "
                f"at least {strength} dims; use jittered for fewer."
            )
        least = _next_prime(max(self.dims, strength) - 1)
        if least**strength > MAX_COUNT:
            raise ParameterError(
                f"orthogonal-array: {self.dims} dims at strength {strength} need "
                f"at least {least}^{strength} points, more than is possible; lower the strength."
            )

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        return _orthogonal(n, self.dims, self.strength, self.jitter, stream.keys(first, count))

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return _prime_powers_near(n, self.strength, self.dims)


def _latin(n: int, dims: int, keys: Array) -> Array:
    out = np.empty((len(keys), n, dims))
    _kernels.fill_latin(keys, cell_side(n), out)
    return out


def _orthogonal(n: int, dims: int, strength: int, jitter: str, keys: Array) -> Array:
    s = root(n, strength)
    slots = _slots(s, dims, strength, jitter)
    side = cell_side(s if jitter == "jittered" else n)
    out = np.empty((len(keys), n, dims))
    shared = jitter == "correlated-multi-jittered"
    _orthogonal_kernels.fill_orthogonal(keys, slots, s, shared, side, out)
    return out


@lru_cache(maxsize=4)  # analyses draw block after block of few n; half the memory of the points
def _slots(s: int, dims: int, strength: int, jitter: str) -> Array:
    """Stratum of each point on each axis before all shuffles: int32 (s^t, dims), read-only.

    The strata of an axis are its s levels, or n = s^t of them: the level, then the order of the
    point among those of the level, which is what its levels on t − 1 other axes say.
    """
    slots = np.empty((s**strength, max(dims, strength)), np.int32)
    _orthogonal_kernels.bush_levels(s, strength, slots)
    if jitter != "jittered":
        levels = slots.copy()
        for step in range(1, strength):
            slots *= s
            slots += np.roll(levels, -step, axis=1)
    slots = np.ascontiguousarray(slots[:, :dims])
    slots.setflags(write=False)
    return slots


def _prime_powers_near(n: int, power: int, dims: int) -> tuple[int | None, int]:
    """Return the largest s^power ≤ n (None if none) and the smallest ≥ n, for possible primes s."""
    least = _next_prime(max(dims, power) - 1)
    s = root(n, power)
    while s > least and not _is_prime(s):
        s -= 1
    if s < least:
        return None, least**power
    below = s**power
    return below, below if below == n else _next_prime(s + 1) ** power


def _next_prime(least: int) -> int:
    candidate = max(least, 2)
    while not _is_prime(candidate):
        candidate += 1
    return candidate


def _is_prime(s: int) -> bool:
    return s >= 2 and all(s % q for q in range(2, math.isqrt(s) + 1))
