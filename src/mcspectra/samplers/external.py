"""Points from outside: given arrays and files, callables, engines of scipy.stats.qmc and of QMCPy.

Callables, engines and generators are asked for one realisation at a time, each with fresh randomness
of its own. `scipy.stats` (half a second) and `qmcpy` are imported when an engine is first asked for.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import sys
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_unit_points
from mcspectra.core.errors import (
    CountError,
    MissingDependency,
    ParameterError,
    close_match_hint,
)
from mcspectra.core.fields import flag, settle
from mcspectra.core.pointfiles import read_points
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.spec import format_call
from mcspectra.core.streams import Stream
from mcspectra.samplers.base import MAX_COUNT, Draw, Randomization, Sampler

__all__ = [
    "FunctionSampler",
    "GivenPoints",
    "QmcpySampler",
    "ScipySampler",
    "is_engine",
    "is_generator",
]

_BELOW_ONE = np.nextafter(1.0, 0.0)
_RANDOMNESS = ("rng", "seed")  # `seed` until scipy 1.15, and in subclasses written before
_SET_ELSEWHERE = ("dimension", "replications", "seed")  # arguments of QMCPy's generators
_UNBIASED = ("Halton", "LatinHypercube", "Sobol")  # engines of scipy, scrambled
_UNIFORM = ("TRUE", "SHIFT", "DS", "LMS DS", "DP", "LMS DP", "NUS")  # `randomize` of QMCPy
_NOT_POINTS = ("DummySampler", "MPMC")


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
    cycle: bool = flag(default=False)
    dims: int = None  # type: ignore[assignment]
    digest: str = field(init=False)

    def __post_init__(self) -> None:
        paths = _as_paths(self.path)
        given: Any = self.points  # None until the files are read
        dims: Any = self.dims
        if given is not None:
            sets = _as_sets(given)
        elif paths:
            sets = _stacked([(path, points) for path in paths for points in read_points(path)])
        else:
            raise ParameterError("points needs a file: write points(path='file.dat').")
        dims = sets.shape[2] if dims is None else dims
        digest = hashlib.sha256(str(sets.shape).encode() + sets.astype("<f8").tobytes())
        settle(
            self,
            path=paths[0] if len(paths) == 1 else paths,
            points=sets,
            dims=dims,
            digest=digest.hexdigest()[:12],
        )
        Sampler.__post_init__(self)
        if dims != sets.shape[2]:
            raise ParameterError(f"points are in {sets.shape[2]} dims, but {dims} dims are needed.")

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


def _as_paths(given: object) -> tuple[str, ...]:
    paths = (given,) if isinstance(given, str | PathLike) else given
    if isinstance(paths, Sequence) and all(isinstance(p, str | PathLike) for p in paths):
        return tuple(map(str, paths))
    raise ParameterError(f"path is {given!r}; give the name of a file, or a list of names.")


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


class _OneByOne(Sampler):
    """A sampler whose realisations are made one by one, by code of others."""

    @abstractmethod
    def _make_one(self, n: int, stream: Stream, realization: int) -> object: ...

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        sets = []
        for realization in range(first, first + count):
            made = self._make_one(n, stream, realization)
            points = as_unit_points(made, name=f"The points of {self.spec}")
            if points.ndim == 2 and points.shape[1] == self.dims and len(points) < n:
                raise CountError(
                    f"{self.spec} returned {len(points)} of {n} points; ask for fewer or change "
                    "its parameters."
                )
            if points.shape != (n, self.dims):
                raise ParameterError(
                    f"{self.spec} returned shape {points.shape}; {(n, self.dims)} is needed."
                )
            sets.append(points)
        return np.stack(sets)

    @contextmanager
    def _refusals_named(self, n: int, kind: type[Exception]) -> Iterator[None]:
        """Say which sampler cannot make `n` points, and why."""
        try:
            yield
        except kind as error:
            raise CountError(f"{self.spec} cannot make {n} points: {_reason(error)}.") from error


@final
@dataclass(frozen=True, kw_only=True)
class FunctionSampler(_OneByOne):
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

    def _check(self) -> None:
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
        return f"function({_qualified_name(self.function)})"

    def _make_one(self, n: int, stream: Stream, realization: int) -> object:
        return self.function(n, stream.generator(realization))


@final
@dataclass(frozen=True, kw_only=True)
class ScipySampler(_OneByOne):
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

    def _check(self) -> None:
        if self.scramble not in (None, True, False) or not isinstance(self.options, Mapping):
            raise ParameterError(
                f"scramble is {self.scramble!r} and options are {self.options!r}; "
                "give True or False, and names with values."
            )
        settle(self, engine=_engine_source(self.engine))
        arguments = self._arguments()
        if not isinstance(self.engine, str | type) and arguments:
            raise ParameterError(
                f"An engine factory takes no {', '.join(arguments)}; set it inside the function."
            )
        for name in (*_RANDOMNESS, "d", "dims"):
            if name in arguments:
                raise ParameterError(
                    f"{name} is not an option of the engine; give rng= to draw(), and dims= for d."
                )
        made = _made_engine(self.engine, self.dims, arguments, Stream(0).generator(0))
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
        if isinstance(engine, _engine_base()):
            if arguments:
                raise ParameterError(
                    f"The engine already has its arguments; to set {', '.join(arguments)}, give its "
                    f"class, {type(engine).__name__}."
                )
            source, found = _engine_source(type(engine)), _arguments_of(engine)
        else:
            source, found = _engine_source(engine), dict(arguments)
        given = [found.pop(name) for name in ("d", "dims") if name in found]
        if len(given) == 2:
            raise ParameterError("d and dims are the same; give one of them.")
        dims = as_integer("d", given[0], least=1) if given else _usual_dims(source, found)
        scramble = found.pop("scramble", None)
        return cls(engine=source, dims=dims, scramble=scramble, options=found)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether every point is known to be uniform."""
        plain = self.options.get("optimization") is None
        return plain and self.scramble is not False and self.engine in _UNBIASED

    @property
    def spec(self) -> str:
        """Spec string; for a class or factory from outside scipy, its name only."""
        if isinstance(self.engine, str):
            return format_call(self)
        return f"scipy(engine=<{_qualified_name(self.engine)}>, {self._arguments()})"

    def _make_one(self, n: int, stream: Stream, realization: int) -> object:
        with self._refusals_named(n, ValueError):
            generator = stream.generator(realization)
            return _made_engine(self.engine, self.dims, self._arguments(), generator).random(n)

    def _arguments(self) -> dict[str, Any]:
        given = {} if self.scramble is None else {"scramble": self.scramble}
        return {**self.options, **given}


def is_engine(source: object) -> bool:
    """Whether this is a QMCEngine or a class of them; nobody has one without importing qmc."""
    return _is_of(source, getattr(sys.modules.get("scipy.stats.qmc"), "QMCEngine", None))


def _engine_base() -> Any:
    from scipy.stats import qmc

    return qmc.QMCEngine


def _engine_classes() -> dict[str, type[Any]]:
    from scipy.stats import qmc

    return _subclasses({name: getattr(qmc, name) for name in qmc.__all__}, qmc.QMCEngine)


def _engine_source(engine: object) -> Any:
    """Return a class of scipy.stats.qmc as its name; check any other class, name or factory."""
    if isinstance(engine, str) or (_is_of(engine, _engine_base()) and isinstance(engine, type)):
        return _as_name(engine, _engine_classes(), "scipy.stats.qmc has no engine")
    if callable(engine) and not isinstance(engine, type | _engine_base()):
        return engine
    raise ParameterError(
        f"{engine!r} is not an engine; give a name in scipy.stats.qmc such as 'Sobol', a QMCEngine, "
        "its class, or a function that makes one from a generator."
    )


def _made_engine(
    source: Any, dims: int, arguments: Mapping[str, Any], generator: np.random.Generator
) -> Any:
    """Make an engine with this generator, or raise if its class or factory will not."""
    if not isinstance(source, str | type):
        engine = source(generator)
        if not isinstance(engine, _engine_base()):
            raise ParameterError(
                f"{_qualified_name(source)} returned {engine!r}; it must return a QMCEngine."
            )
        return engine
    cls = _engine_classes()[source] if isinstance(source, str) else source
    parameters: Mapping[str, inspect.Parameter] = inspect.signature(cls).parameters
    # What a class hands on to QMCEngine, it takes
    if any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        parameters = {**parameters, **inspect.signature(_engine_base()).parameters}
    randomness = next((name for name in _RANDOMNESS if name in parameters), None)
    if randomness is None:
        raise ParameterError(
            f"{_qualified_name(cls)} takes neither rng nor seed, so its realisations cannot be "
            "seeded; give a function that makes an engine from a generator."
        )
    given = {**({"d": dims} if "d" in parameters else {}), **arguments}
    try:
        return cls(**given, **{randomness: generator})
    except (TypeError, ValueError) as error:
        raise ParameterError(
            f"{cls.__name__} cannot be made with {_shown(given)}: {_reason(error)}."
        ) from error


def _usual_dims(source: Any, arguments: Mapping[str, Any]) -> int:
    """Number of dims of an engine made without it."""
    if isinstance(source, str | type):
        cls = _engine_classes()[source] if isinstance(source, str) else source
        d = inspect.signature(cls).parameters.get("d")
        if d is not None and d.default is d.empty:
            raise ParameterError(f"{_qualified_name(source)} needs its number of dims: give d=.")
        if d is not None:
            return as_integer("d", d.default, least=1)
    return int(_made_engine(source, 0, arguments, np.random.default_rng(0)).d)


def _arguments_of(engine: Any) -> dict[str, Any]:
    """Find the arguments an engine was made with among its attributes; refuse to guess."""
    found, cls = {}, type(engine)
    for name, parameter in inspect.signature(cls).parameters.items():
        if name in _RANDOMNESS:
            continue
        # scipy keeps some arguments only in what it hands to qmc_quad, where scramble is True
        handed = getattr(engine, "_init_quad", {}) if name != "scramble" else {}
        kept = {**handed, **vars(engine)}
        variadic = parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
        spelling = next((s for s in (name, f"_{name}") if s in kept), None)
        if variadic or spelling is None:
            raise ParameterError(
                f"The engine {cls.__name__} does not store its argument {'*' * variadic}{name}; give "
                f"the class and its arguments, as in from_scipy({cls.__name__}, d=2), or a function "
                "that makes an engine from a generator."
            )
        value = kept[spelling]
        found[name] = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    return found


@final
@dataclass(frozen=True, kw_only=True)
class QmcpySampler(_OneByOne):
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
    [Choi2022]_
    """

    name: ClassVar[str] = "qmcpy"
    generator: Any = "DigitalNetB2"
    dims: int = DEFAULT_DIMS
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def _check(self) -> None:
        if not isinstance(self.options, Mapping):
            raise ParameterError(f"options are {self.options!r}; give names with values.")
        settle(self, generator=_generator_source(self.generator))
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
        if isinstance(generator, _generator_base()):
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
        made = type(self._pattern)
        randomize = str(getattr(self._pattern, "randomize", "")).upper()
        known = made.__module__.startswith("qmcpy.") and randomize in _UNIFORM
        return made.__name__ == "IIDStdUniform" or known

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
        shown = _shown({name: getattr(made, name, None) for name in made.parameters})
        return f"qmcpy(generator=<{type(made).__name__}({shown})>)"

    @cached_property
    def _pattern(self) -> Any:
        """One generator, from which dims and limits are read."""
        return self._fresh(np.random.SeedSequence(0))

    def _fresh(self, seed: np.random.SeedSequence) -> Any:
        """Make a generator with a seed of its own: a copy of an instance, or one of the class."""
        source = self.generator
        if isinstance(source, _generator_base()):
            name = type(source).__name__
            if not source.no_replications or list(source.dvec) != list(range(source.d)):
                raise ParameterError(
                    f"This {name} has replications or chosen dimensions; make one with dimension=d "
                    "alone."
                )
            try:
                return source._spawn(seed, source.d)  # as its own ``spawn`` does
            except Exception as error:
                raise ParameterError(f"This {name} cannot be copied: {_reason(error)}.") from error
        cls = _generator_classes()[source] if isinstance(source, str) else source
        # Its warnings, of which it has many, stay off unless asked for
        given = {"dimension": self.dims, "replications": None, "seed": seed, "warn": False}
        own = {key: given[key] for key in inspect.signature(cls).parameters if key in given}
        try:
            return cls(**{**own, **self.options})
        except Exception as error:  # QMCPy has its own kinds, and bare assertions
            raise ParameterError(
                f"{cls.__name__} cannot be made in {self.dims} dims with "
                f"{_shown(self.options) or 'its defaults'}: {_reason(error)}."
            ) from error

    def _make_one(self, n: int, stream: Stream, realization: int) -> object:
        k0, k1 = stream.keys(realization, 1)[0]
        made = self._fresh(np.random.SeedSequence([int(k0), int(k1)]))
        with self._refusals_named(n, Exception):  # QMCPy has its own kinds, and bare assertions
            points = np.asarray(made.gen_samples(n, warn=False), dtype=np.float64)
        points[points == 1.0] = _BELOW_ONE
        return points

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        if getattr(self._pattern, "order", "") != "RADICAL INVERSE":
            return n, n
        below: int = 2 ** (n.bit_length() - 1)
        return below, n if below == n else 2 * below


def is_generator(source: object) -> bool:
    """Whether this is a generator of QMCPy or a class of them; nobody has one without importing it."""
    return _is_of(source, getattr(sys.modules.get("qmcpy"), "AbstractDiscreteDistribution", None))


def _qmcpy() -> Any:
    if importlib.util.find_spec("qmcpy") is None:
        raise MissingDependency(
            "Generators of QMCPy need the package qmcpy; install it with: "
            "pip install 'mcspectra[qmcpy]'"
        )
    import qmcpy

    return qmcpy


def _generator_base() -> Any:
    return _qmcpy().AbstractDiscreteDistribution


def _generator_classes() -> dict[str, type[Any]]:
    """The generators that QMCPy names, by name."""
    known = _subclasses(vars(_qmcpy()), _generator_base())
    return {
        name: cls
        for name, cls in known.items()
        if not name.startswith("Abstract") and name not in _NOT_POINTS
    }


def _generator_source(generator: object) -> Any:
    """Return a class of QMCPy as its name; check any other class, name or instance."""
    if isinstance(generator, str) or _is_of(generator, _generator_base()):
        return _as_name(generator, _generator_classes(), "qmcpy has no generator")
    raise ParameterError(
        f"{generator!r} is not a generator; give a name in qmcpy such as 'DigitalNetB2', an "
        "AbstractDiscreteDistribution, or its class."
    )


def _is_of(source: object, base: Any) -> bool:
    """Whether this is an instance of `base` (None: of nothing) or a subclass of it."""
    if base is None:
        return False
    return isinstance(source, base) or (isinstance(source, type) and issubclass(source, base))


def _subclasses(named: Mapping[str, Any], base: Any) -> dict[str, type[Any]]:
    return {
        name: thing
        for name, thing in named.items()
        if isinstance(thing, type) and issubclass(thing, base) and thing is not base
    }


def _as_name(source: Any, classes: Mapping[str, type[Any]], none_such: str) -> Any:
    """Return a class that has a name as that name; a name must be that of a class."""
    if isinstance(source, str) and source not in classes:
        offer, _ = close_match_hint(source, classes)
        raise ParameterError(f"{none_such} {source!r}.{offer}")
    return next((name for name, cls in classes.items() if cls is source), source)


def _qualified_name(thing: object) -> str:
    """Return module and name of a class or function, without its address in memory."""
    named = thing if hasattr(thing, "__qualname__") else type(thing)
    return thing if isinstance(thing, str) else f"{named.__module__}.{named.__qualname__}"


def _shown(arguments: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={value!r}" for name, value in arguments.items())


def _reason(error: Exception) -> str:
    return str(error).rstrip(".")[:200] or "it refuses them without a reason"
