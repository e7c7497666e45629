"""Convergence: measured variance against n and its fitted rate.

The rate is the slope of log variance against log n by weighted least squares, each variance
weighted by the inverse square of its relative standard error (from the kurtosis of the estimates).
Its 95 % interval is widened by the lack of fit, χ² per degree of freedom, where that exceeds 1.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.core.parallel import (
    MAX_REALIZATIONS,
    Block,
    available_workers,
    map_in_order,
    realization_blocks,
)
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, Moments, as_estimator
from mcspectra.estimators.moments import CONFIDENCE_Z, rounding_floor
from mcspectra.samplers import Sampler, as_sampler

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["convergence", "count_moments", "fit_rate"]


def convergence(
    estimator: Any,
    sampler: Any,
    counts: Sequence[int],
    *,
    realizations: int = 1000,
    rng: RngLike = 0,
    fit_last: int | None = None,
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
        Independent realisations for each n, at least 2.
    rng
        Seed (SPEC 7); each n has a stream of its own, shared by all estimators and samplers
        (common random numbers).
    fit_last
        Fit only the last so many counts; all by default.
    workers
        Threads; all processors by default. Results do not depend on it.

    Returns
    -------
    xarray.Dataset
        ``variance(n)``, ``variance_ci(n, bound)``, ``mean(n)``, ``mean_se(n)``, ``bias(n)`` and
        ``mse(n)`` against the estimator's integral, ``rate``, ``rate_ci(bound)``. Lists add the dims
        estimator and sampler, several channels the dim channel. Counts whose variance is rounding
        noise are left out of the fit; the rate of fewer than two others is NaN.

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
    last = len(ns) if fit_last is None else as_integer("fit_last", fit_last, least=2)
    if last > len(ns):
        raise ParameterError(f"fit_last is {last}, but there are {len(ns)} counts.")
    stream = Stream.from_rng(rng)
    grid = [
        [_curve(e, s, ns, realizations, stream, last, available_workers(workers)) for s in samplers]
        for e in estimators
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
        fit_last=last,
        stream_key=f"{stream.key:#x}",
        seed=rng if isinstance(rng, int) else None,
        integral_source="; ".join(dict.fromkeys(e.integral_source for e in estimators)),
    )


def count_moments(
    estimator: AbstractEstimator,
    sampler: Sampler,
    n: int,
    realizations: int,
    stream: Stream,
    workers: int = 1,
) -> Moments:
    """Moments of the estimates of one cell (estimator, sampler, n), channels last."""

    def block_moments(block: Block) -> Moments:
        points = estimator.draw(sampler, n, stream, *block)
        return Moments.of(estimator.estimate(points).reshape(block[1], -1))

    blocks = realization_blocks(realizations, n * estimator.dims * sum(estimator.counts))
    results = map_in_order(block_moments, blocks, workers)
    total = next(results)
    for moments in results:
        total = total.merge(moments)
    return total


def count_stream(stream: Stream, n: int) -> Stream:
    """The stream of one count: the same for every estimator and sampler, another for every n."""
    return stream.child(n)


def fit_rate(
    ns: Array, variance: Array, relative_se: Array, floor: Array
) -> tuple[float, tuple[float, float]]:
    """Fit log variance = a + rate · log n by weighted least squares.

    Parameters
    ----------
    ns, variance, relative_se, floor
        Counts, variances, their relative standard errors, and the variances below which they are
        rounding noise: all (N,).

    Returns
    -------
    tuple
        Rate and its 95 % interval; NaN where fewer than two variances are above the floor, an
        infinite interval where exactly two are not enough to show the lack of fit but are fitted.
    """
    used = (variance > floor) & np.isfinite(relative_se) & (relative_se > 0)
    if used.sum() < 2:
        return math.nan, (math.nan, math.nan)
    x, y, weight = np.log(ns[used]), np.log(variance[used]), relative_se[used] ** -2.0
    centre = np.average(x, weights=weight)
    spread = (weight * (x - centre) ** 2).sum()
    rate = float((weight * (x - centre) * y).sum() / spread)
    residual = y - np.average(y, weights=weight) - rate * (x - centre)
    degrees = int(used.sum()) - 2
    excess = float((weight * residual**2).sum() / degrees) if degrees else 1.0
    half = CONFIDENCE_Z * math.sqrt(max(excess, 1.0) / spread)
    return rate, (rate - half, rate + half)


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
    ns = [as_integer("counts", n, least=1) for n in counts]
    if not ns or any(b <= a for a, b in itertools.pairwise(ns)):
        raise ParameterError(f"counts is {list(counts)}; give ascending numbers of points.")
    for e in estimators:
        for s in samplers:
            for n in ns:
                e.check_sampler(s, n)
    return ns


def _curve(
    estimator: AbstractEstimator,
    sampler: Sampler,
    ns: list[int],
    realizations: int,
    stream: Stream,
    last: int,
    workers: int,
) -> dict[str, Array]:
    """One convergence curve; arrays (n, channel), (n, channel, bound), (channel,), ..."""
    moments = [
        count_moments(estimator, sampler, n, realizations, count_stream(stream, n), workers)
        for n in ns
    ]
    return curve_from_moments(ns, moments, np.atleast_1d(estimator.integral), last)


def curve_from_moments(
    ns: list[int], moments: list[Moments], integral: Array, last: int
) -> dict[str, Array]:
    """Variances, intervals, bias and rate of one curve from the moments of its counts."""
    variance = np.stack([m.variance for m in moments])
    relative = np.stack([m.relative_se for m in moments])
    mean = np.stack([m.mean for m in moments])
    floor = rounding_floor(np.maximum(np.abs(mean), np.abs(integral)))
    fits = [
        fit_rate(np.array(ns[-last:]), variance[-last:, c], relative[-last:, c], floor[-last:, c])
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
        "rate": np.array([rate for rate, _ in fits]),
        "rate_ci": np.array([interval for _, interval in fits]),
    }


_DIMS = {
    "variance": ("n", "channel"),
    "variance_ci": ("n", "channel", "bound"),
    "mean": ("n", "channel"),
    "mean_se": ("n", "channel"),
    "bias": ("n", "channel"),
    "mse": ("n", "channel"),
    "rate": ("channel",),
    "rate_ci": ("channel", "bound"),
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
    for name, own in _DIMS.items():
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
