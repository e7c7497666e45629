"""The primary-space integrand of a technique, g_t(u) = w_t f/p_t at T_t(u), as an integrand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.densities import Density
from mcspectra.estimators.base import AbstractEstimator
from mcspectra.integrands import Integrand

__all__ = ["PrimaryIntegrand"]


@final
@dataclass(frozen=True)
class PrimaryIntegrand(Integrand):
    """g_t of an estimator; discontinuities of f and of the warp are carried to primary space."""

    name: ClassVar[str] = "primary"
    estimator: AbstractEstimator
    technique: int
    integrand: Integrand
    density: Density

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims."""
        return self.integrand.dims

    @property
    def channels(self) -> int:  # type: ignore[override]
        """Channels of f."""
        return self.integrand.channels

    @property
    def spec(self) -> str:
        """Text for messages."""
        return f"primary integrand {self.technique} of {self.estimator.spec}"

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Breaks of the warp and, in 1-D, those of f through the inverse warp."""
        own = self.density.breaks
        if self.dims > 1 or not self.density.has_inverse or not self.integrand.breaks[0]:
            return own
        x = np.array(self.integrand.breaks[0])[:, None]
        carried = self.density.invert(np.clip(x, 0.0, np.nextafter(1.0, 0.0)))[:, 0]
        return (tuple(sorted({*own[0], *carried.tolist()})),)

    def _evaluate(self, x: Array) -> Array:
        return self.estimator.primary_values(self.technique, x)

    def _integral(self) -> Any:
        single = len(self.estimator.counts) == 1
        exact = single and self.integrand.integral_source == "exact"
        return self.integrand.integral if exact else None
