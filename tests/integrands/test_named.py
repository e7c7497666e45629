"""Integrands of other fields by name: each contract, and values by other means."""

import math

import mpmath
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.integrands import brownian_factor, integral_accuracy
from mcspectra.testing import check_integrand

CONSTRUCTIONS = ("incremental", "bridge", "pca")
ANY_DIMS = [
    *("genz-oscillatory", "genz-product-peak", "genz-corner-peak", "genz-gaussian"),
    *("genz-continuous", "genz-discontinuous", "keister", "gaussian-peaks", "gaussian-ridge"),
    *("ratio-tracking", "asian-option", "digital-option", "barrier-option", "sobol-g"),
]
SPECS = [
    ("genz-oscillatory(a=[1, 2, 3.5], u=0.1)", 3),
    ("genz-continuous(u=[0, 0.7, 1])", 3),
    ("genz-discontinuous(a=[1, 2, 3], u=[0.2, 0.7, 0.1])", 3),
    ("gaussian-peaks(centers=[0.1, 0.9], width=0.2)", 4),
    ("gaussian-ridge(start=0, stop=1)", 3),
    ("ratio-tracking(contrast=0, cycles=0)", 3),
    ("ratio-tracking(majorant=2, cycles=2.3)", 6),
    ("asian-option(construction='bridge', maturity=2)", 5),
    ("asian-option(average='arithmetic', strike=90)", 4),
    ("digital-option(construction='pca', rate=-0.01)", 3),
    ("barrier-option(construction='bridge', barrier=99, volatility=0.4)", 6),
    ("sobol-g(a=[0, 1, 4.5, 9, 99])", 5),
]
SIGMAS = 6.0  # Student's t with 63 degrees: 1e-7 a number


@pytest.mark.parametrize(
    ("spec", "dims"), [*SPECS, *((name, dims) for name in ANY_DIMS for dims in (1, 7))]
)
def test_contract(spec, dims):
    """Also finite at the corners, and made again by its spec."""
    f = mcs.integrand(spec, dims)
    check_integrand(f)
    assert np.isfinite(f(np.array([np.zeros(dims), np.ones(dims)]))).all()
    assert mcs.integrand(f.spec, dims) == f


def test_a_gaussian_of_genz_is_the_gaussian():
    """In closed form, and values."""
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
    """(1/d!) Π 1/a_i Σ_v (−1)^|v| / (1 + a·v), in 200 digits as it cancels; equal a: by |v|."""
    with mpmath.workdps(200):
        corners = (
            (-1) ** k * mpmath.binomial(dims, k) / (1 + mpmath.mpf(a) * k) for k in range(dims + 1)
        )
        expected = float(mpmath.fsum(corners) / mpmath.mpf(a) ** dims / mpmath.factorial(dims))
    found = mcs.integrand(f"genz-corner-peak(a={a})", dims).integral
    assert found == pytest.approx(expected, rel=1e-13)


def test_kinks_and_jumps_are_where_they_are_declared():
    f = mcs.integrand("genz-discontinuous", 3)
    assert f.breaks == ((0.3,), (0.3,), ())
    g = mcs.integrand("digital-option(construction='bridge', strike=110)", 8)
    (place,), *others = g.breaks
    assert not any(others)
    x = np.random.default_rng(2).random((20, 8))
    sides = [np.where(np.arange(8) == 0, place + step, x) for step in (-1e-9, 1e-9)]
    assert not g(sides[0]).any()
    assert (g(sides[1]) > 0.9).all()
    h = mcs.integrand("ratio-tracking", 3)
    at = h.breaks[0][0]
    below, above = ([at + step, 0.5, 0.5] for step in (-1e-9, 1e-9))
    assert h(above) == 1.0
    assert h(below) < 0.1
    assert mcs.integrand("barrier-option(construction='bridge')", 4).breaks[0] == (
        *mcs.integrand("barrier-option", 1).breaks[0],
    )


@pytest.mark.parametrize("dims", [1, 2, 7, 60])
def test_keister_is_a_radial_integral(dims):
    """2π^{d/2}/Γ(d/2) ∫ r^{d−1} cos r e^{−r²} dr in 30 digits."""
    with mpmath.workdps(30):
        d = mpmath.mpf(dims)
        radial = mpmath.quad(
            lambda r: r ** (d - 1) * mpmath.cos(r) * mpmath.exp(-r * r), range(0, 21, 2)
        )
        expected = float(2 * mpmath.pi ** (d / 2) / mpmath.gamma(d / 2) * radial)
    assert mcs.integrand("keister", dims).integral == pytest.approx(expected, rel=1e-13)


def test_the_ridge_is_a_mean_of_peaks():
    f = mcs.integrand("gaussian-ridge(start=0.1, stop=0.6, width=0.07)", 3)
    for x in np.random.default_rng(3).random((20, 3)) * 0.3 + 0.2:
        mean = quad(lambda t, x=x: norm.pdf(x, t, 0.07).prod(), 0.1, 0.6, epsabs=0)[0] / 0.5
        assert f(x) == pytest.approx(mean, rel=1e-7)
    inside = quad(lambda t: (norm.cdf((1 - t) / 0.07) - norm.cdf(-t / 0.07)) ** 3, 0.1, 0.6)[0]
    assert f.integral == pytest.approx(inside / 0.5, rel=1e-7)
    assert f(np.zeros(3)) > 0.0


@pytest.mark.parametrize("dates", [1, 2, 3, 5, 8, 64])
def test_factors_of_brownian_motion(dates):
    k = np.arange(1, dates + 1)
    for construction in CONSTRUCTIONS:
        a = brownian_factor(dates, construction)
        assert np.allclose(a @ a.T, np.minimum.outer(k, k) / dates, rtol=0, atol=1e-13)
    assert np.allclose(brownian_factor(dates, "bridge")[:, 0], k / dates)
    gram = (p := brownian_factor(dates, "pca")).T @ p
    assert np.allclose(gram, np.diag(np.diag(gram)), rtol=0, atol=1e-11)
    assert (np.diff(np.diag(gram)) < 0).all()


def _second_date(first, mean, deviation, strike):
    """E max(first/2 + first e^X/2 − strike, 0) of normal X."""
    rest = strike - 0.5 * first
    forward = 0.5 * first * math.exp(mean + 0.5 * deviation**2)
    if rest <= 0.0:
        return forward - rest
    d = (math.log(0.5 * first / rest) + mean) / deviation
    return forward * norm.cdf(d + deviation) - rest * norm.cdf(d)


@pytest.mark.parametrize("volatility", [0.05, 0.2, 0.8])
def test_two_dates_by_conditioning_on_the_first(volatility):
    """Adaptive quadratures of closed forms that the recursions do not use."""
    mean, deviation = 0.5 * (0.05 - 0.5 * volatility**2), volatility * math.sqrt(0.5)
    tight = {"epsabs": 1e-12, "epsrel": 1e-12, "limit": 200}

    def asian(z):
        first = 100.0 * math.exp(mean + deviation * z)
        return norm.pdf(z) * _second_date(first, mean, deviation, 100.0)

    def barrier(z):
        first = 100.0 * math.exp(mean + deviation * z)
        d = (math.log(first / 100.0) + mean) / deviation
        forward = first * math.exp(mean + 0.5 * deviation**2)
        return norm.pdf(z) * (forward * norm.cdf(d + deviation) - 100.0 * norm.cdf(d))

    start = (math.log(0.9) - mean) / deviation
    cases = {
        "asian-option(average='arithmetic', ": (asian, -10.0),
        "barrier-option(": (barrier, max(start, -10.0)),
    }
    for spec, (function, low) in cases.items():
        f = mcs.integrand(f"{spec}volatility={volatility})")
        expected, error = quad(function, low, 10.0, points=[0.0], **tight)
        allowed = error + integral_accuracy(f)[1] + 1e-11 * expected
        assert abs(f.integral - math.exp(-0.05) * expected) < allowed
        assert integral_accuracy(f)[1] < 1e-9 * f.integral


@pytest.mark.parametrize("construction", CONSTRUCTIONS)
@pytest.mark.parametrize("spec", ["asian-option(average='arithmetic'", "barrier-option(barrier=95"])
def test_many_dates_by_randomized_points(spec, construction):
    f = mcs.integrand(f"{spec}, construction='{construction}')", 16)
    x = mcs.sampler("sobol | owen", 16).draw(1024, realizations=64, rng=5)
    means = f(x).mean(axis=1)
    if "asian" in spec:
        g = mcs.integrand(f"asian-option(construction='{construction}')", 16)
        means = means - g(x).mean(axis=1) + g.integral
    error = means.std(ddof=1) / 8
    assert abs(means.mean() - f.integral) < SIGMAS * error
    assert error < 0.02


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("genz-gaussian(a=0)", "greater than 0"),
        ("genz-continuous(u=[0.5, 2])", r"u\[1\]"),
        ("genz-product-peak(dims=400)", "overflows in 400 dims; lower a"),
        ("genz-discontinuous(a=[500, 600, 1], u=1, dims=3)", "overflows"),
        ("gaussian-peaks(centers='0.5')", "give a list"),
        ("gaussian-peaks(centers=[])", "give a list"),
        ("gaussian-ridge(start=0.8)", "give start < stop"),
        ("ratio-tracking(majorant=0.9)", "majorant"),
        ("barrier-option(barrier=120)", "give less than that"),
        ("asian-option(construction='pcs')", "Did you mean 'pca'"),
        ("asian-option(average='harmonic')", "geometric, arithmetic"),
        ("sobol-g(a=-1)", "at least 0"),
        ("ishigami(dims=2)", "no parameter 'dims'"),
    ],
)
def test_refused(spec, words):
    with pytest.raises(ParameterError, match=words):
        mcs.integrand(spec)
