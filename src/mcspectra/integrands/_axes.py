"""One axis at a time: checked parameters, and integrals over intervals that products are made of.

Conventions: frequencies m are integers held as float64, ν is real, intervals are [low, high].
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence

import numpy as np

from mcspectra.core.checks import Array, as_reals

__all__ = [
    "PerAxis",
    "along_first_axis",
    "axis_values",
    "gauss_rule",
    "gaussian_fourier",
    "gaussian_mean",
    "interval_fourier",
    "overlap",
    "power_fourier",
    "product_over_axes",
    "settle",
    "squared_distance",
]

PerAxis = float | Sequence[float]
"""One number for all axes, or one for each."""

_LOW_FREQUENCY = 4  # 2π·4 is more than the highest degree, 20
_NARROW = 0.5  # below this width 8 Gauss nodes integrate exp(−t²) to 1e-19; above, erf differences


def settle(component: object, **values: object) -> None:
    """Replace fields of a frozen dataclass by their checked values; for `__post_init__`."""
    for name, value in values.items():
        object.__setattr__(component, name, value)


def axis_values(name: str, value: object, dims: int) -> PerAxis:
    """Return one finite float, or a tuple of one for each of `dims` axes, as it was given."""
    checked = as_reals(name, value, dims)
    return checked if isinstance(value, Sequence | np.ndarray) else checked[0]


def along_first_axis(value: PerAxis, dims: int) -> Array:
    """Return a vector (d,): a single number is its first component."""
    vector = np.zeros(dims)
    vector[: 1 if isinstance(value, int | float) else dims] = value
    return vector


@functools.lru_cache(maxsize=32)
def gauss_rule(order: int) -> tuple[Array, Array]:
    """Nodes and weights (order,) of Gauss-Legendre quadrature on [0,1]."""
    node, weight = np.polynomial.legendre.leggauss(order)
    return 0.5 * (node + 1.0), 0.5 * weight


def product_over_axes(m: Array, factors: Sequence[Callable[[Array], Array]]) -> Array:
    """Return Π_i factors[i](m_i) for m (..., d), each factor called once for each distinct m_i."""
    product = np.ones(m.shape[:-1], np.complex128)
    for i, factor in enumerate(factors):
        distinct, where = np.unique(m[..., i], return_inverse=True)
        product *= factor(distinct)[where.reshape(product.shape)]
    return product


def overlap(low: Array, high: Array, start: float, stop: float) -> Array:
    """Share of the intervals [low, high] that lies in [start, stop]."""
    inside = np.minimum(high, stop) - np.maximum(low, start)
    return np.asarray(np.maximum(inside, 0.0) / (high - low))


def interval_fourier(nu: Array, low: Array | float, high: Array | float) -> Array:
    """∫_low^high exp(−2πi ν x) dx for real ν, without a singular case at ν = 0."""
    width = high - low
    return np.asarray(width * np.sinc(nu * width) * np.exp(-1j * np.pi * nu * (low + high)))


def power_fourier(m: Array, degree: int) -> list[Array]:
    """∫_0^1 x^k exp(−2πi m x) dx for k = 0 … degree.

    By parts, I_k = (k I_{k−1} − 1)/(2πi m), where rounding does not grow: k < 2π|m|. At lower
    frequencies a Gauss rule is exact to rounding (degree 79, at most 3 cycles).
    """
    low = np.abs(m) < _LOW_FREQUENCY
    a = 2j * np.pi * np.where(low, 1.0, m)
    node, weight = gauss_rule(40)
    waves = weight * np.exp(-2j * np.pi * np.where(low, m, 0.0)[..., None] * node)
    integrals = [np.where(low, m == 0, 0.0).astype(np.complex128)]
    for k in range(1, degree + 1):
        integrals.append(np.where(low, waves @ node**k, (k * integrals[-1] - 1.0) / a))
    return integrals


def squared_distance(x: Array, center: Array, scale: float = 1.0) -> Array:
    """Σ_i (scale (x_i − c_i))² of points x (..., d): float64 (...)."""
    # NumPy's sum over a last axis of two or three numbers takes several times as long.
    from mcspectra.integrands._kernels import fill_squared_distances

    out = np.empty(x.shape[:-1])
    points = np.ascontiguousarray(x).reshape(-1, x.shape[-1])
    fill_squared_distances(points, np.array(center, float), scale, out.reshape(-1))
    return out


def gaussian_fourier(m: Array, center: float, width: float) -> Array:
    """∫_0^1 exp(−(x−c)²/(2w²)) exp(−2πi m x) dx for integer m.

    With t = (x−c)/(w√2) and β = π m w√2 it is w√2 e^{−2πimc} e^{−β²} (√π/2) [erf(t + iβ)] from x = 0
    to 1. Written by the Faddeeva function W(z) = e^{−z²} erfc(−iz) in its upper half plane, where
    |W| ≤ 1, nothing overflows at large m; the phases at the ends are exp(−2πi m) = 1.
    """
    from scipy.special import wofz

    scale = math.sqrt(2.0) * width
    beta = np.pi * m * scale

    def end(x: float) -> Array:
        t = (x - center) / scale
        sign = 1.0 if t >= 0 else -1.0
        return np.asarray(sign * math.exp(-t * t) * wofz(sign * (1j * t - beta)))

    peak = 2.0 * np.exp(-beta * beta - 2j * np.pi * m * center) if 0 < center <= 1 else 0.0
    return np.asarray(0.5 * math.sqrt(math.pi) * scale * (peak + end(0.0) - end(1.0)))


def gaussian_mean(low: Array, high: Array, center: Array, width: float) -> Array:
    """Mean of exp(−(x−c)²/(2w²)) over intervals [low, high], to rounding also where they are short."""
    from scipy.special import erf

    scale = math.sqrt(2.0) * width
    a, b = (low - center) / scale, (high - center) / scale
    node, weight = gauss_rule(8)
    short = np.exp(-((a[..., None] + (b - a)[..., None] * node) ** 2)) @ weight
    long = 0.5 * math.sqrt(math.pi) * (erf(b) - erf(a)) / (b - a)
    return np.where(b - a < _NARROW, short, long)
