"""Densities in closed form whose cdf inverts in one expression: power, exponential, cosine, tent.

All are products over the dims of one-dimensional densities, with one parameter for all dims or one
a dim.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import MAX_DIMS, Array, as_reals
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.densities.base import Density, bounded_product, plain, store_integer

__all__ = ["CosineWeighted", "Exponential", "Power", "Tent"]

# Nearer to −1 more than 1 in 1000 samples u^(1/(a+1)) would be less than the smallest float
_LEAST_EXPONENT = -0.99
_MOST_EXPONENT = 1000.0
_MOST_RATE = 700.0  # exp(710) is infinite
_NO_RATE = 1e-16


@final
@dataclass(frozen=True, kw_only=True)
class Power(Density):
    """Product of powers, p(x) = Π_i (a_i + 1) x_i^a_i.

    Attributes
    ----------
    exponent
        a, from −0.99 to 1000: one number for all dims or one a dim. Below 0 the density is
        unbounded at 0; above 0 it is 0 there, and from 1 on ∫1/p diverges.
    """

    name: ClassVar[str] = "power"
    dims: int = DEFAULT_DIMS
    exponent: float | tuple[float, ...] = 1.0

    def __post_init__(self) -> None:
        store_integer(self, "dims", least=1, most=MAX_DIMS)
        as_reals("exponent", self.exponent, self.dims, least=_LEAST_EXPONENT, most=_MOST_EXPONENT)
        object.__setattr__(self, "exponent", plain(self.exponent))

    @cached_property
    def _exponents(self) -> Array:
        return np.array(as_reals("exponent", self.exponent, self.dims))

    def reciprocal_integral(self) -> float:
        """Π 1/(1 − a²), infinite where an exponent is 1 or more."""
        a = self._exponents
        return float(np.prod(1.0 / ((1.0 - a) * (1.0 + a)))) if (a < 1).all() else math.inf

    def _pdf(self, x: Array) -> Array:
        a = self._exponents
        # 0^a is infinite for a < 0, and at 1e-320 or in products so may be what is finite in theory
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            factors = (a + 1.0) * x**a
            product = factors.prod(axis=-1)
        # 0 · ∞ in a product of dims: the set of those points has no volume
        return np.asarray(np.where(np.isnan(product), 0.0, product))

    def _sample(self, u: Array) -> Array:
        return np.asarray(u ** (1.0 / (self._exponents + 1.0)))

    def _invert(self, x: Array) -> Array:
        return np.asarray(x ** (self._exponents + 1.0))


@final
@dataclass(frozen=True, kw_only=True)
class Exponential(Density):
    """Product of exponential densities cut to [0,1), p(x) = Π_i r_i exp(−r_i x_i)/(1 − exp(−r_i)).

    Attributes
    ----------
    rate
        r, from −700 to 700: one number for all dims or one a dim. Below 0 the density rises; at 0
        it is uniform.
    """

    name: ClassVar[str] = "exponential"
    dims: int = DEFAULT_DIMS
    rate: float | tuple[float, ...] = 1.0

    def __post_init__(self) -> None:
        store_integer(self, "dims", least=1, most=MAX_DIMS)
        as_reals("rate", self.rate, self.dims, least=-_MOST_RATE, most=_MOST_RATE)
        object.__setattr__(self, "rate", plain(self.rate))

    @cached_property
    def _flat(self) -> Array:
        """Where the rate is too small to change a float."""
        return np.abs(as_reals("rate", self.rate, self.dims)) < _NO_RATE

    @cached_property
    def _rates(self) -> Array:
        """Rates, 1 in place of those that are flat."""
        return np.where(self._flat, 1.0, as_reals("rate", self.rate, self.dims))

    def reciprocal_integral(self) -> float:
        """Π [sinh(r/2)/(r/2)]², infinite where it exceeds the largest float."""
        half = 0.5 * self._rates
        with np.errstate(over="ignore"):
            return float(np.where(self._flat, 1.0, (np.sinh(half) / half) ** 2).prod())

    def _pdf(self, x: Array) -> Array:
        steep = np.abs(self._rates)
        from_peak = np.where(self._rates > 0, x, 1.0 - x)
        factors = steep * np.exp(-steep * from_peak) / -np.expm1(-steep)
        return bounded_product(np.where(self._flat, 1.0, factors), self.spec)

    def _sample(self, u: Array) -> Array:
        r = self._rates
        with np.errstate(divide="ignore"):  # u = 1 at rate 700: ∞, cut to the end
            return np.where(self._flat, u, np.log1p(u * np.expm1(-r)) / -r)

    def _invert(self, x: Array) -> Array:
        r = self._rates
        return np.where(self._flat, x, np.expm1(-r * x) / np.expm1(-r))


@final
@dataclass(frozen=True, kw_only=True)
class CosineWeighted(Density):
    """Product of cosines about the centre, p(x) = Π_i (π/2) cos(π (x_i − ½)).

    Notes
    -----
    Two meanings of *cosine-weighted* agree here. In flatland x = ½ + θ/π is the angle of a
    direction above a line, p(θ) = cos θ/2. On the hemisphere with the density cos θ/π by solid
    angle, the polar angle has the density sin 2θ, which is this one in x = 2θ/π; its warp
    θ = arcsin √u is that of Malley's method (Pharr, Jakob, Humphreys, "Physically Based
    Rendering", 3rd edition, §13.6.3). The density is 0 at both ends
    and ∫1/p diverges.
    """

    name: ClassVar[str] = "cosine-weighted"
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        store_integer(self, "dims", least=1, most=MAX_DIMS)

    def reciprocal_integral(self) -> float:
        """Infinite."""
        return math.inf

    def _pdf(self, x: Array) -> Array:
        from_end = np.minimum(x, 1.0 - x)  # so that the zero at x = 1 is exact
        return np.asarray((0.5 * math.pi * np.sin(math.pi * from_end)).prod(axis=-1))

    def _sample(self, u: Array) -> Array:
        from_end = np.arcsin(np.sqrt(np.minimum(u, 1.0 - u))) * (2.0 / math.pi)
        return np.where(u <= 0.5, from_end, 1.0 - from_end)

    def _invert(self, x: Array) -> Array:
        share = np.sin(0.5 * math.pi * np.minimum(x, 1.0 - x)) ** 2
        return np.where(x <= 0.5, share, 1.0 - share)


@final
@dataclass(frozen=True, kw_only=True)
class Tent(Density):
    """Product of tents: each rises linearly from 0 at 0 to 2 at its peak and falls to 0 at 1.

    Attributes
    ----------
    peak
        Position of the peak, from 0 to 1: one number for all dims or one a dim.
    """

    name: ClassVar[str] = "tent"
    dims: int = DEFAULT_DIMS
    peak: float | tuple[float, ...] = 0.5

    def __post_init__(self) -> None:
        store_integer(self, "dims", least=1, most=MAX_DIMS)
        as_reals("peak", self.peak, self.dims, least=0.0, most=1.0)
        object.__setattr__(self, "peak", plain(self.peak))

    @cached_property
    def _peaks(self) -> Array:
        return np.array(as_reals("peak", self.peak, self.dims))

    @cached_property
    def _sides(self) -> tuple[Array, Array]:
        """Lengths of the rising and the falling side, 1 in place of 0."""
        c = self._peaks
        return np.where(c > 0, c, 1.0), np.where(c < 1, 1.0 - c, 1.0)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """The peak: the cdf there is its position."""
        return tuple((c,) if 0 < c < 1 else () for c in self._peaks.tolist())

    def reciprocal_integral(self) -> float:
        """Infinite: the density falls linearly to 0."""
        return math.inf

    def _rising(self, x: Array) -> Array:
        """Where x (or u, the cdf of the peak being its position) is on the rising side."""
        return np.asarray((x < self._peaks) | (self._peaks == 1))

    def _pdf(self, x: Array) -> Array:
        left, right = self._sides
        up, down = np.minimum(x, left) / left, np.minimum(1.0 - x, right) / right
        line = np.where(self._rising(x), up, down)
        return bounded_product(2.0 * line, self.spec)

    def _sample(self, u: Array) -> Array:
        left, right = self._sides
        return np.where(self._rising(u), np.sqrt(u * left), 1.0 - np.sqrt((1.0 - u) * right))

    def _invert(self, x: Array) -> Array:
        left, right = self._sides
        up, down = np.minimum(x, left) / left, np.minimum(1.0 - x, right) / right
        return np.where(self._rising(x), x * up, 1.0 - (1.0 - x) * down)
