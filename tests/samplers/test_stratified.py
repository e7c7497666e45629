"""Stratified sets: who sits in which stratum, exactly; what is random in it, by χ² and moments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.streams import Stream, mix_bits
from mcspectra.samplers import (
    Jittered,
    LatinHypercube,
    MultiJittered,
    Random,
    Regular,
    UniformJitter,
)
from mcspectra.samplers._kernels import _mix_below, fill_jittered

LEVEL = 1 - (1 - 1e-6) ** (1 / 16)  # Šidák: 16 statistical tests in this file share 1e-6
SIGMAS = stats.norm.isf(LEVEL / 2)


def assert_variance(estimates, expected):
    """Compare a sample variance with theory, within SIGMAS of its standard error."""
    r = len(estimates)
    centred = estimates - estimates.mean()
    error = np.sqrt((np.mean(centred**4) - estimates.var() ** 2) / r)
    assert abs(estimates.var(ddof=1) - expected) < SIGMAS * error


def cell_indices(points, sides):
    """Number of the cell of every point, row-major: (R, n)."""
    cells = np.floor(points * sides).astype(int)
    return cells @ sides ** np.arange(points.shape[-1])[::-1]


@pytest.mark.parametrize("cls", [Jittered, UniformJitter, Regular])
@pytest.mark.parametrize(("dims", "sides"), [(1, 7), (2, 5), (3, 4), (6, 2), (40, 1)])
def test_one_point_in_each_cell_in_row_major_order(cls, dims, sides):
    n = sides**dims
    points = cls(dims=dims).draw(n, realizations=50, rng=3)
    np.testing.assert_array_equal(cell_indices(points, sides), np.tile(np.arange(n), (50, 1)))


def test_regular_positions():
    centers = Regular(dims=2).draw(4)[0]
    np.testing.assert_array_equal(centers, [[0.25, 0.25], [0.25, 0.75], [0.75, 0.25], [0.75, 0.75]])
    np.testing.assert_array_equal(
        Regular(dims=1, position="corner").draw(4)[0, :, 0], [0, 0.25, 0.5, 0.75]
    )


def test_jitter_is_uniform_and_independent_in_the_cells():
    points = Jittered(dims=2).draw(16, realizations=4000, rng=11)
    inside = points * 4 % 1.0
    # Pairs of coordinates of one point, then of neighbours in the order of generation
    for a, b in [(inside[..., 0], inside[..., 1]), (inside[:, :-1, 0], inside[:, 1:, 0])]:
        pairs = (8 * np.floor(8 * a) + np.floor(8 * b)).astype(int)
        assert stats.chisquare(np.bincount(pairs.ravel(), minlength=64)).pvalue > LEVEL


def test_uniform_jitter_has_one_offset_for_all_points():
    points = UniformJitter(dims=3).draw(27, realizations=2000, rng=5)
    offsets = points[:, :1]
    grid = Regular(dims=3, position="corner").draw(27)
    np.testing.assert_allclose(points - offsets, np.broadcast_to(grid, points.shape), atol=2e-16)
    bins = (np.floor(offsets[:, 0] * 3 * 4) @ [16, 4, 1]).astype(int)
    assert stats.chisquare(np.bincount(bins, minlength=64)).pvalue > LEVEL


def test_sums_that_round_to_one_stay_below_it():
    """A last cell of half an ulp, of which the upper half would round to 1."""
    below_one = np.nextafter(1.0, 0.0)
    out = np.empty((1, 1000))
    fill_jittered(Stream(1).keys(0, 1), np.full(1000, below_one), 2.0**-53, out)
    np.testing.assert_array_equal(out, below_one)


@pytest.mark.parametrize(("n", "dims"), [(1, 3), (7, 1), (50, 2), (33, 5)])
def test_latin_hypercube_projections(n, dims):
    strata = np.floor(LatinHypercube(dims=dims).draw(n, realizations=50, rng=2) * n)
    expected = np.broadcast_to(np.arange(n)[:, None], strata.shape)
    np.testing.assert_array_equal(np.sort(strata, axis=1), expected)


def test_latin_hypercube_permutations_are_uniform_and_independent():
    strata = np.floor(LatinHypercube(dims=2).draw(3, realizations=18_000, rng=4) * 3)
    codes = np.unique(strata.reshape(len(strata), -1), axis=0, return_counts=True)[1]
    assert len(codes) == 36
    assert stats.chisquare(codes).pvalue > LEVEL


def test_bounded_numbers_are_the_upper_word_of_the_product():
    k0, k1 = np.uint64(0x0123456789ABCDEF), np.uint64(0xFEDCBA9876543210)
    for i, bound in enumerate([1, 2, 3, 10, 1000, 2**31 - 1, 2**31]):
        bits = int(mix_bits(k0, k1, i))
        assert _mix_below(k0, k1, i, bound) == (bits * bound) >> 64


@pytest.mark.parametrize(("n", "columns", "rows"), [(1, 1, 1), (2, 1, 2), (16, 4, 4), (24, 4, 6)])
def test_multi_jittered_is_jittered_and_latin(n, columns, rows):
    points = MultiJittered().draw(n, realizations=50, rng=9)
    cells = np.floor(points * [columns, rows]) @ [rows, 1]
    np.testing.assert_array_equal(np.sort(cells, axis=1), np.tile(np.arange(n), (50, 1)))
    latin = np.sort(np.floor(points * n), axis=1)
    np.testing.assert_array_equal(latin, np.broadcast_to(np.arange(n)[:, None], latin.shape))


def test_multi_jittered_shuffles_are_uniform_and_independent():
    """2 × 2 cells: four shuffles of two, 16 equally likely patterns."""
    strata = np.floor(MultiJittered().draw(4, realizations=16_000, rng=6) * 4)
    codes = np.unique(strata.reshape(len(strata), -1), axis=0, return_counts=True)[1]
    assert len(codes) == 16
    assert stats.chisquare(codes).pvalue > LEVEL


def test_multi_jittered_counts_are_the_nearly_square_products():
    possible = [a * b for a in range(1, 40) for b in range(a, 2 * a + 1)]
    source = MultiJittered()
    for n in range(1, 800):
        if n in possible:
            assert source.check_count(n) == n
            continue
        below = max(m for m in possible if m < n)
        above = min(m for m in possible if m > n)
        with pytest.raises(CountError, match=f"{below} and {above}") as caught:
            source.check_count(n)
        assert caught.value.nearest == (below, above)


@pytest.mark.parametrize("dims", [0, 1, 3, 2.5, "2", None])
def test_multi_jittered_is_two_dimensional(dims):
    with pytest.raises(ParameterError, match="must be 2"):
        MultiJittered(dims=dims)


@pytest.mark.parametrize("dims", [2, 3, 5, 13, 31])
def test_sides_are_exact_roots(dims):
    source = Jittered(dims=dims)
    largest = int(2 ** (31 / dims) + 1e-9)
    for s in {1, 2, 3, largest - 1, largest} - {0}:
        if s <= largest:
            assert source.sides(s**dims) == s
    with pytest.raises(CountError, match="nearest") as caught:
        source.sides(largest**dims - 1)
    assert caught.value.nearest == ((largest - 1) ** dims, largest**dims)


def test_nearest_counts():
    assert Jittered(dims=2).nearest_count(250) == 256
    assert Jittered(dims=2).nearest_count(240) == 225
    assert Jittered(dims=10).nearest_count(500) == 1
    with pytest.raises(CountError, match="nearest count is 1"):
        Jittered(dims=64).draw(1000)


@pytest.mark.parametrize(
    ("source", "n", "expected"),
    [
        (Random(dims=1), 16, 1 / (12 * 16)),
        (Jittered(dims=1), 16, 1 / (12 * 16**3)),
        (UniformJitter(dims=1), 16, 1 / (12 * 16**2)),
        (Jittered(dims=2), 16, 1 / (12 * 16**2)),
        (LatinHypercube(dims=2), 16, 1 / (12 * 16**3)),
        (MultiJittered(), 16, 1 / (12 * 16**3)),
    ],
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_variance_of_the_mean_coordinate(source, n, expected):
    """Exact: strata of width w contribute w²/12 each, independent of one another."""
    means = source.draw(n, realizations=20_000, rng=8)[..., 0].mean(axis=1)
    assert_variance(means, expected)
    assert abs(means.mean() - 0.5) < SIGMAS * np.sqrt(expected / len(means))
