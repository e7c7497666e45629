"""Samples of the unit cube, and errors of means and slopes of noisy values."""

from statistics import NormalDist

import numpy as np

from mcspectra.core.streams import Stream

Z = NormalDist().inv_cdf(0.975)


def uniforms(count, dims=2, seed=1):
    """Independent points (count, dims)."""
    return Stream.from_rng(seed).uniforms(0, 1, count * dims).reshape(count, dims)


def mean_and_error(values):
    return values.mean(axis=0), values.std(axis=0, ddof=1) / len(values) ** 0.5


def slope_error(curve):
    """Standard error of a slope from the noise of its variances, or from the scatter if larger."""
    low, high = np.log(curve["variance_ci"].transpose("bound", "n").values)
    weight = ((high - low) / 2 / Z) ** -2.0
    x = np.log(curve["n"].values)
    spread = (weight * (x - np.average(x, weights=weight)) ** 2).sum()
    return float((max(1.0, float(curve["fit_chi2"])) / spread) ** 0.5)
