"""The terms in chunks: the same bits as at once, for all options; batches merge as they are kept."""

from __future__ import annotations

import numpy as np
import pytest
from tests.staging import check_cuts

import mcspectra as mcs
from mcspectra.core.errors import InfiniteWeightVarianceWarning, ParameterError
from mcspectra.core.staged import compute_chunk
from mcspectra.variance.batches import spread, student_t
from mcspectra.variance.terms import staged_terms

MIS = mcs.MultipleImportance(
    mcs.integrand("gaussian", dims=2), ["uniform", "linear(slope=1)"], counts=(1, 1)
)
COLORS = mcs.Integrand.from_function(
    lambda x: np.stack([x[..., 0], np.sin(9 * x[..., 1])], axis=-1), dims=2
)
LINE = mcs.Estimator("gaussian(center=0.3, width=0.3)", dims=1)

CASES = {
    "plain": ("gaussian", {"bands": "dyadic"}),
    "channels": (COLORS, {"bands": "wedge", "basis": "cosine"}),
    "mis": (MIS, {}),
    "mis-primary": (MIS, {"space": "primary", "cross_matrix": True}),
    "density": (mcs.Estimator("gaussian", "linear(slope=1)", dims=2), {"bands": "anova"}),
    "walsh": ("gaussian", {"basis": "walsh", "half_width": 4}),
    "matrix": (LINE, {"cross_matrix": True, "half_width": 6}),
}


@pytest.mark.parametrize("case", CASES)
def test_chunks_of_terms_change_nothing(case, monkeypatch):
    estimator, options = CASES[case]
    dims = getattr(estimator, "dims", 2)
    sampler = mcs.sampler("jittered", dims=dims)
    settings = {"half_width": 3, "realizations": 45, "rng": 3, **options}

    def make():
        return staged_terms(estimator, sampler, 16, **settings)

    def public(workers):
        return mcs.variance_terms(estimator, sampler, 16, **settings, workers=workers)

    found = check_cuts(make, public, monkeypatch, block_numbers=2**21)
    assert found.attrs["batches"] == 22  # of 2 realisations, and one that says nothing
    assert float(np.min(found["power_term_se"])) > 0
    assert ("cross_matrix_se" in found) == options.get("cross_matrix", False)


def _state(realizations=45, block=None):
    analysis = staged_terms(
        LINE, "jittered", 16, half_width=6, realizations=realizations, cross_matrix=True
    )
    (run,) = next(analysis.stages())
    chunk = (0, run.blocks) if block is None else (block, 1)
    return analysis, run, compute_chunk(analysis, run, chunk)


def test_errors_are_those_of_all_blocks_kept():
    """Against the blocks one by one, by definition."""
    analysis, run, total = _state()
    blocks = [analysis.block(run, i) for i in range(run.blocks)]
    kept = [b for b in blocks if b.sums.count > 1]
    weight = np.array([b.sums.count - 1.0 for b in kept])
    share = weight / weight.sum()
    terms = np.array([b.sums.terms(analysis.partition) for b in kept])
    expected = spread(terms - np.tensordot(share, terms, axes=1), share)
    np.testing.assert_allclose(total.of_blocks.term_errors(), expected, rtol=1e-12)
    maps = np.array([b.sums.contribution(analysis.partition) for b in kept])
    centers = np.average(maps, axis=0, weights=weight**2)
    np.testing.assert_allclose(
        total.of_blocks.contribution.error(), spread(maps - centers, share), rtol=1e-9, atol=1e-18
    )
    matrices = np.array([b.sums.matrix / (b.sums.count - 1) for b in kept])
    off = np.abs(matrices - np.average(matrices, axis=0, weights=weight**2))
    np.testing.assert_allclose(
        total.of_blocks.matrix.error(), spread(off, share), rtol=1e-9, atol=1e-12
    )


def test_sums_are_those_of_all_realizations():
    """Against NumPy's covariance of all spectra with all estimates at once."""
    analysis, _, total = _state()
    points = LINE.draw(analysis.sampler, 16, analysis.stream, 0, 45)
    s, values = analysis.view.coefficients(points), LINE.estimate(points)
    assert total.measured.variance[0] == pytest.approx(values.var(ddof=1), rel=1e-11)
    np.testing.assert_allclose(total.sums.m2 / 44, s.var(axis=0, ddof=1), rtol=1e-10, atol=1e-25)


def test_a_block_of_one_says_nothing():
    analysis, run, last = _state(block=22)
    assert last.sums.count == 1
    assert last.batches is None
    assert analysis.unpack(analysis.pack(last)).batches is None
    first = analysis.block(run, 0)
    for merged in (last.merge(first), first.merge(last)):
        assert merged.of_blocks.count == 1
        assert merged.sums.count == 3
    assert last.merge(last).batches is None


def test_states_keep_every_bit():
    analysis, _, total = _state()
    before, after = analysis.pack(total), analysis.pack(analysis.unpack(analysis.pack(total)))
    assert before.keys() == after.keys()
    for name, values in before.items():
        assert (after[name].dtype, after[name].shape) == (values.dtype, values.shape)
        assert after[name].tobytes() == values.tobytes()


def test_states_grow_by_five_numbers_a_block():
    """Beside the numbers of a block, a state has terms, variance, mean and weight: (3 + 1 + 1 + 1)."""
    _, _, few = _state(45)
    analysis, run, one = _state(45, block=0)
    sizes = [sum(a.nbytes for a in analysis.pack(state).values()) for state in (few, one)]
    spreads = sum(
        s.squares.nbytes
        for s in (few.batches.contribution, few.batches.band_covariance, few.batches.matrix)
    )
    assert sizes[0] - sizes[1] == spreads + 8 * 6 * 21
    assert run.blocks == 23


def test_infinite_weights_warn_at_the_call():
    estimator = mcs.Estimator("gaussian", "linear(slope=2)", dims=1)
    with pytest.warns(InfiniteWeightVarianceWarning) as caught:
        mcs.variance_terms(estimator, "jittered", 4, half_width=2, realizations=4)
    assert [w.filename for w in caught] == [__file__]


def test_cost_is_that_of_the_larger():
    few = next(staged_terms(LINE, "jittered", 4, half_width=50, realizations=10).stages())[0]
    many = next(staged_terms(LINE, "jittered", 400, half_width=5, realizations=10).stages())[0]
    assert (few.cost, many.cost) == (10 * 2 * 51, 10 * 400)


def test_two_batches_have_one_degree_of_freedom():
    assert student_t(2) == pytest.approx(12.7062047)


@pytest.mark.parametrize(
    "changes",
    [
        {"realizations": 1},
        {"half_width": 0.5},
        {"half_width": 10**6},
        {"space": "primal"},
        {"bands": "rings"},
        {"basis": None},
        {"eps": float("nan")},
        {"cross_matrix": True, "half_width": 10_000},
    ],
)
def test_bad_input_is_refused_before_anything_runs(changes):
    with pytest.raises(ParameterError):
        staged_terms("gaussian", mcs.sampler("jittered", dims=2), 16, **changes)
