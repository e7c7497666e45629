"""The warp of a pdf without a known sampling function: numerical inversion, in 1-D and 2-D.

1-D: the axis is cut into cells on which 12-point Chebyshev interpolants of the pdf are as accurate as
rounding; jumps and kinks are closed in by ever smaller cells. The cdf is the integral of the
interpolants, its inverse Newton's method in the cell. 2-D: marginal of x_1, then x_0 given x_1, as in
`mcspectra.densities.tabulated`; the row of each point is evaluated anew on common cells, so that the
warp is as smooth along x_1 as the pdf. Cells are exact for jumps along lines x_0 = c and x_1 = c.
Jumps and kinks along other lines are refused where one of 1018 rows and 1024 places on them sees
them. In 1-D the interpolants are compared with the pdf at 2^18 further points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.polynomial import chebyshev

from mcspectra.core.checks import Array
from mcspectra.core.errors import DensityError
from mcspectra.densities._chebyshev import Cells, integral_at, refine, solve

__all__ = ["NumericalWarp"]

_START = {1: 256, 2: 16}
_MOST = {1: 2**15, 2: 256}
_MOST_OF_MARGINAL = 2**11  # each node of it is a row
_ROWS = 509
_PROBES = {1: 2**18, 2: 2**10}  # along an axis
_SAME = 1e-9
_BLOCK = 2**20  # values of a row block, 8 MiB
_BEND = 1e-4
_SHARP = 2.0**-18  # cells narrower than this close in a jump or a kink


@dataclass(frozen=True)
class _Axis:
    """A cdf on cells: series of density and integral in each (K, 12) and (K, 13), cdf (K+1,)."""

    cells: Cells
    density: Array
    integral: Array
    cdf: Array
    total: float

    @staticmethod
    def of(cells: Cells, values: Array) -> _Axis:
        sums = np.concatenate([[0.0], np.cumsum(cells.masses(values))])
        total = float(sums[-1])  # so that the cdf is exactly 1 where nothing follows
        if not total > 0:
            raise DensityError("The pdf is 0 at all evaluated points; its integral must be 1.")
        density, integral = cells.series(values / total, cells.width)
        return _Axis(cells, density, integral, sums / total, total)

    def sample(self, u: Array) -> Array:
        cell = np.searchsorted(self.cdf[:-1], u, side="right") - 1
        t = np.empty(u.shape)
        solve(self.density[cell], self.integral[cell], u - self.cdf[cell], t)
        return self.cells.low[cell] + 0.5 * (t + 1.0) * self.cells.width[cell]

    def invert(self, x: Array) -> Array:
        cell = self.cells.find(x)
        part = np.empty(x.shape)
        integral_at(self.integral[cell], self.cells.local(cell, x), part)
        return np.clip(self.cdf[cell] + part, self.cdf[cell], self.cdf[cell + 1])

    def breaks(self) -> tuple[float, ...]:
        """Cdf where cells close in a jump or kink, and at borders across which the pdf jumps."""
        narrow = np.flatnonzero(self.cells.width < _SHARP)
        runs = np.split(narrow, np.flatnonzero(np.diff(narrow) > 1) + 1) if narrow.size else []
        closed = [run[np.argmin(self.cells.width[run])] for run in runs]
        found = np.sort(self.cdf[np.union1d(closed, self._borders()).astype(int)])
        found = found[(found > _SHARP) & (found < 1.0 - _SHARP)]
        return tuple(found[np.diff(found, prepend=-1.0) > _SAME].tolist())

    def _borders(self) -> Array:
        """Indices of borders at which density or slope differ on both sides, beside wide cells."""
        half = 0.5 * self.cells.width
        values = chebyshev.chebval([-1.0, 1.0], self.density.T / half)
        slopes = chebyshev.chebval([-1.0, 1.0], chebyshev.chebder(self.density.T) / half**2)
        wide = np.minimum(half[1:], half[:-1]) > _SHARP
        gap = np.abs(values[1:, 0] - values[:-1, 1])
        bend = np.abs(slopes[1:, 0] - slopes[:-1, 1])
        bound = _BEND * (1.0 + np.abs(slopes[1:, 0]) + np.abs(slopes[:-1, 1]))
        return np.flatnonzero(wide & ((gap > _BEND) | (bend > bound))) + 1


@final
@dataclass(frozen=True, eq=False)
class NumericalWarp:
    """The warp of a pdf, with its inverse.

    Attributes
    ----------
    pdf
        Points (..., d) to (...); its integral, `total`, need not be 1.
    dims
        d, 1 or 2.
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
        """The cdf at jumps and kinks; in 2-D on axis 1 only, those of axis 0 depend on the row."""
        last = self._last.breaks()
        return (last,) if self.dims == 1 else ((), last)

    def zero_points(self) -> Array:
        """Centres of cells in which the pdf is 0; in 2-D of those of the marginal."""
        cells, masses = self._last.cells, np.diff(self._last.cdf)
        empty = (self._last.density == 0).all(axis=1) & (masses == 0) & (cells.width > _SHARP)
        centers = (cells.low + 0.5 * cells.width)[empty]
        return np.stack([np.full_like(centers, 0.5), centers], axis=1)[:, -self.dims :]

    @cached_property
    def _last(self) -> _Axis:
        """The only axis, or the marginal of x_1."""
        density = self.pdf if self.dims == 1 else self._marginal
        subject = f"The pdf of {self.spec}" if self.dims == 1 else f"The marginal of {self.spec}"
        cells = refine(
            lambda x: density(x[..., None])[..., None],
            start=256,
            most=_MOST[1] if self.dims == 1 else _MOST_OF_MARGINAL,
            subject=subject,
            probes=_PROBES[1] if self.dims == 1 else 0,  # 3072 nodes are more than there are rows
        )
        return _Axis.of(cells, density(cells.nodes[..., None]))

    @cached_property
    def _rows(self) -> Cells:
        """Cells of axis 0 that suit 509 rows at once."""
        rows = (0.5 + np.arange(_ROWS) * 0.6180339887498949) % 1.0

        def values(x: Array) -> Array:
            points = np.broadcast_arrays(x[..., None], rows)
            return self.pdf(np.stack(points, axis=-1))

        subject = f"The pdf of {self.spec}, along x_0,"
        return refine(values, start=_START[2], most=_MOST[2], subject=subject, probes=_PROBES[2])

    def _row_values(self, y: Array) -> Array:
        """Values (N, K, 12) of the rows at y (N,)."""
        points = np.broadcast_arrays(self._rows.nodes, y[:, None, None])
        return self.pdf(np.stack(points, axis=-1))

    def _marginal(self, y: Array) -> Array:
        """Integrals over x_0 at y (..., 1)."""
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
        """Domain points of primary points (..., d)."""
        return self._warped(u, _Axis.sample, self._row_sample)

    def invert(self, x: Array) -> Array:
        """Primary points of domain points (..., d)."""
        return self._warped(x, _Axis.invert, self._row_invert)

    def _warped(
        self,
        points: Array,
        last: Callable[[_Axis, Array], Array],
        row: Callable[[Array, Array], Array],
    ) -> Array:
        """Points (..., d) with each axis warped; `row` takes x_0 or u_0, and x_1."""
        flat = np.ascontiguousarray(points).reshape(-1, self.dims)
        out = np.empty_like(flat)
        for b in self._blocks(flat):
            out[b, -1] = last(self._last, flat[b, -1])
            if self.dims == 2:
                y = np.clip(out[b, 1] if last is _Axis.sample else flat[b, 1], 0.0, 1.0)
                out[b, 0] = row(flat[b, 0], y)
        return out.reshape(points.shape)

    def _row_cdf(self, y: Array) -> tuple[Array, Array]:
        """Values (N, K, 12), scaled to rows of integral 1, and the cdf at cell borders (N, K+1)."""
        values = self._row_values(y)
        sums = np.cumsum(self._rows.masses(values), axis=1)
        total = np.where(sums[:, -1] > 0, sums[:, -1], 1.0)
        cdf = np.concatenate([np.zeros((len(y), 1)), sums / total[:, None]], axis=1)
        return values / total[:, None, None], cdf

    def _row_sample(self, u: Array, y: Array) -> Array:
        values, cdf = self._row_cdf(y)
        cell = np.maximum((cdf[:, :-1] <= u[:, None]).sum(axis=1) - 1, 0)
        density, integral, start = self._chosen(values, cdf, cell)
        t = np.empty(len(u))
        solve(density, integral, u - start, t)
        return np.asarray(self._rows.low[cell] + 0.5 * (t + 1.0) * self._rows.width[cell])

    def _row_invert(self, x: Array, y: Array) -> Array:
        values, cdf = self._row_cdf(y)
        cell = self._rows.find(x)
        _, integral, start = self._chosen(values, cdf, cell)
        part = np.empty(len(x))
        integral_at(integral, self._rows.local(cell, x), part)
        return start + np.maximum(part, 0.0)

    def _chosen(self, values: Array, cdf: Array, cell: Array) -> tuple[Array, Array, Array]:
        """Series of density and integral in one cell of each row, and the cdf at its left end."""
        each = np.arange(len(cell))
        density, integral = self._rows.series(values[each, cell], self._rows.width[cell])
        return density, integral, cdf[each, cell]

    def check_rows(self) -> None:
        """Compare row integrals of 2-D with those on halved cells, at rows that made no cells.

        Raises
        ------
        DensityError
            They differ: there are jumps or kinks along other lines.
        """
        y = (0.25 + np.arange(_ROWS) * 0.7548776662466927) % 1.0
        own, half = self._rows, 0.5 * self._rows.width
        low = np.stack([own.low, own.low + half], axis=1).ravel()
        finer = Cells(low, np.repeat(half, 2))
        points = np.broadcast_arrays(finer.nodes, y[:, None, None])
        found = self._marginal(y[:, None])
        gap = finer.masses(self.pdf(np.stack(points, axis=-1))).sum(axis=1) - found
        if not np.abs(gap).max() <= _SAME * found.mean():
            raise DensityError(
                f"The pdf of {self.spec} has jumps or kinks along lines that are not parallel to the "
                "axes; give sample=."
            )
