"""Power, exponential, cosine and tent: closed forms, SciPy's cdfs, extremes, what they refuse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import beta, truncexpon

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.densities import CosineWeighted, Exponential, PiecewiseConstant, Power, Tent

U = np.linspace(0, np.nextafter(1.0, 0.0), 1001)[:, None]
ALL = [
    "power(exponent=-0.5)",
    "power(exponent=0.3)",
    "power(exponent=7)",
    "exponential",
    "exponential(rate=-20)",
    "exponential(rate=1e-9)",
    "cosine-weighted",
    "tent",
    "tent(peak=0.2)",
    "tent(peak=1)",
    "tent(peak=0)",
]


@pytest.mark.parametrize("spec", ALL)
def test_the_inverse_is_the_integral_of_the_pdf(spec):
    p = mcs.density(spec, dims=1)
    for x in (0.1, 0.2, 0.5, 0.77, 1.0):
        mass, error = quad(
            lambda t: float(p.pdf([t])), 0, x, points=[0.2, 0.5], epsabs=1e-13, epsrel=1e-13
        )
        # The last float below 1 is what invert may give at most
        assert p.invert([x])[0] == pytest.approx(mass, abs=2 * error + 1e-13)


@pytest.mark.parametrize("spec", [s for s in ALL if s != "power(exponent=-0.5)"])
def test_a_fine_table_has_nearly_the_same_cdf(spec):
    """Cells that hold the masses of the density agree at borders and, within, to |p'| h²/8."""
    p = mcs.density(spec, dims=1)
    cells = 2048
    edges = np.arange(cells + 1)[:, None] / cells
    cdf = p.invert(edges)
    table = PiecewiseConstant(values=np.maximum(np.diff(cdf[:, 0]), 0))
    np.testing.assert_allclose(table.invert(edges), cdf, atol=1e-12)
    middle = edges[1:-1] + 0.5 / cells
    slope = cells * np.abs(np.diff(p.pdf(np.concatenate([edges, [[1.0]]])))).max()
    assert np.abs(table.invert(middle) - p.invert(middle)).max() <= slope / (8 * cells**2) + 1e-12


@pytest.mark.parametrize("exponent", [-0.9, -0.5, 0.5, 3.0, 1000.0])
def test_powers_are_scipys_beta(exponent):
    p = Power(dims=1, exponent=exponent)
    reference = beta(exponent + 1, 1)
    inner = U[1:-1]
    np.testing.assert_allclose(p.pdf(inner), reference.pdf(inner[:, 0]), rtol=1e-11, atol=1e-300)
    np.testing.assert_allclose(p.sample(inner)[:, 0], reference.ppf(inner[:, 0]), rtol=1e-11)


@pytest.mark.parametrize("rate", [0.1, 1.0, 50.0, 700.0])
def test_exponentials_are_scipys(rate):
    p = Exponential(dims=1, rate=rate)
    reference = truncexpon(rate, scale=1 / rate)
    np.testing.assert_allclose(p.pdf(U), reference.pdf(U[:, 0]), rtol=1e-11)
    np.testing.assert_allclose(p.invert(U[:-1])[:, 0], reference.cdf(U[:-1, 0]), rtol=1e-11)


@pytest.mark.parametrize("rate", [1e-17, 0.5, 700.0])
def test_a_negative_rate_is_the_reflection(rate):
    falling, rising = Exponential(dims=1, rate=rate), Exponential(dims=1, rate=-rate)
    x = np.linspace(0, 1, 65)[:, None]  # reflections of these are exact
    np.testing.assert_allclose(rising.pdf(x), falling.pdf(1 - x), rtol=1e-12)
    np.testing.assert_allclose(rising.sample(x[:-1]), 1 - falling.sample(1 - x[:-1]), atol=1e-12)


def test_tiny_rates_approach_the_uniform_density():
    """x = u − r u (1 − u)/2 + O(r²)."""
    for rate in (0.0, 5e-324, 1e-17, 1e-9, -1e-9):
        x = Exponential(dims=1, rate=rate).sample(U)
        np.testing.assert_allclose(x, U - rate * U * (1 - U) / 2, rtol=1e-15, atol=1e-17)


def test_small_shares_keep_their_digits():
    u = np.logspace(-290, -17, 50)[:, None]
    for spec in ("tent(peak=0.3)", "power(exponent=0.5)", "exponential(rate=-3)"):
        p = mcs.density(spec, dims=1)
        np.testing.assert_allclose(p.invert(p.sample(u)), u, rtol=1e-13)


def test_exponent_next_to_minus_one():
    """x = u^100; all but (1e-308)^(1/100) = 8e-4 of the shares come back."""
    p = Power(dims=1, exponent=-0.99)
    u = U[1:]
    np.testing.assert_allclose(p.sample(u), u**100, rtol=1e-12)
    np.testing.assert_allclose(p.invert(p.sample(u)), u, rtol=1e-13)
    assert p.sample([1e-4])[0] == 0
    assert p.pdf([0.0]) == math.inf
    # ∫1/p = 1/(1 − a²)
    assert p.reciprocal_integral() == pytest.approx(1 / (1 - 0.99**2), rel=1e-13)
    by_quadrature, error = quad(lambda x: 1 / float(p.pdf([x])), 0, 1)
    assert p.reciprocal_integral() == pytest.approx(by_quadrature, abs=2 * error)


def test_reciprocal_integrals():
    for spec in ("power(exponent=1)", "power(exponent=2.5)", "tent", "cosine-weighted"):
        assert mcs.density(spec, dims=2).reciprocal_integral() == math.inf
    both = Exponential(dims=2, rate=[2, -6]).reciprocal_integral()
    assert both == pytest.approx(math.sinh(1) ** 2 * (math.sinh(3) / 3) ** 2, rel=1e-14)
    assert Exponential(dims=3, rate=700).reciprocal_integral() == math.inf
    assert Exponential(dims=3, rate=0).reciprocal_integral() == 1
    assert Power(dims=2, exponent=[0.5, 0]).reciprocal_integral() == pytest.approx(4 / 3)


def test_cosine_weighted_is_the_polar_angle_of_the_hemisphere():
    """Directions by Malley's method: a uniform point on the disk, lifted; θ = arcsin √u."""
    p = CosineWeighted(dims=1)
    theta = 0.5 * np.pi * p.sample(U)[:, 0]
    np.testing.assert_allclose(np.sin(theta) ** 2, U[:, 0], atol=1e-15)
    x = U[1:-1]
    np.testing.assert_allclose(p.pdf(x), np.pi / 2 * np.sin(np.pi * x[:, 0]), rtol=1e-12)
    # The angle in flatland: the sine is uniform on [−1, 1]
    np.testing.assert_allclose(
        np.sin(np.pi * (p.sample(U)[:, 0] - 0.5)), 2 * U[:, 0] - 1, atol=2e-15
    )


@pytest.mark.parametrize("peak", [0.0, 5e-324, 0.3, 1.0])
def test_tents_have_the_height_two(peak):
    p = Tent(dims=1, peak=peak)
    assert p.pdf([peak]) == 2
    assert p.sample([peak])[0] == pytest.approx(min(peak, 1 - 2**-53), rel=1e-15)
    far = 0.0 if peak > 0.5 else 1.0
    assert p.pdf([far]) == 0


@pytest.mark.parametrize(
    ("spec", "dims", "says"),
    [
        ("power(exponent=-1)", 1, "exponent is -1"),
        ("power(exponent=-0.991)", 1, "at least -0.99"),
        ("power(exponent=1001)", 1, "at most 1000"),
        ("power(exponent=[1, 2])", 1, "exponent has 2 values"),
        ("power(exponent=None)", 1, "exponent is None"),
        ("power(exponent=1e999)", 1, "exponent is inf"),
        ("exponential(rate=701)", 1, "rate is 701"),
        ("exponential(rate=-701)", 1, "rate is -701"),
        ("exponential(rate='1')", 2, "rate"),
        ("exponential", 10**9, "dims is 1000000000"),
        ("tent(peak=-0.1)", 1, "peak is -0.1"),
        ("tent(peak=1.1)", 1, "peak is 1.1"),
        ("tent(peak=[])", 2, "peak has 0 values"),
        ("tent(top=1)", 1, "no parameter 'top'"),
        ("cosine-weighted", 0, "dims is 0"),
        ("cosine-weighted(power=2)", 1, "no parameter"),
        ("cosine", 1, "Did you mean 'cosine-weighted'"),
    ],
)
def test_bad_parameters(spec, dims, says):
    with pytest.raises(ParameterError, match=says) as caught:
        mcs.density(spec, dims=dims)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("cls", [Power, Exponential, Tent])
def test_nan_parameters(cls):
    name = {Power: "exponent", Exponential: "rate", Tent: "peak"}[cls]
    with pytest.raises(ParameterError, match=f"{name} is nan"):
        cls(**{name: math.nan})
    with pytest.raises(ParameterError, match=rf"{name}\[1\] is nan"):
        cls(**{name: [0.5, math.nan]})
