"""Piecewise bilinear densities in two dims, by continuous marginal-conditional inversion.

Between four nodes p(x) = Σ_ij v_ij B_i(x_0) B_j(x_1), with B linear: p is continuous. So is T, where
the marginal density is above 0: T_1 inverts the marginal cdf (a quadratic in each interval of knots),
T_0 the cdf along the line x_1 = T_1, a blend of the cdfs of the two node rows (another quadratic).
The primary-space integrand jumps only where f does, and bends at the borders of intervals. Compare
`mcspectra.densities.tabulated`, where every warp of a piecewise constant table jumps.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.densities import _bilinear_kernels
from mcspectra.densities.base import Density
from mcspectra.densities.tabulated import as_table, flat, shown

__all__ = ["Bilinear"]


class _Tables(NamedTuple):
    """What the kernels take: see `_bilinear_kernels`."""

    xs: Array
    ys: Array
    nodes: Array
    sums: Array
    rows: Array


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Bilinear(Density):
    """Bilinear between values at nodes, given by rows of a table (2-D).

    Attributes
    ----------
    values
        Relative density at each node, at least 0; any scale. Shape (h, w) with x_0 along a row and
        x_1 from the first row to the last.
    nodes
        ``"centers"``: node (i, j) is the centre of cell (i, j) of h × w equal cells, as of pixels; the
        half cells at the borders continue the outermost values. ``"corners"``: nodes lie at j/(w−1)
        and i/(h−1), ends included; h and w are at least 2.
    periodic
        x_0 wraps around: the last column goes over into the first. For ``"centers"`` only.

    Notes
    -----
    The round trip ``invert(sample(u))`` loses digits in u_0 where the marginal density between two
    rows grows by a large factor, as the rounding of x_1 then moves the line along which u_0 is found.
    """

    name: ClassVar[str] = "bilinear"
    dims: int = field(default=2, init=False)
    values: Any
    nodes: str = "centers"
    periodic: bool = False

    def __post_init__(self) -> None:
        as_choice("nodes", self.nodes, ("centers", "corners"))
        if not isinstance(self.periodic, bool):
            raise ParameterError(f"periodic is {self.periodic!r}; give True or False.")
        table = as_table(self.values)
        least = 1 if self.nodes == "centers" else 2
        if table.ndim != 2 or min(table.shape) < least:
            raise ParameterError(
                f"values have shape {table.shape}; nodes at {self.nodes} need (h, w), "
                f"both at least {least}."
            )
        if self.periodic and self.nodes == "corners":
            raise ParameterError(
                "periodic goes with nodes='centers'; at corners, repeat the first column as the last."
            )
        object.__setattr__(self, "values", shown(table))

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Along axis 1 the marginal cdf at the knots, where the slope of T changes."""
        inside = np.unique(self._tables.rows[1:-1])
        return (), tuple(inside[(inside > 0) & (inside < 1)].tolist())

    def zero_points(self) -> Array:
        """Centres of the rectangles between four nodes that are all 0."""
        xs, ys, nodes = self._tables[:3]
        filled = nodes > 0
        rows = filled[:-1] | filled[1:]
        j, i = np.nonzero(~(rows[:, :-1] | rows[:, 1:]))
        return np.stack([(xs[i] + xs[i + 1]) / 2, (ys[j] + ys[j + 1]) / 2], axis=-1)

    @cached_property
    def _tables(self) -> _Tables:
        table = np.asarray(self.values, np.float64)
        xs, ys, nodes = self._knots(table / table.max())
        sums = _integrals(xs, nodes)
        rows = _integrals(ys, sums[:, -1])
        total = rows[-1]
        return _Tables(xs, ys, nodes / total, sums / total, rows / total)

    def _knots(self, table: Array) -> tuple[Array, Array, Array]:
        """Knots from 0 to 1 along both axes, and nodes at them."""
        if self.nodes == "corners":
            return np.linspace(0, 1, table.shape[1]), np.linspace(0, 1, table.shape[0]), table
        height, width = table.shape
        xs, ys = (np.concatenate([[0.0], (np.arange(k) + 0.5) / k, [1.0]]) for k in (width, height))
        wide = np.pad(table, ((1, 1), (1, 1)), mode="edge")
        if self.periodic:  # halfway between the last centre and the first
            wide[:, 0] = wide[:, -1] = (wide[:, 1] + wide[:, -2]) / 2
        return xs, ys, wide

    def _pdf(self, x: Array) -> Array:
        out = np.empty(x.shape[:-1])
        _bilinear_kernels.evaluate(*self._tables[:3], flat(x), out.reshape(-1))
        return out

    def _sample(self, u: Array) -> Array:
        x = np.empty(u.shape)
        inside = np.clip(u, 0.0, np.nextafter(1.0, 0.0))
        _bilinear_kernels.shape(*self._tables, flat(inside), x.reshape(-1, 2))
        return x

    def _invert(self, x: Array) -> Array:
        u = np.empty(x.shape)
        _bilinear_kernels.flatten(*self._tables, flat(x), u.reshape(-1, 2))
        return u


def _integrals(knots: Array, values: Array) -> Array:
    """Integrals from the first knot along the last axis, by trapezoids, as values are linear."""
    out = np.zeros_like(values)
    areas = np.diff(knots) * (values[..., :-1] + values[..., 1:]) / 2
    np.cumsum(areas, axis=-1, out=out[..., 1:])
    return out
