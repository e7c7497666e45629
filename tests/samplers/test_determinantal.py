"""Determinantal sets: power, pairs and moments of any order against closed forms."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np
import pytest
from scipy import special, stats

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.samplers import Determinantal
from mcspectra.samplers._shells import frequencies_within, half_shells, nearest_frequencies

LEVEL = 1 - (1 - 1e-6) ** (1 / 64)  # Šidák: fewer than 64 statistical comparisons in this file
SIGMAS = stats.norm.isf(LEVEL / 2)


def closed_form_power(frequencies, k):
    """n⟨|S_k|²⟩: one less the part of M that lies in M moved by k."""
    members = {tuple(m) for m in frequencies.tolist()}
    moved = sum(tuple(np.add(m, k)) in members for m in members)
    return 1 - moved / len(members)


def assert_mean(values, expected):
    """Mean over the first axis within SIGMAS standard errors."""
    error = np.std(values, axis=0, ddof=1) / np.sqrt(len(values))
    np.testing.assert_array_less(np.abs(values.mean(axis=0) - expected), SIGMAS * error + 1e-12)


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
    """Σ |f_k|² times the closed form of the power, at three counts, and so the fitted rate."""
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
        beyond = area - area**2 - energy.sum()  # Parseval
        expected.append((energy @ power + beyond) / n)
    low, high = d["rate_ci"].values
    slope = np.polyfit(np.log(counts), np.log(expected), 1)[0]
    assert abs(float(d["rate"]) - slope) < SIGMAS * (high - low) / 2 / 1.96
    assert slope < -1.25  # towards −3/2 with a logarithm: Bardenet and Hardy, n^(−1−1/d)


def test_frequencies_are_those_of_least_norm():
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
    """Pairs nearer than r: ½ n² ∫ (1 − |K|²/n²) ≈ π² n³ r⁴/4, here 0.24 in all; at random, 15."""
    n, r, close = 200, 0.007, 0
    for points in Determinantal().draw(n, realizations=5, rng=6):
        delta = points[:, None] - points
        distance = np.linalg.norm(delta - np.round(delta), axis=-1)
        close += np.count_nonzero(distance[np.triu_indices(n, 1)] < r)
    assert close <= 5  # Poisson: more has probability 2e-7


def test_huge_counts_are_refused():
    with pytest.raises(CountError, match="makes at most 4096 points"):
        Determinantal().draw(2**20)
    assert Determinantal().nearest_count(2**31) == 4096


@pytest.mark.parametrize("dims", [0, 65, 1.5, "x", True, float("nan")])
def test_impossible_dims(dims):
    with pytest.raises(ParameterError, match=r"determinantal: dims is .*; give a whole number"):
        Determinantal(dims=dims)
