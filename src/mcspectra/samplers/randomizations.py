"""Randomisations of the points of any sampler, one realisation at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_real, as_reals
from mcspectra.core.streams import Stream
from mcspectra.samplers import _kernels
from mcspectra.samplers.base import Randomization, Sampler, Structure

__all__ = ["Shift", "StrataShift"]

_TRANSLATED: dict[Structure, Structure] = {s: s for s in Structure} | {
    Structure.STRATA: Structure.TORUS,
    Structure.DIGITS: Structure.TORUS,
}
"""What a toroidal translation leaves: strata and elementary intervals are no longer at the origin."""


@final
@dataclass(frozen=True, kw_only=True)
class Shift(Randomization):
    """Cranley-Patterson shift: one uniform toroidal translation of all points.

    References
    ----------
    Cranley, Patterson (1976), doi 10.1137/0713071.
    """

    name: ClassVar[str] = "shift"
    pointwise: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = _TRANSLATED
    stationary: ClassVar[bool] = True
    debiases: ClassVar[bool] = True

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Translate each realisation by its own vector."""
        return self._moved(points, stream, first, len(points))

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Draw realisations of `sampler` (a fixed set once) and translate them."""
        points = sampler.draw_stream(n, stream, first, 1 if sampler.fixed else count)
        return self._moved(points, own, first, count)

    def _moved(self, points: Array, stream: Stream, first: int, count: int) -> Array:
        offsets = np.empty((count, points.shape[2]))
        _kernels.random_offsets(stream.keys(first, count), offsets)
        return _translated(points, offsets)


@final
@dataclass(frozen=True, kw_only=True)
class StrataShift(Randomization):
    """Deterministic toroidal translation by a fraction of the stratum side n^(-1/d).

    Attributes
    ----------
    offset
        Fraction of the side, one number or one for each dim.

    References
    ----------
    Ramamoorthi, Anderson, Meyer, Nowrouzezahrai (2012), doi 10.1145/2231816.2231819.
    """

    name: ClassVar[str] = "strata-shift"
    fixed: ClassVar[bool] = True
    fits: ClassVar[Mapping[Structure, Structure]] = _TRANSLATED
    offset: float | Sequence[float] = 0.5

    def __post_init__(self) -> None:
        given: Any = self.offset
        listed = isinstance(given, Sequence | np.ndarray) and not isinstance(given, str)
        value = as_reals("offset", given, len(given)) if listed else as_real("offset", given)
        object.__setattr__(self, "offset", value)

    def fit(self, sampler: Sampler) -> Randomization:
        """Refuse a list of offsets of another length than dims."""
        as_reals("offset", self.offset, sampler.dims)
        return Randomization.fit(self, sampler)

    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Translate all realisations by the same vector."""
        del stream, first
        _, n, dims = points.shape
        offsets = np.array([as_reals("offset", self.offset, dims)]) * n ** (-1.0 / dims) % 1.0
        offsets[offsets >= 1.0] = 0.0  # the remainder of −1e-20 rounds to 1
        return _translated(points, offsets)


def _translated(points: Array, offsets: Array) -> Array:
    """Sets (R or 1, n, d) moved by offsets (R or 1, d)."""
    out = np.empty((max(len(points), len(offsets)), *points.shape[1:]))
    _kernels.translate(points, offsets, out)
    return out
