"""Discontinuous integrands, and one smoothed: indicators of half-spaces and balls, and ramps.

The strict inequality decides on borders, so that 1[x < a] of a grid point at a is 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.integrands._axes import (
    PerAxis,
    axis_values,
    interval_fourier,
    overlap,
    settle,
    squared_distance,
)
from mcspectra.integrands._shapes import (
    ball_fourier,
    ball_volume,
    cut_cube_volume,
    cut_disk_fourier,
    disk_share,
    half_plane_fourier,
    half_plane_share,
)
from mcspectra.integrands.base import Integrand, check_dims

__all__ = ["Disk", "HalfSpace", "SmoothedStep", "Step"]

_Breaks = tuple[tuple[float, ...], ...]


@final
@dataclass(frozen=True, kw_only=True)
class Step(Integrand):
    """A step along one axis, f(x) = 1 where x_axis < at, else 0.

    Parameters
    ----------
    at
        Place of the step, in [0,1].
    axis
        Which axis, from 0.
    dims
        Number of dims.
    """

    name: ClassVar[str] = "step"
    at: float = 0.5
    axis: int = 0
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        settle(self, dims=check_dims(self), at=as_real("at", self.at, least=0.0, most=1.0))
        settle(self, axis=as_integer("axis", self.axis, least=0, most=self.dims - 1))

    @property
    def breaks(self) -> _Breaks:
        """The step."""
        return _on_axis(self.dims, self.axis, self.at)

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Share of each box below the step, twice: f² = f."""
        share = overlap(lo[..., self.axis], hi[..., self.axis], 0.0, self.at)
        return share, share

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(x[..., self.axis] < self.at, np.float64)

    def _integral(self) -> float:
        return self.at

    def _fourier(self, m: Array) -> Array:
        return _only_along(m, self.axis, interval_fourier(m[..., self.axis], 0.0, self.at))


@final
@dataclass(frozen=True, kw_only=True)
class SmoothedStep(Integrand):
    """A falling ramp along one axis, f(x) = (at + width/2 − x_axis)/width, held between 0 and 1.

    Parameters
    ----------
    at
        Middle of the ramp, in [0,1].
    width
        Width of the ramp, > 0; the ramp may reach beyond the domain.
    axis
        Which axis, from 0.
    dims
        Number of dims.
    """

    name: ClassVar[str] = "smoothed-step"
    at: float = 0.5
    width: float = 0.1
    axis: int = 0
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        settle(self, dims=check_dims(self), at=as_real("at", self.at, least=0.0, most=1.0))
        settle(self, axis=as_integer("axis", self.axis, least=0, most=self.dims - 1))
        settle(self, width=as_real("width", self.width, above=0.0))

    @property
    def _ramp(self) -> tuple[float, float]:
        """The part of the ramp inside [0,1]."""
        return max(self.at - 0.5 * self.width, 0.0), min(self.at + 0.5 * self.width, 1.0)

    @property
    def breaks(self) -> _Breaks:
        """The two knees, where they are inside."""
        inside = (knee for knee in self._ramp if 0.0 < knee < 1.0)
        return _on_axis(self.dims, self.axis, *inside)

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Share below the ramp, and the trapezoid and its square within the ramp."""
        start, stop = self._ramp
        low, high = lo[..., self.axis], hi[..., self.axis]
        full, sloped = overlap(low, high, 0.0, start), overlap(low, high, start, stop)
        p = self._height(np.clip(low, start, stop))
        q = self._height(np.clip(high, start, stop))
        return full + 0.5 * sloped * (p + q), full + sloped * (p * p + p * q + q * q) / 3.0

    def _height(self, x: Array | float) -> Array:
        return np.clip((self.at - x) / self.width + 0.5, 0.0, 1.0)

    def _evaluate(self, x: Array) -> Array:
        return self._height(x[..., self.axis])

    def _integral(self) -> float:
        start, stop = self._ramp
        middle = 0.5 * (self._height(start) + self._height(stop))
        return float(start + (stop - start) * middle)

    def _fourier(self, m: Array) -> Array:
        # By parts: f_m = (f(0) − f(1) + ∫ f' exp(−2πi m x) dx) / (2πi m), with f' = −1/width.
        along = m[..., self.axis]
        slope = interval_fourier(along, *self._ramp) / self.width
        drop = self._height(0.0) - self._height(1.0)
        ramp = (drop - slope) / (2j * np.pi * np.where(along == 0, 1.0, along))
        return _only_along(m, self.axis, np.where(along == 0, self._integral(), ramp))


@final
@dataclass(frozen=True, kw_only=True)
class Disk(Integrand):
    """The indicator of a ball, f(x) = 1 where |x − center| < radius, else 0.

    In 2-D everything is exact, also where the domain cuts the disk: its coefficients are then
    integrated chord by chord, to rounding. In 3-D and more a ball inside the domain is exact
    (Bessel functions), one that is cut is left to quadrature. There is no wrap-around.

    Parameters
    ----------
    center
        One number for all axes or one for each; it may lie outside the domain.
    radius
        Radius, > 0.
    dims
        Number of dims.
    """

    name: ClassVar[str] = "disk"
    center: PerAxis = 0.5
    radius: float = 0.25
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        settle(self, dims=check_dims(self), radius=as_real("radius", self.radius, above=0.0))
        settle(self, center=axis_values("center", self.center, self.dims))

    @property
    def _centers(self) -> Array:
        return np.broadcast_to(np.asarray(self.center, float), (self.dims,))

    @property
    def _inside(self) -> bool:
        c = self._centers
        return bool((c - self.radius >= 0.0).all() and (c + self.radius <= 1.0).all())

    @property
    def _interval(self) -> tuple[float, float]:
        """The part of a 1-D disk inside [0,1]."""
        c = float(self._centers[0])
        low, high = max(c - self.radius, 0.0), min(c + self.radius, 1.0)
        return low, max(low, high)

    @property
    def breaks(self) -> _Breaks:
        """Both ends in 1-D; in more dims the border lies along no axis."""
        inside = tuple(end for end in self._interval if 0.0 < end < 1.0)
        return (inside,) if self.dims == 1 else ((),) * self.dims

    @property
    def fourier_source(self) -> str:
        """Bessel functions where the disk is inside the domain, else chords."""
        if self.dims == 2 and not self._inside:
            return "Gauss-Legendre quadrature over exact chords, to rounding"
        return super().fourier_source

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array] | None:
        """Share of each box within the disk, twice, in 1-D and 2-D."""
        if self.dims == 1:
            share = overlap(lo[..., 0], hi[..., 0], *self._interval)
        elif self.dims == 2:
            share = disk_share(lo, hi, self._centers, self.radius)
        else:
            return None
        return share, share

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(squared_distance(x, self._centers) < self.radius**2, np.float64)

    def _integral(self) -> float | None:
        if self._inside:
            return ball_volume(self.dims, self.radius)
        whole = self.box_moments(np.zeros(self.dims), np.ones(self.dims))
        return None if whole is None else float(whole[0])

    def _fourier(self, m: Array) -> Array | None:
        if self.dims == 1:
            return interval_fourier(m[..., 0], *self._interval)
        if self._inside:
            return ball_fourier(m, self._centers, self.radius)
        return cut_disk_fourier(m, self._centers, self.radius) if self.dims == 2 else None


@final
@dataclass(frozen=True, kw_only=True)
class HalfSpace(Integrand):
    """The indicator of a half-space, f(x) = 1 where normal·x < offset, else 0.

    Exact in 1-D and 2-D; in more dims the integral is exact (where inclusion and exclusion of the
    cube's corners keeps ten digits, at most 16 dims) and the coefficients come from quadrature.

    Parameters
    ----------
    normal
        One number for all axes or one for each, not all 0.
    offset
        Position of the border, normal·x = offset.
    dims
        Number of dims.
    """

    name: ClassVar[str] = "half-space"
    normal: PerAxis = 1.0
    offset: float = 0.75
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        settle(self, dims=check_dims(self), offset=as_real("offset", self.offset))
        settle(self, normal=axis_values("normal", self.normal, self.dims))
        if not self._normal.any():
            raise ParameterError(
                f"normal is {self.normal!r}; one component at least must not be 0."
            )

    @property
    def _normal(self) -> Array:
        return np.broadcast_to(np.asarray(self.normal, float), (self.dims,))

    @property
    def breaks(self) -> _Breaks:
        """The border, if it is normal to an axis."""
        axes = np.flatnonzero(self._normal)
        at = float(self.offset / self._normal[axes[0]])
        if axes.size > 1 or not 0.0 < at < 1.0:
            return ((),) * self.dims
        return _on_axis(self.dims, int(axes[0]), at)

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array] | None:
        """Share of each box on the side of 1, twice, in 1-D and 2-D."""
        if self.dims > 2:
            return None
        share = half_plane_share(lo, hi, self._normal, self.offset)
        return share, share

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(x @ self._normal < self.offset, np.float64)

    def _integral(self) -> float | None:
        if self.dims > 2:
            return cut_cube_volume(self._normal, self.offset)
        unit = np.zeros(self.dims), np.ones(self.dims)
        return float(half_plane_share(*unit, self._normal, self.offset))

    def _fourier(self, m: Array) -> Array | None:
        if self.dims == 1:
            at = float(np.clip(self.offset / self._normal[0], 0.0, 1.0))
            ends = (0.0, at) if self._normal[0] > 0 else (at, 1.0)
            return interval_fourier(m[..., 0], *ends)
        return half_plane_fourier(m, self._normal, self.offset) if self.dims == 2 else None


def _on_axis(dims: int, axis: int, *places: float) -> _Breaks:
    return tuple(places if i == axis else () for i in range(dims))


def _only_along(m: Array, axis: int, coefficients: Array) -> Array:
    """Coefficients of a function of x_axis alone: 0 where another component of m is not 0."""
    others = (np.delete(m, axis, axis=-1) != 0).any(axis=-1)
    return np.where(others, 0.0, coefficients)
