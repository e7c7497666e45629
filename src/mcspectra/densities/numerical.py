"""Warps of pdfs that have no sampling function: numerical inversion, in 1-D and 2-D.

In 1-D, the axis is divided into cells. Jumps and kinks are enclosed in ever smaller cells.
On each cell, a 12-point Chebyshev interpolant of the pdf is accurate to rounding.
Matrices convert the values at a cell's nodes to coefficients of the interpolant and its integral.
The interpolant is compared with the pdf at the ends of the cell and at the nodes of its halves.
If interpolant and pdf agree, the cell is not divided further [Trefethen2013]_.
The cdf is the integral of the interpolants. Newton's method inverts it within a cell.
The interpolants are then compared with the pdf at 2^18 other points.

In 2-D, x_1 is computed first, from its marginal. Then x_0 is computed from its density given x_1.
The module `mcspectra.densities.tabulated` uses the same order of the axes.
All rows are evaluated on the same cells, so the warp is as smooth along x_1 as the pdf.
Jumps along lines x_0 = c and x_1 = c are resolved exactly.
Jumps or kinks along other lines are searched for in 1018 rows, at 1024 places each.
If a jump or kink along another line is found, the pdf is rejected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.polynomial import chebyshev

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.errors import DensityError
from mcspectra.core.jit import kernel

__all__ = ["NumericalWarp"]

_START = {1: 256, 2: 16}
_MOST = {1: 2**15, 2: 256}
# Largest number of cells for the marginal pdf. At each node of a cell, a row is integrated
_MOST_OF_MARGINAL = 2**11
_ROWS = 509
_PROBES = {1: 2**18, 2: 2**10}  # number of probes along each axis
_SAME = 1e-9
_BLOCK = 2**20  # number of values in a block of rows, 8 MiB
_BEND = 1e-4
_SHARP = 2.0**-18  # cells narrower than this enclose a jump or a kink
_ORDER = 12
_TOLERANCE = 1e-14  # tolerance of each cell, relative to the whole integral
_MOST_UNRESOLVED = 1e-10
_NARROWEST = 4.0  # smallest width of a cell, in spacings of adjacent floats
_PLACE = 0.381966011250105  # position of a probe in its interval, not close to a dyadic fraction
_PROBED = 2**14  # number of probes per block
_OFF = 1e-7
_JUMP = 2.0**-24  # cells narrower than this enclose a jump or a pole
_ADVICE = "give sample=, or move a pole to 0, where floats are dense"
_LEAST = 1e-290  # smallest width of the cell at 0; closer to 0 a pole may overflow

_NODES = -np.cos(np.pi * (np.arange(_ORDER) + 0.5) / _ORDER)
_TO_SERIES = np.linalg.inv(chebyshev.chebvander(_NODES, _ORDER - 1))
_TO_INTEGRAL = np.stack([chebyshev.chebint(c, lbnd=-1) for c in _TO_SERIES.T], axis=1)
_TO_HALVES = (
    chebyshev.chebvander(
        np.concatenate([0.5 * (_NODES - 1), 0.5 * (_NODES + 1), [-1.0, 1.0]]), _ORDER - 1
    )
    @ _TO_SERIES
)


@final
@dataclass(frozen=True, eq=False)
class NumericalWarp:
    """The warp of a pdf, with its inverse.

    Attributes
    ----------
    pdf
        Function of points (..., d). Its integral is `total`, which need not be 1.
    dims
        Number of dims d, 1 or 2.
    spec
        Name of the density in messages.
    """

    pdf: Callable[[Array], Array]
    dims: int
    spec: str

    @property
    def total(self) -> float:
        """Integral of the pdf."""
        return self._last.total

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Cdf at jumps and kinks. In 2-D, only for axis 1, since breaks of axis 0 vary by row."""
        last = self._last.breaks()
        return (last,) if self.dims == 1 else ((), last)

    def zero_points(self) -> Array:
        """Return the centers of cells in which the pdf is 0. In 2-D, use the marginal pdf."""
        cells, masses = self._last.cells, np.diff(self._last.cdf)
        empty = (self._last.density == 0).all(axis=1) & (masses == 0) & (cells.width > _SHARP)
        centers = (cells.low + 0.5 * cells.width)[empty]
        return np.stack([np.full_like(centers, 0.5), centers], axis=1)[:, -self.dims :]

    @cached_property
    def _last(self) -> _Axis:
        """The cdf of x in 1-D, or of the marginal of x_1 in 2-D."""
        density = self.pdf if self.dims == 1 else self._marginal
        subject = f"The pdf of {self.spec}" if self.dims == 1 else f"The marginal of {self.spec}"
        cells = _refine(
            lambda x: density(x[..., None])[..., None],
            start=256,
            most=_MOST[1] if self.dims == 1 else _MOST_OF_MARGINAL,
            subject=subject,
            # In 2-D, the marginal pdf of x_1 is tested only at its quadrature nodes.
            # No other points are needed, because there are more than 509 nodes.
            # The cells along x_0 are also tested at only 509 values of x_1
            probes=_PROBES[1] if self.dims == 1 else 0,
        )
        return _Axis.of(cells, density(cells.nodes[..., None]))

    @cached_property
    def _rows(self) -> _Cells:
        """Cells along x_0, small enough to resolve the pdf in 509 rows (lines of constant x_1)."""
        rows = (0.5 + np.arange(_ROWS) * 0.6180339887498949) % 1.0

        subject = f"The pdf of {self.spec}, along x_0,"
        return _refine(
            lambda x: self._on_grid(x[..., None], rows),
            start=_START[2],
            most=_MOST[2],
            subject=subject,
            probes=_PROBES[2],
        )

    def _on_grid(self, x: Array, y: Array) -> Array:
        """Return the pdf at all pairs of x and y, which are arrays that broadcast."""
        return self.pdf(np.stack(np.broadcast_arrays(x, y), axis=-1))

    def _row_values(self, y: Array) -> Array:
        """Return the pdf in the rows at y (N,), at the nodes of all cells: (N, K, 12)."""
        return self._on_grid(self._rows.nodes, y[:, None, None])

    def _marginal(self, y: Array) -> Array:
        """Return integrals of the pdf over x_0 at y (..., 1)."""
        flat = y.ravel()
        parts = [
            self._rows.masses(self._row_values(flat[b])).sum(axis=-1) for b in self._blocks(flat)
        ]
        return np.concatenate(parts).reshape(y.shape[:-1])

    def _blocks(self, y: Array) -> list[slice]:
        each = 32 if self.dims == 1 else self._rows.nodes.size
        step = max(1, _BLOCK // each)
        return [slice(start, start + step) for start in range(0, max(1, len(y)), step)]

    def sample(self, u: Array) -> Array:
        """Return domain points of primary points (..., d)."""
        return self._warped(u, inverse=False)

    def invert(self, x: Array) -> Array:
        """Return primary points of domain points (..., d)."""
        return self._warped(x, inverse=True)

    def _warped(self, points: Array, *, inverse: bool) -> Array:
        flat = np.ascontiguousarray(points).reshape(-1, self.dims)
        out = np.empty_like(flat)
        for b in self._blocks(flat):
            last = self._last.invert if inverse else self._last.sample
            out[b, -1] = last(flat[b, -1])
            if self.dims == 2:
                y = np.clip(flat[b, 1] if inverse else out[b, 1], 0.0, 1.0)
                out[b, 0] = self._in_rows(flat[b, 0], y, inverse=inverse)
        return out.reshape(points.shape)

    def _in_rows(self, v: Array, y: Array, *, inverse: bool) -> Array:
        """Return x_0 for u_0 = v in the rows x_1 = y. With `inverse`, return u_0 for x_0 = v."""
        values = self._row_values(y)
        # Compute the cdf of each row at the borders of cells, scaled so that it ends at 1
        sums = np.cumsum(self._rows.masses(values), axis=1)
        total = np.where(sums[:, -1] > 0, sums[:, -1], 1.0)[:, None]
        cdf = np.concatenate([np.zeros((len(y), 1)), sums / total], axis=1)
        # Compute Chebyshev series of the density and the integral in each point's cell
        below = (cdf[:, :-1] <= v[:, None]).sum(axis=1) - 1
        cell = self._rows.find(v) if inverse else np.maximum(below, 0)
        each = np.arange(len(cell))
        start, width = cdf[each, cell], self._rows.width[cell]
        density, integral = self._rows.series(values[each, cell] / total, width)
        if inverse:
            return np.asarray(start + np.maximum(self._rows.part(cell, integral, v), 0.0))
        return self._rows.place(cell, density, integral, v - start)

    def check_rows(self) -> None:
        """In 2-D, compare integrals of rows over the cells with integrals over halved cells.

        The tested rows have values of x_1 that were not used to choose the sizes of the cells.

        Raises
        ------
        DensityError
            If the integrals differ: there are jumps or kinks along oblique or curved lines.
        """
        y = (0.25 + np.arange(_ROWS) * 0.7548776662466927) % 1.0
        finer = _Cells(*_halved(self._rows.low, self._rows.width))
        found = self._marginal(y[:, None])
        gap = finer.masses(self._on_grid(finer.nodes, y[:, None, None])).sum(axis=1) - found
        if not np.abs(gap).max() <= _SAME * found.mean():
            raise DensityError(
                f"The pdf of {self.spec} has jumps or kinks along lines that are not parallel to "
                "the axes; give sample=."
            )


@dataclass(frozen=True)
class _Axis:
    """A cdf on K cells: series of density (K, 12) and integral (K, 13), and borders (K+1,)."""

    cells: _Cells
    density: Array
    integral: Array
    cdf: Array
    total: float

    @staticmethod
    def of(cells: _Cells, values: Array) -> _Axis:
        sums = np.concatenate([[0.0], np.cumsum(cells.masses(values))])
        total = float(sums[-1])  # this makes the cdf exactly 1 after the last cell with mass
        if not total > 0:
            raise DensityError("The pdf is 0 at all evaluated points; its integral must be 1.")
        density, integral = cells.series(values / total, cells.width)
        return _Axis(cells, density, integral, sums / total, total)

    def sample(self, u: Array) -> Array:
        cell = np.searchsorted(self.cdf[:-1], u, side="right") - 1
        mass = u - self.cdf[cell]
        return self.cells.place(cell, self.density[cell], self.integral[cell], mass)

    def invert(self, x: Array) -> Array:
        cell = self.cells.find(x)
        share = self.cdf[cell] + self.cells.part(cell, self.integral[cell], x)
        return np.asarray(np.clip(share, self.cdf[cell], self.cdf[cell + 1]))

    def breaks(self) -> tuple[float, ...]:
        """Return the cdf at enclosed jumps and kinks, and at cell borders where the pdf jumps."""
        narrow = np.flatnonzero(self.cells.width < _SHARP)
        runs = np.split(narrow, np.flatnonzero(np.diff(narrow) > 1) + 1) if narrow.size else []
        closed = [run[np.argmin(self.cells.width[run])] for run in runs]
        # Find borders between wide cells where the density or its slope jumps
        half = 0.5 * self.cells.width
        values = chebyshev.chebval([-1.0, 1.0], self.density.T / half)
        slopes = chebyshev.chebval([-1.0, 1.0], chebyshev.chebder(self.density.T) / half**2)
        wide = np.minimum(half[1:], half[:-1]) > _SHARP
        gap = np.abs(values[1:, 0] - values[:-1, 1])
        bend = np.abs(slopes[1:, 0] - slopes[:-1, 1])
        bound = _BEND * (1.0 + np.abs(slopes[1:, 0]) + np.abs(slopes[:-1, 1]))
        borders = np.flatnonzero(wide & ((gap > _BEND) | (bend > bound))) + 1
        found = np.sort(self.cdf[np.union1d(closed, borders).astype(int)])
        found = found[(found > _SHARP) & (found < 1.0 - _SHARP)]
        return tuple(found[np.diff(found, prepend=-1.0) > _SAME].tolist())


@dataclass(frozen=True)
class _Cells:
    """Cells of [0,1] in ascending order, with left ends `low` and `width`, (K,)."""

    low: Array
    width: Array

    @cached_property
    def nodes(self) -> Array:
        """Nodes of all cells (K, 12)."""
        return _spread(self.low, self.width)

    def find(self, x: Array) -> Array:
        """Return the index of the cell that contains x."""
        return np.maximum(np.searchsorted(self.low, x, side="right") - 1, 0)

    def local(self, cell: Array, x: Array) -> Array:
        """Return the position of x in its cell, from −1 to 1."""
        return np.clip(2.0 * (x - self.low[cell]) / self.width[cell] - 1.0, -1.0, 1.0)

    def place(self, cell: Array, density: Array, integral: Array, mass: Array) -> Array:
        """Return the point in each cell below which the integral is `mass`."""
        t = np.empty(mass.shape)
        _solve(density, integral, mass, t)
        return np.asarray(self.low[cell] + 0.5 * (t + 1.0) * self.width[cell])

    def part(self, cell: Array, integral: Array, x: Array) -> Array:
        """Return integrals from the left end of each cell to x."""
        out = np.empty(x.shape)
        _integral_at(integral, self.local(cell, x), out)
        return out

    def series(self, values: Array, width: Array) -> tuple[Array, Array]:
        """Return Chebyshev series of a function and its integral, from values (..., 12)."""
        scaled = values * (0.5 * width[..., None])
        return scaled @ _TO_SERIES.T, scaled @ _TO_INTEGRAL.T

    def masses(self, values: Array) -> Array:
        """Return integrals over all cells from values (..., K, 12); negative integrals become 0."""
        weights = _TO_INTEGRAL.sum(axis=0)
        return np.asarray(np.maximum((values @ weights) * (0.5 * self.width), 0.0))


def _spread(low: Array, width: Array) -> Array:
    """Return nodes (..., 12) of cells with left ends `low` and widths `width`, all below 1."""
    nodes = low[..., None] + (0.5 * width)[..., None] * (_NODES + 1.0)
    return np.asarray(np.minimum(nodes, BELOW_ONE))


def _refine(
    function: Callable[[Array], Array], *, start: int, most: int, subject: str, probes: int = 0
) -> _Cells:
    """Split cells until the interpolants resolve a nonnegative function.

    The nodes of the cells may miss details between them. Therefore the function is also probed.
    If the interpolant differs from the function at a probe, the cell of the probe is split.
    The cells are split down to the distance between probes, and further if necessary.

    Parameters
    ----------
    function
        Function that maps nodes (C, 12) to values (C, 12, rows). All rows use the same cells.
    start, most
        Initial and largest number of cells.
    subject
        Name of the function in messages.
    probes
        Number of further, equally spaced points at which function and interpolant are compared.

    Raises
    ------
    DensityError
        If a value is negative or not finite, or `most` cells do not resolve the function.
    """
    cells = _split(function, start, most, subject, np.empty(0), 1.0)
    if not probes:
        return cells
    points = (np.arange(probes) + _PLACE) / probes
    missed = _missed(function, cells, points, subject)
    if not missed.size:
        return cells
    cells = _split(function, start, most, subject, missed, 1.0 / probes)
    if _missed(function, cells, (points + 0.5 / probes) % 1.0, subject).size:
        raise DensityError(
            f"{subject} has details narrower than {1.0 / probes:.2g}, which a numerical "
            "inverse does not resolve; give sample=."
        )
    return cells


def _missed(
    function: Callable[[Array], Array], cells: _Cells, points: Array, subject: str
) -> Array:
    """Return points where the interpolant of any row is inaccurate, except in cells at jumps."""
    at_nodes = function(cells.nodes)
    allowed = _OFF * (_size(at_nodes, cells.width) + np.abs(at_nodes).max(axis=(1, 2)))
    off = np.zeros(points.size, bool)
    for start in range(0, points.size, _PROBED):
        part = slice(start, start + _PROBED)
        x = points[part]
        cell = cells.find(x)
        basis = chebyshev.chebvander(cells.local(cell, x), _ORDER - 1) @ _TO_SERIES
        fitted = np.einsum("pn,pnr->pr", basis, at_nodes[cell])
        gap = np.abs(fitted - _checked(function(x[:, None]), subject)[:, 0]).max(axis=1)
        off[part] = (gap > allowed[cell]) & (cells.width[cell] > _JUMP)
    return points[off]


def _split(
    function: Callable[[Array], Array],
    start: int,
    most: int,
    subject: str,
    points: Array,
    narrow_enough: float,
) -> _Cells:
    """Return cells that resolve the function. Cells around `points` have a limited width."""
    low, width = np.arange(start) / start, np.full(start, 1.0 / start)
    values = _checked(function(_spread(low, width)), subject)
    total = _size(values, width)
    kept: list[tuple[Array, Array]] = []
    unresolved = 0.0
    while low.size:
        # Test the nodes of both halves, and the ends, because there may be a jump next to an end.
        # There may be a pole at 0, so the test uses the first node instead of 0
        nodes = _spread(*_halved(low, width)).reshape(low.size, 2 * _ORDER)
        first = np.where(low > 0, low, nodes[:, 0])
        ends = np.stack([first, np.nextafter(low + width, 0.0)], axis=1)
        found = _checked(function(np.concatenate([nodes, ends], axis=1)), subject)
        off = np.abs(np.einsum("hn,cnr->chr", _TO_HALVES, values) - found)
        off[low == 0, -2] = 0.0  # the left end 0 is not tested
        gap = off.max(axis=(1, 2)) * width
        narrow = width <= np.maximum(_NARROWEST * np.spacing(low + width), _LEAST)
        seen = np.searchsorted(points, low + width) == np.searchsorted(points, low)
        done = ((gap <= _TOLERANCE * total) & (seen | (width <= narrow_enough))) | narrow
        unresolved += float(gap[narrow].sum())
        kept.append((low[done], width[done]))
        low, width = _halved(low[~done], width[~done])
        values = found[~done, : 2 * _ORDER].reshape(low.size, _ORDER, values.shape[-1])
        if low.size + sum(len(part) for part, _ in kept) > most:
            raise DensityError(f"{subject} is too rough for a numerical inverse; {_ADVICE}.")
    if unresolved > _MOST_UNRESOLVED * total:
        raise DensityError(
            f"{subject} is too steep for a numerical inverse: {unresolved / total:.2g} of its "
            f"integral is not resolved; {_ADVICE}."
        )
    low, width = (np.concatenate(parts) for parts in zip(*kept, strict=True))
    order = np.argsort(low)
    return _Cells(low[order], width[order])


def _halved(low: Array, width: Array) -> tuple[Array, Array]:
    """Return left ends and widths (2C,) of the halves of cells."""
    half = 0.5 * width
    return np.stack([low, low + half], axis=1).ravel(), np.repeat(half, 2)


def _size(values: Array, width: Array) -> float:
    """Return the largest integral of any row.

    If all integrals are 0, return 1, so that a function that is 0 counts as resolved.
    """
    total = float((values.mean(axis=1) * width[:, None]).sum(axis=0).max())
    return total or 1.0


def _checked(values: Array, subject: str) -> Array:
    if not np.isfinite(values).all():
        bad = values[~np.isfinite(values)][0]
        raise DensityError(
            f"{subject} is not finite ({bad:.6g}) within (0,1): a numerical inverse allows a "
            "pole at 0 only; give sample=."
        )
    if (values < 0).any():
        raise DensityError(
            f"{subject} is negative ({values[values < 0][0]:.6g}) within (0,1); a density is "
            "at least 0 everywhere."
        )
    return values


@kernel
def _integral_at(series: Array, t: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Evaluate Chebyshev series (N, k) at t (N,) in [−1, 1]."""
    for i in range(t.size):
        previous, current, total = 1.0, t[i], series[i, 0]
        for k in range(1, series.shape[1]):
            total += series[i, k] * current
            previous, current = current, 2.0 * t[i] * current - previous
        out[i] = total


@kernel
def _solve(
    density: Array, integral: Array, mass: Array, out: Array
) -> None:  # pragma: no cover - compiled
    """Find t (N,) in [−1, 1] where the integral, a series (N, 13), reaches the mass (N,).

    Newton's method works within a bracket. Bisection replaces steps that leave the bracket.
    """
    for i in range(mass.size):
        whole = 0.0
        for k in range(integral.shape[1]):
            whole += integral[i, k]
        low, high = -1.0, 1.0
        t = -1.0 + 2.0 * mass[i] / whole if whole > 0.0 else 0.0
        t = min(max(t, -1.0), 1.0)
        for _ in range(100):
            slope, excess = density[i, 0], integral[i, 0] - mass[i]
            previous, current = 1.0, t
            for k in range(1, integral.shape[1]):
                excess += integral[i, k] * current
                if k < density.shape[1]:
                    slope += density[i, k] * current
                previous, current = current, 2.0 * t * current - previous
            if excess > 0.0:
                high = t
            else:
                low = t
            step = t - excess / slope if slope > 0.0 else -2.0
            if not low <= step <= high:
                step = 0.5 * (low + high)
            if abs(step - t) <= 2e-16 or excess == 0.0:
                break
            t = step
        out[i] = t
