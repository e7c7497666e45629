"""From a study's text to cells: every (estimator, sampler, analysis), built and checked up front."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from mcspectra.core.checks import as_choice
from mcspectra.core.errors import ConfigError, McspectraError
from mcspectra.core.spec import Call, parse_chain
from mcspectra.densities import DENSITIES
from mcspectra.estimators import AbstractEstimator, Estimator, MultipleImportance, TechniqueSum
from mcspectra.integrands import INTEGRANDS
from mcspectra.samplers import Sampler, sampler_from_calls
from mcspectra.spectra.bases import BASES, fitting_basis, make_basis
from mcspectra.spectra.transforms import FrequencyGrid
from mcspectra.studies.config import (
    ConvergenceConfig,
    EstimatorConfig,
    SpectrumConfig,
    StudyConfig,
    TermsConfig,
)
from mcspectra.variance.bands import make_bands
from mcspectra.variance.fit import check_window
from mcspectra.variance.stopping import check_relative_error
from mcspectra.variance.views import check_terms

__all__ = ["Analysis", "Cell", "Plan", "make_plan"]

Analysis = Literal["convergence", "terms", "spectrum", "points"]
Settings = ConvergenceConfig | TermsConfig | SpectrumConfig


@dataclass(frozen=True)
class Cell:
    """One analysis of one estimator with one sampler.

    Attributes
    ----------
    path
        Group of the cell in the store: estimator/sampler/analysis.
    cost
        Work in arbitrary units, about proportional to time; for scheduling and progress.
    """

    path: str
    analysis: Analysis
    estimator_name: str
    sampler_spec: str
    estimator: AbstractEstimator
    sampler: Sampler
    settings: Settings
    cost: float


@dataclass(frozen=True)
class Plan:
    """All cells of a study, in the order of the file."""

    config: StudyConfig
    cells: tuple[Cell, ...]


def make_plan(config: StudyConfig, folder: Path) -> Plan:
    """Build every component and check every count before anything runs.

    Parameters
    ----------
    config
        The study.
    folder
        Folder of the study file: relative paths in spec strings start there.

    Raises
    ------
    ConfigError
        A component cannot be built or a sampler cannot do a count; names the estimator.
    """
    cells: list[Cell] = []
    slugs: dict[str, str] = {}
    for entry in config.estimators:
        try:
            estimator = _build_estimator(entry, folder)
            parent = _slug(entry.name, slugs)
            inner: dict[str, str] = {}
            specs: dict[str, str] = {}
            for text in entry.samplers if entry.samplers is not None else config.samplers:
                sampler = sampler_from_calls(_resolved(text, folder), estimator.dims)
                _check_new(sampler, text, specs)
                path = f"{parent}/{_slug(text, inner)}"
                cells += _cells(config, entry, estimator, sampler, text, path)
        except ConfigError:
            raise
        except McspectraError as error:
            raise ConfigError(f"Estimator {entry.name!r}: {error}") from error
    if not cells:
        raise ConfigError(
            "The study asks for no analysis; give a table convergence, terms or spectrum."
        )
    return Plan(config, tuple(cells))


def _build_estimator(entry: EstimatorConfig, folder: Path) -> AbstractEstimator:
    def integrand(text: str) -> Any:
        return INTEGRANDS.build(_one(text, folder), entry.dims)

    if entry.integrands is not None:
        return TechniqueSum([integrand(t) for t in entry.integrands], counts=entry.technique_counts)
    f = integrand(entry.integrand or "")
    if entry.densities is not None:
        densities = [DENSITIES.build(_one(t, folder), f.dims) for t in entry.densities]
        return MultipleImportance(
            f, densities, heuristic=entry.heuristic or "balance", counts=entry.technique_counts
        )
    if entry.density is None:
        return Estimator(f)
    return Estimator(f, DENSITIES.build(_one(entry.density, folder), f.dims))


def _cells(
    config: StudyConfig,
    entry: EstimatorConfig,
    estimator: AbstractEstimator,
    sampler: Sampler,
    text: str,
    path: str,
) -> list[Cell]:
    """Cells of one estimator with one sampler."""
    cells: list[Cell] = []

    def add(analysis: Analysis, settings: Settings, cost: float) -> None:
        name = entry.name
        cells.append(
            Cell(f"{path}/{analysis}", analysis, name, text, estimator, sampler, settings, cost)
        )

    techniques = sum(estimator.counts)
    convergence = entry.convergence or config.convergence
    if convergence is not None:
        for n in convergence.counts:
            estimator.check_sampler(sampler, n)
        _check_convergence(entry.name, convergence)
        add(
            "convergence",
            convergence,
            sum(convergence.counts) * convergence.realizations * techniques,
        )
    terms = entry.terms or config.terms
    if terms is not None:
        estimator.check_sampler(sampler, terms.n)
        frequencies = _check_terms(estimator, sampler, terms)
        add("terms", terms, terms.realizations * (techniques * terms.n + frequencies))
    spectrum = entry.spectrum or config.spectrum
    if spectrum is not None:
        estimator.check_sampler(sampler, spectrum.n)
        frequencies = FrequencyGrid(estimator.dims, spectrum.half_width).size
        add("spectrum", spectrum, spectrum.realizations * (spectrum.n + 0.5 * frequencies))
        add("points", spectrum, spectrum.n)
    return cells


def _check_new(sampler: Sampler, text: str, specs: dict[str, str]) -> None:
    """Refuse a sampler that is listed already under another spelling."""
    if sampler.spec in specs:
        raise ConfigError(f"{specs[sampler.spec]!r} and {text!r} are the same sampler; list one.")
    specs[sampler.spec] = text


def _check_terms(estimator: AbstractEstimator, sampler: Sampler, settings: TermsConfig) -> int:
    """Refuse what `variance_terms` would; return the number of coefficients."""
    basis = as_choice("basis", settings.basis, (*BASES, "auto"))
    if basis == "auto":
        basis = fitting_basis(sampler, settings.half_width)
    matrix = settings.cross_matrix
    size = check_terms(
        estimator, settings.half_width, settings.space, cross_matrix=matrix, basis=basis
    )
    make_bands(settings.bands, make_basis(basis, estimator.dims, 1))  # whether there are such
    return size


def _check_convergence(name: str, settings: ConvergenceConfig) -> None:
    counts = settings.counts
    if any(b <= a for a, b in itertools.pairwise(counts)):
        raise ConfigError(f"Estimator {name!r}: counts {list(counts)} must be ascending.")
    check_window(settings.fit_last, len(counts))
    if settings.relative_error is not None:
        check_relative_error(settings.relative_error)


def _one(text: str, folder: Path) -> Call:
    calls = _resolved(text, folder)
    if len(calls) != 1:
        raise ConfigError(f"{text!r} chains parts with '|'; only samplers can be chained.")
    return calls[0]


def _resolved(text: str, folder: Path) -> list[Call]:
    """Parse a spec; its path= arguments are taken relative to the study file's folder."""
    return [
        Call(
            call.name,
            {k: _anchor(v, folder) if k == "path" else v for k, v in call.arguments.items()},
        )
        for call in parse_chain(text)
    ]


def _anchor(path: Any, folder: Path) -> Any:
    if isinstance(path, str):
        return str(folder / path)
    if isinstance(path, list | tuple):
        return [_anchor(p, folder) for p in path]
    return path


def _slug(text: str, taken: dict[str, str]) -> str:
    """A short group name of letters, digits and hyphens, different for different texts."""
    base = re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-.")[:60] or "x"
    slug, number = base, 2
    while taken.get(slug, text) != text:
        slug, number = f"{base}-{number}", number + 1
    taken[slug] = text
    return slug
