"""Low-discrepancy blue noise: strata exactly, low discrepancy, blue noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc
from tests.samplers.test_dither import toroidal_distances
from tests.samplers.test_progressive import occupancy

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import LowDiscrepancyBlueNoise
from mcspectra.samplers._ldbn_kernels import jittered_cells, snap_in_chunks

COUNTS = [1, 4, 16, 64, 256, 1024]


def draw(n, realizations=10, **parameters):
    """Realisations with few sweeps: what is exact does not depend on them."""
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
    keys = Stream(4).keys(0, 1)[0]
    followed, points = np.empty((2, 32, 32, 2))
    jittered_cells(keys[0], keys[1], followed)
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


def test_discrepancy_is_that_of_nets():
    """L2 star discrepancy: within 1.5 of scrambled Sobol' points', squared a tenth of random ones'."""

    def squares(spec):
        sets = mcs.samplers.sampler(spec).draw(256, realizations=20, rng=2)
        return np.mean([qmc.discrepancy(points, method="L2-star") ** 2 for points in sets])

    mine = squares("ldbn")
    assert mine < 1.5**2 * squares("sobol | owen")
    assert mine < 0.1 * (1 / 4 - 1 / 9) / 256  # exact for random points


def test_low_frequencies_are_suppressed():
    """Below half the frequency √n of the cells the power is a tenth of random points' at most."""
    n = 256
    spectrum = mcs.power_spectrum("ldbn", n, half_width=8, realizations=50, rng=3)
    norm = np.hypot(*np.meshgrid(np.arange(-8, 9), np.arange(-8, 9)))
    low = n * spectrum["power"].values[(norm > 0) & (norm <= 8)]
    assert low.mean() < 0.05
    jittered = mcs.power_spectrum("jittered", n, half_width=8, realizations=50, rng=3)
    assert low.mean() < 0.2 * n * jittered["power"].values[(norm > 0) & (norm <= 8)].mean()


def test_larger_chunks_and_more_sweeps_keep_points_farther_apart():
    def nearest(**parameters):
        sets = LowDiscrepancyBlueNoise(**parameters).draw(256, realizations=20, rng=4)
        values = [16 * toroidal_distances(points).min() for points in sets]
        return np.mean(values), np.std(values) / np.sqrt(20)

    for worse, better in [({"chunk": 2}, {}), ({"sweeps": 1}, {})]:
        (low, a), (high, b) = nearest(**worse), nearest(**better)
        assert high - low > 5 * np.hypot(a, b)


def test_rate_on_a_disk():
    """As of jittered sets, n^-1.5: errors come from the cells that its edge crosses."""
    estimator = mcs.Estimator("disk(center=[0.463, 0.517], radius=0.27)", dims=2)
    source = LowDiscrepancyBlueNoise(sweeps=20)
    fit = mcs.convergence(estimator, source, [16, 64, 256], realizations=300, rng=2)
    low, high = fit["rate_ci"].values
    assert low < -1.5 < high


def test_variance_on_a_gaussian_is_below_that_of_jittered_points():
    estimator = mcs.Estimator("gaussian", dims=2)
    sources = [LowDiscrepancyBlueNoise(sweeps=20), "jittered"]
    fit = mcs.convergence(estimator, sources, [64, 256], realizations=300, rng=2)
    mine, jittered = fit["variance"].values
    assert (mine < jittered / 2).all()  # ten times the standard error of the ratio


@pytest.mark.parametrize(("n", "near"), [(2, "1 and 4"), (100, "64 and 256"), (255, "64 and 256")])
def test_counts_are_powers_of_four(n, near):
    with pytest.raises(CountError, match=f"nearest counts are {near}"):
        LowDiscrepancyBlueNoise().draw(n)


def test_largest_count():
    with pytest.raises(CountError, match="makes at most 65536 points"):
        LowDiscrepancyBlueNoise().draw(4**9)


@pytest.mark.parametrize("chunk", [0, 1, 3, 24, 128, 2.5, "4", None, True, float("nan")])
def test_impossible_chunks(chunk):
    with pytest.raises(ParameterError, match="chunk is .* from 2 to 64"):
        LowDiscrepancyBlueNoise(chunk=chunk)


@pytest.mark.parametrize("sweeps", [0, -1, 2.5, "4", None, True, float("inf"), 10**6])
def test_impossible_sweeps(sweeps):
    with pytest.raises(ParameterError, match="sweeps is .* from 1 to 100000"):
        LowDiscrepancyBlueNoise(sweeps=sweeps)


@pytest.mark.parametrize("dims", [0, 1, 3, 2.5, "2", None])
def test_two_dimensional(dims):
    with pytest.raises(ParameterError, match="must be 2"):
        LowDiscrepancyBlueNoise(dims=dims)
