"""Exact results for scrambled nets: gain coefficients, nested variances, and Walsh power.

Owen [Owen1997]_ splits f into parts ν_l with levels l = (l_1, …, l_d).
The part ν_l depends on the first l_j digits of coordinate j.
See docs/theory.md, "Gains of scrambled nets".
(In Owen's notation, u is the set {j: l_j > 0}, and k_j is l_j − 1.)
In base 2, ν_l is the part of f in the Walsh functions with indices 2^(l_j − 1) ≤ m_j < 2^l_j.
Under nested scrambling, the Walsh functions of a part ν_l all have the expected power Γ_l / n.
A digital shift keeps the power of a Walsh function, which is 1 on the dual net and 0 elsewhere.
The dual net contains the indices that are orthogonal to all columns of the generator matrices.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import Function, NoClosedForm, Parameter, ParameterError
from mcspectra.core.results import dataset
from mcspectra.core.tally import counting
from mcspectra.integrands import Integrand, as_integrand
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.samplers.law import Fixed, Law, Scrambled
from mcspectra.spectra.bases import WalshBasis
from mcspectra.spectra.closed_forms import points_at

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["closed_form_walsh_power", "gain_coefficients", "gains_at", "nested_variances"]

_BITS = 32


def gain_coefficients(
    sampler: Sampler | str, n: int, *, levels: int | None = None, dims: int | None = None
) -> xr.Dataset:
    """Return the gain coefficients Γ_l of nested uniform scrambling, exactly.

    Parameters
    ----------
    sampler
        Net or sequence, with or without owen. The base may be one number or one per axis.
    n
        Number of points.
    levels
        Largest level of each axis.
        By default, this level is one more than the number of digits of n in the smallest base.
        If no two points share a coordinate, all gains at even larger levels are 1.
    dims
        Number of dims. It is needed if a spec string does not state it.

    Returns
    -------
    xarray.Dataset
        The gains, in a variable ``gain`` with a dim of levels for each axis (``level0``, …).
        Levels are counted from 0. If the level is 0 on all axes, the part is the mean of f.
        The gain at level 0 of all axes is 0, because the mean of f is integrated without error.

    Raises
    ------
    NoClosedForm
        If the gains are random, because the sampler draws different points each time.
    ParameterError
        If there are too many levels, points or dims.

    Examples
    --------
    >>> gain_coefficients("sobol", 4, dims=2, levels=2)["gain"].values
    array([[0., 0., 0.],
           [0., 0., 2.],
           [0., 2., 1.]])
    """
    source = as_sampler(sampler, dims)
    n = source.check_count(n)
    net, bases = _net_inside(source.law(n), source.spec)
    most = max(1, math.floor(52 / math.log2(max(bases))))
    digits = 1
    while min(bases) ** digits < n:
        digits += 1
    default = min(digits + 1, most)
    levels = default if levels is None else as_integer("levels", levels, least=1, most=most)
    names = tuple(f"level{i}" for i in range(net.dims))
    attributes = {"long_name": "level of the digits, 0: not varying", "units": "1"}
    return dataset(
        {"gain": (names, gains_at(net, bases, levels))},
        {name: (name, np.arange(levels + 1), attributes) for name in names},
        sampler=source.spec,
        n=n,
    )


def gains_at(net: Fixed, bases: Sequence[int], levels: int) -> Array:
    """Return the gains (levels + 1, …) of a set after scrambling in the given bases.

    The kernel counts pairs of points whose leading digits agree, for each number of digits.
    A gain is a weighted difference between the counts of pairs at two successive levels.
    The function raises the same errors as `gain_coefficients`.
    """
    gains = net.agreements(bases, levels)
    for axis, base in enumerate(bases):
        values = np.moveaxis(gains, axis, 0)
        finer = (base * values[1:] - values[:-1]) / (base - 1)
        gains = np.moveaxis(np.concatenate([values[:1], finer]), 0, axis)
    gains[(0,) * net.dims] = 0.0
    return gains


def nested_variances(
    integrand: Integrand | str, levels: int, *, max_evaluations: int | None = None
) -> Array:
    """Return the variances σ²_l of parts of f in base 2, for levels l up to `levels` on each axis.

    Parameters
    ----------
    integrand, levels
        The integrand f, or its spec string, and the largest level on each axis.
    max_evaluations
        Maximum number of evaluations of a user's function; above it, BudgetError is raised.

    Returns
    -------
    ndarray
        float64 (levels + 1, …), or (channels, levels + 1, …). It is 0 at level 0 of all axes.
        The values sum to the variance of f, except for the part of the variance at finer levels.

    Raises
    ------
    ParameterError
        If there are more than 2^24 cells.
    """
    levels = as_integer("levels", levels, least=1, most=24)
    integrand = as_integrand(integrand)
    basis = WalshBasis(integrand.dims, 2 ** (levels - 1))
    with counting("nested_variances", max_evaluations):
        coefficients, _ = basis.integrand(integrand)
    squares = basis.full(np.abs(coefficients) ** 2)
    # The indices of one level are contiguous: 0, 1, 2–3, 4–7, …
    starts = np.concatenate([[0], 2 ** np.arange(levels)])
    for axis in range(1, squares.ndim):
        squares = np.add.reduceat(squares, starts, axis=axis)
    squares.reshape(len(squares), -1)[:, 0] = 0.0
    return squares if integrand.channels else squares[0]


def closed_form_walsh_power(sampler: Sampler | str, n: int, indices: Any) -> Array:
    """Return the exact expected power ⟨|S_m|²⟩ in the Walsh basis of digital nets in base 2.

    Parameters
    ----------
    sampler
        Digital net or sequence with digital-shift, or with owen.
    n
        Number of points, a power of two.
    indices
        Indices m in Paley order: whole numbers from 0 to 2^32 − 1, shape (..., d).

    Returns
    -------
    ndarray
        float64 (...). With digital-shift, the power is 1 on the dual net, else 0; with owen, Γ/n.

    Raises
    ------
    NoClosedForm
        If the sampler, its randomization or its number of points is not supported.

    Examples
    --------
    >>> closed_form_walsh_power("sobol | digital-shift", 4, [[1, 1], [2, 2], [3, 1]])
    array([0., 1., 1.])
    """
    source, _, given = points_at(sampler, indices)
    law = source.law(source.check_count(n))
    if not np.array_equal(given, np.rint(given)) or given.min() < 0 or given.max() >= 2.0**_BITS:
        raise ParameterError(
            "Walsh indices are whole numbers from 0 to 2^32 − 1; those given are not."
        )
    m = given.astype(np.uint64)
    net, bases = _net_inside(law, source.spec)
    if net.columns is None:
        raise NoClosedForm(
            f"{n} points of {source.spec} are not a digital net in base 2 with known matrices; "
            "take a power of two of sobol, niederreiter, larcher-pillichshammer or digital-net."
        )
    if isinstance(law, Scrambled) and law.xor:
        # If m is on the dual net, Σ_j (digits of m_j) · (column c of matrix j) is even for all c
        reversed_digits = np.zeros_like(m)
        for bit in range(_BITS):
            digit = (m >> np.uint64(bit)) & np.uint64(1)
            reversed_digits |= digit << np.uint64(_BITS - 1 - bit)
        both = reversed_digits[..., None] & net.columns()
        odd = np.bitwise_count(np.bitwise_xor.reduce(both, axis=-2)) & 1
        return np.asarray((~odd.any(axis=-1)).astype(float))
    if not (isinstance(law, Scrambled) and law.nested_pairs):
        raise NoClosedForm(
            f"No power in the Walsh basis is known for {source.spec}; add digital-shift or owen, "
            "or use ",
            Function("variance_terms"),
            " with ",
            Parameter("basis", "walsh"),
            ".",
        )
    level = np.frexp(given)[1]
    levels = max(1, int(level.max()))
    power = gains_at(net, bases, levels) / law.n
    power[(0,) * source.dims] = 1.0
    return np.asarray(power[tuple(np.moveaxis(level, -1, 0))])


def _net_inside(law: Law, name: str) -> tuple[Fixed, tuple[int, ...]]:
    """Return the fixed set before scrambling, and the bases in which digits are scrambled."""
    net = law.inner if isinstance(law, Scrambled) else law
    if not isinstance(net, Fixed):
        raise NoClosedForm(
            f"No gain coefficients are known for {name}; give a net that is the same every "
            "time, such as sobol, alone or with owen."
        )
    bases = law.bases if isinstance(law, Scrambled) else net.bases
    return net, bases or (2,) * law.dims
