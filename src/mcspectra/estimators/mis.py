"""Estimators with several techniques: multiple importance sampling, and sums of given techniques.

Counts are per technique, as renderers count: n light samples *and* n BSDF samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.densities import Density, as_density
from mcspectra.estimators.base import AbstractEstimator, DomainEstimator, check_counts
from mcspectra.estimators.heuristics import Heuristic, as_heuristic
from mcspectra.estimators.importance import Estimator, check_same_dims, check_support, scale
from mcspectra.estimators.pilots import Residual
from mcspectra.estimators.primary import PrimaryIntegrand
from mcspectra.estimators.sets import check_sets
from mcspectra.integrands import Integrand, as_integrand

__all__ = ["MultipleImportance", "TechniqueSum", "as_parts"]


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
        ``"balance"``: w_t = n_t p_t / Σ_s n_s p_s; ``"power"``: the same with squares (β = 2);
        or another of `mcspectra.estimators.heuristics`, as a spec string or an object.
    counts
        n_t as multiples of n; the same for all by default.
    sets
        How the points of the techniques belong together: ``"independent"``, ``"shared"`` or
        ``"joint"``, see `mcspectra.estimators.sets`.
    dims
        Number of dims for spec strings without ``dims``.

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
        heuristic: Heuristic | str = "balance",
        counts: Sequence[int] | None = None,
        sets: str = "independent",
        dims: int | None = None,
    ) -> None:
        self.integrand, self.densities = as_parts(integrand, densities, dims)
        chosen = as_heuristic(heuristic)
        self.heuristic = chosen.spec
        total = len(self.densities)
        self.counts = check_counts([1] * total if counts is None else counts, total)
        self.sets = check_sets(sets, self.counts)
        self.combination = chosen.fit(self.integrand, self.densities, self.counts)

    def __repr__(self) -> str:
        return f"MultipleImportance({self.spec})"

    @property
    def spec(self) -> str:
        """``integrand / heuristic[densities]``."""
        parts = zip(self.counts, self.densities, strict=True)
        shown = ", ".join(f"{c}×{p.spec}" if c > 1 else p.spec for c, p in parts)
        return f"{self.integrand.spec} / {self.heuristic}[{shown}]{self.sets_label}"

    @property
    def evaluations_per_point(self) -> int:
        """Evaluations of f for one value."""
        return self.integrand.evaluations_per_point

    @property
    def pilot_evaluations(self) -> int:
        """Pilot evaluations of the heuristic."""
        return self.combination.heuristic.pilot_evaluations

    @property
    def infinite_weights(self) -> bool:
        """Whether the combined weights have no second moment (`Combination.infinite`)."""
        return self.combination.infinite

    @property
    def domain_integrand(self) -> Integrand:
        """f; with optimal weights the residual f − Σ α_t p_t, which has the same variance."""
        controlled = self.combination.control is not None
        return Residual(self.integrand, self.combination) if controlled else self.integrand

    def primary_integrand(self, technique: int) -> Integrand:
        """g_t(u) = w_t f/p_t at T_t(u)."""
        density, breaks = self.densities[technique], self.combination.breaks
        return PrimaryIntegrand(self, technique, self.integrand, density, breaks)

    def primary_values(self, technique: int, u: Array) -> Array:
        """g_t(u), which with optimal weights is α_t + (f − Σ α_s p_s) w_t/p_t."""
        x = self.warp(technique, u)
        control = self.combination.control
        if control is None:
            return scale(self.integrand(x), self.weight(technique, x))
        left = self.integrand(x) - self.combination.offset(x)
        return np.asarray(control[technique] + scale(left, self.weight(technique, x)))

    def with_heuristic(self, heuristic: str) -> MultipleImportance:
        """The same techniques, counts and sets with the heuristic of this spec."""
        return MultipleImportance(
            self.integrand,
            self.densities,
            heuristic=heuristic,
            counts=self.counts,
            sets=self.sets,
        )

    def alone(self, technique: int) -> Estimator:
        """f sampled by one of the densities."""
        return Estimator(self.integrand, self.densities[technique])

    def technique_name(self, technique: int) -> str:
        """The spec of the density."""
        return self.densities[technique].spec

    def warp(self, technique: int, u: Array) -> Array:
        """T_t(u)."""
        return self.densities[technique].sample(u)

    def weight(self, technique: int, x: Array) -> Array:
        """w_t/p_t, finite where any p_s is positive; those of `domain_integrand` if optimal."""
        return self.combination.over_density(technique, x)


def as_parts(
    integrand: Integrand | str, densities: Any, dims: int | None
) -> tuple[Integrand, tuple[Density, ...]]:
    """Return f and one or more p_t that cover it, of equal dims, from them or their spec strings.

    Raises
    ------
    DensityError
        All densities are zero at points where f is not.
    ParameterError
        No density, or different numbers of dims.
    """
    if not isinstance(densities, list | tuple) or len(densities) == 0:
        raise ParameterError(f"densities is {densities!r}; give a list of one or more.")
    if dims is None:
        parts = (integrand, *densities)
        dims = next((c.dims for c in parts if isinstance(c, Integrand | Density)), None)
    f = as_integrand(integrand, dims)
    found = [as_density(density, f.dims) for density in densities]
    kept = tuple(density for density in found if density is not None)
    if len(kept) != len(found):
        raise ParameterError("densities holds None; write 'uniform' for a uniform density.")
    check_same_dims([f, *kept])
    check_support(f, list(kept))
    return f, kept


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
    sets
        How the points of the techniques belong together: ``"independent"``, ``"shared"`` or
        ``"joint"``, see `mcspectra.estimators.sets`.
    dims
        Number of dims for spec strings without ``dims``.
    """

    def __init__(
        self,
        integrands: Sequence[Integrand | str],
        *,
        counts: Sequence[int] | None = None,
        sets: str = "independent",
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
        self.sets = check_sets(sets, self.counts)

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
        return " + ".join(g.spec for g in self.integrands) + self.sets_label

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
