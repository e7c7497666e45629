"""Points from outside the package: given arrays and files, functions, and programs.

Functions and programs make one realization at a time, each with fresh randomness.
A spec that names code runs only if `allow_code` or the option ``--allow-code`` allows the code.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import signal
import subprocess
import tempfile
import threading
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_unit_points
from mcspectra.core.display import counted, needed
from mcspectra.core.errors import (
    CountError,
    FileFormatError,
    ParameterError,
    reason_of,
)
from mcspectra.core.fields import checked, flag, real, settle
from mcspectra.core.pointfiles import matching_files, parse_dat, read_points
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.spec import Call
from mcspectra.core.streams import Stream
from mcspectra.core.trust import CODE, allow, loaded_function, process_trust, words_of
from mcspectra.samplers._digital_kernels import all_balanced, leading_digits
from mcspectra.samplers._primes import power_from
from mcspectra.samplers.base import MAX_COUNT, Draw, Randomization, Sampler, repeated
from mcspectra.samplers.law import Fixed, Law, Unknown, bases_to_scramble

__all__ = [
    "PLACEHOLDER",
    "SEED_BITS",
    "CommandSampler",
    "FunctionSampler",
    "GivenPoints",
    "OneByOne",
    "PythonSampler",
    "allow_code",
    "allow_own_code",
    "as_label",
    "check_code",
    "net_quality",
    "printed_points",
    "qualified_name",
    "recognized",
]

PLACEHOLDER = re.compile(r"\{(\w*)\}")
"""Pattern of a placeholder of a command, such as {n}."""

_PLACEHOLDERS = ("n", "seed", "dims")
_COORDINATE_BYTES = 64  # largest number of bytes of a printed coordinate and its separator

SEED_BITS = 31
"""Number of bits of a seed for a program, which reads the seed as int."""

# Recognition of nets and lattices among given sets
_NET_BASES = (2, 3, 5)
# Least number of balanced elementary intervals in a set that counts as a net.
# In a set of fewer than `_FEW` points, intervals are often balanced by chance.
# Small sets therefore need more balanced intervals to count as a net.
_LEAST_CELLS, _LEAST_CELLS_OF_FEW = 8, 16
_FEW = 64
# Largest product of the number of points and the number of interval shapes in a test for nets.
# A test for nets of this size takes about a second.
_MOST_WORK = 2**26
_WORD = 53  # number of bits of a coordinate
_OFF_LATTICE = 0.01  # rounding tolerance of coordinates of a lattice, in units of 1/n

# Code that specs may name, because a Python class uses it or a trusted study allows it
_own: set[str] = set()


def as_label(name: str, given: object) -> str:
    """Return the given text of a field, after checking that the text is short and printable."""
    if isinstance(given, str) and len(given) <= 80 and given.isprintable():
        return given
    raise ParameterError(
        f"{name.rstrip('_')} is {given!r:.90}; give a text of at most 80 characters."
    )


class PointSets(dict[int, Array]):
    """Sets grouped by number of points, (R, n, d) each, and the laws of the sets."""

    @cached_property
    def laws(self) -> dict[int, Law]:
        """For each number of points, the law that was recognized from the sets.

        The largest set must pass a strict test to count as a net with some quality t.
        Smaller sets count as nets if their quality t is at most that of the largest set.
        """
        found: dict[int, Law] = {}
        largest: tuple[int, int] | None = None
        for n in sorted(self, reverse=True):
            nets = [net_quality(points, largest) for points in self[n]]
            known = [net for net in nets if net is not None]
            net = None
            if len(known) == len(nets) and len({base for base, _ in known}) == 1:
                net = max(known)
            if not found:
                largest = net
            sets, _, dims = self[n].shape
            bases = None if net is None else (net[0],) * dims
            if sets == 1:
                found[n] = recognized(self[n][0], bases)
            else:
                found[n] = Unknown(n=n, dims=dims, is_uniform=False, sets=sets, bases=bases)
        return found


@final
@dataclass(frozen=True, kw_only=True)
class GivenPoints(Sampler):
    """Given points: realization r is set r of an array or of point-set files.

    It is an error to draw more realizations than there are sets, or a count that no set has.
    Randomizations that make every point uniform (shift, digital-shift, owen) can reuse the sets.
    Each use of a set has new random numbers, so one set suffices for any number of realizations.

    Attributes
    ----------
    path
        File, files or folder (.dat, .bin, .npz, .npy, .csv) with the sets.
        Files are taken in the order of their names; numbers in names are sorted by value.
        The wildcards ``*`` and ``?`` match any characters of a file name.
        The placeholder ``{n}``, as in ``sets/n{n}_*.dat``, matches the number of points.
        The number in a file's name is then compared with the number of points in the file.
        If points are given, the path is only a name for them.
    points
        The sets, shape (R, n, d) or (n, d), in [0,1). They are copied and read-only.
        If sets have different numbers of points, `points` holds the sets with the fewest points.
    cycle
        Whether the R given sets are used cyclically: realization r is set r mod R.
        Without a randomization, more than R realizations only repeat the R given sets.
        The variance over any number of realizations then describes only the R given sets.
    dims
        Number of coordinates, by default as in the sets; a given number must agree with them.
    name_
        Label in pictures and tables: ``name=`` in a spec.
    sets
        All sets by number of points, (R, n, d) each.
        Digital nets in base 2, 3 or 5 are recognized, and so are lattices.
        Predictions and randomizations of digits use the recognized nets and lattices.
    digest
        First 12 digits of the SHA-256 of shapes and coordinates.

    Raises
    ------
    FileFormatError
        If a file is not a point set, or if no file matches a pattern.
        If the number n in the name of a file differs from its number of points.
    ParameterError
        If neither a path nor points are given, or sets have different dims.
    DomainError
        If points lie outside [0,1) or are not finite, or there are no points.
    """

    name: ClassVar[str] = "points"
    unbiased: ClassVar[bool] = False
    path: str | Sequence[str] = ()
    points: Array = field(default=None, repr=False, compare=False)  # type: ignore[arg-type]
    cycle: bool = flag(default=False)
    name_: str = checked(as_label, "")
    dims: int = None  # type: ignore[assignment]
    sets: PointSets = field(init=False, repr=False, compare=False)
    digest: str = field(init=False)

    def __post_init__(self) -> None:
        paths = _as_paths(self.path)
        given: Any = self.points  # None until the files are read
        dims: Any = self.dims
        if isinstance(given, dict):
            sets = given if isinstance(given, PointSets) else PointSets(given)
        elif given is not None:
            stack = _as_sets(given)
            sets = PointSets({stack.shape[1]: stack})
        elif paths:
            sets = PointSets(_by_count(_read(paths)))
        else:
            raise ParameterError("points needs a file: write points(path='file.dat').")
        first = next(iter(sets.values()))
        digest = hashlib.sha256()
        for stack in sets.values():
            digest.update(str(stack.shape).encode() + stack.astype("<f8").tobytes())
        settle(
            self,
            path=paths[0] if len(paths) == 1 else paths,
            points=first,
            sets=sets,
            dims=first.shape[2] if dims is None else dims,
            digest=digest.hexdigest()[:12],
        )
        Sampler.__post_init__(self)
        if self.dims != first.shape[2]:
            raise ParameterError(
                f"points are in {counted(first.shape[2], 'dim')}, but {needed(self.dims, 'dim')}."
            )

    @classmethod
    def from_array(cls, points: object) -> GivenPoints:
        """Make a sampler from an array of shape (R, n, d), or (n, d) for one set."""
        return cls(points=_as_sets(points))

    @classmethod
    def from_files(cls, *paths: str | PathLike[str]) -> GivenPoints:
        """Make a sampler from the sets of one or several files, folders or patterns, in order."""
        return cls(path=_as_paths(paths))

    @classmethod
    def from_sets(cls, sets: Iterable[object], name: str) -> GivenPoints:
        """Make a sampler from arrays (n, d); messages call their source `name`."""
        made: Any = _by_count([(name, points) for points in sets])
        return cls(path=name, points=made)

    @property
    def spec(self) -> str:
        """Spec string with the path; for an array, its shape and digest."""
        if not self.path:
            shape = "x".join(map(str, self.points.shape))
            return f"points(<array {shape}, SHA-256 {self.digest}>)"
        path = list(self.path) if isinstance(self.path, tuple) else self.path
        name = f", name={self.name_!r}" if self.name_ else ""
        return f"points(path={path!r}{', cycle=True' if self.cycle else ''}{name})"

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """Base in which the sets of every count are nets; 2 if there is none."""
        return bases_to_scramble(list(self.sets.laws.values())) or (2,) * self.dims

    def _law(self, n: int) -> Law:
        return self.sets.laws[n]

    @property
    def most_realizations(self) -> float:
        """Largest number of realizations that can be drawn for every available number of points.

        The number is infinite if sets may be reused.
        """
        return math.inf if self.cycle else min(map(len, self.sets.values()))

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream
        stack = self.sets[n]
        sets = len(stack)
        if first + count > sets and not self.cycle:
            of_n = f" of {n} points" if len(self.sets) > 1 else ""
            raise CountError(
                f"{self.spec} holds {sets} realization{'s' if sets != 1 else ''}{of_n}, but "
                f"{first + count} are needed; ask for fewer, give more sets, or add a "
                "randomization such as '| shift'."
            )
        return np.asarray(stack[np.arange(first, first + count) % sets])

    def _before(self, randomization: Randomization) -> Sampler:
        made: Any = self.sets
        return replace(self, cycle=True, points=made) if randomization.debiases else self

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        below = max((k for k in self.sets if k <= n), default=None)
        return below, min((k for k in self.sets if k >= n), default=2 * MAX_COUNT)


def net_quality(points: Array, like: tuple[int, int] | None = None) -> tuple[int, int] | None:
    """Return base and quality t of a digital net in base 2, 3 or 5; None for other sets (n, d).

    A (t, m, d)-net has b^m points: b^t points in each elementary interval of volume b^(t − m).
    Every set is a net for t = m, so a set counts as a net only if m − t is large enough.
    The difference m − t must be at least 3 in base 2, and at least 2 in bases 3 and 5.
    For sets of fewer than 64 points, m − t must be at least 4 in base 2, and 3 in base 3.
    A smaller set, whose m is below this limit, counts as a net only if its t is 0.
    If a larger set of the same file is a net, `like` is the base and the quality t of this net.
    With `like`, a set is a net in the larger set's base if its t is at most the larger set's t.
    Blue noise of 16 points or more is rarely taken for a net: in tests, at most 1 of 200 sets was.
    """
    n, dims = points.shape
    for base in _NET_BASES if like is None else (like[0],):
        places = power_from(n, base)
        if n == 1 or base**places != n:
            continue
        digits = leading_digits(points, base, places)
        level = 0
        while level < places and n * math.comb(level + dims, level + 1) <= _MOST_WORK:
            if not all_balanced(digits, base, places, level + 1):
                break
            level += 1
        cells = _LEAST_CELLS if n >= _FEW else _LEAST_CELLS_OF_FEW
        least = power_from(cells, base) if like is None else places - like[1]
        if level >= min(least, places):
            return base, places - level
    return None


def recognized(points: Array, bases: tuple[int, ...] | None) -> Fixed:
    """Return the law of one given set of points (n, d).

    The set is a net in the given bases, unless `bases` is None.
    The set is digital if its digits form a group.
    The set is a lattice if its differences form a group on the torus.
    """
    n, dims = points.shape

    # Test for a group of digits in base 2: XOR with the words of a basis must preserve the set
    digital = False
    if bases is not None and bases[0] == 2:
        words = np.rint(points * 2.0**_WORD).astype(np.uint64)
        words ^= words[0]
        digital = _is_group(words, np.bitwise_xor, lambda row, _: np.stack([0 * row, row, 0 * row]))

    # Test for a lattice: n times the differences must be whole numbers and a group modulo n
    steps = n * (points - points[0])
    even = n > 1 and bool((np.abs(steps - np.rint(steps)) <= _OFF_LATTICE).all())
    vector: tuple[int, ...] | None = None
    if even:
        rows = (np.rint(steps).astype(np.int64) % n).astype(np.uint64)
        even = _is_group(
            rows,
            lambda a, b: (a + b) % np.uint64(n),
            lambda row, count: np.arange(count, dtype=np.uint64)[:, None] * row % np.uint64(n),
        )
        # If the origin is a point of the lattice, find a point whose multiples are all points
        orders = n // np.gcd(n, np.gcd.reduce(rows.astype(np.int64), axis=1))
        if even and orders.max() == n and (points == 0.0).all(axis=1).any():
            vector = tuple(rows[int(np.argmax(orders))].tolist())
    return Fixed(n=n, dims=dims, bases=bases, digital=digital, even=even, vector=vector)


def _is_group(
    rows: Array,
    add: Callable[[Array, Array], Array],
    multiples: Callable[[Array, int], Array],
) -> bool:
    """Return whether distinct rows of integers (n, d) are closed under `add`; one row must be 0.

    ``multiples(row, count)`` are 0, row, row + row, … as an array (count, d).
    """
    count, dims = rows.shape
    weights = np.random.default_rng(0).integers(1, 2**63, dims, np.uint64) | np.uint64(1)

    def hashed(some: Array) -> Array:
        # Mix high bits into low ones first, because digits of nets occupy high bits only
        mixed = (some ^ (some >> np.uint64(31))) * weights
        return np.asarray((mixed ^ (mixed >> np.uint64(32))).sum(axis=-1, dtype=np.uint64))

    known = np.unique(hashed(rows))
    if len(known) < count:
        return False
    # Extend a subgroup by a missing row until the subgroup contains all rows
    group = np.zeros((1, dims), np.uint64)
    while len(group) < count:
        new = rows[~np.isin(hashed(rows), hashed(group))][0]
        powers = multiples(new, count // len(group) + 1)
        back = np.flatnonzero(np.isin(hashed(powers[1:]), hashed(group)))
        if not len(back):
            return False
        powers = powers[: back[0] + 1]
        group = add(powers[:, None], group[None]).reshape(-1, dims)
        if not np.isin(hashed(group), known).all():
            return False
    return True


def _as_paths(given: object) -> tuple[str, ...]:
    paths = (given,) if isinstance(given, str | PathLike) else given
    if isinstance(paths, Sequence) and all(isinstance(p, str | PathLike) for p in paths):
        return tuple(map(str, paths))
    raise ParameterError(f"path is {given!r}; give the name of a file, or a list of names.")


def _read(paths: Sequence[str]) -> Iterator[tuple[str, Array]]:
    """Yield all sets of all files in order, with file names; check the n in a file's name."""
    for file, n in (found for path in paths for found in matching_files(path)):
        for points in read_points(file):
            if n is not None and len(points) != n:
                raise FileFormatError(
                    f"{file} has a set of {len(points)} points, but n is {n} in its name; "
                    "correct the file, or write '*' for '{n}'."
                )
            yield str(file), points


def _by_count(sets: Iterable[tuple[str, object]]) -> dict[int, Array]:
    """Stack named sets (n, d) by ascending n, as arrays (R, n, d); all need the same dims."""
    found: dict[int, list[Array]] = {}
    dims = None
    for k, (name, given) in enumerate(sets):
        points = as_unit_points(given, name=f"The points of {name}")
        dims = points.shape[-1] if dims is None else dims
        if points.shape[-1] != dims:
            raise ParameterError(
                f"Set {k + 1} (of {name}) is in {counted(points.shape[-1], 'dim')}, "
                f"but the first in {dims}; all sets of a sampler need the same dims."
            )
        found.setdefault(len(points), []).append(points)
    if not found:
        # If there are no points, the function `_as_sets` raises an error
        return {0: _as_sets([])}
    return {n: _as_sets(np.stack(found[n])) for n in sorted(found)}


def _as_sets(given: object) -> Array:
    """Return a read-only copy of shape (R, n, d)."""
    points = as_unit_points(given)
    if points.ndim not in (2, 3):
        raise ParameterError(
            f"points have shape {points.shape}; give (n, d), or (R, n, d) for R realizations."
        )
    sets = np.array(points if points.ndim == 3 else points[None], order="C")
    sets.flags.writeable = False
    return sets


class OneByOne(Sampler):
    """A sampler whose realizations are made one at a time, by external code."""

    @abstractmethod
    def make_one(self, n: int, stream: Stream, realization: int) -> object:
        """Make realization number `realization`: points (n, dims)."""

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        if self.fixed:
            return repeated(self._checked(n, self.make_one(n, stream, 0)), count)
        made = (self.make_one(n, stream, first + k) for k in range(count))
        return np.stack([self._checked(n, each) for each in made])

    def _checked(self, n: int, made: object) -> Array:
        points = as_unit_points(made, name=f"The points of {self.spec}")
        if points.ndim == 2 and points.shape[1] == self.dims and len(points) < n:
            raise CountError(
                f"{self.spec} returned {len(points)} of {n} points; ask for fewer or change "
                "its parameters."
            )
        if points.shape != (n, self.dims):
            own = points.ndim == 2 and points.shape[1] != self.dims
            raise ParameterError(
                f"{self.spec} returned shape {points.shape}; {(n, self.dims)} is needed"
                + (
                    f": its points are in {points.shape[1]} dims, write dims={points.shape[1]}."
                    if own
                    else "."
                )
            )
        return points

    @contextmanager
    def refusals_named(self, n: int, *kinds: type[BaseException]) -> Iterator[None]:
        """Convert exceptions to a CountError that names the sampler, `n` and the reason."""
        try:
            yield
        except kinds as error:
            raise CountError(
                f"{self.spec} cannot make {n} points: {reason_of(error, 200)}."
            ) from error


class _OfCode(OneByOne):
    """A sampler of the user's code; `unbiased_` declares whether every point is uniform."""

    unbiased_: bool

    @property
    def unbiased(self) -> bool:  # type: ignore[override]
        """Whether points are declared as uniform; False for a set that is always the same."""
        return self.unbiased_ and not self.fixed


@final
@dataclass(frozen=True, kw_only=True)
class FunctionSampler(_OfCode):
    """A callable ``draw(n, generator) -> (n, d)``, called once per realization.

    Attributes
    ----------
    function
        The callable. All its randomness must come from the generator.
        Each realization has a fresh, reproducible generator. Threads may call it concurrently.
    dims
        Number of coordinates of the returned points.
    unbiased_
        Whether each point, taken alone, is uniform on [0,1)^d.
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
    def spec(self) -> str:
        """Name of the callable, because no spec string can describe a callable."""
        return f"function({qualified_name(self.function)})"

    def make_one(self, n: int, stream: Stream, realization: int) -> object:
        """Call the function."""
        return self.function(n, stream.generator(realization))


@final
@dataclass(frozen=True, kw_only=True)
class PythonSampler(_OfCode):
    """A Python function ``draw(n, generator) -> (n, d)`` by its name, called once per realization.

    Attributes
    ----------
    function
        The name as ``module:function``. Modules are found on Python's path (PYTHONPATH).
        The function gets n and a random generator, as in `FunctionSampler`.
    dims
        Number of coordinates of the returned points.
    unbiased_
        Whether each point, taken alone, is uniform on [0,1)^d: ``unbiased=`` in a spec.
    name_
        Label in pictures and tables: ``name=`` in a spec.

    Raises
    ------
    ParameterError
        If the name has another form, cannot be imported, or is not a function.
    CountError
        If the function raises an exception, or returns fewer points than requested.
    ConfigError
        If a spec names the function and it is not allowed (`allow_code`).
    """

    name: ClassVar[str] = "python"
    function: str
    dims: int = DEFAULT_DIMS
    unbiased_: bool = flag(default=True)
    name_: str = checked(as_label, "")

    def _check(self) -> None:
        loaded_function(self.function)
        allow_own_code(self.function)

    def make_one(self, n: int, stream: Stream, realization: int) -> object:
        """Call the function."""
        function = loaded_function(self.function)
        with self.refusals_named(n, Exception, SystemExit):
            return function(n, stream.generator(realization))


@final
@dataclass(frozen=True, kw_only=True)
class CommandSampler(_OfCode):
    """A program that prints points, one per line, run once per realization.

    Attributes
    ----------
    run
        Program and arguments; no shell is used. There are three placeholders:
        ``{n}`` stands for the number of points, and ``{dims}`` for the number of dims.
        ``{seed}`` stands for the seed of the realization, a whole number from 0 to 2^31 − 1.
        Without ``{seed}``, the program prints the same set for all realizations.
        The program then runs only once for each call of `draw`.
    dims
        Number of coordinates that the program prints per point, separated by blanks or commas.
    timeout
        Seconds after which the program is stopped.
    unbiased_
        Whether each point, taken alone, is uniform on [0,1)^d: ``unbiased=`` in a spec.
        Without ``{seed}`` points do not count as uniform.
    name_
        Label in pictures and tables: ``name=`` in a spec.

    Raises
    ------
    ParameterError
        If the program does not exist, takes too long, fails, or prints other points than requested.
    FileFormatError, DomainError
        If the program prints something other than finite numbers, or points outside [0,1).
    ConfigError
        If a spec names the program and it is not allowed (`allow_code`).
    """

    name: ClassVar[str] = "command"
    run: str
    dims: int = DEFAULT_DIMS
    timeout: float = real(60.0, above=0.0)
    unbiased_: bool = flag(default=True)
    name_: str = checked(as_label, "")

    def _check(self) -> None:
        if not words_of(self.run):
            raise ParameterError(
                f"command(run={self.run!r:.80}): write a program and its arguments, as in "
                "'./mine {n} {seed}', with quotes closed."
            )
        unknown = [name for name in PLACEHOLDER.findall(self.run) if name not in _PLACEHOLDERS]
        if unknown:
            raise ParameterError(
                f"command(run={self.run!r:.80}): {{{unknown[0]}}} stands for nothing; use {{n}}, "
                "{seed} or {dims}."
            )
        allow_own_code(self.run)

    @property
    def fixed(self) -> bool:  # type: ignore[override]
        """Whether the program gets no seed."""
        return "{seed}" not in self.run

    def make_one(self, n: int, stream: Stream, realization: int) -> object:
        """Run the program and read its output."""
        seed = int(stream.keys(realization, 1)[0, 0]) >> (64 - SEED_BITS)
        values = {"n": n, "seed": seed, "dims": self.dims}
        return printed_points(self, values, n, f"n = {n}")


def printed_points(sampler: Any, values: Mapping[str, int], count: int, place: str) -> Array:
    """Run the program of a sampler, and return the points (k, dims) that it prints.

    Parameters
    ----------
    sampler
        A sampler or other component with the fields run, dims and timeout.
    values
        Values of the placeholders.
    count
        Number of points that the program should print; a much longer output is an error.
    place
        The values of the placeholders in words, for messages.

    Raises
    ------
    ParameterError
        If the program does not exist, takes too long, fails, or prints too much.
    FileFormatError
        If the program prints something other than finite numbers, or sets of different dims.
    """
    words = [
        PLACEHOLDER.sub(lambda found: str(values[found[1]]), word) for word in words_of(sampler.run)
    ]
    most = 4096 + count * sampler.dims * _COORDINATE_BYTES
    text = _output_of(words, most, sampler.timeout, sampler.spec)
    name = f"The output of {sampler.spec} at {place}"
    sets = parse_dat(text.replace(",", " "), name)
    if len({points.shape[1] for points in sets}) > 1:
        raise FileFormatError(f"{name} has sets of different dims; print one set.")
    return np.concatenate(sets)


def _output_of(words: Sequence[str], most: int, timeout: float, spec: str) -> str:
    """Return the output of a program, at most `most` bytes, and end all its processes."""
    late = threading.Event()

    with tempfile.TemporaryFile() as errors:
        try:
            process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=errors,
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or reason_of(error, 200)
            raise ParameterError(
                f"{spec}: the program {words[0]!r} cannot be run: {reason}; "
                "compile it, or give its path."
            ) from None

        def end() -> None:
            with suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL)

        def stop() -> None:
            late.set()
            end()

        timer = threading.Timer(timeout, stop)
        timer.start()
        assert process.stdout is not None
        try:
            data = process.stdout.read(most + 1)
            if len(data) > most:
                raise ParameterError(
                    f"{spec} printed more than {most} bytes; it must print one point per "
                    "line, and only the requested number of points."
                )
            code = process.wait()
        finally:
            timer.cancel()
            end()
            process.stdout.close()
            process.wait()
        if late.is_set():
            raise ParameterError(
                f"{spec} took more than {timeout:g} s; ask for fewer points, or set timeout=."
            )
        if code:
            errors.seek(max(0, errors.seek(0, os.SEEK_END) - 4096))
            lines = errors.read().decode(errors="replace").strip().splitlines()
            said = reason_of(ValueError(lines[-1]), 200) if lines else "it printed no reason"
            how = f"exit code {code}" if code > 0 else f"signal {-code}"
            raise ParameterError(f"{spec} ended with {how}: {said}.")
    return data.decode(errors="replace")


def allow_code(*names: str) -> None:
    """Allow specs of this process to run the named code: whole commands, programs, or functions.

    The name ``'./mine {n} {seed}'`` allows the spec ``command('./mine {n} {seed}')``.
    The name ``'./mine'`` allows this program with any arguments.
    The name ``'module:function'`` allows the spec ``python('module:function')``.
    Samplers that are made from their classes in Python need no permission.
    Once a sampler is made from its class, its spec is also allowed.

    Raises
    ------
    ConfigError
        If a name is neither a whole command, nor a program, nor a function ``'module:function'``.
    """
    allow(code=names)


def allow_own_code(name: str) -> None:
    """Allow specs to run code that a Python class, or the `Trust` of a study, already allows."""
    _own.add(name)


def check_code(call: Call) -> None:
    """Raise an error if a part of a spec names code that this process may not run.

    Raises
    ------
    ConfigError
        If the code is not allowed; the message explains how to allow it.
    """
    text = call.arguments.get(CODE.get(call.name, ""))
    if not (isinstance(text, str) and text in _own):
        process_trust().check_code(call)


def qualified_name(thing: object) -> str:
    """Return module and name of a class or function, without an address in memory."""
    named = thing if hasattr(thing, "__qualname__") else type(thing)
    return thing if isinstance(thing, str) else f"{named.__module__}.{named.__qualname__}"
