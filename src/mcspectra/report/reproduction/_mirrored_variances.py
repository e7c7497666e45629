"""Exact variances of exp(−x² − y²), mirrored or not, with jittered points, shifted or not.

Mirror-uniform puts each of n/4 points into four images, which is sampling the mean h of f over images
at n/4 points; mirror-random adds the variance of the choice of an image, 1/n of that of f among them.
h = q(x) q(y) is continuous around the torus, and with shifted strata of the side 1/s its variance is the
sum over integer frequencies, Σ |h_m|² (1 − Π_i sinc²(πm_i/s)) / n, m ≠ 0, of products of one axis.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["INTEGRAND", "MIRRORINGS", "RATES", "exact_mirrored", "symmetrized"]

INTEGRAND = "christensen-gaussian"
MIRRORINGS = ("original", "random", "uniform")

RATES = {
    ("original", False): -2.0, ("original", True): -1.5,
    ("random", False): -1.0, ("random", True): -1.0,
    ("uniform", False): -2.0, ("uniform", True): -2.0,
}  # fmt: skip
"""Of each mirroring, not homogenised and homogenised."""

_SAMPLES, _FREQUENCIES = 2**16, 4096


def symmetrized(x: Array) -> Array:
    """Mean q of exp(−x²) over both images of x."""
    return np.asarray((np.exp(-(x**2)) + np.exp(-((1 - x) ** 2))) / 2)


def exact_mirrored(mirroring: str, n: int, *, homogenized: bool) -> float:
    """Variance of I_n with n evaluations of f; n = s², and for ``uniform`` n = 4s²."""
    from mcspectra.variance.exact import exact_variance

    if mirroring == "original":
        sampler = "jittered | shift" if homogenized else "jittered"
        return float(exact_variance(INTEGRAND, sampler, n))
    if mirroring == "uniform":
        return _of_the_mean(n // 4, homogenized)
    return _among_images() / n + _of_the_mean(n, homogenized)


def _of_the_mean(n: int, homogenized: bool) -> float:
    """Variance of h at n jittered points."""
    s = math.isqrt(n)
    if homogenized:
        whole, power = _axis()
        m = np.arange(len(power))
        seen = power[0] + 2.0 * (power[1:] * np.sinc(m[1:] / s) ** 2).sum()
        return float((whole**2 - seen**2) / n)
    # Within stratum j: n⁻² Σ (∫∫ h² n − (∫∫ h n)²), and both are products of axes
    nodes, weights = np.polynomial.legendre.leggauss(24)
    q = symmetrized((np.arange(s)[:, None] + (nodes + 1) / 2) / s)
    means, squares = q @ weights / 2, q**2 @ weights / 2
    return float((squares.sum() ** 2 - (means**2).sum() ** 2) / n**2)


@cache
def _axis() -> tuple[float, Array]:
    """∫q² and |q_m|², m = 0 … 4096, which fall as m⁻⁴."""
    x = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    power = np.abs(np.fft.rfft(symmetrized(x)) / _SAMPLES)[: _FREQUENCIES + 1] ** 2
    nodes, weights = np.polynomial.legendre.leggauss(40)
    return float(weights @ symmetrized((nodes + 1) / 2) ** 2 / 2), power


def _among_images() -> float:
    """∫f² − ∫h²."""
    square = float(np.pi / 8 * math.erf(math.sqrt(2.0)) ** 2)  # (∫ exp(−2x²) dx)²
    return square - _axis()[0] ** 2
