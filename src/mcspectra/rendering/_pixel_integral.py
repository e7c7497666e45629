"""The integral of a pixel: means over randomised points, with their standard error.

A pixel's integrand jumps along curves (edges of lights and of what occludes them) that no axis
follows: boxes of Gauss-Legendre nodes do not converge on it, nor does their error estimate show
it. Independently scrambled Sobol' points are unbiased whatever the integrand, and their spread is an
error that can be trusted [Owen1997]_.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.streams import Stream
from mcspectra.integrands import Integrand
from mcspectra.integrands.base import Estimate
from mcspectra.samplers import as_sampler

__all__ = ["SOURCE", "mean_of_points"]

SOURCE = "mean of 16 Owen-scrambled sets of 2^17 Sobol' points"
"""What `integral_source` says."""

_POINTS, _SETS = 2**17, 16
_SEED = 20_170_623
_SINGLE = float(np.finfo(np.float32).eps)  # of values, which a spread does not show


def mean_of_points(integrand: Integrand) -> Estimate:
    """∫ g, (C,) with 1 for a scalar, and its standard error, the largest of the channels."""
    sampler, stream = as_sampler("sobol | owen", integrand.dims), Stream.from_rng(_SEED)
    means = np.stack(
        [_mean(integrand, sampler.draw_stream(_POINTS, stream, k, 1)[0]) for k in range(_SETS)]
    )
    value = means.mean(axis=0)
    spread = means.std(axis=0, ddof=1) / _SETS**0.5
    error = np.hypot(spread, _SINGLE * np.abs(value))
    return Estimate(value, float(error.max()), SOURCE)


def _mean(integrand: Integrand, u: Array) -> Array:
    mean: Array = integrand(u).reshape(len(u), -1).mean(axis=0)
    return mean
