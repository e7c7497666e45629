"""Piecewise bilinear densities in two dims, by continuous marginal-conditional inversion.

Between four nodes, p(x) = Σ_ij v_ij B_i(x_0) B_j(x_1) with linear B, so p is continuous.
The warp T is also continuous where the marginal density is above 0.
T_1 inverts the marginal cdf, which is quadratic between two knots.
T_0 inverts the cdf along the line x_1 = T_1.
The cdf along a line is a blend of the cdfs of two rows of nodes, also quadratic between knots.
The primary-space integrand jumps only where f jumps. It has kinks where x passes a knot.
In contrast, every warp of a piecewise constant table jumps (`mcspectra.densities.tabulated`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import checked, choice, flag
from mcspectra.core.jit import kernel
from mcspectra.densities.base import Density
from mcspectra.densities.tabulated import as_table, below, flat, last_at_most, shown

__all__ = ["Bilinear"]


class _Tables(NamedTuple):
    """Tables of a bilinear density, in the form that the kernels take.

    The knots `xs` (w,) and `ys` (h,) run from 0 to 1. `nodes` (h, w) is the density at the knots.
    `sums` (h, w) has the integrals along each row, from 0 to each knot.
    These integrals are exact, because the density is linear between knots.
    `rows` (h,) has the integrals of ``sums[:, -1]`` along x_1, from 0 to each knot.
    """

    xs: Array
    ys: Array
    nodes: Array
    sums: Array
    rows: Array


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Bilinear(Density):
    """2-D density that interpolates bilinearly between the values at the nodes of a table.

    Attributes
    ----------
    values
        Relative density at each node, at least 0. The scale is arbitrary.
        Its shape is (h, w), with x_0 along a row and x_1 from the first row to the last.
    nodes
        ``"centers"``: node (i, j) is the center of cell (i, j) of h × w equal cells, like pixels.
        The outermost values extend to the borders.
        ``"corners"``: nodes lie at j/(w−1) and i/(h−1), ends included; h and w are at least 2.
    periodic
        Whether x_0 wraps around from the last column to the first; only for ``"centers"``.

    Notes
    -----
    The round trip ``invert(sample(u))`` may lose digits of u_0.
    Digits are lost if the marginal density between two rows grows by a large factor.
    Where the density grows fast, rounding of x_1 changes the conditional cdf that gives u_0.
    """

    dims: int = field(default=2, init=False)
    values: Any = checked(lambda _, values: shown(as_table(values)))
    nodes: str = choice("centers", "corners")
    periodic: bool = flag(default=False)

    def _check(self) -> None:
        shape = np.shape(self.values)
        least = 1 if self.nodes == "centers" else 2
        if len(shape) != 2 or min(shape) < least:
            raise ParameterError(
                f"values have shape {shape}; nodes at {self.nodes} need (h, w), "
                f"both at least {least}."
            )
        if self.periodic and self.nodes == "corners":
            raise ParameterError(
                "periodic goes with nodes='centers'; at corners, repeat the first column as the "
                "last."
            )

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Breaks on axis 1: values of the marginal cdf at the knots, where the slope of T jumps."""
        inside = np.unique(self._tables.rows[1:-1])
        return (), tuple(inside[(inside > 0) & (inside < 1)].tolist())

    def zero_points(self) -> Array:
        """Return the centers of rectangles whose four corner nodes are all 0."""
        xs, ys, nodes = self._tables[:3]
        filled = nodes > 0
        rows = filled[:-1] | filled[1:]
        j, i = np.nonzero(~(rows[:, :-1] | rows[:, 1:]))
        return np.stack([(xs[i] + xs[i + 1]) / 2, (ys[j] + ys[j + 1]) / 2], axis=-1)

    @cached_property
    def _tables(self) -> _Tables:
        table = np.asarray(self.values, np.float64)
        table = table / table.max()
        # Place knots from 0 to 1 along both axes, with nodes at them
        height, width = table.shape
        if self.nodes == "corners":
            xs, ys, nodes = np.linspace(0, 1, width), np.linspace(0, 1, height), table
        else:
            xs, ys = (
                np.concatenate([[0.0], (np.arange(k) + 0.5) / k, [1.0]]) for k in (width, height)
            )
            nodes = np.pad(table, ((1, 1), (1, 1)), mode="edge")
        if self.periodic:  # first and last column get the mean of the columns next to them
            nodes[:, 0] = nodes[:, -1] = (nodes[:, 1] + nodes[:, -2]) / 2
        sums = _integrals(xs, nodes)
        rows = _integrals(ys, sums[:, -1])
        total = rows[-1]
        return _Tables(xs, ys, nodes / total, sums / total, rows / total)

    def _pdf(self, x: Array) -> Array:
        out = np.empty(x.shape[:-1])
        _evaluate(*self._tables[:3], flat(x), out.reshape(-1))
        return out

    def _sample(self, u: Array) -> Array:
        x = np.empty(u.shape)
        inside = np.clip(u, 0.0, BELOW_ONE)
        _shape(*self._tables, flat(inside), x.reshape(-1, 2))
        return x

    def _invert(self, x: Array) -> Array:
        u = np.empty(x.shape)
        _flatten(*self._tables, flat(x), u.reshape(-1, 2))
        return u


def _integrals(knots: Array, values: Array) -> Array:
    """Integrate along the last axis from the first knot. Trapezoids are exact for linear pieces."""
    out = np.zeros_like(values)
    areas = np.diff(knots) * (values[..., :-1] + values[..., 1:]) / 2
    np.cumsum(areas, axis=-1, out=out[..., 1:])
    return out


@kernel
def _interval(knots: Array, x: float) -> int:
    """Return i with knots[i] <= x < knots[i+1]; points outside belong to the end intervals."""
    return last_at_most(knots, 0, knots.size - 1, x)


@kernel
def _fraction(knots: Array, i: int, x: float) -> float:
    return (x - knots[i]) / (knots[i + 1] - knots[i])  # type: ignore[no-any-return]


@kernel
def _solve(a: float, b: float, share: float) -> float:
    """Return t in [0,1] that divides the integral of a linear function.

    The function is a at 0 and b at 1.
    The integral of the linear function from 0 to t is `share` times its integral from 0 to 1.
    The result is the root of (b − a) t²/2 + a t = share (a + b)/2, without cancellation.
    """
    scale = max(a, b)
    if scale <= 0.0 or share <= 0.0:
        return 0.0
    a, b = a / scale, b / scale
    root = math.sqrt((1.0 - share) * a * a + share * b * b)
    return float(min(share * (a + b) / (a + root), 1.0))


@kernel
def _held(a: float, b: float, t: float) -> float:
    """Integral from 0 to t of the linear function that is a at 0 and b at 1."""
    return float(t * (a + 0.5 * t * (b - a)))


@kernel
def _mixed(table: Array, j: int, t: float, i: int) -> float:
    """Interpolate column i of `table` linearly between the rows j and j+1."""
    return (1.0 - t) * table[j, i] + t * table[j + 1, i]  # type: ignore[no-any-return]


@kernel
def _place(knots: Array, i: int, t: float) -> float:
    """Return the point at the fraction t of interval i, never in the next interval."""
    x = knots[i] + t * (knots[i + 1] - knots[i])
    return float(min(max(x, knots[i]), below(knots[i + 1])))


@kernel
def _evaluate(xs: Array, ys: Array, nodes: Array, x: Array, out: Array) -> None:
    """Fill out (N,) with the density at x (N, 2)."""
    for k in range(x.shape[0]):
        i, j = _interval(xs, x[k, 0]), _interval(ys, x[k, 1])
        s, t = _fraction(xs, i, x[k, 0]), _fraction(ys, j, x[k, 1])
        out[k] = (1.0 - s) * _mixed(nodes, j, t, i) + s * _mixed(nodes, j, t, i + 1)


@kernel
def _column(xs: Array, nodes: Array, sums: Array, j: int, t: float, u: float) -> float:
    """Return the x_0 at which the cdf along a line of constant x_1 is u.

    The line lies between the rows j and j + 1, at the fraction t of their distance.
    """
    total = _mixed(sums, j, t, xs.size - 1)
    if total <= 0.0:  # where the density is 0, x_0 = u_0, as in `_flatten`
        return u
    target = min(u * total, below(total))
    low, size = 0, xs.size - 1
    # Bisect as in `last_at_most`. The cdf is interpolated between the rows j and j + 1
    while size > 1:
        half = size >> 1
        low += half * (_mixed(sums, j, t, low + half) <= target)
        size -= half
    start = _mixed(sums, j, t, low)
    share = (target - start) / (_mixed(sums, j, t, low + 1) - start)
    a, b = _mixed(nodes, j, t, low), _mixed(nodes, j, t, low + 1)
    return _place(xs, low, _solve(a, b, share))


@kernel
def _shape(
    xs: Array, ys: Array, nodes: Array, sums: Array, rows: Array, u: Array, x: Array
) -> None:
    """Write the points x (N, 2) to which T maps u (N, 2); all coordinates are in [0,1)."""
    last = xs.size - 1
    for k in range(u.shape[0]):
        j = _interval(rows, u[k, 1])
        share = (u[k, 1] - rows[j]) / (rows[j + 1] - rows[j])
        x[k, 1] = _place(ys, j, _solve(sums[j, last], sums[j + 1, last], share))
        t = _fraction(ys, j, x[k, 1])  # use the rounded x_1, like `_flatten`
        x[k, 0] = _column(xs, nodes, sums, j, t, u[k, 0])


@kernel
def _flatten(
    xs: Array, ys: Array, nodes: Array, sums: Array, rows: Array, x: Array, u: Array
) -> None:
    """Undo `_shape`."""
    last = xs.size - 1
    for k in range(x.shape[0]):
        i, j = _interval(xs, x[k, 0]), _interval(ys, x[k, 1])
        s, t = _fraction(xs, i, x[k, 0]), _fraction(ys, j, x[k, 1])
        part = (ys[j + 1] - ys[j]) * _held(sums[j, last], sums[j + 1, last], t)
        u[k, 1] = min(rows[j] + part, rows[j + 1])
        total = _mixed(sums, j, t, last)
        if total <= 0.0:
            u[k, 0] = x[k, 0]
            continue
        part = (xs[i + 1] - xs[i]) * _held(_mixed(nodes, j, t, i), _mixed(nodes, j, t, i + 1), s)
        u[k, 0] = (_mixed(sums, j, t, i) + part) / total
