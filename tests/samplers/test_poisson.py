"""Poisson disks: n points, the declared distance, no gaps, uniform points, a hole in the spectrum."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy import stats
from scipy.spatial import Voronoi, cKDTree

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.samplers import PoissonDisk, sampler

FALSE_ALARMS = 1e-6
CHECKS = 12  # statistical tests in this file
LEVEL = 1 - (1 - FALSE_ALARMS) ** (1 / CHECKS)  # Šidák
SHARP = 1e-9  # relative: holes are found to 1e-10 of their size
ROUNDING = 1e-12  # of a distance computed from coordinates below 1

CASES = [
    (1, 100, True),
    (2, 1, True),
    (2, 2, True),
    (2, 3, True),
    (2, 5, True),  # jams in one attempt of twelve
    (2, 64, True),
    (2, 250, False),
    (3, 1, False),
    (3, 3, True),
    (3, 100, True),
    (4, 2, True),
    (4, 50, False),
]


def nearest(points, toroidal):
    """Distance from each point to its nearest neighbor."""
    tree = cKDTree(points, boxsize=1.0 if toroidal else None)
    return tree.query(points, k=2)[0][:, 1]


@pytest.mark.parametrize(("dims", "n", "toroidal"), CASES)
def test_exactly_n_points_keep_the_declared_distance(dims, n, toroidal):
    source = PoissonDisk(dims=dims, boundary="toroidal" if toroidal else "bounded")
    points = source.draw(n, realizations=20, rng=1)
    assert points.shape == (20, n, dims)
    assert points.min() >= 0.0
    assert points.max() < 1.0
    if n > 1:
        smallest = min(nearest(x, toroidal).min() for x in points)
        assert smallest >= source.radius(n) * (1 - ROUNDING)


@pytest.mark.parametrize("radius", [0.25, 0.5, 0.77])
def test_the_radius_can_be_chosen(radius):
    """Relative to the hexagonal packing, whose distance is (2/√3 n)^½."""
    source = sampler(f"poisson-disk(radius={radius})", 2)
    assert source.radius(100) == pytest.approx(radius * np.sqrt(2 / np.sqrt(3) / 100))
    points = source.draw(100, realizations=10, rng=2)
    assert min(nearest(x, True).min() for x in points) >= source.radius(100) * (1 - ROUNDING)
    # Small disks leave pairs closer than larger ones would allow: the radius is not just a floor.
    assert min(nearest(x, True).min() for x in points) < 1.2 * source.radius(100)


def largest_gap(points, toroidal):
    """Distance to the nearest point of the place farthest from all: a corner of a Voronoi cell.

    On the torus, of the points and their periodic images. In the cube, of the points and their
    mirror images, which are no nearer to any place inside, and put corners on its faces.
    """
    dims = points.shape[1]
    tiles = []
    for tile in product((-1, 0, 1), repeat=dims):
        t = np.array(tile)
        tiles.append(points + t if toroidal else np.where(t == 0, points, (t == 1) * 2 - points))
    if dims == 1:
        return np.diff(np.sort(np.concatenate(tiles).ravel())).max() / 2
    corners = Voronoi(np.concatenate(tiles)).vertices
    inside = corners[((corners >= -ROUNDING) & (corners <= 1 + ROUNDING)).all(axis=1)]
    return cKDTree(np.concatenate(tiles)).query(inside)[0].max()


@pytest.mark.parametrize("toroidal", [True, False])
@pytest.mark.parametrize(("dims", "n"), [(1, 30), (2, 3), (2, 6), (2, 64), (2, 500), (3, 40)])
def test_maximal_sets_leave_no_room_for_another_disk(dims, n, toroidal):
    """The farthest place is no farther from all points than they are from one another."""
    boundary = "toroidal" if toroidal else "bounded"
    points = PoissonDisk(dims=dims, mode="maximal", boundary=boundary).draw(
        n, realizations=4, rng=9
    )
    assert points.shape == (4, n, dims)
    for x in points:
        assert largest_gap(x, toroidal) <= nearest(x, toroidal).min() * (1 + SHARP)


def test_exact_sets_leave_room_that_maximal_ones_do_not():
    points = PoissonDisk().draw(500, realizations=4, rng=9)
    assert max(largest_gap(x, True) for x in points) > 1.1 * PoissonDisk().radius(500)


def test_maximal_sets_are_near_the_density_at_jamming():
    """Relative radius 0.777 [Torquato 2006]; the points that fill holes come a few percent later."""
    points = PoissonDisk(mode="maximal").draw(500, realizations=10, rng=10)
    least = np.array([nearest(x, True).min() for x in points])
    relative = least * np.sqrt(500 * np.sqrt(3) / 2)
    assert relative.min() > 0.75
    assert relative.max() < 0.80


def test_spec_round_trip():
    for spec in (
        "poisson-disk",
        "poisson-disk(mode='maximal')",
        "poisson-disk(boundary='bounded', radius=0.5)",
    ):
        assert sampler(spec, 3).spec == spec
        assert sampler(spec, 3) == sampler(sampler(spec, 3).spec, 3)
    assert sampler("poisson-disk(radius=1)").spec == "poisson-disk(radius=1.0)"


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_a_realization_does_not_depend_on_the_call(dims):
    source = PoissonDisk(dims=dims)
    whole = source.draw(50, realizations=8, rng=3)
    np.testing.assert_array_equal(source.draw(50, realizations=3, rng=3, first=4), whole[4:7])
    assert len(np.unique(whole.reshape(8, -1), axis=0)) == 8
    assert not np.array_equal(source.draw(50, rng=4)[0], whole[0])


def test_only_the_torus_is_unbiased():
    assert PoissonDisk().unbiased
    assert not PoissonDisk(boundary="bounded").unbiased
    assert sampler("poisson-disk(boundary='bounded') | shift").unbiased


@pytest.fixture(scope="module", params=[5, 40])
def many_sets(request):
    return PoissonDisk().draw(request.param, realizations=10_000, rng=5)


@pytest.mark.parametrize("order", ["first", "last", "any"])
def test_every_point_is_uniform_on_the_torus(many_sets, order):
    """χ² on 6×6 cells, one point a realisation."""
    points, n = many_sets, many_sets.shape[1]
    any_point = np.random.default_rng(0).integers(n, size=len(points))
    index = {"first": 0, "last": n - 1, "any": any_point}[order]
    x = np.floor(6 * points[np.arange(len(points)), index])
    counts = np.bincount((6 * x[:, 0] + x[:, 1]).astype(int), minlength=36)
    assert stats.chisquare(counts).pvalue > LEVEL


def test_the_bounded_kind_prefers_the_boundary():
    """Disks may stick out: more points than the area's share lie near the edges."""
    points = PoissonDisk(boundary="bounded").draw(64, realizations=400, rng=6)
    margin = 0.25 / np.sqrt(64)
    near = ((points < margin) | (points >= 1 - margin)).any(axis=2)
    share = 1 - (1 - 2 * margin) ** 2
    # A disk keeps others out, so that counts vary less than binomially: σ is an upper bound.
    sigma = np.sqrt(share * (1 - share) / near.size)
    assert near.mean() > share + stats.norm.isf(LEVEL) * sigma


def test_two_points_have_the_law_of_dart_throwing():
    """For n = 2 the second point is uniform outside the disk of the first: P(distance < s)."""
    source = PoissonDisk()
    r = source.radius(2) / np.sqrt(2)  # 0.403 < ½, so that disks do not meet their images
    made = sampler(f"poisson-disk(radius={0.75 / np.sqrt(2)})")
    assert made.radius(2) == pytest.approx(r)
    x = made.draw(2, realizations=20_000, rng=7)
    gap = np.abs(x[:, 0] - x[:, 1])
    distance = np.hypot(*np.minimum(gap, 1 - gap).T)
    inside = distance < 0.5  # where the ring is whole
    expected = (np.pi * 0.25 - np.pi * r**2) / (1 - np.pi * r**2)
    assert stats.binomtest(int(inside.sum()), len(inside), expected).pvalue > LEVEL
    ring = (distance[inside] ** 2 - r**2) / (0.25 - r**2)
    assert stats.kstest(ring, "uniform").pvalue > LEVEL


def periodogram(points, frequencies):
    """n⟨|S_m|²⟩, 1 for random points; points (R, n, d), frequencies (M, d) -> (M,)."""
    phases = np.exp(-2j * np.pi * (points @ frequencies.T))
    return (np.abs(phases.sum(axis=1)) ** 2).mean(axis=0) / points.shape[1]


def test_power_is_low_at_low_frequencies_and_peaks_near_the_inverse_distance():
    """Mean power over M half-space frequencies and R sets; for random points 1 ± 1/√(RM).

    At jamming the 2-D spectrum starts at 0.059 [Torquato, Uche, Stillinger 2006]; a quarter leaves
    room for the few percent of points that are missing and for the rise with frequency.
    """
    source, n, realizations = PoissonDisk(), 400, 50
    points = source.draw(n, realizations=realizations, rng=8)
    grid = np.stack(np.meshgrid(np.arange(0, 33), np.arange(-32, 33), indexing="ij"), axis=-1)
    frequencies = grid.reshape(-1, 2)[33:]  # half of the plane: −m has the power of m
    length = np.hypot(*frequencies.T)
    low = frequencies[(length < 0.25 / source.radius(n)) & (length > 0)]
    peak = frequencies[(length > 1.0 / source.radius(n)) & (length < 1.3 / source.radius(n))]
    noise = stats.norm.isf(LEVEL) / np.sqrt(realizations * np.array([len(low), len(peak)]))
    assert periodogram(points, low).mean() < 0.25 < 1 - noise[0]
    assert periodogram(points, peak).mean() > 1 + noise[1]


def test_variance_falls_between_the_rates_of_its_two_terms():
    """Power at low frequencies, which stays, gives −1; gaps at the edge of the disk, −1.5.

    The first is what is left at large n [Pilleboue et al. 2015, table 1: Poisson disk].
    """
    disk = mcs.Estimator("disk(center=[0.463, 0.517], radius=0.27)")
    fit = mcs.convergence(disk, "poisson-disk", [16, 64, 256], realizations=400, rng=11)
    low, high = fit["rate_ci"].values
    assert -1.5 < low < high < -1.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"dims": 5}, "poisson-disk: dims is 5; give a whole number from 1 to 4"),
        ({"dims": 0}, "dims is 0"),
        ({"boundary": "torodial"}, "boundary is 'torodial'; .* Did you mean 'toroidal'"),
        ({"boundary": True}, "boundary is True; it must be one of toroidal, bounded"),
        ({"mode": "minimal"}, "mode is 'minimal'; it must be one of exact, maximal"),
        ({"mode": None}, "mode is None"),
        ({"mode": "maximal", "radius_": 0.5}, "radius is 0.5, but each maximal set has its own"),
        ({"mode": "maximal", "dims": 4}, "are for 1 to 3 dims, not 4"),
        ({"radius_": float("inf")}, "radius is inf"),
        ({"radius_": 0}, "radius is 0; give a finite number at least 0.25 and at most 1"),
        ({"radius_": -0.5}, "radius is -0.5"),
        ({"radius_": 1.5}, "radius is 1.5"),
        ({"radius_": float("nan")}, "radius is nan"),
        ({"radius_": "wide"}, "radius is 'wide'"),
    ],
)
def test_bad_parameters(arguments, words):
    with pytest.raises(ParameterError, match=words):
        PoissonDisk(**arguments)


@pytest.mark.parametrize("n", [0, -1, 1.5, "x", float("nan")])
def test_bad_counts(n):
    with pytest.raises(CountError, match="give a whole number"):
        PoissonDisk().draw(n)
    with pytest.raises(CountError, match="give a whole number"):
        PoissonDisk().radius(n)


@pytest.mark.parametrize("mode", ["exact", "maximal"])
def test_huge_counts_are_refused_at_once(mode):
    with pytest.raises(CountError, match="makes at most 67108864 points"):
        PoissonDisk(mode=mode, dims=1).draw(2**31)


def test_maximal_sets_have_no_common_radius():
    with pytest.raises(ParameterError, match="no common radius"):
        PoissonDisk(mode="maximal").radius(16)


def test_a_radius_that_leaves_no_room_is_said():
    with pytest.raises(CountError, match=r"no room for 200 points in 2 dims; give a smaller") as e:
        sampler("poisson-disk(radius=0.9)").draw(200, rng=1)
    assert "\n" not in str(e.value)
