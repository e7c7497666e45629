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
    weight_breaks: tuple[float, ...] = ()  # of w_t in the domain, in 1-D

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims of primary space."""
        return self.density.primary_dims

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
        """Breaks of the warp and, in 1-D, those of f and w_t through the inverse warp."""
        own = self.density.breaks
        inner = (*self.integrand.breaks[0], *self.weight_breaks)
        if self.dims > 1 or not inner:
            return own
        x = np.array(inner)[:, None]
        carried = self.density.preimages(np.clip(x, 0.0, np.nextafter(1.0, 0.0)))[:, 0]
        return (tuple(sorted({*own[0], *carried.tolist()})),)

    def _evaluate(self, x: Array) -> Array:
        return self.estimator.primary_values(self.technique, x)

    def _integral(self) -> Any:
        single = len(self.estimator.counts) == 1
        exact = single and self.integrand.integral_source == "exact"
        return self.integrand.integral if exact else None
