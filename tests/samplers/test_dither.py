"""Void and cluster: every step is the best there is, exactly; the sets are blue noise."""

from __future__ import annotations

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import VoidAndCluster
from mcspectra.samplers.dither import dither_mask

SIDE = 32
HALF = SIDE * SIDE // 2
FIRST = round(0.1 * SIDE * SIDE)  # ones of the first pattern
CUT = 1e-5  # what the Gaussians' tails beyond their cut can add up to

KEYS = Stream(3).keys(0, 4)


def gaussian(side, sigma):
    """Gaussian around cell (0, 0) of the torus."""
    offsets = np.minimum(np.arange(side), side - np.arange(side))
    return np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * sigma**2))


def energies(pattern, sigma=1.5):
    """Sum of Gaussians around the ones, through the spectrum."""
    transform = np.fft.rfft2(pattern) * np.fft.rfft2(gaussian(len(pattern), sigma))
    return np.fft.irfft2(transform, s=pattern.shape)


def toroidal_distances(points):
    """Distance of every point to its nearest neighbour on the torus."""
    offsets = np.abs(points[:, None] - points)
    squares = (np.minimum(offsets, 1 - offsets) ** 2).sum(axis=-1)
    np.fill_diagonal(squares, np.inf)
    return np.sqrt(squares.min(axis=1))


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


def test_masks_differ():
    masks = [dither_mask(8, keys) for keys in KEYS]
    assert len(np.unique(np.reshape(masks, (4, -1)), axis=0)) == 4


def test_the_first_pattern_cannot_be_relaxed(mask):
    pattern = mask < FIRST
    energy = energies(pattern)
    cluster = np.argmax(np.where(pattern, energy, -np.inf))
    pattern.flat[cluster] = False
    rest = energies(pattern)
    assert rest[~pattern].min() > rest.flat[cluster] - CUT


@pytest.mark.parametrize("rank", range(FIRST // 2, FIRST, 7))
def test_below_the_first_pattern_the_tightest_cluster_goes(mask, rank):
    energy = energies(mask <= rank)
    assert energy[mask == rank] > energy[mask <= rank].max() - CUT


@pytest.mark.parametrize("rank", range(FIRST, HALF, 37))
def test_above_it_the_largest_void_is_filled(mask, rank):
    energy = energies(mask < rank)
    assert energy[mask == rank] < energy[mask >= rank].min() + CUT


@pytest.mark.parametrize("rank", range(HALF, SIDE * SIDE * 7 // 8, 37))
def test_above_a_half_the_tightest_cluster_of_zeros_is_filled(mask, rank):
    energy = energies(mask >= rank)
    assert energy[mask == rank] > energy[mask >= rank].max() - CUT


@pytest.mark.parametrize("keys", KEYS, ids=range(4))
def test_all_prefixes_and_all_rests_keep_their_distance(keys):
    """At least half of that in a hexagonal lattice, however few they are: the Gaussian must reach."""
    ranks = dither_mask(64, keys)
    for k in (2, 3, 5, 10, 30, 100, 300):
        for chosen in (ranks < k, ranks >= 64 * 64 - k):
            nearest = toroidal_distances(np.argwhere(chosen) / 64).min()
            assert nearest > 0.5 * np.sqrt(2 / (np.sqrt(3) * k))


@pytest.mark.parametrize("size", [0, -1, 1.5, 4096, "8", None, True, float("nan")])
def test_impossible_sizes(size):
    with pytest.raises(ParameterError, match=r"^size is .*; give a whole number from 1 to 2048\."):
        dither_mask(size, KEYS[0])


def test_points_are_in_cells_of_their_own():
    points = VoidAndCluster(cells=16).draw(100, realizations=5, rng=1)
    cells = np.floor(points * 40) @ [40, 1]
    assert all(len(np.unique(row)) == 100 for row in cells)


def test_prefixes_are_spread_evenly():
    """At least half of the distance in a square lattice."""
    for points in VoidAndCluster().draw(256, realizations=4, rng=2):
        for k in (2, 4, 16, 64, 128):
            assert toroidal_distances(points[:k]).min() > 0.5 / np.sqrt(k)


def test_low_frequencies_are_suppressed():
    """Below half the frequency √n of the spacing the power is a tenth of random points' at most."""
    n = 256
    power = mcs.power_spectrum(VoidAndCluster(), n, half_width=8, realizations=50, rng=3)["power"]
    norm = np.hypot(*np.meshgrid(np.arange(-8, 9), np.arange(-8, 9)))
    low = n * power.values[(norm > 0) & (norm <= 8)]
    assert low.mean() < 0.1
    assert low.max() < 0.2


def test_any_count_up_to_the_most():
    source = VoidAndCluster()
    for n in (1, 2, 3, 17):
        assert source.draw(n, rng=1).shape == (1, n, 2)
    with pytest.raises(CountError, match="makes at most 65536 points"):
        source.draw(2**16 + 1)


@pytest.mark.parametrize("cells", [0, 3, 257, 4.5, "16", None, True, float("inf")])
def test_impossible_cells(cells):
    with pytest.raises(ParameterError, match="cells is .* from 4 to 256"):
        VoidAndCluster(cells=cells)


@pytest.mark.parametrize("dims", [0, 1, 3, 2.5, "2", None])
def test_two_dimensional(dims):
    with pytest.raises(ParameterError, match="must be 2"):
        VoidAndCluster(dims=dims)
