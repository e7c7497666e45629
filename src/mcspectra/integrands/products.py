"""Coefficients of integrands in product bases other than Fourier, by quadrature axis by axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.integrands._quadrature import AxisRule, slabs
from mcspectra.integrands.base import Integrand

__all__ = ["axis_rules", "cell_integrals", "product_coefficients"]

_ORDER = 16
_LEAST = {1: 512, 2: 512, 3: 64, 4: 32}
_LIMIT = 2**24  # evaluations
_CELL_NODES = {1: 64, 2: 16, 3: 4, 4: 2}


def axis_rules(f: Integrand, half_width: int) -> list[AxisRule]:
    """Composite Gauss-Legendre rules, 16 nodes to a wave of the half width (fewer beyond 2-D).

    Raises
    ------
    ParameterError
        The product of the rules has more than 2^24 nodes.
    """
    least = _LEAST.get(f.dims, 16)
    for per_wave in (16, 8, 4):
        count = 1 << (max(least, per_wave * half_width) - 1).bit_length()
        if float(count) ** f.dims <= _LIMIT:
            return [AxisRule.make(count, min(_ORDER, count), breaks) for breaks in f.breaks]
    raise ParameterError(
        f"The coefficients of {f.spec} up to half width {half_width} in {f.dims} dims take "
        f"{float(count) ** f.dims:.2g} evaluations, more than {_LIMIT:.2g}; lower half_width."
    )


def product_coefficients(
    f: Integrand, rules: Sequence[AxisRule], functions: Sequence[Array]
) -> Array:
    """∫ f Π_i φ_i for all products of real functions of one variable.

    Parameters
    ----------
    f
        The integrand.
    rules
        A rule for each axis, P_i nodes.
    functions
        Their values at the nodes of each axis, (P_i, N_i).

    Returns
    -------
    ndarray
        float64 (channels or 1, N_0 · … · N_{d−1}), C order.
    """
    total: Array | float = 0.0
    for start, values in slabs(f, rules):
        weighted = [rule.weights[:, None] * phi for rule, phi in zip(rules, functions, strict=True)]
        weighted[0] = weighted[0][start : start + values.shape[1]]
        # values (C, P_0, …): each step takes the first axis of nodes and adds one of functions
        for phi in weighted:
            values = np.tensordot(values, phi, axes=([1], [0]))
        total = total + values
    return np.asarray(total).reshape(max(1, f.channels), -1)


def cell_integrals(f: Integrand, size: int) -> tuple[Array, str]:
    """∫ f over each of size^d equal cells: float64 (channels or 1, size^d), and how it was found.

    Raises
    ------
    ParameterError
        More than 2^24 evaluations.
    """
    cells = float(size) ** f.dims
    if cells > _LIMIT:
        raise ParameterError(
            f"{cells:.2g} cells in {f.dims} dims are more than {_LIMIT:.2g}; lower "
            "half_width or levels."
        )
    # Take means over boxes, where the integrand knows them
    low = np.stack(np.meshgrid(*[np.arange(size) / size] * f.dims, indexing="ij"), axis=-1)
    low = low.reshape(-1, f.dims)
    moments = f.box_moments(low, low + 1.0 / size)
    if moments is not None:
        return np.asarray(moments[0]).reshape(len(low), -1).T / cells, "exact"

    # Else add up the nodes of each cell, slab by slab
    nodes = _CELL_NODES.get(f.dims, 2)
    while nodes > 1 and (float(nodes) * size) ** f.dims > _LIMIT:
        nodes //= 2
    order = min(nodes, _ORDER)
    rules = [AxisRule.make(size * nodes, order, breaks) for breaks in f.breaks]
    cell = [np.floor(rule.nodes * size).astype(np.int64) for rule in rules]
    total = np.zeros((max(1, f.channels), *[size] * f.dims))
    for start, values in slabs(f, rules):
        stop = start + values.shape[1]
        for axis in range(f.dims, 1, -1):
            values = _sum_by(values, axis, rules[axis - 1].weights, cell[axis - 1])
        values = _sum_by(values, 1, rules[0].weights[start:stop], cell[0][start:stop])
        total[:, np.unique(cell[0][start:stop])] += values
    return total.reshape(len(total), -1), "composite Gauss-Legendre quadrature"


def _sum_by(values: Array, axis: int, weights: Array, cell: Array) -> Array:
    """Weighted sums along an axis over the nodes of each cell that has some, in their order."""
    order = np.argsort(cell, kind="stable")
    first = np.flatnonzero(np.diff(cell[order], prepend=-1))
    shape = [1] * values.ndim
    shape[axis] = -1
    weighted = np.take(values, order, axis=axis) * weights[order].reshape(shape)
    return np.asarray(np.add.reduceat(weighted, first, axis=axis))
