"""Distances between the points of a set on the torus."""

from __future__ import annotations

import math

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_unit_points
from mcspectra.core.errors import ParameterError
from mcspectra.quality._kernels import torus_nearest

__all__ = [
    "as_set",
    "best_minimum_distance",
    "check_pairs",
    "nearest_distances",
    "relative_minimum_distance",
]

MAX_PAIR_WORK = 2**27
"""Most n² d of figures that visit all pairs: a second or so, 8192 points in 2-D."""

_TREE_DIMS = 6  # in more dims a tree visits nearly all pairs
_TREE_POINTS = 2**21

_BEST_LATTICE = {
    # dims: minimum distance of the densest packing with one point a unit volume
    1: 1.0,
    2: math.sqrt(2.0 / math.sqrt(3.0)),
    3: 2.0 ** (1.0 / 6.0),
    8: math.sqrt(2.0),
    24: 2.0,
}


def nearest_distances(points: object) -> Array:
    """Return each point's toroidal distance to its nearest neighbour.

    Parameters
    ----------
    points
        One set of at least two points, (n, d), in [0,1).

    Raises
    ------
    ParameterError
        One point only, or more work than a second or so: n > 2^21, or n² d > 2^27 from 7 dims on.
    """
    x = as_set(points)
    n, dims = x.shape
    if n < 2:
        raise ParameterError("One point has no neighbours; give at least two.")
    if dims > _TREE_DIMS:
        check_pairs(x)
        return np.asarray(np.sqrt(torus_nearest(x)))
    if n > _TREE_POINTS:
        raise ParameterError(f"{n} points are too many for distances; give at most {_TREE_POINTS}.")
    from scipy.spatial import cKDTree

    distances, _ = cKDTree(x, boxsize=np.ones(dims)).query(x, k=2)
    return np.array(np.asarray(distances)[:, 1])


def best_minimum_distance(n: int, dims: int) -> float:
    """Return the minimum distance that no `n` points on the torus exceed, where that is proven.

    It is that of the densest packing of balls: points of equal distance in 1-D, the hexagonal
    lattice in 2-D, face-centred cubic in 3-D, E8 and the Leech lattice in 8-D and 24-D.

    Raises
    ------
    ParameterError
        The densest packing in `dims` dims is not known.

    References
    ----------
    Hales (2005), "A proof of the Kepler conjecture", Annals of Mathematics 162,
    doi 10.4007/annals.2005.162.1065. Viazovska (2017), "The sphere packing problem in dimension
    8", Annals of Mathematics 185, doi 10.4007/annals.2017.185.3.7. Cohn, Kumar, Miller,
    Radchenko, Viazovska (2017), "The sphere packing problem in dimension 24", Annals of
    Mathematics 185, doi 10.4007/annals.2017.185.3.8.
    """
    n = as_integer("n", n, least=1)
    if dims not in _BEST_LATTICE:
        raise ParameterError(
            f"The densest packing is proven in {', '.join(map(str, _BEST_LATTICE))} dims, "
            f"not in {dims}."
        )
    return float(_BEST_LATTICE[dims] * n ** (-1.0 / dims))


def relative_minimum_distance(points: object) -> float:
    """Return the minimum distance over the best possible one (at most 1).

    A point's own images count too: they are 1 apart.
    """
    x = as_set(points)
    best = best_minimum_distance(*x.shape)
    return min(1.0, float(nearest_distances(x).min())) / best


def as_set(points: object) -> Array:
    """Return one set (n, d), contiguous, after checking that it lies in the unit cube."""
    x = as_unit_points(points)
    if x.ndim != 2:
        raise ParameterError(f"points have shape {x.shape}; give one set, shape (n, d).")
    return np.ascontiguousarray(x)


def check_pairs(x: Array) -> None:
    """Refuse sets (n, d) whose pairs take long to visit."""
    n, dims = x.shape
    most = math.isqrt(MAX_PAIR_WORK // dims)
    if n > most:
        raise ParameterError(
            f"{n} points are too many for a figure of all pairs; in {dims} dims give at most {most}."
        )
