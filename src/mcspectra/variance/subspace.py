"""Leading eigenpairs of a sample covariance that is known by its products with vectors only.

Randomised subspace iteration [Halko2011]_: the range of A Ω, Ω random, holds the leading eigenvectors but
for errors that shrink with every further product; the eigenpairs of A projected on it (Rayleigh-Ritz)
are the answer. The last product also gives ‖A v − λ v‖, which no eigenvalue of A is farther from λ.

A itself is a sample: batches of realisations each give a variance along v, whose spread is the error of
λ as the variance along v. That v was picked for a large λ it does not know: `flat_edge` is what picking
makes of a flat spectrum.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.variance.batches import spread

__all__ = ["BATCHES", "CovarianceProduct", "Eigenpairs", "flat_edge", "leading_eigenpairs"]

_ROUNDING = 1e-20  # variances beside the largest that are rounding
BATCHES = 20  # whose spread gives the errors of eigenvalues


@dataclass(frozen=True)
class Batch:
    """Vᵀ A_b V of a batch of realisations, (k, k), and its degrees of freedom."""

    degrees: int
    projected: Array


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
    batches
        What each batch says by itself, where `merged` kept them.
    """

    count: int
    mean: Array
    product: Array
    squares: Array
    batches: tuple[Batch, ...] = ()

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
    def merged(
        parts: Iterator[CovarianceProduct], vectors: Array, group: int = 1
    ) -> CovarianceProduct:
        """All parts together, in order; `group` parts are a batch."""
        total = None
        batches: list[Batch] = []
        while own := list(itertools.islice(parts, group)):
            batch = functools.reduce(lambda a, b: a.merge(b, vectors), own)
            if batch.count > 1:
                degrees = batch.count - 1
                batches.append(Batch(degrees, vectors.T @ batch.product / degrees))
            total = batch if total is None else total.merge(batch, vectors)
        assert total is not None
        return replace(total, batches=tuple(batches))


@dataclass(frozen=True)
class Eigenpairs:
    """Eigenvalues, descending; eigenvectors, (D, k); ‖A v − λ v‖; standard errors; the diagonal of A."""

    values: Array
    vectors: Array
    residuals: Array
    errors: Array
    diagonal: Array

    @property
    def trace(self) -> float:
        """Sum of all eigenvalues of A."""
        return float(self.diagonal.sum())


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
    diagonal = last.squares / (last.count - 1)
    errors = _errors(last.batches, rotation)
    return Eigenpairs(np.maximum(values, 0.0), found, residuals, errors, diagonal)


def _errors(batches: tuple[Batch, ...], rotation: Array) -> Array:
    """Standard errors of the variances along the eigenvectors, (k,), by batch means."""
    along = [np.einsum("ik,ij,jk->k", rotation, b.projected, rotation) for b in batches]
    if not along:
        return np.full(rotation.shape[1], np.nan)
    weight = np.array([b.degrees for b in batches], np.float64)
    share = weight / weight.sum()
    return spread(np.array(along) - share @ np.array(along), share)


def flat_edge(diagonal: Array, realizations: int) -> float:
    """Largest sample eigenvalue of a flat spectrum of the same trace, by Marchenko and Pastur.

    With D coordinates that vary and R − 1 degrees of freedom, λ (1 + √(D/(R − 1)))² in the limit of many
    of both [Marchenko1967]_, where the eigenvalues of the covariance itself are all λ.
    """
    varying = int(np.count_nonzero(diagonal > _ROUNDING * diagonal.max(initial=0.0)))
    if not varying:
        return 0.0
    level = float(diagonal.sum()) / varying
    return level * (1.0 + math.sqrt(varying / (realizations - 1))) ** 2
