"""Mirroring: one to one on the grid of float64, strata of the images, antithetic sums, a rate."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import Jittered, LatinHypercube, Mirror, Random, Sobol, Structure

LEVEL = 1 - (1 - 1e-6) ** (1 / 4)  # Šidák: 4 statistical tests in this file share 1e-6
BELOW_ONE = np.nextafter(1.0, 0.0)
EDGES = np.array([0.0, 2.0**-53, 0.25, 0.5 - 2.0**-53, 0.5, 0.5 + 2.0**-53, 0.75, BELOW_ONE])
STREAM = Stream.from_rng(3)


@pytest.mark.parametrize("dims", [1, 2, 3, 64, 65, 130])
def test_random_reflection_reflects_or_not(dims):
    points = Random(dims=dims).draw(50, realizations=20, rng=1)
    moved = Mirror().apply(points, STREAM, 0)
    flipped = moved != points
    np.testing.assert_array_equal(moved[flipped], (BELOW_ONE - points)[flipped])
    # Fair coins, also in pairs of neighbouring coordinates, points and realisations
    bits = flipped.ravel().astype(int)
    pairs = 2 * bits[:-1:2] + bits[1::2]
    assert stats.chisquare(np.bincount(pairs, minlength=4)).pvalue > LEVEL / 6


@pytest.mark.parametrize("mode", ["random", "uniform", "fold"])
def test_results_stay_below_one_at_the_edges(mode):
    moved = Mirror(mode=mode).apply(np.tile(EDGES[:, None], (100, 1, 1)), STREAM, 0)
    assert moved.min() >= 0.0
    assert moved.max() < 1.0


def test_folding_to_the_last_bit():
    ulp = 2.0**-53
    moved = Mirror(mode="fold").apply(EDGES[:, None, None], STREAM, 0).ravel()
    expected = [0.0, 2 * ulp, 0.5, 1 - 2 * ulp, 1 - ulp, 1 - 3 * ulp, 0.5 - ulp, ulp]
    np.testing.assert_array_equal(moved, expected)


def test_folding_is_one_to_one_on_the_grid_and_keeps_points_uniform():
    """A grid of 1,024 multiples of 2^-53 about ½, the only place where the two branches meet."""
    grid = 0.5 + np.arange(-512, 512) * 2.0**-53
    moved = Mirror(mode="fold").apply(grid[:, None, None], STREAM, 0)
    assert len(np.unique(moved)) == 1024
    x = Random(dims=1).draw(6400, rng=2)
    cells = np.floor(Mirror(mode="fold").apply(x, STREAM, 0).ravel() * 64).astype(int)
    assert stats.chisquare(np.bincount(cells, minlength=64)).pvalue > LEVEL


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_uniform_mode_holds_all_images_of_each_point(dims):
    n = 3 * 2**dims
    points = Random(dims=dims).draw(3, realizations=4, rng=5)
    moved = Random(dims=dims).then(Mirror(mode="uniform")).draw(n, realizations=4, rng=5)
    images = moved.reshape(4, 3, 2**dims, dims)
    for k, signs in enumerate(itertools.product((False, True), repeat=dims)):
        expected = np.where(signs, BELOW_ONE - points, points)
        np.testing.assert_array_equal(images[:, :, k], expected)


def test_uniform_mode_integrates_odd_functions_exactly():
    """Antithetic: the mean of each coordinate is (1 − 2^-53)/2 but for the rounding of sums."""
    moved = mcs.sampler("random | mirror(mode='uniform')", 3).draw(64, realizations=20, rng=1)
    np.testing.assert_allclose(moved.mean(axis=1), 0.5, atol=64 * 2.0**-53)


@pytest.mark.parametrize("sides", [3, 4, 7])
def test_uniform_mode_keeps_strata_and_nets(sides):
    n = 4 * sides**2
    moved = Jittered(dims=2).then(Mirror(mode="uniform")).draw(n, realizations=30, rng=1)
    cells = np.floor(moved * sides).astype(int) @ [sides, 1]
    np.testing.assert_array_equal(
        np.sort(cells, axis=1), np.tile(np.repeat(np.arange(sides**2), 4), (30, 1))
    )
    net = mcs.sampler("sobol | owen | mirror(mode='uniform')", 2).draw(64, realizations=20, rng=2)
    for k in range(5):
        cells = np.floor(net * [2**k, 2 ** (4 - k)]) @ [2 ** (4 - k), 1]
        np.testing.assert_array_equal(
            np.sort(cells, axis=1), np.tile(np.repeat(np.arange(16), 4), (20, 1))
        )


def test_counts_of_the_uniform_mode_are_multiples_of_the_samplers():
    source = Jittered(dims=2).then(Mirror(mode="uniform"))
    assert source.nearest_count(40) == 36
    with pytest.raises(CountError, match="36 and 64") as caught:
        source.draw(40)
    assert caught.value.nearest == (36, 64)
    with pytest.raises(CountError, match="nearest count is 8"):
        LatinHypercube(dims=3).then(Mirror(mode="uniform")).draw(7)
    with pytest.raises(CountError, match=r"from 1 to"):
        source.draw(2**40)


def test_too_many_images_are_refused():
    with pytest.raises(ParameterError, match="at most 30"):
        Random(dims=31).then(Mirror(mode="uniform"))


def test_what_is_left():
    jittered, sobol = Jittered(dims=2), Sobol(dims=2)
    assert jittered.then(Mirror()).structure is Structure.NONE
    assert sobol.then(Mirror(mode="fold")).structure is Structure.NONE
    assert jittered.then(Mirror(mode="uniform")).structure is Structure.STRATA
    assert sobol.then(Mirror(mode="uniform")).structure is Structure.DIGITS
    assert not Mirror.debiases


def test_folded_lattices_have_the_rate_of_smooth_periodic_functions():
    """x² in 1-D at a shifted lattice: variance ~ n^-2; folded, continuous with kinks: ~ n^-4."""
    f = mcs.Estimator("polynomial(coefficients=[0, 0, 1])", dims=1)
    for spec, rate in (
        ("rank1-lattice(vector=[1]) | shift", -2.0),
        ("rank1-lattice(vector=[1]) | shift | mirror(mode='fold')", -4.0),
    ):
        d = mcs.convergence(f, spec, [8, 32, 128], realizations=1000, rng=1)
        low, high = d["rate_ci"].values
        assert abs(float(d["rate"]) - rate) < 2 * (high - low) / 1.96 + 0.03, spec


@pytest.mark.parametrize("mode", ["baker", None, True, 1, float("nan")])
def test_bad_modes(mode):
    with pytest.raises(ParameterError, match="random, uniform, fold"):
        Mirror(mode=mode)
