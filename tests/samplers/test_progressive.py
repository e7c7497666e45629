"""Progressive sequences: strata and elementary intervals at every power of two, exactly."""

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs
from mcspectra.core.errors import NotPowerOfTwoWarning
from mcspectra.samplers import PMJ, PMJ02, PMJ02BlueNoise
from mcspectra.samplers.progressive import pairings

LEVEL = 1 - (1 - 1e-6) ** (1 / 8)  # Šidák level of each statistical test


ALL = [PMJ(), PMJ02(), PMJ02BlueNoise()]
NETS = [PMJ02(), PMJ02BlueNoise()]
every_sequence = pytest.mark.parametrize("source", ALL, ids=lambda source: source.name)
every_net = pytest.mark.parametrize("source", NETS, ids=lambda source: source.name)


def occupancy(points, columns, rows):
    """Count the points of each realization in each of columns × rows cells: (R, cells)."""
    cells = (np.floor(points * [columns, rows]) @ [rows, 1]).astype(int)
    return np.stack([np.bincount(row, minlength=columns * rows) for row in cells])


def toroidal_distances(points):
    """Return the distance of every point to its nearest neighbor on the torus."""
    offsets = np.abs(points[:, None] - points)
    squares = (np.minimum(offsets, 1 - offsets) ** 2).sum(axis=-1)
    np.fill_diagonal(squares, np.inf)
    return np.sqrt(squares.min(axis=1))


def uniform(counts):
    """Return whether counts are consistent with equally likely cells."""
    return stats.chisquare(counts).pvalue > LEVEL


@every_sequence
def test_intervals_of_either_axis_and_cells_have_one_point(source):
    """4^k points have one in each of 2^k × 2^k cells; the next 4^k are diagonal to them."""
    sequence = source.draw(2**10, realizations=20, rng=1)
    for level in range(11):
        prefix = sequence[:, : 2**level]
        assert (occupancy(prefix, 2**level, 1) == 1).all()
        assert (occupancy(prefix, 1, 2**level) == 1).all()
    for cells in (1, 2, 4, 8, 16, 32):
        first, second = sequence[:, : cells**2], sequence[:, cells**2 : 2 * cells**2]
        assert (occupancy(first, cells, cells) == 1).all()
        if cells < 32:
            quarters = np.floor(first * 2 * cells).astype(int)
            np.testing.assert_array_equal(quarters ^ 1, np.floor(second * 2 * cells).astype(int))


@every_net
def test_one_point_in_each_elementary_interval(source):
    sequence = source.draw(2**10, realizations=20, rng=3)
    for level in range(11):
        for across in range(level + 1):
            counts = occupancy(sequence[:, : 2**level], 2**across, 2 ** (level - across))
            assert (counts == 1).all()


@every_net
def test_every_block_of_the_sequence_is_a_net(source):
    blocks = source.draw(2**10, realizations=10, rng=4).reshape(10, 16, 64, 2)
    for block in blocks.transpose(1, 0, 2, 3):
        assert all((occupancy(block, 2**k, 2 ** (6 - k)) == 1).all() for k in range(7))


def test_pmj_is_not_a_net():
    prefix = PMJ().draw(64, realizations=50, rng=3)
    assert (occupancy(prefix, 2, 32) != 1).any()


@pytest.mark.parametrize("source", [PMJ(), PMJ02()], ids=["pmj", "pmj02"])
def test_shorter_sets_are_the_beginning_of_longer_ones(source):
    whole = source.draw(256, rng=5)
    np.testing.assert_array_equal(source.draw(32, rng=5), whole[:, :32])
    with pytest.warns(NotPowerOfTwoWarning, match=f"{source.name} are not balanced; 128 and 256"):
        np.testing.assert_array_equal(source.draw(200, rng=5), whole[:, :200])


def test_pairings_are_those_of_scrambled_sobol_points():
    """Sobol' points in the order of pmj02: among k + 1 digits, partners differ in digit k."""
    sobol = mcs.samplers.sampler("sobol").draw(2**10)[0]
    digits = (sobol * 2**10).astype(int)
    order = [0]
    for level in range(10):  # x of point i and of its partner differ in digit `level`
        xor = pairings()[:, level].astype(int)
        size = 2**level
        for i in range(size, 2 * size):
            pairs = [digits[order[i ^ xor[j]], j] >> (9 - level) ^ 1 for j in range(2)]
            found = np.flatnonzero((digits[: 2 * size] >> (9 - level) == pairs).all(axis=1))
            assert found.size == 1
            order.append(int(found[0]))
    assert sorted(order) == list(range(2**10))


@pytest.mark.parametrize("source", [PMJ(), PMJ02()], ids=["pmj", "pmj02"])
def test_points_and_pairs_of_points_are_as_random_as_can_be(source):
    """Each of four points is in any of 4 × 4 intervals; the third is next to or above the first."""
    points = source.draw(4, realizations=16_000, rng=6)
    intervals = np.floor(points * 4) @ [4, 1]
    for i in range(4):
        assert uniform(np.bincount(intervals[:, i].astype(int), minlength=16))
    halves = np.floor(points * 2)
    beside = halves[:, 2, 1] == halves[:, 0, 1]
    assert uniform(np.bincount(beside, minlength=2))
    # A permutation of four intervals on either axis, with the first two in different halves
    codes = np.unique(np.floor(points[..., 0] * 4), axis=0, return_counts=True)[1]
    assert len(codes) == 16
    assert uniform(codes)


def test_pmj_assigns_free_intervals_at_random():
    """Points 64 … 127 in 16 columns of 8 intervals: four are free, in one of 24 orders."""
    x = PMJ().draw(128, realizations=400, rng=10)[:, 64:, 0]
    order = np.argsort(np.floor(x * 16), axis=1, kind="stable")
    four = np.take_along_axis(x, order, axis=1).reshape(-1, 4)  # four intervals per column
    ranks = np.argsort(np.argsort(four, axis=1), axis=1)
    assert uniform(np.unique(ranks @ [64, 16, 4, 1], return_counts=True)[1])


def test_low_bits_are_uniform():
    points = PMJ().draw(16, realizations=2000, rng=7)
    assert uniform(np.bincount((points.ravel() * 16 % 1 * 64).astype(int), minlength=64))


@pytest.mark.parametrize("n", [64, 512])
def test_blue_noise_keeps_points_apart(n):
    """The nearest two points are twice as far apart as in pmj02, by many standard errors."""
    near = [
        [toroidal_distances(points).min() for points in source.draw(n, realizations=20, rng=8)]
        for source in NETS
    ]
    plain, spread = np.array(near)
    error = np.hypot(2 * plain.std(), spread.std()) / np.sqrt(20)
    assert spread.mean() - 2 * plain.mean() > 5 * error


def test_more_sweeps_lower_the_energy():
    def energy(sweeps):
        sets = PMJ02BlueNoise(sweeps=sweeps).draw(256, realizations=20, rng=9)
        return np.array([(toroidal_distances(points) ** -8.0).sum() for points in sets])

    assert (
        stats.ttest_rel(np.log(energy(1)), np.log(energy(8)), alternative="greater").pvalue < 1e-3
    )


@every_sequence
def test_other_counts_warn(source):
    for n in (3, 100):
        with pytest.warns(NotPowerOfTwoWarning, match=f"{source.name} are not balanced"):
            assert source.draw(n, rng=1).shape == (1, n, 2)
