"""Discontinuous integrands (steps, disks, half-spaces), and the ramp, which smooths a step.

The inequality is strict at borders, so 1[x < a] is 0 at a grid point x = a.
"""

from __future__ import annotations

import itertools
import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import each_axis, real
from mcspectra.integrands._quadrature import gauss_rule
from mcspectra.integrands.analytic import squared_distance
from mcspectra.integrands.base import (
    Breaks,
    Integrand,
    any_dims,
    axis_number,
    per_axis,
)

__all__ = ["Disk", "HalfSpace", "SmoothedStep", "Step"]

# A Gauss rule in panels: number of cycles of a wave in a panel, and number of nodes in a panel
_CYCLES, _ORDER = 8, 32
_BLOCK = 2**22  # number of complex numbers in one block of a sum over nodes: 64 MiB
# Largest relative rounding error of a sum with alternating signs (inclusion and exclusion)
_CONDITION = 1e-10


class _Indicator(Integrand):
    """Base class of functions with the values 0 and 1."""

    @abstractmethod
    def _share(self, lo: Array, hi: Array) -> Array | None:
        """Return the fraction of each box in which f is 1. Return None if it is not known."""

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array] | None:
        """Return the means of f and f² over each box: for both, the fraction where f is 1."""
        share = self._share(lo, hi)
        return None if share is None else (share, share)

    def _integral(self) -> float | None:
        whole = self._share(np.zeros(self.dims), np.ones(self.dims))
        return None if whole is None else float(whole)


@final
@dataclass(frozen=True, kw_only=True)
class Step(_Indicator):
    """A step along one axis, f(x) = 1 where x_axis < at, else 0.

    Parameters
    ----------
    at
        Position of the step, in [0,1].
    axis
        Number of the axis, from 0.
    dims
        Number of dims.
    """

    at: float = real(0.5, least=0.0, most=1.0)
    axis: int = axis_number()
    dims: int = any_dims()

    @property
    def breaks(self) -> Breaks:
        """The position of the step on its axis."""
        return _on_axis(self.dims, self.axis, self.at)

    def _share(self, lo: Array, hi: Array) -> Array:
        return _overlap(lo[..., self.axis], hi[..., self.axis], 0.0, self.at)

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(x[..., self.axis] < self.at, np.float64)

    def _fourier(self, m: Array) -> Array:
        return _only_along(m, self.axis, _interval_fourier(m[..., self.axis], 0.0, self.at))


@final
@dataclass(frozen=True, kw_only=True)
class SmoothedStep(Integrand):
    """A falling ramp, f(x) = (at + width/2 − x_axis)/width, clipped to [0, 1].

    Parameters
    ----------
    at
        Middle of the ramp, in [0,1].
    width
        Width of the ramp, > 0. The ramp may extend beyond the domain.
    axis
        Number of the axis, from 0.
    dims
        Number of dims.
    """

    at: float = real(0.5, least=0.0, most=1.0)
    width: float = real(0.1, above=0.0)
    axis: int = axis_number()
    dims: int = any_dims()

    @property
    def _ramp(self) -> tuple[float, float]:
        """The part of the ramp that lies inside [0,1]."""
        return max(self.at - 0.5 * self.width, 0.0), min(self.at + 0.5 * self.width, 1.0)

    @property
    def breaks(self) -> Breaks:
        """Ends of the ramp that lie inside the domain."""
        inside = (knee for knee in self._ramp if 0.0 < knee < 1.0)
        return _on_axis(self.dims, self.axis, *inside)

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Return the means of f and f² over each box.

        Below the ramp, f is 1. The fraction of the box below the ramp is added to the means.
        Within the ramp, f is linear.
        """
        start, stop = self._ramp
        low, high = lo[..., self.axis], hi[..., self.axis]
        full, sloped = _overlap(low, high, 0.0, start), _overlap(low, high, start, stop)
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
        # Integrate by parts with f' = −1/width:
        # f_m = (f(0) − f(1) + ∫ f' exp(−2πi m x) dx) / (2πi m)
        along = m[..., self.axis]
        slope = _interval_fourier(along, *self._ramp) / self.width
        drop = self._height(0.0) - self._height(1.0)
        ramp = (drop - slope) / (2j * np.pi * np.where(along == 0, 1.0, along))
        return _only_along(m, self.axis, np.where(along == 0, self._integral(), ramp))


@final
@dataclass(frozen=True, kw_only=True)
class Disk(_Indicator):
    """The indicator of a ball, f(x) = 1 where |x − center| < radius, else 0.

    In 2-D, the integral and the coefficients are exact.
    If the faces of the domain cut the disk, its coefficients are integrals over chords.
    The integrals over chords have rounding accuracy.
    In 3-D and more, the coefficients of a ball inside the domain are exact (Bessel functions).
    A ball that the faces cut needs quadrature. Balls do not wrap around.

    Parameters
    ----------
    center
        One number for all axes or one for each. The center may lie outside the domain.
    radius
        Radius, > 0.
    dims
        Number of dims.
    """

    center: float | Sequence[float] = per_axis(0.5)
    _centers = each_axis("center")
    radius: float = real(0.25, above=0.0)
    dims: int = any_dims()

    @property
    def _inside(self) -> bool:
        c = self._centers
        return bool((c - self.radius >= 0.0).all() and (c + self.radius <= 1.0).all())

    @property
    def _interval(self) -> tuple[float, float]:
        """The part of a 1-D disk that lies inside [0,1]."""
        c = float(self._centers[0])
        low, high = max(c - self.radius, 0.0), min(c + self.radius, 1.0)
        return low, max(low, high)

    @property
    def breaks(self) -> Breaks:
        """Ends of a disk in 1-D. Empty in more dims: the border is not normal to an axis."""
        inside = tuple(end for end in self._interval if 0.0 < end < 1.0)
        return (inside,) if self.dims == 1 else ((),) * self.dims

    @property
    def fourier_source(self) -> str:
        """How coefficients are computed: by Bessel functions, or by chords of a cut disk."""
        if self.dims == 2 and not self._inside:
            return "Gauss-Legendre quadrature over exact chords, to rounding"
        return super().fourier_source

    def _share(self, lo: Array, hi: Array) -> Array | None:
        if self.dims == 1:
            return _overlap(lo[..., 0], hi[..., 0], *self._interval)
        return _disk_share(lo, hi, self._centers, self.radius) if self.dims == 2 else None

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(squared_distance(x, self._centers) < self.radius**2, np.float64)

    def _integral(self) -> float | None:
        return _ball_volume(self.dims, self.radius) if self._inside else super()._integral()

    def _fourier(self, m: Array) -> Array | None:
        if self.dims == 1:
            return _interval_fourier(m[..., 0], *self._interval)
        if not self._inside:
            return _cut_disk_fourier(m, self._centers, self.radius) if self.dims == 2 else None

        # The coefficient is (r/|m|)^{d/2} J_{d/2}(2π r |m|) exp(−2πi m·c)
        from scipy.special import jv

        order, length = self.dims / 2, np.sqrt((m * m).sum(axis=-1))
        safe = np.where(length > 0, length, 1.0)
        size = (self.radius / safe) ** order * jv(order, 2 * np.pi * self.radius * safe)
        size = np.where(length > 0, size, _ball_volume(self.dims, self.radius))
        return np.asarray(size * np.exp(-2j * np.pi * (m @ self._centers)))


@final
@dataclass(frozen=True, kw_only=True)
class HalfSpace(_Indicator):
    """The indicator of a half-space, f(x) = 1 where normal·x < offset, else 0.

    The integral and the coefficients are exact in 1-D and 2-D.
    In more dims, the coefficients come from quadrature.
    In at most 16 dims, inclusion and exclusion give the integral, as a sum over the cube's corners.
    The sum over corners counts as exact if rounding leaves ten correct digits.

    Parameters
    ----------
    normal
        One number for all axes or one for each. They must not all be 0.
    offset
        Position of the border, normal·x = offset.
    dims
        Number of dims.
    """

    normal: float | Sequence[float] = per_axis(1.0)
    _normal = each_axis("normal")
    offset: float = real(0.75)
    dims: int = any_dims()

    def _check(self) -> None:
        if not self._normal.any():
            raise ParameterError(
                f"normal is {self.normal!r}; one component at least must not be 0."
            )

    @property
    def breaks(self) -> Breaks:
        """The border of the half-space, if it is normal to an axis."""
        axes = np.flatnonzero(self._normal)
        at = float(self.offset / self._normal[axes[0]])
        if axes.size > 1 or not 0.0 < at < 1.0:
            return ((),) * self.dims
        return _on_axis(self.dims, int(axes[0]), at)

    def _share(self, lo: Array, hi: Array) -> Array | None:
        return _half_plane_share(lo, hi, self._normal, self.offset) if self.dims <= 2 else None

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(x @ self._normal < self.offset, np.float64)

    def _integral(self) -> float | None:
        whole = super()._integral()
        return _cut_cube_volume(self._normal, self.offset) if whole is None else whole

    def _fourier(self, m: Array) -> Array | None:
        if self.dims == 1:
            at = float(np.clip(self.offset / self._normal[0], 0.0, 1.0))
            ends = (0.0, at) if self._normal[0] > 0 else (at, 1.0)
            return _interval_fourier(m[..., 0], *ends)
        return _half_plane_fourier(m, self._normal, self.offset) if self.dims == 2 else None


def _on_axis(dims: int, axis: int, *places: float) -> Breaks:
    return tuple(places if i == axis else () for i in range(dims))


def _only_along(m: Array, axis: int, coefficients: Array) -> Array:
    """Return coefficients of a function of x_axis: 0 if another component of m is not 0."""
    others = (np.delete(m, axis, axis=-1) != 0).any(axis=-1)
    return np.where(others, 0.0, coefficients)


def _overlap(low: Array, high: Array, start: float, stop: float) -> Array:
    """Return the fraction of the intervals [low, high] that lies in [start, stop]."""
    inside = np.minimum(high, stop) - np.maximum(low, start)
    return np.asarray(np.maximum(inside, 0.0) / (high - low))


def _interval_fourier(nu: Array, low: Array | float, high: Array | float) -> Array:
    """Return ∫_low^high exp(−2πi ν x) dx for real ν, with its limit at ν = 0."""
    width = high - low
    return np.asarray(width * np.sinc(nu * width) * np.exp(-1j * np.pi * nu * (low + high)))


def _ball_volume(dims: int, radius: float) -> float:
    """Return the volume of a d-ball."""
    return float(math.pi ** (dims / 2) * radius**dims / math.gamma(dims / 2 + 1))


def _disk_share(lo: Array, hi: Array, center: Array, radius: float) -> Array:
    """Return the fraction of the rectangles [lo, hi], (..., 2), that lies in a disk.

    The method of inclusion and exclusion combines areas of quadrants.
    Differences of nearly equal areas would leave rounding errors.
    Therefore rectangles that lie completely inside or outside the disk are set to 1 or 0.
    """
    a, b = (lo - center) / radius, (hi - center) / radius
    box = (b - a).prod(axis=-1)
    area = (
        _quadrant(b[..., 0], b[..., 1])
        - _quadrant(a[..., 0], b[..., 1])
        - _quadrant(b[..., 0], a[..., 1])
        + _quadrant(a[..., 0], a[..., 1])
    )
    farthest = (np.maximum(np.abs(a), np.abs(b)) ** 2).sum(axis=-1)
    nearest = (np.clip(0.0, a, b) ** 2).sum(axis=-1)
    share = np.clip(area / box, 0.0, 1.0)
    return np.where(farthest <= 1.0, 1.0, np.where(nearest >= 1.0, 0.0, share))


def _quadrant(x: Array, y: Array) -> Array:
    """Return the area of the part of the unit disk in (−∞, x] × (−∞, y]."""
    x, y = np.clip(x, -1.0, 1.0), np.clip(y, -1.0, 1.0)
    k = np.sqrt(1.0 - y * y)
    inner = np.clip(x, -k, k)
    strip = y * (inner + k)  # The horizontal chord at y cuts the disk
    below = _half_area(inner) - _half_area(-k) + strip
    caps = _half_area(np.minimum(x, -k)) + _half_area(np.maximum(x, k)) - _half_area(k)
    return np.asarray(np.where(y < 0, below, _half_area(x) + caps + strip))


def _half_area(x: Array) -> Array:
    """Return ∫_{−1}^x √(1−t²) dt."""
    return np.asarray(0.5 * (x * np.sqrt(1.0 - x * x) + np.arcsin(x) + 0.5 * np.pi))


def _cut_disk_fourier(m: Array, center: Array, radius: float) -> Array:
    """Return coefficients, at m (..., 2), of a disk that the unit square cuts, chord by chord.

    The integral along a chord is exact. With x_0 = c_0 + r sin θ, chords are functions of θ.
    The ends of a chord are smooth functions of θ, except for kinks where the circle meets a border.
    Gauss-Legendre panels between the kinks integrate the highest frequency to rounding accuracy.
    The cost is O(U_0 U_1 (|m| + const)), where U_i is the number of distinct m_i.
    """
    m0, where0 = np.unique(m[..., 0], return_inverse=True)
    m1, where1 = np.unique(m[..., 1], return_inverse=True)

    # Divide the range of θ at the kinks, and into panels of at most 8 cycles
    cycles = float(np.abs(m).sum(axis=-1).max())
    ends = np.arcsin(np.clip((np.array([0.0, 1.0]) - center[0]) / radius, -1.0, 1.0))
    meets = np.arccos(np.clip(np.abs(np.array([center[1], 1.0 - center[1]])) / radius, 0.0, 1.0))
    kinks = np.unique(np.clip([*ends, *meets, *-meets], ends[0], ends[1]))
    edges = [np.empty(0)]
    for low, high in itertools.pairwise(kinks):
        count = math.ceil(1 + cycles * radius * (high - low) / _CYCLES)
        edges.append(np.linspace(low, high, count + 1))
    lower = np.concatenate([e[:-1] for e in edges])[:, None]
    width = np.concatenate([np.diff(e) for e in edges])[:, None]
    node, rule = gauss_rule(_ORDER)
    theta, weight = (lower + width * node).ravel(), (width * rule).ravel()

    # Sum over the chords in blocks
    total = np.zeros((m0.size, m1.size), np.complex128)
    step = max(1, _BLOCK // (m0.size + m1.size))
    for start in range(0, theta.size, step):
        t = theta[start : start + step]
        half = radius * np.cos(t)
        low, high = np.clip(center[1] - half, 0.0, 1.0), np.clip(center[1] + half, 0.0, 1.0)
        waves = np.exp(-2j * np.pi * m0[:, None] * (center[0] + radius * np.sin(t)))
        chords = _interval_fourier(m1[:, None], low, high)
        total += (waves * (weight[start : start + step] * half)) @ chords.T
    return np.asarray(total[where0.reshape(m.shape[:-1]), where1.reshape(m.shape[:-1])])


def _half_plane_share(lo: Array, hi: Array, normal: Array, offset: float) -> Array:
    """Return the fraction of boxes [lo, hi], (..., 1) or (..., 2), where normal·x < offset.

    Let a ≥ b ≥ 0 be the absolute components of the normal, multiplied by the sides of the box.
    The fraction is the distribution function of a u + b v, where u and v are uniform in [0, 1].
    The density of a u + b v is a trapezoid with corners at b and a.
    """
    sides = (hi - lo) * normal
    level = offset - lo @ normal - np.minimum(sides, 0.0).sum(axis=-1)
    sides = np.sort(np.abs(sides), axis=-1)
    a = sides[..., -1]
    b = sides[..., 0] if sides.shape[-1] == 2 else np.zeros_like(a)
    level = np.clip(level, 0.0, a + b)
    mirrored = np.minimum(level, a + b - level)  # the distribution is symmetric about (a + b)/2
    twice = np.where(b > 0, 2.0 * a * b, 1.0)
    share = np.where(mirrored < b, mirrored**2 / twice, (mirrored - 0.5 * b) / a)
    return np.asarray(np.where(level > 0.5 * (a + b), 1.0 - share, share))


def _cut_cube_volume(normal: Array, offset: float) -> float | None:
    """Return the volume of {x in [0,1]^d: normal·x < offset}. Return None if rounding spoils it.

    Reflections make all components of the normal ≥ 0. The k components above 0 are the n_i.
    The volume is Σ_v (−1)^|v| (offset − n·v)_+^k / (k! Π n_i) [BarrowSmith1979]_.
    The sum is over the corners v of the cube.
    The terms of the sum cancel, so its relative rounding error is checked.
    """
    level = offset - np.minimum(normal, 0.0).sum()
    n = np.abs(normal[normal != 0])
    if level <= 0 or level >= n.sum():
        return float(level > 0)
    if n.size > 16:
        return None
    low = min(level, n.sum() - level)
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=n.size)))
    terms = np.maximum(low - corners @ n, 0.0) ** n.size / (math.factorial(n.size) * n.prod())
    volume = float((terms * (-1.0) ** corners.sum(axis=-1)).sum())
    if np.finfo(float).eps * n.size * terms.sum() > _CONDITION * volume:
        return None
    return volume if level == low else 1.0 - volume


def _half_plane_fourier(m: Array, normal: Array, offset: float) -> Array:
    """Return coefficients of the indicator of normal·x < offset on the unit square, at m (..., 2).

    The region is {x_k < α + β x_j} or its complement.
    The larger component of the normal is on axis k, so |β| ≤ 1.
    For x_j in [a, b] the line lies inside the square, and the integral along x_k is exact.
    The integral along x_j, of exp(−2πi (m_j + β m_k) x_j), has no singularity at any m.
    """
    k = int(np.argmax(np.abs(normal)))
    mj, mk = m[..., 1 - k], m[..., k]
    alpha, beta = float(offset / normal[k]), float(-normal[1 - k] / normal[k])
    if beta == 0:
        a, b = (0.0, 1.0) if 0 < alpha < 1 else (0.0, 0.0)
    else:
        a, b = np.clip(sorted((-alpha / beta, (1 - alpha) / beta)), 0, 1).tolist()
    if beta == 0:  # `full`: the interval of x_j where the border of the half-space is above 1
        full = (0.0, 1.0) if alpha >= 1 else (0.0, 0.0)
    else:
        cross = min(max((1.0 - alpha) / beta, 0.0), 1.0)
        full = (cross, 1.0) if beta > 0 else (0.0, cross)

    # Integrate ∫_a^b ∫_0^{α+βx} exp(−2πi (m_j x + m_k y)) dy dx.
    # Where the border y = α + βx lies above the square, y covers all of [0, 1]: add this strip
    flat = mk == 0
    edge = np.exp(-2j * np.pi * mk * alpha) * _interval_fourier(mj + beta * mk, a, b)
    base = _interval_fourier(mj, a, b)
    tilted = (base - edge) / (2j * np.pi * np.where(flat, 1.0, mk))
    below = np.where(flat, alpha * base + beta * _ramp_fourier(mj, a, b), tilted)
    below += np.where(flat, _interval_fourier(mj, *full), 0.0)
    whole = ((mj == 0) & flat).astype(float)
    return np.asarray(below if normal[k] > 0 else whole - below)


def _ramp_fourier(m: Array, a: float, b: float) -> Array:
    """Return ∫_a^b x exp(−2πi m x) dx for integer m. It is integrated by parts."""
    zero = m == 0
    c = 2j * np.pi * np.where(zero, 1.0, m)
    at_a, at_b = np.exp(-c * a), np.exp(-c * b)
    return np.where(zero, 0.5 * (b * b - a * a), (a * at_a - b * at_b) / c + (at_a - at_b) / c**2)
