"""Estimators with one technique: plain and importance-sampled, I = (1/n) Σ f(x_k)/p(x_k)."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from mcspectra.core.analysis import Subject
from mcspectra.core.checks import MAX_DIMS, Array, as_integer
from mcspectra.core.display import counted, shown
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
from mcspectra.samplers import Sampler, as_sampler

__all__ = [
    "Estimator",
    "as_densities",
    "as_estimator",
    "as_subject",
    "check_same_dims",
    "check_support",
    "function_dims",
    "is_function",
    "known_dims",
    "scale",
]


@final
class Estimator(DomainEstimator):
    """The importance-sampled estimator (1/n) Σ f(x_k)/p(x_k) with x_k = T(u_k).

    Parameters
    ----------
    integrand
        The integrand f, or its spec string.
    density
        The density p with its warp T, or its spec string; None means the uniform density.
    dims
        Number of dims; needed for spec strings without ``dims``.
        The default is the number of dims of the other argument, or 2.

    Raises
    ------
    DensityError
        If p is zero at points where f is not (probed by `mcspectra.estimators.support`).
        Probes call f only where p is 0, at most a few thousand times. Probes may miss a region.
        If probes miss a region where p is 0 and f is not, a sample in the region raises the error.
        If no sample hits the region, the estimate is biased.
    ParameterError
        If the numbers of dims differ.
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
        """Number of dims of the sampler, which is larger than that of f for some warps."""
        return self.integrand.dims if self.density is None else self.density.primary_dims

    @property
    def spec(self) -> str:
        return self.integrand.spec + (f" / {self.density.spec}" if self.density else "")

    @property
    def pilot_evaluations(self) -> int:
        """Number of evaluations that the construction of f took."""
        return self.integrand.pilot_evaluations

    @property
    def infinite_weights(self) -> bool:
        return self.density is not None and not np.isfinite(self.density.reciprocal_integral())

    def _primary(self, technique: int) -> Integrand:
        """Return g(u) = f(T(u))/p(T(u)); if p is uniform, return f itself."""
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


def is_function(given: Any) -> bool:
    """Return whether `given` is a plain function: a callable that is not an integrand."""
    return callable(given) and not isinstance(given, Integrand | AbstractEstimator)


def function_dims(function: Any, dims: int | None) -> int:
    """Return the number of dims of a plain function, which the user must give.

    Raises
    ------
    ParameterError
        If `dims` is missing or out of range, or if the function is a class.
    """
    if isinstance(function, type):
        raise ParameterError(
            f"{function.__name__} is a class; give an instance of it, or a function of points."
        )
    if dims is None:
        raise ParameterError(
            "dims is missing; give dims=, the number of dims of the function's points."
        )
    return as_integer("dims", dims, least=1, most=MAX_DIMS)


def as_estimator(given: Any, dims: int | None = None) -> AbstractEstimator:
    """Return an estimator. Integrands, their specs and plain functions are sampled uniformly.

    Parameters
    ----------
    given
        An estimator, an integrand, its spec string, or a vectorized function.
        A function maps points (…, d) to values (…) or (…, channels); see `Integrand.from_function`.
    dims
        Number of dims. Functions need it and specs may need it. Other objects must agree with it.

    Raises
    ------
    ParameterError
        If `given` has another type or other dims, or if the function returns invalid values.
    """
    if isinstance(given, AbstractEstimator):
        if dims is not None and given.dims != as_integer("dims", dims, least=1):
            raise ParameterError(
                f"dims is {dims}, but {given.spec} has {counted(given.dims, 'dim')}; leave dims "
                "out."
            )
        return given
    if is_function(given):
        given = Integrand.from_function(given, dims=function_dims(given, dims))
    if isinstance(given, Integrand | str):
        return Estimator(given, dims=dims)
    raise ParameterError(
        f"{shown(given)} is not an estimator; give Estimator(integrand, density), an integrand or "
        "its spec, or a function with dims=."
    )


def as_subject(
    estimator: Any, sampler: Any, *, dims: int | None = None, lists: bool = False
) -> Subject:
    """Return an estimator and a sampler with equal dims, as the subject of an analysis.

    Parameters
    ----------
    estimator, sampler
        The allowed types are the same as in `as_estimator` and `mcspectra.samplers.as_sampler`.
        If `lists` is true, a list of estimators or a list of samplers is also allowed.
    dims
        Number of dims; needed for functions and for spec strings without ``dims``.
        The default is the dims of the first sampler that is not a spec string.
        If a function or sampler has its own number of dims, it must be equal to `dims`.

    Raises
    ------
    ParameterError
        If an argument has another type, a list is empty, or dims differ.
    """
    several, many = (lists and isinstance(given, list | tuple) for given in (estimator, sampler))
    if (several and not estimator) or (many and not sampler):
        raise ParameterError("A list is empty; give at least one estimator and one sampler.")
    if dims is not None:
        dims = as_integer("dims", dims, least=1, most=MAX_DIMS)
    given_samplers = sampler if many else [sampler]
    known = [each.dims for each in given_samplers if isinstance(each, Sampler)]
    open_dims = known[0] if dims is None and known else dims
    estimators = [
        as_estimator(e, open_dims if isinstance(e, str) or is_function(e) else dims)
        for e in (estimator if several else [estimator])
    ]
    samplers = [as_sampler(s, estimators[0].dims) for s in given_samplers]
    return Subject(estimators if several else estimators[0], samplers if many else samplers[0])


def scale(values: Array, weights: Array) -> Array:
    """Multiply values (...) or (..., channels) by weights (...)."""
    return np.asarray(values * (weights if values.ndim == weights.ndim else weights[..., None]))


def known_dims(dims: int | None, *parts: Any) -> int | None:
    """Return `dims`; if None, the dims of the first integrand or density that is not a spec."""
    if dims is not None:
        return dims
    return next((part.dims for part in parts if isinstance(part, Integrand | Density)), None)


def as_densities(given: Any, dims: int, need: str = " of one or more") -> tuple[Density, ...]:
    """Return densities from a list of densities or spec strings.

    Raises
    ------
    ParameterError
        If `given` is not a list, is an empty list, or contains None.
    """
    if not isinstance(given, list | tuple) or len(given) == 0:
        raise ParameterError(f"densities is {shown(given)}; give a list{need}.")
    found = tuple(p for p in (as_density(each, dims) for each in given) if p is not None)
    if len(found) != len(given):
        raise ParameterError("densities holds None; write 'uniform' for a uniform density.")
    return found


def check_same_dims(components: list[Any]) -> None:
    """Raise `ParameterError` unless all components have the dims that a shared sampler needs."""
    if len({component.dims for component in components}) > 1:
        shown = ", ".join(f"{component.spec} has {component.dims}" for component in components)
        raise ParameterError(f"All parts of an estimator need the same number of dims: {shown}.")
    for component in components:
        if isinstance(component, Density) and component.primary_dims != component.dims:
            raise ParameterError(
                f"{component.spec} needs an extra coordinate, which is not available with "
                "several techniques; use selection='coordinate', or its parts as techniques."
            )
