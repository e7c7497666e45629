"""Pair correlation: counts, borders, exact forms, chunks, input."""

import numpy as np
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.core.analysis import Subject
from mcspectra.spectra.pairs import PairCorrelation, count_pairs
from mcspectra.testing import check_analysis


def some_points(n, dims):
    """Return random points, and a few whose distances are exactly ½ along the axes."""
    points = np.random.default_rng(dims).random((n, dims))
    points[: n // 4] = np.round(points[: n // 4] * 8) / 8 % 1
    return points


@pytest.mark.parametrize("dims", [1, 2, 3])
@pytest.mark.parametrize("most", [0.9, 0.5, 0.1, 0.01])
def test_all_pairs_are_counted_once(dims, most):
    x, bins = some_points(200, dims), 37
    delta = np.abs(x[:, None] - x)
    distance = np.sqrt((np.minimum(delta, 1 - delta) ** 2).sum(axis=-1))
    place = (distance[np.triu_indices(200, 1)] * (bins / most)).astype(int)
    expected = np.bincount(place[place < bins], minlength=bins)
    found = count_pairs(x, np.linspace(0, most, bins + 1), wrap=True)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("n", [512, 513, 514, 1027, 1300])
@pytest.mark.parametrize("wrap", [True, False])
def test_more_neighbors_than_a_chunk_holds(n, wrap):
    """Every point has up to n − 1 neighbors, which are counted 512 at a time."""
    x, bins = some_points(n, 2), 50
    delta = np.abs(x[:, None] - x)
    if wrap:
        delta = np.minimum(delta, 1 - delta)
    place = (np.sqrt((delta**2).sum(axis=-1)) * (bins / 0.49)).astype(int)
    np.fill_diagonal(place, bins)
    room = np.minimum(x, 1 - x).min(axis=1)[:, None]
    seen = (place < bins) & (wrap | (np.linspace(0, 0.49, bins + 1)[1:][place % bins] <= room))
    expected = np.bincount(place[seen], minlength=bins) // (2 if wrap else 1)
    found = count_pairs(x, np.linspace(0, 0.49, bins + 1), wrap=wrap)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_points_count_distances_up_to_the_border(dims):
    x, bins, most = some_points(200, dims), 20, 0.3
    edges = np.linspace(0, most, bins + 1)
    distance = np.sqrt(((x[:, None] - x) ** 2).sum(axis=-1))
    room = np.minimum(x, 1 - x).min(axis=1)
    expected = np.zeros(bins)
    for a in range(200):
        for b in range(200):
            place = int(distance[a, b] * (bins / most))
            if a != b and place < bins:
                expected[place] += room[a] >= edges[place + 1]
    np.testing.assert_array_equal(count_pairs(x, edges, wrap=False), expected)


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_border_correction_is_unbiased_for_random_points(dims):
    d = mcs.pair_correlation(
        mcs.sampler("random", dims=dims), 100, bins=10, realizations=200, boundary="border", rng=4
    )
    pull = (d["pair_correlation"] - 1) / d["pair_correlation_se"]
    assert np.abs(pull).max() < 5  # 10 bins, 199 degrees of freedom: 1e-5
    assert d.attrs["boundary"] == "border"


def test_both_boundaries_agree_for_stationary_sets():
    """Away from the border, a toroidal set behaves like a bounded set."""
    both = [
        mcs.pair_correlation(
            "poisson-disk",
            64,
            bins=16,
            realizations=300,
            boundary=boundary,
            max_distance=0.2,
            rng=seed,
        )
        for seed, boundary in enumerate(("toroidal", "border"))
    ]
    difference = both[0]["pair_correlation"] - both[1]["pair_correlation"]
    se = np.hypot(both[0]["pair_correlation_se"], both[1]["pair_correlation_se"])
    assert (np.abs(difference) <= 5 * se + 1e-12).all()


@pytest.mark.parametrize(
    ("spec", "n"),
    [
        ("jittered(dims=1)", 6),
        ("jittered", 16),
        ("jittered(sides=[2, 6])", 12),
        ("jittered(sides=[8, 1])", 8),
        ("jittered(sides=[1, 5])", 5),
    ],
)
def test_jittered_against_the_exact_form(spec, n):
    bins = 25
    d = mcs.pair_correlation(spec, n, bins=bins, realizations=4000, rng=2)
    dims = mcs.sampler(spec).dims
    r = (np.arange(bins * 64) + 0.5) / (bins * 128)
    weight = r ** (dims - 1)
    exact = mcs.spectra.closed_form_pair_correlation(spec, n, r)
    mean = (exact * weight).reshape(bins, 64).sum(axis=1) / weight.reshape(bins, 64).sum(axis=1)
    pull = np.abs(d["pair_correlation"] - mean) / d["pair_correlation_se"]
    assert pull.max() < 5


def test_exact_form_of_jittered_is_the_mean_over_directions():
    angle = (np.arange(200_000) + 0.5) * (np.pi / 400_000)
    for r in (0.05, 0.2, 0.3, 0.45):
        a, b = 2 * r * np.cos(angle), 6 * r * np.sin(angle)
        shared = (np.maximum(0, 1 - a) * np.maximum(0, 1 - b)).mean()
        found = mcs.spectra.closed_form_pair_correlation("jittered(sides=[2, 6])", 12, r)
        np.testing.assert_allclose(found, 12 / 11 * (1 - shared), rtol=1e-8)


@pytest.mark.parametrize(("sides", "n"), [([8, 1], 8), ([1, 5], 5)])
def test_an_axis_of_one_cell_is_always_shared(sides, n):
    """(2/π) ∫ max(0, 1 − n r sin θ) dθ over a quarter turn; the whole quarter up to r = 1/n."""
    r = np.array([0.0, 0.3 / n, 0.9 / n])
    found = mcs.spectra.closed_form_pair_correlation(f"jittered(sides={sides})", n, r)
    np.testing.assert_allclose(found, n / (n - 1) * n * r * 2 / np.pi, atol=1e-12)


def test_random_points_have_g_of_one():
    d = mcs.pair_correlation(mcs.sampler("random", dims=3), 200, bins=20, realizations=40, rng=1)
    assert d["pair_correlation"].dims == ("r",)
    pull = (d["pair_correlation"] - 1) / d["pair_correlation_se"]
    # 20 bins; t with 39 degrees of freedom: 6 σ has probability 5e-7
    assert np.abs(pull).max() < 6


@pytest.mark.parametrize("boundary", ["toroidal", "border"])
def test_chunks_and_threads_change_nothing(boundary):
    check_analysis(PairCorrelation(n=16, bins=7, realizations=11, boundary=boundary))
    found = [
        mcs.pair_correlation(
            "jittered", 16, bins=7, realizations=11, rng=2, boundary=boundary, workers=workers
        )
        for workers in (1, 2)
    ]
    xr.testing.assert_identical(*found)
    assert float(found[0]["pair_correlation_se"].max()) > 0


def test_cost_grows_with_the_pairs():
    random = Subject(None, mcs.sampler("random", dims=2))
    costs = [PairCorrelation(n=n, realizations=3).need(random).cost for n in (10, 1000)]
    assert costs == [3 * (10 + 0.1 * 10**2), 3 * (1000 + 0.1 * 1000**2)]


def test_intervals_cover_the_level_of_random_points():
    """4 realizations, 3 degrees of freedom: 95 % of 60 · 20 independent bins are covered."""
    inside = []
    for seed in range(60):
        d = mcs.pair_correlation("random", 256, bins=20, realizations=4, rng=seed)
        low, high = d["pair_correlation_ci"].values.T
        inside.append((low <= 1) & (high >= 1))
    # Counts of the first bins are few and skew: allow 4 binomial sigma below 93 %
    assert 0.93 - 4 * np.sqrt(0.07 / 1200) < np.mean(inside) < 0.99
