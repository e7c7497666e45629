"""Subset, skip, shuffle: selected points, their order and probability, counts."""

import numpy as np
import pytest
from scipy import stats

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.samplers import (
    Halton,
    Hammersley,
    Jittered,
    Random,
    Shuffle,
    Skip,
    Sobol,
    Subset,
    selection,
)

LEVEL = 1 - (1 - 1e-6) ** (1 / 4)  # Šidák: 4 statistical tests in this file share 1e-6


def chosen_indices(source, n, size, realizations):
    """Return indices of the selected radical inverses 0 … size − 1, in order: (R, n)."""
    whole = Halton(dims=1).draw(size)[0, :, 0]
    rank = np.argsort(whole)
    points = source.draw(n, realizations=realizations, rng=1)[..., 0]
    return rank[np.searchsorted(whole[rank], points)]


def test_random_subsets_are_in_order_and_equally_likely():
    """Subsets of 3 out of 6 points: 20 subsets."""
    source = Halton(dims=1).then(Subset(of=6))
    indices = chosen_indices(source, 3, 6, 8000)
    assert (np.diff(indices, axis=1) > 0).all()
    counts = np.unique(indices @ [36, 6, 1], return_counts=True)[1]
    assert len(counts) == 20
    assert stats.chisquare(counts).pvalue > LEVEL


def test_runs_are_cyclic_from_a_uniform_start():
    source = Halton(dims=1).then(Subset(of=6, pick="run"))
    indices = chosen_indices(source, 4, 6, 6000)
    expected = (indices[:, :1] + np.arange(4)) % 6
    np.testing.assert_array_equal(indices, expected)
    assert stats.chisquare(np.bincount(indices[:, 0])).pvalue > LEVEL


def test_a_subset_of_all_is_the_set():
    np.testing.assert_array_equal(
        mcs.sampler("jittered | subset", 2).draw(64, rng=1), Jittered(dims=2).draw(64, rng=1)
    )


def test_any_count_by_the_next_larger_set():
    source = Jittered(dims=2).then(Subset())
    points = source.draw(10, realizations=200, rng=1)
    cells = np.sort(np.floor(points * 4) @ [4, 1], axis=1)
    assert (np.diff(cells, axis=1) > 0).all()  # points are in ten of the sixteen cells
    assert source.nearest_count(10) == 10
    with pytest.raises(CountError, match="makes at most 46340 points"):
        Jittered(dims=1).then(Subset(of=46340)).draw(50_000)
    with pytest.raises(CountError, match="nearest"):
        mcs.Sampler.from_points(np.full((5, 1), 0.5)).then(Subset()).draw(6)


def test_sets_are_drawn_in_blocks_without_a_seam(monkeypatch):
    source = Random(dims=2).then(Subset(of=20))
    whole = source.draw(5, realizations=9, rng=1)
    skipped = Random(dims=2).then(Skip(count=7)).draw(5, realizations=9, rng=1)
    monkeypatch.setattr(selection, "_NUMBERS", 100)  # two sets of twenty points
    np.testing.assert_array_equal(source.draw(5, realizations=9, rng=1), whole)
    np.testing.assert_array_equal(
        Random(dims=2).then(Skip(count=7)).draw(5, realizations=9, rng=1), skipped
    )


unbalanced = pytest.mark.filterwarnings("ignore::mcspectra.core.errors.NotPowerOfTwoWarning")


@unbalanced
@pytest.mark.parametrize("count", [0, 1, 7, 64])
def test_skip_leaves_out_the_first_points(count):
    whole = Sobol(dims=3).draw(128)[0]
    part = Sobol(dims=3).then(Skip(count=count)).draw(64)[0]
    np.testing.assert_array_equal(part, whole[count : count + 64])
    np.testing.assert_array_equal(Skip(count=count).apply(whole[None], None, 0)[0], whole[count:])


@unbalanced
@pytest.mark.parametrize(("count", "balanced"), [(64, True), (128, True), (1, False), (32, False)])
def test_runs_of_sequences_are_nets_at_multiples_of_their_size(count, balanced):
    points = Sobol(dims=2).then(Skip(count=count)).draw(64)[0]
    cells = np.floor(points * 8) @ [8, 1]
    assert (len(np.unique(cells)) == 64) == balanced


def test_counts_after_skip():
    source = mcs.Sampler.from_points(np.random.default_rng(1).random((20, 2))).then(Skip(count=5))
    assert source.check_count(15) == 15
    with pytest.raises(CountError, match="nearest count is 15"):
        source.draw(16)
    with pytest.raises(CountError):
        mcs.Sampler.from_points(np.full((4, 2), 0.5)).then(Skip(count=5)).draw(1)


def test_hammersley_points_are_not_a_sequence():
    with pytest.raises(
        ParameterError, match="which is not a sequence; use a sequence such as sobol, halton"
    ):
        Hammersley(dims=2).then(Skip(count=1))
    with pytest.raises(ParameterError, match="not a sequence"):
        mcs.sampler("hammersley | owen | skip(count=1)", 2)


def test_every_order_is_equally_likely():
    source = Halton(dims=1).then(Shuffle())
    indices = chosen_indices(source, 4, 4, 9600)
    np.testing.assert_array_equal(np.sort(indices, axis=1), np.tile(np.arange(4), (9600, 1)))
    counts = np.unique(indices @ [64, 16, 4, 1], return_counts=True)[1]
    assert len(counts) == 24
    assert stats.chisquare(counts).pvalue > LEVEL


def test_shuffle_moves_whole_points():
    whole = Jittered(dims=3).draw(27, realizations=5, rng=2)
    moved = Jittered(dims=3).then(Shuffle()).draw(27, realizations=5, rng=2)
    for before, after in zip(whole, moved, strict=True):
        assert {tuple(p) for p in before} == {tuple(p) for p in after}


def test_padded_sets_are_not_correlated_once_shuffled():
    """Two equal Sobol' coordinates; after a shuffle their correlation is 0 ± 1/sqrt(n−1)."""
    x = Sobol(dims=1).then(Shuffle()).draw(64, realizations=400, rng=3)[..., 0]
    plain = Sobol(dims=1).draw(64)[0, :, 0]
    r = np.array([np.corrcoef(plain, row)[0, 1] for row in x])
    assert abs(r.mean()) < stats.norm.isf(LEVEL / 2) / np.sqrt(63 * 400)
