"""Piecewise constant densities, from a table or a picture, in one and two dims.

Which warp
----------
In 1-D the inverse of the cdf is the only monotone warp. In 2-D one pdf has many warps, and the warp
decides where the primary-space integrand g(u) = f(T(u))/p(T(u)) jumps, and with it the rate:

* *Marginal and conditional* (here; Shirley 1992, "Nonuniform random point sets via warping";
  Pharr, Jakob, Humphreys, "Physically Based Rendering", §A.5): u_1 chooses the row by the marginal
  cdf, u_0 the column by the cdf within that row. T_1 is continuous; T_0 jumps from row to row. All
  jumps lie on axis-aligned segments: whole lines ``u_1 = row border``, and within a row pieces
  ``u_0 = column border`` that differ from row to row. Where all rows are proportional (a separable
  table) T is continuous and g jumps, with p, on whole lines only.
* *Hierarchical* warping (Clarberg, Jarosz, Akenine-Möller, Jensen 2005, "Wavelet importance
  sampling") splits the square in quadtree order. It keeps nearby points nearer, in both axes, but
  its jumps form trees of segments of all sizes.
* *Alias tables* (Walker 1977) cost O(1) and cut u into two unordered pieces a cell: T is nowhere
  monotone, has no inverse, and takes all stratification away.
* *Bilinear* tables make p, and so g along rows, continuous: the remedy when jumps cost the rate.

A border cuts strata, rather than falling between them, unless its position is a multiple of their
side: jittered sampling in 2-D then loses from n^-2 to n^-1.5 (see the environment-map study).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.densities import _kernels
from mcspectra.densities.base import Density

__all__ = ["ImageDensity", "PiecewiseConstant"]

_MOST_SHOWN = 256  # tables up to this size are kept as lists, so that spec strings hold them
_SAME_ROWS = 1e-12  # relative; rows that are proportional but for rounding


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PiecewiseConstant(Density):
    """Constant in cells of equal size, given by a list (1-D) or by rows of a table (2-D).

    Attributes
    ----------
    values
        Relative density of each cell, at least 0 and not all 0; any scale. Shape (w,), or (h, w)
        with x_0 along a row and x_1 from the first row to the last.
    """

    name: ClassVar[str] = "piecewise-constant"
    values: Any

    def __post_init__(self) -> None:
        table = _as_table(self.values)
        kept = table.tolist() if table.size <= _MOST_SHOWN else table
        object.__setattr__(self, "values", kept)

    @property
    def dims(self) -> int:  # type: ignore[override]
        """1 or 2, as `values`."""
        return int(self._table.ndim)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Shares at which the warp or its slope jumps along a whole axis-normal line.

        In 1-D the cdf at the borders between different cells. In 2-D, along axis 1, the marginal
        cdf between different rows; along axis 0 the cdf at the column borders if it is the same for
        all rows. Otherwise those borders form segments that differ from row to row, and none are
        given.
        """
        cells, (rows, columns) = self._cells, self._cdfs
        across = _inner(columns[0], cells[0]) if self._separable else ()
        if self.dims == 1:
            return (across,)
        differ = (np.diff(cells, axis=0) != 0).any(axis=1)
        return (across, tuple(np.unique(rows[1:-1][differ]).tolist()))

    def reciprocal_integral(self) -> float:
        """Mean over cells of 1/p, infinite where a cell is 0."""
        return float((1.0 / self._pdf_table).mean()) if self._pdf_table.all() else np.inf

    def zero_points(self) -> Array:
        """Centres of the cells that hold nothing."""
        cells = np.argwhere(self._table == 0)[:, ::-1]  # rows run along axis 1
        return np.asarray((cells + 0.5) / np.array(self._table.shape[::-1]))

    @cached_property
    def _table(self) -> Array:
        return np.asarray(self.values, np.float64)

    @cached_property
    def _cells(self) -> Array:
        """The table as (h, w), a single row in 1-D, scaled so that no sum overflows."""
        return np.asarray(np.atleast_2d(self._table) / self._table.max())

    @cached_property
    def _pdf_table(self) -> Array:
        return np.asarray(self._cells / self._cells.mean())

    @cached_property
    def _cdfs(self) -> tuple[Array, Array]:
        """The marginal cdf of rows (h+1,) and the cdf in each row (h, w+1)."""
        return _cdf(self._cells.sum(axis=1)), _cdf(self._cells)

    @cached_property
    def _separable(self) -> bool:
        """Whether all rows that hold mass are proportional to the first such row."""
        columns = self._cdfs[1][self._cells.any(axis=1)]
        return bool(np.abs(columns - columns[0]).max() <= _SAME_ROWS)

    def _pdf(self, x: Array) -> Array:
        out = np.empty(x.shape[:-1])
        _kernels.look_up(self._pdf_table, _flat(x), out.reshape(-1))
        return out

    def _sample(self, u: Array) -> Array:
        x = np.empty(u.shape)
        inside = np.clip(u, 0.0, np.nextafter(1.0, 0.0))
        _kernels.warp(*self._cdfs, _flat(inside), x.reshape(-1, self.dims))
        return x

    def _invert(self, x: Array) -> Array:
        u = np.empty(x.shape)
        _kernels.unwarp(*self._cdfs, _flat(x), u.reshape(-1, self.dims))
        return u


@final
@dataclass(frozen=True, kw_only=True)
class ImageDensity(Density):
    """Proportional to the pixels of a picture, x_0 to the right and x_1 down from the top.

    Attributes
    ----------
    path
        A file that `mcspectra.core.images.read_image` reads.
    channel
        ``"luminance"`` (Rec. 709; of one channel, itself) or the number of a channel.
    floor
        Pixels below `floor` times the mean are raised to it; 0 or more. Above 0 the density is
        positive everywhere.
    linear
        Values of PNG and JPEG files are linear, not sRGB.
    """

    name: ClassVar[str] = "image"
    dims: int = field(default=2, init=False)
    path: str | os.PathLike[str]
    channel: str | int = "luminance"
    floor: float = 0.0
    linear: bool = False
    _inside: PiecewiseConstant = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        as_real("floor", self.floor, least=0.0)
        if not isinstance(self.linear, bool):
            raise ParameterError(f"linear is {self.linear!r}; give True or False.")
        pixels = _select(self.path, self.channel, self.linear)
        object.__setattr__(self, "path", os.fspath(self.path))
        low = int(np.count_nonzero(pixels < 0))
        if low:
            raise DensityError(
                f"{self.path} has {low} negative pixels; a density needs values of 0 or more."
            )
        if not pixels.any():
            raise DensityError(f"{self.path} is black; a density needs pixels above 0.")
        raised = np.maximum(pixels, self.floor * pixels.mean()) if self.floor else pixels
        object.__setattr__(self, "_inside", PiecewiseConstant(values=raised))

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Those of the table (see `PiecewiseConstant.breaks`)."""
        return self._inside.breaks

    def zero_points(self) -> Array:
        """Centres of the pixels that are black."""
        return self._inside.zero_points()

    def reciprocal_integral(self) -> float:
        """Mean over pixels of 1/p."""
        return self._inside.reciprocal_integral()

    def _pdf(self, x: Array) -> Array:
        return self._inside._pdf(x)

    def _sample(self, u: Array) -> Array:
        return self._inside._sample(u)

    def _invert(self, x: Array) -> Array:
        return self._inside._invert(x)


def _as_table(values: object) -> Array:
    """Check relative densities and return them as a read-only copy."""
    try:
        given = np.asarray(values)
    except ValueError:  # rows of different lengths
        given = np.asarray(None)
    if given.dtype.kind not in "fiub":
        raise ParameterError(
            "values are not an array of real numbers; give a list, or rows of equal length."
        )
    table = np.array(given, dtype=np.float64)
    if table.ndim not in (1, 2) or table.size == 0:
        raise ParameterError(f"values have shape {table.shape}; give (w,) or (h, w), not empty.")
    if not np.isfinite(table).all() or table.min() < 0 or not table.any():
        raise ParameterError(
            f"values run from {table.min():g} to {table.max():g}; "
            "they must be finite, at least 0, and not all 0."
        )
    table.setflags(write=False)
    return table


def _cdf(masses: Array) -> Array:
    """Cdf along the last axis, (..., k+1) from 0 to exactly 1; uniform where there is no mass."""
    sums = np.zeros((*masses.shape[:-1], masses.shape[-1] + 1))
    np.cumsum(masses, axis=-1, out=sums[..., 1:])
    total = sums[..., -1:]
    even = np.broadcast_to(np.linspace(0.0, 1.0, sums.shape[-1]), sums.shape)
    return np.divide(sums, total, out=even.copy(), where=total > 0)


def _inner(borders: Array, cells: Array) -> tuple[float, ...]:
    """Cdf values strictly within (0,1) between cells that differ."""
    found = np.unique(borders[1:-1][np.diff(cells) != 0])
    return tuple(found[(found > 0) & (found < 1)].tolist())


def _flat(points: Array) -> Array:
    return np.ascontiguousarray(points).reshape(-1, points.shape[-1])


def _select(path: str | os.PathLike[str], channel: object, linear: bool) -> Array:
    """One channel of a picture, (h, w)."""
    from mcspectra.core.images import luminance, read_image

    image = read_image(path, linear=linear)
    if channel == "luminance":
        return luminance(image)
    if isinstance(channel, str):
        raise ParameterError(f'channel is {channel!r}; give "luminance" or a number.')
    return np.asarray(image[..., as_integer("channel", channel, least=0, most=image.shape[2] - 1)])
