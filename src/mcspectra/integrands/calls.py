"""Calls of an expensive function: counted, within a budget, in processes, kept on disk by point.

`Calls` is the one door to a function that costs something. It refuses what the budget does not cover
before the function is called. A point found in the cache counts toward the budget like any other,
although it costs no call: what is computed with a `Calls` therefore does not depend on how full the
cache is, and a run that was interrupted gives the same bits when it is run again.
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

_BLOCK, _FEW = 128, 8  # points a call of a vectorized function; single calls that are kept together
_SAME = 1e-9  # relative: a value of the cache and the function's own

_integrand: Integrand  # of a worker process


@final
class Calls:
    """A scalar function on [0,1)^d that is called no more often than a budget allows.

    Close it, or use it in a ``with`` statement, where it has workers or a cache.

    Parameters
    ----------
    f
        A callable of points (k, d), which gives (k,), or an integrand without channels.
    dims
        Number of dimensions d.
    budget
        Points that may be asked for in all.
    vectorized
        False for a function of a single point: an array (d,) to a number.
    workers
        Processes that call f, each with points of its own. A script needs the guard
        ``if __name__ == "__main__":`` then.
    cache
        Path of a file that keeps the values by point; it is made where there is none. It is for one
        function with one set of parameters.
    on_error
        ``"raise"`` where f fails, or gives NaN or infinity; or ``"skip"``: values are NaN there. If
        f fails for several points at once it is called again for each of them.

    Attributes
    ----------
    made
        Calls of f that were made: values of single points.
    left
        Points that may still be asked for: `budget` less all that were, in the cache or not.
    skipped
        Number of points where f failed.
    skips
        Whether values are NaN where f fails.
    first_skipped
        The first of these points (d,), None without any.

    Raises
    ------
    ParameterError
        f has channels or other dims, cannot be called, or cannot be sent to other processes; an
        argument is out of range; the cache is of another function.
    FileFormatError
        The cache is another kind of file.

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
                f"{self.dims} dims, such as a channel of it."
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
        # Counted here, and not again by tallies
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
        self._checked = False  # whether the function still gives a value of the cache
        self._lock = threading.RLock()

    @property
    def left(self) -> int:
        return self.budget - self._asked

    def __call__(self, x: object) -> Array:
        """Values at points (..., d): float64 (...).

        Raises
        ------
        BudgetError
            There are more points than are left; f was not called.
        DomainError
            The points have other dims, or lie outside the unit cube.
        ParameterError
            f did not give one finite real number a point, or gives another than the cache holds.
        StorageError
            The cache cannot be written.
        """
        points = as_real_array("x", x)
        if points.ndim == 0 or points.shape[-1] != self.dims or not in_unit_cube(points):
            raise DomainError(
                f"{self.name} was given points of shape {points.shape}; give points (..., {self.dims}) "
                "of the unit cube."
            )
        flat = np.ascontiguousarray(points.reshape(-1, self.dims))
        with self._lock:
            if len(flat) > self.left:
                raise BudgetError(
                    f"{len(flat)} more calls of {self.name} are beyond the budget of {self.budget}, of "
                    f"which {self.left} are left; give a budget of at least {self._asked + len(flat)}."
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
        """How often and where f failed, and what an interval assumes: values from least to most."""
        assert self.first_skipped is not None
        return (
            f"{self.skipped} of {self._asked} evaluations failed and were skipped, the first at "
            f"{point_in_words(self.first_skipped)}: the interval holds if f lies between {least:.4g} "
            f"and {most:.4g} there, as it does elsewhere"
        )

    def close(self) -> None:
        """Let the processes and the cache go; what was found stays in its file."""
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
        """Places of points and their values, as they come."""
        blocks = [fresh[i : i + self._block] for i in range(0, fresh.size, self._block)]
        if self._pool is None:
            for where in blocks:
                try:
                    found = self._values(x[where])
                except ParameterError as error:  # of a shape: it failed, or gave another one
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
                f"A process that called {self.name} died; look at what it wrote, guard the script by "
                'if __name__ == "__main__":, or give workers=1.'
            ) from None
        finally:
            for task in tasks:
                task.cancel()

    def _check_cache(self, x: Array, values: Array) -> None:
        """Refuse a cache of values that f does not give any more, by one call, once."""
        held = np.flatnonzero(~np.isnan(values))
        if self._checked or not held.size:
            return
        self._checked = True
        i = held[0]
        (now,) = self._values(x[i : i + 1])
        self.made += 1
        if abs(now - values[i]) > _SAME * max(abs(now), abs(values[i])):
            raise ParameterError(
                f"The cache holds {values[i]:.10g} at {point_in_words(x[i])}, where {self.name} now gives "
                f"{now:.10g}: it has changed, or is random itself; give another cache."
            )


@final
class _OneByOne:
    """A function of one point (d,), for points (k, d)."""

    def __init__(self, f: Callable[[Any], Any]) -> None:
        self.f = f
        self.__name__ = str(getattr(f, "__name__", type(f).__name__))

    def __call__(self, x: Array) -> Array:
        values = [np.asarray(self.f(point)) for point in x]
        sizes = {value.size for value in values}
        if sizes - {1}:
            raise ParameterError(
                f"{self.__name__} gave {max(sizes - {1})} values at one point; it must give a number."
            )
        return np.array([value.reshape(()) for value in values])


def _pool(f: Integrand, workers: int) -> ProcessPoolExecutor:
    """Processes that know f: new ones, as forks of a process with threads may hang."""
    from multiprocessing import get_context

    cloudpickle = optional_package("cloudpickle", "cluster", "Calls in other processes need")
    try:
        sent = cloudpickle.dumps(f)
    except Exception as error:  # noqa: BLE001 - whatever f holds
        raise ParameterError(
            f"{f.spec} cannot be sent to other processes ({reason_of(error, 200)}); give workers=1, or a "
            "function without open files, locks or connections."
        ) from None
    return ProcessPoolExecutor(workers, get_context("spawn"), _start_worker, (sent,))


def _start_worker(sent: bytes) -> None:
    import cloudpickle

    global _integrand
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process ends them
    _integrand = cloudpickle.loads(sent)


def _in_worker(x: Array) -> Array:
    return _integrand._evaluate(x)


def _in_worker_or_nan(x: Array) -> Array:
    return _values_or_nan(_integrand, x)  # type: ignore[arg-type]


def _values_or_nan(f: FunctionIntegrand, x: Array) -> Array:
    """Values (k,), NaN where f fails or gives infinity."""
    try:
        values = f.checked_values(x, finite=False)
    except ParameterError:
        if len(x) == 1:
            return np.full(1, np.nan)
        return np.concatenate([_values_or_nan(f, x[i : i + 1]) for i in range(len(x))])
    return np.where(np.isfinite(values), values, np.nan)


@final
class _Cache:
    """Values by a digest of the bytes of their points, in an SQLite file of one function."""

    def __init__(self, path: str | os.PathLike[str], function: str, dims: int) -> None:
        if not is_path(path):
            raise ParameterError(f"cache is {path!r:.80}; give the path of a file.")
        self._path = Path(path)
        try:
            self._file = sqlite3.connect(self._path, timeout=60.0, check_same_thread=False)
            self._file.execute(
                "PRAGMA synchronous = OFF"
            )  # Ctrl-C loses nothing, lack of power may
            with self._file:
                self._file.execute("CREATE TABLE IF NOT EXISTS about (function TEXT, dims INTEGER)")
                self._file.execute(
                    "CREATE TABLE IF NOT EXISTS calls (point BLOB PRIMARY KEY, value REAL) WITHOUT ROWID"
                )
                known = self._file.execute("SELECT * FROM about").fetchone()
                if known is None:
                    self._file.execute("INSERT INTO about VALUES (?, ?)", (function, dims))
        except sqlite3.Error as error:
            raise FileFormatError(
                f"The cache {path} cannot be used ({error}); give a new path, or that of an earlier cache."
            ) from None
        if known not in (None, (function, dims)):
            self.close()
            raise ParameterError(
                f"The cache {path} is of {known[0]} in {known[1]} dims, not of {function} in {dims}; give "
                "another path."
            )

    def values(self, x: Array) -> Array:
        """The values of points (k, d), NaN where they are not known."""
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
