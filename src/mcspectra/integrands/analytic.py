"""Smooth integrands with exact integrals and Fourier coefficients, in any number of dims."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_reals
from mcspectra.core.display import shown
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import checked, each_axis, real
from mcspectra.integrands._quadrature import gauss_rule
from mcspectra.integrands.base import Integrand, any_dims, per_axis

__all__ = ["Constant", "Cosine", "Gaussian", "Linear", "Polynomial", "squared_distance"]

_MAX_DEGREE = 20  # for a higher degree, `Polynomial._fourier` would lose digits by cancellation
# Above this number of cycles, integration by parts is stable: 2π·4 exceeds the highest degree, 20.
# For fewer cycles, a Gauss rule computes the coefficients
_LOW_FREQUENCY = 4
_NARROW = 0.5  # below this width, 8 Gauss nodes replace differences of erf, with an error of 1e-19


def _as_coefficients(name: str, given: object) -> tuple[float, ...]:
    listed = isinstance(given, Sequence | np.ndarray) and not isinstance(given, str)
    count = len(given) if listed else 0  # type: ignore[arg-type]
    if not 1 <= count <= _MAX_DEGREE + 1:
        raise ParameterError(
            f"coefficients is {shown(given)}; give a list of 1 to {_MAX_DEGREE + 1} numbers, "
            "the factors of 1, x, x², …"
        )
    return as_reals(name, given, count)


def _as_cycles(name: str, given: object, dims: int) -> int | tuple[int, ...]:
    cycles = as_reals(name, given, dims)
    if not isinstance(given, Sequence | np.ndarray):
        return as_integer(name, cycles[0], least=-(2**31), most=2**31)
    return tuple(
        as_integer(f"{name}[{i}]", c, least=-(2**31), most=2**31) for i, c in enumerate(cycles)
    )


@final
@dataclass(frozen=True, kw_only=True)
class Constant(Integrand):
    """A constant, f(x) = value.

    Parameters
    ----------
    value
        Any finite number.
    dims
        Number of dims.
    """

    value: float = real(1.0)
    dims: int = any_dims()

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:  # noqa: ARG002
        """Return the constant value and its square for each box."""
        return np.full(lo.shape[:-1], self.value), np.full(lo.shape[:-1], self.value**2)

    def _evaluate(self, x: Array) -> Array:
        return np.full(x.shape[:-1], self.value)

    def _integral(self) -> float:
        return self.value

    def _fourier(self, m: Array) -> Array:
        return np.where((m == 0).all(axis=-1), self.value, 0.0).astype(np.complex128)


@final
@dataclass(frozen=True, kw_only=True)
class Linear(Integrand):
    """A plane, f(x) = offset + Σ_i gradient_i x_i. The default is f(x) = x_0.

    Parameters
    ----------
    gradient
        Slopes. A single number is the slope along the first axis; a list has one for each axis.
    offset
        Value of f at the origin.
    dims
        Number of dims.
    """

    gradient: float | Sequence[float] = per_axis(1.0)
    offset: float = real(0.0)
    dims: int = any_dims()

    @property
    def _slopes(self) -> Array:
        return _along_first_axis(self.gradient, self.dims)

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Return f at the centers of boxes. The mean of f² adds Σ_i (g_i h_i)²/12 for sides h_i."""
        mean = self._evaluate(0.5 * (lo + hi))
        return mean, mean**2 + ((hi - lo) ** 2 @ self._slopes**2) / 12.0

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(self.offset + x @ self._slopes)

    def _integral(self) -> float:
        return float(self.offset + 0.5 * self._slopes.sum())

    def _fourier(self, m: Array) -> Array:
        # ∫ x exp(−2πi m x) dx = i/(2π m), so only frequencies along one axis have a coefficient
        nonzero = m != 0
        along = np.where(nonzero, self._slopes / np.where(nonzero, m, 1.0), 0.0).sum(axis=-1)
        count = nonzero.sum(axis=-1)
        return np.where(count == 1, 0.5j / np.pi * along, np.where(count, 0.0, self._integral()))


@final
@dataclass(frozen=True, kw_only=True)
class Polynomial(Integrand):
    """A product over axes of one polynomial, f(x) = Π_i Σ_k coefficients_k x_i^k.

    Parameters
    ----------
    coefficients
        c_0, c_1, …, the factors of 1, x, x², …: 1 to 21 numbers.
    dims
        Number of dims.
    """

    coefficients: Sequence[float] = checked(_as_coefficients, (0.0, 1.0))
    dims: int = any_dims()

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Return means of f and f² over boxes. The Gauss rule of each axis is exact for f²."""
        node, weight = gauss_rule(len(self.coefficients))
        values = self._factor(lo[..., None] + (hi - lo)[..., None] * node)
        return (values @ weight).prod(axis=-1), (values**2 @ weight).prod(axis=-1)

    def _factor(self, x: Array) -> Array:
        return np.asarray(np.polynomial.polynomial.polyval(x, np.array(self.coefficients)))

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(self._factor(x).prod(axis=-1))

    def _integral(self) -> float:
        return sum(c / (k + 1) for k, c in enumerate(self.coefficients)) ** self.dims

    def _fourier(self, m: Array) -> Array:
        # Integration by parts gives I_k = ∫ x^k exp(−2πi m x) dx = (k I_{k−1} − 1)/(2πi m).
        # Rounding errors do not grow while k < 2π|m|.
        # At lower frequencies (up to 4 cycles), a Gauss rule of degree 79 is exact to rounding
        node, weight = gauss_rule(40)

        def factor(frequency: Array) -> Array:
            low = np.abs(frequency) < _LOW_FREQUENCY
            scale = 2j * np.pi * np.where(low, 1.0, frequency)
            cycles = np.where(low, frequency, 0.0)[..., None]
            waves = weight * np.exp(-2j * np.pi * cycles * node)
            powers = [np.where(low, frequency == 0, 0.0).astype(np.complex128)]
            for k in range(1, len(self.coefficients)):
                powers.append(np.where(low, waves @ node**k, (k * powers[-1] - 1.0) / scale))
            return np.tensordot(np.array(self.coefficients), np.stack(powers), axes=1)

        return _product_over_axes(m, [factor] * self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class Gaussian(Integrand):
    """A Gaussian bell, f(x) = exp(−|x − center|² / (2 width²)).

    Parameters
    ----------
    center
        Position of the maximum, where f is 1: one number for all axes or one for each.
        The position of the maximum may lie outside the unit cube.
    width
        Standard deviation, > 0.
    dims
        Number of dims.
    """

    center: float | Sequence[float] = per_axis(0.5)
    _centers = each_axis("center")
    width: float = real(0.25, above=0.0)
    dims: int = any_dims()

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Return the means of f and f², products of error functions; f² has width width/√2."""
        mean = _gaussian_mean(lo, hi, self._centers, self.width)
        square = _gaussian_mean(lo, hi, self._centers, self.width / math.sqrt(2.0))
        return mean.prod(axis=-1), square.prod(axis=-1)

    def _evaluate(self, x: Array) -> Array:
        scale = min(math.sqrt(0.5) / self.width, sys.float_info.max)  # avoids ∞ · 0 = NaN
        exponent = squared_distance(x, self._centers, scale)
        np.negative(exponent, out=exponent)
        return np.asarray(np.exp(exponent, out=exponent))

    def _integral(self) -> float:
        return float(self._fourier(np.zeros((1, self.dims)))[0].real)

    def _fourier(self, m: Array) -> Array:
        factors = [partial(_gaussian_fourier, center=c, width=self.width) for c in self._centers]
        return _product_over_axes(m, factors)


@final
@dataclass(frozen=True, kw_only=True)
class Cosine(Integrand):
    """A single wave, f(x) = cos(2π frequency·x + phase), with two Fourier coefficients.

    Parameters
    ----------
    frequency
        Whole cycles along each axis, as a list. A single number is for the first axis.
    phase
        Phase in radians.
    dims
        Number of dims.
    """

    frequency: int | Sequence[int] = checked(_as_cycles, 1, using="dims")
    phase: float = real(0.0)
    dims: int = any_dims()

    @property
    def _wave(self) -> Array:
        return _along_first_axis(self.frequency, self.dims)

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Return the means of f and f²; a cosine's mean is its value at the center times Π sinc."""
        argument = 2.0 * np.pi * (0.5 * (lo + hi) @ self._wave) + self.phase
        cycles = (hi - lo) * self._wave
        mean = np.cos(argument) * np.sinc(cycles).prod(axis=-1)
        square = 0.5 + 0.5 * np.cos(2.0 * argument) * np.sinc(2.0 * cycles).prod(axis=-1)
        return mean, square

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(np.cos(2.0 * np.pi * (x @ self._wave) + self.phase))

    def _integral(self) -> float:
        return 0.0 if self._wave.any() else math.cos(self.phase)

    def _fourier(self, m: Array) -> Array:
        half = 0.5 * np.exp(1j * self.phase)
        forward, backward = (m == self._wave).all(axis=-1), (m == -self._wave).all(axis=-1)
        return np.asarray(np.where(forward, half, 0.0) + np.where(backward, half.conjugate(), 0.0))


def _along_first_axis(value: float | Sequence[float], dims: int) -> Array:
    """Return a vector (d,). A single number becomes its first component."""
    vector = np.zeros(dims)
    vector[: 1 if isinstance(value, int | float) else dims] = value
    return vector


def _product_over_axes(m: Array, factors: Sequence[Callable[[Array], Array]]) -> Array:
    """Return Π_i factors[i](m_i) for m (..., d). Each factor is called once per distinct m_i."""
    product = np.ones(m.shape[:-1], np.complex128)
    for i, factor in enumerate(factors):
        distinct, where = np.unique(m[..., i], return_inverse=True)
        product *= factor(distinct)[where.reshape(product.shape)]
    return product


def squared_distance(x: Array, center: Array, scale: float = 1.0) -> Array:
    """Return Σ_i (scale (x_i − c_i))² at points x (..., d): float64 (...)."""
    # For a last axis of two or three numbers, sums by NumPy are several times slower
    from mcspectra.integrands._kernels import fill_squared_distances

    out = np.empty(x.shape[:-1])
    points = np.ascontiguousarray(x).reshape(-1, x.shape[-1])
    fill_squared_distances(points, np.array(center, float), scale, out.reshape(-1))
    return out


def _gaussian_fourier(m: Array, center: float, width: float) -> Array:
    """Return ∫_0^1 exp(−(x−c)²/(2w²)) exp(−2πi m x) dx for integer m.

    Let t = (x−c)/(w√2), let β = π m w√2, and F(x) = w√2 e^{−2πimc} e^{−β²} (√π/2) erf(t + iβ).
    The integral from 0 to 1 is F(1) − F(0).
    In the upper half plane, F is written with the Faddeeva function W(z) = e^{−z²} erfc(−iz).
    In this half plane |W| ≤ 1, so nothing overflows. The phases at both ends are exp(−2πi m) = 1.
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


def _gaussian_mean(low: Array, high: Array, center: Array, width: float) -> Array:
    """Return means of exp(−(x−c)²/(2w²)) over [low, high], accurate also for short intervals."""
    from scipy.special import erf

    scale = math.sqrt(2.0) * width
    a, b = (low - center) / scale, (high - center) / scale
    node, weight = gauss_rule(8)
    short = np.exp(-((a[..., None] + (b - a)[..., None] * node) ** 2)) @ weight
    long = 0.5 * math.sqrt(math.pi) * (erf(b) - erf(a)) / (b - a)
    return np.where(b - a < _NARROW, short, long)
