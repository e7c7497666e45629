"""Estimators with several techniques: multiple importance sampling, and sums of given techniques.

Counts are per technique, as renderers count: n light samples *and* n BSDF samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.densities import Density, as_density
from mcspectra.estimators.base import AbstractEstimator, DomainEstimator, check_counts
from mcspectra.estimators.importance import check_same_dims, check_support, scale
from mcspectra.estimators.primary import PrimaryIntegrand
from mcspectra.integrands import Integrand, as_integrand

__all__ = ["MultipleImportance", "TechniqueSum"]

_POWERS = {"balance": 1.0, "power": 2.0}


@final
class MultipleImportance(DomainEstimator):
    """Multiple importance sampling, I = Σ_t (1/n_t) Σ_k w_t f/p_t [VeachGuibas1995]_.

    Parameters
    ----------
    integrand
        f, or its spec string.
    densities
        p_t with their warps, or spec strings.
    heuristic
        ``"balance"``: w_t = n_t p_t / Σ_s n_s p_s; ``"power"``: the same with squares (β = 2).
    counts
        n_t as multiples of n; the same for all by default.
    dims
        Number of dims for spec strings that do not say.

    Raises
    ------
    DensityError
        All densities are zero at points where f is not.
    ParameterError
        No density, unknown heuristic, counts of another length, different numbers of dims.
    """

    def __init__(
        self,
        integrand: Integrand | str,
        densities: Sequence[Density | str],
        *,
        heuristic: str = "balance",
        counts: Sequence[int] | None = None,
        dims: int | None = None,
    ) -> None:
        if not isinstance(densities, list | tuple) or len(densities) == 0:
            raise ParameterError(f"densities is {densities!r}; give a list of one or more.")
        if dims is None:
            parts = (integrand, *densities)
            dims = next((c.dims for c in parts if isinstance(c, Integrand | Density)), None)
        self.integrand = as_integrand(integrand, dims)
        found = [as_density(density, self.integrand.dims) for density in densities]
        self.densities = tuple(density for density in found if density is not None)
        if len(self.densities) != len(found):
            raise ParameterError("densities holds None; write 'uniform' for a uniform density.")
        self.heuristic = as_choice("heuristic", heuristic, tuple(_POWERS))
        self.counts = check_counts([1] * len(found) if counts is None else counts, len(found))
        check_same_dims([self.integrand, *self.densities])
        check_support(self.integrand, list(self.densities))

    def __repr__(self) -> str:
        return f"MultipleImportance({self.spec})"

    @property
    def spec(self) -> str:
        """``integrand / heuristic[densities]``."""
        parts = zip(self.counts, self.densities, strict=True)
        shown = ", ".join(f"{c}×{p.spec}" if c > 1 else p.spec for c, p in parts)
        return f"{self.integrand.spec} / {self.heuristic}[{shown}]"

    @property
    def infinite_weights(self) -> bool:
        """Whether every ∫1/p_t diverges; with one bounded weight all combined ones are bounded."""
        return not any(np.isfinite(p.reciprocal_integral()) for p in self.densities)

    def primary_integrand(self, technique: int) -> Integrand:
        """g_t(u) = w_t f/p_t at T_t(u)."""
        return PrimaryIntegrand(self, technique, self.integrand, self.densities[technique])

    def primary_values(self, technique: int, u: Array) -> Array:
        """g_t(u)."""
        x = self.warp(technique, u)
        return scale(self.integrand(x), self.weight(technique, x))

    def warp(self, technique: int, u: Array) -> Array:
        """T_t(u)."""
        return self.densities[technique].sample(u)

    def weight(self, technique: int, x: Array) -> Array:
        """w_t/p_t = c_t (c_t p_t)^(β−1) / Σ_s (c_s p_s)^β, finite where any p_s is positive."""
        power = _POWERS[self.heuristic]
        scaled = [c * p.pdf(x) for c, p in zip(self.counts, self.densities, strict=True)]
        total = sum((s**power for s in scaled), np.zeros(x.shape[:-1]))
        own = self.counts[technique] * scaled[technique] ** (power - 1.0)
        return np.asarray(np.divide(own, total, out=np.zeros_like(total), where=total > 0))


@final
class TechniqueSum(AbstractEstimator):
    """A sum of separately sampled integrals, I = Σ_t (1/n_t) Σ_k g_t(u_tk).

    For techniques whose warp and weights are inside the integrand already, such as light and BSDF
    sampling of a renderer: each g_t lives on its own unit cube, so there is no common domain.

    Parameters
    ----------
    integrands
        g_t, or their spec strings.
    counts
        n_t as multiples of n; the same for all by default.
    dims
        Number of dims for spec strings that do not say.
    """

    def __init__(
        self,
        integrands: Sequence[Integrand | str],
        *,
        counts: Sequence[int] | None = None,
        dims: int | None = None,
    ) -> None:
        if not isinstance(integrands, list | tuple) or len(integrands) == 0:
            raise ParameterError(f"integrands is {integrands!r}; give a list of one or more.")
        if dims is None:
            dims = next((g.dims for g in integrands if isinstance(g, Integrand)), None)
        self.integrands = tuple(as_integrand(g, dims) for g in integrands)
        check_same_dims(list(self.integrands))
        channels = {g.channels for g in self.integrands}
        if len(channels) > 1:
            raise ParameterError(
                f"The techniques have {sorted(channels)} channels; make them equal."
            )
        total = len(self.integrands)
        self.counts = check_counts([1] * total if counts is None else counts, total)

    def __repr__(self) -> str:
        return f"TechniqueSum({self.spec})"

    @property
    def dims(self) -> int:
        """Number of dims of every technique."""
        return self.integrands[0].dims

    @property
    def channels(self) -> int:
        """Channels of every technique."""
        return self.integrands[0].channels

    @property
    def spec(self) -> str:
        """``g_0 + g_1 + …``."""
        return " + ".join(g.spec for g in self.integrands)

    @property
    def integral(self) -> Any:
        """Σ_t ∫ g_t."""
        return sum(g.integral for g in self.integrands)

    @property
    def integral_source(self) -> str:
        """``"exact"`` if it is for every technique."""
        sources = {g.integral_source for g in self.integrands}
        return sources.pop() if len(sources) == 1 else "quadrature"

    @property
    def domain_integrand(self) -> None:
        """None: the techniques share no domain."""
        return

    def primary_integrand(self, technique: int) -> Integrand:
        """g_t."""
        return self.integrands[technique]

    def primary_values(self, technique: int, u: Array) -> Array:
        """g_t(u)."""
        return self.integrands[technique](u)
