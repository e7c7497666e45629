"""Plain and importance-sampled estimators: I = (1/n) Σ f(x_k)/p(x_k)."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from mcspectra.core.analysis import Subject
from mcspectra.core.checks import Array, as_integer
from mcspectra.core.display import shown
from mcspectra.core.errors import ParameterError
from mcspectra.densities import Density, as_density
from mcspectra.densities.base import divide_by_density
from mcspectra.estimators.base import (
    AbstractEstimator,
    DomainEstimator,
    PrimaryIntegrand,
    carried_breaks,
)
from mcspectra.estimators.support import check_support
from mcspectra.integrands import Integrand, as_integrand
from mcspectra.integrands.base import Breaks
from mcspectra.samplers import as_sampler

__all__ = [
    "Estimator",
    "as_densities",
    "as_estimator",
    "as_subject",
    "check_same_dims",
    "check_support",
    "known_dims",
    "scale",
]


@final
class Estimator(DomainEstimator):
    """The estimator (1/n) Σ f(x_k)/p(x_k) with x_k = T(u_k).

    Parameters
    ----------
    integrand
        f, or its spec string.
    density
        p with its warp T, or its spec string; None is the uniform density.
    dims
        Number of dims for spec strings that do not say; otherwise the other argument's, or 2.

    Raises
    ------
    DensityError
        p is zero at points where f is not: found by probing (`mcspectra.estimators.support`), which
        calls f where p is 0 at a probe, some thousand times at most, else not at all; a region that is missed is an error when it is sampled, or a bias.
    ParameterError
        Different numbers of dims.
    """

    counts = (1,)

    def __init__(
        self,
        integrand: Integrand | str,
        density: Density | str | None = None,
        *,
        dims: int | None = None,
    ) -> None:
        self.integrand = as_integrand(integrand, known_dims(dims, integrand, density))
        self.density = as_density(density, self.integrand.dims)
        if self.density is not None:
            check_support(self.integrand, [self.density])

    @property
    def dims(self) -> int:
        """Number of dims of the sampler: those of f, or more where the density's warp takes more."""
        return self.integrand.dims if self.density is None else self.density.primary_dims

    @property
    def spec(self) -> str:
        return self.integrand.spec + (f" / {self.density.spec}" if self.density else "")

    @property
    def pilot_evaluations(self) -> int:
        """Those that f was made from."""
        return self.integrand.pilot_evaluations

    @property
    def infinite_weights(self) -> bool:
        return self.density is not None and not np.isfinite(self.density.reciprocal_integral())

    def _primary(self, technique: int) -> Integrand:
        """g(u) = f(T(u))/p(T(u)); f itself where p is uniform."""
        if self.density is None:
            return self.integrand
        return PrimaryIntegrand(self, technique, self.integrand, self.density)

    def primary_breaks(self, technique: int = 0) -> Breaks:  # noqa: ARG002
        own = self.density
        return self.integrand.breaks if own is None else carried_breaks(self.integrand, own)

    def primary_values(self, technique: int, u: Array) -> Array:  # noqa: ARG002
        if self.density is None:
            return self.integrand(u)
        x, pdf = self.density.sample_pdf(u)
        return divide_by_density(self.integrand(x), pdf, x, self.spec)

    def warp(self, technique: int, u: Array) -> Array:  # noqa: ARG002
        return u if self.density is None else self.density.sample(u)

    def weight(self, technique: int, x: Array) -> Array:  # noqa: ARG002
        ones = np.ones(x.shape[:-1])
        if self.density is None:
            return ones
        return divide_by_density(ones, self.density.pdf(x), x, self.spec, constant=True)


def as_estimator(given: Any, dims: int | None = None) -> AbstractEstimator:
    """Return an estimator as it is; an integrand or its spec string becomes a plain `Estimator`.

    Raises
    ------
    ParameterError
        `given` has another type, or an estimator has other dims.
    """
    if isinstance(given, AbstractEstimator):
        if dims is not None and given.dims != as_integer("dims", dims, least=1):
            raise ParameterError(
                f"dims is {dims}, but {given.spec} has {given.dims} dims; leave dims out, or give a spec "
                "that leaves them open."
            )
        return given
    if isinstance(given, Integrand | str):
        return Estimator(given, dims=dims)
    made = ", or make one with Integrand.from_function" if callable(given) else ""
    raise ParameterError(
        f"{shown(given, 80)} is not an estimator; give Estimator(integrand, density), an integrand, or "
        f"an integrand's spec{made}."
    )


def as_subject(estimator: Any, sampler: Any, *, lists: bool = False) -> Subject:
    """Return an estimator with a sampler, of equal dims, as the subject of an analysis.

    Parameters
    ----------
    estimator, sampler
        As for `as_estimator` and `mcspectra.samplers.as_sampler`; with `lists` one or a list of each.

    Raises
    ------
    ParameterError
        Something else, an empty list, or dims that differ.
    """
    several, many = (lists and isinstance(given, list | tuple) for given in (estimator, sampler))
    if (several and not estimator) or (many and not sampler):
        raise ParameterError("A list is empty; give at least one estimator and one sampler.")
    dims = getattr(sampler, "dims", None)  # of specs that leave them open
    estimators = [
        as_estimator(e, dims if isinstance(e, str) else None)
        for e in (estimator if several else [estimator])
    ]
    samplers = [as_sampler(s, estimators[0].dims) for s in (sampler if many else [sampler])]
    return Subject(estimators if several else estimators[0], samplers if many else samplers[0])


def scale(values: Array, weights: Array) -> Array:
    """values (...) or (..., channels) times weights (...)."""
    return np.asarray(values * (weights if values.ndim == weights.ndim else weights[..., None]))


def known_dims(dims: int | None, *parts: Any) -> int | None:
    """`dims`, or else those of the first integrand or density that is no spec string."""
    if dims is not None:
        return dims
    return next((part.dims for part in parts if isinstance(part, Integrand | Density)), None)


def as_densities(given: Any, dims: int, need: str = " of one or more") -> tuple[Density, ...]:
    """Return densities from a list of them or of their spec strings.

    Raises
    ------
    ParameterError
        No list, an empty one, or one with None in it.
    """
    if not isinstance(given, list | tuple) or len(given) == 0:
        raise ParameterError(f"densities is {given!r}; give a list{need}.")
    found = tuple(p for p in (as_density(each, dims) for each in given) if p is not None)
    if len(found) != len(given):
        raise ParameterError("densities holds None; write 'uniform' for a uniform density.")
    return found


def check_same_dims(components: list[Any]) -> None:
    """Raise ParameterError unless all components have the same dims, those of a shared sampler."""
    if len({component.dims for component in components}) > 1:
        shown = ", ".join(f"{component.spec} has {component.dims}" for component in components)
        raise ParameterError(f"All parts of an estimator need the same number of dims: {shown}.")
    for component in components:
        if isinstance(component, Density) and component.primary_dims != component.dims:
            raise ParameterError(
                f"{component.spec} needs an extra coordinate, which is not available with "
                "several techniques; use selection='coordinate', or its parts as techniques."
            )
