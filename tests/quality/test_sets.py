"""Figures of one set, compared with hand calculation, brute force, SciPy and Fourier series."""

import itertools
import math
import time

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import qmc

from mcspectra import sampler
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.quality import (
    best_minimum_distance,
    diaphony,
    generalized_l2_discrepancy,
    l2_discrepancy,
    nearest_distances,
    relative_minimum_distance,
    star_discrepancy,
)


def grid(side, dims):
    return np.array(list(itertools.product(range(side), repeat=dims))) / side


def brute_force(x):
    steps = np.abs(x[:, None] - x[None])
    lengths = np.sqrt((np.minimum(steps, 1 - steps) ** 2).sum(-1))
    np.fill_diagonal(lengths, np.inf)
    return lengths.min(1)


@pytest.mark.parametrize(("side", "dims"), [(8, 1), (4, 2), (3, 3), (2, 7)])
def test_points_of_a_grid_have_the_distance_of_cells(side, dims):
    np.testing.assert_allclose(nearest_distances(grid(side, dims)), 1 / side, rtol=1e-14)


@pytest.mark.parametrize("dims", [1, 2, 3, 6, 7, 9])
def test_distances_agree_with_brute_force(dims):
    x = np.random.default_rng(dims).random((50, dims))
    np.testing.assert_allclose(nearest_distances(x), brute_force(x), rtol=1e-12)


def test_distances_are_periodic():
    np.testing.assert_allclose(nearest_distances([[0.05, 0.5], [0.95, 0.5]]), [0.1, 0.1])


def test_equal_points_have_distance_0():
    assert nearest_distances([[0.3, 0.7], [0.3, 0.7], [0.1, 0.1]])[:2].tolist() == [0.0, 0.0]


N = 64_000
RNG = np.random.default_rng(5)
COORDINATES = RNG.random((N, 2))
CROWDED = {
    "equal": np.full((N, 2), 0.3),
    "collinear": np.column_stack([np.full(N, 0.3), COORDINATES[:, 0]]),
    "diagonal": np.repeat(COORDINATES[:, :1], 6, axis=1),
    "repeated": COORDINATES[: N // 100].repeat(100, axis=0),
    "few cells": np.floor(16 * COORDINATES) / 16 + 1e-15 * COORDINATES[::-1],
    "lattice": np.floor(8 * COORDINATES) / 8,
    "subnormal": COORDINATES * 1e-310,
    "squares underflow": COORDINATES * 1e-160,
}


@pytest.mark.parametrize("kind", CROWDED)
def test_distances_of_equal_points_are_fast(kind):
    """A tree without a test for duplicates took 45 s for 64,000 equal points."""
    points = CROWDED[kind]
    begun = time.process_time()
    distances = nearest_distances(points)
    assert time.process_time() - begun < 10
    places, index, counts = np.unique(points, axis=0, return_inverse=True, return_counts=True)
    assert (distances[counts[index] > 1] == 0).all()
    if places.max() > 1e-100:
        assert (distances[counts[index] == 1] > 0).all()
        some = np.flatnonzero(counts[index] == 1)[:20]
        steps = np.abs(points[some, None] - points[None])
        lengths = np.sqrt((np.minimum(steps, 1 - steps) ** 2).sum(-1))
        lengths[np.arange(len(some)), some] = np.inf
        np.testing.assert_allclose(distances[some], lengths.min(1), rtol=1e-9)


@pytest.mark.parametrize(
    "spec",
    ["random", "jittered", "dart-throwing", "rank1-lattice", "sobol", "regular", "random(dims=6)"],
)
def test_distances_of_distinct_points_agree_with_a_tree(spec):
    points = sampler(spec).draw(1024, rng=1)[0]
    tree = cKDTree(points, boxsize=np.ones(points.shape[1]))
    assert nearest_distances(points).tobytes() == tree.query(points, k=2)[0][:, 1].tobytes()


def fcc():
    return np.array([[0, 0, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0]])


def e8():
    """Return E8 modulo (2Z)^8: coordinates are all integers or all half-integers, with even sum."""
    whole = np.array(list(itertools.product((0.0, 1.0), repeat=8)))
    points = np.concatenate([whole, whole + 0.5])
    return points[points.sum(1) % 2 == 0] / 2


@pytest.mark.parametrize("points", [grid(16, 1), fcc(), e8()], ids=["1-D", "fcc", "E8"])
def test_the_densest_packings_reach_the_bound(points):
    assert relative_minimum_distance(points) == pytest.approx(1.0, rel=1e-12)


def test_a_nearly_hexagonal_lattice_is_near_the_bound():
    rows, columns = 8, 7  # row distance 1/8; √3/2 · 1/7 = 0.1237 would be hexagonal
    points = np.array(
        [((i + 0.5 * (j % 2)) / columns, j / rows) for j in range(8) for i in range(7)]
    )
    distance = math.hypot(0.5 / columns, 1 / rows)
    best = math.sqrt(2 / (math.sqrt(3) * 56))
    assert relative_minimum_distance(points) == pytest.approx(min(distance, 1 / 7) / best)
    assert 0.98 < relative_minimum_distance(points) < 1


def test_periodic_images_limit_the_minimum_distance():
    # Two points of the 8-D torus can have distance √2, but their own images have distance 1.
    assert relative_minimum_distance([[0.0] * 8, [0.5] * 8]) == 1 / best_minimum_distance(2, 8)


def brute_force_star(x):
    """Try every closed and open box with a corner on the grid of coordinates."""
    worst = 0.0
    for corner in itertools.product(*[[*x[:, k], 1.0] for k in range(x.shape[1])]):
        volume = math.prod(corner)
        closed = np.mean((x <= corner).all(1))
        opened = np.mean((x < corner).all(1))
        worst = max(worst, closed - volume, volume - opened)
    return worst


@pytest.mark.parametrize("dims", [1, 2])
@pytest.mark.parametrize("n", [1, 2, 5, 12])
def test_star_discrepancy_agrees_with_the_worst_box(n, dims):
    rng = np.random.default_rng(10 * n + dims)
    for _ in range(10):
        x = rng.random((n, dims))
        assert star_discrepancy(x) == pytest.approx(brute_force_star(x), rel=1e-12)
        ties = np.floor(4 * x) / 4  # many equal coordinates and some equal points
        assert star_discrepancy(ties) == pytest.approx(brute_force_star(ties), rel=1e-12)


@pytest.mark.parametrize(
    ("points", "value"),
    [([[0.5]], 0.5), ([[0.0]], 1.0), ([[0.5, 0.5]], 0.75), ([[0.0, 0.0]], 1.0)],
)
def test_star_discrepancy_of_one_point(points, value):
    assert star_discrepancy(points) == value


def test_star_discrepancy_of_centered_and_van_der_corput_points():
    n = 64
    assert star_discrepancy((np.arange(n)[:, None] + 0.5) / n) == pytest.approx(0.5 / n)
    assert star_discrepancy(sampler("van-der-corput", 1).draw(n)[0]) == pytest.approx(1 / n)


def test_star_discrepancy_does_not_depend_on_the_order_of_points():
    x = np.random.default_rng(3).random((100, 2))
    assert star_discrepancy(x[::-1]) == star_discrepancy(x)
    assert star_discrepancy(x[:, ::-1]) == pytest.approx(star_discrepancy(x), rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "name", "power"),
    [("star", "L2-star", 1), ("centered", "CD", 2), ("wraparound", "WD", 2), ("mixture", "MD", 2)],
)
def test_l2_discrepancies_agree_with_scipy(kind, name, power):
    x = np.random.default_rng(5).random((40, 3))
    assert l2_discrepancy(x, kind) ** power == pytest.approx(qmc.discrepancy(x, method=name))


@pytest.mark.parametrize("x", [0.0, 0.3, 0.5, 0.9])
def test_l2_discrepancies_of_one_point_on_a_line(x):
    # star: ∫_0^x t² + ∫_x^1 (1 − t)²; centered: 13/12 − 2(1 + z/2 − z²/2) + 1 + z, z = |x − 1/2|
    z = abs(x - 0.5)
    assert l2_discrepancy([[x]]) == pytest.approx(math.sqrt((x**3 + (1 - x) ** 3) / 3))
    assert l2_discrepancy([[x]], "centered") == pytest.approx(math.sqrt(1 / 12 + z * z))


@pytest.mark.parametrize("dims", [1, 2, 4])
def test_generalized_l2_discrepancy_sums_all_projections(dims):
    x = np.random.default_rng(dims).random((30, dims))
    axes = [c for k in range(dims) for c in itertools.combinations(range(dims), k + 1)]
    squares = sum(l2_discrepancy(x[:, list(chosen)]) ** 2 for chosen in axes)
    assert generalized_l2_discrepancy(x) == pytest.approx(math.sqrt(squares), rel=1e-10)


@pytest.mark.parametrize(("side", "dims"), [(1, 1), (16, 1), (4, 2), (3, 3)])
def test_diaphony_of_a_grid(side, dims):
    # Only multiples of the grid's frequency contribute: (1 + π²/(3 s²))^d − 1.
    expected = math.sqrt((1 + math.pi**2 / (3 * side**2)) ** dims - 1)
    assert diaphony(grid(side, dims)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("dims", [1, 2])
def test_diaphony_agrees_with_its_fourier_series(dims):
    x = np.random.default_rng(dims).random((9, dims))
    limit = 500
    axis = np.arange(-limit, limit + 1)
    m = np.stack(np.meshgrid(*[axis] * dims, indexing="ij"), -1)
    phases = [np.exp(2j * np.pi * np.multiply.outer(x[:, k], axis)) for k in range(dims)]
    product = phases[0].T if dims == 1 else np.einsum("na,nb->abn", *phases)
    power = np.abs(product.mean(-1)) ** 2
    terms = power / np.prod(np.maximum(1.0, np.abs(m)) ** 2, axis=-1)
    series = float(terms.sum() - 1.0)
    # Frequencies with a component beyond the limit add less than d · 2/limit · (1 + π²/3)^(d−1).
    left_out = dims * 2 / limit * (1 + math.pi**2 / 3) ** (dims - 1)
    assert series <= diaphony(x) ** 2 <= series + left_out
    assert left_out < 0.1 * series


def test_diaphony_is_invariant_under_translations():
    x = np.random.default_rng(8).random((30, 3))
    assert diaphony((x + np.array([0.3, 0.8, 0.1])) % 1) == pytest.approx(diaphony(x), rel=1e-10)


def test_mean_square_of_the_diaphony_of_random_points():
    n, sets = 16, 400
    squares = [diaphony(x) ** 2 for x in sampler("random", 2).draw(n, realizations=sets, rng=4)]
    expected = ((1 + math.pi**2 / 3) ** 2 - 1) / n
    error = np.std(squares, ddof=1) / math.sqrt(sets)
    assert abs(np.mean(squares) - expected) < 5 * error


@pytest.mark.parametrize(
    ("figure", "points", "words"),
    [
        (star_discrepancy, np.full((4, 3), 0.5), "1 and 2 dims only, not in 3"),
        (star_discrepancy, np.full((2**14 + 1, 2), 0.5), "give at most 16384"),
        (star_discrepancy, np.full((2, 4, 2), 0.5), "one set"),
        (star_discrepancy, [[1.0]], r"\[0,1\)"),
        (diaphony, np.full((8193, 2), 0.5), "give at most 8192"),
        (generalized_l2_discrepancy, np.full((8193, 2), 0.5), "give at most 8192"),
        (l2_discrepancy, np.full((8193, 2), 0.5), "give at most 8192"),
        (nearest_distances, [[0.5, 0.5]], "at least two"),
        (nearest_distances, np.full((12000, 7), 0.5), "too many"),
        (nearest_distances, np.full((2**21 + 1, 1), 0.5), "too many"),
    ],
)
def test_invalid_sets_give_an_error(figure, points, words):
    with pytest.raises(ParameterError, match=words):
        figure(points)


def test_unknown_kinds_and_packings_and_outside_points_give_errors():
    with pytest.raises(ParameterError, match="centered"):
        l2_discrepancy([[0.5]], "centred")
    with pytest.raises(ParameterError, match="1, 2, 3, 8, 24"):
        best_minimum_distance(4, 5)
    with pytest.raises(ParameterError, match="n is 0"):
        best_minimum_distance(0, 2)
    with pytest.raises(DomainError, match="NaN"):
        nearest_distances([[0.5], [np.nan]])
