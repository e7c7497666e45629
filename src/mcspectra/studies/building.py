"""From an entry of a study to its estimator."""

from __future__ import annotations

import functools
from typing import Any

from mcspectra.densities import DENSITIES
from mcspectra.estimators import (
    AbstractEstimator,
    ChannelSampling,
    Estimator,
    Mirrored,
    MultipleImportance,
    OneSampleMIS,
    TechniqueSum,
)
from mcspectra.integrands import INTEGRANDS, Integrand
from mcspectra.integrands.smoothing import smoothed
from mcspectra.studies.foreign_code import probed
from mcspectra.studies.tables import EstimatorConfig
from mcspectra.studies.trust import Site

__all__ = ["build_estimator"]


def build_estimator(entry: EstimatorConfig, site: Site) -> AbstractEstimator:
    """Make the estimator that a table ``[[estimators]]`` describes.

    Raises
    ------
    FunctionFailed
        A Python function fails at its first points.
    McspectraError
        A spec cannot be read or a component cannot be made of it.
    """
    estimator = _unmirrored(entry, site)
    return estimator if entry.mirror is None else Mirrored(estimator, entry.mirror)


def _unmirrored(entry: EstimatorConfig, site: Site) -> AbstractEstimator:
    if entry.integrands is not None:
        return TechniqueSum(
            [_integrand(text, entry, site) for text in entry.integrands],
            counts=entry.technique_counts,
            sets=entry.sets or "independent",
        )
    f = _integrand(entry.integrand or "", entry, site)
    if entry.smoothed is not None:
        f = smoothed(f, entry.smoothed)
    if entry.densities is None:
        return Estimator(f, None if entry.density is None else _density(entry.density, f, site))
    return _several(entry, f, [_density(text, f, site) for text in entry.densities])


def _several(entry: EstimatorConfig, f: Integrand, densities: list[Any]) -> AbstractEstimator:
    """An estimator with several densities."""
    if entry.channels in ("own", "shared"):
        sets = "shared" if entry.channels == "shared" else "independent"
        return ChannelSampling(f, densities, sets=sets)
    heuristic = entry.heuristic or "balance"
    if entry.one_sample:
        return OneSampleMIS(
            f,
            densities,
            entry.probabilities,
            heuristic=heuristic,
            selection=entry.selection or "extra",
        )
    return MultipleImportance(
        f,
        densities,
        heuristic=heuristic,
        counts=entry.technique_counts,
        sets=entry.sets or "independent",
    )


def _integrand(text: str, entry: EstimatorConfig, site: Site) -> Integrand:
    wrap = functools.partial(probed, limit=site.limit)
    f: Integrand = site.component(INTEGRANDS, text, entry.dims, wrap)
    return f


def _density(text: str, f: Integrand, site: Site) -> Any:
    return site.component(DENSITIES, text, f.dims, None)
