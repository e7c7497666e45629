"""The density that VEGAS adapts to an integrand named by its spec.

It stands here, not among the densities, because those know no integrands.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, final

from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.densities import GridDensity, vegas_density
from mcspectra.densities.base import Wrapper, whole
from mcspectra.densities.vegas_ import check_training
from mcspectra.integrands import integrand as make_integrand

__all__ = ["VegasDensity"]

_COUNT = whole(least=0)  # 64.0 is 64 in the spec too


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
    dims: int = field(default=DEFAULT_DIMS, metadata=whole(least=1))
    increments: int = field(default=64, metadata=_COUNT)
    iterations: int = field(default=10, metadata=_COUNT)
    evaluations: int = field(default=4096, metadata=_COUNT)
    alpha: float = 0.5
    seed: int = field(default=0, metadata=_COUNT)

    def __post_init__(self) -> None:
        check_training(self.increments, self.iterations, self.evaluations, self.alpha, self.seed)
        self._convert()
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
