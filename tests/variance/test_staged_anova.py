"""ANOVA parts in chunks: the same bits as at once."""

from __future__ import annotations

import numpy as np
import pytest
from tests.staging import check_cuts

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.variance.anova import staged_anova

ESTIMATOR = mcs.Estimator("gaussian(width=0.4)", dims=3)


@pytest.mark.parametrize(("order", "sampler"), [(1, "random"), (2, "jittered | shift")])
def test_chunks_of_anova_change_nothing(order, sampler, monkeypatch):
    settings = {"order": order, "realizations": 45, "rng": 3}

    def make():
        return staged_anova(ESTIMATOR, sampler, 8, **settings)

    def public(workers):
        return mcs.anova_variances(ESTIMATOR, sampler, 8, **settings, workers=workers)

    # 4 · n · d numbers of a realisation: blocks of 5
    found = check_cuts(make, public, monkeypatch, block_numbers=4 * 8 * 3 * 5)
    assert float(found["variance"]) > 0


def test_states_are_the_estimates_of_realizations_in_order(monkeypatch):
    from mcspectra.core import parallel

    monkeypatch.setattr(parallel, "_BLOCK_NUMBERS", 4 * 8 * 3 * 5)
    analysis = staged_anova(ESTIMATOR, "jittered | shift", 8, realizations=12, rng=3)
    (run,) = next(analysis.stages())
    assert (run.realizations, run.blocks) == (12, 3)
    states = [analysis.block(run, i) for i in range(3)]
    merged = analysis.merge(analysis.merge(states[0], states[1]), states[2])
    # The first mask keeps every axis: the plain estimates.
    points = mcs.sampler("jittered | shift", 3).draw(8, rng=3, realizations=12)
    plain = ESTIMATOR.estimate([points])
    assert np.array_equal(merged[0, :, 0], plain)


@pytest.mark.parametrize(
    "changes",
    [{"realizations": 1}, {"realizations": 10**8}, {"order": 3}, {"n": 0}, {"n": float("nan")}],
)
def test_bad_input_is_refused_before_anything_runs(changes):
    with pytest.raises(ParameterError):
        staged_anova(**{"estimator": ESTIMATOR, "sampler": "random", "n": 8, **changes})
