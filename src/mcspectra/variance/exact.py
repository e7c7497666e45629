"""Exact variances of stratified and random sampling, by quadrature over strata.

For independent points u_j uniform in strata of equal volume, Var(I_n) = n^-2 Σ_j Var_j(g) with g
the primary-space integrand; random sampling is one stratum; a shared random offset δ of all strata
is averaged over: E_δ[Var | δ] + Var_δ(E | δ). Strata are cut at the discontinuities that the
integrand declares (`breaks`) and at the seam of the torus, more finely towards 0 and 1, where warps
have their singularities, and integrated by Gauss-Legendre or, for integrands that know their moments
over boxes, exactly. Two orders must agree, else NoClosedForm.
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
from mcspectra.estimators import AbstractEstimator, as_estimator
from mcspectra.integrands import Integrand
from mcspectra.samplers import (
    Jittered,
    LatinHypercube,
    Random,
    Randomized,
    Regular,
    Sampler,
    Shift,
    StrataShift,
    UniformJitter,
    as_sampler,
)

__all__ = ["exact_variance"]

_ORDERS = {1: (12, 20)}
_ORDERS_ELSE = (6, 10)
_TOLERANCE = 1e-6
_MAX_EVALUATIONS = 2**25


def _towards_ends(depth: int) -> tuple[float, ...]:
    return tuple(x for k in range(1, depth) for x in (0.5**k, 1.0 - 0.5**k))


# √u near 0 is integrated to 1e-6 with panels down to 2^-20; in 2-D every panel costs a row of them.
_GRADED = {1: _towards_ends(40), 2: _towards_ends(14)}


def exact_variance(
    estimator: AbstractEstimator | Integrand | str, sampler: Sampler | str, n: int
) -> Any:
    """Return the exact variance of an estimator, without sampling.

    Parameters
    ----------
    estimator, sampler, n
        Any estimator with one of: random, jittered, regular, uniform-jitter, each alone or with
        shift or strata-shift; latin-hypercube in 1-D.

    Returns
    -------
    float or ndarray
        The variance; an array (channels,) where f has several. Relative error about 1e-6 or less.

    Raises
    ------
    NoClosedForm
        Not known for this sampler, or the quadrature does not converge (discontinuities that are
        neither axis-aligned nor integrated in closed form).

    Examples
    --------
    >>> import mcspectra as mcs
    >>> variance = mcs.exact_variance(mcs.Estimator("linear", dims=1), "jittered", 4)
    >>> round(variance * 12 * 4**3, 9)
    1.0
    """
    estimator = as_estimator(estimator, getattr(sampler, "dims", None))
    source = as_sampler(sampler, estimator.dims)
    n = source.check_count(n)
    estimator.check_sampler(source, n)
    total: Any = 0.0
    for technique, count in enumerate(estimator.counts):
        g = estimator.primary_integrand(technique)
        low, high = (
            _variance(source, n * count, g, order) for order in _ORDERS.get(g.dims, _ORDERS_ELSE)
        )
        scale = np.abs(high) + (1e-14 * np.abs(g.integral)) ** 2 / _TOLERANCE
        if not np.all(np.abs(high - low) <= _TOLERANCE * scale):
            raise NoClosedForm(
                f"The stratum quadrature of {g.spec} does not converge ({np.max(low):.6g} against "
                f"{np.max(high):.6g}); use convergence or variance_terms."
            )
        total = total + high
    return total if estimator.channels else float(np.squeeze(total))


def _variance(sampler: Sampler, n: int, g: Integrand, order: int) -> Array:
    """Variance of the mean of g over a stratified set; (channels,) or (1,)."""
    base, offset, shifted = _decompose(sampler, g.dims)
    if isinstance(base, Random):
        return _spread_within_strata(g, (1,) * g.dims, np.zeros(g.dims), order) / n
    sides = (n,) if isinstance(base, LatinHypercube) else base.sides(n)
    jittered = isinstance(base, Jittered | LatinHypercube)
    if jittered and not shifted:
        return _spread_within_strata(g, sides, offset * n ** (-1.0 / g.dims), order) / n
    if not jittered and not (shifted or isinstance(base, UniformJitter)):
        return np.zeros(max(1, g.channels))  # a deterministic set
    nodes, weights = _offsets(g, sides, order)
    if jittered:
        spreads = np.stack([_spread_within_strata(g, sides, d, order) for d in nodes])
        return np.asarray(weights @ spreads) / n
    # A grid with one random offset: the variance of its mean over the offset
    means = np.stack([_grid_mean(g, sides, d) for d in nodes])
    return np.asarray(weights @ (means - weights @ means) ** 2)


def _decompose(sampler: Sampler, dims: int) -> tuple[Any, Array, bool]:
    """Return the base, its fixed offset in strata, and whether a random shift follows."""
    base, steps = (
        (sampler.base, sampler.steps) if isinstance(sampler, Randomized) else (sampler, ())
    )
    known = isinstance(base, Random | Jittered | Regular | UniformJitter)
    known = known or (isinstance(base, LatinHypercube) and dims == 1)
    if not known or not all(isinstance(step, Shift | StrataShift) for step in steps):
        raise NoClosedForm(
            f"No exact variance is known for {sampler.spec} in {dims} dims; "
            "use convergence or variance_terms."
        )
    offset = np.zeros(dims)
    for step in steps:
        if isinstance(step, StrataShift):
            offset = offset + np.asarray(step.offset, float)
    return base, offset % 1.0, any(isinstance(step, Shift) for step in steps)


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


def _spread_within_strata(g: Integrand, sides: tuple[int, ...], offset: Array, order: int) -> Array:
    """Mean over strata, displaced by `offset` on the torus, of the variance within one: (channels,)."""
    if math.prod(sides) > _MAX_EVALUATIONS:
        raise NoClosedForm(
            f"The quadrature of {math.prod(sides):.2g} strata would take more than "
            f"{_MAX_EVALUATIONS:.2g} evaluations; use convergence or variance_terms."
        )
    axes = _cut_axes(sides, offset, g.breaks)
    moments = _box_moments(g, axes)
    if moments is None:
        graded = _GRADED.get(g.dims, ())
        cuts = [(*b, *graded) for b in g.breaks]
        axes = _cut_axes(sides, offset, cuts)
        moments = _gauss_moments(g, axes, order)
    means, squares = (_gather(m, axes, sides) for m in moments)
    # Second pass about the stratum means would cost a second evaluation; clip what cancels.
    return np.asarray(np.maximum(squares - means * means, 0.0).mean(axis=0))


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
    if total > _MAX_EVALUATIONS:
        raise NoClosedForm(
            f"The stratum quadrature of {g.spec} would take {total:.2g} evaluations, more than "
            f"{_MAX_EVALUATIONS:.2g}; use convergence or variance_terms."
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


def _offsets(g: Integrand, sides: tuple[int, ...], order: int) -> tuple[Array, Array]:
    """Gauss nodes and weights for an offset uniform in one stratum, cut where breaks line up."""
    node, weight = np.polynomial.legendre.leggauss(order)
    per_axis = []
    for s, breaks in zip(sides, g.breaks, strict=True):
        side = 1.0 / s
        folded = [b % side for b in breaks]
        ends = np.unique([0.0, side, *(b for b in folded if 1e-14 < b < side - 1e-14)])
        low, width = ends[:-1, None], np.diff(ends)[:, None]
        nodes = (low + width * 0.5 * (node + 1.0)).ravel()
        per_axis.append((nodes, (width / side * 0.5 * weight).ravel()))
    combos = list(itertools.product(*(zip(*axis, strict=True) for axis in per_axis)))
    nodes = np.array([[x for x, _ in combo] for combo in combos])
    return nodes, np.array([np.prod([w for _, w in combo]) for combo in combos])


def _grid_mean(g: Integrand, sides: tuple[int, ...], offset: Array) -> Array:
    """Mean of g over the grid (j + offset·sides)/sides: (channels,)."""
    axes = [(np.arange(s) / s + o) % 1.0 for s, o in zip(sides, offset, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return np.asarray(g(x).reshape(math.prod(sides), -1).mean(axis=0))
