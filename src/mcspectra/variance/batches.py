"""Errors of what spectra say by batch means: every block of realisations estimates it by itself.

Covariances within a block are unbiased, so that the terms of B blocks are B independent estimates of
the same numbers, and their spread gives the error of the mean; its 95 % interval has the quantile of
Student's t with B − 1 degrees of freedom. What all realisations together say is a little more precise
than that mean (by the variance of block means, of relative size one over the realisations of a
block): the errors are on the safe side.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.estimators import Moments
from mcspectra.estimators.moments import rounding_floor
from mcspectra.variance._kernels import add_to_spread
from mcspectra.variance.sums import Partition, SpectralSums

__all__ = ["Batches", "RunningSpread", "Variables", "spread", "student_t"]

Variables: TypeAlias = dict[str, tuple[tuple[str, ...], Any]]
"""Result variables by name: dims and values."""

_LEVEL = 0.95


class Batches:
    """What each block says: terms and measured variance kept, maps and matrices as their spread."""

    def __init__(self) -> None:
        self._weights: list[int] = []
        self._values: list[Array] = []
        self._means: list[Array] = []
        self.contribution = RunningSpread()
        """Of the contributions (C, H)."""
        self.band_covariance = RunningSpread()
        """Of the covariances of bands (C, A, A)."""
        self.matrix = RunningSpread()
        """Of the stored covariances (H, 2H), where they are asked for."""

    @property
    def count(self) -> int:
        """B, the number of blocks of two or more realisations."""
        return len(self._weights)

    def add(self, sums: SpectralSums, measured: Moments, partition: Partition) -> None:
        """Take in one block; a block of one realisation has no covariance and says nothing."""
        degrees = sums.count - 1
        if degrees < 1:
            return
        self._weights.append(degrees)
        self._values.append(np.stack([*sums.terms(partition), measured.variance]))
        self._means.append(measured.mean)
        self.contribution.add(sums.contribution(partition), degrees)
        self.band_covariance.add(sums.band_m2 / degrees, degrees)
        if sums.matrix is not None:
            self.matrix.add(sums.matrix / degrees, degrees)

    def term_errors(self) -> Array:
        """Standard errors of dc, power and cross term: (3, C)."""
        values, share = self._shared()
        return spread(values[:, :3] - np.einsum("b,btc->tc", share, values[:, :3]), share)

    def captured_half(self) -> Array:
        """Half the 95 % interval of predicted over measured variance: (C,)."""
        values, share = self._shared()
        mean = np.einsum("b,btc->tc", share, values)
        predicted, measured = mean[:3].sum(axis=0), mean[3]
        real = measured > rounding_floor(np.mean(self._means, axis=0))
        ratio = np.divide(predicted, measured, out=np.full_like(predicted, np.nan), where=real)
        residual = values[:, :3].sum(axis=1) - ratio * values[:, 3]
        half = spread(residual, share) / np.where(real, measured, np.nan)
        return np.asarray(half * student_t(self.count))

    def _shared(self) -> tuple[Array, Array]:
        """Values of the blocks (B, 4, C) and the weight of each (B,)."""
        weight = np.array(self._weights, np.float64)
        return np.array(self._values), weight / weight.sum()


class RunningSpread:
    """Standard errors of the weighted mean of arrays that come one after the other [West1979]_.

    Deviations are taken about the mean with squared weights, which needs one pass only and is the
    same for equal blocks. Of complex numbers the error is the root of the mean |error|².
    """

    def __init__(self) -> None:
        self._blocks, self._weight, self._squared = 0, 0.0, 0.0
        self._mean: Array = np.zeros(0)
        self._squares: Array = np.zeros(0)
        self._shape: tuple[int, ...] = ()
        self._complex = False

    def add(self, values: Array, weight: float) -> None:
        """Take in one array, all of the same shape and type."""
        if not self._blocks:
            self._shape, self._complex = values.shape, np.iscomplexobj(values)
            self._mean = np.zeros(values.size * (2 if self._complex else 1))
            self._squares = np.zeros_like(self._mean)
        self._blocks += 1
        self._weight += weight
        self._squared += weight**2
        numbers = np.ascontiguousarray(values).reshape(-1).view(np.float64)
        part = weight**2 / self._squared
        add_to_spread(numbers, part, weight**2, self._mean, self._squares)

    def error(self) -> Array:
        """Standard error of the mean, in the shape of the arrays; NaN for one."""
        squares = self._squares
        if self._complex:
            squares = squares.reshape(-1, 2).sum(axis=1)
        squares = squares.reshape(self._shape)
        if self._blocks < 2:
            return np.full_like(squares, np.nan)
        factor = self._blocks / (self._blocks - 1) / self._weight**2
        return np.asarray(np.sqrt(factor * squares))


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
