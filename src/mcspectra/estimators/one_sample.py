"""The one-sample model of multiple importance sampling: each point chooses its technique.

I = (1/n) Σ_k w_t f/(P_t p_t) with t chosen with probability P_t [VeachGuibas1995]_, §9.2.4 of
[Veach1997]_: with the balance heuristic w_t = P_t p_t / Σ_s P_s p_s it is sampling of the mixture
Σ_s P_s p_s, and no other weights have less variance with random points (his Theorem 9.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_reals
from mcspectra.core.errors import ParameterError
from mcspectra.densities import Density
from mcspectra.estimators.base import PrimaryIntegrand, carried_breaks
from mcspectra.estimators.heuristics import Heuristic
from mcspectra.estimators.importance import scale
from mcspectra.estimators.mis import Combined
from mcspectra.integrands import Integrand
from mcspectra.integrands.base import Breaks

__all__ = ["SELECTIONS", "OneSampleMIS"]

SELECTIONS = ("extra", "coordinate")

_SUM = 1e-9  # by which probabilities may miss 1


@final
class OneSampleMIS(Combined):
    """Multiple importance sampling with one technique for each point, chosen at random.

    Parameters
    ----------
    integrand
        f, or its spec string.
    densities
        p_t with their warps, or spec strings.
    probabilities
        P_t, above 0 with the sum 1; equal by default.
    heuristic
        As for `MultipleImportance`, with P_t in the place of n_t. ``"optimal"`` is the balance heuristic
        with the control variate Σ α_t p_t, whose integral Σ α_t is added as it is [OwenZhou2000]_ §4,
        rather than as α_t/P_t of the chosen technique, which would add variance.
    selection
        ``"extra"``: the last of d + 1 coordinates chooses; ``"coordinate"``: the first of d chooses, and is
        stretched to be used again. The coordinate's borders are Σ_{s<t} P_s.
    dims
        Number of dims of f for spec strings without ``dims``.

    Raises
    ------
    DensityError
        All densities are zero at points where f is not.
    ParameterError
        No density, unknown heuristic, or invalid probabilities.

    Notes
    -----
    The primary-space integrand jumps, in general, where the choice changes: an axis-aligned jump
    that costs stratified points their rate, which separate sets of `MultipleImportance` do not have.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> e = mcs.OneSampleMIS("gaussian", ["uniform", "linear(slope=1)"], [0.25, 0.75], dims=1)
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
        self.probabilities = _as_probabilities(probabilities, len(self.densities))
        self.selection = as_choice("selection", selection, SELECTIONS)
        self._combine(heuristic, self.probabilities)
        self._borders = np.cumsum((0.0, *self.probabilities))
        self._borders[-1] = 1.0

    @property
    def dims(self) -> int:
        """d + 1, or d if a coordinate of the point chooses."""
        return self.integrand.dims + (self.selection == "extra")

    @property
    def spec(self) -> str:
        """``integrand / one-sample heuristic[probabilities × densities]``."""
        parts = zip(self.probabilities, self.densities, strict=True)
        shown = ", ".join(f"{chance:.6g}×{p.spec}" for chance, p in parts)
        split = ", coordinate" if self.selection == "coordinate" else ""
        return f"{self.integrand.spec} / one-sample {self.heuristic}{split}[{shown}]"

    def primary_integrand(self, technique: int = 0) -> Integrand:
        """g(u), of all techniques together."""
        return PrimaryIntegrand(self, technique, self.integrand)

    def primary_values(self, technique: int, u: Array) -> Array:
        """g(u) = w_t f/(P_t p_t) at T_t of the rest of u, t chosen by its coordinate."""
        del technique
        x, weights = self._chosen(u)
        values = scale(self.domain_integrand(x), weights)
        control = self.combination.control
        return values if control is None else np.asarray(values + control.sum(axis=0))

    def warp(self, technique: int, u: Array) -> Array:
        del technique
        return self._chosen(u)[0]

    def weighted_points(self, points: list[Array]) -> tuple[Array, Array]:
        """Domain points (R, n, d) and weights w_t/(P_t p_t n) (R, n); they depend on the choice."""
        x, weights = self._chosen(points[0])
        return x, weights / x.shape[1]

    def primary_breaks(self, technique: int = 0) -> Breaks:  # noqa: ARG002
        """Along each axis of primary space: borders of the choice, and breaks of every g_t."""
        found: list[set[float]] = [set() for _ in range(self.dims)]
        axis = self.dims - 1 if self.selection == "extra" else 0
        found[axis].update(self._borders[1:-1].tolist())
        for t, density in enumerate(self.densities):
            own = carried_breaks(self.integrand, density, self.combination.breaks)
            for i, places in enumerate(own):
                if i == axis:  # of the part of the axis that chooses this technique
                    stretched = (self._borders[t] + b * self.probabilities[t] for b in places)
                    found[i].update(map(float, stretched))
                else:
                    found[i].update(places)
        return tuple(tuple(sorted(places)) for places in found)

    def _chosen(self, u: Array) -> tuple[Array, Array]:
        """Domain points (..., d) and w_t/(P_t p_t) (...) of primary points (..., dims)."""
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
                part[:, 0] = np.clip(stretched, 0.0, np.nextafter(1.0, 0.0))
            x[own] = density.sample(part)
            weights[own] = self.combination.over_density(t, x[own]) / self.probabilities[t]
        return x.reshape(*u.shape[:-1], -1), weights.reshape(u.shape[:-1])


def _as_probabilities(given: Sequence[float] | None, techniques: int) -> tuple[float, ...]:
    """P_t from a list of as many numbers with the sum 1, or equal ones."""
    if given is None:
        return (1.0 / techniques,) * techniques
    if not isinstance(given, list | tuple | np.ndarray) or len(given) != techniques:
        raise ParameterError(
            f"probabilities is {given!r:.80}; give a list of {techniques}, one for each density."
        )
    found = as_reals("probabilities", given, techniques, above=0.0, most=1.0)
    if abs(sum(found) - 1.0) > _SUM:
        raise ParameterError(f"probabilities add up to {sum(found):.12g}; make their sum 1.")
    return found
