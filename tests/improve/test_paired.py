"""Paired comparisons: intervals cover, and common random numbers make them narrower."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.streams import Stream
from mcspectra.improve.answers import simultaneous_z
from mcspectra.improve.assess import Errors, compare, estimates_of

COUNTS = (16, 64, 256)
X = mcs.Estimator("linear", dims=1)


def _errors(estimator, sampler, seed, realizations=400, truth=None):
    stream = Stream.from_rng(seed)
    source = mcs.sampler(sampler, dims=estimator.dims)
    values = [
        estimates_of(estimator, source, n, realizations, stream.child(k))
        for k, n in enumerate(COUNTS)
    ]
    integral = np.atleast_1d(estimator.integral) if truth is None else truth
    return Errors.of(COUNTS, values, integral, biased=truth is not None)


def test_intervals_cover_the_ratio_and_the_difference_of_rates():
    """x² with random points has 4/(45n), x with jittered points 1/(12n³): rates differ by −2."""
    square = mcs.Estimator("polynomial(coefficients=[0, 0, 1])", dims=1)
    found = [
        compare(_errors(X, "jittered", s), _errors(square, "random", s), COUNTS[-1])
        for s in range(60)
    ]
    exact = math.log((1 / 12) / (4 / 45)) - 2 * math.log(COUNTS[-1])
    ratio = [(c.log_ratio - exact) / c.log_ratio_se for c in found]
    rate = [(c.rate_difference + 2) / c.rate_difference_se for c in found]
    for scores in (ratio, rate):
        inside = np.mean(np.abs(scores) < 1.96)
        # The share of 60 intervals has σ = 0.028; lack of fit can only widen intervals
        assert inside > 0.95 - 3.5 * 0.028


def test_common_random_numbers_narrow_the_ratio_of_similar_estimators():
    bent = mcs.Estimator("polynomial(coefficients=[0, 1, 0.05])", dims=1)
    paired = compare(_errors(bent, "random", 1), _errors(X, "random", 1), COUNTS[-1])
    apart = compare(_errors(bent, "random", 1), _errors(X, "random", 2), COUNTS[-1])
    exact = math.log((1 / 12 + 0.05 / 6 + 0.05**2 * 4 / 45) / (1 / 12))
    assert abs(paired.log_ratio - exact) < 4 * paired.log_ratio_se
    assert abs(apart.log_ratio - exact) < 4 * apart.log_ratio_se
    assert paired.log_ratio_se < 0.1 * apart.log_ratio_se


def test_proportional_estimates_have_an_exact_ratio():
    """With the same numbers u, random estimates are exactly proportional to jittered estimates."""
    found = compare(_errors(X, "jittered", 1), _errors(X, "random", 1), COUNTS[-1])
    assert found.log_ratio == pytest.approx(-2 * math.log(COUNTS[-1]), abs=1e-10)
    assert found.log_ratio_se < 1e-10


def test_the_error_includes_the_bias():
    truth = np.array([0.5 + 0.1])
    biased = _errors(X, "random", 3, truth=truth)
    plain = _errors(X, "random", 3)
    np.testing.assert_allclose(
        biased.error, plain.error * 399 / 400 + biased.bias[:, 0] ** 2, rtol=1e-12
    )
    assert biased.error[-1] == pytest.approx(0.01, rel=0.1)


def test_errors_between_counts_are_interpolated():
    errors = _errors(X, "random", 5, realizations=2000)
    log_error, influence = errors.at(400)
    assert log_error == pytest.approx(math.log(1 / 12 / 400), abs=4 * influence.std() / 2000**0.5)
    assert errors.at(256)[0] == math.log(errors.error[-1])


def test_the_rate_equals_that_of_convergence():
    errors = _errors(X, "jittered", 5)
    assert errors.rate()[0] == pytest.approx(errors.fit().rate, rel=1e-12)


def test_constant_estimates_have_no_rate_and_the_smallest_error():
    flat = mcs.Estimator("constant(value=2)", dims=1)
    errors = _errors(flat, "random", 1)
    assert not errors.used.any()
    assert math.isnan(errors.rate()[0])
    assert compare(errors, _errors(X, "random", 1), 256).log_ratio == -math.inf


def test_equal_estimates_that_miss_the_integral_have_an_unknown_error():
    rare = mcs.Estimator(
        mcs.Integrand.from_function(
            lambda x: 1.0 * (np.abs(x[..., 0] - 0.37) < 5e-8), dims=1, integral=1e-7
        )
    )
    errors = _errors(rare, "random", 1)
    assert errors.blind.all()
    assert math.isnan(errors.at(256)[0])
    found = compare(errors, _errors(X, "random", 1), 256)
    assert math.isnan(found.log_ratio)
    assert not _errors(mcs.Estimator("constant(value=2)", dims=1), "random", 1).blind.any()


def test_simultaneous_quantiles_are_those_of_sidak():
    assert simultaneous_z(1) == pytest.approx(1.959964, abs=1e-6)
    # Šidák: both tails together have the probability 1 − 0.95^(1/10) = 0.0051162
    assert simultaneous_z(10) == pytest.approx(2.7996, abs=1e-3)


def test_the_error_is_the_sum_over_channels():
    f = mcs.Estimator(
        mcs.Integrand.from_function(lambda x: np.concatenate([x, 2 * x], axis=-1), dims=1)
    )
    both, one = _errors(f, "random", 7), _errors(X, "random", 7)
    np.testing.assert_allclose(both.error, 5 * one.error, rtol=1e-9)
