"""Exact variances of mirrored sets, by those of the sampler inside with another integrand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import NoClosedForm
from mcspectra.estimators.reflected import FoldedIntegrand, SymmetrizedIntegrand
from mcspectra.integrands import Integrand
from mcspectra.samplers import Mirror, Random, Randomized, Sampler

__all__ = ["mirrored_variance", "without_mirror"]


def without_mirror(sampler: Sampler) -> tuple[str | None, Sampler]:
    """Return the mode of the mirroring that a sampler ends with, if any, and what is before it."""
    if not isinstance(sampler, Randomized) or not isinstance(sampler.steps[-1], Mirror):
        return None, sampler
    rest = sampler.steps[:-1]
    inner = Randomized(base=sampler.base, steps=rest) if rest else sampler.base
    return sampler.steps[-1].mode, inner


def mirrored_variance(
    variance: Callable[[Sampler, int, Integrand], Array],
    mode: str,
    inner: Sampler,
    n: int,
    g: Integrand,
) -> Array:
    """Variance of the mean of g over `inner` followed by mirroring.

    Parameters
    ----------
    variance
        Variance of the mean of an integrand over n points of a sampler.
    mode, inner, n, g
        As in ``inner | mirror(mode=...)``, with n points after it.

    Notes
    -----
    Folded points see the folded integrand; images of all n/2^d points see the average ḡ of g over
    reflections, and so do, on average over the coins, points reflected at random. The coins add
    E[Var(g | point)]/n = (Var g − Var ḡ)/n if each point is uniform.
    """
    if mode == "fold":
        return variance(inner, n, FoldedIntegrand(g))
    average = SymmetrizedIntegrand(g)
    if mode == "uniform":
        return variance(inner, n >> g.dims, average)
    if not inner.unbiased:
        raise NoClosedForm(
            f"No exact variance is known for random reflections of {inner.spec}, whose points are "
            "not uniform; use convergence or variance_terms."
        )
    one = Random(dims=g.dims)
    coins = np.maximum(variance(one, 1, g) - variance(one, 1, average), 0.0)
    return np.asarray(variance(inner, n, average) + coins / n)
