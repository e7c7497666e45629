"""Engines of scipy.stats.qmc: their classes by name, their arguments, fresh ones to order.

scipy is imported when an engine is first asked for: `scipy.stats` takes half a second.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from mcspectra.core.checks import as_integer
from mcspectra.core.errors import ParameterError, close_match_hint

__all__ = [
    "UNBIASED",
    "Source",
    "as_source",
    "check_options",
    "dims_of",
    "make",
    "qualified_name",
    "taken_apart",
]

Source: TypeAlias = "str | type[Any] | Callable[[np.random.Generator], Any]"
"""Name in scipy.stats.qmc, another subclass of QMCEngine, or a factory generator -> engine."""

UNBIASED = ("Halton", "LatinHypercube", "Sobol")
"""Engines of scipy whose scrambled points are uniform each by itself."""

_RANDOMNESS = ("rng", "seed")  # `seed` until scipy 1.15, and in subclasses written before


def as_source(engine: object) -> Source:
    """Return a class of scipy.stats.qmc as its name; check any other class, name or factory."""
    if isinstance(engine, str):
        _class(engine)
        return engine
    if isinstance(engine, type) and issubclass(engine, _base()):
        names = [name for name, cls in _classes().items() if cls is engine]
        return names[0] if names else engine
    if callable(engine) and not isinstance(engine, type | _base()):
        return engine
    raise ParameterError(
        f"{engine!r} is not an engine; give a name in scipy.stats.qmc such as 'Sobol', a QMCEngine, "
        "its class, or a function that makes one from a generator."
    )


def check_options(source: Source, arguments: Mapping[str, Any]) -> None:
    """Refuse arguments that are set elsewhere, and all arguments of a factory."""
    if not isinstance(source, str | type) and arguments:
        raise ParameterError(
            f"An engine factory takes no {', '.join(arguments)}; set it inside the function."
        )
    for name in (*_RANDOMNESS, "d", "dims"):
        if name in arguments:
            raise ParameterError(
                f"{name} is not an option of the engine; give rng= to draw(), and dims= for d."
            )


def make(
    source: Source, dims: int, arguments: Mapping[str, Any], generator: np.random.Generator
) -> Any:
    """Make an engine with this generator.

    Raises
    ------
    ParameterError
        The class refuses the arguments, or the factory returns another type.
    """
    if isinstance(source, str | type):
        return _instance(_class(source), dims, arguments, generator)
    engine = source(generator)
    if not isinstance(engine, _base()):
        raise ParameterError(
            f"{qualified_name(source)} returned {engine!r}; it must return a QMCEngine."
        )
    return engine


def taken_apart(engine: object, arguments: Mapping[str, Any]) -> tuple[Source, dict[str, Any]]:
    """Return the source of an engine and the arguments it is made with."""
    if not isinstance(engine, _base()):
        return as_source(engine), dict(arguments)
    if arguments:
        raise ParameterError(
            f"The engine already has its arguments; to set {', '.join(arguments)}, give its class, "
            f"{type(engine).__name__}."
        )
    return as_source(type(engine)), _arguments_of(engine)


def dims_of(source: Source, arguments: dict[str, Any]) -> int:
    """Take the number of dims out of `arguments`, or ask an engine made without it."""
    given = [arguments.pop(name) for name in ("d", "dims") if name in arguments]
    if len(given) == 2:
        raise ParameterError("d and dims are the same; give one of them.")
    if given:
        return as_integer("d", given[0], least=1)
    if isinstance(source, str | type):
        d = inspect.signature(_class(source)).parameters.get("d")
        if d is not None and d.default is d.empty:
            raise ParameterError(f"{qualified_name(source)} needs its number of dims: give d=.")
        if d is not None:
            return as_integer("d", d.default, least=1)
    return int(make(source, 0, arguments, np.random.default_rng(0)).d)


def qualified_name(thing: object) -> str:
    """Return module and name of a class or function, without its address in memory."""
    named = thing if hasattr(thing, "__qualname__") else type(thing)
    return thing if isinstance(thing, str) else f"{named.__module__}.{named.__qualname__}"


def _instance(
    cls: type[Any], dims: int, arguments: Mapping[str, Any], generator: np.random.Generator
) -> Any:
    parameters = inspect.signature(cls).parameters
    sizes = {"d": dims} if "d" in parameters or _takes_any(parameters) else {}
    randomness = {_randomness(cls, parameters): generator}
    try:
        return cls(**sizes, **arguments, **randomness)
    except (TypeError, ValueError) as error:
        shown = ", ".join(f"{k}={v!r}" for k, v in {**sizes, **arguments}.items())
        reason = str(error).rstrip(".")
        raise ParameterError(f"{cls.__name__} cannot be made with {shown}: {reason}.") from error


def _randomness(cls: type[Any], parameters: Mapping[str, inspect.Parameter]) -> str:
    """Return the name of the parameter that takes a generator."""
    if _takes_any(parameters):
        parameters = {**parameters, **inspect.signature(_base()).parameters}
    for name in _RANDOMNESS:
        if name in parameters:
            return name
    raise ParameterError(
        f"{qualified_name(cls)} takes neither rng nor seed, so its realisations cannot be seeded; "
        "give a function that makes an engine from a generator."
    )


def _arguments_of(engine: Any) -> dict[str, Any]:
    """Find the arguments an engine was made with among its attributes; refuse to guess."""
    found = {}
    parameters = inspect.signature(type(engine)).parameters
    for name, parameter in parameters.items():
        if name in _RANDOMNESS:
            continue
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            raise ParameterError(_cannot_tell(engine, f"*{name}"))
        found[name] = _plain(_attribute(engine, name))
    return found


def _attribute(engine: Any, name: str) -> Any:
    # scipy keeps some arguments only in what it hands to qmc_quad, where scramble is always True.
    handed = getattr(engine, "_init_quad", {}) if name != "scramble" else {}
    for holder in (vars(engine), handed):
        for spelling in (name, f"_{name}"):
            if spelling in holder:
                return holder[spelling]
    raise ParameterError(_cannot_tell(engine, name))


def _cannot_tell(engine: object, what: str) -> str:
    name = type(engine).__name__
    return (
        f"The engine {name} does not store its argument {what}; give the class and its arguments, "
        f"as in from_scipy({name}, d=2), or a function that makes an engine from a generator."
    )


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _takes_any(parameters: Mapping[str, inspect.Parameter]) -> bool:
    return any(p.kind is p.VAR_KEYWORD for p in parameters.values())


def _base() -> Any:
    from scipy.stats import qmc

    return qmc.QMCEngine


def _classes() -> dict[str, type[Any]]:
    from scipy.stats import qmc

    public = {name: getattr(qmc, name) for name in qmc.__all__}
    return {
        name: cls
        for name, cls in public.items()
        if isinstance(cls, type) and issubclass(cls, _base()) and cls is not _base()
    }


def _class(source: str | type[Any]) -> type[Any]:
    if isinstance(source, type):
        return source
    classes = _classes()
    if source not in classes:
        offer, _ = close_match_hint(source, classes)
        raise ParameterError(f"scipy.stats.qmc has no engine {source!r}.{offer}")
    return classes[source]
