"""Scrambled nets in exact terms: gain coefficients, nested variances, and power in the Walsh basis.

Owen [Owen1997]_ splits f into parts ν_l, l = (l_1, …, l_d), by the digits of the coordinates that
it varies with (docs/theory.md, "Gains of scrambled nets"). (His u is {j: l_j > 0}, and his k_j is
l_j − 1.) In base 2, ν_l is the part of f in the Walsh functions of index 2^(l_j − 1) ≤ m_j < 2^l_j,
and all these have the expected power Γ_l / n. A digital shift leaves the power of each as it is: 1
on the dual net, the indices to which all columns of the generator matrices are orthogonal, and 0
elsewhere.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import Function, NoClosedForm, Parameter, ParameterError
from mcspectra.core.results import dataset
from mcspectra.core.streams import Stream
from mcspectra.core.tally import counting
from mcspectra.integrands import Integrand, as_integrand
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.spectra.bases import Walsh, parts_of
from mcspectra.spectra.closed_forms import points_at

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["closed_form_walsh_power", "gain_coefficients", "gains_at", "nested_variances"]

_MAX_WORK = 2**28  # points times levels to be counted: about a minute
_BITS = 32
_NESTED = frozenset({"owen", "lms", "digital-shift", "permute"})  # keep which digits agree


def gain_coefficients(
    sampler: Sampler | str, n: int, *, levels: int | None = None, dims: int | None = None
) -> xr.Dataset:
    """Return the gain coefficients Γ_l of nested uniform scrambling, exactly.

    Parameters
    ----------
    sampler
        Net or sequence in any base, or in one base for each axis; with or without owen.
    n
        Number of points.
    levels
        Largest level of each axis; by default one more than the digits of n in the least base.
        Beyond, the gains of nets of distinct coordinates are 1.
    dims
        Dims of a spec string that does not say.

    Returns
    -------
    xarray.Dataset
        ``gain`` on dims ``level0``, ``level1``, …, from 0. Level 0 of all axes, the mean, has none: 0.

    Raises
    ------
    NoClosedForm
        The sampler draws other points each time, so that its gains are random.
    ParameterError
        Too many levels, points or dims to count.

    Examples
    --------
    >>> gain_coefficients("sobol", 4, dims=2, levels=2)["gain"].values
    array([[0., 0., 0.],
           [0., 0., 2.],
           [0., 2., 1.]])
    """
    source = as_sampler(sampler, dims)
    n = source.check_count(n)
    base = _net_inside(source.as_chain(n))
    bases = base.digit_bases
    most = max(1, math.floor(52 / math.log2(max(bases))))
    digits = 1
    while min(bases) ** digits < n:
        digits += 1
    default = min(digits + 1, most)
    levels = default if levels is None else as_integer("levels", levels, least=1, most=most)
    names = tuple(f"level{i}" for i in range(base.dims))
    attributes = {"long_name": "level of the digits, 0: not varying", "units": "1"}
    return dataset(
        {"gain": (names, gains_at(base, n, levels))},
        {name: (name, np.arange(levels + 1), attributes) for name in names},
        sampler=source.spec,
        n=n,
    )


def gains_at(sampler: Sampler, n: int, levels: int) -> Array:
    """Return the gains of n points that are known to be possible, (levels + 1, …).

    From the numbers of pairs that agree: a difference of levels along each axis. Errors are those
    of `gain_coefficients`.
    """
    sampler = _net_inside(sampler.as_chain(n))
    work = float(n) * float(levels + 1) ** sampler.dims
    if work > _MAX_WORK:
        raise ParameterError(
            f"{levels} levels in {sampler.dims} dims of {n} points are {work:.2g} counts, more than "
            f"{_MAX_WORK:.2g}; lower levels, n or dims."
        )
    points = sampler.draw_stream(n, Stream.from_rng(0), 0, 1)[0]
    bases = sampler.digit_bases
    gains = np.empty((levels + 1,) * len(bases))

    def fill(cells: Array, axis: int, at: tuple[int, ...]) -> None:
        """Count ordered pairs that agree in the first l_j digits of coordinate j, for all l."""
        if axis == len(bases):
            gains[at] = np.sum(np.bincount(cells).astype(float) ** 2) / n
            return
        for level in range(levels + 1):
            # The first digits as whole numbers; coordinates rounded down to below k/b^level count as k
            base, scale = bases[axis], float(bases[axis] ** level)
            nudge = 0.0 if base & (base - 1) == 0 else scale * 2.0**-50
            digits = np.floor(points[:, axis] * scale + nudge)
            prefix = np.minimum(digits, scale - 1.0).astype(np.int64)
            inner = cells * base**level + prefix if n > 1 else cells
            fill(np.unique(inner, return_inverse=True)[1], axis + 1, (*at, level))

    fill(np.zeros(n, np.int64), 0, ())
    for axis, base in enumerate(bases):
        values = np.moveaxis(gains, axis, 0)
        finer = (base * values[1:] - values[:-1]) / (base - 1)
        gains = np.moveaxis(np.concatenate([values[:1], finer]), 0, axis)
    gains[(0,) * sampler.dims] = 0.0
    return gains


def nested_variances(
    integrand: Integrand | str, levels: int, *, max_evaluations: int | None = None
) -> Array:
    """Return σ²_l of an integrand (or spec string) in base 2, up to `levels` on each axis.

    Parameters
    ----------
    integrand, levels
        f, or its spec string, and the largest level.
    max_evaluations
        Most evaluations of a user's function: BudgetError where it takes more.

    Returns
    -------
    ndarray
        float64 (levels + 1, …), or (channels, levels + 1, …); 0 at level 0 of all axes. Their sum is
        the variance of f but for finer levels.

    Raises
    ------
    ParameterError
        More than 2^24 cells.
    """
    levels = as_integer("levels", levels, least=1, most=24)
    integrand = as_integrand(integrand)
    basis = Walsh(integrand.dims, 2 ** (levels - 1))
    with counting("nested_variances", max_evaluations):
        coefficients, _ = basis.integrand(integrand)
    squares = basis.full(np.abs(coefficients) ** 2)
    # The indices of a level are neighbours: 0, 1, 2–3, 4–7, …
    starts = np.concatenate([[0], 2 ** np.arange(levels)])
    for axis in range(1, squares.ndim):
        squares = np.add.reduceat(squares, starts, axis=axis)
    squares.reshape(len(squares), -1)[:, 0] = 0.0
    return squares if integrand.channels else squares[0]


def closed_form_walsh_power(sampler: Sampler | str, n: int, indices: Any) -> Array:
    """Return the exact expected power ⟨|S_m|²⟩ in the Walsh basis, for digital nets in base 2.

    Parameters
    ----------
    sampler
        Digital net or sequence with digital-shift, or with owen.
    n
        Number of points, a power of two.
    indices
        m in Paley order, whole numbers from 0 to 2^32 − 1, shape (..., d).

    Returns
    -------
    ndarray
        float64 (...): with digital-shift 1 on the dual net and 0 elsewhere, with owen Γ/n.

    Raises
    ------
    NoClosedForm
        Another sampler, another randomisation, or another count.

    Examples
    --------
    >>> closed_form_walsh_power("sobol | digital-shift", 4, [[1, 1], [2, 2], [3, 1]])
    array([0., 1., 1.])
    """
    source, _, given = points_at(sampler, indices)
    n = source.check_count(n)
    source = source.as_chain(n)
    if not np.array_equal(given, np.rint(given)) or given.min() < 0 or given.max() >= 2.0**_BITS:
        raise ParameterError(
            "Walsh indices are whole numbers from 0 to 2^32 − 1; those given are not."
        )
    m = given.astype(np.uint64)
    steps = {step.name for step in parts_of(source)[1]}
    columns = _columns(_net_inside(source), n)
    if steps == {"digital-shift"}:
        # On the dual net Σ_j (digits of m_j) · (column c of matrix j) is even for every column c
        reversed_digits = np.zeros_like(m)
        for bit in range(_BITS):
            digit = (m >> np.uint64(bit)) & np.uint64(1)
            reversed_digits |= digit << np.uint64(_BITS - 1 - bit)
        both = reversed_digits[..., None] & columns
        odd = np.bitwise_count(np.bitwise_xor.reduce(both, axis=-2)) & 1
        return np.asarray((~odd.any(axis=-1)).astype(float))
    if "owen" not in steps:
        raise NoClosedForm(
            f"No power in the Walsh basis is known for {source.spec}; add digital-shift or owen, or "
            "use ",
            Function("variance_terms"),
            " with ",
            Parameter("basis", "walsh"),
            ".",
        )
    level = np.frexp(given)[1]
    levels = max(1, int(level.max()))
    power = gains_at(source, n, levels) / n
    power[(0,) * source.dims] = 1.0
    return np.asarray(power[tuple(np.moveaxis(level, -1, 0))])


def _net_inside(sampler: Sampler) -> Sampler:
    """Return the net inside randomisations of its digits, which keep which digits agree."""
    base, steps = parts_of(sampler)
    if not base.fixed or not all(step.name in _NESTED for step in steps):
        raise NoClosedForm(
            f"No gain coefficients are known for {sampler.spec}; give a net that is the same every "
            "time, such as sobol, alone or with owen."
        )
    return base


def _columns(sampler: Sampler, n: int) -> Array:
    """Columns of the generator matrices as 32-bit numbers, the first digit highest: (dims, log2 n)."""
    count = n.bit_length() - 1
    binary = 2**count == n and set(sampler.digit_bases) == {2}
    if binary and hasattr(sampler, "direction_numbers"):
        directions: Array = sampler.direction_numbers(n)
        return directions[:, :count].astype(np.uint64)
    if binary and sampler.name == "digital-net":
        matrices = sampler.generator_matrices()[:, :_BITS, :count]  # type: ignore[attr-defined]
        places = 2 ** np.arange(_BITS - 1, _BITS - 1 - matrices.shape[1], -1, dtype=np.int64)
        return np.tensordot(matrices, places, axes=([1], [0])).astype(np.uint64)
    raise NoClosedForm(
        f"{n} points of {sampler.spec} are not a digital net in base 2 with known matrices; take a "
        "power of two of sobol, niederreiter, larcher-pillichshammer or digital-net."
    )
