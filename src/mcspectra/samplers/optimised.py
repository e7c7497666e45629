"""The base class of samplers with optimised sets: a cache, progress reports, reuse of sets."""

from __future__ import annotations

import hashlib
import inspect
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np

from mcspectra.core.cache import cached_array
from mcspectra.core.checks import Array, as_integer
from mcspectra.core.parallel import available_workers, map_in_order
from mcspectra.core.progress import report
from mcspectra.core.streams import Stream
from mcspectra.samplers import _kernels
from mcspectra.samplers.base import Sampler, Structure

__all__ = ["OptimisedSampler", "check_sets"]

_CHILD = 1  # label of the stream that translates sets used again


@dataclass(frozen=True, kw_only=True)
class OptimisedSampler(Sampler, ABC):
    """A sampler whose sets take long: kept in the user's cache folder, with reports of progress.

    Attributes
    ----------
    sets
        None: every realisation is a set of its own, made from its own random numbers. K: only K
        sets are made, the same for every seed; realisation r is set r mod K under a random
        toroidal translation. Means and variances stay right on average, but they, and standard
        errors of spectra, know K sets only.
    """

    costly: ClassVar[bool] = True
    version: ClassVar[int] = 1
    """Version of the method: sets of another one are not taken from the cache."""
    structure: ClassVar[Structure] = Structure.TORUS
    max_count: ClassVar[int] = 2**16
    sets: int | None = None

    @abstractmethod
    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        """Make one set (n, dims) in [0,1) from keys uint64 (2,); report the fraction done."""

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
        offsets = np.empty((count, self.dims))
        _kernels.random_offsets(stream.child(_CHILD).keys(first, count), offsets)
        moved = np.empty_like(points)
        _kernels.translate(points, offsets, moved)
        return moved

    def _set(self, n: int, stream: Stream, realization: int) -> Array:
        """Fetch one set from the cache, or make it."""
        keys = stream.keys(realization, 1)[0]
        what = f"{self.name}, {n} points, set {realization}"

        def make() -> Array:
            report(what, 0.0)
            points = self._optimize(n, keys, lambda fraction: report(what, fraction))
            report(what, 1.0)
            return points

        return cached_array(self._key(n, keys), make)

    def _key(self, n: int, keys: Array) -> str:
        """Everything a set depends on, as text: name, version, parameters, n, dims, random keys."""
        names = sorted(field.name for field in fields(self) if field.name != "sets")
        values: dict[str, Any] = {name: _exact(getattr(self, name)) for name in names}
        words = ", ".join(f"{int(word):016x}" for word in keys)
        return f"{self.name} {self.version}{_source(type(self))} {values!r} n={n} keys={words}"


@lru_cache
def _source(cls: type) -> str:
    """Name and digest of the module of a class from elsewhere: its author may forget `version`."""
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
    """Return what a `repr` shows completely: that of an array leaves numbers out."""
    return value.tolist() if isinstance(value, np.ndarray) else value


def check_sets(sampler: OptimisedSampler) -> None:
    """Make `sets` None or an int of at least 1; for `__post_init__`."""
    if sampler.sets is not None:
        object.__setattr__(sampler, "sets", as_integer("sets", sampler.sets, least=1, most=10**6))
