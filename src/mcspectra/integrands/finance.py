"""Options on an asset whose logarithm is a Brownian motion with drift, as functions of uniform inputs.

Prices at d equal dates t_k up to T are S_k = S_0 exp((r − σ²/2) t_k + σ √T W_k), W = A z, z_i = Φ⁻¹(x_i).
`brownian_factor` chooses A: how f depends on each axis, but not its integral [Glasserman2003]_.

The arithmetic mean and the barrier have no closed form, but are expectations of Markov chains of one
variable, found by one-step quadratures (like [CarverhillClewlow1990]_) to eleven digits.
"""

from __future__ import annotations

import functools
import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import choice, real
from mcspectra.integrands._quadrature import Estimate, gauss_rule
from mcspectra.integrands.base import Breaks, Integrand, any_dims

__all__ = [
    "AsianOption",
    "BarrierOption",
    "DigitalOption",
    "Option",
    "brownian_factor",
    "gaussian_inputs",
]

_REACH = 9.0  # standard deviations beyond which a normal density has 1e-19
_PANEL, _NODES = 3.0, (10, 14)  # standard deviations of a step, with so many Gauss nodes
_MOST_DATES = 128  # 3 s


def gaussian_inputs(x: Array) -> Array:
    """Standard normal numbers Φ⁻¹(x) of uniform ones; those of 0 and 1 are finite."""
    from scipy.special import ndtri

    return np.asarray(ndtri(np.clip(x, 2.0**-54, 1.0 - 2.0**-53)))


@functools.lru_cache(maxsize=16)
def brownian_factor(dates: int, construction: str) -> Array:
    """Factor A of the covariance min(k, l)/dates of a Brownian motion, W = A z: (dates, dates).

    ``"incremental"``: z_k is the step to date k. ``"bridge"``: z_0 is the end of the path, each other one
    the middle of a gap [Caflisch1997]_. ``"pca"``: z_k is the k-th principal component
    [AkessonLehoczky2000]_.
    """
    if construction == "incremental":
        factor = np.tri(dates) / math.sqrt(dates)
    elif construction == "pca":
        k = np.arange(1, dates + 1)
        angle = (2.0 * k - 1.0) * math.pi / (2.0 * dates + 1.0)
        sizes = 1.0 / (math.sqrt(dates * (2.0 * dates + 1.0)) * np.sin(0.5 * angle))
        factor = np.sin(k[:, None] * angle) * sizes
    else:
        # Halve the gaps, widest first; row 0 is the start
        path = np.zeros((dates + 1, dates))
        path[dates, 0] = 1.0
        gaps, made = [(0, dates)], 1
        for left, right in gaps:
            if right - left > 1:
                middle = (left + right) // 2
                before, after = middle - left, right - middle
                path[middle] = (after * path[left] + before * path[right]) / (right - left)
                path[middle, made] = math.sqrt(before * after / (dates * (right - left)))
                gaps += [(left, middle), (middle, right)]
                made += 1
        factor = path[1:]
    factor.flags.writeable = False
    return factor


@dataclass(frozen=True, kw_only=True)
class Option(Integrand):
    """The discounted payoff of an option.

    Parameters
    ----------
    spot, strike, rate, volatility, maturity
        S_0, K, r and σ in a unit of time, and T.
    construction
        Of the path from uniform inputs: ``"incremental"``, ``"bridge"`` or ``"pca"``.
    dims
        Number of dates.
    """

    spot: float = real(100.0, above=0.0)
    strike: float = real(100.0, above=0.0)
    rate: float = real(0.05)
    volatility: float = real(0.2, above=0.0)
    maturity: float = real(1.0, above=0.0)
    construction: str = choice("incremental", "bridge", "pca")
    dims: int = any_dims()

    @abstractmethod
    def _payoff(self, returns: Array) -> Array:
        """Payoff of log S_k/S_0 (..., d): (...)."""

    @abstractmethod
    def _planes(self) -> list[tuple[Array, float]]:
        """Weights w (d,) and prices K for which f jumps or has a kink where Σ_k w_k log S_k = log K."""

    @property
    def breaks(self) -> Breaks:
        """Jumps and kinks that are across an axis."""
        from scipy.special import ndtr

        places: list[set[float]] = [set() for _ in range(self.dims)]
        means, factor = self._law
        for weights, price in self._planes():
            row = weights @ factor
            axes = np.flatnonzero(row)
            if len(axes) == 1:
                level = math.log(price / self.spot) - weights @ means
                places[axes[0]].add(float(ndtr(level / row[axes[0]])))
        return tuple(tuple(sorted(u for u in axis if 0.0 < u < 1.0)) for axis in places)

    @property
    def _law(self) -> tuple[Array, Array]:
        """Means (d,) of log S_k/S_0, and the factor (d, d) of their covariance."""
        drift = (self.rate - 0.5 * self.volatility**2) * self.maturity
        scale = self.volatility * math.sqrt(self.maturity)
        means = drift * np.arange(1, self.dims + 1) / self.dims
        return means, scale * brownian_factor(self.dims, self.construction)

    @property
    def _discount(self) -> float:
        return math.exp(-self.rate * self.maturity)

    def _evaluate(self, x: Array) -> Array:
        means, factor = self._law
        return np.asarray(self._discount * self._payoff(means + gaussian_inputs(x) @ factor.T))

    def _expected_call(
        self, following: Callable[[Array], Array], spot: float, lowest: float = -math.inf
    ) -> Estimate | None:
        """E max(spot e^{X_d} − K, 0) 1[all X_k > lowest], X_1 = R_1 and X_{k+1} = following(X_k) + R_{k+1}.

        R_k are the log returns of a step.
        """
        if self.dims > _MOST_DATES:
            return None
        drift = float(self._law[0][0])
        deviation = self.volatility * math.sqrt(self.maturity / self.dims)

        def value(order: int) -> float:
            node, weight = gauss_rule(order)
            # Carry the law of X_k on, as masses; means are those of X_{k+1} given X_k
            means, masses, center = np.array([drift]), np.array([1.0]), drift
            for k in range(1, self.dims):
                reach = _REACH * deviation * math.sqrt(k) + 2.0 * k * deviation**2
                low, high = max(lowest, center - reach), center + reach
                panels = max(1, math.ceil((high - low) / (_PANEL * deviation)))
                width = (high - low) / panels
                places = (low + width * (np.arange(panels)[:, None] + node)).ravel()
                density = np.exp(-0.5 * ((places[:, None] - means) / deviation) ** 2) @ masses
                masses = density * np.tile(weight, panels) * width
                masses /= deviation * math.sqrt(2.0 * math.pi)
                means = following(places) + drift
                center = float(following(np.array(center))) + drift
            return float(masses @ _call(means, deviation, spot, self.strike, lowest))

        coarse, fine = (self._discount * value(order) for order in _NODES)
        return Estimate(
            np.array([fine]), abs(fine - coarse), "one-step quadratures of a Markov chain"
        )


def _call(
    mean: Array, deviation: float, spot: float, strike: float, lowest: float = -math.inf
) -> Array:
    """E max(spot e^X − strike, 0) 1[X > lowest] of normal X [BlackScholes1973]_."""
    from scipy.special import ndtr

    distance = (mean - max(lowest, math.log(strike / spot))) / deviation
    forward = spot * np.exp(mean + 0.5 * deviation**2)
    return np.asarray(forward * ndtr(distance + deviation) - strike * ndtr(distance))


@final
@dataclass(frozen=True, kw_only=True)
class AsianOption(Option):
    """A call on the mean price at d dates, max(mean − strike, 0).

    The value of the geometric mean is that of [KemnaVorst1990]_.

    Parameters
    ----------
    average
        ``"geometric"``, whose value is exact, or ``"arithmetic"``; others as of ``Option``.
    """

    average: str = choice("geometric", "arithmetic")

    def _planes(self) -> list[tuple[Array, float]]:
        straight = self.average == "geometric" or self.dims == 1
        return [(np.full(self.dims, 1.0 / self.dims), self.strike)] if straight else []

    def _payoff(self, returns: Array) -> Array:
        if self.average == "geometric":
            mean = np.exp(returns.mean(axis=-1))
        else:
            mean = np.exp(returns).mean(axis=-1)
        return np.asarray(np.maximum(self.spot * mean - self.strike, 0.0))

    def _integral(self) -> float | None:
        if self.average == "arithmetic":
            return None
        means, factor = self._law
        deviation = math.sqrt((factor.mean(axis=0) ** 2).sum())
        return self._discount * float(_call(means.mean(), deviation, self.spot, self.strike))

    def _estimated_integral(self) -> Estimate | None:
        """Of the arithmetic mean: with X_{k+1} = log(1 + e^{X_k}) + R e^{X_d} has the law of Σ_k S_k/S_0."""
        if self.average == "geometric":
            return None
        return self._expected_call(lambda x: np.logaddexp(0.0, x), self.spot / self.dims)


@final
class DigitalOption(Option):
    """A digital call, 1 where the price at maturity is above the strike, else 0.

    The jump is across the first axis with ``construction="bridge"``, else oblique. The value is exact
    [BlackScholes1973]_. Parameters are those of ``Option``.
    """

    def _planes(self) -> list[tuple[Array, float]]:
        return [(np.eye(self.dims)[-1], self.strike)]

    def _payoff(self, returns: Array) -> Array:
        return np.where(returns[..., -1] > math.log(self.strike / self.spot), 1.0, 0.0)

    def _integral(self) -> float:
        from scipy.special import ndtr

        level = math.log(self.spot / self.strike) + self._law[0][-1]
        return self._discount * float(ndtr(level / self.volatility / math.sqrt(self.maturity)))


@final
@dataclass(frozen=True, kw_only=True)
class BarrierOption(Option):
    """A down-and-out call, max(S_T − strike, 0) if the price is above the barrier at all d dates.

    Parameters
    ----------
    barrier
        Less than the spot; others as of ``Option``.
    """

    barrier: float = real(90.0, above=0.0)

    def _check(self) -> None:
        if self.barrier >= self.spot:
            raise ParameterError(
                f"barrier is {self.barrier:g}, but the spot is {self.spot:g}; give less than that."
            )

    def _planes(self) -> list[tuple[Array, float]]:
        last = np.eye(self.dims)[-1]
        return [(last, self.strike), *((date, self.barrier) for date in np.eye(self.dims))]

    def _payoff(self, returns: Array) -> Array:
        alive = (returns > math.log(self.barrier / self.spot)).all(axis=-1)
        return alive * np.maximum(self.spot * np.exp(returns[..., -1]) - self.strike, 0.0)

    def _estimated_integral(self) -> Estimate | None:
        return self._expected_call(lambda x: x, self.spot, math.log(self.barrier / self.spot))
