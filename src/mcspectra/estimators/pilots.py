"""Heuristics that know f, from a pilot: optimal weights and variance-aware ones.

The pilot is a quadrature, or random points that the estimate does not use: either way the weights do
not depend on the estimate's own samples, which keeps it unbiased. (The progressive estimator of
[Kondapaneni2019]_, which solves for α from the samples that it weights, is consistent but biased,
and is not offered.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.fields import choice, whole
from mcspectra.core.streams import Stream
from mcspectra.densities import Density
from mcspectra.estimators.heuristics import Balance, Combination, Heuristic, Pilot, density_breaks
from mcspectra.integrands.base import Breaks, Derived, Integrand

__all__ = ["Optimal", "Residual", "VarianceAware"]

_MOST_SAMPLES = 2**22
_SINGULAR = 1e-10  # relative; densities that differ by less share one α
_MOST_FACTOR = 1e8  # v_t = 1 + μ²/σ² of a technique whose samples are all alike, instead of ∞


@dataclass(frozen=True, kw_only=True)
class _Piloted(Heuristic):
    """The balance heuristic with what `adapt` finds out from a pilot."""

    pilot: str = choice("samples", "quadrature")
    samples: int = whole(4096, least=2, most=_MOST_SAMPLES)
    seed: int = whole(0, least=0)

    @property
    def pilot_evaluations(self) -> int:
        """`samples`; a quadrature is not counted."""
        return self.samples if self.pilot == "samples" else 0

    def ratio(self, q: Array, technique: int) -> Array:
        """Ratio of `balance`."""
        return Balance().ratio(q, technique)

    def fit(
        self, integrand: Integrand, densities: Sequence[Density], shares: Sequence[float]
    ) -> Combination:
        """Find shares and control."""
        parts = _Parts(integrand, tuple(densities), np.asarray(shares, np.float64))
        return Combination(self, parts.densities, *self.adapt(parts))


@final
@dataclass(frozen=True, kw_only=True)
class Optimal(_Piloted):
    """The weights of least variance of random points, which may be negative [Kondapaneni2019]_.

    With q = Σ n_t p_t, they are w_t = α_t p_t/f + (n_t p_t/q)(1 − Σ_s α_s p_s/f),
    where A α = b, A_st = ∫ p_s p_t/q, b_t = ∫ f p_t/q. Written out, w_t f/p_t is

        α_t + n_t (f − Σ_s α_s p_s)/q:

    the balance heuristic on f with Σ α_s p_s as a control variate. In this form f may be 0, and each
    channel has its own α. Identical or nearly identical densities make A singular; the solution of
    least norm is taken, which has the same Σ α_s p_s.

    Attributes
    ----------
    pilot
        Where A and b are from: ``"samples"``, random points of all techniques in proportion to
        their counts, or ``"quadrature"`` (then α is exact as far as that is).
    samples
        Pilot points of all techniques together, at least 2; not counted in n.
    seed
        Seed of the pilot points.
    """

    def adapt(self, pilot: Pilot) -> tuple[tuple[float, ...], Array]:
        """The counts as they are, and α: (T,) or (T, channels)."""
        if self.pilot == "quadrature":
            found = pilot.quadrature(pilot.system)
        else:
            # A and b side by side (T, T + C), of pilot points weighted by the balance heuristic
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

    w_t = v_t n_t p_t / Σ_s v_s n_s p_s with v_t = 1 + μ_t²/σ_t² of one random sample of f/p_t alone
    (at most 10⁸): a technique of low variance gets more weight than by the balance
    heuristic, which uses second moments. With several channels their mean is used.

    Attributes
    ----------
    pilot
        Where the moments are from: ``"samples"``, random points, as many of each technique, or
        ``"quadrature"``.
    samples
        Pilot points of all techniques together, at least 2; not counted in n.
    seed
        Seed of the pilot points.
    """

    def adapt(self, pilot: Pilot) -> tuple[tuple[float, ...], None]:
        """The counts times the factors v_t, and no control variate."""
        techniques = len(pilot.shares)
        if self.pilot == "quadrature":
            found = pilot.quadrature(pilot.moments)
        else:
            # Mean and mean square of f/p_t for random points of each technique
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
    """The pilot of an integrand with its densities on the unit cube."""

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
    """Several functions as the channels of one integrand, for the quadrature of integrands."""

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
    """Breaks of f and, in 1-D, those of the warps carried to the domain."""
    if integrand.dims > 1:
        return integrand.breaks
    return (tuple(sorted({*integrand.breaks[0], *density_breaks(densities)})),)
