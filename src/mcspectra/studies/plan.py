"""Build the cells of a study: every estimator with every sampler and analysis.

Cells are checked before the run.
Each spec is checked once, and each estimator and sampler is built once; cells only refer to them.
Later code does not check the contents of a cell again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, final

from mcspectra.core.analysis import (
    ANALYSES,
    Analysis,
    Need,
    Subject,
    compute_chunk,
    driven,
    finished,
    needed,
    steps_of,
)
from mcspectra.core.checks import is_path
from mcspectra.core.display import shown
from mcspectra.core.errors import ConfigError, LargeStudyWarning, McspectraError, warn
from mcspectra.core.memory import check_memory
from mcspectra.core.registry import Registry
from mcspectra.core.streams import Stream
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
from mcspectra.integrands import INTEGRANDS
from mcspectra.integrands.smoothing import smoothed
from mcspectra.samplers import Sampler
from mcspectra.samplers.registry import sampler_from_calls
from mcspectra.studies.files import (
    EstimatorConfig,
    SceneConfig,
    Slugs,
    StudyConfig,
    analysis_tables,
    as_study,
)
from mcspectra.studies.foreign_code import FunctionFailed, probed
from mcspectra.studies.vetting import Inputs, Trust, Vetting

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "MOST_EVALUATIONS",
    "MOST_SECONDS",
    "NOTED_SECONDS",
    "StudyCell",
    "StudyPlan",
    "make_plan",
]

MOST_EVALUATIONS = 10**15
"""Maximum number of evaluations of a study without --force: half a year on a hundred cores."""

# Planning times in seconds: _SPEC for each spec, and _WEIGHTED for each estimator with densities.
# Planning takes _DENSITY seconds for each density in several dims, or _WARP seconds in one dim.
# A density in one dim takes longer, because its warp is searched for gaps
_SPEC, _WEIGHTED, _DENSITY, _WARP = 1e-4, 6e-4, 5e-4, 2e-3
# Planning times in seconds: _PAIR for each pair of estimator and sampler, and _CELL for each cell.
# Planning takes _COUNT more seconds for each item of a list, such as the list of counts
_PAIR, _CELL, _COUNT = 3e-6, 2.5e-5, 3e-6
NOTED_SECONDS = 5.0
"""Planning time in seconds above which a message announces the wait."""

MOST_SECONDS = 120.0
"""Maximum planning time in seconds without --force; five million analyses take this time and 3 GB.

A grid of a few lines that exceeds this limit is usually a mistake.
"""


@final
@dataclass(frozen=True, slots=True)
class StudyCell:
    """One analysis of one estimator or scene with one sampler.

    Attributes
    ----------
    path
        Path of the cell in the results: estimator/sampler/analysis.
    analysis
        The analysis with its options, which have been checked.
    estimator_name, sampler_spec
        Name of the estimator and spec of the sampler, as written in the study file.
    subject
        The estimator and the sampler.
        The estimator is missing if the cell analyzes a scene, or if `error` is set.
    need
        Cost and memory of the cell; the cost serves the schedule and the display of progress.
    error
        Reason why the cell fails before it begins; None if it can be tried.
        For example, the integrand of the estimator may raise an error at the first points.
    inputs
        Names of the files that the cell depends on: keys of the plan's `inputs`.
    """

    path: str
    analysis: Analysis
    estimator_name: str
    sampler_spec: str
    subject: Subject
    need: Need
    error: str | None = None
    inputs: Inputs = ()

    @property
    def analysis_name(self) -> str:
        """Name of the analysis: its table in the study, and the last part of the path."""
        return self.path.rpartition("/")[2]

    def compute(self, seed: int) -> xr.Dataset:
        """Compute the cell in this thread; the result has the same bits on every run.

        Unlike `mcspectra.core.analysis.compute`, this method does not check the request.
        Planning has already checked the requests of all cells.
        """
        steps = steps_of(self.analysis, self.subject, Stream.from_rng(seed))
        result = driven(
            steps, lambda step: (compute_chunk(each, (0, each.blocks)) for each in step)
        )
        return self.finished(result, seed)

    def finished(self, result: xr.Dataset, seed: int) -> xr.Dataset:
        """Check a result of the analysis, and add the seed and the names of the cell."""
        return finished(self.analysis, result, seed).assign_attrs(
            estimator_name=self.estimator_name,
            sampler_spec=self.sampler_spec,
            analysis=self.analysis_name,
        )


@final
@dataclass(frozen=True)
class StudyPlan:
    """All cells of a study, in the order of the file.

    Attributes
    ----------
    inputs
        SHA-256 of the files that the cells depend on, by name.
        For files below the study's folder, the name is the path relative to this folder.
    """

    config: StudyConfig
    cells: tuple[StudyCell, ...]
    inputs: Mapping[str, str] = field(default_factory=dict)


def make_plan(
    config: StudyConfig, folder: str | Path, trust: Trust | None = None, *, force: bool = False
) -> StudyPlan:
    """Build every component, and check every count and size before anything runs.

    Parameters
    ----------
    config
        The study.
    folder
        Folder of the study file, where relative paths in specs start.
    trust
        Files and functions that the study may use beyond `folder`; none by default.
    force
        Whether the limits `MOST_EVALUATIONS` and `MOST_SECONDS` may be exceeded.

    Raises
    ------
    ConfigError
        If a component cannot be built, or a sampler does not support a count.
        If a file or function is not allowed, or the study is too large.
        The message names the estimator.

    Warns
    -----
    LargeStudyWarning
        If planning takes longer than five seconds.
    """
    as_study(config)
    if not (trust is None or isinstance(trust, Trust)):
        raise ConfigError(f"trust is {shown(trust)}; give a Trust, or None.")
    if not is_path(folder):
        raise ConfigError(f"folder is {folder!r}; give the path of the study's folder.")

    # Announce or refuse long planning before anything is built
    texts = {*config.samplers}
    pairs, seconds = 0, 0.0
    shared = {name: _seconds(each) for name, each in config.analyses.items()}
    for entry in config.entries:
        own = config.samplers_of(entry)
        texts.update(entry.samplers or ())
        pairs += len(own)
        seconds += _SPEC + _PAIR * len(own)
        if isinstance(entry, EstimatorConfig):
            asked = {**shared, **{name: _seconds(each) for name, each in entry.analyses.items()}}
            seconds += sum(asked.values()) * len(own) + _SPEC * len(entry.integrands or ())
            densities = len(entry.densities or ()) + (entry.density is not None)
            one = _WARP if entry.dims == 1 else _DENSITY
            seconds += densities * one + _WEIGHTED * (densities > 0)
    seconds += _SPEC * len(texts)
    if seconds > NOTED_SECONDS:
        what = (
            f"The study has {len(config.entries):,} estimators and {pairs:,} pairs of estimator "
            f"and sampler, which take about {seconds:.2g} s to plan"
        )
        if seconds > MOST_SECONDS and not force:
            raise ConfigError(f"{what}; split it into several studies, or give --force.")
        warn(f"{what}, before the first analysis begins.", LargeStudyWarning)
    planner = _Planner(config, Vetting(Path(folder), trust or Trust()))
    cells = tuple(cell for entry in config.entries for cell in planner.cells(entry))
    if not cells:
        raise ConfigError(
            f"The study has no analysis; add a table, one of {', '.join(analysis_tables())}."
        )
    total = sum(cell.need.cost for cell in cells)
    if total > MOST_EVALUATIONS and not force:
        raise ConfigError(
            f"The study needs about {total:.2g} evaluations, months on a hundred processors; use "
            "fewer points or realizations, or give --force."
        )
    return StudyPlan(config, cells, planner.vetting.inputs)


def _seconds(analysis: Analysis) -> float:
    """Return the seconds needed to estimate the cost and memory of an analysis."""
    given = (getattr(analysis, key) for key in analysis.__struct_fields__)
    return _CELL + _COUNT * sum(len(value) for value in given if isinstance(value, tuple))


_Samplers: TypeAlias = list[tuple[str, str, Sampler, Inputs]]
"""For each sampler: its spec, its part of the cell's path, the sampler, and its input files."""

_Asked: TypeAlias = tuple[str, Analysis, Inputs]
"""Name of a requested analysis, the analysis, and the files that it depends on."""


@final
class _Planner:
    """Makes the cells of one study; an object that several cells share is made once."""

    def __init__(self, config: StudyConfig, vetting: Vetting) -> None:
        self.vetting = vetting
        self._config = config
        self._slugs = Slugs()
        self._one: dict[tuple[str, int | None], tuple[Sampler, Inputs]] = {}
        self._lists: dict[tuple[tuple[str, ...], int | None], _Samplers] = {}
        self._vetted: dict[int, list[_Asked]] = {}
        self._needs: dict[Need, Need] = {}

    def cells(self, entry: EstimatorConfig | SceneConfig) -> Iterator[StudyCell]:
        """Yield the cells of an estimator or a scene with all its samplers."""
        kind = "Estimator" if isinstance(entry, EstimatorConfig) else entry.kind.capitalize()
        whose = f"{kind} {entry.name!r}"
        estimator, error, inputs = None, None, set[str]()
        try:
            if isinstance(entry, SceneConfig):
                dims = getattr(entry.analysis, "dims", None)
            else:
                dims = 2 if entry.dims is None else entry.dims
                try:
                    estimator = _built(entry, self.vetting, self._config.time_limit, inputs)
                    dims = estimator.dims
                except FunctionFailed as failure:
                    error = str(failure)
            parent = self._slugs(entry.name)
            asked = list(self._asked(entry))
            samplers = self._samplers(entry, dims, whose)
        except ConfigError:
            raise
        except McspectraError as refusal:
            raise ConfigError(f"{whose}: {refusal}") from refusal
        for text, slug, sampler, of_sampler in samplers:
            subject = Subject(estimator, sampler)
            for name, analysis, of_analysis in asked:
                need = Need(cost=0.0)
                if error is None:  # Refuse analyses that are impossible or need too much memory
                    try:
                        asked_for = needed(analysis, subject)
                        need = self._needs.setdefault(asked_for, asked_for)
                    except McspectraError as refusal:
                        raise ConfigError(f"{whose}, {name}: {refusal}") from refusal
                    check_memory(need.memory, f"{whose}, {name}")
                yield StudyCell(
                    path=f"{parent}/{slug}/{name}",
                    analysis=analysis,
                    estimator_name=entry.name,
                    sampler_spec=text,
                    subject=subject,
                    need=need,
                    error=error,
                    inputs=tuple(sorted(inputs.union(of_sampler, of_analysis))),
                )

    def _asked(self, entry: EstimatorConfig | SceneConfig) -> Iterator[_Asked]:
        """Yield the analyses of an entry, from its own tables and from tables of the whole study.

        After each analysis, yield its companions, which are analyses that run with it.
        """
        if isinstance(entry, SceneConfig):
            tables = {entry.kind: entry.analysis}
        else:
            tables = {**self._config.analyses, **entry.analyses}
        for name, table in tables.items():
            # A table's id identifies it, because no table is deleted during the life of the study
            if id(table) not in self._vetted:
                analysis, inputs = self.vetting.options(table)
                vetted = [(name, analysis, inputs)]
                # Also plan the companions: other analyses that a study adds to this analysis
                for other in analysis.companions:
                    kind = ANALYSES.load(other)
                    shared = {*kind.__struct_fields__} & {*analysis.__struct_fields__}
                    made = kind(**{key: getattr(analysis, key) for key in shared})
                    vetted.append((other, made, inputs))
                self._vetted[id(table)] = vetted
            for asked in self._vetted[id(table)]:
                if asked[0] == name or asked[0] not in tables:
                    yield asked

    def _samplers(
        self, entry: EstimatorConfig | SceneConfig, dims: int | None, whose: str
    ) -> _Samplers:
        """Return the samplers of an estimator or a scene. Equal specs give the same object."""
        texts = self._config.samplers_of(entry)
        key = texts, dims
        if key not in self._lists:
            slugs, specs, found = Slugs(), dict[str, str](), _Samplers()
            for text in texts:
                if (text, dims) not in self._one:
                    try:
                        calls, inputs = self.vetting.sampler(text)
                        self._one[text, dims] = sampler_from_calls(calls, dims), inputs
                    except ConfigError:
                        raise
                    except McspectraError as refusal:
                        raise ConfigError(f"{whose}, sampler {shown(text)}: {refusal}") from refusal
                sampler, inputs = self._one[text, dims]
                first = specs.setdefault(sampler.spec, text)
                if first != text:
                    raise ConfigError(
                        f"{shown(first)} and {shown(text)} are the same sampler; list only one of "
                        "them."
                    )
                found.append((text, slugs(text), sampler, inputs))
            self._lists[key] = found
        return self._lists[key]


def _built(
    entry: EstimatorConfig, vetting: Vetting, limit: float | None, inputs: set[str]
) -> AbstractEstimator:
    """Make the estimator of a table ``[[estimators]]``, and collect the files that it reads.

    Raises
    ------
    FunctionFailed
        If a Python function fails at its first points.
    McspectraError
        If a spec cannot be read, or a component cannot be built from it.
    """

    def component(registry: Registry, text: str, dims: int | None) -> Any:
        calls, names = vetting.calls(text)
        inputs.update(names)
        if len(calls) != 1:
            raise ConfigError(f"{shown(text)} chains parts with '|'; only samplers can be chained.")
        if calls[0].name != "python":
            return registry.build(calls[0], dims)
        if registry is not INTEGRANDS:
            raise ConfigError(f"{shown(text)}: only integrands can be Python functions.")
        function, names = vetting.function(text, calls[0])
        inputs.update(names)
        return probed(function, dims=2 if dims is None else dims, limit=limit)

    sets, counts = entry.sets or "independent", entry.technique_counts
    heuristic = entry.heuristic or "balance"
    made: AbstractEstimator
    if entry.integrands is not None:
        parts = [component(INTEGRANDS, text, entry.dims) for text in entry.integrands]
        made = TechniqueSum(parts, counts=counts, sets=sets)
    else:
        f = component(INTEGRANDS, entry.integrand or "", entry.dims)
        if entry.smoothed is not None:
            f = smoothed(f, entry.smoothed)
        one = None if entry.density is None else component(DENSITIES, entry.density, f.dims)
        densities = [component(DENSITIES, text, f.dims) for text in entry.densities or ()]
        if entry.densities is None:
            made = Estimator(f, one)
        elif entry.channels in ("own", "shared"):  # There is one density per channel
            own = "shared" if entry.channels == "shared" else "independent"
            made = ChannelSampling(f, densities, sets=own)
        elif entry.one_sample:
            chance, selection = entry.probabilities, entry.selection or "extra"
            made = OneSampleMIS(f, densities, chance, heuristic=heuristic, selection=selection)
        else:
            made = MultipleImportance(f, densities, heuristic=heuristic, counts=counts, sets=sets)
    return made if entry.mirror is None else Mirrored(made, entry.mirror)
