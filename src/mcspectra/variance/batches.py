"""Errors of what spectra say by batch means: every block of realisations estimates it by itself.

Covariances within a block are unbiased, so that the terms of B blocks are B independent estimates of
the same numbers, and their spread gives the error of the mean; its 95 % interval has the quantile of
Student's t with B − 1 degrees of freedom. What all realisations together say is a little more precise
than that mean (by the variance of block means, of relative size one over the realisations of a
block): the errors are on the safe side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.estimators import Moments
from mcspectra.estimators.moments import rounding_floor
from mcspectra.variance._kernels import merge_spreads
from mcspectra.variance.sums import Partition, SpectralSums

__all__ = ["Batches", "RunningSpread", "Variables", "spread", "student_t"]

Variables: TypeAlias = dict[str, tuple[tuple[str, ...], Any]]
"""Result variables by name: dims and values."""

_LEVEL = 0.95


@dataclass(frozen=True)
class RunningSpread:
    """Weighted mean of arrays and squares about it, of blocks that are merged in any order.

    Deviations are taken about the mean with squared weights, which needs one pass only [West1979]_ and
    is the same for equal blocks. Of complex numbers the error is the root of the mean |error|².

    Attributes
    ----------
    blocks, weight, squared
        Number of arrays, the sum of their weights, and that of the squares of the weights.
    mean
        In the shape and type of the arrays.
    squares
        Sums for each real number of the arrays: (J,), or empty as long as they are zeros.
    """

    blocks: int
    weight: float
    squared: float
    mean: Array
    squares: Array

    @staticmethod
    def of(values: Array, weight: float) -> RunningSpread:
        """The spread of one array, which it takes over; all are of the same shape and type."""
        weight = float(weight)
        return RunningSpread(1, weight, weight**2, np.ascontiguousarray(values), np.zeros(0))

    def merge(self, other: RunningSpread) -> RunningSpread:
        """Spread of the arrays of both (Chan, Golub & LeVeque 1983), in the memory of this one."""
        squared = self.squared + other.squared
        part = other.squared / squared
        mean = _real(self.mean)
        squares = self.squares if self.squares.size else np.zeros(mean.size)
        merge_spreads(part, self.squared * part, mean, squares, _real(other.mean), other.squares)
        blocks, weight = self.blocks + other.blocks, self.weight + other.weight
        return RunningSpread(blocks, weight, squared, self.mean, squares)

    def error(self) -> Array:
        """Standard error of the mean, in the shape of the arrays; NaN for one."""
        if self.blocks < 2:
            return np.full(self.mean.shape, np.nan)
        squares = self.squares
        if np.iscomplexobj(self.mean):
            squares = squares.reshape(-1, 2).sum(axis=1)
        factor = self.blocks / (self.blocks - 1) / self.weight**2
        return np.asarray(np.sqrt(factor * squares.reshape(self.mean.shape)))


@dataclass(frozen=True)
class Batches:
    """What each block says: terms and measured variance kept, maps and matrices as their spread.

    Attributes
    ----------
    weights
        Degrees of freedom of each block: (B,).
    values
        Dc, power and cross term and measured variance: (B, 4, C).
    means
        Of the estimates: (B, C).
    contribution, band_covariance, matrix
        Of the contributions (C, H), of the covariances of bands (C, A, A) and, where they are asked for,
        of the stored covariances (H, 2H).
    """

    weights: Array
    values: Array
    means: Array
    contribution: RunningSpread
    band_covariance: RunningSpread
    matrix: RunningSpread | None

    @staticmethod
    def of(sums: SpectralSums, measured: Moments, partition: Partition) -> Batches | None:
        """What one block says; None for one realisation, which has no covariance."""
        degrees = sums.count - 1
        if degrees < 1:
            return None
        matrix = None if sums.matrix is None else RunningSpread.of(sums.matrix / degrees, degrees)
        return Batches(
            np.array([degrees], np.float64),
            np.stack([*sums.terms(partition), measured.variance])[None],
            measured.mean[None],
            RunningSpread.of(sums.contribution(partition), degrees),
            RunningSpread.of(sums.band_m2 / degrees, degrees),
            matrix,
        )

    def merge(self, other: Batches) -> Batches:
        """What the blocks of both say; takes over the memory of this one."""
        matrix = None
        if self.matrix is not None and other.matrix is not None:
            matrix = self.matrix.merge(other.matrix)
        return Batches(
            np.concatenate([self.weights, other.weights]),
            np.concatenate([self.values, other.values]),
            np.concatenate([self.means, other.means]),
            self.contribution.merge(other.contribution),
            self.band_covariance.merge(other.band_covariance),
            matrix,
        )

    @property
    def count(self) -> int:
        """B, the number of blocks of two or more realisations."""
        return len(self.weights)

    def term_errors(self) -> Array:
        """Standard errors of dc, power and cross term: (3, C)."""
        values, share = self._shared()
        return spread(values[:, :3] - np.einsum("b,btc->tc", share, values[:, :3]), share)

    def captured_half(self) -> Array:
        """Half the 95 % interval of predicted over measured variance: (C,)."""
        values, share = self._shared()
        mean = np.einsum("b,btc->tc", share, values)
        predicted, measured = mean[:3].sum(axis=0), mean[3]
        real = measured > rounding_floor(self.means.mean(axis=0))
        ratio = np.divide(predicted, measured, out=np.full_like(predicted, np.nan), where=real)
        residual = values[:, :3].sum(axis=1) - ratio * values[:, 3]
        half = spread(residual, share) / np.where(real, measured, np.nan)
        return np.asarray(half * student_t(self.count))

    def _shared(self) -> tuple[Array, Array]:
        """Values of the blocks (B, 4, C) and the weight of each (B,)."""
        return self.values, self.weights / self.weights.sum()


def _real(values: Array) -> Array:
    """The real numbers of an array in a row."""
    return values.reshape(-1).view(np.float64)


def spread(deviation: Array, share: Array) -> Array:
    """Standard error of a weighted mean over blocks (B, ...) from deviations; NaN for one block."""
    blocks = len(share)
    if blocks < 2:
        return np.full(deviation.shape[1:], np.nan)
    squares = np.tensordot(share**2, deviation**2, axes=1)
    return np.asarray(np.sqrt(squares * blocks / (blocks - 1)))


def student_t(batches: int) -> float:
    """Half the 95 % interval in standard errors from this many batches; two at least."""
    from scipy.special import stdtrit

    return float(stdtrit(max(1, batches - 1), 0.5 + _LEVEL / 2))
