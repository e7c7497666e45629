"""The share of ∫f²/p where no sample will fall: a measured variance misses it.

∫1/p and the variance may be finite and yet far larger than any simulation can measure: with f = 1 and
p normal about ½ with σ = 0.02, ∫f²/p is 4e131, and 99.8 % of it come from x within 0.005 of the
ends, where one sample in 3e134 falls.
"""

from __future__ import annotations

import numpy as np

from mcspectra.estimators.base import AbstractEstimator
from mcspectra.estimators.importance import Estimator
from mcspectra.estimators.moments import Moments
from mcspectra.estimators.support import probe_points

__all__ = ["tail_note", "unsampled_note", "unsampled_share"]

_LEAST, _POINTS = 2**12, 2**16
_LARGE = 0.1  # of the second moment; what a note is worth


def unsampled_share(estimator: AbstractEstimator, samples: int) -> float:
    """Return the share of ∫f²/p over the region of smallest p that holds less than one sample.

    Parameters
    ----------
    estimator
        The share is 0 for anything but an `Estimator` with a density.
    samples
        Number N of all samples, over all realizations: the region has the mass 1/N.

    Notes
    -----
    Means over points of an additive recurrence, as many as samples but 4096 to 65 536, so that this
    costs no more than the simulation: a region that holds none of them counts as
    empty, so in many dims the share is too small rather than too large. With several channels the
    largest share is returned.
    """
    if not isinstance(estimator, Estimator) or estimator.density is None:
        return 0.0
    count = int(np.clip(samples, _LEAST, _POINTS))
    x = probe_points(estimator.integrand.dims, count)
    p = estimator.density.pdf(x)
    order = np.argsort(p)
    unsampled = int(np.searchsorted(np.cumsum(p[order]) / count, 1.0 / samples))
    values = np.asarray(estimator.integrand(x[order])).reshape(count, -1)

    # f²/p relative to the largest of its channel, by logarithms: p may be 1e-300
    with np.errstate(divide="ignore"):
        floor = np.maximum(p[order, None], np.finfo(float).tiny)
        logarithms = 2 * np.log(np.abs(values)) - np.log(floor)
    largest = logarithms.max(axis=0)
    squares = np.exp(logarithms - np.where(np.isfinite(largest), largest, 0.0))
    totals = squares.sum(axis=0)
    shares = squares[:unsampled].sum(axis=0) / np.where(totals > 0, totals, 1.0)
    return float(shares.max())


def unsampled_note(estimator: AbstractEstimator, samples: int) -> str | None:
    """Return a sentence if a tenth or more of ∫f²/p lies where no sample is expected.

    A black box is not called for it: None.
    """
    share = 0.0 if estimator.is_black_box else unsampled_share(estimator, samples)
    if share < _LARGE:
        return None
    return (
        f"{100 * share:.3g} % of ∫f²/p lies where less than one of the {samples} samples is expected: "
        "the true variance may be far above the measured one and its interval; choose a density "
        "with heavier tails, such as defensive(density=…)"
    )


def tail_note(moments: Moments) -> str | None:
    """Return a sentence if the tails of the estimates are not resolved: of the channel that is worst."""
    unresolved = ~np.atleast_1d(moments.resolved)
    if not unresolved.any():
        return None
    index = np.atleast_1d(moments.tail_index)[unresolved]
    found = "" if np.isnan(index).all() else f", tail index k̂ = {np.nanmax(index):.2f}"
    return (
        f"tails not resolved (one or a few of {moments.count} estimates make the variance{found}): it "
        "may be far above the measured one and has no upper bound; more points or a density with "
        "heavier tails help, more realizations show it"
    )
