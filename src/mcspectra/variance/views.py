"""The two views of an estimator: which coefficients meet which spectra of points.

In the *domain* view one integrand f meets the warped, weighted points of all techniques; in *primary*
space every technique has its own integrand g_t and the sampler's own points, and sums run over
(technique, m).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from mcspectra.core.analysis import Subject
from mcspectra.core.checks import Array
from mcspectra.core.errors import InfiniteWeightVarianceWarning, ParameterError, warn
from mcspectra.estimators import AbstractEstimator, Mirrored
from mcspectra.samplers.randomizations import Mirror
from mcspectra.spectra.bases import Basis, Coefficients, fitting_basis, make_basis
from mcspectra.variance.sums import Partition, Variables

__all__ = ["Frequencies", "View"]


@final
@dataclass(frozen=True)
class Frequencies:
    """The basis functions of an analysis, in the domain or in primary space."""

    estimator: AbstractEstimator
    space: str  # ``"domain"`` or ``"primary"``
    basis: Basis

    @staticmethod
    def of(subject: Subject, asked: Any) -> Frequencies:
        """Choose the space and the basis that an analysis leaves open.

        The basis ``"auto"`` is the one that fits the points that an estimator makes. A mirrored
        integrand has folded points in the domain, in primary space those of the sampler.
        """
        estimator, space, basis = subject.estimator, asked.space, asked.basis
        domain = estimator.domain_integrand
        if space == "domain" and domain is None:
            raise ParameterError(
                f"{estimator.spec} has no common domain: its techniques are given on their own "
                "unit cubes; use space='primary'."
            )
        chosen = space or ("primary" if domain is None else "domain")
        if basis == "auto":
            source = estimator.randomized(subject.sampler)
            mirrored = isinstance(estimator, Mirrored) and estimator.mode == "integrand"
            if chosen == "domain" and mirrored:
                source = source.then(Mirror(mode="fold"))
            basis = fitting_basis(source, asked.half_width)
        dims = estimator.dims if chosen == "primary" else estimator.domain_dims
        return Frequencies(estimator, chosen, make_basis(basis, dims, asked.half_width))

    @property
    def size(self) -> int:
        """Number of coefficients: in primary space of each technique."""
        techniques = len(self.estimator.counts) if self.space == "primary" else 1
        return self.basis.size * techniques

    @property
    def diverge(self) -> bool:
        """Whether Var(S_0) and the spectral terms are infinite."""
        return self.space == "domain" and self.estimator.infinite_weights

    def view(self, n: int, asked: Any, *, apart: bool = False) -> View:
        """Prepare the transforms of n points and f's coefficients: `apart`, those of each technique.

        In primary space they are always apart.
        """
        estimator, basis = self.estimator, self.basis
        f = estimator.domain_integrand if self.space == "domain" else None
        techniques = range(len(estimator.counts))
        counts = estimator.counts if apart or f is None else (sum(estimator.counts),)
        transforms = [basis.transform(n * count, asked.engine, asked.eps) for count in counts]
        integrands = [estimator.primary_integrand(t) for t in techniques] if f is None else [f]
        found = [basis.integrand(g) for g in integrands]
        stacked = np.stack([coefficients for coefficients, _ in found], axis=1)
        return View(
            estimator,
            self.space,
            basis,
            tuple(coefficients for coefficients, _ in transforms),
            transforms[0][1],
            np.broadcast_to(stacked, (len(stacked), len(counts), basis.stored)),
            "; ".join(dict.fromkeys(source for _, source in found)),
        )

    def undefined(
        self, variables: Variables, finite: tuple[str, ...], infinite: tuple[str, ...] = ()
    ) -> Variables:
        """What is left of the variables of terms that diverge: no number that means nothing."""
        warn(
            f"∫1/p diverges for {self.estimator.spec}: Var(S_0) and the spectral terms are infinite "
            "although the estimate's variance need not be; use space='primary'.",
            InfiniteWeightVarianceWarning,
        )
        return {
            name: (dims, v)
            if name.startswith(finite)
            else (dims, np.full_like(v, math.inf if name in infinite else math.nan))
            for name, (dims, v) in variables.items()
        }


@dataclass(frozen=True)
class View:
    """Domain or primary view: which integrand coefficients meet which point spectra."""

    estimator: AbstractEstimator
    space: str
    basis: Basis
    transforms: tuple[Coefficients, ...]  # of the points of each technique, or of all together
    engine: str
    integrand_coefficients: Array  # f^t, (C, T, H)
    source: str  # where they come from

    def spectra(self, points: list[Array]) -> list[Array]:
        """Spectra of a block, (R, H), of each technique, or of all together."""
        if self.space == "primary":
            return [
                transform(u, None) for transform, u in zip(self.transforms, points, strict=True)
            ]
        if len(self.transforms) == 1:  # weights of one may depend on u, beyond x
            return [self.transforms[0](*self.estimator.weighted_points(points))]
        warped = [self.estimator.warp(t, u) for t, u in enumerate(points)]
        return [
            transform(x, self.estimator.weight(t, x) / x.shape[1])
            for t, (transform, x) in enumerate(zip(self.transforms, warped, strict=True))
        ]

    def coefficients(self, points: list[Array]) -> Array:
        """Spectra of a block, those of the techniques side by side: (R, T·H)."""
        parts = self.spectra(points)
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def partition(self, band: Array, matrix: bool) -> Partition:
        """Coefficients and labels, repeated for each technique."""
        techniques = len(self.transforms)
        shell = self.basis.oscillations().max(axis=1)
        dc = np.zeros(self.basis.stored, bool)
        dc[self.basis.dc] = True
        flat = self.integrand_coefficients.reshape(len(self.integrand_coefficients), -1)
        return Partition(
            np.ascontiguousarray(flat),
            np.tile(self.basis.double, techniques),
            np.tile(dc, techniques),
            np.tile(band, techniques),
            np.tile(shell, techniques),
            matrix,
        )
