"""The density that VEGAS adapts to an integrand named by its spec.

It stands here, not among the densities, because those know no integrands.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, final

from mcspectra.core.checks import Array
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.densities.base import Density, store_integer
from mcspectra.densities.vegas_ import GridDensity, check_training, vegas_density
from mcspectra.integrands import integrand as make_integrand

__all__ = ["VegasDensity"]


@final
@dataclass(frozen=True, kw_only=True)
class VegasDensity(Density):
    """Product of histograms, adapted to an integrand by VEGAS when first used.

    Attributes
    ----------
    integrand
        Spec of the integrand.
    dims
        Number of dims.
    increments, iterations, evaluations, alpha, seed
        As in `mcspectra.densities.vegas_density`.
    """

    name: ClassVar[str] = "vegas"
    integrand: str
    dims: int = DEFAULT_DIMS
    increments: int = 64
    iterations: int = 10
    evaluations: int = 4096
    alpha: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        check_training(self.increments, self.iterations, self.evaluations, self.alpha, self.seed)
        store_integer(self, "dims", least=1)
        for name in ("increments", "iterations", "evaluations", "seed"):
            store_integer(self, name, least=0)  # 64.0 is 64 in the spec too
        make_integrand(self.integrand, self.dims)

    @cached_property
    def grid(self) -> GridDensity:
        """The adapted density."""
        return vegas_density(
            make_integrand(self.integrand, self.dims),
            increments=self.increments,
            iterations=self.iterations,
            evaluations=self.evaluations,
            alpha=self.alpha,
            seed=self.seed,
        )

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Shares between bins of different width."""
        return self.grid.breaks

    def reciprocal_integral(self) -> float:
        """Π N Σ width²."""
        return self.grid.reciprocal_integral()

    def _pdf(self, x: Array) -> Array:
        return self.grid._pdf(x)

    def _sample(self, u: Array) -> Array:
        return self.grid._sample(u)

    def _invert(self, x: Array) -> Array:
        return self.grid._invert(x)
