"""Generators of QMCPy (`qmcpy.discrete_distribution`) as samplers."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_unit_points
from mcspectra.core.errors import (
    CountError,
    MissingDependency,
    ParameterError,
    close_match_hint,
)
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.spec import format_call
from mcspectra.core.streams import Stream
from mcspectra.samplers.base import MAX_COUNT, Sampler, check_dims

__all__ = ["QmcpySampler", "is_qmcpy"]

_ONE = np.nextafter(1.0, 0.0)
_OURS = ("dimension", "replications", "seed")
_UNIFORM = ("TRUE", "SHIFT", "DS", "LMS DS", "DP", "LMS DP", "NUS")
_NOT_POINTS = ("DummySampler", "MPMC")


@final
@dataclass(frozen=True, kw_only=True)
class QmcpySampler(Sampler):
    """A generator of QMCPy, made anew for each realisation with a seed of its own.

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
        object.__setattr__(self, "generator", _as_source(self.generator))
        for name in self.options:
            if name in _OURS:
                raise ParameterError(
                    f"{name} is not an option of a generator here; give rng= and realizations= "
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
            `generator` is none of these, or does not take the arguments.
        MissingDependency
            QMCPy is not installed.
        """
        options = dict(arguments)
        given = [options.pop(key) for key in ("dimension", "dims") if key in options]
        if len(given) > 1:
            raise ParameterError("dimension and dims are the same; give one of them.")
        if isinstance(generator, _base()):
            given = given or [generator.d]
            if options:
                raise ParameterError(
                    f"A generator has its arguments already; give its class, "
                    f"{type(generator).__name__}, to set {', '.join(options)}."
                )
        dims = as_integer("dimension", given[0] if given else DEFAULT_DIMS, least=1)
        return cls(generator=generator, dims=dims, options=options)

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether every point is known to be uniform."""
        made = self._pattern
        if type(made).__name__ == "IIDStdUniform":
            return True
        known = type(made).__module__.startswith("qmcpy.")
        return known and str(getattr(made, "randomize", "")).upper() in _UNIFORM

    @property
    def max_count(self) -> int:  # type: ignore[override]
        """The generator's limit."""
        limit = self._pattern.n_limit
        return MAX_COUNT if limit > MAX_COUNT else int(limit)

    @property
    def spec(self) -> str:
        """Spec string; of an instance, or a class that is not QMCPy's, what it says of itself."""
        if isinstance(self.generator, str):
            return format_call(self)
        made = self._pattern
        parameters = {name: getattr(made, name, None) for name in made.parameters}
        shown = ", ".join(f"{name}={value!r}" for name, value in parameters.items())
        return f"qmcpy(generator=<{type(made).__name__}({shown})>)"

    @cached_property
    def _pattern(self) -> Any:
        """One generator, to ask what it is and can do."""
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
        points[points == 1.0] = _ONE
        points = as_unit_points(points, name=f"The points of {self.spec}")
        if points.shape != (n, self.dims):
            raise ParameterError(
                f"{self.spec} returned shape {points.shape}; {(n, self.dims)} is needed."
            )
        return points

    def _fresh(self, seed: np.random.SeedSequence) -> Any:
        source = self.generator
        if isinstance(source, _base()):
            return _spawned(source, seed)
        return _made(_classes()[source] if isinstance(source, str) else source, self, seed)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        if getattr(self._pattern, "order", "") != "RADICAL INVERSE":
            return n, n
        below: int = 2 ** (n.bit_length() - 1)
        return below, n if below == n else 2 * below


def is_qmcpy(source: object) -> bool:
    """Whether this is a generator of QMCPy or a class of them; nobody has one without importing it."""
    base = getattr(sys.modules.get("qmcpy"), "AbstractDiscreteDistribution", None)
    if base is None:
        return False
    return isinstance(source, base) or (isinstance(source, type) and issubclass(source, base))


def _as_source(generator: object) -> Any:
    """Return a class of QMCPy as its name; check any other class, name or instance."""
    classes = _classes()
    if isinstance(generator, str):
        if generator not in classes:
            offer, _ = close_match_hint(generator, classes)
            raise ParameterError(f"qmcpy has no generator {generator!r}.{offer}")
        return generator
    if isinstance(generator, type) and issubclass(generator, _base()):
        return next((name for name, cls in classes.items() if cls is generator), generator)
    if isinstance(generator, _base()):
        return generator
    raise ParameterError(
        f"{generator!r} is no generator; give a name in qmcpy such as 'DigitalNetB2', an "
        "AbstractDiscreteDistribution, or its class."
    )


def _made(cls: type[Any], sampler: QmcpySampler, seed: np.random.SeedSequence) -> Any:
    """Make a generator; its warnings, of which it has many, stay off unless asked for."""
    parameters = inspect.signature(cls).parameters
    given = {"dimension": sampler.dims, "replications": None, "seed": seed, "warn": False}
    own = {name: value for name, value in given.items() if name in parameters}
    try:
        return cls(**{**own, **sampler.options})
    except Exception as error:  # QMCPy has its own kinds, and bare assertions
        shown = ", ".join(f"{k}={v!r}" for k, v in sampler.options.items())
        reason = str(error).rstrip(".")[:200] or "it refuses them without a reason"
        raise ParameterError(
            f"{cls.__name__} cannot be made in {sampler.dims} dims with {shown or 'its defaults'}: "
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
        raise ParameterError(f"This {name} cannot be made anew: {reason}.") from error


def _base() -> Any:
    return _qmcpy().AbstractDiscreteDistribution


def _classes() -> dict[str, type[Any]]:
    """The generators that QMCPy names, by name."""
    return {
        name: thing
        for name, thing in vars(_qmcpy()).items()
        if isinstance(thing, type)
        and issubclass(thing, _base())
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
