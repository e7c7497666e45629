"""Test integrands of physics: Keister's function, narrow peaks and a ridge, and a ray through a medium."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array, as_reals
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import checked, real
from mcspectra.integrands._quadrature import gauss_rule
from mcspectra.integrands.analytic import Gaussian
from mcspectra.integrands.base import Breaks, Integrand, any_dims
from mcspectra.integrands.finance import gaussian_inputs

__all__ = ["GaussianPeaks", "GaussianRidge", "Keister", "RatioTracking"]


def _as_centers(name: str, given: object) -> tuple[float, ...]:
    if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray) or not len(given):
        raise ParameterError(f"{name} is {given!r}; give a list of numbers.")
    return as_reals(name, given, len(given), least=0.0, most=1.0)


@final
@dataclass(frozen=True, kw_only=True)
class Keister(Integrand):
    """Keister's function: ∫ cos|y| e^{−|y|²} dy over all of ℝ^d, with y = Φ⁻¹(x)/√2.

    Of [Keister1996]_: f(x) = π^{d/2} cos(|Φ⁻¹(x)|/√2), with the integral π^{d/2} ₁F₁(d/2; ½; −¼).

    Parameters
    ----------
    dims
        Number of dims.
    """

    dims: int = any_dims()

    def _evaluate(self, x: Array) -> Array:
        length = np.sqrt(0.5 * (gaussian_inputs(x) ** 2).sum(axis=-1))
        return np.asarray(math.pi ** (0.5 * self.dims) * np.cos(length))

    def _integral(self) -> float:
        from scipy.special import hyp1f1

        return float(math.pi ** (0.5 * self.dims) * hyp1f1(0.5 * self.dims, 0.5, -0.25))


@final
@dataclass(frozen=True, kw_only=True)
class GaussianPeaks(Integrand):
    """The mean of normal densities at a few places on the diagonal, as of vegas.

    After [Lepage2021]_.

    Parameters
    ----------
    centers
        Places (c, …, c), in [0,1].
    width
        Standard deviation, > 0.
    dims
        Number of dims.
    """

    centers: Sequence[float] = checked(_as_centers, (0.23, 0.39, 0.74))
    width: float = real(0.05, above=0.0)
    dims: int = any_dims()

    def landmarks(self) -> Array:
        """The places."""
        return np.repeat(np.array(self.centers)[:, None], self.dims, axis=1)

    @property
    def _parts(self) -> list[Gaussian]:
        return [Gaussian(center=c, width=self.width, dims=self.dims) for c in self.centers]

    @property
    def _height(self) -> float:
        return (math.sqrt(2.0 * math.pi) * self.width) ** -self.dims / len(self.centers)

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(self._height * sum(part._evaluate(x) for part in self._parts))

    def _integral(self) -> float:
        return self._height * sum(part._integral() for part in self._parts)

    def _fourier(self, m: Array) -> Array:
        return np.asarray(self._height * sum(part._fourier(m) for part in self._parts))


@final
@dataclass(frozen=True, kw_only=True)
class GaussianRidge(Integrand):
    """The mean of normal densities all along a piece of the diagonal, as of vegas.

    After [Lepage2021]_.

    Parameters
    ----------
    start, stop
        Ends of the ridge, (start, …, start) and (stop, …, stop), 0 ≤ start < stop ≤ 1.
    width
        Standard deviation of the densities, > 0.
    dims
        Number of dims.
    """

    start: float = real(0.25, least=0.0, most=1.0)
    stop: float = real(0.75, least=0.0, most=1.0)
    width: float = real(0.05, above=0.0)
    dims: int = any_dims()

    def _check(self) -> None:
        if self.start >= self.stop:
            raise ParameterError(f"start is {self.start:g}, stop {self.stop:g}; give start < stop.")

    def landmarks(self) -> Array:
        """Places along the ridge."""
        return np.linspace([self.start] * self.dims, [self.stop] * self.dims, 9)

    def _evaluate(self, x: Array) -> Array:
        # Σ(x_i − t)² = Σ(x_i − mean)² + d (mean − t)²: along the ridge a difference of Φ
        from scipy.special import ndtr

        mean = x.mean(axis=-1)
        across = ((x - mean[..., None]) ** 2).sum(axis=-1) / (2.0 * self.width**2)
        scale = math.sqrt(self.dims) / self.width
        low, high = (self.start - mean) * scale, (self.stop - mean) * scale
        along = np.where(low > 0.0, ndtr(-low) - ndtr(-high), ndtr(high) - ndtr(low))
        height = (math.sqrt(2.0 * math.pi) * self.width) ** (1.0 - self.dims)
        height /= (self.stop - self.start) * math.sqrt(self.dims)
        return np.asarray(height * np.exp(-across) * along)

    def _integral(self) -> float:
        from scipy.special import ndtr

        node, weight = gauss_rule(20)  # on pieces of one width at most: good to rounding
        panels = math.ceil((self.stop - self.start) / self.width)
        step = (self.stop - self.start) / panels
        t = self.start + step * (np.arange(panels)[:, None] + node)
        inside = (ndtr((1.0 - t) / self.width) - ndtr(-t / self.width)) ** self.dims
        return float((inside @ weight).mean())


@final
@dataclass(frozen=True, kw_only=True)
class RatioTracking(Integrand):
    """Transmittance of a ray of length 1 through a medium, by ratio tracking.

    Of [Novak2014]_. The extinction is σ(t) = extinction (1 + contrast cos(2π cycles t)). Tentative collisions t_1 < t_2 < …
    of a rate μ ≥ σ, one for each input, multiply the estimate by 1 − σ(t)/μ. After the last input
    the rest of the ray is exact: the integral is exp(−∫σ) in any number of dims.

    Parameters
    ----------
    extinction
        Its mean over a cycle, > 0.
    contrast
        In [0,1].
    cycles
        Waves along the ray, ≥ 0.
    majorant
        μ as a multiple of the largest extinction, ≥ 1.
    dims
        Number of tentative collisions.
    """

    extinction: float = real(2.0, above=0.0)
    contrast: float = real(0.8, least=0.0, most=1.0)
    cycles: float = real(3.0, least=0.0)
    majorant: float = real(1.0, least=1.0)
    dims: int = any_dims()

    @property
    def _rate(self) -> float:
        return self.majorant * self.extinction * (1.0 + self.contrast)

    @property
    def breaks(self) -> Breaks:
        """Where the first collision leaves the ray: a jump across the first axis."""
        place = -math.expm1(-self._rate)
        return ((place,) if place < 1.0 else (), *[()] * (self.dims - 1))

    def _depth(self, t: Array) -> Array:
        """∫_0^t σ."""
        return self.extinction * t * (1.0 + self.contrast * np.sinc(2.0 * self.cycles * t))

    def _evaluate(self, x: Array) -> Array:
        flights = -np.log1p(-np.minimum(x, 1.0 - 2.0**-53)) / self._rate
        t = np.minimum(flights.cumsum(axis=-1), 1.0)
        density = self.extinction * (1.0 + self.contrast * np.cos(2.0 * np.pi * self.cycles * t))
        ratios = np.where(t < 1.0, 1.0 - density / self._rate, 1.0).prod(axis=-1)
        return np.asarray(ratios * np.exp(self._depth(t[..., -1]) - self._depth(np.ones(()))))

    def _integral(self) -> float:
        return math.exp(-float(self._depth(np.ones(()))))
