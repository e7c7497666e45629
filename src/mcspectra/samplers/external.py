"""Point sets from outside: given arrays and files, callables, engines of scipy.stats.qmc."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any, ClassVar, TypeAlias, final

import numpy as np

from mcspectra.core.checks import Array, as_unit_points
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.pointfiles import read_points
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.spec import format_call
from mcspectra.core.streams import Stream
from mcspectra.samplers import _engines
from mcspectra.samplers.base import MAX_COUNT, Randomization, Sampler, check_dims

__all__ = ["FunctionSampler", "GivenPoints", "ScipySampler"]

Draw: TypeAlias = Callable[[int, np.random.Generator], object]
"""What makes one realisation: ``draw(n, generator)`` gives points (n, d) in [0,1)."""


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
        Number of coordinates; by default what the sets have, else it must agree with them.
    digest
        First 12 digits of the SHA-256 of shape and coordinates.

    Raises
    ------
    FileFormatError
        A file is not a point set.
    ParameterError
        Neither `path` nor `points`, or sets of different shapes.
    DomainError
        Points outside [0,1), not finite, or none.
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
        """Spec string by path; an array, which has none, shows its shape and digest."""
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
                f"{self.spec} holds {sets} realisation{'s' if sets != 1 else ''}, but number {first + count} was asked for; "
                "ask for fewer, give more sets, or let a randomisation such as '| shift' follow."
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
        """What was declared."""
        return self.unbiased_

    @property
    def spec(self) -> str:
        """Name of the callable: no spec string makes it again."""
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
    of any other engine it is not assumed.
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
            `engine` is none of these, or the arguments of an instance cannot be found out.
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
        """Spec string; of a class or factory that is not scipy's, only its name."""
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
