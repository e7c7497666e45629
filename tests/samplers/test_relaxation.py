"""Relaxed points: cells and energies against slow references, results, transport cost."""

import itertools
import time

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial import ConvexHull, HalfspaceIntersection, Voronoi, cKDTree
from tests.samplers.test_poisson import clearances, nearest

import mcspectra as mcs
from mcspectra.core.errors import DomainError
from mcspectra.core.streams import Stream
from mcspectra.samplers import Bnot, FarthestPoint, GaussianBlueNoise, Lloyd, transport_cost
from mcspectra.samplers import _cell_kernels as kernels
from mcspectra.samplers._cell_kernels import balance, power_diagram
from mcspectra.samplers.poisson import densest_distance
from mcspectra.samplers.relaxation import near_energy, relax, series_energy

ROUNDING = 1e-12


SHIFTS = np.array(list(itertools.product((-1, 0, 1), repeat=2)))


def random_sites(n, seed=0, spread=0.0):
    """Return points, and weights that differ by up to `spread` / n."""
    rng = np.random.default_rng(seed)
    return rng.random((n, 2)), spread / n * rng.random(n)


def mean_over(polygon, f):
    """Area of a convex polygon, and ∫ f over it by midpoints of edges (exact to quadratics)."""
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
    """Return the faces as a dense matrix."""
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


def test_a_cell_may_have_very_many_neighbors():
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
    while True:  # Gauss's reduction of the basis
        u, v = sorted((u, v), key=lambda w: w @ w)
        if not (k := np.rint(u @ v / (u @ u))):
            break
        v = v - k * u
    v = -v if u @ v > 0 else v
    p = [-(x @ y) for x, y in ((u, v), (u, -u - v), (v, -u - v))]
    assert min(p) >= -1e-15
    return sum(p) / 12 + np.prod(p) * n**2 / 12


def lattice(n, a):
    """Return points of a lattice, away from the borders of buckets."""
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


def test_the_diagram_is_translated_with_its_sites():
    points, weights = random_sites(100, 10, 1.0)
    diagram = power_diagram(points, weights)
    moved = power_diagram((points + np.array([0.37, 0.81])) % 1.0, weights)
    np.testing.assert_allclose(moved.areas, diagram.areas, atol=1e-14)
    np.testing.assert_allclose(moved.offsets, diagram.offsets, atol=1e-12)


@pytest.mark.parametrize(("n", "seed"), [(1, 0), (2, 1), (10, 2), (1000, 3)])
def test_balanced_cells_have_the_requested_areas(n, seed):
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


N, SETS = 1024, 12
HEXAGONAL = 5 / (18 * np.sqrt(3))


@pytest.fixture(scope="module")
def sets():
    return Bnot().draw(N, realizations=SETS, rng=3)


def balanced(points):
    n = len(points)
    return balance(points, np.zeros(n), np.full(n, 1 / n), 1e-9, 100)[1]


def test_bnot_ends_with_equal_areas_around_their_centroids(sets):
    for points in sets[:4]:
        diagram = balanced(points)
        np.testing.assert_allclose(diagram.areas, 1 / N, rtol=1e-6)
        # The sampler's own cells, of equal areas to 1e-3, had centroids within the tolerance
        distance = np.sqrt(np.sum(diagram.offsets**2))
        assert distance < Bnot().tolerance + 1e-3


def test_bnot_keeps_points_apart(sets):
    """Published: minimum distances above 0.7 of the hexagonal lattice's (here 0.77 ± 0.014)."""
    densest = np.sqrt(2 / (np.sqrt(3) * N))
    for points in sets:
        nearest = cKDTree(points, boxsize=1.0).query(points, k=2)[0][:, 1]
        assert nearest.min() > 0.7 * densest


def test_bnot_has_a_blue_noise_spectrum(sets):
    """Almost no power up to 0.6 √n, and a ring at the peaks of the hexagonal lattice.

    The published radial means are below 0.03 there. At one frequency the mean of the sets is
    Gamma-distributed: more than 0.12 happens with probability below
    exp(−12 (4 − 1 − ln 4)) < 1e-8.
    """
    spectrum = mcs.power_spectrum(Bnot(), N, realizations=SETS, rng=3, half_width=48)
    p = N * spectrum["power"].values
    m = np.arange(-48, 49)
    radius = np.hypot(*np.meshgrid(m, m, indexing="ij")) / np.sqrt(N)
    low = (radius > 0) & (radius < 0.6)
    assert p[low].mean() < 0.03
    assert p[low].max() < 0.12
    ring = np.round(radius * 20).astype(int)
    means = np.bincount(ring.ravel(), p.ravel()) / np.bincount(ring.ravel())
    peak = 1 + means[1:28].argmax()
    assert abs(peak / 20 - np.sqrt(2 / np.sqrt(3))) < 0.1
    assert 2.0 < means[peak] < 5.0  # crystals would have far higher peaks


def test_cost_falls_to_that_of_the_hexagonal_lattice_but_not_below(sets):
    costs = [N * transport_cost(points) for points in sets[:3]]
    assert min(costs) > HEXAGONAL
    assert max(costs) < 1.05 * HEXAGONAL
    assert N * transport_cost(Bnot(tolerance=0.05).draw(N, rng=3)[0]) > max(costs)


@pytest.mark.parametrize("n", [1, 2, 3, 7])
@pytest.mark.parametrize(
    "sampler", [Lloyd(tolerance=1e-6, iterations=10_000), Bnot(tolerance=1e-6)]
)
def test_few_points(sampler, n):
    for points in sampler.draw(n, realizations=3, rng=1):
        diagram = balanced(points) if sampler.name == "bnot" else power_diagram(points, np.zeros(n))
        assert np.sqrt(np.sum(diagram.offsets**2)) < 1e-3  # areas are equal within 1e-3


def test_lloyd_brings_points_nearer_to_the_centroids_of_their_cells():
    distances = []
    for iterations in (1, 5, 25, 125):
        points = Lloyd(iterations=iterations).draw(256, rng=2)[0]
        distances.append(np.sum(power_diagram(points, np.zeros(256)).offsets ** 2))
    assert sorted(distances, reverse=True) == distances
    assert distances[-1] < 1e-2 * distances[0]


def test_lloyd_never_raises_the_mean_square_distance_to_the_nearest_point():
    points = np.random.default_rng(6).random((200, 2))
    energies = []
    for _ in range(30):
        diagram = power_diagram(points, np.zeros(200))
        energies.append(diagram.moments.sum())
        points = relax(points, lambda x: cells(x).offsets, 1, 0.0, lambda fraction: None)
    assert all(a > b for a, b in itertools.pairwise(energies))


def cells(points):
    return power_diagram(points, np.zeros(len(points)))


def test_points_close_to_their_centroids_are_not_moved():
    points = Lloyd(tolerance=0.05).draw(100, rng=4)[0]
    assert np.sqrt(np.sum(cells(points).offsets ** 2)) <= 0.05
    before = Lloyd(iterations=3).draw(100, rng=4)[0]
    assert np.sqrt(np.sum(cells(before).offsets ** 2)) > 0.05


@pytest.mark.parametrize("method", [cells, balanced])
def test_results_are_translated_with_the_start(method):
    """Hence every point is uniform. Rounding errors grow little in ten steps."""
    start, offset = np.random.default_rng(5).random((64, 2)), np.array([0.31, 0.77])
    ends = [
        relax(x, lambda points: method(points).offsets, 10, 0.0, lambda fraction: None)
        for x in (start, (start + offset) % 1.0)
    ]
    difference = ends[1] - ends[0] - offset
    np.testing.assert_allclose(difference - np.rint(difference), 0.0, atol=1e-6)


def test_progress_is_reported():
    fractions = []
    Lloyd(iterations=20)._optimize(16, np.array([1, 2], np.uint64), fractions.append)
    assert fractions == [i / 20 for i in range(20)]


@pytest.mark.parametrize("side", [1, 2, 5, 16])
def test_transport_cost_of_a_square_grid(side):
    grid = (np.stack(np.meshgrid(*2 * [np.arange(side)]), axis=-1).reshape(-1, 2) + 0.3) / side
    assert abs(transport_cost(grid) * 6 * side**2 - 1) < 1e-12


@pytest.mark.parametrize(("n", "a"), [(7, 2), (30, 11), (209, 56)])
def test_transport_cost_of_a_lattice(n, a):
    assert abs(transport_cost(lattice(n, a)) / second_moment(n, a) - 1) < 1e-11


def test_second_moment_of_a_lattice_that_is_nearly_hexagonal():
    """209 = 11 · 19 points with a = 56: triangles with edges² of 241 and 242 (times n^(−2))."""
    assert 1 < second_moment(209, 56) * 209 / HEXAGONAL < 1 + 1e-3


@pytest.mark.parametrize(("n", "dims", "side"), [(6, 1, 600), (8, 2, 32), (16, 2, 32)])
def test_transport_cost_is_that_of_the_best_assignment(n, dims, side):
    """Transport from a grid of m points to n; W₂ of grid and uniform density is √(dims/12)/side."""
    points = np.random.default_rng(n).random((n, dims))
    grid = np.stack(np.meshgrid(*dims * [(np.arange(side) + 0.5) / side]), -1).reshape(-1, dims)
    delta = grid[:, None] - np.repeat(points, len(grid) // n, axis=0)
    squares = np.sum((delta - np.rint(delta)) ** 2, axis=-1)
    best = squares[linear_sum_assignment(squares)].mean()
    error = abs(np.sqrt(transport_cost(points)) - np.sqrt(best))
    assert error < np.sqrt(dims / 12) / side


def test_gradient_of_the_cost_points_away_from_the_centroids():
    points = np.random.default_rng(7).random((50, 2))
    direction = np.random.default_rng(8).standard_normal((50, 2))
    gradient = -2 / 50 * balanced(points).offsets
    h = 1e-6
    ends = [transport_cost((points + s * h * direction) % 1.0) for s in (1, -1)]
    slope = (ends[0] - ends[1]) / (2 * h)
    assert abs(slope - np.sum(gradient * direction)) < 1e-6
    assert abs(slope) > 1e-3


def test_equal_points_share_a_cell():
    assert abs(transport_cost([[0.2, 0.9]] * 5) - 1 / 6) < 1e-12
    pair, twice = [[0.1, 0.2], [0.6, 0.7]], [[0.1, 0.2]] * 3 + [[0.6, 0.7]] * 3
    assert abs(transport_cost(pair) - transport_cost(twice)) < 1e-12
    uneven = [[0.0, 0.3]] * 3 + [[0.5, 0.3]]  # strips of widths 3/4 and 1/4
    assert abs(transport_cost(uneven) - (1 / 12 + (0.75**3 + 0.25**3) / 12)) < 1e-9


@pytest.mark.parametrize("scale", [1e-155, 1e-300])
def test_points_whose_distances_underflow_have_the_cost_of_one_point(scale):
    """Such points once caused a division by zero."""
    points = np.random.default_rng(6).random((64, 2)) * scale
    assert abs(transport_cost(points) - 1 / 6) < 1e-12


def test_transport_cost_of_points_a_rounding_apart_is_refused():
    """Such points once caused a division by zero."""
    rng = np.random.default_rng(1)
    points = rng.integers(0, 16, (2**13, 2)) / 16 + rng.random((2**13, 2)) * 1e-15
    with pytest.raises(DomainError, match="too far from uniform"):
        transport_cost(points)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cluster", "column"])
def test_transport_cost_of_points_far_from_uniform_ends_in_seconds(kind):
    """Eight thousand points in a small square once took minutes."""
    points = np.random.default_rng(7).random((2**13, 2))
    points = (
        points * 1e-3 if kind == "cluster" else np.column_stack([points[:, :1] * 0, points[:, 1]])
    )
    transport_cost(np.random.default_rng(8).random((64, 2)))  # compiles the kernels
    begun = time.process_time()
    with pytest.raises(DomainError, match="too far from uniform"):
        transport_cost(points)
    assert time.process_time() - begun < 90  # It took 42 s while another test ran


def test_newton_steps_end_with_their_work():
    points = np.random.default_rng(8).random((100, 2)) ** 3
    masses = np.full(100, 0.01)
    _, first = balance(points, np.zeros(100), masses, 1e-9, 100, 0)
    assert first.work == power_diagram(points, np.zeros(100)).work > 100
    np.testing.assert_array_equal(first.areas, power_diagram(points, np.zeros(100)).areas)


def test_transport_cost_of_points_on_a_line_does_not_depend_on_the_origin():
    points = np.random.default_rng(9).random((20, 1))
    moved = transport_cost((points + 0.3) % 1.0)
    assert abs(transport_cost(points) - moved) < 1e-14
    assert abs(transport_cost((np.arange(7)[:, None] + 0.2) / 7) - 1 / (12 * 49)) < 1e-15


@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        (np.zeros((2, 3)), "shape"),
        (np.zeros(3), "shape"),
        (np.zeros((1, 2, 2)), "shape"),
        (np.zeros((0, 2)), "at least one"),
        ([[0.5, 1.0]], "lie in"),
        ([[0.5, float("nan")]], "NaN"),
        ([[0.5, float("inf")]], "infinite"),
        ([["a", "b"]], "real numbers"),
        (0.5 + 1e-7 * np.random.default_rng(1).random((99, 2)), "far from uniform"),
    ],
)
def test_transport_cost_refuses_with_a_sentence(points, sentence):
    with pytest.raises(DomainError, match=sentence):
        transport_cost(points)


def energy_of_images(points, sigma):
    """Return the sum over pairs and all their images, without cells.

    The sum over images is a product over axes, because a Gaussian of a vector is such a product.
    """
    reach = int(np.ceil(9 * sigma)) + 1
    delta = (points[:, None] - points[None])[..., None] + np.arange(-reach, reach + 1)
    terms = np.exp(-(delta**2) / (2 * sigma**2)).sum(axis=-1).prod(axis=-1)
    return (terms.sum() - np.trace(terms)) / 2


@pytest.mark.parametrize(("dims", "n"), [(1, 2), (1, 30), (2, 3), (2, 50), (3, 2), (3, 40), (5, 4)])
def test_gradient_is_that_of_all_images(dims, n):
    """Central differences of a sum without cells; the cutoff leaves e^(−18) per pair."""
    rng = np.random.default_rng(n)
    points, sigma = rng.random((n, dims)), 0.8 * n ** (-1 / dims)
    if dims > 3:
        sigma = 0.25  # keeps the number of images in 5 dims small
    direction, h = rng.standard_normal((n, dims)), 1e-5
    ends = [energy_of_images(points + s * h * direction, sigma) for s in (1, -1)]
    slope, scale = (ends[0] - ends[1]) / (2 * h), 1.0
    if dims > 3:
        scale = (np.sqrt(2 * np.pi) * sigma) ** dims
    evaluate = near_energy if dims <= 3 else series_energy
    gradient = scale * evaluate(sigma, points)[1]
    bound = n**2 * 6**dims * np.exp(-18) / sigma + 1e-9
    assert abs(np.sum(gradient * direction) - slope) < bound * np.abs(direction).max() * 10
    assert abs(slope) > 1e3 * bound or n < 10  # otherwise the comparison is not significant


def test_series_and_cells_agree():
    points = np.random.default_rng(3).random((60, 2))
    near, series = near_energy(0.1, points), series_energy(0.1, points)
    scale = 2 * np.pi * 0.1**2
    np.testing.assert_allclose(scale * series[1], near[1], atol=1e-4 * np.abs(near[1]).max())
    assert abs(scale * series[0] / near[0] - 1) < 1e-5


@pytest.mark.parametrize("dims", [2, 3])
def test_energy_does_not_change_under_translations(dims):
    rng = np.random.default_rng(1)
    points, offset = rng.random((100, dims)), rng.random(dims)
    sigma = 100 ** (-1 / dims)
    energy, gradient = near_energy(sigma, points)
    moved_energy, moved = near_energy(sigma, points + offset)
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
        energies.append(near_energy(sigma, points)[0])
    assert all(np.diff(energies) < 0)
    # ½ n² (2π σ² − 1/n) is the energy of a set without power below the Gaussian's cutoff
    ideal = 0.5 * 256 * (2 * np.pi - 1)
    assert abs(energies[-1] / ideal - 1) < 1e-5


@pytest.mark.parametrize(("dims", "n"), [(1, 64), (2, 256), (3, 216)])
def test_low_frequencies_are_empty_and_those_at_the_spacing_are_not(dims, n):
    points = GaussianBlueNoise(dims=dims, iterations=150).draw(n, realizations=2, rng=4)
    side = n ** (1 / dims)
    axis = np.arange(-int(2 * side), int(2 * side) + 1)
    m = np.stack(np.meshgrid(*[axis] * dims, indexing="ij"), axis=-1).reshape(-1, dims)
    m = m[: len(m) // 2]  # the other half is equal by symmetry
    radius = np.linalg.norm(m, axis=1) / side
    near = (radius < 0.4) | (np.abs(radius - 1.0) < 0.15)
    m, radius = m[near], radius[near]
    power = np.mean([np.abs(np.exp(-2j * np.pi * (m @ x.T)).sum(1)) ** 2 / n for x in points], 0)
    assert power[radius < 0.4].max() < 1e-3
    assert power[radius > 0.4].mean() > 1.0


@pytest.mark.parametrize("n", [1, 2, 3, 5, 40])
def test_holes_agree_with_the_voronoi_diagram(n):
    """Compare with Qhull's diagram of the points and their periodic images."""
    points = Stream(n).uniforms(0, 1, 2 * n).reshape(n, 2)
    tiles = np.concatenate([points + np.array(t) for t in itertools.product((0, 1, -1), repeat=2)])
    diagram = Voronoi(tiles)
    _, holes = kernels.measure_all(points)
    for i in range(n):
        corners = diagram.vertices[diagram.regions[diagram.point_region[i]]]
        far = np.hypot(*(corners - points[i]).T).max()
        assert np.sqrt(holes[i, 2]) == pytest.approx(far, rel=1e-9)
        assert np.hypot(*(holes[i, :2] - points[i])) == pytest.approx(far, rel=1e-9)
    near = cKDTree(tiles).query(points, k=2)[0][:, 1]
    np.testing.assert_allclose(np.sqrt(holes[:, 3]), near, rtol=1e-12)


def test_cells_stay_correct_while_points_move():
    """After every move, updated cells equal recomputed ones, and no distance decreases."""
    points = Stream(1).uniforms(0, 1, 120).reshape(60, 2)
    buckets, holes = kernels.measure_all(points)
    for i in range(60):
        before, least = points.copy(), holes[:, 3].min()
        kernels.move_points(i, i + 1, points, buckets, holes)
        _, anew = kernels.measure_all(points)
        np.testing.assert_allclose(holes[:, 2:], anew[:, 2:], rtol=1e-9)
        assert holes[:, 3].min() >= least * (1 - ROUNDING)
        others = np.delete(before, i, axis=0)
        np.testing.assert_array_equal(np.delete(points, i, axis=0), others)
        # The new place of the point is as far from all others as any place
        places = Stream(i).uniforms(0, 1, 4000).reshape(2000, 2)
        reached = clearances(points[i][None], others)[0]
        assert clearances(places, others).max() <= reached * (1 + ROUNDING)


@pytest.mark.parametrize("n", [256, 1024])
def test_farthest_points_are_near_the_hexagonal_packing(n):
    """Relative minimum distance of at least 0.9 [Schlömer et al. 2011: up to 0.93]."""
    sweeps = 30 if n < 1024 else 15  # fewer sweeps to save time
    points = FarthestPoint(sweeps=sweeps).draw(n, rng=6)[0]
    assert 0.9 <= nearest(points).min() / densest_distance(n, 2) < 1.0


def test_two_farthest_points_are_opposite():
    x, y = FarthestPoint().draw(2, rng=7)[0]
    np.testing.assert_allclose((x - y) % 1.0, 0.5, atol=1e-12)


def test_farthest_points_stop_when_nothing_moves():
    """Two points have their final places after one sweep, so more sweeps take no time."""
    short, long = (FarthestPoint(sweeps=s).draw(2, rng=8) for s in (3, 100_000))
    np.testing.assert_array_equal(short, long)
