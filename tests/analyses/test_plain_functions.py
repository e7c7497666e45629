"""Plain functions with dims give the same results and counts as integrands."""

import inspect

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import McspectraError, ParameterError

PROFILED = ("integral", "interval", "variance", "rate", "rate_ci", "tried", "calls")
PROBE = 28  # Number of points on which `from_function` tests a function


class Counting:
    """The function exp(x0) + x1, which counts its points."""

    def __init__(self):
        self.calls = 0

    def __call__(self, x):
        self.calls += x.size // 2
        return np.exp(x[..., 0]) + x[..., 1]


# Functions that take an estimator, with few evaluations. Two threads may both compute the same
# property of f
CALLS = {
    "convergence": lambda f, **given: mcs.convergence(
        f, ["random", "jittered"], [4, 16], realizations=20, **given
    ),
    "predict": lambda f, **given: mcs.predict(f, "jittered", [16], workers=1, **given),
    "plan": lambda f, **given: mcs.plan(f, "jittered", target_error=0.05, workers=1, **given),
    "variance_terms": lambda f, **given: mcs.variance_terms(
        f, ["random", "jittered"], 16, half_width=4, realizations=16, **given
    ),
    "technique_terms": lambda f, **given: mcs.technique_terms(
        f, "jittered", 16, half_width=4, realizations=16, **given
    ),
    "anova_variances": lambda f, **given: mcs.anova_variances(
        f, "random", 4, realizations=100, **given
    ),
    "covariance_modes": lambda f, **given: mcs.covariance_modes(
        f, "jittered", 16, half_width=2, modes=2, realizations=16, **given
    ),
    "exact_variance": lambda f, **given: mcs.exact_variance(f, "jittered", 16, **given),
    "remedies": lambda f, **given: mcs.remedies(
        f, "random", 64, realizations=100, kinds=["sampler"], **given
    ),
    "profile": lambda f, **given: mcs.profile(f, budget=1024, **given),
    "integrate": lambda f, **given: mcs.integrate(f, budget=512, **given),
    "realizations_needed": lambda f, **given: mcs.measure.realizations_needed(
        f, "random", 4, relative_error=0.5, **given
    ),
    "mirror_study": lambda f, **given: mcs.improve.mirror_study(
        f, "jittered", [4, 16], mirrorings=["original"], realizations=20, **given
    ),
    "strata_shift_scan": lambda f, **given: mcs.improve.strata_shift_scan(
        f, "jittered", 4, offsets=[0, 0.5], realizations=20, **given
    ),
    "best_alignment": lambda f, **given: mcs.improve.best_alignment(
        f, "jittered", 4, offsets=[0, 0.5], realizations=20, **given
    ),
    "primary_picture": lambda f, **given: mcs.explain.primary_picture(f, resolution=8, **given),
}


def _numbers(found):
    """Return all numbers of a result."""
    if isinstance(found, mcs.Profile):
        return {name: np.asarray(getattr(found, name)) for name in PROFILED}
    if not hasattr(found, "data_vars"):
        return {"": np.asarray(found)}
    return {name: v.values for name, v in found.data_vars.items() if v.dtype.kind in "iufc"}


@pytest.mark.parametrize("name", CALLS)
def test_a_function_gives_the_results_of_an_integrand(name):
    f, g = Counting(), Counting()
    found = CALLS[name](f, dims=2)
    integrand = mcs.Integrand.from_function(g, dims=2)
    expected = CALLS[name](integrand)
    made = g.calls
    for (key, values), others in zip(
        _numbers(found).items(), _numbers(expected).values(), strict=True
    ):
        np.testing.assert_array_equal(values, others, err_msg=key)
    # Profile and integrate call a function through their own budget, without a test before
    own = f.calls if name in ("profile", "integrate") else f.calls - PROBE
    assert own == made - PROBE
    if "evaluations" in getattr(found, "attrs", ()):
        assert found.attrs["evaluations"] == own


@pytest.mark.parametrize("name", CALLS)
def test_a_function_without_dims_is_refused(name):
    f = Counting()
    with pytest.raises(ParameterError, match=r"^dims is missing; give dims=, the number of dims"):
        CALLS[name](f)
    assert f.calls == 0


@pytest.mark.parametrize("name", CALLS)
def test_dims_of_an_estimator_must_agree(name):
    estimator = mcs.Estimator("gaussian", "linear", dims=1)
    for given in (estimator, mcs.integrand("gaussian", dims=1)):
        with pytest.raises(McspectraError, match=r"1 dim\b"):
            CALLS[name](given, dims=2)


@pytest.mark.parametrize("name", CALLS)
def test_specs_take_dims(name):
    spec = "gaussian(width=0.3)"
    found = _numbers(CALLS[name](spec, dims=1))
    for key, values in _numbers(CALLS[name](mcs.integrand(spec, dims=1))).items():
        np.testing.assert_array_equal(found[key], values, err_msg=key)


def test_all_functions_of_an_estimator_take_dims():
    packages = (mcs, mcs.measure, mcs.prediction, mcs.explain, mcs.improve, mcs.profiler)
    functions = {n: getattr(p, n) for p in packages for n in p.__all__ if n.islower()}
    for name, function in functions.items():
        parameters = inspect.signature(function).parameters if callable(function) else {}
        if "estimator" in parameters:
            assert "dims" in parameters, name


def test_a_sampler_gives_the_dims_of_a_function():
    sampler = mcs.sampler("random", dims=2)
    found = mcs.convergence(Counting(), sampler, [4], realizations=20)
    expected = mcs.convergence(Counting(), "random", [4], realizations=20, dims=2)
    assert found["variance"].equals(expected["variance"])
    assert mcs.profile(Counting(), sampler=sampler, budget=256).subject == "function(Counting)"
    with pytest.raises(ParameterError, match="is for 2 dims, but 3 dims are needed"):
        mcs.convergence(lambda x: x[..., 0], sampler, [4], dims=3)


def test_lists_may_hold_functions():
    found = mcs.convergence([Counting(), "gaussian"], "random", [4], realizations=20, dims=2)
    assert found["estimator"].values.tolist() == ["function(Counting)", "gaussian"]


@pytest.mark.parametrize(
    ("given", "dims", "message"),
    [
        (mcs.integrands.Gaussian, 2, "Gaussian is a class; give an instance of it"),
        (lambda x: x[..., 0, None, None], 2, "gave shape .* it must give"),
        (lambda x: x[:, 0], 2, r"use x\[..., 0\] for the first coordinate"),
        (lambda x: x[..., 0], 0, "dims is 0"),
        (lambda x: x[..., 0], 10**6, "dims is 1000000"),
        (3, 2, "3 is not an estimator; give .* a function with dims="),
    ],
)
def test_invalid_functions_are_refused(given, dims, message):
    with pytest.raises(ParameterError, match=message):
        mcs.convergence(given, "random", [4, 16], dims=dims)
