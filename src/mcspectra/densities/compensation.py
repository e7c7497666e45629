"""MIS compensation: a tabulated density, lowered where other techniques sample enough already.

With the balance heuristic and f proportional to a table p, the points of all techniques together
should be distributed as p. Technique τ has a share β_τ = n_τ/Σ n of them, so that its own density
should be what the others' leave, β_τ p'_τ = max(0, λ p − Σ_{s≠τ} β_s p_s), with λ such that p'_τ is a
density [Karlik2019]_. This is the p'_τ of least ∫ f²/(β_τ p'_τ + Σ β_s p_s), hence of least second
moment; λ = 1 where nothing is cut off, and then the estimate of f has no variance at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.densities.base import Density
from mcspectra.densities.registry import as_density
from mcspectra.densities.tabulated import ImageDensity, PiecewiseConstant

__all__ = ["compensated"]

_NODES = 4  # of a Gauss rule along each axis of a cell
_BLOCK = 2**16  # cells at a time


def compensated(
    density: Density | str,
    others: Sequence[Density | str],
    counts: Sequence[int] | None = None,
) -> PiecewiseConstant:
    """Sharpen a table for multiple importance sampling with other techniques.

    Parameters
    ----------
    density
        The table p, which stands for f: `PiecewiseConstant` or `ImageDensity`, or a spec string of one.
    others
        Densities of the other techniques, or spec strings.
    counts
        Points of `density` and of the others, as `MultipleImportance` takes them; equal by default.

    Returns
    -------
    PiecewiseConstant
        p'_τ with the warp of `density`: 0 in cells that the others sample often enough.

    Raises
    ------
    ParameterError
        Not a table, other dims, or counts of another length.

    Notes
    -----
    The others count by their means over cells, from Gauss rules of 4 nodes an axis. A cell in which
    one of these nodes finds all others 0 keeps all of λ p, so that f stays covered;
    `MultipleImportance` checks this again. Only f proportional to p is served best: where f has
    further factors, compensation still is unbiased.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> table = mcs.density("piecewise-constant(values=[1, 1, 4, 2])")
    >>> compensated(table, ["uniform"]).values
    [0.0, 0.0, 3.0, 1.0]
    """
    table = _as_tabulated(density)
    if not isinstance(others, list | tuple):
        raise ParameterError(f"others is {others!r:.80}; give a list of densities.")
    found = [_checked(other, table.dims) for other in others]
    shares = _shares(counts, 1 + len(found))
    p = table._pdf_table.reshape(table._table.shape)
    taken = _taken(found, shares[1:], p.shape)
    left = np.maximum(_level(p, taken, shares[0]) * p - taken, 0.0) / shares[0]
    return PiecewiseConstant(values=left, warp=table.warp)


def _as_tabulated(given: Density | str) -> PiecewiseConstant:
    found = as_density(given)
    if isinstance(found, ImageDensity):
        found = found._inside
    if not isinstance(found, PiecewiseConstant):
        raise ParameterError(
            f"{given!r:.80} is not a table; compensation takes piecewise-constant(values=…) or "
            "image(path=…)."
        )
    return found


def _checked(given: Density | str, dims: int) -> Density:
    found = as_density(given, dims)
    if found is None:
        raise ParameterError("others holds None; write 'uniform' for a uniform density.")
    return found


def _shares(counts: Any, techniques: int) -> Array:
    """β of all techniques, their own first."""
    given = (1,) * techniques if counts is None else counts
    if not isinstance(given, list | tuple | np.ndarray) or len(given) != techniques:
        raise ParameterError(
            f"counts is {counts!r:.80}; give {techniques} numbers, that of the table first."
        )
    values = [as_integer(f"counts[{i}]", c, least=1) for i, c in enumerate(given)]
    return np.array(values) / sum(values)


def _taken(others: list[Density], shares: Array, shape: tuple[int, ...]) -> Array:
    """Σ β_s p_s over each cell, 0 where it vanishes anywhere in the cell: `shape`."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    grid = np.stack(np.meshgrid(*([0.5 * (node + 1)] * len(shape)), indexing="ij"), axis=-1)
    inside = grid.reshape(-1, len(shape))
    rule = weight / 2 if len(shape) == 1 else np.outer(weight / 2, weight / 2).ravel()
    sides = np.array(shape[::-1])
    out = np.zeros(int(np.prod(shape)))
    for start in range(0, out.size, _BLOCK):
        cells = np.arange(start, min(start + _BLOCK, out.size))
        # Rows of the table run along axis 1.
        corner = np.stack(np.unravel_index(cells, shape)[::-1], axis=-1)
        x = (corner[:, None, :] + inside) / sides
        total = np.zeros(x.shape[:-1])
        for share, other in zip(shares, others, strict=True):
            total += share * other.pdf(x)
        out[cells] = np.where((total > 0).all(axis=1), total @ rule, 0.0)
    return out.reshape(shape)


def _level(p: Array, taken: Array, share: float) -> float:
    """λ with mean max(0, λ p − taken) = share: one linear piece of it, found by sorting."""
    inside = p.ravel() > 0
    own, other = p.ravel()[inside], taken.ravel()[inside]
    ratio = other / own
    order = np.argsort(ratio)
    # λ if just the first k cells in this order are above 0; right where the next is not.
    levels = (share * p.size + np.cumsum(other[order])) / np.cumsum(own[order])
    ends = np.append(ratio[order][1:], np.inf)
    return float(levels[np.flatnonzero(levels <= ends)[0]])
