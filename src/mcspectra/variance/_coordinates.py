"""Real orthonormal coordinates of complex coefficients whose conjugates are not kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.variance.views import View

__all__ = ["Coordinates"]


@dataclass(frozen=True)
class Coordinates:
    """Real orthonormal coordinates z of the coefficients y_m of a band.

    Attributes
    ----------
    place
        Where the band's coefficients are among all stored, those of all techniques: int64 (P,).
    factor
        What makes y of S: conj(f_m) or 1, times `scale`: (P,).
    scale
        √2 for a coefficient that stands for −m too, else 1: (P,).
    complex
        Which of these have an imaginary part: all but the constants, in a complex basis; (Q,).
    direction
        The band's part of the estimate is its scalar product with z: (D,).
    """

    place: Array
    factor: Array
    scale: Array
    complex: Array
    direction: Array

    @staticmethod
    def of(view: View, inside: Array, channel: int, *, weighted: bool) -> Coordinates:
        techniques = len(view.transforms)
        place = np.flatnonzero(np.tile(inside, techniques))
        f = view.integrand_coefficients[channel].reshape(-1)[place]
        scale = np.sqrt(np.tile(view.basis.double, techniques)[place])
        towards = scale if weighted else scale * f
        double = np.iscomplexobj(f) & (place % view.basis.stored != view.basis.dc)
        both = np.flatnonzero(double)
        factor = scale * f.conj() if weighted else scale
        direction = np.concatenate([towards.real, towards.imag[both]])
        return Coordinates(place, factor, scale, both, direction)

    @property
    def size(self) -> int:
        """D."""
        return len(self.direction)

    def real(self, s: Array) -> Array:
        """z of spectra (R, T·H): float64 (R, D)."""
        y = s[:, self.place] * self.factor
        return np.concatenate([y.real, y.imag[:, self.complex]], axis=1)

    def stored(self, vectors: Array, size: int) -> Array:
        """Patterns over all `size` stored coefficients, (k, size), of vectors (D, k)."""
        half = len(self.place)
        y: Array = vectors[:half].T
        if self.size > half:
            y = y.astype(np.complex128)
            y[:, self.complex] += 1j * vectors[half:].T
        out = np.zeros((vectors.shape[1], size), y.dtype)
        out[:, self.place] = y / self.scale
        return out
