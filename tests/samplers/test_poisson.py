"""Points that keep apart: declared distances, no gaps, slow references, dart throwing's law."""

from itertools import product

import numpy as np
import pytest
from scipy import stats
from scipy.spatial import Voronoi, cKDTree

from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import BestCandidate, DartThrowing, PoissonDisk, sampler
from mcspectra.samplers.poisson import densest_distance

LEVEL = 1 - (1 - 1e-6) ** (1 / 12)  # Šidák: at most 12 statistical tests in this file share 1e-6
SHARP = 1e-9  # relative tolerance; holes are found to 1e-10 of their size
ROUNDING = 1e-12  # rounding error of a distance between points in the unit cube


CASES = [
    (1, 100, True),
    (2, 1, True),
    (2, 2, True),
    (2, 3, True),
    (2, 5, True),  # one attempt in twelve jams
    (2, 64, True),
    (2, 250, False),
    (3, 1, False),
    (3, 3, True),
    (3, 100, True),
    (4, 2, True),
    (4, 50, False),
]


def nearest(points, toroidal=True):
    """Return the distance from each point to its nearest neighbor."""
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
    # Small disks allow closer pairs than large ones, so the radius is also used as such
    assert min(nearest(x, True).min() for x in points) < 1.2 * source.radius(100)


def largest_gap(points, toroidal):
    """Return the largest distance of any place to its nearest point, at a corner of a Voronoi cell.

    On the torus, the cells are those of the points and their periodic images. In the cube they are
    those of the points and their mirror images, which put corners on its faces.
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
    """The distance of the farthest place from all points is at most the minimum distance."""
    boundary = "toroidal" if toroidal else "bounded"
    points = PoissonDisk(dims=dims, mode="maximal", boundary=boundary).draw(
        n, realizations=4, rng=9
    )
    assert points.shape == (4, n, dims)
    for x in points:
        assert largest_gap(x, toroidal) <= nearest(x, toroidal).min() * (1 + SHARP)


def test_maximal_sets_are_near_the_density_at_jamming():
    """Relative radius 0.777 [Torquato 2006]; filling of holes adds a few percent of points."""
    points = PoissonDisk(mode="maximal").draw(500, realizations=10, rng=10)
    least = np.array([nearest(x, True).min() for x in points])
    relative = least * np.sqrt(500 * np.sqrt(3) / 2)
    assert relative.min() > 0.75
    assert relative.max() < 0.80


def test_first_and_last_points_are_uniform_on_the_torus():
    """χ² on 6×6 cells, for sets of which one attempt in twelve jams."""
    points = PoissonDisk().draw(5, realizations=10_000, rng=5)
    for x in (np.floor(6 * points[:, index]) for index in (0, -1)):
        counts = np.bincount((6 * x[:, 0] + x[:, 1]).astype(int), minlength=36)
        assert stats.chisquare(counts).pvalue > LEVEL


def test_bounded_sets_have_more_points_near_the_boundary():
    """Disks may stick out, so more points than the area's share lie near the edges."""
    points = PoissonDisk(boundary="bounded").draw(64, realizations=400, rng=6)
    margin = 0.25 / np.sqrt(64)
    near = ((points < margin) | (points >= 1 - margin)).any(axis=2)
    share = 1 - (1 - 2 * margin) ** 2
    # Disks exclude other points, so counts vary less than binomially: σ is an upper bound
    sigma = np.sqrt(share * (1 - share) / near.size)
    assert near.mean() > share + stats.norm.isf(LEVEL) * sigma


def test_two_points_have_the_law_of_dart_throwing():
    """For n = 2 the second point is uniform outside the disk of the first: P(distance < s)."""
    source = PoissonDisk()
    r = source.radius(2) / np.sqrt(2)  # 0.403 < ½, so disks do not touch their images
    made = sampler(f"poisson-disk(radius={0.75 / np.sqrt(2)})")
    assert made.radius(2) == pytest.approx(r)
    x = made.draw(2, realizations=20_000, rng=7)
    gap = np.abs(x[:, 0] - x[:, 1])
    distance = np.hypot(*np.minimum(gap, 1 - gap).T)
    inside = distance < 0.5  # distances at which the ring is complete
    expected = (np.pi * 0.25 - np.pi * r**2) / (1 - np.pi * r**2)
    assert stats.binomtest(int(inside.sum()), len(inside), expected).pvalue > LEVEL
    ring = (distance[inside] ** 2 - r**2) / (0.25 - r**2)
    assert stats.kstest(ring, "uniform").pvalue > LEVEL


def periodogram(points, frequencies):
    """Return n⟨|S_m|²⟩, 1 for random points; points (R, n, d), frequencies (M, d) -> (M,)."""
    phases = np.exp(-2j * np.pi * (points @ frequencies.T))
    return (np.abs(phases.sum(axis=1)) ** 2).mean(axis=0) / points.shape[1]


def test_power_is_low_at_low_frequencies_and_peaks_near_the_inverse_distance():
    """Mean power over M half-space frequencies and R sets; for random points 1 ± 1/√(RM).

    At jamming the 2-D spectrum starts at 0.059 [Torquato, Uche, Stillinger 2006]. A limit of a
    quarter allows for the few percent of missing points and for the rise with frequency.
    """
    source, n, realizations = PoissonDisk(), 400, 20
    points = source.draw(n, realizations=realizations, rng=8)
    grid = np.stack(np.meshgrid(np.arange(0, 33), np.arange(-32, 33), indexing="ij"), axis=-1)
    frequencies = grid.reshape(-1, 2)[33:]  # half of the plane, since −m and m have equal power
    length = np.hypot(*frequencies.T)
    low = frequencies[(length < 0.25 / source.radius(n)) & (length > 0)]
    peak = frequencies[(length > 1.0 / source.radius(n)) & (length < 1.3 / source.radius(n))]
    noise = stats.norm.isf(LEVEL) / np.sqrt(realizations * np.array([len(low), len(peak)]))
    assert periodogram(points, low).mean() < 0.25 < 1 - noise[0]
    assert periodogram(points, peak).mean() > 1 + noise[1]


def test_maximal_sets_have_no_common_radius():
    with pytest.raises(ParameterError, match="no common radius"):
        PoissonDisk(mode="maximal").radius(16)


def clearances(places, points):
    """Return the toroidal distance from each of `places` to the nearest point, by brute force."""
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
    if n >= 200:  # for many points the least distance is close to the radius
        assert smallest < 1.05 * source.radius(n)


@pytest.mark.parametrize(("dims", "n"), [(1, 30), (2, 60), (4, 20)])
def test_accepted_darts_are_the_first_ones_far_enough_away(dims, n):
    """A slow reference with the same random numbers compares every dart with all earlier points."""
    source, stream = DartThrowing(dims=dims), Stream(5)
    darts = stream.uniforms(3, 1, 20_000 * dims).reshape(-1, dims)
    taken = darts[:1]
    for dart in darts[1:]:
        if len(taken) < n and clearances(dart[None], taken)[0] >= source.radius(n):
            taken = np.vstack([taken, dart])
    np.testing.assert_array_equal(source.draw_stream(n, stream, 3, 1)[0], taken)


def test_dart_throwing_has_the_law_of_the_poisson_disks():
    """At equal radius, nearest-neighbor distances of one point per set have the same law."""
    n, realizations = 30, 1500
    darts = DartThrowing(radius_=0.6).draw(n, realizations=realizations, rng=2)
    disks = PoissonDisk(radius_=0.6).draw(n, realizations=realizations, rng=3)
    assert DartThrowing(radius_=0.6).radius(n) == PoissonDisk(radius_=0.6).radius(n)
    samples = [[nearest(x)[-1] for x in sets] for sets in (darts, disks)]
    assert stats.ks_2samp(*samples).pvalue > LEVEL


@pytest.mark.parametrize(
    ("dims", "n", "candidates"), [(1, 70, 2), (2, 150, 3), (3, 90, 2), (5, 40, 1)]
)
def test_best_candidates_agree_with_a_search_without_grids(dims, n, candidates):
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


@pytest.mark.parametrize("spec", ["poisson-disk(radius=0.9)", "dart-throwing(radius=0.95)"])
def test_sets_without_room_are_an_error(spec):
    with pytest.raises(CountError, match="no room for 200 points in 2 dims.* smaller radius"):
        sampler(spec).draw(200, rng=1)
