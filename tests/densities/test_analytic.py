"""Closed forms: SciPy's distributions, quadrature, extremes and small digits."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import beta, truncexpon, truncnorm

import mcspectra as mcs
from mcspectra.densities import (
    CosineWeighted,
    Exponential,
    Linear,
    Power,
    Tent,
    TruncatedNormal,
    Uniform,
)

U = np.linspace(0, np.nextafter(1.0, 0.0), 1001)[:, None]


@pytest.mark.parametrize(
    "spec",
    [
        "linear(slope=0.3)",
        "truncated-normal(mean=0.3, sigma=0.4)",
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
    ],
)
def test_the_inverse_is_the_integral_of_the_pdf(spec):
    p = mcs.density(spec, dims=1)
    for x in (0.1, 0.2, 0.5, 0.77, 1.0):
        mass, error = quad(
            lambda t: float(p.pdf([t])), 0, x, points=[0.2, 0.5], epsabs=1e-13, epsrel=1e-13
        )
        # The last float below 1 is the largest result of invert
        assert p.invert([x])[0] == pytest.approx(mass, abs=2 * error + 1e-13)


def test_the_density_half_plus_x():
    p = mcs.density("linear(slope=1)", dims=1)
    np.testing.assert_allclose(p.pdf(U), 0.5 + U[:, 0], rtol=1e-15)
    assert p.reciprocal_integral() == pytest.approx(math.log(3), rel=1e-15)


def test_slopes_of_two_are_squares_and_roots():
    np.testing.assert_allclose(Linear(dims=1, slope=2).sample(U), np.sqrt(U), rtol=1e-15)
    falling = Linear(dims=1, slope=-2).sample(U)
    # 1 − √(1−u) without cancellation
    np.testing.assert_allclose(falling, U / (1 + np.sqrt(1 - U)), rtol=1e-15)


@pytest.mark.parametrize("slope", [1e-3, 1e-9, 1e-15, 1e-300, -1e-9])
def test_small_slopes_approach_the_identity(slope):
    """x = u + s u (1 − u)/2 + O(s²)."""
    x = Linear(dims=1, slope=slope).sample(U)
    np.testing.assert_allclose(x, U + slope * U * (1 - U) / 2, atol=slope**2 + 4e-16)


@pytest.mark.parametrize(("mean", "sigma"), [(0.5, 0.2), (0.1, 0.05), (1.3, 0.3), (-0.4, 0.5)])
def test_truncated_normal_agrees_with_scipy(mean, sigma):
    p = TruncatedNormal(dims=1, mean=mean, sigma=sigma)
    reference = truncnorm((0 - mean) / sigma, (1 - mean) / sigma, mean, sigma)
    np.testing.assert_allclose(p.pdf(U), reference.pdf(U[:, 0]), rtol=1e-12)
    within = U[:-1]  # at the last float below 1, x is accurate to 2^-53/p only
    np.testing.assert_allclose(p.sample(within)[:, 0], reference.ppf(within[:, 0]), atol=1e-12)
    np.testing.assert_allclose(p.invert(U)[:, 0], reference.cdf(U[:, 0]), atol=1e-13)


@pytest.mark.parametrize("mean", [3.0, 20.0, -3.0, -19.0])
def test_far_tails_are_nearly_exponential(mean):
    """At z sigma, the density decays like exp(−z t/σ) (1 + O(1/z²)) from the near end."""
    p = TruncatedNormal(dims=1, mean=mean, sigma=0.2)
    x = p.sample(U[1:-1])[:, 0]
    from_end = 1 - x if mean > 0 else x
    share = U[1:-1, 0] if mean > 0 else 1 - U[1:-1, 0]
    z = (mean - 1 if mean > 0 else -mean) / 0.2
    expected = -np.log(share) * 0.2 / z
    np.testing.assert_allclose(from_end, expected, rtol=8 / z**2 * 2, atol=1e-12)


@pytest.mark.parametrize("exponent", [-0.9, -0.5, 0.5, 3.0, 1000.0])
def test_powers_agree_with_scipys_beta(exponent):
    p = Power(dims=1, exponent=exponent)
    reference = beta(exponent + 1, 1)
    inner = U[1:-1]
    np.testing.assert_allclose(p.pdf(inner), reference.pdf(inner[:, 0]), rtol=1e-11, atol=1e-300)
    np.testing.assert_allclose(p.sample(inner)[:, 0], reference.ppf(inner[:, 0]), rtol=1e-11)


@pytest.mark.parametrize("rate", [0.1, 1.0, 50.0, 700.0])
def test_exponentials_agree_with_scipy(rate):
    p = Exponential(dims=1, rate=rate)
    reference = truncexpon(rate, scale=1 / rate)
    np.testing.assert_allclose(p.pdf(U), reference.pdf(U[:, 0]), rtol=1e-11)
    np.testing.assert_allclose(p.invert(U[:-1])[:, 0], reference.cdf(U[:-1, 0]), rtol=1e-11)


@pytest.mark.parametrize("rate", [1e-17, 0.5, 700.0])
def test_a_negative_rate_is_the_reflection(rate):
    falling, rising = Exponential(dims=1, rate=rate), Exponential(dims=1, rate=-rate)
    x = np.linspace(0, 1, 65)[:, None]  # points whose reflections are exact
    np.testing.assert_allclose(rising.pdf(x), falling.pdf(1 - x), rtol=1e-12)
    np.testing.assert_allclose(rising.sample(x[:-1]), 1 - falling.sample(1 - x[:-1]), atol=1e-12)


def test_tiny_rates_approach_the_uniform_density():
    """x = u − r u (1 − u)/2 + O(r²)."""
    for rate in (0.0, 5e-324, 1e-17, 1e-9, -1e-9):
        x = Exponential(dims=1, rate=rate).sample(U)
        np.testing.assert_allclose(x, U - rate * U * (1 - U) / 2, rtol=1e-15, atol=1e-17)


def test_small_shares_keep_their_digits():
    u = np.logspace(-290, -17, 50)[:, None]
    lines = [f"linear(slope={slope})" for slope in (-2, -1, 0, 1e-9, 1, 2)]
    for spec in (*lines, "tent(peak=0.3)", "power(exponent=0.5)", "exponential(rate=-3)"):
        p = mcs.density(spec, dims=1)
        np.testing.assert_allclose(p.invert(p.sample(u)), u, rtol=1e-13)


def test_exponent_next_to_minus_one():
    """x = u^100; all shares but (1e-308)^(1/100) = 8e-4 of them are recovered."""
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


def test_cosine_weighted_agrees_with_the_polar_angle_of_the_hemisphere():
    """Malley's method: directions are uniform points on the disk, lifted; θ = arcsin √u."""
    p = CosineWeighted(dims=1)
    theta = 0.5 * np.pi * p.sample(U)[:, 0]
    np.testing.assert_allclose(np.sin(theta) ** 2, U[:, 0], atol=1e-15)
    x = U[1:-1]
    np.testing.assert_allclose(p.pdf(x), np.pi / 2 * np.sin(np.pi * x[:, 0]), rtol=1e-12)
    # In flatland, the sine of the angle is uniform on [−1, 1]
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


def test_reciprocal_integrals():
    for spec in ("power(exponent=1)", "power(exponent=2.5)", "tent", "cosine-weighted"):
        assert mcs.density(spec, dims=2).reciprocal_integral() == math.inf
    finite = [
        (Linear(dims=2, slope=[1, -1.5]), math.log(3) * math.log(7) / 1.5),
        (Linear(dims=3, slope=0), 1),
        (Uniform(dims=7), 1),
        (Exponential(dims=2, rate=[2, -6]), math.sinh(1) ** 2 * (math.sinh(3) / 3) ** 2),
        (Exponential(dims=3, rate=0), 1),
        (Power(dims=2, exponent=[0.5, 0]), 4 / 3),
    ]
    for density, expected in finite:
        assert density.reciprocal_integral() == pytest.approx(expected, rel=1e-14)
    assert Linear(dims=2, slope=[1, -2]).reciprocal_integral() == math.inf
    assert Exponential(dims=3, rate=700).reciprocal_integral() == math.inf


@pytest.mark.parametrize(("mean", "sigma"), [(0.5, 0.2), (0.2, 0.3), (1.5, 0.4), (-1.0, 0.5)])
def test_reciprocal_integral_of_truncated_normals(mean, sigma):
    p = TruncatedNormal(dims=1, mean=mean, sigma=sigma)
    by_quadrature, error = quad(lambda x: 1 / p.pdf([x]), 0, 1, epsabs=0, epsrel=1e-12)
    assert p.reciprocal_integral() == pytest.approx(by_quadrature, abs=2 * error)


def test_components_print_compare_and_hash():
    p = Linear(dims=2, slope=np.array([1.0, -1.0]))
    assert p.spec == "linear(slope=[1.0, -1.0])"
    assert p == Linear(dims=2, slope=(1.0, -1.0))
    assert hash(p) == hash(Linear(dims=2, slope=[1.0, -1.0]))
    assert mcs.density("linear(slope=1)", dims=1).spec == "linear(slope=1)"
