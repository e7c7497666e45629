"""Remedies: helpful changes are recommended at equal cost, others are listed with a reason."""

import json

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.explain.diagnosis import diagnose
from mcspectra.improve.answers import simultaneous_z
from mcspectra.improve.candidates import KINDS, Budget, Candidate, CandidateSettings, candidates_of
from mcspectra.measure.setup import Setup, affordable_count

SMOOTH = "christensen-gaussian"


def _setup(estimator, sampler):
    e = mcs.estimators.as_estimator(estimator)
    return Setup(e, mcs.sampler(sampler, dims=e.dims))


def _found(estimator, sampler, *kinds, **options):
    budget = Budget(256, 100, Stream.from_rng(0), **options)
    return list(candidates_of(_setup(estimator, sampler), kinds or tuple(KINDS), budget))


@pytest.fixture(scope="module")
def shifted():
    """Remedies for a smooth integrand with boundary jumps and a shifted sampler."""
    kinds = ["unshifted", "mirrored", "aligned", "sampler"]
    return mcs.remedies(SMOOTH, "jittered | shift", 1024, realizations=400, rng=1, kinds=kinds)


def test_removing_the_shift_and_mirroring_restore_the_rate(shifted):
    """The rate is −1.5 with the shift and −2 after either change; the intervals hold −0.5."""
    for name in ("unshifted", "mirrored: integrand"):
        row = shifted.sel(remedy=name)
        assert row["verdict"] == row["rate_verdict"] == "better"
        low, high = row["rate_difference_ci"].values
        assert low < -0.5 < high
    assert "wrap-around" in str(shifted.sel(remedy="mirrored: integrand")["reason"].values)
    assert "opposite faces" in shifted.attrs["diagnosis"]


def test_remedies_are_sorted_by_error_and_the_best_is_recommended(shifted):
    errors = shifted["error"].values
    assert (np.diff(errors) >= 0).all()
    # The intervals of all errors and rates hold simultaneously
    assert shifted.attrs["simultaneous_z"] == simultaneous_z(2 * (len(errors) - 1))
    assert (shifted.sel(remedy=["random", "mirrored: random"])["verdict"] == "worse").all()
    best = shifted.isel(remedy=0)
    change = str(best["change"].values)
    assert shifted.attrs["answer"].lower().startswith(change.lower())
    assert (shifted["rank_by_rate"].values == 1).sum() == 1
    rates = shifted["rate"].values
    assert shifted["rank_by_rate"].values[np.nanargmin(rates)] == 1


def test_costs_never_exceed_the_budget_at_any_step(shifted):
    cost = shifted["cost"].values
    assert np.nanmax(cost) <= 1024
    budgets = 1024 / 4.0 ** np.arange(4, -1, -1)
    assert (np.isnan(cost) | (cost <= budgets)).all()
    for name in ("sobol | owen", "as given"):
        np.testing.assert_array_equal(shifted["cost"].sel(remedy=name), budgets)


def test_ratios_agree_with_exact_variances():
    """For x in 1-D, jittered has 1/(12n³), and with a shift 1/(6n²) − 1/(12n³)."""
    n = 64
    f = mcs.Estimator("linear", dims=1)
    found = mcs.remedies(f, "jittered | shift", n, realizations=2000, kinds=["unshifted"])
    exact = (1 / (12 * n**3)) / (1 / (6 * n**2) - 1 / (12 * n**3))
    low, high = found["error_ratio_ci"].sel(remedy="unshifted").values
    assert low < exact < high
    assert high / low < 1.5


def test_smoothing_helps_at_interior_edges_and_mirroring_does_not():
    found = mcs.remedies(
        "disk(center=0.47)",
        "jittered | shift",
        1024,
        realizations=300,
        kinds=["mirrored", "smoothed"],
    )
    assert "cross a discontinuity of the integrand" in found.attrs["diagnosis"]
    mirrored = found.sel(remedy="mirrored: integrand")
    assert mirrored["verdict"] != "better"
    assert mirrored["rate_verdict"] != "better"
    smooth = str(found["remedy"].values[0])
    assert smooth.startswith("smoothed by")
    assert found["verdict"].values[0] == "better"
    assert "bias" in str(found["reason"].values[0])


def test_alignment_with_a_known_edge_removes_the_variance():
    found = mcs.remedies(
        mcs.Estimator("step(at=0.3)", dims=1), "jittered", 256, realizations=100, kinds=["aligned"]
    )
    assert str(found["remedy"].values[0]) == "aligned with edges"
    assert float(found["error"][0]) < 1e-30
    assert "RMSE 0 at 256 evaluations instead of 0.0017. " in found.attrs["answer"]


def test_only_samplers_with_strata_are_aligned():
    """Owen scrambling keeps one point in each jittered stratum; a scrambled net has no strata."""
    (jittered, _) = _found("step(at=0.3)", "jittered | owen", "aligned")
    assert jittered.name == "aligned with edges"
    (net,) = _found("step(at=0.3)", "sobol | owen", "aligned")
    assert "sobol | owen has no strata" in net


def test_removing_the_slow_technique_is_recommended():
    mis = mcs.MultipleImportance(
        mcs.integrand("polynomial(coefficients=[0.5, 0, 1])", dims=1),
        ["uniform", "piecewise-constant(values=[1, 2, 3])"],
    )
    found = mcs.remedies(mis, "jittered", 512, realizations=300, kinds=["techniques", "heuristic"])
    only = found.sel(remedy="only uniform")
    # The rate is −3 for smooth f with uniform points, and −2 with the jumps of the table
    assert only["verdict"] == only["rate_verdict"] == "better"
    assert "cross a discontinuity of the integrand, " in found.attrs["diagnosis"]
    assert found.sel(remedy="heuristic: maximum")["verdict"] == "worse"


def test_unbounded_weights_are_reported():
    e = mcs.Estimator("polynomial(coefficients=[0, 0, 1])", "linear(slope=2)", dims=1)
    found = mcs.remedies(e, "random", 64, realizations=200, kinds=["warp"])
    assert "1/p is unbounded" in found.attrs["diagnosis"]
    assert any("defensive" in str(name) for name in found["remedy"].values)


def test_without_a_better_change_the_sampler_is_kept():
    """f is nearly proportional to its density, so every change is worse or undecided."""
    f = mcs.integrand("linear(gradient=[1], offset=0.5)", dims=1)
    found = mcs.remedies(
        mcs.Estimator(f, "linear(slope=0.9)"), "sobol | owen", 256, realizations=200, kinds=["warp"]
    )
    assert not (found["verdict"] == "better").any()
    assert found.attrs["answer"].startswith(
        "Keep sobol | owen: no tested change is significantly better."
    )
    assert json.loads(found.attrs["best"])["name"] == "as given"


def test_separate_densities_for_color_channels_are_recommended():
    e = mcs.Estimator("environment", "environment")
    found = mcs.remedies(e, "jittered", 256, realizations=200, kinds=["channels"])
    assert found.sel(remedy="channels: own")["verdict"] == "better"


def test_changes_that_cannot_be_tested_are_listed_with_a_reason(shifted):
    found = mcs.remedies(SMOOTH, "jittered", 64, realizations=100, kinds=["unshifted", "channels"])
    assert [str(r) for r in found["remedy"].values] == ["as given"]
    assert "no shift to leave out" in found.attrs["not_tried"]


def test_each_set_up_is_tried_once_and_differs_from_the_given_one():
    found = _found(SMOOTH, "jittered | shift", "unshifted", "sampler")
    names = [c.setup.sampler.spec for c in found if isinstance(c, Candidate)]
    assert len(names) == len(set(names))
    assert "jittered | shift" not in names


def test_a_sampler_that_is_biased_without_its_shift_keeps_it():
    (found,) = _found(SMOOTH, "regular | shift", "unshifted")
    assert isinstance(found, str)
    assert "biased" in found


@pytest.mark.parametrize(
    ("estimator", "sampler", "budget", "expected"),
    [
        (SMOOTH, "jittered", 1000, 31**2),
        (SMOOTH, "sobol | owen", 1000, 512),
        (SMOOTH, "random", 1000, 1000),
        # steps of 1/256 of the count would miss this count
        (SMOOTH, "sobol | owen", 14336, 8192),
        (mcs.Mirrored(SMOOTH, "uniform", dims=2), "jittered", 1000, 4 * 15**2),
        (mcs.MultipleImportance(SMOOTH, ["uniform", "linear"], counts=(1, 3)), "random", 1000, 250),
        # n and 4n are both squares
        (mcs.MultipleImportance(SMOOTH, ["uniform", "linear"], counts=(1, 4)), "jittered", 100, 16),
        (SMOOTH, "jittered", 0, None),
        (
            mcs.MultipleImportance(SMOOTH, ["uniform", "linear"], counts=(1, 2)),
            "jittered",
            99,
            None,
        ),
    ],
)
def test_the_largest_count_within_a_budget(estimator, sampler, budget, expected):
    assert affordable_count(_setup(estimator, sampler), budget) == expected


def test_undetermined_causes_are_not_reported_as_absent():
    """Causes cannot be determined for shared points or from few evaluations."""
    f = mcs.integrand("gaussian", dims=3)
    shared = mcs.MultipleImportance(f, ["uniform", "truncated-normal(sigma=0.3)"], sets="shared")
    for estimator, most in ((shared, None), (mcs.estimators.as_estimator(f), 100)):
        found = diagnose(estimator, mcs.sampler("jittered", dims=3), Stream.from_rng(0), most)
        assert found.causes == []
        assert found.text.startswith("The causes of noise could not be determined: ")


def test_jumps_are_found_in_many_dims():
    e = mcs.estimators.as_estimator("half-space(normal=[1, 1, 1, 1, 1], offset=2.2)", 5)
    found = diagnose(e, mcs.sampler("sobol | owen", dims=5), Stream.from_rng(0))
    assert found.causes[0].name == "interior-jump"


def test_an_estimate_without_variance_needs_no_remedy():
    found = mcs.remedies("constant(value=2)", "random", 64, realizations=100, kinds=["mirrored"])
    assert found.attrs["answer"].startswith(
        "Keep random: none of the 3 tested changes is significantly better"
    )
    assert not (found["verdict"] == "better").any()


@pytest.mark.parametrize("sampler", ["sobol", "halton", "regular"])
def test_the_error_of_deterministic_points_is_their_bias(sampler):
    """Points without randomization have no variance; their error is the squared bias."""
    f = mcs.integrand(SMOOTH)
    found = mcs.remedies(f, sampler, 256, realizations=100, kinds=["sampler"])
    n = 256
    alone = float(np.mean(f(mcs.sampler(sampler, dims=2).draw(n)[0]))) - float(f.integral)
    given = found.sel(remedy="as given")
    assert float(given["error"]) == pytest.approx(alone**2, rel=1e-6)
    assert found.sel(remedy="sobol | owen")["verdict"] == "better"


def test_missed_rare_events_do_not_give_a_verdict():
    p = 1e-5
    f = mcs.Integrand.from_function(
        lambda x: 1.0 * (np.abs(x[..., 0] - 0.37) < p / 2), dims=1, integral=p
    )
    wrong = 0
    for seed in range(10):
        # both changes have exactly the variance of the given set-up
        found = mcs.remedies(f, "random", 256, realizations=400, rng=seed, kinds=["mirrored"])
        same = found.sel(remedy=["mirrored: integrand", "mirrored: random"])
        wrong += bool((same["verdict"] != "undecided").any())
    # 5 % of 10 runs are 0.5, with a binomial σ of 0.7
    assert wrong <= 0.5 + 3.5 * 0.7
    never = mcs.Integrand.from_function(
        lambda x: 1.0 * (np.abs(x[..., 0] - 0.37) < 1e-12), dims=1, integral=2e-12
    )
    found = mcs.remedies(never, "random", 64, realizations=100, kinds=["mirrored"])
    assert "missed a rare region" in found.attrs["answer"]
    assert np.isnan(found["error"]).all()


def test_costs_equal_the_calls_of_the_function():
    """The costs of pilots and of means over boxes equal the counted calls."""
    calls = 0

    def counted(x):
        nonlocal calls
        calls += x[..., 0].size
        return 1.0 * (x.sum(axis=-1) > 1.1)

    f = mcs.Integrand.from_function(counted, dims=2, integral=0.595)
    smooth = mcs.Estimator(mcs.smoothed(f, 0.25), None)
    setup = Setup(smooth, mcs.sampler("random", dims=2))
    n = affordable_count(setup, 4096)
    points = smooth.draw(setup.sampler, n, Stream.from_rng(0), 0, 1)
    calls = 0
    smooth.estimate(points)
    assert calls == n * setup.cost <= 4096
    calls = 0
    mis = mcs.MultipleImportance(f, ["uniform", "linear"], heuristic="optimal(samples=1000)")
    assert mis.pilot_evaluations == 1000
    setup = Setup(mis, setup.sampler)
    assert affordable_count(setup, 1200) == (1200 - 1000) // 2
    assert affordable_count(setup, 1000) is None
    found = mcs.remedies(
        mis.with_heuristic("balance"), "random", 256, realizations=100, kinds=["heuristic"]
    )
    assert "pilot alone takes 4096" in found.attrs["not_tried"]


def test_biased_smoothing_has_no_rate():
    found = mcs.remedies(
        "christensen-disk", "sobol | owen", 256, realizations=100, kinds=["smoothed"]
    )
    (name,) = (str(n) for n in found["remedy"].values if str(n).startswith("smoothed"))
    assert np.isnan(found.sel(remedy=name)["rate"])
    assert found.sel(remedy=name)["rate_verdict"] == "undecided"


def test_means_over_boxes_of_periodic_integrands_are_unbiased():
    f = mcs.integrand("image(values=[[0, 1], [1, 0]])")
    one_width = CandidateSettings(widths=(0.1,))
    found = _found(f, "jittered | shift", "smoothed", settings=one_width)
    changes = [c for c in found if isinstance(c, Candidate)]
    assert [c.biased for c in changes] == [False]


def test_mirrored_estimators_keep_their_other_remedies():
    mis = mcs.MultipleImportance(SMOOTH, ["uniform", "linear"], heuristic="maximum")
    found = _found(mcs.Mirrored(mis), "jittered | shift", "heuristic", "techniques")
    names = {c.name for c in found if isinstance(c, Candidate)}
    assert {"heuristic: balance", "only uniform"} <= names
    assert all(
        isinstance(c.setup.estimator, mcs.Mirrored) for c in found if isinstance(c, Candidate)
    )


def test_tables_with_other_techniques_are_compensated():
    """For f = p q with a table p, p may be set to 0 where q samples often [Karlik2019]."""
    table = mcs.density("piecewise-constant(values=[[1, 1, 9, 1], [1, 1, 1, 1], [1, 9, 1, 1]])")
    other = mcs.density("product(parts=['linear', 'uniform'])")
    f = mcs.Integrand.from_function(lambda x: table.pdf(x) * other.pdf(x), dims=2)
    mis = mcs.MultipleImportance(f, [other, table])
    found = mcs.remedies(mis, "random", 1024, realizations=400, rng=0, kinds=["compensated"])
    best = found.isel(remedy=0)
    assert (best["remedy"], best["verdict"]) == ("compensated: technique 1", "better")
    (made,) = _found(mis, "random", "compensated")
    sharp = mcs.densities.compensated(table, [other])
    assert np.array_equal(made.setup.estimator.densities[1].values, sharp.values)
    (reason,) = _found(SMOOTH, "random", "compensated")
    assert reason.startswith("compensated: ")


def test_a_failing_kind_does_not_affect_other_kinds(monkeypatch):
    def broken(given, budget):
        raise ParameterError("no scan of that.")
        yield

    monkeypatch.setitem(KINDS, "aligned", broken)
    found = _found(SMOOTH, "jittered | shift", "aligned", "unshifted")
    assert [getattr(c, "kind", c) for c in found] == ["aligned: no scan of that.", "unshifted"]


def test_the_answer_gives_reasons_if_no_change_can_be_tested():
    found = mcs.remedies(SMOOTH, "jittered", 256, realizations=100, kinds=["warp", "channels"])
    assert found.attrs["answer"].startswith("No change could be tested. warp: ")


def test_a_budget_too_small_for_two_counts_is_refused():
    with pytest.raises((ParameterError, CountError), match="no two counts"):
        mcs.remedies(
            SMOOTH, mcs.Sampler.from_points(np.full((100, 8, 2), 0.5)), 16, realizations=100
        )


@pytest.mark.parametrize(
    ("integrand", "share", "words"),
    [
        # x + y is odd about the center, although its values on opposite sides differ as well
        ("linear(gradient=[1, 1])", 1.0, "g is odd about the center (100 % of the variance of g)"),
        # A disk at the center is symmetric
        ("disk(center=0.5)", 0.0, None),
    ],
)
def test_mirroring_names_central_symmetry_as_its_cause(integrand, share, words):
    estimator = mcs.Estimator(integrand, dims=2)
    sampler = mcs.sampler("jittered | shift", dims=2)
    found = diagnose(estimator, sampler, Stream.from_rng(0))
    assert found.odd == pytest.approx(share, abs=0.02)
    if words:
        mirrored = mcs.remedies(estimator, sampler, 256, realizations=100, kinds=["mirrored"])
        assert words in str(mirrored.sel(remedy="mirrored: uniform")["reason"].values)


def test_a_variance_is_not_called_an_error(shifted):
    """The answer gives the RMSE, which is the square root of the variance."""
    (error, (low, high)), given = (shifted[name].values[0] for name in ("error", "error_ci")), (
        shifted.sel(remedy="as given")["error"]
    )  # fmt: skip
    text = shifted.attrs["answer"]
    assert f"RMSE {np.sqrt(error):.2g} ({np.sqrt(low):.2g} to {np.sqrt(high):.2g})" in text
    assert f"instead of {np.sqrt(float(given)):.2g}" in text
    best = json.loads(shifted.attrs["best"])
    assert best["rmse"] == pytest.approx(np.sqrt(error))
    assert best["gain"] == pytest.approx(float(given) / error)
    assert "error" not in text
    assert not any("error" in str(reason) for reason in shifted["reason"].values)


def test_too_many_mirror_images_are_not_tried():
    """A point has 2^32 mirror images; the other changes are still measured."""
    g = mcs.Integrand.from_function(lambda u: u.prod(axis=-1), dims=32, integral=2.0**-32)
    found = mcs.remedies(g, "sobol | owen", 64, realizations=100, kinds=["mirrored", "sampler"])
    assert "mirrored: uniform: " in found.attrs["not_tried"]
    assert "use at most 30" in found.attrs["not_tried"]
    assert {"random", "mirrored: random"} <= set(found["remedy"].values)


def test_an_exact_lattice_has_no_error_although_the_integral_is_unknown():
    """Its equal estimates are accepted as exact because they agree with the other samplers."""

    def wave(x):
        return np.prod(1.0 + 0.5 * np.cos(2.0 * np.pi * x), axis=-1)

    found = mcs.remedies(wave, "random", 1024, dims=4, realizations=100, kinds=["sampler"])
    row = found.sel(remedy="rank1-lattice | shift")
    assert float(row["error"]) == 0.0
    assert row["verdict"] == "better"
    assert json.loads(found.attrs["best"])["sampler"] == "rank1-lattice | shift"


def test_estimates_that_miss_rare_events_are_not_called_exact():
    def rare(x):
        return (x[..., 0] < 1e-3) * 1.0

    found = mcs.remedies(
        rare, "sobol | owen", 64, dims=2, realizations=400, rng=1, kinds=["sampler"]
    )
    assert not (found["error"].sel(remedy=found["verdict"] == "better") == 0.0).any()

    def rarer(x):
        return (x[..., 0] < 1e-9) * 1.0

    found = mcs.remedies(rarer, "random", 64, dims=2, realizations=100, kinds=["sampler"])
    assert np.isnan(found["error"].values).all()
    assert "missed a rare region" in found.attrs["answer"]


def test_changes_of_the_estimator_are_also_tried_with_nets():
    """Means along an axis are smooth, and nets gain more than strata for smooth functions."""

    def half_space(x):
        return (x @ np.array([0.6, 0.8]) < 0.7) * 1.0

    found = mcs.remedies(
        half_space, "jittered", 1024, dims=2, realizations=100, kinds=["preintegrated"]
    )
    pair, alone = (
        float(found["error"].sel(remedy=name))
        for name in ("preintegrated along axis 1, with sobol | owen", "preintegrated along axis 1")
    )
    assert pair < 0.1 * alone
