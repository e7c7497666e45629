"""Second moments of several techniques: streamed over realisations, mergeable.

With S^t_m the spectrum of technique t's points and f^t its integrand, E_t = Σ_m conj(f^t_m) S^t_m is
what the technique adds to the truncated estimate, and

    Cov(E_t, E_s) = Re [conj(f^t_0) f^s_0 C^ts_00 + Σ_{m≠0} conj(f^t_m) f^s_m C^ts_mm + Σ_{m≠l} …]

with C^ts_ml = ⟨S^t_m conj(S^s_l)⟩ − ⟨S^t_m⟩ conj(⟨S^s_l⟩). In the domain view all f^t are f and the points
carry the weights w_t/(p_t n_t); in primary space they carry 1/n_t and f^t is g_t.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.estimators import AbstractEstimator, Moments
from mcspectra.spectra.bases import Basis, Coefficients
from mcspectra.variance.batches import spread

__all__ = ["Covariances", "TechniqueBatches", "TechniqueSums", "TechniqueView"]

_MOST = 2**25  # complex numbers of Σ_r S^t conj(S^s): 512 MiB


@dataclass(frozen=True)
class TechniqueView:
    """Coefficients f^t (C, T, H) and the transforms of each technique's points."""

    estimator: AbstractEstimator
    domain: bool
    basis: Basis
    transforms: tuple[Coefficients, ...]
    coefficients: Array
    engine: str
    source: str

    @staticmethod
    def of(
        estimator: AbstractEstimator, n: int, space: str, basis: Basis, engine: str, eps: float
    ) -> TechniqueView:
        """Prepare the transforms of n · counts[t] points.

        Raises
        ------
        ParameterError
            The techniques and frequencies are too many.
        """
        techniques = range(len(estimator.counts))
        size = len(techniques) ** 2 * basis.stored
        if size > _MOST:
            raise ParameterError(
                f"{len(techniques)}² pairs of techniques at {basis.stored} frequencies are more "
                f"than {_MOST} covariances; choose a smaller half_width."
            )
        made = [basis.transform(n * c, engine, eps) for c in estimator.counts]
        f = estimator.domain_integrand if space == "domain" else None
        integrands = [estimator.primary_integrand(t) for t in techniques] if f is None else [f]
        found = [basis.integrand(g) for g in integrands]
        stacked = np.stack([coefficients for coefficients, _ in found], axis=1)
        shape = (len(stacked), len(techniques), basis.stored)
        return TechniqueView(
            estimator,
            f is not None,
            basis,
            tuple(transform for transform, _ in made),
            np.broadcast_to(stacked, shape),
            made[0][1],
            "; ".join(dict.fromkeys(source for _, source in found)),
        )

    def spectra(self, points: list[Array]) -> Array:
        """Spectra of each technique of a block: (R, T, H)."""
        if self.domain and len(points) == 1:  # its weights may depend on u, beyond x
            return self.transforms[0](*self.estimator.weighted_points(points))[:, None]
        parts = []
        for technique, (u, transform) in enumerate(zip(points, self.transforms, strict=True)):
            if self.domain:
                x = self.estimator.warp(technique, u)
                parts.append(transform(x, self.estimator.weight(technique, x) / u.shape[1]))
            else:
                parts.append(transform(u, None))
        return np.stack(parts, axis=1)

    def estimates(self, points: list[Array]) -> Array:
        """What each technique adds to the estimate: (R, C, T)."""
        values = [
            self.estimator.primary_values(t, u).mean(axis=1).reshape(len(u), -1)
            for t, u in enumerate(points)
        ]
        return np.stack(values, axis=2)

    def truncated(self, spectra: Array) -> Array:
        """The same from spectra (R, T, H) alone: (R, C, T)."""
        weighted = self.coefficients.conj() * self.basis.double
        return np.stack(
            [(spectra[:, t] @ weighted[:, t].T).real for t in range(spectra.shape[1])], axis=2
        )


@dataclass(frozen=True)
class Covariances:
    """Dc, power and cross term and measured covariance of pairs of techniques, each (C, T, T)."""

    dc: Array
    power: Array
    cross: Array
    measured: Array

    @property
    def stacked(self) -> Array:
        """All four: (4, C, T, T)."""
        return np.stack([self.dc, self.power, self.cross, self.measured])


@dataclass(frozen=True)
class TechniqueSums:
    """Sums over `count` realisations about the running means; `merge` adds those of others."""

    count: int
    mean: Array  # (T, H)
    products: Array  # (T, T, H): Σ_r (S^t − S̄^t) conj(S^s − S̄^s)
    values_mean: Array  # (2, C, T): truncated and full estimates of the techniques
    values_products: Array  # (2, C, T, T)
    moments: Moments  # of the full estimates of the techniques, and of their sum: (C, T + 1)

    @staticmethod
    def of(view: TechniqueView, points: list[Array]) -> TechniqueSums:
        """Sums of a block."""
        s, full = view.spectra(points), view.estimates(points)
        values = np.stack([view.truncated(s), full], axis=1)
        mean, values_mean = s.mean(axis=0), values.mean(axis=0)
        deviation, off = s - mean, values - values_mean
        return TechniqueSums(
            count=len(s),
            mean=mean,
            products=np.einsum("rth,rsh->tsh", deviation, deviation.conj()),
            values_mean=values_mean,
            values_products=np.einsum("rkct,rkcs->kcts", off, off),
            moments=Moments.of(np.concatenate([full, full.sum(axis=2, keepdims=True)], axis=2)),
        )

    def merge(self, other: TechniqueSums) -> TechniqueSums:
        """Sums of both sets of realisations together (Chan, Golub & LeVeque 1983)."""
        a, b = self.count, other.count
        factor, part = a * b / (a + b), b / (a + b)
        delta, jump = other.mean - self.mean, other.values_mean - self.values_mean
        return replace(
            self,
            count=a + b,
            mean=self.mean + part * delta,
            products=self.products
            + other.products
            + factor * np.einsum("th,sh->tsh", delta, delta.conj()),
            values_mean=self.values_mean + part * jump,
            values_products=self.values_products
            + other.values_products
            + factor * np.einsum("kct,kcs->kcts", jump, jump),
            moments=self.moments.merge(other.moments),
        )

    def covariances(self, view: TechniqueView) -> Covariances:
        """The terms, unbiased: dc + power + cross is the covariance of the truncated estimates."""
        f, basis, degrees = view.coefficients, view.basis, max(self.count - 1, 1)
        weighted = self.products * basis.double / degrees
        at = slice(basis.dc, basis.dc + 1)
        dc = _paired(f[..., at], weighted[..., at])
        weighted[..., at] = 0.0
        power = _paired(f, weighted)
        total, measured = self.values_products / degrees
        return Covariances(dc, power, total - dc - power, measured)


@dataclass(frozen=True)
class TechniqueBatches:
    """The covariances that each block of realisations says by itself, for standard errors.

    Attributes
    ----------
    weights
        Degrees of freedom of each block: (B,).
    values
        Dc, power, cross and measured: (B, 4, C, T, T).
    """

    weights: Array
    values: Array

    @staticmethod
    def of(sums: TechniqueSums, view: TechniqueView) -> TechniqueBatches:
        """One block; a block of one realisation has no covariance and says nothing."""
        some = slice(0, int(sums.count > 1))
        values = sums.covariances(view).stacked[None]
        return TechniqueBatches(np.array([sums.count - 1.0])[some], values[some])

    def merge(self, other: TechniqueBatches) -> TechniqueBatches:
        """The blocks of both."""
        return TechniqueBatches(
            np.concatenate([self.weights, other.weights]),
            np.concatenate([self.values, other.values]),
        )

    @property
    def errors(self) -> Array:
        """Standard errors of dc, power, cross and measured: (4, C, T, T); NaN for one block."""
        share = self.weights / self.weights.sum()
        return spread(self.values - np.tensordot(share, self.values, axes=1), share)


def _paired(f: Array, products: Array) -> Array:
    """Re Σ_h conj(f^t_h) f^s_h products^ts_h: (C, T, T)."""
    return np.stack([np.einsum("th,sh,tsh->ts", g.conj(), g, products).real for g in f])
