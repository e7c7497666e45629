"""Irradiance from a rectangular light: a rendering integrand with a known exact integral."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import checked, real
from mcspectra.core.geometry import as_vector, check_light, norm
from mcspectra.integrands.base import Integrand

__all__ = ["RectangleLight"]

Vector = tuple[float, float, float]

_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
# An occluder hides nothing if its plane contains the origin, up to this relative distance
_FLAT = 1e-12


def _as_occluder(_: str, value: Any) -> tuple[Vector, Vector, Vector]:
    if not isinstance(value, list | tuple | np.ndarray) or len(value) != 3:
        raise ParameterError(
            f"occluder is {value!r:.80}; give None or [corner, edge0, edge1] of three numbers each."
        )
    corner, edge0, edge1 = (as_vector(f"occluder[{i}]", v) for i, v in enumerate(value))
    first, second = np.array(edge0), np.array(edge1)
    if not norm(np.cross(first, second)) > 1e-9 * norm(first) * norm(second):
        raise ParameterError("The occluder has no area; give edges that are not parallel.")
    return corner, edge0, edge1


@final
@dataclass(frozen=True, kw_only=True)
class RectangleLight(Integrand):
    """Irradiance at a point that a rectangle illuminates: f(s, t) = L cos θ cos θ' V area / r².

    (s, t) are the coordinates of the point corner + s e_0 + t e_1 on the light.
    The light emits the same radiance L on both sides.
    θ is the angle from the receiver's normal. Below the receiver's horizon f is 0.
    θ' is the angle from the light's normal. V is 0 if an occluder hides the point, else 1.
    The density ``spherical-rectangle`` samples rectangular lights.
    For parallelograms, use the density ``spherical-triangle``.

    Attributes
    ----------
    corner, edge0, edge1
        A corner of the light, and the edges from it. Any parallelogram of positive area is allowed.
    origin
        The illuminated point. It must not lie in the plane of the light.
    normal
        Normal of the receiver, of any positive length.
    radiance
        Radiance L of the light, at least 0.
    occluder
        None, or the corner and the two edges of an opaque parallelogram: ``[[x, y, z], …]``.
        The shadow of the occluder makes f discontinuous.

    Notes
    -----
    The integral is exact, by Lambert's formula for polygons:
    E = (L/2) Σ_i Γ_i n·(v_i × v_{i+1})/|…|, where Γ_i is the angle of the edge v_i v_{i+1}.
    The part of the light that is behind the occluder is subtracted.
    The rounding error is about 1e-15 L for lights of any size.
    """

    dims: int = field(default=2, init=False)
    corner: Vector = checked(as_vector, (-0.5, -0.5, 1.0))
    edge0: Vector = checked(as_vector, (1.0, 0.0, 0.0))
    edge1: Vector = checked(as_vector, (0.0, 1.0, 0.0))
    origin: Vector = checked(as_vector, (0.0, 0.0, 0.0))
    normal: Vector = checked(as_vector, (0.0, 0.0, 1.0))
    radiance: float = real(1.0, least=0.0)
    occluder: Any = checked(_as_occluder, None)

    def _check(self) -> None:
        if not norm(np.array(self.normal)) > 0:
            raise ParameterError("The normal is (0, 0, 0); give the direction the receiver faces.")
        self._height  # noqa: B018 - refuses degenerate lights

    @cached_property
    def _light(self) -> tuple[Array, Array, Array]:
        """Corner of the light, relative to the origin, and its two edges."""
        return np.subtract(self.corner, self.origin), np.array(self.edge0), np.array(self.edge1)

    @cached_property
    def _height(self) -> float:
        return check_light("light", *self._light)

    @cached_property
    def _up(self) -> Array:
        """The unit normal of the receiver."""
        return np.asarray(self.normal / norm(np.array(self.normal)))

    @cached_property
    def _shade(self) -> tuple[Array, Array, Array] | None:
        """The occluder, relative to the origin. None if it hides nothing."""
        if self.occluder is None:
            return None
        corner, edge0, edge1 = np.array(self.occluder)
        corner = corner - self.origin
        plane = np.cross(edge0, edge1)
        if abs(corner @ plane) <= _FLAT * norm(plane) * (norm(corner) + norm(edge0) + norm(edge1)):
            return None
        return corner, edge0, edge1

    def _evaluate(self, x: Array) -> Array:
        corner, e0, e1 = self._light
        w = corner + x[..., :1] * e0 + x[..., 1:] * e1
        cosines = np.maximum(w @ self._up, 0.0) * self._height * float(norm(np.cross(e0, e1)))
        return np.asarray(self.radiance * cosines * self._visible(w) / norm(w) ** 4)

    def _visible(self, w: Array) -> Array:
        """Return whether there is nothing between the origin and points w (..., 3)."""
        if self._shade is None:
            return np.ones(w.shape[:-1], bool)
        corner, e0, e1 = self._shade
        # Solve corner + a e0 + b e1 = τ w by Cramer's rule
        across = w @ np.cross(e0, e1)
        scale = np.divide(1.0, across, out=np.zeros_like(across), where=across != 0)
        a = -(w @ np.cross(corner, e1)) * scale
        b = w @ np.cross(corner, e0) * scale
        tau = (corner @ np.cross(e0, e1)) * scale
        hit = (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1) & (tau > 0) & (tau < 1)
        return np.asarray(~hit)

    def _integral(self) -> float:
        corner, e0, e1 = self._light
        lit = _clip(corner + _CORNERS @ np.stack([e0, e1]), self._up, 0.0)
        return self.radiance * (self._irradiance(lit) - self._irradiance(self._shadow(lit)))

    def _irradiance(self, polygon: Array) -> float:
        """Apply Lambert's formula to corners (k, 3) above the horizon, for radiance 1."""
        following = np.roll(polygon, -1, axis=0)
        crossed = np.cross(polygon, following)
        lengths = norm(crossed)
        angles = np.arctan2(lengths, np.einsum("ki,ki->k", polygon, following))
        ratios = np.divide(angles, lengths, out=np.zeros_like(angles), where=lengths > 0)
        return 0.5 * abs(float(ratios @ (crossed @ self._up)))

    def _shadow(self, lit: Array) -> Array:
        """Return the part of a polygon of the light that the occluder hides."""
        if self._shade is None:
            return lit[:0]
        corner, e0, e1 = self._shade
        toward = np.cross(self._light[1], self._light[2])
        toward = toward / norm(toward) * np.sign(self._light[0] @ toward)
        shade = _clip(corner + _CORNERS @ np.stack([e0, e1]), toward, 0.0)
        # Parts of the occluder that are behind the light hide nothing
        shade = -_clip(-shade, toward, -self._height)
        if len(shade) < 3:
            return lit[:0]
        middle = shade.mean(axis=0)
        for start, end in zip(shade, np.roll(shade, -1, axis=0), strict=True):
            side = np.cross(start, end)
            lit = _clip(lit, side * np.sign(side @ middle), 0.0)
        return lit


def _clip(polygon: Array, normal: Array, offset: float) -> Array:
    """Clip a convex polygon (k, 3) to a half-space, normal·x >= offset [SutherlandHodgman1974]_."""
    if not len(polygon):
        return polygon
    heights = polygon @ normal - offset
    kept = []
    for i, height in enumerate(heights):
        following = (i + 1) % len(heights)
        if height >= 0:
            kept.append(polygon[i])
        if (height >= 0) != (heights[following] >= 0):
            share = height / (height - heights[following])
            kept.append(polygon[i] + share * (polygon[following] - polygon[i]))
    return np.array(kept).reshape(-1, 3)
