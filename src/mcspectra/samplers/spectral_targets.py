"""Sets in 2-D for a given target: a step, a radial power spectrum or a pair correlation.

Frequencies are given as |m|/√n and distances as r√n, in units of the mean distance 1/√n of the
points, so that one target serves every count.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real, as_real_array, as_unit_points
from mcspectra.core.errors import ParameterError
from mcspectra.samplers._descent import minimize, random_points, wrap
from mcspectra.samplers._spectrum_matching import Profile, RingLoss, hankel, piecewise_linear
from mcspectra.samplers.base import check_dims
from mcspectra.samplers.optimised import OptimisedSampler, check_sets

__all__ = ["StepBlueNoise", "TargetPcf", "TargetSpectrum"]

_REACH = 2.0  # |m|/√n up to where power is matched
_PCF_REACH = 4.0  # the same for pair correlations: details of ⅛ of the mean distance
_TRIED = np.linspace(0.0, 6.0, 601)  # where transforms of targets are looked at
_LINE = np.linspace(0.0, 2 * _PCF_REACH, 1601)  # beyond the corners of the square of frequencies
_NEGATIVE = -1e-6  # what counts as negative there: quadrature leaves 1e-9
_LARGEST_STEP = 1 / math.sqrt(math.pi)
_MOST_KNOTS, _LARGEST_PLACE = 200, 4.0


@final
@dataclass(frozen=True, kw_only=True)
class StepBlueNoise(OptimisedSampler):
    """Points without power below a cutoff frequency and flat power above it; 2-D.

    Attributes
    ----------
    cutoff
        ν, in units of √n: mean power 0 for |m| < ν √n, 1 above. Up to 1/√π = 0.564: beyond,
        a step would need a negative density of pairs.
    iterations
        Most steps of the descent.
    sets
        Reuse of sets, see `OptimisedSampler`.

    References
    ----------
    Heck, Schlömer, Deussen (2013), "Blue noise sampling with controlled aliasing",
    doi 10.1145/2487228.2487233.
    """

    name: ClassVar[str] = "step-blue-noise"
    max_dims: ClassVar[int | None] = 2
    dims: int = 2
    cutoff: float = 0.55
    iterations: int = 200

    def __post_init__(self) -> None:
        _check(self)
        cutoff = as_real("cutoff", self.cutoff, above=0.0)
        if cutoff > _LARGEST_STEP:
            raise ParameterError(
                f"cutoff is {cutoff:g}; give at most 1/√π = 0.5642: a higher cutoff would need a "
                "negative density of pairs."
            )
        object.__setattr__(self, "cutoff", cutoff)

    def misfit(self, points: object) -> float:
        """Return how far the radial power of `points` (n, 2) is from the target, see `ring_misfit`."""
        return ring_misfit(self._loss, points)

    def _loss(self, n: int) -> RingLoss:
        return RingLoss(n, lambda nu: (nu >= self.cutoff).astype(float), _REACH)

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        return _matched(self._loss(n), n, keys, self.iterations, report)


@final
@dataclass(frozen=True, kw_only=True)
class TargetSpectrum(OptimisedSampler):
    """Points whose radial mean power follows a given piecewise linear curve; 2-D.

    Attributes
    ----------
    frequencies
        |m|/√n of the knots, increasing, 0 to 4.
    power
        n⟨|S_m|²⟩ at the knots; constant before the first knot, 1 after the last. Matched up to
        |m| = 2 √n.
    iterations
        Most steps of the descent.
    sets
        Reuse of sets, see `OptimisedSampler`.

    Notes
    -----
    The mean power of rings of frequencies one wide is fitted, by descent from independent uniform
    points, so that single sets follow the curve closer than chance would have it. Targets whose
    pair correlation (the Hankel transform) is negative somewhere do not exist, and are refused.
    `misfit` says how near a set has come.

    References
    ----------
    Heck, Schlömer, Deussen (2013), "Blue noise sampling with controlled aliasing",
    doi 10.1145/2487228.2487233. Zhou, Huang, Wei, Wang (2012), "Point sampling with general noise
    spectrum", doi 10.1145/2185520.2185572.
    """

    name: ClassVar[str] = "target-spectrum"
    max_dims: ClassVar[int | None] = 2
    dims: int = 2
    frequencies: tuple[float, ...] = (0.2, 0.8)
    power: tuple[float, ...] = (0.0, 1.0)
    iterations: int = 200

    def __post_init__(self) -> None:
        _check(self)
        _check_knots(self, "frequencies", "power")
        low, where = _least_transform(self._profile, self.frequencies)
        if low < _NEGATIVE:
            raise ParameterError(
                f"No point set has this power: its pair correlation would be {low:.3g} at the "
                f"distance {where:.3g}/√n; lower the power at fewer low frequencies."
            )

    def misfit(self, points: object) -> float:
        """Return how far the radial power of `points` (n, 2) is from the target, see `ring_misfit`."""
        return ring_misfit(self._loss, points)

    @property
    def _profile(self) -> Profile:
        return piecewise_linear(np.array(self.frequencies), np.array(self.power))

    def _loss(self, n: int) -> RingLoss:
        return RingLoss(n, self._profile, _REACH)

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        return _matched(self._loss(n), n, keys, self.iterations, report)


@final
@dataclass(frozen=True, kw_only=True)
class TargetPcf(OptimisedSampler):
    """Points whose pair correlation follows a given piecewise linear curve; 2-D.

    Attributes
    ----------
    distances
        r√n of the knots, increasing, 0 to 4.
    pcf
        Pair correlation at the knots, 1 for independent points; constant before the first knot,
        1 after the last.
    iterations
        Most steps of the descent.
    sets
        Reuse of sets, see `OptimisedSampler`.

    Notes
    -----
    The curve is turned into radial power by a Hankel transform, and that is matched up to
    |m| = 4 √n as `target-spectrum` does; a curve whose power is negative somewhere is refused.

    References
    ----------
    Öztireli, Gross (2012), "Analysis and synthesis of point distributions based on pair
    correlation", doi 10.1145/2366145.2366189. Heck, Schlömer, Deussen (2013), "Blue noise sampling
    with controlled aliasing", doi 10.1145/2487228.2487233.
    """

    name: ClassVar[str] = "target-pcf"
    max_dims: ClassVar[int | None] = 2
    dims: int = 2
    distances: tuple[float, ...] = (0.4, 0.6)
    pcf: tuple[float, ...] = (0.0, 1.0)
    iterations: int = 200

    def __post_init__(self) -> None:
        _check(self)
        _check_knots(self, "distances", "pcf")
        low, where = _least_transform(self._correlation, self.distances)
        if low < _NEGATIVE:
            raise ParameterError(
                f"No point set has this pair correlation: its power would be {low:.3g} at the "
                f"frequency {where:.3g} √n; keep the points less far apart."
            )

    def misfit(self, points: object) -> float:
        """Return how far the radial power of `points` (n, 2) is from the target, see `ring_misfit`."""
        return ring_misfit(self._loss, points)

    @property
    def _correlation(self) -> Profile:
        return piecewise_linear(np.array(self.distances), np.array(self.pcf))

    def _loss(self, n: int) -> RingLoss:
        power = _power(self.distances, self.pcf)
        return RingLoss(n, lambda nu: np.interp(nu, _LINE, power), _PCF_REACH)

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        return _matched(self._loss(n), n, keys, self.iterations, report)


@lru_cache(maxsize=8)  # many small sets have one target
def _power(distances: tuple[float, ...], pcf: tuple[float, ...]) -> Array:
    """Return the power of a pair correlation along `_LINE`."""
    places = np.array(distances)
    return np.maximum(hankel(piecewise_linear(places, np.array(pcf)), places, _LINE), 0.0)


def ring_misfit(loss: Callable[[int], RingLoss], points: object) -> float:
    """Return the root of the mean square difference of power and target over all frequencies."""
    x = as_unit_points(points, dims=2)
    power, target, sizes = loss(len(x)).rings(x)
    return float(np.sqrt(np.average((power - target) ** 2, weights=sizes)))


def _matched(
    loss: RingLoss, n: int, keys: Array, iterations: int, report: Callable[[float], None]
) -> Array:
    return wrap(
        minimize(
            loss,
            random_points(keys, n, 2),
            iterations=iterations,
            longest=0.25 / math.sqrt(n),
            report=report,
        )
    )


def _check(sampler: StepBlueNoise | TargetSpectrum | TargetPcf) -> None:
    check_dims(sampler)
    if sampler.dims != 2:
        raise ParameterError(f"{sampler.name}: dims is {sampler.dims!r}; it must be 2.")
    check_sets(sampler)
    iterations = as_integer("iterations", sampler.iterations, least=1, most=10**6)
    object.__setattr__(sampler, "iterations", iterations)


def _check_knots(sampler: TargetSpectrum | TargetPcf, places: str, values: str) -> None:
    """Make both fields tuples of floats: increasing places, values that are not negative."""
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
    object.__setattr__(sampler, places, tuple(x.tolist()))
    object.__setattr__(sampler, values, tuple(y.tolist()))


def _least_transform(profile: Profile, places: tuple[float, ...]) -> tuple[float, float]:
    """Return the least value of the other description of a target, and where it is."""
    values = hankel(profile, np.array(places), _TRIED)
    return float(values.min()), float(_TRIED[values.argmin()])
