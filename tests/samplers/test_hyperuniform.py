"""Perturbed lattices against closed forms of their spectra; stealthy sets: no power, exactly."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.samplers import PerturbedLattice, StealthyHyperuniform
from mcspectra.samplers._hyperuniform_kernels import fill_normals
from mcspectra.samplers.hyperuniform import _power

LEVEL = 1 - (1 - 1e-6) ** (1 / 100)  # Šidák: fewer than 100 statistical comparisons in this file
SIGMAS = stats.norm.isf(LEVEL / 2)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path))


def powers(points, frequencies):
    """n|S_m|² of every realisation and frequency."""
    sums = np.exp(2j * np.pi * points @ np.transpose(frequencies)).sum(axis=1)
    return np.abs(sums) ** 2 / points.shape[1]


def assert_mean(values, expected):
    """Mean over the first axis within SIGMAS standard errors."""
    error = np.std(values, axis=0, ddof=1) / np.sqrt(len(values))
    np.testing.assert_array_less(np.abs(values.mean(axis=0) - expected), SIGMAS * error + 1e-12)


def lattice_power(m, sides, width, beta):
    """n⟨|S_m|²⟩ from the covariances of a Gaussian field, written as sums over grid and lags."""
    dims = len(m)
    wave = np.array(list(itertools.product(range(sides), repeat=dims)))
    folded = np.minimum(wave, sides - wave)
    norm = np.sqrt(np.sum(folded.astype(float) ** 2, axis=1))
    weight = np.ones(len(wave))
    if beta != 0:
        weight = np.where(norm > 0, np.where(norm > 0, norm, 1.0) ** -beta, 0.0)
    weight *= (width / sides) ** 2 / weight.sum()
    covariance = np.cos(2 * np.pi * wave @ wave.T / sides) @ weight  # by lag
    decay = np.exp(-4 * np.pi**2 * np.dot(m, m) * (weight.sum() - covariance))
    return float(np.sum(np.cos(2 * np.pi * wave @ m / sides) * decay))


@pytest.mark.parametrize("beta", [-1.5, 0.0, 1.0, 2.0])
@pytest.mark.parametrize(("sides", "dims"), [(9, 1), (4, 2), (3, 3)])
def test_spectrum_of_perturbed_lattices(beta, sides, dims):
    """Frequencies below, at and above those of the grid."""
    sampler = PerturbedLattice(dims=dims, width=0.3, correlation=beta)
    points = sampler.draw(sides**dims, realizations=3000, rng=2)
    m = np.array([[k] + [1] * (dims - 1) for k in (1, 2, 3)] + [[sides] + [0] * (dims - 1)])
    expected = [lattice_power(row, sides, 0.3, beta) for row in m]
    assert_mean(powers(points, m), expected)


def test_independent_displacements_have_the_simple_closed_form():
    sampler, sides = PerturbedLattice(width=0.2), 5
    m = np.array([[1, 0], [1, 2], [4, 3], [5, 1]])
    simple = 1 - np.exp(-4 * np.pi**2 * np.sum(m**2, axis=1) * (0.2 / sides) ** 2)
    np.testing.assert_allclose(simple, [lattice_power(row, sides, 0.2, 0) for row in m], atol=1e-12)
    assert_mean(powers(sampler.draw(25, realizations=3000, rng=4), m), simple)


@pytest.mark.parametrize("beta", [0.0, 1.0])
def test_displacements_of_width_zero_leave_the_grid(beta):
    points = PerturbedLattice(width=0.0, correlation=beta).draw(16, rng=1)[0]
    steps = (points - points[0]) * 4
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-14)


def test_displacements_have_the_width_along_each_axis():
    source = PerturbedLattice(width=0.1, correlation=1.0)
    points = source.draw(64, realizations=2000, rng=3)
    grid = np.stack(np.meshgrid(*[np.arange(8) / 8] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    moves = (points - points[:, :1] - grid + 0.5) % 1.0 - 0.5  # relative to the first point
    relative = moves[:, 36]  # half the torus away: variance 2 (c(0) − c(½, ½))
    wave = np.array(list(itertools.product(range(8), repeat=2)))
    norm = np.hypot(*np.minimum(wave, 8 - wave).T)
    weight = 1 / np.where(norm > 0, norm, np.inf)
    lag = np.cos(np.pi * wave.sum(axis=1)) @ weight / weight.sum()
    assert_mean(relative**2, 2 * (0.1 / 8) ** 2 * (1 - lag))


def test_normal_numbers_are_normal_and_independent():
    out = np.empty((2, 20_001))
    fill_normals(np.array([[1, 2], [3, 4]], np.uint64), 7, out)
    assert stats.kstest(out.ravel(), "norm").pvalue > LEVEL
    assert abs(np.mean(out[:, :-1:2] * out[:, 1::2])) < SIGMAS / np.sqrt(20_000)
    assert abs(np.mean(out[:, 1:-2] * out[:, 2:-1])) < SIGMAS / np.sqrt(39_996)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        *(({"width": v}, "width") for v in (-0.1, float("nan"), float("inf"), "x", None, True)),
        *(({"correlation": v}, "correlation") for v in (-2.1, 2.5, float("nan"), "x", None)),
    ],
)
def test_parameters_of_the_perturbed_lattice(arguments, word):
    with pytest.raises(ParameterError, match=f"^{word} is .*; give a finite number"):
        PerturbedLattice(**arguments)


def test_counts_of_the_perturbed_lattice():
    with pytest.raises(CountError, match="nearest counts are 9 and 16"):
        PerturbedLattice().draw(10)


@pytest.mark.parametrize("beta", [0.0, 1.0])
def test_rate_of_the_perturbed_lattice(beta):
    """Edges of the disk: ∫ |k|^(−3) min(1, (|k|/√n)^(2−β)) k dk / n ~ n^(−3/2)."""
    sampler = PerturbedLattice(correlation=beta)
    f = mcs.Estimator(mcs.integrand("disk"))
    d = mcs.convergence(f, sampler, [64, 256, 1024], realizations=300, rng=3)
    low, high = d["rate_ci"].values
    slack = 0.05 if beta == 0.0 else 0.15  # lower-order terms: n^(−1/2), with β = 1 a logarithm
    assert abs(float(d["rate"]) + 1.5) < 4 * (high - low) / 2 / 1.96 + slack


@pytest.mark.parametrize(
    ("n", "dims", "chi"),
    [(64, 1, 0.3), (64, 2, 0.1), (100, 2, 0.4), (200, 2, 0.45), (100, 3, 0.4), (20, 6, 0.4)],
)
def test_stealthy_sets_have_no_power_and_only_there(n, dims, chi):
    sampler = StealthyHyperuniform(dims=dims, stealthiness=chi)
    frequencies = sampler.constrained(n)
    assert 0 < len(frequencies) <= chi * dims * (n - 1)
    points = sampler.draw(n, realizations=2, rng=1)
    assert powers(points, frequencies).max() < 1e-12
    beyond = 2 * np.abs(frequencies).max() * np.eye(dims, dtype=int)
    assert powers(points, beyond).mean() > 1e-2


def test_constrained_frequencies_are_whole_shells():
    m = StealthyHyperuniform(stealthiness=0.4).constrained(100)
    radius = np.max(np.sum(m**2, axis=1))
    axis = range(-20, 21)
    inside = [(a, b) for a in axis for b in axis if 0 < a * a + b * b <= radius]
    assert {tuple(row) for row in np.concatenate([m, -m]).tolist()} == set(inside)
    assert len(inside) == 2 * len(m)


@pytest.mark.parametrize(("n", "dims"), [(5, 1), (9, 2), (8, 3), (6, 5)])
def test_gradient_of_the_power(n, dims):
    rng = np.random.default_rng(n)
    points, direction, h = rng.random((n, dims)), rng.standard_normal((n, dims)), 1e-6
    m = rng.integers(-3, 4, (12, dims))
    value, gradient = _power(m, points)
    assert abs(value - powers(points[None], m).sum()) < 1e-10
    ends = [powers(points[None] + s * h * direction, m).sum() for s in (1, -1)]
    assert abs((ends[0] - ends[1]) / (2 * h) - np.sum(gradient * direction)) < 1e-5


@pytest.mark.parametrize("n", [1, 2, 3])
def test_sets_too_small_for_any_constraint_are_random(n):
    sampler = StealthyHyperuniform(stealthiness=0.2)
    assert sampler.constrained(n).shape == (0, 2)
    assert sampler.draw(n, realizations=2, rng=1).shape == (2, n, 2)


def test_variance_of_a_smooth_function_vanishes():
    """cos 2π(x + 2y) has no frequency beyond K: integrated without any error."""
    points = StealthyHyperuniform().draw(64, realizations=3, rng=1)
    means = np.cos(2 * np.pi * points @ [1, 2]).mean(axis=1)
    np.testing.assert_allclose(means, 0.0, atol=1e-11)


def test_rate_of_the_disk():
    """Edges: ∫ |k|^(−3) k dk / n from K ~ √n on: n^(−3/2)."""
    sampler = StealthyHyperuniform(stealthiness=0.3, sets=4)
    f = mcs.Estimator(mcs.integrand("disk"))
    d = mcs.convergence(f, sampler, [16, 64, 256], realizations=500, rng=3)
    low, high = d["rate_ci"].values
    assert low - 0.1 < -1.5 < high + 0.1 or high < -1.5  # K²/n keeps to 10 % between whole shells


@pytest.mark.parametrize("value", [0.5, 0.9, 3])
def test_crystals_are_refused(value):
    with pytest.raises(ParameterError, match="give less than 0.5: from 0.5 on, all sets are"):
        StealthyHyperuniform(stealthiness=value)


@pytest.mark.parametrize("value", [0, -1, float("nan"), float("inf"), "x", None, True])
def test_stealthiness_out_of_range(value):
    with pytest.raises(ParameterError, match=r"^stealthiness is .*; give a finite number"):
        StealthyHyperuniform(stealthiness=value)


def test_sets_that_are_not_found_are_an_error():
    with pytest.raises(
        ParameterError, match=r"found no set of 16 points .* lower stealthiness .* raise"
    ):
        StealthyHyperuniform(iterations=2).draw(16, rng=1)


def test_huge_counts_are_refused():
    with pytest.raises(CountError, match="makes at most 16384 points"):
        StealthyHyperuniform().draw(2**22)
