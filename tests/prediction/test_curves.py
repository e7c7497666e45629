"""Users' functions that are sums or products of functions of one axis, with few evaluations."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.prediction.prediction import LIMITS

A = 0.4  # exponent of the poles: ∫(t^-A)² is finite, and most of it comes from tiny t


def power(u):
    return u**-A


def stratum_means(n):
    """Means of u^-A over n strata of the unit interval."""
    ends = (np.arange(n + 1) / n) ** (1.0 - A)
    return n * np.diff(ends) / (1.0 - A)


def sums(x):
    return power(x[..., 0]) + power(x[..., 1])


def products(x):
    return power(x[..., 0]) * power(x[..., 1])


def bumpy(x):
    """A sum, except in a small square."""
    inside = (np.abs(x - 0.3) < 0.02).all(axis=-1)
    return x[..., 0] + x[..., 1] ** 2 + inside


def exact(f, sampler, n):
    """Variances that follow from the means over strata and ∫f² = 1/(1 − 2A)."""
    mean, square = 1.0 / (1.0 - A), 1.0 / (1.0 - 2.0 * A)
    within = square - np.mean(stratum_means(n if sampler == "latin-hypercube" else 8) ** 2)
    if f is sums:
        return 2.0 * (square - mean**2 if sampler == "random" else within) / n
    if sampler == "random":
        return (square**2 - mean**4) / n
    if sampler == "jittered":
        return (square**2 - (square - within) ** 2) / n
    apart = (n * mean**2 - (square - within)) / (n - 1)
    return square**2 / n + (1 - 1 / n) * apart**2 - mean**4


@pytest.mark.parametrize("sampler", ["random", "jittered", "latin-hypercube"])
@pytest.mark.parametrize("f", [sums, products])
def test_unbounded_functions_of_users_have_exact_variances(f, sampler):
    """Earlier versions extrapolated measurements: 0.3 to 0.7 of the variance."""
    found = mcs.predict(f, sampler, [64], dims=2)
    assert str(found["method"].values[0]) == "exact"
    true = exact(f, sampler, 64)
    low, high = found["predicted_variance_ci"].values[0]
    assert low <= true <= high < 1.001 * low
    assert float(found["predicted_variance"][0]) == pytest.approx(true, rel=1e-8)


def test_variances_that_diverge_are_infinite():
    found = mcs.predict(lambda x: x[..., 0] ** -0.6 + x[..., 1], "sobol | owen", [64], dims=2)
    assert math.isinf(found["predicted_variance"][0])
    assert "diverges" in found.attrs["note"]


@pytest.mark.parametrize("f", [sums, products, bumpy])
@pytest.mark.parametrize("most", [2**14, 2**16, None])
def test_the_limit_of_evaluations_holds(f, most):
    made = 0

    def counted(x):
        nonlocal made
        made += x.size // 2
        return f(x)

    mcs.predict(counted, ["random", "sobol | owen"], [16, 64], dims=2, max_evaluations=most)
    assert 0 < made <= (most or LIMITS.evaluations)


def test_a_function_that_is_a_sum_nearly_everywhere_is_measured():
    """The square has the area 0.0016; 2^17 points miss it with probability e^-210."""
    found = mcs.predict(bumpy, "sobol | owen", [64], dims=2)
    assert str(found["method"].values[0]) == "extrapolated"


def test_extrapolation_on_request_measures_sums():
    found = mcs.predict(lambda x: x.sum(axis=-1), "random", [64], dims=2, method="extrapolated")
    assert str(found["method"].values[0]) == "extrapolated"


def test_a_function_may_fail_closer_to_0_than_samplers_draw():
    """The search for poles evaluates the function at 1e-12 to 1e-19."""

    def fails(x):
        if (x < 1e-12).any():
            raise ValueError("too small")
        return x.sum(axis=-1)

    found = mcs.predict(fails, "random", [64], dims=2)
    assert float(found["predicted_variance"][0]) == pytest.approx(1 / (6 * 64), rel=1e-8)


def test_a_density_that_cancels_the_pole_is_used():
    """f/p of f = x^-A with the density p ∝ x^-A is constant, so nothing varies."""
    estimator = mcs.Estimator(
        mcs.Integrand.from_function(lambda x: power(x[..., 0]) + 0.0, dims=1),
        "power(exponent=-0.4)",
    )
    found = mcs.predict(estimator, "random", [64])
    assert not found["predicted_variance"].notnull().any()
