"""Quadrature: rules, coefficients and integrals compared with exact ones, accuracy, limits."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.integrands import fourier_accuracy, integral_accuracy
from mcspectra.integrands._quadrature import AxisRule, gauss_rule

K = 12


@pytest.mark.parametrize("order", [1, 2, 5, 16])
def test_a_wave_keeps_its_phase(order):
    """The midpoint rule (order 1) is exact for waves, including the half-sample phase."""
    rule = AxisRule.make(32 * order, order)
    m = np.arange(-6.0, 7.0)
    found = rule.transform(np.cos(2 * np.pi * 5 * rule.nodes + 0.7), m)
    expected = np.where(m == 5, np.exp(0.7j) / 2, np.where(m == -5, np.exp(-0.7j) / 2, 0))
    # Order 2 integrates 5 of 32 cycles per cell to h⁴/4320 = (2π·11/32)⁴/4320 for the product's
    # wave
    bound = {1: 1e-15, 2: (2 * np.pi * 11 / 32) ** 4 / 4320, 5: 1e-9, 16: 1e-15}[order]
    assert np.abs(found - expected).max() < bound
    if order == 1:  # Without the phase the error is |exp(πi 5/32) − 1| / 2
        dropped = np.fft.fft(np.cos(2 * np.pi * 5 * rule.nodes + 0.7))[m.astype(int)] / 32
        assert np.abs(dropped - expected).max() > 0.2


def test_pieces_of_cut_cells_fill_the_axis():
    rule = AxisRule.make(64, 16, (0.1, 0.11, 0.25, 0.6, 0.999))
    assert rule.weights.sum() == pytest.approx(1, abs=1e-15)
    used = rule.weights > 0
    for b in (0.1, 0.11, 0.25, 0.6, 0.999):
        share = rule.weights[used & (rule.nodes < b)].sum()
        assert share == pytest.approx(b, abs=1e-15)


@pytest.mark.parametrize(
    ("spec", "dims"),
    [
        ("christensen-gaussian", 2),
        ("christensen-bilinear", 2),
        ("christensen-step", 2),
        ("gaussian(width=0.1)", 1),
        ("gaussian", 3),
        ("linear(gradient=[1, 2, 3, 4])", 4),
        ("smoothed-step(at=0.437, width=0.2)", 1),
        ("image(values=[[[1, -1], [2, 0]], [[4, 1], [5, 7]], [[0, 1], [2, 2]]])", 2),
    ],
)
def test_smooth_and_broken_functions_to_rounding(spec, dims, hidden):
    """Also for non-periodic f, as the border is the edge of a cell; 8 nodes per wave give 1e-10."""
    f = mcs.integrand(spec, dims=dims)
    h = hidden(f)
    width = K if dims < 4 else 2
    exact, found = f.fourier_grid(width), h.fourier_grid(width)
    description, error = fourier_accuracy(h, width)
    assert np.abs(found - exact).max() < 1e-14 * max(1, np.abs(exact).max())
    assert error < 1e-10 * np.abs(exact).max()
    assert "FFT" in description
    assert "nodes" in description
    assert fourier_accuracy(f, width) == ("exact", 0.0)


@pytest.mark.parametrize(
    ("spec", "perimeter"),
    [
        ("christensen-disk", np.pi / 2 * 0.8),
        ("christensen-triangle", 2**0.5),
        ("disk", np.pi / 2),
        ("half-space(normal=[1, 2], offset=0.9)", 1.1),
    ],
)
def test_borders_that_no_axis_follows(spec, perimeter, hidden):
    """Cut cells of side h cover at most √2 h (perimeter + 2h).

    A jump in a row of nodes costs at most one Gauss weight of the cell, along each axis.
    """
    f = mcs.integrand(spec)
    h = hidden(f)
    found = h.fourier_grid(K) - f.fourier_grid(K)
    size = 16 / 2048
    area = 2**0.5 * size * (perimeter + 2 * size)
    assert np.abs(found).max() < 2 * gauss_rule(16)[1].max() * area
    # The error is an estimate, not a bound; a tenth of the true error would be useless
    assert fourier_accuracy(h, K)[1] > 0.1 * np.abs(found).max()


def test_listed_frequencies_need_no_full_grid(hidden):
    f = mcs.integrand("christensen-gaussian")
    m = np.array([[[200, 1], [-100, 0]], [[0, 0], [7, -5]]])
    assert np.abs(hidden(f).fourier(m) - f.fourier(m)).max() < 1e-14
    one = mcs.integrand("gaussian", dims=1)
    assert np.abs(hidden(one).fourier([[123456]]) - one.fourier([[123456]])).max() < 1e-15


def test_results_are_remembered_and_cannot_be_spoilt():
    calls = []

    def function(x):
        calls.append(x.shape)
        return x[..., 0] ** 2

    f = mcs.Integrand.from_function(function, dims=1)
    first = f.fourier_grid(4)
    used = len(calls)
    first[:] = 0
    assert f.fourier_grid(4)[4] == pytest.approx(1 / 3, abs=1e-15)
    assert f.integral == pytest.approx(1 / 3, abs=1e-15)
    assert len(calls) == used
    for width in range(5, 12):
        f.fourier_grid(width)
    assert f.fourier_grid(4)[4] == pytest.approx(1 / 3, abs=1e-15)


def test_the_known_integral_is_the_zeroth_coefficient():
    """For an oblique border the FFT is accurate to 1e-5, but the integral is known."""
    f = mcs.Integrand.from_function(
        lambda x: (x[..., 0] + x[..., 1] ** 2 < 0.5) * 1.0, dims=2, integral=2**0.5 / 3
    )
    assert f.fourier([[0, 0]])[0] == 2**0.5 / 3
    assert f.fourier_grid(3)[3, 3] == 2**0.5 / 3
    assert fourier_accuracy(f, 3)[1] > 0


@pytest.mark.parametrize(
    ("function", "expected", "tolerance"),
    [
        (lambda x: np.abs(x[..., 0] - 0.3), (0.09 + 0.49) / 2, 1e-12),
        (lambda x: (x[..., 0] < 1 / 3) * 1.0, 1 / 3, 1e-12),
        (lambda x: np.sqrt(x[..., 0]), 2 / 3, 1e-12),
        (lambda x: x[..., 0] ** -0.5, 2.0, 1e-5),
        (lambda x: np.exp(-(((x[..., 0] - 0.123) / 1e-3) ** 2)), 1e-3 * np.pi**0.5, 1e-12),
        (lambda x: x[..., 0] * 0, 0.0, 0.0),
    ],
)
def test_integrals_1d(function, expected, tolerance):
    f = mcs.Integrand.from_function(lambda x: function(x), dims=1)
    assert f.integral == pytest.approx(expected, abs=max(tolerance, 1e-300))
    # For x^-½ each halving leaves √½ of the error, so the rest is 1/(1 − √½) of the last difference
    assert abs(f.integral - expected) <= 3.5 * integral_accuracy(f)[1] + 1e-15


@pytest.mark.parametrize("dims", [2, 3, 4, 5])
def test_integrals_of_products(dims):
    f = mcs.Integrand.from_function(lambda x: np.exp(x).prod(axis=-1), dims=dims)
    expected = (np.e - 1) ** dims
    assert f.integral_source == "quadrature"
    # 4 nodes per axis in 5-D, 5 in 4-D; cells of side ½ and ¼; the tolerance is 1e-12 of the
    # integral
    assert f.integral == pytest.approx(expected, rel=1e-11)


def test_many_dims_use_a_sequence():
    f = mcs.Integrand.from_function(lambda x: np.stack([x.sum(-1), x.prod(-1)], -1), dims=8)
    description, error = integral_accuracy(f)
    assert "Kronecker" in description
    assert 0 < error < 1e-4
    assert np.abs(f.integral - [4, 2**-8]).max() < 10 * error


def test_exact_integrands_say_so():
    assert integral_accuracy(mcs.integrand("disk")) == ("exact", 0.0)
    cut = mcs.integrand("christensen-disk")
    description, error = fourier_accuracy(cut, 4)
    assert "chords" in description
    assert error == 0


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda f: f.fourier_grid(-1), "half_width"),
        (lambda f: f.fourier_grid(2.5), "half_width"),
        (lambda f: f.fourier_grid(10**5), "smaller half_width"),
        (lambda f: f.fourier([[5000, 5000]]), "evaluations"),
        (lambda f: f.fourier([[0.5, 1]]), "integer"),
        (lambda f: f.fourier([[np.nan, 1]]), "NaN"),
        (lambda f: f.fourier([1, 2, 3]), "(..., 2)"),
        (lambda f: f.fourier(np.zeros((0, 2))), "(..., 2)"),
    ],
)
def test_refused(ask, words, hidden):
    with pytest.raises(ParameterError) as caught:
        ask(hidden(mcs.integrand("gaussian")))
    assert words in str(caught.value)


def test_seven_dims_are_too_many_for_a_grid(hidden):
    h = hidden(mcs.integrand("gaussian", dims=7))
    with pytest.raises(ParameterError, match="evaluations"):
        h.fourier_grid(1)
