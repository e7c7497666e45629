"""Plans: the smallest count that reaches an error, predicted, measured, or extrapolated."""

import functools
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from tests.oracles import digital_option

import mcspectra as mcs
from mcspectra.core.errors import BudgetError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.improve.planning import _Nets
from mcspectra.plots.kinds import describe
from mcspectra.prediction import prediction, subsets, torus


@pytest.fixture
def quick_predictions(monkeypatch):
    """Fit few products and measure few sets, so that predictions have wider intervals."""
    few = replace(subsets.SUBSET_SETTINGS, rank=2, sweeps=8, draws=4)
    monkeypatch.setattr(subsets, "SUBSET_SETTINGS", few)
    monkeypatch.setattr(torus, "_MOVES", replace(torus._MOVES, offsets=2**11))
    settings = prediction.ExtrapolationSettings(sets=500, near_sets=250, near_points=2**16)
    methods = tuple(
        replace(each, predict=functools.partial(each.predict, settings=settings))
        if each.name == "extrapolated"
        else each
        for each in prediction.METHODS
    )
    monkeypatch.setattr(prediction, "METHODS", methods)


def test_random_points_need_variance_over_squared_error():
    """f = x has variance 1/12."""
    f = mcs.integrand("linear", dims=1)
    for target in (0.02, 1e-3):  # inside the curve, and far above its last count
        found = mcs.plan(f, "random", target_error=target)
        exact = 1 / (12 * target**2)
        assert exact * (1 - 1e-9) <= float(found["planned_n"]) <= 1.05 * exact + 1
        assert float(found["planned_error"]) <= target
    assert found.attrs["how"] == "extrapolated from n = 65536"
    assert mcs.plan(f, "random", target_error=0.02).attrs["method"] == "exact"


def test_jittered_points_reach_the_error_at_the_smallest_count():
    """The variance of f = x is 1/(12 n³)."""
    f = mcs.integrand("linear", dims=1)
    assert float(mcs.plan(f, "jittered", target_error=0.5)["planned_n"]) == 1
    found = mcs.plan(f, "jittered", target_error=1e-4)
    assert float(found["planned_n"]) == math.ceil((1 / (12 * 1e-8)) ** (1 / 3))
    half = mcs.plan(
        f, "jittered", target_error=2e-4, relative=True
    )  # relative to the integral, 1/2
    assert float(half["planned_n"]) == float(found["planned_n"])


def test_planned_counts_reach_the_error():
    f = mcs.integrand("disk(center=(0.4,0.55),radius=0.3)", dims=2)
    samplers = ["sobol | owen", "jittered | shift", "random"]
    target = 1.6e-2
    plan = mcs.plan(f, samplers, target_error=target)
    for sampler, n in zip(samplers, plan["planned_n"].values, strict=True):
        measured = mcs.convergence(f, sampler, [int(n)], realizations=1000, rng=3)
        low, _ = np.sqrt(measured["variance_ci"].values[0])
        assert low <= target * 1.05  # predictions for disks have this accuracy
    found = plan["planned_n"].sel(sampler="sobol | owen")
    assert int(found).bit_count() == 1
    assert f" {int(found):,} with sobol | owen" in plan.attrs["answer"]
    assert plan.attrs["answer"].endswith("with random")


def test_the_curve_ends_well_below_the_error():
    curve = mcs.plan("gaussian", "jittered", target_error=1e-3)["predicted_variance"]
    known = curve.dropna("n").values
    assert (np.diff(known) < 0).all()
    assert known[-1] <= 0.25e-6 < known[-2] * 4


def test_deterministic_samplers_have_no_plan():
    found = mcs.plan("gaussian", ["sobol", "random"], target_error=1e-2)
    assert np.isnan(found["planned_n"].sel(sampler="sobol"))
    assert "sobol: a deterministic sampler has no variance" in found.attrs["note"]


@pytest.mark.usefixtures("quick_predictions")
def test_plans_can_be_the_smallest_possible_count():
    """One point of an unbiased sampler has the variance σ²; orthogonal arrays need four points."""
    f = mcs.integrand("disk", dims=2)
    samplers = ["random", "jittered | shift", "sobol | owen", "pmj02"]
    plan = mcs.plan(f, samplers, target_error=0.5)
    of_one = math.sqrt(math.pi / 16 * (1 - math.pi / 16))
    np.testing.assert_allclose(plan["planned_error"], of_one, rtol=1e-9)
    assert (plan["planned_n"] == 1).all()
    assert float(mcs.plan(f, "orthogonal-array", target_error=0.5)["planned_n"]) == 4


def test_zero_variance_reaches_every_error():
    """A constant needs one point; a wave needs a grid that resolves it."""
    assert float(mcs.plan("constant", "random", target_error=1e-9)["planned_n"]) == 1
    wave = mcs.integrand("cosine(frequency=1)", dims=1)
    found = mcs.plan(wave, "regular | shift", target_error=0.1)
    assert (float(found["planned_n"]), float(found["planned_error"])) == (2, 0)
    assert "note" not in found.attrs


@pytest.mark.parametrize(
    ("f", "dims", "sampler", "target", "most"),
    [
        ("formula(expression='(x0<1/3)*1.')", 1, "regular | shift", 3e-3, 158),
        ("disk(center=0.47)", 2, "jittered", 2e-3, 1681),
    ],
)
def test_no_smaller_count_nearby_reaches_the_error(f, dims, sampler, target, most):
    """The variance is not monotone in n; only base-2 samplers are limited to powers of two."""
    f = mcs.integrand(f, dims=dims)
    assert float(mcs.predict(f, sampler, [most])["predicted_variance"][0]) <= target**2
    found = mcs.plan(f, sampler, target_error=target)
    assert float(found["planned_n"]) <= most
    assert float(found["planned_error"]) <= target


@pytest.mark.usefixtures("quick_predictions")
def test_plans_have_intervals():
    """The intervals follow from the predictions; the answer shows none for exact predictions."""
    f = mcs.integrand("christensen-disk", dims=2)
    found = mcs.plan(f, ["sobol | owen", "random"], target_error=1e-2)
    low, high = found["planned_n_ci"].values.T
    assert (low <= found["planned_n"]).all()
    assert (found["planned_n"] <= high).all()
    edge = mcs.integrand("half-space(normal=[1.0, 0.77, 0.63, 0.53], offset=1.3)", dims=4)
    wide = mcs.plan(edge, "perturbed-lattice | shift", target_error=5e-2)
    low, high = wide["planned_n_ci"].values
    assert high > 1.25 * low
    assert f"({low:.0f} to {high:.0f}) with perturbed-lattice" in wide.attrs["answer"]
    assert f"({low:.0f} … {high:.0f})" in str(describe("prediction", wide).panels[0].marks)


@pytest.mark.parametrize("target", [0.0, -1.0, math.nan, math.inf, "small", None])
def test_invalid_targets_are_refused(target):
    with pytest.raises(ParameterError, match="target_error"):
        mcs.plan("gaussian", "random", target_error=target)


def test_relative_errors_need_a_nonzero_integral():
    f = mcs.integrand("cosine(frequency=1)", dims=1)
    with pytest.raises(ParameterError, match="without relative"):
        mcs.plan(f, "random", target_error=0.1, relative=True)


# Functions of users, for which plans use measurements with few evaluations
FUNCTIONS = {
    "smooth": (lambda x: np.exp(x.sum(axis=-1)), 2),
    "kink": (lambda x: np.abs(x.sum(axis=-1) - 0.8), 2),
    "disk": (lambda x: 1.0 * (((x - 0.5) ** 2).sum(axis=-1) < 0.09), 2),
    "jump along an axis": (lambda x: (x[..., 0] > 0.37) * np.exp(x[..., 1]), 2),
    "digital option": (digital_option(16), 16),
    "pole": (lambda x: x[..., 0] ** -0.3, 1),
    "Gaussian peak": (lambda x: np.exp(-((x - 0.4) ** 2).sum(axis=-1) / 0.02), 2),
    "ridge": (lambda x: np.maximum(x.sum(axis=-1) - 2.0, 0.0), 4),
    "waves": (lambda x: np.cos(9.0 * x.sum(axis=-1)), 3),
    "product": (lambda x: (1.0 + 0.5 * np.cos(2.0 * np.pi * x)).prod(axis=-1), 4),
}


class Counting:
    """A function that counts its points."""

    def __init__(self, function, dims):
        self.function, self.dims, self.calls = function, dims, 0

    def __call__(self, x):
        self.calls += x.size // self.dims
        return self.function(x)


# Each function with one of the samplers; the other pairs are slow
QUICK_PAIRS = set(zip(FUNCTIONS, itertools.cycle(["random", "sobol | owen"])))


@pytest.mark.parametrize(
    ("name", "sampler"),
    [
        pytest.param(*pair, marks=[] if pair in QUICK_PAIRS else [pytest.mark.slow])
        for pair in itertools.product(FUNCTIONS, ["random", "sobol | owen"])
    ],
)
def test_plans_agree_with_profiles(name, sampler):
    """The n for the error in a profile agrees with the profile's n within both intervals."""
    f, dims = FUNCTIONS[name]
    found = mcs.profile(f, dims=dims, sampler=sampler, budget=4096, rng=1)
    curve = found.samplers[sampler]
    variance, error = curve.at(found.points)
    planned = mcs.plan(f, sampler, dims=dims, target_error=math.sqrt(variance), rng=1)
    low, high = planned["planned_n_ci"].values
    away = math.exp(1.96 * error / -curve.rate)
    assert low <= (2 if sampler != "random" else 1) * found.points * away  # n is a power of 2
    assert found.points / away <= high
    assert planned.attrs["evaluations"] <= 2**18


SAMPLERS = ["random", "sobol | owen", "jittered", "halton | owen", "rank1-lattice | shift"]
ALL_PAIRS = list(itertools.product(["smooth", "disk", "jump along an axis", "pole"], SAMPLERS))
# Each function and each sampler at least once, the functions of jumps twice; the others are slow
SOME_PAIRS = [ALL_PAIRS[place] for place in (0, 6, 9, 12, 13, 15)]


@pytest.mark.parametrize(
    ("name", "sampler"),
    [
        pytest.param(*pair, marks=[] if pair in SOME_PAIRS else [pytest.mark.slow])
        for pair in ALL_PAIRS
    ],
)
def test_measured_plans_are_monotone_in_the_error(name, sampler):
    f, dims = FUNCTIONS[name]
    before = 0.0
    for target in np.geomspace(0.3, 1e-3, 7):
        found = mcs.plan(f, sampler, dims=dims, target_error=target, rng=7)
        n, (low, high) = float(found["planned_n"]), found["planned_n_ci"].values
        assert before <= n
        assert low <= n <= high
        assert np.isfinite(high) or found.attrs["note"]
        before = n


@pytest.mark.parametrize(
    ("f", "dims", "sampler"),
    [
        ("disk(center=0.47)", 2, "jittered"),
        ("formula(expression='(x0<1/3)*1.')", 1, "regular | shift"),
        ("christensen-disk", 2, "random"),
        ("gaussian", 2, "sobol | owen"),
    ],
)
def test_predicted_plans_are_monotone_in_the_error(f, dims, sampler):
    f = mcs.integrand(f, dims=dims)
    targets = np.geomspace(0.05, 4e-3, 6)
    counts = [float(mcs.plan(f, sampler, target_error=t)["planned_n"]) for t in targets]
    assert counts == sorted(counts)


@pytest.mark.parametrize(
    ("sampler", "target"),
    [
        ("random", 2e-3),
        ("sobol | owen", 2e-3),
        ("jittered", 2e-3),
        ("latin-hypercube", 8e-3),  # Exact variances at larger counts take seconds
        pytest.param("latin-hypercube", 2e-3, marks=pytest.mark.slow),
    ],
)
def test_measured_plans_agree_with_predicted_plans(sampler, target):
    known = mcs.integrand("gaussian", dims=2)
    expected = float(mcs.plan(known, sampler, target_error=target)["planned_n"])
    low, high = mcs.plan(known.__call__, sampler, dims=2, target_error=target)[
        "planned_n_ci"
    ].values
    assert low <= 1.05 * expected
    assert expected <= 1.05 * high


def test_easy_targets_need_few_evaluations():
    """If few points reach the target, the plan needs one stage, for any limit."""
    f = Counting(FUNCTIONS["disk"][0], 2)
    found = mcs.plan(f, "sobol | owen", dims=2, target_error=0.1, max_evaluations=2**20)
    assert found.attrs["evaluations"] == 4096
    assert float(found["planned_n"]) <= 16
    assert mcs.plan(f, "random", dims=2, target_error=1e-3).attrs["evaluations"] == 4096


@pytest.mark.parametrize("most", [1000, 5000, 30_000])
def test_evaluations_stay_within_the_limit(most):
    f = Counting(FUNCTIONS["disk"][0], 2)
    samplers = ["sobol | owen", "random", "jittered | shift"]
    found = mcs.plan(f, samplers, dims=2, target_error=1e-4, max_evaluations=most)
    assert f.calls - 28 == found.attrs["evaluations"] <= most  # 28 calls test how f must be called
    assert np.isfinite(found["planned_n"]).all()


def test_too_small_a_limit_is_refused_before_the_first_call():
    f = Counting(FUNCTIONS["disk"][0], 2)
    message = "plan takes at least 256 evaluations of the integrand, and max_evaluations is 200"
    with pytest.raises(BudgetError, match=message):
        mcs.plan(f, "random", dims=2, target_error=0.1, max_evaluations=200)
    assert f.calls == 28


def test_later_stages_reuse_earlier_evaluations():
    """Later stages extend the same nets, so no point is evaluated twice."""
    f = Counting(FUNCTIONS["disk"][0], 2)
    estimator = mcs.Estimator(mcs.Integrand.from_function(f, dims=2))
    nets = _Nets(estimator, 2**16, Stream.from_rng(3))
    stages = list(nets.stages())
    sets, n = nets.values[0].shape[:2]
    (points,) = estimator.draw(mcs.sampler("sobol | owen", dims=2), n, Stream.from_rng(3), 0, sets)
    np.testing.assert_array_equal(nets.values[0][..., 0], f.function(points))
    assert stages[-1].evaluations == sets * n == 2**16


def test_open_intervals_have_a_reason():
    pole = mcs.plan(FUNCTIONS["pole"][0], "random", dims=1, target_error=1e-2)
    assert math.isinf(pole["planned_n_ci"].values[1])
    assert "f grows about as t^−0.3" in pole.attrs["note"]
    assert " or more) with random" in pole.attrs["answer"]
    same = mcs.plan(lambda x: 0 * x[..., 0] + 3, "random", dims=2, target_error=1e-2)
    assert same["planned_n_ci"].values.tolist() == [1, math.inf]
    assert "either it is constant" in same.attrs["note"]


def test_relative_targets_use_the_measured_integral():
    """The mean comes from the nets; quadrature does not evaluate the function."""
    f = Counting(FUNCTIONS["smooth"][0], 2)
    found = mcs.plan(f, "random", dims=2, target_error=0.01, relative=True)
    assert float(found["target_variance"]) ** 0.5 == pytest.approx(
        0.01 * (math.e - 1) ** 2, rel=1e-3
    )
    assert f.calls - 28 == 4096
    with_sign = mcs.plan(
        lambda x: np.sin(2 * np.pi * x[..., 0]), "random", dims=2, target_error=0.01, relative=True
    )
    assert "the integral may be 0" in with_sign.attrs["note"]


def test_channels_and_techniques_are_measured_together():
    """Every channel reaches the error, and a point of two techniques is two evaluations."""
    channels = mcs.Integrand.from_function(
        lambda x: np.stack([x[..., 0], 3 * x[..., 0]], axis=-1), dims=1
    )
    both = mcs.plan(channels, "random", target_error=0.01)
    assert float(both["planned_n"]) == pytest.approx(9 / 12e-4, rel=0.1)
    mis = mcs.MultipleImportance(
        mcs.Integrand.from_function(lambda x: x[..., 0] ** 2, dims=1),
        ["uniform", "linear(slope=0.5)"],
    )
    found = mcs.plan(mis, ["random", "jittered"], target_error=0.01)
    assert (found["planned_n_ci"].sel(bound="high") >= found["planned_n"]).all()
    assert "each is 2 evaluations" in found.attrs["answer"]
