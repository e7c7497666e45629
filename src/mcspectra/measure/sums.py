"""Mergeable second moments of spectra and band-limited estimates, in constant memory.

The moments give the power term, the contribution map and the band covariance.
The theory is in docs/theory.md, "Contributions and bands".

Errors come from batch means. Every block of realizations gives an unbiased estimate.
The spread over B blocks gives the error of the mean over blocks.
Intervals use the quantile of Student's t for B − 1 degrees of freedom.
The errors are conservative: the estimate from all realizations together is more precise.
If realizations reuse a few stored sets, groups of these sets replace the blocks.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import student_t
from mcspectra.core.ordered import gram, weighted_sum
from mcspectra.core.records import JOIN, SUM, merged
from mcspectra.estimators.moments import Moments
from mcspectra.measure._kernels import accumulate, band_estimates, term_sums
from mcspectra.samplers.law import Law, independent_sets

__all__ = [
    "BATCH_SETTINGS",
    "BatchSettings",
    "Batches",
    "Partition",
    "RunningSpread",
    "SpectralSums",
    "StoredGroups",
    "TermSums",
    "Variables",
    "ratio_factors",
    "spread",
    "student_t",
]

Variables: TypeAlias = dict[str, tuple[tuple[str, ...], Any]]
"""Variables of a result. For each name there are the names of the dims, and the values."""


@dataclass(frozen=True)
class BatchSettings:
    """Number of blocks of realizations. The spread over blocks gives standard errors."""

    # Least number of blocks, if there are at least two realizations for each block.
    # Student's t with 19 degrees of freedom makes intervals 7 % wider than a normal law.
    # 40 blocks would make intervals 3 % wider, and 10 blocks 15 % wider.
    least: int = 20


BATCH_SETTINGS = BatchSettings()
"""Settings of all analyses with batch means."""


@dataclass(frozen=True)
class StoredGroups:
    """Groups of realizations that reuse stored sets: realization r uses the set r mod `sets`.

    Attributes
    ----------
    first
        Number of the first realization of a block.
    sets, groups
        Number of stored sets, and number of groups of sets. The spread of groups gives errors.
    """

    first: int
    sets: int
    groups: int

    @staticmethod
    def of(law: Law, realizations: int, first: int) -> StoredGroups | None:
        """Return groups of the stored sets that realizations reuse, or None if no set is reused."""
        sets = independent_sets(law)
        if sets is None or sets >= realizations:
            return None
        # A group needs two realizations for a variance.
        # The two realizations may be translations of one set, or two different sets
        alone = law.stationary and realizations >= 2 * sets
        return StoredGroups(
            first, sets, min(sets if alone else max(sets // 2, 1), BATCH_SETTINGS.least)
        )

    def labels(self, count: int) -> Array:
        """Return the group of each realization of a block."""
        return np.asarray((self.first + np.arange(count)) % self.sets % self.groups)


@dataclass(frozen=True)
class TermSums:
    """Sums of spectra and estimates over realizations, and the terms of each block."""

    sums: SpectralSums
    measured: Moments
    batches: Batches | None  # None if every block has fewer than two realizations
    # Sums for each group of stored sets. The names of groups are "0", "1" and so on.
    # If no set is reused, there are no groups, and `batches` is used
    by_group: dict[str, TermSums] | None = None

    @staticmethod
    def of(
        spectra: Array, estimates: Array, partition: Partition, stored: StoredGroups | None = None
    ) -> TermSums:
        """Return sums of a block: spectra (R, H), real or complex, and estimates (R, C)."""
        sums = SpectralSums.of(spectra, partition)
        if stored is None:
            measured = Moments.of(estimates, tails=True)
            return TermSums(sums, measured, Batches.of(sums, measured, partition))
        first, sets = stored.first, stored.sets
        measured = Moments.of(estimates, tails=True, first=first, sets=sets)
        label, groups = stored.labels(len(spectra)), {}
        for group in np.unique(label):
            own = label == group
            part = SpectralSums.of(spectra[own], partition)
            groups[str(group)] = TermSums(part, Moments.of(estimates[own]), None)
        return TermSums(sums, measured, None, groups)

    def merge(self, other: TermSums) -> TermSums:
        """Return the sums over the realizations of `self` and `other`, group by group."""
        groups = None
        if self.by_group is not None and other.by_group is not None:
            groups = dict(self.by_group)
            for name, own in other.by_group.items():
                groups[name] = groups[name].merge(own) if name in groups else own
        batches = self.batches if other.batches is None else other.batches
        if self.batches is not None and other.batches is not None:
            batches = merged(self.batches, other.batches)
        sums, measured = self.sums.merge(other.sums), self.measured.merge(other.measured)
        return TermSums(sums, measured, batches, groups)

    def all_batches(self, partition: Partition) -> Batches | None:
        """Return batches by block or stored set, or None if no batch has two realizations."""
        if self.by_group is None:
            return self.batches
        each = (Batches.of(g.sums, g.measured, partition) for g in self.by_group.values())
        known = [batches for batches in each if batches is not None]
        return functools.reduce(merged, known) if known else None


@dataclass(frozen=True)
class Partition:
    """The coefficients of the integrand, with their weights and labels."""

    # Stored coefficients f_m of all techniques, one technique after another.
    # The shape is (C, H), real or complex
    coefficients: Array
    double: Array  # 2.0 if a coefficient counts for both m and −m, else 1.0: (H,)
    dc: Array  # Whether a coefficient belongs to the constant function: bool (H,)
    band: Array  # Band of each coefficient: int64 (H,)
    shell: Array  # Smallest half width that includes each coefficient: int64 (H,)
    matrix: bool = False  # Whether to keep the full covariance matrix


@dataclass(frozen=True)
class SpectralSums:
    """Sums of S and of estimates over `count` realizations; `merge` adds more realizations."""

    count: int
    mean: Array  # (H,) complex: S̄
    estimate_mean: Array  # Mean of the estimates of each channel, (C,)
    m2: Array  # Sums of |S − S̄|² over realizations, (H,)
    cov: Array  # Sums of S − S̄ times (estimate − its mean), (C, H) complex
    band_mean: Array  # Mean of the estimate from each band, (C, A)
    band_m2: Array  # Sums of products of deviations of two bands' estimates, (C, A, A)
    truncated: Moments  # Moments of the estimate truncated at each half width: (C, K+1)
    # Σ_r (S − S̄)_m conj(S − S̄)_l, and Σ_r (S − S̄)_m (S − S̄)_l without the conjugate: (H, 2H).
    # The sums with and without the conjugate give the covariances between ±m and ±l
    matrix: Array | None

    @staticmethod
    def of(s: Array, partition: Partition) -> SpectralSums:
        """Return sums of a block s (R, H), which is real or complex like the coefficients."""
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
            matrix=gram(s - mean) if partition.matrix else None,
        )

    def terms(self, partition: Partition) -> tuple[Array, Array, Array]:
        """Return unbiased dc, power and cross terms, each (C,). They add up to the variance."""
        f = partition.coefficients
        sums = np.zeros((len(f), 3))
        term_sums(f, self.m2, self.cov, partition.double, partition.dc, sums)
        dc, power, total = sums.T / max(self.count - 1, 1)
        return dc, power, total - dc - power

    def contribution(self, partition: Partition) -> Array:
        """Return contributions of stored coefficients to the variance, for ±m each: (C, H)."""
        f = partition.coefficients
        return np.asarray((f.conj() * self.cov).real / max(self.count - 1, 1))

    def merge(self, other: SpectralSums) -> SpectralSums:
        """Return sums over both sets of realizations together (Chan, Golub & LeVeque 1983)."""
        a, b = self.count, other.count
        factor, part = a * b / (a + b), b / (a + b)
        delta = other.mean - self.mean
        shift = other.estimate_mean - self.estimate_mean
        jump = other.band_mean - self.band_mean
        matrix = None
        if self.matrix is not None and other.matrix is not None:
            matrix = self.matrix + other.matrix + factor * gram(delta[None])
        return replace(
            self,
            count=a + b,
            mean=self.mean + part * delta,
            estimate_mean=self.estimate_mean + part * shift,
            m2=self.m2 + other.m2 + a * part * (delta.real**2 + delta.imag**2),
            cov=self.cov + other.cov + (a * part * shift)[:, None] * delta,
            band_mean=self.band_mean + part * jump,
            band_m2=self.band_m2 + other.band_m2 + factor * np.einsum("ca,cb->cab", jump, jump),
            truncated=self.truncated.merge(other.truncated),
            matrix=matrix,
        )


@dataclass(frozen=True)
class RunningSpread:
    """Sums over blocks that give the standard error of a weighted mean of arrays.

    Each block has an array x and a weight w; all arrays x have the same shape and type.
    The error follows from the deviations of the arrays x from their mean with the weights w².
    If all blocks are equally long, the mean with the weights w² is the plain mean over blocks.
    For complex numbers the error is the root of the mean |error|².
    """

    total: SUM  # Σ w² x
    squares: SUM  # Σ w² |x|²
    weight: float  # Σ w
    squared: float  # Σ w²
    blocks: int = 1

    @staticmethod
    def of(values: Array, weight: float) -> RunningSpread:
        """Return the sums over a single block with the array `values`."""
        weight = float(weight)
        total = weight**2 * values
        return RunningSpread(total, (total * values.conj()).real, weight, weight**2)

    def error(self) -> Array:
        """Return the standard error of the mean, in the shape of the arrays. NaN for one array."""
        if self.blocks < 2:
            return np.full(self.squares.shape, np.nan)
        squares = self.squares - np.abs(self.total) ** 2 / self.squared
        factor = self.blocks / (self.blocks - 1) / self.weight**2
        return np.asarray(np.sqrt(factor * np.maximum(squares, 0.0)))


@dataclass(frozen=True)
class Batches:
    """Terms of the variance in each block of realizations, and the spread of covariances."""

    weights: JOIN  # Degrees of freedom of each block: (B,)
    values: JOIN  # dc, power and cross term and measured variance: (B, 4, C)
    # `contribution` is the spread between blocks for the contributions of frequencies: (C, H).
    # `band_covariance` is the spread between blocks for the covariances of two bands: (C, A, A).
    # `matrix` is the spread between blocks for the covariances of two frequencies: (H, 2H).
    # If covariances of two frequencies were not requested, `matrix` is None
    contribution: RunningSpread
    band_covariance: RunningSpread
    matrix: RunningSpread | None

    @staticmethod
    def of(sums: SpectralSums, measured: Moments, partition: Partition) -> Batches | None:
        """Return the terms of the variance in a block, or None if it has a single realization."""
        degrees = sums.count - 1
        if degrees < 1:
            return None
        matrix = None if sums.matrix is None else RunningSpread.of(sums.matrix / degrees, degrees)
        return Batches(
            np.array([degrees], np.float64),
            np.stack([*sums.terms(partition), measured.variance])[None],
            RunningSpread.of(sums.contribution(partition), degrees),
            RunningSpread.of(sums.band_m2 / degrees, degrees),
            matrix,
        )

    @property
    def count(self) -> int:
        """Number B of blocks with two or more realizations."""
        return len(self.weights)

    @property
    def share(self) -> Array:
        """Return the weight of each block in a mean, (B,)."""
        return np.asarray(self.weights / self.weights.sum())

    def term_errors(self) -> Array:
        """Return standard errors of dc, power and cross term: (3, C)."""
        terms, share = self.values[:, :3], self.share
        return spread(terms - weighted_sum(share, terms), share)

    def captured_factors(self) -> Array:
        """Return factors that turn the ratio predicted/measured into its interval ends: (C, 2).

        Multiply the ratio predicted/measured by the two factors to get its 95 % interval.
        """
        return ratio_factors(self.values[:, :3].sum(axis=1), self.values[:, 3], self.share)


def spread(deviation: Array, share: Array) -> Array:
    """Return the standard error of a weighted mean over blocks (B, ...), or NaN for one block."""
    blocks = len(share)
    if blocks < 2:
        return np.full(deviation.shape[1:], np.nan)
    squares = weighted_sum(share**2, deviation**2)
    return np.asarray(np.sqrt(squares * blocks / (blocks - 1)))


def ratio_factors(above: Array, below: Array, share: Array) -> Array:
    """Return the ends of the 95 % interval of a ratio of two means, divided by the ratio.

    The ratio is the weighted mean of `above` divided by the weighted mean of `below`.
    The arrays `above` and `below` have one positive number per block: (B, ...).
    The result has shape (..., 2).
    The interval is logarithmic, by the jackknife with Student's t [Miller1974]_.
    If the error comes mostly from few blocks, the tail is not resolved.
    With an unresolved tail, the interval is 1 + √(excess kurtosis / B) times as wide.
    The skewness also widens the interval on the side of the unresolved tail.
    The coverage of these intervals is measured by ``python -m benchmarks coverage``.
    """
    blocks = len(share)
    if blocks < 2:
        return np.full((*above.shape[1:], 2), np.nan)
    weight = share.reshape(-1, *[1] * (above.ndim - 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        # Replace predictions at rounding level by a fixed fraction of the measured variance
        above = np.maximum(above, np.finfo(float).eps ** 2 * below)
        a, b = ((weighted_sum(share, v) - weight * v) / (1.0 - weight) for v in (above, below))
        influence = (1.0 - 1.0 / weight) * np.log(a / b)
        influence = influence - weighted_sum(share, influence)
        error = student_t(blocks) * spread(influence, share)
        scale = np.sqrt((influence**2).mean(axis=0))
        unit = np.divide(influence, scale, out=np.zeros_like(influence), where=scale > 0)
    skewness, kurtosis = (unit**3).mean(axis=0), (unit**4).mean(axis=0)
    wider = 1.0 + np.sqrt(np.maximum(kurtosis - 3.0, 0.0) / blocks)
    low, high = (error * (wider + np.maximum(sign * skewness, 0.0)) for sign in (-1, 1))
    with np.errstate(over="ignore"):  # If exp overflows, the upper end is infinite
        return np.asarray(np.exp(np.stack([-low, high], axis=-1)))
