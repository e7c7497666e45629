"""Densities in closed form, products over the dims: uniform, linear, truncated normal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_reals
from mcspectra.core.errors import ParameterError
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.densities.base import Density, bounded_product, exponential, plain, store_integer

__all__ = ["Linear", "TruncatedNormal", "Uniform"]

_MAX_DIMS = 1024
_MAX_SIGMAS = 100.0
_MAX_SIGMA = 100.0


@final
@dataclass(frozen=True, kw_only=True)
class Uniform(Density):
    """Uniform density, p = 1; the warp is the identity."""

    name: ClassVar[str] = "uniform"
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        store_integer(self, "dims", least=1, most=_MAX_DIMS)

    def reciprocal_integral(self) -> float:
        """1."""
        return 1.0

    def _pdf(self, x: Array) -> Array:
        return np.ones(x.shape[:-1])

    def _sample(self, u: Array) -> Array:
        return u

    def _invert(self, x: Array) -> Array:
        return x


@final
@dataclass(frozen=True, kw_only=True)
class Linear(Density):
    """Product of linear densities, p(x) = Π_i (1 + s_i (x_i − ½)).

    Attributes
    ----------
    slope
        s, within [−2, 2]: one number for all dims or one a dim. At ±2 the density falls to 0 at an
        end and ∫1/p diverges.

    Notes
    -----
    The cdf of one dim, low·x + s x²/2 with low = 1 − s/2 = p(0), is inverted by the root
    2u / (low + √D); D = low² + 2 s u is written as high² − 2 s (1 − u), high = p(1), for s < 0: both
    are sums of positive terms, so that nothing cancels at s → 0 nor at s = ±2.
    """

    name: ClassVar[str] = "linear"
    dims: int = DEFAULT_DIMS
    slope: float | tuple[float, ...] = 1.0

    def __post_init__(self) -> None:
        store_integer(self, "dims", least=1, most=_MAX_DIMS)
        as_reals("slope", self.slope, self.dims, least=-2.0, most=2.0)
        object.__setattr__(self, "slope", plain(self.slope))

    @cached_property
    def _slopes(self) -> Array:
        return np.array(as_reals("slope", self.slope, self.dims))

    def reciprocal_integral(self) -> float:
        """Π ln((1 + s/2)/(1 − s/2))/s, infinite where a slope is ±2."""
        return math.prod(_reciprocal_of_line(0.5 * s) for s in self._slopes.tolist())

    def _pdf(self, x: Array) -> Array:
        s = self._slopes
        # Both written from the end where the density is low
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


@final
@dataclass(frozen=True, kw_only=True)
class TruncatedNormal(Density):
    """Product of normal densities cut to [0,1) and rescaled.

    Attributes
    ----------
    mean
        Mean before cutting: one number or one a dim. It may lie outside [0,1], up to 100 sigma away.
    sigma
        Standard deviation before cutting, above 0 and at most 100: one number or one a dim.

    Notes
    -----
    With z = (x − mean)/σ and Φ the normal cdf, the cdf is [Φ(z) − Φ(z₀)]/[Φ(z₁) − Φ(z₀)]. Logarithms
    of Φ carry it far into the left tail; where the mean is below 0 the density is reflected, so that
    the right tail is never met. Rounding of u costs about 1e-14 at 10 sigma, 1e-12 at 100.
    """

    name: ClassVar[str] = "truncated-normal"
    dims: int = DEFAULT_DIMS
    mean: float | tuple[float, ...] = 0.5
    sigma: float | tuple[float, ...] = 0.2

    def __post_init__(self) -> None:
        store_integer(self, "dims", least=1, most=_MAX_DIMS)
        sigmas = as_reals("sigma", self.sigma, self.dims, above=0.0, most=_MAX_SIGMA)
        means = as_reals("mean", self.mean, self.dims)
        for mean, sigma in zip(means, sigmas, strict=True):
            if max(-mean, mean - 1.0) > _MAX_SIGMAS * sigma:
                raise ParameterError(
                    f"mean is {mean:g}, more than {_MAX_SIGMAS:g} sigma ({sigma:g}) outside [0,1]; "
                    "move it closer or make sigma larger."
                )
        object.__setattr__(self, "mean", plain(self.mean))
        object.__setattr__(self, "sigma", plain(self.sigma))

    @cached_property
    def _normal(self) -> _CutNormal:
        means = np.array(as_reals("mean", self.mean, self.dims))
        return _CutNormal.of(means, np.array(as_reals("sigma", self.sigma, self.dims)))

    def reciprocal_integral(self) -> float:
        """Exact, by Dawson's function; infinite where it exceeds the largest float (1e308)."""
        return self._normal.reciprocal_integral()

    def _pdf(self, x: Array) -> Array:
        return exponential(self._normal.log_pdf(x), self.spec)

    def _sample(self, u: Array) -> Array:
        return self._normal.sample(u)

    def _invert(self, x: Array) -> Array:
        return self._normal.invert(x)


@final
@dataclass(frozen=True)
class _CutNormal:
    """The arithmetic of truncated normals; all fields have one value a dim, shape (d,).

    `flip` marks dims that are reflected, x → 1 − x, so that `mean` is at least 0; `low` and `high`
    are z at x = 0 and 1; log_low, log_high and log_mass are log Φ(low), log Φ(high) and log of
    their difference.
    """

    flip: Array
    mean: Array
    sigma: Array
    low: Array
    high: Array
    log_low: Array
    log_high: Array
    log_mass: Array

    @staticmethod
    def of(mean: Array, sigma: Array) -> _CutNormal:
        from scipy.special import log_ndtr

        flip = mean < 0
        mean = np.where(flip, 1.0 - mean, mean)
        low, high = (0.0 - mean) / sigma, (1.0 - mean) / sigma
        log_low, log_high = log_ndtr(low), log_ndtr(high)
        log_mass = log_high + np.log(-np.expm1(log_low - log_high))
        return _CutNormal(flip, mean, sigma, low, high, log_low, log_high, log_mass)

    def log_pdf(self, x: Array) -> Array:
        z = (np.where(self.flip, 1.0 - x, x) - self.mean) / self.sigma
        log_scale = np.log(self.sigma * math.sqrt(2 * math.pi)) + self.log_mass
        return np.asarray((-0.5 * z**2 - log_scale).sum(axis=-1))

    def sample(self, u: Array) -> Array:
        from scipy.special import ndtri_exp

        share = np.where(self.flip, 1.0 - u, u)
        ratio = np.exp(self.log_low - self.log_high)
        with np.errstate(divide="ignore"):  # share 0 and ratio 0: the logarithm is −∞, z too
            log_cdf = self.log_high + np.log(share + (1.0 - share) * ratio)
        z = np.clip(ndtri_exp(np.minimum(log_cdf, 0.0)), self.low, self.high)
        x = np.clip(self.mean + self.sigma * z, 0.0, 1.0)
        return np.asarray(np.where(self.flip, 1.0 - x, x))

    def invert(self, x: Array) -> Array:
        from scipy.special import log_ndtr

        z = (np.where(self.flip, 1.0 - x, x) - self.mean) / self.sigma
        # [Φ(z) − Φ(low)]/mass, as Φ(z)/mass (1 − Φ(low)/Φ(z))
        log_z = log_ndtr(z)
        share = np.exp(log_z - self.log_mass) * -np.expm1(np.minimum(self.log_low - log_z, 0.0))
        return np.asarray(np.clip(np.where(self.flip, 1.0 - share, share), 0.0, 1.0))

    def reciprocal_integral(self) -> float:
        """Π π σ² mass [erfi(high/√2) − erfi(low/√2)], erfi(t) = 2/√π exp(t²) D(t)."""
        from scipy.special import dawsn

        a, b = self.low / math.sqrt(2), self.high / math.sqrt(2)
        most = np.maximum(a**2, b**2)
        difference = dawsn(b) * np.exp(b**2 - most) - dawsn(a) * np.exp(a**2 - most)
        logarithms = np.log(2 * math.sqrt(math.pi) * self.sigma**2 * difference)
        with np.errstate(over="ignore"):
            return float(np.exp((logarithms + self.log_mass + most).sum()))


def _reciprocal_of_line(t: float) -> float:
    """∫1/(1 + 2t (x − ½)) dx = artanh(t)/t for t in [−1, 1]."""
    if abs(t) == 1.0:
        return math.inf
    return math.atanh(t) / t if t else 1.0
