"""The routes of samplers of which nothing is known but their sets: these are drawn, and measure.

A table holds g at the middles of fine cells, once for all samplers and counts, and is linear between
them. Its variance is measured with sets of the sampler; what the table leaves out is as fine as its cells,
and counts as white: ∫(g − table)²/n. The last route measures g itself, at other counts than n.
"""

from __future__ import annotations

import contextlib
import functools
import math

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import CountError, NoClosedForm
from mcspectra.core.streams import Stream
from mcspectra.estimators import AbstractEstimator, Estimator, Moments
from mcspectra.estimators.moments import CONFIDENCE_Z, rounding_floor
from mcspectra.integrands import Integrand
from mcspectra.samplers.base import Sampler
from mcspectra.variance.convergence import count_moments, count_stream
from mcspectra.variance.prediction.known import Known, Predicted
from mcspectra.variance.quadrature import Pointwise, mesh

__all__ = ["extrapolated", "of_measurements", "of_table"]

_CELLS = {1: 2**16, 2: 2**10, 3: 100}  # along each axis
_PROBE = 2**16  # points, random, at which the table is held against g
_BLOCK = 2**16  # points at a time
_POINTS = 2**22  # of all sets together, about a second
_LEAST, _MOST = 200, 10_000  # sets

# Measured extrapolation
_SMALL = tuple(2**k for k in range(3, 9))
_LARGEST = 2**12  # count, of f that is cheap
_NEAR = 16  # parts of n, by which counts next to it are apart at most
_FITTED = 4
_REALIZATIONS = 2000  # sets of a count
_NEAR_SETS, _NEAR_POINTS = 1000, 2**20  # of those next to n, and their points: what is more
_MOST_FACTOR = 30.0  # by which an extrapolation may be off at most


def of_table(sampler: Sampler, n: int, known: Known, stream: Stream) -> Predicted:
    """Measure a table of g with sets of the sampler, and add what the table leaves out."""
    if known.g.dims not in _CELLS:
        raise NoClosedForm("A table takes 1 to 3 dims.")
    if np.isinf(known.square[0]).any():
        raise NoClosedForm("∫g² diverges.")
    table, missed, miss = known.once("table", lambda: _tabulated(known.g))
    sets = min(max(_POINTS // n, _LEAST), _MOST)
    moments = count_moments(Estimator(table), sampler, n, sets, stream)
    if not (moments.resolved & (moments.variance > rounding_floor(moments.mean))).all():
        raise NoClosedForm(f"{sets} sets do not tell the variance of {sampler.spec}.")
    tail = missed / n
    # Points may be as good within cells as they are beyond, or as bad as at random
    error = CONFIDENCE_Z * moments.relative_se * moments.variance + tail + miss / n
    share = 1.0 - np.minimum(missed / known.square[0], 1.0)
    return Predicted(moments.variance + tail, error, f"{sets} sets on a table of g", share, tail)


def _tabulated(g: Integrand) -> tuple[Integrand, Array, Array]:
    """A table of g, and ∫(g − table)² with half its 95 % interval, by channel."""
    from scipy.interpolate import RegularGridInterpolator

    axes = [(np.arange(_CELLS[g.dims]) + 0.5) / _CELLS[g.dims]] * g.dims
    nodes = mesh(*axes)
    flat = nodes.reshape(-1, g.dims)
    blocks = [g(flat[i : i + _BLOCK]) for i in range(0, len(flat), _BLOCK)]
    values = np.concatenate(blocks).reshape(*nodes.shape[:-1], *[g.channels] * (g.channels > 0))
    linear = RegularGridInterpolator(axes, values, bounds_error=False, fill_value=None)
    table = Pointwise(g, linear, ((),) * g.dims, f"a table of {g.spec}")
    probe = np.random.default_rng(0).random((_PROBE, g.dims))
    missed = ((g(probe) - table(probe)) ** 2).reshape(_PROBE, -1)
    error = CONFIDENCE_Z * missed.std(axis=0, ddof=1) / math.sqrt(_PROBE)
    return table, missed.mean(axis=0), error


def of_measurements(sampler: Sampler, n: int, known: Known, stream: Stream) -> Predicted:
    """Extrapolate the variances of the sampler's small sets."""
    return extrapolated(Estimator(known.g), sampler, n, known, stream)


def extrapolated(
    estimator: AbstractEstimator, sampler: Sampler, n: int, known: Known, stream: Stream
) -> Predicted:
    """A line through the logarithms of variances measured at the small counts nearest to n, without n."""
    near = [] if known.g.costly else _counts_near(n)
    counts = {sampler.nearest_count(c): c in near for c in (*_SMALL, *near)}
    by_distance = sorted(counts, key=lambda count: (abs(math.log(count / n)), count))
    found: list[tuple[int, Moments]] = []
    for count in by_distance:
        if count == n or len(found) == _FITTED:
            continue
        with contextlib.suppress(CountError):
            if sum(estimator.counts) > 1:  # one has its nearest counts, without more warnings
                estimator.check_sampler(sampler, count)
            close = counts[count]
            sets = max(_NEAR_SETS, _NEAR_POINTS // count) if close else _REALIZATIONS
            moments = known.once(
                ("measured", sampler.spec, count, sets),
                functools.partial(
                    count_moments, estimator, sampler, count, sets, count_stream(stream, count)
                ),
            )
            if (moments.resolved & (moments.variance > rounding_floor(moments.mean))).all():
                found.append((count, moments))
    if len(found) < _FITTED - 1:
        raise NoClosedForm(
            f"No route predicts {sampler.spec}, and its small sets show no variance or are too few."
        )

    # The scatter about the line is at least that of the measurements
    from scipy.special import stdtrit

    x = np.log([float(count) for count, _ in found])
    y = np.log([moments.variance for _, moments in found])
    noise = np.array([moments.relative_se for _, moments in found])
    middle, spread = x.mean(), ((x - x.mean()) ** 2).sum()
    slope = ((x - middle)[:, None] * y).sum(axis=0) / spread
    left = y - y.mean(axis=0) - slope * (x - middle)[:, None]
    degrees = len(x) - 2
    scatter = np.sqrt((left**2).sum(axis=0) / degrees)
    size = np.maximum(scatter, np.sqrt((noise**2).mean(axis=0)))
    away = math.log(n) - middle
    half = stdtrit(degrees, 0.975) * size * math.sqrt(1.0 + 1.0 / len(x) + away**2 / spread)
    variance = np.exp(y.mean(axis=0) + slope * away)
    error = variance * np.expm1(np.minimum(half, math.log(_MOST_FACTOR)))
    listed = ", ".join(str(count) for count in sorted(count for count, _ in found))
    route = f"extrapolated from measurements at {listed}"
    return Predicted(variance, error, route, 0.0, variance)


def _counts_near(n: int) -> list[int]:
    """Counts about n that sets fill as n: of a power of two others, else in steps of one that divides n."""
    if n & (n - 1) == 0:
        near = [n // 4, n // 2, 2 * n, 4 * n]
    else:
        step = min(n & -n, 1 << max(0, (n // _NEAR).bit_length() - 1))
        near = [n + k * step for k in (-2, -1, 1, 2)]
    return [count for count in near if 1 < count <= _LARGEST]
