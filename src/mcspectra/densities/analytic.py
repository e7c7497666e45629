"""Products of 1-D densities in closed form, with one parameter for all dims or one per dim.

The cdf of uniform, linear, power, exponential, cosine and tent densities has a closed-form inverse.
The cdf of truncated normals is inverted through logarithms of the normal cdf.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from mcspectra.core.checks import MAX_DIMS, Array, as_reals
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import whole
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.densities.base import Density, bounded_product, exponential, per_dim

__all__ = [
    "CosineWeighted",
    "Exponential",
    "Linear",
    "Power",
    "Tent",
    "TruncatedNormal",
    "Uniform",
]

_MAX_SIGMAS = 100.0
_MAX_SIGMA = 100.0
# If a is closer to −1 than this, more than 1 in 1000 of the samples u^(1/(a+1)) underflow
_LEAST_EXPONENT = -0.99
_MOST_EXPONENT = 1000.0
_MOST_RATE = 700.0  # exp(710) is infinite
_NO_RATE = 1e-16


@dataclass(frozen=True, kw_only=True)
class _Separable(Density):
    """Abstract product of 1-D densities over any number of dims."""

    dims: int = whole(DEFAULT_DIMS, least=1, most=MAX_DIMS)

    def _each(self, parameter: str) -> Array:
        """Return the values (d,) of a parameter."""
        return np.array(as_reals(parameter, getattr(self, parameter), self.dims))


@final
@dataclass(frozen=True, kw_only=True)
class Uniform(_Separable):
    """Uniform density, p = 1; the warp is the identity."""

    def reciprocal_integral(self) -> float:
        """Return 1."""
        return 1.0

    def _pdf(self, x: Array) -> Array:
        return np.ones(x.shape[:-1])

    def _sample(self, u: Array) -> Array:
        return u

    def _invert(self, x: Array) -> Array:
        return x


@final
@dataclass(frozen=True, kw_only=True)
class Linear(_Separable):
    """Product of linear densities, p(x) = Π_i (1 + s_i (x_i − ½)).

    Attributes
    ----------
    slope
        Slope s, within [−2, 2]: one number for all dims or one per dim.
        At ±2 the density falls to 0 at one end, and ∫1/p diverges.

    Notes
    -----
    In one dim, the cdf is low·x + s x²/2 with low = 1 − s/2 = p(0).
    The inverse of the cdf is 2u / (low + √D) with D = low² + 2 s u.
    For s < 0, D is written as high² − 2 s (1 − u) with high = p(1).
    Each formula for D adds only positive terms, so no digits cancel for s → 0 or s = ±2.
    """

    slope: float | tuple[float, ...] = per_dim(1.0, least=-2.0, most=2.0)

    @cached_property
    def _slopes(self) -> Array:
        return self._each("slope")

    def reciprocal_integral(self) -> float:
        """Return Π ln((1 + s/2)/(1 − s/2))/s, infinite if a slope is ±2."""
        halves = (0.5 * self._slopes).tolist()
        if any(abs(t) == 1.0 for t in halves):
            return math.inf
        return math.prod(math.atanh(t) / t if t else 1.0 for t in halves)

    def _pdf(self, x: Array) -> Array:
        s = self._slopes
        # Compute p(x) from its value at the end where the density is lower, to avoid cancellation
        line = np.where(s >= 0, (1.0 - 0.5 * s) + s * x, (1.0 + 0.5 * s) - s * (1.0 - x))
        return bounded_product(line, self.spec)

    def _sample(self, u: Array) -> Array:
        s = self._slopes
        low, high = 1.0 - 0.5 * s, 1.0 + 0.5 * s
        root = low + np.sqrt(np.where(s >= 0, low**2 + 2 * s * u, high**2 - 2 * s * (1.0 - u)))
        return np.divide(2.0 * u, root, out=np.zeros_like(u), where=root > 0)

    def _invert(self, x: Array) -> Array:
        s = self._slopes
        rest = np.where(s >= 0, (1.0 - 0.5 * s) + 0.5 * s * x, 1.0 - 0.5 * s * (1.0 - x))
        return np.asarray(x * rest)


class _Normals(NamedTuple):
    """Constants of truncated normals, with one value per dim: shape (d,).

    `flip` marks dims that are reflected, x → 1 − x, so that `mean` is at least 0.
    `low` and `high` are the values of z = (x − mean)/σ at x = 0 and x = 1.
    log_low and log_high are log Φ(low) and log Φ(high), where Φ is the normal cdf.
    log_mass is the logarithm of Φ(high) − Φ(low).
    """

    flip: Array
    mean: Array
    sigma: Array
    low: Array
    high: Array
    log_low: Array
    log_high: Array
    log_mass: Array

    def score(self, x: Array) -> Array:
        """Return z = (x − mean)/σ at points x (..., d)."""
        return np.asarray((np.where(self.flip, 1.0 - x, x) - self.mean) / self.sigma)


@final
@dataclass(frozen=True, kw_only=True)
class TruncatedNormal(_Separable):
    """Product of normal densities, each cut to [0,1) and rescaled.

    Attributes
    ----------
    mean
        Mean before truncation: one number or one per dim. It may be up to 100 σ outside [0,1].
    sigma
        Standard deviation before truncation, above 0 and at most 100: one number or one per dim.

    Notes
    -----
    With z = (x − mean)/σ and the normal cdf Φ, the cdf is [Φ(z) − Φ(z₀)]/[Φ(z₁) − Φ(z₀)].
    The computation uses logarithms of Φ, which are accurate far into the left tail.
    A density with a mean below 0 is reflected, which turns its right tail into a left tail.
    Rounding of u causes errors of about 1e-14 at 10 σ, and of 1e-12 at 100 σ.
    """

    mean: float | tuple[float, ...] = per_dim(0.5)
    sigma: float | tuple[float, ...] = per_dim(0.2, above=0.0, most=_MAX_SIGMA)

    def _check(self) -> None:
        for mean, sigma in zip(self._each("mean"), self._each("sigma"), strict=True):
            if max(-mean, mean - 1.0) > _MAX_SIGMAS * sigma:
                raise ParameterError(
                    f"mean is {mean:g}, more than {_MAX_SIGMAS:g} sigma ({sigma:g}) outside [0,1]; "
                    "move it closer or make sigma larger."
                )

    @cached_property
    def _normal(self) -> _Normals:
        from scipy.special import log_ndtr

        mean, sigma = self._each("mean"), self._each("sigma")
        flip = mean < 0
        mean = np.where(flip, 1.0 - mean, mean)
        low, high = (0.0 - mean) / sigma, (1.0 - mean) / sigma
        log_low, log_high = log_ndtr(low), log_ndtr(high)
        log_mass = log_high + np.log(-np.expm1(log_low - log_high))
        return _Normals(flip, mean, sigma, low, high, log_low, log_high, log_mass)

    def reciprocal_integral(self) -> float:
        """Return Π π σ² mass [erfi(high/√2) − erfi(low/√2)].

        Here erfi(t) = 2/√π exp(t²) D(t), with Dawson's function D.
        The result is infinite if it exceeds the largest float (1e308).
        """
        from scipy.special import dawsn

        c = self._normal
        a, b = c.low / math.sqrt(2), c.high / math.sqrt(2)
        most = np.maximum(a**2, b**2)
        difference = dawsn(b) * np.exp(b**2 - most) - dawsn(a) * np.exp(a**2 - most)
        logarithms = np.log(2 * math.sqrt(math.pi) * c.sigma**2 * difference)
        with np.errstate(over="ignore"):
            return float(np.exp((logarithms + c.log_mass + most).sum()))

    def _pdf(self, x: Array) -> Array:
        c = self._normal
        log_scale = np.log(c.sigma * math.sqrt(2 * math.pi)) + c.log_mass
        return exponential((-0.5 * c.score(x) ** 2 - log_scale).sum(axis=-1), self.spec)

    def _sample(self, u: Array) -> Array:
        from scipy.special import ndtri_exp

        c = self._normal
        share = np.where(c.flip, 1.0 - u, u)
        ratio = np.exp(c.log_low - c.log_high)
        # A cdf of 0 has the logarithm −∞. Then z is also −∞, and is clipped to the lower end
        with np.errstate(divide="ignore"):
            log_cdf = c.log_high + np.log(share + (1.0 - share) * ratio)
        z = np.clip(ndtri_exp(np.minimum(log_cdf, 0.0)), c.low, c.high)
        x = np.clip(c.mean + c.sigma * z, 0.0, 1.0)
        return np.asarray(np.where(c.flip, 1.0 - x, x))

    def _invert(self, x: Array) -> Array:
        from scipy.special import log_ndtr

        c = self._normal
        # Compute [Φ(z) − Φ(low)]/mass as Φ(z)/mass (1 − Φ(low)/Φ(z))
        log_z = log_ndtr(c.score(x))
        share = np.exp(log_z - c.log_mass) * -np.expm1(np.minimum(c.log_low - log_z, 0.0))
        return np.asarray(np.clip(np.where(c.flip, 1.0 - share, share), 0.0, 1.0))


@final
@dataclass(frozen=True, kw_only=True)
class Power(_Separable):
    """Product of powers, p(x) = Π_i (a_i + 1) x_i^a_i.

    Attributes
    ----------
    exponent
        Exponent a, from −0.99 to 1000: one number for all dims or one per dim.
        For a < 0 the density is unbounded at 0; for a > 0 it vanishes at 0.
        The integral ∫1/p diverges for a ≥ 1.
    """

    exponent: float | tuple[float, ...] = per_dim(1.0, least=_LEAST_EXPONENT, most=_MOST_EXPONENT)

    @cached_property
    def _exponents(self) -> Array:
        return self._each("exponent")

    def reciprocal_integral(self) -> float:
        """Return Π 1/(1 − a²). It is infinite if an exponent is 1 or more."""
        a = self._exponents
        return float(np.prod(1.0 / ((1.0 - a) * (1.0 + a)))) if (a < 1).all() else math.inf

    def _pdf(self, x: Array) -> Array:
        a = self._exponents
        # For a < 0, 0^a is infinite. Powers of tiny x, and products of powers, may overflow
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            factors = (a + 1.0) * x**a
            product = factors.prod(axis=-1)
        # Points at which the product over dims is 0 · ∞ have measure 0
        return np.asarray(np.where(np.isnan(product), 0.0, product))

    def _sample(self, u: Array) -> Array:
        return np.asarray(u ** (1.0 / (self._exponents + 1.0)))

    def _invert(self, x: Array) -> Array:
        return np.asarray(x ** (self._exponents + 1.0))


@final
@dataclass(frozen=True, kw_only=True)
class Exponential(_Separable):
    """Product of densities p(x) = Π_i r_i exp(−r_i x_i)/(1 − exp(−r_i)): exponentials cut to [0,1).

    Attributes
    ----------
    rate
        Rate r, from −700 to 700: one number for all dims or one per dim.
        If r is below 0, the density rises. If r is 0, the density is uniform.
    """

    rate: float | tuple[float, ...] = per_dim(1.0, least=-_MOST_RATE, most=_MOST_RATE)

    @cached_property
    def _flat(self) -> Array:
        """For each dim, whether its rate is so small that the density counts as uniform."""
        return np.abs(self._each("rate")) < _NO_RATE

    @cached_property
    def _rates(self) -> Array:
        """Rates of all dims. Dims in which the density counts as uniform have the value 1."""
        return np.where(self._flat, 1.0, self._each("rate"))

    def reciprocal_integral(self) -> float:
        """Return Π [sinh(r/2)/(r/2)]², infinite if it exceeds the largest float."""
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
        # If the rate is 700, u = 1 gives x = ∞, which `sample` clips to the largest float below 1
        with np.errstate(divide="ignore"):
            return np.where(self._flat, u, np.log1p(u * np.expm1(-r)) / -r)

    def _invert(self, x: Array) -> Array:
        r = self._rates
        return np.where(self._flat, x, np.expm1(-r * x) / np.expm1(-r))


@final
@dataclass(frozen=True, kw_only=True)
class CosineWeighted(_Separable):
    """Product of cosines about the center, p(x) = Π_i (π/2) cos(π (x_i − ½)).

    Notes
    -----
    The term *cosine-weighted* has two meanings, which agree here.
    In flatland, x = ½ + θ/π is the angle of a direction above a line, with p(θ) = cos θ/2.
    On the hemisphere with cos θ/π per steradian, the polar angle θ has the density sin 2θ.
    In the coordinate x = 2θ/π, the density sin 2θ becomes the density p(x) of this class.
    The warp θ = arcsin √u is the warp of Malley's method [Pharr2016]_ (§13.6.3).
    The density is 0 at both ends, and ∫1/p diverges.
    """

    def reciprocal_integral(self) -> float:
        """Return infinity."""
        return math.inf

    def _pdf(self, x: Array) -> Array:
        from_end = np.minimum(x, 1.0 - x)  # p(1) is exactly 0
        return np.asarray((0.5 * math.pi * np.sin(math.pi * from_end)).prod(axis=-1))

    def _sample(self, u: Array) -> Array:
        from_end = np.arcsin(np.sqrt(np.minimum(u, 1.0 - u))) * (2.0 / math.pi)
        return np.where(u <= 0.5, from_end, 1.0 - from_end)

    def _invert(self, x: Array) -> Array:
        share = np.sin(0.5 * math.pi * np.minimum(x, 1.0 - x)) ** 2
        return np.where(x <= 0.5, share, 1.0 - share)


@final
@dataclass(frozen=True, kw_only=True)
class Tent(_Separable):
    """Product of tents. Each tent rises linearly from 0 to 2 at its peak and then falls to 0.

    Attributes
    ----------
    peak
        Position of the peak, from 0 to 1: one number for all dims or one per dim.
    """

    peak: float | tuple[float, ...] = per_dim(0.5, least=0.0, most=1.0)

    @cached_property
    def _peaks(self) -> Array:
        return self._each("peak")

    @cached_property
    def _sides(self) -> tuple[Array, Array]:
        """Lengths of the rising and the falling side. A length of 0 is replaced by 1."""
        c = self._peaks
        return np.where(c > 0, c, 1.0), np.where(c < 1, 1.0 - c, 1.0)

    @property
    def breaks(self) -> tuple[tuple[float, ...], ...]:
        """Position of the peak on each axis: the same in x and in u, because cdf(peak) = peak."""
        return tuple((c,) if 0 < c < 1 else () for c in self._peaks.tolist())

    def reciprocal_integral(self) -> float:
        """Return infinity, since the density falls linearly to 0."""
        return math.inf

    def _rising(self, x: Array) -> Array:
        """Whether coordinates of x or u lie below the peak, which has the same place in x and u."""
        return np.asarray((x < self._peaks) | (self._peaks == 1))

    def _heights(self, x: Array) -> tuple[Array, Array]:
        """Return the rising and the falling line at x, divided by the value at the peak."""
        left, right = self._sides
        return np.minimum(x, left) / left, np.minimum(1.0 - x, right) / right

    def _pdf(self, x: Array) -> Array:
        line = np.where(self._rising(x), *self._heights(x))
        return bounded_product(2.0 * line, self.spec)

    def _sample(self, u: Array) -> Array:
        left, right = self._sides
        return np.where(self._rising(u), np.sqrt(u * left), 1.0 - np.sqrt((1.0 - u) * right))

    def _invert(self, x: Array) -> Array:
        up, down = self._heights(x)
        return np.where(self._rising(x), x * up, 1.0 - (1.0 - x) * down)
