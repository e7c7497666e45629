"""Rings of radial frequency between pixels, of what `numpy.fft.rfft2` returns of an image."""

from __future__ import annotations

from typing import final

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["Rings"]

_MOST_RINGS = 64


@final
class Rings:
    """Rings of equal width up to half a cycle a pixel.

    Attributes
    ----------
    radius
        Their middles, in cycles a pixel.
    sizes
        Frequencies of each, NaN where there are none.
    """

    def __init__(self, height: int, width: int) -> None:
        count = min(_MOST_RINGS, max(1, min(height, width) // 2))
        across = np.fft.rfftfreq(width)
        distance = np.hypot(np.fft.fftfreq(height)[:, None], across)
        self._ring = np.minimum((distance * 2 * count).astype(int), count).ravel()
        # Columns that stand for their mirror images, too
        both = np.where((across > 0) & (across < 0.5), 2.0, 1.0)
        self._weight = np.broadcast_to(both, distance.shape)
        sizes = np.bincount(self._ring, self._weight.ravel(), count + 1)
        self.sizes = np.where(sizes > 0, sizes, np.nan)[:-1]
        self.radius = (np.arange(count) + 0.5) / (2 * count)

    def mean(self, power: Array) -> Array:
        """Mean over each ring."""
        sums = np.bincount(self._ring, (power * self._weight).ravel(), self.sizes.size + 1)
        return np.asarray(sums[:-1] / self.sizes)
