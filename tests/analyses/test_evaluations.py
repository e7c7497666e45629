"""Calls of a user's function at every public function: the requested number and no more."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.analysis import ANALYSES, Counted
from mcspectra.core.errors import BudgetError
from mcspectra.core.tally import counting, spend
from mcspectra.report.reprs import component_html

PROBE = 28  # Number of points on which `from_function` tests a function
R, N = 40, 16
JITTERED, SHIFTED = "jittered", "jittered | shift"


class Function:
    """exp(x + y) where x is beyond a jump; it counts its points."""

    def __init__(self, dims, jump=0.3):
        self.dims, self.jump, self.calls = dims, jump, 0
        self.integrand = mcs.Integrand.from_function(self, dims=dims)
        assert self.calls == PROBE
        self.calls = 0

    def __call__(self, x):
        self.calls += x.size // self.dims
        return np.exp(x.sum(axis=-1)) * (x[..., 0] >= self.jump)


ESTIMATORS = {
    "plain": (lambda f: mcs.Estimator(f), 2, 1),
    "density": (lambda f: mcs.Estimator(f, "linear(slope=0.5)"), 1, 1),
    "mis": (lambda f: mcs.MultipleImportance(f, ["uniform", "linear(slope=0.5)"]), 1, 2),
    "mirrored": (lambda f: mcs.Mirrored(f, "integrand"), 2, 1),
}

# Measurements, and the number of calls that they promise for each number of techniques
MEASURED = {
    "convergence": (lambda e: mcs.convergence(e, JITTERED, [N, 64], realizations=R), R * (N + 64)),
    "realizations_needed": (
        lambda e: mcs.measure.realizations_needed(
            e, JITTERED, N, relative_error=1e-3, max_realizations=R
        ),
        R * N,
    ),
    "mirror_study": (
        lambda e: mcs.improve.mirror_study(
            e, JITTERED, [N, 64], mirrorings=["original"], realizations=R
        ),
        2 * R * (N + 64),
    ),
    "strata_shift_scan": (
        lambda e: mcs.improve.strata_shift_scan(
            e, JITTERED, [N, 64], offsets=[0, 0.5], realizations=R
        ),
        {1: 2 * R * (N + 64), 2: 4 * R * (N + 64)},
    ),
    "anova_variances": (
        lambda e: mcs.anova_variances(e, JITTERED, N, realizations=R),
        {1: 2 * R * N, 2: 4 * R * N},
    ),
}  # fmt: skip

# Functions that are called explicitly and report their calls
NAMED = {
    "variance_terms": lambda e, m=None: mcs.variance_terms(
        e, JITTERED, N, half_width=2, realizations=R, max_evaluations=m
    ),
    "technique_terms": lambda e, m=None: mcs.technique_terms(
        e, JITTERED, N, half_width=2, realizations=R, max_evaluations=m
    ),
    "covariance_modes": lambda e, m=None: mcs.covariance_modes(
        e, JITTERED, N, half_width=2, modes=2, realizations=R, max_evaluations=m
    ),
    "predict by all methods": lambda e, m=2**24: mcs.predict(
        e, SHIFTED, [N], method="all", half_width=2, realizations=R, max_evaluations=m
    ),
    "predict": lambda e, m=None: mcs.predict(e, JITTERED, [N], max_evaluations=m),
    "image_error_spectrum": lambda e, m=None: mcs.prediction.image_error_spectrum(
        e, "random | decorrelate(width=8)", 4, half_width=2, images=2, max_evaluations=m
    ),
    "nested_variances": lambda e, m=None: mcs.spectra.nested_variances(e, 6, max_evaluations=m),
    "integrand_decay": lambda e, m=None: mcs.prediction.integrand_decay(
        e, half_width=32, max_evaluations=m
    ),
    "plan": lambda e, m=None: mcs.plan(e, JITTERED, target_error=0.1, max_evaluations=m),
    "exact_variance": lambda e, m=None: mcs.exact_variance(e, JITTERED, N, max_evaluations=m),
}

# Also called explicitly, without a count, because the calls are their subject
PICTURES = {"primary_picture", "design", "certificate"}

# Tested separately, or without calls
ELSEWHERE = {
    "remedies",
    "smoothing_scan",
    "best_alignment",
    "aligned",
    "anova_spectrum",
    "integrate",
    "learned_density",
    "profile",
    "profile_scene",
    "plan_scene",
}
CALL_NOTHING = {
    *("closed_form_covariance", "closed_form_pair_correlation", "closed_form_power"),
    *("closed_form_walsh_power", "gain_coefficients", "axis_frequencies"),
    *("diagonal_frequencies", "plane_frequencies", "subset_frequencies", "power_at"),
    *(
        "pair_correlation",
        "power_spectrum",
        "low_frequency_exponent",
        "radial_statistics",
        "slices",
    ),
    *("variance_from_spectrum", "wedge_means", "fitted_decay", "predicted_rate", "warp_quality"),
    *("quality_figures", "density", "integrand", "sampler", "smoothed", "channel_estimators"),
    *("progress_bars", "chain_error", "sampler_bench"),
}


def made(kind):
    make, dims, techniques = ESTIMATORS[kind]
    f = Function(dims)
    estimator = make(f.integrand)
    assert f.calls == 0  # A density that is positive everywhere costs no call
    return f, estimator, dims, techniques


def test_every_public_function_is_here():
    names = {name: getattr(mcs, name) for name in mcs.__all__}
    for package in (
        mcs.spectra,
        mcs.measure,
        mcs.prediction,
        mcs.explain,
        mcs.improve,
        mcs.profiler,
    ):
        names |= {name: getattr(package, name) for name in package.__all__}
    functions = {name for name, found in names.items() if name.islower() and callable(found)}
    assert functions <= {*MEASURED, *NAMED, *PICTURES, *ELSEWHERE, *CALL_NOTHING}


@pytest.mark.parametrize("kind", ESTIMATORS)
@pytest.mark.parametrize("name", MEASURED)
def test_measurements_make_the_promised_number_of_calls(name, kind):
    call, promised = MEASURED[name]
    f, estimator, dims, techniques = made(kind)
    found = call(estimator)
    if isinstance(promised, dict):
        promised = promised[dims]
    assert f.calls == techniques * promised
    if "evaluations" in found.attrs:
        assert found.attrs["evaluations"] == f.calls


@pytest.mark.parametrize("name", NAMED)
def test_results_report_their_calls(name):
    f = Function(1, jump=0.0)
    found = NAMED[name](f.integrand)
    assert f.calls > 0
    if hasattr(found, "attrs"):
        assert found.attrs["evaluations"] == f.calls


@pytest.mark.parametrize("most", [100, 3_000])
@pytest.mark.parametrize("name", NAMED)
def test_no_call_is_made_above_the_limit(name, most):
    f = Function(2)
    if name == "plan" and most >= 256:  # The search stays within its limit
        found = NAMED[name](f.integrand, most)
        assert f.calls == found.attrs["evaluations"] <= most
        return
    with pytest.raises(
        BudgetError, match=f"{name.split()[0]} takes at least .* max_evaluations is {most};"
    ):
        NAMED[name](f.integrand, most)
    assert f.calls <= most


def test_too_small_limits_are_refused_before_any_call():
    f = Function(2)
    for call in (
        lambda: mcs.remedies(f.integrand, JITTERED, 64, realizations=100, max_evaluations=6400),
        lambda: mcs.convergence(
            f.integrand, JITTERED, [N], realizations=R, max_evaluations=R * N - 1
        ),
        lambda: mcs.anova_variances(
            f.integrand, JITTERED, N, realizations=R, max_evaluations=R * N
        ),
        lambda: mcs.improve.mirror_study(
            f.integrand, JITTERED, [N], realizations=R, max_evaluations=8 * R * N - 1
        ),
    ):
        with pytest.raises(BudgetError):
            call()
    assert f.calls == 0
    mcs.convergence(f.integrand, JITTERED, [N], realizations=R, max_evaluations=R * N)
    assert f.calls == R * N


def test_registered_analyses_of_an_integrand_can_be_limited():
    free = {"spectrum", "points", "pcf", "anova-spectrum", "exact", "map", "profile"}
    for name in set(ANALYSES) - free:
        assert issubclass(ANALYSES.load(name), Counted), name


def test_an_unknown_integral_is_noted_and_omits_the_bias():
    f = Function(2)
    found = mcs.convergence(f.integrand, JITTERED, [N, 64], realizations=R)
    assert np.isnan(found["bias"]).all()
    assert np.array_equal(found["mse"], found["variance"])
    assert found.attrs["integral_source"] == "unknown"
    assert "the integral is unknown, so no bias is measured; give integral=" in found.attrs["note"]
    known = mcs.Integrand.from_function(f, dims=2, integral=(np.e - np.exp(0.3)) * (np.e - 1))
    again = mcs.convergence(known, JITTERED, [N, 64], realizations=R)
    assert np.array_equal(found["variance"], again["variance"])
    assert (np.abs(again["bias"]) < 5 * again["bias_se"]).all()


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_remedies_keep_to_their_budget(kind):
    """At most 4/3 B R per set-up, and 7/3 B R for the diagnosis (see `remedies`)."""
    budget, realizations = 64, 100
    f, estimator, *_ = made(kind)
    found = mcs.remedies(estimator, JITTERED, budget, realizations=realizations)
    assert f.calls == found.attrs["evaluations"]
    assert f.calls <= budget * realizations * (4 / 3 * found.sizes["remedy"] + 7 / 3)


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_remedies_refuse_before_or_stay_within(kind):
    budget, realizations = 64, 100
    refused = done = 0
    for factor in (1, 2, 3, 5, 20, 60):
        f, estimator, *_ = made(kind)
        most = factor * budget * realizations
        try:
            found = mcs.remedies(
                estimator, JITTERED, budget, realizations=realizations, max_evaluations=most
            )
        except BudgetError:
            assert f.calls == 0
            refused += 1
        else:
            assert f.calls == found.attrs["evaluations"] <= most
            done += 1
            assert found.sizes["remedy"] > 1 or factor < 60
    assert refused
    assert done


def test_remedies_try_a_change_or_refuse_with_the_given_limit():
    """Earlier versions measured the given set-up and then tried no change."""
    f, limit = Function(2), 400_000
    with pytest.raises(BudgetError, match=f"max_evaluations is {limit}"):
        mcs.remedies(f.integrand, "random", 1024, realizations=100, max_evaluations=limit)
    assert f.calls == 0
    found = mcs.remedies(
        f.integrand, "random", 1024, realizations=100, max_evaluations=limit, kinds=["sampler"]
    )
    assert found.sizes["remedy"] > 1
    assert f"share of max_evaluations = {limit}" in found.attrs["not_tried"]


def test_searches_are_charged():
    f = Function(1)
    mcs.improve.smoothing_scan(f.integrand, JITTERED, N, [0.1, 0.2], realizations=R)
    boxes = [mcs.smoothed(f.integrand, w).evaluations_per_point for w in (0.1, 0.2)]
    assert f.calls == R * N * sum(boxes)
    f.calls = 0
    found = mcs.improve.best_alignment(f.integrand, JITTERED, N, realizations=R)
    assert found.attrs["method"] == "measured"
    assert f.calls % (R * N) == 0


def test_showing_a_result_makes_no_calls():
    for kind in ESTIMATORS:
        f, estimator, *_ = made(kind)
        repr(estimator), component_html(estimator), component_html(f.integrand)
        assert f.calls == 0


def test_tallies_can_be_nested():
    with counting("outer", 10) as outer:
        with counting("inner", 5) as inner:
            spend(4)
            with pytest.raises(BudgetError, match="inner takes at least 6"):
                spend(2)
        spend(6)
        with pytest.raises(BudgetError, match="outer takes at least 11"):
            spend(1)
    assert (inner.made, outer.made) == (4, 10)
    with pytest.raises(BudgetError):  # This also holds if the error was caught in between
        inner.check()


def test_calls_of_integrands_of_other_packages_are_counted():
    class Theirs(mcs.Integrand):
        name, dims, spec = "theirs", 2, "theirs"
        points = 0

        def _evaluate(self, x):
            type(self).points += x.size // 2
            return x[..., 0]

    found = mcs.convergence(Theirs(), JITTERED, [N, 64], realizations=R)
    assert Theirs.points == R * (N + 64) == found.attrs["evaluations"]
    assert found.attrs["integral_source"] == "unknown"
