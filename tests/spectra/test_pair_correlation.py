"""Pair correlation: random is 1, strata repel."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError


@pytest.mark.parametrize("dims", [1, 2, 3])
def test_random_points_have_g_of_one(dims):
    d = mcs.pair_correlation(mcs.sampler("random", dims=dims), 200, bins=20, realizations=40, rng=1)
    assert d["pair_correlation"].dims == ("r",)
    pull = (d["pair_correlation"] - 1) / d["pair_correlation_se"]
    # 20 bins; t with 39 degrees: 6 σ has probability 5e-7
    assert np.abs(pull).max() < 6


def test_jittered_points_in_1d_match_the_exact_pair_density():
    """Two points of different cells: ρ(r) = 1 − (1/n)·overlap of a cell with itself shifted by r."""
    n, bins = 8, 64
    d = mcs.pair_correlation(
        mcs.sampler("jittered", dims=1), n, bins=bins, realizations=4000, rng=2
    )
    # mean over a bin of g(r) = (1 − max(0, 1 − n r)/1) · n/(n−1), on the torus
    fine = (np.arange(bins * 50) + 0.5) / (bins * 100)
    g = (1 - np.maximum(0, 1 - n * fine)) * n / (n - 1)
    expected = g.reshape(bins, 50).mean(axis=1)
    pull = np.abs(d["pair_correlation"] - expected) / (d["pair_correlation_se"] + 1e-12)
    assert pull.max() < 6


def test_one_point_has_no_pairs():
    with pytest.raises(ParameterError, match="at least 2"):
        mcs.pair_correlation("random", 1)
