"""Continuous inversion of a piecewise bilinear density, first along x_1, then along x_0.

Legend: the knots `xs` (w,) and `ys` (h,) run from 0 to 1; `nodes` (h, w) is the density at them;
`sums` (h, w) integrates the nodes along each row, from 0 at the first knot (exact for a function that
is linear between knots); `rows` (h,) integrates ``sums[:, -1]`` along the columns, from 0 to 1.
"""

from __future__ import annotations

import math

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.densities._kernels import below, last_at_most

__all__ = ["evaluate", "flatten", "shape"]


@kernel
def _interval(knots: Array, x: float) -> int:
    """i with knots[i] <= x < knots[i+1]; points outside belong to the end intervals."""
    return last_at_most(knots, 0, knots.size - 1, x)


@kernel
def _fraction(knots: Array, i: int, x: float) -> float:
    return (x - knots[i]) / (knots[i + 1] - knots[i])  # type: ignore[no-any-return]


@kernel
def _solve(a: float, b: float, share: float) -> float:
    """t in [0,1] up to which the line from a to b holds `share` of its integral.

    The root of (b − a) t²/2 + a t = share (a + b)/2 in the form without cancellation.
    """
    scale = max(a, b)
    if scale <= 0.0 or share <= 0.0:
        return 0.0
    a, b = a / scale, b / scale
    root = math.sqrt((1.0 - share) * a * a + share * b * b)
    return float(min(share * (a + b) / (a + root), 1.0))


@kernel
def _held(a: float, b: float, t: float) -> float:
    """Integral up to t of the line from a at 0 to b at 1."""
    return float(t * (a + 0.5 * t * (b - a)))


@kernel
def _mixed(table: Array, j: int, t: float, i: int) -> float:
    """Entry i of rows j and j+1 of `table`, linear in t."""
    return (1.0 - t) * table[j, i] + t * table[j + 1, i]  # type: ignore[no-any-return]


@kernel
def _place(knots: Array, i: int, t: float) -> float:
    """The point at t in interval i; never the next interval's."""
    x = knots[i] + t * (knots[i + 1] - knots[i])
    return float(min(max(x, knots[i]), below(knots[i + 1])))


@kernel
def evaluate(xs: Array, ys: Array, nodes: Array, x: Array, out: Array) -> None:
    """Fill out (N,) with the density at x (N, 2)."""
    for k in range(x.shape[0]):
        i, j = _interval(xs, x[k, 0]), _interval(ys, x[k, 1])
        s, t = _fraction(xs, i, x[k, 0]), _fraction(ys, j, x[k, 1])
        out[k] = (1.0 - s) * _mixed(nodes, j, t, i) + s * _mixed(nodes, j, t, i + 1)


@kernel
def _column(xs: Array, nodes: Array, sums: Array, j: int, t: float, u: float) -> float:
    """x_0 of the share u along the line at t between rows j and j+1."""
    total = _mixed(sums, j, t, xs.size - 1)
    if total <= 0.0:  # a line without mass: any rule will do that `flatten` undoes
        return u
    target = min(u * total, below(total))
    low, size = 0, xs.size - 1
    while size > 1:  # as `last_at_most`, in the blend of two rows
        half = size >> 1
        low += half * (_mixed(sums, j, t, low + half) <= target)
        size -= half
    start = _mixed(sums, j, t, low)
    share = (target - start) / (_mixed(sums, j, t, low + 1) - start)
    a, b = _mixed(nodes, j, t, low), _mixed(nodes, j, t, low + 1)
    return _place(xs, low, _solve(a, b, share))


@kernel
def shape(xs: Array, ys: Array, nodes: Array, sums: Array, rows: Array, u: Array, x: Array) -> None:
    """Fill x (N, 2) from u (N, 2), in [0,1)."""
    last = xs.size - 1
    for k in range(u.shape[0]):
        j = _interval(rows, u[k, 1])
        share = (u[k, 1] - rows[j]) / (rows[j + 1] - rows[j])
        x[k, 1] = _place(ys, j, _solve(sums[j, last], sums[j + 1, last], share))
        t = _fraction(ys, j, x[k, 1])  # of the rounded point, which is the one that `flatten` sees
        x[k, 0] = _column(xs, nodes, sums, j, t, u[k, 0])


@kernel
def flatten(
    xs: Array, ys: Array, nodes: Array, sums: Array, rows: Array, x: Array, u: Array
) -> None:
    """Undo `shape`."""
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
