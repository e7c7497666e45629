"""Plans: the least count that reaches an error, by predictions and beyond them."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.plots.kinds import describe


def test_random_points_need_the_variance_over_the_squared_error():
    """f = x has variance 1/12."""
    f = mcs.integrand("linear", dims=1)
    for target in (0.02, 1e-3):  # within the curve and far beyond it
        found = mcs.plan(f, "random", target_error=target)
        exact = 1 / (12 * target**2)
        assert exact * (1 - 1e-9) <= float(found["planned_n"]) <= 1.05 * exact + 1
        assert float(found["planned_error"]) <= target
    assert found.attrs["how"] == "extrapolated from n = 65536"
    assert mcs.plan(f, "random", target_error=0.02).attrs["method"] == "exact"


def test_strata_reach_it_at_the_first_count_that_they_can_do():
    """The variance of f = x is 1/(12 n³)."""
    f = mcs.integrand("linear", dims=1)
    assert float(mcs.plan(f, "jittered", target_error=0.5)["planned_n"]) == 1
    found = mcs.plan(f, "jittered", target_error=1e-4)
    assert float(found["planned_n"]) == math.ceil((1 / (12 * 1e-8)) ** (1 / 3))
    half = mcs.plan(f, "jittered", target_error=2e-4, relative=True)  # of 1/2
    assert float(half["planned_n"]) == float(found["planned_n"])


def test_planned_counts_do_what_was_planned():
    f = mcs.integrand("disk(center=(0.4,0.55),radius=0.3)", dims=2)
    samplers = ["sobol | owen", "jittered | shift", "random"]
    plan = mcs.plan(f, samplers, target_error=8e-3)
    for sampler, n in zip(samplers, plan["planned_n"].values, strict=True):
        measured = mcs.convergence(f, sampler, [int(n)], realizations=1000, rng=3)
        low, _ = np.sqrt(measured["variance_ci"].values[0])
        assert low <= 8e-3 * 1.05  # the accuracy of predictions of disks
    found = plan["planned_n"].sel(sampler="sobol | owen")
    assert int(found).bit_count() == 1
    assert f" {int(found):,} with sobol | owen" in plan.attrs["recommendation"]
    assert plan.attrs["recommendation"].endswith("with random")


def test_the_curve_ends_well_below_the_error():
    curve = mcs.plan("gaussian", "jittered", target_error=1e-3)["predicted_variance"]
    known = curve.dropna("n").values
    assert (np.diff(known) < 0).all()
    assert known[-1] <= 0.25e-6 < known[-2] * 4


def test_what_never_varies_has_no_plan():
    found = mcs.plan("gaussian", ["sobol", "random"], target_error=1e-2)
    assert np.isnan(found["planned_n"].sel(sampler="sobol"))
    assert "sobol: a deterministic sampler has no variance" in found.attrs["note"]


def test_plans_go_down_to_the_least_count_that_there_is():
    """One point of any unbiased sampler has σ²; an orthogonal array has 4 at least."""
    f = mcs.integrand("disk", dims=2)
    samplers = ["random", "jittered | shift", "sobol | owen", "pmj02"]
    plan = mcs.plan(f, samplers, target_error=0.5)
    of_one = math.sqrt(math.pi / 16 * (1 - math.pi / 16))
    np.testing.assert_allclose(plan["planned_error"], of_one, rtol=1e-9)
    assert (plan["planned_n"] == 1).all()
    assert float(mcs.plan(f, "orthogonal-array", target_error=0.5)["planned_n"]) == 4


def test_what_vanishes_reaches_every_error():
    """A constant does at one point; a wave where a grid resolves it."""
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
def test_no_count_nearby_is_less(f, dims, sampler, target, most):
    """Curves go up and down; digits in base 2 alone are kept to powers of two."""
    f = mcs.integrand(f, dims=dims)
    assert float(mcs.predict(f, sampler, [most])["predicted_variance"][0]) <= target**2
    found = mcs.plan(f, sampler, target_error=target)
    assert float(found["planned_n"]) <= most
    assert float(found["planned_error"]) <= target


def test_plans_have_intervals():
    """As wide as those of the predictions; of exact ones there is nothing to say."""
    f = mcs.integrand("christensen-disk", dims=2)
    found = mcs.plan(f, ["sobol | owen", "random"], target_error=1e-2)
    low, high = found["planned_n_ci"].values.T
    assert (low <= found["planned_n"]).all()
    assert (found["planned_n"] <= high).all()
    edge = mcs.integrand("half-space(normal=[1.0, 0.77, 0.63, 0.53], offset=1.3)", dims=4)
    wide = mcs.plan(edge, "perturbed-lattice | shift", target_error=1e-2)
    low, high = wide["planned_n_ci"].values
    assert high > 1.25 * low
    assert f"({low:.0f} to {high:.0f}) with perturbed-lattice" in wide.attrs["recommendation"]
    assert f"({low:.0f} … {high:.0f})" in str(describe("prediction", wide).panels[0].marks)


@pytest.mark.parametrize("target", [0.0, -1.0, math.nan, math.inf, "small", None])
def test_targets_that_are_none(target):
    with pytest.raises(ParameterError, match="target_error"):
        mcs.plan("gaussian", "random", target_error=target)


def test_no_error_is_a_share_of_nothing():
    f = mcs.integrand("cosine(frequency=1)", dims=1)
    with pytest.raises(ParameterError, match="without relative"):
        mcs.plan(f, "random", target_error=0.1, relative=True)
