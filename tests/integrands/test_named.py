"""Genz's integrands by name, and functions from other fields with known integrals."""

import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm
from tests import oracles

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.integrands import integral_accuracy
from mcspectra.testing import check_integrand

ANY_DIMS = [
    *("genz-oscillatory", "genz-product-peak", "genz-corner-peak", "genz-gaussian"),
    *("genz-continuous", "genz-discontinuous"),
]
SPECS = [
    ("genz-oscillatory(a=[1, 2, 3.5], u=0.1)", 3),
    ("genz-continuous(u=[0, 0.7, 1])", 3),
    ("genz-discontinuous(a=[1, 2, 3], u=[0.2, 0.7, 0.1])", 3),
]
SIGMAS = 6.0  # Student's t with 63 degrees: probability 1e-7 per number


@pytest.mark.parametrize(
    ("spec", "dims"), [*SPECS, *((name, dims) for name in ANY_DIMS for dims in (1, 7))]
)
def test_contract(spec, dims):
    """Values are also finite at the corners, and the spec makes the integrand again."""
    f = mcs.integrand(spec, dims)
    check_integrand(f)
    assert np.isfinite(f(np.array([np.zeros(dims), np.ones(dims)]))).all()
    assert mcs.integrand(f.spec, dims) == f


def test_a_gaussian_of_genz_is_the_gaussian():
    """Compare with the closed form, and compare values."""
    f = mcs.integrand("genz-gaussian(a=[2, 30], u=[0.3, 1])")
    parts = [
        mcs.integrand(f"gaussian(center={u}, width={math.sqrt(0.5) / a!r})", dims=1)
        for a, u in ((2, 0.3), (30, 1))
    ]
    assert f.integral == pytest.approx(parts[0].integral * parts[1].integral, rel=1e-14)
    x = np.random.default_rng(1).random((50, 2))
    assert np.allclose(f(x), parts[0](x[:, :1]) * parts[1](x[:, 1:]), rtol=1e-13)


@pytest.mark.parametrize(("a", "dims"), [(5.0, 1), (0.01, 3), (5.0, 12), (100.0, 20)])
def test_corner_peak_is_the_sum_over_corners(a, dims):
    """(1/d!) Π 1/a_i Σ_v (−1)^|v| / (1 + a·v), in fractions because it cancels; equal a: by |v|."""
    corners = sum(
        Fraction((-1) ** k * math.comb(dims, k)) / (1 + Fraction(a) * k) for k in range(dims + 1)
    )
    expected = float(corners / Fraction(a) ** dims / math.factorial(dims))
    found = mcs.integrand(f"genz-corner-peak(a={a})", dims).integral
    assert found == pytest.approx(expected, rel=1e-13)


def test_kinks_and_jumps_are_where_they_are_declared():
    f = mcs.integrand("genz-discontinuous", 3)
    assert f.breaks == ((0.3,), (0.3,), ())


ORACLES = {
    **{
        f"{make.__name__} {dims}-D": make(dims)
        for make in (
            *(oracles.keister, oracles.gaussian_peaks, oracles.gaussian_ridge),
            *(oracles.ratio_tracking, oracles.asian_option, oracles.digital_option),
        )
        for dims in (1, 2, 3, 16)
        if dims < 16 or "gaussian" not in make.__name__  # 2^16 points miss its peaks
    },
    "ratio_tracking of a loose majorant": oracles.ratio_tracking(6, majorant=2.0),
    "ishigami": oracles.ishigami()[0],
    "sobol_g": oracles.sobol_g([0.0, 1.0, 4.5, 9.0, 99.0])[0],
}


@pytest.mark.parametrize("name", ORACLES)
def test_randomized_points_find_the_known_integrals(name):
    f = ORACLES[name]
    means = f(mcs.sampler("sobol | owen", f.dims).draw(1024, realizations=64, rng=5)).mean(axis=1)
    assert abs(means.mean() - f.integral) < SIGMAS * means.std(ddof=1) / 8


@pytest.mark.parametrize("name", [name for name in ORACLES if ORACLES[name].dims <= 3])
def test_quadrature_finds_the_known_integrals(name):
    """Errors are estimates, accurate to a factor of three."""
    f = ORACLES[name]
    unknown = mcs.Integrand.from_function(lambda x: f(x), dims=f.dims)
    assert abs(unknown.integral - f.integral) < 3.0 * integral_accuracy(unknown)[1]


def _above_a_limit(u):
    """Return whether a cantilever with random load, modulus, length and width bends by 2.6 mm."""
    z = oracles.normal(u)
    load, modulus = 500.0 * np.exp(0.2 * z[..., 0]), 2.1e11 * np.exp(0.05 * z[..., 1])
    length, width = 1.0 + 0.1 * u[..., 2], 0.048 + 0.004 * u[..., 3]
    return (1e3 * load * length**3 / (3.0 * modulus * width**4 / 12.0) > 2.6) * 1.0


def _posterior_weights(s):
    """Likelihood · prior / proposal of a linear model; the normal proposal is s times as wide."""
    rng, t = np.random.default_rng(1), np.linspace(-1.0, 1.0, 12)
    design = np.stack([np.ones_like(t), t], axis=1)
    data = design @ [0.4, -0.8] + 0.3 * rng.standard_normal(12)
    covariance = np.linalg.inv(design.T @ design / 0.3**2 + np.eye(2))
    center, root = covariance @ design.T @ data / 0.3**2, np.linalg.cholesky(covariance)
    evidence = multivariate_normal.logpdf(
        data, np.zeros(12), design @ design.T + 0.3**2 * np.eye(12)
    )

    def weights(u):
        z = oracles.normal(u)
        theta = center + s * z @ root.T
        joint = norm.logpdf(data, theta @ design.T, 0.3).sum(axis=-1)
        joint += norm.logpdf(theta).sum(axis=-1)
        proposal = norm.logpdf(z).sum(axis=-1) - 2.0 * np.log(s) - np.log(np.diag(root)).sum()
        return np.exp(joint - proposal - evidence)

    return mcs.Estimator(mcs.Integrand.from_function(weights, dims=2, integral=1.0))


@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (lambda: oracles.digital_option(16), "interior-jump"),
        (lambda: mcs.Integrand.from_function(_above_a_limit, dims=4), "interior-jump"),
        (lambda: oracles.gaussian_ridge(3), "heavy-tail"),
        (
            lambda: mcs.Estimator(
                oracles.gaussian_peaks(3, width=0.08), "truncated-normal(mean=0.39, sigma=0.1)"
            ),
            "heavy-tail",
        ),
        (lambda: _posterior_weights(0.5), "infinite-variance"),
        (lambda: _posterior_weights(0.8), "border-growth"),
        (lambda: _posterior_weights(1.5), "none"),
    ],
)
def test_profiles_of_other_fields_name_the_cause(make, cause):
    assert mcs.profile(make(), budget=8192).causes[0].name == cause


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("genz-gaussian(a=0)", "greater than 0"),
        ("genz-continuous(u=[0.5, 2])", r"u\[1\]"),
        ("genz-product-peak(dims=400)", "overflows in 400 dims; lower a"),
        ("genz-discontinuous(a=[500, 600, 1], u=1, dims=3)", "overflows"),
    ],
)
def test_refused(spec, words):
    with pytest.raises(ParameterError, match=words):
        mcs.integrand(spec)
