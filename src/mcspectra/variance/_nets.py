"""Exact variances of sets that are known on a grid of cells: scrambled nets, Latin hypercubes.

* Nested uniform scrambling [Owen1997]_: Var = (1/n) Σ_l Γ_l σ²_l. Once the coordinates of all points
  differ within L digits of each axis, the levels beyond L have Γ_l = 1, so that with ω² the mean over
  cells of b^-L to a side of the variance within one,

      Var = (1/n) [ω² + Σ_{0 < l ≤ L} Γ_l σ²_l],

  a finite sum of squares. σ²_l follows from the means of the cells.
* Digital shift in base 2, coordinates whole multiples of 2^-L: the shift is one of L bits and, below
  them, an offset δ uniform in a cell that all points share. For given δ the values of g over the grid
  have a Walsh spectrum ĝ_m(δ), the points ŝ_m = (1/n) Σ_k wal_m(x_k), of which |ŝ_m|² is 1 on the dual
  net and 0 elsewhere for digital nets, and

      Var = E_δ [Σ_{m ≠ 0} ĝ_m² ŝ_m²] + Var_δ ĝ_0.
* Latin hypercubes: on each axis two points are in different ones of n strata. With ω² the mean variance
  within n^d cells and σ²_v the ANOVA parts of the means of the cells, v a subset of the axes,

      Var = (1/n) [ω² + Σ_{v ≠ ∅} (1 + (n − 1) (−1/(n − 1))^|v|) σ²_v],

  without what varies along single axes from stratum to stratum [Stein1987]_.
"""

from __future__ import annotations

import math

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.integrands import Integrand
from mcspectra.samplers import Randomized, Sampler
from mcspectra.spectra.gain import gain_coefficients
from mcspectra.variance._strata import (
    MAX_EVALUATIONS,
    grid_values,
    offset_rule,
    stratum_moments,
)

__all__ = ["level_variances", "net_variance", "scrambling"]

_KEEP_LAW = frozenset({"digital-shift", "permute"})  # of nested scrambling, too
_SHIFTS = frozenset({"shift", "shuffle"})
_LATIN = ("latin-hypercube", "n-rooks")
_MOST_BITS = 24


def scrambling(sampler: Sampler) -> str | None:
    """Return ``"owen"``, ``"digital-shift"``, ``"latin"`` or ``"latin-shift"``; None for others."""
    base = sampler.base if isinstance(sampler, Randomized) else sampler
    if base.name in _LATIN and getattr(base, "strength", 1) == 1 and sampler.dims > 1:
        steps = {step.name for step in sampler.steps} if isinstance(sampler, Randomized) else set()
        shifted = "latin-shift" if "shift" in steps else "latin"
        return shifted if steps <= _SHIFTS else None
    if not isinstance(sampler, Randomized) or not sampler.base.fixed:
        return None
    names = {step.name for step in sampler.steps}  # in the base of the net: others do not fit it
    if "owen" in names and names <= _KEEP_LAW | {"owen"}:
        return "owen"
    # In base 2 there are two permutations of a digit: permute is the same thing
    binary = set(sampler.base.digit_bases) == {2}
    return "digital-shift" if binary and names and names <= _KEEP_LAW else None


def net_variance(sampler: Sampler, n: int, g: Integrand, order: int, kind: str) -> Array:
    """Variance of the mean of g over a set of this `scrambling`: (channels,) or (1,).

    Raises
    ------
    NoClosedForm
        Coordinates coincide or are finer than can be resolved, or there are too many cells.
    """
    if kind == "latin":
        return _latin(sampler, n, g, order, np.zeros(g.dims))
    if kind == "latin-shift":
        return _shifted_latin(sampler, n, g, order)
    assert isinstance(sampler, Randomized)
    net = sampler.base
    points = net.draw_stream(n, Stream.from_rng(0), 0, 1)[0]
    if kind == "owen":
        return _nested(net, n, g, order, _separating_digits(net, points))
    return _shifted(points, g, order, _bits(net, points))


def level_variances(means: Array, bases: tuple[int, ...]) -> Array:
    """σ²_l of all levels up to those of the cells, from the means of a function over the cells.

    Parameters
    ----------
    means
        float64 (b_0^L_0, b_1^L_1, …, channels).
    bases
        b_i, the base of each axis.

    Returns
    -------
    ndarray
        float64 (L_0 + 1, L_1 + 1, …, channels); at level 0 of all axes the square of the mean.
    """
    return _levels(means, bases, 0)


def _levels(values: Array, bases: tuple[int, ...], axis: int) -> Array:
    """Split along `axis` into what each digit adds, then along the axes after it."""
    if axis == len(bases):
        return np.asarray((values**2).mean(axis=tuple(range(axis))))
    base, parts = bases[axis], []
    while values.shape[axis] > 1:
        shape = [*values.shape[:axis], -1, base, *values.shape[axis + 1 :]]
        coarse = values.reshape(shape).mean(axis=axis + 1)
        parts.append(values - np.repeat(coarse, base, axis=axis))
        values = coarse
    return np.stack([_levels(part, bases, axis + 1) for part in [values, *reversed(parts)]])


def _nested(net: Sampler, n: int, g: Integrand, order: int, digits: tuple[int, ...]) -> Array:
    bases = net.digit_bases
    sides = tuple(b**level for b, level in zip(bases, digits, strict=True))
    _check_cells(net, sides)
    try:
        gains = gain_coefficients(net, n, levels=max(1, *digits))["gain"].to_numpy()
    except ParameterError as error:
        raise NoClosedForm(f"{error} Or use convergence or variance_terms.") from None
    gains = gains[tuple(slice(level + 1) for level in digits)]
    means, squares = stratum_moments(g, sides, np.zeros(g.dims), order)
    within = np.maximum(squares - means**2, 0.0).mean(axis=0)
    levels = level_variances(means.reshape(*sides, -1), bases)
    return np.asarray((within + np.tensordot(gains, levels, axes=g.dims)) / n)


def _shifted_latin(sampler: Sampler, n: int, g: Integrand, order: int) -> Array:
    """Mean over the offset of the cells: the points are uniform for each, so that nothing is added."""
    sides = (n,) * g.dims
    nodes, weights = offset_rule(g, sides, order // 2 + 2)  # a mean over all cells is smooth
    _check_cells(sampler, sides, len(nodes) * order**g.dims)
    return np.asarray(weights @ np.stack([_latin(sampler, n, g, order, d) for d in nodes]))


def _latin(sampler: Sampler, n: int, g: Integrand, order: int, offset: Array) -> Array:
    sides = (n,) * g.dims
    _check_cells(sampler, sides)
    means, squares = stratum_moments(g, sides, offset, order)
    within = np.maximum(squares - means**2, 0.0).mean(axis=0)
    if n == 1:
        return np.asarray(within)
    varying = np.indices((2,) * g.dims).sum(axis=0)  # |v|
    gains = np.where(varying > 0, 1.0 + (n - 1.0) * (-1.0 / (n - 1.0)) ** varying, 0.0)
    parts = level_variances(means.reshape(*sides, -1), sides)  # levels of one digit in base n
    return np.asarray((within + np.tensordot(gains, parts, axes=g.dims)) / n)


def _shifted(points: Array, g: Integrand, order: int, bits: int) -> Array:
    cells = 2**bits
    sides = (cells,) * g.dims
    _check_cells(g, sides, order**g.dims)
    nodes, weights = offset_rule(g, sides, order)
    counts = np.zeros(sides)
    np.add.at(counts, tuple(np.rint(points * cells).astype(np.int64).T), 1.0 / len(points))
    spectrum = _hadamard(counts, g.dims) ** 2
    spectrum[(0,) * g.dims] = 0.0
    means, within = [], []
    for offset in nodes:
        walsh = _hadamard(grid_values(g, sides, offset), g.dims) / cells**g.dims
        means.append(walsh[(0,) * g.dims])
        within.append(np.tensordot(spectrum, walsh**2, axes=g.dims))
    of_offset = np.array(means)
    spread = (of_offset - weights @ of_offset) ** 2
    return np.asarray(weights @ (np.array(within) + spread))


def _hadamard(values: Array, dims: int) -> Array:
    """Σ_x values(x) wal_m(x) along the first `dims` axes, m in the order of the butterflies."""
    for axis in range(dims):
        step = 1
        while step < values.shape[axis]:
            shape = (*values.shape[:axis], -1, 2, step, *values.shape[axis + 1 :])
            left, right = np.moveaxis(values.reshape(shape), axis + 1, 0)
            values = np.stack([left + right, left - right], axis=axis + 1).reshape(values.shape)
            step *= 2
    return values


def _separating_digits(net: Sampler, points: Array) -> tuple[int, ...]:
    """For each axis the number of digits in which all coordinates differ."""
    digits = []
    for axis, base in enumerate(net.digit_bases):
        level, limit = 0, math.floor(_MOST_BITS / math.log2(base))
        # As in spectra.gain: coordinates rounded down to below a digit count as that digit
        x = points[:, axis] + (0.0 if base & (base - 1) == 0 else 2.0**-50)
        while len(np.unique(np.floor(x * base**level))) < len(x):
            level += 1
            if level > limit:
                raise NoClosedForm(
                    f"Axis {axis} of {net.spec} has coordinates that coincide or nearly so; the exact "
                    "variance of nested scrambling is known for distinct ones only."
                )
        digits.append(level)
    return tuple(digits)


def _bits(net: Sampler, points: Array) -> int:
    """Bits that hold all coordinates."""
    for bits in range(_MOST_BITS + 1):
        if np.array_equal(points * 2**bits, np.floor(points * 2**bits)):
            return bits
    raise NoClosedForm(
        f"Coordinates of {net.spec} have more than {_MOST_BITS} bits; use convergence or "
        "variance_terms."
    )


def _check_cells(what: Sampler | Integrand, sides: tuple[int, ...], times: int = 1) -> None:
    cells = times * math.prod(float(s) for s in sides)
    if cells > MAX_EVALUATIONS:
        raise NoClosedForm(
            f"The exact variance of {what.spec} would take {cells:.2g} cells, more than "
            f"{MAX_EVALUATIONS:.2g}; use convergence or variance_terms."
        )
