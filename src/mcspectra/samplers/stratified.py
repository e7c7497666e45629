"""Random points, square and hexagonal grids, jittered and multi-jittered sets, shared cells.

The unit cube is divided into n cells of equal volume.
By default each axis has s cells, so that n = s^d.
Points come in row-major order of their cells, the last coordinate fastest.

Notation of the kernels: R realizations, n points, d dims.
Arrays ``out`` are float64 (R, n, d), and ``keys`` are uint64 (R, 2) from `Stream.keys`.
Random number i·d + j of a realization belongs to coordinate j of point i.
Shuffles use the random numbers that follow the n·d numbers of the coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from os import PathLike
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array, as_integer
from mcspectra.core.decoding import opened, read_npz
from mcspectra.core.display import counted, needed
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.core.fields import choice, real, settle
from mcspectra.core.jit import kernel
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream, mix_uniform
from mcspectra.samplers._kernels import _shuffle, fill_jittered
from mcspectra.samplers.base import MAX_COUNT, FixedSet, PlaneSampler, Sampler, Structure
from mcspectra.samplers.law import (
    AntitheticPair,
    BoxPoint,
    Fixed,
    GaussianPoint,
    Independent,
    Law,
    PairedAxes,
    PairPattern,
    Shifted,
    Strata,
    Unknown,
)

__all__ = [
    "AntitheticJittered",
    "BoxJitter",
    "CorrelatedMultiJittered",
    "GaussianJitter",
    "GridSampler",
    "Hexagonal",
    "Jittered",
    "MultiJittered",
    "Random",
    "Regular",
    "SharedCells",
    "UniformJitter",
    "cell_side",
    "corners",
    "nearly_square",
    "root",
    "write_cells",
]

_SLACK = 2.0**-52
_MOST_WIDTH = 1000.0  # largest width in cells for which float64 wraps points exactly


@final
@dataclass(frozen=True, kw_only=True)
class Random(Sampler):
    """Independent uniform points.

    Any dims, any count.

    References
    ----------
    [Metropolis1949]_.
    """

    structure: ClassVar[Structure] = Structure.NONE
    sequence: ClassVar[bool] = True
    dims: int = DEFAULT_DIMS

    def _law(self, n: int) -> Law:
        return Independent(n=n, dims=self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        return stream.uniforms(first, count, n * self.dims).reshape(count, n, self.dims)


class GridSampler(Sampler):
    """Abstract sampler on a grid of s^d cells, or with `sides_` cells along the axes."""

    sides_: Sequence[int] | None = None

    def _check(self) -> None:
        given: Any = self.sides_
        if given is None:
            return
        if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray):
            raise ParameterError(
                f"{self.name}: sides is {given!r}; give a list of {self.dims} whole numbers."
            )
        sides = tuple(as_integer(f"sides[{i}]", s, least=1) for i, s in enumerate(given))
        if len(sides) != self.dims:
            raise ParameterError(
                f"{self.name}: sides has {counted(len(sides), 'number')}; give one for each of the "
                f"{self.dims} dims."
            )
        if math.prod(sides) > MAX_COUNT:
            raise ParameterError(
                f"{self.name}: sides give {float(math.prod(sides)):.3g} cells; "
                f"at most {MAX_COUNT:.3g} are possible."
            )
        settle(self, sides_=sides)

    def sides(self, n: int) -> tuple[int, ...]:
        """Return the number of cells along each axis for `n` points."""
        return self._sides(self.check_count(n))

    def _sides(self, n: int) -> tuple[int, ...]:
        return (root(n, self.dims),) * self.dims if self.sides_ is None else tuple(self.sides_)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        if self.sides_ is None:
            s = root(n, self.dims)
            return s**self.dims, n if s**self.dims == n else (s + 1) ** self.dims
        only = math.prod(self.sides_)
        return (only if only <= n else None), (only if only >= n else MAX_COUNT + 1)


@final
@dataclass(frozen=True, kw_only=True)
class Regular(FixedSet, GridSampler):
    """Regular grid of s^d points, or of given sides, deterministic; randomize with shift.

    Any dims; counts s^d, or only the product of `sides`.

    Attributes
    ----------
    position
        Position in each cell: ``"center"`` or ``"corner"`` (next to the origin).
    sides
        Number of cells along each axis; by default s on every axis.

    References
    ----------
    [Ramamoorthi2012]_.
    """

    structure: ClassVar[Structure] = Structure.STRATA
    dims: int = DEFAULT_DIMS
    position: str = choice("center", "corner")
    sides_: Sequence[int] | None = None

    def _law(self, n: int) -> Law:
        corner = 0.5 if self.position == "center" else 0.0
        return Fixed(n=n, dims=self.dims, sides=self._sides(n), corner=corner)

    def _set(self, n: int) -> Array:
        sides = self._sides(n)
        points: Array = corners(sides) + (0.5 / np.array(sides) if self.position == "center" else 0)
        return points


@final
@dataclass(frozen=True, kw_only=True)
class UniformJitter(GridSampler):
    """Regular grid moved by one random offset within a cell, the same for all points.

    Any dims; counts s^d, or only the product of `sides`.

    Attributes
    ----------
    sides
        Number of cells along each axis; by default s on every axis.

    References
    ----------
    [Ramamoorthi2012]_.
    """

    structure: ClassVar[Structure] = Structure.TORUS
    dims: int = DEFAULT_DIMS
    sides_: Sequence[int] | None = None

    def _law(self, n: int) -> Law:
        grid = Regular(dims=self.dims, position="corner", sides_=self._sides(n)).law(n)
        return Shifted(n=n, dims=self.dims, inner=grid)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        return _in_cells(self._sides(n), stream.uniforms(first, count, self.dims)[:, None, :])


@final
@dataclass(frozen=True, kw_only=True)
class Jittered(GridSampler):
    """One uniform point in each of s^d cells, or in each cell of a given grid.

    Any dims; counts s^d, or only the product of `sides`.

    Attributes
    ----------
    sides
        Number of cells along each axis; by default s on every axis.

    References
    ----------
    [Haber1966]_, [Cook1986]_.
    """

    structure: ClassVar[Structure] = Structure.STRATA
    dims: int = DEFAULT_DIMS
    sides_: Sequence[int] | None = None

    def _law(self, n: int) -> Law:
        return Strata(n=n, dims=self.dims, sides=self._sides(n))

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        sides = self._sides(n)
        if len(set(sides)) > 1:
            shares = stream.uniforms(first, count, n * self.dims)
            return _in_cells(sides, shares.reshape(count, n, self.dims))
        out = np.empty((count, n * self.dims))
        fill_jittered(stream.keys(first, count), corners(sides).ravel(), cell_side(sides[0]), out)
        return out.reshape(count, n, self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class BoxJitter(GridSampler):
    """Centers of the cells of a grid, each moved uniformly within a box of a given width, wrapped.

    Any dims; counts s^d.

    Attributes
    ----------
    width
        Side of the box in units of a cell side, from 0 (regular grid) to 1000; 1 is jittered.

    Notes
    -----
    Every point is uniform if the boxes tile the torus, that is for whole widths of at least 1.
    With other widths, the boxes leave gaps or overlap, at the same places of every cell.
    The randomization shift makes the points uniform.
    Points that leave the domain at one end enter at the other end.
    The default width is not from a paper; points with it look different from jittered points.

    References
    ----------
    [Ramamoorthi2012]_.
    """

    structure: ClassVar[Structure] = Structure.TORUS
    dims: int = DEFAULT_DIMS
    width: float = real(0.5, least=0.0, most=_MOST_WIDTH)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether the boxes tile the torus."""
        return self.width >= 1.0 and self.width.is_integer()

    def _law(self, n: int) -> Law:
        return Strata(n=n, dims=self.dims, sides=self._sides(n), motif=BoxPoint(self.width))

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        u = stream.uniforms(first, count, n * self.dims)
        return _moved_centers(self._sides(n), self.width * (u - 0.5))


@final
@dataclass(frozen=True, kw_only=True)
class GaussianJitter(GridSampler):
    """Centers of the cells of a grid, each moved by a Gaussian vector of its own, wrapped.

    Any dims; counts s^d.

    Attributes
    ----------
    width
        Standard deviation along each axis in units of a cell side, from 0 (regular grid) to 1000.

    Notes
    -----
    A point is not uniform. Its density along each axis is 1 + 2 exp(−2π² width²) cos(2πsx) + …,
    The density varies by 58 % at width 0.25 and by 10^-8 at width 1.
    The randomization shift makes the points uniform.
    Points may leave their cells; a point that leaves the domain enters at the other end.
    The default is close to the standard deviation of jittered, 0.29, and is not from a paper.

    References
    ----------
    [Balakrishnan1962]_.
    """

    structure: ClassVar[Structure] = Structure.TORUS
    unbiased: ClassVar[bool] = False
    dims: int = DEFAULT_DIMS
    width: float = real(0.25, least=0.0, most=_MOST_WIDTH)

    def _law(self, n: int) -> Law:
        return Strata(n=n, dims=self.dims, sides=self._sides(n), motif=GaussianPoint(self.width))

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        from scipy.special import ndtri

        u = stream.uniforms(first, count, n * self.dims)
        normal = ndtri(np.maximum(u, 2.0**-54))  # ndtri(0) is −∞
        return _moved_centers(self._sides(n), self.width * normal)


@final
@dataclass(frozen=True, kw_only=True)
class AntitheticJittered(Sampler):
    """Two points in each of s^d cells: a uniform one and its reflection through the cell's center.

    Any dims; counts 2 s^d. Points 2i and 2i + 1 are the pair of cell i.

    Notes
    -----
    The linear part of the integrand cancels within each pair.
    The variance of smooth integrands therefore falls like n^(−1 − 4/d).
    For jittered points, this variance falls like n^(−1 − 2/d).

    References
    ----------
    [Haber1967]_, [Haber1970]_.
    """

    structure: ClassVar[Structure] = Structure.STRATA
    antithetic: ClassVar[bool] = True
    dims: int = DEFAULT_DIMS

    def _law(self, n: int) -> Law:
        sides = (root(n // 2, self.dims),) * self.dims
        return Strata(n=n, dims=self.dims, sides=sides, motif=AntitheticPair())

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        s = root(n // 2, self.dims)
        out = np.empty((count, n // 2, 2, self.dims))
        _fill_antithetic(stream.keys(first, count), corners((s,) * self.dims), cell_side(s), out)
        return out.reshape(count, n, self.dims)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        s = root(n // 2, self.dims)
        below = 2 * s**self.dims
        return below or None, below if below == n else 2 * (s + 1) ** self.dims


@kernel
def _fill_antithetic(keys: Array, corners: Array, side: float, out: Array) -> None:
    # Fill out (R, cells, 2, d) with pairs of points, given the corners (cells, d) of the cells.
    count, cells, _, dims = out.shape
    for r in range(count):
        for i in range(cells):
            for j in range(dims):
                u = mix_uniform(keys[r, 0], keys[r, 1], i * dims + j)
                out[r, i, 0, j] = corners[i, j] + side * u
                # Reflect the number k/2^53 exactly, so that the reflection is also uniform
                out[r, i, 1, j] = corners[i, j] + side * (BELOW_ONE - u)


@final
@dataclass(frozen=True, kw_only=True)
class MultiJittered(PlaneSampler):
    """Jittered in a × b cells, with one point also in each of n strata of either axis (2-D).

    2-D. Counts are n = a·b with a ≤ b ≤ 2a; the sampler takes the most nearly square a × b.

    Notes
    -----
    The sub-strata of a column (or row) are shuffled independently of other columns (or rows);
    correlated-multi-jittered uses one shuffle for all columns and one for all rows.

    References
    ----------
    [Chiu1994]_.
    """

    structure: ClassVar[Structure] = Structure.STRATA
    other_dims: ClassVar[str] = "for other dims use orthogonal-array, jittered or latin-hypercube"

    def _law(self, n: int) -> Law:
        # Two points have the same column, the same row, or neither
        columns = nearly_square(n)
        rows = n // columns
        c, r = 1.0 / columns, 1.0 / rows
        patterns = (
            PairPattern((1.0 - c) * (1.0 - r), ("apart", "apart")),
            PairPattern(c * (1.0 - r), ("mates", "apart")),
            PairPattern(r * (1.0 - c), ("apart", "mates")),
        )
        return PairedAxes(
            n=n,
            dims=2,
            strata=(columns, rows),
            parts=(rows, columns),
            patterns=patterns,
            base=columns if 1 < columns == rows else None,
        )

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        columns, out = nearly_square(n), np.empty((count, n, 2))
        keys = stream.keys(first, count)
        _fill_multi_jittered(keys, columns, n // columns, cell_side(n), out)
        return out

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        below = above = n
        while not nearly_square(below):
            below -= 1
        while not nearly_square(above):
            above += 1
        return below, above


@final
@dataclass(frozen=True, kw_only=True)
class CorrelatedMultiJittered(PlaneSampler):
    """Multi-jittered with one shuffle for all columns and one for all rows, any count (2-D).

    2-D, any count.

    Notes
    -----
    For counts n = a·b with a ≤ b ≤ 2a, the sampler takes the most nearly square a × b.
    Each of the a × b cells, and each of n intervals of either axis, contains one point.

    Other counts follow Kensler's code: a = ⌊√n⌋ columns and b = ⌈n/a⌉ rows of height a/n.
    The last row is incomplete. Each of n intervals of the second axis contains one point.
    Each cell, and each of a·b intervals of the first axis, contains at most one point.

    Digits can be randomized only if the last row of cells is complete.
    Shuffles are true random permutations, whereas Kensler's code hashes indices.
    Points come in the order of their second coordinate; add shuffle for a random order.

    References
    ----------
    [Kensler2013]_.
    """

    structure: ClassVar[Structure] = Structure.STRATA
    other_dims: ClassVar[str] = "for other dims use orthogonal-array, jittered or latin-hypercube"

    def digit_strata(self, n: int, base: int) -> bool:
        """Whether n points form a rectangle of columns and rows that are powers of the base."""
        columns = nearly_square(n)
        return columns > 0 and base ** round(math.log(columns, base)) == columns

    def _law(self, n: int) -> Law:
        return Unknown(n=n, dims=2, strata=(n, n))

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        columns = nearly_square(n) or math.isqrt(n)
        rows = -(-n // columns)
        sides = cell_side(columns * rows), cell_side(n)
        out = np.empty((count, n, 2))
        _fill_correlated(stream.keys(first, count), columns, rows, *sides, out)
        return out


@kernel
def _fill_multi_jittered(keys: Array, columns: int, rows: int, side: float, out: Array) -> None:
    # Point (i, j) is in column i and row j, and alone in one of n intervals of each axis.
    n = columns * rows
    down, across = np.empty(rows, np.int64), np.empty(columns, np.int64)
    for r in range(out.shape[0]):
        k0, k1, points = keys[r, 0], keys[r, 1], out[r]
        # Shuffle the points of each column over its sub-strata
        for i in range(columns):
            _shuffle(k0, k1, 2 * n + i * rows, down)
            for j in range(rows):
                p = i * rows + j
                points[p, 0] = (i * rows + down[j]) / n + side * mix_uniform(k0, k1, 2 * p)
        # Shuffle the points of each row over its sub-strata
        for j in range(rows):
            _shuffle(k0, k1, 3 * n + j * columns, across)
            for i in range(columns):
                p = i * rows + j
                y = (j * columns + across[i]) / n
                points[p, 1] = y + side * mix_uniform(k0, k1, 2 * p + 1)


@kernel
def _fill_correlated(
    keys: Array, columns: int, rows: int, wide: float, high: float, out: Array
) -> None:
    # Use one shuffle of the columns and one of the rows, for all points.
    # Point p is in stratum p of n strata of the second axis, and so in row ⌊p / columns⌋.
    # The last row may be incomplete.
    # The strata of the two axes have the sides `wide` and `high`.
    n, slots = out.shape[1], columns * rows
    across, down = np.empty(columns, np.int64), np.empty(rows, np.int64)
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        _shuffle(k0, k1, 2 * n, across)
        _shuffle(k0, k1, 2 * n + columns, down)
        for p in range(n):
            x = (across[p % columns] * rows + down[p // columns]) / slots
            out[r, p, 0] = x + wide * mix_uniform(k0, k1, 2 * p)
            out[r, p, 1] = p / n + high * mix_uniform(k0, k1, 2 * p + 1)


@final
@dataclass(frozen=True, kw_only=True)
class Hexagonal(PlaneSampler, FixedSet):
    """Triangular lattice (hexagonal cells) stretched to fit the torus; randomize with shift.

    2-D; counts n = 2ab for a = 1, 2, 3, …, where b is the whole number nearest to a/√3, but not 0.
    The smallest counts are 2, 4, 12, 16, 30, 36, 56 and 80.

    Notes
    -----
    The points form 2b rows of a points; every other row is moved by half a step.
    The set is deterministic.
    On a square torus no hexagonal array is exactly regular, because b = a/√3 would be needed.
    The chosen b differs from a/√3 by at most ½. Neighbors therefore have two different distances.
    The ratio of the two distances between neighbors depends on the count:
    for n = 2, 4, 12, 16, 30 and 36, the ratio is 1.41, 1.12, 1.11, 1.12, 1.03 and 1.12.
    The longer of two neighbor distances exceeds the shorter by at most 6 % for n ≥ 56,
    and by at most 2 % for n ≥ 780.

    References
    ----------
    [Petersen1962]_.
    """

    structure: ClassVar[Structure] = Structure.TORUS
    other_dims: ClassVar[str] = "for other dims use rank1-lattice or regular"

    def _law(self, n: int) -> Law:
        return Fixed(n=n, dims=2, even=True)

    def _set(self, n: int) -> Array:
        across = _largest_across(n)
        row, step = np.divmod(np.arange(n), across)
        x = (4 * step + 1 + 2 * (row % 2)) / (4 * across)
        y = (2 * row + 1) / (2 * (n // across))
        return np.stack([x, y], axis=-1)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        across = _largest_across(n)
        below = _hexagonal_count(across) if across else None
        return below, n if below == n else _hexagonal_count(across + 1)


def _hexagonal_count(across: int) -> int:
    """Return the number of points of the hexagonal set with `across` points in each row."""
    return 2 * across * max(1, round(across / math.sqrt(3.0)))


def _largest_across(n: int) -> int:
    """Return the largest row length whose count is at most `n`, or 0 if there is no such length."""
    across = math.isqrt(n) + 2  # for a > 1, a count is at least a²
    while across and _hexagonal_count(across) > n:
        across -= 1
    return across


def root(n: int, dims: int) -> int:
    """Return the largest s with s^dims ≤ n, in exact integers (64 ** (1 / 3) is 3.9999…)."""
    s: int = round(n ** (1.0 / dims)) + 1
    while s**dims > n:
        s -= 1
    return s


def nearly_square(n: int) -> int:
    """Return the largest divisor a of n with n/2 ≤ a² ≤ n, or 0 if there is no such divisor."""
    candidates = np.arange(math.isqrt(n), math.isqrt((n - 1) // 2), -1)
    found = candidates[n % candidates == 0]
    return int(found[0]) if found.size else 0


@lru_cache(maxsize=2)  # an analysis draws many blocks of realizations with the same n
def corners(sides: tuple[int, ...]) -> Array:
    """Return the lower corners of the cells in row-major order: float64 (cells, d), read-only."""
    out = np.zeros((math.prod(sides), len(sides)))
    for j, s in enumerate(sides):
        steps = (np.arange(s) / s)[:, None]
        out[:, j].reshape(math.prod(sides[:j]), s, -1)[:] = steps
    out.setflags(write=False)
    return out


def cell_side(s: int) -> float:
    """Return 1/s minus 2^-52, so that k/s + side·u stays below (k + 1)/s for all u < 1.

    Four numbers below 1 are each rounded by at most 2^-54: k/s, side·u, their sum, and (k + 1)/s.
    The sum of these four rounding errors is therefore at most 2^-52.
    """
    return 1.0 / s - _SLACK


def _in_cells(sides: tuple[int, ...], shares: Array) -> Array:
    """Return points at the fractions `shares` (R, n or 1, d) of the sides of their cells."""
    points: Array = corners(sides) + shares * [cell_side(s) for s in sides]
    return points


def _moved_centers(sides: tuple[int, ...], displacements: Array) -> Array:
    """Return cell centers on the torus, moved by displacements (count, n·d) in units of cells."""
    points = displacements.reshape(-1, math.prod(sides), len(sides))
    points += 0.5
    points /= sides[0]
    points += corners(sides)
    points -= np.floor(points)
    points[points == 1.0] = 0.0  # −1e-20 − ⌊−1e-20⌋ rounds to 1
    return points


@final
@dataclass(frozen=True, kw_only=True)
class SharedCells(Sampler):
    """Points in n cells of a grid; the n cells are a set chosen at random from W sets of cells.

    The grid has W n cells, and each of these cells is in exactly one of the W sets.
    A realization draws one offset, a uniform point of a cell.
    The point of each cell is at the drawn offset, possibly reflected along some axes.
    Every point is uniform on [0,1)^d for any choice of the sets, so estimates are unbiased.
    The function `design` computes sets of cells for this sampler.

    Attributes
    ----------
    path
        File .npz with an array ``cells`` of integers of shape (W, n, d).
        Each integer belongs to a cell and an axis: it is 1 + the index of the cell along the axis.
        The integer is negative if the offset of the cell's point is reflected along the axis.
        The largest absolute value in the array is the number of cells along an axis.
    dims
        Number of coordinates, by default as in the file; a given number must agree with it.

    Raises
    ------
    FileFormatError
        If the file has no such array, or a cell of the grid is not in exactly one set.
    """

    path: str
    dims: int = None  # type: ignore[assignment]
    _cells: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        cells = _cells_of_file(self.path)
        settle(self, path=str(self.path), _cells=cells)
        given: Any = self.dims
        settle(self, dims=cells.shape[2] if given is None else given)
        Sampler.__post_init__(self)
        if self.dims != cells.shape[2]:
            raise ParameterError(
                f"The cells of {self.path} are in {counted(cells.shape[2], 'dim')}, "
                f"but {needed(self.dims, 'dim')}."
            )

    @property
    def spec(self) -> str:
        """Spec string of the sampler, with the path of the file of cells."""
        return f"shared-cells(path={self.path!r})"

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del n
        numbers = stream.uniforms(first, count, 1 + self.dims)
        chosen = self._cells[(numbers[:, 0] * len(self._cells)).astype(np.int64)]
        sides = np.abs(self._cells).max(axis=(0, 1))
        offset = numbers[:, None, 1:]
        offset = np.where(chosen < 0, BELOW_ONE - offset, offset)
        return np.ascontiguousarray(np.minimum((np.abs(chosen) - 1 + offset) / sides, BELOW_ONE))

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        size = self._cells.shape[1]
        return (size if n >= size else None), (size if n <= size else 2 * MAX_COUNT)


def _cells_of_file(path: str) -> Array:
    """Return the cells of a file as int64 (W, n, d); each cell must be in exactly one set."""
    with opened(path, "a file of cells", (".npz",)) as (stream, size, name, _):
        cells = read_npz(stream, size, name, "cells")
    if cells.ndim != 3 or cells.dtype.kind != "i" or not cells.all() or cells.size == 0:
        raise FileFormatError(
            f"{path} holds cells of type {cells.dtype} and shape {cells.shape}; give integers of "
            "shape (W, n, d), along each axis 1 + the number of the cell or minus that."
        )
    cells = cells.astype(np.int64)
    index = np.abs(cells).reshape(-1, cells.shape[2]) - 1
    sides = index.max(axis=0) + 1
    if math.prod(sides.tolist()) != len(index) or len(np.unique(index, axis=0)) != len(index):
        raise FileFormatError(
            f"{path} has {len(index)} cells for a grid of {' x '.join(map(str, sides))}; each cell "
            "of the grid must be in one set, or points are not uniform."
        )
    return cells


def write_cells(path: str | PathLike[str], cells: Array) -> None:
    """Write signed cells (W, n, d) in the format that `SharedCells` reads."""
    np.savez_compressed(path, cells=cells.astype(np.int16))
