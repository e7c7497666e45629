"""Directions on the lat-long square: uniform and cosine-weighted hemisphere, uniform sphere.

With solid angle dω = sin θ dθ dφ a density q per steradian is p(x) = q |∂ω/∂x| on the square, which
falls to 0 at its poles: ∫1/p diverges logarithmically, ∫f²/p does not where f carries sin θ too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.densities._disk_maps import DISK_MAPS, SPHERE_MAPS, WARPS
from mcspectra.densities.base import Density

__all__ = ["HemisphereDensity", "SphereDensity"]

_WEIGHTINGS = ("uniform", "cosine")
_RIGHT_ANGLE = 0.5 * np.pi


@final
@dataclass(frozen=True, kw_only=True)
class HemisphereDensity(Density):
    """Directions of a hemisphere, x = (φ/2π, θ/(π/2)) with θ from its pole.

    Attributes
    ----------
    weighting
        ``"uniform"``: 1/2π per steradian, p = (π/2) sin θ. ``"cosine"``: cos θ/π per steradian,
        p = (π/2) sin 2θ.
    warp
        How the disk is made whose ρ² is the share up to θ: ``"polar"`` keeps x_0 = u_0 and is
        smooth on the lat-long square; ``"concentric"`` (Shirley & Chiu 1997, lifted as by Malley)
        is smooth on the sphere, and jumps in x where φ passes 0: along u_1 = ½, u_0 > ½.

    Notes
    -----
    On x_1 = 0 all x_0 are one direction: `invert` gives one point for them with the concentric warp.
    """

    name: ClassVar[str] = "hemisphere"
    warps: ClassVar[tuple[str, ...]] = WARPS
    dims: int = field(default=2, init=False)
    weighting: str = "cosine"
    warp: str = "concentric"

    def __post_init__(self) -> None:
        as_choice("weighting", self.weighting, _WEIGHTINGS)
        as_choice("warp", self.warp, WARPS)

    def reciprocal_integral(self) -> float:
        """Infinite."""
        return math.inf

    def _pdf(self, x: Array) -> Array:
        theta = x[..., 1]
        if self.weighting == "uniform":
            return np.asarray(_RIGHT_ANGLE * np.sin(_RIGHT_ANGLE * theta))
        return np.asarray(_RIGHT_ANGLE * np.sin(np.pi * np.minimum(theta, 1.0 - theta)))

    def _sample(self, u: Array) -> Array:
        rho, turn = DISK_MAPS[self.warp][0](u)
        uniform = self.weighting == "uniform"
        theta = 2.0 * np.arcsin(rho / np.sqrt(2.0)) if uniform else np.arcsin(rho)
        return np.stack([turn, theta / _RIGHT_ANGLE], axis=-1)

    def _invert(self, x: Array) -> Array:
        theta = _RIGHT_ANGLE * x[..., 1]
        uniform = self.weighting == "uniform"
        rho = np.sqrt(2.0) * np.sin(0.5 * theta) if uniform else np.sin(theta)
        return DISK_MAPS[self.warp][1](rho, x[..., 0])


@final
@dataclass(frozen=True, kw_only=True)
class SphereDensity(Density):
    """Uniform directions of the sphere, x = (φ/2π, θ/π), p = (π/2) sin θ.

    Attributes
    ----------
    warp
        ``"polar"``: x_0 = u_0, cos θ = 1 − 2 u_1, smooth on the lat-long square. ``"concentric"``:
        the equal-area octahedral map, with the pole θ = 0 at the centre of the square and θ = π at
        its four corners; x jumps where φ passes 0: along u_1 = ½, u_0 > ½.

    References
    ----------
    P. Clarberg (2008), "Fast equal-area mapping of the (hemi)sphere using SIMD", Journal of
    Graphics Tools 13(3).
    """

    name: ClassVar[str] = "sphere"
    warps: ClassVar[tuple[str, ...]] = WARPS
    dims: int = field(default=2, init=False)
    warp: str = "concentric"

    def __post_init__(self) -> None:
        as_choice("warp", self.warp, WARPS)

    def reciprocal_integral(self) -> float:
        """Infinite."""
        return math.inf

    def _pdf(self, x: Array) -> Array:
        theta = np.minimum(x[..., 1], 1.0 - x[..., 1])
        return np.asarray(_RIGHT_ANGLE * np.sin(np.pi * theta))

    def _sample(self, u: Array) -> Array:
        theta, turn = SPHERE_MAPS[self.warp][0](u)
        return np.stack([turn, theta], axis=-1)

    def _invert(self, x: Array) -> Array:
        return SPHERE_MAPS[self.warp][1](x[..., 1], x[..., 0])
