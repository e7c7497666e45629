"""Smoothed edges: ramps by definition, coefficients by quadrature, box means with equal
integrals."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.integrands import BoxSmoothed, EdgeSmoothed, SmoothedStep

RNG = np.random.default_rng(8)


def test_a_step_becomes_the_ramp_of_its_own_class():
    g = mcs.smoothed("step(at=0.3, axis=1)", 0.2, dims=2)
    assert g == SmoothedStep(at=0.3, axis=1, dims=2, width=0.2)
    assert mcs.smoothed("christensen-step", 0.2, dims=2) == SmoothedStep(
        at=1 / np.pi, dims=2, width=0.2
    )


@pytest.mark.parametrize("center", [(0.463, 0.517), (0.1, 0.7), (1.2, 0.5)])
def test_ramps_of_disks(center):
    width, radius = 0.1, 0.3
    g = mcs.smoothed(mcs.integrand(f"disk(center={center}, radius={radius})", dims=2), width)
    x = RNG.random((500, 2))
    away = np.hypot(*(x - center).T) - radius
    expected = np.interp(away, [-width / 2, width / 2], [1, 0])
    np.testing.assert_allclose(g(x), expected, atol=1e-14)


@pytest.mark.parametrize("normal", [(1.0, 2.0), (-3.0, 0.5)])
def test_ramps_of_half_spaces_are_as_wide_as_asked_whatever_the_length_of_the_normal(normal):
    g = mcs.smoothed(mcs.integrand(f"half-space(normal={normal}, offset=0.4)", dims=2), 0.1)
    x = RNG.random((500, 2))
    away = (x @ np.array(normal) - 0.4) / np.hypot(*normal)
    np.testing.assert_allclose(g(x), np.interp(away, [-0.05, 0.05], [1, 0]), atol=1e-14)


def test_the_integral_of_a_smoothed_disk_is_larger_by_an_exact_bias():
    """∫ = (1/δ)∫ π(R+τ)² dτ = πR² + πδ²/12, inside the domain."""
    disk = mcs.integrand("disk(center=0.5, radius=0.25)", dims=2)
    for width in (0.01, 0.2, 0.4):
        bias = mcs.smoothed(disk, width).integral - disk.integral
        assert bias == pytest.approx(np.pi * width**2 / 12, rel=1e-9)


@pytest.mark.parametrize(
    "spec",
    [
        "disk(center=[0.463, 0.517], radius=0.27)",
        "disk(center=[0.1, 0.7], radius=0.4)",
        "half-space(normal=[1, 2], offset=0.9)",
        "christensen-triangle",
    ],
)
def test_integrals_and_coefficients_of_ramps_against_a_grid(spec):
    """Midpoints, 1024²: second order for a ramp, whose curvature is 1/δ along its two ends."""
    g = mcs.smoothed(mcs.integrand(spec, dims=2), 0.3)
    steps = (np.arange(1024) + 0.5) / 1024
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    values = g(grid)
    m = np.array([[0, 0], [1, 0], [2, -3], [-7, 4]])
    waves = [np.exp(-2j * np.pi * (grid @ k)) for k in m]
    expected = [(values * wave).mean() for wave in waves]
    np.testing.assert_allclose(g.fourier(m), expected, atol=2e-5)
    assert g.integral == pytest.approx(expected[0].real, abs=2e-6)
    assert "averaged over edges" in g.fourier_source


def test_high_frequencies_of_wide_ramps_are_resolved():
    """The decay |m|^-3/2 of a disk (J_1) becomes |m|^-5/2, so averages of waves have to cancel."""
    g = mcs.smoothed("disk(center=0.5, radius=0.25)", 0.3, dims=2)
    fine = EdgeSmoothed(edge=g.edge, width=g.width)
    high = np.array([[61, 0], [120, 35]])
    many = fine._mean(lambda edge: edge._fourier(high), 64)
    np.testing.assert_allclose(g.fourier(high), many, atol=1e-13)
    assert abs(g.fourier(high)).max() < abs(g.edge.fourier(high)).max() / 5


def test_one_dim_and_three_dims():
    f = mcs.smoothed("disk(center=0.5, radius=0.25)", 0.1, dims=1)
    assert f.breaks == (pytest.approx((0.2, 0.3, 0.7, 0.8)),)
    assert f.integral == pytest.approx(0.5, abs=1e-13)
    ball = mcs.smoothed("disk(center=0.5, radius=0.25)", 0.2, dims=3)
    exact = 4 / 3 * np.pi * (0.35**4 - 0.15**4) / 4 / 0.2
    assert ball.integral == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(
    "spec", ["disk(center=[0.2, 0.9], radius=0.4)", "gaussian(width=0.1)", "step(at=0.02)"]
)
def test_boxes_keep_the_integral_and_are_means_over_boxes(spec):
    f = mcs.integrand(spec, dims=2)
    g = mcs.smoothed(f, 0.3, method="box")
    assert isinstance(g, BoxSmoothed)
    assert g.integral == f.integral
    steps = (np.arange(200) + 0.5) / 200
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    # Midpoints have errors at kinks of g: 200^-2 · (slope ≤ 1/0.3) · their length
    assert g(grid).mean() == pytest.approx(f.integral, abs=5e-4)
    offsets = (np.arange(300) + 0.5) / 300 - 0.5
    box = 0.3 * np.stack(np.meshgrid(offsets, offsets, indexing="ij"), axis=-1)
    for x in ([0.05, 0.5], [0.5, 0.98], [0.0, 1.0], [0.3, 0.6]):
        around = np.abs(x + box)
        reflected = np.where(around > 1, 2 - around, around)
        # A border crosses at most 4 · 300 of the 300² cells, and half of a cell on average
        assert g([x])[0] == pytest.approx(f(reflected).mean(), abs=8e-3)


def test_boxes_by_quadrature_of_smooth_functions_and_of_channels():
    f = mcs.Integrand.from_function(
        lambda x: np.stack([np.cos(x[..., 0]), x[..., 1] ** 2], axis=-1), dims=2
    )
    g = mcs.smoothed(f, 0.2)
    x = np.array([[0.4, 0.5], [0.6, 0.7]])
    sinc = np.sin(0.1) / 0.1
    expected = np.stack([np.cos(x[:, 0]) * sinc, x[:, 1] ** 2 + 0.04 / 12], axis=-1)
    np.testing.assert_allclose(g(x), expected, atol=1e-13)
    np.testing.assert_array_equal(g.integral, f.integral)
    assert g.integral_source == "quadrature"


def test_boxes_by_quadrature_keep_the_integral_too():
    f = mcs.Integrand.from_function(lambda x: np.exp(2 * x[..., 0]), dims=1)
    g = mcs.smoothed(f, 0.4, nodes=3)
    x = (np.arange(2**14) + 0.5)[:, None] / 2**14
    assert g(x).mean() == pytest.approx(f.integral, rel=1e-8)  # Midpoints: 4/(24 · 2^28)


@pytest.mark.parametrize(
    ("spec", "width", "keywords", "words"),
    [
        ("disk", 0.0, {}, "greater than 0"),
        ("disk", "wide", {}, "finite"),
        ("disk", 0.5, {}, "narrower than 0.5"),
        ("gaussian", 1.5, {}, "at most 1"),
        ("gaussian", 0.1, {"method": "distance"}, "use method='box'"),
        ("gaussian", 0.1, {"method": "blur"}, "must be one of"),
        ("gaussian", 0.1, {"nodes": 0}, "nodes is 0"),
        ("gaussian", 0.1, {"nodes": 10**9}, "nodes is 1000000000"),
        ("no-such", 0.1, {}, "no-such"),
    ],
)
def test_bad_input(spec, width, keywords, words):
    with pytest.raises(ParameterError, match=words):
        mcs.smoothed(spec, width, dims=2, **keywords)


def test_boxes_in_many_dims_are_refused_at_once():
    f = mcs.Integrand.from_function(lambda x: x[..., 0], dims=8)
    with pytest.raises(ParameterError, match="4096"):
        mcs.smoothed(f, 0.1)
