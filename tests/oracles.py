"""Functions of other fields with known integrals: finance, physics and sensitivity analysis."""

import math

import numpy as np
from scipy.special import hyp1f1, ndtr, ndtri

from mcspectra import Integrand


def normal(u):
    """Standard normal quantiles, finite at 0 and 1."""
    return ndtri(np.clip(u, 2.0**-54, 1.0 - 2.0**-53))


def keister(dims):
    """∫ cos|y| exp(−|y|²) dy over ℝ^d (Keister 1996), with y = Φ⁻¹(u)/√2."""
    scale = math.pi ** (dims / 2)

    def f(u):
        return scale * np.cos(np.sqrt(0.5 * (normal(u) ** 2).sum(axis=-1)))

    return Integrand.from_function(
        f, dims=dims, integral=float(scale * hyp1f1(dims / 2, 0.5, -0.25))
    )


def gaussian_peaks(dims, centers=(0.23, 0.39, 0.74), width=0.05):
    """Mean of normal densities at points of the diagonal, as in vegas (Lepage 2021)."""

    def f(u):
        squares = [((u - c) ** 2).sum(axis=-1) for c in centers]
        height = (math.sqrt(2.0 * math.pi) * width) ** -dims
        return height * np.mean([np.exp(-s / (2.0 * width**2)) for s in squares], axis=0)

    inside = [(ndtr((1.0 - c) / width) - ndtr(-c / width)) ** dims for c in centers]
    return Integrand.from_function(f, dims=dims, integral=float(np.mean(inside)))


def gaussian_ridge(dims, start=0.25, stop=0.75, width=0.05):
    """Mean of normal densities along a piece of the diagonal, as in vegas (Lepage 2021)."""

    def f(u):
        # Σ(u_i − t)² = Σ(u_i − mean)² + d (mean − t)²: along the ridge a difference of Φ
        mean = u.mean(axis=-1)
        across = ((u - mean[..., None]) ** 2).sum(axis=-1) / (2.0 * width**2)
        scale = math.sqrt(dims) / width
        low, high = (start - mean) * scale, (stop - mean) * scale
        along = np.where(low > 0.0, ndtr(-low) - ndtr(-high), ndtr(high) - ndtr(low))
        height = (math.sqrt(2.0 * math.pi) * width) ** (1.0 - dims)
        return height / ((stop - start) * math.sqrt(dims)) * np.exp(-across) * along

    node, weight = np.polynomial.legendre.leggauss(200)
    t = 0.5 * (start + stop) + 0.5 * (stop - start) * node
    inside = (ndtr((1.0 - t) / width) - ndtr(-t / width)) ** dims
    return Integrand.from_function(f, dims=dims, integral=float(0.5 * inside @ weight))


def ratio_tracking(dims, majorant=1.0):
    """Transmittance of a ray of length 1 by ratio tracking (Novák et al. 2014), `dims` collisions.

    The extinction is σ(t) = 2 (1 + 0.8 cos(6πt)); the ray after the last collision is exact.
    """
    rate = majorant * 2.0 * 1.8

    def depth(t):
        return 2.0 * t * (1.0 + 0.8 * np.sinc(6.0 * t))

    def f(u):
        t = np.minimum((-np.log1p(-np.minimum(u, 1.0 - 2.0**-53)) / rate).cumsum(axis=-1), 1.0)
        extinction = 2.0 * (1.0 + 0.8 * np.cos(6.0 * np.pi * t))
        ratios = np.where(t < 1.0, 1.0 - extinction / rate, 1.0).prod(axis=-1)
        return ratios * np.exp(depth(t[..., -1]) - depth(1.0))

    return Integrand.from_function(f, dims=dims, integral=float(np.exp(-depth(1.0))))


_SPOT, _STRIKE, _RATE, _VOLATILITY = 100.0, 100.0, 0.05, 0.2
_DRIFT = _RATE - 0.5 * _VOLATILITY**2


def log_prices(u):
    """Logarithms (..., d) of S_k/S_0 at d dates in a year, from independent steps."""
    dates = u.shape[-1]
    return (_DRIFT / dates + _VOLATILITY / math.sqrt(dates) * normal(u)).cumsum(axis=-1)


def asian_option(dates):
    """A call on the geometric mean of the prices (Kemna and Vorst 1990)."""

    def f(u):
        mean = _SPOT * np.exp(log_prices(u).mean(axis=-1))
        return math.exp(-_RATE) * np.maximum(mean - _STRIKE, 0.0)

    k = np.arange(1, dates + 1)
    mean = _DRIFT * k.mean() / dates
    deviation = _VOLATILITY * math.sqrt((k.astype(float) ** 2).sum() / dates**3)
    distance = (mean - math.log(_STRIKE / _SPOT)) / deviation
    forward = _SPOT * math.exp(mean + 0.5 * deviation**2)
    value = forward * ndtr(distance + deviation) - _STRIKE * ndtr(distance)
    return Integrand.from_function(f, dims=dates, integral=float(math.exp(-_RATE) * value))


def digital_option(dates):
    """1 if the last price is above the strike (Black and Scholes 1973)."""

    def f(u):
        return math.exp(-_RATE) * (log_prices(u)[..., -1] > math.log(_STRIKE / _SPOT))

    value = math.exp(-_RATE) * ndtr((math.log(_SPOT / _STRIKE) + _DRIFT) / _VOLATILITY)
    return Integrand.from_function(f, dims=dates, integral=float(value))


def ishigami(a=7.0, b=0.1):
    """Ishigami's function (1990), with its first-order and total indices."""

    def f(u):
        y = np.pi * (2.0 * u - 1.0)
        return np.sin(y[..., 0]) * (1.0 + b * y[..., 2] ** 4) + a * np.sin(y[..., 1]) ** 2

    first, second = 0.5 * (1.0 + b * math.pi**4 / 5.0) ** 2, a**2 / 8.0
    pair = b**2 * math.pi**8 * (8.0 / 225.0)
    alone, total = np.array([first, second, 0.0]), np.array([first + pair, second, pair])
    variance = first + second + pair
    made = Integrand.from_function(f, dims=3, integral=0.5 * a)
    return made, alone / variance, total / variance


def sobol_g(a):
    """Sobol's function Π (|4 u_i − 2| + a_i)/(1 + a_i), with the same indices."""
    a = np.asarray(a, float)

    def f(u):
        return ((np.abs(4.0 * u - 2.0) + a) / (1.0 + a)).prod(axis=-1)

    alone = 1.0 / (3.0 * (1.0 + a) ** 2)
    product = (1.0 + alone).prod()
    made = Integrand.from_function(f, dims=len(a), integral=1.0)
    return made, alone / (product - 1.0), alone / (1.0 + alone) * product / (product - 1.0)
