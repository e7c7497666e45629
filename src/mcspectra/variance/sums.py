"""Mergeable second moments of spectra and band-limited estimates: memory flat in realisations.

With R realisations the sums hold, about the running means (Chan, Golub & LeVeque 1983),

    Σ|S_m − S̄_m|²,  Σ(S_m − S̄_m)(I − Ī),  Σ(I_a − Ī_a)(I_b − Ī_b),  moments of the truncated I,

from which the power term, the contribution map and the band covariance follow (DESIGN §1).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.estimators.moments import Moments
from mcspectra.variance._kernels import accumulate, band_estimates, merge_moments, term_sums

__all__ = ["Partition", "SpectralSums"]


@dataclass(frozen=True)
class Partition:
    """What the sums need to know of the coefficients.

    Attributes
    ----------
    coefficients
        f_m of all techniques, as far as they are stored, one after the other: (C, H), real or complex.
    double
        2.0 for a coefficient that stands for −m too, else 1.0: (H,).
    dc
        Which coefficients are those of the constant function: bool (H,).
    band
        Band of each coefficient: int64 (H,).
    shell
        Half width at which each coefficient comes in: int64 (H,).
    matrix
        Whether to keep the full covariance matrix.
    """

    coefficients: Array
    double: Array
    dc: Array
    band: Array
    shell: Array
    matrix: bool = False


@dataclass(frozen=True)
class SpectralSums:
    """Sums over `count` realisations; `merge` adds those of others."""

    count: int
    mean: Array  # (H,) complex: S̄
    estimate_mean: Array  # (C,)
    m2: Array  # (H,)
    cov: Array  # (C, H) complex
    band_mean: Array  # (C, A)
    band_m2: Array  # (C, A, A)
    truncated: Moments  # of the estimate truncated at each half width: (C, K+1)
    matrix: Array | None  # (H, 2H): Σ (S−S̄)_m conj(S−S̄)_l and without conj, see terms.py

    @staticmethod
    def of(s: Array, partition: Partition) -> SpectralSums:
        """Sums of a block: s is (R, H), real or complex like the coefficients."""
        f, double = partition.coefficients, partition.double
        shape = (len(s), len(f))
        bands = np.zeros((*shape, int(partition.band.max()) + 1))
        shells = np.zeros((*shape, int(partition.shell.max()) + 1))
        mean = np.zeros(s.shape[1], s.dtype)
        band_estimates(s, f, double, partition.band, partition.shell, bands, shells, mean)
        mean /= len(s)
        estimate = bands.sum(axis=2)
        estimate_mean = estimate.mean(axis=0)
        squares, cov = np.zeros_like(mean), np.zeros_like(f)
        numbers = (a.view(np.float64) for a in (squares, cov))
        accumulate(s.view(np.float64), mean.view(np.float64), estimate - estimate_mean, *numbers)
        band_mean = bands.mean(axis=0)
        deviation = bands - band_mean
        return SpectralSums(
            count=len(s),
            mean=mean,
            estimate_mean=estimate_mean,
            m2=squares.real + squares.imag,
            cov=cov,
            band_mean=band_mean,
            band_m2=np.einsum("rca,rcb->cab", deviation, deviation),
            truncated=Moments.of(np.cumsum(shells, axis=2)),
            matrix=_outer(s - mean) if partition.matrix else None,
        )

    def terms(self, partition: Partition) -> tuple[Array, Array, Array]:
        """Dc, power and cross term, each (C,): unbiased, and their sum is the variance of I."""
        f = partition.coefficients
        sums = np.zeros((len(f), 3))
        term_sums(f, self.m2, self.cov, partition.double, partition.dc, sums)
        dc, power, total = sums.T / max(self.count - 1, 1)
        return dc, power, total - dc - power

    def contribution(self, partition: Partition) -> Array:
        """Contribution of each stored coefficient to the variance, for ±m each: (C, H)."""
        f = partition.coefficients
        return np.asarray((f.conj() * self.cov).real / max(self.count - 1, 1))

    def merge(self, other: SpectralSums) -> SpectralSums:
        """Sums of both sets of realisations together."""
        a, b = self.count, other.count
        factor = a * b / (a + b)
        part = b / (a + b)
        shift = other.estimate_mean - self.estimate_mean
        jump = other.band_mean - self.band_mean
        matrix = None
        if self.matrix is not None and other.matrix is not None:
            delta = (other.mean - self.mean)[None, :]
            matrix = self.matrix + other.matrix + factor * _outer(delta)
        mean, m2, cov = merge_moments(
            a, self.mean, self.m2, self.cov, b, other.mean, other.m2, other.cov, shift
        )
        return replace(
            self,
            count=a + b,
            mean=mean,
            estimate_mean=self.estimate_mean + part * shift,
            m2=m2,
            cov=cov,
            band_mean=self.band_mean + part * jump,
            band_m2=self.band_m2 + other.band_m2 + factor * np.einsum("ca,cb->cab", jump, jump),
            truncated=self.truncated.merge(other.truncated),
            matrix=matrix,
        )


def _outer(deviation: Array) -> Array:
    """Σ_r d_m conj(d_l) beside Σ_r d_m d_l, from which all four sign pairs of (m, l) follow."""
    return np.concatenate([deviation.T @ deviation.conj(), deviation.T @ deviation], axis=1)
