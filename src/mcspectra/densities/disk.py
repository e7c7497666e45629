"""The uniform density on a disk, with two warps."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_real, as_reals
from mcspectra.core.errors import ParameterError
from mcspectra.densities._disk_maps import DISK_MAPS, WARPS
from mcspectra.densities.base import Density

__all__ = ["DiskDensity"]

_LEAST_RADIUS = 1e-6
_ROUNDING = 4e-16  # of a coordinate, so that samples on the rim count as inside


@final
@dataclass(frozen=True, kw_only=True)
class DiskDensity(Density):
    """Uniform on a disk inside the unit square, 0 outside.

    Both warps keep areas; they differ in where T tears neighbours apart (see `warp`), and so in the
    rate of correlated samplers.

    Attributes
    ----------
    radius
        Between 1e-6 and ½.
    center
        One number for both coordinates or one for each; the disk must lie inside the square.
    warp
        ``"polar"``: φ = 2π u_0, ρ² = radius² u_1. The sides u_0 = 0 and 1 meet in x, those of
        u_1 do not: the whole side u_1 = 0 is the centre. ``"concentric"``: squares about the centre
        to circles; all sides lie on the rim.

    References
    ----------
    P. Shirley, K. Chiu (1997), "A low distortion map between disk and square", Journal of Graphics
    Tools 2(3).
    """

    name: ClassVar[str] = "disk"
    warps: ClassVar[tuple[str, ...]] = WARPS
    dims: int = field(default=2, init=False)
    radius: float = 0.5
    center: float | tuple[float, float] = 0.5
    warp: str = "concentric"

    def __post_init__(self) -> None:
        as_choice("warp", self.warp, WARPS)
        radius = as_real("radius", self.radius, least=_LEAST_RADIUS, most=0.5)
        center = as_reals("center", self.center, 2)
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "center", center[0] if center[0] == center[1] else center)
        if min(center) < radius - _ROUNDING or max(center) > 1.0 - radius + _ROUNDING:
            raise ParameterError(
                f"A disk of radius {radius:g} at {center} leaves the unit square; its centre must "
                f"lie between {radius:g} and {1.0 - radius:g}."
            )

    def reciprocal_integral(self) -> float:
        """Infinite: the corners hold nothing."""
        return math.inf

    def zero_points(self) -> Array:
        """The corners, and points around the disk that are not in it but in the square."""
        turns = np.arange(16) / 16
        around = self._place(np.full(16, 1.0 + 1e-6), turns)
        inside = ((around >= 0.0) & (around <= 1.0)).all(axis=-1)
        return np.concatenate([list(itertools.product((0.0, 1.0), repeat=2)), around[inside]])

    def _place(self, rho: Array, turn: Array) -> Array:
        """Points at polar coordinates in radii about the centre."""
        angle = 2.0 * np.pi * turn
        offset = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.asarray(np.asarray(self.center) + self.radius * rho[..., None] * offset)

    def _pdf(self, x: Array) -> Array:
        distance = np.hypot(*np.moveaxis(x - np.asarray(self.center), -1, 0))
        inside = distance <= self.radius + _ROUNDING
        return np.where(inside, 1.0 / (np.pi * self.radius**2), 0.0)

    def _sample(self, u: Array) -> Array:
        return self._place(*DISK_MAPS[self.warp][0](u))

    def _invert(self, x: Array) -> Array:
        """Points outside the disk count as those of the rim in their direction."""
        a, b = np.moveaxis(x - np.asarray(self.center), -1, 0)
        rho = np.minimum(np.hypot(a, b) / self.radius, 1.0)
        return DISK_MAPS[self.warp][1](rho, np.arctan2(b, a) / (2.0 * np.pi) % 1.0)
