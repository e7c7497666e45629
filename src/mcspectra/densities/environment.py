"""Importance densities of environment maps in latitude and longitude.

Conventions are those of `mcspectra.core.environments`: x_0 is φ/2π, x_1 is θ/π, rows run from θ = 0.
The density of *directions*, per steradian, is p(x)/(2π² sin(π x_1)).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_real
from mcspectra.core.environments import environment_pixels, row_solid_angles
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.densities._warps import WARPS
from mcspectra.densities.base import Density
from mcspectra.densities.bilinear import Bilinear
from mcspectra.densities.tabulated import PiecewiseConstant, select_channel, shown

__all__ = ["EnvironmentDensity"]


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class EnvironmentDensity(Density):
    """Proportional to the radiance of a lat-long environment map, over solid angle.

    Attributes
    ----------
    path, values
        A file that `mcspectra.core.images.read_image` reads, or pixels (h, w) or (h, w, channels),
        linear and at least 0; by default `synthetic_sky`.
    channel
        ``"luminance"`` (Rec. 709; of one channel, itself) or the number of a channel.
    interpolation
        ``"constant"``: constant in each pixel, which gets the mass L · solid angle exactly.
        ``"bilinear"``: between pixel centres, periodic in φ, of L sin θ at the centres.
    sin_theta
        Weight rows by their solid angle; False samples L over the square, as of a flat picture.
    compensation
        False, or the multiple of the mean radiance to subtract: p ∝ max(0, L − multiple · mean L), the
        normal-independent form of [Karlik2019]_; True is 1, for as many samples by directions as
        by BSDF. The density is then 0 where f is not: use it together with another technique.
    warp
        As in `PiecewiseConstant`, for ``interpolation="constant"``.

    Raises
    ------
    ParameterError
        A parameter or the pixels are not as above.
    FileFormatError
        The file is missing or cannot be read.
    DensityError
        The map is black, or compensation leaves nothing of it.
    """

    name: ClassVar[str] = "environment"
    warps: ClassVar[tuple[str, ...]] = WARPS
    dims: int = field(default=2, init=False)
    path: str | os.PathLike[str] | None = None
    values: Any = None
    channel: str | int = "luminance"
    interpolation: str = "constant"
    sin_theta: bool = True
    compensation: bool | float = False
    warp: str = "marginal"
    _inside: Density = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._check_options()
        pixels = environment_pixels(self.path, self.values)
        weighted = self._weighted(select_channel(pixels, self.channel))
        if self.path is not None:
            object.__setattr__(self, "path", os.fspath(self.path))
        if self.values is not None:
            object.__setattr__(self, "values", shown(np.array(self.values, np.float64)))
        object.__setattr__(self, "_inside", self._table(weighted))

    def _check_options(self) -> None:
        as_choice("interpolation", self.interpolation, ("constant", "bilinear"))
        as_choice("warp", self.warp, WARPS)
        if not isinstance(self.sin_theta, bool):
            raise ParameterError(f"sin_theta is {self.sin_theta!r}; give True or False.")
        if not isinstance(self.compensation, bool):
            as_real("compensation", self.compensation, least=0.0)
        if self.interpolation == "bilinear" and self.warp != "marginal":
            raise ParameterError(
                f"warp is {self.warp!r}; bilinear interpolation has the marginal warp only."
            )

    def _weighted(self, radiance: Array) -> Array:
        """Pixels (h, w) in proportion to p."""
        if not radiance.any():
            raise DensityError(f"{self._source} is black; a density needs pixels above 0.")
        height = len(radiance)
        angles = row_solid_angles(height) if self.sin_theta else np.full(height, 1.0 / height)
        scaled = radiance / radiance.max()
        mean = float(angles @ scaled.mean(axis=1))
        left = np.maximum(scaled - float(self.compensation) * mean, 0.0)
        # The mean of a constant map may round to just below the pixels
        if self.compensation and left.max() <= 1e-12:
            raise DensityError(
                f"Compensation leaves nothing of {self._source}: no pixel is above "
                f"{float(self.compensation):g} times the mean; give a smaller multiple or False."
            )
        # sin θ at the centres is this but for a factor (see `row_solid_angles`)
        return np.asarray(left * angles[:, None])

    def _table(self, weighted: Array) -> Density:
        if self.interpolation == "bilinear":
            return Bilinear(values=weighted, periodic=True)
        return PiecewiseConstant(values=weighted, warp=self.warp)

    @property
    def _source(self) -> str:
        """Name of the map in messages."""
        return "The environment map" if self.path is None else str(self.path)

    @property
    def has_inverse(self) -> bool:
        """False for alias tables."""
        return self._inside.has_inverse

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Breaks of the table."""
        return self._inside.breaks

    def zero_points(self) -> Array:
        """Centres of the areas that hold nothing."""
        return self._inside.zero_points()

    def reciprocal_integral(self) -> float:
        """∫1/p of the table."""
        return self._inside.reciprocal_integral()

    def _pdf(self, x: Array) -> Array:
        return self._inside._pdf(x)

    def _sample(self, u: Array) -> Array:
        return self._inside._sample(u)

    def _invert(self, x: Array) -> Array:
        return self._inside._invert(x)
