"""The interface of samplers and randomisations, and samplers of points from outside.

A `Sampler` draws realisations of a point set, a `Randomization` changes the points of another
sampler; ``sampler.then(randomization)`` chains them. Implementations write `_points` (or `apply`)
and say which counts they can do; everything else (checks, seeds, shapes) is here. So are the samplers
that ``Sampler.from_…`` makes: of given arrays and files, callables, engines of scipy.stats.qmc and
generators of QMCPy.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from os import PathLike
from typing import Any, ClassVar, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_unit_points
from mcspectra.core.errors import CountError, NotPowerOfTwoWarning, ParameterError, warn
from mcspectra.core.pointfiles import read_points
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.spec import Component, format_call
from mcspectra.core.streams import RngLike, Stream
from mcspectra.samplers import _engines, _qmcpy
from mcspectra.samplers._fields import check_fields, settle

__all__ = [
    "MAX_COUNT",
    "FixedSet",
    "FunctionSampler",
    "GivenPoints",
    "QmcpySampler",
    "Randomization",
    "Randomized",
    "Sampler",
    "ScipySampler",
    "Structure",
    "check_dims",
    "repeated",
]

MAX_COUNT = 2**31
"""Most points in one realisation, and most numbers in one `draw` of a sampler (16 GiB)."""

_MOST_STEPS = 32
_FIRST_STEP = 1 << 16  # stream labels below this one are free for the samplers' own parts
_BELOW_ONE = np.nextafter(1.0, 0.0)
_SET_ELSEWHERE = ("dimension", "replications", "seed")  # arguments of QMCPy's generators

Draw: TypeAlias = Callable[[int, np.random.Generator], object]
"""What makes one realisation: ``draw(n, generator)`` gives points (n, d) in [0,1)."""


class Structure(Enum):
    """The structure that makes a point set better than random; randomisations must keep it."""

    NONE = "independent points"
    UNKNOWN = "points from outside"
    STRATA = "strata"
    DIGITS = "elementary intervals"
    TORUS = "distances and differences on the torus"


class Sampler(Component, ABC):
    """A randomised point set on [0,1)^d, drawn by the realisation.

    Attributes
    ----------
    dims
        Number of dimensions d.
    unbiased
        Whether a point picked at random is uniform on [0,1)^d, so that means are unbiased.
    fixed
        Whether all realisations are the same set.
    structure
        The structure that randomisations of this sampler must keep: `Structure`.
    sequence
        Whether the first k of n points are those of a set of k points, each run of them good.
    antithetic
        Whether points come in pairs that mirror each other within a cell.
    independent
        Whether the realisations of a seed are independent of one another.
    min_dims, max_dims, max_count
        Least and largest dims and largest count of a realisation; beyond them, time or memory run
        out. `other_dims` is the advice where there are no others.
    """

    dims: int
    unbiased: ClassVar[bool] = True
    fixed: ClassVar[bool] = False
    structure: ClassVar[Structure] = Structure.UNKNOWN
    sequence: ClassVar[bool] = False
    antithetic: ClassVar[bool] = False
    independent: ClassVar[bool] = True
    min_dims: ClassVar[int] = 1
    max_dims: ClassVar[int | None] = None
    other_dims: ClassVar[str] = ""
    max_count: ClassVar[int] = MAX_COUNT

    def __post_init__(self) -> None:
        check_dims(self)
        check_fields(self)
        self._check()

    def _check(self) -> None:
        """Check what parameters, each checked by its field, mean together."""

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """Base of the digits of each coordinate, for randomisations of digits: 2 by default."""
        return (2,) * self.dims

    @property
    def powers_only(self) -> bool:
        """Whether randomisations of digits keep the set at powers of their base only."""
        return self.structure is Structure.STRATA

    def digit_strata(self, n: int, base: int) -> bool:
        """Whether the strata of `n` points, a power of `base`, have sides that are powers too."""
        del n, base
        return True

    def draw(self, n: int, *, realizations: int = 1, rng: RngLike = None, first: int = 0) -> Array:
        """Draw realisations first … first+realizations−1 of a set of `n` points.

        Parameters
        ----------
        n
            Number of points in a realisation.
        realizations
            How many realisations.
        rng
            Seed in the sense of SPEC 7. Realisation r of a seed is the same whichever call draws it.
        first
            Number of the first realisation.

        Returns
        -------
        ndarray
            float64, shape (realizations, n, dims), in [0,1).

        Raises
        ------
        CountError
            The sampler cannot make `n` points; the message names the nearest counts.
        """
        n = self.check_count(n)
        count = as_integer("realizations", realizations, least=1)
        start = as_integer("first", first, least=0, most=2**62)
        if n * count * self.dims > MAX_COUNT:
            raise CountError(
                f"{count} realisations of {n} points in {self.dims} dims are "
                f"{n * count * self.dims:.3g} numbers; draw at most {MAX_COUNT:.3g} at a time, "
                "in several calls with first=."
            )
        return self._points(n, Stream.from_rng(rng), start, count)

    def draw_stream(self, n: int, stream: Stream, first: int, count: int) -> Array:
        """Draw `count` realisations from `stream`, `n` already checked: for estimators' inner loops."""
        return self._points(n, stream, first, count)

    def check_count(self, n: object) -> int:
        """Return `n` as an int if this sampler can make `n` points, else raise CountError."""
        try:
            count = as_integer("n", n, least=1, most=MAX_COUNT)
        except ParameterError as error:
            raise CountError(str(error)) from None
        if count > self.max_count:
            raise CountError(
                f"{self.spec} makes at most {self.max_count} points, not {count}; ask for fewer, or "
                "use a sampler that needs no optimisation.",
                (self.max_count,),
            )
        below, above = self._counts_near(count)
        if count in (below, above):
            if sentence := self._count_warning(count):
                warn(sentence, NotPowerOfTwoWarning)
            return count
        options = tuple(c for c in (below, above) if c is not None and c <= MAX_COUNT)
        verb = "count is" if len(options) == 1 else "counts are"
        raise CountError(
            f"{self.spec} in {self.dims} dims cannot make {count} points; "
            f"the nearest {verb} {' and '.join(map(str, options))}.",
            options,
        )

    def nearest_count(self, n: int) -> int:
        """Return the count nearest to `n` that this sampler can make (the lower one on a tie)."""
        count = min(as_integer("n", n, least=1, most=MAX_COUNT), self.max_count)
        options = [c for c in self._counts_near(count) if c is not None and c <= self.max_count]
        return min(options, key=lambda c: (abs(c - count), c))

    def then(self, randomization: Randomization) -> Sampler:
        """Return this sampler with `randomization` applied to every realisation."""
        if not isinstance(randomization, Randomization):
            raise ParameterError(f"{randomization!r} is not a randomisation; use e.g. Shift().")
        fitted = randomization.fit(self)
        base, steps = (self.base, self.steps) if isinstance(self, Randomized) else (self, ())
        if len(steps) == _MOST_STEPS:
            raise ParameterError(
                f"{base.spec} already has {_MOST_STEPS} randomisations, the most allowed; "
                "leave the others out."
            )
        return Randomized(base=base._before(fitted), steps=(*steps, fitted))

    @abstractmethod
    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        """Make realisations first … first+count−1: float64 (count, n, dims)."""

    def _before(self, randomization: Randomization) -> Sampler:
        """Return the sampler to draw from before `randomization`: given sets may then be reused."""
        del randomization
        return self

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        """Return the largest possible count ≤ n (None if none) and the smallest ≥ n."""
        return n, n

    def _count_warning(self, n: int) -> str | None:
        """Return a warning for `n` points, a possible but poor count, else None."""
        del n
        return None

    @staticmethod
    def from_points(points: object) -> Sampler:
        """Make a sampler of given points, shape (R, n, d) or (n, d): realisation r is points[r]."""
        return GivenPoints.from_array(points)

    @staticmethod
    def from_files(*paths: str | PathLike[str]) -> Sampler:
        """Make a sampler of point files (.dat, .bin, .npz, .csv, .parquet), their sets in order."""
        return GivenPoints.from_files(*paths)

    @staticmethod
    def from_function(draw: Draw, *, dims: int, unbiased: bool = True) -> Sampler:
        """Make a sampler of a callable ``draw(n, generator) -> (n, d)`` points in [0,1)."""
        return FunctionSampler(function=draw, dims=dims, unbiased_=unbiased)

    @staticmethod
    def from_scipy(engine: object, **arguments: object) -> Sampler:
        """Make a sampler of a `scipy.stats.qmc.QMCEngine`, its class, or a factory ``rng -> engine``."""
        return ScipySampler.from_engine(engine, **arguments)

    @staticmethod
    def from_qmcpy(generator: object, **arguments: object) -> Sampler:
        """Make a sampler of a QMCPy generator: an instance, its class with arguments, or a name."""
        return QmcpySampler.from_generator(generator, **arguments)


class FixedSet(Sampler):
    """A sampler of the same points every time: implementations write `_set`."""

    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True

    @abstractmethod
    def _set(self, n: int) -> Array:
        """Make the set of `n` points: float64 (n, dims)."""

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first
        return repeated(self._set(n), count)


class Randomization(Component, ABC):
    """A change to the points of a sampler, with its own randomness."""

    stationary: ClassVar[bool] = False
    """Whether the result is statistically the same after any toroidal translation."""
    debiases: ClassVar[bool] = False
    """Whether every point is uniform afterwards, whatever it was before."""
    fixed: ClassVar[bool] = False
    """Whether realisations that are the same set remain so."""
    pointwise: ClassVar[bool] = False
    """Whether each point moves by itself, so that sequences stay sequences."""
    independent: ClassVar[bool] = True
    """Whether realisations are moved independently of one another."""
    fits: ClassVar[Mapping[Structure, Structure]] = {s: s for s in Structure}
    """The structures that survive, and what is left of each; samplers of others are refused."""

    def __post_init__(self) -> None:
        check_fields(self)
        self._check()

    def _check(self) -> None:
        """Check what parameters, each checked by its field, mean together."""

    @abstractmethod
    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Return new points (count, n, d) in [0,1) for realisations first … first+count−1."""

    def fit(self, sampler: Sampler) -> Randomization:
        """Return this randomisation as it is applied to `sampler`, e.g. in its digits' base.

        Raises
        ------
        ParameterError
            It would break the structure of the sampler; the message names one that fits.
        """
        if sampler.structure not in self.fits:
            raise ParameterError(
                f"{self.name} would break the {sampler.structure.value} of {sampler.spec}; "
                f"{_advice(sampler.structure)}."
            )
        return self

    def left(self, sampler: Sampler) -> Structure:
        """Return the structure of `sampler` that this randomisation keeps."""
        return self.fits[sampler.structure]

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Draw realisations of `sampler` from `stream` and randomise them from the stream `own`.

        To be overridden where other counts or realisations of `sampler` are needed than those
        asked for.
        """
        return self.apply(sampler.draw_stream(n, stream, first, count), own, first)

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        """Return the largest count ≤ n (None if none) and the smallest ≥ n that can be made."""
        return sampler._counts_near(n)

    def max_count(self, sampler: Sampler) -> int:
        """Return the largest count possible with `sampler`."""
        return sampler.max_count

    def count_warning(self, sampler: Sampler, n: int) -> str | None:
        """Return a warning for `n` points, a possible but poor count, else None."""
        return sampler._count_warning(n)


def _advice(structure: Structure) -> str:
    if structure is Structure.TORUS:
        return "use shift"
    if structure is Structure.DIGITS:
        return "use shift, digital-shift or owen"
    return "use shift"


@final
@dataclass(frozen=True, kw_only=True)
class Randomized(Sampler):
    """A sampler followed by one or more randomisations."""

    base: Sampler
    steps: tuple[Randomization, ...]

    def __post_init__(self) -> None:
        """The parts were checked when they were made."""

    @property
    def dims(self) -> int:  # type: ignore[override]
        """Number of dims of the sampler inside."""
        return self.base.dims

    @property
    def spec(self) -> str:
        """Spec string of the whole chain."""
        return " | ".join([self.base.spec, *(step.spec for step in self.steps)])

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether every point is uniform after the last step."""
        return self.base.unbiased or any(step.debiases for step in self.steps)

    @property
    def fixed(self) -> bool:  # type: ignore[override]
        """Whether all steps leave a fixed set one."""
        return self.base.fixed and all(step.fixed for step in self.steps)

    @property
    def structure(self) -> Structure:  # type: ignore[override]
        """The structure of the sampler inside that all steps keep."""
        return self.steps[-1].left(self._inner)

    @property
    def antithetic(self) -> bool:  # type: ignore[override]
        """Whether the sampler inside has pairs: all accepted steps keep them."""
        return self.base.antithetic

    @property
    def independent(self) -> bool:  # type: ignore[override]
        """Whether nothing in the chain ties realisations together."""
        return self.base.independent and all(step.independent for step in self.steps)

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """Bases of the sampler inside."""
        return self.base.digit_bases

    @property
    def max_count(self) -> int:  # type: ignore[override]
        """The largest count of the last step, given that of the sampler inside."""
        return self.steps[-1].max_count(self._inner)

    @property
    def sequence(self) -> bool:  # type: ignore[override]
        """Whether all steps leave a sequence one."""
        return self.base.sequence and all(step.pointwise for step in self.steps)

    @property
    def powers_only(self) -> bool:
        """As for the sampler inside, while a part of its structure is kept."""
        return self.base.powers_only and self.structure in (Structure.STRATA, Structure.DIGITS)

    def digit_strata(self, n: int, base: int) -> bool:
        """As for the sampler inside."""
        return self.base.digit_strata(n, base)

    @property
    def _inner(self) -> Sampler:
        """The sampler that the last step is applied to."""
        rest = self.steps[:-1]
        return Randomized(base=self.base, steps=rest) if rest else self.base

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        own = stream.child(_FIRST_STEP + len(self.steps) - 1)
        return self.steps[-1].draw(self._inner, n, stream, own, first, count)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return self.steps[-1].counts_near(self._inner, n)

    def _count_warning(self, n: int) -> str | None:
        return self.steps[-1].count_warning(self._inner, n)


@final
@dataclass(frozen=True, kw_only=True)
class GivenPoints(Sampler):
    """Given points: realisation r is set r of an array or of point-set files.

    More realisations than sets, or another n, are errors. Followed by a randomisation that makes
    every point uniform (shift, digital-shift, owen) the sets are used again and again, each time
    with fresh randomness: one set is then enough for any number of realisations.

    Attributes
    ----------
    path
        File or files (.dat, .bin, .npz, .csv, .parquet) that hold the sets, in order; beside
        `points`, only their name.
    points
        The sets, shape (R, n, d) or (n, d), in [0,1). Copied, then read-only.
    cycle
        Whether realisation r is set r mod R. Without a randomisation that repeats data:
        a variance is then that of R sets, however many are drawn.
    dims
        Number of coordinates; by default that of the sets; a given number must agree with them.
    digest
        First 12 digits of the SHA-256 of shape and coordinates.

    Raises
    ------
    FileFormatError
        A file is not a point set.
    ParameterError
        Neither `path` nor `points`, or sets of different shapes.
    DomainError
        Points outside [0,1) or not finite, or no points.
    """

    name: ClassVar[str] = "points"
    unbiased: ClassVar[bool] = False
    path: str | Sequence[str] = ()
    points: Array = field(default=None, repr=False, compare=False)  # type: ignore[arg-type]
    cycle: bool = False
    dims: int = None  # type: ignore[assignment]
    digest: str = field(init=False)

    def __post_init__(self) -> None:
        if self.dims is not None:
            check_dims(self)
        if not isinstance(self.cycle, bool):
            raise ParameterError(f"cycle is {self.cycle!r}; give True or False.")
        paths = _as_paths(self.path)
        given: object = self.points  # None until the files are read
        sets = _sets_of_files(paths) if given is None else _as_sets(given)
        dims = sets.shape[2]
        if self.dims not in (None, dims):
            raise ParameterError(f"points are in {dims} dims, but {self.dims} dims are needed.")
        object.__setattr__(self, "path", paths[0] if len(paths) == 1 else paths)
        object.__setattr__(self, "points", sets)
        object.__setattr__(self, "dims", dims)
        object.__setattr__(self, "digest", _digest(sets))

    @classmethod
    def from_array(cls, points: object) -> GivenPoints:
        """Make a sampler of an array of shape (R, n, d), or (n, d) for one set."""
        return cls(points=_as_sets(points))

    @classmethod
    def from_files(cls, *paths: str | PathLike[str]) -> GivenPoints:
        """Make a sampler of the sets of one or several files, in order."""
        return cls(path=_as_paths(paths))

    @classmethod
    def from_sets(cls, sets: Iterable[object], name: str) -> GivenPoints:
        """Make a sampler of arrays (n, d) from a source called `name`."""
        return cls(path=name, points=_stacked([(name, points) for points in sets]))

    @property
    def spec(self) -> str:
        """Spec string with the path; for an array, its shape and digest."""
        if not self.path:
            shape = "x".join(map(str, self.points.shape))
            return f"points(<array {shape}, SHA-256 {self.digest}>)"
        path = list(self.path) if isinstance(self.path, tuple) else self.path
        return f"points(path={path!r}{', cycle=True' if self.cycle else ''})"

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del n, stream
        sets = len(self.points)
        if first + count > sets and not self.cycle:
            raise CountError(
                f"{self.spec} holds {sets} realisation{'s' if sets != 1 else ''}, but {first + count} are needed; "
                "ask for fewer, give more sets, or add a randomisation such as '| shift'."
            )
        return np.asarray(self.points[np.arange(first, first + count) % sets])

    def _before(self, randomization: Randomization) -> Sampler:
        return replace(self, cycle=True) if randomization.debiases else self

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        size = self.points.shape[1]
        return (size if n >= size else None), (size if n <= size else 2 * MAX_COUNT)


@final
@dataclass(frozen=True, kw_only=True)
class FunctionSampler(Sampler):
    """A callable ``draw(n, generator) -> (n, d)``, called once for each realisation.

    Attributes
    ----------
    function
        The callable. All its randomness must come from the generator, which is fresh and
        reproducible for each realisation; threads may call it side by side.
    dims
        Number of coordinates of the points it returns.
    unbiased_
        Whether each of its points is uniform on [0,1)^d by itself.
    """

    name: ClassVar[str] = "function"
    function: Draw
    dims: int
    unbiased_: bool = True

    def __post_init__(self) -> None:
        check_dims(self)
        if not callable(self.function):
            raise ParameterError(
                f"{self.function!r} is not callable; give a function draw(n, generator)."
            )

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """As declared by the user."""
        return self.unbiased_

    @property
    def spec(self) -> str:
        """Name of the callable, which no spec string can describe."""
        return f"function({_engines.qualified_name(self.function)})"

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        sets = [self.function(n, stream.generator(r)) for r in range(first, first + count)]
        return np.stack([_checked(x, n, self.dims, self.spec) for x in sets])


@final
@dataclass(frozen=True, kw_only=True)
class ScipySampler(Sampler):
    """An engine of `scipy.stats.qmc`, made anew for each realisation with its own generator.

    Attributes
    ----------
    engine
        Name of a class in `scipy.stats.qmc`, a subclass of its QMCEngine, or a factory
        ``generator -> engine``.
    dims
        Number of dims, the engine's ``d``.
    scramble
        The engine's argument of that name; None leaves it to the engine.
    options
        Further arguments of the engine, e.g. ``{'strength': 2}``.

    Notes
    -----
    Scrambled Sobol, Halton and LatinHypercube, without `optimization`, are known to be unbiased;
    any other engine is not assumed to be.
    """

    name: ClassVar[str] = "scipy"
    engine: str | type[Any] | Callable[[np.random.Generator], Any] = "Sobol"
    dims: int = DEFAULT_DIMS
    scramble: bool | None = None
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        check_dims(self)
        if self.scramble not in (None, True, False) or not isinstance(self.options, Mapping):
            raise ParameterError(
                f"scramble is {self.scramble!r} and options are {self.options!r}; "
                "give True or False, and names with values."
            )
        object.__setattr__(self, "engine", _engines.as_source(self.engine))
        _engines.check_options(self.engine, self._arguments())
        made = self._fresh(Stream(0), 0)
        if made.d != self.dims:
            raise ParameterError(
                f"The engine of {self.spec} makes points in {made.d} dims, not in {self.dims}."
            )

    @classmethod
    def from_engine(cls, engine: object, **arguments: Any) -> ScipySampler:
        """Make a sampler of an engine, its class or name, or a factory ``generator -> engine``.

        Parameters
        ----------
        engine
            Of an instance only the class and the arguments it was made with are used, not its
            generator or how far it has been drawn.
        arguments
            Arguments of a class: ``d`` (or ``dims``), ``scramble``, ...

        Raises
        ------
        ParameterError
            `engine` has another type, or the arguments of an instance are not known.
        """
        source, found = _engines.taken_apart(engine, arguments)
        dims = _engines.dims_of(source, found)
        scramble = found.pop("scramble", None)
        return cls(engine=source, dims=dims, scramble=scramble, options=found)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether every point is known to be uniform."""
        plain = self.options.get("optimization") is None
        return plain and self.scramble is not False and self.engine in _engines.UNBIASED

    @property
    def spec(self) -> str:
        """Spec string; for a class or factory from outside scipy, its name only."""
        if isinstance(self.engine, str):
            return format_call(self)
        return f"scipy(engine=<{_engines.qualified_name(self.engine)}>, {self._arguments()})"

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        return np.stack([self._draw_one(n, stream, r) for r in range(first, first + count)])

    def _draw_one(self, n: int, stream: Stream, realization: int) -> Array:
        try:
            points = self._fresh(stream, realization).random(n)
        except ValueError as error:
            reason = str(error).rstrip(".")
            raise CountError(f"{self.spec} cannot make {n} points: {reason}.") from error
        return _checked(points, n, self.dims, self.spec)

    def _fresh(self, stream: Stream, realization: int) -> Any:
        generator = stream.generator(realization)
        return _engines.make(self.engine, self.dims, self._arguments(), generator)

    def _arguments(self) -> dict[str, Any]:
        given = {} if self.scramble is None else {"scramble": self.scramble}
        return {**self.options, **given}


@final
@dataclass(frozen=True, kw_only=True)
class QmcpySampler(Sampler):
    """A generator of QMCPy, made anew for each realisation with its own seed.

    Dims and counts are those of the generator: its ``d_limit`` and ``n_limit``, powers of two where
    its order is the radical inverse; other refusals come when points are drawn.

    Attributes
    ----------
    generator
        Name of a class in `qmcpy`, the class, or an instance: that is only a pattern, of which
        fresh copies are made (QMCPy's own ``spawn``).
    dims
        Number of dims, the generator's ``dimension``.
    options
        Further arguments of the class, e.g. ``{'randomize': 'NUS'}``.

    Notes
    -----
    QMCPy keeps up to 63 binary digits; a coordinate that rounds up to 1.0 becomes the largest
    double below 1. Larger ones are errors. Points count as uniform where the class is QMCPy's and
    its ``randomize`` says a shift, a digital shift, a digital permutation or nested scrambling.

    References
    ----------
    Choi, Hickernell, Jagadeeswaran, McCourt, Sorokin (2022), "Quasi-Monte Carlo software",
    doi 10.1007/978-3-030-98319-2_2.
    """

    name: ClassVar[str] = "qmcpy"
    generator: Any = "DigitalNetB2"
    dims: int = DEFAULT_DIMS
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        check_dims(self)
        if not isinstance(self.options, Mapping):
            raise ParameterError(f"options are {self.options!r}; give names with values.")
        object.__setattr__(self, "generator", _qmcpy.as_source(self.generator))
        for name in self.options:
            if name in _SET_ELSEWHERE:
                raise ParameterError(
                    f"{name} is not an option of the generator; give rng= and realizations= "
                    "to draw(), and dims= for the dimension."
                )
        if self._pattern.d != self.dims:
            raise ParameterError(
                f"The generator of {self.spec} is for {self._pattern.d} dims, not for {self.dims}."
            )

    @classmethod
    def from_generator(cls, generator: object, **arguments: Any) -> QmcpySampler:
        """Make a sampler of a generator's name, its class with arguments, or an instance.

        Parameters
        ----------
        generator
            Name, class, or instance; of the latter neither its seed nor replications are used.
        arguments
            Arguments of a class: ``dimension`` (or ``dims``), ``randomize``, ...

        Raises
        ------
        ParameterError
            `generator` has another type, or does not take the arguments.
        MissingDependency
            QMCPy is not installed.
        """
        options = dict(arguments)
        given = [options.pop(key) for key in ("dimension", "dims") if key in options]
        if len(given) > 1:
            raise ParameterError("dimension and dims are the same; give one of them.")
        if isinstance(generator, _qmcpy.generator_class()):
            given = given or [generator.d]
            if options:
                raise ParameterError(
                    f"The generator already has its arguments; to set {', '.join(options)}, give "
                    f"its class, {type(generator).__name__}."
                )
        dims = as_integer("dimension", given[0] if given else DEFAULT_DIMS, least=1)
        return cls(generator=generator, dims=dims, options=options)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether every point is known to be uniform."""
        return _qmcpy.is_uniform(self._pattern)

    @property
    def max_count(self) -> int:  # type: ignore[override]
        """The generator's limit."""
        limit = self._pattern.n_limit
        return MAX_COUNT if limit > MAX_COUNT else int(limit)

    @property
    def spec(self) -> str:
        """Spec string; for an instance, or a class from outside QMCPy, its own description."""
        if isinstance(self.generator, str):
            return format_call(self)
        made = self._pattern
        parameters = {name: getattr(made, name, None) for name in made.parameters}
        shown = ", ".join(f"{name}={value!r}" for name, value in parameters.items())
        return f"qmcpy(generator=<{type(made).__name__}({shown})>)"

    @cached_property
    def _pattern(self) -> Any:
        """One generator, from which dims and limits are read."""
        return self._fresh(np.random.SeedSequence(0))

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        keys = stream.keys(first, count)
        return np.stack([self._draw_one(n, [int(k0), int(k1)]) for k0, k1 in keys])

    def _draw_one(self, n: int, entropy: list[int]) -> Array:
        made = self._fresh(np.random.SeedSequence(entropy))
        try:
            points = np.asarray(made.gen_samples(n, warn=False), dtype=np.float64)
        except Exception as error:  # QMCPy has its own kinds, and bare assertions
            reason = str(error).rstrip(".")[:200]
            raise CountError(f"{self.spec} cannot make {n} points: {reason}.") from error
        points[points == 1.0] = _BELOW_ONE
        points = as_unit_points(points, name=f"The points of {self.spec}")
        if points.shape != (n, self.dims):
            raise ParameterError(
                f"{self.spec} returned shape {points.shape}; {(n, self.dims)} is needed."
            )
        return points

    def _fresh(self, seed: np.random.SeedSequence) -> Any:
        return _qmcpy.fresh(self.generator, self.dims, self.options, seed)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        if getattr(self._pattern, "order", "") != "RADICAL INVERSE":
            return n, n
        below: int = 2 ** (n.bit_length() - 1)
        return below, n if below == n else 2 * below


def check_dims(sampler: Any) -> None:
    """Make a sampler's `dims` an int from its class's `min_dims` to `max_dims`."""
    least, most, given = sampler.min_dims, sampler.max_dims, sampler.dims
    try:
        settle(sampler, dims=as_integer("dims", given, least=least, most=most or 2**16))
    except ParameterError as error:
        only = f"dims is {given!r}; it must be {least}" if least == most else str(error).rstrip(".")
        advice = f", {sampler.other_dims}" if sampler.other_dims else ""
        raise ParameterError(f"{sampler.name}: {only}{advice}.") from None


def repeated(points: Array, count: int) -> Array:
    """Points (n, d) `count` times: float64 (count, n, d).

    Unlike `numpy.tile`, this copies without Python's lock, so that threads do not wait for one another.
    """
    out = np.empty((count, *points.shape))
    out[...] = points
    return out


def _checked(points: object, n: int, dims: int, source: str) -> Array:
    """Return points that others made as float64 (n, dims), all in [0,1)."""
    array = as_unit_points(points, name=f"The points of {source}")
    if array.ndim == 2 and array.shape[1] == dims and len(array) < n:
        raise CountError(
            f"{source} returned {len(array)} of {n} points; ask for fewer or change its parameters."
        )
    if array.shape != (n, dims):
        raise ParameterError(f"{source} returned shape {array.shape}; {(n, dims)} is needed.")
    return array


def _as_paths(given: object) -> tuple[str, ...]:
    paths = (given,) if isinstance(given, str | PathLike) else given
    if isinstance(paths, Sequence) and all(isinstance(p, str | PathLike) for p in paths):
        return tuple(map(str, paths))
    raise ParameterError(f"path is {given!r}; give the name of a file, or a list of names.")


def _sets_of_files(paths: tuple[str, ...]) -> Array:
    if not paths:
        raise ParameterError("points needs a file: write points(path='file.dat').")
    return _stacked([(path, points) for path in paths for points in read_points(path)])


def _stacked(sets: Sequence[tuple[str, object]]) -> Array:
    """Make (R, n, d) of named sets (n, d); they must be of the same shape."""
    arrays = [as_unit_points(points, name=f"The points of {name}") for name, points in sets]
    for k, array in enumerate(arrays):
        if array.shape != arrays[0].shape:
            raise ParameterError(
                f"Set {k + 1} (of {sets[k][0]}) has shape {array.shape}, but the first has "
                f"{arrays[0].shape}; all realisations need the same number of points and dims."
            )
    return _as_sets(np.stack(arrays) if arrays else [])


def _as_sets(given: object) -> Array:
    """Return a read-only copy of shape (R, n, d)."""
    points = as_unit_points(given)
    if points.ndim not in (2, 3):
        raise ParameterError(
            f"points have shape {points.shape}; give (n, d), or (R, n, d) for R realisations."
        )
    sets = np.array(points if points.ndim == 3 else points[None], order="C")
    sets.flags.writeable = False
    return sets


def _digest(sets: Array) -> str:
    data = str(sets.shape).encode() + sets.astype("<f8").tobytes()
    return hashlib.sha256(data).hexdigest()[:12]
