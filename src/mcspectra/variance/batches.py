"""Standard errors of the terms by batch means: every block of realisations estimates them by itself.

Covariances within a block are unbiased, so that the terms of B blocks are B independent estimates of
the same numbers, and their spread gives the error of the mean. The terms of all realisations together
are a little more precise than that mean (by the variance of block means, of relative size one over
the realisations of a block): the errors are on the safe side.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.estimators import Moments
from mcspectra.estimators.moments import rounding_floor
from mcspectra.variance.sums import Partition, SpectralSums

__all__ = ["Batches", "Variables", "spread"]

Variables: TypeAlias = dict[str, tuple[tuple[str, ...], Any]]
"""Result variables by name: dims and values."""

_NAMES = ("dc_term_se", "power_term_se", "cross_term_se")
_LEVEL = 0.95


class Batches:
    """The terms and the measured variance of each block."""

    def __init__(self) -> None:
        self._weights: list[int] = []
        self._values: list[Array] = []
        self._means: list[Array] = []

    def add(self, sums: SpectralSums, measured: Moments, partition: Partition) -> None:
        """Take in one block; a block of one realisation has no covariance and says nothing."""
        if sums.count < 2:
            return
        self._weights.append(sums.count - 1)
        self._values.append(np.stack([*sums.terms(partition), measured.variance]))
        self._means.append(measured.mean)

    def errors(self, captured: Array) -> Variables:
        """Standard errors of the terms, and the interval of `captured`, predicted over measured."""
        from scipy.special import stdtrit

        values, weight = np.array(self._values), np.array(self._weights, np.float64)
        share = weight / weight.sum()
        mean = np.einsum("b,btc->tc", share, values)
        predicted, measured = mean[:3].sum(axis=0), mean[3]
        real = measured > rounding_floor(np.mean(self._means, axis=0))
        ratio = np.divide(predicted, measured, out=np.full_like(predicted, np.nan), where=real)
        residual = values[:, :3].sum(axis=1) - ratio * values[:, 3]
        half = spread(residual, share) / np.where(real, measured, np.nan)
        half = half * stdtrit(max(1, len(weight) - 1), 0.5 + _LEVEL / 2)
        errors = spread(values[:, :3] - mean[:3], share)
        terms = {name: (("channel",), error) for name, error in zip(_NAMES, errors, strict=True)}
        interval = np.stack([captured - half, captured + half], axis=-1)
        return {**terms, "captured_ci": (("channel", "bound"), interval)}


def spread(deviation: Array, share: Array) -> Array:
    """Standard error of a weighted mean over blocks (B, ...) from deviations; NaN for one block."""
    blocks = len(share)
    if blocks < 2:
        return np.full(deviation.shape[1:], np.nan)
    squares = np.tensordot(share**2, deviation**2, axes=1)
    return np.asarray(np.sqrt(squares * blocks / (blocks - 1)))
