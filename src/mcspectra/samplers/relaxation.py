"""Points moved until they are spread evenly: Lloyd, bnot, Gaussian blue noise, farthest points.

Lloyd's method repeatedly moves each point to the centroid of its Voronoi cell.
Blue noise through optimal transport instead uses the power diagram whose cells have equal areas.
Moving the points lowers the cost of transporting the uniform density to the points.
The gradient for a point is 2/n times its distance from the centroid of its cell [deGoes2012]_.
Gaussian blue noise lowers an energy of pairs.
Farthest-point optimization moves each point to the place farthest from all others.
"""

from __future__ import annotations

import itertools
import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_unit_points, distinct_points
from mcspectra.core.errors import DomainError
from mcspectra.core.fields import real, whole
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.samplers import _cell_kernels as kernels
from mcspectra.samplers.base import PlaneSampler
from mcspectra.samplers.optimised import OptimisedSampler, Report, minimize, random_points, wrap

__all__ = [
    "Bnot",
    "FarthestPoint",
    "GaussianBlueNoise",
    "Lloyd",
    "near_energy",
    "relax",
    "series_energy",
    "transport_cost",
]

_NEWTON = 100  # largest number of Newton steps; random points take 10, moved points 2 or 3
_BALANCED = 1e-3  # allowed relative error of the cells' areas while points move
# Relative error of the cells' areas at which Newton's method stops for a transport cost.
# With areas accurate to 1e-9, the error of the transport cost is about (1e-9)²
_EXACT = 1e-9
# Largest accepted relative error of the areas if rounding prevents a smaller one.
# If the areas have this error, the transport cost has an error of 1e-6
_CLOSE = 1e-4
# Largest amount of work for a transport cost, in the unit of work that `kernels.Diagram` defines.
# The largest amount of work takes some seconds. For 8192 random points, 2^24 units are enough.
# If all points lie in one quarter of the square, more than 2^30 units of work are needed.
_MOST_WORK = 2**32
_REPORTS = 50
_CHUNK = 4096  # number of moves between reports of progress
_CUTOFF = 6.0  # cutoff distance of the Gaussian, in σ; its value there is exp(−18) = 1.5e-8
_SERIES_END = 6.0  # cutoff of the Fourier series in many dims: terms below e^(−½ 6²) are dropped
_CELLS = 4  # length of the cutoff distance, measured in cells of the grid


class _CentroidSampler(PlaneSampler, OptimisedSampler):
    """Abstract sampler that moves points until they are close to the centroids of their cells."""

    other_dims: ClassVar[str] = "for other dims use gaussian-blue-noise"
    iterations: int
    tolerance: float

    @abstractmethod
    def _offsets(self, n: int) -> Callable[[Array], Array]:
        """Return a function of `n` points: the vectors from points to centroids of their cells."""

    def _optimize(self, n: int, keys: Array, report: Report) -> Array:
        start, offsets = random_points(keys, n, 2), self._offsets(n)
        return relax(start, offsets, self.iterations, self.tolerance, report)


@final
@dataclass(frozen=True, kw_only=True)
class Lloyd(_CentroidSampler):
    """Points at the centroids of their Voronoi cells, by Lloyd's method (2-D torus).

    Any count.

    Attributes
    ----------
    dims
        2.
    iterations
        Largest number of moves of all points.
    tolerance
        Root-mean-square distance of points from their centroids at which the method stops.
        The unit is n^(−1/2).
    sets
        Largest number of different sets, see `OptimisedSampler`.

    Notes
    -----
    The start is random, and the method does not depend on the origin, so every point is uniform.
    The power at low frequencies falls slowly, because areas of cells equalize only by diffusion.
    The sampler bnot avoids this slow convergence.

    References
    ----------
    [Lloyd1982]_, [McCoolFiume1992]_.
    """

    iterations: int = whole(100, least=1, most=10**6)
    tolerance: float = real(0.0, least=0.0, most=1.0)

    def _offsets(self, n: int) -> Callable[[Array], Array]:
        return lambda points: kernels.power_diagram(points, np.zeros(n)).offsets


@final
@dataclass(frozen=True, kw_only=True)
class Bnot(_CentroidSampler):
    """Blue noise through optimal transport: cells of equal area around their centroids (2-D torus).

    Any count.

    Attributes
    ----------
    dims
        2.
    iterations
        Largest number of moves of all points.
    tolerance
        Root-mean-square distance between points and centroids at which the method stops.
        The unit is n^(−1/2).
        With smaller values, the points form regular patches like crystals.
    sets
        Largest number of different sets, see `OptimisedSampler`.

    Notes
    -----
    The start is random, and the method does not depend on the origin, so every point is uniform.
    The paper also jitters regions that have become regular; here the descent ends earlier instead.
    An earlier, discrete form is capacity-constrained Voronoi tessellation [Balzer2009]_.
    The discrete form assigns samples of the density to points, and swaps samples between points.

    References
    ----------
    [deGoes2012]_, [Balzer2009]_.
    """

    iterations: int = whole(200, least=1, most=10**6)
    tolerance: float = real(0.01, least=0.0, most=1.0)

    def _offsets(self, n: int) -> Callable[[Array], Array]:
        weights, masses = np.zeros(n), np.full(n, 1.0 / n)

        def offsets(points: Array) -> Array:
            weights[:], diagram = kernels.balance(points, weights, masses, _BALANCED, _NEWTON)
            return kernels.Diagram(*diagram).offsets

        return offsets


def relax(
    points: Array,
    offsets: Callable[[Array], Array],
    iterations: int,
    tolerance: float,
    report: Report,
) -> Array:
    """Move points by their offsets until the offsets are small, at most `iterations` times."""
    for i in range(iterations):
        if i % max(1, iterations // _REPORTS) == 0:
            report(i / iterations)
        moves = offsets(points)
        if float(np.sum(moves**2)) <= tolerance**2:
            break
        points = wrap(points + moves)
    return points


def transport_cost(points: object) -> float:
    """Return the cost of transporting the uniform density to the points, with equal masses.

    The unit square is partitioned into equal parts, one for each point, with the least cost.
    Each place in the square is transported to the point to whose part the place belongs.
    The cost W₂² is the mean squared distance of this transport on the torus.
    In 1-D the cost is computed by sorting, in 2-D by the power diagram with equal areas.
    A square grid has n · cost = 1/6. The lower bound is the cost of a hexagonal grid:
    n · cost = 0.1604 (5/(18√3)).

    Parameters
    ----------
    points
        Points (n, 1) or (n, 2) in [0,1).

    Raises
    ------
    DomainError
        If there are more than 2 dims, no points, or points outside [0,1).
        If the points are so uneven that Newton's method takes over 100 steps or some seconds.
        For uniform random points, Newton's method takes about 10 steps.

    References
    ----------
    [Kitagawa2019]_.
    """
    x = as_unit_points(points)
    if x.ndim != 2 or x.shape[1] > 2:
        raise DomainError(
            f"points have shape {x.shape}; the transport cost is for one set, (n, 1) or (n, 2)."
        )
    n = len(x)
    if x.shape[1] == 1:
        # Each point gets an interval of 1/n, in order; a shift along the circle minimizes the cost
        distances = np.sort(x[:, 0]) - (np.arange(n) + 0.5) / n
        return float(distances.var() + 1.0 / (12.0 * n * n))

    sites, _, counts = distinct_points(x)  # equal points share one cell
    masses = counts / n
    weights, diagram = kernels.balance(
        sites, np.zeros(len(sites)), masses, _EXACT, _NEWTON, _MOST_WORK
    )
    lacking = masses - diagram.areas
    if float(np.abs(lacking / masses).max()) > _CLOSE:
        raise DomainError(
            f"The transport cost was not found in {_NEWTON} Newton steps or some seconds: the "
            "points are too far from uniform; transform them to be nearly uniform, or give fewer."
        )
    # Add a correction: the missing area of each cell times its weight in the power diagram.
    # The corrected cost is the value of the dual transport problem.
    # The error of the corrected cost is of second order in the missing areas of the cells.
    return float(np.sum(diagram.moments) + np.sum(weights * lacking))


@final
@dataclass(frozen=True, kw_only=True)
class GaussianBlueNoise(OptimisedSampler):
    """Points of least energy Σ exp(−|x_i − x_k|²/(2σ²)) on the torus; any dims, any count.

    Attributes
    ----------
    sigma
        σ as a multiple of the mean distance n^(−1/d) between points.
        A larger σ removes more low frequencies and takes more iterations.
    iterations
        Largest number of descent steps.
    sets
        Largest number of different sets, see `OptimisedSampler`.

    Notes
    -----
    The paper uses gradient descent. Here limited-memory BFGS is used, which needs fewer steps.
    In up to 3 dims, pairs are cut off at 6 σ, and work grows like n.
    In more dims, all periodic images count, through the Fourier series of the Gaussian.
    In more than 3 dims, work grows like n².
    The start is random and the energy is invariant under translation, so every point is uniform.

    References
    ----------
    [Ahmed2022]_.
    """

    dims: int = DEFAULT_DIMS
    sigma: float = real(1.0, least=0.2, most=2.0)
    iterations: int = whole(400, least=1, most=10**6)

    def _optimize(self, n: int, keys: Array, report: Report) -> Array:
        spacing = n ** (-1.0 / self.dims)
        energy = near_energy if self.dims <= 3 else series_energy
        points = minimize(
            partial(energy, self.sigma * spacing),
            random_points(keys, n, self.dims),
            iterations=self.iterations,
            longest=spacing / 4,
            report=report,
        )
        return wrap(points)


def near_energy(sigma: float, points: Array) -> tuple[float, Array]:
    """Return energy and gradient in up to 3 dims, by cells."""
    n, dims = points.shape
    cells, offsets = _neighbor_cells(sigma, dims)
    padded, force = np.zeros((n, 3)), np.empty((n, 3))
    padded[:, :dims] = wrap(points)
    energy = kernels.near_energy(padded, cells, offsets, sigma, force)
    return energy, force[:, :dims].copy()


@lru_cache(maxsize=4)
def _neighbor_cells(sigma: float, dims: int) -> tuple[Array, Array]:
    """Return the number of cells along 3 axes, and the steps from a cell to neighboring cells.

    The first step is 0. Of two opposite steps, only one is returned.
    """
    reach = _CUTOFF * sigma
    side = max(1, min(int(_CELLS / reach), 1024))
    steps = math.ceil(reach * side)
    axes = [range(-steps, steps + 1) if j < dims else range(1) for j in range(3)]

    def gap(offset: tuple[int, ...]) -> float:
        """Return the smallest distance between two cells, in units of cells, from their offset."""
        return math.hypot(*(max(abs(step) - 1, 0) for step in offset))

    found = itertools.product(*axes)
    half = [offset for offset in found if offset >= (0, 0, 0) and gap(offset) < reach * side]
    return np.array([side] * dims + [1] * (3 - dims)), np.array(half)


def series_energy(sigma: float, points: Array) -> tuple[float, Array]:
    """Return energy (divided by its mean) and gradient in any dims, from the Fourier series."""
    orders = np.arange(1, max(2, math.ceil(_SERIES_END / (2 * math.pi * sigma))) + 1)
    weights = 2.0 * np.exp(-2.0 * (math.pi * sigma * orders) ** 2)
    force = np.empty(points.shape)
    return kernels.series_energy(points, weights, force), force


@final
@dataclass(frozen=True, kw_only=True)
class FarthestPoint(PlaneSampler, OptimisedSampler):
    """Farthest-point optimized points: minimum distance near the densest packing (2-D torus).

    The points start at random. Each point in turn moves to the center of the largest empty disk.
    The center of this disk is the place farthest from all other points.
    The minimum distance of the points never decreases.
    One sweep over n points takes O(n²) with a small constant: 1024 points and 30 sweeps take 2 s.

    Attributes
    ----------
    dims
        2.
    sweeps
        Largest number of moves of every point; the method ends earlier if no point moves.
        After 30 sweeps the minimum distance is about 0.92 times that of the hexagonal packing.

    References
    ----------
    [Schloemer2011]_.
    """

    other_dims: ClassVar[str] = "for other dims use best-candidate or dart-throwing"
    sweeps: int = whole(30, least=1, most=100_000)

    def _optimize(self, n: int, keys: Array, report: Report) -> Array:
        drawn = random_points(keys, n + 1, 2)
        points, offset = drawn[:n].copy(), drawn[n:]
        buckets, holes = kernels.measure_all(points)
        for sweep in range(self.sweeps):
            before = points.copy()
            for start in range(0, n, _CHUNK):
                report((sweep + start / n) / self.sweeps)
                stop = min(start + _CHUNK, n)
                kernels.move_points(start, stop, points, buckets, holes)
            if np.array_equal(points, before):
                break
        # With few points, some holes have equal size, and the choice depends on their positions
        return wrap(points + offset)
