"""Random and stratified samplers: random, regular, uniform jitter, jitter, Latin hypercube, multi-jitter.

The unit cube is cut into n cells of equal volume (s a side, n = s^d), or each axis into n strata.
Points come in row-major order of their cells, the last coordinate fastest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _kernels
from mcspectra.samplers.base import Sampler, Structure, check_dims

__all__ = ["Jittered", "LatinHypercube", "MultiJittered", "Random", "Regular", "UniformJitter"]


@final
@dataclass(frozen=True, kw_only=True)
class Random(Sampler):
    """Independent uniform points."""

    name: ClassVar[str] = "random"
    structure: ClassVar[Structure] = Structure.NONE
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        check_dims(self)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        return stream.uniforms(first, count, n * self.dims).reshape(count, n, self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class Regular(Sampler):
    """Regular grid of s^d points, the same every time.

    Attributes
    ----------
    position
        ``"center"`` or ``"corner"`` (the one next to the origin) of each cell.
    """

    name: ClassVar[str] = "regular"
    structure: ClassVar[Structure] = Structure.STRATA
    unbiased: ClassVar[bool] = False
    dims: int = DEFAULT_DIMS
    position: str = "center"

    def __post_init__(self) -> None:
        check_dims(self)
        as_choice("position", self.position, ("center", "corner"))

    def sides(self, n: int) -> int:
        """Return s, the number of cells along each axis, for n = s^d points."""
        return _root(self.check_count(n), self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        s = _root(n, self.dims)
        grid = _corners(s, self.dims) + (0.5 / s if self.position == "center" else 0.0)
        return np.tile(grid, (count, 1, 1))

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return _powers_near(n, self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class UniformJitter(Sampler):
    """Regular grid of s^d points moved by one random offset within a cell, the same for all points.

    References
    ----------
    Ramamoorthi, Anderson, Meyer, Nowrouzezahrai (2012), "A theory of Monte Carlo visibility
    sampling", doi 10.1145/2231816.2231819.
    """

    name: ClassVar[str] = "uniform-jitter"
    structure: ClassVar[Structure] = Structure.TORUS
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        check_dims(self)

    def sides(self, n: int) -> int:
        """Return s, the number of cells along each axis, for n = s^d points."""
        return _root(self.check_count(n), self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        s = _root(n, self.dims)
        offsets = stream.uniforms(first, count, self.dims)[:, None, :] / s
        points: Array = _corners(s, self.dims) + offsets
        # (s − 1 + u)/s, u < 1, can round up to 1
        return np.minimum(points, np.nextafter(1.0, 0.0), out=points)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return _powers_near(n, self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class Jittered(Sampler):
    """One uniform point in each of s^d cells."""

    name: ClassVar[str] = "jittered"
    structure: ClassVar[Structure] = Structure.STRATA
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        check_dims(self)

    def sides(self, n: int) -> int:
        """Return s, the number of strata along each axis, for n = s^d points."""
        return _root(self.check_count(n), self.dims)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        s = _root(n, self.dims)
        out = np.empty((count, n * self.dims))
        corners = _corners(s, self.dims).ravel()
        _kernels.fill_jittered(stream.keys(first, count), corners, 1.0 / s, out)
        return out.reshape(count, n, self.dims)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return _powers_near(n, self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class LatinHypercube(Sampler):
    """Each coordinate stratified into n by a random permutation of its own, jittered within.

    References
    ----------
    McKay, Beckman, Conover (1979), doi 10.1080/00401706.1979.10489755.
    """

    name: ClassVar[str] = "latin-hypercube"
    structure: ClassVar[Structure] = Structure.STRATA
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        check_dims(self)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        out = np.empty((count, n, self.dims))
        _kernels.fill_latin(stream.keys(first, count), out)
        return out


@final
@dataclass(frozen=True, kw_only=True)
class MultiJittered(Sampler):
    """Jittered in a × b cells and, at once, one point in each n-th of either axis (2-D).

    The counts are those n = a·b with a ≤ b ≤ 2a; the most nearly square such a × b is taken. The
    shares of a column (or row) are shuffled independently of those of the others.

    References
    ----------
    Chiu, Shirley, Wang (1994), "Multi-jittered sampling", Graphics Gems IV; Kensler (2013),
    Pixar technical memo 13-01, repeats one shuffle in all columns instead.
    """

    name: ClassVar[str] = "multi-jittered"
    structure: ClassVar[Structure] = Structure.STRATA
    max_dims: ClassVar[int | None] = 2
    dims: int = 2

    def __post_init__(self) -> None:
        if self.dims != 2:
            raise ParameterError(
                f"multi-jittered: dims is {self.dims!r}; it must be 2, "
                "for other dims use jittered or latin-hypercube."
            )
        check_dims(self)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        columns = _nearly_square(n)
        out = np.empty((count, n, 2))
        _kernels.fill_multi_jittered(stream.keys(first, count), columns, n // columns, out)
        return out

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        below = above = n
        while not _nearly_square(below):
            below -= 1
        while not _nearly_square(above):
            above += 1
        return below, above


def _root(n: int, dims: int) -> int:
    """Largest s with s^dims ≤ n, in exact integers (64 ** (1 / 3) is 3.9999…)."""
    s: int = round(n ** (1.0 / dims)) + 1
    while s**dims > n:
        s -= 1
    return s


def _powers_near(n: int, dims: int) -> tuple[int, int]:
    s = _root(n, dims)
    return s**dims, n if s**dims == n else (s + 1) ** dims


@lru_cache(maxsize=2)  # analyses draw block after block of one n; no more memory than the points
def _corners(s: int, dims: int) -> Array:
    """Lower corners of the cells of side 1/s: float64 (s^dims, dims), read-only."""
    corners = np.zeros((s**dims, dims))
    for j in range(dims if s > 1 else 0):
        axis = np.arange(s) / s
        corners[:, j].reshape(s**j, s, -1)[:] = axis[:, None]
    corners.setflags(write=False)
    return corners


def _nearly_square(n: int) -> int:
    """Largest divisor a of n with n/2 ≤ a² ≤ n, 0 if there is none."""
    candidates = np.arange(math.isqrt(n), math.isqrt((n - 1) // 2), -1)
    found = candidates[n % candidates == 0]
    return int(found[0]) if found.size else 0
