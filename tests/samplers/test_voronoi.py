"""Lloyd and bnot: cells of the result, distances, spectrum, rate; transport cost: exact values."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from tests.samplers.test_power_diagram import lattice, second_moment

import mcspectra as mcs
from mcspectra.core.errors import DomainError, ParameterError
from mcspectra.samplers import Bnot, Lloyd, transport_cost
from mcspectra.samplers._power_diagram import power_diagram
from mcspectra.samplers._power_weights import balance
from mcspectra.samplers.voronoi import _relax

N, SETS = 1024, 12
HEXAGONAL = 5 / (18 * np.sqrt(3))


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MCSPECTRA_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


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
        # The sampler's own cells, equal within 1e-3, had centroids as near as the tolerance.
        distance = np.sqrt(np.sum(diagram.offsets**2))
        assert distance < Bnot().tolerance + 1e-3


def test_bnot_keeps_points_apart(sets):
    """Published: minimum distances above 0.7 of the hexagonal lattice's (here 0.77 ± 0.014)."""
    densest = np.sqrt(2 / (np.sqrt(3) * N))
    for points in sets:
        nearest = cKDTree(points, boxsize=1.0).query(points, k=2)[0][:, 1]
        assert nearest.min() > 0.7 * densest


def test_bnot_spectrum_is_that_of_blue_noise(sets):
    """Next to nothing up to 0.6 √n, a ring at the distance of the hexagonal lattice's peaks.

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
    assert 2.0 < means[peak] < 5.0  # of crystals it would be far higher


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
        assert np.sqrt(np.sum(diagram.offsets**2)) < 1e-3  # areas were equal within 1e-3


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
        points = _relax(Lloyd(iterations=1), points, cells, lambda fraction: None)
    assert all(a > b for a, b in itertools.pairwise(energies))


def cells(points):
    return power_diagram(points, np.zeros(len(points)))


def test_points_near_enough_to_their_centroids_are_left_alone():
    points = Lloyd(tolerance=0.05).draw(100, rng=4)[0]
    assert np.sqrt(np.sum(cells(points).offsets ** 2)) <= 0.05
    before = Lloyd(iterations=3).draw(100, rng=4)[0]
    assert np.sqrt(np.sum(cells(before).offsets ** 2)) > 0.05


@pytest.mark.parametrize("method", [cells, balanced])
def test_results_move_with_the_start(method):
    """Hence every point is uniform. Rounding grows little in ten steps."""
    start, offset = np.random.default_rng(5).random((64, 2)), np.array([0.31, 0.77])
    ends = [
        _relax(Bnot(iterations=10, tolerance=0.0), x, method, lambda fraction: None)
        for x in (start, (start + offset) % 1.0)
    ]
    difference = ends[1] - ends[0] - offset
    np.testing.assert_allclose(difference - np.rint(difference), 0.0, atol=1e-6)


def test_progress_is_reported():
    fractions = []
    Lloyd(iterations=20)._optimize(16, np.array([1, 2], np.uint64), fractions.append)
    assert fractions == [i / 20 for i in range(20)]


def test_variance_rate_of_the_disk():
    """n^(−3/2): Pilleboue et al. (2015), of sets whose spectrum vanishes at low frequencies.

    Points this regular make n^(3/2) times the variance swing with the radius over the spacing:
    ±10 % (measured for n 64 … 512) are ±0.1 in the slope over a factor of 8.
    """
    disk = mcs.Estimator("disk(center=[0.463, 0.517], radius=0.27)")
    rates = mcs.convergence(disk, Bnot(sets=16), [64, 128, 256, 512], realizations=1000, rng=2)
    low, high = rates["rate_ci"].values
    error = (high - low) / 2 / 1.96
    assert abs(float(rates["rate"]) + 1.5) < 4 * error + 0.1
    assert high < -1.2  # random points have −1


@pytest.mark.parametrize("side", [1, 2, 5, 16])
def test_transport_cost_of_a_square_grid(side):
    grid = (np.stack(np.meshgrid(*2 * [np.arange(side)]), axis=-1).reshape(-1, 2) + 0.3) / side
    assert abs(transport_cost(grid) * 6 * side**2 - 1) < 1e-12


@pytest.mark.parametrize(("n", "a"), [(7, 2), (30, 11), (209, 56)])
def test_transport_cost_of_a_lattice(n, a):
    assert abs(transport_cost(lattice(n, a)) / second_moment(n, a) - 1) < 1e-11


def test_second_moment_of_a_lattice_that_is_nearly_hexagonal():
    """209 = 11 · 19 points with a = 56: the triangles of edges² 242 to 241 (times n^(−2))."""
    assert 1 < second_moment(209, 56) * 209 / HEXAGONAL < 1 + 1e-3


@pytest.mark.parametrize(("n", "dims", "side"), [(6, 1, 600), (8, 2, 32), (16, 2, 32)])
def test_transport_cost_is_that_of_the_best_assignment(n, dims, side):
    """Of a grid of m points to n; W₂ between grid and uniform density is √(dims/12)/side."""
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
    uneven = [[0.0, 0.3]] * 3 + [[0.5, 0.3]]  # strips of 3/4 and 1/4
    assert abs(transport_cost(uneven) - (1 / 12 + (0.75**3 + 0.25**3) / 12)) < 1e-9


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


@pytest.mark.parametrize("cls", [Lloyd, Bnot])
@pytest.mark.parametrize(
    "arguments",
    [
        {"dims": 1},
        {"dims": 3},
        {"dims": "2"},
        {"iterations": 0},
        {"iterations": 2.5},
        {"iterations": float("nan")},
        {"tolerance": -0.1},
        {"tolerance": float("nan")},
        {"tolerance": float("inf")},
        {"tolerance": "x"},
        {"sets": 0},
    ],
)
def test_bad_parameters(cls, arguments):
    with pytest.raises(ParameterError, match=next(iter(arguments))):
        cls(**arguments)
