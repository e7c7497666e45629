"""How many realisations: a given number, or until the variance is known well enough.

The relative standard error of a measured variance is √((κ − 1)/R) for R estimates of kurtosis κ: 5 %
takes 800 of normal ones, and many more where few estimates carry most of the spread. κ is not known
in advance, so that the number is found by going on: sequentially, in stages fixed by what was
seen so far, hence the same bits for any number of workers.

What has not been seen cannot be counted. A stop is believed only when the next stage, at least a
quarter longer, confirms it, because the first stop of a skewed sample tends to be a moment at which κ
is underestimated; and estimates that have shown no spread at all are no evidence of none: 10 000 are
tried, then the error is given as NaN, and the goal as not reached.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from mcspectra.core.checks import as_integer, as_real
from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers, map_in_order
from mcspectra.core.results import dataset
from mcspectra.core.staged import MergeTree, compute
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, Moments, as_estimator
from mcspectra.estimators.moments import rounding_floor
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.variance.staged_moments import (
    Found,
    MomentsCell,
    Search,
    StagedMoments,
    merge_moments,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "all_realizations",
    "check_relative_error",
    "count_moments",
    "joint_moments",
    "realizations_needed",
    "relative_error_of",
    "staged_realizations_needed",
    "until_precise",
]

Variables: TypeAlias = dict[str, tuple[tuple[str, ...], Any]]

_LEAST = 100  # realisations of the first stage: κ of fewer says little
_STEP = 1.25  # a stage makes the sample longer by a quarter at least,
_LEAP = 4.0  # and at most fourfold: κ is known better then
_BLANK = 10_000  # realisations without spread after which the search is given up


def realizations_needed(
    estimator: Any,
    sampler: Sampler | str,
    n: int,
    *,
    relative_error: float = 0.05,
    max_realizations: int = 1_000_000,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Go on until the relative standard error of the variance is reached.

    Parameters
    ----------
    estimator, sampler, n
        What is measured.
    relative_error
        Wanted standard error of the variance, relative to it, of every channel.
    max_realizations
        Stop there in any case, at least 2.
    rng
        Seed (SPEC 7). Realisation r uses the points of ``sampler.draw(n, rng=rng, first=r)``.
    workers
        Threads; all processors by default. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        ``realizations_used``, ``reached`` (1: yes, confirmed by the last stage; 0: the maximum came
        first, or the estimates showed no spread), ``variance`` with ``variance_ci``,
        ``variance_relative_se`` (NaN without spread), ``skewness`` and ``kurtosis`` of the
        estimates (0 and 3 for normal ones), ``mean``, ``mean_se``; a dim channel where f has several.

    Raises
    ------
    ParameterError, CountError
        A value is out of range, or the sampler cannot do `n`.

    Notes
    -----
    About (κ − 1)/relative_error² realisations, and a quarter more to confirm. What is so rare that it
    has not come up cannot be known of: compare ``skewness`` with what the integrand lets expect.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> f = mcs.Estimator("linear", dims=1)
    >>> found = mcs.realizations_needed(f, "jittered", 16, relative_error=0.1, rng=1)
    >>> bool(found["reached"]), bool(found["variance_relative_se"] <= 0.1)
    (True, True)
    """
    threads = available_workers(workers)
    return compute(
        staged_realizations_needed(
            estimator,
            sampler,
            n,
            relative_error=relative_error,
            max_realizations=max_realizations,
            rng=rng,
        ),
        threads,
        "realizations_needed",
    )


def staged_realizations_needed(
    estimator: Any,
    sampler: Sampler | str,
    n: int,
    *,
    relative_error: float = 0.05,
    max_realizations: int = 1_000_000,
    rng: RngLike = 0,
) -> StagedMoments:
    """Return `realizations_needed` as a staged analysis, its arguments checked."""
    estimator = as_estimator(estimator, getattr(sampler, "dims", None))
    source = as_sampler(sampler, estimator.dims)
    n = source.check_count(n)
    estimator.check_sampler(source, n)
    goal = check_relative_error(relative_error)
    most = as_integer("max_realizations", max_realizations, least=2, most=MAX_REALIZATIONS)
    stream = Stream.from_rng(rng)

    def result(found: list[list[Found]]) -> xr.Dataset:
        ((moments, reached),) = found[0]
        names = {"realizations_used": np.int64(moments.count), "reached": np.int64(reached)}
        used: Variables = {name: ((), value) for name, value in names.items()}
        return dataset(
            used | _summary(moments, scalar=estimator.channels == 0),
            {"bound": ["low", "high"]},
            estimator=estimator.spec,
            sampler=source.spec,
            n=n,
            relative_error=goal,
            max_realizations=most,
            stream_key=f"{stream.key:#x}",
            seed=rng if isinstance(rng, int) else None,
        )

    cell = MomentsCell((estimator,), source, n, stream)
    return StagedMoments((cell,), until_precise(goal, most), result)


def check_relative_error(value: object) -> float:
    """Return a wanted relative standard error after checking that it can be reached at all."""
    goal = as_real("relative_error", value, above=0.0, most=1.0)
    if 0.5 / goal**2 > MAX_REALIZATIONS:
        raise ParameterError(
            f"relative_error is {goal:g}, which takes more than {MAX_REALIZATIONS} realisations; "
            "give 1e-4 or more."
        )
    return goal


def count_moments(
    estimator: AbstractEstimator,
    sampler: Sampler,
    n: int,
    realizations: int,
    stream: Stream,
    workers: int = 1,
    first: int = 0,
) -> Moments:
    """Moments of the estimates of realisations first … first + realizations − 1, channels last."""
    return joint_moments([estimator], sampler, n, realizations, stream, workers, first)[0]


def joint_moments(
    estimators: Sequence[AbstractEstimator],
    sampler: Sampler,
    n: int,
    realizations: int,
    stream: Stream,
    workers: int = 1,
    first: int = 0,
) -> list[Moments]:
    """Return `count_moments` of several estimators that draw the same points; drawn once."""
    cell = MomentsCell(tuple(estimators), sampler, n, stream)
    tree = MergeTree(merge_moments)
    for moments in map_in_order(cell.moments, cell.blocks(first, realizations), workers):
        tree.add(moments)
    return tree.total()


def all_realizations(realizations: int) -> Callable[[MomentsCell, int], Search]:
    """Return a search that takes a given number of realisations."""

    def search(cell: MomentsCell, part: int) -> Search:
        return [(moments, True) for moments in (yield cell.run(part, 0, realizations))]

    return search


def until_precise(relative_error: float, most: int) -> Callable[[MomentsCell, int], Search]:
    """Return a search that goes on until the error is reached and confirmed, for one estimator."""

    def search(cell: MomentsCell, part: int) -> Search:
        (total,) = yield cell.run(part, 0, min(_LEAST, most))
        before = False
        while True:
            error = relative_error_of(total)
            now = error <= relative_error
            blank = math.isnan(error)
            if (now and before) or total.count >= (min(most, _BLANK) if blank else most):
                return [(total, now and before)]
            before = now
            stop = min(most, _next_stop(total.count, math.inf if blank else error / relative_error))
            (more,) = yield cell.run(part, total.count, stop - total.count)
            total = total.merge(more)

    return search


def relative_error_of(moments: Moments) -> float:
    """Largest relative standard error among the channels that vary; NaN if none does."""
    varies = moments.variance > rounding_floor(moments.mean)
    return float(moments.relative_se[varies].max()) if varies.any() else math.nan


def _next_stop(count: int, excess: float) -> int:
    """Where the next stage ends: where the error should be reached, within a quarter to fourfold."""
    return math.ceil(count * min(max(excess**2, _STEP), _LEAP))


def _summary(moments: Moments, *, scalar: bool) -> Variables:
    """Result variables of the moments of one count."""
    varies = moments.variance > rounding_floor(moments.mean)
    second = np.where(varies, moments.m2, np.nan)
    values = {
        "variance": moments.variance,
        "variance_relative_se": np.where(varies, moments.relative_se, np.nan),
        "skewness": math.sqrt(moments.count) * moments.m3 / second**1.5,
        "kurtosis": moments.count * moments.m4 / second**2,
        "mean": moments.mean,
        "mean_se": moments.mean_se,
        "variance_ci": moments.variance_ci,
    }
    dims = {name: ("channel", "bound")[: value.ndim] for name, value in values.items()}
    if scalar:
        return {name: (dims[name][1:], value[0]) for name, value in values.items()}
    return {name: (dims[name], value) for name, value in values.items()}
