"""The interface of samplers and randomisations, on one screen.

A `Sampler` draws realisations of a point set, a `Randomization` changes the points of another
sampler; ``sampler.then(randomization)`` chains them. Implementations write `_points` (or `apply`)
and say which counts they can do; everything else (checks, seeds, shapes) is here.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from os import PathLike
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import CountError, NotPowerOfTwoWarning, ParameterError
from mcspectra.core.spec import Component
from mcspectra.core.streams import RngLike, Stream

__all__ = ["MAX_COUNT", "Randomization", "Randomized", "Sampler", "Structure", "check_dims"]

MAX_COUNT = 2**31
"""Most points in one realisation, and most numbers in one `draw` of a sampler (16 GiB)."""

_MOST_STEPS = 32
_FIRST_STEP = 1 << 16  # stream labels below this one are free for the samplers' own parts


class Structure(Enum):
    """What makes a point set better than random, and so what a randomisation must not break."""

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
        What randomisations of this sampler have to keep: `Structure`.
    sequence
        Whether the first k of n points are those of a set of k points, each run of them good.
    antithetic
        Whether points come in pairs that mirror each other within a cell.
    independent
        Whether the realisations of a seed are independent of one another.
    max_dims, max_count
        Most dims and most points of a realisation; beyond, it would take hours or all memory.
    """

    dims: int
    unbiased: ClassVar[bool] = True
    fixed: ClassVar[bool] = False
    structure: ClassVar[Structure] = Structure.UNKNOWN
    sequence: ClassVar[bool] = False
    antithetic: ClassVar[bool] = False
    independent: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = None
    max_count: ClassVar[int] = MAX_COUNT

    @property
    def digit_bases(self) -> tuple[int, ...]:
        """Base of the digits of each coordinate, for randomisations of digits: 2 unless said."""
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
                f"{self.spec} makes {self.max_count} points at most, not {count}; ask for fewer, or "
                "use a sampler that takes no search.",
                (self.max_count,),
            )
        below, above = self._counts_near(count)
        if count in (below, above):
            if sentence := self._count_warning(count):
                warnings.warn(sentence, NotPowerOfTwoWarning, stacklevel=3)
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
                f"{base.spec} is followed by {_MOST_STEPS} steps, the most there can be; "
                "leave the others out."
            )
        return Randomized(base=base._before(fitted), steps=(*steps, fitted))

    @abstractmethod
    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        """Make realisations first … first+count−1: float64 (count, n, dims)."""

    def _before(self, randomization: Randomization) -> Sampler:
        """Return what to draw from when `randomization` follows: given sets may then be reused."""
        del randomization
        return self

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        """Return the largest possible count ≤ n (None if none) and the smallest ≥ n."""
        return n, n

    def _count_warning(self, n: int) -> str | None:
        """Return what to warn of when `n` points, a possible count, are asked for."""
        del n
        return None

    @staticmethod
    def from_points(points: object) -> Sampler:
        """Make a sampler of given points, shape (R, n, d) or (n, d): realisation r is points[r]."""
        from mcspectra.samplers.external import GivenPoints

        return GivenPoints.from_array(points)

    @staticmethod
    def from_files(*paths: str | PathLike[str]) -> Sampler:
        """Make a sampler of point files (.dat, .bin, .npz, .csv, .parquet), their sets in order."""
        from mcspectra.samplers.external import GivenPoints

        return GivenPoints.from_files(*paths)

    @staticmethod
    def from_function(
        draw: Callable[[int, np.random.Generator], object], *, dims: int, unbiased: bool = True
    ) -> Sampler:
        """Make a sampler of a callable ``draw(n, generator) -> (n, d)`` points in [0,1)."""
        from mcspectra.samplers.external import FunctionSampler

        return FunctionSampler(function=draw, dims=dims, unbiased_=unbiased)

    @staticmethod
    def from_scipy(engine: object, **arguments: object) -> Sampler:
        """Make a sampler of a `scipy.stats.qmc.QMCEngine`, its class, or a factory ``rng -> engine``."""
        from mcspectra.samplers.external import ScipySampler

        return ScipySampler.from_engine(engine, **arguments)

    @staticmethod
    def from_qmcpy(generator: object, **arguments: object) -> Sampler:
        """Make a sampler of a QMCPy generator: an instance, its class with arguments, or a name."""
        from mcspectra.samplers.qmcpy_ import QmcpySampler

        return QmcpySampler.from_generator(generator, **arguments)


class Randomization(Component, ABC):
    """A change to the points of a sampler, with randomness of its own."""

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

    @abstractmethod
    def apply(self, points: Array, stream: Stream, first: int) -> Array:
        """Return new points (count, n, d) in [0,1) for realisations first … first+count−1."""

    def fit(self, sampler: Sampler) -> Randomization:
        """Return this randomisation as it is applied to `sampler`, e.g. in its digits' base.

        Raises
        ------
        ParameterError
            It would break what the sampler is made for; the message says what and what fits.
        """
        if sampler.structure not in self.fits:
            raise ParameterError(
                f"{self.name} would break the {sampler.structure.value} of {sampler.spec}; "
                f"{_advice(sampler.structure)}."
            )
        return self

    def left(self, sampler: Sampler) -> Structure:
        """Return what is left of the structure of `sampler`."""
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
        """Return the most points that can be made of what `sampler` makes at most."""
        return sampler.max_count

    def count_warning(self, sampler: Sampler, n: int) -> str | None:
        """Return what to warn of when `n` points, a possible count, are asked for."""
        return sampler._count_warning(n)


def _advice(structure: Structure) -> str:
    if structure is Structure.TORUS:
        return "shift keeps them"
    if structure is Structure.DIGITS:
        return "shift, digital-shift and owen fit"
    return "shift fits"


@final
@dataclass(frozen=True, kw_only=True)
class Randomized(Sampler):
    """A sampler followed by one or more randomisations."""

    base: Sampler
    steps: tuple[Randomization, ...]

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
        """What the steps have left of the structure of the sampler inside."""
        return self.steps[-1].left(self._inner)

    @property
    def antithetic(self) -> bool:  # type: ignore[override]
        """Whether there are still pairs: all steps that are accepted keep them."""
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
        """What the last step makes of the most points inside."""
        return self.steps[-1].max_count(self._inner)

    @property
    def sequence(self) -> bool:  # type: ignore[override]
        """Whether all steps leave a sequence one."""
        return self.base.sequence and all(step.pointwise for step in self.steps)

    @property
    def powers_only(self) -> bool:
        """That of the sampler inside, while something of its structure is left."""
        return self.base.powers_only and self.structure in (Structure.STRATA, Structure.DIGITS)

    def digit_strata(self, n: int, base: int) -> bool:
        """Those of the sampler inside."""
        return self.base.digit_strata(n, base)

    @property
    def _inner(self) -> Sampler:
        """What the last step is applied to."""
        rest = self.steps[:-1]
        return Randomized(base=self.base, steps=rest) if rest else self.base

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        own = stream.child(_FIRST_STEP + len(self.steps) - 1)
        return self.steps[-1].draw(self._inner, n, stream, own, first, count)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        return self.steps[-1].counts_near(self._inner, n)

    def _count_warning(self, n: int) -> str | None:
        return self.steps[-1].count_warning(self._inner, n)


def check_dims(sampler: Any) -> None:
    """Make a sampler's `dims` an int from 1 to its class's `max_dims`; for `__post_init__`."""
    try:
        dims = as_integer("dims", sampler.dims, least=1, most=sampler.max_dims or 2**16)
        object.__setattr__(sampler, "dims", dims)
    except ParameterError as error:
        raise ParameterError(f"{sampler.name}: {error}") from None
