"""What routes to a predicted variance share: what is known of an integrand, and what they lead to.

A route is a function ``(sampler, n, known, stream) -> Predicted`` that raises `NoClosedForm` where it
does not lead anywhere. It may evaluate g where it likes, but for the sampler's own points.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar, cast, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.records import student_t
from mcspectra.integrands import Integrand
from mcspectra.variance.quadrature import constant, looked_at, square_integral, unseen

__all__ = ["Known", "Predicted", "half_interval"]

Made = TypeVar("Made")


@final
@dataclass(frozen=True)
class Predicted:
    """The variance of the mean of g over n points, by one route; arrays are (channels or 1,).

    Attributes
    ----------
    variance
        Its value, positive.
    error
        Half of its 95 % interval: of quadrature, of sampled spectra, and what the tail may be off by.
    route
        A few words that name it.
    share
        Part of ∫g² that was counted term by term.
    tail
        Part of `variance` that stands for the rest, in the same units as `variance`.
    """

    variance: Array
    error: Array
    route: str
    share: Array | float = 1.0
    tail: Array | float = 0.0


@final
class Known:
    """An integrand in primary space, and what routes found out about it, for all counts and samplers.

    All of them cut it at the jumps that lines see across an axis (`looked_at`).
    """

    def __init__(self, g: Integrand) -> None:
        self.g = looked_at(g)
        self._made: dict[Hashable, object] = {}
        self._lock = threading.RLock()

    @cached_property
    def square(self) -> tuple[Array, Array]:
        """∫g² and its absolute error, both (channels or 1,)."""
        return square_integral(self.g)

    @cached_property
    def constant(self) -> str:
        """What is to be said where g is the same wherever it was looked at; else empty."""
        return constant(self.g)

    @cached_property
    def unseen(self) -> Array:
        """What ∫g² may be off by for regions that nodes do not see, (channels or 1,)."""
        return unseen(self.g)

    def once(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """Return what `make` returns, made at the first call with this key."""
        with self._lock:
            if key not in self._made:
                self._made[key] = make()
            return cast(Made, self._made[key])


def half_interval(values: Array) -> Array:
    """Half of the 95 % interval of the mean over the first axis, by Student's t."""
    count = len(values)
    return np.asarray(student_t(count) * values.std(axis=0, ddof=1) / math.sqrt(count))
