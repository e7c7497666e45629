"""Exact variances of antithetic jittered sets, by those of jittered with a symmetrised integrand.

A pair u, u' of a cell, reflected through its centre, contributes h(u) = (g(u) + g(u'))/2, so that the
variance is that of one jittered point for each cell with h in the place of g [Haber1967]_.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.integrands import Integrand
from mcspectra.variance._strata import spread_within_strata

__all__ = ["CellSymmetrized", "antithetic_variance"]


def antithetic_variance(g: Integrand, n: int, order: int) -> Array:
    """Variance of the mean of g over n = 2 s^d antithetic jittered points: (channels,) or (1,)."""
    cells = n // 2
    side = round(cells ** (1.0 / g.dims))
    spread = spread_within_strata(
        CellSymmetrized(g, side), (side,) * g.dims, np.zeros(g.dims), order
    )
    return np.asarray(spread / cells)


@final
@dataclass(frozen=True)
class CellSymmetrized(Integrand):
    """Mean of g at a point and at its reflection through the centre of its cell of side 1/side."""

    name: ClassVar[str] = "cell-symmetrized"
    integrand: Integrand
    side: int

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims of g."""
        return self.integrand.dims

    @property
    def channels(self) -> int:  # type: ignore[override]
        """Channels of g."""
        return self.integrand.channels

    @property
    def spec(self) -> str:
        """Text for messages."""
        return f"{self.integrand.spec}, symmetrised in cells"

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Those of g and their reflections."""
        return tuple(
            tuple(sorted({*axis, *self._reflected(np.asarray(axis, float)).tolist()}))
            for axis in self.integrand.breaks
        )

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(0.5 * (self.integrand(x) + self.integrand(self._reflected(x))))

    def _reflected(self, x: Array) -> Array:
        cell = np.minimum(np.floor(x * self.side), self.side - 1.0)
        return np.asarray(np.clip((2.0 * cell + 1.0) / self.side - x, 0.0, 1.0))
