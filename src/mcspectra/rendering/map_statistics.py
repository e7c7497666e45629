"""Statistics of variances over an image: rates, the technique that limits MIS, gains, and shares.

Rates come from line fits of log variance against log n at every pixel.
The weights of a fit come from the relative standard errors (`mcspectra.core.fits.line_fits`).
Arrays have the axes (strategy, n, y, x) or (strategy, y, x).

A path requests random numbers x_1 … x_K, one or two at a time, for its K decisions.
`path_shares` divides the variance of the path's value f among these requests:
Var f = Σ_k (Var E[f | x_1 … x_k] − Var E[f | x_1 … x_{k−1}]).
No term is negative.
The variance from an interaction of several requests is assigned to the last of these requests.
Let h_k = f(x_1 … x_k, y_{k+1} … y_K) for two independent paths x and y of K requests each.
Term k is the mean of (h_k − h_{k−1}) (h_K − c), the pick-freeze estimator [Sobol2001]_.
K + 1 evaluations of f give all terms.
The estimator of a term is unbiased if c is any function of the sum h_k + h_{k−1}.
The error is least if c is the regression of h_K on h_k + h_{k−1}.
The slope of the regression is fitted to the same paths, which gives a bias of order 1/R.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.core.fits import LineFits, line_fits

__all__ = [
    "UNDECIDED",
    "dominant",
    "fit_lines",
    "gain",
    "interval",
    "least",
    "path_shares",
    "ratio",
    "slowest",
    "smooth",
]

UNDECIDED = -1.0

# Variances below this multiple of float32's rounding unit are attributed to rounding in Mitsuba
_ULPS = 4.0


def fit_lines(
    ns: Array, variance: Array, relative_se: Array, mean: Array, largest_se: float = 0.5
) -> LineFits:
    """Fit lines to all variances at once, given relative errors and means, (S, N, …).

    Variances that are zero, or that rounding in float32 could cause, are ignored.
    Variances with a relative standard error above `largest_se` are ignored as well.
    Variances with large errors come from few realizations that hit a rare event.
    Most variances with large errors are far too small.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        floor = (_ULPS * np.finfo(np.float32).eps * mean) ** 2
        used = (variance > floor) & (relative_se > 0) & (relative_se <= largest_se)
        weight = np.where(used, relative_se**-2.0, 0.0)
        y = np.where(used, np.log(variance), 0.0)
        x = np.log(ns.astype(float)).reshape(1, -1, *[1] * (variance.ndim - 2))
        # If a variance is ignored, but a variance at a larger n is used,
        # the realizations at the smaller n probably missed a rare event
        missed = np.maximum.accumulate(used[:, ::-1], axis=1)[:, ::-1] & ~used
        return line_fits(x, y, weight, known=np.asarray(~missed.any(axis=1)))


def smooth(rate: Array, rate_se: Array, window: int, independent: bool) -> tuple[Array, Array]:
    """Average rates (S, y, x) over window × window pixels, weighted by their precision.

    Pixels without a rate are ignored and remain without a rate.
    If the points of pixels are `independent`, averaging lowers the standard error of the rate.
    If the points are not independent, the result has the mean standard error of the pixels.
    The mean is exact if all errors in the window are equal, and too large if they are not.
    """
    if window == 1:
        return rate, rate_se
    known = np.isfinite(rate) & (rate_se > 0)
    weight = np.zeros_like(rate)
    np.power(rate_se, -2.0, out=weight, where=known)
    total = _box(weight, window)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = _box(weight * np.where(known, rate, 0.0), window) / total
        together = _box(weight * np.where(known, rate_se, 0.0), window) / total
        se = total**-0.5 if independent else together
    return np.where(known, mean, np.nan), np.where(known, se, np.nan)


def interval(value: Array, se: Array) -> Array:
    """Return the 95 % interval of a value, (…, 2)."""
    return np.stack([value - CONFIDENCE_Z * se, value + CONFIDENCE_Z * se], axis=-1)


def ratio(log_ratio: Array, se: Array) -> tuple[Array, Array]:
    """Return a ratio and its 95 % interval (…, 2), from its logarithm and standard error."""
    return np.exp(log_ratio), np.exp(interval(log_ratio, se))


def slowest(rate: Array, rate_se: Array) -> Array:
    """Return which of two techniques (2, y, x) has the significantly slower rate.

    The techniques must have independent points, so that their squared standard errors add up.
    Testing whether the 95 % intervals of the two rates are disjoint would be less sensitive.
    For rates with equal standard errors, disjoint intervals need a 1.4 times larger difference.
    """
    return _larger(rate[0] - rate[1], rate_se, np.isnan(rate).all(axis=0))


def dominant(variance: Array, relative_se: Array) -> Array:
    """Return which of two techniques (2, y, x) has the significantly larger variance."""
    with np.errstate(invalid="ignore", divide="ignore"):
        log_ratio = np.log(variance[0]) - np.log(variance[1])
        return _larger(log_ratio, relative_se, np.isnan(log_ratio))


def least(variance: Array, relative_se: Array) -> Array:
    """Return the index of the sampler with the least variance; the variances are (S, …).

    The index is `UNDECIDED` unless the sampler's variance is significantly below all others.
    The index is NaN if the variance of any sampler is not positive.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        log = np.where(variance > 0.0, np.log(variance), np.nan)
        unknown = np.isnan(log).any(axis=0)
        best = np.argmin(np.where(unknown, 0.0, log), axis=0)[None]
        own, own_se = (np.take_along_axis(a, best, axis=0) for a in (log, relative_se))
        apart = log - own > CONFIDENCE_Z * np.hypot(relative_se, own_se)
    np.put_along_axis(apart, best, True, axis=0)
    return np.select([unknown, apart.all(axis=0)], [np.nan, best[0]], UNDECIDED)


def path_shares(chains: Array, partitions: list[Array]) -> tuple[Array, Array, Array]:
    """Return the variance of a path, the shares of its parts, and the largest share.

    Parameters
    ----------
    chains
        Values h_0 … h_K of R chains (pairs of paths) at P pixels, (R, K + 1, P).
    partitions
        Each partition is a mask (G, K) that groups the K requests of a path into G parts.
        Every request for random numbers belongs to exactly one of these parts.

    Returns
    -------
    tuple
        The variance and its standard error (2, P).
        The shares of all parts, each with the two ends of its 95 % interval (3, ΣG, P).
        Intervals use Student's t, with degrees of freedom from the effective number of chains.
        Intervals are NaN if the standard error of the variance exceeds half of the variance.
        For each partition, the index of the part with the largest share (partitions, P).
        The index is `UNDECIDED` if the share does not differ significantly from another share.
    """
    from scipy.special import stdtrit

    # From each pair of paths, estimate the variance that each request for random numbers adds
    count, mean = len(chains), chains.mean(axis=(0, 1))
    values = chains - mean
    last, steps = values[:, -1:], np.diff(values, axis=1)
    middle = 0.5 * (values[:, 1:] + values[:, :-1])
    square = (middle**2).sum(axis=0)
    slope = np.divide(
        (last * middle).sum(axis=0), square, out=np.zeros_like(square), where=square > 0
    )
    products = steps * (last - np.clip(slope, 0.0, 1.0) * middle)
    every = products.sum(axis=1)
    whole, error = every.mean(axis=0), every.std(axis=0, ddof=1) / count**0.5
    floor = (_ULPS * np.finfo(np.float32).eps * mean) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        known = np.where((whole > floor) & (error <= 0.5 * whole), whole, np.nan)

    def shared(own: Array) -> tuple[Array, Array]:
        """Return the shares of parts (R, G, P), and half widths of intervals (delta method)."""
        share = own.mean(axis=0) / known
        squares = (own - share * every[:, None]) ** 2
        total, fourth = squares.sum(axis=0), (squares**2).sum(axis=0)
        carriers = np.divide(total**2, fourth, out=np.full_like(total, count), where=fourth > 0.0)
        return share, stdtrit(np.maximum(carriers - 1.0, 1.0), 0.975) * np.sqrt(total) / (
            count * known
        )

    shares, largest = [], []
    for members in partitions:
        own = np.stack([products[:, part].sum(axis=1) for part in members], axis=1)
        share, half = shared(own)
        shares.append(np.stack([share, share - half, share + half]))
        first = np.argmax(np.where(np.isnan(share), 0.0, share), axis=0)[None]
        gap, half = shared(np.take_along_axis(own, first[None], axis=1) - own)
        apart = gap > half
        np.put_along_axis(apart, first, True, axis=0)
        undecided = [np.isnan(known), apart.all(axis=0)]
        largest.append(np.select(undecided, [np.nan, first[0]], UNDECIDED))
    return np.stack([whole, error]), np.concatenate(shares, axis=1), np.stack(largest)


def gain(single: LineFits, mis: LineFits, total: float, missed: Array) -> tuple[Array, Array]:
    """Variance of the best single strategy divided by that of MIS, each with `total` samples.

    Strategies in `missed` are excluded, because they miss light that another strategy hits.
    The measured variance of an excluded strategy is too small.

    The variances of MIS and of the strategies come from the fitted lines.
    MIS gives each technique half of the samples.
    The standard error treats the two variances as independent.
    The two variances use the same points, so the standard error is rather too large than too small.
    """
    levels, errors = single.at(total)
    levels = np.where(missed, np.nan, levels)
    best = np.argmin(np.where(np.isnan(levels), np.inf, levels), axis=0)[None]
    level, error = (np.take_along_axis(a, best, axis=0)[0] for a in (levels, errors))
    other, other_error = mis.at(total / 2)
    return ratio(level - other[0], np.hypot(error, other_error[0]))


def _larger(difference: Array, se: Array, unknown: Any) -> Array:
    """Return which of two values is larger, 0 or 1; undecided if the interval contains 0.

    The result is NaN where `unknown` is true.
    """
    half = CONFIDENCE_Z * np.hypot(*se)
    sure = [unknown, difference > half, -difference > half]
    return np.select(sure, [np.nan, 0.0, 1.0], UNDECIDED)


def _box(image: Array, window: int) -> Array:
    """Sum images (S, y, x) over windows of window × window pixels; pixels outside count as zero."""
    reach = window // 2
    for axis in (1, 2):
        margin = [(reach, reach) if a == axis else (0, 0) for a in range(3)]
        wide = np.pad(image, margin)
        length = image.shape[axis]
        parts = (np.take(wide, range(k, k + length), axis=axis) for k in range(window))
        image = np.sum(list(parts), axis=0)
    return image
