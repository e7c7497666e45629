"""Pair correlations in chunks of point sets: the same bits as at once."""

from __future__ import annotations

import numpy as np
import pytest
from tests.staging import check_cuts

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.spectra.pair_correlation import mean_of_realizations, staged_pair_correlation
from mcspectra.spectra.staged_mean import mean_and_error


@pytest.mark.parametrize("boundary", ["toroidal", "border"])
def test_chunks_of_a_pair_correlation_change_nothing(boundary, monkeypatch):
    settings = {"bins": 7, "realizations": 11, "rng": 2, "boundary": boundary}

    def make():
        return staged_pair_correlation("jittered", 16, **settings)

    def public(workers):
        return mcs.pair_correlation("jittered", 16, **settings, workers=workers)

    found = check_cuts(make, public, monkeypatch, block_numbers=2**21)
    assert float(found["pair_correlation_se"].max()) > 0


def test_mean_and_error_are_those_of_numpy():
    values = np.random.default_rng(1).random((9, 4))
    mean, se = mean_of_realizations(lambda i: values[i], 9, 2)
    np.testing.assert_allclose(mean, values.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(se, values.std(axis=0, ddof=1) / 3, rtol=1e-12)


def test_one_realization_has_no_error():
    mean, se = mean_and_error((np.array([2.0]), np.array([4.0])), 1)
    assert mean.tolist() == [2.0]
    assert np.isnan(se).all()


def test_cost_grows_with_the_pairs():
    costs = [
        next(staged_pair_correlation("random", n, realizations=3).stages())[0].cost
        for n in (10, 1000)
    ]
    assert costs == [3 * (10 + 0.1 * 10**2), 3 * (1000 + 0.1 * 1000**2)]


@pytest.mark.parametrize(
    "changes",
    [{"n": 1}, {"n": 10**7}, {"bins": 0}, {"realizations": 0}, {"max_distance": float("nan")}],
)
def test_bad_input_is_refused_before_anything_runs(changes):
    with pytest.raises(ParameterError):
        staged_pair_correlation("random", **{"n": 4, **changes})
