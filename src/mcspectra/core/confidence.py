"""Precision of a mean: standard error, quantiles and 95 % intervals."""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["CONFIDENCE_Z", "log_mean_interval", "standard_error", "student_t"]

CONFIDENCE_Z = 1.959963984540054
"""Half width of a two-sided 95 % interval in standard errors."""


def standard_error(spread: Array, count: int) -> Array:
    """Standard error of a mean of `count` values; `spread` is mean square minus squared mean."""
    if count < 2:
        return np.full_like(spread, np.nan)
    return np.asarray(np.sqrt(np.maximum(spread, 0.0) / (count - 1)))


def student_t(count: int) -> float:
    """Half width of the 95 % interval of a mean of `count` values, in standard errors.

    A `count` below 2 is treated as 2.
    """
    from scipy.special import stdtrit

    return float(stdtrit(max(1, count - 1), 0.975))


def log_mean_interval(mean: Array, se: Array, count: int) -> Array:
    """95 % interval of a mean of nonnegative values, shape (..., 2), on a logarithmic scale.

    Student's t is applied to the logarithm of the mean. Example: 4 realizations of |S|² of a
    Gaussian S, which is exponentially distributed. The interval covers 93 %, the interval
    mean ± t·se covers 88 %, and the interval with the normal quantile covers 78 %.
    """
    relative = np.divide(se, mean, out=np.array(se), where=mean > 0)
    factor = np.exp(student_t(count) * relative)
    return np.stack([mean / factor, mean * factor], axis=-1)
