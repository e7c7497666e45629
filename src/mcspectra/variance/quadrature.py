"""Quadrature of primary-space integrands: means over strata and shifted grids, and ∫g².

Strata are cut at the discontinuities that the integrand declares (`breaks`) and at the seam of the
torus, more finely towards 0 and 1, where warps have their singularities, and integrated by
Gauss-Legendre or, for integrands that know their moments over boxes, exactly.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm
from mcspectra.densities.adaptive import positive_integral
from mcspectra.integrands import Integrand
from mcspectra.integrands._quadrature import probe
from mcspectra.integrands.base import Breaks, Derived, integral_accuracy, numeric_integral

__all__ = [
    "Pointwise",
    "blindness",
    "check_cells",
    "grid_values",
    "mean_square",
    "mesh",
    "offset_rule",
    "orders_of",
    "spread_within_strata",
    "square_integral",
    "stratum_moments",
]

_MOST_EVALUATIONS = 2**25  # of an integrand: beyond, a quadrature is refused
_AT_ONCE = 2**16  # evaluations, about: a call of an integrand may take milliseconds by itself
_ORDERS = ((12, 20), (6, 10), (4, 6))
_MANY = 400  # nets in 2-D have n² cells: 10² nodes in each of more are too many
_LEAST_PANELS = 32  # of the whole axis, where offsets of few strata are integrated over
_FEW_CELLS = 2**13  # of a level: enough for curves of jumps, and an eighth of the time
_SAME = 1e-9  # of √∫g²: a mean this near to an integral in closed form has seen all of g
_RESOLVED = 1e-10  # relative error of ∫g² above which g has jumps that boxes could not follow
_CENTER = 2**10  # points whose mean is subtracted before g is squared
_SUSPECT = 0.01  # relative error, beyond which there may be a pole, and all levels are worth it

# √u near 0 is integrated to 1e-6 with panels down to 2^-20; in 2-D every panel costs a row of them.
_GRADED = {
    dims: tuple(x for k in range(1, depth) for x in (0.5**k, 1.0 - 0.5**k))
    for dims, depth in ((1, 40), (2, 14))
}


@final
@dataclass(frozen=True, eq=False)
class Pointwise(Derived):
    """What is made of an integrand point by point."""

    name: ClassVar[str] = "pointwise"
    text = "{0.label}"
    integrand: Integrand
    values: Callable[[Array], Array]  # of points
    cuts: Breaks
    label: str

    @property
    def breaks(self) -> Breaks:
        return self.cuts

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(self.values(x))

    def _integral(self) -> None:
        return None


@final
@dataclass(frozen=True, eq=False)
class _Moments(Derived):
    """g − a and (g − a)², channel by channel."""

    name: ClassVar[str] = "moments"
    text = "moments of {0.integrand.spec}"
    integrand: Integrand
    middle: Array

    @property
    def channels(self) -> int:  # type: ignore[override]
        return 2 * len(self.middle)

    def _evaluate(self, x: Array) -> Array:
        centered = self.integrand(x).reshape(*x.shape[:-1], -1) - self.middle
        with np.errstate(over="ignore"):  # next to a pole
            return np.concatenate([centered, centered**2], axis=-1)

    def _integral(self) -> None:
        return None


def blindness(g: Integrand, means: Array, squares: Array) -> Array:
    """How far a rule's ∫g and ∫g² are off, as a variance: (channels,).

    Parameters
    ----------
    g
        The integrand.
    means, squares
        Means of g and g² over equal parts of the cube by that rule, (parts, channels).

    Returns
    -------
    ndarray
        0 where the sums agree with integrals by a rule that looks for what nodes miss
        (`mcspectra.integrands._quadrature.adaptive_integral`), and it resolves g; or, where ∫g is
        known in closed form, with that. Else the difference, and the error of the integrals.
    """
    mean, square = means.mean(axis=0), squares.mean(axis=0)
    exact = g._integral()
    if g.box_moments(np.zeros((1, g.dims)), np.ones((1, g.dims))) is not None:
        return np.zeros(mean.shape)
    if exact is not None and (np.abs(mean - exact) <= _SAME * np.sqrt(square)).all():
        return np.zeros(mean.shape)
    if "_moments" not in g.__dict__:
        middle = g(probe(g.dims)[:_CENTER]).reshape(_CENTER, -1).mean(axis=0)
        both = _Moments(g, middle)
        known = np.split(numeric_integral(both), 2)
        g.__dict__["_moments"] = middle, known, integral_accuracy(both)[1]
    middle, (first, second), error = g.__dict__["_moments"]
    rounding = 1e-14 * (square + middle**2)
    off = np.abs(mean - middle - first) - error - rounding
    square_off = np.abs(square - 2.0 * middle * mean + middle**2 - second) - error - rounding
    largest = np.abs(means - middle).max(axis=0)
    missed = np.maximum(square_off, 0.0) + 2.0 * largest * np.maximum(off, 0.0)
    # Integrals that are not resolved can hide as much as their error
    return np.asarray(missed + np.where(error > _RESOLVED * second, error, 0.0))


def orders_of(cells: int, dims: int) -> tuple[int, int]:
    """Orders of two rules to compare; in 2-D and up lower, and for many cells lower still."""
    return _ORDERS[0] if dims == 1 else _ORDERS[1] if cells < _MANY else _ORDERS[2]


def check_cells(what: str, cells: float, unit: str = "cells") -> None:
    """Refuse what would take too many evaluations of an integrand; `what` begins the sentence."""
    if cells > _MOST_EVALUATIONS:
        raise NoClosedForm(
            f"{what} would take {cells:.2g} {unit}, more than {_MOST_EVALUATIONS:.2g}; use "
            "convergence or variance_terms."
        )


def mesh(*axes: Array) -> Array:
    """All points of a grid with these coordinates along the axes: (…, d)."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def spread_within_strata(
    g: Integrand, sides: tuple[int, ...], offset: Array, order: int
) -> tuple[Array, Array]:
    """Mean over strata, displaced by `offset` on the torus, of the variance within one: (channels,).

    And its `blindness`.
    """
    check_cells(f"The quadrature of the strata of {g.spec}", float(math.prod(sides)), "evaluations")
    means, squares = stratum_moments(g, sides, offset, order)
    # Second pass about the stratum means would cost a second evaluation; clip what cancels.
    spread = np.maximum(squares - means * means, 0.0).mean(axis=0)
    return np.asarray(spread), blindness(g, means, squares)


def stratum_moments(
    g: Integrand, sides: tuple[int, ...], offset: Array, order: int
) -> tuple[Array, Array]:
    """Means of g and g² over strata, displaced by `offset` on the torus: (strata, channels or 1)."""

    def cut(graded: tuple[float, ...] = ()) -> list[tuple[Array, Array]]:
        """Ends of the pieces between strata borders (j + offset)/sides, breaks and the seam 0."""
        axes = []
        for s, displaced, breaks in zip(sides, map(float, offset), g.breaks, strict=True):
            borders = (np.arange(s) / s + displaced) % 1.0
            inner = [b for b in (*breaks, *graded) if 0 < b < 1]
            ends = np.unique(np.concatenate([[0.0, 1.0], borders, inner]))
            wide = np.diff(ends) > 1e-15
            axes.append((ends[:-1][wide], ends[1:][wide]))
        return axes

    # Means over all pieces from closed forms, if g has them, else by a tensor Gauss-Legendre rule
    axes = cut()
    moments = g.box_moments(mesh(*(low for low, _ in axes)), mesh(*(high for _, high in axes)))
    if moments is None:
        axes = cut(_GRADED.get(g.dims, ()))
        pieces = math.prod(len(low) for low, _ in axes)
        check_cells(
            f"The stratum quadrature of {g.spec}", float(pieces) * order**g.dims, "evaluations"
        )
        node, weight = np.polynomial.legendre.leggauss(order)
        node, weight = 0.5 * (node + 1.0), 0.5 * weight
        grids = [low[:, None] + (high - low)[:, None] * node for low, high in axes]
        mean: Any = 0.0
        square: Any = 0.0
        nodes = list(itertools.product(range(order), repeat=g.dims))
        step = max(1, _AT_ONCE // pieces)
        for some in (nodes[start : start + step] for start in range(0, len(nodes), step)):
            x = [mesh(*(grid[:, i] for grid, i in zip(grids, q, strict=True))) for q in some]
            for q, values in zip(some, g(np.stack(x)).reshape(len(some), pieces, -1), strict=True):
                w = float(np.prod(weight[list(q)]))
                mean = mean + w * values
                square = square + w * values**2
        moments = mean, square

    # Means over strata: pieces count by their share of the stratum, an axis after the other
    both = np.stack([m.reshape(*(len(low) for low, _ in axes), -1) for m in moments])
    for i, (low, high) in enumerate(axes):
        middle = (0.5 * (low + high) - float(offset[i])) % 1.0
        stratum = np.minimum(np.floor(middle * sides[i]).astype(np.int64), sides[i] - 1)
        share = ((high - low) * sides[i]).reshape(-1, *(1,) * (g.dims - i))
        gathered = np.zeros((*both.shape[: i + 1], sides[i], *both.shape[i + 2 :]))
        where: Any = (slice(None),) * (i + 1) + (stratum,)
        np.add.at(gathered, where, both * share)
        both = gathered
    means, squares = both.reshape(2, math.prod(sides), -1)
    return means, squares


def offset_rule(g: Integrand, sides: tuple[int, ...], order: int) -> tuple[Array, Array]:
    """Gauss nodes and weights for an offset uniform in one stratum, cut where breaks line up."""
    node, weight = np.polynomial.legendre.leggauss(order)
    per_axis = []
    for s, breaks in zip(sides, g.breaks, strict=True):
        side = 1.0 / s
        folded = [b % side for b in breaks]
        panels = max(1, _LEAST_PANELS // s) if g.dims == 1 else 1
        cuts = [*folded, *(np.arange(1, panels) / panels * side)]
        ends = np.unique([0.0, side, *(b for b in cuts if 1e-14 < b < side - 1e-14)])
        low, width = ends[:-1, None], np.diff(ends)[:, None]
        nodes = (low + width * 0.5 * (node + 1.0)).ravel()
        per_axis.append((nodes, (width / side * 0.5 * weight).ravel()))
    combos = list(itertools.product(*(zip(*axis, strict=True) for axis in per_axis)))
    nodes = np.array([[x for x, _ in combo] for combo in combos])
    return nodes, np.array([np.prod([w for _, w in combo]) for combo in combos])


def grid_values(g: Integrand, sides: tuple[int, ...], offset: Array) -> Array:
    """Values of g on the grid (j + offset·sides)/sides: (*sides, channels or 1)."""
    x = mesh(*((np.arange(s) / s + o) % 1.0 for s, o in zip(sides, offset, strict=True)))
    return np.asarray(g(x)).reshape(*sides, -1)


def mean_square(g: Integrand) -> Array:
    """∫g², (channels or 1,); infinite where it diverges."""
    return square_integral(g)[0]


def square_integral(g: Integrand) -> tuple[Array, Array]:
    """∫g² and an estimate of its absolute error, both (channels or 1,).

    Boxes cut at the breaks of g; in 1-D and 2-D also quadrature that records how much each level
    leaves unresolved (`mcspectra.densities.adaptive`): the integral is infinite where that does not
    shrink, else the smaller error counts. Boxes alone do not see a divergence: rounding of T(u)
    stops it somewhere. In more dims it shows as a large error at best. Kept with g, as all counts
    and samplers ask for it.
    """
    if "_square" not in g.__dict__:
        g.__dict__["_square"] = _square_integral(g)
    known: tuple[Array, Array] = g.__dict__["_square"]
    return known


def _square_integral(g: Integrand) -> tuple[Array, Array]:
    found = g.box_moments(np.zeros((1, g.dims)), np.ones((1, g.dims)))
    if found is not None:
        exact = np.asarray(found[1], float).reshape(-1)
        return exact, np.zeros(exact.shape)

    def square(x: Array) -> Array:
        with np.errstate(over="ignore"):  # next to a pole
            return np.asarray(g(x) ** 2)

    # By quadrature that records what each level leaves unresolved
    by_levels = np.full(max(1, g.channels), np.nan)
    level_errors = np.full(by_levels.shape, np.inf)
    for c in range(len(by_levels) if g.dims <= 2 else 0):

        def of_channel(x: Array, c: int = c) -> Array:
            return np.asarray(square(x).reshape(*x.shape[:-1], -1)[..., c])

        found_c = positive_integral(of_channel, g.dims, most_cells=_FEW_CELLS)
        if found_c[1] > _SUSPECT * found_c[0]:
            found_c = positive_integral(of_channel, g.dims)
        by_levels[c], level_errors[c] = found_c
    if np.isinf(by_levels).all():
        return by_levels, level_errors

    # By boxes
    squared = Pointwise(g, square, g.breaks, f"square of {g.spec}")
    value = np.atleast_1d(np.asarray(numeric_integral(squared), float))
    error = np.full(value.shape, integral_accuracy(squared)[1])
    full = by_levels >= value - level_errors - error  # levels miss slabs, boxes the ends of poles
    better = (level_errors < error) & full | np.isinf(by_levels)
    return np.where(better, by_levels, value), np.where(better, level_errors, error)
