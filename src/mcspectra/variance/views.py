"""The two views of an estimator: which coefficients meet which spectra of points.

In the *domain* view one integrand f meets the warped, weighted points of all techniques; in *primary*
space every technique has its own integrand g_t and the sampler's own points, and sums run over
(technique, m).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mcspectra.core.checks import Array, as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.estimators import AbstractEstimator, Mirrored
from mcspectra.samplers import Sampler
from mcspectra.samplers.mirror import Mirror
from mcspectra.spectra.bases import BASES, Basis, Coefficients, fitting_basis, make_basis
from mcspectra.variance.sums import Partition

__all__ = ["MAX_MATRIX", "SPACES", "View", "check_terms", "chosen_basis", "view_dims"]

SPACES = ("domain", "primary")
MAX_MATRIX = 4096
"""Most frequencies of a full cross matrix: two of that size take 0.5 GiB."""


@dataclass(frozen=True)
class View:
    """Domain or primary view: which integrand coefficients meet which point spectra."""

    estimator: AbstractEstimator
    space: str
    basis: Basis
    transforms: tuple[Coefficients, ...]
    engine: str
    integrand_coefficients: Array  # (C, T, H)
    source: str

    @staticmethod
    def of(
        estimator: AbstractEstimator, n: int, space: str, basis: Basis, engine: str, eps: float
    ) -> View:
        techniques = range(len(estimator.counts))
        if space == "domain":
            integrand = estimator.domain_integrand
            assert integrand is not None  # check_terms has seen to it
            integrands, counts = [integrand], [n * sum(estimator.counts)]
        else:
            integrands = [estimator.primary_integrand(t) for t in techniques]
            counts = [n * count for count in estimator.counts]
        transforms = [basis.transform(count, engine, eps) for count in counts]
        found = [basis.integrand(g) for g in integrands]
        return View(
            estimator,
            space,
            basis,
            tuple(coefficients for coefficients, _ in transforms),
            transforms[0][1],
            np.stack([coefficients for coefficients, _ in found], axis=1),
            "; ".join(dict.fromkeys(source for _, source in found)),
        )

    def coefficients(self, points: list[Array]) -> Array:
        """Spectra of a block, those of the techniques side by side: (R, T·H)."""
        if self.space == "domain":
            return self.transforms[0](*self.estimator.weighted_points(points))
        parts = [transform(u, None) for transform, u in zip(self.transforms, points, strict=True)]
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


def chosen_basis(
    basis: object, estimator: AbstractEstimator, sampler: Sampler, space: str, half_width: int
) -> str:
    """Return a basis' name; for ``"auto"`` the one that fits the points that an estimator makes.

    A mirrored integrand has folded points in the domain, in primary space those of the sampler.
    """
    if not isinstance(basis, str):
        raise ParameterError(
            f"basis is {basis!r}; give the name of one: {', '.join((*BASES, 'auto'))}."
        )
    if as_choice("basis", basis, (*BASES, "auto")) != "auto":
        return basis
    source = estimator.randomized(sampler)
    if space == "domain" and isinstance(estimator, Mirrored) and estimator.mode == "integrand":
        source = source.then(Mirror(mode="fold"))
    return fitting_basis(source, half_width)


def view_dims(estimator: AbstractEstimator, space: str | None) -> int:
    """Return the number of dims of the frequencies: of the domain, or of primary space."""
    return estimator.dims if space == "primary" else estimator.domain_dims


def check_terms(
    estimator: AbstractEstimator,
    half_width: int,
    space: str | None,
    *,
    cross_matrix: bool,
    basis: str = "fourier",
) -> int:
    """Check what `variance_terms` can refuse before any work; return the number of coefficients.

    Raises
    ------
    ParameterError
        The grid or the cross matrix would be too large, or there is no domain to work in.
    """
    size = make_basis(basis, view_dims(estimator, space), half_width).size
    if space == "domain" and estimator.domain_integrand is None:
        raise ParameterError(
            f"{estimator.spec} has no common domain: its techniques are given on their own "
            "unit cubes; use space='primary'."
        )
    primary = space == "primary" or estimator.domain_integrand is None
    size *= len(estimator.counts) if primary else 1
    if cross_matrix and size > MAX_MATRIX:
        raise ParameterError(
            f"The cross matrix of {size} frequencies takes {32 * size**2 / 2**30:.3g} GiB; "
            f"ask for at most {MAX_MATRIX} frequencies, or use contribution and band_covariance."
        )
    return size
