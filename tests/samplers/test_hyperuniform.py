"""Hyperuniform sets: spectra, pairs and moments against closed forms; exactly zero power."""

import itertools
from collections import Counter

import numpy as np
import pytest
from scipy import special, stats

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.samplers import Determinantal, PerturbedLattice, StealthyHyperuniform
from mcspectra.samplers.hyperuniform import (
    fill_normals,
    frequencies_within,
    half_shells,
    nearest_frequencies,
    summed_power,
)

LEVEL = 1 - (1 - 1e-6) ** (1 / 164)  # Šidák: fewer than 164 statistical comparisons in this file
SIGMAS = stats.norm.isf(LEVEL / 2)


def powers(points, frequencies):
    """Return n|S_m|² of every realization and frequency."""
    sums = np.exp(2j * np.pi * points @ np.transpose(frequencies)).sum(axis=1)
    return np.abs(sums) ** 2 / points.shape[1]


def assert_mean(values, expected):
    """Assert that the mean over the first axis is within SIGMAS standard errors."""
    error = np.std(values, axis=0, ddof=1) / np.sqrt(len(values))
    np.testing.assert_array_less(np.abs(values.mean(axis=0) - expected), SIGMAS * error + 1e-12)


def lattice_power(m, sides, width, beta):
    """Return n⟨|S_m|²⟩ from the covariances of a Gaussian field, summed over grid and lags."""
    dims = len(m)
    wave = np.array(list(itertools.product(range(sides), repeat=dims)))
    folded = np.minimum(wave, sides - wave)
    norm = np.sqrt(np.sum(folded.astype(float) ** 2, axis=1))
    weight = np.ones(len(wave))
    if beta != 0:
        weight = np.where(norm > 0, np.where(norm > 0, norm, 1.0) ** -beta, 0.0)
    weight *= (width / sides) ** 2 / weight.sum()
    covariance = np.cos(2 * np.pi * wave @ wave.T / sides) @ weight  # covariance by lag
    decay = np.exp(-4 * np.pi**2 * np.dot(m, m) * (weight.sum() - covariance))
    return float(np.sum(np.cos(2 * np.pi * wave @ m / sides) * decay))


@pytest.mark.parametrize("beta", [-1.5, 0.0, 1.0, 2.0])
@pytest.mark.parametrize(("sides", "dims"), [(9, 1), (4, 2), (3, 3)])
def test_spectrum_of_perturbed_lattices(beta, sides, dims):
    """Frequencies below, at and above the frequencies of the grid."""
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
def test_displacements_of_width_zero_do_not_change_the_grid(beta):
    points = PerturbedLattice(width=0.0, correlation=beta).draw(16, rng=1)[0]
    steps = (points - points[0]) * 4
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-14)


def test_displacements_have_the_width_along_each_axis():
    source = PerturbedLattice(width=0.1, correlation=1.0)
    points = source.draw(64, realizations=2000, rng=3)
    grid = np.stack(np.meshgrid(*[np.arange(8) / 8] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    moves = (points - points[:, :1] - grid + 0.5) % 1.0 - 0.5  # relative to the first point
    relative = moves[:, 36]  # at half the torus the variance is 2 (c(0) − c(½, ½))
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
    ("n", "dims", "chi"),
    [(64, 1, 0.3), (64, 2, 0.1), (100, 2, 0.4), (200, 2, 0.45), (100, 3, 0.4), (20, 6, 0.4)],
)
def test_stealthy_sets_have_zero_power_at_the_constrained_frequencies_only(n, dims, chi):
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
    value, gradient = summed_power(m, points)
    assert abs(value - powers(points[None], m).sum()) < 1e-10
    ends = [powers(points[None] + s * h * direction, m).sum() for s in (1, -1)]
    assert abs((ends[0] - ends[1]) / (2 * h) - np.sum(gradient * direction)) < 1e-5


@pytest.mark.parametrize("n", [1, 2, 3])
def test_sets_too_small_for_any_constraint_are_random(n):
    sampler = StealthyHyperuniform(stealthiness=0.2)
    assert sampler.constrained(n).shape == (0, 2)
    assert sampler.draw(n, realizations=2, rng=1).shape == (2, n, 2)


def test_variance_of_a_smooth_function_vanishes():
    """cos 2π(x + 2y) has no frequency above K, so it is integrated exactly."""
    points = StealthyHyperuniform().draw(64, realizations=3, rng=1)
    means = np.cos(2 * np.pi * points @ [1, 2]).mean(axis=1)
    np.testing.assert_allclose(means, 0.0, atol=1e-11)


def test_sets_that_are_not_found_are_an_error():
    with pytest.raises(
        ParameterError, match=r"found no set of 16 points .* lower stealthiness .* raise"
    ):
        StealthyHyperuniform(iterations=2).draw(16, rng=1)


def closed_form_power(frequencies, k):
    """Return n⟨|S_k|²⟩: one minus the fraction of M that lies in M moved by k."""
    members = {tuple(m) for m in frequencies.tolist()}
    moved = sum(tuple(np.add(m, k)) in members for m in members)
    return 1 - moved / len(members)


@pytest.mark.parametrize(("n", "dims"), [(7, 1), (6, 2), (21, 2), (8, 3)])
def test_power_of_low_frequencies(n, dims):
    points = Determinantal(dims=dims).draw(n, realizations=3000, rng=n)
    k = [m for m in itertools.product(range(4), repeat=dims) if 0 < sum(m) <= 4][:10]
    sums = np.exp(2j * np.pi * points @ np.transpose(k)).sum(axis=1)
    frequencies = Determinantal(dims=dims).frequencies(n)
    assert_mean(np.abs(sums) ** 2 / n, [closed_form_power(frequencies, m) for m in k])


def test_density_of_pairs():
    """n² − |K|² of the difference of two points in 1-D, integrated over ten bins."""
    n, edges = 5, np.linspace(0, 1, 11)
    points = Determinantal(dims=1).draw(n, realizations=4000, rng=1)[..., 0]
    i, j = np.triu_indices(n, 1)
    differences = (points[:, i] - points[:, j]) % 1.0
    counts = np.stack([np.histogram(row, edges)[0] for row in differences])
    # |K(δ)|² = Σ over pairs of M of cos 2π(m − m')δ
    lags = Counter((np.subtract.outer(range(n), range(n))).ravel().tolist())
    integral = sum(
        c * (edges if lag == 0 else np.sin(2 * np.pi * lag * edges) / (2 * np.pi * lag))
        for lag, c in lags.items()
    )
    assert_mean(counts, (n**2 * np.diff(edges) - np.diff(integral)) / 2)


def test_moments_are_those_of_random_unitary_matrices():
    """1-D, odd n: eigenvalues of a Haar unitary U; E|tr U|^2j = j! for j ≤ n (Rains 1997)."""
    points = Determinantal(dims=1).draw(5, realizations=20_000, rng=3)[..., 0]
    trace = np.abs(np.exp(2j * np.pi * points).sum(axis=1))
    assert_mean(np.stack([trace**2, trace**4, trace**6], axis=1), [1.0, 2.0, 6.0])


def test_variance_of_the_disk():
    """Σ |f_k|² times the closed-form power, at three counts, and the fitted rate."""
    counts, radius = [9, 25, 81], 0.25
    f = mcs.integrand(f"disk(radius={radius})")
    d = mcs.convergence(mcs.Estimator(f), "determinantal", counts, realizations=300, rng=5)
    k = frequencies_within(60**2, 2)[1:]
    norm = np.linalg.norm(k, axis=1)
    energy = (radius * special.j1(2 * np.pi * radius * norm) / norm) ** 2
    area = np.pi * radius**2
    expected = []
    for n in counts:
        m = nearest_frequencies(n, 2)
        power = np.array(
            [closed_form_power(m, q) if q @ q <= 4 * m[-1] @ m[-1] else 1.0 for q in k]
        )
        beyond = area - area**2 - energy.sum()  # remaining energy, by Parseval's identity
        expected.append((energy @ power + beyond) / n)
    low, high = d["rate_ci"].values
    slope = np.polyfit(np.log(counts), np.log(expected), 1)[0]
    assert abs(float(d["rate"]) - slope) < SIGMAS * (high - low) / 2 / 1.96
    assert slope < -1.25  # toward −3/2 with a logarithm: Bardenet and Hardy, n^(−1−1/d)


def test_frequencies_have_the_smallest_norms():
    for n, dims in ((9, 2), (30, 3), (100, 2), (50, 7)):
        m = Determinantal(dims=dims).frequencies(n)
        assert m.shape == (n, dims)
        assert len(np.unique(m, axis=0)) == n
        norms = np.sum(m**2, axis=1)
        assert (np.diff(norms) >= 0).all()
        assert len(frequencies_within(int(norms[-1]) - 1, dims)) < n


def test_all_frequencies_within_a_ball():
    cube = [m for m in itertools.product(range(-4, 5), repeat=3) if np.dot(m, m) <= 14]
    np.testing.assert_array_equal(np.unique(frequencies_within(14, 3), axis=0), np.array(cube))


@pytest.mark.parametrize(
    ("most", "dims"), [(0, 2), (1, 2), (2, 2), (4, 2), (50, 2), (9, 1), (3, 3)]
)
def test_half_shells_are_whole(most, dims):
    half = half_shells(most, dims)
    assert len(half) <= most
    both = np.concatenate([half, -half, np.zeros((1, dims), int)])
    assert len(np.unique(both, axis=0)) == 2 * len(half) + 1
    radius = int(np.max(np.sum(half**2, axis=1), initial=0))
    assert len(frequencies_within(radius, dims)) == len(both)
    larger = radius + 1
    while len(frequencies_within(larger, dims)) == len(both):
        larger += 1
    assert (len(frequencies_within(larger, dims)) - 1) // 2 > most


def test_pairs_are_apart_in_sets_larger_than_a_batch_of_proposals():
    """Expected pairs nearer than r: ½ n² ∫ (1 − |K|²/n²) ≈ π² n³ r⁴/4 = 0.24; random points 15."""
    n, r, close = 200, 0.007, 0
    for points in Determinantal().draw(n, realizations=5, rng=6):
        delta = points[:, None] - points
        distance = np.linalg.norm(delta - np.round(delta), axis=-1)
        close += np.count_nonzero(distance[np.triu_indices(n, 1)] < r)
    assert close <= 5  # more pairs have probability 2e-7 (Poisson)
