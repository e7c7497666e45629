"""Rates: fitted slopes contain the theory; labels; what is refused."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.variance.convergence import fit_rate

COUNTS = [16, 64, 256, 1024]


def _rate(estimator, sampler, counts=COUNTS, realizations=1000, **kwargs):
    d = mcs.convergence(estimator, sampler, counts, realizations=realizations, rng=2, **kwargs)
    low, high = d["rate_ci"].values
    return float(d["rate"]), (high - low) / 2 / 1.96


@pytest.mark.parametrize(
    ("integrand", "sampler", "rate", "slack"),
    [
        # ORACLES.md. `slack` bounds the pre-asymptotic bend: lower-order terms are O(n^-1/2).
        ("christensen-gaussian", "random", -1.0, 0.0),
        ("christensen-gaussian", "jittered", -2.0, 0.02),
        ("christensen-gaussian", "jittered | shift", -1.5, 0.03),
        ("christensen-gaussian", "latin-hypercube", -1.0, 0.06),
        ("disk(center=[0.463, 0.517], radius=0.27)", "random", -1.0, 0.0),
        ("disk(center=[0.463, 0.517], radius=0.27)", "jittered", -1.5, 0.05),
        ("disk(center=[0.463, 0.517], radius=0.27)", "jittered | shift", -1.5, 0.05),
        ("disk(center=[0.463, 0.517], radius=0.27)", "latin-hypercube", -1.0, 0.06),
    ],
)
def test_rates_of_the_oracle_table(integrand, sampler, rate, slack):
    fitted, se = _rate(mcs.Estimator(integrand, dims=2), sampler)
    assert abs(fitted - rate) < 4 * se + slack, (fitted, se)


def test_scrambled_sobol_rates():
    """Gaussian −3 (measured −2.95 for n 16…4096), disk −1.5 (ORACLES)."""
    fitted, se = _rate(
        mcs.Estimator("christensen-gaussian"), "sobol | owen", [16, 64, 256, 1024, 4096]
    )
    assert abs(fitted + 2.95) < 4 * se + 0.05, (fitted, se)


def test_1d_rates():
    f = mcs.Estimator("polynomial(coefficients=[0, 0, 1])", dims=1)
    for sampler, rate in (("random", -1.0), ("jittered", -3.0), ("jittered | shift", -2.0)):
        fitted, se = _rate(f, sampler, [8, 32, 128])
        assert abs(fitted - rate) < 4 * se + 0.03, (sampler, fitted, se)


def test_fit_recovers_a_line_and_covers_it():
    """200 synthetic curves with known errors: the 95 % interval covers the slope 95 % of the time."""
    rng = np.random.default_rng(6)
    n = np.array([4, 16, 64, 256, 1024])
    se = np.array([0.05, 0.1, 0.05, 0.2, 0.05])
    covered = 0
    trials = 1000
    for _ in range(trials):
        variance = 3.0 * n**-1.5 * np.exp(se * rng.standard_normal(5))
        _, (low, high) = fit_rate(n, variance, se, np.zeros(5))
        covered += low <= -1.5 <= high
    # at least 95 % (widening for lack of fit only adds); binomial 5 σ below
    assert covered / trials > 0.95 - 5 * np.sqrt(0.05 * 0.95 / trials)


def test_lists_add_dims():
    estimators = [mcs.Estimator("linear", dims=1), mcs.Estimator("step", dims=1)]
    d = mcs.convergence(
        estimators, ["random", "jittered", "jittered | shift"], [4, 16], realizations=50
    )
    assert d["variance"].dims == ("estimator", "sampler", "n")
    assert d["rate_ci"].dims == ("estimator", "sampler", "bound")
    assert d["sampler"].values.tolist() == ["random", "jittered", "jittered | shift"]
    one = mcs.convergence(estimators[1], "jittered", [4, 16], realizations=50)
    assert np.array_equal(one["variance"], d["variance"][1, 1])


def test_bias_of_unbiased_and_biased_sets():
    f = mcs.Estimator("polynomial(coefficients=[0, 0, 1])", dims=1)
    d = mcs.convergence(f, "jittered", [4, 16], realizations=2000, rng=1)
    assert (np.abs(d["bias"]) < 4 * d["mean_se"]).all()
    one = mcs.convergence(f, "regular", [4, 16], realizations=4)
    # midpoint rule on x²: error −1/(12 n²)
    assert np.allclose(one["bias"], [-1 / (12 * 16), -1 / (12 * 256)])
    assert np.allclose(one["mse"], one["bias"] ** 2)


def test_no_variance_has_no_rate():
    d = mcs.convergence(
        mcs.Estimator("constant(value=0.1)", dims=2), "jittered", [4, 16], realizations=20
    )
    assert np.isnan(float(d["rate"]))
    assert np.isnan(d["rate_ci"]).all()
    single = mcs.convergence(mcs.Estimator("linear", dims=2), "jittered", [16], realizations=20)
    assert np.isnan(float(single["rate"]))


def test_results_do_not_depend_on_workers():
    f = mcs.Estimator("gaussian", dims=2)
    one = mcs.convergence(f, "jittered", [256, 4096], realizations=1000, workers=1)
    two = mcs.convergence(f, "jittered", [256, 4096], realizations=1000, workers=2)
    assert one.identical(two)


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"counts": [16, 20]}, CountError, "16 and 25"),
        ({"counts": [64, 16]}, ParameterError, "ascending"),
        ({"counts": []}, ParameterError, "ascending"),
        ({"counts": [0, 4]}, ParameterError, "at least 1"),
        ({"realizations": 1}, ParameterError, "from 2 to"),
        ({"fit_last": 3}, ParameterError, "fit_last"),
        ({"sampler": []}, ParameterError, "at least one"),
        ({"sampler": "jitterd"}, ParameterError, "Did you mean 'jittered'"),
    ],
)
def test_bad_input(changes, error, words):
    arguments = {"sampler": "jittered", "counts": [4, 16], "realizations": 4, **changes}
    with pytest.raises(error, match=words):
        mcs.convergence(mcs.Estimator("gaussian", dims=2), **arguments)
