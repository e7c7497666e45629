"""A continuous density in one dim, linear between nodes of equal spacing."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_real_array
from mcspectra.core.errors import ParameterError
from mcspectra.densities.base import Density

__all__ = ["PiecewiseLinear"]

_MOST_SHOWN = 256  # tables up to this size are kept as lists, so that spec strings hold them
_SAME_SLOPE = 1e-12


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PiecewiseLinear(Density):
    """Linear between nodes, given by its values at x = 0, 1/(k−1), …, 1.

    Attributes
    ----------
    values
        Relative density at each of k ≥ 2 nodes, at least 0 and not all 0; any scale. Cells between
        two zeros are empty.

    Notes
    -----
    In a cell with the densities a and b at its ends the share r of its mass lies left of
    t = (a + b) r/(a + √D), D = a² + (b² − a²) r, written from the lower end as in `Linear`: sums of
    positive terms, so that nothing cancels for a → b nor where a or b is 0.
    """

    name: ClassVar[str] = "piecewise-linear"
    dims: int = field(default=1, init=False)
    values: Any

    def __post_init__(self) -> None:
        table = _as_nodes(self.values)
        kept = table.tolist() if table.size <= _MOST_SHOWN else table
        object.__setattr__(self, "values", kept)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """The cdf at the inner nodes where the slope changes."""
        bend = np.abs(np.diff(self._nodes, 2)) > _SAME_SLOPE
        found = np.unique(self._cdf[1:-1][bend])
        return (tuple(found[(found > 0) & (found < 1)].tolist()),)

    def zero_points(self) -> Array:
        """Centres of the empty cells."""
        return ((np.flatnonzero(self._masses == 0) + 0.5) / self._masses.size)[:, None]

    def reciprocal_integral(self) -> float:
        """Mean over cells of ln(b/a)/(b − a), infinite where a node is 0."""
        p = self._nodes / self._masses.mean()
        if not p.all():
            return math.inf
        mean, t = 0.5 * (p[1:] + p[:-1]), (p[1:] - p[:-1]) / (p[1:] + p[:-1])
        stretch = np.divide(np.arctanh(t), t, out=np.ones_like(t), where=t != 0)
        return float((stretch / mean).mean())

    @cached_property
    def _nodes(self) -> Array:
        values = np.asarray(self.values, np.float64)
        return np.asarray(values / values.max())

    @cached_property
    def _masses(self) -> Array:
        return np.asarray(0.5 * (self._nodes[1:] + self._nodes[:-1]))

    @cached_property
    def _cdf(self) -> Array:
        """Cdf at the nodes (k,), from 0 to exactly 1."""
        sums = np.concatenate([[0.0], np.cumsum(self._masses)])
        return np.asarray(sums / sums[-1])

    def _cell(self, x: Array) -> tuple[Array, Array]:
        """Cell that holds x and the position t in it, from 0 to 1."""
        scaled = x * self._masses.size
        cell = np.minimum(scaled.astype(np.int64), self._masses.size - 1)
        return cell, scaled - cell

    def _pdf(self, x: Array) -> Array:
        cell, t = self._cell(x[..., 0])
        line = (1.0 - t) * self._nodes[cell] + t * self._nodes[cell + 1]
        return np.asarray(line / self._masses.mean())

    def _sample(self, u: Array) -> Array:
        # The last cell that starts at or below u: empty cells are passed over
        cell = np.searchsorted(self._cdf[:-1], u, side="right") - 1
        low, high = self._cdf[cell], self._cdf[cell + 1]
        share = np.divide(u - low, high - low, out=np.zeros_like(u), where=high > low)
        return np.asarray((cell + _position(self._nodes, cell, share)) / self._masses.size)

    def _invert(self, x: Array) -> Array:
        cell, t = self._cell(x)
        a, b = self._nodes[cell], self._nodes[cell + 1]
        part = t * np.where(b >= a, a + 0.5 * t * (b - a), a - 0.5 * t * (a - b))
        return np.asarray(np.minimum(self._cdf[cell] + part / self._masses.sum(), 1.0))


def _position(nodes: Array, cell: Array, share: Array) -> Array:
    """Where in a cell the share r of its mass lies to the left, from 0 to 1."""
    top = np.maximum(np.maximum(nodes[cell], nodes[cell + 1]), np.finfo(float).tiny)
    a, b = nodes[cell] / top, nodes[cell + 1] / top  # so that no square underflows
    rising = a * a + (b * b - a * a) * share
    falling = b * b + (a * a - b * b) * (1.0 - share)
    bottom = a + np.sqrt(np.where(b >= a, rising, falling))
    t = np.divide((a + b) * share, bottom, out=np.zeros_like(share), where=bottom > 0)
    return np.asarray(np.minimum(t, 1.0))


def _as_nodes(values: object) -> Array:
    """Check relative densities at nodes and return them as a read-only copy."""
    table = as_real_array("values", values).copy()
    if table.ndim != 1 or table.size < 2:
        raise ParameterError(
            f"values have shape {table.shape}; give a flat list of at least two nodes."
        )
    if not np.isfinite(table).all() or table.min() < 0 or not table.any():
        raise ParameterError(
            f"values run from {table.min():g} to {table.max():g}; "
            "they must be finite, at least 0, and not all 0."
        )
    table.setflags(write=False)
    return table
