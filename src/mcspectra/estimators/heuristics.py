"""Heuristics of multiple importance sampling: how techniques share the integral.

A heuristic gives weights w_t(x). They sum to 1 at every point that some technique can sample.
The estimator is I = Σ_t (1/n_t) Σ_k w_t f/p_t [VeachGuibas1995]_.
With q_t = n_t p_t, these heuristics are described in [Veach1997]_ §9.2:

* ``balance``: w_t = q_t / Σ_s q_s. For random points, Veach's Theorem 9.2 bounds its variance:
  other weights ≥ 0 have a variance that is smaller by at most (1/min n_t − 1/Σ n_t) I².
* ``power(beta=2)``: w_t = q_t^β / Σ_s q_s^β. β = 0 gives equal shares, and β → ∞ is `maximum`.
* ``cutoff(alpha=0.1)``: balance among techniques with q_t ≥ α max_s q_s; others have weight 0.
* ``maximum``: weight 1 for the largest q_t. Ties have equal shares, as in ``cutoff(alpha=1)``.

``optimal`` and ``variance-aware`` use a pilot of f.
The pilot is a quadrature, or a set of random points that the estimate does not use.
The weights do not depend on the samples of the estimate, so the estimate is unbiased.
The progressive estimator of [Kondapaneni2019]_ is not implemented.
The progressive estimator computes α from the samples that it weights, so it is biased.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import choice, real, whole
from mcspectra.core.registry import Registry, classes_of
from mcspectra.core.spec import Component, parse
from mcspectra.core.streams import Stream
from mcspectra.densities import Density
from mcspectra.densities.adaptive import mean_or_infinity
from mcspectra.integrands.base import Breaks, Derived, Integrand

__all__ = [
    "HEURISTICS",
    "Balance",
    "Combination",
    "Cutoff",
    "Heuristic",
    "Maximum",
    "Optimal",
    "Pilot",
    "PowerHeuristic",
    "Residual",
    "VarianceAware",
    "as_heuristic",
]

_GRID = 2049
_BISECTIONS = 45
_EDGE = 1e-12  # Breaks within this distance from the ends of [0,1] are dropped

_MOST_SAMPLES = 2**22
# Singular values of the matrix A below this fraction of the largest singular value count as 0.
# If a singular value is 0, some densities are identical, and identical densities share one α
_SINGULAR = 1e-10
# Upper limit of v_t = 1 + μ²/σ², which is infinite if all samples of a technique are equal
_MOST_FACTOR = 1e8
# Number of cells of a quadrature that only tests whether an integral diverges
_FEW_CELLS = 2**12


class Heuristic(Component, ABC):
    """A rule that combines techniques. `ratio` computes weights from q_t; `fit` uses f and p_t."""

    @property
    def bounded(self) -> bool:
        """Whether all w_t/p_t are bounded if at least one density is bounded from below."""
        return True

    @property
    def smooth(self) -> bool:
        """Whether weights are as smooth as the densities; if not, they may jump to 0."""
        return True

    @property
    def pilot_evaluations(self) -> int:
        """Number of evaluations of f in a pilot, or 0 if weights do not depend on f."""
        return 0

    def fit(
        self,
        integrand: Integrand,
        densities: Sequence[Density],
        shares: Sequence[float],
    ) -> Combination:
        """Return weights for an integrand and for densities with their counts or probabilities."""
        del integrand
        return Combination(self, tuple(densities), tuple(map(float, shares)))

    def adapt(self, pilot: Pilot) -> tuple[tuple[float, ...], Array | None]:
        """Return the shares and the control variate of a `Combination`, estimated by a pilot."""
        return tuple(map(float, pilot.shares)), None

    @abstractmethod
    def ratio(self, q: Array, technique: int) -> Array:
        """Return w_t/q_t (...) for the q (T, ...) of all techniques; 0 where all q are 0."""


HEURISTICS = Registry(
    "heuristic",
    "mcspectra.heuristics",
    classes_of(
        {
            "estimators.heuristics": "Balance Cutoff Maximum Optimal power=PowerHeuristic "
            "VarianceAware",
        }
    ),
    base=Heuristic,
)
"""Heuristics that can be named in spec strings."""


class Pilot(ABC):
    """Values of f and of all p_t at sampled points, for heuristics that use f.

    The samples are the rows of an array. Each row is a point of the common domain.
    For a renderer, a row describes a light path, in a format that its subclass of `Pilot` defines.

    Attributes
    ----------
    shares
        Counts n_t of the techniques, up to a common factor, (T,).
    channels
        Number of channels of f, or 0 if f is scalar.
    """

    shares: Array
    channels: int

    @abstractmethod
    def points(self, technique: int, count: int, seed: int) -> Array:
        """Return `count` random points of a technique, (count, …)."""

    @abstractmethod
    def pdfs(self, x: Array) -> Array:
        """Return the densities p_t at k points, (T, k)."""

    @abstractmethod
    def values(self, x: Array) -> Array:
        """Return f at k points, (k, channels); a scalar f has one channel."""

    def system(self, x: Array) -> Array:
        """Return the integrands of A, p_s p_t/q, and of b, f p_s/q, at k points: (k, T, T + C)."""
        p = self.pdfs(x)
        q = self.shares @ p
        over = np.divide(p, q, out=np.zeros_like(p), where=q > 0)
        right = np.concatenate([p.T, self.values(x)], axis=1)
        return np.asarray(over.T[:, :, None] * right[:, None, :])

    def moments(self, x: Array) -> Array:
        """Return f and f²/p_t where p_t > 0, as (k, T, 2); f is the mean over channels."""
        p = self.pdfs(x).T
        f = np.broadcast_to(self.values(x).mean(axis=1)[:, None], p.shape)
        square = np.divide(f * f, p, out=np.zeros_like(p), where=p > 0)
        return np.stack([np.where(p > 0, f, 0.0), square], axis=-1)

    def quadrature(self, function: Callable[[Array], Array]) -> Array:  # noqa: ARG002
        """Return the integrals of one function, `system` or `moments`, over the common domain.

        Raises
        ------
        ParameterError
            If the techniques have no common domain.
        """
        raise ParameterError(
            "These techniques share no domain to integrate over; give pilot='samples'."
        )


@final
@dataclass(frozen=True, eq=False)
class Combination:
    """The weights of an estimator, from a heuristic and its densities.

    Attributes
    ----------
    heuristic
        Rule that gives w_t from q_t = shares[t] p_t.
    densities
        p_t.
    shares
        Counts n_t up to a common factor. The heuristic `variance-aware` multiplies them by factors.
    control
        Coefficients α_t of the control variate of `optimal`, (T,) or (T, channels), or None.
        Σ_t α_t p_t is subtracted from f, and Σ_t α_t is added to the estimate.
    """

    heuristic: Heuristic
    densities: tuple[Density, ...]
    shares: tuple[float, ...]
    control: Array | None = None

    def over_density(self, technique: int, x: Array) -> Array:
        """Return w_t/p_t (...) at points x (..., d)."""
        q = np.stack([c * p.pdf(x) for c, p in zip(self.shares, self.densities, strict=True)])
        return np.asarray(self.shares[technique] * self.heuristic.ratio(q, technique))

    @cached_property
    def infinite(self) -> bool:
        """Whether ∫ Σ_t (w_t/p_t)² p_t diverges. If so, Var(S_0) is infinite.

        For `Heuristic.bounded` weights, the integral converges if ∫1/p_t does for one technique t.
        The integral may converge even if all ∫1/p_t diverge: densities may be 0 at opposite ends.
        """
        finite = [math.isfinite(p.reciprocal_integral()) for p in self.densities]
        if all(finite) or (any(finite) and self.heuristic.bounded):
            return False

        def second_moment(x: Array) -> Array:
            """Return Σ_t (w_t/p_t)² p_t (...) at points x (..., d)."""
            pdfs = [density.pdf(x) for density in self.densities]
            with np.errstate(divide="ignore", over="ignore"):
                parts = [self.over_density(t, x) ** 2 * pdf for t, pdf in enumerate(pdfs)]
            return np.asarray(np.where(sum(pdfs) == 0, np.inf, sum(parts)))

        dims = self.densities[0].dims
        return not math.isfinite(mean_or_infinity(second_moment, dims, most_cells=_FEW_CELLS))

    def weights(self, x: Array) -> Array:
        """Return all w_t (T, ...) at points x (..., d). Their sum is 1 where any p_t > 0."""
        techniques = range(len(self.densities))
        return np.stack([self.over_density(t, x) * self.densities[t].pdf(x) for t in techniques])

    @cached_property
    def breaks(self) -> tuple[float, ...]:
        """Points of a 1-D domain at which the weights may jump or kink. Empty in more dims.

        Crossings of densities are found on a grid of 2049 points.
        If two crossings lie in one cell, both are missed.
        """
        if self.densities[0].dims > 1:
            return ()
        found = _density_breaks(self.densities)
        if self.heuristic.smooth:
            return tuple(sorted(found))

        def active(x: Array) -> Array:
            return np.stack([self.over_density(t, x) > 0 for t in range(len(self.densities))])

        # Find the ends of intervals in which a technique has a positive weight, by bisection
        grid = np.linspace(0.0, 1.0, _GRID)[:, None]
        changes = (active(grid[:-1]) != active(grid[1:])).any(axis=0)
        low, high = grid[:-1][changes], grid[1:][changes]
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            left = (active(low) == active(middle)).all(axis=0)[:, None]
            low, high = np.where(left, middle, low), np.where(left, high, middle)
        return tuple(sorted(found | set(high[:, 0].tolist())))

    def offset(self, x: Array) -> Array:
        """Return Σ_t α_t p_t, (...) or (..., channels), at points x (..., d)."""
        assert self.control is not None  # `offset` is called only if there is a control variate
        pdfs = np.stack([p.pdf(x) for p in self.densities], axis=-1)
        return np.asarray(pdfs @ self.control)


@final
@dataclass(frozen=True, kw_only=True)
class PowerHeuristic(Heuristic):
    """The power heuristic: weights q_t^β / Σ q_s^β.

    Attributes
    ----------
    beta
        Exponent β ≥ 0; β = 1 is `balance`.
    """

    name: ClassVar[str] = "power"
    beta: float = real(2.0, least=0.0)

    @property
    def bounded(self) -> bool:
        """Whether β ≥ 1. Then w_t/p_t is bounded: it is proportional to p_t^(β−1) as p_t → 0."""
        return self.beta >= 1.0

    def ratio(self, q: Array, technique: int) -> Array:
        """Return q_t^(β−1) / Σ q_s^β. Scaling all q by max q prevents overflow and underflow."""
        largest = q.max(axis=0)
        scaled = np.divide(q, largest, out=np.zeros_like(q), where=largest > 0)
        # With β = 0, a technique that cannot sample x must have no share, although 0⁰ is 1
        powers = np.where(scaled > 0, scaled**self.beta, 0.0)
        own = scaled[technique]
        part = own ** (self.beta - 1.0) if self.beta >= 1.0 else _divided(powers[technique], own)
        return _divided(part, largest * powers.sum(axis=0))


@final
@dataclass(frozen=True, kw_only=True)
class Balance(Heuristic):
    """The balance heuristic: weights q_t / Σ q_s."""

    def ratio(self, q: Array, technique: int) -> Array:
        del technique
        return _divided(np.ones(q.shape[1:]), q.sum(axis=0))


@final
@dataclass(frozen=True, kw_only=True)
class Cutoff(Heuristic):
    """The balance heuristic for techniques with q_t ≥ α max q; all others have weight 0.

    Attributes
    ----------
    alpha
        The cutoff α, from 0 (equal to `balance`) to 1 (equal to `maximum`).
    """

    alpha: float = real(0.1, least=0.0, most=1.0)

    @property
    def smooth(self) -> bool:
        return self.alpha == 0.0

    def ratio(self, q: Array, technique: int) -> Array:
        """Return 1 over the sum of the q_s above the cutoff, or 0 if q_t is below the cutoff."""
        kept = q >= self.alpha * q.max(axis=0)
        total = np.where(kept, q, 0.0).sum(axis=0)
        return _divided(kept[technique].astype(np.float64), total)


@final
@dataclass(frozen=True, kw_only=True)
class Maximum(Heuristic):
    """Weight 1 for the technique with the largest q_t; ties have equal shares."""

    @property
    def smooth(self) -> bool:
        return False

    def ratio(self, q: Array, technique: int) -> Array:
        return Cutoff(alpha=1.0).ratio(q, technique)


@dataclass(frozen=True, kw_only=True)
class _Piloted(Heuristic):
    """A balance heuristic whose parameters `adapt` estimates from a pilot."""

    pilot: str = choice("samples", "quadrature")
    samples: int = whole(4096, least=2, most=_MOST_SAMPLES)
    seed: int = whole(0, least=0)

    @property
    def pilot_evaluations(self) -> int:
        """Number of random pilot points, or 0 if the pilot is a quadrature."""
        return self.samples if self.pilot == "samples" else 0

    def ratio(self, q: Array, technique: int) -> Array:
        """Return the ratio w_t/q_t of the `balance` heuristic."""
        return Balance().ratio(q, technique)

    def fit(
        self, integrand: Integrand, densities: Sequence[Density], shares: Sequence[float]
    ) -> Combination:
        """Estimate the shares and the control variate from the pilot."""
        parts = _Parts(integrand, tuple(densities), np.asarray(shares, np.float64))
        return Combination(self, parts.densities, *self.adapt(parts))


@final
@dataclass(frozen=True, kw_only=True)
class Optimal(_Piloted):
    """Weights with the least variance for random points [Kondapaneni2019]_; some may be negative.

    Let q = Σ n_t p_t. The weights are w_t = α_t p_t/f + (n_t p_t/q)(1 − Σ_s α_s p_s/f).
    The coefficients α solve A α = b, with A_st = ∫ p_s p_t/q and b_t = ∫ f p_t/q.
    With these weights, a sample of technique t has the weighted value w_t f/p_t =

        α_t + n_t (f − Σ_s α_s p_s)/q,

    The same values result from the balance heuristic for f with the control variate Σ α_s p_s.
    The weighted value is also defined where f is 0, and each channel has its own α.
    If densities are (nearly) identical, A is singular. The solution of least norm is then used.
    All solutions have the same sum Σ α_s p_s.

    Attributes
    ----------
    pilot
        How the integrals A_st and b_t are computed, from which α follows.
        ``"samples"`` uses random points of all techniques in proportion to their counts.
        ``"quadrature"`` makes α as accurate as the quadrature.
    samples
        Number of pilot points of all techniques together, at least 2; n does not include them.
    seed
        Seed of the random points of the pilot.
    """

    def adapt(self, pilot: Pilot) -> tuple[tuple[float, ...], Array]:
        """Return the given counts, and α as (T,) or (T, channels)."""
        if self.pilot == "quadrature":
            found = pilot.quadrature(pilot.system)
        else:
            # Estimate the matrices [A, b] (T, T + C) from pilot points by the balance heuristic
            wanted = self.samples * pilot.shares / pilot.shares.sum()
            counts = np.maximum(1, np.rint(wanted).astype(np.int64))
            drawn = [pilot.points(t, m, self.seed) for t, m in enumerate(counts.tolist())]
            x = np.concatenate(drawn)
            q = counts @ pilot.pdfs(x)
            weight = np.divide(1.0, q, out=np.zeros_like(q), where=q > 0)
            found = np.tensordot(weight, pilot.system(x), axes=1)
        techniques = len(pilot.shares)
        matrix, right = found[:, :techniques], found[:, techniques:]
        alpha = np.linalg.lstsq(matrix, right, rcond=_SINGULAR)[0]
        return tuple(pilot.shares.tolist()), alpha if pilot.channels else alpha[:, 0]


@final
@dataclass(frozen=True, kw_only=True)
class VarianceAware(_Piloted):
    """The balance heuristic with counts multiplied by factors v_t [Grittmann2019]_.

    v_t is the second moment of one random sample of f/p_t, divided by its variance σ_t².
    The weights are w_t = v_t n_t p_t / Σ_s v_s n_s p_s with v_t = 1 + μ_t²/σ_t², at most 10⁸.
    The balance heuristic is derived from second moments of f/p_t.
    With counts multiplied by v_t, the weights are derived from the variances of f/p_t instead.
    Therefore a technique of low variance gets more weight.
    If f has several channels, v_t is computed from their mean.

    Attributes
    ----------
    pilot
        Source of the moments. ``"samples"``: the same number of random points of each technique.
        ``"quadrature"``: numerical integrals.
    samples
        Number of pilot points of all techniques together, at least 2; n does not include them.
    seed
        Seed of the random points of the pilot.
    """

    def adapt(self, pilot: Pilot) -> tuple[tuple[float, ...], None]:
        """Return the counts n_t times the factors v_t, and None: there is no control variate."""
        techniques = len(pilot.shares)
        if self.pilot == "quadrature":
            found = pilot.quadrature(pilot.moments)
        else:
            # Estimate the mean and the mean square of f/p_t from random points of each technique
            found = np.empty((techniques, 2))
            for t in range(techniques):
                x = pilot.points(t, max(2, self.samples // techniques), self.seed)
                pdf = pilot.pdfs(x)[t]
                weight = np.divide(1.0, pdf, out=np.zeros_like(pdf), where=pdf > 0)
                found[t] = np.mean(weight[:, None] * pilot.moments(x)[:, t], axis=0)
        mean, square = found.T
        variance = np.maximum(square - mean**2, mean**2 / _MOST_FACTOR)
        factor = 1.0 + np.divide(mean**2, variance, out=np.zeros_like(mean), where=variance > 0)
        return tuple((pilot.shares * factor).tolist()), None


@final
@dataclass(frozen=True)
class Residual(Derived):
    """The difference f − Σ α_t p_t between f and the control variate of the optimal weights.

    The difference f − Σ α_t p_t is the integrand in the domain view.
    """

    text = "{0.integrand.spec} less its control variate"
    integrand: Integrand
    combination: Combination

    @property
    def breaks(self) -> Breaks:
        """Breaks of f; in 1-D also breaks of the densities."""
        return _breaks(self.integrand, self.combination.densities)

    def _evaluate(self, x: Array) -> Array:
        return np.asarray(self.integrand(x) - self.combination.offset(x))

    def _integral(self) -> Any:
        control = self.combination.control
        exact = self.integrand.integral_source == "exact" and control is not None
        return self.integrand.integral - control.sum(axis=0) if exact else None  # type: ignore[union-attr]


@final
@dataclass(frozen=True)
class _Parts(Pilot):
    """A pilot for an integrand f and densities p_t that are functions on the unit cube."""

    integrand: Integrand
    densities: tuple[Density, ...]
    shares: Array

    @property
    def channels(self) -> int:  # type: ignore[override]
        return self.integrand.channels

    def pdfs(self, x: Array) -> Array:
        return np.stack([p.pdf(x) for p in self.densities])

    def values(self, x: Array) -> Array:
        return self.integrand(x).reshape(len(x), -1)

    def points(self, technique: int, count: int, seed: int) -> Array:
        density, stream = self.densities[technique], Stream.from_rng(seed).child(technique)
        u = stream.uniforms(0, 1, count * density.primary_dims)
        return density.sample(u.reshape(count, -1))

    def quadrature(self, function: Callable[[Array], Array]) -> Array:
        shape = function(np.full((1, self.integrand.dims), 0.5)).shape[1:]
        found = _Packed(self.integrand, self.densities, function, int(np.prod(shape))).integral
        return np.asarray(found).reshape(shape)


@final
@dataclass(frozen=True, eq=False)
class _Packed(Derived):
    """An integrand whose channels are several functions, so that one quadrature integrates all."""

    name: ClassVar[str] = "pilot"
    text = "pilot of {0.integrand.spec}"
    integrand: Integrand
    densities: tuple[Density, ...]
    function: Callable[[Array], Array]
    size: int

    @property
    def channels(self) -> int:  # type: ignore[override]
        return self.size

    @property
    def breaks(self) -> Breaks:
        return _breaks(self.integrand, self.densities)

    def _evaluate(self, x: Array) -> Array:
        flat = x.reshape(-1, self.dims)
        return self.function(flat).reshape(*x.shape[:-1], self.channels)

    def _integral(self) -> None:
        return None


def _breaks(integrand: Integrand, densities: Sequence[Density]) -> Breaks:
    """Return breaks of f; in 1-D also breaks of the warps, mapped to the domain."""
    if integrand.dims > 1:
        return integrand.breaks
    return (tuple(sorted({*integrand.breaks[0], *_density_breaks(densities)})),)


def _density_breaks(densities: Sequence[Density]) -> set[float]:
    """Return domain points at which 1-D densities may jump or kink: their warped breaks.

    Both sides of a break are included, because p may be 0 on a whole interval next to it.
    """
    found: set[float] = set()
    for density in densities:
        if len(density.breaks) == 1:
            places = np.array([0.0, *density.breaks[0], 1.0])
            sides = np.concatenate([places[:-1], np.nextafter(places[1:], 0.0)])
            found.update(density.sample(sides[:, None])[:, 0].tolist())
    return {x for x in found if _EDGE < x < 1.0 - _EDGE}


def as_heuristic(given: object) -> Heuristic:
    """Return a heuristic, given as an object or as a spec string such as ``"power(beta=3)"``.

    Raises
    ------
    UnknownName, SpecError
        If the spec does not name a heuristic, or if it cannot be read.
    ParameterError
        If a parameter is out of range, or `given` has another type.
    """
    if isinstance(given, Heuristic):
        return given
    if not isinstance(given, str):
        raise ParameterError(
            f"heuristic is {given!r:.80}; give a spec string such as 'balance', one of "
            f"{', '.join(HEURISTICS)}."
        )
    made: Heuristic = HEURISTICS.build(parse(given))
    return made


def _divided(part: Array, total: Array) -> Array:
    """Return part/total, or 0 if the total is 0."""
    return np.asarray(np.divide(part, total, out=np.zeros_like(total), where=total > 0))
