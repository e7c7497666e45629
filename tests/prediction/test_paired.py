"""Orthogonal arrays, moved strata and scrambles in many dims: exact variances and measurements."""

import math

import pytest

import mcspectra as mcs
from mcspectra.prediction.paired import is_array

PRODUCT = "formula(expression='(1+x0)*exp(x1)*(x2<0.37)*(1+abs(x3-0.4))')"
ROTATED = "formula(expression='exp(-6*(x0+x1-x2-0.3)**2-3*(x1-x3+0.2)**2-2*(x0-0.4)**2)')"
BALL = "formula(expression='where((x0-0.5)**2+(x1-0.5)**2+(x2-0.5)**2+(x3-0.5)**2<0.2,1,0)')"


def predicted(f, sampler, n, method="auto"):
    """Return value, half its interval, and the name of the method."""
    found = mcs.predict(mcs.integrand(f, dims=4), sampler, [n], method=method)
    low, high = found["predicted_variance_ci"].values[0]
    return float(found["predicted_variance"][0]), 0.5 * (high - low), str(found["method"].values[0])


def measured(f, sampler, n, realizations=4000):
    """Return the variance of estimates and its standard error, with their kurtosis."""
    points = mcs.sampler(sampler, dims=4).draw(n, realizations=realizations, rng=3)
    means = mcs.integrand(f, dims=4)(points).mean(axis=1)
    away = (means - means.mean()) ** 2
    return means.var(ddof=1), away.std(ddof=1) / math.sqrt(realizations)


@pytest.mark.parametrize(
    ("sampler", "n"),
    [
        ("orthogonal-array(jitter='jittered')", 49),
        ("orthogonal-array(jitter='jittered') | shift", 25),
        ("orthogonal-array | strata-shift", 49),
        ("orthogonal-array | shift", 25),
        ("latin-hypercube | shift", 64),
        ("latin-hypercube | strata-shift", 64),
        ("jittered", 256),
        ("jittered | shift", 256),
        ("jittered | strata-shift", 81),
    ],
)
def test_products_have_their_exact_variance(sampler, n):
    """Earlier versions extrapolated orthogonal arrays under a shift, to within a quarter."""
    exact = mcs.exact_variance(mcs.integrand(PRODUCT, dims=4), sampler, n, tolerance=1e-3)
    value, half, _ = predicted(PRODUCT, sampler, n, "subsets")
    assert abs(value - exact) <= 2.0 * half  # Four standard errors
    assert half < 0.05 * value


@pytest.mark.parametrize(
    ("sampler", "n"),
    [
        ("orthogonal-array | shift", 121),
        ("latin-hypercube | strata-shift", 100),
        ("jittered | strata-shift", 81),
    ],
)
def test_jumps_across_all_axes_are_those_measured(sampler, n):
    """Sums of products miss them; earlier versions extrapolated moving strata to ±20 to 60 %."""
    value, half, method = predicted(BALL, sampler, n)
    truth, error = measured(BALL, sampler, n)
    assert method == "subsets"
    assert abs(value - truth) <= math.hypot(2.0 * half, 4.0 * error)
    assert half < 0.06 * value


@pytest.mark.parametrize(
    ("sampler", "n"),
    [
        ("niederreiter | owen", 512),
        ("halton | digital-shift", 256),
        ("faure | digital-shift", 625),
    ],
)
def test_smooth_functions_that_are_no_products(sampler, n):
    """Earlier versions extrapolated niederreiter | owen to ±50 %, digits in other bases to ±20
    %."""
    value, half, method = predicted(ROTATED, sampler, n)
    truth, error = measured(ROTATED, sampler, n)
    assert method == "moves"
    assert abs(value - truth) <= math.hypot(2.0 * half, 4.0 * error)
    assert half < 0.1 * value


def test_scrambles_of_one_law_of_pairs_have_one_prediction():
    """Earlier versions extrapolated linear scrambles: 0.45 of the variance of nested ones."""
    nested, linear = (predicted(BALL, f"sobol | {step}", 256) for step in ("owen", "lms"))
    assert linear[0] == pytest.approx(nested[0], rel=1e-12)
    assert linear[1] == pytest.approx(nested[1], rel=1e-12)


def test_scrambles_agree_with_exact_variances():
    """Test products in bases 2 and 5."""
    for sampler, n in (("sobol | owen", 64), ("faure | owen", 125)):
        exact = mcs.exact_variance(mcs.integrand(PRODUCT, dims=4), sampler, n, tolerance=1e-3)
        value, half, _ = predicted(PRODUCT, sampler, n, "moves")
        assert abs(value - exact) <= 2.0 * half


def test_which_laws_are_arrays():
    def law(sampler, n, dims=4):
        return mcs.sampler(sampler, dims=dims).law(n)

    assert is_array(law("orthogonal-array | shift", 49))
    assert is_array(law("orthogonal-array", 49))
    assert not is_array(law("latin-hypercube | shift", 49))
    assert not is_array(law("jittered | shift", 16))


def test_energies_need_no_symmetry_of_g():
    """A function of two of four axes has energy only in their pairs of strata."""
    f = "formula(expression='cos(2*pi*(x0+x1))+0*x2*x3')"
    for sampler in ("orthogonal-array(jitter='jittered') | shift", "orthogonal-array | shift"):
        value, half, _ = predicted(f, sampler, 49, "subsets")
        truth, error = measured(f, sampler, 49)
        assert abs(value - truth) <= math.hypot(2.0 * half, 4.0 * error)
