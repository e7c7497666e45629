"""Gaussian blue noise: energy against all images of all pairs, optimum in 1-D, spectrum, descent."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.samplers import GaussianBlueNoise
from mcspectra.samplers._descent import minimize, random_points, wrap
from mcspectra.samplers.gaussian_blue_noise import _near, _series


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path))


def energy_of_images(points, sigma):
    """The sum over pairs and over all their images, without any cells."""
    dims = points.shape[1]
    reach = int(np.ceil(9 * sigma)) + 1
    total = 0.0
    for shift in itertools.product(range(-reach, reach + 1), repeat=dims):
        delta = points[:, None] - points[None] + shift
        terms = np.exp(-np.sum(delta**2, axis=-1) / (2 * sigma**2))
        total += (terms.sum() - np.trace(terms)) / 2
    return total


@pytest.mark.parametrize(("dims", "n"), [(1, 2), (1, 30), (2, 3), (2, 50), (3, 2), (3, 40), (5, 4)])
def test_gradient_is_that_of_all_images(dims, n):
    """Central differences of a sum written without cells; the cut-off leaves e^(−18) a pair."""
    rng = np.random.default_rng(n)
    points, sigma = rng.random((n, dims)), 0.8 * n ** (-1 / dims)
    if dims > 3:
        sigma = 0.25  # images of a sum over 5 dims must not reach far
    direction, h = rng.standard_normal((n, dims)), 1e-5
    ends = [energy_of_images(points + s * h * direction, sigma) for s in (1, -1)]
    slope, scale = (ends[0] - ends[1]) / (2 * h), 1.0
    if dims > 3:
        scale = (np.sqrt(2 * np.pi) * sigma) ** dims
    evaluate = _near if dims <= 3 else _series
    gradient = scale * evaluate(sigma, points)[1]
    bound = n**2 * 6**dims * np.exp(-18) / sigma + 1e-9
    assert abs(np.sum(gradient * direction) - slope) < bound * np.abs(direction).max() * 10
    assert abs(slope) > 1e3 * bound or n < 10  # else the comparison means little


def test_series_and_cells_agree():
    points = np.random.default_rng(3).random((60, 2))
    near, series = _near(0.1, points), _series(0.1, points)
    scale = 2 * np.pi * 0.1**2
    np.testing.assert_allclose(scale * series[1], near[1], atol=1e-4 * np.abs(near[1]).max())
    assert abs(scale * series[0] / near[0] - 1) < 1e-5


@pytest.mark.parametrize("dims", [2, 3])
def test_energy_does_not_change_under_translations(dims):
    rng = np.random.default_rng(1)
    points, offset = rng.random((100, dims)), rng.random(dims)
    sigma = 100 ** (-1 / dims)
    energy, gradient = _near(sigma, points)
    moved_energy, moved = _near(sigma, points + offset)
    assert abs(moved_energy / energy - 1) < 1e-7
    np.testing.assert_allclose(moved, gradient, atol=1e-6 * np.abs(gradient).max())


def test_least_energy_in_one_dimension_is_equal_spacing():
    points = np.sort(GaussianBlueNoise(dims=1, sigma=0.5).draw(16, rng=2)[0, :, 0])
    gaps = np.diff(points, append=points[0] + 1)
    np.testing.assert_allclose(gaps, 1 / 16, atol=1e-6)


def test_energy_falls_with_iterations():
    sigma, energies = 256**-0.5, []
    for iterations in (1, 5, 25, 125):
        points = GaussianBlueNoise(iterations=iterations).draw(256, rng=5)[0]
        energies.append(_near(sigma, points)[0])
    assert all(np.diff(energies) < 0)
    # ½ n² (2π σ² − 1/n): the energy of a set without any power below the Gaussian's own cut-off
    ideal = 0.5 * 256 * (2 * np.pi - 1)
    assert abs(energies[-1] / ideal - 1) < 1e-5


@pytest.mark.parametrize(("dims", "n"), [(1, 64), (2, 256), (3, 343)])
def test_low_frequencies_are_empty_and_those_at_the_spacing_are_not(dims, n):
    points = GaussianBlueNoise(dims=dims, iterations=150).draw(n, realizations=2, rng=4)
    side = n ** (1 / dims)
    axis = np.arange(-int(2 * side), int(2 * side) + 1)
    m = np.stack(np.meshgrid(*[axis] * dims, indexing="ij"), axis=-1).reshape(-1, dims)
    m = m[: len(m) // 2]  # the other half is the same
    radius = np.linalg.norm(m, axis=1) / side
    near = (radius < 0.4) | (np.abs(radius - 1.0) < 0.15)
    m, radius = m[near], radius[near]
    power = np.mean([np.abs(np.exp(-2j * np.pi * (m @ x.T)).sum(1)) ** 2 / n for x in points], 0)
    assert power[radius < 0.4].max() < 1e-3
    assert power[radius > 0.4].mean() > 1.0


def test_variance_of_the_disk_falls_faster_than_jittered():
    """A set without low frequencies keeps the n^(−3/2) of an edge in 2-D (Pilleboue et al. 2015)."""
    estimator = mcs.Estimator(mcs.integrand("disk"))
    sampler = GaussianBlueNoise(iterations=60, sets=4)
    d = mcs.convergence(estimator, sampler, [16, 64, 256], realizations=400, rng=3)
    low, high = d["rate_ci"].values
    assert low < -1.5 < high or high < -1.5


def test_one_point_is_where_it_started():
    assert GaussianBlueNoise().draw(1, realizations=2, rng=1).shape == (2, 1, 2)


def test_minimize_finds_the_least_value_and_stops_there():
    target = np.array([[0.3, 0.4], [0.1, 0.9]])
    scales = np.array([[1.0, 10.0], [100.0, 1000.0]])
    calls, reports = [], []

    def bowl(x):
        calls.append(x)
        return float(np.sum(scales * (x - target) ** 2)), 2 * scales * (x - target)

    start = random_points(np.array([1, 2], np.uint64), 2, 2)
    found = minimize(bowl, start, iterations=500, longest=0.1, report=reports.append, goal=1e-20)
    np.testing.assert_allclose(found, target, atol=1e-9)
    assert len(calls) < 100
    assert max(np.abs(np.diff(calls[:2], axis=0)).ravel()) <= 0.1 + 1e-15
    assert reports == sorted(reports)


def test_minimize_leaves_a_place_without_slope():
    start = np.full((2, 2), 0.5)
    same = minimize(
        lambda x: (1.0, np.zeros_like(x)), start, iterations=9, longest=1.0, report=print
    )
    np.testing.assert_array_equal(same, start)


def test_wrap_stays_below_one():
    np.testing.assert_array_equal(wrap(np.array([-1e-20, 1.0, -0.25, 3.5])), [0, 0, 0.75, 0.5])


@pytest.mark.parametrize("value", [0, -1, 0.1, 3, float("nan"), float("inf"), "x", None, True])
def test_sigma_out_of_range(value):
    with pytest.raises(ParameterError, match=r"^sigma is .*; give a finite number"):
        GaussianBlueNoise(sigma=value)


@pytest.mark.parametrize("value", [0, -1, 1.5, float("nan"), float("inf"), "x", None, True])
def test_iterations_out_of_range(value):
    with pytest.raises(ParameterError, match=r"^iterations is .*; give a whole number"):
        GaussianBlueNoise(iterations=value)
