"""Terms of techniques in chunks: the same bits as at once."""

from __future__ import annotations

import numpy as np
import pytest
from tests.staging import check_cuts

import mcspectra as mcs
from mcspectra.core.errors import InfiniteWeightVarianceWarning, ParameterError
from mcspectra.variance.techniques import staged_techniques

MIS = mcs.MultipleImportance(
    mcs.integrand("linear", dims=2), ["uniform", "linear(slope=1)"], counts=(1, 1)
)


@pytest.mark.parametrize("n", [16, [4, 16]])
@pytest.mark.parametrize("space", ["domain", "primary"])
def test_chunks_of_technique_terms_change_nothing(n, space, monkeypatch):
    settings = {"half_width": 2, "realizations": 45, "rng": 3, "space": space}

    def make():
        return staged_techniques(MIS, "jittered", n, **settings)

    def public(workers):
        return mcs.technique_terms(MIS, "jittered", n, **settings, workers=workers)

    found = check_cuts(make, public, monkeypatch, block_numbers=2**21)
    assert float(found["technique_covariance_se"].min()) > 0
    assert ("bottleneck" in found) == isinstance(n, list)


def test_a_block_of_one_says_nothing():
    analysis = staged_techniques(MIS, "jittered", 16, half_width=2, realizations=45)
    (run,) = next(analysis.stages())
    last, first = analysis.block(run, run.blocks - 1), analysis.block(run, 0)
    assert last.sums.count == 1
    assert last.batches.values.shape == (0, 4, 1, 2, 2)
    for merged in (analysis.merge(last, first), analysis.merge(first, last)):
        assert merged.batches.weights.tolist() == [1.0]
        assert np.isnan(merged.batches.errors).all()


def test_infinite_weights_warn_at_the_call():
    estimator = mcs.Estimator("gaussian", "linear(slope=2)", dims=1)
    with pytest.warns(InfiniteWeightVarianceWarning) as caught:
        mcs.technique_terms(estimator, "jittered", 4, half_width=2, realizations=4)
    assert [w.filename for w in caught] == [__file__]


@pytest.mark.parametrize(
    "changes",
    [
        {"n": [16, 4]},
        {"n": []},
        {"realizations": 1},
        {"half_width": 10**6},
        {"space": "primal"},
        {"eps": float("nan")},
    ],
)
def test_bad_input_is_refused_before_anything_runs(changes):
    with pytest.raises(ParameterError):
        staged_techniques(**{"estimator": MIS, "sampler": "random", "n": 16, **changes})
