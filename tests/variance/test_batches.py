"""Standard errors of the terms: as large as the spread over independent runs says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs

RUNS = 60


@pytest.fixture(scope="module")
def runs():
    estimator = mcs.Estimator("gaussian(center=0.3, width=0.3)", "linear(slope=0.8)", dims=1)
    return [
        mcs.variance_terms(estimator, "jittered", 8, half_width=16, realizations=160, rng=seed)
        for seed in range(RUNS)
    ]


@pytest.mark.parametrize("term", ["dc_term", "power_term", "cross_term"])
def test_errors_of_terms_are_their_spread(runs, term):
    values = np.array([float(d[term]) for d in runs])
    claimed = np.sqrt(np.mean([float(d[f"{term}_se"]) ** 2 for d in runs]))
    # the spread of 60 values is known to 1/√(2·59) = 9 %, the mean of squared errors far better;
    # batch means of 8 realisations claim up to √(8/7) too much
    assert 1 - 4 * 0.092 < claimed / np.std(values, ddof=1) < np.sqrt(8 / 7) * (1 + 4 * 0.092)


def test_the_interval_of_captured_covers_the_truth(runs):
    """The truth from 100 times as many realisations; 60 intervals of 95 % miss it at most 11 times."""
    estimator = mcs.Estimator("gaussian(center=0.3, width=0.3)", "linear(slope=0.8)", dims=1)
    truth = float(
        mcs.variance_terms(estimator, "jittered", 8, half_width=16, realizations=16_000, rng=999)[
            "captured"
        ]
    )
    low, high = np.array([d["captured_ci"].values for d in runs]).T
    missed = np.count_nonzero((truth < low) | (truth > high))
    assert missed <= 11  # binomial(60, 0.05): more with probability 1e-5
    claimed = np.sqrt(np.mean((high - low) ** 2)) / 2 / stats.t.ppf(0.975, 19)
    spread = np.std([float(d["captured"]) for d in runs], ddof=1)
    assert 1 - 4 * 0.092 < claimed / spread < np.sqrt(8 / 7) * (1 + 4 * 0.092)


def test_few_realizations():
    estimator = mcs.Estimator("gaussian", dims=1)
    two = mcs.variance_terms(estimator, "jittered", 8, half_width=4, realizations=3)
    assert np.isnan(float(two["cross_term_se"]))
    assert np.isnan(two["captured_ci"]).all()
    four = mcs.variance_terms(estimator, "jittered", 8, half_width=4, realizations=4)
    assert float(four["power_term_se"]) > 0


def test_channels_have_errors_of_their_own():
    f = mcs.Integrand.from_function(lambda x: np.concatenate([x, 2 * x], axis=-1), dims=1)
    d = mcs.variance_terms(f, "random", 8, half_width=4, realizations=40, rng=1)
    assert d["power_term_se"].dims == ("channel",)
    np.testing.assert_allclose(d["power_term_se"][1] / d["power_term_se"][0], 4.0)
    np.testing.assert_allclose(d["captured_ci"][0], d["captured_ci"][1])
