"""Latin hypercubes and orthogonal arrays: projections onto one, two or more axes are stratified."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import MAX_DIMS, Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import choice, whole
from mcspectra.core.jit import kernel
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream, mix_uniform
from mcspectra.samplers._kernels import _shuffle, fill_latin
from mcspectra.samplers._primes import is_prime, prime_from
from mcspectra.samplers.base import MAX_COUNT, PlaneSampler, Sampler, Structure
from mcspectra.samplers.law import Law, Unknown, latin_hypercube, paired_axes_of_array
from mcspectra.samplers.stratified import cell_side, root

__all__ = ["LatinHypercube", "NRooks", "OrthogonalArray"]


@final
@dataclass(frozen=True, kw_only=True)
class LatinHypercube(Sampler):
    """Each coordinate has n strata in its own random order, with one jittered point in each.

    With strength 1, any dims and any count.
    With strength 2, counts are p² for primes p ≥ d − 1, in up to 1024 dims.

    Attributes
    ----------
    strength
        Strength: 1, or 2 to also stratify every two coordinates into p × p cells.

    Notes
    -----
    Strength 2 is Tang's construction: an orthogonal array divides each coordinate into p parts.
    The p points in each part are shuffled over p sub-strata.
    With strength 2, the sampler equals orthogonal-array with its default jitter.

    References
    ----------
    [McKay1979]_, [Tang1993]_
    """

    structure: ClassVar[Structure] = Structure.STRATA
    dims: int = DEFAULT_DIMS
    strength: int = whole(1, least=1, most=2)

    def _check(self) -> None:
        if self.strength == 2 and self.dims > MAX_DIMS:
            raise ParameterError(
                f"latin-hypercube: dims is {self.dims}; strength 2 allows at most {MAX_DIMS}."
            )

    def _law(self, n: int) -> Law:
        if self.strength == 2:
            return paired_axes_of_array(root(n, 2), self.dims, shared_out=True)
        return latin_hypercube(n, self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        if self.strength == 2:
            return _orthogonal(n, self.dims, 2, "multi-jittered", stream.keys(first, count))
        return _latin(n, self.dims, stream.keys(first, count))

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return (n, n) if self.strength == 1 else _prime_powers_near(n, 2, self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class NRooks(PlaneSampler):
    """N rooks that do not threaten each other: the Latin hypercube in 2-D.

    2-D, any count.

    References
    ----------
    [Shirley1991]_
    """

    name: ClassVar[str] = "n-rooks"
    structure: ClassVar[Structure] = Structure.STRATA
    other_dims: ClassVar[str] = "for other dims use latin-hypercube"

    def _law(self, n: int) -> Law:
        return latin_hypercube(n, 2)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        return _latin(n, self.dims, stream.keys(first, count))


def _latin(n: int, dims: int, keys: Array) -> Array:
    out = np.empty((len(keys), n, dims))
    fill_latin(keys, cell_side(n), out)
    return out


@final
@dataclass(frozen=True, kw_only=True)
class OrthogonalArray(Sampler):
    """Orthogonal array of strength t: every t coordinates are stratified into s^t cells.

    From t to s + 1 dims (at most 1024); counts s^t for primes s ≥ max(t, d) − 1.

    Attributes
    ----------
    strength
        The strength t, from 2 to 8.
    jitter
        Each axis is divided into s strata. This option determines the position within a stratum.
        ``"jittered"``: uniform in the stratum.
        ``"multi-jittered"``: the points of each stratum are shuffled over its sub-strata.
        Each of n intervals of the axis then contains one point [Tang1993]_.
        ``"correlated-multi-jittered"``: a point's sub-stratum depends on its other coordinates:
        its strata on the next t − 1 axes determine the sub-stratum.
        A shuffle of sub-strata is drawn for each axis, and all strata of the axis use it.

    Notes
    -----
    The arrays were found by Bush [Bush1952]_ (for t = 2 by Bose), over the integers modulo s.
    Each row belongs to one polynomial of degree below t.
    The row contains the polynomial's leading coefficient, and its values at 0 … s − 1.
    Any t columns contain each of the s^t combinations of levels once.
    The levels of each column are renamed by a random permutation, as in [Owen1992]_.
    Points come in the order of the array.
    Powers of primes are not supported, because they need arithmetic in finite fields.

    References
    ----------
    [Jarosz2019]_, [Bush1952]_, [Owen1992]_, [Tang1993]_
    """

    structure: ClassVar[Structure] = Structure.STRATA
    max_dims: ClassVar[int | None] = MAX_DIMS
    dims: int = DEFAULT_DIMS
    strength: int = whole(2, least=2, most=8)
    jitter: str = choice(
        "jittered", "multi-jittered", "correlated-multi-jittered", default="multi-jittered"
    )

    def _check(self) -> None:
        if self.dims < self.strength:
            raise ParameterError(
                f"orthogonal-array: dims is {self.dims}, but strength {self.strength} needs "
                f"at least {self.strength} dims; use jittered for fewer."
            )
        least = prime_from(max(self.dims, self.strength) - 1)
        if least**self.strength > MAX_COUNT:
            raise ParameterError(
                f"orthogonal-array: {self.dims} dims at strength {self.strength} need at least "
                f"{least}^{self.strength} points, more than is possible; lower the strength."
            )

    def _law(self, n: int) -> Law:
        if self.strength > 2 or self.jitter == "correlated-multi-jittered":
            strata = n if self.jitter != "jittered" else root(n, self.strength)
            return Unknown(n=n, dims=self.dims, strata=(strata,) * self.dims)
        shared_out = self.jitter == "multi-jittered"
        return paired_axes_of_array(root(n, 2), self.dims, shared_out=shared_out)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        return _orthogonal(n, self.dims, self.strength, self.jitter, stream.keys(first, count))

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return _prime_powers_near(n, self.strength, self.dims)


def _orthogonal(n: int, dims: int, strength: int, jitter: str, keys: Array) -> Array:
    s = root(n, strength)
    slots = _slots(s, dims, strength, jitter)
    side = cell_side(s if jitter == "jittered" else n)
    out = np.empty((len(keys), n, dims))
    shared = jitter == "correlated-multi-jittered"
    _fill_orthogonal(keys, slots, s, shared, side, out)
    return out


# Four arrays are cached, one for each n, because an analysis uses only a few values of n.
# An array takes half as much memory as a set of n points
@lru_cache(maxsize=4)
def _slots(s: int, dims: int, strength: int, jitter: str) -> Array:
    """Return the stratum of each point on each axis before shuffles: int32 (s^t, dims), read-only.

    An axis has s strata (its levels) or n = s^t strata.
    The n strata are numbered by level, and within a level by the rank of the point.
    The rank of a point within its level follows from its levels on t − 1 other axes.
    """
    slots = np.empty((s**strength, max(dims, strength)), np.int32)
    _bush_levels(s, strength, slots)
    if jitter != "jittered":
        levels = slots.copy()
        for step in range(1, strength):
            slots *= s
            slots += np.roll(levels, -step, axis=1)
    slots = np.ascontiguousarray(slots[:, :dims])
    slots.setflags(write=False)
    return slots


def _prime_powers_near(n: int, power: int, dims: int) -> tuple[int | None, int]:
    """Return the largest s^power ≤ n for primes s (None if there is none), and the smallest ≥ n."""
    least = prime_from(max(dims, power) - 1)
    s = root(n, power)
    while s > least and not is_prime(s):
        s -= 1
    if s < least:
        return None, least**power
    below = s**power
    return below, below if below == n else prime_from(s + 1) ** power


@kernel
def _bush_levels(s: int, strength: int, out: Array) -> None:
    # Bush's array: row i belongs to the polynomial with the base-s digits of i as coefficients.
    # The levels are written to the array `out`, int32 (s^strength, d) with d ≤ s + 1.
    # Column 0 of the array is the leading coefficient of the polynomial.
    # Column j + 1 of the array is the value of the polynomial at j, modulo the prime s.
    n, dims = out.shape
    for i in range(n):
        out[i, 0] = i // (n // s)
        for j in range(dims - 1):
            value, rest, base = 0, i, n // s
            for _ in range(strength):  # Evaluate by Horner's rule, leading coefficient first
                value = (value * j + rest // base) % s
                rest, base = rest % base, base // s
            out[i, j + 1] = value


@kernel
def _fill_orthogonal(
    keys: Array, slots: Array, levels: int, shared: bool, side: float, out: Array
) -> None:
    # Place point i at random in stratum slots[i, j] of axis j, after a shuffle.
    # A level is a run of strata; all runs have the same length.
    # The levels are shuffled, and the strata within each level are shuffled.
    # If `shared`, the strata of all levels are shuffled in the same way.
    # slots int32 (n, d); `side` is the side of a stratum; out (R, n, d).
    count, n, dims = out.shape
    strata = slots[:, 0].max() + 1
    width = strata // levels
    order = np.empty(strata, np.int32)
    places, within = np.empty(levels, np.int64), np.empty(width, np.int64)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        for j in range(dims):
            number = n * dims + j * (levels + strata)
            _shuffle(k0, k1, number, places)
            for a in range(levels):
                if a == 0 or not shared:
                    _shuffle(k0, k1, number + levels + a * width, within)
                for q in range(width):
                    order[a * width + q] = places[a] * width + within[q]
            for i in range(n):
                x = order[slots[i, j]] / strata
                out[r, i, j] = x + side * mix_uniform(k0, k1, i * dims + j)
