"""Convergence in chunks: the same bits as at once, for all kinds of estimators and stops."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from tests.staging import check_cuts, run_sizes

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.core.staged import compute_chunk
from mcspectra.core.streams import Stream
from mcspectra.estimators import Moments
from mcspectra.variance.convergence import count_stream, staged_convergence
from mcspectra.variance.stopping import staged_realizations_needed

PLAIN = mcs.Estimator("gaussian", dims=2)
DISK = mcs.Estimator("disk(radius=0.3)", dims=2)
WARPED = mcs.Estimator("gaussian", "linear(slope=1)", dims=2)
MIS = mcs.MultipleImportance(
    mcs.integrand("gaussian", dims=2), ["uniform", "linear(slope=1)"], counts=(1, 1)
)
COLORS = mcs.Integrand.from_function(
    lambda x: np.stack([x[..., 0], np.sin(9 * x[..., 1])], axis=-1), dims=2
)

CASES = {
    "plain": (PLAIN, "jittered"),
    "channels": (COLORS, "random"),
    "mis": (MIS, "jittered"),
    "density": (WARPED, "jittered | shift"),
    "joint": ([PLAIN, DISK], ["random", "jittered"]),
    "mixed": ([MIS, PLAIN], "random"),
}


@pytest.mark.parametrize("relative_error", [None, 0.08])
@pytest.mark.parametrize("case", CASES)
def test_chunks_of_a_curve_change_nothing(case, relative_error, monkeypatch):
    arguments = (*CASES[case], [4, 16])
    settings = {"realizations": 700, "rng": 3, "relative_error": relative_error, "fit_last": 2}

    def make():
        return staged_convergence(*arguments, **settings)

    def public(workers):
        return mcs.convergence(*arguments, **settings, workers=workers)

    found = check_cuts(make, public, monkeypatch, block_numbers=2**11)
    assert found["variance"].min() > 0
    assert ("reached" in found) == (relative_error is not None)


def test_chunks_of_a_search_change_nothing(monkeypatch):
    def make():
        return staged_realizations_needed(MIS, "random", 16, relative_error=0.07, rng=1)

    def public(workers):
        return mcs.realizations_needed(
            MIS, "random", 16, relative_error=0.07, rng=1, workers=workers
        )

    found = check_cuts(make, public, monkeypatch, block_numbers=2**11)
    assert int(found["reached"]) == 1
    assert len(run_sizes(make())) >= 3  # stages


def test_a_search_measures_the_first_realizations():
    """Against the variance of all estimates at once, of the count's own stream."""
    curve = mcs.convergence(PLAIN, "random", [16], realizations=5000, rng=5, relative_error=0.1)
    used = int(curve["realizations_used"][0])
    assert 100 < used < 5000
    stream = count_stream(Stream.from_rng(5), 16)
    points = mcs.sampler("random", dims=2).draw_stream(16, stream, 0, used)
    variance = PLAIN.estimate([points]).var(ddof=1)
    assert float(curve["variance"][0]) == pytest.approx(variance, rel=1e-12)


def test_runs_of_a_search_follow_each_other():
    """Every realisation once: the runs of a cell begin where the last one ended."""
    analysis = staged_convergence(
        [PLAIN, DISK], "random", [4, 16], realizations=3000, relative_error=0.06
    )
    stages, states, ends = analysis.stages(), None, {}
    parts = []
    try:
        while True:
            runs = stages.send(states)
            for run in runs:
                assert run.first == ends.get(run.part, 0)
                ends[run.part] = run.first + run.realizations
            parts.append({run.part for run in runs})
            states = [compute_chunk(analysis, run, (0, run.blocks)) for run in runs]
    except StopIteration as end:
        used = end.value["realizations_used"].values.reshape(-1)
    assert parts[0] == {0, 1, 2, 3}  # estimators × counts
    assert all(later <= earlier for earlier, later in itertools.pairwise(parts))
    assert used.tolist() == [ends[part] for part in range(4)]


def test_costs_are_the_coordinates():
    analysis = staged_convergence([PLAIN, DISK], "random", [4, 16], realizations=100)
    (runs,) = [next(analysis.stages())]
    assert [run.cost for run in runs] == [100 * n * 2 * 2 for n in (4, 16)]
    mis = next(staged_convergence(MIS, "random", [4], realizations=100).stages())
    assert mis[0].cost == 100 * 4 * 2 * 2  # two techniques


def test_moments_keep_every_bit():
    analysis = staged_convergence([PLAIN, DISK], "random", [4])
    odd = np.array([0.1 + 0.2, -0.0, 5e-324, np.nan, np.inf])
    state = [Moments(10**9, odd, odd[::-1], 2 * odd, odd * odd), Moments(1, odd, odd, odd, odd)]
    back = analysis.unpack(analysis.pack(state))
    for before, after in zip(state, back, strict=True):
        assert type(after.count) is int
        assert after.count == before.count
        for name in ("mean", "m2", "m3", "m4"):
            assert getattr(after, name).tobytes() == getattr(before, name).tobytes()


def test_a_billion_realizations_are_cut_at_once():
    (run,) = next(staged_convergence(PLAIN, "random", [1024], realizations=10**9).stages())
    assert run.blocks == pytest.approx(10**9 * 1024 * 2 / 2**20, rel=0.01)


@pytest.mark.parametrize(
    "changes",
    [
        {"realizations": 1},
        {"realizations": 10**12},
        {"counts": [16, 4]},
        {"counts": []},
        {"relative_error": float("nan")},
        {"fit_last": 1},
        {"estimator": []},
        {"sampler": ["random", "random"]},
    ],
)
def test_bad_input_is_refused_before_anything_runs(changes):
    arguments = {"estimator": PLAIN, "sampler": "random", "counts": [4, 16], **changes}
    with pytest.raises(ParameterError):
        staged_convergence(**arguments)
