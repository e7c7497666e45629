"""The interface of estimators: techniques, each with a warp, a weight and an integrand.

An estimator has techniques t = 0 … T−1.
For technique t it draws n_t = n · counts[t] points u_tk of a sampler.
The estimate is I = Σ_t (1/n_t) Σ_k g_t(u_tk). There are two views of an estimator:

* *primary space*: integrands g_t on the unit cube, with the sampler's own points;
* *domain*: one integrand f, with all warped points x_tk = T_t(u_tk).
  Each point has the weight w_t/(p_t n_t), so that I = Σ_tk w_t(x_tk) f(x_tk) / (p_t(x_tk) n_t).

The point sets of the techniques are independent, shared or joint:

* ``"independent"``: each technique draws its own set from its own random stream.
  Covariances between techniques are 0.
* ``"shared"``: all techniques use the same primary points, so their counts must be equal.
  Errors of techniques cancel if their integrands vary in opposite ways, and add up otherwise.
* ``"joint"``: one set of n · Σ counts points is divided among the techniques.
  From a *sequence* (`Sampler.sequence`), technique t gets n · counts[t] consecutive points.
  Sets that are not sequences are divided into groups of Σ counts consecutive points.
  From each group, technique t gets counts[t] points that are chosen at random.
  Consecutive points of a stratified set are neighbors in space.
  Therefore each technique has points in every neighborhood.
  The random choice makes the points of each technique uniform, so estimates are unbiased.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, final, runtime_checkable

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array, as_choice, as_integer
from mcspectra.core.display import Drawable
from mcspectra.core.errors import (
    CountError,
    DependentRealizationsWarning,
    Function,
    NoClosedForm,
    Parameter,
    ParameterError,
    warn,
)
from mcspectra.core.streams import Stream
from mcspectra.estimators.moments import Moments
from mcspectra.integrands import integral_accuracy
from mcspectra.integrands.base import Breaks, Derived, Integrand

if TYPE_CHECKING:
    from mcspectra.densities import Density
    from mcspectra.samplers.base import Sampler
from mcspectra.samplers.law import Law

__all__ = [
    "SETS",
    "AbstractEstimator",
    "DomainEstimator",
    "PrimaryIntegrand",
    "Weighted",
    "carried_breaks",
    "check_counts",
    "check_sets",
    "draw_sets",
    "set_sizes",
]

SETS = ("independent", "shared", "joint")

_TECHNIQUE = 1 << 20  # Random stream of the second technique
_DEAL = (1 << 20) - 1  # Random stream for the division of a joint set among the techniques


class AbstractEstimator(Drawable, ABC):
    """An estimator of an integral, which can be combined with any sampler.

    Attributes
    ----------
    counts
        For each technique, its number of points as a multiple of n.
    sets
        How the point sets of the techniques are related; see `mcspectra.estimators.base`.
    """

    counts: tuple[int, ...]
    sets: str = "independent"

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.spec})"

    @property
    def sets_label(self) -> str:
        """The part of `spec` that names the relation between the techniques' point sets."""
        return "" if self.sets == "independent" else f" ({self.sets} sets)"

    @property
    def dims(self) -> int:
        """Number of dims that the sampler must have."""
        return self.primary_integrand().dims

    @property
    def domain_dims(self) -> int:
        """Number of dims of the domain. Without a domain view, it is `dims`."""
        return self.dims if self.domain_integrand is None else self.domain_integrand.dims

    @property
    def channels(self) -> int:
        """Number of channels of the estimate, or 0 if it is a single number."""
        return self.primary_integrand().channels

    @property
    @abstractmethod
    def spec(self) -> str:
        """Text that identifies this estimator, for provenance."""

    @property
    def integral(self) -> Any:
        """Exact value of the integral, Σ_t ∫ g_t, as a float or an array (channels,)."""
        return sum(g.integral for g in self._every_primary())

    @property
    def integral_source(self) -> str:
        """How the integral was computed. It is ``"exact"`` for a closed form."""
        sources = {g.integral_source for g in self._every_primary()}
        return sources.pop() if len(sources) == 1 else "quadrature"

    @property
    def integral_error(self) -> float:
        """Standard error of `integral`, or an estimate of its absolute error; 0 if it is exact."""
        f = self.domain_integrand
        return sum(
            integral_accuracy(g)[1] for g in ([f] if f is not None else self._every_primary())
        )

    @property
    def is_black_box(self) -> bool:
        """Whether an integrand may take long to evaluate (`Integrand.is_black_box`)."""
        return any(g.is_black_box for g in self._every_primary())

    def known_integral(self) -> tuple[Any, float, str]:
        """Return `integral`, its error and source. If this would call a black box, return NaN."""
        if self.is_black_box and self.integral_source != "exact":
            unknown = np.full(self.channels, np.nan) if self.channels else np.nan
            return unknown, math.nan, "unknown"
        return self.integral, self.integral_error, self.integral_source

    @property
    def domain_integrand(self) -> Integrand | None:
        """Integrand f of the domain view. It is None if the techniques have no common domain."""
        return None

    @property
    def infinite_weights(self) -> bool:
        """Whether ∫1/p diverges. If it does, Var(S_0) is infinite in the domain view."""
        return False

    @property
    def evaluations_per_point(self) -> int:
        """Number of evaluations of the underlying function for each point."""
        f = self.domain_integrand
        return 1 if f is None else f.evaluations_per_point

    @property
    def cost(self) -> int:
        """Number of evaluations of the underlying function by all techniques, divided by n."""
        return sum(self.counts) * self.evaluations_per_point

    @property
    def pilot_evaluations(self) -> int:
        """Number of evaluations in a pilot, before the first sample."""
        return 0

    def primary_integrand(self, technique: int = 0) -> Integrand:
        """Return the integrand g_t of the primary view. Later calls return the same object.

        The integrand object stores results of quadrature.
        """
        if technique not in self._primaries:
            self._primaries[technique] = self._primary(technique)
        return self._primaries[technique]

    @cached_property
    def _primaries(self) -> dict[int, Integrand]:
        return {}

    def _every_primary(self) -> list[Integrand]:
        return [self.primary_integrand(t) for t in range(len(self.counts))]

    @abstractmethod
    def _primary(self, technique: int) -> Integrand:
        """Create the integrand g_t of technique t."""

    def primary_breaks(self, technique: int) -> Breaks:
        """Return the positions along each axis of primary space at which g_t may jump or kink."""
        raise NotImplementedError

    @abstractmethod
    def primary_values(self, technique: int, u: Array) -> Array:
        """Return g_t at primary points u (..., d), as float64 (...) or (..., channels)."""

    def warp(self, technique: int, u: Array) -> Array:
        """Return domain points T_t(u)."""
        raise NotImplementedError

    def weight(self, technique: int, x: Array) -> Array:
        """Return the weights w_t(x)/p_t(x) at domain points of technique t."""
        raise NotImplementedError

    def randomized(self, sampler: Sampler) -> Sampler:
        """Return the sampler from which points are drawn, possibly with added randomizations."""
        return sampler

    def law(self, sampler: Sampler, n: int) -> Law:
        """Return the joint distribution of the points of the first technique."""
        return self.randomized(sampler).law(set_sizes(self.sets, self.counts, n)[0])

    def check_sampler(self, sampler: Sampler, n: int) -> None:
        """Raise an error unless `sampler` has the right dims and the counts of all techniques."""
        if sampler.dims != self.dims:
            raise ParameterError(
                f"The estimator {self.spec} needs a sampler in {self.dims} dims; "
                f"{sampler.spec} has {sampler.dims}."
            )
        if not sampler.independent:
            warn(
                f"The realizations of {sampler.spec} are the pixels of one image, not "
                "independent: the reported variance is the variance within one image, and its "
                "interval may be too narrow or too wide.",
                DependentRealizationsWarning,
            )
        for technique, size in enumerate(set_sizes(self.sets, self.counts, n)):
            try:
                sampler.check_count(size)
            except CountError as error:
                if size == n:
                    raise
                joint = self.sets == "joint"
                who = "The joint set has" if joint else f"Technique {technique} draws"
                text = f"{who} {size // n} · {n} points: {error}"
                raise CountError(text, error.nearest) from None

    def check_independent(self) -> None:
        """Raise `NoClosedForm` if techniques are correlated, so variances do not add up."""
        if self.sets != "independent" and len(self.counts) > 1:
            raise NoClosedForm(
                f"The techniques of {self.spec} are correlated; the variance is known for "
                "independent ones only; use ",
                Function("convergence"),
                " or ",
                Function("technique_terms"),
                ".",
            )

    def draw(self, sampler: Sampler, n: int, stream: Stream, first: int, count: int) -> list[Array]:
        """Draw `count` realizations, beginning at `first`, as (count, n_t, d) for each technique.

        The first technique uses `stream` itself and gets the points of ``sampler.draw(n, rng)``.
        Point sets of other techniques are described in `mcspectra.estimators.base`.
        """
        return draw_sets(self.sets, self.counts, sampler, n, stream, first, count)

    def estimate(self, points: list[Array]) -> Array:
        """Return the estimates from the primary points of all techniques: (R,) or (R, channels)."""
        return self.estimate_of(self.primary_values(t, u) for t, u in enumerate(points))

    def estimate_of(self, values: Iterable[Array]) -> Array:
        """Return estimates from the primary values of all techniques, each (R, n[, channels])."""
        total: Any = 0.0
        for each in values:
            total = total + each.mean(axis=1)
        if not np.isfinite(total).all():
            raise ParameterError(f"{self.spec} gave an estimate that is NaN or infinite.")
        return np.asarray(total)

    def weighted_points(self, points: list[Array]) -> tuple[Array, Array]:
        """Return domain points (R, Σn_t, d), and their weights w_t/(p_t n_t), (R, Σn_t)."""
        xs, weights = [], []
        for technique, u in enumerate(points):
            x = self.warp(technique, u)
            xs.append(x)
            weights.append(self.weight(technique, x) / u.shape[1])
        return np.concatenate(xs, axis=1), np.concatenate(weights, axis=1)

    def moments(self, sampler: Sampler, n: int, stream: Stream, first: int, count: int) -> Moments:
        """Return moments of `count` estimates, one for each realization."""
        return Moments.of(self.estimate(self.draw(sampler, n, stream, first, count)))


class DomainEstimator(AbstractEstimator):
    """An estimator of the integral of one integrand f on one domain.

    Attributes
    ----------
    integrand
        f.
    """

    integrand: Integrand

    @property
    def dims(self) -> int:
        """Number of dims of the sampler: the dims of f, or more if a warp uses more numbers."""
        return self.integrand.dims

    @property
    def channels(self) -> int:
        return self.integrand.channels

    @property
    def integral(self) -> Any:
        """The integral of f."""
        return self.integrand.integral

    @property
    def integral_source(self) -> str:
        return self.integrand.integral_source

    @property
    def integral_error(self) -> float:
        return integral_accuracy(self.domain_integrand or self.integrand)[1]

    @property
    def domain_integrand(self) -> Integrand | None:
        """f."""
        return self.integrand


@final
@dataclass(frozen=True)
class PrimaryIntegrand(Derived):
    """The primary-space integrand g_t of an estimator of f, as a separate object.

    Attributes
    ----------
    density
        The density p_t; None if each point selects its technique.
    """

    name: ClassVar[str] = "primary"
    text = "primary integrand {0.technique} of {0.estimator.spec}"
    estimator: AbstractEstimator
    technique: int
    integrand: Integrand
    density: Density | None = None

    @property
    def dims(self) -> int:  # type: ignore[override]
        return self.estimator.dims

    @property
    def breaks(self) -> Breaks:
        """Discontinuities of f, of the warp and of the weights, mapped to primary space."""
        return self.estimator.primary_breaks(self.technique)

    def _evaluate(self, x: Array) -> Array:
        return self.estimator.primary_values(self.technique, x)

    def _integral(self) -> Any:
        exact = len(self.estimator.counts) == 1 and self.integrand.integral_source == "exact"
        return self.integrand.integral if exact else None


def carried_breaks(integrand: Integrand, density: Density, weights: Sequence[float] = ()) -> Breaks:
    """Return breaks of a warp in primary space. In 1-D, add breaks of f and of the weights."""
    own = density.breaks
    inner = (*integrand.breaks[0], *weights)
    if density.primary_dims > 1 or not inner:
        return own
    x = np.clip(np.array(inner)[:, None], 0.0, BELOW_ONE)
    return (tuple(sorted({*own[0], *density.preimages(x)[:, 0].tolist()})),)


@runtime_checkable
class Weighted(Protocol):
    """An estimator that combines techniques by a heuristic. A copy can have another heuristic."""

    counts: tuple[int, ...]

    def with_heuristic(self, heuristic: str) -> AbstractEstimator:
        """Return a copy with another heuristic, given as a spec."""

    def alone(self, technique: int) -> AbstractEstimator:
        """Return the estimator that uses a single technique."""

    def technique_name(self, technique: int) -> str:
        """Return the name of a technique."""


def check_counts(counts: Any, techniques: int) -> tuple[int, ...]:
    """Return counts as a tuple of one positive int per technique. None means that all are 1."""
    if counts is None:
        return (1,) * techniques
    values = tuple(counts) if isinstance(counts, list | tuple | np.ndarray) else (counts,)
    if len(values) != techniques:
        raise ParameterError(
            Parameter("counts"),
            f" is {counts!r:.60}; give one number for each technique ({techniques}).",
        )
    return tuple(as_integer(f"counts[{i}]", c, least=1) for i, c in enumerate(values))


def check_sets(sets: object, counts: tuple[int, ...]) -> str:
    """Return `sets` if it is one of `SETS` and is possible with these counts."""
    chosen = as_choice("sets", sets, SETS)
    if chosen == "shared" and len(set(counts)) > 1:
        raise ParameterError(
            f"sets is 'shared' and counts is {list(counts)}; techniques that share their points "
            "need equal counts."
        )
    return chosen


def set_sizes(sets: str, counts: tuple[int, ...], n: int) -> list[int]:
    """Return the sizes of the point sets that are drawn from the sampler."""
    if sets == "joint":
        return [n * sum(counts)]
    return [n * counts[0]] if sets == "shared" else [n * count for count in counts]


def draw_sets(
    sets: str,
    counts: tuple[int, ...],
    sampler: Sampler,
    n: int,
    stream: Stream,
    first: int,
    count: int,
) -> list[Array]:
    """Return the points of each technique, (count, n · counts[t], d), for several realizations.

    The realizations are first … first+count−1.
    The first technique uses `stream` itself.
    Therefore it has the same points as ``sampler.draw(size, rng)``.
    """
    sizes = set_sizes(sets, counts, n)
    streams = [stream, *(stream.child(_TECHNIQUE + t) for t in range(1, len(sizes)))]
    drawn = [
        sampler.draw_stream(size, own, first, count)
        for size, own in zip(sizes, streams, strict=True)
    ]
    if sets == "shared":
        return drawn * len(counts)
    if sets == "independent":
        return drawn
    if sampler.sequence:
        return np.split(drawn[0], np.cumsum([n * c for c in counts])[:-1], axis=1)

    # Divide the set into groups of Σ counts consecutive points. Within each group,
    # distribute the points at random among the techniques
    total, group = n * sum(counts), sum(counts)
    keys = stream.child(_DEAL).uniforms(first, count, total).reshape(count, n, group)
    order = np.argsort(keys, axis=2)[..., None]
    mixed = np.take_along_axis(drawn[0].reshape(count, n, group, -1), order, axis=2)
    parts = np.split(mixed, np.cumsum(counts)[:-1], axis=2)
    return [part.reshape(count, -1, sampler.dims) for part in parts]
