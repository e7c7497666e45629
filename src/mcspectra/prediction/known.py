"""Common parts of all prediction methods: facts about an integrand, and the type of a result.

A method is a function ``(law, known, stream) -> Predicted``.
If a method cannot predict the variance of this sampler and integrand, it raises `NoClosedForm`.
A method may evaluate g anywhere except at the points of the sampler itself.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, TypeVar, cast, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import student_t
from mcspectra.core.records import JOIN
from mcspectra.estimators.quadrature import (
    DIVERGES,
    beyond_points,
    constant,
    growth,
    looked_at,
    square_integral,
    unseen,
)
from mcspectra.integrands import Integrand
from mcspectra.prediction.separable import separated

__all__ = ["Cells", "Known", "Predicted", "half_interval"]

Made = TypeVar("Made")


@final
@dataclass(frozen=True)
class Predicted:
    """The variance of the mean of g over n points by one method, for each channel.

    Attributes
    ----------
    variance
        The predicted variance. It is positive.
    error
        Half of the 95 % interval, for errors of quadrature, of sampled spectra and of the tail.
    how
        Short description of the computation, such as the number of point sets.
    share
        Part of ∫g² that the method sums term by term.
    tail
        Variance from the part of ∫g² that is not summed term by term. It is part of `variance`.
        `tail` is one estimate for the sum of all terms that the method leaves out.
    method
        Name of the prediction method, as in `METHODS`.
    poles
        Whether `error` covers poles of g that tables and points do not resolve.
    """

    variance: Array
    error: Array
    how: str
    share: Array | float = 1.0
    tail: Array | float = 0.0
    method: str = ""
    poles: bool = False


@final
@dataclass(frozen=True)
class Cells:
    """Predicted variances of several samplers, counts or methods, one row each.

    Attributes
    ----------
    variance, low, high
        Variance and ends of its 95 % interval, (N, channels or 1). Unknown variances are NaN.
    share, tail
        See `Predicted`.
    methods, hows, notes
        Three arrays (N,): names of methods, details (or why a value is missing), and notes.
    """

    variance: JOIN
    low: JOIN
    high: JOIN
    share: JOIN
    tail: JOIN
    methods: JOIN
    hows: JOIN
    notes: JOIN

    @staticmethod
    def row(
        method: str,
        how: str,
        variance: Any,
        low: Any,
        high: Any,
        *,
        share: Any = 1.0,
        tail: Any = 0.0,
        note: str = "",
        channels: int = 1,
    ) -> Cells:
        """Make a table of one prediction; its numbers are scalars or arrays (channels,)."""
        numbers = [np.full((1, channels), each) for each in (variance, low, high, share, tail)]
        return Cells(*numbers, *(np.array([text]) for text in (method, how, note)))

    @staticmethod
    def unknown(reason: str, channels: int) -> Cells:
        """Make a table of one failed prediction: NaN, with the reason as text."""
        nan, why = math.nan, reason.rstrip(".")
        return Cells.row(
            "none", why, nan, nan, nan, share=nan, tail=nan, note=why, channels=channels
        )

    @staticmethod
    def joined(parts: Sequence[Cells]) -> Cells:
        """Concatenate rows."""
        return Cells(
            *(np.concatenate(each) for each in zip(*map(Cells._arrays, parts), strict=True))
        )

    def named(self, place: int = 0) -> tuple[str, str]:
        """Return the method and the details of prediction number `place`."""
        return str(self.methods[place]), str(self.hows[place])

    def at(self, place: int) -> Cells:
        """Return a table that holds only prediction number `place`."""
        return Cells(*(each[place : place + 1] for each in self._arrays()))

    def _arrays(self) -> tuple[Array, ...]:
        return tuple(getattr(self, field.name) for field in fields(self))


@final
class Known:
    """An integrand in primary space, with cached facts for all methods, counts and samplers.

    Searches along lines find jumps across an axis. All methods treat these jumps as breaks.
    Results of quadrature are stored in `mcspectra.integrands.base.IntegrandCache`.
    """

    def __init__(self, given: Integrand) -> None:
        self.given = given
        self._made: dict[Hashable, object] = {}
        self._lock = threading.RLock()

    @cached_property
    def g(self) -> Integrand:
        """The integrand, with its jumps as breaks."""
        return looked_at(self.given)

    @property
    def costly(self) -> bool:
        """Whether evaluations are so slow that only a few methods are worthwhile."""
        return self.given.costly

    @cached_property
    def square(self) -> tuple[Array, Array]:
        """∫g² and its absolute error, both (channels or 1,)."""
        if self.unresolved.any() and (parts := separated(self.g)):
            spread, error = np.array([part.spread for part in parts]).T
            infinite = np.array([part.diverges for part in parts])
            whole = spread + np.array([part.mean for part in parts]) ** 2
            return np.where(infinite, np.inf, whole), np.where(infinite, 0.0, error)
        return square_integral(self.g)

    @cached_property
    def diverges(self) -> Array:
        """Whether the growth of |g| along lines shows that ∫g² is infinite, (channels or 1,)."""
        found = growth(self.g) >= DIVERGES
        if self.unresolved.any() and (parts := separated(self.g)):
            found = found | np.array([part.diverges for part in parts])
        return np.asarray(found)

    @cached_property
    def unresolved(self) -> Array:
        """Part of ∫g² next to poles that tables and points do not resolve, (channels or 1,)."""
        return beyond_points(self.g)

    @cached_property
    def constant(self) -> str:
        """A message if g has the same value at all probe points, otherwise an empty string."""
        return constant(self.g)

    @cached_property
    def unseen(self) -> Array:
        """Error of ∫g² due to regions that quadrature nodes miss, (channels or 1,)."""
        return unseen(self.g)

    def once(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """Return the result of `make`. It is computed only at the first call with this key."""
        with self._lock:
            if key not in self._made:
                self._made[key] = make()
            return cast(Made, self._made[key])


def half_interval(values: Array) -> Array:
    """Return half of the 95 % interval of the mean over the first axis, by Student's t."""
    count = len(values)
    return np.asarray(student_t(count) * values.std(axis=0, ddof=1) / math.sqrt(count))
