"""A picture as an integrand: constant in each pixel, with exact coefficients at every frequency."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np
import numpy.typing as npt

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.integrands._axes import settle
from mcspectra.integrands.base import Integrand

__all__ = ["Image", "select_channel"]

_MOST_BREAKS = 64
_LANDMARKS = 4096


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Image(Integrand):
    """A picture on the unit square, constant in each pixel; x_0 runs along rows, x_1 down them.

    With v the pixels, w wide and h high, its coefficients are exact at every frequency: the discrete
    transform V of the pixels, repeated periodically, times those of one pixel,

        f_m = V[m_1 mod h, m_0 mod w]/(w h) · sinc(π m_0/w) sinc(π m_1/h) · exp(−πi (m_0/w + m_1/h)).

    Parameters
    ----------
    path
        A file that `mcspectra.core.images.read_image` reads; PNG and JPEG are made linear.
    values
        Pixels instead of a file: numbers of shape (h, w) or (h, w, channels), first row on top.
    channel
        Number of one channel, ``"luminance"`` (Rec. 709, of three), or None for all. All of a
        one-channel picture is a scalar integrand.

    Raises
    ------
    ParameterError
        Neither or both of path and values; not finite numbers of that shape; no such channel.
    FileFormatError
        The file is missing or cannot be read.
    """

    name: ClassVar[str] = "image"
    path: str | os.PathLike[str] | None = None
    values: npt.ArrayLike | None = None
    channel: int | str | None = None
    dims: int = field(default=2, init=False)
    channels: int = field(init=False)
    _pixels: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if (self.path is None) == (self.values is None):
            raise ParameterError("image needs either path, of a picture file, or values, not both.")
        if self.path is None:
            pixels = select_channel(_check_values(self.values), self.channel)
        else:
            pixels = select_channel(_read(self.path), self.channel)
            settle(self, path=os.fspath(self.path))
        settle(self, _pixels=pixels, channels=0 if pixels.ndim == 2 else pixels.shape[2])

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Pixel borders, along axes with at most 64 pixels."""
        height, width = self._pixels.shape[:2]
        return tuple(
            tuple((np.arange(1, size) / size).tolist()) if size <= _MOST_BREAKS else ()
            for size in (width, height)
        )

    def landmarks(self) -> Array:
        """Centres of the pixels that are not 0, of the 4096 largest at most."""
        size = np.abs(self._pixels).reshape(*self._pixels.shape[:2], -1).max(axis=2)
        height, width = size.shape
        order = np.argpartition(size, max(0, size.size - _LANDMARKS), axis=None)[-_LANDMARKS:]
        order = order[size.ravel()[order] > 0]
        row, column = np.divmod(order, width)
        return np.stack([(column + 0.5) / width, (row + 0.5) / height], axis=-1)

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Sums over rectangles of the pixels and of their squares, fractions of pixels included."""
        plain, squared = self._tables
        return _box_means(plain, lo, hi), _box_means(squared, lo, hi)

    @cached_property
    def _tables(self) -> tuple[Array, Array]:
        """Summed-area tables of f and f², (h+1, w+1[, channels])."""
        return _summed_area(self._pixels), _summed_area(self._pixels**2)

    @cached_property
    def _transform(self) -> Array:
        """Discrete Fourier transform of the pixels over their number, (h, w[, channels])."""
        height, width = self._pixels.shape[:2]
        return np.asarray(np.fft.fft2(self._pixels, axes=(0, 1)) / (height * width))

    def _evaluate(self, x: Array) -> Array:
        height, width = self._pixels.shape[:2]
        column = np.clip(np.floor(x[..., 0] * width), 0, width - 1).astype(np.intp)
        row = np.clip(np.floor(x[..., 1] * height), 0, height - 1).astype(np.intp)
        return np.asarray(self._pixels[row, column])

    def _integral(self) -> Any:
        mean = self._pixels.mean(axis=(0, 1))
        return mean if self.channels else float(mean)

    def _fourier(self, m: Array) -> Array:
        height, width = self._pixels.shape[:2]
        row = np.mod(m[..., 1], height).astype(np.intp)
        column = np.mod(m[..., 0], width).astype(np.intp)
        cycles = m / np.array([width, height])  # in one pixel
        pixel = np.sinc(cycles).prod(axis=-1) * np.exp(-1j * np.pi * cycles.sum(axis=-1))
        found = self._transform[row, column]
        return np.asarray(found * (pixel[..., None] if self.channels else pixel))


def _read(path: object) -> Array:
    if not isinstance(path, str | os.PathLike):
        raise ParameterError(f"path is {path!r}; give the name of a picture file.")
    from mcspectra.core.images import read_image

    return read_image(path)


def _check_values(values: object) -> Array:
    """Return the pixels as a float64 copy (h, w, channels)."""
    try:
        pixels = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ParameterError(
            "values are not an array of numbers; give (h, w) or (h, w, channels)."
        ) from None
    if pixels.ndim not in (2, 3) or pixels.size == 0:
        raise ParameterError(
            f"values have shape {pixels.shape}; give pixels of shape (h, w) or (h, w, channels)."
        )
    if not np.isfinite(pixels).all():
        raise ParameterError("values hold NaN or infinity; give finite pixels.")
    return pixels.reshape(*pixels.shape[:2], -1)


def select_channel(pixels: Array, channel: object) -> Array:
    """Return one channel (h, w), or all of several (h, w, channels)."""
    count = pixels.shape[2]
    if channel is None:
        return pixels if count > 1 else pixels[..., 0]
    if channel == "luminance" and count in (1, 3):
        from mcspectra.core.images import luminance

        return luminance(pixels)
    if type(channel) is int and 0 <= channel < count:
        return pixels[..., channel]
    raise ParameterError(
        f"channel is {channel!r}, but the picture has {count}; give a number from 0 to {count - 1}, "
        "'luminance' (of three channels), or None for all."
    )


def _summed_area(pixels: Array) -> Array:
    table = np.zeros((pixels.shape[0] + 1, pixels.shape[1] + 1, *pixels.shape[2:]))
    table[1:, 1:] = pixels.cumsum(axis=0).cumsum(axis=1)
    return np.asarray(table / (pixels.shape[0] * pixels.shape[1]))


def _box_means(table: Array, lo: Array, hi: Array) -> Array:
    """Mean over boxes from a summed-area table: its bilinear interpolant is the exact primitive."""
    total: Any = 0.0
    for x, sx in ((hi[..., 0], 1.0), (lo[..., 0], -1.0)):
        for y, sy in ((hi[..., 1], 1.0), (lo[..., 1], -1.0)):
            total = total + sx * sy * _interpolate(table, x, y)
    volume = (hi - lo).prod(axis=-1)
    return np.asarray(total / (volume[..., None] if table.ndim == 3 else volume))


def _interpolate(table: Array, x: Array, y: Array) -> Array:
    height, width = table.shape[0] - 1, table.shape[1] - 1
    column = np.clip(np.floor(x * width), 0, width - 1).astype(np.intp)
    row = np.clip(np.floor(y * height), 0, height - 1).astype(np.intp)
    s, t = x * width - column, y * height - row
    if table.ndim == 3:
        s, t = s[..., None], t[..., None]
    top = (1 - s) * table[row, column] + s * table[row, column + 1]
    bottom = (1 - s) * table[row + 1, column] + s * table[row + 1, column + 1]
    return np.asarray((1 - t) * top + t * bottom)
