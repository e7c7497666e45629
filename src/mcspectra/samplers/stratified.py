"""Random points, regular grids and one point a cell: random, regular, uniform-jitter, jittered.

The unit cube is cut into n cells of equal volume, s a side (n = s^d) unless other sides are given.
Points come in row-major order of their cells, the last coordinate fastest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _kernels
from mcspectra.samplers._grid import (
    cell_side,
    check_sides,
    corners,
    grid_counts_near,
    grid_sides,
)
from mcspectra.samplers.base import Sampler, Structure, check_dims, repeated

__all__ = ["Jittered", "Random", "Regular", "UniformJitter"]


@final
@dataclass(frozen=True, kw_only=True)
class Random(Sampler):
    """Independent uniform points.

    Any dims, any count.

    References
    ----------
    Metropolis, Ulam (1949), "The Monte Carlo method", doi 10.1080/01621459.1949.10483310.
    """

    name: ClassVar[str] = "random"
    structure: ClassVar[Structure] = Structure.NONE
    sequence: ClassVar[bool] = True
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        check_dims(self)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        return stream.uniforms(first, count, n * self.dims).reshape(count, n, self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class Regular(Sampler):
    """Regular grid of s^d points, or of given sides, deterministic; randomise with shift.

    Any dims; counts s^d, or only the product of `sides`.

    Attributes
    ----------
    position
        ``"center"`` or ``"corner"`` (the one next to the origin) of each cell.
    sides
        Cells along each axis, one number for each dim; s each if not given.

    References
    ----------
    Ramamoorthi, Anderson, Meyer, Nowrouzezahrai (2012), "A theory of Monte Carlo visibility
    sampling", doi 10.1145/2231816.2231819.
    """

    name: ClassVar[str] = "regular"
    structure: ClassVar[Structure] = Structure.STRATA
    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True
    dims: int = DEFAULT_DIMS
    position: str = "center"
    sides_: Sequence[int] | None = None

    def __post_init__(self) -> None:
        check_dims(self)
        check_sides(self)
        as_choice("position", self.position, ("center", "corner"))

    def sides(self, n: int) -> tuple[int, ...]:
        """Return the number of cells along each axis for `n` points."""
        return grid_sides(self.check_count(n), self.dims, self.sides_)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        sides = grid_sides(n, self.dims, self.sides_)
        offset = 0.5 / np.array(sides) if self.position == "center" else 0.0
        return repeated(corners(sides) + offset, count)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return grid_counts_near(n, self.dims, self.sides_)


@final
@dataclass(frozen=True, kw_only=True)
class UniformJitter(Sampler):
    """Regular grid moved by one random offset within a cell, the same for all points.

    Any dims; counts s^d, or only the product of `sides`.

    Attributes
    ----------
    sides
        Cells along each axis, one number for each dim; s each if not given.

    References
    ----------
    Ramamoorthi, Anderson, Meyer, Nowrouzezahrai (2012), "A theory of Monte Carlo visibility
    sampling", doi 10.1145/2231816.2231819.
    """

    name: ClassVar[str] = "uniform-jitter"
    structure: ClassVar[Structure] = Structure.TORUS
    dims: int = DEFAULT_DIMS
    sides_: Sequence[int] | None = None

    def __post_init__(self) -> None:
        check_dims(self)
        check_sides(self)

    def sides(self, n: int) -> tuple[int, ...]:
        """Return the number of cells along each axis for `n` points."""
        return grid_sides(self.check_count(n), self.dims, self.sides_)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        sides = grid_sides(n, self.dims, self.sides_)
        shares = stream.uniforms(first, count, self.dims)[:, None, :]
        points: Array = corners(sides) + shares * [cell_side(s) for s in sides]
        return points

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return grid_counts_near(n, self.dims, self.sides_)


@final
@dataclass(frozen=True, kw_only=True)
class Jittered(Sampler):
    """One uniform point in each of s^d cells, or in each cell of a given grid.

    Any dims; counts s^d, or only the product of `sides`.

    Attributes
    ----------
    sides
        Cells along each axis, one number for each dim; s each if not given.

    References
    ----------
    Haber (1966), "A modified Monte-Carlo quadrature", doi 10.1090/S0025-5718-1966-0210285-0.

    Cook (1986), "Stochastic sampling in computer graphics", doi 10.1145/7529.8927.
    """

    name: ClassVar[str] = "jittered"
    structure: ClassVar[Structure] = Structure.STRATA
    dims: int = DEFAULT_DIMS
    sides_: Sequence[int] | None = None

    def __post_init__(self) -> None:
        check_dims(self)
        check_sides(self)

    def sides(self, n: int) -> tuple[int, ...]:
        """Return the number of strata along each axis for `n` points."""
        return grid_sides(self.check_count(n), self.dims, self.sides_)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        sides = grid_sides(n, self.dims, self.sides_)
        if len(set(sides)) > 1:
            shares = stream.uniforms(first, count, n * self.dims).reshape(count, n, self.dims)
            points: Array = corners(sides) + shares * [cell_side(s) for s in sides]
            return points
        out = np.empty((count, n * self.dims))
        corner = corners(sides).ravel()
        _kernels.fill_jittered(stream.keys(first, count), corner, cell_side(sides[0]), out)
        return out.reshape(count, n, self.dims)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return grid_counts_near(n, self.dims, self.sides_)
