"""The disk, the hemisphere and the sphere of directions on a lat-long square. Each has two warps.

With the solid angle dω = sin θ dθ dφ, a density q per steradian is p(x) = q |∂ω/∂x| on the square.
The density p is 0 at the poles, so ∫1/p diverges logarithmically.
However, ∫f²/p converges if f also contains the factor sin θ.

All densities use maps from the square to the disk or the sphere, in polar coordinates.
A point of the unit disk is (ρ, turn) and a direction is (θ/π, turn), with turn = φ/2π in [0,1].
All maps preserve area, up to the factor π for the disk and 4π for the sphere.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_reals
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import checked, choice, real
from mcspectra.densities.base import Density

__all__ = ["DiskDensity", "HemisphereDensity", "SphereDensity"]

_WARPS = ("polar", "concentric")
_LEAST_RADIUS = 1e-6
_ROUNDING = 4e-16  # tolerance of a coordinate, so that samples on the rim count as inside
_RIGHT_ANGLE = 0.5 * np.pi

_Pair = tuple[Array, Array]
_Map = tuple[Callable[[Array], _Pair], Callable[[Array, Array], Array]]


def _polar_to_disk(u: Array) -> _Pair:
    """Map by turn = u_0, ρ² = u_1. Distortion is unbounded at the center; x jumps at the seam."""
    return np.sqrt(u[..., 1]), u[..., 0]


def _polar_from_disk(radius: Array, turn: Array) -> Array:
    return np.stack([turn, radius**2], axis=-1)


def _concentric_to_disk(u: Array) -> _Pair:
    """Map squares around the center to circles [Shirley1997]_. The distortion is at most 4/π."""
    a, b = 2.0 * u[..., 0] - 1.0, 2.0 * u[..., 1] - 1.0
    wide = np.abs(a) > np.abs(b)
    long, short = np.where(wide, a, b), np.where(wide, b, -a)
    local = np.divide(short, long, out=np.zeros_like(long), where=long != 0)
    quarter = np.where(wide, 0.0, 0.25) + np.where(long < 0, 0.5, 0.0)
    return np.abs(long), (quarter + local / 8.0) % 1.0


def _concentric_from_disk(radius: Array, turn: Array) -> Array:
    quarter = np.rint(4.0 * turn)
    local = radius * (8.0 * (turn - quarter / 4.0))
    index = quarter.astype(np.int64) % 4
    a = np.choose(index, [radius, -local, -radius, local])
    b = np.choose(index, [local, radius, -local, -radius])
    return np.asarray(0.5 * (np.stack([a, b], axis=-1) + 1.0))


def _polar_to_sphere(u: Array) -> _Pair:
    """Map by turn = u_0, sin²(θ/2) = u_1. This is separable on the lat-long square."""
    half = np.sqrt(np.minimum(u[..., 1], 1.0 - u[..., 1]))
    theta = 2.0 / np.pi * np.arcsin(half)
    return np.where(u[..., 1] > 0.5, 1.0 - theta, theta), u[..., 0]


def _polar_from_sphere(theta: Array, turn: Array) -> Array:
    share = np.sin(0.5 * np.pi * np.minimum(theta, 1.0 - theta)) ** 2
    return np.stack([turn, np.where(theta > 0.5, 1.0 - share, share)], axis=-1)


def _octahedral_to_sphere(u: Array) -> _Pair:
    """Map the square to the sphere by an octahedron of equal area [Clarberg2008]_.

    All four corners of the square map to the same pole.
    """
    a, b = np.abs(2.0 * u[..., 0] - 1.0), np.abs(2.0 * u[..., 1] - 1.0)
    lower = a + b > 1.0
    radius = np.where(lower, (1.0 - a) + (1.0 - b), a + b)
    ratio = np.divide(b - a, radius, out=np.zeros_like(radius), where=radius != 0)
    turn = (np.clip(ratio, -1.0, 1.0) + 1.0) / 8.0
    turn = np.where(u[..., 0] < 0.5, 0.5 - turn, turn)
    turn = np.where(u[..., 1] < 0.5, -turn, turn) % 1.0
    theta = 2.0 / np.pi * np.arcsin(radius / np.sqrt(2.0))
    return np.where(lower, 1.0 - theta, theta), turn


def _octahedral_from_sphere(theta: Array, turn: Array) -> Array:
    lower = theta > 0.5
    radius = np.sqrt(2.0) * np.sin(0.5 * np.pi * np.where(lower, 1.0 - theta, theta))
    below, left = turn > 0.5, np.abs(turn - 0.5) < 0.25
    folded = np.where(below, 1.0 - turn, turn)
    folded = np.where(left, 0.5 - folded, folded)
    # Choose a and b so that |a| + |b| is the radius (or 2 − radius), and |b| − |a| = radius · ratio
    b = 4.0 * radius * folded
    a = radius - b
    a, b = np.where(lower, 1.0 - b, a), np.where(lower, 1.0 - a, b)
    signed = np.stack([np.where(left, -a, a), np.where(below, -b, b)], axis=-1)
    return np.asarray(0.5 * (signed + 1.0))


# Maps from the square to the disk (ρ, turn) or to the sphere (θ/π, turn), with their inverses
_DISK_MAPS: Mapping[str, _Map] = {
    "polar": (_polar_to_disk, _polar_from_disk),
    "concentric": (_concentric_to_disk, _concentric_from_disk),
}
_SPHERE_MAPS: Mapping[str, _Map] = {
    "polar": (_polar_to_sphere, _polar_from_sphere),
    "concentric": (_octahedral_to_sphere, _octahedral_from_sphere),
}


@dataclass(frozen=True, kw_only=True)
class _TwoWarps(Density):
    """A density in 2-D with two warps and infinite ∫1/p."""

    warps: ClassVar[tuple[str, ...]] = _WARPS
    dims: int = field(default=2, init=False)

    def reciprocal_integral(self) -> float:
        """Return infinity."""
        return math.inf


def _as_center(name: str, value: Any) -> float | tuple[float, ...]:
    center = as_reals(name, value, 2)
    return center[0] if center[0] == center[1] else center


@final
@dataclass(frozen=True, kw_only=True)
class DiskDensity(_TwoWarps):
    """Density that is uniform on a disk inside the unit square, and 0 outside the disk.

    Both warps preserve areas, but they separate neighboring points at different places (`warp`).
    Therefore samplers with correlated points have different rates with the two warps.

    Attributes
    ----------
    radius
        Radius of the disk, between 1e-6 and ½.
    center
        Center of the disk, one number for both coordinates or one per coordinate.
        The disk must lie inside the square.
    warp
        ``"polar"``: φ = 2π u_0, ρ² = radius² u_1. The sides u_0 = 0 and u_0 = 1 have the same x.
        The side u_1 = 0 maps to the center of the disk, and the side u_1 = 1 maps to its rim.
        ``"concentric"``: squares around the center map to circles [Shirley1997]_.
        With this map, all sides of the square lie on the rim.
    """

    name: ClassVar[str] = "disk"
    radius: float = real(0.5, least=_LEAST_RADIUS, most=0.5)
    center: float | tuple[float, float] = checked(_as_center, 0.5)
    warp: str = choice(*_WARPS, default="concentric")

    def _check(self) -> None:
        center, radius = as_reals("center", self.center, 2), self.radius
        if min(center) < radius - _ROUNDING or max(center) > 1.0 - radius + _ROUNDING:
            raise ParameterError(
                f"A disk of radius {radius:g} at {center} leaves the unit square; its center must "
                f"lie between {radius:g} and {1.0 - radius:g}."
            )

    def zero_points(self) -> Array:
        """Return the corners of the square, and points of the square just outside the disk."""
        turns = np.arange(16) / 16
        around = self._place(np.full(16, 1.0 + 1e-6), turns)
        inside = ((around >= 0.0) & (around <= 1.0)).all(axis=-1)
        return np.concatenate([list(itertools.product((0.0, 1.0), repeat=2)), around[inside]])

    def _place(self, rho: Array, turn: Array) -> Array:
        """Return points at polar coordinates around the center, in units of the radius."""
        angle = 2.0 * np.pi * turn
        offset = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.asarray(np.asarray(self.center) + self.radius * rho[..., None] * offset)

    def _pdf(self, x: Array) -> Array:
        distance = np.hypot(*np.moveaxis(x - np.asarray(self.center), -1, 0))
        inside = distance <= self.radius + _ROUNDING
        return np.where(inside, 1.0 / (np.pi * self.radius**2), 0.0)

    def _sample(self, u: Array) -> Array:
        return self._place(*_DISK_MAPS[self.warp][0](u))

    def _invert(self, x: Array) -> Array:
        """Invert the warp. A point outside the disk counts as the rim point in its direction."""
        a, b = np.moveaxis(x - np.asarray(self.center), -1, 0)
        rho = np.minimum(np.hypot(a, b) / self.radius, 1.0)
        return _DISK_MAPS[self.warp][1](rho, np.arctan2(b, a) / (2.0 * np.pi) % 1.0)


@final
@dataclass(frozen=True, kw_only=True)
class HemisphereDensity(_TwoWarps):
    """Directions of a hemisphere, x = (φ/2π, θ/(π/2)), where θ is the angle from its pole.

    Attributes
    ----------
    weighting
        ``"uniform"`` is 1/2π per steradian, with p = (π/2) sin θ.
        ``"cosine"`` is cos θ/π per steradian, with p = (π/2) sin 2θ.
    warp
        Map to a disk, in which ρ² is the share of the directions whose angle is at most θ.
        ``"polar"`` keeps x_0 = u_0 and is smooth on the lat-long square.
        ``"concentric"`` ([Shirley1997]_, lifted as by Malley) is smooth on the sphere.
        With this map, x jumps where φ passes 0: along u_1 = ½, u_0 > ½.

    Notes
    -----
    All points with x_1 = 0 are the same direction (the pole), for any x_0.
    With the concentric warp, `invert` returns the same u for all points at the pole.
    """

    name: ClassVar[str] = "hemisphere"
    weighting: str = choice("uniform", "cosine", default="cosine")
    warp: str = choice(*_WARPS, default="concentric")

    def _pdf(self, x: Array) -> Array:
        theta = x[..., 1]
        if self.weighting == "uniform":
            return np.asarray(_RIGHT_ANGLE * np.sin(_RIGHT_ANGLE * theta))
        return np.asarray(_RIGHT_ANGLE * np.sin(np.pi * np.minimum(theta, 1.0 - theta)))

    def _sample(self, u: Array) -> Array:
        rho, turn = _DISK_MAPS[self.warp][0](u)
        uniform = self.weighting == "uniform"
        theta = 2.0 * np.arcsin(rho / np.sqrt(2.0)) if uniform else np.arcsin(rho)
        return np.stack([turn, theta / _RIGHT_ANGLE], axis=-1)

    def _invert(self, x: Array) -> Array:
        theta = _RIGHT_ANGLE * x[..., 1]
        uniform = self.weighting == "uniform"
        rho = np.sqrt(2.0) * np.sin(0.5 * theta) if uniform else np.sin(theta)
        return _DISK_MAPS[self.warp][1](rho, x[..., 0])


@final
@dataclass(frozen=True, kw_only=True)
class SphereDensity(_TwoWarps):
    """Uniform directions of the sphere, x = (φ/2π, θ/π), p = (π/2) sin θ.

    Attributes
    ----------
    warp
        ``"polar"``: x_0 = u_0, cos θ = 1 − 2 u_1, smooth on the lat-long square.
        ``"concentric"`` is the equal-area octahedral map [Clarberg2008]_.
        The pole θ = 0 is at the center of the square, and θ = π is at its four corners.
        With this map, x jumps where φ passes 0: along u_1 = ½, u_0 > ½.
    """

    name: ClassVar[str] = "sphere"
    warp: str = choice(*_WARPS, default="concentric")

    def _pdf(self, x: Array) -> Array:
        theta = np.minimum(x[..., 1], 1.0 - x[..., 1])
        return np.asarray(_RIGHT_ANGLE * np.sin(np.pi * theta))

    def _sample(self, u: Array) -> Array:
        theta, turn = _SPHERE_MAPS[self.warp][0](u)
        return np.stack([turn, theta], axis=-1)

    def _invert(self, x: Array) -> Array:
        return _SPHERE_MAPS[self.warp][1](x[..., 1], x[..., 0])
