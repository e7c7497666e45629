"""Convergence: measured variance against n and its fitted rate.

The number of realizations is given, or grows until the variance is accurate enough.
The theory is in docs/theory.md, "Intervals of variances, and stopping".
The number of realizations grows in stages that depend only on earlier estimates.
Therefore the result has the same bits for any number of workers.

The search ends only if the next stage, at least a quarter longer, confirms the accuracy.
The estimated accuracy of a variance depends on the estimated kurtosis of the sample.
If a sample is skewed and its kurtosis is underestimated, the variance seems too accurate.
Estimates without any spread do not prove that the variance is 0.
After 10,000 equal estimates the error is NaN, and the precision is not reached.

Estimates may miss the source of the variance.
In this case the interval has no finite upper end, and the rate has no interval.
The attribute ``note`` gives the reason (`mcspectra.measure.blindness`).
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, final

import numpy as np
from msgspec import Meta

from mcspectra.core.analysis import (
    Counted,
    MergeTree,
    Need,
    Reduction,
    Steps,
    Subject,
    compute,
    in_step,
)
from mcspectra.core.checks import Array
from mcspectra.core.confidence import rounding_floor
from mcspectra.core.errors import ParameterError
from mcspectra.core.fits import check_window, fit_rates
from mcspectra.core.memory import memory_of
from mcspectra.core.options import COUNT, COUNTS, FIT_LAST, REALIZATIONS, Counts, Window
from mcspectra.core.parallel import (
    MAX_REALIZATIONS,
    Block,
    map_in_order,
    realization_blocks,
    slices,
)
from mcspectra.core.results import coordinate, dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator
from mcspectra.estimators.importance import as_subject
from mcspectra.estimators.moments import Moments
from mcspectra.estimators.tails import growth_exponents, tail_note
from mcspectra.measure.blindness import blindness, is_fixed
from mcspectra.samplers import Sampler
from mcspectra.samplers.law import independent_sets

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "Convergence",
    "MomentsCell",
    "RealizationsNeeded",
    "convergence",
    "count_moments",
    "count_stream",
    "realizations_needed",
]

# A smaller relative error would take billions of realizations
Precision = Annotated[float, Meta(ge=1e-4, le=1.0)]


@dataclass(frozen=True)
class StageSettings:
    """Lengths of the stages in a search for the number of realizations, and the size of blocks."""

    # Number of realizations of the first stage of a search.
    # The kurtosis of 100 normal estimates has a standard error of √(24/100) = 0.5.
    # Results are the same for values from 50 to 200.
    first: int = 100
    # A stage lengthens the sample by at least the factor `step`, and at most the factor `leap`.
    # If a sample that is a quarter longer is also accurate enough, the search ends.
    # The length of the next stage depends on the kurtosis of the sample.
    # With four times as many realizations, the kurtosis is twice as accurate.
    # If `step` is 1.1, a search for an error of 10 % stops too early, at an error of 10.3 %.
    # If `step` is 1.25, a search for an error of 10 % stops at an error of 9 %.
    # If `step` is 1.5, the search takes 30 % more realizations.
    # Results are the same for values of `leap` from 2 to 8
    # (`python -m benchmarks settings --stages`).
    step: float = 1.25
    leap: float = 4.0
    # The search ends if all estimates are equal after this number of realizations.
    # An event of probability 3e-4 occurs in 10,000 realizations with probability 95 %.
    blank: int = 10_000
    # The usual length of a block is divided by this number, so that threads share small analyses.
    # For example, a thousand realizations of a thousand points are two blocks for two threads.
    parts: int = 2
    # Largest number of points whose values show whether the integrand has a light tail.
    # The 256 farthest values form the tail of 6,400 or more values.
    of_tail: int = 2**14


STAGE_SETTINGS = StageSettings()
"""Default settings of searches for the number of realizations."""

# Fields of `Moments` that describe the tail of the distribution of estimates
_TAIL = ("largest_share", "resolved", "tail_index", "exponent")

_DIMS = {
    "variance": ("n", "channel"),
    "variance_ci": ("n", "channel", "bound"),
    "mean": ("n", "channel"),
    "mean_se": ("n", "channel"),
    "bias": ("n", "channel"),
    "bias_se": ("n", "channel"),
    "mse": ("n", "channel"),
    "realizations_used": ("n",),
    "reached": ("n",),
    "rate": ("channel",),
    "rate_ci": ("channel", "bound"),
    "fit_first_n": ("channel",),
    "fit_chi2": ("channel",),
}


@final
class Convergence(Counted, frozen=True, kw_only=True):
    """Variance against n, and its rate."""

    function = "convergence"
    verb = "converge"
    pictured = True
    several = ("estimator", "sampler")
    variables = tuple(_DIMS)

    counts: Annotated[Counts, COUNTS]
    realizations: Annotated[
        int,
        REALIZATIONS,
        Meta(
            description="Realizations at each count; with a relative error, the largest number.",
        ),
    ] = 1000
    relative_error: Annotated[
        Precision | None,
        Meta(
            description="Stop at a count when its variance has at most this relative standard "
            "error.",
        ),
    ] = None
    fit_last: Annotated[Window, FIT_LAST] = None

    def need(self, subject: Subject) -> Need:
        """Check that every sampler allows every count, and that all results fit in one dataset."""
        estimators, samplers = subject.estimators, subject.samplers
        check_window(self.fit_last, len(self.counts))
        channels = sorted({e.channels for e in estimators})
        if len(channels) > 1:
            raise ParameterError(
                f"The estimators have {' and '.join(map(str, channels))} channels; compare "
                "estimators with equal numbers."
            )
        for estimator, sampler, n in itertools.product(estimators, samplers, self.counts):
            estimator.check_sampler(sampler, n)
        evaluations = [sum(e.counts) for e in estimators]
        each = sum(e.cost for e in estimators) * len(samplers)
        whole = self.relative_error is None
        return Need(
            evaluations=sum(self.counts) * self.realizations * each if whole else 0,
            cost=float(sum(self.counts) * self.realizations * sum(evaluations) * len(samplers)),
            memory=memory_of(self.counts[-1], estimators[0].dims, max(evaluations)),
        )

    def reduction(self, subject: Subject, stream: Stream) -> Steps:
        """Yield the next realizations of each unit of work that is not finished."""
        cells = self._cells(subject, stream)
        found = yield from in_step([
            cell.all_of(part, self.realizations)
            if self.relative_error is None
            else cell.until_precise(part, self.relative_error, self.realizations)
            for part, cell in enumerate(cells)
        ])  # fmt: skip

        # Collect the moments of every estimator, sampler and count.
        # If several estimators share realizations, move the axis of the estimators to the front
        estimators, samplers = subject.estimators, subject.samplers
        flat = [each for cell in found for each in cell]
        joint = len(cells[0].estimators) > 1
        shape = (len(estimators), len(samplers), len(self.counts))

        def of_all(values: list[Any]) -> Array:
            array = np.array(values)
            if not joint:
                return array.reshape(*shape, *array.shape[1:])
            return np.moveaxis(array.reshape(*shape[1:], shape[0], *array.shape[1:]), 2, 0)

        taken = ("variance", "relative_se", "mean", "mean_se", "variance_ci", "count", *_TAIL)
        variance, relative, mean, mean_se, interval, count, *tail = (
            of_all([getattr(moments, name) for moments, _ in flat]) for name in taken
        )
        references = [e.known_integral() for e in estimators]
        integral = np.stack([np.atleast_1d(value) for value, *_ in references])[:, None, None]
        known = np.array([error for _, error, _ in references])[:, None, None, None]
        floor = rounding_floor(np.fmax(np.abs(mean), np.abs(integral)))

        # A deterministic set has no variance. Any spread is rounding noise
        fixed = np.array([[is_fixed(e, s) for s in samplers] for e in estimators])
        variance[fixed], interval[fixed], mean_se[fixed] = 0.0, 0.0, 0.0
        v, r, f = (np.moveaxis(a, 2, 0) for a in (variance, relative, floor))
        fits = fit_rates(np.array(self.counts), v, r, f, self.fit_last)

        # If estimates missed the source of the variance, its interval has no upper end.
        # The rate then has no interval
        measured = {
            "realizations": np.broadcast_to(count[..., None], variance.shape),
            "variance": variance,
            "relative_se": relative,
            **dict(zip(_TAIL, tail, strict=True)),
            "bias": mean - integral,
            "bias_se": np.hypot(mean_se, known),
            "floor": floor,
        }
        ns = np.array(self.counts)
        blind, notes = blindness(estimators, samplers, ns, self.realizations, measured)
        if np.isnan(integral).any():
            notes.append("the integral is unknown, so no bias is measured; give integral=…")
        interval[blind, 1] = np.inf
        fitted = (ns >= fits["first_n"][..., None]) & np.moveaxis(variance > floor, 2, -1)
        unknown = (fitted & np.moveaxis(blind, 2, -1)).any(axis=-1)
        fits["interval"][unknown] = -np.inf, np.inf
        values = {
            "variance": variance,
            "variance_ci": interval,
            "mean": mean,
            "mean_se": mean_se,
            "bias": measured["bias"],
            "bias_se": measured["bias_se"],
            "mse": np.where(
                np.isnan(integral),
                variance,
                (mean - integral) ** 2 + variance * ((count - 1) / count)[..., None],
            ),
            "realizations_used": count,
            **(
                {}
                if self.relative_error is None
                else {"reached": of_all([int(r) for _, r in flat])}
            ),
            "rate": fits["rate"],
            "rate_ci": fits["interval"],
            "fit_first_n": fits["first_n"],
            "fit_chi2": fits["chi2"],
        }

        # A single estimator, a single sampler and a scalar integrand have no dim in the result
        single = {
            "estimator": subject.estimator is estimators[0],
            "sampler": subject.sampler is samplers[0],
            "channel": all(e.channels == 0 for e in estimators),
        }
        labels = {
            "estimator": [e.spec for e in estimators],
            "sampler": [s.spec for s in samplers],
        }
        fitted = fits["first_n"][np.isfinite(fits["first_n"])]
        return dataset(
            {name: (("estimator", "sampler", *_DIMS[name]), v) for name, v in values.items()},
            {
                "n": coordinate("n", list(self.counts), "number of points"),
                "bound": ["low", "high"],
                **{name: texts for name, texts in labels.items() if not single[name]},
            },
            drop=[dim for dim, alone in single.items() if alone],
            **{name: texts[0] for name, texts in labels.items() if single[name]},
            realizations=self.realizations,
            relative_error=self.relative_error,
            fit_last=sum(n >= fitted.min() for n in self.counts) if fitted.size else None,
            fit_window="auto" if self.fit_last == "auto" else None,
            stream_key=f"{stream.key:#x}",
            integral_source="; ".join(dict.fromkeys(source for *_, source in references)),
            note="; ".join(notes) or None,
        )

    def part(self, subject: Subject, stream: Stream, key: str) -> Reduction[Any]:
        """Return the estimates of consecutive realizations of one unit of work."""
        part, first, realizations = map(int, key.split("-"))
        return self._cells(subject, stream)[part].run(part, first, realizations)

    def _cells(self, subject: Subject, stream: Stream) -> list[MomentsCell]:
        """Return units of work: each has a group of estimators, one sampler and one count.

        Estimators of one technique share the sampler's points, unless they have their own `draw`.
        Estimators that share points also share realizations.
        If a precision is requested, each estimator takes as many realizations as it needs.
        """
        estimators = tuple(subject.estimators)
        draws = AbstractEstimator.draw
        plain = all(e.counts == (1,) and type(e).draw is draws for e in estimators)
        joint = plain and self.relative_error is None
        return [
            MomentsCell(group, sampler, n, count_stream(stream, n))
            for group in ([estimators] if joint else [(e,) for e in estimators])
            for sampler in subject.samplers
            for n in self.counts
        ]


@final
class RealizationsNeeded(Counted, frozen=True, kw_only=True):
    """Number of realizations for a requested precision of the variance."""

    function = "measure.realizations_needed"
    variables = (
        *("realizations_used", "reached", "variance", "variance_ci", "variance_relative_se"),
        *("skewness", "kurtosis", "mean", "mean_se"),
    )
    provenance = ("estimator", "sampler", "n", "relative_error", "max_realizations", "stream_key")

    n: Annotated[int, COUNT]
    relative_error: Annotated[
        Precision, Meta(description="Requested relative standard error of the variance.")
    ] = 0.05
    max_realizations: Annotated[
        int,
        Meta(ge=2, le=MAX_REALIZATIONS, description="Most realizations, at any precision."),
    ] = 1_000_000

    def need(self, subject: Subject) -> Need:
        """Check that the sampler allows the count."""
        estimator = subject.estimator
        estimator.check_sampler(subject.sampler, self.n)
        evaluations = sum(estimator.counts)
        # Normal estimates have κ − 1 = 2
        expected = min(self.max_realizations, 2.0 / self.relative_error**2)
        memory = memory_of(self.n, estimator.dims, evaluations)
        return Need(cost=expected * self.n * evaluations, memory=memory)

    def reduction(self, subject: Subject, stream: Stream) -> Steps:
        """Yield the next realizations."""
        cell = MomentsCell((subject.estimator,), subject.sampler, self.n, stream)
        search = cell.until_precise(0, self.relative_error, self.max_realizations)
        (((moments, reached),),) = yield from in_step([search])
        varies = moments.variance > rounding_floor(moments.mean)
        second = np.where(varies, moments.m2, np.nan)
        values = {
            "variance": moments.variance,
            "variance_relative_se": np.where(varies, moments.known_se, np.nan),
            "skewness": math.sqrt(moments.count) * moments.m3 / second**1.5,
            "kurtosis": moments.count * moments.m4 / second**2,
            "mean": moments.mean,
            "mean_se": moments.mean_se,
            "variance_ci": moments.variance_ci,
        }
        return dataset(
            {
                "realizations_used": ((), np.int64(moments.count)),
                "reached": ((), np.int64(reached)),
                **{name: (("channel", "bound")[: v.ndim], v) for name, v in values.items()},
            },
            {"bound": ["low", "high"]},
            drop=() if subject.estimator.channels else ("channel",),
            note=tail_note(moments),
        )

    def part(self, subject: Subject, stream: Stream, key: str) -> Reduction[Any]:
        """Return the estimates of consecutive realizations."""
        cell = MomentsCell((subject.estimator,), subject.sampler, self.n, stream)
        return cell.run(*map(int, key.split("-")))


def convergence(
    estimator: Any,
    sampler: Any,
    counts: Sequence[int],
    *,
    dims: int | None = None,
    realizations: int = 1000,
    rng: RngLike = 0,
    relative_error: float | None = None,
    fit_last: int | str | None = None,
    max_evaluations: int | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Measure variance against the number of points and fit its rate.

    Parameters
    ----------
    estimator, sampler
        One estimator and one sampler, or a list of each, without duplicates.
        Samplers may be spec strings. For plain sampling, an estimator may be an integrand.
        An integrand's spec string, or a vectorized function of points (…, d), is also allowed.
    dims
        Number of dims of a function, or of a spec without ``dims``.
        The default is the number of dims of the sampler, unless the sampler is a spec.
    counts
        Ascending numbers of points n that every sampler allows.
    realizations
        Number of independent realizations for each n, at least 2.
        If `relative_error` is given, this is the maximum number of realizations.
    rng
        Seed (SPEC 7). Each n has its own stream of random numbers.
        All estimators and samplers share this stream (common random numbers).
    relative_error
        Relative standard error of the variance at which the search for each count stops.
        By default all realizations are used. See also `realizations_needed`.
    fit_last
        Number of the largest counts to which the rate is fitted. The default is all counts.
        ``"auto"`` uses the largest counts at which the log-log curve of the variance is straight
        (see `mcspectra.core.fits.fit_rate`).
    workers
        Number of threads. The default is all processors. It has no effect on results.
    max_evaluations
        Maximum number of evaluations of the integrand.
        If an analysis needs more evaluations, an error is raised, usually before the start.

    Returns
    -------
    xarray.Dataset
        ``variance(n)`` has the interval ``variance_ci(n, bound)``.
        ``mean(n)`` has the standard error ``mean_se(n)``.

        ``bias(n)`` and ``mse(n)`` refer to the estimator's integral.
        The attribute ``integral_source`` names the source of this integral.
        ``bias_se(n)`` includes the error of the integral.
        For a user's function without a given integral, ``bias`` and ``bias_se`` are NaN.
        Without a given integral, ``mse`` is the variance.

        ``realizations_used(n)`` is the number of realizations.
        With `relative_error`, ``reached(n)`` is 1 if the requested error was reached.
        ``reached`` is 0 if the maximum `realizations` was reached first.
        ``reached`` is also 0 if all estimates were equal.

        ``rate`` has the interval ``rate_ci(bound)``.
        ``fit_first_n`` is the smallest count of the fit.
        ``fit_chi2`` is the lack of fit per degree of freedom.

        A deterministic set has the variance 0 and no rate, which the attribute ``note`` reports.
        The note also reports estimates that may have missed most of the variance.
        The estimates may be all equal, or their tails may not be resolved.
        The mean of the estimates may be five standard errors from the integral.
        ∫g² may be infinite, or too large for the measured variance of random points.
        Most of ∫g² may lie where no sample falls (`mcspectra.estimators.tails`).

        Tails are not resolved in three cases.
        One estimate may have a fifth or more of Σ (estimate − mean)².
        The tail index k̂ of the estimates may be too large for a reliable variance.
        Values of a user's function of one technique may follow a power law.
        Much of the variance may then lie beyond the largest value.
        A user's function of one technique may also grow as t^−κ toward a face of the cube.
        For κ ≥ ¼, ∫g⁴ diverges, and the error of a measured variance has no bound.
        In these cases the upper end of ``variance_ci`` and both ends of ``rate_ci`` are infinite.

        A sampler may have fewer stored sets than realizations, and reuse them under translations.
        Standard errors are then at least as large as those of a jackknife over groups of sets.
        Lists add the dims estimator and sampler. Several channels add the dim channel.
        Counts whose variance is rounding noise are left out of the fit.
        The rate is NaN if fewer than two counts remain.

    Raises
    ------
    CountError, ParameterError
        If a sampler does not allow a count, dims disagree, or counts are not ascending.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> curve = mcs.convergence(mcs.Estimator("linear", dims=1), "jittered", [8, 32], rng=1)
    >>> round(float(curve["rate"]), 1)
    -3.0
    """
    subject = as_subject(estimator, sampler, dims=dims, lists=True)
    return compute(Convergence.of(locals()), subject, rng, workers)


def realizations_needed(
    estimator: Any,
    sampler: Sampler | str,
    n: int,
    *,
    dims: int | None = None,
    relative_error: float = 0.05,
    max_realizations: int = 1_000_000,
    rng: RngLike = 0,
    max_evaluations: int | None = None,
    workers: int | None = None,
) -> xr.Dataset:
    """Add realizations until the relative standard error of the variance is reached.

    Parameters
    ----------
    estimator, sampler, n
        The estimator, its sampler and the number of points.
    dims
        Number of dims of a function, or of a spec without ``dims``.
        The default is the number of dims of the sampler, unless the sampler is a spec.
    relative_error
        Requested relative standard error of the variance of every channel.
    max_realizations
        Largest number of realizations, at least 2.
    rng
        Seed (SPEC 7). Realization r uses the points of ``sampler.draw(n, rng=rng, first=r)``.
    workers
        Number of threads. The default is all processors. It has no effect on results.
    max_evaluations
        Maximum number of evaluations of the integrand.
        If an analysis needs more evaluations, an error is raised, usually before the start.

    Returns
    -------
    xarray.Dataset
        ``realizations_used`` is the number of realizations.
        ``reached`` is 1 if the last stage confirmed the error.
        ``reached`` is 0 if the maximum was reached first, or the estimates had no spread.
        ``variance`` has the interval ``variance_ci`` and the error ``variance_relative_se``.
        The error is NaN if all estimates are equal, and infinite if tails are not resolved.
        The attribute ``note`` reports tails that are not resolved.
        ``skewness`` and ``kurtosis`` describe the estimates; they are 0 and 3 for normal estimates.
        ``mean`` has the standard error ``mean_se``. Several channels add a dim channel.

    Raises
    ------
    ParameterError, CountError
        If a value is out of range, or the sampler does not allow `n`.

    Notes
    -----
    The search takes about (κ − 1)/relative_error² realizations, where κ is the kurtosis.
    The last stage, which confirms the accuracy, takes another quarter of the realizations.
    The search cannot account for events that are too rare to occur.
    ``skewness`` can be compared with the skewness of the integrand, if that is known.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> f = mcs.Estimator("linear", dims=1)
    >>> found = mcs.measure.realizations_needed(f, "jittered", 16, relative_error=0.1, rng=1)
    >>> bool(found["reached"]), bool(found["variance_relative_se"] <= 0.1)
    (True, True)
    """
    subject = as_subject(estimator, sampler, dims=dims)
    return compute(RealizationsNeeded.of(locals()), subject, rng, workers)


_Found: TypeAlias = tuple[Moments, bool]  # Moments, and whether the requested precision was reached

_Search: TypeAlias = "Generator[Reduction[list[Moments]], list[Moments], list[_Found]]"


@final
@dataclass(frozen=True)
class MomentsCell:
    """Moments of the estimates of a group of estimators that use the same sets of n points."""

    estimators: tuple[AbstractEstimator, ...]
    sampler: Sampler
    n: int
    stream: Stream

    def run(self, part: int, first: int, realizations: int) -> Reduction[list[Moments]]:
        """Return moments of each estimator over the realizations `first`, `first` + 1 and so on."""
        evaluations = self.n * sum(self.estimators[0].counts)
        numbers = evaluations * self.estimators[0].dims  # Number of coordinates of a realization
        blocks = realization_blocks(realizations, STAGE_SETTINGS.parts * numbers, first=first)
        sets = independent_sets(self.estimators[0].law(self.sampler, self.n))

        def estimates(block: Block) -> list[tuple[Array, Moments | None, Array | None]]:
            points = self.estimators[0].draw(self.sampler, self.n, self.stream, *block)
            return [of_estimator(e, points, block[0]) for e in self.estimators]

        def of_estimator(
            e: AbstractEstimator, points: list[Array], start: int
        ) -> tuple[Array, Moments | None, Array | None]:
            """Return estimates (R, C), moments of the values of a user's function, and their tail.

            C is the number of channels, or 1 for an integrand without channels.
            The first realizations show whether the function has a light tail,
            and whether a user's function grows toward a face of the cube.
            """
            if len(points) > 1:
                return e.estimate(points).reshape(len(points[0]), -1), None, None
            values = e.primary_values(0, points[0])
            alone = values.reshape(values.shape[0] * values.shape[1], -1)
            found = light = None
            if start == 0:
                light = Moments.of_points(alone[: STAGE_SETTINGS.of_tail]).has_light_tail()
            if e.is_black_box:
                found = Moments.of_points(alone)
                if start == 0:
                    growth = growth_exponents(points[0].reshape(len(alone), -1), alone)
                    found = replace(found, growth=growth)
            return e.estimate_of([values]).reshape(len(values), -1), found, light

        def moments(index: int) -> list[Moments]:
            parts = zip(*map(estimates, slices(blocks[index], numbers)), strict=True)
            found = []
            for each in parts:
                values, points, lights = zip(*each, strict=True)
                start = blocks[index][0]
                whole = Moments.of(np.concatenate(values), tails=True, first=start, sets=sets)
                alone = None if points[0] is None else functools.reduce(Moments.merge, points)
                found.append(replace(whole, points=alone, light=lights[0]))
            return found

        return Reduction(
            kind=list[Moments],
            block=moments,
            blocks=len(blocks),
            cost=float(realizations * evaluations * len(self.estimators)),
            key=f"{part}-{first}-{realizations}",
        )

    def all_of(self, part: int, realizations: int) -> _Search:
        """Use a given number of realizations."""
        return [(moments, True) for moments in (yield self.run(part, 0, realizations))]

    def until_precise(
        self,
        part: int,
        relative_error: float,
        most: int,
        settings: StageSettings = STAGE_SETTINGS,
    ) -> _Search:
        """Add realizations for one estimator until the requested error is confirmed."""
        (moments,) = yield self.run(part, 0, min(settings.first, most))
        before = False
        while True:
            # Largest error among the channels that vary, or NaN if none varies
            varies = moments.variance > rounding_floor(moments.mean)
            error = float(moments.known_se[varies].max()) if varies.any() else math.nan
            now, blank = error <= relative_error, math.isnan(error)
            if (now and before) or moments.count >= (min(most, settings.blank) if blank else most):
                return [(moments, now and before)]
            before = now
            # Predict the number of realizations for which the error is small enough.
            # The factor by which a stage lengthens the sample is limited from below and above
            excess = math.inf if blank else error / relative_error
            longer = min(max(excess**2, settings.step), settings.leap)
            stop = min(most, math.ceil(moments.count * longer))
            (more,) = yield self.run(part, moments.count, stop - moments.count)
            moments = moments.merge(more)


def count_stream(stream: Stream, n: int) -> Stream:
    """Return the stream of one count, which all estimators and samplers share."""
    return stream.child(n)


def count_moments(
    estimator: AbstractEstimator,
    sampler: Sampler,
    n: int,
    realizations: int,
    stream: Stream,
    workers: int = 1,
    first: int = 0,
) -> Moments:
    """Return moments of the estimates of consecutive realizations, starting at `first`."""
    run = MomentsCell((estimator,), sampler, n, stream).run(0, first, realizations)
    tree: MergeTree[list[Moments]] = MergeTree()
    for state in map_in_order(run.block, range(run.blocks), workers):
        tree.add(state)
    return tree.total()[0]
