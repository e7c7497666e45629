"""Estimators whose three terms have one sign or another, and their exact terms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.integrands.registry import integrand

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.densities import Density
    from mcspectra.estimators import Estimator
    from mcspectra.integrands import Integrand

__all__ = [
    "BAD",
    "BAR",
    "CASES",
    "FLAT",
    "GOOD",
    "LINE",
    "MANY",
    "STRATIFIED",
    "Case",
    "N",
    "estimator",
    "exact_bar",
    "exact_random",
    "terms",
    "terms_of_own",
]

N = 16
_FEW, MANY = 4, 64  # half widths: f with one cycle needs no more than 1


@dataclass(frozen=True)
class Case:
    """An estimator and a sampler; `amplitude` is that of the density 1 + a cos(2πx), 0 a constant."""

    title: str
    function: str
    amplitude: float
    sampler: str


LINE = Case("f = x, p = 1, jittered", "line", 0.0, "jittered")
BAR = Case("bar, p = 1, jittered", "bar", 0.0, "jittered")
GOOD = Case("cosine, p as f, random", "cosine", -0.8, "random")
STRATIFIED = Case("cosine, p as f, jittered", "cosine", -0.8, "jittered")
BAD = Case("cosine, p against f, random", "cosine", 0.8, "random")
FLAT = Case("f = 1, p as the cosine, random", "one", -0.8, "random")
CASES = (LINE, BAR, GOOD, STRATIFIED, BAD, FLAT)


def function_of(name: str) -> Integrand:
    """``line``, ``bar``, ``one``, or ``cosine``: 1 − cos 2πx."""
    from mcspectra.integrands.base import Integrand

    if name == "line":
        return integrand("linear", 1)
    if name == "bar":  # edges in the middle of strata 4 and 10 of 16
        return integrand(f"disk(center={7.5 / N}, radius={3 / N})", 1)
    height = 0.0 if name == "one" else 1.0

    def f(x: Array) -> Array:
        return np.asarray(1.0 - height * np.cos(2 * np.pi * x[..., 0]))

    return Integrand.from_function(f, dims=1, integral=1.0)


def density_of(amplitude: float) -> Density | None:
    """1 + a cos 2πx, None for a = 0."""
    from mcspectra.densities.base import Density

    if amplitude == 0.0:
        return None
    return Density.from_functions(
        pdf=lambda x: 1.0 + amplitude * np.cos(2 * np.pi * x[..., 0]), dims=1
    )


def estimator(case: Case) -> Estimator:
    """The estimator of a case."""
    from mcspectra.estimators import Estimator

    return Estimator(function_of(case.function), density_of(case.amplitude))


def terms(case: Case, realizations: int, seed: int) -> xr.Dataset:
    """The terms of a case, with half widths that its function needs."""
    from mcspectra.variance.terms import variance_terms

    half_width = MANY if case.function in ("line", "bar") else _FEW
    return variance_terms(
        estimator(case),
        case.sampler,
        N,
        half_width=half_width,
        realizations=realizations,
        rng=seed,
    )


def exact_random(case: Case) -> tuple[float, float, float]:
    """The three terms of random points: means over the domain, periodic, so that midpoints are exact.

    N times the terms are I² (∫1/p − 1), ∫1/p (∫f² − I²), and Cov(f², 1/p) of x uniform.
    """
    x = (np.arange(4096) + 0.5)[:, None] / 4096
    f, p = function_of(case.function)(x), 1.0 + case.amplitude * np.cos(2 * np.pi * x[:, 0])
    integral, square, inverse = f.mean(), (f**2).mean(), (1 / p).mean()
    first = integral**2 * (inverse - 1.0)
    second = inverse * (square - integral**2)
    third = (f**2 / p).mean() - square * inverse
    return float(first) / N, float(second) / N, float(third) / N


def exact_bar(half_width: int) -> float:
    """The third term of the bar up to a half width, by the closed form of C_ml; 1/(6N²) in all."""
    from mcspectra.spectra.closed_forms import closed_form_covariance

    m = np.arange(-half_width, half_width + 1)[:, None]
    f = function_of("bar").fourier(m)
    matrix = f.conj()[:, None] * f * closed_form_covariance("jittered", N, m[:, None], m[None])
    return float((matrix.sum() - np.trace(matrix)).real)


def terms_of_own(seed: int) -> xr.Dataset:
    """Terms of 1 − 0.8 cos 2πx with p = f, jittered points."""
    from mcspectra.estimators import Estimator
    from mcspectra.integrands.base import Integrand
    from mcspectra.variance.terms import variance_terms

    def f(x: Array) -> Array:
        return np.asarray(1.0 - 0.8 * np.cos(2 * np.pi * x[..., 0]))

    own = Integrand.from_function(f, dims=1, integral=1.0)
    return variance_terms(
        Estimator(own, density_of(-0.8)), "jittered", N, half_width=_FEW, realizations=100, rng=seed
    )
