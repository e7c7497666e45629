"""Generators of QMCPy (`qmcpy.discrete_distribution`): their classes by name, fresh ones to order."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from mcspectra.core.errors import MissingDependency, ParameterError, close_match_hint

__all__ = ["as_source", "fresh", "generator_class", "is_qmcpy", "is_uniform"]

_UNIFORM = ("TRUE", "SHIFT", "DS", "LMS DS", "DP", "LMS DP", "NUS")
_NOT_POINTS = ("DummySampler", "MPMC")


def is_qmcpy(source: object) -> bool:
    """Whether this is a generator of QMCPy or a class of them; nobody has one without importing it."""
    base = getattr(sys.modules.get("qmcpy"), "AbstractDiscreteDistribution", None)
    if base is None:
        return False
    return isinstance(source, base) or (isinstance(source, type) and issubclass(source, base))


def as_source(generator: object) -> Any:
    """Return a class of QMCPy as its name; check any other class, name or instance."""
    classes = _classes()
    if isinstance(generator, str):
        if generator not in classes:
            offer, _ = close_match_hint(generator, classes)
            raise ParameterError(f"qmcpy has no generator {generator!r}.{offer}")
        return generator
    if isinstance(generator, type) and issubclass(generator, generator_class()):
        return next((name for name, cls in classes.items() if cls is generator), generator)
    if isinstance(generator, generator_class()):
        return generator
    raise ParameterError(
        f"{generator!r} is not a generator; give a name in qmcpy such as 'DigitalNetB2', an "
        "AbstractDiscreteDistribution, or its class."
    )


def fresh(source: Any, dims: int, options: Mapping[str, Any], seed: np.random.SeedSequence) -> Any:
    """Make a generator of a class or its name, or a copy of one, with a seed of its own."""
    if isinstance(source, generator_class()):
        return _spawned(source, seed)
    cls = _classes()[source] if isinstance(source, str) else source
    return _made(cls, dims, options, seed)


def is_uniform(made: Any) -> bool:
    """Whether every point of a generator is known to be uniform."""
    if type(made).__name__ == "IIDStdUniform":
        return True
    known = type(made).__module__.startswith("qmcpy.")
    return known and str(getattr(made, "randomize", "")).upper() in _UNIFORM


def generator_class() -> Any:
    """Base class of all generators.

    Raises
    ------
    MissingDependency
        QMCPy is not installed.
    """
    return _qmcpy().AbstractDiscreteDistribution


def _made(
    cls: type[Any], dims: int, options: Mapping[str, Any], seed: np.random.SeedSequence
) -> Any:
    """Make a generator; its warnings, of which it has many, stay off unless asked for."""
    parameters = inspect.signature(cls).parameters
    given = {"dimension": dims, "replications": None, "seed": seed, "warn": False}
    own = {name: value for name, value in given.items() if name in parameters}
    try:
        return cls(**{**own, **options})
    except Exception as error:  # QMCPy has its own kinds, and bare assertions
        shown = ", ".join(f"{k}={v!r}" for k, v in options.items())
        reason = str(error).rstrip(".")[:200] or "it refuses them without a reason"
        raise ParameterError(
            f"{cls.__name__} cannot be made in {dims} dims with {shown or 'its defaults'}: "
            f"{reason}."
        ) from error


def _spawned(generator: Any, seed: np.random.SeedSequence) -> Any:
    """Make a fresh copy of a generator, as its own ``spawn`` does."""
    name = type(generator).__name__
    if not generator.no_replications or list(generator.dvec) != list(range(generator.d)):
        raise ParameterError(
            f"This {name} has replications or chosen dimensions; make one with dimension=d alone."
        )
    try:
        return generator._spawn(seed, generator.d)
    except Exception as error:
        reason = str(error).rstrip(".")[:200]
        raise ParameterError(f"This {name} cannot be copied: {reason}.") from error


def _classes() -> dict[str, type[Any]]:
    """The generators that QMCPy names, by name."""
    return {
        name: thing
        for name, thing in vars(_qmcpy()).items()
        if isinstance(thing, type)
        and issubclass(thing, generator_class())
        and not name.startswith("Abstract")
        and name not in _NOT_POINTS
    }


def _qmcpy() -> Any:
    if importlib.util.find_spec("qmcpy") is None:
        raise MissingDependency(
            "Generators of QMCPy need the package qmcpy; install it with: "
            "pip install 'mcspectra[qmcpy]'"
        )
    import qmcpy

    return qmcpy
