"""Calls of an expensive function: they are counted, limited, parallel, and cached on disk.

Expensive functions are called only through `Calls`.
If the budget does not cover a call, `Calls` raises an error and does not call.
A point in the cache counts toward the budget like any other, although it costs no call.
Therefore results do not depend on the state of the cache:
an interrupted run gives the same bits when it is repeated.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import signal
import sqlite3
import threading
from collections.abc import Callable, Generator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Any, Self, final

import numpy as np

from mcspectra.core.checks import (
    Array,
    as_choice,
    as_integer,
    as_real_array,
    in_unit_cube,
    is_path,
)
from mcspectra.core.errors import (
    BudgetError,
    DomainError,
    FileFormatError,
    ParameterError,
    StorageError,
    point_in_words,
    reason_of,
)
from mcspectra.core.progress import report
from mcspectra.core.registry import optional_package
from mcspectra.integrands.base import FunctionIntegrand, Integrand

__all__ = ["Calls"]

# Number of points in one call of a vectorized function.
# If the function takes single points, this many values are stored at the same time
_BLOCK, _FEW = 128, 8
# Largest relative difference between a cached value and the value of the function
_SAME = 1e-9

_integrand: Integrand  # integrand that a worker process evaluates


@final
class Calls:
    """A scalar function on [0,1)^d with a limited number of calls.

    If it has workers or a cache, close it, or use it in a ``with`` statement.

    Parameters
    ----------
    f
        A callable that maps points (k, d) to values (k,), or an integrand without channels.
    dims
        Number of dimensions d.
    budget
        Largest number of points in total.
    vectorized
        Set this to False if the function maps a single point, an array (d,), to a number.
    workers
        Number of processes that call f. The points are divided among the processes.
        With more than one process, a script needs the guard ``if __name__ == "__main__":``.
    cache
        Path of a file that stores the values by point. It is created if it does not exist.
        One file can store only one function with one set of parameters.
    on_error
        ``"raise"``: an error is raised if f fails or gives NaN or infinity.
        ``"skip"``: values are NaN at points where f fails or is not finite.
        If f fails on several points at once, f is called again for each of these points.

    Attributes
    ----------
    made
        Number of points at which f was called.
    left
        Number of points that are still allowed: `budget` minus all points requested, cached or not.
    skipped
        Number of points at which f failed.
    skips
        Whether values are NaN where f fails.
    first_skipped
        The first point at which f failed, (d,), or None.

    Raises
    ------
    ParameterError
        If f has channels or another number of dims, or cannot be called or sent to processes.
        If an argument is out of range, or if the cache belongs to another function.
    FileFormatError
        If the cache is a file of another kind.

    Examples
    --------
    >>> import numpy as np
    >>> f = Calls(lambda x: x[:, 0] ** 2, dims=1, budget=100)
    >>> f(np.array([[0.5], [0.25]]))
    array([0.25  , 0.0625])
    >>> f.made, f.left
    (2, 98)
    """

    def __init__(
        self,
        f: Callable[[Any], Any],
        *,
        dims: int,
        budget: int,
        vectorized: bool = True,
        workers: int = 1,
        cache: str | os.PathLike[str] | None = None,
        on_error: str = "raise",
    ) -> None:
        self.dims = as_integer("dims", dims, least=1)
        self.budget = as_integer("budget", budget, least=1)
        self.made, self._asked = 0, 0
        self.skipped: int = 0
        self.first_skipped: Array | None = None
        skips = as_choice("on_error", on_error, ("raise", "skip")) == "skip"
        if not isinstance(vectorized, bool):
            raise ParameterError(f"vectorized is {vectorized!r:.80}; it must be True or False.")
        if not callable(f):
            raise ParameterError(f"f is {f!r:.80}, not a callable; give f(points) -> values.")
        if isinstance(f, Integrand) and (f.channels or f.dims != self.dims):
            raise ParameterError(
                f"{f.spec} has {f.dims} dims and {f.channels} channels; give a scalar function in "
                f"{self.dims} dims, such as one of its channels."
            )
        self.__name__ = self.name = (
            f.spec if isinstance(f, Integrand) else str(getattr(f, "__name__", type(f).__name__))
        )
        self._block = _BLOCK if vectorized else _FEW
        self._f = (
            f
            if isinstance(f, Integrand)
            else FunctionIntegrand(function=f if vectorized else _OneByOne(f), dims=self.dims)
        )
        # Calls are counted here, so the general counter of evaluations must not count them again
        g = self._f
        self._values = g.checked_values if isinstance(g, FunctionIntegrand) else g._evaluate
        self.skips = skips and isinstance(g, FunctionIntegrand)
        if self.skips:
            self._values = partial(_values_or_nan, g)  # type: ignore[arg-type]
        self._pool = (
            _pool(self._f, workers)
            if as_integer("workers", workers, least=1, most=1024) > 1
            else None
        )
        self._cache = None if cache is None else _Cache(cache, self.name, self.dims)
        self._checked = False  # whether a cached value has been compared with the function
        self._lock = threading.RLock()

    @property
    def left(self) -> int:
        return self.budget - self._asked

    def __call__(self, x: object) -> Array:
        """Return values at points (..., d): float64 (...).

        Raises
        ------
        BudgetError
            If there are more points than the limit still allows. f is then not called.
        DomainError
            If the points have another number of dims or lie outside the unit cube.
        ParameterError
            If f does not give one finite real number per point, or differs from cached values.
        StorageError
            If the cache cannot be written.
        """
        points = as_real_array("x", x)
        if points.ndim == 0 or points.shape[-1] != self.dims or not in_unit_cube(points):
            raise DomainError(
                f"{self.name} was given points of shape {points.shape}; give points "
                f"(..., {self.dims}) of the unit cube."
            )
        flat = np.ascontiguousarray(points.reshape(-1, self.dims))
        with self._lock:
            if len(flat) > self.left:
                raise BudgetError(
                    f"{len(flat)} more calls of {self.name} exceed the budget of {self.budget}, of "
                    f"which {self.left} are left; give a budget of at least "
                    f"{self._asked + len(flat)}."
                )
            values = self._cache.values(flat) if self._cache else np.full(len(flat), np.nan)
            fresh = np.flatnonzero(np.isnan(values))
            self._check_cache(flat, values)
            before, done = self._asked, len(flat) - fresh.size
            self._asked += len(flat)
            with contextlib.closing(self._evaluated(flat, fresh)) as found:
                for where, part in found:
                    values[where] = part
                    self.made, done = self.made + len(part), done + len(part)
                    if self.skips and (failed := np.flatnonzero(np.isnan(part))).size:
                        if self.first_skipped is None:
                            self.first_skipped = flat[where[failed[0]]]
                        self.skipped += failed.size
                    if self._cache:
                        self._cache.add(flat[where], part)
                    report(f"{self.budget} calls of {self.name}", (before + done) / self.budget)
        return values.reshape(points.shape[:-1])

    def skipped_in_words(self, least: float, most: float) -> str:
        """Describe where f failed, and the range of f there for which the interval is valid."""
        assert self.first_skipped is not None
        return (
            f"{self.skipped} of {self._asked} evaluations failed and were skipped, the first at "
            f"{point_in_words(self.first_skipped)}: the interval holds if f lies between "
            f"{least:.4g} and {most:.4g} there, as it does elsewhere"
        )

    def close(self) -> None:
        """Stop the processes and close the cache. Its file keeps the values."""
        report(f"{self.budget} calls of {self.name}", 1.0)
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
        if self._cache is not None:
            self._cache.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _evaluated(self, x: Array, fresh: Array) -> Generator[tuple[Array, Array], None, None]:
        """Yield positions of points with their values, in the order in which they are finished."""
        blocks = [fresh[i : i + self._block] for i in range(0, fresh.size, self._block)]
        if self._pool is None:
            for where in blocks:
                try:
                    found = self._values(x[where])
                # A shape error means that f failed, or that its result has a wrong shape
                except ParameterError as error:
                    if self.made or self._block == _FEW or "shape" not in str(error):
                        raise
                    hint = "If it takes one point at a time, give vectorized=False."
                    raise ParameterError(f"{error} {hint}") from error.__cause__
                yield where, found
            return
        tasks: dict[Future[Array], Array] = {}
        try:
            work = _in_worker_or_nan if self.skips else _in_worker
            tasks = {self._pool.submit(work, x[where]): where for where in blocks}
            for task in as_completed(tasks):
                yield tasks[task], task.result()
        except BrokenProcessPool:
            raise ParameterError(
                f"A process that called {self.name} died; check its output, guard the script by "
                'if __name__ == "__main__":, or give workers=1.'
            ) from None
        finally:
            for task in tasks:
                task.cancel()

    def _check_cache(self, x: Array, values: Array) -> None:
        """Raise an error if the cache disagrees with f at one point. Only one call checks this."""
        held = np.flatnonzero(~np.isnan(values))
        if self._checked or not held.size:
            return
        self._checked = True
        i = held[0]
        (now,) = self._values(x[i : i + 1])
        self.made += 1
        if abs(now - values[i]) > _SAME * max(abs(now), abs(values[i])):
            raise ParameterError(
                f"The cache holds {values[i]:.10g} at {point_in_words(x[i])}, where {self.name} "
                f"now gives {now:.10g}: it has changed or is random; give another cache."
            )


@final
class _OneByOne:
    """Applies a function of one point (d,) to points (k, d)."""

    def __init__(self, f: Callable[[Any], Any]) -> None:
        self.f = f
        self.__name__ = str(getattr(f, "__name__", type(f).__name__))

    def __call__(self, x: Array) -> Array:
        values = [np.asarray(self.f(point)) for point in x]
        sizes = {value.size for value in values}
        if sizes - {1}:
            raise ParameterError(
                f"{self.__name__} gave {max(sizes - {1})} values at one point; give one "
                "component at a time, such as lambda x: f(x)[0]."
            )
        return np.array([value.reshape(()) for value in values])


def _pool(f: Integrand, workers: int) -> ProcessPoolExecutor:
    """Return processes that contain f. They are spawned, because forking with threads may hang."""
    from multiprocessing import get_context

    cloudpickle = optional_package("cloudpickle", "cluster", "Calls in other processes need")
    try:
        sent = cloudpickle.dumps(f)
    except Exception as error:  # noqa: BLE001 - pickling f may raise anything
        raise ParameterError(
            f"{f.spec} cannot be sent to other processes ({reason_of(error, 200)}); give "
            "workers=1, or a function without open files, locks or connections."
        ) from None
    return ProcessPoolExecutor(workers, get_context("spawn"), _start_worker, (sent,))


def _start_worker(sent: bytes) -> None:
    import cloudpickle

    global _integrand
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process ends the workers
    _integrand = cloudpickle.loads(sent)


def _in_worker(x: Array) -> Array:
    return _integrand._evaluate(x)


def _in_worker_or_nan(x: Array) -> Array:
    return _values_or_nan(_integrand, x)  # type: ignore[arg-type]


def _values_or_nan(f: FunctionIntegrand, x: Array) -> Array:
    """Return values (k,). They are NaN where f fails or gives infinity."""
    try:
        values = f.checked_values(x, finite=False)
    except ParameterError:
        if len(x) == 1:
            return np.full(1, np.nan)
        return np.concatenate([_values_or_nan(f, x[i : i + 1]) for i in range(len(x))])
    return np.where(np.isfinite(values), values, np.nan)


@final
class _Cache:
    """Values of one function in an SQLite file. Keys are digests of the bytes of points."""

    def __init__(self, path: str | os.PathLike[str], function: str, dims: int) -> None:
        if not is_path(path):
            raise ParameterError(f"cache is {path!r:.80}; give the path of a file.")
        self._path = Path(path)
        try:
            self._file = sqlite3.connect(self._path, timeout=60.0, check_same_thread=False)
            self._file.execute(
                "PRAGMA synchronous = OFF"
            )  # Ctrl-C loses no values, but a power failure may
            with self._file:
                self._file.execute("CREATE TABLE IF NOT EXISTS about (function TEXT, dims INTEGER)")
                self._file.execute(
                    "CREATE TABLE IF NOT EXISTS calls "
                    "(point BLOB PRIMARY KEY, value REAL) WITHOUT ROWID"
                )
                known = self._file.execute("SELECT * FROM about").fetchone()
                if known is None:
                    self._file.execute("INSERT INTO about VALUES (?, ?)", (function, dims))
        except sqlite3.Error as error:
            raise FileFormatError(
                f"The cache {path} cannot be used ({error}); give a new path or an earlier cache."
            ) from None
        if known not in (None, (function, dims)):
            self.close()
            raise ParameterError(
                f"The cache {path} is of {known[0]} in {known[1]} dims, not of {function} in "
                f"{dims}; give another path."
            )

    def values(self, x: Array) -> Array:
        """Return the values at points (k, d). They are NaN for unknown points."""
        find = "SELECT value FROM calls WHERE point = ?"
        found = (self._file.execute(find, (_digest(point),)).fetchone() for point in x)
        return np.array([np.nan if each is None else each[0] for each in found], float)

    def add(self, x: Array, values: Array) -> None:
        rows = zip(map(_digest, x), values.tolist(), strict=True)
        try:
            with self._file:
                self._file.executemany("INSERT OR REPLACE INTO calls VALUES (?, ?)", rows)
        except sqlite3.Error as error:
            raise StorageError(f"The cache {self._path} cannot be written: {error}.") from None

    def close(self) -> None:
        self._file.close()


def _digest(point: Array) -> bytes:
    return hashlib.blake2b(point.tobytes(), digest_size=16).digest()
