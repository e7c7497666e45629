"""Exact variances of functions that no node resolves are refused, or within their errors."""

import functools

import numpy as np
import pytest
from tests.prediction.adversarial import make
from tests.prediction.unlimited import predict

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.estimators.quadrature import square_integral
from mcspectra.prediction.exact import estimated_variance, of_integrand


@functools.cache
def _made(family, dims, seed):
    """Return a case and its integrand, which keeps what quadrature finds, for all samplers."""
    case = make(family, dims, seed)
    return case, case.integrand()


def _worst(family, dims, sampler, n, sides):
    """Return the largest ratio of true to claimed error over tolerances; 0 if refused."""
    case, f = _made(family, dims, 0)
    g, found = mcs.Estimator(f).primary_integrand(0), [0.0]
    for tolerance in (1e-6, 1e-2, 1e-1):
        try:
            source = mcs.sampler(sampler, dims=case.dims)
            value, error = (float(v[0]) for v in of_integrand(source.law(n), g, tolerance))
        except mcs.NoClosedForm:
            continue
        assert error <= tolerance * value
        found.append(abs(value - case.variance(sides)) / (error + 1e-14 * case.square / n))
    return max(found)


@pytest.mark.parametrize(
    ("family", "dims"),
    [
        *(("slab", 1), ("bell", 1), ("box", 1), ("slab", 4), ("hidden-step", 2)),
        *(("ridge", 2), ("oblique-step", 3), ("product", 3)),
    ],
)
def test_random_points(family, dims):
    """Without comparison with integrals these were 0, or had errors of 2e-5 instead of 1e-6."""
    assert _worst(family, dims, "random", 1, ()) <= 1.0


@pytest.mark.parametrize(
    ("family", "dims"), [("slab", 1), ("box", 1), ("slab", 2), ("ridge", 2), ("oblique-step", 3)]
)
def test_jittered_points(family, dims):
    side = {1: 16, 2: 4, 3: 2}[dims]
    assert _worst(family, dims, "jittered", side**dims, (side,) * dims) <= 1.0


@pytest.mark.parametrize("sampler", ["regular | shift", "jittered | shift", "sobol | owen"])
def test_other_samplers_see_a_slab(sampler):
    """Of 16 points, one is in the slab with probability 16 · 6e-5."""
    f = mcs.Integrand.from_function(lambda x: (np.abs(x[..., 0] - 0.30003) < 3e-5) * 1.0, dims=1)
    found = mcs.exact_variance(f, mcs.sampler(sampler, dims=1), 16)
    assert found == pytest.approx(6e-5 / 16 - 6e-5**2, rel=1e-6)


def test_a_tolerance_gives_variances_of_oblique_jumps():
    case = make("oblique-step", 2, 0)
    f, expected = case.integrand(), case.variance((2, 2))
    with pytest.raises(mcs.NoClosedForm, match="tolerance"):
        mcs.exact_variance(f, "jittered", 4)
    assert mcs.exact_variance(f, "jittered", 4, tolerance=0.1) == pytest.approx(expected, rel=0.1)
    found = mcs.Estimator(f), "jittered"
    value, error = estimated_variance(*found, 4, 0.1)
    assert abs(value[0] - expected) <= error[0]


def test_a_narrow_ridge_is_no_pole():
    case = make("ridge", 2, 10)
    assert case.volume == pytest.approx(4.367e-5, rel=1e-3)
    value, error = square_integral(case.integrand())
    assert abs(value[0] - case.square) <= error[0]


def test_jumps_that_are_not_declared_have_variances_to_a_tolerance():
    f = mcs.integrand("formula(expression='(x0+0.7*x1>0.83)*1.0')", dims=2)
    same = mcs.integrand("half-space(normal=(1, 0.7), offset=0.83)", dims=2)
    for sampler, n, tolerance in (
        ("random", 16, 1e-3),
        ("jittered", 64, 0.1),
        ("jittered", 1024, 0.1),
        ("latin-hypercube", 64, 1e-2),
        ("sobol | owen", 64, 0.1),
    ):
        with pytest.raises(mcs.NoClosedForm, match=r"or tolerance="):
            mcs.exact_variance(f, sampler, n)
        value, error = estimated_variance(f, sampler, n, tolerance)
        assert error[0] <= tolerance * value[0]
        assert abs(value[0] - mcs.exact_variance(same, sampler, n)) <= error[0]


@pytest.mark.parametrize("n", [64, 101])
def test_latin_hypercubes_by_slabs_hold_their_error(n):
    """With few evaluations: cells of 1/4 and slabs of 1/64 instead of 64² cells, or slabs alone."""
    g = mcs.Estimator("disk(center=(0.45, 0.52), radius=0.27)").primary_integrand(0)
    sampler = mcs.sampler("latin-hypercube", dims=2)
    expected, _ = of_integrand(sampler.law(n), g, 1e-6)
    value, error = of_integrand(sampler.law(n), g, 0.1, 500.0)
    assert 0.0 < abs(value - expected) <= error


def test_smooth_functions_are_given_as_before():
    f = mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=1)
    for n in (1, 16, 1024):
        edges = np.arange(n + 1) / n
        means, squares = (np.diff(edges**k) * n / k for k in (3, 5))
        expected = np.mean(squares - means**2) / n
        assert mcs.exact_variance(f, "jittered", n) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("tolerance", [0.0, 2.0, "much"])
def test_tolerances_out_of_range(tolerance):
    with pytest.raises(ParameterError, match="tolerance"):
        mcs.exact_variance("linear", "jittered", 4, tolerance=tolerance)


@functools.cache
def _slab(axis, center, width):
    """x0, plus a slab across an axis with at least half of ∫g²."""
    height = width**-0.5
    return mcs.Integrand.from_function(
        lambda x: x[..., 0] + height * (np.abs(x[..., axis] - center) < width / 2), dims=2
    )


@pytest.mark.parametrize(
    ("axis", "center", "width"),
    [(0, 0.301, 1.47e-4), pytest.param(1, 0.497, 4.28e-4, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("sampler", ["random", "latin-hypercube", "sobol | owen"])
def test_predictions_see_a_thin_slab(axis, center, width, sampler):
    """Random points got a tenth of their variance, with an interval of 1e-12; nets 14 % more."""
    height, n = width**-0.5, 64
    if sampler == "random":
        mean = 0.5 + height * width
        across = width * (center if axis == 0 else 0.5)
        expected = (1 / 3 + 2 * height * across + 1 - mean**2) / n
    else:  # The rest of each axis within its strata; the slab lies in one or two of them
        edges = np.clip(np.arange(n + 1) / n, center - width / 2, center + width / 2)
        low, high = edges[:-1], edges[1:]
        part = (high - low) * n
        apart = (1 / (12 * n**2) + height**2 * np.mean(part - part**2)) / n
        middle = (np.arange(n) + 0.5) / n
        both = np.sum((high - low) * (0.5 * (low + high) - middle)) if axis == 0 else 0.0
        expected = apart + 2 * height * both / n
    found = predict(_slab(axis, center, width), sampler, [n])
    assert float(found["predicted_variance"][0]) == pytest.approx(expected, rel=1e-6)
    assert float(np.diff(found["predicted_variance_ci"][0])[0]) < 1e-3 * expected


@pytest.mark.parametrize(
    ("sampler", "seed"),
    [
        ("random", 0),
        ("jittered", 0),
        pytest.param("latin-hypercube", 0, marks=pytest.mark.slow),
        ("sobol | owen", 0),
        pytest.param("jittered", 1, marks=pytest.mark.slow),
        pytest.param("latin-hypercube", 1, marks=pytest.mark.slow),
    ],
)
def test_no_method_is_sure_of_a_ridge_that_points_hardly_hit(sampler, seed):
    """Scrambled points resolve a ridge much narrower than their cells no better than random
    ones."""
    case, f = _made("ridge", 2, seed)
    assert case.volume < 1e-4
    expected = case.variance((4, 4)) if sampler == "jittered" else case.variance(()) / 16
    low, high = predict(f, sampler, [16])["predicted_variance_ci"].values[0]
    assert low <= expected <= high


@pytest.mark.parametrize(
    ("f", "dims", "square"),
    [
        (lambda x: x[..., 1] ** -0.5, 2, np.inf),
        (lambda x: np.abs(x[..., 0] - 0.37) ** -0.6, 2, np.inf),
        (lambda x: 1 / (x[..., 0] - 0.5), 1, np.inf),
        (lambda x: x[..., 0] ** -0.49, 1, 50.0),
        pytest.param(lambda x: x[..., 0] ** -0.45, 1, 10.0, marks=pytest.mark.slow),
    ],
)
def test_poles_are_infinite_from_one_half_on(f, dims, square):
    integrand = mcs.Integrand.from_function(f, dims=dims)
    found = predict(integrand, "random", [16])
    value = mcs.exact_variance(integrand, "random", 16, tolerance=1e-2)
    assert value == found["predicted_variance"][0]
    if np.isinf(square):
        assert value == np.inf
        assert "diverges" in found.attrs["note"]
    else:
        mean = 2 / (1 + 1 / square)  # 1/(1 − a), where 1/(1 − 2a) is the square
        assert value == pytest.approx((square - mean**2) / 16, rel=1e-2)


def test_weights_that_grow_far_beyond_all_samples_are_finite():
    f, p = mcs.integrand("gaussian(width=0.3)", dims=1), "truncated-normal(mean=0.2, sigma=0.1)"
    estimator = mcs.Estimator(f, p)
    x = (np.arange(10**6)[:, None] + 0.5) / 10**6
    expected = np.mean(f(x) ** 2 / estimator.density.pdf(x)) / 16
    assert mcs.exact_variance(estimator, "random", 16, tolerance=1e-2) == pytest.approx(expected)


def test_a_pole_slows_the_limit_of_strata():
    """n^-2 n^2a from the first stratum, n^-4 Σ (j/n)^-(2 + 2a) from the others: −2 + 2a."""
    f = mcs.Integrand.from_function(lambda x: x[..., 0] ** -0.45, dims=1)
    found = predict(f, "jittered", [16, 64, 256])
    assert float(found["limit_rate"]) == pytest.approx(-1.1, abs=0.01)


@pytest.mark.parametrize(
    "sampler",
    [
        "random",
        "jittered",
        *(pytest.param(s, marks=pytest.mark.slow) for s in ("latin-hypercube", "sobol | owen")),
    ],
)
def test_what_was_the_same_everywhere_is_not_called_constant(sampler):
    f = mcs.Integrand.from_function(lambda x: 1.0 * (np.abs(x - 0.3) < 5e-4).all(axis=-1), dims=3)
    with pytest.raises(mcs.NoClosedForm, match="the same at all 131072 points"):
        mcs.exact_variance(f, sampler, 8)
    found = predict(f, sampler, [8])
    assert np.isnan(found["predicted_variance"]).all()
    assert "the same at all 131072 points" in found.attrs["note"]
    declared = mcs.Integrand.from_function(lambda x: 1.0 + 0.0 * x[..., 0], dims=3, integral=1.0)
    assert mcs.exact_variance(declared, sampler, 8) == 0.0


def test_errors_of_a_function_are_named_as_its_own():
    calls = []

    def broken(x):
        calls.append(x)
        return x[..., 0] if len(calls) == 1 else 1 / 0

    f = mcs.Integrand.from_function(broken, dims=1)
    with pytest.raises(ParameterError, match="broken.*failed.*ZeroDivisionError"):
        predict(f, "random", [16])


@pytest.mark.parametrize(
    "exponent", [*(pytest.param(e, marks=pytest.mark.slow) for e in (0.1, 0.2, 0.3)), 0.4]
)
def test_square_integrals_of_poles_that_cross_lie_within_their_errors(exponent):
    """Levels of (xy)^-2a shrink as k r^k: the claimed error was 5.9e-5, the true one 7.9e-5."""
    f = mcs.integrand(f"formula(expression='(x0*x1)**-{exponent}')", dims=2)
    value, error = square_integral(f)
    assert abs(value[0] - (1.0 - 2.0 * exponent) ** -2.0) <= error[0] < 0.05 * value[0]
