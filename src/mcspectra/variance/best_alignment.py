"""The best alignment of strata: found by prediction, verified by a measurement of its own."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import NoClosedForm
from mcspectra.core.parallel import MAX_REALIZATIONS, available_workers
from mcspectra.core.results import dataset
from mcspectra.core.streams import RngLike, Stream
from mcspectra.estimators import AbstractEstimator, as_estimator
from mcspectra.estimators.moments import Moments, rounding_floor, variance_interval
from mcspectra.integrands import Integrand
from mcspectra.samplers import Sampler, as_sampler
from mcspectra.variance.alignment import Offsets, aligned, checked_offsets, predictor
from mcspectra.variance.convergence import count_moments
from mcspectra.variance.exact import exact_variance

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["best_alignment"]

_HALVINGS = 8  # of the step of the scan: a part of 256


@dataclass(frozen=True)
class _Candidate:
    """A set-up, its offset, and the variance predicted for it (NaN where none is)."""

    name: str
    estimator: AbstractEstimator
    sampler: Sampler
    offset: tuple[float, ...]
    predicted: float


def best_alignment(
    estimator: AbstractEstimator | Integrand | str,
    sampler: Sampler | str,
    n: int,
    *,
    edges: Any = None,
    offsets: Any = None,
    method: str = "auto",
    realizations: int = 1000,
    rng: RngLike = 0,
    workers: int | None = None,
) -> xr.Dataset:
    """Find the offset of strata with the least variance, and measure what it is worth.

    Parameters
    ----------
    estimator, sampler, n
        What is to be improved; the sampler without a shift, which would average over all offsets.
    edges
        Places of known edges, as for `mcspectra.variance.aligned`: strata with borders there are tried
        as well. Needs an estimator without a density and n = s^d.
    offsets, method
        As for `mcspectra.strata_shift_scan`; the best of the scan is refined by a pattern search,
        whose step is halved 8 times.
    realizations, rng, workers
        As for `mcspectra.convergence`; the measurement of each candidate has a stream of its own.

    Returns
    -------
    xarray.Dataset
        On the dim candidate, ``"unshifted"``, ``"offset"`` and, with `edges`, ``"aligned"``:
        ``strata_offset(candidate, axis)``, ``predicted_variance``, ``measured_variance`` with
        ``measured_variance_ci``, ``variance_ratio`` to that of the first with ``variance_ratio_ci``,
        and ``improvement``: 1 where that interval is below 1, −1 where it is above, else 0. The
        attribute ``best`` names the candidate with the least predicted variance (measured, where one
        has no prediction), ``improved`` is yes, no or undecided for it. Variances of several
        channels are added up.

    Raises
    ------
    CountError, ParameterError, NoClosedForm
        As for `mcspectra.strata_shift_scan` and `mcspectra.variance.aligned`.

    Notes
    -----
    Intervals of ratios are those of independent measurements, for both candidates at once 95 %.

    Examples
    --------
    >>> import mcspectra as mcs
    >>> light = mcs.integrand("disk(center=0.5125, radius=0.25)", dims=1)  # 2.1 to 6.1 strata
    >>> found = mcs.best_alignment(light, "jittered", 8)
    >>> found.attrs["improved"], round(float(found["strata_offset"].sel(candidate="offset")[0]), 2)
    ('yes', 0.1)
    """
    plain = as_estimator(estimator, getattr(sampler, "dims", None))
    source = as_sampler(sampler, plain.dims)
    plain.check_sampler(source, as_integer("n", n, least=1))
    count = as_integer("realizations", realizations, least=2, most=MAX_REALIZATIONS)
    bent = None if edges is None else aligned(plain, edges, n)
    places = checked_offsets(offsets, plain.dims)
    stream, threads = Stream.from_rng(rng), available_workers(workers)
    found = predictor(plain, source, [n], method, count, stream.child(0), threads)
    candidates = _candidates(found, source, n, places, bent)
    moments = [
        count_moments(c.estimator, c.sampler, n, count, stream.child(1 + i), threads)
        for i, c in enumerate(candidates)
    ]
    return _labelled(
        candidates,
        moments,
        estimator=plain.spec,
        sampler=source.spec,
        n=n,
        method="exact" if found.exact else "measured",
        realizations=count,
        stream_key=f"{stream.key:#x}",
        seed=rng if isinstance(rng, int) else None,
    )


def _candidates(
    found: Offsets, sampler: Sampler, n: int, places: list[float], bent: AbstractEstimator | None
) -> list[_Candidate]:
    zero = (0.0,) * sampler.dims
    best, value = _searched(found, n, places)
    plain = found.estimator
    candidates = [
        _Candidate("unshifted", plain, sampler, zero, _total(found, zero, n)),
        _Candidate("offset", plain, found.displaced(best), best, value),
    ]
    if bent is not None:
        predicted = _exact_total(bent, sampler, n)
        candidates.append(_Candidate("aligned", bent, sampler, zero, predicted))
    return candidates


def _searched(found: Offsets, n: int, places: list[float]) -> tuple[tuple[float, ...], float]:
    """Offset of the least predicted variance: the best of a grid, then a pattern search about it."""
    values = {o: _total(found, o, n) for o in itertools.product(places, repeat=found.sampler.dims)}
    best = min(values, key=lambda o: values[o])
    value, step = values[best], 0.5 / len(places)
    for _ in range(_HALVINGS):
        for axis, sign in itertools.product(range(len(best)), (1.0, -1.0)):
            moved = tuple((o + sign * step * (i == axis)) % 1.0 for i, o in enumerate(best))
            if (there := _total(found, moved, n)) < value:
                best, value = moved, there
        step *= 0.5
    return best, value


def _total(found: Offsets, offset: tuple[float, ...], n: int) -> float:
    return float(found.at(offset, n).value.sum())


def _exact_total(estimator: AbstractEstimator, sampler: Sampler, n: int) -> float:
    try:
        return float(np.sum(exact_variance(estimator, sampler, n)))
    except NoClosedForm:
        return float("nan")


@dataclass(frozen=True)
class _Measured:
    """Variance summed over channels, its relative standard error at most, and its rounding floor."""

    value: float
    relative_se: float
    floor: float

    @staticmethod
    def of(moments: Moments) -> _Measured:
        variance = moments.variance
        total = float(variance.sum())
        error = float((variance * moments.relative_se).sum())
        least = float(moments.relative_se.max())
        floor = float(rounding_floor(moments.mean).sum())
        return _Measured(total, error / total if total > 0 else least, floor)


def _ratio(after: _Measured, before: _Measured, z: float) -> tuple[float, Array]:
    """Ratio of two independent variances and its interval; NaN where both are rounding noise."""
    if before.value <= before.floor:
        return float("nan"), np.full(2, np.nan)
    ratio = after.value / before.value
    half = z * float(np.hypot(after.relative_se, before.relative_se))
    return ratio, ratio * np.exp([-half, half])


def _labelled(
    candidates: list[_Candidate], moments: list[Moments], **provenance: Any
) -> xr.Dataset:
    from scipy.special import ndtri

    measured = [_Measured.of(m) for m in moments]
    z = float(ndtri(1.0 - 0.025 / (len(candidates) - 1)))
    ratios = [(1.0, np.ones(2)), *(_ratio(m, measured[0], z) for m in measured[1:])]
    interval = np.stack([ci for _, ci in ratios])
    verdict = (interval[:, 1] < 1.0).astype(np.int64) - (interval[:, 0] > 1.0)
    predicted = np.array([c.predicted for c in candidates])
    value = np.array([m.value for m in measured])
    relative = np.array([m.relative_se for m in measured])
    best = int(np.argmin(value if np.isnan(predicted).any() else predicted))
    names = [c.name for c in candidates]
    over = ("candidate",)
    return dataset(
        {
            "strata_offset": ((*over, "axis"), np.array([c.offset for c in candidates])),
            "predicted_variance": (over, predicted),
            "measured_variance": (over, value),
            "measured_variance_ci": ((*over, "bound"), variance_interval(value, relative)),
            "variance_ratio": (over, np.array([ratio for ratio, _ in ratios])),
            "variance_ratio_ci": ((*over, "bound"), interval),
            "improvement": (over, verdict),
        },
        {
            "candidate": names,
            "bound": ["low", "high"],
            "axis": np.arange(len(candidates[0].offset)),
        },
        best=names[best],
        improved=("undecided", "yes", "no")[verdict[best]],
        **provenance,
    )
