"""Leading eigenpairs of a sample covariance that is known by its products with vectors only.

Randomised subspace iteration [Halko2011]_: the range of A Ω, Ω random, holds the leading eigenvectors but
for errors that shrink with every further product; the eigenpairs of A projected on it (Rayleigh-Ritz)
are the answer. The last product also gives ‖A v − λ v‖, which no eigenvalue of A is farther from λ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["CovarianceProduct", "Eigenpairs", "leading_eigenpairs"]


@dataclass(frozen=True)
class CovarianceProduct:
    """Σ (z − z̄)(z − z̄)ᵀ V over `count` realisations; `merge` adds those of others.

    Attributes
    ----------
    count, mean
        Number of realisations and z̄, (D,).
    product
        The sum, (D, k).
    squares
        Σ (z − z̄)², (D,): the diagonal.
    """

    count: int
    mean: Array
    product: Array
    squares: Array

    @staticmethod
    def of(z: Array, vectors: Array) -> CovarianceProduct:
        """Sums of a block z, (R, D)."""
        mean = z.mean(axis=0)
        deviation = z - mean
        product = deviation.T @ (deviation @ vectors)
        return CovarianceProduct(len(z), mean, product, (deviation**2).sum(axis=0))

    def merge(self, other: CovarianceProduct, vectors: Array) -> CovarianceProduct:
        """Sums over the realisations of both, about their common mean."""
        count = self.count + other.count
        delta = other.mean - self.mean
        factor = self.count * other.count / count
        between = factor * np.outer(delta, delta @ vectors)
        return CovarianceProduct(
            count,
            self.mean + delta * (other.count / count),
            self.product + other.product + between,
            self.squares + other.squares + factor * delta**2,
        )

    @staticmethod
    def merged(parts: Iterator[CovarianceProduct], vectors: Array) -> CovarianceProduct:
        """All parts together, in order."""
        total = next(parts)
        for part in parts:
            total = total.merge(part, vectors)
        return total


@dataclass(frozen=True)
class Eigenpairs:
    """Eigenvalues, descending; eigenvectors, (D, k); ‖A v − λ v‖; the trace of A."""

    values: Array
    vectors: Array
    residuals: Array
    trace: float


def leading_eigenpairs(
    product: Callable[[Array], CovarianceProduct], start: Array, passes: int
) -> Eigenpairs:
    """Approximate the leading eigenpairs of the unbiased covariance A.

    Parameters
    ----------
    product
        Makes a pass over the realisations: the sums for vectors (D, k).
    start
        Random vectors Ω, (D, k).
    passes
        Number of products, 2 or more.
    """
    vectors = start
    for _ in range(passes - 1):
        vectors = np.linalg.qr(product(vectors).product)[0]
    last = product(vectors)
    image = last.product / (last.count - 1)
    projected = vectors.T @ image
    values, rotation = np.linalg.eigh(0.5 * (projected + projected.T))
    values, rotation = values[::-1], rotation[:, ::-1]
    found = vectors @ rotation
    residuals = np.linalg.norm(image @ rotation - found * values, axis=0)
    trace = float(last.squares.sum()) / (last.count - 1)
    return Eigenpairs(np.maximum(values, 0.0), found, residuals, trace)
