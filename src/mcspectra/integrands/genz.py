"""The six families of test integrands of [Genz1984]_, with exact integrals in any dimension."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import each_axis, real
from mcspectra.integrands.base import Breaks, Integrand, any_dims, per_axis

__all__ = [
    "Genz",
    "GenzContinuous",
    "GenzCornerPeak",
    "GenzDiscontinuous",
    "GenzGaussian",
    "GenzOscillatory",
    "GenzProduct",
    "GenzProductPeak",
]

# The integral of the corner peak in d dims is computed as an integral over y = log s.
# The range of y is from `_LEFT` to `_RIGHT` + log(d + 1). Outside, the integrand is negligible
_LEFT, _RIGHT = -40.0, 5.0


@dataclass(frozen=True, kw_only=True)
class Genz(Integrand):
    """Base class of the functions of [Genz1984]_.

    Parameters
    ----------
    a
        Difficulty along the axes, > 0: one number for all axes or one for each.
    u
        Positions of peaks, kinks or jumps in [0,1]: one number for all axes or one for each.
        In ``genz-oscillatory``, u is one number: a phase in cycles.
        ``genz-corner-peak`` does not have the parameter u.
    dims
        Number of dims.
    """

    a: float | Sequence[float] = per_axis(5.0, above=0.0)
    _a = each_axis("a")


@dataclass(frozen=True, kw_only=True)
class GenzProduct(Genz):
    """Base class of Genz's functions that are products over axes."""

    u: float | Sequence[float] = per_axis(0.3, least=0.0, most=1.0)
    _u = each_axis("u")
    dims: int = any_dims()

    @abstractmethod
    def _factors(self, x: Array) -> Array:
        """Return the values of all factors at points x. Both have the shape (..., d)."""

    @abstractmethod
    def _means(self) -> Array:
        """Return the integrals of all factors: (d,)."""

    def _check(self) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            if not math.isfinite(self._integral() ** 2):
                raise ParameterError(f"{self.spec} overflows in {self.dims} dims; lower a.")

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(self._factors(x).prod(axis=-1))

    def _integral(self) -> float:
        return float(self._means().prod())


@final
@dataclass(frozen=True, kw_only=True)
class GenzOscillatory(Genz):
    """Genz's oscillatory function, f(x) = cos(2π u + Σ_i a_i x_i)."""

    u: float = real(0.3)
    dims: int = any_dims()

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(np.cos(2.0 * np.pi * self.u + x @ self._a))

    def _integral(self) -> float:
        return float(self._fourier(np.zeros(self.dims)).real)

    def _fourier(self, m: Array) -> Array:
        """Add two waves. For each, ∫ exp(iax − 2πimx) dx = e^{iθ} sin θ/θ with θ = a/2 − πm."""
        waves = []
        for sign in (1.0, -1.0):
            theta = 0.5 * sign * self._a - np.pi * m
            phase = 2.0 * np.pi * sign * self.u + theta.sum(axis=-1)
            waves.append(np.exp(1j * phase) * np.sinc(theta / np.pi).prod(axis=-1))
        return np.asarray(0.5 * (waves[0] + waves[1]))


@final
class GenzProductPeak(GenzProduct):
    """Genz's product peak, f(x) = Π_i 1/(a_i⁻² + (x_i − u_i)²)."""

    def _factors(self, x: Array) -> Array:
        return np.asarray(1.0 / (self._a**-2.0 + (x - self._u) ** 2))

    def _means(self) -> Array:
        a, u = self._a, self._u
        return np.asarray(a * (np.arctan(a * (1.0 - u)) + np.arctan(a * u)))


@final
@dataclass(frozen=True, kw_only=True)
class GenzCornerPeak(Genz):
    """Genz's corner peak, f(x) = (1 + Σ_i a_i x_i)^−(d+1)."""

    dims: int = any_dims()

    def _evaluate(self, x: Array) -> Array:
        return np.asarray((1.0 + x @ self._a) ** -(self.dims + 1.0))

    def _integral(self) -> float:
        # The alternating sum over 2^d corners suffers from cancellation.
        # Use the integral ∫_0^∞ s^d e^{-s}/d! Π (1 − e^{−a_i s})/(a_i s) ds with s = e^y instead.
        # All terms of this integral are positive, so there is no cancellation
        d = self.dims
        # Steps of a quarter of a standard deviation give rounding accuracy
        step = 0.25 / math.sqrt(d + 64.0)
        y = np.arange(_LEFT, math.log(d + 1.0) + _RIGHT, step)
        s = np.exp(y)
        t = self._a[:, None] * s
        logs = (d + 1.0) * y - s - math.lgamma(d + 1.0) + np.log(-np.expm1(-t) / t).sum(axis=0)
        return float(np.exp(logs).sum() * step)


@final
class GenzGaussian(GenzProduct):
    """Genz's Gaussian, f(x) = exp(−Σ_i a_i² (x_i − u_i)²)."""

    def _factors(self, x: Array) -> Array:
        return np.asarray(np.exp(-((self._a * (x - self._u)) ** 2)))

    def _means(self) -> Array:
        from scipy.special import erf

        a, u = self._a, self._u
        return np.asarray(0.5 * math.sqrt(math.pi) / a * (erf(a * (1.0 - u)) + erf(a * u)))


@final
class GenzContinuous(GenzProduct):
    """Genz's continuous function f(x) = exp(−Σ_i a_i |x_i − u_i|), with kinks at u."""

    @property
    def breaks(self) -> Breaks:
        """The kinks inside (0, 1)."""
        return tuple((u,) if 0.0 < u < 1.0 else () for u in self._u.tolist())

    def _factors(self, x: Array) -> Array:
        return np.asarray(np.exp(-self._a * np.abs(x - self._u)))

    def _means(self) -> Array:
        a, u = self._a, self._u
        return np.asarray(-(np.expm1(-a * u) + np.expm1(-a * (1.0 - u))) / a)


@final
class GenzDiscontinuous(GenzProduct):
    """Genz's discontinuous function: exp(Σ_i a_i x_i) where x_0 < u_0 and x_1 < u_1, else 0.

    Only the first two components of u matter.
    """

    @property
    def _ends(self) -> Array:
        return np.where(np.arange(self.dims) < 2, self._u, 1.0)

    @property
    def breaks(self) -> Breaks:
        """The jumps inside (0, 1)."""
        return tuple((u,) if 0.0 < u < 1.0 else () for u in self._ends.tolist())

    def _factors(self, x: Array) -> Array:
        inside = (x < self._ends) | (np.arange(self.dims) >= 2)
        return np.where(inside, np.exp(self._a * x), 0.0)

    def _means(self) -> Array:
        return np.asarray(np.expm1(self._a * self._ends) / self._a)
