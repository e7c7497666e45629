"""Discrepancies and diaphony: how far a set is from uniform, exactly."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mcspectra.core.checks import as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.quality._kernels import diaphony_sum, generalized_l2_sum, star_discrepancy_2d
from mcspectra.quality.distances import as_set, check_pairs

__all__ = ["diaphony", "generalized_l2_discrepancy", "l2_discrepancy", "star_discrepancy"]

_MOST_STAR_POINTS = 2**14  # half a second in 2-D
_SCIPY: Mapping[str, tuple[str, bool]] = {
    # kind: SciPy's name, and whether it returns the square
    "star": ("L2-star", False),
    "centered": ("CD", True),
    "wraparound": ("WD", True),
    "mixture": ("MD", True),
}


def star_discrepancy(points: object) -> float:
    """Return D* = sup |share of points in [0,a) − volume of [0,a)|, exactly, in 1-D and 2-D.

    Parameters
    ----------
    points
        One set, (n, d), in [0,1).

    Raises
    ------
    ParameterError
        More than 2 dims (exact algorithms take O(n^(1 + d/2)) and are not built in), or more than 2^14 points in 2-D.

    Notes
    -----
    Cost O(n log n) in 1-D, O(n²) in 2-D.

    References
    ----------
    Niederreiter (1972), "Discrepancy and convex programming", Annali di Matematica 93,
    doi 10.1007/BF02412017 (1-D). De Clerck (1986), "A method for exact calculation of the
    stardiscrepancy of plane sets applied to the sequences of Hammersley", Monatshefte für
    Mathematik 101, doi 10.1007/BF01301660.
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
    return float(star_discrepancy_2d(x[order, 0], x[order, 1]))


def l2_discrepancy(points: object, kind: str = "star") -> float:
    """Return an L2 discrepancy of a set, through `scipy.stats.qmc.discrepancy`.

    Parameters
    ----------
    points
        One set, (n, d), in [0,1).
    kind
        ``"star"``, ``"centered"``, ``"wraparound"`` or ``"mixture"``. The square root is taken
        of all, where SciPy returns squares of the last three.

    Raises
    ------
    ParameterError
        Unknown kind, or n² d > 2^27.

    References
    ----------
    Hickernell (1998), "A generalized discrepancy and quadrature error bound", Mathematics of
    Computation 67, doi 10.1090/S0025-5718-98-00894-1. Zhou, Fang, Ning (2013), "Mixture
    discrepancy for quasi-random point sets", Journal of Complexity 29,
    doi 10.1016/j.jco.2012.11.006.
    """
    from scipy.stats import qmc

    x = as_set(points)
    method, squared = _SCIPY[as_choice("kind", kind, tuple(_SCIPY))]
    check_pairs(x)
    value = float(qmc.discrepancy(x, method=method))  # type: ignore[arg-type]
    return math.sqrt(max(value, 0.0)) if squared else value


def generalized_l2_discrepancy(points: object) -> float:
    """Return the L2 star discrepancy over all projections together.

    D² = (4/3)^d − 2/n Σ_i Π_k (3 − x_ik²)/2 + 1/n² Σ_ij Π_k (2 − max(x_ik, x_jk)), the sum of the
    squared L2 star discrepancies of the projections on all sets of axes.

    Raises
    ------
    ParameterError
        n² d > 2^27.

    References
    ----------
    Hickernell (1998), "A generalized discrepancy and quadrature error bound", Mathematics of
    Computation 67, doi 10.1090/S0025-5718-98-00894-1.
    """
    x = as_set(points)
    check_pairs(x)
    n, dims = x.shape
    single = np.prod((3.0 - x * x) / 2.0, axis=1).sum()
    double = 2.0 * generalized_l2_sum(x) + np.prod(2.0 - x, axis=1).sum()
    return math.sqrt(max(0.0, (4.0 / 3.0) ** dims - 2.0 * single / n + double / n**2))


def diaphony(points: object) -> float:
    """Return the diaphony F: the power spectrum weighted by (Π_k max(1, |m_k|))^−2.

    F² = Σ_{m≠0} |S_m|² / Π_k max(1, m_k²) over all frequencies, S_m = 1/n Σ_i exp(2πi m·x_i),
    summed in closed form over pairs. It does not change when the set is moved on the torus; the
    mean of F² over random sets is ((1 + π²/3)^d − 1) / n.

    Raises
    ------
    ParameterError
        n² d > 2^27.

    References
    ----------
    Zinterhof (1976), "Über einige Abschätzungen bei der Approximation von Funktionen mit
    Gleichverteilungsmethoden", Sitzungsberichte der Österreichischen Akademie der Wissenschaften,
    mathematisch-naturwissenschaftliche Klasse II 185.
    """
    x = as_set(points)
    check_pairs(x)
    n, dims = x.shape
    alone = (1.0 + math.pi**2 / 3.0) ** dims - 1.0
    return math.sqrt(max(0.0, alone / n + 2.0 * diaphony_sum(x) / n**2))
