"""The analysis: one question about an estimator with a sampler, declared once.

An `Analysis` is a frozen struct whose fields are its options. It says what it needs (`need`) and how
it is computed (`reduction`); Python's functions, study files, verbs, the explorer, the registered
variables of results and the docs derive from it. `ANALYSES` finds analyses by name, those of other
packages too (entry points ``mcspectra.analyses``).

Computing is one contract. A `Reduction` cuts realizations into atomic blocks, whose number and limits
depend on the size of the problem alone; each block gives a state, and states merge in a fixed binary
tree over the blocks (`MergeTree`). The result is therefore the same bits whether one thread computes
all blocks or many machines compute *chunks* of them: a chunk is an aligned run of 2^k blocks, which is
a node of that tree. An analysis that decides later what to draw (stopping at a precision) is a
generator: it yields lists of reductions, is sent their merged states, and returns its dataset.
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

# Names that options of analyses cannot have: verbs, public functions and study files have them
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
_TAKEN_BY_SUBJECTS = frozenset(  # but not by scenes
    {"density", "dims", "estimator", "heuristic", "integrand", "mirror", "plus", "shares"}
)

State = TypeVar("State")
Result = TypeVar("Result")

Chunk: TypeAlias = tuple[int, int]
"""First atomic block and number of blocks: a power of two that divides the first, or the last ones."""


@final
@dataclass(frozen=True, slots=True)
class Subject:
    """What is analyzed.

    Attributes
    ----------
    estimator
        An estimator; None where an analysis is about point sets or a scene alone. A list where the
        analysis takes `several`.
    sampler
        A sampler; a list where the analysis takes `several`.
    density
        Importance density of the points, for analyses of point sets; by default the estimator's,
        if it has a single one.
    """

    estimator: Any
    sampler: Any
    density: Any = None

    @property
    def estimators(self) -> list[Any]:
        """The estimators, one or more."""
        return _listed(self.estimator)

    @property
    def samplers(self) -> list[Any]:
        """The samplers, one or more."""
        return _listed(self.sampler)


@final
@dataclass(frozen=True, kw_only=True, slots=True)
class Need:
    """What an analysis takes.

    Attributes
    ----------
    cost
        Work in arbitrary units, about proportional to time: evaluations of the integrand.
    memory
        Bytes beyond those of the program itself, at most.
    evaluations
        Evaluations of the integrand that are sure to be made.
    """

    cost: float = 1.0
    memory: int = 0
    evaluations: int = 0


class Analysis(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A question about an estimator with a sampler; subclasses are final, their fields are options.

    The first line of a subclass's docstring is its summary everywhere.

    Attributes
    ----------
    function
        Its public function in Python, as a name of `mcspectra`, dotted if the function is in a package;
        empty without a public function.
    verb
        Its verb on the command line; empty if it has none.
    split
        What ``--split`` chooses it by, where several analyses share the verb.
    about
        What it takes: an estimator with a sampler, a sampler with a density at most, or a scene.
    several
        What it takes lists of, too: ``"estimator"``, ``"sampler"``, or both.
    variables
        Names of its variables in `mcspectra.core.results.VARIABLES`, and `Variable`s of its own.
    provenance
        Attributes that its result is given: ``estimator`` and ``sampler`` by their spec strings,
        ``stream_key``, and options by their names.
    companions
        Analyses that a study computes beside it with the same table, such as points of a spectrum.
    """

    function: ClassVar[str] = ""
    verb: ClassVar[str] = ""
    split: ClassVar[str] = ""
    about: ClassVar[Literal["estimator", "sampler", "scene"]] = "estimator"
    several: ClassVar[tuple[Literal["estimator", "sampler"], ...]] = ()
    variables: ClassVar[tuple[str | Variable, ...]] = ()
    provenance: ClassVar[tuple[str, ...]] = ()
    companions: ClassVar[tuple[str, ...]] = ()

    def need(self, subject: Subject) -> Need:  # noqa: ARG002
        """Return the cost and memory of the analysis of a subject, after refusing what cannot be.

        Options are clean (`mcspectra.core.options.checked`); here they are held against the
        subject: counts that the sampler cannot do, dims that are too many.

        Raises
        ------
        McspectraError
            One sentence.
        """
        return Need()

    def reduction(self, subject: Subject, stream: Stream) -> Reduction[Any] | Steps:  # noqa: ARG002
        """Return how it is computed, or a generator that yields reductions step by step.

        Parameters
        ----------
        subject
            One that `need` has accepted.
        stream
            Random numbers of all realizations.
        """
        raise AnalysisError(
            f"{type(self).__name__} has no reduction; define it, which says how it is computed."
        )

    def part(self, subject: Subject, stream: Stream, key: str) -> Reduction[Any]:
        """Return the reduction of a key, for a worker that has not seen the steps before it.

        By default one of the first step; analyses whose later steps depend on states override it.

        Raises
        ------
        NotImplementedError
            The key is not one of the first step.
        """
        found = self.reduction(subject, stream)
        for each in [found] if isinstance(found, Reduction) else next(found):
            if each.key == key:
                return each
        raise NotImplementedError(
            f"The first step of {type(self).__name__} has no reduction of the key {shown(key)}: an analysis "
            "of several steps overrides part."
        )

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> Self:
        """Make one of the arguments of its public function, ``locals()``, named as its options."""
        return cls(**{name: arguments[name] for name in cls.__struct_fields__})

    @classmethod
    def command(cls) -> str:
        """Return the arguments of ``mcspectra`` that run it; empty without a verb."""
        return f"{cls.verb} --split {cls.split}" if cls.split else cls.verb

    @classmethod
    def summary(cls) -> str:
        """Return the first line of the docstring."""
        return (cls.__doc__ or "").strip().partition("\n")[0]


class Counted(Analysis, frozen=True, kw_only=True):
    """An analysis that evaluates an integrand, at most so often; with users' functions it says how often.

    The attribute ``evaluations`` of the result is their number, where Python's function was called.
    """

    max_evaluations: Evaluations = None

    def limit(self, subject: Subject) -> int | None:  # noqa: ARG002
        """Most evaluations of a subject's functions; by default those that were asked for."""
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
"""Analyses by the names of their tables in study files."""


def check_names(kind: type[Analysis]) -> None:
    """Refuse an analysis whose options cannot be told from what its verb or its function takes.

    Raises
    ------
    AnalysisError
        An option has a name, or a flag, that is taken.
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
    """A sum over blocks of realizations.

    Attributes
    ----------
    kind
        Type of the states: a record (`mcspectra.core.records`), a list of records, an array, a
        dict of arrays, or a dataset.
    block
        State of one atomic block, by its number.
    blocks
        Number of atomic blocks.
    cost
        Work of all blocks in the units of `Need.cost`.
    key
        A name, unique within the analysis: stored states are found by it.
    result
        Makes the dataset of the state of all blocks; None for those of a generator.
    """

    kind: Any
    block: Callable[[int], State]
    blocks: int = 1
    cost: float = 1.0
    key: str = "0"
    result: Callable[[State], xr.Dataset] | None = None


Steps: TypeAlias = "Generator[list[Reduction[Any]], list[Any], xr.Dataset]"
"""Yields the reductions of a step, is sent their merged states in that order, returns the result."""


def whole(function: Callable[[], xr.Dataset], cost: float = 1.0) -> Reduction[xr.Dataset]:
    """Return what cannot be cut as a reduction of one block, whose state is the dataset itself."""
    import xarray as xr

    return Reduction(
        kind=xr.Dataset, block=lambda _: function(), cost=cost, result=lambda state: state
    )


def needed(analysis: Analysis, subject: Subject) -> Need:
    """Return what an analysis says that it needs.

    Raises
    ------
    AnalysisError
        That is no `Need`.
    ParameterError
        A list of what the analysis takes one of, or one sampler twice.
    McspectraError
        As of its `need`.
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
    """Check that only parts that may be lists are lists, and that samplers differ."""
    for what in ("estimator", "sampler"):
        if isinstance(getattr(subject, what), list | tuple) and what not in analysis.several:
            raise ParameterError(
                _said(analysis), f" takes one {what} at a time; ask it for each of the list."
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
    """The analysis in a sentence: its public function, or its class."""
    return Function(analysis.function) if analysis.function else type(analysis).__name__


def steps_of(analysis: Analysis, subject: Subject, stream: Stream) -> Steps:
    """Return the steps of an analysis, one where it is a single reduction.

    Raises
    ------
    AnalysisError
        It has no reduction or result, or a step has something else, or two have one key, or one has
        no blocks.
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
                    f"{name} has two reductions of the key {shown(each.key)}; give each a key of its own."
                )
            if not isinstance(each.blocks, numbers.Integral) or each.blocks < 1:
                raise AnalysisError(
                    f"{name} has a reduction of {shown(each.blocks)} blocks; give a whole number from 1."
                )
            keys.add(each.key)
        states = yield step

    if not hasattr(result, "data_vars"):
        raise AnalysisError(f"{name} gives {shown(result)} as its result; it must be a dataset.")
    if not analysis.provenance:
        return result
    # Say what it is of
    components = {"estimator": subject.estimator, "sampler": subject.sampler}
    known = {name: getattr(each, "spec", None) for name, each in components.items()}
    known |= {"stream_key": f"{stream.key:#x}", **msgspec.structs.asdict(analysis)}
    return result.assign_attrs(attributes_of(**{name: known[name] for name in analysis.provenance}))


def _single(reduction: Reduction[State], name: str) -> Steps:
    if reduction.result is None:
        raise AnalysisError(f"{name} has a Reduction without result; say how its dataset is made.")
    (state,) = yield [reduction]
    return reduction.result(state)


def finished(analysis: Analysis, result: xr.Dataset, rng: RngLike = None) -> xr.Dataset:
    """Check a result against the variables that its analysis declares; return it with its seed.

    The seed is an attribute where `rng` is a whole number, by which the result can be had again: a
    text from 2^63 on.

    Raises
    ------
    AnalysisError
        A variable is not declared, or has other dims or another kind.
    """
    check_variables(result, type(analysis).variables, type(analysis).__name__)
    if isinstance(rng, int | numbers.Integral):  # of NumPy, too
        return result.assign_attrs(attributes_of(seed=rng))
    return result


def compute(
    analysis: Analysis, subject: Subject, rng: RngLike = 0, workers: int | None = None
) -> xr.Dataset:
    """Compute an analysis with `workers` threads: the body of Python's public functions.

    The result does not depend on the number of threads. Progress is reported under the name of the
    public function.

    Raises
    ------
    ParameterError
        An option is out of range, or this is no analysis of a subject.
    ConfigError
        It needs more memory than there is.
    McspectraError
        As of `needed` and `steps_of`.
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
            # Merge the states of all blocks; tell how much of the step's cost is done
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
    """Result of steps, each of which is sent the merged states that `states_of` gives of it."""
    states: list[Any] | None = None
    try:
        while True:
            states = list(states_of(steps.send(states)))  # type: ignore[arg-type]
    except StopIteration as end:
        result: xr.Dataset = end.value
        return result


def compute_chunk(reduction: Reduction[State], chunk: Chunk) -> State:
    """State of a chunk of a reduction, computed in this thread."""
    tree: MergeTree[State] = MergeTree()
    first, count = chunk
    for index in range(first, first + count):
        tree.add(reduction.block(index))
    return tree.total()


class MergeTree(Generic[State]):
    """Merges states of blocks as a binary counter does: neighbors of equal size first.

    What remains at the end merges from the right. The tree depends on the number of blocks alone,
    not on the chunks they came in, nor on the order of these; of chunks in their order only log₂ of the
    number of blocks are held at once.

    Attributes
    ----------
    nodes
        Number of blocks and state of what is merged so far, by the first block.
    """

    def __init__(self) -> None:
        self.nodes: dict[int, tuple[int, State]] = {}
        self._next = 0

    def add(self, state: State, blocks: int = 1) -> None:
        """Take in the state of the next `blocks` blocks, which make a `Chunk`."""
        self.put((self._next, blocks), state)
        self._next += blocks

    def put(self, chunk: Chunk, state: State) -> int:
        """Take in the state of any chunk; returns the first block of the node that it is in."""
        first, count = chunk
        while count & (count - 1) == 0 and self.nodes.get(first ^ count, (0,))[0] == count:
            _, other = self.nodes.pop(first ^ count)
            left, right = (state, other) if first & count == 0 else (other, state)
            state = merged(left, right)
            first, count = first & ~count, 2 * count
        self.nodes[first] = count, state
        return first

    def total(self) -> State:
        """State of all blocks together; of at least one."""
        parts = [self.nodes[first][1] for first in sorted(self.nodes)]
        self.nodes.clear()
        total = parts.pop()
        while parts:
            total = merged(parts.pop(), total)
        return total


def chunks(blocks: int, size: int) -> Iterator[Chunk]:
    """Cut blocks into chunks of `size`, a power of two; the last may be shorter."""
    return ((first, min(size, blocks - first)) for first in range(0, blocks, size))


def in_step(
    parts: Sequence[Generator[Reduction[Any], State, Result]],
) -> Generator[list[Reduction[Any]], list[State], list[Result]]:
    """Drive generators of one reduction at a time side by side: a step has the next of each.

    Returns what each returned, in their order.
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
