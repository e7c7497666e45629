"""Distances: grids, the densest packings, brute force."""

import itertools
import math

import numpy as np
import pytest

from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.quality import best_minimum_distance, nearest_distances
from mcspectra.quality.distances import relative_minimum_distance


def grid(side, dims):
    return np.array(list(itertools.product(range(side), repeat=dims))) / side


def brute_force(x):
    steps = np.abs(x[:, None] - x[None])
    lengths = np.sqrt((np.minimum(steps, 1 - steps) ** 2).sum(-1))
    np.fill_diagonal(lengths, np.inf)
    return lengths.min(1)


@pytest.mark.parametrize(("side", "dims"), [(8, 1), (4, 2), (3, 3), (2, 7)])
def test_a_grid_is_as_wide_as_its_cells(side, dims):
    np.testing.assert_allclose(nearest_distances(grid(side, dims)), 1 / side, rtol=1e-14)


@pytest.mark.parametrize("dims", [1, 2, 3, 6, 7, 9])
def test_brute_force_finds_the_same(dims):
    x = np.random.default_rng(dims).random((50, dims))
    np.testing.assert_allclose(nearest_distances(x), brute_force(x), rtol=1e-12)


def test_neighbours_across_the_border_count():
    np.testing.assert_allclose(nearest_distances([[0.05, 0.5], [0.95, 0.5]]), [0.1, 0.1])


def test_points_at_the_same_place_are_0_apart():
    assert nearest_distances([[0.3, 0.7], [0.3, 0.7], [0.1, 0.1]])[:2].tolist() == [0.0, 0.0]


def fcc():
    return np.array([[0, 0, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0]])


def e8():
    """E8 modulo (2Z)^8: coordinates all whole or all half, with even sum."""
    whole = np.array(list(itertools.product((0.0, 1.0), repeat=8)))
    points = np.concatenate([whole, whole + 0.5])
    return points[points.sum(1) % 2 == 0] / 2


@pytest.mark.parametrize("points", [grid(16, 1), fcc(), e8()], ids=["1-D", "fcc", "E8"])
def test_the_densest_packings_are_the_best_possible(points):
    assert relative_minimum_distance(points) == pytest.approx(1.0, rel=1e-12)


def test_a_nearly_hexagonal_lattice_is_nearly_the_best_possible():
    rows, columns = 8, 7  # 8 rows of 7: rows 1/8 apart, √3/2 · 1/7 = 0.1237 would be hexagonal
    points = np.array(
        [((i + 0.5 * (j % 2)) / columns, j / rows) for j in range(8) for i in range(7)]
    )
    distance = math.hypot(0.5 / columns, 1 / rows)
    best = math.sqrt(2 / (math.sqrt(3) * 56))
    assert relative_minimum_distance(points) == pytest.approx(min(distance, 1 / 7) / best)
    assert 0.98 < relative_minimum_distance(points) < 1


def test_no_set_is_better_than_the_best():
    rng = np.random.default_rng(1)
    for dims, n in itertools.product((1, 2, 3, 8), (2, 3, 8)):
        assert relative_minimum_distance(rng.random((n, dims))) <= 1


def test_own_images_count_for_the_best_distance():
    # Two points of the 8-D torus can be √2 apart, but are 1 from their own images.
    assert relative_minimum_distance([[0.0] * 8, [0.5] * 8]) == 1 / best_minimum_distance(2, 8)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([[0.5, 0.5]], "at least two"),
        (np.zeros((2, 3, 2)), "one set"),
        (np.full((12000, 7), 0.5), "too many"),
        (np.full((2**21 + 1, 1), 0.5), "too many"),
    ],
)
def test_sets_that_have_no_neighbours_or_too_many(points, words):
    with pytest.raises(ParameterError, match=words):
        nearest_distances(points)


def test_unknown_packings_and_points_outside_are_refused():
    with pytest.raises(ParameterError, match="1, 2, 3, 8, 24"):
        best_minimum_distance(4, 5)
    with pytest.raises(ParameterError, match="n is 0"):
        best_minimum_distance(0, 2)
    with pytest.raises(DomainError, match="NaN"):
        nearest_distances([[0.5], [np.nan]])
