"""Errors of fitted rates by noise, for tests of curves that wobble about their line."""

from statistics import NormalDist

import numpy as np

Z = NormalDist().inv_cdf(0.975)


def slope_error(curve):
    """Standard error of a slope by the noise of its variances, or by the scatter about it if larger."""
    low, high = np.log(curve["variance_ci"].transpose("bound", "n").values)
    weight = ((high - low) / 2 / Z) ** -2.0
    x = np.log(curve["n"].values)
    spread = (weight * (x - np.average(x, weights=weight)) ** 2).sum()
    return float((max(1.0, float(curve["fit_chi2"])) / spread) ** 0.5)
