"""Random points that keep apart: Poisson disks, classic dart throwing, best candidates.

Dart throwing is random sequential addition of darts that are uniform on the domain.
A dart becomes a point if all earlier points are at least r away.
On the torus, the distribution of sets is invariant under translation, so every point is uniform.
For "exact" Poisson disks, n determines r in advance, and dart throwing stops at the n-th point.
If a set jams earlier (see `PoissonDisk.radius`), it is discarded and a new set is started.
Starting a new set keeps the distribution invariant under translation.

Darts are thrown only where they can be accepted, in the cells of a grid.
The cells have diagonal r, so that each cell has at most one point.
Cells that may have room for a point are kept in a list.
From time to time, all cells that may have room are halved along every axis.
Cells that a disk covers completely are removed from the list [Ebeida2012]_.
Accepted darts are still uniform on the uncovered region, so the law does not change.
The set is maximal when no cell remains.

For "maximal" sets, increasing radii are tried, until the darts jam with at most n points.
The missing points, a few percent, are placed one by one at the center of the largest empty disk.
The radius of this disk is the largest minimum distance at which one more point fits.
At the end no further disk fits: the last point is at the place farthest from all others
[Schloemer2011]_.
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
"""Disks, and the grid of cells in which their neighbors are searched.

The entries are the radius, the number of cells per axis, and the reach of a disk in cells.
The next entries are the steps to all cells that a disk can touch, whether the points are on
the torus, and the number of darts."""

Throw: TypeAlias = Callable[[Any, Any, int, Array], tuple[int, int]]
"""Function that fills an array of points (n, d).

Further arguments are the keys of a realization, and the index of the next random number.
The function returns the number of points placed, and the new index."""

DENSEST = (1.0, 2.0 / 3.0**0.5, 2.0**0.5, 2.0, 2.0 * 2.0**0.5, 8.0 / 3.0**0.5, 8.0, 16.0)
"""Value of n·r^d for the densest known packings of n spheres of diameter r in 1 to 8 dims.

The packings are line, hexagons, fcc, D4, D5, E6, E7 and E8. They are listed in table 1.2 of
[Conway, Sloane (1999), "Sphere Packings, Lattices and Groups"]."""

_DEFAULT_RADIUS = (0.7, 0.75, 0.75, 0.75)
"""Default relative radii in 1 to 4 dims.

The default radii are slightly below the jamming radii 0.748, 0.777, 0.803, 0.806 [Torquato2006]_.
"""

_FIRST_RADIUS = (0.755, 0.785, 0.81, 0.815)  # first radius that is tried for maximal sets
# Ratio of successive radii. In 2-D, each larger radius has room for 2 % fewer points.
_NEXT_RADIUS = 1.01
_MOST_MAXIMAL = 3  # largest number of dims: 1000 points take 0.8 s in 3-D, a minute in 4-D
# Smallest allowed radius. Points with a smaller minimum distance are hardly better than random.
_LEAST_RADIUS = 0.25
_OFFSETS = 1  # label of the random stream that translates maximal sets on the torus
_TRIALS = 100_000  # misses in a row after which less than 1/10,000 of the domain is uncovered


@final
@dataclass(frozen=True, kw_only=True)
class PoissonDisk(Sampler):
    """Random points with a minimum distance (dart throwing), exact or maximal.

    Attributes
    ----------
    dims
        Number of dims: 1 to 4; for maximal sets 1 to 3.
    boundary
        ``"toroidal"``: distances are on the torus. ``"bounded"``: distances are in the cube.
        In the cube disks extend beyond the domain, and points near the boundary are more likely.
        If distances are in the cube, points are therefore not uniform.
    mode
        ``"exact"``: the minimum distance is the same for all sets, see `radius`.
        ``"maximal"``: no further disk fits into a set, and each set has its own minimum distance.
    radius_
        Minimum distance in mode ``"exact"``, from 0.25 to 1.
        The unit is the distance in the densest known packing of n points [Lagae2008]_.
        The default is 0.7 in 1-D, else 0.75, which is near the limit of dart throwing.
        Dart throwing jams on average at 0.748, 0.777, 0.803 and 0.806 in 1 to 4 dims.

    References
    ----------
    [Cook1986]_, [Bridson2007]_, [Ebeida2012]_.
    """

    structure: ClassVar[Structure] = Structure.TORUS
    max_dims: ClassVar[int | None] = 4
    max_count: ClassVar[int] = 2**26  # grids of cells take much more memory than the points
    dims: int = DEFAULT_DIMS
    boundary: str = choice("toroidal", "bounded")
    mode: str = choice("exact", "maximal")
    radius_: float | None = real(None, least=_LEAST_RADIUS, most=1.0)

    def _check(self) -> None:
        if self.mode == "maximal" and self.dims > _MOST_MAXIMAL:
            raise ParameterError(
                f"Maximal Poisson-disk sets are for 1 to {_MOST_MAXIMAL} dims, not {self.dims} "
                "(the last gaps take minutes to find); use mode='exact'."
            )
        if self.mode == "maximal" and self.radius_ is not None:
            raise ParameterError(
                f"radius is {self.radius_:g}, but each maximal set has its own minimum distance; "
                "leave radius out, or use mode='exact'."
            )

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether distances are on the torus."""
        return self.boundary == "toroidal"

    def radius(self, n: int) -> float:
        """Return the minimum distance r between any two of n points, in units of the domain.

        Raises
        ------
        ParameterError
            If the mode is "maximal", because each set then has its own minimum distance.
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
            # In sets of few points, some holes have equal size.
            # The kernel chooses among equal holes by position, so a random translation is needed
            own = stream.child(_OFFSETS).uniforms(first, count, self.dims)
            return points if self.boundary == "bounded" else translated(points, own)
        attempts = 3 + 3000 // n  # a small set often jams at the default radius
        throw = partial(kernels.throw_set, self._disks(self.radius(n)))
        most = f"; give a smaller radius, at most {_DEFAULT_RADIUS[self.dims - 1]}."
        return thrown(throw, self, n, keys, attempts, most)

    def _maximal_set(self, n: int, keys: Array) -> Array:
        """Throw darts at the smallest radius without room for n + 1 points, then fill holes."""
        radius = _FIRST_RADIUS[self.dims - 1] * densest_distance(n, self.dims)
        points, placed, at = np.empty((n + 1, self.dims)), n + 1, 0
        while placed > n:
            placed, at = kernels.throw_set(self._disks(radius), keys[0], keys[1], at, points)
            radius *= _NEXT_RADIUS
        kernels.fill_holes(points[:n], placed, self.unbiased)
        return points[:n]

    def _disks(self, radius: float) -> Disks:
        """Return the data of the disks, and of the grid of cells around them, for the kernels."""
        side = max(1, int(np.ceil(self.dims**0.5 / radius)))

        # Steps to the cells of the padded grid that a disk can touch, nearest first
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
    """Random points, rejected if too close to an earlier one, until n are accepted (Cook).

    Sets have the same distribution as those of `poisson-disk`, which is faster in up to 4 dims.
    Distances are on the torus. A set restarts after 100,000 rejected darts in a row.

    Attributes
    ----------
    dims
        Number of dims, 1 to 8.
    radius_
        Minimum distance relative to the densest known packing of n points [Lagae2008]_.
        The relative distance is above 0 and at most 1.
        Dart throwing jams at relative distances of about 0.75 (1-D), 0.78 (2-D) or 0.8 (more dims).
        Classic rejection becomes slow already below the distance at which dart throwing jams.

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
        # Cells at least as large as a disk, so that a disk reaches only adjacent cells
        side = max(1, min(int(1.0 / radius), int(n ** (1.0 / min(self.dims, 3)))))
        attempts = 3 + 300 // n  # sets of few points often jam
        throw = partial(kernels.throw_darts, radius**2, side, _TRIALS)
        some = f" with {_TRIALS} darts; give a smaller radius."
        return thrown(throw, self, n, stream.keys(first, count), attempts, some)


@final
@dataclass(frozen=True, kw_only=True)
class BestCandidate(Sampler):
    """Each point is the best of random candidates: the farthest from all earlier points.

    Progressive: the first points of a set have the same law as a smaller set.
    Distances are on the torus. The time is O(candidates · n²).

    Attributes
    ----------
    dims
        Any number of dims.
    candidates
        Number of candidates per existing point: point i (from 0) is chosen from candidates · i.

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
    """Return R sets of n points (R, n, d) from keys (R, 2); a set that jams is restarted.

    Raises
    ------
    CountError
        If a set jams in all attempts; the message ends with the given advice.
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
