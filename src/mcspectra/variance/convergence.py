"""Convergence: measured variance against n and its fitted rate.

The rate is the slope of log variance against log n (`mcspectra.variance.fit`). The variance is that of
the realisations, a sample variance with ddof = 1, which is unbiased for the variance of the estimator;
its relative standard error, from the kurtosis of the estimates, is its weight in the fit.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers
from mcspectra.core.staged import compute
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, as_estimator
from mcspectra.estimators.tails import unsampled_note
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.variance._curves import curve_from_moments, fitted_counts, labelled
from mcspectra.variance.fit import check_window
from mcspectra.variance.staged_moments import Found, MomentsCell, Search, StagedMoments
from mcspectra.variance.stopping import all_realizations, check_relative_error, until_precise

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["convergence", "count_stream", "staged_convergence"]


def convergence(
    estimator: Any,
    sampler: Any,
    counts: Sequence[int],
    *,
    realizations: int = 1000,
    rng: RngLike = 0,
    relative_error: float | None = None,
    fit_last: int | str | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Measure variance against the number of points and fit its rate.

    Parameters
    ----------
    estimator, sampler
        One or a list of each, no sampler twice. Samplers may be spec strings, estimators may be
        integrands or their spec strings, for plain sampling.
    counts
        Numbers of points n, ascending; each must be one that every sampler can do.
    realizations
        Independent realisations for each n, at least 2; with `relative_error` the most of each.
    rng
        Seed (SPEC 7); each n has a stream of its own, shared by all estimators and samplers
        (common random numbers).
    relative_error
        Stop each count as soon as the standard error of its variance, relative to it, is this small
        (`realizations_needed`); by default all realisations are used.
    fit_last
        Fit only the last so many counts; all by default. ``"auto"`` takes as many as lie on a
        line: `mcspectra.variance.fit.fit_rate`.
    workers
        Threads; all processors by default. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        ``variance(n)``, ``variance_ci(n, bound)``, ``mean(n)``, ``mean_se(n)``, ``bias(n)`` and
        ``mse(n)`` against the estimator's integral (attribute ``integral_source``), ``bias_se(n)``,
        which has the integral's own error in it, ``realizations_used(n)``, with `relative_error`
        ``reached(n)`` (1: yes; 0: `realizations` came first, or there was no spread), ``rate``,
        ``rate_ci(bound)``, ``fit_first_n`` (the smallest count of the fit) and ``fit_chi2`` (its lack of
        fit per degree of freedom). The attribute ``note`` says where the largest simulation cannot
        see most of a variance (`mcspectra.estimators.tails`). Lists add the dims estimator and sampler, several channels the dim
        channel. Counts whose variance is rounding noise are left out of the fit; the rate of fewer
        than two others is NaN.

    Raises
    ------
    CountError, ParameterError
        A sampler cannot do a count, dims disagree, counts are not ascending.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> curve = mcs.convergence(mcs.Estimator("linear", dims=1), "jittered", [8, 32], rng=1)
    >>> round(float(curve["rate"]), 1)
    -3.0
    """
    threads = available_workers(workers)
    return compute(
        staged_convergence(
            estimator,
            sampler,
            counts,
            realizations=realizations,
            rng=rng,
            relative_error=relative_error,
            fit_last=fit_last,
        ),
        threads,
        "convergence",
    )


def staged_convergence(
    estimator: Any,
    sampler: Any,
    counts: Sequence[int],
    *,
    realizations: int = 1000,
    rng: RngLike = 0,
    relative_error: float | None = None,
    fit_last: int | str | None = None,
) -> StagedMoments:
    """Return `convergence` as a staged analysis, its arguments checked.

    A run is a count of one sampler, or with `relative_error` the next realisations of one.
    """
    several, given = isinstance(estimator, list | tuple), isinstance(sampler, list | tuple)
    if (several and not estimator) or (given and not sampler):
        raise ParameterError("convergence needs at least one estimator and one sampler.")
    estimators = [as_estimator(e) for e in (estimator if several else [estimator])]
    samplers = [as_sampler(s, estimators[0].dims) for s in (sampler if given else [sampler])]
    _check_comparable(estimators, samplers)
    job = _Job(
        tuple(estimators),
        tuple(samplers),
        tuple(_check_counts(counts, estimators, samplers)),
        as_integer("realizations", realizations, least=2, most=MAX_REALIZATIONS),
        Stream.from_rng(rng),
        rng if isinstance(rng, int) else None,
        None if relative_error is None else check_relative_error(relative_error),
        check_window(fit_last, len(counts)),
        several,
        given,
    )
    return StagedMoments(job.cells, job.search, job.result)


@dataclass(frozen=True)
class _Job:
    """What is asked for.

    Attributes
    ----------
    several, given
        Whether estimators, and samplers, are lists, which have dims of their own.
    """

    estimators: tuple[AbstractEstimator, ...]
    samplers: tuple[Sampler, ...]
    counts: tuple[int, ...]
    realizations: int
    stream: Stream
    seed: int | None
    goal: float | None
    window: int | str
    several: bool
    given: bool

    @property
    def groups(self) -> list[tuple[AbstractEstimator, ...]]:
        """Estimators that share points and realisations.

        One technique that has no `draw` of its own gets the sampler's points: all such share them.
        A wanted precision takes as many realisations as each estimator needs by itself.
        """
        draws = AbstractEstimator.draw
        plain = all(e.counts == (1,) and type(e).draw is draws for e in self.estimators)
        joint = plain and self.goal is None
        return [self.estimators] if joint else [(e,) for e in self.estimators]

    @property
    def cells(self) -> tuple[MomentsCell, ...]:
        """By group, by sampler, by count."""
        return tuple(
            MomentsCell(group, s, n, count_stream(self.stream, n))
            for group in self.groups
            for s in self.samplers
            for n in self.counts
        )

    @property
    def search(self) -> Callable[[MomentsCell, int], Search]:
        """How many realisations a cell takes."""
        if self.goal is None:
            return all_realizations(self.realizations)
        return until_precise(self.goal, self.realizations)

    def result(self, found: list[list[Found]]) -> xr.Dataset:
        """Dataset of what was found in the cells."""
        rest = iter(found)
        grid = []
        for group in self.groups:
            rows = [list(itertools.islice(rest, len(self.counts))) for _ in self.samplers]
            for place, estimator in enumerate(group):
                own = ([cell[place] for cell in row] for row in rows)
                grid.append([self._curve(estimator, cells) for cells in own])
        return self._labelled(grid)

    def _curve(self, estimator: AbstractEstimator, found: list[Found]) -> dict[str, Array]:
        """Variables of one estimator with one sampler."""
        moments = [m for m, _ in found]
        integral = np.atleast_1d(estimator.integral)
        curve = curve_from_moments(list(self.counts), moments, integral, self.window)
        curve["bias_se"] = np.hypot(curve["mean_se"], estimator.integral_error)
        if self.goal is not None:
            curve["reached"] = np.array([np.int64(reached) for _, reached in found])
        return curve

    def _labelled(self, grid: list[list[dict[str, Array]]]) -> xr.Dataset:
        """Label a grid estimator × sampler."""
        singles = {
            "estimator": not self.several,
            "sampler": not self.given,
            "channel": all(e.channels == 0 for e in self.estimators),
        }
        samples = self.counts[-1] * self.realizations
        return labelled(
            grid,
            list(self.counts),
            drop=[name for name, single in singles.items() if single],
            coords={
                "estimator": [e.spec for e in self.estimators],
                "sampler": [s.spec for s in self.samplers],
            },
            realizations=self.realizations,
            relative_error=self.goal,
            fit_last=fitted_counts(list(self.counts), grid),
            fit_window="auto" if self.window == "auto" else None,
            stream_key=f"{self.stream.key:#x}",
            seed=self.seed,
            integral_source="; ".join(dict.fromkeys(e.integral_source for e in self.estimators)),
            note="; ".join(_notes(self.estimators, samples)) or None,
        )


def _notes(estimators: Iterable[AbstractEstimator], samples: int) -> Iterator[str]:
    """What to say of estimators whose variance no simulation of this size can measure."""
    for estimator in estimators:
        note = unsampled_note(estimator, samples)
        if note:
            yield f"{estimator.spec}: {note}"


def count_stream(stream: Stream, n: int) -> Stream:
    """The stream of one count: the same for every estimator and sampler, another for every n."""
    return stream.child(n)


def _check_comparable(estimators: list[AbstractEstimator], samplers: list[Sampler]) -> None:
    """Raise unless all fit in one dataset: equal channels, samplers that differ."""
    channels = sorted({e.channels for e in estimators})
    if len(channels) > 1:
        raise ParameterError(
            f"The estimators have {' and '.join(map(str, channels))} channels; compare those of "
            "equal numbers."
        )
    names = [s.spec for s in samplers]
    for name in names:
        if names.count(name) > 1:
            raise ParameterError(f"The sampler {name} is listed twice; list each once.")


def _check_counts(
    counts: Any, estimators: list[AbstractEstimator], samplers: list[Sampler]
) -> list[int]:
    if not isinstance(counts, Sequence | np.ndarray) or isinstance(counts, str):
        raise ParameterError(f"counts is {counts!r}; give a list of ascending numbers of points.")
    if any(np.ndim(n) > 0 for n in counts if not isinstance(n, str)):
        raise ParameterError(
            f"counts is {counts!r}; give one flat list of numbers, not lists in it."
        )
    ns = [as_integer("counts", n, least=1) for n in counts]
    if not ns or any(b <= a for a, b in itertools.pairwise(ns)):
        raise ParameterError(f"counts is {list(counts)}; give ascending numbers of points.")
    for e in estimators:
        for s in samplers:
            for n in ns:
                e.check_sampler(s, n)
    return ns
