"""Sums over integer and over half-integer frequencies, of two functions on the unit interval.

f(x) = x jumps where the interval ends and begins again, g(x) = (1 − cos 2πx)/2 does not. Half-integers are
the frequencies of a domain twice as long, [0, 2), in whose second half f and the points are 0. With Δν = ½ and
N → ∞ the sum over them without ν = 0 tends to ∫ (f ⋆ box)² − I²/2: |⟨S_ν⟩|² is the power of the box.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.integrands import Integrand

__all__ = [
    "COUNTS",
    "NAMES",
    "SAMPLERS",
    "exact_variances",
    "integer_sums",
    "measured",
    "real_limit",
    "real_sums",
]

COUNTS = (16, 64, 256, 1024)
NAMES = ("f", "g")
SAMPLERS = ("random", "jittered")
_HIGHEST = 2**16  # frequency; the tail of f beyond is 12 N / (4π² 2^16) = 0.5 % at N = 1024
_ORDER = 60  # of the quadrature of a polynomial of degree 4 and of cosines of one cycle


def measured(realizations: int, seed: int) -> dict[str, xr.Dataset]:
    """Return the convergence of both functions, random and jittered points, the latter shifted."""
    from mcspectra.variance.convergence import convergence

    samplers = ["random", "jittered | shift"]
    return {
        name: convergence(
            _integrand(name), samplers, list(COUNTS), realizations=realizations, rng=seed
        )
        for name in NAMES
    }


@cache
def exact_variances(name: str, sampler: str) -> Array:
    """Return the exact variances at the counts, of shifted points."""
    from mcspectra.variance.exact import exact_variance

    f, spec = _integrand(name), f"{sampler} | shift"
    return np.array([float(exact_variance(f, spec, n)) for n in COUNTS])


@cache
def integer_sums(name: str, sampler: str) -> Array:
    """Return Σ |f_m|² ⟨|S_m|²⟩ over integers m ≠ 0, at the counts."""
    return _sums(name, sampler, np.arange(1.0, _HIGHEST + 1), 1.0)


@cache
def real_sums(name: str, sampler: str) -> Array:
    """Return ½ Σ |f(ν)|² ⟨|S_ν|²⟩ over half-integers ν ≠ 0, at the counts."""
    return _sums(name, sampler, np.arange(1.0, _HIGHEST + 1) / 2, 0.5)


@cache
def real_limit(name: str) -> float:
    """Return what `real_sums` tend to, by quadrature of (f ⋆ box)² over its support [0, 2]."""
    node, weight = np.polynomial.legendre.leggauss(_ORDER)
    t, weight = (node + 1) / 2, weight / 2
    # f ⋆ box is F(t) on [0, 1] and I − F(t − 1) on [1, 2], F the integral of f from 0
    partial = t**2 / 2 if name == "f" else t / 2 - np.sin(2 * np.pi * t) / (4 * np.pi)
    return float(weight @ (partial**2 + (0.5 - partial) ** 2)) - 0.5 * 0.5**2


def _integrand(name: str) -> Integrand:
    from mcspectra.integrands.base import Integrand

    def f(x: Array) -> Array:
        return x[..., 0]

    def g(x: Array) -> Array:
        return np.asarray(0.5 - 0.5 * np.cos(2 * np.pi * x[..., 0]))

    return Integrand.from_function(f if name == "f" else g, dims=1, integral=0.5)


def _sums(name: str, sampler: str, nu: Array, step: float) -> Array:
    """Sums over ±ν."""
    from mcspectra.spectra.closed_forms import closed_form_power

    power = np.abs(_transform(name, nu)) ** 2
    return np.array(
        [2 * step * (power @ closed_form_power(sampler, n, nu[:, None])) for n in COUNTS]
    )


def _transform(name: str, nu: Array) -> Array:
    """∫ f(x) exp(−2πiνx) dx over [0, 1], ν ≠ 0."""
    if name == "g":
        return np.asarray(_box(nu) / 2 - (_box(nu - 1) + _box(nu + 1)) / 4)
    w = 2 * np.pi * nu
    return np.asarray(np.exp(-1j * w) * (1j / w + 1 / w**2) - 1 / w**2)


def _box(nu: Array) -> Array:
    return np.asarray(np.exp(-1j * np.pi * nu) * np.sinc(nu))
