"""Dart throwing, best candidates, farthest points: distances, slow references, uniform points."""

from __future__ import annotations

import re
from itertools import product

import numpy as np
import pytest
from scipy import stats
from scipy.spatial import Voronoi, cKDTree

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import BestCandidate, DartThrowing, FarthestPoint, PoissonDisk, sampler
from mcspectra.samplers import _voronoi_kernels as voronoi
from mcspectra.samplers.poisson import densest_distance

FALSE_ALARMS = 1e-6
CHECKS = 8  # statistical tests in this file
LEVEL = 1 - (1 - FALSE_ALARMS) ** (1 / CHECKS)  # Šidák
ROUNDING = 1e-12


def nearest(points):
    """Toroidal distance from each point to its nearest neighbor."""
    return cKDTree(points, boxsize=1.0).query(points, k=2)[0][:, 1]


def clearances(places, points):
    """Toroidal distance from each of `places` to the nearest of `points`, without any grid."""
    gaps = np.abs(places[:, None] - points)
    return np.sqrt((np.minimum(gaps, 1 - gaps) ** 2).sum(axis=-1)).min(axis=1)


@pytest.mark.parametrize(
    ("dims", "n", "radius"),
    [(1, 200, 0.7), (2, 1, 0.65), (2, 2, 0.65), (2, 300, 0.72), (3, 200, 0.7), (5, 50, 0.65)],
)
def test_darts_keep_the_declared_distance(dims, n, radius):
    source = DartThrowing(dims=dims, radius_=radius)
    points = source.draw(n, realizations=5, rng=1)
    assert points.shape == (5, n, dims)
    if n > 1:
        smallest = min(nearest(x).min() for x in points)
        assert smallest >= source.radius(n) * (1 - ROUNDING)
    if n >= 200:  # the least distance of many is a tight bound
        assert smallest < 1.05 * source.radius(n)


@pytest.mark.parametrize(("dims", "n"), [(1, 30), (2, 60), (4, 20)])
def test_darts_are_the_first_places_that_are_far_enough(dims, n):
    """A slow reference: the same random numbers, every point checked against all before it."""
    source, stream = DartThrowing(dims=dims), Stream(5)
    darts = stream.uniforms(3, 1, 20_000 * dims).reshape(-1, dims)
    taken = darts[:1]
    for dart in darts[1:]:
        if len(taken) < n and clearances(dart[None], taken)[0] >= source.radius(n):
            taken = np.vstack([taken, dart])
    np.testing.assert_array_equal(source.draw_stream(n, stream, 3, 1)[0], taken)


def test_dart_throwing_has_the_law_of_the_poisson_disks():
    """Same radius: distances to the nearest neighbor of one point a set, from both."""
    n, realizations = 30, 1500
    darts = DartThrowing(radius_=0.6).draw(n, realizations=realizations, rng=2)
    disks = PoissonDisk(radius_=0.6).draw(n, realizations=realizations, rng=3)
    assert DartThrowing(radius_=0.6).radius(n) == PoissonDisk(radius_=0.6).radius(n)
    samples = [[nearest(x)[-1] for x in sets] for sets in (darts, disks)]
    assert stats.ks_2samp(*samples).pvalue > LEVEL


@pytest.mark.parametrize(
    ("dims", "n", "candidates"), [(1, 70, 2), (2, 150, 3), (3, 90, 2), (5, 40, 1)]
)
def test_best_candidates_are_those_of_a_search_without_grids(dims, n, candidates):
    stream = Stream(7)
    total = sum(max(1, candidates * i) for i in range(n))
    places = stream.uniforms(2, 1, total * dims).reshape(-1, dims)
    chosen = places[:1]
    for i in range(1, n):
        start = 1 + candidates * i * (i - 1) // 2
        mine = places[start : start + candidates * i]
        best = np.argmax(clearances(mine, chosen))
        chosen = np.vstack([chosen, mine[best]])
    source = BestCandidate(dims=dims, candidates=candidates)
    np.testing.assert_array_equal(source.draw_stream(n, stream, 2, 1)[0], chosen)


def test_best_candidates_are_progressive():
    points = BestCandidate().draw(200, realizations=2, rng=4)
    np.testing.assert_array_equal(BestCandidate().draw(77, realizations=2, rng=4), points[:, :77])


def test_more_candidates_are_farther_apart():
    least = [
        np.mean(
            [
                nearest(x).min()
                for x in BestCandidate(candidates=c).draw(200, realizations=20, rng=5)
            ]
        )
        for c in (1, 4, 30)
    ]
    assert least == sorted(least)
    assert least[2] > 0.7 * densest_distance(200, 2)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 40])
def test_cells_are_those_of_the_voronoi_diagram(n):
    """Against Qhull's diagram of the points and their periodic images."""
    points = Stream(n).uniforms(0, 1, 2 * n).reshape(n, 2)
    tiles = np.concatenate([points + np.array(t) for t in product((0, 1, -1), repeat=2)])
    diagram = Voronoi(tiles)
    holes = np.empty((n, 4))
    voronoi.measure_all(points, voronoi.point_buckets(points), holes)
    for i in range(n):
        corners = diagram.vertices[diagram.regions[diagram.point_region[i]]]
        far = np.hypot(*(corners - points[i]).T).max()
        assert np.sqrt(holes[i, 2]) == pytest.approx(far, rel=1e-9)
        assert np.hypot(*(holes[i, :2] - points[i])) == pytest.approx(far, rel=1e-9)
    near = cKDTree(tiles).query(points, k=2)[0][:, 1]
    np.testing.assert_allclose(np.sqrt(holes[:, 3]), near, rtol=1e-12)


def test_cells_stay_right_while_points_move():
    """After every move: those measured on the way are those measured anew; none gets nearer."""
    points = Stream(1).uniforms(0, 1, 120).reshape(60, 2)
    buckets, holes, anew = voronoi.point_buckets(points), np.empty((60, 4)), np.empty((60, 4))
    voronoi.measure_all(points, buckets, holes)
    for i in range(60):
        before, least = points.copy(), holes[:, 3].min()
        voronoi.move_points(i, i + 1, points, buckets, holes)
        voronoi.measure_all(points, voronoi.point_buckets(points), anew)
        np.testing.assert_allclose(holes[:, 2:], anew[:, 2:], rtol=1e-9)
        assert holes[:, 3].min() >= least * (1 - ROUNDING)
        others = np.delete(before, i, axis=0)
        np.testing.assert_array_equal(np.delete(points, i, axis=0), others)
        # The point's new place is as far from all others as any place is
        places = Stream(i).uniforms(0, 1, 4000).reshape(2000, 2)
        reached = clearances(points[i][None], others)[0]
        assert clearances(places, others).max() <= reached * (1 + ROUNDING)


@pytest.mark.parametrize("n", [256, 1024])
def test_farthest_points_are_near_the_hexagonal_packing(n):
    """Relative minimum distance 0.9 and more [Schlömer et al. 2011: up to 0.93]."""
    sweeps = 30 if n < 1024 else 15  # quicker
    points = FarthestPoint(sweeps=sweeps).draw(n, rng=6)[0]
    assert 0.9 <= nearest(points).min() / densest_distance(n, 2) < 1.0


def test_two_farthest_points_are_opposite():
    x, y = FarthestPoint().draw(2, rng=7)[0]
    np.testing.assert_allclose((x - y) % 1.0, 0.5, atol=1e-12)


def test_farthest_points_stop_when_nothing_moves():
    """Two points are where they belong after one sweep: many more take no time."""
    short, long = (FarthestPoint(sweeps=s).draw(2, rng=8) for s in (3, 100_000))
    np.testing.assert_array_equal(short, long)


@pytest.mark.parametrize(
    ("spec", "n"), [("dart-throwing", 5), ("best-candidate", 8), ("farthest-point(sweeps=3)", 4)]
)
def test_every_point_is_uniform(spec, n):
    """χ² of the last point of 1000 sets on 5×5 cells."""
    last = sampler(spec).draw(n, realizations=1000, rng=9)[:, -1]
    counts = np.bincount((np.floor(last * 5) @ [5, 1]).astype(int), minlength=25)
    assert stats.chisquare(counts).pvalue > LEVEL


@pytest.mark.parametrize(
    ("spec", "steepest", "flattest"),
    [
        ("dart-throwing", -1.5, -1.0),  # power at low frequencies stays: −1 in the end
        ("best-candidate", -1.5, -1.0),
        ("farthest-point(sets=8, sweeps=5)", -1.75, -1.25),  # hardly any: −1.5, that of the edge
    ],
)
def test_variance_rates_on_the_disk(spec, steepest, flattest):
    disk = mcs.Estimator("disk(center=[0.463, 0.517], radius=0.27)")
    fit = mcs.convergence(disk, spec, [16, 64, 256], realizations=100, rng=10)
    low, high = fit["rate_ci"].values
    assert low < flattest
    assert high > steepest


@pytest.mark.parametrize(
    ("cls", "arguments", "words"),
    [
        (DartThrowing, {"radius_": 0}, "radius is 0; give a finite number greater than 0"),
        (DartThrowing, {"radius_": 1.2}, "radius is 1.2"),
        (DartThrowing, {"radius_": float("nan")}, "radius is nan"),
        (DartThrowing, {"radius_": None}, "radius is None"),
        (DartThrowing, {"dims": 9}, "dart-throwing: dims is 9; give a whole number from 1 to 8"),
        (BestCandidate, {"candidates": 0}, "candidates is 0; give a whole number from 1 to 10000"),
        (BestCandidate, {"candidates": 1.5}, "candidates is 1.5"),
        (BestCandidate, {"candidates": float("inf")}, "candidates is inf"),
        (BestCandidate, {"dims": 0}, "best-candidate: dims is 0"),
        (FarthestPoint, {"dims": 3}, "dims is 3; it must be 2, for other dims use best-candidate"),
        (FarthestPoint, {"sweeps": 0}, "sweeps is 0; give a whole number from 1"),
        (FarthestPoint, {"sets": "many"}, "sets is 'many'"),
    ],
)
def test_bad_parameters(cls, arguments, words):
    with pytest.raises(ParameterError, match=re.escape(words)):
        cls(**arguments)


@pytest.mark.parametrize(
    ("spec", "most"),
    [("dart-throwing", 2**22), ("best-candidate", 2**16), ("farthest-point", 2**16)],
)
def test_huge_counts_are_refused_at_once(spec, most):
    with pytest.raises(CountError, match=f"at most {most} points") as caught:
        sampler(spec).draw(2**30)
    assert caught.value.nearest == (most,)


def test_darts_that_find_no_room_are_said():
    with pytest.raises(CountError, match="no room for 200 points in 2 dims .* smaller radius") as e:
        sampler("dart-throwing(radius=0.95)").draw(200, rng=1)
    assert "\n" not in str(e.value)
