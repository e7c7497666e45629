"""Smooth integrands with exact integrals and Fourier coefficients, in any number of dims."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real, as_reals
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.integrands._axes import (
    PerAxis,
    along_first_axis,
    axis_values,
    gauss_rule,
    gaussian_fourier,
    gaussian_mean,
    power_fourier,
    product_over_axes,
    settle,
    squared_distance,
)
from mcspectra.integrands.base import Integrand, check_dims

__all__ = ["Constant", "Cosine", "Gaussian", "Linear", "Polynomial"]

_MAX_DEGREE = 20  # see `power_fourier`; beyond, powers of x are a bad basis in any case


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

    name: ClassVar[str] = "constant"
    value: float = 1.0
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        settle(self, dims=check_dims(self), value=as_real("value", self.value))

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:  # noqa: ARG002
        """Value and its square."""
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
    """A plane, f(x) = offset + Σ_i gradient_i x_i; by default f(x) = x_0.

    Parameters
    ----------
    gradient
        One number is the slope along the first axis, a list has a slope for each axis.
    offset
        Value at the origin.
    dims
        Number of dims.
    """

    name: ClassVar[str] = "linear"
    gradient: PerAxis = 1.0
    offset: float = 0.0
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        settle(self, dims=check_dims(self), offset=as_real("offset", self.offset))
        settle(self, gradient=axis_values("gradient", self.gradient, self.dims))

    @property
    def _slopes(self) -> Array:
        return along_first_axis(self.gradient, self.dims)

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Mean at the centre; the variance is Σ_i (g_i h_i)²/12 for sides h_i."""
        mean = self._evaluate(0.5 * (lo + hi))
        return mean, mean**2 + ((hi - lo) ** 2 @ self._slopes**2) / 12.0

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(self.offset + x @ self._slopes)

    def _integral(self) -> float:
        return float(self.offset + 0.5 * self._slopes.sum())

    def _fourier(self, m: Array) -> Array:
        # ∫ x exp(−2πi m x) dx = i/(2π m): only frequencies along one axis have a coefficient.
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
        c_0, c_1, … of 1, x, x², …: 1 to 21 numbers.
    dims
        Number of dims.
    """

    name: ClassVar[str] = "polynomial"
    coefficients: Sequence[float] = (0.0, 1.0)
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        settle(self, dims=check_dims(self), coefficients=_check_coefficients(self.coefficients))

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Products over axes, by a Gauss rule that is exact for the squared polynomial."""
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
        def factor(frequency: Array) -> Array:
            powers = power_fourier(frequency, len(self.coefficients) - 1)
            return np.tensordot(np.array(self.coefficients), np.stack(powers), axes=1)

        return product_over_axes(m, [factor] * self.dims)


@final
@dataclass(frozen=True, kw_only=True)
class Gaussian(Integrand):
    """A Gaussian bell, f(x) = exp(−|x − center|² / (2 width²)).

    Parameters
    ----------
    center
        Where f is 1: one number for all axes or one for each; it may lie outside the domain.
    width
        Standard deviation, > 0.
    dims
        Number of dims.
    """

    name: ClassVar[str] = "gaussian"
    center: PerAxis = 0.5
    width: float = 0.25
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        settle(self, dims=check_dims(self), width=as_real("width", self.width, above=0.0))
        settle(self, center=axis_values("center", self.center, self.dims))

    @property
    def _centers(self) -> Array:
        return np.broadcast_to(np.asarray(self.center, float), (self.dims,))

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """Products of error functions; f² is a Gaussian of width/√2."""
        mean = gaussian_mean(lo, hi, self._centers, self.width)
        square = gaussian_mean(lo, hi, self._centers, self.width / math.sqrt(2.0))
        return mean.prod(axis=-1), square.prod(axis=-1)

    def _evaluate(self, x: Array) -> Array:
        scale = min(math.sqrt(0.5) / self.width, sys.float_info.max)  # 0 · ∞ is not 0
        exponent = squared_distance(x, self._centers, scale)
        np.negative(exponent, out=exponent)
        return np.asarray(np.exp(exponent, out=exponent))

    def _integral(self) -> float:
        return float(self._fourier(np.zeros((1, self.dims)))[0].real)

    def _fourier(self, m: Array) -> Array:
        factors = [partial(gaussian_fourier, center=c, width=self.width) for c in self._centers]
        return product_over_axes(m, factors)


@final
@dataclass(frozen=True, kw_only=True)
class Cosine(Integrand):
    """One wave, f(x) = cos(2π frequency·x + phase), that is two Fourier coefficients.

    Parameters
    ----------
    frequency
        Whole cycles: one number is along the first axis, a list has one for each axis.
    phase
        Radians.
    dims
        Number of dims.
    """

    name: ClassVar[str] = "cosine"
    frequency: int | Sequence[int] = 1
    phase: float = 0.0
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        settle(self, dims=check_dims(self), phase=as_real("phase", self.phase))
        settle(self, frequency=_check_cycles(self.frequency, self.dims))

    @property
    def _wave(self) -> Array:
        return along_first_axis(self.frequency, self.dims)

    def box_moments(self, lo: Array, hi: Array) -> tuple[Array, Array]:
        """cos at the centre times Π sinc; f² = ½ + ½ cos of the doubled argument."""
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


def _check_coefficients(coefficients: object) -> tuple[float, ...]:
    listed = isinstance(coefficients, Sequence | np.ndarray) and not isinstance(coefficients, str)
    count = len(coefficients) if listed else 0  # type: ignore[arg-type]
    if not 1 <= count <= _MAX_DEGREE + 1:
        raise ParameterError(
            f"coefficients is {coefficients!r}; give a list of 1 to {_MAX_DEGREE + 1} numbers, "
            "the factors of 1, x, x², …"
        )
    return as_reals("coefficients", coefficients, count)


def _check_cycles(frequency: object, dims: int) -> int | tuple[int, ...]:
    cycles = axis_values("frequency", frequency, dims)
    if isinstance(cycles, float):
        return as_integer("frequency", cycles, least=-(2**31), most=2**31)
    return tuple(
        as_integer(f"frequency[{i}]", c, least=-(2**31), most=2**31) for i, c in enumerate(cycles)
    )
