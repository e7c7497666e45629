"""Analyses: each question about an estimator with a sampler is declared once, as a struct.

An `Analysis` is a frozen struct whose fields are its options.
`Analysis.need` returns the cost of a run, and `Analysis.reduction` returns the computation itself.
Python functions, study files, commands, the explorer and the docs are derived from the struct.
A result is checked against the variables that the struct declares.
`ANALYSES` finds analyses by name.
Other packages add analyses by the entry points ``mcspectra.analyses``.

All analyses are computed in the same way. A `Reduction` divides realizations into blocks.
The number and the limits of the blocks depend only on the size of the problem.
The result of each block is called its *state*. States are merged in a fixed binary tree.
A *chunk* is an aligned run of 2^k blocks, which is a node of this tree (`MergeTree`).
The tree is the same if one thread computes all blocks, or if many machines compute chunks.
Therefore results have the same bits for any number of threads and machines.

In some analyses, later draws depend on earlier results, for example to stop at a precision.
In this case, the method `Analysis.reduction` is a generator.
In each step, the generator yields a list of reductions, which are sums over blocks.
For each `Reduction`, the generator receives one state: the merged state of all blocks.
At its end, the generator returns the dataset.
"""

from __future__ import annotations

import numbers
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Generic,
    Literal,
    Self,
    TypeAlias,
    TypeVar,
    final,
)

import msgspec

from mcspectra.core.display import shown
from mcspectra.core.errors import AnalysisError, Function, ParameterError
from mcspectra.core.memory import check_memory
from mcspectra.core.options import Evaluations, checked, options_of
from mcspectra.core.parallel import available_workers, map_in_order
from mcspectra.core.progress import report
from mcspectra.core.records import merged
from mcspectra.core.registry import Registry, classes_of
from mcspectra.core.results import Variable, attributes_of, check_variables
from mcspectra.core.streams import RngLike, Stream
from mcspectra.core.tally import EvaluationTally, counting

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "ANALYSES",
    "Analysis",
    "Chunk",
    "Counted",
    "MergeTree",
    "Need",
    "Reduction",
    "Steps",
    "Subject",
    "check_names",
    "chunks",
    "compute",
    "compute_chunk",
    "driven",
    "finished",
    "in_step",
    "needed",
    "steps_of",
    "whole",
]

# Option names that analyses cannot use, because commands, functions or study files use them
_TAKEN = frozenset(
    {
        "debug",
        "help",
        "json",
        "name",
        "out",
        "quiet",
        "rng",
        "sampler",
        "samplers",
        "seed",
        "show",
        "workers",
    }
)
_TAKEN_BY_SUBJECTS = frozenset(  # option names that are reserved, except for analyses of scenes
    {"density", "dims", "estimator", "heuristic", "integrand", "mirror", "plus", "shares"}
)

State = TypeVar("State")
Result = TypeVar("Result")

Chunk: TypeAlias = tuple[int, int]
"""First block of a chunk, and number of blocks in the chunk.

The number of blocks is 2^k, and the index of the first block is a multiple of 2^k.
Only the last chunk of a computation may have fewer blocks.
"""


@final
@dataclass(frozen=True, slots=True)
class Subject:
    """The estimator, sampler and density that are analyzed.

    Attributes
    ----------
    estimator
        The estimator, or a list if the analysis takes several estimators.
        None if the analysis is about point sets or about a scene.
    sampler
        The sampler, or a list if the analysis takes several samplers.
    density
        Importance density of the points, for analyses of point sets.
        The default is the density of the estimator, if it has only one.
    """

    estimator: Any
    sampler: Any
    density: Any = None

    @property
    def estimators(self) -> list[Any]:
        """The estimators, as a list of at least one."""
        return _listed(self.estimator)

    @property
    def samplers(self) -> list[Any]:
        """The samplers, as a list of at least one."""
        return _listed(self.sampler)


@final
@dataclass(frozen=True, kw_only=True, slots=True)
class Need:
    """Resources that an analysis needs: work, memory and evaluations.

    Attributes
    ----------
    cost
        Work in arbitrary units that are about proportional to time, such as evaluations.
    memory
        Maximum number of bytes of memory, not counting the program itself.
    evaluations
        Minimum number of evaluations of the integrand.
    """

    cost: float = 1.0
    memory: int = 0
    evaluations: int = 0


class Analysis(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A question about an estimator with a sampler. Subclasses are final, and fields are options.

    The first line of the docstring of a subclass is used as its summary everywhere.

    Attributes
    ----------
    function
        Name of the analysis' public function in `mcspectra`, or empty if it has no function.
        The name is dotted if the function is in a package.
    verb
        Command of the analysis on the command line, or empty if it has no command.
    split
        Value of ``--split`` that selects this analysis, if several analyses share one command.
    about
        Subject: an estimator with a sampler, a sampler with an optional density, or a scene.
    several
        What a user may give as a list of several: ``"estimator"``, ``"sampler"``, or both.
    variables
        Names of the result's variables in `mcspectra.core.results.VARIABLES`.
        A variable that is not in `VARIABLES` is given as a `Variable`.
    provenance
        Names of attributes of the result: ``estimator`` and ``sampler`` hold their spec strings.
        The attribute ``stream_key`` holds the key of the random stream.
        An option's value is in the attribute that has the name of the option.
    companions
        Names of other analyses that a study computes in addition to this analysis.
        For example, a study that computes spectra also computes the points.
    pictured
        Whether the first screen of a report shows the analysis.
        A study computes the analyses on the first screen of its report before all others.
        An interrupted study therefore already has a report.
    """

    function: ClassVar[str] = ""
    verb: ClassVar[str] = ""
    split: ClassVar[str] = ""
    about: ClassVar[Literal["estimator", "sampler", "scene"]] = "estimator"
    several: ClassVar[tuple[Literal["estimator", "sampler"], ...]] = ()
    variables: ClassVar[tuple[str | Variable, ...]] = ()
    provenance: ClassVar[tuple[str, ...]] = ()
    companions: ClassVar[tuple[str, ...]] = ()
    pictured: ClassVar[bool] = False

    def need(self, subject: Subject) -> Need:  # noqa: ARG002
        """Return the cost and memory that the analysis needs for an estimator, sampler or scene.

        The options were already checked (see `mcspectra.core.options.checked`).
        This method rejects options that do not fit the subject.
        For example, there may be too many dims, or the sampler cannot make this number of points.

        Raises
        ------
        McspectraError
            If the subject and the options do not fit. The message is one sentence.
        """
        return Need()

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[Any] | Steps:  # noqa: ARG002
        """Return the computation: a `Reduction`, or a generator that yields reductions in steps.

        Parameters
        ----------
        subject
            A subject (estimator, sampler or scene) that `need` accepted.
        stream
            Source of the random numbers of all realizations.
        """
        raise AnalysisError(
            f"{type(self).__name__} has no reduction; define this method, which returns the "
            "computation."
        )

    def trial(
        self,
        subject: Subject,  # noqa: ARG002
        stream: Stream,  # noqa: ARG002
        seconds: float,  # noqa: ARG002
    ) -> tuple[float, int] | None:
        """Return the estimated seconds and stored bytes, from short runs of about `seconds`.

        By default, this method returns None, and runs with few realizations estimate the time.
        Analyses whose time depends on other sizes, such as pixels, override this method.
        """
        return None

    def part(self, subject: Subject, stream: Stream, key: str) -> Reduction[Any]:
        """Return the reduction, a sum over blocks of realizations, that has the name `key`.

        Workers call this method without running the earlier steps of the analysis.
        By default, `key` must be the name of a reduction that needs no earlier results.
        Analyses override this method if later steps depend on the merged states of earlier steps.

        Raises
        ------
        NotImplementedError
            If no reduction in the first step of the analysis has the name `key`.
        """
        found = self.reduction(subject, stream)
        for each in [found] if isinstance(found, Reduction) else next(found):
            if each.key == key:
                return each
        raise NotImplementedError(
            f"The first step of {type(self).__name__} has no reduction with the key {shown(key)}: "
            "an analysis of several steps must override part."
        )

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> Self:
        """Make an analysis from the arguments of its public function, which are its ``locals()``.

        The arguments have the names of the options.
        """
        return cls(**{name: arguments[name] for name in cls.__struct_fields__})

    @classmethod
    def command(cls) -> str:
        """Return the arguments of ``mcspectra`` that run the analysis. Empty without a command."""
        return f"{cls.verb} --split {cls.split}" if cls.split else cls.verb

    @classmethod
    def summary(cls) -> str:
        """Return the first line of the docstring."""
        return (cls.__doc__ or "").strip().partition("\n")[0]


class Counted(Analysis, frozen=True, kw_only=True):
    """An analysis that evaluates an integrand and counts the evaluations of a user's function.

    For a Python function, this number is the attribute ``evaluations`` of the result.
    """

    max_evaluations: Evaluations = None

    def limit(self, subject: Subject) -> int | None:  # noqa: ARG002
        """Return the maximum number of evaluations: the option `max_evaluations`."""
        return self.max_evaluations


ANALYSES = Registry(
    "analysis",
    "mcspectra.analyses",
    classes_of(
        {
            "rendering.maps": "Map",
            "spectra.pairs": "pcf=PairCorrelation",
            "spectra.power": "Points Spectrum",
            "measure.anova": "Anova AnovaSpectrum",
            "measure.converge": "Convergence",
            "measure.modes": "Modes",
            "improve.planning": "Plan",
            "prediction.prediction": "predict=Prediction",
            "profiler.profiling": "profile=Profiling",
            "improve.remedy": "Remedies",
            "measure.techniques": "Techniques",
            "measure.terms": "Terms",
        }
    ),
    base=Analysis,
)
"""Analyses, by the names of their tables in study files."""


def check_names(kind: type[Analysis]) -> None:
    """Raise an error if an option has the same name as an argument of the command or the function.

    Raises
    ------
    AnalysisError
        If the name or the flag of an option is already used.
    """
    scene = kind.about == "scene"
    names = _TAKEN if scene else _TAKEN | _TAKEN_BY_SUBJECTS
    flags = {"-h", "-o"} if scene else {"-h", "-o", "-d"}
    for option in options_of(kind):
        own = {option.flag, option.extra.get("flag", option.flag)}
        if option.is_flag:
            own.add(f"--no-{option.flag[2:]}")
        taken = option.name in names or hasattr(Analysis, option.name)
        if taken or not own.isdisjoint(flags):
            what = f"the flag {min(own & flags)}" if own & flags else "that name"
            raise AnalysisError(
                f"{kind.__name__} has the option {shown(option.name)}, but {what} is taken by all "
                "analyses or by another of its options; rename it."
            )
        flags |= own


@final
@dataclass(frozen=True, kw_only=True)
class Reduction(Generic[State]):
    """A computation as a sum over blocks of realizations.

    Attributes
    ----------
    kind
        Type of the state of a block: a record or a list of records (`mcspectra.core.records`).
        The state may also be an array, a dict of arrays, or a dataset.
    block
        Function that maps the index of a block to its state.
    blocks
        Number of blocks. A block is the smallest unit of work.
    cost
        Work for all blocks together, in any unit that is the same for all reductions of a step.
        Reductions with more work start earlier. Progress is the finished fraction of the work.
    key
        Name that is unique within the analysis. It identifies stored states.
    result
        Function that makes the dataset from the merged state. None if a generator does this.
    """

    kind: Any
    block: Callable[[int], State]
    blocks: int = 1
    cost: float = 1.0
    key: str = "0"
    result: Callable[[State], xr.Dataset] | None = None


Steps: TypeAlias = "Generator[list[Reduction[Any]], list[Any], xr.Dataset]"
"""Type of the generator that computes an analysis step by step.

In each step, the generator yields reductions (sums over blocks), and receives merged states.
At its end, the generator returns the dataset.
"""


def whole(function: Callable[[], xr.Dataset]) -> Reduction[xr.Dataset]:
    """Wrap a computation that cannot be divided into blocks. Its state is its dataset."""
    import xarray as xr

    return Reduction(kind=xr.Dataset, block=lambda _: function(), result=lambda state: state)


def needed(analysis: Analysis, subject: Subject) -> Need:
    """Return the resources that an analysis of a subject needs.

    Raises
    ------
    AnalysisError
        If the method `need` of the analysis does not return a `Need`.
    ParameterError
        If a list is given where the analysis takes one object, or a sampler is listed twice.
    McspectraError
        If the method `need` of the analysis raises a `McspectraError`.
    """
    _check_lists(analysis, subject)
    need: Any = analysis.need(subject)
    if not isinstance(need, Need):
        raise AnalysisError(
            f"{type(analysis).__name__} needs {shown(need)}; its need must return a Need."
        )
    most = _most(analysis, subject)
    if most is not None and need.evaluations > most:
        EvaluationTally(_said(analysis), most, refused=need.evaluations).check()
    return need


def _check_lists(analysis: Analysis, subject: Subject) -> None:
    """Check that lists are given only where the analysis takes lists, and that samplers differ."""
    for what in ("estimator", "sampler"):
        if isinstance(getattr(subject, what), list | tuple) and what not in analysis.several:
            raise ParameterError(
                _said(analysis),
                f" takes one {what} at a time; call it once for each item of the list.",
            )
    listed = subject.sampler if isinstance(subject.sampler, list | tuple) else ()
    names = [getattr(each, "spec", None) for each in listed]
    for name in names:
        if names.count(name) > 1:
            raise ParameterError(f"The sampler {name} is listed twice; list each once.")


def _listed(given: Any) -> list[Any]:
    return list(given) if isinstance(given, list | tuple) else [given]


def _most(analysis: Analysis, subject: Subject) -> int | None:
    return analysis.limit(subject) if isinstance(analysis, Counted) else None


def _said(analysis: Analysis) -> str | Function:
    """Return the name of the analysis for messages: its public function, or its class."""
    return Function(analysis.function) if analysis.function else type(analysis).__name__


def steps_of(analysis: Analysis, subject: Subject, stream: Stream) -> Steps:
    """Return the generator that computes an analysis. A single `Reduction` becomes the only step.

    Raises
    ------
    AnalysisError
        If the analysis has no computation or no result, or if a step has the wrong type.
        If two reductions of the analysis have the same name, or if a reduction has no blocks.
    """
    name = type(analysis).__name__
    found: Any = analysis.reduction(subject, stream)
    if isinstance(found, Reduction):
        found = _single(found, name)
    if not isinstance(found, Generator):
        raise AnalysisError(
            f"{name} is computed by {shown(found)}; its reduction must return a Reduction, or be a "
            "generator that yields lists of them."
        )
    states: list[Any] | None = None
    keys: set[str] = set()
    while True:
        try:
            step = found.send(states)
        except StopIteration as end:
            result: xr.Dataset = end.value
            break
        if not isinstance(step, list) or not all(isinstance(each, Reduction) for each in step):
            raise AnalysisError(f"{name} has the step {shown(step)}; give a list of Reductions.")
        for each in step:
            if each.key in keys:
                raise AnalysisError(
                    f"{name} has two reductions of the key {shown(each.key)}; give each a key of "
                    "its own."
                )
            if not isinstance(each.blocks, numbers.Integral) or each.blocks < 1:
                raise AnalysisError(
                    f"{name} has a reduction of {shown(each.blocks)} blocks; give a whole number "
                    "from 1."
                )
            keys.add(each.key)
        states = yield step

    if not hasattr(result, "data_vars"):
        raise AnalysisError(f"{name} gives {shown(result)} as its result; it must be a dataset.")
    if not analysis.provenance:
        return result
    # Record the spec strings of the components, and the options
    components = {"estimator": subject.estimator, "sampler": subject.sampler}
    known = {name: getattr(each, "spec", None) for name, each in components.items()}
    known |= {"stream_key": f"{stream.key:#x}", **msgspec.structs.asdict(analysis)}
    return result.assign_attrs(attributes_of(**{name: known[name] for name in analysis.provenance}))


def _single(reduction: Reduction[State], name: str) -> Steps:
    if reduction.result is None:
        raise AnalysisError(
            f"{name} has a Reduction without result; set the function that makes its dataset."
        )
    (state,) = yield [reduction]
    return reduction.result(state)


def finished(analysis: Analysis, result: xr.Dataset, rng: RngLike = None) -> xr.Dataset:
    """Check a result against the variables that its analysis declares. Return it with its seed.

    If `rng` is an integer, the attribute ``seed`` records it, to make the result reproducible.
    Integers of at least 2^63 are recorded as text.

    Raises
    ------
    AnalysisError
        If a variable is not declared, or has other dims or another type.
    """
    check_variables(result, type(analysis).variables, type(analysis).__name__)
    if isinstance(rng, int | numbers.Integral):  # NumPy's integers also count as seeds
        return result.assign_attrs(attributes_of(seed=rng))
    return result


def compute(
    analysis: Analysis, subject: Subject, rng: RngLike = 0, workers: int | None = None
) -> xr.Dataset:
    """Compute an analysis with `workers` threads. The public Python functions call this function.

    The result does not depend on the number of threads.
    Progress is reported under the name of the public function.

    Raises
    ------
    ParameterError
        If an option is out of range, or an argument has the wrong type.
    ConfigError
        If the analysis needs more memory than there is.
    McspectraError
        If `needed` or `steps_of`, which this function calls, raises an error.
    """
    given: tuple[Any, Any] = analysis, subject
    if not isinstance(given[0], Analysis) or not isinstance(given[1], Subject):
        raise ParameterError(f"{shown(given)} are not an Analysis and a Subject; give these.")
    threads = available_workers(workers)
    clean = checked(analysis)
    name = clean.function or type(clean).__name__
    _check_lists(clean, subject)
    with counting(_said(clean), _most(clean, subject)) as tally:
        check_memory(needed(clean, subject).memory, _said(clean))

        def states_of(step: list[Reduction[Any]]) -> Iterator[Any]:
            # Merge the states of all blocks. Report which fraction of the step's work is finished
            total, before = max(sum(each.cost for each in step), 1e-300), 0.0
            for each in step:
                tree: MergeTree[Any] = MergeTree()
                for done, state in enumerate(
                    map_in_order(each.block, range(each.blocks), threads), 1
                ):
                    tree.add(state)
                    share = (before + done / each.blocks * each.cost) / total
                    report(name, 1.0 if share > 1.0 - 1e-9 else share)
                yield tree.total()
                before += each.cost

        result = driven(steps_of(clean, subject, Stream.from_rng(rng)), states_of)
        tally.check()
        result = finished(clean, result, rng)
    return result.assign_attrs(evaluations=tally.made) if tally.made else result


def driven(steps: Steps, states_of: Callable[[list[Reduction[Any]]], Iterable[Any]]) -> xr.Dataset:
    """Compute an analysis step by step; `states_of` returns the merged states of a step."""
    states: list[Any] | None = None
    try:
        while True:
            states = list(states_of(steps.send(states)))  # type: ignore[arg-type]
    except StopIteration as end:
        result: xr.Dataset = end.value
        return result


def compute_chunk(reduction: Reduction[State], chunk: Chunk) -> State:
    """Compute the merged state of a chunk of consecutive blocks, in the calling thread."""
    tree: MergeTree[State] = MergeTree()
    first, count = chunk
    for index in range(first, first + count):
        tree.add(reduction.block(index))
    return tree.total()


class MergeTree(Generic[State]):
    """Merges states of blocks, like a binary counter: neighboring nodes of equal size merge first.

    A node is a run of consecutive blocks whose states have been merged.
    The nodes that remain after the last block have different sizes, and `total` merges them.
    The method `total` begins with the last blocks and ends with the first blocks.
    The tree depends only on the number of blocks, not on the chunks or their order.
    If blocks arrive in order, the tree holds only log₂(blocks) states at the same time.

    Attributes
    ----------
    nodes
        For each node of the tree, its number of blocks and the merged state of these blocks.
        The keys of this dict are the indices of the first blocks of the nodes.
    """

    def __init__(self) -> None:
        self.nodes: dict[int, tuple[int, State]] = {}
        self._next = 0

    def add(self, state: State, blocks: int = 1) -> None:
        """Add the merged state of the next `blocks` blocks, whose number is a power of two."""
        self.put((self._next, blocks), state)
        self._next += blocks

    def put(self, chunk: Chunk, state: State) -> int:
        """Add the merged state of consecutive blocks, and merge it with neighboring states.

        Two neighboring nodes of the tree are merged as long as they have equal numbers of blocks.
        The method returns the first block of the node that contains the added blocks.
        """
        first, count = chunk
        while count & (count - 1) == 0 and self.nodes.get(first ^ count, (0,))[0] == count:
            _, other = self.nodes.pop(first ^ count)
            left, right = (state, other) if first & count == 0 else (other, state)
            state = merged(left, right)
            first, count = first & ~count, 2 * count
        self.nodes[first] = count, state
        return first

    def total(self) -> State:
        """Return the state of all blocks together. There must be at least one block."""
        parts = [self.nodes[first][1] for first in sorted(self.nodes)]
        self.nodes.clear()
        total = parts.pop()
        while parts:
            total = merged(parts.pop(), total)
        return total


def chunks(blocks: int, size: int) -> Iterator[Chunk]:
    """Divide blocks into chunks of `size` blocks, a power of two. The last chunk may be shorter."""
    return ((first, min(size, blocks - first)) for first in range(0, blocks, size))


def in_step(
    parts: Sequence[Generator[Reduction[Any], State, Result]],
) -> Generator[list[Reduction[Any]], list[State], list[Result]]:
    """Run several generators together: each step computes the next reduction of every generator.

    The result is a list with the result of each generator, in the same order.
    """
    results: dict[int, Result] = {}
    states: Mapping[int, Any] = dict.fromkeys(range(len(parts)))
    while states:
        found: dict[int, Reduction[Any]] = {}
        for place, state in states.items():
            try:
                found[place] = parts[place].send(state)
            except StopIteration as end:
                results[place] = end.value
        states = dict(zip(found, (yield list(found.values())), strict=True)) if found else {}
    return [results[place] for place in range(len(parts))]
