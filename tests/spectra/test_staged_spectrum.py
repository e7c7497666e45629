"""Spectra in chunks: the same bits as at once, sums as of all sets, progress to the end."""

from __future__ import annotations

import numpy as np
import pytest
from tests.staging import check_cuts

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.core.progress import listening
from mcspectra.core.staged import compute_chunk
from mcspectra.spectra.power import staged_spectrum

CASES = {
    "plain": ("jittered", {}),
    "mean": ("jittered", {"mean": True, "engine": "direct"}),
    "density": ("jittered", {"density": "linear(slope=1)", "mean": True}),
    "odd": ("random", {"realizations": 33, "wedges": 5}),
    "line": (mcs.sampler("jittered", dims=1), {"frequency_step": 0.5}),
}


@pytest.mark.parametrize("case", CASES)
def test_chunks_of_a_spectrum_change_nothing(case, monkeypatch):
    sampler, options = CASES[case]
    settings = {"half_width": 4, "realizations": 40, "rng": 3, **options}

    def make():
        return staged_spectrum(sampler, 16, **settings)

    def public(workers):
        return mcs.power_spectrum(sampler, 16, **settings, workers=workers)

    found = check_cuts(make, public, monkeypatch, block_numbers=2**21)
    assert np.nanmax(found["power_se"]) > 0
    assert ("mean_coefficient" in found) == options.get("mean", False)


def test_sums_count_all_sets():
    """Against |S|² of every point set, by definition."""
    analysis = staged_spectrum("jittered", 16, half_width=2, realizations=21, rng=1)
    (run,) = next(analysis.stages())
    total = compute_chunk(analysis, run, (0, run.blocks))
    assert total.power.count == 21
    points = mcs.sampler("jittered", dims=2).draw_stream(16, analysis.stream, 0, 21)
    m = analysis.transform.grid.half_indices()
    s = np.exp(-2j * np.pi * np.einsum("rkd,hd->rkh", points, m)).mean(axis=1)
    np.testing.assert_allclose(total.power.total, (np.abs(s) ** 2).sum(axis=0), atol=1e-7)


def test_states_keep_every_bit():
    analysis = staged_spectrum("jittered", 16, half_width=2, realizations=20, mean=True)
    (run,) = next(analysis.stages())
    before = analysis.pack(analysis.block(run, 1))
    after = analysis.pack(analysis.unpack(before))
    assert before.keys() == after.keys()
    assert all(after[k].tobytes() == v.tobytes() for k, v in before.items())


def test_progress_is_told_to_the_end():
    told = []
    with listening(lambda what, done: told.append((what, done))):
        mcs.power_spectrum("random", 4, half_width=2, realizations=16, workers=2)
    assert {what for what, _ in told} == {"power_spectrum"}
    assert [done for _, done in told] == [i / 8 for i in range(1, 9)]


@pytest.mark.parametrize(
    "changes",
    [{"realizations": 0}, {"half_width": -1}, {"wedges": 0}, {"eps": 2.0}, {"n": 2**40}],
)
def test_bad_input_is_refused_before_anything_runs(changes):
    with pytest.raises(ParameterError):
        staged_spectrum("random", **{"n": 4, **changes})
