"""A one-dimensional environment map: sampling by luminance against sampling by each channel.

Eight pixels of three channels times a smooth cosine factor, jittered. By luminance the primary-space
integrand keeps L_c/luminance, which jumps at pixel borders: n^-2. By the channel's own density it
keeps the cosine only, continuous with kinks: n^-3 in the limit, −2.6 to −2.9 for these counts, and
variances that are lower by two decades and more.
"""

from __future__ import annotations

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.densities import PiecewiseConstant

PIXELS = np.array(
    [
        [0.3, 0.4, 0.9],
        [0.2, 0.5, 1.0],
        [6.0, 1.0, 0.4],
        [14.0, 12.0, 7.0],
        [0.6, 5.0, 0.8],
        [0.4, 0.7, 4.0],
        [0.1, 0.9, 0.3],
        [1.2, 0.3, 0.2],
    ]
)
LUMINANCE = PIXELS @ np.array([0.2126, 0.7152, 0.0722])
COUNTS = [16, 32, 64, 128, 256, 512, 1024]
REALIZATIONS = 600


def channel(c):
    """f_c(x) = L_c(x) cos(π (x − ½)) with its exact integral."""
    table = PiecewiseConstant(values=PIXELS[:, c])
    scale = PIXELS[:, c].mean()
    borders = np.sin(np.pi * (np.arange(9) / 8 - 0.5)) / np.pi
    return mcs.Integrand.from_function(
        lambda x: scale * table.pdf(x) * np.cos(np.pi * (x[..., 0] - 0.5)),
        dims=1,
        integral=float(PIXELS[:, c] @ np.diff(borders)),
    )


BY_LUMINANCE = [mcs.Estimator(channel(c), PiecewiseConstant(values=LUMINANCE)) for c in range(3)]
BY_OWN = [mcs.Estimator(channel(c), PiecewiseConstant(values=PIXELS[:, c])) for c in range(3)]


@pytest.fixture(scope="module")
def measured():
    """Convergence of both, dims (estimator, n): three channels by luminance, then by their own."""
    return mcs.convergence(
        BY_LUMINANCE + BY_OWN, "jittered", COUNTS, realizations=REALIZATIONS, rng=1
    )


def test_rates(measured):
    """Fitted: about −2 by luminance, −2.6 to −3 by the own density, intervals apart."""
    low, high = np.moveaxis(measured["rate_ci"].values.reshape(6, 2), -1, 0)
    rates = measured["rate"].values.ravel()
    assert ((rates[:3] > -2.3) & (rates[:3] < -1.8)).all()
    assert ((rates[3:] > -3.05) & (rates[3:] < -2.6)).all()
    assert low[:3].min() > high[3:].max()


def test_variances_are_decades_apart(measured):
    last = measured["variance"].values.reshape(6, len(COUNTS))[:, -1]
    decades = np.log10(last[:3] / last[3:])
    assert decades.min() > 1.5  # green, which is most of luminance
    assert decades.max() > 3.0


def test_variances_are_those_of_strata(measured):
    """By quadrature of each stratum, an independent route; 4 σ by the reported intervals."""
    for k, estimator in enumerate(BY_LUMINANCE + BY_OWN):
        for j in (0, 3):
            expected = mcs.exact_variance(estimator, "jittered", COUNTS[j])
            low, high = measured["variance_ci"].values.reshape(6, len(COUNTS), 2)[k, j]
            error = np.log(high / low) / (2 * 1.96)
            variance = measured["variance"].values.reshape(6, len(COUNTS))[k, j]
            assert abs(np.log(variance / expected)) < 4 * error


def test_means_are_the_integrals(measured):
    off = measured["bias"].values / measured["mean_se"].values
    assert np.abs(off).max() < 5  # 42 means: 5 σ is 2e-5 for all of them
