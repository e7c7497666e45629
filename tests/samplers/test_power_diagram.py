"""Power diagrams on the torus: cells against SciPy's, lattices, derivatives; areas as wanted."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial import ConvexHull, HalfspaceIntersection, Voronoi

from mcspectra.samplers._power_diagram import power_diagram
from mcspectra.samplers._power_weights import balance

SHIFTS = np.array(list(itertools.product((-1, 0, 1), repeat=2)))


def random_sites(n, seed=0, spread=0.0):
    """Points, and weights that differ by up to `spread` / n."""
    rng = np.random.default_rng(seed)
    return rng.random((n, 2)), spread / n * rng.random(n)


def mean_over(polygon, f):
    """Area of a convex polygon, and ∫ f over it: exact for quadratics, by mid-edge points."""
    centre = polygon.mean(axis=0)
    order = np.argsort(np.arctan2(*(polygon - centre).T))
    polygon = polygon[order]
    area, integral = 0.0, 0.0
    for p, q in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        piece = abs(np.linalg.det([p - centre, q - centre])) / 2
        area += piece
        integral += piece / 3 * sum(f((u + v) / 2) for u, v in ((p, q), (q, centre), (centre, p)))
    return area, integral


def laplacian(diagram):
    """The faces as a dense matrix."""
    n = len(diagram.areas)
    matrix = np.zeros((n, n))
    for i, (start, end) in enumerate(diagram.rows):
        np.add.at(matrix[i], diagram.neighbors[start:end], -diagram.couplings[start:end])
        matrix[i, i] -= matrix[i].sum()
    return matrix


@pytest.mark.parametrize(("n", "seed"), [(2, 1), (3, 2), (5, 3), (40, 4), (300, 5)])
def test_voronoi_cells_are_those_of_nine_tiles(n, seed):
    points, weights = random_sites(n, seed)
    diagram = power_diagram(points, weights)
    tiles = Voronoi((points[None] + SHIFTS[:, None]).reshape(-1, 2))
    for i, x in enumerate(points):
        polygon = tiles.vertices[tiles.regions[tiles.point_region[4 * n + i]]] - x
        area, moment = mean_over(polygon, lambda u: u @ u)
        np.testing.assert_allclose(
            [diagram.areas[i], diagram.moments[i]], [area, moment], rtol=1e-9
        )
        for axis in (0, 1):
            first = mean_over(polygon, lambda u, axis=axis: u[axis])[1]
            assert abs(diagram.offsets[i, axis] - first / area) < 1e-12


@pytest.mark.parametrize(("n", "spread"), [(3, 0.3), (20, 1.0), (20, 5.0), (60, 2.0)])
def test_power_cells_are_intersections_of_half_planes(n, spread):
    points, weights = random_sites(n, 7, spread)
    diagram = power_diagram(points, weights)
    assert abs(diagram.areas.sum() - 1) < 1e-12
    for i in np.flatnonzero(diagram.areas > 1e-6):
        d = (points - points[i] + SHIFTS[:, None]).reshape(-1, 2)
        level = np.sum(d**2, axis=1) + weights[i] - np.tile(weights, 9)
        planes = np.column_stack([2 * d, -level])[np.any(d != 0, axis=1)]
        corners = HalfspaceIntersection(planes, diagram.offsets[i]).intersections
        assert abs(ConvexHull(corners).volume - diagram.areas[i]) < 1e-10


def test_cells_cover_the_torus_when_some_are_empty():
    points, weights = random_sites(50, 8)
    weights[:10] = -1.0
    diagram = power_diagram(points, weights)
    np.testing.assert_array_equal(diagram.areas[:10], 0.0)
    np.testing.assert_array_equal(diagram.rows[:10, 0], diagram.rows[:10, 1])
    rest = power_diagram(points[10:], weights[10:])
    np.testing.assert_allclose(diagram.areas[10:], rest.areas, rtol=1e-12)


def test_a_cell_may_have_very_many_neighbours():
    angles = 2 * np.pi * np.arange(200) / 200
    circle = 0.5 + 0.3 * np.column_stack([np.cos(angles), np.sin(angles)])
    diagram = power_diagram(np.vstack([circle, [[0.5, 0.5]]]), np.zeros(201))
    assert diagram.rows[200, 1] - diagram.rows[200, 0] == 200
    assert abs(diagram.areas[200] - 200 * 0.15**2 * np.tan(np.pi / 200)) < 1e-12


def second_moment(n, a):
    """Mean of |x|² over the Voronoi cell of the lattice of (i/n, ai/n), by Selling's parameters.

    With an obtuse superbase, p_ij = −v_i·v_j ≥ 0: Σ p / 12 + p_01 p_02 p_12 / (12 n^(−2)).
    """
    u, v = np.array([1, a]) / n, np.array([0.0, 1.0])
    while True:  # Gauss
        u, v = sorted((u, v), key=lambda w: w @ w)
        if not (k := np.rint(u @ v / (u @ u))):
            break
        v = v - k * u
    v = -v if u @ v > 0 else v
    p = [-(x @ y) for x, y in ((u, v), (u, -u - v), (v, -u - v))]
    assert min(p) >= -1e-15
    return sum(p) / 12 + np.prod(p) * n**2 / 12


def lattice(n, a):
    """Points of a lattice, away from the borders of buckets."""
    i = np.arange(n)
    return (np.column_stack([i / n, a * i % n / n]) + np.array([0.0123, 0.0456])) % 1.0


@pytest.mark.parametrize(("n", "a"), [(1, 0), (2, 1), (7, 2), (30, 11), (209, 56), (610, 377)])
def test_cells_of_lattices(n, a):
    diagram = power_diagram(lattice(n, a), np.full(n, 0.3))
    np.testing.assert_allclose(diagram.areas, 1 / n, rtol=1e-11)
    np.testing.assert_allclose(diagram.offsets, 0.0, atol=1e-14)
    np.testing.assert_allclose(diagram.moments, second_moment(n, a) / n, rtol=1e-11)


@pytest.mark.parametrize("n", [2, 5, 80])
def test_faces_are_the_derivatives_of_the_areas(n):
    points, weights = random_sites(n, 9, 0.2)
    matrix = laplacian(power_diagram(points, weights))
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    h = 1e-6 / n
    for i in range(0, n, 7):
        step = h * (np.arange(n) == i)
        ends = [power_diagram(points, weights + s * step).areas for s in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h), matrix[i], atol=1e-6)


def test_diagram_moves_with_its_sites():
    points, weights = random_sites(100, 10, 1.0)
    diagram = power_diagram(points, weights)
    moved = power_diagram((points + np.array([0.37, 0.81])) % 1.0, weights)
    np.testing.assert_allclose(moved.areas, diagram.areas, atol=1e-14)
    np.testing.assert_allclose(moved.offsets, diagram.offsets, atol=1e-12)


@pytest.mark.parametrize(("n", "seed"), [(1, 0), (2, 1), (10, 2), (1000, 3)])
def test_balanced_cells_have_the_areas_wanted(n, seed):
    points, _ = random_sites(n, seed)
    masses = np.random.default_rng(n).uniform(0.5, 1.5, n)
    masses /= masses.sum()
    weights, diagram = balance(points, np.zeros(n), masses, 1e-9, 100)
    np.testing.assert_allclose(power_diagram(points, weights).areas, masses, rtol=1e-9)
    np.testing.assert_array_equal(power_diagram(points, weights).moments, diagram.moments)


def test_balance_starts_again_when_the_weights_leave_a_cell_empty():
    points, weights = random_sites(30, 4)
    weights[0] = -1.0
    masses = np.full(30, 1 / 30)
    again = balance(points, weights, masses, 1e-9, 100)[0]
    np.testing.assert_array_equal(again, balance(points, np.zeros(30), masses, 1e-9, 100)[0])
    assert weights[0] == -1.0
