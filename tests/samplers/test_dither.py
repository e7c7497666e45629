"""Void and cluster: every step is optimal; low-discrepancy blue noise: strata are exact."""

import numpy as np
import pytest
from scipy.stats import qmc
from tests.samplers.test_progressive import occupancy, toroidal_distances

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import LowDiscrepancyBlueNoise, VoidAndCluster
from mcspectra.samplers.dither import dither_mask, snap_in_chunks

SIDE = 32
HALF = SIDE * SIDE // 2
FIRST = round(0.1 * SIDE * SIDE)  # number of ones in the first pattern
CUT = 1e-5  # bound of the sum of the Gaussians' tails beyond the cutoff
KEYS = Stream(3).keys(0, 4)


def gaussian(side, sigma):
    """Return a Gaussian around cell (0, 0) of the torus."""
    offsets = np.minimum(np.arange(side), side - np.arange(side))
    return np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * sigma**2))


def energies(pattern, sigma=1.5):
    """Return the sum of Gaussians around the ones, computed by a Fourier transform."""
    transform = np.fft.rfft2(pattern) * np.fft.rfft2(gaussian(len(pattern), sigma))
    return np.fft.irfft2(transform, s=pattern.shape)


@pytest.fixture(scope="module")
def mask():
    return dither_mask(SIDE, KEYS[0])


@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 7, 16, 33])
def test_ranks_are_a_permutation(size):
    ranks = dither_mask(size, KEYS[0])
    assert ranks.shape == (size, size)
    assert ranks.dtype == np.int64
    np.testing.assert_array_equal(np.sort(ranks, axis=None), np.arange(size * size))
    np.testing.assert_array_equal(ranks, dither_mask(size, KEYS[0]))


def test_the_first_pattern_cannot_be_relaxed(mask):
    pattern = mask < FIRST
    energy = energies(pattern)
    cluster = np.argmax(np.where(pattern, energy, -np.inf))
    pattern.flat[cluster] = False
    rest = energies(pattern)
    assert rest[~pattern].min() > rest.flat[cluster] - CUT


def test_every_rank_is_the_tightest_cluster_or_the_largest_void(mask):
    """Ranks below the first pattern, between it and a half, and above a half."""
    for rank in range(FIRST // 2, FIRST, 7):
        energy = energies(mask <= rank)
        assert energy[mask == rank] > energy[mask <= rank].max() - CUT
    for rank in range(FIRST, HALF, 37):
        energy = energies(mask < rank)
        assert energy[mask == rank] < energy[mask >= rank].min() + CUT
    for rank in range(HALF, SIDE * SIDE * 7 // 8, 37):
        energy = energies(mask >= rank)
        assert energy[mask == rank] > energy[mask >= rank].max() - CUT


@pytest.mark.parametrize("keys", KEYS, ids=range(4))
def test_all_prefixes_and_all_rests_keep_their_distance(keys):
    """Distances are at least half the hexagonal lattice's, so the Gaussian is wide enough."""
    ranks = dither_mask(64, keys)
    for k in (2, 3, 5, 10, 30, 100, 300):
        for chosen in (ranks < k, ranks >= 64 * 64 - k):
            nearest = toroidal_distances(np.argwhere(chosen) / 64).min()
            assert nearest > 0.5 * np.sqrt(2 / (np.sqrt(3) * k))


@pytest.mark.parametrize("size", [0, 1.5, 4096, "8"])
def test_impossible_sizes(size):
    with pytest.raises(ParameterError, match=r"^size is .*; give a whole number from 1 to 2048\."):
        dither_mask(size, KEYS[0])


def test_every_point_has_its_own_cell():
    points = VoidAndCluster(cells=16).draw(100, realizations=5, rng=1)
    cells = np.floor(points * 40) @ [40, 1]
    assert all(len(np.unique(row)) == 100 for row in cells)


def test_prefixes_are_spread_evenly():
    """Distances are at least half of that in a square lattice."""
    for points in VoidAndCluster().draw(256, realizations=4, rng=2):
        for k in (2, 4, 16, 64, 128):
            assert toroidal_distances(points[:k]).min() > 0.5 / np.sqrt(k)


COUNTS = [1, 4, 16, 64, 256, 1024]


def draw(n, realizations=10, **parameters):
    """Draw realizations with few sweeps; exact properties do not depend on the sweeps."""
    source = LowDiscrepancyBlueNoise(sweeps=3, **parameters)
    return source.draw(n, realizations=realizations, rng=1)


@pytest.mark.parametrize("n", COUNTS)
@pytest.mark.parametrize("chunk", [2, 16, 64])
def test_one_point_in_each_cell_in_row_major_order_and_in_each_interval(n, chunk):
    points = draw(n, chunk=chunk)
    side = round(n**0.5)
    cells = np.floor(points * side) @ [side, 1]
    np.testing.assert_array_equal(cells, np.tile(np.arange(n), (10, 1)))
    assert (occupancy(points, n, 1) == 1).all()
    assert (occupancy(points, 1, n) == 1).all()


@pytest.mark.parametrize("chunk", [2, 4, 8, 16, 32])
def test_elementary_intervals_as_long_as_a_chunk(chunk):
    points = draw(1024, chunk=chunk)
    for longer in range(6):
        flat = occupancy(points, 32 >> longer, 32 << longer)
        tall = occupancy(points, 32 << longer, 32 >> longer)
        kept = longer == 0 or 1 << longer >= chunk
        assert (flat == 1).all() == (tall == 1).all() == kept


def test_points_follow_the_order_of_those_given():
    keys, points = Stream(4).keys(0, 1)[0], np.empty((32, 32, 2))
    grid = np.stack(np.meshgrid(np.arange(32), np.arange(32), indexing="ij"), axis=-1)
    followed = grid + Stream(5).uniforms(0, 1, 2048).reshape(32, 32, 2)
    snap_in_chunks(keys[0], keys[1], 4096, 8, followed, points)
    for axis in range(2):
        given = np.moveaxis(followed[..., axis], axis, 0).reshape(32, 4, 8)
        made = np.moveaxis(points[..., axis], axis, 0).reshape(32, 4, 8)
        np.testing.assert_array_equal(np.argsort(given), np.argsort(made))


def test_chunks_are_in_the_order_of_shifted_van_der_corput_points():
    points = draw(1024, chunk=8)[0].reshape(32, 32, 2)
    for axis in range(2):
        intervals = np.moveaxis(points[..., axis], axis, 0).reshape(32, 4, 8) * 1024 % 4
        low = np.floor(intervals).astype(int)
        assert (low == low[..., :1]).all()
        assert (low[:, :, 0] ^ low[:, :1, 0] == [0, 2, 1, 3]).all()
        assert len(np.unique(low[:, 0, 0])) == 4


def test_discrepancy_is_comparable_with_nets():
    """Squared L2 star discrepancy: within 1.5 of scrambled Sobol', a tenth of random points."""

    def squares(spec):
        sets = mcs.samplers.sampler(spec).draw(256, realizations=20, rng=2)
        return np.mean([qmc.discrepancy(points, method="L2-star") ** 2 for points in sets])

    mine = squares("ldbn")
    assert mine < 1.5**2 * squares("sobol | owen")
    assert mine < 0.1 * (1 / 4 - 1 / 9) / 256  # exact value for random points


@pytest.mark.parametrize(("spec", "most"), [("void-and-cluster", 0.1), ("ldbn", 0.05)])
def test_low_frequencies_are_suppressed(spec, most):
    """Mean power below half the frequency √n of the spacing; random points have power 1."""
    n = 256
    power = mcs.power_spectrum(spec, n, half_width=8, realizations=30, rng=3)["power"].values
    norm = np.hypot(*np.meshgrid(np.arange(-8, 9), np.arange(-8, 9)))
    low = n * power[(norm > 0) & (norm <= 8)]
    assert low.mean() < most
    assert low.max() < 0.2


def test_larger_chunks_and_more_sweeps_keep_points_farther_apart():
    def nearest(**parameters):
        sets = LowDiscrepancyBlueNoise(**parameters).draw(256, realizations=16, rng=4)
        values = [16 * toroidal_distances(points).min() for points in sets]
        return np.mean(values), np.std(values) / np.sqrt(16)

    high, b = nearest()
    for worse in ({"chunk": 2}, {"sweeps": 1}):
        low, a = nearest(**worse)
        assert high - low > 5 * np.hypot(a, b)


def test_variance_on_a_gaussian_is_below_that_of_jittered_points():
    estimator = mcs.Estimator("gaussian", dims=2)
    sources = [LowDiscrepancyBlueNoise(sweeps=20), "jittered"]
    fit = mcs.convergence(estimator, sources, [64, 256], realizations=100, rng=2)
    mine, jittered = fit["variance"].values
    assert (mine < jittered / 2).all()  # log 2 is five times the error √(4/99) of the log ratio


@pytest.mark.parametrize(("n", "near"), [(2, "1 and 4"), (100, "64 and 256"), (255, "64 and 256")])
def test_counts_are_powers_of_four(n, near):
    with pytest.raises(CountError, match=f"nearest counts are {near}"):
        LowDiscrepancyBlueNoise().draw(n)
