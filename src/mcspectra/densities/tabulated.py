"""Piecewise constant densities from a table or a picture, in one and two dims.

Four warps
----------
In 1-D the inverse of the cdf is the only monotone warp. In 2-D one pdf has many warps.
The warp T determines where the primary-space integrand g(u) = f(T(u))/p(T(u)) jumps.
Therefore the choice of the warp determines the rate.
`warp` chooses one of four warps, for exactly the same pdf (h rows of w columns):

* ``"marginal"`` [Shirley1992]_ [Pharr2016]_ (§13.6.7): u_1 chooses the row by the marginal cdf.
  u_0 chooses the column by the cdf within that row.
  T_1 is continuous, and T_0 jumps from row to row. All jumps of g lie on axis-aligned segments.
  Lines ``u_1 = row border`` cross the whole square. Each row has segments ``u_0 = column border``.
  The positions u_0 of the segments differ from row to row.
  A line along u_0 crosses no jump of T, and a line along u_1 crosses at most h − 1 jumps.
  If all rows are proportional (a separable table), T is continuous.
  For a separable table, g jumps only where p jumps, along lines across the whole square.
* ``"hierarchical"`` [McCoolHarwood1997]_ [Clarberg2005]_: the table is halved repeatedly.
  Each split halves the longer side, until single cells are left.
  A split along x_0 uses the coordinate u_0, and a split along x_1 uses u_1.
  Points u that are close in both coordinates mostly map to points x that are close.
  T jumps at the border of a split if the two halves are then divided in different ratios.
  Lines along u_0 cross at most w − 1 jumps, and lines along u_1 at most h − 1 jumps.
* ``"alias"`` [Walker1977]_ [Vose1991]_: this warp costs O(1).
  u_0 chooses one of h·w bins of equal size, and one of the two cells in the bin.
  The remainder of u_0 gives the position along x_0, and u_1 gives the position along x_1.
  In a table of h × w cells, a line along u_0 crosses up to 2hw − 1 jumps.
  At each jump, x may move to any other cell of the table.
  Point sets remain stratified only in u_1, and only within cells.
  Several bins may map to the whole of a cell, so T is many-to-one and has *no inverse*.
* ``"hilbert"`` [SteiglederMcCool2003]_: u_0 chooses a cell by the cdf along a Hilbert curve.
  The remainder of u_0 gives the position in the direction in which the curve leaves the cell.
  u_1 gives the position in the cell perpendicular to the curve.
  In a table of h × w cells, a line along u_0 crosses up to hw − 1 jumps.
  The jumps are at the turns of the Hilbert curve.
  If the table is a square of side 2^k, each jump stays within two neighboring cells.
  Any other table is put into the smallest square of side 2^k, and the curve fills this square.
  There, jumps can be longer, because the Hilbert curve leaves the table and enters it elsewhere.
  A line along u_1 crosses no jumps.
  The Hilbert warp suits samplers with n strata in u_0, which become n strata along the curve.
  Samplers with square 2-D strata have only √n strata in u_0, hence only √n along the curve.

*Bilinear* tables (`bilinear`) make p continuous. Therefore g is also continuous along rows.
Use bilinear tables if the jumps of a piecewise constant table make the rate worse.

The border of a cell cuts strata unless its position is a multiple of the side of a stratum.
If strata are cut, the variance of jittered sampling in 2-D falls as n^-1.5 instead of n^-2.
The study of environment maps shows how cut strata make the rate worse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.core.fields import checked, choice
from mcspectra.core.jit import kernel
from mcspectra.densities.base import Density

__all__ = [
    "WARPS",
    "PiecewiseConstant",
    "as_table",
    "below",
    "check_masses",
    "flat",
    "last_at_most",
    "shown",
]

WARPS = ("marginal", "hierarchical", "alias", "hilbert")

_MOST_SHOWN = 256  # tables up to this size are stored as lists, which spec strings show
_MOST_CELLS = 2**26  # largest number of cells: 512 MiB per copy, and a warp stores several copies
_MOST_BREAKS = 2**12  # largest number of breaks: quadrature between more breaks takes too long
_SAME_ROWS = 1e-12  # relative tolerance with which rows count as proportional


def as_table(values: object) -> Array:
    """Check relative densities and return them as a read-only copy."""
    try:
        given = np.asarray(values)
    except ValueError:  # the rows have different lengths
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
    return check_masses(np.array(given, dtype=np.float64))


def check_masses(table: Array) -> Array:
    """Check that relative densities are finite, at least 0 and not all 0; make them read-only."""
    if not np.isfinite(table).all() or table.min() < 0 or not table.any():
        raise ParameterError(
            f"values run from {table.min():g} to {table.max():g}; "
            "they must be finite, at least 0, and not all 0."
        )
    table.setflags(write=False)
    return table


def shown(table: Array) -> Any:
    """Return the table in the form that spec strings show: a list, or the array if it is large."""
    return table.tolist() if table.size <= _MOST_SHOWN else table


def flat(points: Array) -> Array:
    """Return points (..., d) as a contiguous array (N, d) for kernels."""
    return np.ascontiguousarray(points).reshape(-1, points.shape[-1])


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PiecewiseConstant(Density):
    """Constant in each cell. The cells are given by a list (1-D) or by the rows of a table (2-D).

    Attributes
    ----------
    values
        Relative density of each cell: at least 0 and not all 0. The scale is arbitrary.
        Its shape is (w,), or (h, w) with x_0 along a row and x_1 from the first row to the last.
    warp
        The warp T: ``"marginal"``, ``"hierarchical"``, ``"alias"`` or ``"hilbert"``.
        The module describes these warps. In 1-D all except ``"alias"`` are the same.
    """

    warps: ClassVar[tuple[str, ...]] = WARPS
    values: Any = checked(lambda _, values: shown(as_table(values)))
    warp: str = choice(*WARPS)

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims: 1 or 2, the number of axes of `values`."""
        return int(self._table.ndim)

    @property
    def has_inverse(self) -> bool:
        """Whether the warp is one-to-one. Only the alias warp is not."""
        return self.warp != "alias"

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Positions in u of whole lines, normal to an axis, on which the warp or its slope jumps.

        In 1-D this is the cdf at borders between different cells. In 2-D it depends on the warp.
        Borders that form segments rather than lines are omitted.
        All borders of an axis are omitted if there are more than 4096.
        """
        return self._warp.breaks()[: self.dims]

    def reciprocal_integral(self) -> float:
        """Return ∫ 1/p: the mean of 1/p over the cells. It is infinite if a cell is 0."""
        return float((1.0 / self._pdf_table).mean()) if self._pdf_table.all() else np.inf

    def zero_points(self) -> Array:
        """Return the centers of the empty cells."""
        cells = np.argwhere(self._table == 0)[:, ::-1]  # the rows of a table run along axis 1
        return np.asarray((cells + 0.5) / np.array(self._table.shape[::-1]))

    @cached_property
    def _table(self) -> Array:
        return np.asarray(self.values, np.float64)

    @cached_property
    def _cells(self) -> Array:
        """The table as (h, w), with a single row in 1-D. It is scaled so that no sum overflows."""
        return np.asarray(np.atleast_2d(self._table) / self._table.max())

    @cached_property
    def _pdf_table(self) -> Array:
        return np.asarray(self._cells / self._cells.mean())

    @cached_property
    def _warp(self) -> _Marginal | _Hierarchical | _Alias | _Hilbert:
        # All warps give each cell the same mass, spread evenly in the cell.
        # The warps differ only in the order of the cells
        if self.warp == "alias":
            return _Alias(self._cells)
        if self.dims == 1 or self.warp == "marginal":
            return _Marginal(self._cells)
        return _Hierarchical(self._cells) if self.warp == "hierarchical" else _Hilbert(self._cells)

    def _pdf(self, x: Array) -> Array:
        out = np.empty(x.shape[:-1])
        _look_up(self._pdf_table, flat(x), out.reshape(-1))
        return out

    def _sample(self, u: Array) -> Array:
        x = np.empty(u.shape)
        inside = np.clip(u, 0.0, BELOW_ONE)
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


def _cdf(masses: Array) -> Array:
    """Return the cdf along the last axis, from 0 to exactly 1, with the shape (..., k+1).

    If all masses are 0, the cdf is that of the uniform density.
    """
    sums = np.zeros((*masses.shape[:-1], masses.shape[-1] + 1))
    np.cumsum(masses, axis=-1, out=sums[..., 1:])
    total = sums[..., -1:]
    even = np.broadcast_to(np.linspace(0.0, 1.0, sums.shape[-1]), sums.shape)
    return np.divide(sums, total, out=even.copy(), where=total > 0)


def _inner(borders: Array, differ: Array | None = None) -> tuple[float, ...]:
    """Return ascending borders within (0,1) between different cells; none if more than 4096."""
    kept = borders if differ is None else borders[1:-1][differ != 0]
    found = np.unique(kept)
    found = found[(found > 0) & (found < 1)]
    return tuple(found.tolist()) if found.size <= _MOST_BREAKS else ()


# In kernels, cell i of k covers [i/k, (i+1)/k) *as rounded*, both in look-ups and for samples.
# Look-ups and samples round cell borders alike, so no sample leaves the cell that it was drawn in.
# `borders` are values of the cdf at cell borders, from 0 to 1.


@kernel
def below(x: float) -> float:
    """Return the next smaller float than x, for x in (0, 1]."""
    return np.nextafter(x, 0.0)  # type: ignore[no-any-return]


@kernel
def _cell_at(x: float, cells: int) -> int:
    """Return i with i/cells <= x < (i+1)/cells. Points outside belong to the first or last cell."""
    i = min(max(math.floor(x * cells), 0), cells - 1)
    if i > 0 and x < i / cells:
        return i - 1
    if i < cells - 1 and x >= (i + 1) / cells:
        return i + 1
    return i


@kernel
def _within(cell: int, rest: float, cells: int) -> float:
    """Return the point at the fraction `rest` of a cell, never in the next cell."""
    return min((cell + rest) / cells, below((cell + 1) / cells))


@kernel
def last_at_most(borders: Array, low: int, size: int, u: float) -> int:
    """Return the largest i of low … low + size − 1 with borders[i] <= u; borders[low] must be ≤ u.

    The bisection has no branch, because which half is chosen is practically random.
    Mispredicted branches would cost more time than the arithmetic.
    """
    while size > 1:
        half = size >> 1
        low += half * (borders[low + half] <= u)
        size -= half
    return low


@kernel
def _look_up(table: Array, x: Array, out: Array) -> None:
    """Fill out (N,) with the entries of `table` (h, w) at x (N, d)."""
    row = 0
    for k in range(x.shape[0]):
        if x.shape[1] == 2:
            row = _cell_at(x[k, 1], table.shape[0])
        out[k] = table[row, _cell_at(x[k, 0], table.shape[1])]


@final
class _Marginal:
    """Marginal warp: u_1 chooses the row by the marginal cdf, u_0 the column by the row's cdf."""

    def __init__(self, cells: Array) -> None:
        self.cells = cells
        self.rows = _cdf(cells.sum(axis=1))  # (h+1,)
        self.columns = _cdf(cells)  # (h, w+1)

    def sample(self, u: Array, x: Array) -> None:
        _warp_rows(self.rows, self.columns, u, x)

    def invert(self, x: Array, u: Array) -> None:
        _unwarp_rows(self.rows, self.columns, x, u)

    def breaks(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the values of the marginal cdf at the borders between rows that differ.

        If all rows are proportional, also return the values of the row cdf at column borders.
        """
        # Rows are proportional if all rows with mass have equal cdfs
        columns = self.columns[self.cells.any(axis=1)]
        separable = np.abs(columns - columns[0]).max() <= _SAME_ROWS
        across = _inner(self.columns[0], np.diff(self.cells[0])) if separable else ()
        return across, _inner(self.rows, np.asarray(np.diff(self.cells, axis=0).any(axis=1)))


@kernel
def _stretch(borders: Array, u: float) -> tuple[int, float]:
    """Return the cell of u and the point that u maps to."""
    cells = borders.size - 1
    i = last_at_most(borders, 0, cells, u)  # this cell has mass, since u < 1 = borders[-1]
    x = (i + (u - borders[i]) / (borders[i + 1] - borders[i])) / cells
    return i, min(max(x, i / cells), below((i + 1) / cells))


@kernel
def _shrink(borders: Array, x: float) -> tuple[int, float]:
    """Return the cell of x and the cdf at x."""
    cells = borders.size - 1
    i = _cell_at(x, cells)
    width = borders[i + 1] - borders[i]
    u = borders[i] + (x * cells - i) * width
    return i, max(borders[i], min(u, below(borders[i + 1]) if width > 0 else borders[i]))


@kernel
def _warp_rows(rows: Array, columns: Array, u: Array, x: Array) -> None:
    row = 0
    for k in range(u.shape[0]):
        if u.shape[1] == 2:
            row, x[k, 1] = _stretch(rows, u[k, 1])
        _, x[k, 0] = _stretch(columns[row], u[k, 0])


@kernel
def _unwarp_rows(rows: Array, columns: Array, x: Array, u: Array) -> None:
    row = 0
    for k in range(x.shape[0]):
        if x.shape[1] == 2:
            row, u[k, 1] = _shrink(rows, x[k, 1])
        _, u[k, 0] = _shrink(columns[row], x[k, 0])


@final
class _Hierarchical:
    """Hierarchical warp: repeated splits of the longer side of the table, down to single cells.

    A split along an axis uses the coordinate of u on the same axis.
    `shares` is a heap. Node k has the children 2k+1 (lower indices) and 2k+2.
    shares[k] is the fraction of the mass of node k that belongs to its first child.
    `axes` (levels,) is the axis that each level splits: 0 for columns, 1 for rows.
    Tables are padded to powers of two with empty cells, which no sample reaches.
    """

    def __init__(self, cells: Array) -> None:
        # At each level of the tree, split the longer side; if both sides are equal, split the rows
        bits = [(size - 1).bit_length() for size in cells.shape]
        table = np.pad(cells, [(0, 2**b - size) for b, size in zip(bits, cells.shape, strict=True)])
        axes = []
        while any(bits):
            axes.append(int(bits[0] >= bits[1]))
            bits[1 - axes[-1]] -= 1
        self.cells, self.axes = cells, np.array(axes, np.int64)
        # Build the tree upward from the single cells.
        # Each level adds the masses of pairs of rows (axis 1) or pairs of columns (axis 0)
        levels = [np.empty(0)]
        for depth in range(len(axes) - 1, -1, -1):
            pairs = (table[0::2], table[1::2]) if axes[depth] else (table[:, 0::2], table[:, 1::2])
            table = pairs[0] + pairs[1]
            share = np.divide(pairs[0], table, out=np.full(table.shape, 0.5), where=table > 0)
            # Flatten the table `share` of this level.
            # Put the bits of row and column indices in the order in which the table was split
            above = self.axes[:depth]
            order = np.empty(depth, np.int64)
            order[above == 1] = np.arange(above.sum())
            order[above == 0] = np.arange(above.sum(), depth)
            levels.append(share.reshape((2,) * depth).transpose(order).ravel())
        self.shares = np.concatenate(levels[::-1])

    def sample(self, u: Array, x: Array) -> None:
        _descend(self.shares, self.axes, self.cells.shape, u, x)

    def invert(self, x: Array, u: Array) -> None:
        _return_to_root(self.shares, self.axes, self.cells.shape, x, u)

    def breaks(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Borders of the first splits, which all divide the same axis.

        The first borders are whole lines. Later borders are only segments, and are omitted.
        """
        found: list[tuple[float, ...]] = [(), ()]
        if self.axes.size:
            axis = int(self.axes[0])
            changed = np.flatnonzero(self.axes != axis)
            kept = int(changed[0]) if changed.size else self.axes.size
            block = 2 ** (int(np.count_nonzero(self.axes == axis)) - kept)
            borders = _cdf(self.cells.sum(axis=axis))[::block]
            found[axis] = _inner(np.append(borders, 1.0))
        return found[0], found[1]


@kernel
def _descend(shares: Array, axes: Array, size: tuple[int, ...], u: Array, x: Array) -> None:
    """Fill x. Each split chooses a half by a coordinate of u, and stretches the coordinate."""
    height, width = size
    one = below(1.0)
    for k in range(u.shape[0]):
        node, column, row = 0, 0, 0
        rest_x, rest_y = u[k, 0], u[k, 1]
        for axis in axes:
            share = shares[node]
            rest = rest_y if axis else rest_x
            second = int(rest >= share)
            # Arithmetic replaces a branch on `second`, whose random values no processor predicts
            start = share * second
            length = share + second * (1.0 - 2.0 * share)
            rest = min((rest - start) / length, one)
            node = 2 * node + 1 + second
            if axis:
                row, rest_y = 2 * row + second, rest
            else:
                column, rest_x = 2 * column + second, rest
        x[k, 0], x[k, 1] = _within(column, rest_x, width), _within(row, rest_y, height)


@kernel
def _return_to_root(shares: Array, axes: Array, size: tuple[int, ...], x: Array, u: Array) -> None:
    height, width = size
    row_bits = 0
    for axis in axes:
        row_bits += axis
    for k in range(x.shape[0]):
        column, row = _cell_at(x[k, 0], width), _cell_at(x[k, 1], height)
        rest_x = max(x[k, 0] * width - column, 0.0)
        rest_y = max(x[k, 1] * height - row, 0.0)
        # Find the leaf of the cell. Each split takes the next lower bit of the row or column index
        rows, columns = row_bits, axes.size - row_bits
        node = 0
        for axis in axes:
            if axis:
                rows -= 1
                node = 2 * node + 1 + ((row >> rows) & 1)
            else:
                columns -= 1
                node = 2 * node + 1 + ((column >> columns) & 1)
        # Undo the splits, from the last split to the first
        for level in range(axes.size - 1, -1, -1):
            second = node % 2 == 0
            node = (node - 1) >> 1
            share = shares[node]
            rest = rest_y if axes[level] else rest_x
            rest = share + (1.0 - share) * rest if second else share * rest
            if axes[level]:
                rest_y = rest
            else:
                rest_x = rest
        u[k, 0], u[k, 1] = rest_x, rest_y


@final
class _Alias:
    """Alias warp: u_0 gives a bin, one of its two cells, and the place along x_0. u_1 gives x_1.

    Bin i of n maps to cell i with the probability `keep[i]`, otherwise to cell `other[i]`.
    """

    def __init__(self, cells: Array) -> None:
        self.cells = cells
        self.keep, self.other = _alias_table((cells / cells.mean()).ravel())

    def sample(self, u: Array, x: Array) -> None:
        _jump(self.keep, self.other, self.cells.shape, u, x)

    def invert(self, x: Array, u: Array) -> None:
        """Raise an error, since several values of u may belong to x. This is never called."""
        raise NotImplementedError

    def breaks(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Borders of the bins along u_0, and the border between the two cells of each bin."""
        starts = np.arange(self.keep.size)
        return _inner(np.concatenate([starts, starts + self.keep]) / self.keep.size), ()


@kernel
def _alias_table(masses: Array) -> tuple[Array, Array]:
    """Return the shares `keep` (n,) and the cells `other` (n,) of the alias table of masses (n,).

    The mean of the masses is 1.
    Cells with masses above the mean fill the bins of cells with masses below the mean.
    Bins of cells with mass 0 are filled first, while other cells still have more than the mean.
    Therefore the share of an empty cell in its own bin is exactly 0.
    Rounding errors change only the shares of cells whose remaining mass is near the mean.
    """
    n = masses.size
    left = masses.copy()
    keep, other = np.ones(n), np.arange(n)
    # Cells with masses below the mean are at the front of this array, all others at its back
    stack = np.empty(n, np.int64)
    low, high = 0, n
    for i in range(n):
        if left[i] < 1.0:
            stack[low] = i
            low += 1
        else:
            high -= 1
            stack[high] = i
    while low > 0 and high < n:
        low -= 1
        i, giver = stack[low], stack[high]
        keep[i], other[i] = left[i], giver
        left[giver] = (left[giver] + left[i]) - 1.0
        if left[giver] < 1.0:
            high += 1
            stack[low] = giver
            low += 1
    return keep, other


@kernel
def _jump(keep: Array, other: Array, size: tuple[int, ...], u: Array, x: Array) -> None:
    height, width = size
    n = keep.size
    for k in range(u.shape[0]):
        scaled = u[k, 0] * n
        i = min(int(scaled), n - 1)
        rest = scaled - i
        if rest < keep[i]:
            cell, rest = i, rest / keep[i]
        else:
            cell, rest = other[i], (rest - keep[i]) / (1.0 - keep[i])
        row, column = divmod(cell, width)
        x[k, 0] = _within(column, rest, width)
        if u.shape[1] == 2:
            x[k, 1] = _within(row, u[k, 1], height)


@final
class _Hilbert:
    """Hilbert warp: u_0 is the position on a Hilbert curve through the cells. u_1 goes across it.

    `borders` (n+1,) is the cdf of the cells in the order of the curve.
    `order` (n,) has the flat indices of these cells, and `places` is the inverse permutation.
    `headings` (n,) has the direction in which the curve leaves each cell.
    The direction 0 is +x_0, 1 is −x_0, 2 is +x_1, and 3 is −x_1.
    `guide` divides [0,1) into 2^g equal intervals and has the first cell of each [ChenAsau1974]_.
    With the table `guide`, a search for a cell usually starts with one or two candidates.
    """

    def __init__(self, cells: Array) -> None:
        # Order the cells by the curve through the smallest square of side 2^k around the table
        side = 1 << (max(cells.shape) - 1).bit_length()
        numbers = np.empty(cells.size, np.int64)
        headings = np.zeros(cells.size, np.int8)
        _places_on_curve(side, cells.shape, numbers, headings)
        self.cells, self.order = cells, np.argsort(numbers)
        self.places = np.empty_like(self.order)
        self.places[self.order] = np.arange(self.order.size)
        self.headings = headings[self.order]
        self.borders = _cdf(cells.ravel()[self.order])
        shares = np.linspace(0.0, 1.0, (1 << (cells.size - 1).bit_length()) + 1)
        found = np.searchsorted(self.borders, shares, side="right") - 1
        self.guide = np.minimum(found, cells.size - 1)

    def sample(self, u: Array, x: Array) -> None:
        _follow(self.borders, self.guide, self.order, self.headings, self.cells.shape, u, x)

    def invert(self, x: Array, u: Array) -> None:
        _return_along(self.borders, self.places, self.headings, self.cells.shape, x, u)

    def breaks(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the values of the cdf at the cells' borders along the Hilbert curve.

        The warp T jumps at the turns of the curve. At other borders only the slope of T jumps.
        """
        return _inner(self.borders), ()


@kernel
def _position(side: int, column: int, row: int) -> int:
    """Return a cell's index on the curve through side × side cells, with side a power of two.

    The curve visits one quadrant after another.
    Quadrants are turned, so that each starts next to the end of the quadrant before.
    """
    found = 0
    step = side >> 1
    while step > 0:
        right, down = int(column & step > 0), int(row & step > 0)
        found += step * step * ((3 * right) ^ down)
        if down == 0:
            if right == 1:
                column, row = step - 1 - (column & (step - 1)), step - 1 - (row & (step - 1))
            column, row = row & (step - 1), column & (step - 1)
        step >>= 1
    return found


@kernel
def _places_on_curve(side: int, size: tuple[int, ...], places: Array, headings: Array) -> None:
    """Compute the index of each cell on the curve, and the direction to the next cell.

    Both arrays have the shape (height · width,).

    The direction at a cell points to the neighbor with the next index.
    The last cell has the same direction as the cell before it.
    """
    height, width = size
    last = side * side - 1
    for row in range(height):
        for column in range(width):
            k = row * width + column
            here = _position(side, column, row)
            places[k] = here
            step = 1 if here < last else -1
            for heading in range(4):
                x = column + (1 if heading == 0 else -1 if heading == 1 else 0)
                y = row + (1 if heading == 2 else -1 if heading == 3 else 0)
                inside = 0 <= x < side and 0 <= y < side
                if inside and _position(side, x, y) == here + step:
                    headings[k] = heading if step == 1 else heading ^ 1


@kernel
def _follow(
    borders: Array,
    guide: Array,
    order: Array,
    headings: Array,
    size: tuple[int, ...],
    u: Array,
    x: Array,
) -> None:
    height, width = size
    for k in range(u.shape[0]):
        # Find the interval of the guide table that contains u_0, exactly:
        # multiplication of u_0 by a power of two causes no rounding
        g = int(u[k, 0] * (guide.size - 1))
        i = last_at_most(borders, guide[g], guide[g + 1] + 1 - guide[g], u[k, 0])
        rest = (u[k, 0] - borders[i]) / (borders[i + 1] - borders[i])
        row, column = divmod(order[i], width)
        along = 1.0 - rest if headings[i] & 1 else rest
        a, b = (u[k, 1], along) if headings[i] & 2 else (along, u[k, 1])
        x[k, 0], x[k, 1] = _within(column, a, width), _within(row, b, height)


@kernel
def _return_along(
    borders: Array,
    places: Array,
    headings: Array,
    size: tuple[int, ...],
    x: Array,
    u: Array,
) -> None:
    height, width = size
    for k in range(x.shape[0]):
        column, row = _cell_at(x[k, 0], width), _cell_at(x[k, 1], height)
        i = places[row * width + column]
        a = max(x[k, 0] * width - column, 0.0)
        b = max(x[k, 1] * height - row, 0.0)
        along, across = (b, a) if headings[i] & 2 else (a, b)
        rest = 1.0 - along if headings[i] & 1 else along
        u[k, 0] = borders[i] + rest * (borders[i + 1] - borders[i])
        u[k, 1] = across
