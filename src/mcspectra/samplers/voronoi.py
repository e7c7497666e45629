"""Points at the centroids of their cells on the 2-D torus: lloyd, bnot; the cost of transport.

Lloyd's method moves each point to the centroid of its Voronoi cell, again and again. Blue noise
through optimal transport does the same with the power diagram whose cells have equal areas: that is
a descent of the cost of transporting the uniform density to the points, of which the gradient by a
point is 2/n times its distance from the centroid of its cell [deGoes2012]_.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real, as_unit_points
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.samplers._descent import random_points, wrap
from mcspectra.samplers._power_diagram import Diagram, power_diagram
from mcspectra.samplers._power_weights import balance
from mcspectra.samplers.base import check_dims
from mcspectra.samplers.optimised import OptimisedSampler, check_sets

__all__ = ["Bnot", "Lloyd", "transport_cost"]

_NEWTON = 100  # steps at most: about 10 from random points, 2 or 3 after a move
_BALANCED = 1e-3  # of an area, while points still move
_EXACT = 1e-9  # the same for the cost, which errs by its square
_CLOSE = 1e-4  # the same where rounding is in the way: the cost is right to about 1e-6
_REPORTS = 50

Tessellation: TypeAlias = Callable[[Array], Diagram]


@final
@dataclass(frozen=True, kw_only=True)
class Lloyd(OptimisedSampler):
    """Points at the centroids of their Voronoi cells, by Lloyd's method (2-D torus).

    Any count.

    Attributes
    ----------
    dims
        2.
    iterations
        Largest number of moves of all points.
    tolerance
        The method stops at this distance of points from their centroids: root mean square, as a
        multiple of n^(−1/2).
    sets
        Reuse of sets, see `OptimisedSampler`.

    Notes
    -----
    The start is random, and the method does not depend on where the origin is: every point is
    uniform. Low frequencies are slow to go, since areas become equal by diffusion only: see bnot.

    References
    ----------
    Lloyd (1982), "Least squares quantization in PCM", doi 10.1109/TIT.1982.1056489.

    McCool, Fiume (1992), "Hierarchical Poisson disk sampling distributions",
    doi 10.20380/GI1992.12.
    """

    name: ClassVar[str] = "lloyd"
    max_dims: ClassVar[int | None] = 2
    dims: int = 2
    iterations: int = 100
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        _check(self)

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        def cells(points: Array) -> Diagram:
            return power_diagram(points, np.zeros(n))

        return _relax(self, random_points(keys, n, 2), cells, report)


@final
@dataclass(frozen=True, kw_only=True)
class Bnot(OptimisedSampler):
    """Blue noise through optimal transport: cells of equal areas around their centroids (2-D torus).

    Any count.

    Attributes
    ----------
    dims
        2.
    iterations
        Largest number of moves of all points.
    tolerance
        The method stops at this distance of points from the centroids of their cells: root mean
        square, as a multiple of n^(−1/2). Smaller values order the points into crystals.
    sets
        Reuse of sets, see `OptimisedSampler`.

    Notes
    -----
    The start is random, and the method does not depend on where the origin is: every point is
    uniform. The paper also jitters regions that have become regular; here descent ends before
    that. The capacity-constrained Voronoi tessellations of Balzer, Schlömer, Deussen (2009), which
    swap samples of the density between points, are the discrete forerunner of this method.

    References
    ----------
    de Goes, Breeden, Ostromoukhov, Desbrun (2012), "Blue noise through optimal transport",
    doi 10.1145/2366145.2366190.

    Balzer, Schlömer, Deussen (2009), "Capacity-constrained point distributions: a variant of
    Lloyd's method", doi 10.1145/1531326.1531392.
    """

    name: ClassVar[str] = "bnot"
    max_dims: ClassVar[int | None] = 2
    dims: int = 2
    iterations: int = 200
    tolerance: float = 0.01

    def __post_init__(self) -> None:
        _check(self)

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        weights, masses = np.zeros(n), np.full(n, 1.0 / n)

        def cells(points: Array) -> Diagram:
            weights[:], diagram = balance(points, weights, masses, _BALANCED, _NEWTON)
            return Diagram(*diagram)

        return _relax(self, random_points(keys, n, 2), cells, report)


def _relax(
    sampler: Lloyd | Bnot, points: Array, cells: Tessellation, report: Callable[[float], None]
) -> Array:
    """Move points to the centroids of their cells until they are near."""
    for i in range(sampler.iterations):
        if i % max(1, sampler.iterations // _REPORTS) == 0:
            report(i / sampler.iterations)
        offsets = cells(points).offsets
        if float(np.sum(offsets**2)) <= sampler.tolerance**2:
            break
        points = wrap(points + offsets)
    return points


def _check(sampler: Lloyd | Bnot) -> None:
    if sampler.dims != 2:
        raise ParameterError(
            f"{sampler.name}: dims is {sampler.dims!r}; it must be 2, "
            "for other dims use gaussian-blue-noise."
        )
    check_dims(sampler)
    check_sets(sampler)
    iterations = as_integer("iterations", sampler.iterations, least=1, most=10**6)
    object.__setattr__(sampler, "iterations", iterations)
    tolerance = as_real("tolerance", sampler.tolerance, least=0.0, most=1.0)
    object.__setattr__(sampler, "tolerance", tolerance)


def transport_cost(points: object) -> float:
    """Return the cost of transporting the uniform density to the points, equal masses at each.

    The least mean square distance on the torus, W₂², over all ways to share the unit square out
    equally; in 1-D by sorting, in 2-D by the power diagram with equal areas. n times the cost is
    1/6 for a square grid, 0.1604 (5/(18√3)) for a hexagonal one, which no set can beat.

    Parameters
    ----------
    points
        Points (n, 1) or (n, 2) in [0,1).

    Raises
    ------
    DomainError
        More than 2 dims, no points in [0,1), or points so far from uniform that Newton's method
        takes more than 100 steps; random ones take 10.

    References
    ----------
    Kitagawa, Mérigot, Thibert (2019), "Convergence of a Newton algorithm for semi-discrete optimal
    transport", doi 10.4171/JEMS/889.
    """
    x = as_unit_points(points)
    if x.ndim != 2 or x.shape[1] > 2:
        raise DomainError(
            f"points have shape {x.shape}; the transport cost is for one set, (n, 1) or (n, 2)."
        )
    return _cost_in_line(x[:, 0]) if x.shape[1] == 1 else _cost_in_plane(x)


def _cost_in_line(x: Array) -> float:
    """Intervals of 1/n in the order of the points, moved along the circle to where it costs least."""
    n = x.size
    distances = np.sort(x) - (np.arange(n) + 0.5) / n
    return float(distances.var() + 1.0 / (12.0 * n * n))


def _cost_in_plane(x: Array) -> float:
    sites, counts = np.unique(x, axis=0, return_counts=True)  # equal points share a cell
    masses = counts / len(x)
    weights, diagram = balance(sites, np.zeros(len(sites)), masses, _EXACT, _NEWTON)
    lacking = masses - diagram.areas
    if float(np.abs(lacking / masses).max()) > _CLOSE:
        raise DomainError(
            f"The transport cost was not found in {_NEWTON} Newton steps: the points are too far "
            "from uniform; transform them to be nearly uniform, or give fewer."
        )
    # The dual value: what areas lack counts at its price, so that errors are of second order
    return float(np.sum(diagram.moments) + np.sum(weights * lacking))
