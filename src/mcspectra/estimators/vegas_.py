"""The density that VEGAS adapts to an integrand named by its spec.

It stands here, not among the densities, because those know no integrands.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, final

from mcspectra.core.fields import whole
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.densities import GridDensity, vegas_density
from mcspectra.densities.base import Wrapper
from mcspectra.densities.pieces import check_training
from mcspectra.integrands import integrand as make_integrand

__all__ = ["VegasDensity"]


@final
@dataclass(frozen=True, kw_only=True)
class VegasDensity(Wrapper):
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
    dims: int = whole(DEFAULT_DIMS, least=1)
    increments: int = whole(64, least=0)
    iterations: int = whole(10, least=0)
    evaluations: int = whole(4096, least=0)
    alpha: float = 0.5
    seed: int = whole(0, least=0)

    def __post_init__(self) -> None:
        check_training(self.increments, self.iterations, self.evaluations, self.alpha, self.seed)
        super().__post_init__()
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
    def _inside(self) -> GridDensity:
        return self.grid
