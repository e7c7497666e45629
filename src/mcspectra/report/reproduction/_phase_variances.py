"""Variances of displaced strata: measured, by quadrature, and from closed forms of C_ml."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.integrands.registry import integrand

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.integrands import Integrand

__all__ = [
    "BAR",
    "COUNTS",
    "HALF_WIDTH",
    "HIGHEST",
    "N",
    "closed_matrix",
    "displaced",
    "displaced_curve",
    "displaced_terms",
    "equal_power",
    "exact_bar",
    "exact_curve",
    "series",
    "stratified",
    "third_term",
]

COUNTS = (16, 64, 256, 1024)
N = 16
HALF_WIDTH = 48
BAR = "disk(center=0.5, radius=0.25)"  # edges at 1/4 and 3/4, borders of strata of 4^k points
HIGHEST = 12  # frequency of the two functions of equal power


def displaced(offset: float) -> str:
    """Jittered points, their strata moved by a part of the side."""
    return f"jittered | strata-shift(offset={offset})"


def displaced_terms(offset: float, realizations: int, seed: int) -> xr.Dataset:
    """Terms of the bar."""
    from mcspectra.variance.terms import variance_terms

    return variance_terms(
        integrand(BAR, 1), displaced(offset), N,
        half_width=HALF_WIDTH, realizations=realizations, rng=seed,
    )  # fmt: skip


def _smooth() -> Integrand:
    """The bar, and a cosine that gives what is left of the variance when edges cost nothing."""
    from mcspectra.integrands.base import Integrand

    def f(x: Array) -> Array:
        return np.asarray((np.abs(x[..., 0] - 0.5) < 0.25) + np.cos(2 * np.pi * x[..., 0]))

    return Integrand.from_function(f, dims=1, integral=0.5)


def displaced_curve(offset: float, realizations: int, seed: int) -> xr.Dataset:
    """Convergence of the bar and the cosine."""
    from mcspectra.variance.convergence import convergence

    return convergence(
        _smooth(), displaced(offset), list(COUNTS), realizations=realizations, rng=seed
    )


def exact_bar(offset: float, n: int) -> float:
    """Both edges cut a stratum into shares s = offset and 1 − s: 2 s(1 − s)/N²."""
    return 2 * offset * (1 - offset) / n**2


def exact_curve(offset: float) -> Array:
    """Variances of the bar and the cosine: of each stratum, by quadrature on both sides of its cut."""
    return np.array([_strata_variance(offset, n) for n in COUNTS])


def _strata_variance(offset: float, n: int) -> float:
    node, weight = np.polynomial.legendre.leggauss(8)
    node, weight = (node + 1) / 2, weight / 2
    # Cuts are 1 − offset from the left of a stratum.
    left, right = node * (1 - offset), 1 - offset + node * offset
    t, w = np.concatenate([left, right]), np.concatenate([weight * (1 - offset), weight * offset])
    x = ((np.arange(n)[:, None] + t + offset) / n) % 1.0
    f = _smooth()(x[..., None])
    mean = f @ w
    return float((((f - mean[:, None]) ** 2) @ w).sum()) / n**2


def closed_matrix(sampler: str, half_width: int = HALF_WIDTH) -> tuple[Array, Array]:
    """Frequencies (M, 1) and C_ml in closed form."""
    from mcspectra.spectra.closed_forms import closed_form_covariance

    m = np.arange(-half_width, half_width + 1)[:, None]
    return m, closed_form_covariance(sampler, N, m[:, None], m[None])


def third_term(f: Array, c: Array) -> float:
    """Σ conj(f_m) f_l C_ml over m ≠ l."""
    matrix = f.conj()[:, None] * f[None] * c
    return float((matrix.sum() - np.trace(matrix)).real)


def equal_power() -> tuple[Array, Array, Array]:
    """Frequencies, and coefficients of two real functions of equal |f_m|: a peak and a spread-out one.

    Phases of the second are those of a chirp, π m²/K.
    """
    m = np.arange(-HIGHEST, HIGHEST + 1)[:, None]
    size = 1.0 / (1.0 + np.abs(m[:, 0]))
    return m, size + 0j, size * np.exp(1j * np.pi * np.sign(m[:, 0]) * m[:, 0] ** 2 / HIGHEST)


def _nodes() -> Array:
    """Nodes in each of N strata, (N, nodes), of Gauss's rule, and their weights below."""
    node, weight = np.polynomial.legendre.leggauss(16)
    return np.stack([(np.arange(N)[:, None] + (node + 1) / 2) / N, np.tile(weight / 2, (N, 1))])


def stratified(m: Array, f: Array) -> float:
    """Variance of jittered points on a series, by quadrature."""
    x, weight = _nodes()
    values = series(x, m, f)
    mean = (values * weight).sum(axis=1)
    return float(((values - mean[:, None]) ** 2 * weight).sum()) / N**2


def series(x: Array, m: Array, f: Array) -> Array:
    """Values of Σ f_m exp(2πi m x), which is real."""
    return np.asarray((np.exp(2j * np.pi * x[..., None] * m[:, 0]) @ f).real)
