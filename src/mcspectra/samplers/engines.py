"""Engines of scipy.stats.qmc and generators of QMCPy as samplers.

Each realization is drawn separately, with fresh randomness.
The modules `scipy.stats` (half a second) and `qmcpy` are imported at the first use.
"""

from __future__ import annotations

import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import BELOW_ONE, as_integer
from mcspectra.core.decoding import check_decoded_size, opened
from mcspectra.core.errors import (
    MissingDependency,
    ParameterError,
    close_match_hint,
    reason_of,
)
from mcspectra.core.fields import settle
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.spec import format_call
from mcspectra.core.streams import Stream
from mcspectra.samplers.base import MAX_COUNT
from mcspectra.samplers.external import OneByOne, qualified_name

__all__ = ["QmcpySampler", "ScipySampler", "is_engine", "is_generator"]

# Engines of scipy take the random generator as the argument `rng`, before scipy 1.15 as `seed`
_RANDOMNESS = ("rng", "seed")
_SET_ELSEWHERE = ("dimension", "replications", "seed")  # arguments that QmcpySampler sets itself
_UNBIASED = ("Halton", "LatinHypercube", "Sobol")  # scrambled engines of scipy with uniform points
# Values of QMCPy's argument `randomize` with which points are uniform
_UNIFORM = ("TRUE", "SHIFT", "DS", "LMS DS", "DP", "LMS DP", "NUS")
_NOT_POINTS = ("DummySampler", "MPMC")  # the class MPMC downloads its points
_TABLES = {"generating_matrices": "generating_matrices", "generating_vector": "generating_vectors"}
"""Options of QMCPy that name a file, and the folder with QMCPy's own files."""
_TEXT_RATIO = 16  # Bytes of memory per byte of a table file


@final
@dataclass(frozen=True, kw_only=True)
class ScipySampler(OneByOne):
    """An engine of `scipy.stats.qmc`, created for each realization with its own generator.

    Attributes
    ----------
    engine
        Name of a class in `scipy.stats.qmc`, or a subclass of its QMCEngine.
        A function that makes an engine from a generator is also accepted.
    dims
        Number of dims, the engine's ``d``.
    scramble
        The engine's option for scrambling; with None the engine uses its default.
    options
        Further arguments of the engine, such as ``{'strength': 2}``.

    Notes
    -----
    Scrambled Sobol, Halton and LatinHypercube engines without `optimization` count as unbiased.
    All other engines of `scipy.stats.qmc` do not count as unbiased.
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
        """Make a sampler from an engine, its class or name, or a factory ``generator -> engine``.

        Parameters
        ----------
        engine
            For an instance, only its class and arguments are used.
            The instance's generator and its position in the sequence are ignored.
        arguments
            Arguments of a class, such as its number of dims or ``scramble``.

        Raises
        ------
        ParameterError
            If `engine` has a wrong type, or the arguments of an instance cannot be found.
        """
        if isinstance(engine, _engine_base()):
            if arguments:
                raise ParameterError(
                    f"The engine already has its arguments; to set {', '.join(arguments)}, "
                    f"give its class, {type(engine).__name__}."
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
        """Whether every point is guaranteed to be uniform."""
        plain = self.options.get("optimization") is None
        return plain and self.scramble is not False and self.engine in _UNBIASED

    @property
    def spec(self) -> str:
        """Spec string; for a class or factory outside scipy, only its name."""
        if isinstance(self.engine, str):
            return format_call(self)
        return f"scipy(engine=<{qualified_name(self.engine)}>, {self._arguments()})"

    def make_one(self, n: int, stream: Stream, realization: int) -> object:
        with self.refusals_named(n, ValueError):
            generator = stream.generator(realization)
            return _made_engine(self.engine, self.dims, self._arguments(), generator).random(n)

    def _arguments(self) -> dict[str, Any]:
        given = {} if self.scramble is None else {"scramble": self.scramble}
        return {**self.options, **given}


def is_engine(source: object) -> bool:
    """Return whether this is a QMCEngine or its class; False if qmc is not imported."""
    return _is_of(source, getattr(sys.modules.get("scipy.stats.qmc"), "QMCEngine", None))


def _engine_base() -> Any:
    from scipy.stats import qmc

    return qmc.QMCEngine


def _engine_classes() -> dict[str, type[Any]]:
    from scipy.stats import qmc

    return _subclasses({name: getattr(qmc, name) for name in qmc.__all__}, qmc.QMCEngine)


def _engine_source(engine: object) -> Any:
    """Return the name of a class of scipy.stats.qmc; check any other class, name or factory."""
    if isinstance(engine, str) or (_is_of(engine, _engine_base()) and isinstance(engine, type)):
        return _as_name(engine, _engine_classes(), "scipy.stats.qmc has no engine")
    if callable(engine) and not isinstance(engine, type | _engine_base()):
        return engine
    raise ParameterError(
        f"{engine!r} is not an engine; give a name in scipy.stats.qmc such as 'Sobol', "
        "a QMCEngine, its class, or a function that makes one from a generator."
    )


def _made_engine(
    source: Any, dims: int, arguments: Mapping[str, Any], generator: np.random.Generator
) -> Any:
    """Make an engine with this generator; raise an error if its class or factory fails."""
    if not isinstance(source, str | type):
        engine = source(generator)
        if not isinstance(engine, _engine_base()):
            raise ParameterError(
                f"{qualified_name(source)} returned {engine!r}; it must return a QMCEngine."
            )
        return engine
    cls = _engine_classes()[source] if isinstance(source, str) else source
    parameters: Mapping[str, inspect.Parameter] = inspect.signature(cls).parameters
    # A class with **kwargs also accepts the arguments of QMCEngine
    if any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        parameters = {**parameters, **inspect.signature(_engine_base()).parameters}
    randomness = next((name for name in _RANDOMNESS if name in parameters), None)
    if randomness is None:
        raise ParameterError(
            f"{qualified_name(cls)} takes neither rng nor seed, so its realizations cannot be "
            "seeded; give a function that makes an engine from a generator."
        )
    given = {**({"d": dims} if "d" in parameters else {}), **arguments}
    try:
        return cls(**given, **{randomness: generator})
    except (TypeError, ValueError) as error:
        raise ParameterError(
            f"{cls.__name__} cannot be made with {_shown(given)}: {reason_of(error, 200)}."
        ) from error


def _usual_dims(source: Any, arguments: Mapping[str, Any]) -> int:
    """Return the number of dims of an engine that is created without a number of dims."""
    if isinstance(source, str | type):
        cls = _engine_classes()[source] if isinstance(source, str) else source
        d = inspect.signature(cls).parameters.get("d")
        if d is not None and d.default is d.empty:
            raise ParameterError(f"{qualified_name(source)} needs its number of dims: give d=.")
        if d is not None:
            return as_integer("d", d.default, least=1)
    return int(_made_engine(source, 0, arguments, np.random.default_rng(0)).d)


def _arguments_of(engine: Any) -> dict[str, Any]:
    """Read the arguments of an engine from its attributes; raise an error if one is missing."""
    found, cls = {}, type(engine)
    for name, parameter in inspect.signature(cls).parameters.items():
        if name in _RANDOMNESS:
            continue
        # scipy stores some arguments only for qmc_quad, in a dict where scramble is always True
        handed = getattr(engine, "_init_quad", {}) if name != "scramble" else {}
        kept = {**handed, **vars(engine)}
        variadic = parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
        spelling = next((s for s in (name, f"_{name}") if s in kept), None)
        if variadic or spelling is None:
            raise ParameterError(
                f"The engine {cls.__name__} does not store its argument {'*' * variadic}{name}; "
                f"give the class and its arguments, as in from_scipy({cls.__name__}, d=2), "
                "or a function that makes an engine from a generator."
            )
        value = kept[spelling]
        found[name] = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    return found


@final
@dataclass(frozen=True, kw_only=True)
class QmcpySampler(OneByOne):
    """A generator of QMCPy, created for each realization with its own seed.

    The generator's attributes ``d_limit`` and ``n_limit`` limit dims and counts.
    Counts are powers of two if the order of the generator is the radical inverse.
    All other restrictions of a generator cause an error only when points are drawn.

    Attributes
    ----------
    generator
        Name of a class in `qmcpy`, the class, or an instance.
        An instance is only a pattern: its method ``spawn`` makes fresh copies.
    dims
        Number of dims, the generator's ``dimension``.
    options
        Further arguments of the class, such as ``{'randomize': 'NUS'}``.

    Notes
    -----
    QMCPy keeps up to 63 binary digits, so coordinates may round up to 1.0.
    The largest double below 1 replaces 1.0. Larger coordinates are errors.
    Points of QMCPy's own classes count as uniform after some randomizations:
    shifts, digital shifts, digital permutations and nested scrambling.
    Options that name tables are read from QMCPy's folder or from a file, never from the network.

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
        """Make a sampler from a generator's name, its class with arguments, or an instance.

        Parameters
        ----------
        generator
            Name, class, or instance; the seed and replications of an instance are ignored.
        arguments
            Arguments of a class, such as its number of dims or ``randomize``.

        Raises
        ------
        ParameterError
            If `generator` has a wrong type, or does not accept the arguments.
        MissingDependency
            If QMCPy is not installed.
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
        """Whether every point is guaranteed to be uniform."""
        made = type(self._pattern)
        randomize = str(getattr(self._pattern, "randomize", "")).upper()
        known = made.__module__.startswith("qmcpy.") and randomize in _UNIFORM
        return made.__name__ == "IIDStdUniform" or known

    @property
    def max_count(self) -> int:  # type: ignore[override]
        """Largest number of points that the generator allows."""
        limit = self._pattern.n_limit
        return MAX_COUNT if limit > MAX_COUNT else int(limit)

    @property
    def spec(self) -> str:
        """Spec string. If `generator` is not a name, the spec shows its class and parameters."""
        if isinstance(self.generator, str):
            return format_call(self)
        made = self._pattern
        shown = _shown({name: getattr(made, name, None) for name in made.parameters})
        return f"qmcpy(generator=<{type(made).__name__}({shown})>)"

    @cached_property
    def _pattern(self) -> Any:
        """A generator from which dims and limits are read."""
        return self._fresh(np.random.SeedSequence(0))

    def _fresh(self, seed: np.random.SeedSequence) -> Any:
        """Make a generator with its own seed: a copy of the instance, or a new one of the class."""
        source = self.generator
        if isinstance(source, _generator_base()):
            name = type(source).__name__
            if not source.no_replications or list(source.dvec) != list(range(source.d)):
                raise ParameterError(
                    f"This {name} has replications or chosen dimensions; make one with dimension=d "
                    "alone."
                )
            try:
                # QMCPy's public method ``spawn`` also calls this private method
                return source._spawn(seed, source.d)
            except Exception as error:
                raise ParameterError(
                    f"This {name} cannot be copied: {reason_of(error, 200)}."
                ) from error
        cls = _generator_classes()[source] if isinstance(source, str) else source
        # Turn off QMCPy's many warnings unless the user requests them
        given = {"dimension": self.dims, "replications": None, "seed": seed, "warn": False}
        parameters = inspect.signature(cls).parameters
        own = {key: given[key] for key in parameters if key in given}
        tables = {
            key: _local_table(value, Path(inspect.getfile(cls)).parent / folder)
            for key, folder in _TABLES.items()
            if isinstance(value := self.options.get(key), str)
            and value != getattr(parameters.get(key), "default", None)
        }
        try:
            return cls(**{**own, **self.options, **tables})
        except Exception as error:  # QMCPy raises its own exceptions and bare assertions
            raise ParameterError(
                f"{cls.__name__} cannot be made in {self.dims} dims with "
                f"{_shown(self.options) or 'its defaults'}: {reason_of(error, 200)}."
            ) from error

    def make_one(self, n: int, stream: Stream, realization: int) -> object:
        k0, k1 = stream.keys(realization, 1)[0]
        made = self._fresh(np.random.SeedSequence([int(k0), int(k1)]))
        with self.refusals_named(n, Exception):  # QMCPy has its own exceptions
            points = np.asarray(made.gen_samples(n, warn=False), dtype=np.float64)
        points[points == 1.0] = BELOW_ONE
        return points

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        if getattr(self._pattern, "order", "") != "RADICAL INVERSE":
            return n, n
        below: int = 2 ** (n.bit_length() - 1)
        return below, n if below == n else 2 * below


def _local_table(name: str, folder: Path) -> str:
    """Return a name under which QMCPy opens one of its tables, or a file, without the network.

    QMCPy looks for a name in its own folder, then on the network, and last among local files.
    """
    if Path(name).name == name and (folder / name).is_file():
        return name
    with opened(name, "a table of QMCPy", (".txt",)) as (_, size, shown, _):
        check_decoded_size(shown, size, _TEXT_RATIO * size)
    return os.path.relpath(Path(name).resolve(), folder.resolve())


def is_generator(source: object) -> bool:
    """Return whether this is a QMCPy generator or its class; False if QMCPy is not imported."""
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
    """Return the generators of QMCPy by name."""
    known = _subclasses(vars(_qmcpy()), _generator_base())
    return {
        name: cls
        for name, cls in known.items()
        if not name.startswith("Abstract") and name not in _NOT_POINTS
    }


def _generator_source(generator: object) -> Any:
    """Return the name of a class of QMCPy; check any other class, name or instance."""
    if isinstance(generator, str) or _is_of(generator, _generator_base()):
        return _as_name(generator, _generator_classes(), "qmcpy has no generator")
    raise ParameterError(
        f"{generator!r} is not a generator; give a name in qmcpy such as 'DigitalNetB2', an "
        "AbstractDiscreteDistribution, or its class."
    )


def _is_of(source: object, base: Any) -> bool:
    """Return whether this is an instance or a subclass of `base`; False if `base` is None."""
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
    """Return the name of a class if it has one; check that a name belongs to a class."""
    if isinstance(source, str) and source not in classes:
        offer, _ = close_match_hint(source, classes)
        raise ParameterError(f"{none_such} {source!r}.{offer}")
    return next((name for name, cls in classes.items() if cls is source), source)


def _shown(arguments: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={value!r}" for name, value in arguments.items())
