"""Integrals of pixels: correct within the stated error for any discontinuities."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.streams import Stream
from mcspectra.integrands import Integrand, integral_accuracy
from mcspectra.rendering import Pixel, pixel_mis
from mcspectra.rendering import pixel as module
from mcspectra.rendering.pixel import SOURCE, mean_of_points

pytestmark = pytest.mark.render

FLOOR = {"scene": "veach", "x": 5, "y": 500}
SIGMAS = 4.5  # Student's t with 15 degrees of freedom exceeds it by chance once in 2400
SAMPLES = 2**18


def uniforms(dims):
    return Stream.from_rng(3).uniforms(0, 1, SAMPLES * dims).reshape(SAMPLES, dims)


@pytest.mark.parametrize(
    ("strategy", "dims"),
    [pytest.param("light", 2, marks=pytest.mark.slow), ("light", 4), ("mis-bsdf", 4)],
)
def test_it_is_the_mean_of_random_points(monkeypatch, strategy, dims):
    monkeypatch.setattr(module, "_POINTS", 2**14)  # as many points as the reference
    pixel = Pixel(**FLOOR, dims=dims, strategy=strategy)
    values = pixel(uniforms(dims))
    error = np.hypot(values.std() / SAMPLES**0.5, integral_accuracy(pixel)[1])
    assert abs(values.mean() - pixel.integral) < SIGMAS * error
    assert error < 0.1 * pixel.integral  # otherwise the test could not fail


def test_errors_cover_discontinuities(monkeypatch):
    """An ellipse of known area: z-scores of 40 placements have the variance of Student's t."""
    monkeypatch.setattr(module, "_POINTS", 2**10)
    scores = []
    for k in range(40):
        radii, centre = (0.11 + 0.004 * k, 0.2), (0.41, 0.53 + 0.003 * k)
        shape = Integrand.from_function(
            lambda x, r=radii, c=centre: 1.0 * ((((x - c) / r) ** 2).sum(axis=-1) < 1.0), dims=2
        )
        found = mean_of_points(shape)
        scores.append((float(found.value[0]) - np.pi * radii[0] * radii[1]) / found.error)
    # Mean square 15/13, for a sample of 40 with kurtosis 3 + 6/11, within 4 standard errors.
    spread = np.mean(np.square(scores))
    assert abs(spread - 15 / 13) < 4 * 15 / 13 * np.sqrt((2 + 6 / 11) / 40)


def test_accuracy_names_its_method():
    pixel = Pixel(**FLOOR)
    assert pixel.integral_source == SOURCE
    source, error = integral_accuracy(pixel)
    assert source == SOURCE
    assert 0.0 < error < 1e-3 * pixel.integral


def test_it_is_computed_once(monkeypatch):
    monkeypatch.setattr(module, "_POINTS", 2**10)
    pixel = Pixel(**FLOOR)
    kept = pixel.integral
    monkeypatch.setattr(module, "mean_of_points", None)
    assert pixel.integral == kept


def test_channels_have_an_integral_each(monkeypatch):
    monkeypatch.setattr(module, "_POINTS", 2**10)
    together = Pixel(**FLOOR, channel="rgb").integral
    single = [Pixel(**FLOOR, channel=c).integral for c in range(3)]
    assert np.allclose(together, single, rtol=1e-6)


def test_sums_of_techniques_add_their_errors(monkeypatch):
    monkeypatch.setattr(module, "_POINTS", 2**14)
    mis = pixel_mis(**FLOOR, light=0)
    parts = [mis.primary_integrand(t) for t in range(2)]
    assert mis.primary_integrand(1) is parts[1]
    assert mis.integral == sum(g.integral for g in parts)
    assert mis.integral_error == sum(integral_accuracy(g)[1] for g in parts)
    assert mis.integral_source == SOURCE
    light = Pixel(**FLOOR, light=0)
    error = np.hypot(mis.integral_error, integral_accuracy(light)[1])
    assert abs(mis.integral - light.integral) < SIGMAS * error


@pytest.mark.parametrize("dims", [2, 4])
def test_convergence_reports_no_false_bias(monkeypatch, dims):
    monkeypatch.setattr(module, "_POINTS", 2**12)  # the error of the integral is part of `bias_se`
    pixel = Pixel(**FLOOR, dims=dims)
    found = mcs.convergence(pixel, "random", [64], realizations=4000, rng=1)
    assert abs(float(found["bias"][0])) < SIGMAS * float(found["bias_se"][0])
    expected = np.hypot(found["mean_se"], integral_accuracy(pixel)[1])
    assert np.allclose(found["bias_se"], expected, rtol=1e-14)
    assert found.attrs["integral_source"] == SOURCE


def test_a_constant_is_known_to_the_rounding_of_its_values():
    f = Integrand.from_function(lambda x: np.full(x.shape[:-1], 3.0), dims=2)
    found = mean_of_points(f)
    assert found.value == 3.0
    assert found.error == pytest.approx(3.0 * 2.0**-23)
