"""Error of an estimator's integral: 0 if exact, else the sum of the errors of its parts."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.integrands import integral_accuracy

CORNER = mcs.integrand("formula(expression='where(x + y < 0.7, 1, 0)')", dims=2)


def test_exact_integrals_have_no_error():
    for spec in ("linear", "disk"):
        assert mcs.Estimator(spec).integral_error == 0.0
    assert mcs.Mirrored("disk", "uniform").integral_error == 0.0


def test_it_is_that_of_the_integrand_inside():
    error = integral_accuracy(CORNER)[1]
    assert error > 0.0
    assert mcs.Estimator(CORNER).integral_error == error
    assert mcs.Mirrored(CORNER, "uniform").integral_error == error
    assert abs(CORNER.integral - 0.245) < 10 * error


def test_bias_is_as_uncertain_as_mean_and_integral():
    exact, numeric = (
        mcs.convergence(mcs.Estimator(f), "jittered", [4, 16], realizations=50, rng=2)
        for f in ("disk", CORNER)
    )
    assert np.array_equal(exact["bias_se"], exact["mean_se"])
    expected = np.hypot(numeric["mean_se"], integral_accuracy(CORNER)[1])
    assert np.allclose(numeric["bias_se"], expected, rtol=1e-14)
    assert numeric["bias_se"].attrs["units"] == "f"


def test_sums_and_channels():
    parts = mcs.estimators.TechniqueSum([CORNER, CORNER])
    assert parts.integral_error == pytest.approx(2 * integral_accuracy(CORNER)[1])
