"""Means over realisations and their standard errors, from sums that merge."""

from __future__ import annotations

import numpy as np

from mcspectra.core.analysis import MergeTree
from mcspectra.core.records import MeanSums


def test_mean_and_error_are_those_of_numpy():
    values = np.random.default_rng(1).random((9, 4))
    before, tree = values.copy(), MergeTree()
    for row in values:
        tree.add(MeanSums.of(row))
    mean, se = tree.total().mean_and_error()
    np.testing.assert_allclose(mean, values.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(se, values.std(axis=0, ddof=1) / 3, rtol=1e-12)
    np.testing.assert_array_equal(values, before)


def test_one_realization_has_no_error():
    mean, se = MeanSums.of(np.array([2.0])).mean_and_error()
    assert mean.tolist() == [2.0]
    assert np.isnan(se).all()
