"""Poisson-disk sampling: random points that keep a minimum distance, exactly n of them.

Method
------
Dart throwing, that is random sequential addition: a dart, uniform on the domain, becomes a point
if it is at least r away from all points before it. On the torus that law does not change under
translation, hence every point is uniform. Here r is fixed beforehand by n and the dart throwing
stops at the n-th point; a set that jams before (see `PoissonDisk.radius`) is thrown away and
begun anew, which keeps the law translation-invariant.

Darts are not thrown where they cannot stick: a grid of cells of diagonal r (at most one point in
each) lists the cells that may have room, and those left over are halved along every axis now and
then, without the children that a disk covers [Ebeida2012]_. The darts that stick are uniform on the
uncovered part all the same, so that this changes the time and not the law.

References
----------
.. [Cook1986] Cook, "Stochastic sampling in computer graphics", doi 10.1145/7529.8927.
.. [Torquato2006] Torquato, Uche, Stillinger, "Random sequential addition of hard spheres in high
   Euclidean dimensions", doi 10.1103/PhysRevE.74.061308: where dart throwing jams.
.. [Lagae2008] Lagae, Dutré, "A comparison of methods for generating Poisson disk distributions",
   doi 10.1111/j.1467-8659.2007.01100.x: radius relative to the densest packing.
.. [Ebeida2012] Ebeida et al., "A simple algorithm for maximal Poisson-disk sampling in high
   dimensions", doi 10.1111/j.1467-8659.2012.03059.x.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_real
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.jit import kernel
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream, mix_uniform
from mcspectra.samplers.base import Sampler, Structure, check_dims

__all__ = ["PoissonDisk"]

_DENSEST = (1.0, 2.0 / 3.0**0.5, 2.0**0.5, 2.0)
"""n·r^d of the densest known packings of spheres of diameter r: line, hexagons, fcc, D4
[Conway, Sloane (1999), "Sphere Packings, Lattices and Groups", table 1.2]."""

_DEFAULT_RADIUS = (0.7, 0.75, 0.75, 0.75)
"""A little below where dart throwing jams: 0.748, 0.777, 0.803, 0.806 [Torquato2006]_."""

_LEAST_RADIUS = 0.25  # below, sets are as good as random, and the grid of (c/r)^d cells grows large
_BELOW_ONE = 1.0 - 2.0**-53
_FINEST = 2**40
_NOWHERE = 9.0  # coordinate of an empty cell, farther away than any radius


@final
@dataclass(frozen=True, kw_only=True)
class PoissonDisk(Sampler):
    """Random points with a minimum distance (dart throwing), on the torus or in the cube.

    Attributes
    ----------
    dims
        1 to 4.
    toroidal
        Whether distances go round the edges of the domain. If not, discs may stick out of it,
        which makes points near the boundary more likely: `unbiased` is then False.
    radius_
        Minimum distance relative to that of the densest known packing of n points, 0.25 to 1. By
        default 0.7 in 1-D and 0.75 above, near the largest that dart throwing can do: it jams
        on average at 0.748, 0.777, 0.803, 0.806 in 1 to 4 dims.
    """

    name: ClassVar[str] = "poisson-disk"
    structure: ClassVar[Structure] = Structure.TORUS
    max_dims: ClassVar[int | None] = 4
    dims: int = DEFAULT_DIMS
    toroidal: bool = True
    radius_: float | None = None

    def __post_init__(self) -> None:
        check_dims(self)
        if not isinstance(self.toroidal, bool):
            raise ParameterError(f"toroidal is {self.toroidal!r}; give True or False.")
        if self.radius_ is not None:
            radius = as_real("radius", self.radius_, least=_LEAST_RADIUS, most=1.0)
            object.__setattr__(self, "radius_", radius)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether distances are toroidal."""
        return self.toroidal

    def radius(self, n: int) -> float:
        """Return the minimum distance r between any two of n points, in units of the domain."""
        relative = _DEFAULT_RADIUS[self.dims - 1] if self.radius_ is None else self.radius_
        densest = (_DENSEST[self.dims - 1] / self.check_count(n)) ** (1.0 / self.dims)
        return float(relative * densest)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        radius = self.radius(n)
        side = max(1, int(np.ceil(self.dims**0.5 / radius)))
        reach, near = _neighbors(self.dims, side, radius)
        disks = (radius, side, reach, near, self.toroidal, 2 if self.dims < 3 else 8)
        attempts = 3 + 3000 // n  # a small set jams often at the default radius, a large one never
        out = np.empty((count, n, self.dims))
        if not _throw_sets(stream.keys(first, count), disks, attempts, out):
            raise CountError(
                f"{self.spec} found no room for {n} points in {self.dims} dims; "
                f"give a smaller radius, at most {_DEFAULT_RADIUS[self.dims - 1]}."
            )
        return out


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


@kernel
def _home(x: Array, side: int, reach: int) -> int:
    # Index of the cell of x in the padded grid.
    index = 0
    for j in range(x.size):
        index = index * (side + 2 * reach) + min(int(x[j] * side), side - 1) + reach
    return index


@kernel
def _is_covered(x: Array, half: float, home: int, radius: float, near: Array, grid: Array) -> bool:
    # Whether the open disk around one of the points holds the whole box x ± half.
    limit = radius * radius
    for k in range(near.size):
        point = grid[home + near[k]]
        square = 0.0
        for j in range(x.size):
            square += (abs(x[j] - point[j]) + half) ** 2
        if square < limit:
            return True
    return False


@kernel
def _place(x: Array, side: int, reach: int, wrap: bool, grid: Array) -> None:
    # Put x, and its periodic images within reach of the domain, into the padded grid.
    dims = x.size
    turns = 1 + (reach - 1) // side if wrap else 0
    images = (2 * turns + 1) ** dims
    for image in range(images):
        rest, index, inside = image, 0, True
        for j in range(dims):
            c = min(int(x[j] * side), side - 1) + reach + (rest % (2 * turns + 1) - turns) * side
            inside = inside and 0 <= c < side + 2 * reach
            index = index * (side + 2 * reach) + c
            rest //= 2 * turns + 1
        if inside:
            rest = image
            for j in range(dims):
                grid[index, j] = x[j] + rest % (2 * turns + 1) - turns
                rest //= 2 * turns + 1


@kernel
def _halved(
    active: Array, scale: int, side: int, reach: int, radius: float, near: Array, grid: Array
) -> Array:
    # Children, at twice the scale, of the active cells, but those that a disk covers.
    m, dims = active.shape
    children = np.empty((m << dims, dims), np.int64)
    center = np.empty(dims)
    kept = 0
    for i in range(m):
        for corner in range(1 << dims):
            for j in range(dims):
                children[kept, j] = 2 * active[i, j] + ((corner >> j) & 1)
                center[j] = (children[kept, j] + 0.5) / (2 * scale)
            home = _home(center, side, reach)
            if not _is_covered(center, 0.25 / scale, home, radius, near, grid):
                kept += 1
    return children[:kept]


@kernel
def _all_cells(side: int, dims: int) -> Array:
    # Integer coordinates (side^d, d) of the grid.
    active = np.empty((side**dims, dims), np.int64)
    for i in range(active.shape[0]):
        rest = i
        for j in range(dims):
            active[i, dims - 1 - j] = rest % side
            rest //= side
    return active


@kernel
def _throw_set(k0: Any, k1: Any, at: int, disks: Any, points: Array) -> tuple[int, int]:
    # Throw until `points` (n, d) are placed or none fits; return their number, and where the
    # random numbers go on.
    radius, side, reach, near, wrap, throws = disks
    n, dims = points.shape
    grid = np.full(((side + 2 * reach) ** dims, dims), _NOWHERE)
    active = _all_cells(side, dims)
    scale, placed = side, 0
    x = np.empty(dims)
    while active.shape[0] > 0 and scale < _FINEST:
        m = active.shape[0]
        for _ in range(throws * m):
            pick = int(mix_uniform(k0, k1, at) * m)
            for j in range(dims):
                x[j] = min((active[pick, j] + mix_uniform(k0, k1, at + 1 + j)) / scale, _BELOW_ONE)
            at += dims + 1
            home = _home(x, side, reach)
            if grid[home, 0] == _NOWHERE:
                if _is_covered(x, 0.0, home, radius, near, grid):
                    continue
                for j in range(dims):
                    points[placed, j] = x[j]
                _place(x, side, reach, wrap, grid)
                placed += 1
                if placed == n:
                    return placed, at
            # The cell has its point: take it off the list.
            m -= 1
            for j in range(dims):
                active[pick, j] = active[m, j]
            if m == 0:
                break
        active = _halved(active[:m], scale, side, reach, radius, near, grid)
        scale *= 2
    return placed, at


@kernel
def _throw_sets(keys: Array, disks: Any, attempts: int, out: Array) -> bool:
    # Fill out (R, n, d); False if a realisation jams in every attempt.
    n = out.shape[1]
    for r in range(out.shape[0]):
        at: Any = np.int64(0)  # a literal 0 would compile _throw_set twice
        placed, attempt = 0, 0
        while placed < n:
            if attempt == attempts:
                return False
            placed, at = _throw_set(keys[r, 0], keys[r, 1], at, disks, out[r])
            attempt += 1
    return True
