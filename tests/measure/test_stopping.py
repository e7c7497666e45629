"""Sequential stopping reaches the requested error, and skewed values take longer."""

import numpy as np
import pytest

import mcspectra as mcs

LINEAR = mcs.Estimator("linear", dims=1)


def _step(share):
    return mcs.Estimator(f"step(at={share})", dims=1)


def test_the_requested_error_is_reached():
    """A uniform value has the kurtosis 9/5, so about 0.8/ε² realizations are needed."""
    d = mcs.measure.realizations_needed(LINEAR, "random", 1, relative_error=0.02, rng=1)
    assert float(d["reached"]) == 1
    assert float(d["variance_relative_se"]) <= 0.02
    assert abs(float(d["kurtosis"]) - 1.8) < 0.1
    assert 0.75 / 0.02**2 < int(d["realizations_used"]) < 2 * 0.8 / 0.02**2
    assert abs(float(d["variance"]) * 12 - 1) < 4 * 0.02


def test_stated_errors_equal_the_spread_over_seeds():
    """In 60 runs, deviations from the exact variance agree with the stated errors."""
    runs = [
        mcs.measure.realizations_needed(LINEAR, "jittered", 4, relative_error=0.1, rng=seed)
        for seed in range(60)
    ]
    exact = mcs.exact_variance(LINEAR, "jittered", 4)
    pulls = [(float(d["variance"]) / exact - 1) / float(d["variance_relative_se"]) for d in runs]
    # Σ pull² has a χ² distribution with 60 degrees of freedom; allow 4 σ
    assert abs(np.mean(np.square(pulls)) - 1) < 4 * np.sqrt(2 / 60)


@pytest.mark.parametrize("share", [0.1, 0.01])
def test_skewed_values_need_more_realizations(share):
    """A value of 1[x < p] has the kurtosis κ = (1 − 3pq)/pq, and R is about (κ − 1)/ε²."""
    d = mcs.measure.realizations_needed(_step(share), "random", 1, relative_error=0.1, rng=1)
    q = share * (1 - share)
    expected = ((1 - 3 * q) / q - 1) / 0.1**2
    # The error of κ is about ε, because rare values are Poisson; a stop is confirmed 25 % later
    assert 0.7 * expected < int(d["realizations_used"]) < 1.25**2 * 1.3 * expected
    assert float(d["reached"]) == 1
    assert abs(float(d["variance"]) / q - 1) < 4 * 0.1


def test_skewed_values_do_not_stop_early():
    """A sample without rare values, or with too few, must not end the run."""
    used, low = [], []
    for seed in range(60):
        d = mcs.measure.realizations_needed(_step(0.02), "random", 1, relative_error=0.2, rng=seed)
        used.append(int(d["realizations_used"]))
        low.append(float(d["variance_ci"][1]) < 0.02 * 0.98)
    # 2.5 % of the intervals may lie below the truth; allow 5 σ of 60 runs
    assert np.mean(low) < 0.025 + 5 * np.sqrt(0.025 * 0.975 / 60)
    assert min(used) > 100


def test_equal_values_do_not_reach_the_precision():
    d = mcs.measure.realizations_needed(_step(1e-9), "random", 1, rng=1)
    assert float(d["reached"]) == 0
    assert np.isnan(float(d["variance_relative_se"]))
    assert np.isnan(float(d["kurtosis"]))
    assert int(d["realizations_used"]) >= 10_000
    short = mcs.measure.realizations_needed(_step(1e-9), "random", 1, max_realizations=500, rng=1)
    assert int(short["realizations_used"]) == 500


def test_the_maximum_is_not_exceeded():
    d = mcs.measure.realizations_needed(
        LINEAR, "random", 1, relative_error=0.01, max_realizations=150
    )
    assert (int(d["realizations_used"]), float(d["reached"])) == (150, 0)


def test_every_channel_reaches_the_precision():
    two = mcs.Estimator(
        mcs.Integrand.from_function(
            lambda x: np.stack([x[..., 0], 1.0 * (x[..., 0] < 0.01)], axis=-1), dims=1
        )
    )
    d = mcs.measure.realizations_needed(two, "random", 1, relative_error=0.1, rng=1)
    assert d["variance_ci"].dims == ("channel", "bound")
    assert (d["variance_relative_se"] <= 0.1).all()
    assert int(d["realizations_used"]) > 5000  # the rare channel needs this number


def test_unresolved_tails_do_not_reach_the_precision():
    """u^-0.8 has an infinite variance, so the variance of 2000 values is meaningless."""
    f = mcs.Integrand.from_function(lambda x: x[..., 0] ** -0.8, dims=1)
    d = mcs.measure.realizations_needed(
        mcs.Estimator(f), "random", 1, relative_error=0.2, max_realizations=2000, rng=1
    )
    assert (int(d["realizations_used"]), int(d["reached"])) == (2000, 0)
    assert float(d["variance_relative_se"]) == float(d["variance_ci"][1]) == np.inf
    assert d.attrs["note"].startswith("tails not resolved (one or a few of 2000 estimates")
    assert "note" not in mcs.measure.realizations_needed(LINEAR, "random", 1).attrs
