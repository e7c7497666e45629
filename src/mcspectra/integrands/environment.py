"""Light from an environment map on a surface: radiance × clamped cosine over all directions.

Conventions are those of `mcspectra.core.environments`: x_0 is φ/2π, x_1 is θ/π. The density to go with
it is ``environment`` of `mcspectra.densities.environment`. Sampled by luminance, a channel c keeps the
ratio L_c / luminance, which jumps at the borders of colored pixels; sampled by its own density it
keeps the cosine only, which is smooth but for its horizon.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import numpy as np
import numpy.typing as npt

from mcspectra.core.checks import Array, as_choice, as_reals
from mcspectra.core.environments import directions, environment_pixels, synthetic_sky
from mcspectra.core.errors import ParameterError
from mcspectra.integrands._axes import settle
from mcspectra.integrands.base import Integrand
from mcspectra.integrands.image import select_channel

__all__ = ["Environment", "synthetic_sky"]

_MOST_BREAKS = 64


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Environment(Integrand):
    """Irradiance by a lat-long environment map: L(ω) max(0, n·ω), per unit of the square.

    f(x) = 2π² sin(π x_1) L(x) max(0, n·ω(x)); its integral is the irradiance of a surface with the
    normal n.

    Parameters
    ----------
    path, values
        A file that `mcspectra.core.images.read_image` reads, or pixels (h, w) or (h, w, channels),
        linear and at least 0; by default `synthetic_sky`.
    channel
        Number of one channel, ``"luminance"`` (Rec. 709, of three), or None for all. All of a
        one-channel map is a scalar integrand.
    normal
        Three numbers, not all 0, of any length; +z is towards the first row.
    interpolation
        ``"constant"`` in each pixel, or ``"bilinear"`` between centres: periodic in φ, the outermost
        rows continued to the poles.

    Raises
    ------
    ParameterError
        Both path and values; pixels, channel, normal or interpolation not as above.
    FileFormatError
        The file is missing or cannot be read.
    """

    name: ClassVar[str] = "environment"
    path: str | os.PathLike[str] | None = None
    values: npt.ArrayLike | None = None
    channel: int | str | None = None
    normal: Sequence[float] = (0.0, 0.0, 1.0)
    interpolation: str = "constant"
    dims: int = field(default=2, init=False)
    channels: int = field(init=False)
    _pixels: Array = field(init=False, repr=False)
    _unit: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        as_choice("interpolation", self.interpolation, ("constant", "bilinear"))
        pixels = select_channel(environment_pixels(self.path, self.values), self.channel)
        if self.path is not None:
            settle(self, path=os.fspath(self.path))
        normal = as_reals("normal", self.normal, 3)
        largest = max(abs(c) for c in normal)
        if largest == 0:
            raise ParameterError(f"normal is {self.normal!r}; give a direction, not all 0.")
        scaled = np.array(normal) / largest
        unit = scaled / np.linalg.norm(scaled)
        channels = 0 if pixels.ndim == 2 else pixels.shape[2]
        settle(self, _pixels=pixels, _unit=unit, channels=channels, normal=normal)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Pixel borders or centres, along axes with at most 64; the horizon of a vertical normal."""
        height, width = self._pixels.shape[:2]
        return self._lines(width), tuple(sorted({*self._lines(height), *self._horizon}))

    def _lines(self, size: int) -> tuple[float, ...]:
        if size > _MOST_BREAKS:
            return ()
        first = 1.0 if self.interpolation == "constant" else 0.5
        return tuple((np.arange(first, size) / size).tolist())

    @property
    def _horizon(self) -> tuple[float, ...]:
        return (0.5,) if self._vertical else ()

    @property
    def _vertical(self) -> bool:
        return bool(self._unit[0] == 0 and self._unit[1] == 0)

    def _evaluate(self, x: Array) -> Array:
        cosine = np.maximum(directions(x) @ self._unit, 0.0)
        factor = 2 * math.pi**2 * np.sin(np.pi * x[..., 1]) * cosine
        radiance = self._nearest(x) if self.interpolation == "constant" else self._blend(x)
        return np.asarray(radiance * (factor[..., None] if self.channels else factor))

    def _nearest(self, x: Array) -> Array:
        height, width = self._pixels.shape[:2]
        column = np.minimum((x[..., 0] * width).astype(np.intp), width - 1)
        row = np.minimum((x[..., 1] * height).astype(np.intp), height - 1)
        return np.asarray(self._pixels[row, column])

    def _blend(self, x: Array) -> Array:
        """Between the four centres around x."""
        height, width = self._pixels.shape[:2]
        s, t = x[..., 0] * width - 0.5, np.clip(x[..., 1] * height - 0.5, 0, height - 1)
        left, top = np.floor(s).astype(np.intp), np.floor(t).astype(np.intp)
        s, t = s - left, t - top
        if self.channels:
            s, t = s[..., None], t[..., None]
        right, bottom = (left + 1) % width, np.minimum(top + 1, height - 1)
        left = left % width
        upper = (1 - s) * self._pixels[top, left] + s * self._pixels[top, right]
        lower = (1 - s) * self._pixels[bottom, left] + s * self._pixels[bottom, right]
        return np.asarray((1 - t) * upper + t * lower)

    def _integral(self) -> Any:
        """Exact for constant pixels and a vertical normal: ∫ cos θ sin θ dθ = ½ sin² θ."""
        if self.interpolation != "constant" or not self._vertical:
            return None
        height, width = self._pixels.shape[:2]
        theta = np.pi * np.arange(height + 1) / height
        up = self._unit[2] > 0
        lit = np.minimum(theta, np.pi / 2) if up else np.maximum(theta, np.pi / 2)
        rows = 0.5 * np.abs(np.diff(np.sin(lit) ** 2)) * 2 * np.pi / width
        found = np.tensordot(rows, self._pixels.sum(axis=1), axes=1)
        return found if self.channels else float(found)
