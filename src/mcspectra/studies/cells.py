"""What a cell computes: one dataset, from its address alone, cut into blocks where it can be."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.errors import NoClosedForm
from mcspectra.core.results import dataset
from mcspectra.core.staged import Staged, Whole, compute
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator, Estimator
from mcspectra.spectra.pair_correlation import staged_pair_correlation
from mcspectra.spectra.power import staged_spectrum
from mcspectra.studies.plan import Cell
from mcspectra.studies.tables import (
    AnovaConfig,
    ConvergenceConfig,
    ExactConfig,
    MapConfig,
    PcfConfig,
    RemediesConfig,
    SpectrumConfig,
    TechniquesConfig,
    TermsConfig,
)
from mcspectra.variance.anova import staged_anova
from mcspectra.variance.convergence import staged_convergence
from mcspectra.variance.exact import exact_variance
from mcspectra.variance.remedies import remedies
from mcspectra.variance.techniques import staged_techniques
from mcspectra.variance.terms import staged_terms

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["compute_cell", "finished_cell", "labels_of", "staged_cell"]


def compute_cell(cell: Cell, seed: int) -> xr.Dataset:
    """Compute a cell in this thread: the same bits wherever and whenever it runs."""
    return finished_cell(cell, compute(staged_cell(cell, seed), 1))


def staged_cell(cell: Cell, seed: int) -> Staged[Any]:
    """The analysis of a cell, to be computed as a whole or in chunks."""
    staged = _STAGED.get(cell.analysis)
    if staged is not None:
        return staged(cell, cell.settings, seed)
    return Whole(lambda: _COMPUTE[cell.analysis](cell, cell.settings, seed), cell.cost)


def finished_cell(cell: Cell, result: xr.Dataset) -> xr.Dataset:
    """What is stored of a result: text as attributes, and what the cell is."""
    return _without_text(result).assign_attrs(
        estimator_name=cell.estimator_name, sampler_spec=cell.sampler_spec, analysis=cell.analysis
    )


def labels_of(result: xr.Dataset, name: str) -> list[str]:
    """Texts of a coordinate of a stored cell, which keeps them as the attribute ``labels_<name>``."""
    return [str(text) for text in result.attrs[f"labels_{name}"]]


def _without_text(result: xr.Dataset) -> xr.Dataset:
    """Text coordinates as attributes: Zarr v3 has no stable type for text; ``bound`` is the root's."""
    texts = [str(name) for name, c in result.variables.items() if c.dtype.kind in "UOT"]
    labels = {f"labels_{t}": result[t].values.tolist() for t in texts if t != "bound"}
    return result.drop_vars([t for t in texts if t != "bound"]).assign_attrs(labels)


def _convergence(cell: Cell, settings: ConvergenceConfig, seed: int) -> Staged[Any]:
    return staged_convergence(
        _estimator(cell),
        cell.sampler,
        settings.counts,
        realizations=settings.realizations,
        rng=seed,
        relative_error=settings.relative_error,
        fit_last=settings.fit_last,
    )


def _terms(cell: Cell, settings: TermsConfig, seed: int) -> Staged[Any]:
    estimator = _estimator(cell)
    domain = estimator.domain_integrand is not None
    return staged_terms(
        estimator,
        cell.sampler,
        settings.n,
        half_width=settings.half_width,
        realizations=settings.realizations,
        rng=seed,
        space=settings.space or ("domain" if domain else "primary"),
        basis=settings.basis,
        bands=settings.bands,
        cross_matrix=settings.cross_matrix,
    )


def _spectrum(cell: Cell, settings: SpectrumConfig, seed: int) -> Staged[Any]:
    return staged_spectrum(
        cell.sampler,
        settings.n,
        density=_density(_estimator(cell)),
        half_width=settings.half_width,
        frequency_step=settings.frequency_step,
        realizations=settings.realizations,
        rng=seed,
    )


def _points(cell: Cell, settings: SpectrumConfig, seed: int) -> xr.Dataset:
    """First realisation of the points, warped by the density where there is one."""
    points = cell.sampler.draw_stream(settings.n, Stream.from_rng(seed), 0, 1)[0]
    density = _density(_estimator(cell))
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


def _techniques(cell: Cell, settings: TechniquesConfig, seed: int) -> Staged[Any]:
    return staged_techniques(
        _estimator(cell),
        cell.sampler,
        settings.counts,
        half_width=settings.half_width,
        realizations=settings.realizations,
        rng=seed,
        basis=settings.basis,
        space=settings.space,
        fit_last=settings.fit_last,
    )


def _pcf(cell: Cell, settings: PcfConfig, seed: int) -> Staged[Any]:
    return staged_pair_correlation(
        cell.sampler,
        settings.n,
        bins=settings.bins,
        realizations=settings.realizations,
        rng=seed,
        boundary=settings.boundary,
        max_distance=settings.max_distance,
    )


def _anova(cell: Cell, settings: AnovaConfig, seed: int) -> Staged[Any]:
    return staged_anova(
        _estimator(cell),
        cell.sampler,
        settings.n,
        order=settings.order,
        realizations=settings.realizations,
        rng=seed,
    )


def _exact(cell: Cell, settings: ExactConfig, seed: int) -> xr.Dataset:
    """Exact variances, NaN where there is none; the attribute ``note`` says why."""
    estimator = _estimator(cell)
    channels = (estimator.channels,) if estimator.channels else ()
    values = np.full((len(settings.counts), *channels), np.nan)
    note: dict[str, str] = {}
    for i, n in enumerate(settings.counts):
        try:
            values[i] = exact_variance(estimator, cell.sampler, n)
        except NoClosedForm as error:
            note["note"] = str(error)
    dims = ("n", "channel") if channels else ("n",)
    return dataset(
        {"exact_variance": (dims, values)},
        {"n": np.array(settings.counts)},
        estimator=estimator.spec,
        sampler=cell.sampler.spec,
        seed=seed,
        **note,
    )


def _remedies(cell: Cell, settings: RemediesConfig, seed: int) -> xr.Dataset:
    return remedies(
        _estimator(cell),
        cell.sampler,
        settings.budget,
        realizations=settings.realizations,
        rng=seed,
        kinds=settings.kinds,
        workers=1,
    )


def _map(cell: Cell, settings: MapConfig, seed: int) -> Staged[Any]:
    from mcspectra.rendering.maps import staged_map

    given: dict[str, Any] = (
        {} if settings.strategies is None else {"strategies": settings.strategies}
    )

    return staged_map(
        settings.scene,
        sampler=cell.sampler,
        counts=settings.counts,
        realizations=settings.realizations,
        crop=settings.crop,
        size=settings.size,
        light=settings.light,
        heuristic=settings.heuristic,
        channel=settings.channel,
        dims=settings.dims,
        points=settings.points,
        smoothing=settings.smoothing,
        predict_every=settings.predict_every,
        rng=seed,
        **given,
    )


_STAGED: dict[str, Callable[[Cell, Any, int], Staged[Any]]] = {
    "convergence": _convergence,
    "terms": _terms,
    "techniques": _techniques,
    "spectrum": _spectrum,
    "pcf": _pcf,
    "anova": _anova,
    "map": _map,
}
"""Analyses that are sums over realisations, or sets of pixels, and can be cut."""

_COMPUTE: dict[str, Callable[[Cell, Any, int], xr.Dataset]] = {
    "points": _points,
    "exact": _exact,
    "remedies": _remedies,
}


def _estimator(cell: Cell) -> AbstractEstimator:
    if cell.estimator is None:
        raise TypeError(f"The cell {cell.path} has no estimator.")
    return cell.estimator
