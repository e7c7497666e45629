"""What a cell computes: one dataset, from its address alone, with one thread."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.results import dataset
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator, Estimator
from mcspectra.spectra.power import power_spectrum
from mcspectra.studies.config import ConvergenceConfig, SpectrumConfig, TermsConfig
from mcspectra.studies.plan import Cell
from mcspectra.variance.convergence import convergence
from mcspectra.variance.terms import variance_terms

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["compute_cell"]


def compute_cell(cell: Cell, seed: int) -> xr.Dataset:
    """Compute a cell: the same bits wherever and whenever it runs."""
    settings: Any = cell.settings
    if cell.analysis == "convergence":
        result = _convergence(cell, settings, seed)
    elif cell.analysis == "terms":
        result = _terms(cell, settings, seed)
    elif cell.analysis == "spectrum":
        result = _spectrum(cell, settings, seed)
    else:
        result = _points(cell, settings, seed)
    return result.assign_attrs(
        estimator_name=cell.estimator_name, sampler_spec=cell.sampler_spec, analysis=cell.analysis
    )


def _convergence(cell: Cell, settings: ConvergenceConfig, seed: int) -> xr.Dataset:
    return convergence(
        cell.estimator,
        cell.sampler,
        settings.counts,
        realizations=settings.realizations,
        rng=seed,
        relative_error=settings.relative_error,
        fit_last=settings.fit_last,
        workers=1,
    )


def _terms(cell: Cell, settings: TermsConfig, seed: int) -> xr.Dataset:
    domain = cell.estimator.domain_integrand is not None
    return variance_terms(
        cell.estimator,
        cell.sampler,
        settings.n,
        half_width=settings.half_width,
        realizations=settings.realizations,
        rng=seed,
        space=settings.space or ("domain" if domain else "primary"),
        basis=settings.basis,
        bands=settings.bands,
        cross_matrix=settings.cross_matrix,
        workers=1,
    )


def _spectrum(cell: Cell, settings: SpectrumConfig, seed: int) -> xr.Dataset:
    return power_spectrum(
        cell.sampler,
        settings.n,
        density=_density(cell.estimator),
        half_width=settings.half_width,
        realizations=settings.realizations,
        rng=seed,
        workers=1,
    )


def _points(cell: Cell, settings: SpectrumConfig, seed: int) -> xr.Dataset:
    """First realisation of the points, warped by the density where there is one."""
    points = cell.sampler.draw_stream(settings.n, Stream.from_rng(seed), 0, 1)[0]
    density = _density(cell.estimator)
    if density is not None:
        points = density.sample(points)
    return dataset(
        {"points": (("point", "axis"), points)},
        {"axis": np.arange(cell.sampler.dims)},
        sampler=cell.sampler.spec,
        n=settings.n,
        seed=seed,
    )


def _density(estimator: AbstractEstimator) -> Any:
    """The density whose samples are shown: only a single technique has one."""
    return estimator.density if isinstance(estimator, Estimator) else None
