"""Projective blue noise: points keep a distance in the domain and in all projections on axes.

Method
------
Dart throwing: a dart is accepted if it is far enough from all earlier points in all projections.
For each k from 1 to d, the distance in every projection on k of the d axes must be at least r_k.
Let g_1 ≤ … ≤ g_d be the sorted gaps of two points along the axes.
Of all projections on k axes, the one on the axes of the k smallest gaps has the least distance.
Therefore d conditions on partial sums, g_1² + … + g_k² ≥ r_k², check all 2^d − 1 projections.

The projections on single axes reject most darts, but the coordinates of darts are independent.
Each coordinate is therefore redrawn until it is at least r_1 away from all earlier coordinates.
The projections on two or more axes are checked afterwards.
Checking in this order saves time and does not change the distribution of the points.
On the torus the law is invariant under translation, so every point is uniform.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.fields import real
from mcspectra.core.jit import kernel
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream, mix_uniform
from mcspectra.samplers.base import Sampler, Structure
from mcspectra.samplers.law import Law, Stationary
from mcspectra.samplers.poisson import densest_distance, thrown

__all__ = ["ProjectiveBlueNoise"]

_DEFAULT_RADIUS = (0.65, 0.6, 0.5, 0.4, 0.33, 0.25)
# Smallest allowed radius. The kernel divides each axis into cells about as wide as the radius.
_LEAST_RADIUS = 0.01
_TRIALS = 10_000  # largest number of rejected darts in a row
_DRAWS = 500  # largest number of draws of a coordinate before a dart is rejected


@final
@dataclass(frozen=True, kw_only=True)
class ProjectiveBlueNoise(Sampler):
    """Random points with a minimum distance in every projection on axes (dart throwing, toroidal).

    Attributes
    ----------
    dims
        Number of dims, 1 to 6.
    radius_
        Minimum distance in every projection on k axes, from 0.01 to 1.
        The unit is the distance in the densest known packing of n points in k dims.
        The default is 0.65, 0.6, 0.5, 0.4, 0.33 and 0.25 in 1 to 6 dims.
        With slightly larger values, dart throwing could not place 1000 points any more.

    References
    ----------
    [Reinert2016]_
    """

    structure: ClassVar[Structure] = Structure.TORUS
    max_dims: ClassVar[int | None] = 6
    max_count: ClassVar[int] = 2**12  # the time grows at least as n²
    dims: int = DEFAULT_DIMS
    radius_: float | None = real(None, least=_LEAST_RADIUS, most=1.0)

    def radii(self, n: int) -> tuple[float, ...]:
        """Return the minimum distances of n points in projections on 1 to d axes."""
        count = self.check_count(n)
        relative = _DEFAULT_RADIUS[self.dims - 1] if self.radius_ is None else self.radius_
        return tuple(relative * densest_distance(count, k) for k in range(1, self.dims + 1))

    def _law(self, n: int) -> Law:
        return Stationary(n=n, dims=self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        limits = np.square(self.radii(n))
        attempts = 3 + 100 // n  # with few points, failures by chance are frequent
        throw, some = partial(_throw_set, limits), f" with {_TRIALS} darts; give a smaller radius."
        return thrown(throw, self, n, stream.keys(first, count), attempts, some)


@kernel
def _free_coordinate(
    k0: Any, k1: Any, at: int, radius: float, column: Array, cells: Array
) -> tuple[float, int]:
    # Draw x until no point is nearer than `radius` on this axis; −1 after too many draws.
    # `cells` has the number of the point in each cell of the axis, −1 if there is none.
    # A cell is at most as large as the radius, and larger than half the radius.
    side = cells.size
    for _ in range(_DRAWS):
        x = mix_uniform(k0, k1, at)
        at += 1
        home, free = int(x * side), True
        for c in range(home - 2, home + 3):
            i = cells[c % side]
            if i >= 0:
                gap = abs(column[i] - x)
                free = free and min(gap, 1.0 - gap) >= radius
        if free:
            return x, at
    return -1.0, at


@kernel
def _is_apart(x: Array, y: Array, limits: Array, gaps: Array) -> bool:
    # Return whether the squared distances of x and y are at least `limits` in all projections.
    for j in range(x.size):
        gap = abs(x[j] - y[j])
        gap = min(gap, 1.0 - gap)
        k = j
        while k > 0 and gaps[k - 1] > gap:
            gaps[k] = gaps[k - 1]
            k -= 1
        gaps[k] = gap
    total = 0.0
    for j in range(x.size):
        total += gaps[j] * gaps[j]
        if total < limits[j]:
            return False
    return True


@kernel
def _throw_set(limits: Array, k0: Any, k1: Any, at: int, points: Array) -> tuple[int, int]:
    # Throw darts until all points (n, d) are placed or _TRIALS in a row are rejected.
    n, dims = points.shape
    radius = np.sqrt(limits[0])
    cells, gaps = np.full((dims, int(np.ceil(1.0 / radius))), -1), np.empty(dims)
    placed, missed = 0, 0
    while placed < n and missed < _TRIALS:
        x = points[placed]
        apart = True
        for j in range(dims):
            x[j], at = _free_coordinate(k0, k1, at, radius, points[:, j], cells[j])
            apart = apart and x[j] >= 0.0
        i = 0
        while apart and i < placed:
            apart = _is_apart(x, points[i], limits, gaps)
            i += 1
        missed += 1
        if apart:
            for j in range(dims):
                cells[j, int(x[j] * cells.shape[1])] = placed
            placed += 1
            missed = 0
    return placed, at
