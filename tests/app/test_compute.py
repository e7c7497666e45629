"""Jobs: rounds, canceling, and refused set-ups."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from mcspectra.app import compute as module
from mcspectra.app.compute import (
    MOST_AT_ONCE,
    UPDATE_KINDS,
    Job,
    Update,
    analyses_of,
    compute,
    ladder,
    make_parts,
    rounds,
)
from mcspectra.app.state import ExplorerSetup
from mcspectra.core.progress import report

SMALL = ExplorerSetup(n=16, half_width=4, realizations=64)


@pytest.fixture(autouse=True)
def _no_hurry(monkeypatch):
    """Keep a slow machine from ending a job early."""
    monkeypatch.setattr(module, "_LONGEST_ROUND", 1e9)


def finished(setup):
    """Run a job to its end; return its updates and its last sentence."""
    updates: list[Update] = []
    sentences: list[str] = []
    job = Job(setup, updates.append, sentences.append).start()
    job.join(60)
    assert len(sentences) == 1
    return updates, sentences[0]


@pytest.mark.parametrize(
    ("target", "expected"),
    [(1024, [16, 64, 256, 1024]), (16, [16]), (2, [2]), (100, [16, 64, 100])],
)
def test_rounds_end_at_the_target(target, expected):
    assert list(rounds(replace(SMALL, realizations=target))) == expected


def test_a_job_sends_all_kinds_in_each_round():
    updates, sentence = finished(SMALL)
    assert sentence == ""
    assert [u.kind for u in updates] == [*UPDATE_KINDS, *UPDATE_KINDS]
    assert [u.realizations for u in updates] == [16] * 6 + [64] * 6
    assert updates[-1].fraction == 1.0
    assert all(0 < u.fraction <= 1 for u in updates)
    terms = updates[UPDATE_KINDS.index("terms") - len(UPDATE_KINDS)]
    assert terms.value.attrs["realizations"] == 64


def test_points_are_the_first_realization_with_its_weights():
    setup = replace(SMALL, density="linear(slope=1)", seed=3)
    found = compute("points", setup, 16)
    parts = make_parts(setup)
    u = parts.sampler.draw(16, realizations=1, rng=3)[0]
    assert parts.density is not None
    np.testing.assert_array_equal(found["points"], parts.density.sample(u))
    np.testing.assert_array_equal(found["weights"], 1.0 / parts.density.pdf(found["points"].values))


@pytest.mark.parametrize("dims", [1, 2])
def test_the_integrand_is_shown_with_its_density(dims):
    setup = replace(SMALL, density="linear(slope=1)", dims=dims)
    found = compute("integrand", setup, 16)
    parts = make_parts(setup)
    assert parts.density is not None
    assert list(found) == ["f", "p", "f/p"]
    x = np.array([[0.25 + 0.5 / len(found["x0"])] * dims])
    at = found.sel(dict.fromkeys(found.dims, x[0, 0]), method="nearest")
    x = np.array([[float(at[axis]) for axis in found.dims]])
    assert float(at["f"]) == float(parts.estimator.domain_integrand(x)[0])
    assert float(at["p"]) == float(parts.density.pdf(x)[0])
    assert float(found["p"].mean()) == pytest.approx(1.0, rel=1e-4)
    assert float((found["f/p"] * found["p"]).mean()) == pytest.approx(float(found["f"].mean()))
    # The result does not depend on the sampler
    assert compute("integrand", replace(setup, sampler="random", n=8, seed=1), 64) is found


def test_techniques_are_shown_in_primary_space():
    setup = replace(SMALL, integrand="technique-sum(integrands=['gaussian', 'disk'])")
    found = compute("integrand", setup, 16)
    assert list(found) == ["technique 0", "technique 1"]
    assert float(found["technique 1"].max()) == 1.0


def test_options_reach_the_analyses_that_have_them():
    setup = replace(
        SMALL, basis="cosine", engine="direct", counts=(4, 16), bands="dyadic", fit_last="auto",
        frequency_step=0.5, space="primary", eps=1e-6,
    )  # fmt: skip
    found = analyses_of(setup)
    terms, spectrum, curve = (found[name] for name in ("terms", "spectrum", "convergence"))
    assert (terms.basis, terms.engine, terms.bands, terms.space) == (
        "cosine",
        "direct",
        "dyadic",
        "primary",
    )
    assert (spectrum.engine, spectrum.frequency_step, spectrum.eps) == ("direct", 0.5, 1e-6)
    assert (curve.counts, curve.fit_last) == ((4, 16), "auto")
    assert analyses_of(SMALL)["convergence"].counts == tuple(ladder(SMALL))


def test_the_spectrum_does_not_wait_for_an_integrand():
    first = compute("spectrum", SMALL, 16)
    other = replace(SMALL, integrand="disk", smoothing=0.1, mirror="random", basis="cosine")
    assert compute("spectrum", other, 16) is first
    assert compute("spectrum", replace(SMALL, seed=1), 16) is not first


def test_cancelling_ends_an_analysis_between_its_blocks(monkeypatch):
    begun, go, told = threading.Event(), threading.Event(), []

    def slow(kind, setup):
        del kind, setup
        begun.set()
        go.wait(30)
        for k in range(5):
            report("terms", k / 5)
            told.append(k)

    monkeypatch.setattr(module, "_computed", slow)
    sentences: list[str] = []
    job = Job(replace(SMALL, seed=5), told.append, sentences.append).start()
    assert begun.wait(30)
    job.cancel()
    go.set()
    job.join(30)
    assert told == []
    assert sentences == []


def test_canceling_a_job_does_not_stop_another_job():
    cancelled = Job(replace(SMALL, seed=6), lambda _: None, lambda _: None)
    cancelled.cancel()
    cancelled.start().join(30)
    assert finished(replace(SMALL, seed=6, realizations=16))[1] == ""


def test_a_canceled_job_sends_no_more_updates(monkeypatch):
    entered, go = threading.Event(), threading.Event()

    def slow(kind, setup, realizations):
        entered.set()
        assert go.wait(30)
        return "late"

    monkeypatch.setattr(module, "compute", slow)
    said: list[object] = []
    job = Job(SMALL, said.append, said.append).start()
    assert entered.wait(30)
    job.cancel()
    go.set()
    job.join(30)
    assert said == []


def test_rounds_that_would_take_long_are_not_begun(monkeypatch):
    clock = iter(np.arange(0.0, 1e4, 10.0))
    monkeypatch.setattr(module, "_LONGEST_ROUND", 30.0)
    monkeypatch.setattr(module, "compute", lambda *_: None)
    monkeypatch.setattr(module.time, "perf_counter", lambda: next(clock))
    updates, sentence = finished(replace(SMALL, realizations=1024))
    assert [u.realizations for u in updates] == [16] * 6 + [64] * 6
    assert "Stopped at 64 realizations: 256 would take about 240 s" in sentence


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"sampler": "no-such"}, "no sampler called"),
        ({"sampler": "jittered", "n": 257}, "256 and 289"),
        ({"integrand": "no-such"}, "no integrand called"),
        ({"density": "linear(slope=9)"}, "slope"),
        ({"integrand": "christensen-gaussian", "dims": 1}, "dims"),
        ({"integrand": f"upload(digest='{'0' * 64}')"}, "upload it again"),
        ({"sampler": "hexagonal", "dims": 1}, "dims"),
        ({"basis": "walsh", "integrand": "disk", "half_width": 3}, ""),
    ],
)
def test_an_invalid_set_up_gives_a_sentence(changes, said):
    updates, sentence = finished(replace(SMALL, realizations=2, **changes))
    assert said in sentence
    assert not updates or said == ""


def test_faults_of_components_end_the_job_with_a_sentence(monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr(module, "compute", broken)
    assert finished(SMALL)[1] == "Unexpected ZeroDivisionError: by zero."


def test_the_ladder_has_counts_that_the_sampler_supports():
    for setup in (
        SMALL,
        replace(SMALL, sampler="sobol"),
        replace(SMALL, n=1),
        ExplorerSetup(n=2**16),
    ):
        source = make_parts(setup).sampler
        counts = ladder(setup)
        assert counts == sorted(set(counts))
        assert all(source.nearest_count(n) == n and n <= 2**16 for n in counts)


def test_warnings_of_counts_are_notes():
    parts = make_parts(replace(SMALL, sampler="sobol | owen", n=12))
    assert len(parts.notes) == 1
    assert "balanced" in parts.notes[0]


def test_jobs_of_all_pages_take_turns(monkeypatch):
    """Twenty pages used to compute at once, and the first page waited for all."""
    lock, now, most, done = threading.Lock(), [0], [0], threading.Semaphore(0)

    def slow(kind, setup, realizations):
        del kind, setup, realizations
        with lock:
            now[0] += 1
            most[0] = max(most[0], now[0])
        time.sleep(0.01)
        with lock:
            now[0] -= 1

    monkeypatch.setattr(module, "compute", slow)
    monkeypatch.setattr(module, "make_parts", lambda setup: None)
    jobs = [Job(SMALL, lambda _: None, lambda _: done.release()) for _ in range(8)]
    for job in jobs:
        job.start()
    assert all(done.acquire(timeout=30) for _ in jobs)
    assert most[0] == MOST_AT_ONCE

    # A waiting job is canceled
    for _ in range(MOST_AT_ONCE):
        module._TURNS.acquire()
    try:
        waiting = Job(SMALL, lambda _: None, lambda _: done.release()).start()
        waiting.cancel()
        waiting.join(10)
        assert not waiting._thread.is_alive()
        assert not done.acquire(blocking=False)
    finally:
        for _ in range(MOST_AT_ONCE):
            module._TURNS.release()
