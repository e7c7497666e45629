"""Heuristics of multiple importance sampling: how the techniques share an integrand.

A heuristic gives weights w_t(x) that sum to 1 wherever any technique can sample; I is estimated by
Σ_t (1/n_t) Σ_k w_t f/p_t [VeachGuibas1995]_. With q_t = n_t p_t, and the names of [Veach1997]_ §9.2:

* ``balance``: w_t = q_t / Σ_s q_s. No other weights have a variance of random points that is lower
  by more than (1/min n_t − 1/Σ n_t) I² (his Theorem 9.2); that bound holds for weights ≥ 0.
* ``power(beta=2)``: w_t = q_t^β / Σ_s q_s^β. β = 0 shares equally, β → ∞ is `maximum`.
* ``cutoff(alpha=0.1)``: balance among techniques with q_t ≥ α max_s q_s, 0 for the others.
* ``maximum``: all to the largest q_t; ties are shared equally, so that it is ``cutoff(alpha=1)``.

``optimal`` and ``variance-aware`` need to know f: `mcspectra.estimators.pilots`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.fields import real
from mcspectra.core.registry import Registry
from mcspectra.core.spec import Component, parse
from mcspectra.densities import Density
from mcspectra.densities.adaptive import mean_or_infinity
from mcspectra.integrands.base import Integrand

__all__ = [
    "HEURISTICS",
    "Balance",
    "Combination",
    "Cutoff",
    "Heuristic",
    "Maximum",
    "Pilot",
    "Power",
    "as_heuristic",
    "density_breaks",
]

_GRID = 2049
_BISECTIONS = 45
_EDGE = 1e-12  # from the ends of [0,1], where there are breaks anyway

_FEW_CELLS = 2**12  # whether an integral diverges shows long before its value is known


class Heuristic(Component, ABC):
    """A rule that combines techniques: `ratio` gives weights from q_t, `fit` from f and p_t."""

    @property
    def bounded(self) -> bool:
        """Whether w_t/p_t is bounded as soon as one density is bounded from below."""
        return True

    @property
    def smooth(self) -> bool:
        """Whether weights are as smooth as the densities; if not, they jump to 0."""
        return True

    @property
    def pilot_evaluations(self) -> int:
        """Evaluations of f for points of a pilot; 0 where weights do not look at f."""
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
        """Return `shares` and `control` of the `Combination` that suits the values of a pilot."""
        return tuple(map(float, pilot.shares)), None

    @abstractmethod
    def ratio(self, q: Array, technique: int) -> Array:
        """w_t/q_t for q (T, ...) of all techniques: (...), 0 where all q are."""


HEURISTICS = Registry(
    "heuristic",
    "mcspectra.heuristics",
    {
        "balance": "mcspectra.estimators.heuristics:Balance",
        "cutoff": "mcspectra.estimators.heuristics:Cutoff",
        "maximum": "mcspectra.estimators.heuristics:Maximum",
        "optimal": "mcspectra.estimators.pilots:Optimal",
        "power": "mcspectra.estimators.heuristics:Power",
        "variance-aware": "mcspectra.estimators.pilots:VarianceAware",
    },
    base=Heuristic,
)
"""Heuristics that spec strings can name."""


class Pilot(ABC):
    """Interface to f and all p_t at sampled points, for heuristics that use f.

    Points are rows of an array that only the pilot itself reads: of a domain that the techniques
    share, or records of what a renderer found along a path.

    Attributes
    ----------
    shares
        n_t up to a common factor, (T,).
    channels
        Channels of f, 0 if it is scalar.
    """

    shares: Array
    channels: int

    @abstractmethod
    def points(self, technique: int, count: int, seed: int) -> Array:
        """Random points of a technique: (count, …)."""

    @abstractmethod
    def pdfs(self, x: Array) -> Array:
        """p_t at k points: (T, k)."""

    @abstractmethod
    def values(self, x: Array) -> Array:
        """f at k points: (k, channels), with one channel for scalars."""

    def system(self, x: Array) -> Array:
        """p_s p_t/q and f p_s/q side by side: (k, T, T + C)."""
        p = self.pdfs(x)
        q = self.shares @ p
        over = np.divide(p, q, out=np.zeros_like(p), where=q > 0)
        right = np.concatenate([p.T, self.values(x)], axis=1)
        return np.asarray(over.T[:, :, None] * right[:, None, :])

    def moments(self, x: Array) -> Array:
        """Integrands f and f²/p_t of the moments where p_t > 0, f the mean of the channels: (k, T, 2)."""
        p = self.pdfs(x).T
        f = np.broadcast_to(self.values(x).mean(axis=1)[:, None], p.shape)
        square = np.divide(f * f, p, out=np.zeros_like(p), where=p > 0)
        return np.stack([np.where(p > 0, f, 0.0), square], axis=-1)

    def quadrature(self, function: Callable[[Array], Array]) -> Array:  # noqa: ARG002
        """Integrals of `system` or `moments` over the domain that the techniques share.

        Raises
        ------
        ParameterError
            The techniques share no domain.
        """
        raise ParameterError(
            "These techniques share no domain to integrate over; give pilot='samples'."
        )


@final
@dataclass(frozen=True, eq=False)
class Combination:
    """Weights of one estimator: a heuristic that knows its densities.

    Attributes
    ----------
    heuristic
        Gives w_t from q_t = shares[t] p_t.
    densities
        p_t.
    shares
        n_t up to a common factor, times the factors of `variance-aware`.
    control
        α_t (T,), or (T, channels), where Σ_t α_t p_t is taken off f and Σ_t α_t added to the
        estimate (`optimal`); None where there is no such control variate.
    """

    heuristic: Heuristic
    densities: tuple[Density, ...]
    shares: tuple[float, ...]
    control: Array | None = None

    def over_density(self, technique: int, x: Array) -> Array:
        """w_t/p_t at points x (..., d): (...)."""
        q = np.stack([c * p.pdf(x) for c, p in zip(self.shares, self.densities, strict=True)])
        return np.asarray(self.shares[technique] * self.heuristic.ratio(q, technique))

    @cached_property
    def infinite(self) -> bool:
        """Whether ∫ Σ_t (w_t/p_t)² p_t diverges, so that Var(S_0) is infinite.

        One ∫1/p_t that converges is enough for weights that are `Heuristic.bounded`. Where none does,
        the densities may still cover for one another, as two that are 0 at opposite ends.
        """
        finite = [math.isfinite(p.reciprocal_integral()) for p in self.densities]
        if all(finite) or (any(finite) and self.heuristic.bounded):
            return False

        def second_moment(x: Array) -> Array:
            """Σ_t (w_t/p_t)² p_t at points x (..., d): (...)."""
            pdfs = [density.pdf(x) for density in self.densities]
            with np.errstate(divide="ignore", over="ignore"):
                parts = [self.over_density(t, x) ** 2 * pdf for t, pdf in enumerate(pdfs)]
            return np.asarray(np.where(sum(pdfs) == 0, np.inf, sum(parts)))

        dims = self.densities[0].dims
        return not math.isfinite(mean_or_infinity(second_moment, dims, most_cells=_FEW_CELLS))

    def weights(self, x: Array) -> Array:
        """w_t at points x (..., d): (T, ...), which sum to 1 where any density is positive."""
        techniques = range(len(self.densities))
        return np.stack([self.over_density(t, x) * self.densities[t].pdf(x) for t in techniques])

    @cached_property
    def breaks(self) -> tuple[float, ...]:
        """Points of the domain where the weights may jump or kink: in 1-D only, else empty.

        Crossings of densities are found on a grid of 2049 points: two within a cell are missed.
        """
        if self.densities[0].dims > 1:
            return ()
        found = density_breaks(self.densities)
        if self.heuristic.smooth:
            return tuple(sorted(found))

        def active(x: Array) -> Array:
            return np.stack([self.over_density(t, x) > 0 for t in range(len(self.densities))])

        # Bisect to where the set of techniques with a weight changes
        grid = np.linspace(0.0, 1.0, _GRID)[:, None]
        changes = (active(grid[:-1]) != active(grid[1:])).any(axis=0)
        low, high = grid[:-1][changes], grid[1:][changes]
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            left = (active(low) == active(middle)).all(axis=0)[:, None]
            low, high = np.where(left, middle, low), np.where(left, high, middle)
        return tuple(sorted(found | set(high[:, 0].tolist())))

    def offset(self, x: Array) -> Array:
        """Σ_t α_t p_t at points x (..., d): (...) or (..., channels)."""
        assert self.control is not None  # asked for where there is one
        pdfs = np.stack([p.pdf(x) for p in self.densities], axis=-1)
        return np.asarray(pdfs @ self.control)


@final
@dataclass(frozen=True, kw_only=True)
class Power(Heuristic):
    """q_t^β / Σ q_s^β.

    Attributes
    ----------
    beta
        β ≥ 0; 1 is `balance`.
    """

    beta: float = real(2.0, least=0.0)

    @property
    def bounded(self) -> bool:
        """Where p_t → 0, w_t/p_t goes like p_t^(β−1)."""
        return self.beta >= 1.0

    def ratio(self, q: Array, technique: int) -> Array:
        """q_t^(β−1) / Σ q_s^β, from q/max q, which neither overflows nor vanishes."""
        largest = q.max(axis=0)
        scaled = np.divide(q, largest, out=np.zeros_like(q), where=largest > 0)
        # 0⁰ is 1, but a technique that cannot sample x has no share there.
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
        """1 over the sum of the q_s that are kept, 0 where q_t is not."""
        kept = q >= self.alpha * q.max(axis=0)
        total = np.where(kept, q, 0.0).sum(axis=0)
        return _divided(kept[technique].astype(np.float64), total)


@final
@dataclass(frozen=True, kw_only=True)
class Maximum(Heuristic):
    """All weight to the largest q_t, shared equally where several are largest."""

    @property
    def smooth(self) -> bool:
        return False

    def ratio(self, q: Array, technique: int) -> Array:
        return Cutoff(alpha=1.0).ratio(q, technique)


def density_breaks(densities: Sequence[Density]) -> set[float]:
    """Where 1-D densities may jump or kink, in the domain: the breaks of their warps, warped.

    Both sides of a break are, as it may stand for a whole interval where p is 0.
    """
    found: set[float] = set()
    for density in densities:
        if len(density.breaks) == 1:
            places = np.array([0.0, *density.breaks[0], 1.0])
            sides = np.concatenate([places[:-1], np.nextafter(places[1:], 0.0)])
            found.update(density.sample(sides[:, None])[:, 0].tolist())
    return {x for x in found if _EDGE < x < 1.0 - _EDGE}


def as_heuristic(given: object) -> Heuristic:
    """Return a heuristic from one or from a spec string such as ``"power(beta=3)"``.

    Raises
    ------
    UnknownName, SpecError
        The spec names no heuristic, or cannot be read.
    ParameterError
        A parameter is out of range, or `given` has another type.
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
    """part/total, 0 where total is."""
    return np.asarray(np.divide(part, total, out=np.zeros_like(total), where=total > 0))
