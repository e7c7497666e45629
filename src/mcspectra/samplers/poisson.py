"""Poisson-disk sampling: random points that keep a minimum distance, exactly n of them.

Method
------
Dart throwing, that is random sequential addition: a dart, uniform on the domain, becomes a point
if it is at least r away from all points before it. On the torus that law does not change under
translation, hence every point is uniform. In mode "exact", r is fixed beforehand by n and the dart
throwing stops at the n-th point; a set that jams before (see `PoissonDisk.radius`) is thrown away and
begun anew, which keeps the law translation-invariant.

Darts are not thrown where they cannot stick: a grid of cells of diagonal r (at most one point in
each) lists the cells that may have room, and those left over are halved along every axis now and
then, without the children that a disk covers [Ebeida2012]_. The darts that stick are uniform on the
uncovered part all the same, so that this changes the time and not the law. It also tells when
nothing is left uncovered: when the set is maximal.

In mode "maximal", r is the least of a growing sequence at which the darts jam before there are
more than n points. Those that are missing, a few in a hundred, go one by one into the largest empty
disk, whose radius is the largest minimum distance that has room for one more [Schloemer2011]_. Hence
the n-th is at least as far from the others as any place in the domain is from all n: no disk of the
set's minimum distance fits any more.

References
----------
.. [Cook1986] Cook, "Stochastic sampling in computer graphics", doi 10.1145/7529.8927.
.. [Torquato2006] Torquato, Uche, Stillinger, "Random sequential addition of hard spheres in high
   Euclidean dimensions", doi 10.1103/PhysRevE.74.061308: where dart throwing jams.
.. [Lagae2008] Lagae, Dutré, "A comparison of methods for generating Poisson disk distributions",
   doi 10.1111/j.1467-8659.2007.01100.x: radius relative to the densest packing.
.. [Ebeida2012] Ebeida et al., "A simple algorithm for maximal Poisson-disk sampling in high
   dimensions", doi 10.1111/j.1467-8659.2012.03059.x.
.. [Schloemer2011] Schlömer, Heck, Deussen, "Farthest-point optimized point sets with maximized
   minimum distance", doi 10.1145/2018323.2018345.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import ClassVar, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_real
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _spacing_kernels as kernels
from mcspectra.samplers._kernels import random_offsets, translate
from mcspectra.samplers.base import Sampler, Structure, check_dims

__all__ = ["DENSEST", "PoissonDisk", "densest_distance"]

Disks: TypeAlias = tuple[float, int, int, Array, bool, int]
"""Radius, cells an axis, reach of a disk in cells, cells it can touch, torus?, darts a cell."""

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
        points, 0.25 to 1. By default 0.7 in 1-D and 0.75 above, near the largest that dart throwing
        can do: it jams on average at 0.748, 0.777, 0.803, 0.806 in 1 to 4 dims.

    References
    ----------
    Cook (1986), "Stochastic sampling in computer graphics", doi 10.1145/7529.8927; Bridson (2007),
    "Fast Poisson disk sampling in arbitrary dimensions", doi 10.1145/1278780.1278807; Ebeida et
    al. (2012), "A simple algorithm for maximal Poisson-disk sampling in high dimensions",
    doi 10.1111/j.1467-8659.2012.03059.x.
    """

    name: ClassVar[str] = "poisson-disk"
    structure: ClassVar[Structure] = Structure.TORUS
    max_dims: ClassVar[int | None] = 4
    max_count: ClassVar[int] = 2**26  # grids of cells take many times the memory of the points
    dims: int = DEFAULT_DIMS
    boundary: str = "toroidal"
    mode: str = "exact"
    radius_: float | None = None

    def __post_init__(self) -> None:
        check_dims(self)
        as_choice("boundary", self.boundary, ("toroidal", "bounded"))
        as_choice("mode", self.mode, ("exact", "maximal"))
        if self.mode == "maximal" and self.dims > _MOST_MAXIMAL:
            raise ParameterError(
                f"Maximal Poisson-disk sets are for 1 to {_MOST_MAXIMAL} dims, not {self.dims} (the "
                "last gaps take minutes to find); use mode='exact'."
            )
        if self.radius_ is None:
            return
        radius = as_real("radius", self.radius_, least=_LEAST_RADIUS, most=1.0)
        object.__setattr__(self, "radius_", radius)
        if self.mode == "maximal":
            raise ParameterError(
                f"radius is {radius:g}, but each maximal set has its own minimum distance; "
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

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        if self.mode == "maximal":
            return self._maximal_sets(n, stream, first, count)
        attempts = 3 + 3000 // n  # a small set jams often at the default radius, a large one never
        out = np.empty((count, n, self.dims))
        disks = self._disks(self.radius(n))
        if not kernels.throw_sets(stream.keys(first, count), disks, attempts, out):
            raise CountError(
                f"{self.spec} found no room for {n} points in {self.dims} dims; "
                f"give a smaller radius, at most {_DEFAULT_RADIUS[self.dims - 1]}."
            )
        return out

    def _maximal_sets(self, n: int, stream: Stream, first: int, count: int) -> Array:
        points = np.stack([self._maximal_set(n, keys) for keys in stream.keys(first, count)])
        if self.boundary == "bounded":
            return points
        # Holes of equal size (there are, among few points) are chosen by where they are
        offsets, moved = np.empty((count, self.dims)), np.empty_like(points)
        random_offsets(stream.child(_OFFSETS).keys(first, count), offsets)
        translate(points, offsets, moved)
        return moved

    def _maximal_set(self, n: int, keys: Array) -> Array:
        """Throw darts at the least radius that leaves no room for n + 1 points, then fill holes."""
        from mcspectra.samplers._void_kernels import fill_holes

        radius = _FIRST_RADIUS[self.dims - 1] * densest_distance(n, self.dims)
        points, placed, at = np.empty((n + 1, self.dims)), n + 1, 0
        while placed > n:
            placed, at = kernels.throw_set(keys[0], keys[1], at, self._disks(radius), points)
            radius *= _NEXT_RADIUS
        fill_holes(points[:n], placed, self.unbiased)
        return points[:n]

    def _disks(self, radius: float) -> Disks:
        """Return what the kernels know of the disks and of the grid of cells around them."""
        side = max(1, int(np.ceil(self.dims**0.5 / radius)))
        reach, near = _neighbors(self.dims, side, radius)
        return radius, side, reach, near, self.unbiased, 2 if self.dims < 3 else 8


def densest_distance(n: int, dims: int) -> float:
    """Return the minimum distance in the densest known packing of n points in 1 to 8 dims."""
    return float((DENSEST[dims - 1] / n) ** (1.0 / dims))


def _neighbors(dims: int, side: int, radius: float) -> tuple[int, Array]:
    """Return the reach of a disk in cells, and the cells around one that it can touch, near first.

    The cells come as steps (K,) in a grid of side cells an axis that is padded by the reach.
    """
    reach = int(np.ceil(radius * side))
    offsets = np.array(list(product(range(-reach, reach + 1), repeat=dims)))
    gaps = np.maximum(np.abs(offsets) - 1, 0) / side
    near = offsets[(gaps**2).sum(axis=1) < radius**2]
    near = near[np.argsort((near**2).sum(axis=1), kind="stable")]
    return reach, near @ (side + 2 * reach) ** np.arange(dims - 1, -1, -1)
