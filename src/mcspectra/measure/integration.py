"""An integral with its interval for a budget of calls, from replicates of randomized sets.

A budget of N calls is divided into R replicates of n points.
If the variance of a replicate is ∝ n^-θ, the interval has a half width ∝ t_{R−1} n^{−θ/2} R^{−1/2}.
For large θ, few replicates of many points are best.
For example, θ is large for smooth functions with scrambled nets.
For θ near 1, more replicates are best, because they make the quantile t smaller at no cost.

A quarter of the budget measures θ with eight replicates.
The eight replicates are prefixes of randomized sequences. Later sets start with the same points.

If a profile of f is given, it contains θ, so that θ need not be measured.
With a profile, all points form one net or lattice.
The net or lattice is divided into R runs of n points, which replace the replicates.
Each run is a net or a lattice itself.
The errors of the runs partly cancel: their mean is as accurate as one set of all points.
The interval of independent replicates is therefore too wide, by the factor R^{(θ−1)/2}.
For nets, the interval is divided by the square root of R^{(θ−1)/2}.
For lattices, the interval is not changed, because the rates of lattices vary with n.

Two intervals are computed: one from Student's t, and one that Hall's transform corrects for skew.
The result is the smallest interval that contains Student's interval and Hall's interval.
Intervals of `mean_interval` were tested with 300 seeds at 256 calls.
`mean_interval` contains the integral of x^−½ in 88 % of cases, and Student's t in 74 %.
For e^(x + y), `mean_interval` contains the integral in 97 % of cases, and Student's t in 96 %.

If f grows without bound toward a face of the cube, the errors of strata are skewed.
Quantiles of skewed errors (`estimators/tails.py`) are used if they widen the interval.

Student's t and Hall's transform are accurate for many replicates; here R is at least eight.
Replicates may all miss an event whose probability in one replicate is below 1/R.
An interval from replicates that missed an event is too short [Owen2025]_.
A rare event is, for example, a point between a cell border of a net and a nearby jump of f.
Intervals that hold for any bounded function would need many replicates of few points:
n = Θ(N^{1/(θ+1)}) points for a budget of N calls [Jain2026]_.
Replicates of few points would have ten times the error if f is smooth.

A few linear scrambles of a net cause most of the variance.
All linear scrambles except a few bad ones have far smaller errors.
The *median* of replicates ignores the few bad scrambles.
For smooth f, the error of the median falls faster than any power of n ([Pan2024]_).
An estimate is above the median with probability one half.
Therefore order statistics bound the median for any distribution.
Nested scrambles have no bad scrambles, so the mean of their replicates is better.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_choice, as_integer, as_real
from mcspectra.core.confidence import rounding_floor, student_t
from mcspectra.core.errors import (
    Function,
    InfiniteVarianceWarning,
    Parameter,
    ParameterError,
    warn,
)
from mcspectra.core.memory import check_memory, memory_of
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import (
    AbstractEstimator,
    Estimator,
    as_estimator,
    function_dims,
    is_function,
)
from mcspectra.estimators.moments import Moments, mean_interval
from mcspectra.estimators.tails import (
    border_growth,
    few_note,
    growing_interval,
    growth_note,
    tail_note,
    tied_error,
)
from mcspectra.integrands import Calls, FunctionIntegrand, Integrand
from mcspectra.measure.setup import Setup, affordable_count
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.samplers.lattice import nested_lattices
from mcspectra.samplers.law import Fixed, Independent, Law, Scrambled, leaf_of

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["integrate"]


@dataclass(frozen=True)
class IntegrationSettings:
    """Settings that divide a budget into replicates, and that choose between median and mean.

    Numbers in the comments are from 40 runs with 512 and with 4,096 calls on five functions.
    The functions are two smooth ones in 2 and 4 dims, x^−½, a quarter disk and a kink.
    """

    # Least number of replicates.
    # For smooth functions, intervals of 16 replicates are wider than intervals of 8 replicates.
    # The ratio of their widths is 1.6 to 1.9.
    # Intervals of 4 replicates are as wide as intervals of 8 on average.
    # Four replicates miss an event of probability 1/8 more often than eight replicates do.
    least: int = 8
    # One large set can be divided into parts (runs), which replace independent replicates.
    # Largest number of runs into which one set is divided.
    # With 128 runs, intervals are only 2 % narrower if θ is 1.
    # Estimates from runs of a few points have heavy tails.
    most_runs: int = 32
    # Least number of replicates of a median. It is odd, so that one replicate is the median.
    # The 95 % interval of the median extends from the second replicate to the last but one.
    # One bad scramble at either end of the sorted replicates therefore has no effect.
    # On average, intervals of 7 replicates are as wide as intervals of 11 replicates.
    # Intervals of 21 replicates are 1.5 times as wide as intervals of 11 replicates.
    least_of_median: int = 11
    # Number of points for which the law of the sampler (the distribution of its points) is found.
    # The law shows how the points are scrambled, which is the same for all numbers of points.
    law_at: int = 64
    # The rate is measured with sets that have fewer points than the final sets.
    # Largest ratio of the points of a final set to the points of a set that measures the rate.
    # Results are the same for ratios from 2 to 8: widths of intervals differ by 1 % on average.
    pilot: int = 4
    # Number of initial parts (prefixes) of a replicate to which the rate is fitted.
    # Each initial part has half as many points as the next.
    # If the rate is fitted to 2 initial parts of each replicate, intervals are 6 % wider.
    # Results are the same for values from 4 to 6.
    levels: int = 4
    # The median is preferred if the interval of the mean is wider by more than this factor.
    # With a factor of 1, the median's interval contains the integral in 90 % of runs, not 93 %.
    # With a factor of 4, the intervals of the median are 12 % wider.
    stands_out: float = 2.0
    # Number of calls before the width of the interval is first compared with a tolerance.
    # The first calls are 8 replicates of 128 points, whose interval is right for usual functions.
    first: int = 2**10
    # The measured rate gives the number of calls that the tolerance requires.
    # In each round, the required number of calls is multiplied by this factor.
    # The width of an interval from 8 replicates has a standard error of 25 %.
    # With 30 % more calls, two rounds are nevertheless enough for most tolerances.
    margin: float = 1.3
    # Largest ratio between the numbers of calls of consecutive rounds.
    # The ratio of calls is limited because the first measured rates are uncertain.
    growth: float = 4.0
    # If the advised points are blind to f, such as a lattice to waves of its own frequency,
    # the values of f at the points hardly vary, and the replicates agree on a wrong value.
    # Points are blind if the variance of f at them is below this share of that in the profile.
    # At 4096 points that resolve f, the share is 1 up to a few percent.
    seen: float = 0.01
    # The estimates of the profile and of the new calls contradict each other if their distance
    # exceeds this number of half widths of the 95 % interval of their difference.
    # Two half widths are 4 standard errors; a normal error exceeds them with probability 6e-5.
    apart: float = 2.0


_SETTINGS = IntegrationSettings()

_SIDE = 0.025  # Probability that the true value lies above (or below) a 95 % interval
_RATES = 1.0, 3.0  # Exponent θ of random points, and of smooth functions with scrambled nets


def integrate(
    f: Callable[[Any], Any] | Integrand | AbstractEstimator | str,
    *,
    budget: int,
    sampler: Sampler | str | None = None,
    dims: int | None = None,
    combine: str = "mean",
    vectorized: bool = True,
    workers: int = 1,
    cache: str | os.PathLike[str] | None = None,
    on_error: str = "raise",
    tolerance: float | None = None,
    profile: Any = None,
    rng: RngLike = 0,
) -> xr.Dataset:
    """Integrate a function over [0,1)^d within a number of calls, with a 95 % interval.

    Parameters
    ----------
    f
        A vectorized function of points (…, d) with values (…).
        f may also be an integrand without channels, or its spec string.
        An estimator of one technique is also allowed, such as ``Estimator(f, density)``.
    budget
        Maximum number of calls of f, where each point is one call.
    sampler
        A randomized sampler. The default is ``"sobol | owen"``, for the median ``"sobol | lms"``.
    dims
        Number of dims. It is needed if neither f nor the sampler has a number of dims.
    combine
        ``"mean"`` of the replicates, or ``"median"`` for linear scrambles such as ``lms``.
        The median is far better for smooth f in one dim.
        In two dims the median is far better with more than about 2,000 calls.
    vectorized, workers, cache
        Options for slow functions: see `mcspectra.integrands.Calls`.
        An interrupted call continues when it is repeated with the same cache.
        The repeated call gives the same bits as a call without interruption.
    on_error
        ``"raise"`` raises an error if f fails or is not finite. ``"skip"`` counts failed points.
        In the value, each failed point counts as the mean of the points that did not fail.
        For the interval, failed points may have any value between the least and the largest.
        The note reports the number of failed points and the first failed point.
    tolerance
        Evaluation stops when the half width of the interval has fallen to this number.
        The note reports if the budget is spent before the tolerance is reached.
    profile
        A profile of f (`mcspectra.Profile`), which recommends the estimator and the sampler.
        Evaluations of the profile are reused, and are not counted in `budget`.
        The result combines the integral of the profile with the integral of the new calls.
        Each integral is weighted by the inverse square of the width of its interval.
        If the two integrals contradict each other, the interval contains both of their intervals.
    rng
        Seed (SPEC 7).

    Returns
    -------
    xarray.Dataset
        ``value`` is the integral, or NaN without an integral.

        ``interval(bound)`` is the 95 % interval of the value, over the replicates.
        For a median, the interval is for the median of the distribution of replicates.
        The interval contains the median of this distribution with probability at least 95 %.

        ``calls`` is the number of calls, and ``skipped`` the number of failed calls.
        There are ``replicates`` replicates of ``n`` points each.
        ``rate`` is the rate of the variance, from which ``n`` is chosen. It is NaN if not measured.

        The interval is infinite in three cases, and the attribute ``note`` gives the reason.
        All replicates may be equal, or a few values may hold most of the variance.
        The growth of f toward a face of the cube may make its variance infinite.
        Growth with a finite variance widens the interval on one side only:
        upward if f grows to +∞, and downward if f falls to −∞.

    Warns
    -----
    InfiniteVarianceWarning
        If the variance of f is infinite, or the integral of f does not exist.

    Raises
    ------
    ParameterError
        If a value is out of range, or the sampler is not random.
        If f has channels or several techniques.
        If the budget is too small for eight replicates, or for eleven replicates of a median.
        If a median is requested without linear scrambles.
        For errors of the calls of f, see `mcspectra.integrands.Calls`.
    ConfigError
        If the points and values of the budget exceed this machine's memory.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.integrate(lambda x: x[..., 0] * x[..., 1], dims=2, budget=2000)
    >>> bool(found["interval"][0] < 0.25 < found["interval"][1])
    True
    >>> int(found["calls"]), int(found["n"])
    (1920, 128)
    """
    # Make an estimator of the function, and the sampler
    if profile is not None:
        if sampler is not None or cache is not None:
            given = "sampler" if sampler is not None else "cache"
            raise ParameterError(
                Parameter(given),
                " is given and ",
                Parameter("profile"),
                ", which has its own; give one of both.",
            )
        f, sampler = _advised(f, profile)
    least_width = 0.0 if tolerance is None else as_real("tolerance", tolerance, above=0.0)
    inner, known = f, dims if dims is not None else getattr(sampler, "dims", None)
    if is_function(f):
        known = function_dims(f, known)
    else:
        estimator = as_estimator(f, known)
        if estimator.counts != (1,):
            raise ParameterError(
                f"{estimator.spec} has several techniques; integrate one, or use ",
                Function("convergence"),
                ".",
            )
        inner, known = estimator.primary_integrand(0), estimator.dims
    median = as_choice("combine", combine, ("mean", "median")) == "median"
    usual = "sobol | lms" if median else "sobol | owen"
    source = as_sampler(usual if sampler is None else sampler, known)
    if source.fixed:
        raise ParameterError(
            f"{source.spec} is deterministic, so no error bar exists; add owen or shift."
        )
    law = source.law(source.nearest_count(_SETTINGS.law_at))
    linear = isinstance(law, Scrambled) and law.kind == "linear" and law.uniform
    if median and not linear:
        raise ParameterError(
            Parameter("combine"),
            f" is 'median', and {source.spec} is not a linear scramble, whose variance a few sets "
            "cause: use the mean, which is better, or a sampler such as sobol | lms.",
        )
    each = 1 if is_function(f) else estimator.evaluations_per_point
    calls = Calls(
        inner,  # type: ignore[arg-type]
        dims=known,
        budget=as_integer("budget", budget, least=1) // each,
        vectorized=vectorized,
        workers=workers,
        cache=cache,
        on_error=on_error,
    )
    setup = Setup(Estimator(FunctionIntegrand(function=calls, dims=known)), source)
    check_memory(memory_of(calls.budget, known), "integrate")
    stream = Stream.from_rng(rng)
    one_set = profile is not None and tolerance is None and not median

    # Make replicates. With a tolerance, first make a few, then as many as the interval requires.
    allowed = calls.budget if tolerance is None else min(calls.budget, _SETTINGS.first)
    with calls:
        sets = _in_one_set(calls, setup, stream, profile.answer.best) if one_set else None
        sets = sets or _sampled(calls, setup, stream, allowed, median=median)
        found = _estimated(sets, law, median=median, linear=linear)
        while allowed < calls.budget and not found.half_width <= least_width:
            # The width of the interval is proportional to the square root of the variance.
            # If the interval is infinite, double the number of calls
            wider = min(found.half_width / least_width, 2.0**_SETTINGS.growth)
            more = wider ** (2.0 / sets.rate if sets.rate > 0.0 else 2.0)
            more = min(max(_SETTINGS.margin * more, 2.0), _SETTINGS.growth)
            allowed = min(math.ceil(allowed * more), calls.budget)
            sets = _sampled(calls, setup, stream, allowed, median=median, known=sets)
            found = _estimated(sets, law, median=median, linear=linear)
    value, interval, note = found.value, found.interval, found.note
    if found.endless:
        warn(f"{calls.name}: {found.endless}.", InfiniteVarianceWarning)
    values = found.values
    if calls.skipped:
        skipped = float(np.isnan(sets.values).mean())
        least_value, most_value, middle = values.min(), values.max(), values.mean()
        interval = (
            interval[0] - skipped * (middle - least_value),
            interval[1] + skipped * (most_value - middle),
        )
        said = calls.skipped_in_words(least_value, most_value)
        note = f"{said}; {note}" if note else said
    if profile is not None:
        value, interval, note = _with_profile(value, interval, note, profile, found, sets)
    if tolerance is not None and not interval[1] - interval[0] <= 2.0 * least_width:
        said = f"the budget of {budget} calls ended before the interval was ± {least_width:g}"
        note = f"{said}; {note}" if note else said
    replicates, n = values.shape
    return dataset(
        {
            "value": ((), value),
            "interval": (("bound",), np.array(interval)),
            "calls": ((), calls.made * each),
            "skipped": ((), calls.skipped),
            "replicates": ((), replicates),
            "n": ((), n),
            "rate": ((), -sets.rate),
        },
        {"bound": ["low", "high"]},
        integrand=calls.name,
        sampler=source.spec,
        budget=calls.budget * each,
        stream_key=f"{stream.key:#x}",
        note=note,
    )


@dataclass(frozen=True)
class _Replicates:
    """Points (R, n, d) and values (R, n) of replicates, NaN where f failed, and the rate θ.

    Replicates are independent sets, or runs of one set.
    The interval of independent sets is multiplied by `narrower`.
    """

    points: Array
    values: Array
    rate: float
    sets: int
    narrower: float = 1.0


def _sampled(
    calls: Calls,
    setup: Setup,
    stream: Stream,
    allowed: int,
    *,
    median: bool,
    known: _Replicates | None = None,
) -> _Replicates:
    """Make replicates of at most `allowed` points in total, reusing the values in `known`."""
    source, few = setup.sampler, _SETTINGS.least
    least = _SETTINGS.least_of_median if median else few
    most = affordable_count(setup, allowed // least)
    if most is None:
        raise ParameterError(
            Parameter("budget"),
            f" is {allowed}, too small for {least} replicates of {source.spec}; give "
            f"at least {least * source.nearest_count(1)}.",
        )
    # Measure the rate from prefixes of the first replicates
    first, rate = np.empty((few, 0)), math.nan
    splits = source.sequence and not median
    pilot = affordable_count(setup, most // _SETTINGS.pilot) if splits else None
    if pilot is not None and pilot >= 2**_SETTINGS.levels:
        if known is not None and known.values.shape[1] >= 2**_SETTINGS.levels:
            first = known.values[:few]
        else:
            first = calls(source.draw_stream(pilot, stream, 0, few))
        # Fit θ of a variance ∝ n^-θ. If a prefix has no variance, use the largest θ
        prefixes = first.shape[1] >> np.arange(_SETTINGS.levels)
        known_first = _filled(first)
        means = np.stack([known_first[:, :n].mean(axis=1) for n in prefixes])
        variances, rate = means.var(axis=1, ddof=1), _RATES[1]
        if (variances > rounding_floor(np.abs(means).max(axis=1))).all():
            slope = np.polyfit(np.log(prefixes), np.log(variances), 1)[0]
            rate = float(np.clip(-slope, *_RATES))

    # Choose the number of points of a replicate, then make all replicates
    counts = {most}
    while rate < _RATES[1] and (n := affordable_count(setup, min(counts) // 2)):
        if n < max(pilot or 1, 2):
            break
        counts.add(n)
    # Half widths of Student's t intervals for each n, except for a constant factor
    widths = {n: student_t(r := allowed // n) * n ** (-0.5 * rate) * r**-0.5 for n in counts}
    n = min(widths, key=lambda n: widths[n])
    # Reuse values that are known: prefixes of sequences, or sets with the same count
    have = first if known is None or not splits else known.values
    if known is not None and known.values.shape[1] == n:
        have = known.values
    have = have[:, :n]
    rows, columns = have.shape
    replicates = allowed // n
    while replicates >= least and replicates * n - min(replicates, rows) * columns > calls.left:
        replicates -= 1
    if replicates < least and known is not None:  # Longer sets would need more calls than remain
        return known
    have = have[:replicates]
    x = source.draw_stream(n, stream, 0, replicates)
    values = np.empty(x.shape[:2])
    rows, columns = have.shape
    values[:rows, :columns] = have
    values[:rows, columns:] = calls(x[:rows, columns:])
    values[rows:] = calls(x[rows:])
    return _Replicates(x, values, rate, replicates)


def _in_one_set(calls: Calls, setup: Setup, stream: Stream, best: Any) -> _Replicates | None:
    """Return runs (parts) of one large set as replicates, or None if independent sets are better.

    Any 2^k points of a scrambled net in base 2 that start at a multiple of 2^k are a scrambled net.
    The points k, k + R, k + 2R, … of a lattice are a shifted lattice.
    """
    source, least = setup.sampler, _SETTINGS.least
    count = affordable_count(setup, calls.budget)
    if count is None or count < 2 * least:
        return None
    leaf = leaf_of(source.law(count))
    lattice = isinstance(leaf, Fixed) and leaf.vector is not None
    net = source.sequence and isinstance(source.law(count), Scrambled)
    net &= set(source.digit_bases) == {2}
    # From the profile, take the rate of convergence, and the slowest rate in its interval
    rate, surely = (
        float(np.clip(-each, *_RATES)) if math.isfinite(each) else _RATES[0]
        for each in (best.rate, best.rate_ci[1])
    )
    widths = {least: 0.0}
    if lattice:
        count -= count % least
    elif net:
        # Half widths of the 95 % interval from R runs of a net, up to a constant factor
        counts = (least << k for k in range((count // least).bit_length() - 1))
        counts = (r for r in counts if r <= _SETTINGS.most_runs)
        widths = {r: student_t(r) * r ** (0.25 * (surely - 1.0)) for r in counts}
    # If the budget is not a power of two, independent sets use more calls
    if not (lattice or net) or count**rate <= calls.budget * least ** (rate - 1.0):
        return None
    replicates = min(widths, key=lambda r: widths[r])
    if lattice:  # Choose a lattice whose runs (every R-th point) are also good lattices
        source = nested_lattices(source, count, replicates, at_once=True)
    x = source.draw_stream(count, stream, 0, 1)[0]
    values = calls(x)
    if lattice:
        order = np.arange(count).reshape(-1, replicates).T
    else:
        order = np.arange(count).reshape(replicates, -1)
    narrower = 1.0 if lattice else replicates ** (-0.25 * (surely - 1.0))
    return _Replicates(x[order], values[order], rate, 1, narrower)


@dataclass(frozen=True)
class _Estimated:
    """The value, its interval, a note, and the reason if the variance is infinite.

    Where f failed, `values` hold the mean of all other values.
    `alike` is true if the replicates do not vary.
    """

    value: float
    interval: tuple[float, float]
    note: str | None
    endless: str | None
    alike: bool
    values: Array

    @property
    def half_width(self) -> float:
        return 0.5 * (self.interval[1] - self.interval[0])


def _estimated(sets: _Replicates, law: Law, *, median: bool, linear: bool) -> _Estimated:
    """Return the estimate from replicates. The interval is infinite if no values vary."""
    from scipy.special import bdtr

    # Points where f failed get the mean of all other values
    values = _filled(sets.values)
    means, replicates = values.mean(axis=1), len(values)
    moments = Moments.of(means, tails=True)
    value, interval = float(moments.mean), mean_interval(means)
    # If f grows toward the border, strata have skewed errors, and a variance may not exist.
    # Unresolved tails that are not caused by growth at the border make the interval infinite
    growths = border_growth(sets.points.reshape(-1, sets.points.shape[-1]), values.ravel())
    endless = growth_note(growths)
    note = None if growths else tail_note(moments) or few_note(values.ravel())
    if note:
        interval = -math.inf, math.inf
    elif endless or not isinstance(law, Independent):
        interval = growing_interval(means, growths)
    # Compute an interval of the median from sorted replicates.
    # If the median's interval is much narrower than the mean's, a few replicates are outliers
    outer = int((bdtr(np.arange(replicates), replicates, 0.5) < _SIDE).sum()) - 1
    ends = np.sort(means)[[outer, -1 - outer]]
    stand_out = linear and 0.0 < _SETTINGS.stands_out * np.ptp(ends) < np.ptp(interval)
    if median:
        value, note = float(np.median(means)), None
        low, high = (float(ends[0]), float(ends[1])) if stand_out else interval
        interval = min(low, float(ends[0])), max(high, float(ends[1]))
        if not stand_out:
            note = "no replicate stands out: the mean is as good, unless n is larger or f smoother"
    elif stand_out:
        note = (
            "few replicates cause the variance, as with linear scrambles: combine='median' "
            "ignores them"
        )
    low, high = interval
    interval = value - sets.narrower * (value - low), value + sets.narrower * (high - value)
    alike = bool(moments.variance <= rounding_floor(moments.mean))
    alike = alike and not (median and bool(np.ptp(values)))
    if alike:
        interval, endless = (-math.inf, math.inf), None
        note = "all replicates are equal: f is constant, or no point hit the region where it varies"
    elif endless:
        interval, note = (-math.inf, math.inf), endless
        if any(growth.without_integral() for growth in growths):
            value = math.nan
    return _Estimated(value, interval, note, endless, alike, values)


def _advised(f: Any, profile: Any) -> tuple[AbstractEstimator, Sampler]:
    """Return the estimator and the sampler that the profile of f recommends."""
    answer = getattr(profile, "answer", None)
    if answer is None:
        raise ParameterError(
            Parameter("profile"),
            f" is {profile!r:.60}; give the result of profile(f).",
        )
    of = profile.function
    if not (f is of or (isinstance(f, str) and f == of)):
        raise ParameterError(
            Parameter("profile"),
            f" is of {profile.subject}, not of f; give the same function to both.",
        )
    return answer.best.estimator, answer.best.sampler


def _with_profile(
    value: float,
    interval: tuple[float, float],
    note: str | None,
    profile: Any,
    found: _Estimated,
    sets: _Replicates,
) -> tuple[float, tuple[float, float], str | None]:
    """Combine an estimate of ∫f with the estimate in a profile, whose error is uncorrelated.

    Return the combined estimate, its interval and a note.

    The recommended estimator is fitted to evaluations of the profile.
    The estimates have the mean ∫f, whatever estimator the profile recommends.
    Therefore the errors of the estimates are uncorrelated with the errors of the profile.
    """
    low, high = profile.interval
    blind = _is_blind(profile, found)
    if blind:
        interval = -math.inf, math.inf
        note = "f varies far less than in the profile: they miss its variation"
    twice = 2.0 * low - profile.integral, 2.0 * high - profile.integral
    if found.alike and not blind and twice[0] <= value <= twice[1] and high - low < math.inf:
        # f varied in the profile, but is constant at the points of the recommended sampler.
        # The value is within about four standard errors (two half widths) of the profile's mean
        away = math.sqrt(float(rounding_floor(np.array(value))))
        error, note = tied_error(found.values), "all replicates are equal to rounding"
        if error > away:
            away, note = error, "all replicates are equal, perhaps by chance: f has few values"
        return value, (value - away, value + away), note
    widths = interval[1] - interval[0], high - low
    if math.isinf(widths[0]) and not math.isinf(widths[1]):
        # The interval of the profile holds for any value in it, also for the new estimate
        note = f"the interval is that of the profile, because with the advised points {note}"
        return value if low <= value <= high else profile.integral, (low, high), note
    if not (math.isfinite(sum(widths)) and min(widths) > 0.0):
        return value, interval, note
    # If the estimates contradict each other, an interval misses ∫f, but which one is not known.
    # The value with the wider interval is the more cautious one
    reach = math.hypot(*(
        (each[1] - own if own < other else own - each[0])
        for own, other, each in (
            (value, profile.integral, interval), (profile.integral, value, (low, high)),
        )
    ))  # fmt: skip
    if abs(value - profile.integral) > _SETTINGS.apart * reach:
        note = (
            f"the new calls give {value:.6g} and the profile {profile.integral:.6g}, which their "
            "intervals do not allow, so the interval contains both: give another sampler or a "
            "larger budget without profile"
        )
        ends = min(low, interval[0]), max(high, interval[1])
        return value if widths[0] > widths[1] else profile.integral, ends, note
    # The width from few replicates has a large error. Use the expected width if it is smaller
    best, n = profile.answer.best, found.values.size / sets.sets
    expected = 4.0 * best.rmse * (n / best.n) ** (0.5 * best.rate) * sets.sets**-0.5
    own = min(widths[0], expected) if math.isfinite(expected) else widths[0]
    share = widths[1] ** 2 / (own**2 + widths[1] ** 2)
    parts = (share, value, interval), (1.0 - share, profile.integral, (low, high))
    mean = sum(weight * each for weight, each, _ in parts)
    below = math.hypot(*(weight * (each - ends[0]) for weight, each, ends in parts))
    above = math.hypot(*(weight * (ends[1] - each) for weight, each, ends in parts))
    return mean, (mean - below, mean + above), note


def _is_blind(profile: Any, found: _Estimated) -> bool:
    """Return whether f hardly varies at the advised points, although it varied in the profile.

    If the profile recommends another estimator, its g may vary far less for good reason.
    """
    best, given = profile.answer.best, profile.answer.given
    curve = profile.samplers.get("random")
    if curve is None or best.estimator is not given.estimator:
        return False
    return bool(found.values.var() < _SETTINGS.seen * curve.at(1)[0])


def _filled(values: Array) -> Array:
    """Return values in which the mean of all other values replaces NaN."""
    failed = np.isnan(values)
    if not failed.any():
        return values
    if failed.all():
        raise ParameterError("f failed at all points; give a function that has values.")
    return np.where(failed, values[~failed].mean(), values)
