"""Heuristics of multiple importance sampling: how the techniques share an integrand.

A heuristic gives weights w_t(x) that sum to 1 wherever any technique can sample. The estimator is
I = Σ_t (1/n_t) Σ_k w_t f/p_t [VeachGuibas1995]_. With q_t = n_t p_t and the names of [Veach1997]_
§9.2:

* ``balance``: w_t = q_t / Σ_s q_s. With random points, no other weights ≥ 0 have a variance that is
  lower by more than (1/min n_t − 1/Σ n_t) I² (his Theorem 9.2).
* ``power(beta=2)``: w_t = q_t^β / Σ_s q_s^β. β = 0 gives equal shares, β → ∞ is `maximum`.
* ``cutoff(alpha=0.1)``: balance among techniques with q_t ≥ α max_s q_s, 0 for the others.
* ``maximum``: weight 1 for the largest q_t. Ties share equally, as in ``cutoff(alpha=1)``.

``optimal`` and ``variance-aware`` use f, through a pilot: a quadrature, or random points that the
estimate does not use. The weights do not depend on the estimate's own samples, so the estimate
stays unbiased. (The progressive estimator of [Kondapaneni2019]_ solves for α from the samples that
it weights. It is consistent but biased, and not implemented.)
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
_EDGE = 1e-12  # Distance from the ends of [0,1] within which breaks are dropped

_MOST_SAMPLES = 2**22
_SINGULAR = 1e-10  # Relative singular value below which densities share one α
# Cap of v_t = 1 + μ²/σ² for a technique whose samples are all equal
_MOST_FACTOR = 1e8
# Cells of an integral that is only tested for divergence, which shows long before its value
_FEW_CELLS = 2**12


class Heuristic(Component, ABC):
    """A rule that combines techniques: `ratio` gives weights from q_t, `fit` uses f and p_t."""

    @property
    def bounded(self) -> bool:
        """Whether w_t/p_t is bounded if at least one density is bounded from below."""
        return True

    @property
    def smooth(self) -> bool:
        """Whether weights are as smooth as the densities; otherwise they jump to 0."""
        return True

    @property
    def pilot_evaluations(self) -> int:
        """Number of evaluations of f by a pilot; 0 if weights do not depend on f."""
        return 0

    def fit(
        self,
        integrand: Integrand,
        densities: Sequence[Density],
        shares: Sequence[float],
    ) -> Combination:
        """Return the weights for an integrand, its densities and their counts or probabilities."""
        del integrand
        return Combination(self, tuple(densities), tuple(map(float, shares)))

    def adapt(self, pilot: Pilot) -> tuple[tuple[float, ...], Array | None]:
        """Return `shares` and `control` of the `Combination` that a pilot suggests."""
        return tuple(map(float, pilot.shares)), None

    @abstractmethod
    def ratio(self, q: Array, technique: int) -> Array:
        """Return w_t/q_t (...) for q (T, ...) of all techniques, 0 where all q are 0."""


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
"""Heuristics that spec strings can name."""


class Pilot(ABC):
    """Access to f and all p_t at sampled points, for heuristics that use f.

    Points are rows of an array that only the pilot interprets: points of a shared domain, or
    records of a renderer's path.

    Attributes
    ----------
    shares
        n_t up to a common factor, (T,).
    channels
        Number of channels of f, 0 if it is scalar.
    """

    shares: Array
    channels: int

    @abstractmethod
    def points(self, technique: int, count: int, seed: int) -> Array:
        """Return random points of a technique: (count, …)."""

    @abstractmethod
    def pdfs(self, x: Array) -> Array:
        """Return p_t at k points: (T, k)."""

    @abstractmethod
    def values(self, x: Array) -> Array:
        """Return f at k points: (k, channels), with one channel for scalars."""

    def system(self, x: Array) -> Array:
        """Return p_s p_t/q and f p_s/q, concatenated: (k, T, T + C)."""
        p = self.pdfs(x)
        q = self.shares @ p
        over = np.divide(p, q, out=np.zeros_like(p), where=q > 0)
        right = np.concatenate([p.T, self.values(x)], axis=1)
        return np.asarray(over.T[:, :, None] * right[:, None, :])

    def moments(self, x: Array) -> Array:
        """Return f and f²/p_t where p_t > 0, for f averaged over channels: (k, T, 2)."""
        p = self.pdfs(x).T
        f = np.broadcast_to(self.values(x).mean(axis=1)[:, None], p.shape)
        square = np.divide(f * f, p, out=np.zeros_like(p), where=p > 0)
        return np.stack([np.where(p > 0, f, 0.0), square], axis=-1)

    def quadrature(self, function: Callable[[Array], Array]) -> Array:  # noqa: ARG002
        """Return integrals of `system` or `moments` over the domain that the techniques share.

        Raises
        ------
        ParameterError
            If the techniques share no domain.
        """
        raise ParameterError(
            "These techniques share no domain to integrate over; give pilot='samples'."
        )


@final
@dataclass(frozen=True, eq=False)
class Combination:
    """Weights of one estimator: a heuristic with its densities.

    Attributes
    ----------
    heuristic
        Rule for w_t from q_t = shares[t] p_t.
    densities
        p_t.
    shares
        n_t up to a common factor, times the factors of `variance-aware`.
    control
        α_t (T,) or (T, channels) for the control variate of `optimal`, else None. Σ_t α_t p_t is
        subtracted from f and Σ_t α_t added to the estimate.
    """

    heuristic: Heuristic
    densities: tuple[Density, ...]
    shares: tuple[float, ...]
    control: Array | None = None

    def over_density(self, technique: int, x: Array) -> Array:
        """Return w_t/p_t at points x (..., d): (...)."""
        q = np.stack([c * p.pdf(x) for c, p in zip(self.shares, self.densities, strict=True)])
        return np.asarray(self.shares[technique] * self.heuristic.ratio(q, technique))

    @cached_property
    def infinite(self) -> bool:
        """Whether ∫ Σ_t (w_t/p_t)² p_t diverges, so that Var(S_0) is infinite.

        One convergent ∫1/p_t is enough for `Heuristic.bounded` weights. If all diverge, the
        densities may still complement each other, such as two that are 0 at opposite ends.
        """
        finite = [math.isfinite(p.reciprocal_integral()) for p in self.densities]
        if all(finite) or (any(finite) and self.heuristic.bounded):
            return False

        def second_moment(x: Array) -> Array:
            """Return Σ_t (w_t/p_t)² p_t at points x (..., d): (...)."""
            pdfs = [density.pdf(x) for density in self.densities]
            with np.errstate(divide="ignore", over="ignore"):
                parts = [self.over_density(t, x) ** 2 * pdf for t, pdf in enumerate(pdfs)]
            return np.asarray(np.where(sum(pdfs) == 0, np.inf, sum(parts)))

        dims = self.densities[0].dims
        return not math.isfinite(mean_or_infinity(second_moment, dims, most_cells=_FEW_CELLS))

    def weights(self, x: Array) -> Array:
        """Return w_t at points x (..., d): (T, ...); the sum is 1 where a density is positive."""
        techniques = range(len(self.densities))
        return np.stack([self.over_density(t, x) * self.densities[t].pdf(x) for t in techniques])

    @cached_property
    def breaks(self) -> tuple[float, ...]:
        """Points of a 1-D domain where the weights may jump or kink; empty in more dims.

        Crossings of densities are found on a grid of 2049 points. Two crossings in one cell are
        missed.
        """
        if self.densities[0].dims > 1:
            return ()
        found = _density_breaks(self.densities)
        if self.heuristic.smooth:
            return tuple(sorted(found))

        def active(x: Array) -> Array:
            return np.stack([self.over_density(t, x) > 0 for t in range(len(self.densities))])

        # Bisect for the points where the set of techniques with a positive weight changes
        grid = np.linspace(0.0, 1.0, _GRID)[:, None]
        changes = (active(grid[:-1]) != active(grid[1:])).any(axis=0)
        low, high = grid[:-1][changes], grid[1:][changes]
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            left = (active(low) == active(middle)).all(axis=0)[:, None]
            low, high = np.where(left, middle, low), np.where(left, high, middle)
        return tuple(sorted(found | set(high[:, 0].tolist())))

    def offset(self, x: Array) -> Array:
        """Return Σ_t α_t p_t at points x (..., d): (...) or (..., channels)."""
        assert self.control is not None  # This function is called only with a control variate
        pdfs = np.stack([p.pdf(x) for p in self.densities], axis=-1)
        return np.asarray(pdfs @ self.control)


@final
@dataclass(frozen=True, kw_only=True)
class PowerHeuristic(Heuristic):
    """q_t^β / Σ q_s^β.

    Attributes
    ----------
    beta
        β ≥ 0; 1 is `balance`.
    """

    name: ClassVar[str] = "power"
    beta: float = real(2.0, least=0.0)

    @property
    def bounded(self) -> bool:
        """Whether β ≥ 1: for p_t → 0, w_t/p_t is proportional to p_t^(β−1)."""
        return self.beta >= 1.0

    def ratio(self, q: Array, technique: int) -> Array:
        """Return q_t^(β−1) / Σ q_s^β from q/max q, which neither overflows nor underflows."""
        largest = q.max(axis=0)
        scaled = np.divide(q, largest, out=np.zeros_like(q), where=largest > 0)
        # 0⁰ is 1, but a technique that cannot sample x gets no share
        powers = np.where(scaled > 0, scaled**self.beta, 0.0)
        own = scaled[technique]
        part = own ** (self.beta - 1.0) if self.beta >= 1.0 else _divided(powers[technique], own)
        return _divided(part, largest * powers.sum(axis=0))


@final
@dataclass(frozen=True, kw_only=True)
class Balance(Heuristic):
    """q_t / Σ q_s: the balance heuristic."""

    def ratio(self, q: Array, technique: int) -> Array:
        del technique
        return _divided(np.ones(q.shape[1:]), q.sum(axis=0))


@final
@dataclass(frozen=True, kw_only=True)
class Cutoff(Heuristic):
    """Balance among techniques with q_t ≥ α max q, 0 for the others.

    Attributes
    ----------
    alpha
        α from 0, which is `balance`, to 1, which is `maximum`.
    """

    alpha: float = real(0.1, least=0.0, most=1.0)

    @property
    def smooth(self) -> bool:
        return self.alpha == 0.0

    def ratio(self, q: Array, technique: int) -> Array:
        """Return 1 over the sum of the q_s above the cutoff, 0 if q_t is below it."""
        kept = q >= self.alpha * q.max(axis=0)
        total = np.where(kept, q, 0.0).sum(axis=0)
        return _divided(kept[technique].astype(np.float64), total)


@final
@dataclass(frozen=True, kw_only=True)
class Maximum(Heuristic):
    """Weight 1 for the largest q_t, shared equally among ties."""

    @property
    def smooth(self) -> bool:
        return False

    def ratio(self, q: Array, technique: int) -> Array:
        return Cutoff(alpha=1.0).ratio(q, technique)


@dataclass(frozen=True, kw_only=True)
class _Piloted(Heuristic):
    """The balance heuristic with parameters that `adapt` estimates from a pilot."""

    pilot: str = choice("samples", "quadrature")
    samples: int = whole(4096, least=2, most=_MOST_SAMPLES)
    seed: int = whole(0, least=0)

    @property
    def pilot_evaluations(self) -> int:
        """`samples`; a quadrature is not counted."""
        return self.samples if self.pilot == "samples" else 0

    def ratio(self, q: Array, technique: int) -> Array:
        """Return the ratio of `balance`."""
        return Balance().ratio(q, technique)

    def fit(
        self, integrand: Integrand, densities: Sequence[Density], shares: Sequence[float]
    ) -> Combination:
        """Estimate shares and control from the pilot."""
        parts = _Parts(integrand, tuple(densities), np.asarray(shares, np.float64))
        return Combination(self, parts.densities, *self.adapt(parts))


@final
@dataclass(frozen=True, kw_only=True)
class Optimal(_Piloted):
    """Weights with the least variance for random points; may be negative [Kondapaneni2019]_.

    With q = Σ n_t p_t, they are w_t = α_t p_t/f + (n_t p_t/q)(1 − Σ_s α_s p_s/f), with A α = b,
    A_st = ∫ p_s p_t/q and b_t = ∫ f p_t/q. Then w_t f/p_t is

        α_t + n_t (f − Σ_s α_s p_s)/q,

    the balance heuristic on f with Σ α_s p_s as a control variate. In this form f may be 0, and
    each channel has its own α. Identical or nearly identical densities make A singular. The
    solution of least norm is used then, which has the same Σ α_s p_s.

    Attributes
    ----------
    pilot
        Source of A and b: ``"samples"``, random points of all techniques in proportion to their
        counts, or ``"quadrature"``, which makes α as exact as the quadrature.
    samples
        Total number of pilot points of all techniques, at least 2; not counted in n.
    seed
        Seed of the pilot points.
    """

    def adapt(self, pilot: Pilot) -> tuple[tuple[float, ...], Array]:
        """Return the given counts, and α: (T,) or (T, channels)."""
        if self.pilot == "quadrature":
            found = pilot.quadrature(pilot.system)
        else:
            # Estimate A and b, (T, T + C), from pilot points weighted by the balance heuristic
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
    """Balance with counts times v_t = second moment / variance of technique t [Grittmann2019]_.

    w_t = v_t n_t p_t / Σ_s v_s n_s p_s with v_t = 1 + μ_t²/σ_t² of a single random sample of f/p_t,
    at most 10⁸. A technique of low variance gets more weight than by the balance heuristic, which
    uses second moments. With several channels their mean is used.

    Attributes
    ----------
    pilot
        Source of the moments: ``"samples"``, equally many random points of each technique, or
        ``"quadrature"``.
    samples
        Total number of pilot points of all techniques, at least 2; not counted in n.
    seed
        Seed of the pilot points.
    """

    def adapt(self, pilot: Pilot) -> tuple[tuple[float, ...], None]:
        """Return the counts times the factors v_t, and no control variate."""
        techniques = len(pilot.shares)
        if self.pilot == "quadrature":
            found = pilot.quadrature(pilot.moments)
        else:
            # Estimate mean and mean square of f/p_t from random points of each technique
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
    """The residual f − Σ α_t p_t of the control variate: the domain view of optimal weights."""

    text = "{0.integrand.spec} less its control variate"
    integrand: Integrand
    combination: Combination

    @property
    def breaks(self) -> Breaks:
        """Breaks of f and, in 1-D, of the densities."""
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
    """A pilot for an integrand and densities on the unit cube."""

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
    """Several functions as the channels of one integrand, for quadrature."""

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
    """Return breaks of f and, in 1-D, breaks of the warps mapped to the domain."""
    if integrand.dims > 1:
        return integrand.breaks
    return (tuple(sorted({*integrand.breaks[0], *_density_breaks(densities)})),)


def _density_breaks(densities: Sequence[Density]) -> set[float]:
    """Return domain points where 1-D densities may jump or kink: the breaks of their warps, warped.

    Both sides of a break are included, because it may stand for a whole interval with p = 0.
    """
    found: set[float] = set()
    for density in densities:
        if len(density.breaks) == 1:
            places = np.array([0.0, *density.breaks[0], 1.0])
            sides = np.concatenate([places[:-1], np.nextafter(places[1:], 0.0)])
            found.update(density.sample(sides[:, None])[:, 0].tolist())
    return {x for x in found if _EDGE < x < 1.0 - _EDGE}


def as_heuristic(given: object) -> Heuristic:
    """Return a heuristic, or make one from a spec string such as ``"power(beta=3)"``.

    Raises
    ------
    UnknownName, SpecError
        If the spec names no heuristic, or cannot be read.
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
    """Return part/total, 0 where the total is 0."""
    return np.asarray(np.divide(part, total, out=np.zeros_like(total), where=total > 0))
