"""Warps computed from a pdf alone, against closed forms, and their refusals."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import DensityError, ParameterError
from mcspectra.densities import NumericalDensity, PiecewiseConstant

U = np.linspace(0, np.nextafter(1.0, 0.0), 2001)[:, None]


def X(x):
    return x[..., 0]


def Y(x):
    return x[..., 1]


def of(pdf, dims=1, **more):
    return mcs.Density.from_functions(pdf=pdf, dims=dims, **more)


@pytest.mark.parametrize(
    "spec",
    [
        "uniform",
        "linear(slope=1)",
        "linear(slope=-2)",
        "power(exponent=0.5)",
        "power(exponent=6)",
        "exponential(rate=40)",
        "exponential(rate=-3)",
        "cosine-weighted",
        "tent(peak=0.3)",
        "truncated-normal(mean=0.3, sigma=0.01)",
        "truncated-normal(mean=0.7, sigma=1e-4)",
        "piecewise-linear(values=[1, 0, 0, 4, 3])",
        "mixture(parts=['tent', 'power(exponent=3)'])",
    ],
)
def test_the_warp_agrees_with_the_closed_form(spec):
    exact = mcs.density(spec, dims=1)
    p = of(exact.pdf)
    if exact.has_inverse:
        x = p.sample(U)
        np.testing.assert_allclose(exact.invert(x), U, atol=1e-12)
        np.testing.assert_allclose(p.invert(U), exact.invert(U), atol=1e-12)
    np.testing.assert_allclose(p.invert(p.sample(U)), U, atol=1e-12)
    assert not np.any(p.pdf(p.sample(U[1:])) == 0)


@pytest.mark.parametrize("exponent", [-0.3, -0.5, -0.9])
def test_unbounded_densities(exponent):
    p = of(lambda x: (exponent + 1) * X(x) ** exponent)
    np.testing.assert_allclose(p.sample(U), U ** (1 / (exponent + 1)), atol=1e-12)


@pytest.mark.parametrize("at", [0.5, 1 / 3, 1e-4, 1 - 1e-4])
def test_jumps_anywhere(at):
    """A quarter of the mass lies left of the jump."""
    p = of(lambda x: np.where(X(x) < at, 0.25 / at, 0.75 / (1 - at)))
    u = U[:, 0]
    expected = np.where(u < 0.25, u / 0.25 * at, 1 - (1 - u) / 0.75 * (1 - at))
    np.testing.assert_allclose(p.sample(U)[:, 0], expected, atol=1e-12)
    (found,) = p.breaks[0]
    assert found == pytest.approx(0.25, abs=1e-12)


@pytest.mark.parametrize("peak", [0.5, 0.3])
def test_kinks_are_breaks(peak):
    (found,) = of(mcs.density(f"tent(peak={peak})", dims=1).pdf).breaks[0]
    assert found == pytest.approx(peak, abs=1e-6)


def test_a_table_of_many_jumps():
    table = PiecewiseConstant(values=[3, 1, 0, 0, 2, 7, 1])
    p = of(table.pdf)
    np.testing.assert_allclose(p.sample(U), table.sample(U), atol=1e-12)
    assert (table.pdf(p.zero_points()) == 0).all()
    assert len(p.zero_points())
    np.testing.assert_allclose(p.breaks[0], table.breaks[0], atol=1e-12)


def test_normalization():
    def pdf(x):
        return np.exp(-X(x))

    with pytest.raises(DensityError, match=r"integrates to 0\.632120558829 .* normalize=True"):
        of(pdf)
    p = of(pdf, normalize=True)
    exact = mcs.density("exponential", dims=1)
    np.testing.assert_allclose(p.pdf(U), exact.pdf(U), rtol=1e-13)
    np.testing.assert_allclose(p.sample(U), exact.sample(U), atol=1e-13)
    with pytest.raises(DensityError, match="not to 1"):
        of(lambda x: (2 + 1e-8) * X(x))
    of(lambda x: (2 + 1e-10) * X(x))


@pytest.mark.parametrize(
    "spec",
    [
        "linear(slope=[1, -1.5])",
        "product(parts=['exponential(rate=3)', 'truncated-normal(mean=0.2, sigma=0.05)'])",
        (
            "product(parts=['piecewise-linear(values=[1, 3, 0.5])', "
            "'piecewise-constant(values=[1, 4])'])"
        ),
    ],
)
def test_products_in_two_dims(spec):
    exact = mcs.density(spec, dims=2)
    p = of(exact.pdf, 2)
    u = np.random.default_rng(1).random((2000, 2))
    np.testing.assert_allclose(exact.invert(p.sample(u)), u, atol=1e-11)
    np.testing.assert_allclose(p.invert(u), exact.invert(u), atol=1e-11)


def test_rows_that_differ():
    """p = e^{xy}/c: given y, the cdf of x is (e^{xy} − 1)/(e^y − 1)."""
    p = of(lambda x: np.exp(X(x) * Y(x)), 2, normalize=True)
    u = np.random.default_rng(2).random((2000, 2))
    x = p.sample(u)
    conditional = np.expm1(X(x) * Y(x)) / np.expm1(Y(x))
    np.testing.assert_allclose(conditional, u[:, 0], atol=1e-12)
    np.testing.assert_allclose(p.invert(x), u, atol=1e-12)
    p.check()


@pytest.mark.parametrize(
    ("pdf", "dims", "says"),
    [
        (lambda x: X(x) - 0.1, 1, "negative"),
        (lambda x: X(x) * math.nan, 1, "not finite"),
        (lambda x: X(x) * math.inf, 1, "not finite"),
        (lambda x: 0 * X(x), 1, "is 0 at all"),
        (lambda x: 0 * X(x), 2, "is 0 at all"),
        (lambda x: 2 * x, 1, r"Write x\[\.\.\., 0\]"),
        (lambda x: 2.0, 1, r"gave shape \(\)"),
        (lambda x: x.nothing, 1, "failed on points"),
        (lambda x: X(x) + 0j, 1, "complex128"),
        (lambda x: 0.01 * X(x) ** -0.99, 1, "too steep"),
        (lambda x: np.minimum(0.5 * (1 - X(x) + 1e-99) ** -0.5, 1e9), 1, "too steep"),
        (lambda x: 1 + np.sin(1e8 * X(x)), 1, "too rough"),
        (lambda x: X(x) - 0.1, 2, "negative"),
        (lambda x: 4 / math.pi * (X(x) ** 2 + Y(x) ** 2 < 1), 2, "along x_0, is too rough"),
        (lambda x: 3 * np.abs(X(x) - Y(x)), 2, "along x_0, is too rough"),
        (3, 1, "pdf is 3"),
    ],
)
def test_bad_pdfs(pdf, dims, says):
    with pytest.raises(DensityError, match=says) as caught:
        of(pdf, dims)
    assert "\n" not in str(caught.value)


def test_bad_arguments():
    with pytest.raises(DensityError, match="1-D and 2-D only"):
        of(X, 3)
    with pytest.raises(ParameterError, match="dims is 0"):
        of(X, 0)
    with pytest.raises(DensityError, match="invert was given without sample"):
        of(X, invert=np.square)
    with pytest.raises(DensityError, match="normalize is 2"):
        of(X, normalize=2)
    with pytest.raises(DensityError, match="normalize works without sample"):
        of(lambda x: 2 * X(x), sample=np.sqrt, normalize=True)
    with pytest.raises(ParameterError, match="dims is 3"):
        NumericalDensity(dims=3, pdf_function=X)


def test_input_is_read_only_for_the_pdf():
    def greedy(x):
        x *= 0.5
        return X(x)

    with pytest.raises(DensityError, match="read-only"):
        of(greedy)


@pytest.mark.parametrize("sides", [(0.008, 0.008), (0.1, 0.0025)])
def test_narrow_boxes_keep_their_mass(sides):
    """1 + 1000 in a box: the mass of the box counts, up to rounding."""
    low = np.array([0.5083, 0.2277])

    def pdf(x):
        return 1 + 1000.0 * ((x > low) & (x < low + sides)).all(axis=-1)

    p = of(pdf, 2, normalize=True)
    mass = 1 + 1000 * math.prod(sides)
    assert float(p.pdf([0.1, 0.1])) == pytest.approx(1 / mass, rel=1e-12)
    u = np.random.default_rng(4).random((1000, 2))
    np.testing.assert_allclose(p.invert(p.sample(u)), u, atol=1e-11)
    # x_1 has the cdf of its marginal, a step function
    y = p.sample(u)[:, 1]
    inside = np.clip(y - low[1], 0, sides[1])
    np.testing.assert_allclose((y + 1000 * sides[0] * inside) / mass, u[:, 1], atol=1e-12)


@pytest.mark.parametrize("radius", [0.02, 0.005, 0.002])
def test_narrow_cones_are_refused(radius):
    def pdf(x):
        return 1 + 1000 * np.maximum(0, 1 - np.hypot(X(x) - 0.5123, Y(x) - 0.2317) / radius)

    with pytest.raises(DensityError, match="too rough|not parallel"):
        of(pdf, 2, normalize=True)


@pytest.mark.parametrize("sigma", [1e-3, 1e-5, 1e-6])
def test_narrow_peaks_keep_their_mass(sigma):
    peak = mcs.density(f"truncated-normal(mean=0.37123, sigma={sigma})", dims=1)
    p = of(lambda x: 0.7 + 0.3 * peak.pdf(x), normalize=True)
    assert float(p.pdf([0.1])) == pytest.approx(0.7, rel=1e-10)
    x = p.sample(U)
    expected = 0.7 * x + 0.3 * peak.invert(x)
    np.testing.assert_allclose(expected, U, atol=1e-9)


@pytest.mark.parametrize("at", [0.25 + 1e-6, 0.25 - 1e-6, 1 / 256 + 1e-9, 0.5 - 1e-12])
def test_jumps_next_to_borders_of_cells(at):
    """A jump within a thousandth of a cell from its border, closer than any node."""
    p = of(lambda x: np.where(X(x) < at, 1.0, 9.0), normalize=True)
    mass = at + 9 * (1 - at)
    assert float(p.pdf([0.1 * at])) == pytest.approx(1 / mass, rel=1e-13)
    found = p.breaks[0]
    assert found == pytest.approx((at / mass,), abs=1e-12)


@pytest.mark.parametrize(
    ("pdf", "says"),
    [
        (lambda x: 0.5 / np.sqrt(1 - X(x)), "too steep .* move a pole to 0"),
        (lambda x: X(x) ** -0.3 * (1 - X(x)) ** -0.7, "too rough .* move a pole to 0"),
        (lambda x: np.abs(X(x) - 0.4) ** -0.3, "a pole at 0 only|too steep .* move a pole to 0"),
        (lambda x: 1 / np.abs(X(x) - 0.5), "a pole at 0 only"),
    ],
)
def test_poles_away_from_zero_are_refused_with_advice(pdf, says):
    with pytest.raises(DensityError, match=says):
        of(pdf, normalize=True)


def test_a_mild_pole_at_one_next_to_a_pole_at_zero():
    """Beta(0.3, 0.7): the unresolved part next to 1 is 1e-11 of the mass."""
    from scipy.stats import beta

    p = of(lambda x: X(x) ** -0.7 * (1 - X(x)) ** -0.3, normalize=True)
    u = np.linspace(0.01, 0.99, 99)[:, None]
    np.testing.assert_allclose(p.sample(u), beta(0.3, 0.7).ppf(u), rtol=1e-8)
