"""Convergence: measured variance against n and its fitted rate.

The rate is the slope of log variance against log n (`mcspectra.variance.fit`). The variance is that of
the realisations, a sample variance with ddof = 1, which is unbiased for the variance of the estimator;
its relative standard error, from the kurtosis of the estimates, is its weight in the fit.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, Moments, as_estimator
from mcspectra.estimators.moments import rounding_floor
from mcspectra.estimators.tails import unsampled_note
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.variance.fit import check_window, fit_rate
from mcspectra.variance.stopping import check_relative_error, joint_moments, moments_until

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["convergence"]


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
    several, given = isinstance(estimator, list | tuple), isinstance(sampler, list | tuple)
    if (several and not estimator) or (given and not sampler):
        raise ParameterError("convergence needs at least one estimator and one sampler.")
    estimators = [as_estimator(e) for e in (estimator if several else [estimator])]
    samplers = [as_sampler(s, estimators[0].dims) for s in (sampler if given else [sampler])]
    _check_comparable(estimators, samplers)
    ns = _check_counts(counts, estimators, samplers)
    realizations = as_integer("realizations", realizations, least=2, most=MAX_REALIZATIONS)
    window = check_window(fit_last, len(ns))
    goal = None if relative_error is None else check_relative_error(relative_error)
    stream = Stream.from_rng(rng)
    threads = available_workers(workers)

    def cell(es: list[AbstractEstimator], s: Sampler, n: int) -> list[tuple[Moments, bool]]:
        own = count_stream(stream, n)
        if goal is None:
            return [(m, True) for m in joint_moments(es, s, n, realizations, own, threads)]
        return [moments_until(e, s, n, goal, realizations, own, threads) for e in es]

    def curves(es: list[AbstractEstimator], s: Sampler) -> Iterator[dict[str, Array]]:
        found = [cell(es, s, n) for n in ns]
        for e, cells in zip(es, zip(*found, strict=True), strict=True):
            moments = [m for m, _ in cells]
            curve = curve_from_moments(ns, moments, np.atleast_1d(e.integral), window)
            curve["bias_se"] = np.hypot(curve["mean_se"], e.integral_error)
            if goal is not None:
                curve["reached"] = np.array([np.int64(reached) for _, reached in cells])
            yield curve

    # One technique that has no `draw` of its own gets the sampler's points: then all share them.
    plain = all(e.counts == (1,) and type(e).draw is AbstractEstimator.draw for e in estimators)
    groups = [estimators] if plain else [[e] for e in estimators]
    grid = [
        list(row)
        for es in groups
        for row in zip(*(list(curves(es, s)) for s in samplers), strict=True)
    ]
    return _labelled(
        grid,
        ns,
        drop=[
            name
            for name, single in (
                ("estimator", not several),
                ("sampler", not given),
                ("channel", all(e.channels == 0 for e in estimators)),
            )
            if single
        ],
        coords={"estimator": [e.spec for e in estimators], "sampler": [s.spec for s in samplers]},
        realizations=realizations,
        relative_error=goal,
        fit_last=_largest_window(ns, grid),
        fit_window="auto" if window == "auto" else None,
        stream_key=f"{stream.key:#x}",
        seed=rng if isinstance(rng, int) else None,
        integral_source="; ".join(dict.fromkeys(e.integral_source for e in estimators)),
        note="; ".join(_notes(estimators, ns[-1] * realizations)) or None,
    )


def _notes(estimators: list[AbstractEstimator], samples: int) -> Iterator[str]:
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


def curve_from_moments(
    ns: list[int], moments: list[Moments], integral: Array, window: int | str
) -> dict[str, Array]:
    """Variances, intervals, bias and rate of one curve from the moments of its counts."""
    variance = np.stack([m.variance for m in moments])
    relative = np.stack([m.relative_se for m in moments])
    mean = np.stack([m.mean for m in moments])
    floor = rounding_floor(np.maximum(np.abs(mean), np.abs(integral)))
    fits = [
        fit_rate(np.array(ns), variance[:, c], relative[:, c], floor[:, c], window)
        for c in range(variance.shape[1])
    ]
    return {
        "variance": variance,
        "variance_ci": np.stack([m.variance_ci for m in moments]),
        "mean": mean,
        "mean_se": np.stack([m.mean_se for m in moments]),
        "bias": mean - integral,
        "mse": (mean - integral) ** 2
        + variance * np.array([(m.count - 1) / m.count for m in moments])[:, None],
        "realizations_used": np.array([m.count for m in moments]),
        "rate": np.array([fit.rate for fit in fits]),
        "rate_ci": np.array([fit.interval for fit in fits]),
        "fit_first_n": np.array([fit.first_n for fit in fits]),
        "fit_chi2": np.array([fit.chi2 for fit in fits]),
    }


def _largest_window(ns: list[int], grid: list[list[dict[str, Array]]]) -> int | None:
    """How many counts the fits go over, the most of any; None where nothing was fitted."""
    first = np.array([curve["fit_first_n"] for row in grid for curve in row])
    fitted = first[np.isfinite(first)]
    return sum(n >= fitted.min() for n in ns) if fitted.size else None


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


def _labelled(
    grid: list[list[dict[str, Array]]],
    ns: list[int],
    drop: list[str],
    coords: dict[str, Any],
    **provenance: Any,
) -> xr.Dataset:
    """Stack the curves of a grid estimator × sampler, dropping the dims that were not asked for."""
    variables = {}
    for name in grid[0][0]:
        own = _DIMS[name]
        dims = ("estimator", "sampler", *own)
        values = np.stack([np.stack([curve[name] for curve in row]) for row in grid])
        index = tuple(0 if dim in drop else slice(None) for dim in dims)
        variables[name] = (tuple(dim for dim in dims if dim not in drop), values[index])
    kept = {name: values for name, values in coords.items() if name not in drop}
    single = {name: values[0] for name, values in coords.items() if name in drop}
    count = ("n", ns, {"long_name": "number of points", "units": "1"})
    return dataset(
        variables, {"n": count, "bound": ["low", "high"], **kept}, **single, **provenance
    )
