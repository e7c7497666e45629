"""From a study's text to cells: every (estimator, sampler, analysis), built and checked up front."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from mcspectra.core.errors import ConfigError, McspectraError
from mcspectra.estimators import AbstractEstimator
from mcspectra.samplers import Sampler, sampler_from_calls
from mcspectra.studies.analyses import Asked, asked_analyses, asked_map, asked_names
from mcspectra.studies.building import build_estimator
from mcspectra.studies.foreign_code import FunctionFailed
from mcspectra.studies.inputs import Digests
from mcspectra.studies.sizes import MOST_EVALUATIONS
from mcspectra.studies.tables import (
    EstimatorConfig,
    MapConfig,
    Settings,
    StudyConfig,
    entries_of,
    samplers_of,
)
from mcspectra.studies.trust import Site, Trust

__all__ = ["Cell", "Plan", "make_plan"]

_MOST_CELLS = 10**7
_RESERVED = frozenset({"zarr.json", "c"})


@dataclass(frozen=True)
class Cell:
    """One analysis of one estimator with one sampler, or a map of a scene.

    Attributes
    ----------
    path
        Group of the cell in the store: estimator/sampler/analysis.
    estimator
        None for a map.
    cost
        Work in arbitrary units, about proportional to time; for scheduling and progress.
    memory
        Bytes it takes at most, estimated.
    error
        Why it fails before it has begun, as when its integrand raises at the first points; None if
        it can be tried.
    inputs
        Names of the files that it depends on: keys of the plan's.
    """

    path: str
    analysis: str
    estimator_name: str
    sampler_spec: str
    estimator: AbstractEstimator | None
    sampler: Sampler
    settings: Settings
    cost: float
    memory: int = 0
    error: str | None = None
    inputs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """All cells of a study, in the order of the file.

    Attributes
    ----------
    inputs
        SHA-256 of the files that they depend on, by names for people: the path from the study's
        folder, if it is below that.
    """

    config: StudyConfig
    cells: tuple[Cell, ...]
    inputs: Mapping[str, str] = field(default_factory=dict)


def make_plan(
    config: StudyConfig, folder: Path, trust: Trust | None = None, *, force: bool = False
) -> Plan:
    """Build every component and check every count and size before anything runs.

    Parameters
    ----------
    config
        The study.
    folder
        Folder of the study file: relative paths in spec strings start there.
    trust
        What the study may reach beyond `folder`; nothing by default.
    force
        Allow more than `MOST_EVALUATIONS` evaluations.

    Raises
    ------
    ConfigError
        A component cannot be built, a sampler cannot do a count, a file or a function is not one
        that the study may reach, or the study is too large; names the estimator.
    """
    digests = Digests(folder)
    _check_number(config)
    cells: list[Cell] = []
    slugs = _Slugs()
    for entry in entries_of(config):
        site = Site(folder, trust or Trust(), config.time_limit)
        try:
            found = list(_cells(config, entry, site, slugs(entry.name)))
            cells += _with_inputs(found, digests.add(site.files))
        except ConfigError:
            raise
        except McspectraError as error:
            kind = "Map" if isinstance(entry, MapConfig) else "Estimator"
            raise ConfigError(f"{kind} {entry.name!r}: {error}") from error
    if not cells:
        raise ConfigError(
            "The study asks for no analysis; give a table convergence, terms or spectrum."
        )
    _check_work(cells, force)
    return Plan(config, tuple(cells), digests.by_name)


def _cells(
    config: StudyConfig, entry: EstimatorConfig | MapConfig, site: Site, parent: str
) -> Iterator[Cell]:
    """Cells of an estimator, or of a map, with all its samplers."""
    estimator = None
    if isinstance(entry, MapConfig):
        entry = msgspec.structs.replace(entry, scene=site.scene(entry.scene))
        dims = entry.dims
    else:
        try:
            estimator = build_estimator(entry, site)
        except FunctionFailed as failure:
            yield from _failed_cells(config, entry, site, parent, str(failure))
            return
        dims = estimator.dims
    inner = _Slugs()
    specs: dict[str, str] = {}
    for text in samplers_of(config, entry):
        sampler = sampler_from_calls(site.calls(text), dims)
        _check_new(sampler, text, specs)
        path = f"{parent}/{inner(text)}"
        for asked in _asked(config, entry, estimator, sampler):
            yield _cell(asked, path, entry.name, text, estimator, sampler)


def _failed_cells(
    config: StudyConfig, entry: EstimatorConfig, site: Site, parent: str, error: str
) -> Iterator[Cell]:
    """Cells of an estimator whose integrand fails at its first points: they fail, and no others."""
    inner = _Slugs()
    for text in samplers_of(config, entry):
        sampler = sampler_from_calls(site.calls(text), 2 if entry.dims is None else entry.dims)
        path = f"{parent}/{inner(text)}"
        for name, settings in asked_names(config, entry):
            asked = Asked(name, settings, 0.0, 0)
            cell = _cell(asked, path, entry.name, text, None, sampler)
            yield dataclasses.replace(cell, error=error)


def _asked(
    config: StudyConfig,
    entry: EstimatorConfig | MapConfig,
    estimator: AbstractEstimator | None,
    sampler: Sampler,
) -> Iterator[Asked]:
    if estimator is not None and isinstance(entry, EstimatorConfig):
        yield from asked_analyses(config, entry, estimator, sampler)
    elif isinstance(entry, MapConfig):
        yield asked_map(entry, sampler)


def _cell(
    asked: Asked,
    path: str,
    name: str,
    text: str,
    estimator: AbstractEstimator | None,
    sampler: Sampler,
) -> Cell:
    return Cell(
        path=f"{path}/{asked.analysis}",
        analysis=asked.analysis,
        estimator_name=name,
        sampler_spec=text,
        estimator=estimator,
        sampler=sampler,
        settings=asked.settings,
        cost=asked.cost,
        memory=asked.memory,
    )


def _with_inputs(cells: list[Cell], inputs: tuple[str, ...]) -> Iterable[Cell]:
    return (dataclasses.replace(cell, inputs=inputs) for cell in cells) if inputs else cells


def _check_number(config: StudyConfig) -> None:
    """Refuse more cells than a store can hold, before any is built."""
    pairs = sum(len(samplers_of(config, entry)) for entry in entries_of(config))
    if pairs > _MOST_CELLS:
        raise ConfigError(
            f"The study has {pairs:,} pairs of estimator and sampler; {_MOST_CELLS:,} at most are "
            "planned, so take several studies."
        )


def _check_work(cells: list[Cell], force: bool) -> None:
    total = sum(cell.cost for cell in cells)
    if total > MOST_EVALUATIONS and not force:
        raise ConfigError(
            f"The study would take about {total:.2g} evaluations, months of a hundred processors; ask "
            "for fewer points or realisations, or give --force."
        )


def _check_new(sampler: Sampler, text: str, specs: dict[str, str]) -> None:
    """Refuse a sampler that is listed already under another spelling."""
    if sampler.spec in specs:
        raise ConfigError(f"{specs[sampler.spec]!r} and {text!r} are the same sampler; list one.")
    specs[sampler.spec] = text


class _Slugs:
    """Short group names of letters, digits, dots and hyphens, a different one for each text.

    They have no separator and no leading dot, so that no name leads out of the store, and are none of
    the names of the store's own files.
    """

    def __init__(self) -> None:
        self._taken: set[str] = set(_RESERVED)
        self._next: dict[str, int] = {}

    def __call__(self, text: str) -> str:
        base = re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-.")[:60].strip("-.") or "x"
        slug = base
        while slug in self._taken:
            # Numbers go on where they were: thousands of texts may begin alike.
            number = self._next.get(base, 2)
            slug, self._next[base] = f"{base}-{number}", number + 1
        self._taken.add(slug)
        return slug
