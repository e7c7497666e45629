"""The interface of samplers and randomizations.

A sampler draws realizations of a point set.
A randomization changes the points of another sampler.
The method `then` of a sampler appends a randomization.
Subclasses implement the drawing of points and declare their properties.
The base classes handle checks, seeds and shapes.
"""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from os import PathLike
from typing import ClassVar, TypeAlias, final

import numpy as np

from mcspectra import samplers
from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import CountError, NotPowerOfTwoWarning, ParameterError, warn
from mcspectra.core.fields import settle
from mcspectra.core.spec import Component
from mcspectra.core.streams import RngLike, Stream
from mcspectra.samplers.law import Fixed, Law, Unknown

__all__ = [
    "FIRST_STEP",
    "MAX_COUNT",
    "FixedSet",
    "PlaneSampler",
    "Randomization",
    "Randomized",
    "Sampler",
    "Structure",
    "repeated",
]

MAX_COUNT = 2**31
"""Largest number of points per realization, and of float64 values per call of `draw` (16 GiB)."""

FIRST_STEP = 1 << 16
"""Label of the random stream of the first randomization; samplers may use lower labels."""

_MOST_STEPS = 32

Draw: TypeAlias = Callable[[int, np.random.Generator], object]
"""Function that makes one realization: ``draw(n, generator)`` gives points (n, d) in [0,1)."""


class Structure(Enum):
    """The structure that makes a point set better than random; randomizations must preserve it."""

    NONE = "independent points"
    UNKNOWN = "points from outside"
    STRATA = "strata"
    DIGITS = "elementary intervals"
    TORUS = "distances and differences on the torus"


class Sampler(Component, ABC):
    """A randomized point set on [0,1)^d.

    Attributes
    ----------
    dims
        Number of dimensions d.
    unbiased
        Whether a point picked at random is uniform on [0,1)^d, so that estimates have no bias.
    fixed
        Whether all realizations are the same set.
    structure
        The structure that randomizations of this sampler must preserve.
    sequence
        Whether the first k of n points are the set of k points, and well distributed for every k.
    antithetic
        Whether points come in pairs that are reflected through the center of a cell.
    independent
        Whether the realizations of a seed are independent.
    min_dims, max_dims, max_count
        Smallest and largest number of dims, and largest number of points.
        Larger sets would take too much time or memory.
        In error messages, the text `other_dims` advises what to use for other dims.
        The text `cost_of_more` gives the reason why larger sets are not allowed.
    scrambles
        Number of built-in randomizations, such as owen in ``halton(scramble='owen')``.
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
    cost_of_more: ClassVar[str] = ""
    scrambles: ClassVar[int] = 0

    def __post_init__(self) -> None:
        least, most = self.min_dims, self.max_dims
        try:
            settle(self, dims=as_integer("dims", self.dims, least=least, most=most or 2**16))
        except ParameterError as error:
            found = str(error).rstrip(".")
            only = f"dims is {self.dims!r}; it must be {least}" if least == most else found
            advice = f", {self.other_dims}" if self.other_dims else ""
            raise ParameterError(f"{self.name}: {only}{advice}.") from None
        super().__post_init__()

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """Base of the digits of each coordinate, for randomizations of digits; 2 by default."""
        return (2,) * self.dims

    @property
    def powers_only(self) -> bool:
        """Whether randomizations of digits keep the structure only if n is a power of the base."""
        return self.structure is Structure.STRATA

    def digit_strata(self, n: int, base: int) -> bool:
        """Whether the number of points and the sides of the strata are powers of `base`."""
        del n, base
        return True

    def draw(self, n: int, *, realizations: int = 1, rng: RngLike = None, first: int = 0) -> Array:
        """Draw realizations first … first + realizations − 1 of a set of `n` points.

        Parameters
        ----------
        n
            Number of points in a realization.
        realizations
            Number of realizations.
        rng
            Seed, generator or None, as in SPEC 7 of Scientific Python.
            Realization r of a seed is the same in every call.
        first
            Number of the first realization.

        Returns
        -------
        ndarray
            float64, shape (realizations, n, dims), in [0,1).

        Raises
        ------
        CountError
            If the sampler cannot make `n` points; the message names the nearest counts.
        """
        n = self.check_count(n)
        count = as_integer("realizations", realizations, least=1)
        start = as_integer("first", first, least=0, most=2**62)
        if n * count * self.dims > MAX_COUNT:
            raise CountError(
                f"{count} realizations of {n} points in {self.dims} dims are "
                f"{n * count * self.dims:.3g} numbers; draw at most {MAX_COUNT:.3g} at a time, "
                "in several calls with first=."
            )
        return self._points(n, Stream.from_rng(rng), start, count)

    def draw_stream(self, n: int, stream: Stream, first: int, count: int) -> Array:
        """Draw `count` realizations for the inner loops of estimators, without a check of `n`."""
        return self._points(n, stream, first, count)

    def law(self, n: int) -> Law:
        """Return the joint distribution of the points of one realization of `n` points.

        All predictions follow from this joint distribution, the law of the sampler.
        Predictions are closed forms of spectra and covariances, exact variances, and rates.
        A prediction is refused if the law is not known well enough.
        See `mcspectra.samplers.law`.

        Raises
        ------
        CountError
            If the sampler cannot make `n` points.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotPowerOfTwoWarning)
            n = self.check_count(n)
        law = self._law(n)
        return law if law.source is not None else law.of(self)

    def _law(self, n: int) -> Law:
        """Return the joint distribution of `n` points, by default from the declared properties."""
        bases = self.digit_bases if self.structure is Structure.DIGITS else None
        if not self.fixed:
            return Unknown(n=n, dims=self.dims, is_uniform=self.unbiased, bases=bases)
        return Fixed(n=n, dims=self.dims, bases=bases)

    @property
    def plain(self) -> Sampler:
        """The sampler without its randomizations."""
        return self

    @property
    def randomizations(self) -> tuple[Randomization, ...]:
        """The randomizations of the plain sampler, in the order of application."""
        return ()

    def as_chain(self, n: int) -> Sampler:  # noqa: ARG002
        """Return an equivalent sampler for n points, whose randomizations are separate steps.

        If no equivalent sampler of this form exists, the sampler itself is returned.
        """
        return self

    @property
    def most_realizations(self) -> float:
        """Largest number of realizations that can be drawn; finite only for given points."""
        return math.inf

    def check_count(self, n: object) -> int:
        """Return `n` as an int if this sampler can make `n` points, else raise CountError."""
        try:
            count = as_integer("n", n, least=1, most=MAX_COUNT)
        except ParameterError as error:
            raise CountError(error) from None
        if count > self.max_count:
            cost = f" ({self.cost_of_more})" if self.cost_of_more else ""
            raise CountError(
                f"{self.spec} makes at most {self.max_count} points, not {count}{cost}; ask for "
                "fewer, or use a sampler that needs no optimization.",
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
        """Return the count nearest to `n` that this sampler can make (the lower count on a tie)."""
        count = min(as_integer("n", n, least=1, most=MAX_COUNT), self.max_count)
        options = [c for c in self._counts_near(count) if c is not None and c <= self.max_count]
        return min(options, key=lambda c: (abs(c - count), c))

    def then(self, randomization: Randomization) -> Sampler:
        """Return this sampler with `randomization` applied to every realization."""
        if not isinstance(randomization, Randomization):
            raise ParameterError(f"{randomization!r} is not a randomization; use e.g. Shift().")
        fitted = randomization.fit(self)
        base, steps = self.plain, self.randomizations
        if len(steps) == _MOST_STEPS:
            raise ParameterError(
                f"{base.spec} already has {_MOST_STEPS} randomizations, the most allowed; "
                "leave the others out."
            )
        return Randomized(base=base._before(fitted), steps=(*steps, fitted))

    @abstractmethod
    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        """Make realizations first … first + count − 1: float64 (count, n, dims)."""

    def _before(self, randomization: Randomization) -> Sampler:
        """Return the sampler that `randomization` is applied to: by default, this sampler itself.

        A sampler of given sets may return a version of itself that uses each set repeatedly.
        """
        del randomization
        return self

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        """Return the largest allowed count ≤ n (None if there is none) and the smallest ≥ n."""
        return n, n

    def _count_warning(self, n: int) -> str | None:
        """Return a warning if `n` points are allowed but not recommended, else None."""
        del n
        return None

    @staticmethod
    def from_points(points: object) -> Sampler:
        """Make a sampler of given points, shape (R, n, d) or (n, d); realization r is points[r]."""
        return samplers.GivenPoints.from_array(points)

    @staticmethod
    def from_files(*paths: str | PathLike[str]) -> Sampler:
        """Make a sampler from point files, folders or patterns, taken in order: `GivenPoints`."""
        return samplers.GivenPoints.from_files(*paths)

    @staticmethod
    def from_function(draw: Draw, *, dims: int, unbiased: bool = True) -> Sampler:
        """Make a sampler from a callable ``draw(n, generator) -> (n, d)``, points in [0,1)."""
        return samplers.FunctionSampler(function=draw, dims=dims, unbiased_=unbiased)

    @staticmethod
    def from_command(run: str, *, dims: int, unbiased: bool = True) -> Sampler:
        """Make a sampler from a program such as ``./mine {n} {seed}``; see `CommandSampler`."""
        return samplers.CommandSampler(run=run, dims=dims, unbiased_=unbiased)

    @staticmethod
    def from_scipy(engine: object, **arguments: object) -> Sampler:
        """Make a sampler from an engine of scipy.stats.qmc, its class, or a function of ``rng``."""
        return samplers.ScipySampler.from_engine(engine, **arguments)

    @staticmethod
    def from_qmcpy(generator: object, **arguments: object) -> Sampler:
        """Make a sampler from a QMCPy generator: an instance, a class with arguments, or a name."""
        return samplers.QmcpySampler.from_generator(generator, **arguments)


@dataclass(frozen=True, kw_only=True)
class PlaneSampler(Sampler):
    """Abstract sampler of points in two dimensions only."""

    min_dims: ClassVar[int] = 2
    max_dims: ClassVar[int | None] = 2
    dims: int = 2


class FixedSet(Sampler):
    """Abstract sampler that returns the same points every time; implementations write `_set`."""

    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True

    @abstractmethod
    def _set(self, n: int) -> Array:
        """Make the set of `n` points: a new array, float64 (n, dims)."""

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first
        points = self._set(n)
        return points[None] if count == 1 else repeated(points, count)


class Randomization(Component, ABC):
    """A random change of the points of a sampler."""

    stationary: ClassVar[bool] = False
    """Whether the randomized set has the same law after any translation of the torus."""
    debiases: ClassVar[bool] = False
    """Whether every randomized point is uniform, whatever its law was before."""
    fixed: ClassVar[bool] = False
    """Whether the realizations remain identical if all input realizations are identical."""
    pointwise: ClassVar[bool] = False
    """Whether each point moves independently of the others, so that sequences remain sequences."""
    independent: ClassVar[bool] = True
    """Whether the randomizations of different realizations are independent."""
    fits: ClassVar[Mapping[Structure, Structure]] = {s: s for s in Structure}
    """Map from each structure that the randomization accepts to the structure that remains."""

    @abstractmethod
    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Return new points (count, n, d) in [0,1) for realizations first … first + count − 1."""

    def law_of(self, law: Law, n: int) -> Law:
        """Return the law of `n` randomized points, given the law before the randomization."""
        return Unknown(n=n, dims=law.dims, is_uniform=law.uniform or self.debiases)

    def count_inside(self, sampler: Sampler, n: int) -> int:  # noqa: ARG002
        """Return how many points `sampler` must draw to get `n` randomized points."""
        return n

    def fit(self, sampler: Sampler) -> Randomization:
        """Return this randomization adapted to `sampler`, for instance to the base of its digits.

        Raises
        ------
        ParameterError
            If the randomization would break the sampler's structure; the message names another one.
        """
        if sampler.structure not in self.fits:
            digits = ", digital-shift or owen" if sampler.structure is Structure.DIGITS else ""
            raise ParameterError(
                f"{self.name} would break the {sampler.structure.value} of {sampler.spec}; "
                f"use shift{digits}."
            )
        return self

    def left(self, sampler: Sampler) -> Structure:
        """Return the structure of `sampler` that this randomization preserves."""
        return self.fits[sampler.structure]

    def draw(
        self, sampler: Sampler, n: int, stream: Stream, own: Stream, first: int, count: int
    ) -> Array:
        """Draw realizations of the sampler, and randomize them with the separate stream `own`.

        Override this method if the randomization draws other counts or realizations of `sampler`.
        """
        return self.apply(sampler.draw_stream(n, stream, first, count), own, first)

    def counts_near(self, sampler: Sampler, n: int) -> tuple[int | None, int]:
        """Return the largest allowed count ≤ n (None if there is none) and the smallest ≥ n."""
        return sampler._counts_near(n)

    def max_count(self, sampler: Sampler) -> int:
        """Return the largest number of randomized points for `sampler`."""
        return sampler.max_count

    def count_warning(self, sampler: Sampler, n: int) -> str | None:
        """Return a warning if `n` points are allowed but not recommended, else None."""
        return sampler._count_warning(n)


@final
@dataclass(frozen=True, kw_only=True)
class Randomized(Sampler):
    """A sampler followed by one or more randomizations."""

    base: Sampler
    steps: tuple[Randomization, ...]
    _inner: ClassVar[Sampler]
    """The sampler to which the last randomization of the chain is applied."""

    def __post_init__(self) -> None:
        # Derive the declared properties from the inner sampler and the last randomization
        *rest, last = self.steps
        inner = replace(self, steps=tuple(rest)) if rest else self.base
        settle(
            self,
            _inner=inner,
            dims=inner.dims,
            unbiased=inner.unbiased or last.debiases,
            fixed=inner.fixed and last.fixed,
            structure=last.left(inner),
            sequence=inner.sequence and last.pointwise,
            antithetic=inner.antithetic,
            independent=inner.independent and last.independent,
            max_count=last.max_count(inner),
        )

    def _law(self, n: int) -> Law:
        last = self.steps[-1]
        return last.law_of(self._inner.law(last.count_inside(self._inner, n)), n)

    @property
    def spec(self) -> str:
        """Spec string of the whole chain."""
        return " | ".join([self.base.spec, *(step.spec for step in self.steps)])

    @property
    def plain(self) -> Sampler:
        """The sampler to which the first randomization of the chain is applied."""
        return self.base

    @property
    def randomizations(self) -> tuple[Randomization, ...]:
        """The randomizations that follow the plain sampler, in the order of application."""
        return self.steps

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """Bases of the digits of the inner sampler."""
        return self.base.digit_bases

    @property
    def powers_only(self) -> bool:
        """Whether randomizations of digits keep the structure only if n is a power of the base.

        False if the randomizations preserve neither strata nor elementary intervals.
        If they preserve strata or elementary intervals, the inner sampler determines the value.
        """
        return self.base.powers_only and self.structure in (Structure.STRATA, Structure.DIGITS)

    def digit_strata(self, n: int, base: int) -> bool:
        """Whether `n` and the sides of the inner sampler's strata are powers of `base`."""
        return self.base.digit_strata(n, base)

    def as_chain(self, n: int) -> Sampler:
        """Return an equivalent sampler for n points, whose randomizations are separate steps.

        The steps of the inner sampler come first, then the randomizations of this sampler.
        """
        chain = self.base.as_chain(n)
        for step in self.steps:
            chain = chain.then(step)
        return chain

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        own = stream.child(FIRST_STEP + self.base.scrambles + len(self.steps) - 1)
        return self.steps[-1].draw(self._inner, n, stream, own, first, count)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return self.steps[-1].counts_near(self._inner, n)

    def _count_warning(self, n: int) -> str | None:
        return self.steps[-1].count_warning(self._inner, n)


def repeated(points: Array, count: int) -> Array:
    """Repeat the points (n, d) `count` times: float64 (count, n, d).

    Unlike `numpy.tile`, this function releases the interpreter lock, so threads run in parallel.
    """
    out = np.empty((count, *points.shape))
    out[...] = points
    return out
