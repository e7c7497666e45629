"""Estimators with several techniques: multiple importance sampling, and sums of techniques.

As in renderers, counts are per technique: n light samples *and* n BSDF samples.
In the one-sample model, each point selects its technique:

I = (1/n) Σ_k w_t f/(P_t p_t), where technique t has the probability P_t.
The one-sample model is described in [VeachGuibas1995]_ and in §9.2.4 of [Veach1997]_.
With the balance heuristic w_t = P_t p_t / Σ_s P_s p_s,
the one-sample estimator is the same as sampling from the mixture Σ_s P_s p_s.
No other weights have less variance with random points (Theorem 9.4 of Veach).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array, as_choice, as_integer, as_reals
from mcspectra.core.display import shown
from mcspectra.core.errors import ParameterError
from mcspectra.densities import Defensive, Density, Mixture, as_density
from mcspectra.estimators.base import (
    AbstractEstimator,
    DomainEstimator,
    PrimaryIntegrand,
    carried_breaks,
    check_counts,
    check_sets,
)
from mcspectra.estimators.heuristics import Combination, Heuristic, Residual, as_heuristic
from mcspectra.estimators.importance import (
    Estimator,
    as_densities,
    check_same_dims,
    check_support,
    known_dims,
    scale,
)
from mcspectra.integrands import Integrand, as_integrand
from mcspectra.integrands.base import Breaks

__all__ = [
    "SELECTIONS",
    "Combined",
    "MultipleImportance",
    "OneSampleMIS",
    "TechniqueSum",
    "split_mixture",
]

SELECTIONS = ("extra", "coordinate")

_SUM = 1e-9  # Largest allowed difference between 1 and the sum of the probabilities
_EXACT = 1e-9  # Largest allowed difference between a share and the fraction that replaces it


class Combined(DomainEstimator):
    """An estimator of f with densities that a heuristic combines.

    Attributes
    ----------
    densities
        The densities p_t, with the dims of f.
    heuristic
        Spec string of the heuristic.
    combination
        The weights that the heuristic gives.
    """

    densities: tuple[Density, ...]
    heuristic: str
    combination: Combination

    def _take(self, integrand: Integrand | str, densities: Any, dims: int | None) -> None:
        """Set f and the densities p_t from objects or specs of equal dims.

        Wherever f is not 0, some density must be above 0.
        """
        parts = densities if isinstance(densities, list | tuple) else ()
        self.integrand = as_integrand(integrand, known_dims(dims, integrand, *parts))
        self.densities = as_densities(densities, self.integrand.dims)
        check_same_dims([self.integrand, *self.densities])
        check_support(self.integrand, list(self.densities))

    def _combine(self, heuristic: Heuristic | str, shares: Sequence[float]) -> None:
        chosen = as_heuristic(heuristic)
        self.heuristic = chosen.spec
        self.combination = chosen.fit(self.integrand, self.densities, shares)

    @property
    def pilot_evaluations(self) -> int:
        return self.combination.heuristic.pilot_evaluations

    @property
    def infinite_weights(self) -> bool:
        """Whether combined weights have an infinite second moment (see `Combination.infinite`)."""
        return self.combination.infinite

    @property
    def domain_integrand(self) -> Integrand:
        """f; for optimal weights, the residual f − Σ α_t p_t, which has the same variance."""
        controlled = self.combination.control is not None
        return Residual(self.integrand, self.combination) if controlled else self.integrand


@final
class MultipleImportance(Combined):
    """Multiple importance sampling: I = Σ_t (1/n_t) Σ_k w_t f/p_t [VeachGuibas1995]_.

    Parameters
    ----------
    integrand
        The integrand f, or its spec string.
    densities
        The densities p_t with their warps, or spec strings of densities.
    heuristic
        A heuristic or its spec string. ``"balance"`` is w_t = n_t p_t / Σ_s n_s p_s.
        ``"power"`` uses squares of n_t p_t (β = 2). See `mcspectra.estimators.heuristics` for more.
    counts
        Numbers of points n_t as multiples of n; all equal by default.
    sets
        How the point sets of the techniques are related: ``"independent"``, ``"shared"`` or
        ``"joint"``; see `mcspectra.estimators.base`.
    dims
        Number of dims; needed for spec strings without ``dims``.

    Raises
    ------
    DensityError
        If all densities are zero at points where f is not.
    ParameterError
        If no density is given, the heuristic is unknown, the number of counts is wrong,
        or dims differ.
    """

    def __init__(
        self,
        integrand: Integrand | str,
        densities: Sequence[Density | str],
        *,
        heuristic: Heuristic | str = "balance",
        counts: Sequence[int] | None = None,
        sets: str = "independent",
        dims: int | None = None,
    ) -> None:
        self._take(integrand, densities, dims)
        heuristic = as_heuristic(heuristic)
        self.counts = check_counts(counts, len(self.densities))
        self.sets = check_sets(sets, self.counts)
        self._combine(heuristic, self.counts)

    @property
    def spec(self) -> str:
        """Text of the form ``integrand / heuristic[densities]``."""
        parts = zip(self.counts, self.densities, strict=True)
        shown = ", ".join(f"{c}×{p.spec}" if c > 1 else p.spec for c, p in parts)
        return f"{self.integrand.spec} / {self.heuristic}[{shown}]{self.sets_label}"

    def _primary(self, technique: int) -> Integrand:
        density = self.densities[technique]
        return PrimaryIntegrand(self, technique, self.integrand, density)

    def primary_breaks(self, technique: int) -> Breaks:
        density = self.densities[technique]
        return carried_breaks(self.integrand, density, self.combination.breaks)

    def primary_values(self, technique: int, u: Array) -> Array:
        """Return g_t(u). With optimal weights, g_t is α_t + (f − Σ α_s p_s) w_t/p_t."""
        x = self.warp(technique, u)
        control = self.combination.control
        if control is None:
            return scale(self.integrand(x), self.weight(technique, x))
        left = self.integrand(x) - self.combination.offset(x)
        return np.asarray(control[technique] + scale(left, self.weight(technique, x)))

    def with_heuristic(self, heuristic: str) -> MultipleImportance:
        """Return a copy with another heuristic, given as a spec."""
        return MultipleImportance(
            self.integrand,
            self.densities,
            heuristic=heuristic,
            counts=self.counts,
            sets=self.sets,
        )

    def alone(self, technique: int) -> Estimator:
        """Return the estimator of f that uses only one of the densities."""
        return Estimator(self.integrand, self.densities[technique])

    def technique_name(self, technique: int) -> str:
        return self.densities[technique].spec

    def warp(self, technique: int, u: Array) -> Array:
        return self.densities[technique].sample(u)

    def weight(self, technique: int, x: Array) -> Array:
        """Return w_t/p_t, finite where any p_s is positive. Optimal weights use the residual."""
        return self.combination.over_density(technique, x)


@final
class OneSampleMIS(Combined):
    """Multiple importance sampling in which each point selects one technique at random.

    Parameters
    ----------
    integrand
        The integrand f, or its spec string.
    densities
        The densities p_t with their warps, or spec strings of densities.
    probabilities
        Probabilities P_t of the techniques, above 0 and with the sum 1; all equal by default.
    heuristic
        The heuristic is the same as in `MultipleImportance`, but P_t replaces n_t.
        ``"optimal"`` is the balance heuristic with the control variate Σ α_t p_t.
        The sum Σ α_t is added to the estimate directly ([OwenZhou2000]_ §4),
        because adding α_t/P_t would increase the variance.
    selection
        ``"extra"``: the last of d + 1 coordinates selects the technique.
        ``"coordinate"``: the first of d coordinates selects the technique, and is then used again.
        The interval of the coordinate that belongs to the technique is stretched to [0, 1).
        The interval of technique t begins at Σ_{s<t} P_s.
    dims
        Number of dims of f; needed for spec strings without ``dims``.

    Raises
    ------
    DensityError
        If all densities are zero at points where f is not.
    ParameterError
        If no density is given, the heuristic is unknown, or the probabilities are invalid.

    Notes
    -----
    The primary-space integrand usually jumps where the selected technique changes.
    The jumps are normal to an axis, and make the rate of stratified points slower.
    `MultipleImportance` avoids these jumps, because each technique has its own point set.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> e = mcs.estimators.OneSampleMIS(
    ...     "gaussian", ["uniform", "linear(slope=1)"], [0.25, 0.75], dims=1
    ... )
    >>> e.dims, e.spec
    (2, 'gaussian / one-sample balance[0.25×uniform, 0.75×linear(slope=1)]')
    """

    counts = (1,)

    def __init__(
        self,
        integrand: Integrand | str,
        densities: Sequence[Density | str],
        probabilities: Sequence[float] | None = None,
        *,
        heuristic: Heuristic | str = "balance",
        selection: str = "extra",
        dims: int | None = None,
    ) -> None:
        self._take(integrand, densities, dims)
        count, given = len(self.densities), probabilities
        self.probabilities = (1.0 / count,) * count
        if given is not None:
            if not isinstance(given, list | tuple | np.ndarray) or len(given) != count:
                raise ParameterError(
                    f"probabilities is {shown(given)}; give a list of {count}, one for each "
                    "density."
                )
            found = as_reals("probabilities", given, count, above=0.0, most=1.0)
            if abs(sum(found) - 1.0) > _SUM:
                raise ParameterError(
                    f"probabilities add up to {sum(found):.12g}; make their sum 1."
                )
            self.probabilities = found
        self.selection = as_choice("selection", selection, SELECTIONS)
        self._combine(heuristic, self.probabilities)
        self._borders = np.cumsum((0.0, *self.probabilities))
        self._borders[-1] = 1.0

    @property
    def dims(self) -> int:
        """Number of dims: d + 1, or d if a coordinate of the point selects the technique."""
        return self.integrand.dims + (self.selection == "extra")

    @property
    def spec(self) -> str:
        """Text of the form ``integrand / one-sample heuristic[probabilities × densities]``."""
        parts = zip(self.probabilities, self.densities, strict=True)
        shown = ", ".join(f"{chance:.6g}×{p.spec}" for chance, p in parts)
        split = ", coordinate" if self.selection == "coordinate" else ""
        return f"{self.integrand.spec} / one-sample {self.heuristic}{split}[{shown}]"

    def _primary(self, technique: int) -> Integrand:
        """Return the single primary-space integrand g of all techniques."""
        return PrimaryIntegrand(self, technique, self.integrand)

    def primary_values(self, technique: int, u: Array) -> Array:
        """Return g(u) = w_t f/(P_t p_t). One coordinate selects t, and T_t maps all others."""
        del technique
        x, weights = self._chosen(u)
        values = scale(self.domain_integrand(x), weights)
        control = self.combination.control
        return values if control is None else np.asarray(values + control.sum(axis=0))

    def warp(self, technique: int, u: Array) -> Array:
        del technique
        return self._chosen(u)[0]

    def weighted_points(self, points: list[Array]) -> tuple[Array, Array]:
        """Return domain points (R, n, d) and their weights w_t/(P_t p_t n), (R, n)."""
        x, weights = self._chosen(points[0])
        return x, weights / x.shape[1]

    def primary_breaks(self, technique: int = 0) -> Breaks:  # noqa: ARG002
        """Return the positions on each primary axis where g may jump or bend.

        On one axis, these are the borders between the intervals that select different techniques.
        On all axes, these are the breaks of all g_t.
        """
        found: list[set[float]] = [set() for _ in range(self.dims)]
        axis = self.dims - 1 if self.selection == "extra" else 0
        found[axis].update(self._borders[1:-1].tolist())
        for t, density in enumerate(self.densities):
            own = carried_breaks(self.integrand, density, self.combination.breaks)
            for i, places in enumerate(own):
                if i == axis:  # This interval of the coordinate selects technique t
                    stretched = (self._borders[t] + b * self.probabilities[t] for b in places)
                    found[i].update(map(float, stretched))
                else:
                    found[i].update(places)
        return tuple(tuple(sorted(places)) for places in found)

    def _chosen(self, u: Array) -> tuple[Array, Array]:
        """Return domain points (..., d) of primary points (..., dims), and w_t/(P_t p_t)."""
        flat = u.reshape(-1, self.dims)
        extra = self.selection == "extra"
        chooser, rest = flat[:, -1 if extra else 0], flat[:, : self.integrand.dims]
        which = np.searchsorted(self._borders[1:-1], chooser, side="right")
        x, weights = np.empty((len(flat), self.integrand.dims)), np.empty(len(flat))
        for t, density in enumerate(self.densities):
            own = which == t
            part = rest[own].copy()
            if not extra:
                stretched = (part[:, 0] - self._borders[t]) / self.probabilities[t]
                part[:, 0] = np.clip(stretched, 0.0, BELOW_ONE)
            x[own] = density.sample(part)
            weights[own] = self.combination.over_density(t, x[own]) / self.probabilities[t]
        return x.reshape(*u.shape[:-1], -1), weights.reshape(u.shape[:-1])


@final
class TechniqueSum(AbstractEstimator):
    """A sum of separately sampled integrals, I = Σ_t (1/n_t) Σ_k g_t(u_tk).

    Each g_t includes its warp and weights, such as light and BSDF sampling of a renderer.
    Each g_t is defined on its own unit cube, so there is no common domain.

    Parameters
    ----------
    integrands
        The integrands g_t, or their spec strings.
    counts
        Numbers of points n_t as multiples of n; all equal by default.
    sets
        How the point sets of the techniques are related: ``"independent"``, ``"shared"`` or
        ``"joint"``; see `mcspectra.estimators.base`.
    dims
        Number of dims; needed for spec strings without ``dims``.
    """

    def __init__(
        self,
        integrands: Sequence[Integrand | str],
        *,
        counts: Sequence[int] | None = None,
        sets: str = "independent",
        dims: int | None = None,
    ) -> None:
        if not isinstance(integrands, list | tuple) or len(integrands) == 0:
            raise ParameterError(f"integrands is {shown(integrands)}; give a list of one or more.")
        dims = known_dims(dims, *integrands)
        self.integrands = tuple(as_integrand(g, dims) for g in integrands)
        check_same_dims(list(self.integrands))
        channels = {g.channels for g in self.integrands}
        if len(channels) > 1:
            raise ParameterError(
                f"The techniques have {sorted(channels)} channels; make them equal."
            )
        self.counts = check_counts(counts, len(self.integrands))
        self.sets = check_sets(sets, self.counts)

    @property
    def spec(self) -> str:
        """The specs of all g_t, joined by plus signs."""
        return " + ".join(g.spec for g in self.integrands) + self.sets_label

    def _primary(self, technique: int) -> Integrand:
        return self.integrands[technique]

    def primary_values(self, technique: int, u: Array) -> Array:
        return self.integrands[technique](u)


def split_mixture(
    integrand: Integrand | str, mixture: Density | str, *, most: int = 1000
) -> MultipleImportance:
    """Make an estimator that gives n w_t points to part t of a mixture, without random selection.

    Parameters
    ----------
    integrand
        The integrand f, or its spec string.
    mixture
        A mixture or defensive mixture, or its spec. Its parameter `selection` has no effect.
    most
        Largest accepted common denominator of the shares w_t; it is the sum of all counts c_t.

    Returns
    -------
    MultipleImportance
        An estimator with a technique for each part p_t, combined by the balance heuristic.
        The counts c_t of the techniques are proportional to the shares w_t of the mixture.
        With counts c_t there are n Σ c_t points, each with the weight 1/p, where p is the mixture.
        The points are therefore a stratified sample of the mixture ([OwenZhou2000]_ §3.2).
        For random points, the estimator's variance is at most that of sampling from the mixture.

    Raises
    ------
    ParameterError
        If `mixture` is not a mixture, or if no common denominator is at most `most`.

    Examples
    --------
    >>> e = split_mixture("gaussian(dims=1)", "mixture(parts=['uniform', 'tent'], weights=[1, 3])")
    >>> e.counts, [p.spec for p in e.densities]
    ((1, 3), ['uniform', 'tent'])
    """
    f = as_integrand(integrand, mixture.dims if isinstance(mixture, Density) else None)
    given = as_density(mixture, f.dims)
    found = given.mixture if isinstance(given, Defensive) else given
    if not isinstance(found, Mixture):
        raise ParameterError(
            f"{shown(mixture)} is not a mixture; give mixture(parts=[…]) or defensive(density=…)."
        )

    # Find the smallest integers that have the same ratios as the shares
    most, shares = as_integer("most", most, least=1), found.shares
    fractions = [Fraction(share).limit_denominator(most) for share in shares.tolist()]
    total = math.lcm(*(fraction.denominator for fraction in fractions))
    far = max(abs(float(f) - share) for f, share in zip(fractions, shares.tolist(), strict=True))
    if far > _EXACT or total > most or sum(fractions) != 1:
        written = ", ".join(f"{share:.6g}" for share in shares)
        raise ParameterError(
            f"The shares {written} have no common denominator up to {most}; give weights that are "
            "integers with a small sum, or raise most."
        )
    return MultipleImportance(f, found.parts, counts=[int(part * total) for part in fractions])
