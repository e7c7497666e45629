"""Sliced optimal transport: closed-form quantiles of projected cubes, evenness on new lines."""

import functools

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.samplers import SlicedOptimalTransport
from mcspectra.samplers.sliced import projected_quantiles


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path))


def unevenness(points):
    """Return the root-mean-square distance of ordered projections from their quantiles."""
    squares = [
        np.mean((np.sort((points - 0.5) @ theta) - quantiles) ** 2)
        for theta, quantiles in lines(*points.shape)
    ]
    return np.sqrt(np.mean(squares))


@functools.cache
def lines(n, dims):
    """Return a hundred random directions, and n quantiles of the cube's projection on each."""
    theta = np.random.default_rng(77).standard_normal((100, dims))
    theta /= np.linalg.norm(theta, axis=1, keepdims=True)
    return [(each, projected_quantiles(each, n)) for each in theta]


def test_quantiles_along_an_axis_are_those_of_a_uniform_number():
    found = projected_quantiles(np.array([0.0, 1.0, 0.0]), 8)
    np.testing.assert_allclose(found, (np.arange(8) + 0.5) / 8 - 0.5, atol=1e-12)


@pytest.mark.parametrize("angle", [0.1, 0.5, np.pi / 4, 2.0])
def test_quantiles_of_a_projected_square(angle):
    """The density is a trapezoid; its distribution function is evaluated at the quantiles."""
    theta, n = np.array([np.cos(angle), np.sin(angle)]), 200
    wide, narrow = np.sort(np.abs(theta))[::-1]
    t = projected_quantiles(theta, n)

    def ramp(x):  # second integral of the step
        return np.maximum(x, 0) ** 2 / (2 * wide * narrow)

    ends = [(wide + narrow) / 2, (wide - narrow) / 2]
    below = ramp(t + ends[0]) - ramp(t + ends[1]) - ramp(t - ends[1]) + ramp(t - ends[0])
    np.testing.assert_allclose(below, (np.arange(n) + 0.5) / n, atol=1e-5)


def test_quantiles_along_the_diagonal_are_those_of_irwin_and_hall():
    s = (projected_quantiles(np.full(3, 3**-0.5), 100) + 3**0.5 / 2) * 3**0.5
    below = sum(sign * np.maximum(s - k, 0) ** 3 for k, sign in enumerate((1, -3, 3, -1))) / 6
    np.testing.assert_allclose(below, (np.arange(100) + 0.5) / 100, atol=1e-5)


def test_quantiles_in_many_dims_are_nearly_normal():
    """64 equal widths: the sum has variance 1/12 and fourth cumulant −1/(120 · 64).

    Each of 63 linear interpolations in a table of steps h = 8/2048 adds h²/8 or so: 1.2e-4.
    """
    t = projected_quantiles(np.full(64, 0.125), 4000)
    assert abs(t.mean()) < 1e-6
    assert abs(np.var(t) - 1 / 12) < 2e-4
    assert abs(np.mean(t**4) - 3 * np.var(t) ** 2 + 1 / (120 * 64)) < 1e-4


@pytest.mark.parametrize(("n", "dims"), [(64, 2), (256, 2), (128, 3), (64, 8)])
def test_projections_on_new_lines_are_more_even_than_at_random(n, dims):
    """Better than random by n^(1/(2d)), to n^(−1/2−1/(2d)) (Paulin et al. 2020)."""
    iterations = 60 if dims < 8 else 20  # quantiles in 8 dims take most of the time
    source = SlicedOptimalTransport(dims=dims, iterations=iterations)
    found = unevenness(source.draw(n, rng=1)[0])
    rng = np.random.default_rng(5)
    usual = np.median([unevenness(rng.random((n, dims))) for _ in range(9)])
    assert found < usual / n ** (0.5 / dims)


def test_every_iteration_lowers_the_unevenness():
    found = [
        unevenness(SlicedOptimalTransport(iterations=i).draw(128, rng=3)[0]) for i in (1, 4, 16, 64)
    ]
    assert all(np.diff(found) < 0)


def test_only_translated_sets_are_unbiased():
    assert not SlicedOptimalTransport().unbiased
    assert SlicedOptimalTransport(sets=2).unbiased
    assert SlicedOptimalTransport().then(mcs.samplers.Shift()).unbiased
