"""Multi-jittered sets: cells and strata of both axes exactly, shuffles by χ², the memo's formula."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.samplers import CorrelatedMultiJittered, MultiJittered

LEVEL = 1 - (1 - 1e-6) ** (1 / 4)  # Šidák: the χ² tests of this file share 1e-6

both = pytest.mark.parametrize("cls", [MultiJittered, CorrelatedMultiJittered])


def pattern_counts(points):
    """How often each assignment of the points to n × n strata was drawn."""
    strata = np.floor(points * points.shape[1]).reshape(len(points), -1)
    return np.unique(strata, axis=0, return_counts=True)[1]


@both
@pytest.mark.parametrize(
    ("n", "columns", "rows"), [(1, 1, 1), (2, 1, 2), (16, 4, 4), (24, 4, 6), (1020, 30, 34)]
)
def test_jittered_and_latin(cls, n, columns, rows):
    points = cls().draw(n, realizations=50, rng=9)
    cells = np.floor(points * [columns, rows]) @ [rows, 1]
    np.testing.assert_array_equal(np.sort(cells, axis=1), np.tile(np.arange(n), (50, 1)))
    latin = np.sort(np.floor(points * n), axis=1)
    np.testing.assert_array_equal(latin, np.broadcast_to(np.arange(n)[:, None], latin.shape))


@pytest.mark.parametrize(
    ("cls", "n", "patterns"),
    [
        (MultiJittered, 4, 16),  # 2 × 2 cells: four shuffles of two
        (CorrelatedMultiJittered, 6, 12),  # 2 × 3 cells: 2! · 3!
    ],
)
def test_shuffles_are_uniform_and_independent(cls, n, patterns):
    counts = pattern_counts(cls().draw(n, realizations=16_000, rng=6))
    assert len(counts) == patterns
    assert stats.chisquare(counts).pvalue > LEVEL


@both
def test_jitter_within_the_strata_is_uniform(cls):
    inside = cls().draw(16, realizations=4000, rng=12) * 16 % 1.0
    pairs = (8 * np.floor(8 * inside[..., 0]) + np.floor(8 * inside[..., 1])).astype(int)
    assert stats.chisquare(np.bincount(pairs.ravel(), minlength=64)).pvalue > LEVEL


def rectangle(n):
    """Columns and rows of the correlated set: a nearly square rectangle, else the memo's rule."""
    exact = [a for a in range(1, math.isqrt(n) + 1) if n % a == 0 and n <= 2 * a * a]
    columns = exact[-1] if exact else math.isqrt(n)
    return columns, math.ceil(n / columns)


@pytest.mark.parametrize("n", [3, 5, 7, 10, 13, 14, 32, 61, 997])
def test_correlated_of_any_count_leaves_the_last_row_incomplete(n):
    """The second axis is Latin, the cells and the strata of the first hold at most one point."""
    points = CorrelatedMultiJittered().draw(n, realizations=40, rng=3)
    columns, rows = rectangle(n)
    np.testing.assert_array_equal(np.floor(points[..., 1] * n), np.tile(np.arange(n), (40, 1)))
    cells = np.floor(points[..., 0] * columns) * rows + np.arange(n) // columns
    strata = np.floor(points[..., 0] * columns * rows)
    for taken in (cells, strata):
        assert all(len(np.unique(row)) == n for row in taken)


@pytest.mark.parametrize("n", [24, 14])
def test_correlated_is_one_shuffle_of_columns_and_one_of_rows(n):
    """What the memo writes for point s, with the shuffles read off the first row and column."""
    columns, rows = rectangle(n)
    s = np.arange(n)
    for points in CorrelatedMultiJittered().draw(n, realizations=20, rng=8):
        fine = np.floor(points[:, 0] * columns * rows).astype(int)
        across, down = fine[:columns] // rows, fine[::columns] % rows
        np.testing.assert_array_equal(fine, across[s % columns] * rows + down[s // columns])
        assert sorted(across) == list(range(columns))
        assert sorted(down) == list(range(rows))


@pytest.mark.parametrize("spec", ["multi-jittered", "correlated-multi-jittered"])
def test_rate_on_the_disk(spec):
    """The cells alone give −1.5; the strata of the axes only lower the constant."""
    estimator = mcs.Estimator("disk(center=[0.463, 0.517], radius=0.27)", dims=2)
    found = mcs.convergence(estimator, spec, [16, 64, 256, 1024], realizations=1000, rng=2)
    low, high = found["rate_ci"].values
    error = (high - low) / 2 / 1.96
    assert abs(float(found["rate"]) + 1.5) < 4 * error + 0.05


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


@both
@pytest.mark.parametrize("dims", [0, 1, 3, 2.5, "2", None])
def test_two_dimensional(cls, dims):
    with pytest.raises(ParameterError, match="must be 2"):
        cls(dims=dims)
