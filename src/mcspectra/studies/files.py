"""Read study files: TOML, typed and checked as a whole before anything runs.

A study names samplers, estimators and analyses.
Each analysis has a table under its name (`mcspectra.core.analysis`).
An estimator may have its own table of an analysis, which replaces the table of the study.
The analysis defines the keys, types, defaults and meanings of its table.
Unknown keys, wrong types and values out of range are errors that name the place.
Relative paths in specs are relative to the folder of the file.

A study is read in four steps. First, changes from the command line are applied.
Next, grids are expanded, and then the types of all values are checked.
Finally, rules that concern several keys are checked.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import itertools
import math
import re
import tomllib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, final

import msgspec
from msgspec import Meta

from mcspectra.core.analysis import ANALYSES, Analysis
from mcspectra.core.checks import is_path
from mcspectra.core.display import shown
from mcspectra.core.errors import (
    ConfigError,
    McspectraError,
    MissingDependency,
    UnknownName,
    close_match_hint,
)
from mcspectra.core.options import Option, Positive, Text, options_of

__all__ = [
    "BUILT_IN",
    "MOST_ENTRIES",
    "RESERVED",
    "EstimatorConfig",
    "Names",
    "SceneConfig",
    "Slugs",
    "StudyConfig",
    "analysis_tables",
    "apply_overrides",
    "as_study",
    "decode_study",
    "expand_grids",
    "plain_study",
    "planned_groups",
    "read_study",
    "study_file",
    "study_of",
]

BUILT_IN = {file.stem: file for file in sorted((Path(__file__).parent / "builtin").glob("*.toml"))}
"""Files of the studies in this package, by name."""

MOST_ENTRIES = 100_000
"""Maximum number of estimators, maps or samplers that grids may generate in one table."""

RESERVED = ("analyses", "scenes", "kind", "analysis")
"""Fields of the structs of studies, estimators and scenes that a file cannot set."""

_MOST_TEXT = 10**8  # Maximum number of characters that a grid may generate in one table
_LARGEST_FILE = 4 * 2**20
_RESERVED_SLUGS = frozenset({"zarr.json", "c"})
_SINGLE = ("seed", "time_limit")  # Keys of a study that accept no placeholder of a grid
# Dotted keys have at most 64 parts, because tomllib's time grows with the square of their number.
# A dotted key with 10⁶ parts would take hours to parse
_DOTTED = re.compile(
    r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){64}""", re.ASCII
)
_TABLE_NAME = re.compile(r"[a-z][a-z0-9]*(?:-[a-z0-9]+)*")
_STEP = r"[A-Za-z][A-Za-z0-9_-]*(?:\[\d{1,6}\])*"
_PLACE = re.compile(rf"{_STEP}(?:\.{_STEP})*")
_PLACEHOLDER = re.compile(r"\{([A-Za-z_][A-Za-z0-9_]*)\}")
_OWN, _HAS_OWN = ("n", "seed", "dims"), re.compile(r"\b(?:command|points)\(")
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

Struct = TypeVar("Struct", bound=msgspec.Struct)
Grid = dict[str, list[str | int | float | bool | list[Any]]]
Values = Mapping[str, list[Any]]

_NAME = Meta(description="Name in tables and figures; it must be unique.")
_SAMPLERS = Meta(description="Samplers; by default those of the study.")


class _StudyTable(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """Base of the structs for all tables of a study file. It sets options of msgspec for them."""


class EstimatorConfig(_StudyTable, frozen=True, kw_only=True, omit_defaults=True):
    """An estimator: its integrand, its densities, and its samplers."""

    name: Annotated[Text, _NAME]
    dims: Annotated[
        Annotated[int, Meta(ge=1, le=1024)] | None,
        Meta(description="Number of dims, if the specs do not fix it."),
    ] = None
    integrand: Annotated[
        Text | None, Meta(description="Spec (`mcspectra list integrands`) or python(...).")
    ] = None
    integrands: Annotated[
        tuple[Text, ...] | None,
        Meta(description="Techniques in primary space, each with its own points; they are added."),
    ] = None
    density: Annotated[
        Text | None, Meta(description="Importance density (`mcspectra list densities`).")
    ] = None
    densities: Annotated[
        tuple[Text, ...] | None,
        Meta(description="Densities of multiple importance sampling, or one density per channel."),
    ] = None
    heuristic: Annotated[
        str | None,
        Meta(
            description="Weights of densities: balance, power(beta=2), cutoff, maximum, optimal, "
            "variance-aware."
        ),
    ] = None
    technique_counts: Annotated[
        tuple[Positive, ...] | None,
        Meta(description="Points of each technique as multiples of n; 1 by default."),
    ] = None
    sets: Annotated[
        Literal["independent", "shared", "joint"] | None,
        Meta(description="Relation between the techniques' point sets; independent by default."),
    ] = None
    one_sample: Annotated[
        bool, Meta(description="Let each point choose one of the densities at random.")
    ] = False
    probabilities: Annotated[
        tuple[float, ...] | None,
        Meta(description="Probabilities of the densities with one_sample; equal by default."),
    ] = None
    selection: Annotated[
        Literal["extra", "coordinate"] | None,
        Meta(description="Coordinate that chooses with one_sample: an extra one, or the first."),
    ] = None
    channels: Annotated[
        Literal["own", "shared", "combined", "one"] | None,
        Meta(
            description="Densities of color channels: own or shared points for each channel's "
            "density, all densities combined by MIS, or one density for all channels."
        ),
    ] = None
    mirror: Annotated[
        Literal["integrand", "random", "uniform"] | None,
        Meta(description="Mirror the integrand, or the samples at random or into all images."),
    ] = None
    smoothed: Annotated[
        Annotated[float, Meta(gt=0)] | None,
        Meta(description="Width of the ramps that replace the integrand's edges."),
    ] = None
    samplers: Annotated[tuple[Text, ...] | None, _SAMPLERS] = None
    grid: Annotated[
        Grid | None,
        Meta(description="Values of {placeholders}: one estimator for each combination."),
    ] = None
    analyses: dict[str, Analysis] = {}


class SceneConfig(_StudyTable, frozen=True, kw_only=True, omit_defaults=True):
    """An analysis of a scene with its own samplers: an entry of ``[[maps]]``.

    The field `kind` is the name of the analysis; `analysis` holds the options of the entry.
    """

    name: Annotated[Text, _NAME]
    samplers: Annotated[tuple[Text, ...] | None, _SAMPLERS] = None
    grid: Annotated[
        Grid | None, Meta(description="Values of {placeholders}: one entry for each combination.")
    ] = None
    kind: str = ""
    analysis: Analysis = msgspec.field(default_factory=Analysis)


class StudyConfig(_StudyTable, frozen=True, kw_only=True, omit_defaults=True):
    """The tables and keys of a study file.

    The field `analyses` holds the tables of analyses by name, in the order of the file.
    The field `scenes` holds the entries of ``[[maps]]``.
    """

    title: Annotated[Text, Meta(description="Title of the report.")]
    seed: Annotated[Annotated[int, Meta(ge=0)], Meta(description="Seed of all realizations.")] = 0
    samplers: Annotated[
        tuple[Text, ...],
        Meta(description="Samplers of all estimators (`mcspectra list samplers`), chained by |."),
    ] = ()
    time_limit: Annotated[
        Annotated[float, Meta(ge=0.01, le=1e9)] | None,
        Meta(description="Time limit in seconds; a longer task is stopped and its analysis fails."),
    ] = None
    grid: Annotated[
        Grid | None, Meta(description="Values of {placeholders} anywhere in the study.")
    ] = None
    estimators: Annotated[
        tuple[EstimatorConfig, ...], Meta(description="Tables [[estimators]].")
    ] = ()
    analyses: dict[str, Analysis] = {}
    scenes: tuple[SceneConfig, ...] = ()

    @property
    def entries(self) -> tuple[EstimatorConfig | SceneConfig, ...]:
        """Estimators followed by scenes, in the order of the file."""
        return *self.estimators, *self.scenes

    def samplers_of(self, entry: EstimatorConfig | SceneConfig) -> tuple[str, ...]:
        """Return the samplers of an estimator or scene: its own samplers, or those of the study."""
        return self.samplers if entry.samplers is None else entry.samplers


def analysis_tables() -> dict[str, type[Analysis]]:
    """Return the analyses by the keys of their tables.

    The key is the name of the analysis. For an analysis of scenes, it is the plural (``maps``).
    Analyses that cannot be loaded are left out.
    """
    found = {}
    for name in sorted(_names()):
        with contextlib.suppress(MissingDependency):
            kind = ANALYSES.load(name)
            found[f"{name}s" if kind.about == "scene" else name] = kind
    return found


def _names() -> frozenset[str]:
    """Return the names of analyses that can be keys of a study.

    The names of all other keys of studies and estimators are excluded.
    """
    own = {*StudyConfig.__struct_fields__, *EstimatorConfig.__struct_fields__}
    return frozenset(n for n in ANALYSES if _TABLE_NAME.fullmatch(n) and n not in own)


def _scene_lists(table: Mapping[str, Any]) -> dict[str, str]:
    """Return the keys of a study that list scenes, each with the name of the analysis of scenes.

    For example, the key ``maps`` stands for the analysis ``map``.
    """
    names, found = _names(), {}
    for key in table:
        name = key.removesuffix("s")
        listed = key not in names and name != key and name in names
        if listed and ANALYSES.load(name).about == "scene":
            found[key] = name
    return found


def study_file(name: str | Path) -> Path:
    """Return the file of a built-in study, such as ``"tour"``; any other name is itself a path.

    Paths in a study are relative to the folder of its file.

    Raises
    ------
    ConfigError
        If the name is not a path.
    """
    if not is_path(name):
        raise ConfigError(
            f"{shown(name)} is not the path of a study file; give the path of a .toml file."
        )
    return BUILT_IN.get(str(name), Path(name))


def read_study(path: str | Path, overrides: Sequence[str] = ()) -> StudyConfig:
    """Read and check a study file.

    Parameters
    ----------
    path
        Path of the file, or name of a built-in study: see `study_file`.
    overrides
        Changes ``key=value`` as in ``mcspectra run --set``: see `apply_overrides`.

    Raises
    ------
    ConfigError
        If the file is missing, unreadable, not TOML, or not a study. The message names the place.
    """
    file = study_file(path)
    try:
        if file.exists() and not file.is_file():
            raise ConfigError(f"{str(file)!r} is not a file; give the path of a .toml file.")
        if file.stat().st_size > _LARGEST_FILE:
            raise ConfigError(f"{str(file)!r} is larger than a study file may be (4 MiB).")
        text = file.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ConfigError(
            f"There is no study file {str(file)!r}; give the path of a .toml file, or one of these "
            f"names: {', '.join(BUILT_IN)}."
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ConfigError(f"The study file {str(file)!r} cannot be read: {reason}.") from None
    return decode_study(text, str(file), overrides)


def decode_study(text: str, source: str = "study", overrides: Sequence[str] = ()) -> StudyConfig:
    """Check the text of a study file and expand its grids; messages call the file `source`.

    Raises
    ------
    ConfigError
        Same as in the function `read_study`.
    """
    if not isinstance(text, str):
        raise ConfigError(f"{source} is {type(text).__name__}, not the text of a study file.")
    try:
        if _DOTTED.search(text):
            raise RecursionError
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{source} is not valid TOML: {error}.") from None
    except RecursionError:
        raise ConfigError(f"{source} is nested too deeply for a study.") from None
    except ValueError:  # int() refuses numbers of more than 4300 digits
        raise ConfigError(f"{source} contains a number with too many digits.") from None
    return study_of(expand_grids(apply_overrides(table, overrides), source), source)


def study_of(table: Mapping[str, Any], source: str = "study") -> StudyConfig:
    """Convert a table of plain values without grids to a study; the inverse of `plain_study`.

    Raises
    ------
    ConfigError
        If the table is not a study. The message names the place.
    """
    try:
        config = _StudyReader().study(table)

        # The types in each table have been checked. Now check rules that concern several tables
        if not config.entries:
            scenes = [key for key, each in analysis_tables().items() if each.about == "scene"]
            lists = " or ".join(f"[[{key}]]" for key in ("estimators", *scenes))
            raise ConfigError(f"there is nothing to study; add {lists}.")
        (name, times), *_ = Counter(entry.name for entry in config.entries).most_common(1)
        if times > 1:
            raise ConfigError(f"two estimators are called {shown(name)}; names must differ.")
        seen = set()
        for entry in config.entries:
            samplers = config.samplers_of(entry)
            if not samplers:
                raise ConfigError(
                    f"{shown(entry.name)} has no samplers; list some there or at the top."
                )
            if id(samplers) not in seen and len(set(samplers)) < len(samplers):
                raise ConfigError(f"{shown(entry.name)} lists a sampler twice.")
            seen.add(id(samplers))  # Check a list once: most estimators share it
        for estimator in config.estimators:
            for complaint in _complaints(estimator):
                raise ConfigError(f"the estimator {shown(estimator.name)} {complaint}")
    except McspectraError as error:
        raise ConfigError(f"{source}: {error}") from None
    return config


def as_study(config: StudyConfig) -> StudyConfig:
    """Return the argument if it is a study, and raise an error otherwise.

    Raises
    ------
    ConfigError
        If the argument is not a study.
    """
    if not isinstance(config, StudyConfig):
        raise ConfigError(f"{config!r} is not a study; pass the result of read_study.")
    return config


def plain_study(config: StudyConfig) -> dict[str, Any]:
    """Return a study as plain values, with the keys of a file and expanded grids.

    Keys of the study and of estimators are left out if they have their default value.
    Options of analyses are kept even if they have their default value.
    Therefore the returned values are the same if other analyses are installed or removed.
    """
    plain: dict[str, Any] = msgspec.to_builtins(as_study(config))
    for entry in (plain, *plain.get("estimators", ())):
        entry |= entry.pop("analyses", {})
    for entry in plain.pop("scenes", ()):
        listed = plain.setdefault(f"{entry.pop('kind')}s", [])
        listed.append({**entry, **entry.pop("analysis")})
    return plain


@final
class Slugs:
    """Make a unique group name for each text, of letters, digits, dots and hyphens.

    Names have no separator and no leading dot, so they cannot leave the store.
    Group names also differ from the names of files that the store uses for itself.
    """

    def __init__(self) -> None:
        self._taken: set[str] = set(_RESERVED_SLUGS)
        self._next: dict[str, int] = {}

    def __call__(self, text: str) -> str:
        """Return a group name for a text, different from all names of earlier calls."""
        base = re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-.")[:60].strip("-.") or "x"
        slug = base
        while slug in self._taken:
            # Thousands of texts may give the same name, so do not try all numbers from 2 again:
            # remember the next free number of each name
            number = self._next.get(base, 2)
            slug, self._next[base] = f"{base}-{number}", number + 1
        self._taken.add(slug)
        return slug


Names: TypeAlias = dict[str, None]
"""Unique texts in order, with fast lookup."""


def planned_groups(study: Mapping[str, Any]) -> dict[str, tuple[Names, Names]]:
    """Return all names that make up the paths of a study's cells, without building a cell.

    Parameters
    ----------
    study
        Study as plain values, as returned by `plain_study`.

    Returns
    -------
    dict
        A path is estimator/sampler/analysis. Keys of the result are names of estimators or scenes.
        Each value is a pair of lists: the names of the samplers and of the analyses.
        Companions, which are analyses that always run with another analysis, are included.
    """
    found, slugs = dict[str, tuple[Names, Names]](), Slugs()
    known: dict[tuple[str, ...], Names] = {}
    shared = [key for key, value in study.items() if isinstance(value, Mapping)]
    for key, entries in study.items():
        if not isinstance(entries, list | tuple) or key == "samplers":
            continue
        for entry in entries:
            texts = tuple(entry.get("samplers") or study.get("samplers") or ())
            if texts not in known:
                known[texts] = dict.fromkeys(map(Slugs(), texts))
            tables = dict.fromkeys([key.removesuffix("s")])
            if key == "estimators":
                own = (name for name, value in entry.items() if isinstance(value, Mapping))
                tables = dict.fromkeys([*shared, *own])
            asked: Names = {}
            for name in tables:
                asked[name] = None
                with contextlib.suppress(
                    MissingDependency, UnknownName
                ):  # The package is not installed
                    companions = ANALYSES.load(name).companions
                    asked |= dict.fromkeys(each for each in companions if each not in tables)
            found[slugs(entry["name"])] = known[texts], asked
    return found


# Check the types of values, so that each table becomes a struct.


@final
class _StudyReader:
    """Makes structs from the tables of one study."""

    def __init__(self) -> None:
        self._names = _names()

    def study(self, table: Mapping[str, Any]) -> StudyConfig:
        """Read a whole study."""
        if not isinstance(table, dict):
            raise ConfigError(f"a study is a table, not {shown(table)}.")
        lists = _scene_lists(table)
        rest = {k: v for k, v in table.items() if k not in lists and k != "estimators"}
        config = self._with_analyses(rest, StudyConfig, "")
        estimators = tuple(
            self._with_analyses(entry, EstimatorConfig, place)
            for entry, place in _entries("estimators", table.get("estimators", []))
        )
        scenes = []
        own = ("name", "samplers")
        for key, name in lists.items():
            for entry, place in _entries(key, table[key]):
                given = _table(entry, place)
                made = _struct({k: given[k] for k in own if k in given}, SceneConfig, place)
                options = {k: v for k, v in given.items() if k not in own}
                analysis: Analysis = _struct(options, ANALYSES.load(name), place, own)
                scenes.append(msgspec.structs.replace(made, kind=name, analysis=analysis))
        return msgspec.structs.replace(config, estimators=estimators, scenes=tuple(scenes))

    def _with_analyses(self, table: Any, kind: type[Struct], place: str) -> Struct:
        """Read a table that may contain tables of analyses."""
        given = _table(table, place)
        made = _struct({k: v for k, v in given.items() if k not in self._names}, kind, place)
        analyses = {}
        for key in (key for key in given if key in self._names):
            inside = f"{place}.{key}" if place else key
            analysis = ANALYSES.load(key)
            if analysis.about == "scene":
                raise ConfigError(f"{inside} is an analysis of scenes; add tables [[{key}s]].")
            analyses[key] = _struct(given[key], analysis, inside)
        return msgspec.structs.replace(made, analyses=analyses)


def _entries(key: str, entries: Any) -> Iterator[tuple[Any, str]]:
    """Return the entries of a list of tables, each with a text such as ``maps[0]`` for messages."""
    if not isinstance(entries, list | tuple):
        raise ConfigError(f"{key} is {_shown(entries)}; give a list of tables, [[{key}]].")
    return ((entry, f"{key}[{i}]") for i, entry in enumerate(entries))


def _table(table: Any, place: str) -> dict[str, Any]:
    """Return a value of a study that must be a table."""
    if not isinstance(table, dict):
        raise ConfigError(f"{place} is {_shown(table)}; give a table.")
    return table


def _struct(table: Any, kind: type[Struct], place: str, beside: tuple[str, ...] = ()) -> Struct:
    """Convert a table to a struct; `beside` lists further keys that the table may have.

    Raises
    ------
    ConfigError
        If a key is unknown or missing, or a value has the wrong type or is out of range.
    """
    given, where = _table(table, place), f"{place}: " if place else ""
    known = _keys_of(kind)
    unknown = [key for key in given if key not in known]
    if unknown:
        tables = analysis_tables() if "analyses" in kind.__struct_fields__ else {}
        top = kind is StudyConfig
        allowed = [
            *beside,
            *known,
            *(key for key, each in tables.items() if top or each.about != "scene"),
        ]
        hint, close = close_match_hint(unknown[0], allowed)
        sentence = (
            f"{where}there is no key {shown(unknown[0])}; allowed here: {', '.join(allowed)}."
        )
        raise ConfigError(sentence + (hint if close else ""))
    clean = {}
    for name, option in known.items():
        if name in given:
            label = f"{place}.{name}" if place else name
            clean[name] = option.check(given[name], label, from_file=True)
        elif option.required:
            raise ConfigError(f"{where}the key {shown(name)} is missing.")
    try:
        return msgspec.convert(clean, kind)
    except msgspec.ValidationError as error:  # `Option.check` does not check all types
        raise ConfigError(f"{where}{error}.") from None


@functools.cache
def _keys_of(kind: type[msgspec.Struct]) -> dict[str, Option]:
    """Return the options of a table by key."""
    hidden = RESERVED if issubclass(kind, _StudyTable) else ()
    return {each.name: each for each in options_of(kind) if each.name not in hidden}


def _shown(value: Any) -> str:
    """Format a given value for messages."""
    return "a table" if isinstance(value, dict) else shown(value)


def _complaints(e: EstimatorConfig) -> Iterator[str]:
    """Yield errors in the keys of an estimator, as sentences without a subject."""
    several = e.densities is not None or e.integrands is not None
    if (e.integrand is None) == (e.integrands is None):
        yield "needs either integrand or integrands."
    if e.density is not None and e.densities is not None:
        yield "has density and densities; give one of them."
    if e.densities is None and e.heuristic is not None:
        yield "has a heuristic, which weights densities; give densities, or leave it out."
    if e.technique_counts is not None and (not several or e.one_sample):
        yield (
            "has technique_counts but one technique; give densities or integrands, or leave it out."
        )
    if e.integrands is not None and (e.density is not None or e.densities is not None):
        yield "has integrands, which carry their densities inside; leave density and densities out."
    if e.integrands is not None and e.smoothed is not None:
        yield "has integrands, which cannot be smoothed; leave smoothed out."
    if e.sets is not None and (not several or e.one_sample):
        yield "has sets, which belong to several techniques; leave it out."

    # Check options of one-sample estimators, which choose a technique at random for each sample
    if e.one_sample and e.densities is None:
        yield "has one_sample but no densities to choose from; give densities."
    if not e.one_sample and (e.probabilities is not None or e.selection is not None):
        yield "has probabilities or selection, which belong to one_sample = true."

    # Check densities of color channels
    if e.channels == "one" and e.density is None:
        yield 'has channels = "one", which needs density.'
    if e.channels not in (None, "one") and e.densities is None:
        yield f'has channels = "{e.channels}", which needs densities, one for each channel.'
    if e.channels is not None and e.one_sample:
        yield "has channels and one_sample; give one of them."
    given = (e.heuristic, e.technique_counts, e.sets)
    if e.channels in ("own", "shared") and any(value is not None for value in given):
        yield f'has channels = "{e.channels}", which takes no heuristic, technique_counts or sets.'


# Changes from the command line, such as ``estimators[0].dims=3``; values are TOML.


def apply_overrides(table: dict[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Return a study's table with changes applied in order.

    Parameters
    ----------
    table
        The study as read from TOML; it is not modified.
    overrides
        Texts ``path=value``. The path consists of keys between dots, with indices from 0.
        An example of a path is ``estimators[0].density``.
        The value is TOML. Missing tables are created.

    Raises
    ------
    ConfigError
        If a path cannot be read or leads nowhere, or a value is not TOML.
        Unknown keys are found later, when the study is checked.
    """
    given: Any = overrides
    if not isinstance(given, list | tuple) or not all(isinstance(text, str) for text in given):
        raise ConfigError(f"The changes are {shown(given)}; give a list of texts key=value.")
    changed = copy.deepcopy(table) if overrides else table
    for text in overrides:
        path, equals, value = text.partition("=")
        if not equals:
            raise ConfigError(f"--set {shown(text)} has no '='; write key=value.")

        # Split the path at the dots into keys with their indices
        if not _PLACE.fullmatch(path.strip()):
            raise ConfigError(
                f"--set {shown(text)}: {shown(path.strip())} is not a place in a study; write for "
                "example seed, samplers[0] or estimators[0].density."
            )
        parts = re.findall(r"\[(\d+)\]|([\w-]+)", path)
        steps = [key or int(index) for index, key in parts]

        # Read the value: exactly one TOML value
        try:
            found = tomllib.loads(f"value = {value}\n")
        except (ValueError, RecursionError):
            found = {}
        if list(found) != ["value"]:
            raise ConfigError(
                f"--set {shown(text)}: {shown(value.strip())} is not a TOML value; strings need "
                "quotes: key='\"text\"'."
            )

        # Follow the path through tables and lists, and store the value at its end
        place: Any = changed
        for i, step in enumerate(steps):
            lack = ""
            if isinstance(step, str) and not isinstance(place, dict):
                lack = f"there is no table that could hold {shown(step)}"
            elif isinstance(step, int) and not isinstance(place, list):
                lack = f"there is no list that could hold [{step}]; count from 0"
            elif isinstance(step, int) and step >= len(place):
                entries = "1 entry" if len(place) == 1 else f"{len(place)} entries"
                lack = f"there is no [{step}], the list has {entries}; count from 0"
            if lack:
                raise ConfigError(f"--set {shown(text)}: {lack}.")
            if i == len(steps) - 1:
                place[step] = found["value"]
            else:
                place = place.setdefault(step, {}) if isinstance(place, dict) else place[step]
    return changed


# Grids: every combination of the listed values replaces the ``{placeholders}`` of a study.


def expand_grids(table: dict[str, Any], source: str = "study") -> dict[str, Any]:
    """Return a study's table with all combinations of its grids written out.

    Estimators, maps and samplers are repeated for each combination of their placeholders.
    Estimators are also repeated for placeholders in the study's tables of analyses.
    A text that is only a placeholder becomes the value itself, so a list stays a list.

    Parameters
    ----------
    table
        The study as read from TOML.
        A table ``grid`` at the top applies to the whole study.
        A table ``grid`` in an estimator applies to that estimator and takes precedence.
        The table of an analysis at the top may have placeholders.
        A table with placeholders is copied into each estimator that has no table of the analysis.
    source
        Name of the study in messages.

    Raises
    ------
    ConfigError
        If a grid is not a table of lists, or its values are unused.
        If a placeholder has no values, or stands for a key that has only one value in a study.
        If there would be more than `MOST_ENTRIES` entries or too much text.
        Entries and text are counted before anything is generated.
    """
    try:
        if not isinstance(table, dict):
            raise ConfigError(f"a study is a table, not {shown(table)}.")
        return _expanded(table)
    except McspectraError as error:
        raise ConfigError(f"{source}: {error}") from None


def _expanded(table: Mapping[str, Any]) -> dict[str, Any]:
    """Expand the grids of a study."""
    shared = _grid_values(table.get("grid"), "grid")
    # Names of the used placeholders, and number of entries under each key
    all_used, counts = set[str](), Counter[str]()

    def repeated(
        given: Any, more: Mapping[str, Any], key: str, place: str
    ) -> Iterator[dict[str, Any]]:
        """Repeat an estimator or map for all values of its placeholders.

        Placeholders that occur only in a list of samplers do not repeat the whole entry.
        """
        if not isinstance(given, dict):
            yield given  # a value of a wrong type is reported later
            return
        entry = {**more, **given}
        own = _grid_values(entry.get("grid"), f"{place}.grid")
        values = {**shared, **own}
        listed = isinstance(entry.get("samplers"), list)
        samplers = entry["samplers"] if listed else []
        apart = ("grid", "samplers") if listed else ("grid",)
        body = {name: value for name, value in entry.items() if name not in apart}
        keys = _keys_in(body, values, place)
        used = {*keys, *_keys_in(samplers, values, place)}
        _check_used(own, used, f"{place}: ")
        all_used.update(used - own.keys())
        counts[key] += math.prod(len(values[name]) for name in keys)
        _check_size(counts[key], 0, key)
        mentioned = set(_placeholders(body.get("name")))
        for choice in _choices(keys, values, entry, place):
            made = _filled(body, choice)
            rest = [f"{k}={v}" for k, v in choice.items() if k not in mentioned]
            if rest and isinstance(made.get("name"), str):
                made["name"] += f" ({', '.join(rest)})"
            if listed:
                chosen = {**values, **{k: [value] for k, value in choice.items()}}
                made["samplers"] = _repeated(samplers, chosen, place)
            yield made

    names = _names()
    made = {key: value for key, value in table.items() if key != "grid"}
    lists = [key for key in ("estimators", *_scene_lists(made)) if isinstance(made.get(key), list)]
    takers = [key for key in lists if any(isinstance(entry, dict) for entry in made[key])]

    # If a table of an analysis contains placeholders,
    # copy the table into each estimator that has no table of this analysis.
    # Copy a placeholder for the whole list of samplers into all estimators and maps
    given: dict[str, Any] = {}
    if "estimators" in takers:
        tables = [key for key in made if key in names and isinstance(made[key], dict)]
        given = {key: made.pop(key) for key in tables if any(_placeholders(made[key]))}
    samplers, listed = made.get("samplers"), {}
    if takers and isinstance(samplers, str) and _PLACEHOLDER.fullmatch(samplers):
        listed = {"samplers": made.pop("samplers")}
    for key in _SINGLE:
        if any(_placeholders(made.get(key))):
            raise ConfigError(
                f"{key} is {shown(made[key])}, but a study has a single value; run one study per "
                f"value, for example with --set {key}=..."
            )
    for key in lists:
        more = {**given, **listed} if key == "estimators" else listed
        made[key] = [
            each
            for i, entry in enumerate(made[key])
            for each in repeated(entry, more, key, f"{key}[{i}]")
        ]
    if isinstance(made.get("samplers"), list):
        all_used.update(_keys_in(made["samplers"], shared, "samplers"))
        made["samplers"] = _repeated(made["samplers"], shared, "samplers")
    _check_used(shared, all_used, "")
    return made


def _repeated(samplers: list[Any], values: Values, place: str) -> list[Any]:
    """Repeat the spec of each sampler for all values of the placeholders in this spec."""
    if not any(_placeholders(samplers, values)):
        return samplers
    made: list[Any] = []
    for text in samplers:
        keys = _keys_in(text, values, place)
        made += [_filled(text, choice) for choice in _choices(keys, values, text, place)]
        _check_size(len(made), 0, place)
    return made


def _check_used(values: Values, used: Collection[str], place: str) -> None:
    for key in values:
        if key not in used:
            _, close = close_match_hint(key, used)
            offer = f" Did you mean {' or '.join(map(repr, close))}?" if close else ""
            raise ConfigError(
                f"{place}nothing uses grid.{key}; write {{{key}}} where its values go, or leave it "
                f"out.{offer}"
            )


def _choices(keys: list[str], values: Values, body: Any, place: str) -> Iterator[dict[str, Any]]:
    """Yield all combinations of values for `body`; raise an error if they are too many or long."""
    number = math.prod(len(values[key]) for key in keys)
    longest = sum(max(len(str(value)) for value in values[key]) for key in keys)
    size = len(repr(body)) + longest * (1 + len([*_placeholders(body, values)]))
    _check_size(number, number * size if keys else 0, place)
    return (
        dict(zip(keys, chosen, strict=True))
        for chosen in itertools.product(*(values[key] for key in keys))
    )


def _check_size(number: int, size: int, place: str) -> None:
    if number > MOST_ENTRIES or size > _MOST_TEXT:
        long = f" with {size:.2g} characters" if size > _MOST_TEXT else ""
        raise ConfigError(
            f"{place}: the grid makes {number:,} entries{long}, but at most {MOST_ENTRIES:,} "
            f"entries and {_MOST_TEXT:.0e} characters are allowed; use fewer values, or several "
            "studies."
        )


def _keys_in(value: Any, values: Values, place: str) -> list[str]:
    """Return the placeholders in a value, in the order in which the grid lists them."""
    found = set(_placeholders(value, values))
    for key in sorted(found - set(values)):
        if values:
            offer, _ = close_match_hint(key, values)
            raise ConfigError(f"{place}: there is no grid.{key} for {{{key}}}.{offer}")
        raise ConfigError(f"{place}: {{{key}}} needs a grid: grid = {{ {key} = [...] }}.")
    return [key for key in values if key in found]


def _placeholders(value: Any, values: Collection[str] = ()) -> Iterator[str]:
    """Yield names in braces, except fields such as {n}, which programs and point files use."""
    if isinstance(value, str):
        own = _OWN if _HAS_OWN.search(value) else ()
        yield from (key for key in _PLACEHOLDER.findall(value) if key in values or key not in own)
    elif isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _placeholders(item, values)


def _filled(value: Any, choice: Mapping[str, Any]) -> Any:
    """Replace the placeholders in a value."""
    if isinstance(value, str) and "{" in value:
        whole = _PLACEHOLDER.fullmatch(value)
        if whole is not None and whole[1] in choice:
            return choice[whole[1]]
        return _PLACEHOLDER.sub(lambda match: str(choice.get(match[1], match[0])), value)
    if isinstance(value, dict):
        return {key: _filled(item, choice) for key, item in value.items()}
    if isinstance(value, list):
        return [_filled(item, choice) for item in value]
    return value


def _grid_values(grid: Any, place: str) -> dict[str, list[Any]]:
    """Check a table ``grid`` and return its values."""
    if grid is None:
        return {}
    if not isinstance(grid, dict):
        raise ConfigError(
            f"{place} is {shown(grid)}; give a table of lists, {{ width = [0.1, 0.2] }}."
        )
    for key, values in grid.items():
        if not _KEY.fullmatch(key):
            raise ConfigError(f"{place}: {shown(key)} is not a name of letters, digits and '_'.")
        if not isinstance(values, list) or not values:
            raise ConfigError(
                f"{place}.{key} is {shown(values)}; give a list of one or more values."
            )
        for value in values:
            _check_grid_value(value, f"{place}.{key}")
    return grid


def _check_grid_value(value: Any, place: str) -> None:
    if isinstance(value, list):
        for item in value:
            _check_grid_value(item, place)
    elif not isinstance(value, str | int | float | bool):
        raise ConfigError(f"{place} holds {shown(value)}; give numbers, strings, or lists of them.")
    elif isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{place} holds {shown(value)}; give finite numbers.")
