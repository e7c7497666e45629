"""Which analyses a study asks of an estimator with a sampler: checked, with their costs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, final

from mcspectra.core.checks import as_choice
from mcspectra.core.errors import ConfigError
from mcspectra.estimators import AbstractEstimator
from mcspectra.samplers import Sampler
from mcspectra.spectra.bases import BASES, fitting_basis, make_basis
from mcspectra.spectra.transforms import FrequencyGrid
from mcspectra.studies.sizes import check_memory, memory_of
from mcspectra.studies.tables import (
    ANALYSIS_TABLES,
    AnovaConfig,
    ConvergenceConfig,
    EstimatorConfig,
    ExactConfig,
    MapConfig,
    PcfConfig,
    RemediesConfig,
    Settings,
    SpectrumConfig,
    StudyConfig,
    TechniquesConfig,
    TermsConfig,
)
from mcspectra.variance.bands import make_bands
from mcspectra.variance.counterfactuals import KINDS
from mcspectra.variance.fit import check_window
from mcspectra.variance.stopping import check_relative_error
from mcspectra.variance.views import check_terms

__all__ = ["Asked", "asked_analyses", "asked_map", "asked_names"]

_REMEDY_STEPS = 5
_REMEDIES = 20  # changes that are tried, about


@final
@dataclass(frozen=True)
class Asked:
    """An analysis that is asked for.

    Attributes
    ----------
    cost
        Work in arbitrary units, about proportional to time.
    memory
        Bytes it takes at most, estimated.
    """

    analysis: str
    settings: Settings
    cost: float
    memory: int


def asked_analyses(
    config: StudyConfig, entry: EstimatorConfig, estimator: AbstractEstimator, sampler: Sampler
) -> Iterator[Asked]:
    """Check and yield the analyses of one estimator with one sampler.

    Raises
    ------
    McspectraError
        A sampler cannot do a count, or a value is not one that the analysis takes.
    ConfigError
        An analysis needs more memory than there is.
    """
    pair = _Pair(entry.name, estimator, sampler)
    for name, settings in _settings(config, entry):
        yield from _CHECKS[name](pair, settings)


def asked_names(config: StudyConfig, entry: EstimatorConfig) -> Iterator[tuple[str, Settings]]:
    """Yield the names of an estimator's analyses, in the order of `asked_analyses`: unchecked."""
    for name, settings in _settings(config, entry):
        yield name, settings
        if name == "spectrum":
            yield "points", settings


def asked_map(entry: MapConfig, sampler: Sampler) -> Asked:
    """Check what of a map can be checked without its scene."""
    _check_ascending(entry.name, entry.counts)
    for n in entry.counts:
        check_memory(memory_of(n, entry.dims, 2), f"Map {entry.name!r}, n = {n:,}")
        sampler.check_count(n)
    width, height = (entry.crop[2:] if entry.crop else entry.size) or (256, 256)
    cost = float(width * height * sum(entry.counts) * entry.realizations * 4)
    return Asked("map", entry, cost, memory_of(max(entry.counts), entry.dims, 2, width * height))


def _settings(config: StudyConfig, entry: EstimatorConfig) -> Iterator[tuple[str, Settings]]:
    """Tables of an estimator's analyses: its own, or the study's."""
    for name in ANALYSIS_TABLES:
        own = getattr(entry, name)
        settings = own if own is not None else getattr(config, name)
        if settings is not None:
            yield name, settings


@final
@dataclass(frozen=True)
class _Pair:
    """An estimator with a sampler."""

    name: str
    estimator: AbstractEstimator
    sampler: Sampler

    @property
    def evaluations(self) -> int:
        """Evaluations of the integrand for each of n."""
        return sum(self.estimator.counts)

    def memory(self, analysis: str, n: int, frequencies: int = 0) -> int:
        """Memory at n points; refuses what the machine has not, and counts that cannot be made."""
        needed = memory_of(n, self.estimator.dims, self.evaluations, frequencies)
        check_memory(needed, f"Estimator {self.name!r}, {analysis} with n = {n:,}")
        self.estimator.check_sampler(self.sampler, n)
        return needed


def _convergence(pair: _Pair, settings: ConvergenceConfig) -> Iterator[Asked]:
    counts = settings.counts
    memory = max(pair.memory("convergence", n) for n in counts)
    _check_ascending(pair.name, counts)
    check_window(settings.fit_last, len(counts))
    if settings.relative_error is not None:
        check_relative_error(settings.relative_error)
    cost = sum(counts) * settings.realizations * pair.evaluations
    yield Asked("convergence", settings, cost, memory)


def _terms(pair: _Pair, settings: TermsConfig) -> Iterator[Asked]:
    size = _frequencies(pair, settings, cross_matrix=settings.cross_matrix)
    matrix = 2 * size * size if settings.cross_matrix else 0
    memory = pair.memory("terms", settings.n, size + matrix)
    basis = _basis(pair.sampler, settings)
    make_bands(settings.bands, make_basis(basis, pair.estimator.dims, 1))  # whether there are such
    cost = settings.realizations * (pair.evaluations * settings.n + size)
    yield Asked("terms", settings, cost, memory)


def _techniques(pair: _Pair, settings: TechniquesConfig) -> Iterator[Asked]:
    counts = settings.counts
    _check_ascending(pair.name, counts)
    check_window(settings.fit_last, len(counts))
    size = _frequencies(pair, settings, cross_matrix=False)
    squared = size * len(pair.estimator.counts) ** 2
    memory = max(pair.memory("techniques", n, squared) for n in counts)
    cost = settings.realizations * (pair.evaluations * sum(counts) + squared * len(counts))
    yield Asked("techniques", settings, cost, memory)


def _spectrum(pair: _Pair, settings: SpectrumConfig) -> Iterator[Asked]:
    size = FrequencyGrid(pair.estimator.dims, settings.half_width).size
    memory = pair.memory("spectrum", settings.n, size)
    cost = settings.realizations * (settings.n + 0.5 * size)
    yield Asked("spectrum", settings, cost, memory)
    yield Asked("points", settings, settings.n, pair.memory("points", settings.n))


def _pcf(pair: _Pair, settings: PcfConfig) -> Iterator[Asked]:
    memory = pair.memory("pcf", settings.n)
    pairs = settings.n**2 * (settings.max_distance or 0.5)
    yield Asked("pcf", settings, settings.realizations * (settings.n + 0.1 * pairs), memory)


def _anova(pair: _Pair, settings: AnovaConfig) -> Iterator[Asked]:
    dims = pair.estimator.dims
    if dims > 64:
        raise ConfigError(f"Estimator {pair.name!r}: anova is for up to 64 dims, not {dims}.")
    work = dims**settings.order * settings.realizations * settings.n * pair.evaluations
    yield Asked("anova", settings, work, pair.memory("anova", settings.n))


def _exact(pair: _Pair, settings: ExactConfig) -> Iterator[Asked]:
    _check_ascending(pair.name, settings.counts)
    memory = max(pair.memory("exact", n) for n in settings.counts)
    yield Asked("exact", settings, 1000.0 * sum(settings.counts), memory)


def _remedies(pair: _Pair, settings: RemediesConfig) -> Iterator[Asked]:
    for kind in settings.kinds or ():
        as_choice("remedies.kinds", kind, tuple(KINDS))
    if settings.budget < pair.evaluations:
        raise ConfigError(
            f"Estimator {pair.name!r}: the budget {settings.budget} is below the {pair.evaluations} "
            "evaluations of n = 1; give more."
        )
    needed = memory_of(settings.budget, pair.estimator.dims)
    check_memory(needed, f"Estimator {pair.name!r}, remedies with budget = {settings.budget:,}")
    tries = _REMEDIES if settings.kinds is None else 3 * len(settings.kinds)
    cost = settings.budget * settings.realizations * tries * _REMEDY_STEPS / 2
    yield Asked("remedies", settings, cost, needed)


_CHECKS: dict[str, Callable[[_Pair, Any], Iterator[Asked]]] = {
    "convergence": _convergence,
    "terms": _terms,
    "techniques": _techniques,
    "spectrum": _spectrum,
    "pcf": _pcf,
    "anova": _anova,
    "exact": _exact,
    "remedies": _remedies,
}


def _basis(sampler: Sampler, settings: TermsConfig | TechniquesConfig) -> str:
    basis = as_choice("basis", settings.basis, (*BASES, "auto"))
    return fitting_basis(sampler, settings.half_width) if basis == "auto" else basis


def _frequencies(
    pair: _Pair, settings: TermsConfig | TechniquesConfig, *, cross_matrix: bool
) -> int:
    """Refuse what `variance_terms` would; return the number of coefficients."""
    return check_terms(
        pair.estimator,
        settings.half_width,
        settings.space,
        cross_matrix=cross_matrix,
        basis=_basis(pair.sampler, settings),
    )


def _check_ascending(name: str, counts: tuple[int, ...]) -> None:
    if any(b <= a for a, b in itertools.pairwise(counts)):
        raise ConfigError(f"Estimator {name!r}: counts {list(counts)} must be ascending.")
