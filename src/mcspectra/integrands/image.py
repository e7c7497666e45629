"""Images as integrands: constant in each pixel, or as an environment that lights a surface.

Environment maps follow `mcspectra.core.environments`: x_0 is φ/2π and x_1 is θ/π.
The matching density is ``environment`` of `mcspectra.densities.environment`.
If points are sampled by luminance, the ratio L_c / luminance remains in each channel c.
The ratio L_c / luminance jumps at the borders of colored pixels.
With the channel's own density, f/p is proportional to the cosine between light and normal.
The cosine between light and normal is smooth except at the horizon.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np
import numpy.typing as npt

from mcspectra.core.checks import Array, as_reals
from mcspectra.core.display import shown
from mcspectra.core.environments import directions, environment_pixels, synthetic_sky
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import checked, choice
from mcspectra.core.images import luminance, read_image
from mcspectra.integrands.base import Breaks, Integrand

__all__ = ["Environment", "Image", "synthetic_sky"]

_MOST_BREAKS = 64
_LANDMARKS = 4096


@dataclass(frozen=True, kw_only=True, eq=False)
class _Picture(Integrand):
    """Base class of functions of x that are given by pixels (h, w) or (h, w, channels)."""

    path: str | os.PathLike[str] | None = checked(
        lambda _, given: os.fspath(given) if isinstance(given, os.PathLike) else given, None
    )
    values: npt.ArrayLike | None = None
    channel: int | str | None = None
    dims: int = field(default=2, init=False)
    _pixels: ClassVar[Any]  # pixels (h, w) or (h, w, channels), which subclasses provide

    def _check(self) -> None:
        self._pixels  # noqa: B018 - reads the file and raises on bad pixels

    @property
    def channels(self) -> int:  # type: ignore[override]
        """Number of selected channels. It is 0 if f is scalar."""
        return 0 if self._pixels.ndim == 2 else self._pixels.shape[2]

    def _pixel(self, x: Array) -> Array:
        """Return the value of the pixel that contains x."""
        height, width = self._pixels.shape[:2]
        column = np.minimum((x[..., 0] * width).astype(np.intp), width - 1)
        row = np.minimum((x[..., 1] * height).astype(np.intp), height - 1)
        return np.asarray(self._pixels[row, column])

    def _lines(self, first: float) -> Breaks:
        """Return pixel borders (or, if `first` is ½, centers) along axes with at most 64 pixels."""
        height, width = self._pixels.shape[:2]
        return tuple(
            tuple((np.arange(first, size) / size).tolist()) if size <= _MOST_BREAKS else ()
            for size in (width, height)
        )


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Image(_Picture):
    """An image on the unit square, constant in each pixel. x_0 runs along rows, and x_1 down them.

    The Fourier coefficients are exact at every frequency.
    If V is the periodic discrete Fourier transform of the w × h pixels, the coefficients are

      f_m = V[m_1 mod h, m_0 mod w]/(w h) · sinc(π m_0/w) sinc(π m_1/h) · exp(−πi (m_0/w + m_1/h)).

    Parameters
    ----------
    path
        Image file that `mcspectra.core.images.read_image` reads. PNG and JPEG become linear.
    values
        Pixels instead of a file: numbers of shape (h, w) or (h, w, channels). The top row is first.
    channel
        Number of one channel, ``"luminance"`` (Rec. 709, three channels), or None for all.
        If an image has one channel, the integrand is scalar.

    Raises
    ------
    ParameterError
        If neither or both of path and values are given, or if the channel does not exist.
        If the pixels are not finite numbers of shape (h, w) or (h, w, channels).
    FileFormatError
        If the file is missing or cannot be read.
    """

    @cached_property
    def _pixels(self) -> Array:
        if (self.path is None) == (self.values is None):
            raise ParameterError("image needs either path, of a picture file, or values, not both.")
        if isinstance(self.path, str):
            return _chosen(read_image(self.path), self.channel)
        if self.path is not None:
            raise ParameterError(f"path is {shown(self.path)}; give the name of a picture file.")

        # Copy the values as float64 (h, w, channels)
        try:
            pixels = np.array(self.values, dtype=np.float64)
        except (TypeError, ValueError):
            raise ParameterError(
                "values are not an array of numbers; give (h, w) or (h, w, channels)."
            ) from None
        if pixels.ndim not in (2, 3) or pixels.size == 0:
            raise ParameterError(
                f"values have shape {pixels.shape}; give pixels of shape (h, w) or "
                "(h, w, channels)."
            )
        if not np.isfinite(pixels).all():
            raise ParameterError("values hold NaN or infinity; give finite pixels.")
        return _chosen(pixels.reshape(*pixels.shape[:2], -1), self.channel)

    @property
    def breaks(self) -> Breaks:
        """Pixel borders, for axes with at most 64 pixels."""
        return self._lines(1.0)

    def landmarks(self) -> Array:
        """Return centers of nonzero pixels, or of the 4096 largest pixels if more are nonzero."""
        size = np.abs(self._pixels).reshape(*self._pixels.shape[:2], -1).max(axis=2)
        height, width = size.shape
        order = np.argpartition(size, max(0, size.size - _LANDMARKS), axis=None)[-_LANDMARKS:]
        order = order[size.ravel()[order] > 0]
        row, column = np.divmod(order, width)
        return np.stack([(column + 0.5) / width, (row + 0.5) / height], axis=-1)

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Return means over rectangles of the pixels and of their squares."""
        plain, squared = self._tables
        return _box_means(plain, lo, hi), _box_means(squared, lo, hi)

    @cached_property
    def _tables(self) -> tuple[Array, Array]:
        """Summed-area tables of f and f², (h+1, w+1[, channels])."""
        return _summed_area(self._pixels), _summed_area(self._pixels**2)

    @cached_property
    def _transform(self) -> Array:
        """Discrete Fourier transform, divided by the number of pixels: (h, w[, channels])."""
        height, width = self._pixels.shape[:2]
        return np.asarray(np.fft.fft2(self._pixels, axes=(0, 1)) / (height * width))

    def _evaluate(self, x: Array) -> Array:
        return self._pixel(x)

    def _integral(self) -> Any:
        mean = self._pixels.mean(axis=(0, 1))
        return mean if self.channels else float(mean)

    def _fourier(self, m: Array) -> Array:
        height, width = self._pixels.shape[:2]
        row = np.mod(m[..., 1], height).astype(np.intp)
        column = np.mod(m[..., 0], width).astype(np.intp)
        cycles = m / np.array([width, height])  # frequency in cycles per pixel
        pixel = np.sinc(cycles).prod(axis=-1) * np.exp(-1j * np.pi * cycles.sum(axis=-1))
        found = self._transform[row, column]
        return np.asarray(found * (pixel[..., None] if self.channels else pixel))


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Environment(_Picture):
    """Irradiance by a lat-long environment map, L(ω) max(0, n·ω), as a function on the unit square.

    f(x) = 2π² sin(π x_1) L(x) max(0, n·ω(x)), with radiance L and direction ω.
    The integral of f is the irradiance of a surface with normal n.

    Parameters
    ----------
    path, values
        Image file that `mcspectra.core.images.read_image` reads, or linear pixels, all at least 0.
        Pixels have the shape (h, w) or (h, w, channels). The default is `synthetic_sky`.
    channel
        Number of one channel, ``"luminance"`` (Rec. 709, three channels), or None for all.
        If a map has one channel, the integrand is scalar.
    normal
        The normal n: three numbers, not all 0, of any length. +z points to the first row.
    interpolation
        ``"constant"`` in each pixel, or ``"bilinear"`` between the centers of pixels.
        ``"bilinear"`` is periodic in φ. Between the outermost rows and the poles it is constant.

    Raises
    ------
    ParameterError
        If both path and values are given.
        If the pixels, the channel, the normal or the interpolation are invalid.
    FileFormatError
        If the file is missing or cannot be read.
    """

    normal: Sequence[float] = checked(lambda name, v: as_reals(name, v, 3), (0.0, 0.0, 1.0))
    interpolation: str = choice("constant", "bilinear")

    def _check(self) -> None:
        super()._check()
        if not any(self.normal):
            raise ParameterError(f"normal is {shown(self.normal)}; give a direction, not all 0.")

    @cached_property
    def _pixels(self) -> Array:
        return _chosen(environment_pixels(self.path, self.values), self.channel)

    @cached_property
    def _unit(self) -> Array:
        scaled = np.array(self.normal) / max(abs(c) for c in self.normal)
        return np.asarray(scaled / np.linalg.norm(scaled))

    @property
    def breaks(self) -> Breaks:
        """Positions of pixel borders or pixel centers, on axes of up to 64 pixels.

        If the surface is horizontal, the breaks include the horizon.
        """
        columns, rows = self._lines(1.0 if self.interpolation == "constant" else 0.5)
        return columns, tuple(sorted({*rows, 0.5})) if self._vertical else rows

    @property
    def _vertical(self) -> bool:
        return bool(self._unit[0] == 0 and self._unit[1] == 0)

    def _evaluate(self, x: Array) -> Array:
        cosine = np.maximum(directions(x) @ self._unit, 0.0)
        factor = 2 * math.pi**2 * np.sin(np.pi * x[..., 1]) * cosine
        if self.interpolation == "constant":
            radiance = self._pixel(x)
        else:  # interpolate between the four centers around x
            height, width = self._pixels.shape[:2]
            s, t = x[..., 0] * width - 0.5, np.clip(x[..., 1] * height - 0.5, 0, height - 1)
            left, top = np.floor(s).astype(np.intp), np.floor(t).astype(np.intp)
            columns = left % width, (left + 1) % width
            rows = top, np.minimum(top + 1, height - 1)
            radiance = _between(self._pixels, columns, rows, s - left, t - top)
        return np.asarray(radiance * (factor[..., None] if self.channels else factor))

    def _integral(self) -> Any:
        """Return the exact integral for constant pixels and a vertical normal, else None."""
        if self.interpolation != "constant" or not self._vertical:
            return None
        height, width = self._pixels.shape[:2]
        theta = np.pi * np.arange(height + 1) / height
        up = self._unit[2] > 0
        lit = np.minimum(theta, np.pi / 2) if up else np.maximum(theta, np.pi / 2)
        rows = 0.5 * np.abs(np.diff(np.sin(lit) ** 2)) * 2 * np.pi / width
        found = np.tensordot(rows, self._pixels.sum(axis=1), axes=1)
        return found if self.channels else float(found)


def _chosen(pixels: Array, channel: object) -> Array:
    """Return one channel (h, w), or all channels (h, w, channels)."""
    count = pixels.shape[2]
    if channel is None:
        return pixels if count > 1 else pixels[..., 0]
    if channel == "luminance" and count in (1, 3):
        return luminance(pixels)
    if type(channel) is int and 0 <= channel < count:
        return pixels[..., channel]
    raise ParameterError(
        f"channel is {shown(channel)}, but the image has {count}; give a number from 0 to "
        f"{count - 1}, 'luminance' (three channels), or None for all."
    )


def _summed_area(pixels: Array) -> Array:
    table = np.zeros((pixels.shape[0] + 1, pixels.shape[1] + 1, *pixels.shape[2:]))
    table[1:, 1:] = pixels.cumsum(axis=0).cumsum(axis=1)
    return np.asarray(table / (pixels.shape[0] * pixels.shape[1]))


def _box_means(table: Array, lo: Array, hi: Array) -> Array:
    """Return means over boxes. Bilinear interpolation of a summed-area table gives exact means."""
    height, width = table.shape[0] - 1, table.shape[1] - 1
    total: Any = 0.0
    for x, sx in ((hi[..., 0], 1.0), (lo[..., 0], -1.0)):
        for y, sy in ((hi[..., 1], 1.0), (lo[..., 1], -1.0)):
            column = np.clip(np.floor(x * width), 0, width - 1).astype(np.intp)
            row = np.clip(np.floor(y * height), 0, height - 1).astype(np.intp)
            ends = (column, column + 1), (row, row + 1)
            primitive = _between(table, *ends, x * width - column, y * height - row)
            total = total + sx * sy * primitive
    volume = (hi - lo).prod(axis=-1)
    return np.asarray(total / (volume[..., None] if table.ndim == 3 else volume))


def _between(
    table: Array, columns: tuple[Array, Array], rows: tuple[Array, Array], s: Array, t: Array
) -> Array:
    """Interpolate bilinearly, at the fractions s between two columns and t between two rows."""
    if table.ndim == 3:
        s, t = s[..., None], t[..., None]
    (left, right), (top, bottom) = columns, rows
    upper = (1 - s) * table[top, left] + s * table[top, right]
    lower = (1 - s) * table[bottom, left] + s * table[bottom, right]
    return np.asarray((1 - t) * upper + t * lower)
