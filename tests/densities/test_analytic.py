"""Closed forms of lines and normals, and what they refuse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import truncnorm

import mcspectra as mcs
from mcspectra.core.errors import DomainError, McspectraError, ParameterError
from mcspectra.densities import Linear, PiecewiseConstant, TruncatedNormal, Uniform

U = np.linspace(0, np.nextafter(1.0, 0.0), 1001)[:, None]


def test_half_plus_x():
    p = mcs.density("linear(slope=1)", dims=1)
    np.testing.assert_allclose(p.pdf(U), 0.5 + U[:, 0], rtol=1e-15)
    assert p.reciprocal_integral() == pytest.approx(math.log(3), rel=1e-15)


def test_slopes_of_two_are_squares_and_roots():
    np.testing.assert_allclose(Linear(dims=1, slope=2).sample(U), np.sqrt(U), rtol=1e-15)
    falling = Linear(dims=1, slope=-2).sample(U)
    # 1 − √(1−u), written without cancellation
    np.testing.assert_allclose(falling, U / (1 + np.sqrt(1 - U)), rtol=1e-15)


@pytest.mark.parametrize("slope", [1e-3, 1e-9, 1e-15, 1e-300, -1e-9])
def test_small_slopes_approach_the_identity(slope):
    """x = u + s u (1 − u)/2 + O(s²)."""
    x = Linear(dims=1, slope=slope).sample(U)
    np.testing.assert_allclose(x, U + slope * U * (1 - U) / 2, atol=slope**2 + 4e-16)


def test_reciprocal_integrals_of_products():
    both = Linear(dims=2, slope=[1, -1.5]).reciprocal_integral()
    assert both == pytest.approx(math.log(3) * math.log(7) / 1.5, rel=1e-14)
    assert Linear(dims=2, slope=[1, -2]).reciprocal_integral() == math.inf
    assert Linear(dims=3, slope=0).reciprocal_integral() == 1
    assert Uniform(dims=7).reciprocal_integral() == 1


@pytest.mark.parametrize(("mean", "sigma"), [(0.5, 0.2), (0.1, 0.05), (1.3, 0.3), (-0.4, 0.5)])
def test_truncated_normal_is_scipys(mean, sigma):
    p = TruncatedNormal(dims=1, mean=mean, sigma=sigma)
    reference = truncnorm((0 - mean) / sigma, (1 - mean) / sigma, mean, sigma)
    np.testing.assert_allclose(p.pdf(U), reference.pdf(U[:, 0]), rtol=1e-12)
    within = U[:-1]  # at the last float below 1, x is known to 2^-53/p only
    np.testing.assert_allclose(p.sample(within)[:, 0], reference.ppf(within[:, 0]), atol=1e-12)
    np.testing.assert_allclose(p.invert(U)[:, 0], reference.cdf(U[:, 0]), atol=1e-13)


@pytest.mark.parametrize("mean", [3.0, 20.0, -3.0, -19.0])
def test_far_tails_are_nearly_exponential(mean):
    """At distance z sigma the density decays like exp(−z t/σ) (1 + O(1/z²)) from the near end."""
    p = TruncatedNormal(dims=1, mean=mean, sigma=0.2)
    x = p.sample(U[1:-1])[:, 0]
    from_end = 1 - x if mean > 0 else x
    share = U[1:-1, 0] if mean > 0 else 1 - U[1:-1, 0]
    z = (mean - 1 if mean > 0 else -mean) / 0.2
    expected = -np.log(share) * 0.2 / z
    np.testing.assert_allclose(from_end, expected, rtol=8 / z**2 * 2, atol=1e-12)


@pytest.mark.parametrize(("mean", "sigma"), [(0.5, 0.2), (0.2, 0.3), (1.5, 0.4), (-1.0, 0.5)])
def test_reciprocal_integral_of_truncated_normals(mean, sigma):
    p = TruncatedNormal(dims=1, mean=mean, sigma=sigma)
    by_quadrature, error = quad(lambda x: 1 / p.pdf([x]), 0, 1, epsabs=0, epsrel=1e-12)
    assert p.reciprocal_integral() == pytest.approx(by_quadrature, abs=2 * error)


@pytest.mark.parametrize("slope", [1.0, -2.0, 0.3])
def test_a_line_and_its_table_have_nearly_the_same_cdf(slope):
    """A cell of width h holds the line's own mean, so cdfs agree at borders and differ within a
    cell by at most |p'| h²/8."""
    cells = 4096
    line = Linear(dims=1, slope=slope)
    centers = (np.arange(cells) + 0.5) / cells
    steps = PiecewiseConstant(values=line.pdf(centers[:, None]))
    x = np.linspace(0, 1, 50_001)[:-1, None]
    bound = abs(slope) / (8 * cells**2)
    assert np.abs(line.invert(x) - steps.invert(x)).max() <= bound + 1e-13
    half = np.full((1, 1), 1000.5 / cells)  # the worst place: the bound is attained
    gap = np.abs(line.invert(half) - steps.invert(half))[0, 0]
    assert gap == pytest.approx(bound, rel=1e-4)


@pytest.mark.parametrize(
    ("spec", "dims", "says"),
    [
        ("linear(slope=2.0001)", 1, "slope is 2.0001"),
        ("linear(slope=[1, 2, 3])", 2, "slope has 3 values"),
        ("linear(slope=[])", 2, "slope has 0 values"),
        ("linear(slope='1')", 2, "slope"),
        ("linear(slope=None)", 2, "slope"),
        ("linear(slope=True)", 2, "slope"),
        ("linear(slope=[[1]])", 1, "slope"),
        ("linear(slop=1)", 1, "no parameter 'slop'"),
        ("linear", 0, "dims is 0"),
        ("uniform", -1, "dims is -1"),
        ("uniform", 10**9, "dims is 1000000000"),
        ("uniform(dims=2)", 3, "dims"),
        ("truncated-normal(sigma=0)", 1, "sigma is 0"),
        ("truncated-normal(sigma=-1)", 1, "sigma is -1"),
        ("truncated-normal(sigma=101)", 1, "sigma is 101"),
        ("truncated-normal(sigma=1e999)", 1, "sigma is inf"),
        ("truncated-normal(mean=1e999)", 1, "mean is inf"),
        ("truncated-normal(mean=30, sigma=0.2)", 1, "100 sigma"),
        ("truncated-normal(mean=-21, sigma=0.2)", 1, "100 sigma"),
        ("uniformm", 1, "Did you mean 'uniform'"),
        ("uniform | uniform", 1, "chains"),
        ("", 1, "name"),
    ],
)
def test_bad_parameters(spec, dims, says):
    with pytest.raises(ParameterError, match=says) as caught:
        mcs.density(spec, dims=dims)
    assert "\n" not in str(caught.value)


def test_nan_parameters():
    with pytest.raises(ParameterError, match="slope is nan"):
        Linear(slope=math.nan)
    with pytest.raises(ParameterError, match=r"mean\[1\] is nan"):
        TruncatedNormal(mean=[0, math.nan])


@pytest.mark.parametrize("method", ["pdf", "sample", "invert"])
@pytest.mark.parametrize(
    ("points", "says"),
    [
        ([[0.5, math.nan]], "NaN"),
        ([[0.5, math.inf]], "infinity"),
        ([0.5], "shape"),
        (0.5, "shape"),
        ([[0.1, 0.2, 0.3]], "shape"),
        ("abc", "not an array"),
        ([[0.1], [0.2, 0.3]], "not an array"),
        (None, "not an array"),
    ],
)
def test_bad_points(method, points, says):
    p = mcs.density("linear", dims=2)
    with pytest.raises(DomainError, match=says):
        getattr(p, method)(points)


def test_components_print_compare_and_hash():
    p = Linear(dims=2, slope=np.array([1.0, -1.0]))
    assert p.spec == "linear(slope=[1.0, -1.0])"
    assert p == Linear(dims=2, slope=(1.0, -1.0))
    assert hash(p) == hash(Linear(dims=2, slope=[1.0, -1.0]))
    assert mcs.density("linear(slope=1)", dims=1).spec == "linear(slope=1)"


def test_all_errors_are_the_packages():
    assert issubclass(ParameterError, McspectraError)
