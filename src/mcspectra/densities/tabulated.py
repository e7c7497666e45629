"""Piecewise constant densities, from a table or a picture, in one and two dims.

Which warp
----------
In 1-D the inverse of the cdf is the only monotone warp. In 2-D one pdf has many warps, and the warp
decides where the primary-space integrand g(u) = f(T(u))/p(T(u)) jumps, and with it the rate.
`warp` chooses one of four, for the same pdf to the last bit (h rows of w columns):

* ``"marginal"`` (Shirley 1992, "Nonuniform random point sets via warping"; Pharr, Jakob, Humphreys,
  "Physically Based Rendering", §A.5): u_1 chooses the row by the marginal cdf, u_0 the column by
  the cdf within that row. T_1 is continuous; T_0 jumps from row to row. All jumps lie on
  axis-aligned segments: whole lines ``u_1 = row border``, and within a row pieces
  ``u_0 = column border`` that differ from row to row. A line along u_0 meets no jump of T, one
  along u_1 at most h − 1. Where all rows are proportional (a separable table) T is continuous and
  g jumps, with p, on whole lines only.
* ``"hierarchical"`` [McCoolHarwood1997]_ [Clarberg2005]_ halves the table, always the longer side,
  down to the cells; each split takes its share of u along that side. Neighborhoods stay compact in
  both axes, but a split is a jump for every other split that it crosses: lines along u_0 meet
  w − 1 jumps at most, lines along u_1 h − 1.
* ``"alias"`` [Walker1977]_ [Vose1991]_ costs O(1): u_0 chooses one of h·w bins of equal size and
  one of the two cells in it; the remainder of u_0 places along x_0, u_1 along x_1. Up to 2hw − 1
  jumps on a line along u_0, to anywhere; sets are stratified in u_1 only, within cells. A
  cell fills from several bins, each time whole, so T is many-to-one and has *no inverse*.
* ``"hilbert"`` [SteiglederMcCool2003]_: u_0 chooses a cell by the cdf along a Hilbert curve and its
  remainder places in the direction in which the curve leaves the cell, u_1 across it. Up to
  hw − 1 jumps on a line along u_0, where the curve turns, each within two neighboring cells
  where the table is a square of 2^k (elsewhere the curve leaves the table and comes back); none
  along u_1. Made for n strata in u_0: square strata in 2-D get √n of them along the curve.

*Bilinear* tables (`bilinear`) make p, and so g along rows, continuous: the remedy when jumps cost
the rate.

A border cuts strata, rather than falling between them, unless its position is a multiple of their
side: jittered sampling in 2-D then loses from n^-2 to n^-1.5 (see the environment-map study).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer, as_real
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.densities import _kernels
from mcspectra.densities._warps import WARPS, TableWarp, make_warp
from mcspectra.densities.base import Density

__all__ = ["ImageDensity", "PiecewiseConstant", "as_table", "flat", "select_channel", "shown"]

_MOST_SHOWN = 256  # tables up to this size are kept as lists, so that spec strings hold them
_MOST_CELLS = 2**26  # 512 MiB a copy, and a warp holds a few


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PiecewiseConstant(Density):
    """Constant in cells of equal size, given by a list (1-D) or by rows of a table (2-D).

    Attributes
    ----------
    values
        Relative density of each cell, at least 0 and not all 0; any scale. Shape (w,), or (h, w)
        with x_0 along a row and x_1 from the first row to the last.
    warp
        ``"marginal"``, ``"hierarchical"``, ``"alias"`` or ``"hilbert"``: which T has that density
        (see the module). In 1-D all but ``"alias"`` are the same.
    """

    name: ClassVar[str] = "piecewise-constant"
    warps: ClassVar[tuple[str, ...]] = WARPS
    values: Any
    warp: str = "marginal"

    def __post_init__(self) -> None:
        as_choice("warp", self.warp, WARPS)
        object.__setattr__(self, "values", shown(as_table(self.values)))

    @property
    def dims(self) -> int:  # type: ignore[override]
        """1 or 2, as `values`."""
        return int(self._table.ndim)

    @property
    def has_inverse(self) -> bool:
        """False for alias tables, which are many-to-one."""
        return self._warp.one_to_one

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Shares at which the warp or its slope jumps along a whole axis-normal line.

        In 1-D the cdf at the borders between different cells. In 2-D those of the warp:
        `mcspectra.densities._warps`. Borders that form segments rather than lines are not given, nor
        are more than 4096 along one axis.
        """
        return self._warp.breaks()[: self.dims]

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
    def _warp(self) -> TableWarp:
        return make_warp(self.warp, self._cells, self.dims)

    def _pdf(self, x: Array) -> Array:
        out = np.empty(x.shape[:-1])
        _kernels.look_up(self._pdf_table, flat(x), out.reshape(-1))
        return out

    def _sample(self, u: Array) -> Array:
        x = np.empty(u.shape)
        inside = np.clip(u, 0.0, np.nextafter(1.0, 0.0))
        self._warp.sample(flat(inside), x.reshape(-1, self.dims))
        return x

    def _invert(self, x: Array) -> Array:
        if not self.has_inverse:
            raise DensityError(
                f"{self.spec} maps several u to one x and has no inverse; choose another warp."
            )
        u = np.empty(x.shape)
        self._warp.invert(flat(x), u.reshape(-1, self.dims))
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
    warp
        As in `PiecewiseConstant`.
    """

    name: ClassVar[str] = "image"
    warps: ClassVar[tuple[str, ...]] = WARPS
    dims: int = field(default=2, init=False)
    path: str | os.PathLike[str]
    channel: str | int = "luminance"
    floor: float = 0.0
    linear: bool = False
    warp: str = "marginal"
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
        object.__setattr__(self, "_inside", PiecewiseConstant(values=raised, warp=self.warp))

    @property
    def has_inverse(self) -> bool:
        """False for alias tables."""
        return self._inside.has_inverse

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Breaks of the table (see `PiecewiseConstant.breaks`)."""
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


def as_table(values: object) -> Array:
    """Check relative densities and return them as a read-only copy."""
    try:
        given = np.asarray(values)
    except ValueError:  # rows of different lengths
        given = np.asarray(None)
    if given.dtype.kind not in "fiub":
        raise ParameterError(
            "values are not an array of real numbers; give a list, or rows of equal length."
        )
    if given.ndim not in (1, 2) or given.size == 0:
        raise ParameterError(f"values have shape {given.shape}; give (w,) or (h, w), not empty.")
    if given.size > _MOST_CELLS:
        raise ParameterError(
            f"values have shape {given.shape}; tables hold at most {_MOST_CELLS:.3g} cells."
        )
    table = np.array(given, dtype=np.float64)
    if not np.isfinite(table).all() or table.min() < 0 or not table.any():
        raise ParameterError(
            f"values run from {table.min():g} to {table.max():g}; "
            "they must be finite, at least 0, and not all 0."
        )
    table.setflags(write=False)
    return table


def shown(table: Array) -> Any:
    """The table as spec strings show it: a list, or the array where it is long."""
    return table.tolist() if table.size <= _MOST_SHOWN else table


def flat(points: Array) -> Array:
    """Points (..., d) as contiguous (N, d), for kernels."""
    return np.ascontiguousarray(points).reshape(-1, points.shape[-1])


def _select(path: str | os.PathLike[str], channel: object, linear: bool) -> Array:
    """One channel of a picture, (h, w)."""
    from mcspectra.core.images import read_image

    return select_channel(read_image(path, linear=linear), channel)


def select_channel(image: Array, channel: object) -> Array:
    """One channel (h, w), by number, or the luminance, of pixels (h, w, channels)."""
    from mcspectra.core.images import luminance

    if channel == "luminance":
        return luminance(image)
    if isinstance(channel, str):
        raise ParameterError(f'channel is {channel!r}; give "luminance" or a number.')
    return np.asarray(image[..., as_integer("channel", channel, least=0, most=image.shape[2] - 1)])
