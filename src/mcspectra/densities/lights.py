"""Solid-angle sampling of a rectangular or triangular light, in area coordinates of the light.

The square (s, t) maps to the light with a constant Jacobian.
Therefore uniform points (s, t) in the square are uniform on the area of the light.
The densities here are uniform in solid angle, p(s, t) = area · cos θ' / (r² Ω).
Both densities are positive everywhere, and can be applied to any integrand in (s, t).

The code computes cumulative solid angles without differences of nearly equal terms.
Newton's method inverts these cumulative solid angles.
The closed forms of the papers compute a small Ω as a difference of angles of order 1.
Therefore the closed forms of the papers lose all digits for small lights.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import checked
from mcspectra.core.geometry import as_vector, check_light, norm, triangle_angle
from mcspectra.densities.base import Density

__all__ = ["SphericalRectangle", "SphericalTriangle"]

Vector = tuple[float, float, float]

_PERPENDICULAR = 1e-9  # largest cosine of the angle between edges of a rectangle, which should be 0
_MOST = 120  # largest number of iterations: 53 bisections, at most doubled by Newton steps
_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, kw_only=True)
class _Light(Density):
    """Density that maps u to coordinates (s, t) of a light.

    u_0 is the fraction of the solid angle below s. u_1 is the fraction below t on the line at s.
    """

    dims: int = field(default=2, init=False)

    @abstractmethod
    def _share(self, s: Array) -> tuple[Array, Array]:
        """Return the fraction of Ω from coordinate 0 to s, and the derivative in s."""

    @abstractmethod
    def _share_of_line(self, s: Array, t: Array) -> tuple[Array, Array]:
        """Return the share up to t on the line of constant s, and its derivative in t."""

    def _sample(self, u: Array) -> Array:
        s = _solve_increasing(self._share, u[..., 0])
        t = _solve_increasing(lambda t: self._share_of_line(s, t), u[..., 1])
        return np.stack([s, t], axis=-1)

    def _invert(self, x: Array) -> Array:
        s, t = x[..., 0], x[..., 1]
        return np.stack([self._share(s)[0], self._share_of_line(s, t)[0]], axis=-1)


def _solve_increasing(function: Callable[[Array], tuple[Array, Array]], target: Array) -> Array:
    """Solve F(s) = target for each element, by Newton's method within a shrinking bracket.

    Parameters
    ----------
    function
        Function of s that returns F(s) and F'(s) > 0, with F(0) = 0 and F(1) = 1.
        F(s) and F'(s) have the shape of `target`.
    target
        Values in [0,1].

    Notes
    -----
    Elements that have converged do not change further, so results do not depend on other elements.
    """
    low, high = np.zeros_like(target), np.ones_like(target)
    s, last = target.copy(), np.ones_like(target)
    done = np.zeros(target.shape, bool)
    for _ in range(_MOST):
        value, slope = function(s)
        gap = value - target
        low, high = np.where(gap <= 0, s, low), np.where(gap >= 0, s, high)
        step = gap / slope
        done |= np.abs(gap) <= 4.0 * _EPS * target
        small = np.abs(step) <= 8.0 * _EPS * s
        newton = (s - step >= low) & (s - step <= high) & (small | (np.abs(step) <= 0.5 * last))
        new = np.where(done, s, np.where(newton, s - step, 0.5 * (low + high)))
        last = np.abs(new - s)
        done |= small | (last <= _EPS * new)
        s = new
        if done.all():
            break
    return s


@final
@dataclass(frozen=True, kw_only=True)
class SphericalRectangle(_Light):
    """Density uniform in a rectangle's solid angle. x = (s, t) is the point corner + s e_0 + t e_1.

    u_0 is the share of the solid angle up to s [Urena2013]_.
    On the line of constant s, u_1 is the share of the density from 0 to t.

    Attributes
    ----------
    corner
        One corner of the rectangle.
    edge0, edge1
        The edges e_0 and e_1 from the corner, at right angles.
    origin
        The illuminated point, which must not lie in the plane of the light.
    """

    corner: Vector = checked(as_vector, (-0.5, -0.5, 1.0))
    edge0: Vector = checked(as_vector, (1.0, 0.0, 0.0))
    edge1: Vector = checked(as_vector, (0.0, 1.0, 0.0))
    origin: Vector = checked(as_vector, (0.0, 0.0, 0.0))

    def _check(self) -> None:
        e0, e1 = np.array(self.edge0), np.array(self.edge1)
        self._height  # noqa: B018 - checks for degenerate lights
        if abs(e0 @ e1) > _PERPENDICULAR * norm(e0) * norm(e1):
            raise ParameterError(
                f"edge0 {self.edge0} and edge1 {self.edge1} are not at right angles; for other "
                "parallelograms give two spherical triangles."
            )

    @cached_property
    def _height(self) -> float:
        corner = np.subtract(self.corner, self.origin)
        return check_light("rectangle", corner, np.array(self.edge0), np.array(self.edge1))

    @cached_property
    def _frame(self) -> tuple[float, float, float, float]:
        """Smallest x and y of the light in the frame of its edges, and the lengths of its edges."""
        corner = np.subtract(self.corner, self.origin)
        e0, e1 = np.array(self.edge0), np.array(self.edge1)
        l0, l1 = float(norm(e0)), float(norm(e1))
        return float(corner @ e0) / l0, float(corner @ e1) / l1, l0, l1

    @cached_property
    def solid_angle(self) -> float:
        """Solid angle Ω in steradians."""
        return float(self._strip(np.ones(())))

    def _strip(self, s: Array) -> Array:
        """Return the solid angle of the strip of the light from coordinate 0 to s."""
        x0, y0, l0, l1 = self._frame
        z = self._height
        near, far = _corners(np.full(s.shape, x0), y0, l1, z), _corners(x0 + s * l0, y0, l1, z)
        volume = z * l0 * l1 * s
        first = triangle_angle(volume, near[0], far[0], far[1])
        return first + triangle_angle(volume, near[0], far[1], near[1])

    def _share(self, s: Array) -> tuple[Array, Array]:
        x0, y0, l0, l1 = self._frame
        squared = (x0 + s * l0) ** 2 + self._height**2
        line = self._height / squared * _rise(squared, y0, l1)
        return self._strip(s) / self.solid_angle, l0 * line / self.solid_angle

    def _share_of_line(self, s: Array, t: Array) -> tuple[Array, Array]:
        x0, y0, l0, l1 = self._frame
        squared = (x0 + s * l0) ** 2 + self._height**2
        whole = _rise(squared, y0, l1)
        slope = l1 * squared / (squared + (y0 + t * l1) ** 2) ** 1.5
        return _rise(squared, y0, t * l1) / whole, slope / whole

    def _pdf(self, x: Array) -> Array:
        x0, y0, l0, l1 = self._frame
        s, t = x[..., 0], x[..., 1]
        squared = (x0 + s * l0) ** 2 + (y0 + t * l1) ** 2 + self._height**2
        return np.asarray(l0 * l1 * self._height / squared**1.5 / self.solid_angle)


@final
@dataclass(frozen=True, kw_only=True)
class SphericalTriangle(_Light):
    """Density uniform in the solid angle of a triangle, with area coordinates (s, t).

    x = (s, t) is the point b + √t ((1 − s) a + s c − b).
    The ray from b through x cuts off the share s of the area, next to the edge ab.
    The line through x parallel to ac cuts off a triangle at b, which has the share t of the area.
    u_0 is the share of the solid angle up to s.
    On the line of constant s, u_1 is the share of the density from 0 to t.
    The map from u to x is the continuous map of [Arvo1995]_.

    Attributes
    ----------
    a, b, c
        Corners of the triangle.
    origin
        The illuminated point, which must not lie in the plane of the light.
    """

    a: Vector = checked(as_vector, (-0.5, -0.5, 1.0))
    b: Vector = checked(as_vector, (0.5, -0.5, 1.0))
    c: Vector = checked(as_vector, (-0.5, 0.5, 1.0))
    origin: Vector = checked(as_vector, (0.0, 0.0, 0.0))

    def _check(self) -> None:
        self._volume  # noqa: B018 - checks for degenerate lights

    @cached_property
    def _corners(self) -> Array:
        """The corners a, b and c relative to the origin (3, 3)."""
        return np.array([self.a, self.b, self.c]) - self.origin

    @cached_property
    def _volume(self) -> float:
        """|a · (b × c)|, the height times twice the area."""
        first, second = np.subtract(self.b, self.a), np.subtract(self.c, self.a)
        height = check_light("triangle", self._corners[0], first, second)
        return height * float(norm(np.cross(first, second)))

    @cached_property
    def solid_angle(self) -> float:
        """Solid angle Ω in steradians."""
        return float(triangle_angle(np.array(self._volume), *self._corners))

    def _opposite(self, s: Array) -> Array:
        """Return the point (..., 3) on the edge ac at the fraction s from a."""
        return np.asarray(self._corners[0] + s[..., None] * np.subtract(self.c, self.a))

    def _point(self, s: Array, t: Array) -> Array:
        edge = np.subtract(self.a, self.b) + s[..., None] * np.subtract(self.c, self.a)
        return np.asarray(self._corners[1] + np.sqrt(t)[..., None] * edge)

    def _spread(self, point: Array) -> Array:
        """Return |x| (|b||x| + b·x) ∝ 1/(1 − cos γ), where γ is the angle between b and x."""
        b, length = self._corners[1], norm(point)
        return np.asarray(length * (norm(b) * length + point @ b))

    def _share(self, s: Array) -> tuple[Array, Array]:
        a, b, _ = self._corners
        opposite = self._opposite(s)
        angle = triangle_angle(s * self._volume, a, b, opposite)
        slope = self._volume / self._spread(opposite)
        return angle / self.solid_angle, slope / self.solid_angle

    def _share_of_line(self, s: Array, t: Array) -> tuple[Array, Array]:
        """Return the fraction of the line of constant s below t, and its derivative in t.

        The line from 0 to t spans the angle a, and the whole line spans the angle b.
        The fraction of the line below t is (1 − cos a)/(1 − cos b).
        """
        point, whole = self._point(s, t), self._spread(self._opposite(s))
        return t * whole / self._spread(point), 0.5 * whole / norm(point) ** 3

    def _pdf(self, x: Array) -> Array:
        point = self._point(x[..., 0], x[..., 1])
        return np.asarray(0.5 * self._volume / norm(point) ** 3 / self.solid_angle)


def _corners(x: Array, y0: float, length: float, z: float) -> tuple[Array, Array]:
    """Return the two end points (..., 3) of the segments at x, y0 ≤ y ≤ y0 + length, z."""
    low = np.stack([x, np.full(x.shape, y0), np.full(x.shape, z)], axis=-1)
    return low, low + np.array([0.0, length, 0.0])


def _rise(squared: Array, start: float, length: Array | float) -> Array:
    """Return y/√(R² + y²) at y = start + length, minus its value at y = start, given R²."""
    end = start + np.asarray(length)
    ra, rb = np.sqrt(squared + start**2), np.sqrt(squared + end**2)
    weight = np.abs(end) * ra + np.abs(start) * rb
    ratio = np.divide(np.abs(start + end), weight, out=np.zeros_like(weight), where=weight > 0)
    one_sided = squared * length * ratio / (ra * rb)
    return np.where(start * end > 0, one_sided, end / rb - start / ra)
