"""Precision of a mean: its standard error, quantiles and 95 % intervals."""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array

__all__ = [
    "CONFIDENCE_Z",
    "deviations_t",
    "log_mean_interval",
    "rounding_floor",
    "standard_error",
    "student_t",
]

CONFIDENCE_Z = 1.959963984540054
"""Half width of a two-sided 95 % interval, in standard errors."""


def standard_error(spread: Array, count: int) -> Array:
    """Return the standard error of a mean of `count` values with mean square deviation `spread`."""
    if count < 2:
        return np.full_like(spread, np.nan)
    return np.asarray(np.sqrt(np.maximum(spread, 0.0) / (count - 1)))


def student_t(count: int) -> float:
    """Return the half width of the 95 % interval of a mean, in standard errors.

    The mean is over `count` values. A `count` below 2 is treated as 2.
    """
    from scipy.special import stdtrit

    return float(stdtrit(max(1, count - 1), 0.975))


def deviations_t(count: int) -> float:
    """Return the half width of a 95 % interval of a mean of squared deviations, as `student_t`.

    The deviations are the differences between `count` values and the mean of these values.
    For normal values, the squares of two deviations have the correlation 1/(count − 1)².
    Because of this correlation, the standard error is too small by √((count − 2)/(count − 1)).
    Two values give no standard error, because the squares of their deviations are equal.
    """
    return student_t(count) * (1.0 if count < 3 else ((count - 1) / (count - 2)) ** 0.5)


def log_mean_interval(mean: Array, se: Array, count: int) -> Array:
    """Return the 95 % interval (..., 2) of a mean of nonnegative values, on a logarithmic scale.

    Student's t is applied to the logarithm of the mean.
    For example, take 4 realizations of |S|² with Gaussian S: |S|² is exponentially distributed.
    The interval contains the true mean in 93 % of cases.
    The interval mean ± t·se would contain the true mean in 88 %, mean ± 1.96 se in 78 %.
    """
    relative = np.divide(se, mean, out=np.array(se), where=mean > 0)
    factor = np.exp(student_t(count) * relative)
    return np.stack([mean / factor, mean * factor], axis=-1)


def rounding_floor(size: Array) -> Array:
    """Return (16 ulps)² of estimates of magnitude `size`. Smaller variances are only rounding."""
    return np.asarray((16 * np.finfo(float).eps * np.abs(size)) ** 2)
