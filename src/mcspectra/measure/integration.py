"""An integral with its interval for a budget of calls: replicates of randomised sets, Student's t.

A budget of N calls is R replicates of n points. With a variance ∝ n^-θ of a replicate the half width
of the interval is ∝ t_{R−1} n^{−θ/2} R^{−1/2}: few replicates of many points where θ is large, as for
smooth functions and scrambled nets; more of them where θ is near 1, as they cost nothing then and make t
smaller. θ is measured with a quarter of the budget, by eight replicates whose points are the first ones of
the sets that follow: prefixes of a randomised sequence.

The interval is the hull of Student's t and of Hall's transform of it (`mean_interval`): of 300 seeds at 256
calls it holds the integral of x^−½ in 88 % (74 % by Student's t alone) and that of e^(x + y) in 97 % (96 %).

Both are asymptotic in R, and eight replicates are the least. What has a chance below 1/R a replicate
may be missed, such as a step along an axis just beside a line of the net: then the interval is too short
[Owen2025]_. Intervals that hold for any bounded function would take n = Θ(N^{1/(θ+1)}) [Jain2026]_, that is
most of the budget for replicates: for a smooth function an error ten times as large.

Of linear scrambles of nets most sets have far smaller errors than the few that make the variance: the *median* of
replicates leaves those out, and its error falls faster than any power of n where f is smooth ([Pan2024]_). Half
of the estimates are above their median: order statistics bound it, whatever their distribution. Nested scrambles
have no such sets, and their mean is better.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import as_choice
from mcspectra.core.confidence import student_t
from mcspectra.core.errors import Function, Parameter, ParameterError
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
from mcspectra.estimators.moments import Moments, mean_interval, rounding_floor
from mcspectra.estimators.tails import tail_note
from mcspectra.integrands import Calls, FunctionIntegrand, Integrand
from mcspectra.measure.setup import Setup, affordable_count
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.samplers.law import Scrambled

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["integrate"]

_LEAST, _LEAST_OF_MEDIAN = 8, 11  # replicates
_LAW_AT = 64  # points at which the kind of scramble is looked up; it is the same at all n
_PILOT = 4  # a part of the budget: the first replicates at this part of their longest sets
_LEVELS = 4  # prefixes of a replicate, each half of the next
_SIDE = 0.025  # chance, on either side of an interval
_STANDS_OUT = 2.0  # width of the interval of the mean, over that of the median
_RATES = 1.0, 3.0  # random points, and smooth functions under scrambled nets


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
    rng: RngLike = 0,
) -> xr.Dataset:
    """Integrate a function over [0,1)^d with a number of calls, and say how well.

    Parameters
    ----------
    f
        A vectorised function of points (…, d) to values (…); an integrand or its spec string, without channels;
        or an estimator of one technique, such as ``Estimator(f, density)``.
    budget
        Most calls of f, each of one point: none is made beyond it, and no other but these.
    sampler
        A randomised one; by default ``"sobol | owen"``, for the median ``"sobol | lms"``.
    dims
        Number of dims, where neither f nor the sampler say it.
    combine
        ``"mean"`` of the replicates or, for linear scrambles such as ``lms``, ``"median"``: far better where
        f is smooth, in one dim, and in two from about 2,000 calls on.
    vectorized, workers, cache
        Of functions that are slow: as of `mcspectra.integrands.Calls`. What was interrupted goes on where
        it was when it is called again with the same cache, to the same bits.
    rng
        Seed (SPEC 7).

    Returns
    -------
    xarray.Dataset
        ``value``, ``interval(bound)`` (95 %, over the replicates; for the median at least, of that of
        all replicates, which are as often too large as too small), ``calls`` that were made,
        ``replicates``, ``n`` points of each, and ``rate``, of the variance as it was measured for the
        split, NaN where it was not. Where all replicates are alike the interval is infinite, and the
        attribute ``note`` says why.

    Raises
    ------
    ParameterError
        A value is out of range, the sampler is not random, f has channels or several techniques, the
        budget is too small for eight replicates (a median of eleven), a median of other sets than linear
        scrambles; as of `mcspectra.integrands.Calls`.
    ConfigError
        The budget's points and values are more than this machine's memory.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> found = mcs.integrate(lambda x: x[..., 0] * x[..., 1], dims=2, budget=2000)
    >>> bool(found["interval"][0] < 0.25 < found["interval"][1])
    True
    >>> int(found["calls"]), int(found["n"])
    (1920, 128)
    """
    # What is called, and what draws its points
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
            f"{source.spec} is the same every time, which says nothing of its error; add owen or shift."
        )
    law = source.law(source.nearest_count(_LAW_AT))
    linear = isinstance(law, Scrambled) and law.kind == "linear" and law.uniform
    if median and not linear:
        raise ParameterError(
            Parameter("combine"),
            f" is 'median', and {source.spec} is no linear scramble, few of whose sets make the "
            "variance: take the mean, which is better, or a sampler such as sobol | lms.",
        )
    calls = Calls(
        inner,  # type: ignore[arg-type]
        dims=known,
        budget=budget,
        vectorized=vectorized,
        workers=workers,
        cache=cache,
    )
    setup = Setup(Estimator(FunctionIntegrand(function=calls, dims=known)), source)
    least = _LEAST_OF_MEDIAN if median else _LEAST
    most = affordable_count(setup, calls.budget // least)
    if most is None:
        raise ParameterError(
            Parameter("budget"),
            f" is {calls.budget}, too small for {least} replicates of {source.spec}; give more.",
        )
    check_memory(memory_of(calls.budget, known), "integrate")
    stream = Stream.from_rng(rng)

    with calls:
        # Measure the rate by prefixes of the first replicates
        first, rate = np.empty((_LEAST, 0)), math.nan
        splits = source.sequence and not median
        pilot = affordable_count(setup, most // _PILOT) if splits else None
        if pilot is not None and pilot >= 2**_LEVELS:
            first = calls(source.draw_stream(pilot, stream, 0, _LEAST))
            # θ of a variance ∝ n^-θ, the largest where prefixes have none
            prefixes = first.shape[1] >> np.arange(_LEVELS)
            means = np.stack([first[:, :n].mean(axis=1) for n in prefixes])
            variances, rate = means.var(axis=1, ddof=1), _RATES[1]
            if (variances > rounding_floor(np.abs(means).max(axis=1))).all():
                slope = np.polyfit(np.log(prefixes), np.log(variances), 1)[0]
                rate = float(np.clip(-slope, *_RATES))

        # Choose the number of points of a replicate, then make all of them
        counts = {most}
        while rate < _RATES[1] and (n := affordable_count(setup, min(counts) // 2)):
            if n < max(pilot or 1, 2):
                break
            counts.add(n)
        # Half widths of the interval but for a factor, by Student's t
        widths = {
            n: student_t(r := calls.budget // n) * n ** (-0.5 * rate) * r**-0.5 for n in counts
        }
        n = min(widths, key=lambda n: widths[n])
        replicates = calls.budget // n
        x = source.draw_stream(n, stream, 0, replicates)
        values = np.empty(x.shape[:2])
        values[:_LEAST, : first.shape[1]] = first
        values[:_LEAST, first.shape[1] :] = calls(x[:_LEAST, first.shape[1] :])
        values[_LEAST:] = calls(x[_LEAST:])

    # The interval: none where nothing varies
    means = values.mean(axis=1)
    moments = Moments.of(means, tails=True)
    value, note, interval = float(moments.mean), tail_note(moments), mean_interval(means)
    # The median, and whether some sets stand out from those about it: else f is rough, or n small
    from scipy.special import bdtr

    outer = int((bdtr(np.arange(replicates), replicates, 0.5) < _SIDE).sum()) - 1
    ends = np.sort(means)[[outer, -1 - outer]]
    stand_out = linear and 0.0 < _STANDS_OUT * np.ptp(ends) < np.ptp(interval)
    if median:
        value, note = float(np.median(means)), None
        low, high = (float(ends[0]), float(ends[1])) if stand_out else interval
        interval = min(low, float(ends[0])), max(high, float(ends[1]))
        if not stand_out:
            note = "no replicate stands out: the mean is as good, unless n is larger or f smoother"
    elif stand_out:
        note = "few replicates make the variance, as linear scrambles do: combine='median' leaves them out"
    alike = float(moments.variance) <= rounding_floor(moments.mean)
    if alike and not (median and np.ptp(values)):
        interval = -math.inf, math.inf
        note = "all replicates are alike: f is constant, or what varies was not met"
    return dataset(
        {
            "value": ((), value),
            "interval": (("bound",), np.array(interval)),
            "calls": ((), calls.made),
            "replicates": ((), replicates),
            "n": ((), n),
            "rate": ((), -rate),
        },
        {"bound": ["low", "high"]},
        integrand=calls.name,
        sampler=source.spec,
        budget=calls.budget,
        stream_key=f"{stream.key:#x}",
        note=note,
    )
