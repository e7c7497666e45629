"""Analyses in chunks and on any number of threads give equal bits, for all options and kinds."""

import itertools

import numpy as np
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.core import analysis as core_analysis
from mcspectra.core import parallel
from mcspectra.core.analysis import Reduction, compute, compute_chunk, needed, steps_of
from mcspectra.core.errors import InfiniteWeightVarianceWarning, McspectraError, ParameterError
from mcspectra.core.options import checked
from mcspectra.core.records import merged, pack, unpack
from mcspectra.core.streams import Stream
from mcspectra.estimators import as_subject
from mcspectra.estimators.moments import Moments
from mcspectra.improve.remedy import Remedies
from mcspectra.measure.anova import Anova, AnovaSpectrum
from mcspectra.measure.converge import Convergence, RealizationsNeeded, count_stream
from mcspectra.measure.modes import Modes
from mcspectra.measure.sums import TermSums, spread
from mcspectra.measure.techniques import Techniques
from mcspectra.measure.terms import Terms
from mcspectra.prediction.prediction import Prediction
from mcspectra.testing import check_analysis

PLAIN = mcs.Estimator("gaussian", dims=2)
DISK = mcs.Estimator("disk(radius=0.3)", dims=2)
WARPED = mcs.Estimator("gaussian", "linear(slope=1)", dims=2)
MIS = mcs.MultipleImportance(
    mcs.integrand("gaussian", dims=2), ["uniform", "linear(slope=1)"], counts=(1, 1)
)
COLORS = mcs.Integrand.from_function(
    lambda x: np.stack([x[..., 0], np.sin(9 * x[..., 1])], axis=-1), dims=2
)
SOLID = mcs.Estimator("gaussian(width=0.4)", dims=3)
LINE = mcs.Estimator("gaussian(center=0.3, width=0.3)", dims=1)
LINE_TERMS = Terms(n=16, half_width=6, realizations=45, cross_matrix=True)


def _curve(**options):
    return Convergence(counts=(4, 16), realizations=700, fit_last=2, **options)


def _terms(**options):
    return Terms(**{"n": 16, "half_width": 3, "realizations": 45, **options})


def _techniques(counts, space):
    return Techniques(counts=counts, half_width=2, realizations=45, space=space)


# Analysis, estimator, sampler, and a block size so small that some reduction has five blocks
CASES = {
    "curve": (_curve(), PLAIN, "jittered", 2**11),
    "curve-channels": (_curve(), COLORS, "random", 2**11),
    "curve-mis": (_curve(), MIS, "jittered", 2**11),
    "curve-density": (_curve(), WARPED, "jittered | shift", 2**11),
    "curves-joint": (_curve(), [PLAIN, DISK], ["random", "jittered"], 2**11),
    "curves-mixed": (_curve(), [MIS, PLAIN], "random", 2**11),
    "search": (_curve(relative_error=0.08), PLAIN, "jittered", 2**11),
    "searches": (_curve(relative_error=0.08), [MIS, PLAIN], ["random", "jittered"], 2**11),
    "needed": (RealizationsNeeded(n=16, relative_error=0.07), MIS, "random", 2**11),
    "terms": (_terms(bands="dyadic"), PLAIN, "jittered", 2**21),
    "terms-channels": (_terms(bands="wedge", basis="cosine"), COLORS, "jittered", 2**21),
    "terms-mis": (_terms(), MIS, "jittered", 2**21),
    "terms-primary": (_terms(space="primary", cross_matrix=True), MIS, "jittered", 2**21),
    "terms-density": (_terms(bands="anova"), WARPED, "jittered", 2**21),
    "terms-walsh": (_terms(basis="walsh", half_width=4), PLAIN, "jittered", 2**21),
    "terms-matrix": (LINE_TERMS, LINE, "jittered", 2**21),
    "techniques": (_techniques(16, "domain"), MIS, "jittered", 2**21),
    "techniques-counts": (_techniques((4, 16), "domain"), MIS, "jittered", 2**21),
    "techniques-primary": (_techniques((4, 16), "primary"), MIS, "jittered", 2**21),
    "anova": (Anova(n=8, order=1, realizations=45), SOLID, "random", 4 * 8 * 3 * 5),
    "anova-pairs": (Anova(n=8, realizations=45), SOLID, "jittered | shift", 4 * 8 * 3 * 5),
    "anova-spectrum": (AnovaSpectrum(n=8, frequencies=32), SOLID, "random", 2**21),
    "exact": (Prediction(counts=(4, 9, 16, 25, 36), method="exact"), PLAIN, "jittered", 2**21),
    "modes": (Modes(n=16, half_width=3, modes=2, realizations=45), MIS, "jittered", 2**21),
    "modes-groups": (Modes(n=16, half_width=2, modes=2, realizations=99), PLAIN, "random", 64),
    "remedies": (Remedies(budget=64, realizations=100), LINE, "jittered | shift", 2**21),
    "methods": (
        Prediction(counts=(16,), method="all", half_width=2, realizations=45),
        PLAIN,
        "jittered | shift",
        2**21,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_cuts_and_threads_change_nothing(case, monkeypatch):
    analysis, estimator, sampler, numbers = CASES[case]
    monkeypatch.setattr(parallel, "_BLOCK_NUMBERS", numbers)
    check_analysis(analysis, estimator, sampler)
    subject, sizes = as_subject(estimator, sampler, lists=True), []

    def counted(work, blocks, threads):
        sizes.append(len(blocks))
        return parallel.map_in_order(work, blocks, threads)

    kind, needs = type(analysis), []
    need = kind.need
    monkeypatch.setattr(kind, "need", lambda *given: needs.append(given) or need(*given))
    monkeypatch.setattr(core_analysis, "map_in_order", counted)
    one, two = (compute(analysis, subject, 3, workers) for workers in (1, 2))
    assert max(sizes) >= 5
    assert len(needs) == 2  # The need is computed once for each of the two
    xr.testing.assert_identical(one, two)


def _stages(analysis, subject, seed=3):
    """All reductions, stage by stage, and the result."""
    steps, states, stages = steps_of(analysis, subject, Stream.from_rng(seed)), None, []
    try:
        while True:
            stages.append(next(steps) if states is None else steps.send(states))
            states = [compute_chunk(each, (0, each.blocks)) for each in stages[-1]]
    except StopIteration as end:
        return stages, end.value


# --- searches
# -----------------------------------------------------------------------------------------


def test_a_search_measures_the_first_realizations():
    """The variance equals that of all estimates at once, drawn from the stream of the count."""
    curve = mcs.convergence(PLAIN, "random", [16], realizations=5000, rng=5, relative_error=0.1)
    used = int(curve["realizations_used"][0])
    assert 100 < used < 5000
    stream = count_stream(Stream.from_rng(5), 16)
    points = mcs.sampler("random", dims=2).draw_stream(16, stream, 0, used)
    variance = PLAIN.estimate([points]).var(ddof=1)
    assert float(curve["variance"][0]) == pytest.approx(variance, rel=1e-12)


def test_runs_of_a_search_follow_each_other():
    """Every realization is used once: runs of a cell begin where the last run ended."""
    analysis = Convergence(counts=(4, 16), realizations=3000, relative_error=0.06)
    stages, result = _stages(analysis, as_subject([PLAIN, DISK], "random", lists=True))
    ends, parts = {}, []
    for stage in stages:
        for run in stage:
            part, first, realizations = map(int, run.key.split("-"))
            assert first == ends.get(part, 0)
            ends[part] = first + realizations
        parts.append({int(run.key.split("-")[0]) for run in stage})
    assert len(stages) >= 3
    assert parts[0] == {0, 1, 2, 3}  # Estimators × counts
    assert all(later <= earlier for earlier, later in itertools.pairwise(parts))
    used = result["realizations_used"].values.reshape(-1)
    assert used.tolist() == [ends[part] for part in range(4)]


def test_costs_are_evaluations():
    two = as_subject([PLAIN, DISK], "random", lists=True)
    analysis = Convergence(counts=(4, 16), realizations=100)
    ((few, many),) = _stages(analysis, two)[0]
    assert [few.cost, many.cost] == [100 * n * 2 for n in (4, 16)]
    assert analysis.need(two).cost == few.cost + many.cost
    ((mis,),) = _stages(Convergence(counts=(4,), realizations=100), as_subject(MIS, "random"))[0]
    assert mis.cost == 100 * 4 * 2  # Two techniques


def test_a_billion_realizations_are_cut_at_once():
    analysis = Convergence(counts=(1024,), realizations=10**9)
    (run,) = next(analysis.reduction(as_subject(PLAIN, "random"), Stream.from_rng(0)))
    assert run.blocks == pytest.approx(10**9 * 1024 * 2 / 2**20, rel=0.01)


def test_moments_keep_every_bit():
    odd = np.array([0.1 + 0.2, -0.0, 5e-324, np.nan, np.inf])
    state = [Moments(10**9, odd, odd[::-1], 2 * odd, odd * odd), Moments(1, odd, odd, odd, odd)]
    for before, after in zip(state, unpack(list[Moments], pack(state)), strict=True):
        assert type(after.count) is int
        assert after.count == before.count
        for name in ("mean", "m2", "m3", "m4"):
            assert getattr(after, name).tobytes() == getattr(before, name).tobytes()


# --- terms
# --------------------------------------------------------------------------------------------


def _line():
    """Return the reduction of the terms along a line, and its states block by block."""
    found = LINE_TERMS.reduction(as_subject(LINE, "jittered"), Stream.from_rng(0))
    assert isinstance(found, Reduction)
    return found, [found.block(i)[0] for i in range(found.blocks)]


def _total():
    found, _ = _line()
    return compute_chunk(found, (0, found.blocks))[0]


def test_errors_equal_those_of_all_blocks():
    """Compare with the blocks one by one, by definition."""
    _, blocks = _line()
    total = _total().batches
    kept = [b for b in blocks if b.sums.count > 1]
    weight = np.array([b.sums.count - 1.0 for b in kept])
    share = weight / weight.sum()
    terms = np.array([b.batches.values[0, :3] for b in kept])
    expected = spread(terms - np.tensordot(share, terms, axes=1), share)
    np.testing.assert_allclose(total.term_errors(), expected, rtol=1e-12)
    maps = np.array([b.batches.contribution.total / b.batches.contribution.squared for b in kept])
    centers = np.average(maps, axis=0, weights=weight**2)
    np.testing.assert_allclose(
        total.contribution.error(), spread(maps - centers, share), rtol=1e-9, atol=1e-18
    )
    matrices = np.array([b.sums.matrix / (b.sums.count - 1) for b in kept])
    off = np.abs(matrices - np.average(matrices, axis=0, weights=weight**2))
    np.testing.assert_allclose(total.matrix.error(), spread(off, share), rtol=1e-9, atol=1e-12)


def test_a_block_of_one_realization_gives_no_error():
    _, blocks = _line()
    first, last = blocks[0], blocks[-1]
    assert last.sums.count == 1
    assert last.batches is None
    assert unpack(TermSums, pack(last)).batches is None
    assert merged(last, last).batches is None
    _, again = _line()
    for both in (merged(last, first), merged(again[0], last)):
        assert both.batches.count == 1
        assert both.sums.count == 3


def test_states_grow_by_five_numbers_a_block():
    """In addition to the numbers of a block, a state has terms, variance and weight: (3 + 1 +
    1)."""
    _, blocks = _line()
    one, few = blocks[0], _total()
    # In addition to the smallest and largest estimates, at most 64 each
    tails = few.measured.extremes.nbytes - one.measured.extremes.nbytes
    assert few.measured.extremes.nbytes <= 8 * 128
    grown = len(pack(few)) - len(pack(one)) - tails
    assert abs(grown - 8 * 5 * 21) < 64  # Numbers of shapes take a few bytes


@pytest.mark.parametrize("function", [mcs.variance_terms, mcs.technique_terms])
def test_infinite_weights_warn_at_the_call(function):
    estimator = mcs.Estimator("gaussian", "linear(slope=2)", dims=1)
    with pytest.warns(InfiniteWeightVarianceWarning) as caught:
        function(estimator, "jittered", 4, half_width=2, realizations=4)
    assert [w.filename for w in caught] == [__file__]


def test_states_of_anova_are_the_estimates_of_realizations_in_order(monkeypatch):
    monkeypatch.setattr(parallel, "_BLOCK_NUMBERS", 4 * 8 * 3 * 5)
    subject = as_subject(SOLID, "jittered | shift")
    found = Anova(n=8, realizations=12).reduction(subject, Stream.from_rng(3))
    assert found.blocks == 3
    whole = compute_chunk(found, (0, 3)).values
    # The first mask keeps every axis, which gives the plain estimates
    points = mcs.sampler("jittered | shift", 3).draw(8, rng=3, realizations=12)
    assert np.array_equal(whole[0, :, 0], SOLID.estimate([points]))


# --- what is refused before anything runs
# -------------------------------------------------------------

RANDOM = as_subject(PLAIN, "random")
MANY = as_subject(mcs.Estimator("gaussian", dims=64), "random")
JITTERED = as_subject(PLAIN, "jittered")
TECHNIQUES = as_subject(mcs.estimators.TechniqueSum(["linear", "step(at=0.3)"], dims=1), "jittered")
NAN = float("nan")


@pytest.mark.parametrize(
    ("analysis", "subject"),
    [
        (Convergence(counts=(4,), realizations=1), RANDOM),
        (Convergence(counts=(4,), realizations=10**12), RANDOM),
        (Convergence(counts=()), RANDOM),
        (Convergence(counts=(4, 16), relative_error=NAN), RANDOM),
        (Convergence(counts=(4,)), as_subject([PLAIN, COLORS], "random", lists=True)),
        (Convergence(counts=(2**60,)), JITTERED),
        (Terms(n=16, realizations=1), JITTERED),
        (Terms(n=16, half_width=0.5), JITTERED),
        (Terms(n=16, half_width=2**31), JITTERED),
        (Terms(n=16, half_width=8), MANY),
        (Terms(n=16, space="primal"), JITTERED),
        (Terms(n=16, space="domain"), TECHNIQUES),
        (Terms(n=16, bands="wedge"), as_subject(LINE, "jittered")),
        (Terms(n=16, basis=None), JITTERED),
        (Terms(n=16, eps=NAN), JITTERED),
        (Terms(n=16, cross_matrix=True, half_width=100), JITTERED),
        (Techniques(counts=()), RANDOM),
        (Techniques(counts=16, realizations=1), RANDOM),
        (Techniques(counts=16, half_width=10**6), RANDOM),
        (Techniques(counts=16, space="primal"), RANDOM),
        (Techniques(counts=16, eps=NAN), RANDOM),
        (Techniques(counts=(4, 8), fit_last=3), RANDOM),
        (Anova(n=8, realizations=1), RANDOM),
        (Anova(n=8, realizations=10**8), RANDOM),
        (Anova(n=8, realizations=10**6), MANY),
        (Anova(n=0), RANDOM),
        (Anova(n=NAN), RANDOM),
        (Anova(), as_subject(mcs.Estimator("gaussian", dims=65), "random")),
        (AnovaSpectrum(n=8, order=3), MANY),
        (AnovaSpectrum(n=8), JITTERED),
        (AnovaSpectrum(n=17), as_subject(PLAIN, "jittered | shift")),
        (Modes(n=16, channel=1), JITTERED),
        (Prediction(counts=(16,), method="terms", half_width=10**9), JITTERED),
        (Prediction(counts=(7,), method="all"), JITTERED),
        (Prediction(counts=(16,), method="all", realizations=3), JITTERED),
        (Remedies(budget=3), JITTERED),
        (Remedies(budget=2**25), JITTERED),
        (Remedies(budget=64, kinds=()), JITTERED),
    ],
)
def test_invalid_options_are_refused_before_anything_runs(analysis, subject):
    with pytest.raises(McspectraError):
        needed(checked(analysis), subject)


@pytest.mark.parametrize("given", [([], "random"), (PLAIN, []), (PLAIN, ["random", 3])])
def test_lists_have_the_right_items(given):
    with pytest.raises(ParameterError):
        mcs.convergence(*given, [4, 16])
