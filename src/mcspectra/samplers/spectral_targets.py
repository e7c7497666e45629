"""Sets in 2-D for a given target: a step, a radial power spectrum or a pair correlation.

Frequencies are given as ν = |m|/√n and distances as r√n.
The unit is the mean distance 1/√n of the points, so that one target applies to every count.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array, as_real_array, as_unit_points
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import real, settle, whole
from mcspectra.samplers.base import PlaneSampler
from mcspectra.samplers.optimised import OptimisedSampler, Report, minimize, random_points, wrap

__all__ = [
    "Profile",
    "RingLoss",
    "StepBlueNoise",
    "TargetPcf",
    "TargetSpectrum",
    "hankel",
    "piecewise_linear",
]

Profile: TypeAlias = Callable[[Array], Array]
"""Function with limit 1 at infinity: power as a function of ν, or pair correlation of r."""

_REACH = 2.0  # largest |m|/√n at which power is matched
# Largest |m|/√n at which power is matched if the target is a pair correlation.
# These frequencies resolve details of the pair correlation down to 1/8 of the mean distance.
_PCF_REACH = 4.0
# Arguments at which the transform of a target is checked for negative values.
# The transform of a target power is a pair correlation, and vice versa
_TRIED = np.linspace(0.0, 6.0, 601)
_LINE = np.linspace(0.0, 2 * _PCF_REACH, 1601)  # tabulated values of |m|/√n
_NEGATIVE = -1e-6  # Values below this limit count as negative; quadrature errors are 1e-9.
_LARGEST_STEP = 1 / math.sqrt(math.pi)
_MOST_KNOTS, _LARGEST_PLACE = 200, 4.0
_EPS = 1e-9  # tolerance of the non-uniform transforms
_NODES = 48  # number of Gauss-Legendre nodes per linear piece; enough for J0 up to 2π·4·4


class _MatchedSampler(PlaneSampler, OptimisedSampler):
    """Points optimized so that their radial mean power approaches a target."""

    other_dims: ClassVar[str] = "for other dims use gaussian-blue-noise"
    iterations: int

    @abstractmethod
    def _loss(self, n: int) -> RingLoss:
        """Return the loss of a set of `n` points: how far its spectrum is from the target."""

    def misfit(self, points: object) -> float:
        """Return the root-mean-square difference between the power of `points` and the target.

        The mean square is over all frequencies. The power of a frequency is the mean over its ring.
        The points have shape (n, 2).
        """
        x = as_unit_points(points, dims=2)
        power, target, sizes = self._loss(len(x)).rings(x)
        return float(np.sqrt(np.average((power - target) ** 2, weights=sizes)))

    def _optimize(self, n: int, keys: Array, report: Report) -> Array:
        return wrap(
            minimize(
                self._loss(n),
                random_points(keys, n, 2),
                iterations=self.iterations,
                longest=0.25 / math.sqrt(n),
                report=report,
            )
        )


@final
@dataclass(frozen=True, kw_only=True)
class StepBlueNoise(_MatchedSampler):
    """Points in 2-D with zero power below a cutoff frequency and constant power above it.

    Attributes
    ----------
    cutoff
        Cutoff ν in units of √n: mean power is 0 for |m| < ν √n, and 1 above.
        The largest ν is 1/√π = 0.564; a higher cutoff would need a negative density of pairs.
    iterations
        Largest number of descent steps.
    sets
        Largest number of different sets, see `OptimisedSampler`.

    References
    ----------
    [Heck2013]_.
    """

    cutoff: float = real(0.55, above=0.0)
    iterations: int = whole(200, least=1, most=10**6)

    def _check(self) -> None:
        if self.cutoff > _LARGEST_STEP:
            raise ParameterError(
                f"cutoff is {self.cutoff:g}; give at most 1/√π = 0.5642: a higher cutoff would "
                "need a negative density of pairs."
            )

    def _loss(self, n: int) -> RingLoss:
        return RingLoss(n, lambda nu: (nu >= self.cutoff).astype(float), _REACH)


@final
@dataclass(frozen=True, kw_only=True)
class TargetSpectrum(_MatchedSampler):
    """Points whose radial mean power follows a given piecewise linear curve; 2-D.

    Attributes
    ----------
    frequencies
        Values of |m|/√n at the knots: increasing, from 0 to 4.
    power
        Values of n⟨|S_m|²⟩ at the knots; constant before the first knot, 1 after the last knot.
        The power is matched up to |m| = 2 √n.
    iterations
        Largest number of descent steps.
    sets
        Largest number of different sets, see `OptimisedSampler`.

    Notes
    -----
    The optimization by descent starts from independent uniform points.
    The descent fits the mean power over rings of frequencies, which have width one.
    Single sets therefore follow the curve more closely than random fluctuations would allow.
    A target is refused if its pair correlation (its Hankel transform) is negative somewhere.
    No point sets have the power of a target with negative pair correlation.
    `misfit` measures the difference between the power of a set and the target.

    References
    ----------
    [Heck2013]_, [Zhou2012]_.
    """

    frequencies: tuple[float, ...] = (0.2, 0.8)
    power: tuple[float, ...] = (0.0, 1.0)
    iterations: int = whole(200, least=1, most=10**6)

    def _check(self) -> None:
        low, where = _least_transform(self, "frequencies", "power")
        if low < _NEGATIVE:
            raise ParameterError(
                f"No point set has this power: its pair correlation would be {low:.3g} at the "
                f"distance {where:.3g}/√n; lower the power at fewer low frequencies."
            )

    def _loss(self, n: int) -> RingLoss:
        return RingLoss(n, piecewise_linear(self.frequencies, self.power), _REACH)


@final
@dataclass(frozen=True, kw_only=True)
class TargetPcf(_MatchedSampler):
    """Points whose pair correlation follows a given piecewise linear curve; 2-D.

    Attributes
    ----------
    distances
        Distances of the knots, r√n: increasing, from 0 to 4.
    pcf
        Pair correlation at the knots: 1 for independent points.
        The curve is constant before the first knot, and 1 after the last knot.
    iterations
        Largest number of descent steps.
    sets
        Largest number of different sets, see `OptimisedSampler`.

    Notes
    -----
    A Hankel transform converts the curve to radial power.
    The power is matched up to |m| = 4 √n, as in `target-spectrum`.
    A curve with negative power somewhere is refused.

    References
    ----------
    [Oztireli2012]_, [Heck2013]_.
    """

    distances: tuple[float, ...] = (0.4, 0.6)
    pcf: tuple[float, ...] = (0.0, 1.0)
    iterations: int = whole(200, least=1, most=10**6)

    def _check(self) -> None:
        low, where = _least_transform(self, "distances", "pcf")
        if low < _NEGATIVE:
            raise ParameterError(
                f"No point set has this pair correlation: its power would be {low:.3g} at the "
                f"frequency {where:.3g} √n; keep the points less far apart."
            )

    def _loss(self, n: int) -> RingLoss:
        power = _power_of_pcf(self.distances, self.pcf)
        return RingLoss(n, lambda nu: np.interp(nu, _LINE, power), _PCF_REACH)


def _least_transform(sampler: Any, places: str, values: str) -> tuple[float, float]:
    """Convert the knots of a target to tuples of floats: places, and values at these places.

    Check that the places increase and that the values are not negative.

    Return the smallest value of the transformed target, and its place.
    Power and pair correlation are transforms of each other.
    """
    x, y = (as_real_array(name, getattr(sampler, name)) for name in (places, values))
    if x.ndim != 1 or x.shape != y.shape or not 0 < x.size <= _MOST_KNOTS:
        raise ParameterError(
            f"{places} and {values} have shapes {x.shape} and {y.shape}; give two lists of "
            f"equal length, 1 to {_MOST_KNOTS}."
        )
    good = np.isfinite(x).all() and x[0] >= 0 and x[-1] <= _LARGEST_PLACE
    if not good or (np.diff(x) <= 0).any():
        raise ParameterError(
            f"{places} are {x.tolist()}; give increasing numbers from 0 to {_LARGEST_PLACE:g}."
        )
    if not np.isfinite(y).all() or y.min() < 0:
        raise ParameterError(f"{values} is {y.tolist()}; give finite numbers that are at least 0.")
    settle(sampler, **{places: tuple(x.tolist()), values: tuple(y.tolist())})
    transform = hankel(piecewise_linear(x, y), x, _TRIED)
    return float(transform.min()), float(_TRIED[transform.argmin()])


# The result is cached, because many small sets are often made for the same pair correlation.
@lru_cache(maxsize=8)
def _power_of_pcf(distances: tuple[float, ...], pcf: tuple[float, ...]) -> Array:
    """Return the power that belongs to a pair correlation, at the frequencies `_LINE`."""
    return np.maximum(hankel(piecewise_linear(distances, pcf), np.array(distances), _LINE), 0.0)


def piecewise_linear(places: Any, values: Any) -> Profile:
    """Return the linear interpolant that is constant before the first place, 1 after the last."""

    def profile(x: Array) -> Array:
        return np.asarray(np.interp(x, places, values, right=1.0))

    return profile


def hankel(profile: Profile, places: Array, at: Array) -> Array:
    """Return 1 + 2π ∫ (profile(t) − 1) J0(2π t s) t dt at every s in `at`.

    The function converts power to pair correlation and back:
    power − 1 and pair correlation − 1 are Hankel transforms of each other.
    The knots of the function `profile`, including the end of its range, are given as `places`.
    """
    from scipy.special import j0

    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    ends = np.unique(np.concatenate([[0.0], places]))
    half = np.diff(ends) / 2
    t = (ends[:-1] + half)[:, None] + half[:, None] * nodes
    w = half[:, None] * weights * (profile(t) - 1.0) * t
    waves: Array = j0(2 * np.pi * np.multiply.outer(at, t.ravel()))
    transform: Array = 1.0 + 2 * np.pi * np.sum(waves * w.ravel(), axis=-1)
    return transform


@final
class RingLoss:
    """Squared difference between the mean power of rings of frequencies and a target, in 2-D.

    Ring r holds the frequencies with |m| within ½ of r.
    The loss is Σ (mean power − target)² over rings.
    The target of a ring is averaged over the same frequencies as the power.
    Rings have equal weights, because the lowest rings matter most.
    If a ring's weight were its number of frequencies,
    the errors of the lowest rings would be ten times as large.

    Parameters
    ----------
    n
        Number of points.
    target
        The target power n⟨|S_m|²⟩, as a function of |m|/√n.
    reach
        The largest |m|/√n that is used.
    """

    def __init__(self, n: int, target: Profile, reach: float) -> None:
        import finufft

        self.n = n
        most = max(2, round(reach * n**0.5))
        self.axis = np.arange(-most, most + 1)
        norm = np.hypot(self.axis[:, None], self.axis)
        # Ring number of each frequency; frequencies outside all rings get the number 0
        self.ring = np.where(norm < most + 0.5, np.round(norm), 0).astype(np.int64)
        self.sizes = np.maximum(np.bincount(self.ring.ravel()), 1)
        self.target = self._ring_means(target(norm / n**0.5))
        plans = [(1, -1, 1), (2, 1, 2)]  # FINUFFT's type, sign and number of transforms
        self.plans: list[Any] = [
            finufft.Plan(
                kind, norm.shape, n_trans=many, eps=_EPS, isign=sign, nthreads=1, showwarn=0
            )
            for kind, sign, many in plans
        ]

    def __call__(self, points: Array) -> tuple[float, Array]:
        """Return the loss and its gradient (n, 2)."""
        angles = 2 * np.pi * wrap(points)
        for plan in self.plans:
            plan.setpts(angles[:, 0].copy(), angles[:, 1].copy())
        sums = self.plans[0].execute(np.ones(self.n, np.complex128))
        excess = self._ring_means(sums.real**2 + sums.imag**2) / self.n - self.target
        excess[0] = 0.0
        pull = (excess / self.sizes)[self.ring] * sums
        waves = np.stack([pull * self.axis[:, None], pull * self.axis])
        slopes = self.plans[1].execute(waves)
        gradient = (-8 * np.pi / self.n) * np.ascontiguousarray(slopes.imag.T)
        return float(np.sum(excess**2)), gradient

    def rings(self, points: Array) -> tuple[Array, Array, Array]:
        """Return mean power, target and number of frequencies of the rings |m| = 1, 2, …"""
        angles = 2 * np.pi * points
        self.plans[0].setpts(angles[:, 0].copy(), angles[:, 1].copy())
        sums = self.plans[0].execute(np.ones(self.n, np.complex128))
        power = self._ring_means(np.abs(sums) ** 2) / self.n
        return power[1:], self.target[1:], self.sizes[1:]

    def _ring_means(self, values: Array) -> Array:
        total: Array = np.bincount(self.ring.ravel(), values.ravel())
        return total / self.sizes
