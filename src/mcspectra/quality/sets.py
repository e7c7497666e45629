"""Exact quality figures of one point set: toroidal distances, discrepancies and diaphony.

Loops over pairs visit each pair of points once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer, as_unit_points, distinct_points
from mcspectra.core.errors import ParameterError
from mcspectra.core.jit import kernel

__all__ = [
    "as_set",
    "best_minimum_distance",
    "diaphony",
    "generalized_l2_discrepancy",
    "l2_discrepancy",
    "nearest_distances",
    "relative_minimum_distance",
    "star_discrepancy",
]

_MAX_PAIR_WORK = 2**27  # Largest n² d for loops over pairs: a second for 8192 points in 2-D
_TREE_DIMS = 6  # Largest number of dims for a k-d tree. In more dims it visits nearly all pairs
_TREE_POINTS = 2**21

_BEST_LATTICE = {
    # By number of dims: the largest possible minimum distance, with one point per unit volume
    1: 1.0,
    2: math.sqrt(2.0 / math.sqrt(3.0)),
    3: 2.0 ** (1.0 / 6.0),
    8: math.sqrt(2.0),
    24: 2.0,
}
_MOST_STAR_POINTS = 2**14  # Largest number of points in 2-D; it takes half a second
_SCIPY: Mapping[str, tuple[str, bool]] = {
    # For each kind of discrepancy: SciPy's name, and whether SciPy returns the square
    "star": ("L2-star", False),
    "centered": ("CD", True),
    "wraparound": ("WD", True),
    "mixture": ("MD", True),
}
_MEAN = math.pi**2 / 6.0


def as_set(points: object) -> Array:
    """Return one set (n, d), contiguous, after checking that it lies in the unit cube."""
    x = as_unit_points(points)
    if x.ndim != 2:
        raise ParameterError(f"points have shape {x.shape}; give one set, shape (n, d).")
    return np.ascontiguousarray(x)


def _check_pairs(x: Array) -> None:
    """Raise an error if a loop over all pairs of the set (n, d) would take long."""
    n, dims = x.shape
    most = math.isqrt(_MAX_PAIR_WORK // dims)
    if n > most:
        raise ParameterError(
            f"{n} points are too many for a figure over all pairs; in {dims} dims give at most "
            f"{most}."
        )


def nearest_distances(points: object) -> Array:
    """Return each point's toroidal distance to its nearest neighbor.

    Parameters
    ----------
    points
        One set of at least two points in [0,1), (n, d).

    Raises
    ------
    ParameterError
        If there is only one point, or if there are too many points:
        n > 2^21 in up to 6 dims, or n² d > 2^27 in 7 dims or more.
    """
    x = as_set(points)
    n, dims = x.shape
    if n < 2:
        raise ParameterError("One point has no neighbors; give at least two.")
    if dims > _TREE_DIMS:
        _check_pairs(x)
        return np.asarray(np.sqrt(_torus_nearest(x)))
    if n > _TREE_POINTS:
        raise ParameterError(f"{n} points are too many for distances; give at most {_TREE_POINTS}.")
    from scipy.spatial import cKDTree

    # Equal points have distance 0. Remove them, because a k-d tree would visit all their pairs
    sites, index, counts = distinct_points(x)
    distances = np.zeros(len(sites))
    if len(sites) > 1:
        found, _ = cKDTree(sites, boxsize=np.ones(dims)).query(sites, k=2)
        distances = np.where(counts > 1, 0.0, np.asarray(found)[:, 1])
    return np.asarray(distances[index])


@kernel
def _torus_nearest(x: Array) -> Array:
    """Return each point's squared toroidal distance to its nearest neighbor."""
    n, dims = x.shape
    nearest = np.full(n, np.inf)
    for i in range(n):
        for j in range(i):
            square = 0.0
            for k in range(dims):
                step = abs(x[i, k] - x[j, k])
                step = min(step, 1.0 - step)
                square += step * step
            nearest[i] = min(nearest[i], square)
            nearest[j] = min(nearest[j], square)
    return nearest


def best_minimum_distance(n: int, dims: int) -> float:
    """Return a proven upper bound of the minimum distance between `n` points on the torus.

    The bound is the minimum distance in the densest packing of spheres.
    The densest packings are equidistant points in 1-D and the hexagonal lattice in 2-D.
    In 3-D it is the face-centered cubic lattice [Hales2005]_.
    In 8-D it is the lattice E8 [Viazovska2017]_, and in 24-D the Leech lattice [Cohn2017]_.

    Raises
    ------
    ParameterError
        If the densest packing in `dims` dims is not known.
    """
    n = as_integer("n", n, least=1)
    if dims not in _BEST_LATTICE:
        raise ParameterError(
            f"The densest packing is proven in {', '.join(map(str, _BEST_LATTICE))} dims, "
            f"not in {dims}."
        )
    return float(_BEST_LATTICE[dims] * n ** (-1.0 / dims))


def relative_minimum_distance(points: object) -> float:
    """Return the minimum distance divided by its upper bound. The result is at most 1.

    The distance 1 between a point and its own periodic image also counts.
    """
    x = as_set(points)
    best = best_minimum_distance(*x.shape)
    return min(1.0, float(nearest_distances(x).min())) / best


def star_discrepancy(points: object) -> float:
    """Return D* = sup |share of points in [0,a) − volume of [0,a)|, exactly, in 1-D and 2-D.

    Parameters
    ----------
    points
        One set in [0,1), (n, d).

    Raises
    ------
    ParameterError
        If d > 2: exact algorithms take O(n^(1 + d/2)) and are not implemented.
        If n > 2^14 in 2-D.

    Notes
    -----
    The cost is O(n log n) in 1-D [Niederreiter1972]_ and O(n²) in 2-D [DeClerck1986]_.
    """
    x = as_set(points)
    n, dims = x.shape
    if dims == 1:
        ascending = np.sort(x[:, 0])
        middles = (np.arange(n) + 0.5) / n
        return float(0.5 / n + np.abs(ascending - middles).max())
    if dims > 2:
        raise ParameterError(
            f"The exact star discrepancy is computed in 1 and 2 dims only, not in {dims}."
        )
    if n > _MOST_STAR_POINTS:
        raise ParameterError(
            f"{n} points are too many for the star discrepancy; give at most {_MOST_STAR_POINTS}."
        )
    order = np.argsort(x[:, 0])
    return float(_star_discrepancy_2d(x[order, 0], x[order, 1]))


@kernel
def _star_discrepancy_2d(x: Array, y: Array) -> float:
    """Return the star discrepancy D* of the points (x_i, y_i), with x ascending.

    The supremum of |share of points − volume| is taken over boxes [0,a) × [0,b).
    The supremum is found by boxes whose sides a and b are coordinates of points, or 1.
    The grid of all pairs (a, b) is scanned column by column.
    For each column, the points to its left are sorted by y.
    """
    n = len(x)
    heights = np.empty(n + 2)
    heights[0], heights[1] = 0.0, 1.0
    worst = 0.0
    for column in range(n + 1):
        left = x[column - 1] if column else 0.0
        right = x[column] if column < n else 1.0
        if column:
            k = column
            heights[column + 1] = 1.0
            while heights[k - 1] > y[column - 1]:
                heights[k] = heights[k - 1]
                k -= 1
            heights[k] = y[column - 1]
        for k in range(column + 1):
            share = k / n
            worst = max(worst, share - left * heights[k], right * heights[k + 1] - share)
    return worst


def l2_discrepancy(points: object, kind: str = "star") -> float:
    """Return an L2 discrepancy of a set, computed by `scipy.stats.qmc.discrepancy`.

    Parameters
    ----------
    points
        One set in [0,1), (n, d).
    kind
        ``"star"``, ``"centered"``, ``"wraparound"`` [Hickernell1998]_ or ``"mixture"``.
        The definition of ``"mixture"`` is from [ZhouFangNing2013]_.
        The result is the discrepancy; SciPy returns its square for the last three kinds.

    Raises
    ------
    ParameterError
        If the kind is unknown, or n² d > 2^27.
    """
    from scipy.stats import qmc

    x = as_set(points)
    method, squared = _SCIPY[as_choice("kind", kind, tuple(_SCIPY))]
    _check_pairs(x)
    value = float(qmc.discrepancy(x, method=method))  # type: ignore[arg-type]
    return math.sqrt(max(value, 0.0)) if squared else value


def generalized_l2_discrepancy(points: object) -> float:
    """Return the L2 star discrepancy of a set, combined over all its projections.

    D² = (4/3)^d − 2/n Σ_i Π_k (3 − x_ik²)/2 + 1/n² Σ_ij Π_k (2 − max(x_ik, x_jk)).
    D² sums the squared L2 star discrepancies of the projections onto all sets of axes
    [Hickernell1998]_.

    Raises
    ------
    ParameterError
        If n² d > 2^27.
    """
    x = as_set(points)
    _check_pairs(x)
    n, dims = x.shape
    single = np.prod((3.0 - x * x) / 2.0, axis=1).sum()
    double = 2.0 * _generalized_l2_sum(x) + np.prod(2.0 - x, axis=1).sum()
    return math.sqrt(max(0.0, (4.0 / 3.0) ** dims - 2.0 * single / n + double / n**2))


@kernel
def _generalized_l2_sum(x: Array) -> float:
    """Return the sum over pairs i < j of Π(2 − max(x_ik, x_jk)) for points (n, d)."""
    n, dims = x.shape
    total = 0.0
    for i in range(n):
        row = 0.0
        for j in range(i):
            product = 1.0
            for k in range(dims):
                product *= 2.0 - max(x[i, k], x[j, k])
            row += product
        total += row
    return total


def diaphony(points: object) -> float:
    """Return the diaphony F [Zinterhof1976]_, which weights the spectrum by (Π_k max(1, |m_k|))^−2.

    F² = Σ_{m≠0} |S_m|² / Π_k max(1, m_k²) over all frequencies, with S_m = 1/n Σ_i exp(2πi m·x_i).
    The sum is computed over pairs of points, in closed form.
    Translations on the torus do not change F.
    The mean of F² over random sets is ((1 + π²/3)^d − 1) / n.

    Raises
    ------
    ParameterError
        If n² d > 2^27.
    """
    x = as_set(points)
    _check_pairs(x)
    n, dims = x.shape
    alone = (1.0 + math.pi**2 / 3.0) ** dims - 1.0
    return math.sqrt(max(0.0, alone / n + 2.0 * _diaphony_sum(x) / n**2))


@kernel
def _diaphony_sum(x: Array) -> float:
    """Return the sum over pairs i < j of Π(1 + 2π² B2({x_ik − x_jk})) − 1 for points (n, d)."""
    n, dims = x.shape
    total = 0.0
    for i in range(n):
        # Sum the terms of point i first, and then add the sums of all points.
        # A single sum of n² terms would accumulate more rounding errors
        row = 0.0
        for j in range(i):
            product = 1.0
            for k in range(dims):
                turn = 1.0 - 2.0 * abs(x[i, k] - x[j, k])
                product *= 1.0 - _MEAN + 3.0 * _MEAN * turn * turn
            row += product - 1.0
        total += row
    return total
