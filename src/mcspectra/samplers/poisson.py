"""Random points that keep apart: Poisson disks, classic dart throwing, best candidates.

Dart throwing is random sequential addition: a dart, uniform on the domain, becomes a point
if it is at least r away from all points before it. On the torus that law does not change under
translation, hence every point is uniform. For "exact" Poisson disks, r is fixed beforehand by n and the
dart throwing stops at the n-th point; a set that jams before (see `PoissonDisk.radius`) is thrown away
and begun anew, which keeps the law translation-invariant.

Darts are not thrown where they cannot stick: a grid of cells of diagonal r (at most one point in
each) lists the cells that may have room, and those left over are halved along every axis now and
then, without the children that a disk covers [Ebeida2012]_. The darts that stick are uniform on the
uncovered part all the same, so that this changes the time and not the law. It also tells when
nothing is left uncovered: when the set is maximal.

For "maximal" sets, r is the least of a growing sequence at which the darts jam before there are
more than n points. Those that are missing, a few in a hundred, go one by one into the largest empty
disk, whose radius is the largest minimum distance that has room for one more [Schloemer2011]_. Hence
the n-th is at least as far from the others as any place in the domain is from all n: no disk of the
set's minimum distance fits any more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, ClassVar, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.fields import choice, real, whole
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _spacing_kernels as kernels
from mcspectra.samplers._kernels import translated
from mcspectra.samplers.base import Sampler, Structure
from mcspectra.samplers.law import Law, Stationary, Unknown

__all__ = ["DENSEST", "BestCandidate", "DartThrowing", "PoissonDisk", "densest_distance", "thrown"]

Disks: TypeAlias = tuple[float, int, int, Array, bool, int]
"""Radius, cells an axis, reach of a disk in cells, cells it can touch, torus?, darts a cell."""

Throw: TypeAlias = Callable[[Any, Any, int, Array], tuple[int, int]]
"""Takes the keys of a realization, the number of the next random number, and points (n, d) to be placed;
returns how many are, and the number of the random number after them."""

DENSEST = (1.0, 2.0 / 3.0**0.5, 2.0**0.5, 2.0, 2.0 * 2.0**0.5, 8.0 / 3.0**0.5, 8.0, 16.0)
"""n·r^d of the densest known packings of spheres of diameter r in 1 to 8 dims: line, hexagons, fcc,
D4, D5, E6, E7, E8 [Conway, Sloane (1999), "Sphere Packings, Lattices and Groups", table 1.2]."""

_DEFAULT_RADIUS = (0.7, 0.75, 0.75, 0.75)
"""A little below where dart throwing jams: 0.748, 0.777, 0.803, 0.806 [Torquato2006]_."""

_FIRST_RADIUS = (0.755, 0.785, 0.81, 0.815)  # a little above: the first to try for maximal sets
_NEXT_RADIUS = 1.01  # times the one before: 2 % of the points of a plane on average too few
_MOST_MAXIMAL = 3  # dims: 1000 points took 0.02 s in 2-D, 0.8 s in 3-D, a minute in 4-D
_LEAST_RADIUS = 0.25  # below, sets are as good as random, and the grid of (c/r)^d cells grows large
_OFFSETS = 1  # label of the stream that translates maximal sets
_TRIALS = 100_000  # darts in a row that may miss: then less than a ten-thousandth is uncovered


@final
@dataclass(frozen=True, kw_only=True)
class PoissonDisk(Sampler):
    """Random points with a minimum distance (dart throwing), exact or maximal.

    Attributes
    ----------
    dims
        1 to 4; maximal sets, 1 to 3.
    boundary
        ``"toroidal"``: distances go round the edges of the domain; ``"bounded"``: they do not, so
        that disks stick out of it, which makes points near the boundary more likely: `unbiased` is
        then False.
    mode
        ``"exact"``: the minimum distance is the same for all sets, see `radius`. ``"maximal"``: no
        further disk fits into a set, whose minimum distance is then its own.
    radius_
        Minimum distance in mode ``"exact"``, relative to that of the densest known packing of n
        points [Lagae2008]_, 0.25 to 1. By default 0.7 in 1-D and 0.75 above, near the largest that
        dart throwing can do: it jams on average at 0.748, 0.777, 0.803, 0.806 in 1 to 4 dims.

    References
    ----------
    [Cook1986]_, [Bridson2007]_, [Ebeida2012]_.
    """

    structure: ClassVar[Structure] = Structure.TORUS
    max_dims: ClassVar[int | None] = 4
    max_count: ClassVar[int] = 2**26  # grids of cells take many times the memory of the points
    dims: int = DEFAULT_DIMS
    boundary: str = choice("toroidal", "bounded")
    mode: str = choice("exact", "maximal")
    radius_: float | None = real(None, least=_LEAST_RADIUS, most=1.0)

    def _check(self) -> None:
        if self.mode == "maximal" and self.dims > _MOST_MAXIMAL:
            raise ParameterError(
                f"Maximal Poisson-disk sets are for 1 to {_MOST_MAXIMAL} dims, not {self.dims} (the "
                "last gaps take minutes to find); use mode='exact'."
            )
        if self.mode == "maximal" and self.radius_ is not None:
            raise ParameterError(
                f"radius is {self.radius_:g}, but each maximal set has its own minimum distance; "
                "leave radius out, or use mode='exact'."
            )

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether distances are toroidal."""
        return self.boundary == "toroidal"

    def radius(self, n: int) -> float:
        """Return the minimum distance r between any two of n points, in units of the domain.

        Raises
        ------
        ParameterError
            In mode "maximal": every set has its own minimum distance.
        """
        if self.mode == "maximal":
            raise ParameterError(
                f"{self.spec} has no common radius: each set has its own; measure it on the points."
            )
        relative = _DEFAULT_RADIUS[self.dims - 1] if self.radius_ is None else self.radius_
        return relative * densest_distance(self.check_count(n), self.dims)

    def _law(self, n: int) -> Law:
        if self.unbiased:
            return Stationary(n=n, dims=self.dims)
        return Unknown(n=n, dims=self.dims, is_uniform=False)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        keys = stream.keys(first, count)
        if self.mode == "maximal":
            points = np.stack([self._maximal_set(n, each) for each in keys])
            # Holes of equal size (there are, among few points) are chosen by where they are
            own = stream.child(_OFFSETS).uniforms(first, count, self.dims)
            return points if self.boundary == "bounded" else translated(points, own)
        attempts = 3 + 3000 // n  # a small set jams often at the default radius, a large one never
        throw = partial(kernels.throw_set, self._disks(self.radius(n)))
        most = f"; give a smaller radius, at most {_DEFAULT_RADIUS[self.dims - 1]}."
        return thrown(throw, self, n, keys, attempts, most)

    def _maximal_set(self, n: int, keys: Array) -> Array:
        """Throw darts at the least radius that leaves no room for n + 1 points, then fill holes."""
        radius = _FIRST_RADIUS[self.dims - 1] * densest_distance(n, self.dims)
        points, placed, at = np.empty((n + 1, self.dims)), n + 1, 0
        while placed > n:
            placed, at = kernels.throw_set(self._disks(radius), keys[0], keys[1], at, points)
            radius *= _NEXT_RADIUS
        kernels.fill_holes(points[:n], placed, self.unbiased)
        return points[:n]

    def _disks(self, radius: float) -> Disks:
        """Return what the kernels know of the disks and of the grid of cells around them."""
        side = max(1, int(np.ceil(self.dims**0.5 / radius)))

        # Steps to the cells that a disk can touch, near ones first, in the grid padded by its reach
        reach = int(np.ceil(radius * side))
        offsets = np.array(list(product(range(-reach, reach + 1), repeat=self.dims)))
        gaps = np.maximum(np.abs(offsets) - 1, 0) / side
        near = offsets[(gaps**2).sum(axis=1) < radius**2]
        near = near[np.argsort((near**2).sum(axis=1), kind="stable")]
        steps = near @ (side + 2 * reach) ** np.arange(self.dims - 1, -1, -1)
        return radius, side, reach, steps, self.unbiased, 2 if self.dims < 3 else 8


@final
@dataclass(frozen=True, kw_only=True)
class DartThrowing(Sampler):
    """Random points, each rejected if it is too close to an earlier one, until n are accepted (Cook).

    The law is that of `poisson-disk`, whose method is faster, for up to 8 dims; distances are
    toroidal. A set is begun anew when 100,000 darts in a row have missed.

    Attributes
    ----------
    dims
        1 to 8.
    radius_
        Minimum distance relative to that of the densest known packing of n points [Lagae2008]_,
        above 0, at most 1. Dart throwing jams at about 0.75 in 1-D, 0.78 in 2-D, 0.8 above, and
        classic rejection gets slow before.

    References
    ----------
    [Cook1986]_, [Lagae2008]_.
    """

    structure: ClassVar[Structure] = Structure.TORUS
    max_dims: ClassVar[int | None] = 8
    max_count: ClassVar[int] = 2**22
    dims: int = DEFAULT_DIMS
    radius_: float = real(0.65, above=0.0, most=1.0)

    def radius(self, n: int) -> float:
        """Return the minimum distance between any two of n points, in units of the domain."""
        return self.radius_ * densest_distance(self.check_count(n), self.dims)

    def _law(self, n: int) -> Law:
        return Stationary(n=n, dims=self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        radius = self.radius(n)
        # Cells no smaller than a disk, so that it can only touch those next to its own
        side = max(1, min(int(1.0 / radius), int(n ** (1.0 / min(self.dims, 3)))))
        attempts = 3 + 300 // n  # few points jam often: whether they fit is luck
        throw = partial(kernels.throw_darts, radius**2, side, _TRIALS)
        some = f" with {_TRIALS} darts; give a smaller radius."
        return thrown(throw, self, n, stream.keys(first, count), attempts, some)


@final
@dataclass(frozen=True, kw_only=True)
class BestCandidate(Sampler):
    """Each point is the best of random candidates: the farthest from all earlier points.

    Progressive: the first points of a set are themselves one. Distances are toroidal. The time is
    O(candidates · n²).

    Attributes
    ----------
    dims
        Any number.
    candidates
        Candidates for each point there is already: point i (from 0) is chosen from candidates · i.

    References
    ----------
    [Mitchell1991]_.
    """

    structure: ClassVar[Structure] = Structure.TORUS
    max_count: ClassVar[int] = 2**16
    dims: int = DEFAULT_DIMS
    candidates: int = whole(4, least=1, most=10_000)

    def _law(self, n: int) -> Law:
        return Stationary(n=n, dims=self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        out = np.empty((count, n, self.dims))
        kernels.pick_candidates(stream.keys(first, count), self.candidates, out)
        return out


def thrown(
    throw: Throw, sampler: Sampler, n: int, keys: Array, attempts: int, advice: str
) -> Array:
    """Sets of n points of realizations with keys (R, 2): (R, n, d); one that jams is begun anew.

    Raises
    ------
    CountError
        One jams in all attempts; the sentence ends with the advice.
    """
    out = np.empty((len(keys), n, sampler.dims))
    for own, points in zip(keys, out, strict=True):
        at = 0
        for _ in range(attempts):
            placed, at = throw(own[0], own[1], at, points)
            if placed == n:
                break
        else:
            raise CountError(
                f"{sampler.spec} found no room for {n} points in {sampler.dims} dims{advice}"
            )
    return out


def densest_distance(n: int, dims: int) -> float:
    """Return the minimum distance in the densest known packing of n points in 1 to 8 dims."""
    return float((DENSEST[dims - 1] / n) ** (1.0 / dims))
