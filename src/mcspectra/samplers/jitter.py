"""Other jitter than one uniform point a cell: narrower or wider, Gaussian, antithetic pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_real
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _jitter_kernels
from mcspectra.samplers._grid import cell_side, corners, grid_counts_near, root
from mcspectra.samplers.base import Sampler, Structure, check_dims

__all__ = ["AntitheticJittered", "BoxJitter", "GaussianJitter"]

_MOST_WIDTH = 1000.0  # cells: far beyond independent points, and wrapped in float64 without loss


@final
@dataclass(frozen=True, kw_only=True)
class BoxJitter(Sampler):
    """Centers of the cells of a grid, each moved uniformly within a box of a given width, wrapped.

    Any dims; counts s^d.

    Attributes
    ----------
    width
        Side of the box in sides of a cell, from 0 to 1000: 0 is the regular grid, 1 is jittered.

    Notes
    -----
    Every point is uniform on the torus where the boxes tile it: for whole widths from 1 on. Others
    leave gaps or overlaps at the same places of every cell; shift makes them uniform. Points that
    leave the domain at one end come in at the other. The default is narrow enough to look
    unlike jittered, and is not from a paper.

    References
    ----------
    Ramamoorthi, Anderson, Meyer, Nowrouzezahrai (2012), "A theory of Monte Carlo visibility
    sampling", doi 10.1145/2231816.2231819.
    """

    name: ClassVar[str] = "box-jitter"
    structure: ClassVar[Structure] = Structure.TORUS
    dims: int = DEFAULT_DIMS
    width: float = 0.5

    def __post_init__(self) -> None:
        check_dims(self)
        width = as_real("width", self.width, least=0.0, most=_MOST_WIDTH)
        object.__setattr__(self, "width", width)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether the boxes tile the torus."""
        return self.width >= 1.0 and self.width.is_integer()

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        u = stream.uniforms(first, count, n * self.dims)
        return _moved_centers(n, self.dims, self.width * (u - 0.5))

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return grid_counts_near(n, self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class GaussianJitter(Sampler):
    """Centers of the cells of a grid, each moved by a Gaussian vector of its own, wrapped.

    Any dims; counts s^d.

    Attributes
    ----------
    width
        Standard deviation along each axis in sides of a cell, from 0 (the regular grid) to 1000.

    Notes
    -----
    A point is not uniform: the centers show in its density as 1 + 2 exp(−2π² width²) cos(2πsx) + …
    along each axis, by 58 % at width 0.25 and by 10^-8 at width 1; shift makes it uniform. Points
    may leave their cells; those that leave the domain come in at the other end. The default is about
    the standard deviation of jittered, 0.29, and is not from a paper.

    References
    ----------
    Balakrishnan (1962), "On the problem of time jitter in sampling", doi 10.1109/TIT.1962.1057717.
    """

    name: ClassVar[str] = "gaussian-jitter"
    structure: ClassVar[Structure] = Structure.TORUS
    unbiased: ClassVar[bool] = False
    dims: int = DEFAULT_DIMS
    width: float = 0.25

    def __post_init__(self) -> None:
        check_dims(self)
        width = as_real("width", self.width, least=0.0, most=_MOST_WIDTH)
        object.__setattr__(self, "width", width)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        from scipy.special import ndtri

        u = stream.uniforms(first, count, n * self.dims)
        normal = ndtri(np.maximum(u, 2.0**-54))  # 0 would go to −∞
        return _moved_centers(n, self.dims, self.width * normal)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return grid_counts_near(n, self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class AntitheticJittered(Sampler):
    """Two points in each of s^d cells: a uniform one and its reflection through the cell's center.

    Any dims; counts 2 s^d. Points 2i and 2i + 1 are the pair of cell i.

    Notes
    -----
    The linear part of the integrand cancels within each pair, so that the variance of smooth
    integrands goes down as n^(−1 − 4/d), that of jittered as n^(−1 − 2/d).

    References
    ----------
    Haber (1967), "A modified Monte-Carlo quadrature. II", doi 10.1090/S0025-5718-1967-0234606-9.

    Haber (1970), "Numerical evaluation of multiple integrals", doi 10.1137/1012102.
    """

    name: ClassVar[str] = "antithetic-jittered"
    structure: ClassVar[Structure] = Structure.STRATA
    antithetic: ClassVar[bool] = True
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        check_dims(self)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        cells, s = n // 2, root(n // 2, self.dims)
        out = np.empty((count, cells, 2, self.dims))
        grid = corners((s,) * self.dims)
        _jitter_kernels.fill_antithetic(stream.keys(first, count), grid, cell_side(s), out)
        return out.reshape(count, n, self.dims)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        if n == 1:
            return None, 2
        below = 2 * root(n // 2, self.dims) ** self.dims
        return below, below if below == n else 2 * grid_counts_near(n // 2 + 1, self.dims)[1]


def _moved_centers(n: int, dims: int, displacements: Array) -> Array:
    """Return the cell centers plus displacements in cells, (count, n·d), on the torus."""
    s = root(n, dims)
    points = displacements.reshape(-1, n, dims)
    points += 0.5
    points /= s
    points += corners((s,) * dims)
    points -= np.floor(points)
    points[points == 1.0] = 0.0  # −1e-20 − ⌊−1e-20⌋ rounds to 1
    return points
