"""Orthogonal arrays, moved strata and scrambles in many dims: exact variances and measurements."""

import functools
import math

import pytest

import mcspectra as mcs
from mcspectra.prediction import paired
from mcspectra.prediction.paired import is_array

PRODUCT = "formula(expression='(1+x0)*exp(x1)*(x2<0.37)*(1+abs(x3-0.4))')"
ROTATED = "formula(expression='exp(-6*(x0+x1-x2-0.3)**2-3*(x1-x3+0.2)**2-2*(x0-0.4)**2)')"
BALL = "formula(expression='where((x0-0.5)**2+(x1-0.5)**2+(x2-0.5)**2+(x3-0.5)**2<0.2,1,0)')"


@pytest.fixture(autouse=True)
def few_pairs(request, monkeypatch):
    """Use an eighth of the pairs in quick tests; predictions then state wider intervals."""
    if not request.node.get_closest_marker("slow"):
        few = paired.PairedSettings(pairs=(1 << 13, 1 << 10, 1 << 10))
        monkeypatch.setattr(paired, "_SETTINGS", few)


@functools.cache
def integrand(f):
    """Return the integrand in 4-D, made once because its integral takes a second."""
    return mcs.integrand(f, dims=4)


def predictions(f, samplers, n, method="auto"):
    """Return value, half its interval, and method of each sampler, from one call of predict."""
    found = mcs.predict(integrand(f), samplers, [n], method=method).isel(n=0)
    values, methods = found["predicted_variance"].values, found["method"].values
    halves = 0.5 * found["predicted_variance_ci"].diff("bound").values[:, 0]
    return [(float(v), float(h), str(m)) for v, h, m in zip(values, halves, methods, strict=True)]


def predicted(f, sampler, n, method="auto"):
    """Return the same for one sampler."""
    return predictions(f, [sampler], n, method)[0]


def measured(f, sampler, n, realizations=4000):
    """Return the variance of estimates and its standard error, with their kurtosis."""
    points = mcs.sampler(sampler, dims=4).draw(n, realizations=realizations, rng=3)
    means = integrand(f)(points).mean(axis=1)
    away = (means - means.mean()) ** 2
    return means.var(ddof=1), away.std(ddof=1) / math.sqrt(realizations)


@pytest.mark.parametrize(
    ("n", "samplers"),
    [
        (
            25,
            [
                "orthogonal-array(jitter='jittered')",
                "orthogonal-array(jitter='jittered') | shift",
                "orthogonal-array | strata-shift",
                "orthogonal-array | shift",
                "latin-hypercube | shift",
                "latin-hypercube | strata-shift",
            ],
        ),
        (81, ["jittered", "jittered | shift", "jittered | strata-shift"]),
    ],
    ids=str,
)
def test_products_have_their_exact_variance(n, samplers):
    """Earlier versions extrapolated orthogonal arrays under a shift, to within a quarter."""
    found = predictions(PRODUCT, samplers, n, "subsets")
    for sampler, (value, half, _) in zip(samplers, found, strict=True):
        exact = mcs.exact_variance(integrand(PRODUCT), sampler, n, tolerance=1e-3)
        assert abs(value - exact) <= 2.0 * half, sampler  # Four standard errors
        assert half < 0.05 * value, sampler


@pytest.mark.parametrize(
    ("f", "n", "samplers", "answered", "bound"),
    [
        # Sums of products miss jumps across all axes; extrapolated moving strata have ±20 to 60 %
        (BALL, 49, ["orthogonal-array | shift"], "subsets", 0.08),
        pytest.param(
            BALL, 49, ["orthogonal-array | shift"], "subsets", 0.06, marks=pytest.mark.slow
        ),
        pytest.param(
            BALL, 49, ["latin-hypercube | strata-shift"], "subsets", 0.06, marks=pytest.mark.slow
        ),
        (BALL, 81, ["jittered | strata-shift"], "subsets", 0.06),
        pytest.param(
            BALL, 121, ["orthogonal-array | shift"], "subsets", 0.06, marks=pytest.mark.slow
        ),
        # A smooth function that is no product; extrapolated nets have ±20 to 50 %
        (ROTATED, 256, ["niederreiter | owen"], "moves", 0.1),
        pytest.param(
            ROTATED, 256, ["halton | digital-shift"], "moves", 0.1, marks=pytest.mark.slow
        ),
        pytest.param(ROTATED, 625, ["faure | digital-shift"], "moves", 0.1, marks=pytest.mark.slow),
        pytest.param(ROTATED, 512, ["niederreiter | owen"], "moves", 0.1, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_predictions_without_products_agree_with_measurements(f, n, samplers, answered, bound):
    for sampler, found in zip(samplers, predictions(f, samplers, n), strict=True):
        value, half, method = found
        truth, error = measured(f, sampler, n)
        assert method == answered, sampler
        assert abs(value - truth) <= math.hypot(2.0 * half, 4.0 * error), sampler
        assert half < bound * value, sampler


def test_scrambles_of_one_law_of_pairs_have_one_prediction():
    """Earlier versions extrapolated linear scrambles: 0.45 of the variance of nested ones."""
    nested, linear = predictions(BALL, ["sobol | owen", "sobol | lms"], 64)
    assert linear[0] == pytest.approx(nested[0], rel=1e-12)
    assert linear[1] == pytest.approx(nested[1], rel=1e-12)


def test_scrambles_agree_with_exact_variances():
    """Test products in bases 2 and 5."""
    for sampler, n in (("sobol | owen", 64), ("faure | owen", 125)):
        exact = mcs.exact_variance(integrand(PRODUCT), sampler, n, tolerance=1e-3)
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
    samplers = ["orthogonal-array(jitter='jittered') | shift", "orthogonal-array | shift"]
    found = predictions(f, samplers, 49, "subsets")
    for sampler, (value, half, _) in zip(samplers, found, strict=True):
        truth, error = measured(f, sampler, 49)
        assert abs(value - truth) <= math.hypot(2.0 * half, 4.0 * error)
