"""Base of samplers with optimized sets: a cache, progress reports, reuse of sets, and descent.

The function `minimize` is limited-memory BFGS with reproducible bits [Nocedal1980]_.
Linear algebra libraries may sum in another order on other numbers of threads or processors.
This module uses no linear algebra library: NumPy computes all sums in a fixed order.
Therefore a set of points depends only on its random numbers (docs/decisions/0015).
"""

from __future__ import annotations

import hashlib
import inspect
import sys
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import lru_cache, partial
from typing import Any, ClassVar, TypeAlias

import numpy as np

from mcspectra.core.cache import cached_array
from mcspectra.core.checks import Array
from mcspectra.core.fields import whole
from mcspectra.core.parallel import available_workers, map_in_order
from mcspectra.core.progress import report
from mcspectra.core.streams import Stream, uniforms
from mcspectra.samplers._kernels import translated
from mcspectra.samplers.base import Sampler, Structure
from mcspectra.samplers.law import Law, Stationary, Unknown

__all__ = [
    "OptimisedSampler",
    "Report",
    "minimize",
    "random_points",
    "wrap",
]

Report: TypeAlias = Callable[[float], None]
"""Function that is called at intervals with the fraction of the work done."""

_CHILD = 1  # label of the random stream for the translations of reused sets
# Number of earlier steps that limited-memory BFGS stores; 5 to 20 are usual.
# BFGS also stores the change of the gradient in each of the earlier steps.
_MEMORY = 10
_DECREASE = 1e-4  # least decrease of an accepted step, relative to the slope
_HALVINGS = 20
_REPORTS = 50


@dataclass(frozen=True, kw_only=True)
class OptimisedSampler(Sampler, ABC):
    """A sampler whose sets take long to compute; they are kept in the user's cache folder.

    Attributes
    ----------
    sets
        With None, every realization is a new set, made from its own random numbers.
        With a number K, only K sets are made, which are the same for every seed.
        Realization r is then set r mod K under a random translation of the torus.
        Estimated means and variances remain correct on average.
        Standard errors of spectra treat only the K sets as independent, not all realizations.
    """

    costly: ClassVar[bool] = True
    version: ClassVar[int] = 1
    """Version of the method; cached sets of another version are not used."""
    structure: ClassVar[Structure] = Structure.TORUS
    max_count: ClassVar[int] = 2**16
    sets: int | None = whole(None, least=1, most=10**6)

    @abstractmethod
    def _optimize(self, n: int, keys: Array, report: Report) -> Array:
        """Make one set (n, dims) in [0,1) from keys uint64 (2,); report the fraction done."""

    def _law(self, n: int) -> Law:
        if self.unbiased and self.structure is Structure.TORUS:
            return Stationary(n=n, dims=self.dims, sets=self.sets)
        return Unknown(n=n, dims=self.dims, is_uniform=self.unbiased, sets=self.sets)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        source = stream if self.sets is None else Stream(0)
        wanted = np.arange(first, first + count)
        chosen, place = np.unique(
            wanted if self.sets is None else wanted % self.sets, return_inverse=True
        )
        workers = min(len(chosen), available_workers())
        made = map_in_order(partial(self._set, n, source), chosen.tolist(), workers)
        points = np.stack(list(made))[place]
        if self.sets is None:
            return points
        return translated(points, stream.child(_CHILD).uniforms(first, count, self.dims))

    def _set(self, n: int, stream: Stream, realization: int) -> Array:
        """Read one set from the cache, or make it."""
        keys = stream.keys(realization, 1)[0]
        what = f"{self.name}, {n} points, set {realization}"

        def make() -> Array:
            report(what, 0.0)
            points = self._optimize(n, keys, lambda fraction: report(what, fraction))
            report(what, 1.0)
            return points

        return cached_array(self._key(n, keys), make)

    def _key(self, n: int, keys: Array) -> str:
        """Return a text that determines the set: name, version, parameters, n, dims and keys."""
        names = sorted(field.name for field in fields(self) if field.name != "sets")
        values: dict[str, Any] = {name: _exact(getattr(self, name)) for name in names}
        words = ", ".join(f"{int(word):016x}" for word in keys)
        return f"{self.name} {self.version}{_source(type(self))} {values!r} n={n} keys={words}"


@lru_cache
def _source(cls: type) -> str:
    """Return name and digest of an external class's module.

    The digest is needed because the author may forget to change the class's `version`.
    """
    if cls.__module__.startswith("mcspectra."):
        return ""
    try:
        text = inspect.getsource(sys.modules[cls.__module__])
    except (OSError, TypeError, KeyError):
        code = cls._optimize.__code__  # type: ignore[attr-defined]
        text = f"{code.co_code!r} {code.co_consts!r}"
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    return f" {cls.__module__}:{cls.__qualname__} {digest}"


def _exact(value: object) -> object:
    """Convert an array to a list, because the printed text of a long array omits some numbers."""
    return value.tolist() if isinstance(value, np.ndarray) else value


def random_points(keys: Array, n: int, dims: int) -> Array:
    """Return the first n·d random numbers of a realization as uniform points (n, d)."""
    return uniforms(keys[None], n * dims).reshape(n, dims)


def wrap(points: Array) -> Array:
    """Return points modulo 1, with all coordinates below 1."""
    inside = points - np.floor(points)
    inside[inside >= 1.0] = 0.0  # the remainder of −1e-20 modulo 1 rounds to 1
    return inside


def minimize(
    function: Callable[[Array], tuple[float, Array]],
    start: Array,
    *,
    iterations: int,
    longest: float,
    report: Report = lambda _: None,
    goal: float = -np.inf,
    gain: float = 0.0,
) -> Array:
    """Return a point near `start` at which `function` is small, by limited-memory BFGS.

    Parameters
    ----------
    function
        Function that returns value and gradient at an array of any shape. Points are not wrapped.
    start
        The array at which the descent starts.
    iterations
        Largest number of steps.
    longest
        Largest change of a coordinate in one step.
    report
        Function that is called at intervals with the fraction of the iterations done.
    goal
        The descent ends as soon as the value of `function` is at most this.
    gain
        The descent ends when a step gains less than this, relative to the value or to 1.
    """
    x, (value, gradient) = start, function(start)
    memory: deque[tuple[Array, Array, float]] = deque(maxlen=_MEMORY)
    for i in range(iterations):
        if i % max(1, iterations // _REPORTS) == 0:
            report(i / iterations)
        if value <= goal or not gradient.any():
            break

        # Halve the step until the value falls by a fraction of the decrease that the slope predicts
        direction = _direction(gradient, memory)
        slope = _dot(direction, gradient)
        length = longest / float(np.abs(direction).max())
        length = min(1.0, length) if memory else length
        for _ in range(_HALVINGS):
            moved = x + length * direction
            trial, changed = function(moved)
            if trial <= value + _DECREASE * length * slope:
                break
            length /= 2
        else:
            if not memory:
                # A step along the gradient does not lower the value, because of rounding errors
                break
            memory.clear()
            continue

        # Store only steps of positive curvature
        step, change = moved - x, changed - gradient
        product = _dot(step, change)
        if product > 1e-10 * _dot(change, change) ** 0.5 * _dot(step, step) ** 0.5:
            memory.append((step, change, product))
        gained, x, value, gradient = value - trial, moved, trial, changed
        if gained < gain * max(abs(value), 1.0):
            break
    return x


def _direction(gradient: Array, memory: deque[tuple[Array, Array, float]]) -> Array:
    """Return −H g by Nocedal's two loops, with the approximate inverse Hessian H and gradient g."""
    direction, factors = -gradient, []
    for step, change, product in reversed(memory):
        factor = _dot(step, direction) / product
        direction = direction - factor * change
        factors.append(factor)
    if memory:
        _, change, product = memory[-1]
        direction = direction * (product / _dot(change, change))
    for (step, change, product), factor in zip(memory, reversed(factors), strict=True):
        direction = direction + (factor - _dot(change, direction) / product) * step
    return direction


def _dot(a: Array, b: Array) -> float:
    return float(np.sum(a * b))
