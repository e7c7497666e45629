"""Quadrature over strata: means of a function and of its square over each, and over shifted grids.

Strata are cut at the discontinuities that the integrand declares (`breaks`) and at the seam of the
torus, more finely towards 0 and 1, where warps have their singularities, and integrated by
Gauss-Legendre or, for integrands that know their moments over boxes, exactly.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm
from mcspectra.integrands import Integrand

__all__ = [
    "MAX_EVALUATIONS",
    "grid_mean",
    "grid_values",
    "offset_rule",
    "spread_within_strata",
    "stratum_moments",
]

MAX_EVALUATIONS = 2**25
"""Evaluations of an integrand beyond which a quadrature is refused."""


_LEAST_PANELS = 32  # of the whole axis, where offsets of few strata are integrated over


def _towards_ends(depth: int) -> tuple[float, ...]:
    return tuple(x for k in range(1, depth) for x in (0.5**k, 1.0 - 0.5**k))


# √u near 0 is integrated to 1e-6 with panels down to 2^-20; in 2-D every panel costs a row of them.
_GRADED = {1: _towards_ends(40), 2: _towards_ends(14)}


@dataclass(frozen=True)
class _Axis:
    """Pieces of one axis between strata borders and breaks: ends, stratum, share of the stratum."""

    low: Array
    high: Array
    stratum: Array
    share: Array

    @staticmethod
    def cut(sides: int, offset: float, breaks: tuple[float, ...]) -> _Axis:
        """Cut [0,1) at strata borders (j + offset)/sides, at `breaks` and at the seam 0."""
        borders = (np.arange(sides) / sides + offset) % 1.0
        inner = [b for b in breaks if 0 < b < 1]
        ends = np.unique(np.concatenate([[0.0, 1.0], borders, inner]))
        low, high = ends[:-1], ends[1:]
        wide = high - low > 1e-15
        low, high = low[wide], high[wide]
        stratum = np.floor((0.5 * (low + high) - offset) % 1.0 * sides).astype(np.int64)
        return _Axis(low, high, np.minimum(stratum, sides - 1), (high - low) * sides)


def spread_within_strata(g: Integrand, sides: tuple[int, ...], offset: Array, order: int) -> Array:
    """Mean over strata, displaced by `offset` on the torus, of the variance within one: (channels,)."""
    if math.prod(sides) > MAX_EVALUATIONS:
        raise NoClosedForm(
            f"The quadrature of {math.prod(sides):.2g} strata would take more than "
            f"{MAX_EVALUATIONS:.2g} evaluations; use convergence or variance_terms."
        )
    means, squares = stratum_moments(g, sides, offset, order)
    # Second pass about the stratum means would cost a second evaluation; clip what cancels.
    return np.asarray(np.maximum(squares - means * means, 0.0).mean(axis=0))


def stratum_moments(
    g: Integrand, sides: tuple[int, ...], offset: Array, order: int
) -> tuple[Array, Array]:
    """Means of g and g² over strata, displaced by `offset` on the torus: (strata, channels or 1)."""
    axes = _cut_axes(sides, offset, g.breaks)
    moments = _box_moments(g, axes)
    if moments is None:
        graded = _GRADED.get(g.dims, ())
        cuts = [(*b, *graded) for b in g.breaks]
        axes = _cut_axes(sides, offset, cuts)
        moments = _gauss_moments(g, axes, order)
    return _gather(moments[0], axes, sides), _gather(moments[1], axes, sides)


def _cut_axes(
    sides: tuple[int, ...], offset: Array, breaks: Sequence[tuple[float, ...]]
) -> list[_Axis]:
    return [_Axis.cut(s, float(o), b) for s, o, b in zip(sides, offset, breaks, strict=True)]


def _box_moments(g: Integrand, axes: list[_Axis]) -> tuple[Array, Array] | None:
    """Means of g and g² over all pieces from closed forms, if g has them: (pieces, channels)."""
    low = np.stack(np.meshgrid(*(a.low for a in axes), indexing="ij"), axis=-1)
    high = np.stack(np.meshgrid(*(a.high for a in axes), indexing="ij"), axis=-1)
    found = g.box_moments(low, high)
    if found is None:
        return None
    pieces = low[..., 0].size
    return found[0].reshape(pieces, -1), found[1].reshape(pieces, -1)


def _gauss_moments(g: Integrand, axes: list[_Axis], order: int) -> tuple[Array, Array]:
    """Means of g and g² over all pieces by a tensor Gauss-Legendre rule: (pieces, channels)."""
    dims, pieces = len(axes), [len(a.low) for a in axes]
    total = float(np.prod(pieces)) * order**dims
    if total > MAX_EVALUATIONS:
        raise NoClosedForm(
            f"The stratum quadrature of {g.spec} would take {total:.2g} evaluations, more than "
            f"{MAX_EVALUATIONS:.2g}; use convergence or variance_terms."
        )
    node, weight = np.polynomial.legendre.leggauss(order)
    node, weight = 0.5 * (node + 1.0), 0.5 * weight
    grids = [a.low[:, None] + (a.high - a.low)[:, None] * node for a in axes]
    mean: Any = 0.0
    square: Any = 0.0
    for q in itertools.product(range(order), repeat=dims):
        x = np.stack(
            np.meshgrid(*(grid[:, i] for grid, i in zip(grids, q, strict=True)), indexing="ij"),
            axis=-1,
        )
        values = g(x).reshape(int(np.prod(pieces)), -1)
        w = float(np.prod(weight[list(q)]))
        mean = mean + w * values
        square = square + w * values**2
    return mean, square


def _gather(piece_means: Array, axes: list[_Axis], sides: tuple[int, ...]) -> Array:
    """Means over strata from means over pieces: (strata, channels)."""
    values = piece_means.reshape(*(len(a.low) for a in axes), -1)
    for i, axis in enumerate(axes):
        shape = [1] * values.ndim
        shape[i] = -1
        gathered = np.zeros((*values.shape[:i], sides[i], *values.shape[i + 1 :]))
        where: Any = (slice(None),) * i + (axis.stratum,)
        np.add.at(gathered, where, values * axis.share.reshape(shape))
        values = gathered
    return np.asarray(values.reshape(math.prod(sides), -1))


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


def grid_mean(g: Integrand, sides: tuple[int, ...], offset: Array) -> Array:
    """Mean of g over the grid (j + offset·sides)/sides: (channels,)."""
    return np.asarray(grid_values(g, sides, offset).reshape(math.prod(sides), -1).mean(axis=0))


def grid_values(g: Integrand, sides: tuple[int, ...], offset: Array) -> Array:
    """Values of g on the grid (j + offset·sides)/sides: (*sides, channels or 1)."""
    axes = [(np.arange(s) / s + o) % 1.0 for s, o in zip(sides, offset, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return np.asarray(g(x)).reshape(*sides, -1)
