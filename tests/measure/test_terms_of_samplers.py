"""Terms of several samplers at once equal the terms of each sampler alone."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import InfiniteWeightVarianceWarning, McspectraError, ParameterError
from mcspectra.measure.terms import Terms
from mcspectra.testing import check_analysis

SAMPLERS = ["jittered", "random", "sobol | owen"]
OPTIONS = {"half_width": 4, "realizations": 50, "rng": 3}


def _same(several, alone, sampler):
    row = several.sel(sampler=sampler)
    assert set(row.data_vars) == set(alone.data_vars)
    for name, values in alone.variables.items():
        if values.dtype.kind in "iufc":
            assert row[name].dims == values.dims
            np.testing.assert_array_equal(row[name].values, values.values, err_msg=name)


@pytest.mark.parametrize(
    ("estimator", "more"),
    [
        (mcs.Estimator("gaussian", dims=2), {"bands": "anova"}),
        (mcs.Estimator("gaussian", "linear(slope=0.5)", dims=1), {"cross_matrix": True}),
        (
            mcs.MultipleImportance("gaussian", ["uniform", "linear(slope=0.5)"], dims=1),
            {"space": "primary", "cross_matrix": True},
        ),
        (
            mcs.Integrand.from_function(
                lambda x: np.stack([x[..., 0], x[..., 0] ** 2], -1), dims=1
            ),
            {"basis": "cosine"},
        ),
    ],
)
def test_results_of_each_sampler_equal_its_results_alone(estimator, more):
    found = mcs.variance_terms(estimator, SAMPLERS, 16, **OPTIONS, **more)
    assert found["predicted_variance"].dims[0] == "sampler"
    assert found["sampler"].values.tolist() == SAMPLERS
    assert "sampler" not in found.attrs
    for sampler in SAMPLERS:
        alone = mcs.variance_terms(estimator, sampler, 16, **OPTIONS, **more)
        assert "sampler" not in alone.dims
        assert alone.attrs["sampler"] == sampler
        _same(found, alone, sampler)
    one = mcs.variance_terms(estimator, SAMPLERS[:1], 16, **OPTIONS, **more)
    assert one["sampler"].values.tolist() == SAMPLERS[:1]


def test_evaluations_are_the_sum_over_samplers():
    f = mcs.Integrand.from_function(lambda x: np.exp(x[..., 0]), dims=1)
    alone = mcs.variance_terms(f, "random", 16, **OPTIONS).attrs["evaluations"]
    both = mcs.variance_terms(f, SAMPLERS[:2], 16, **OPTIONS).attrs["evaluations"]
    # The coefficients are cached by now. Both calls count the energy of f once, and 50 · 16 points
    # per sampler
    assert 2 * 50 * 16 <= both < 2 * alone
    most = 2 * 50 * 16 - 1
    with pytest.raises(McspectraError, match="takes at least 1600 evaluations"):
        mcs.variance_terms(f, SAMPLERS[:2], 16, **OPTIONS, max_evaluations=most)


def test_a_fixed_set_can_be_listed_with_a_random_sampler():
    found = mcs.variance_terms("gaussian", ["random", "sobol"], 16, **OPTIONS)
    assert float(found["measured_variance"].sel(sampler="sobol")) == 0.0
    assert float(found["measured_variance"].sel(sampler="random")) > 0.0
    assert found.attrs["note"] == "sobol has no variance: add owen or shift, or compare |bias|"


def test_infinite_weights_give_one_warning():
    estimator = mcs.Estimator("linear", "linear(slope=2)", dims=1)
    with pytest.warns(InfiniteWeightVarianceWarning) as warned:
        found = mcs.variance_terms(estimator, SAMPLERS[:2], 16, **OPTIONS)
    assert len(warned) == 1
    assert np.isinf(found["power_term"]).all()
    assert np.isfinite(found["measured_variance"]).all()
    assert found.attrs["note"].count("∫1/p diverges") == 1


def test_invalid_lists_are_refused():
    for samplers, message in (
        (["random", "random"], "random is listed twice"),
        ([], "A list is empty"),
    ):
        with pytest.raises(ParameterError, match=message):
            mcs.variance_terms("gaussian", samplers, 16, **OPTIONS)
    with pytest.raises(ParameterError, match="variance_terms takes one estimator at a time"):
        mcs.variance_terms(["gaussian", "disk"], "random", 16, **OPTIONS)
    with pytest.raises(ParameterError, match="basis is 'auto', which is cosine for random, walsh"):
        mcs.variance_terms("gaussian", ["random", "sobol | owen"], 16, basis="auto", **OPTIONS)
    found = mcs.variance_terms("gaussian", ["random", "jittered"], 16, basis="auto", **OPTIONS)
    assert found.attrs["basis"] == "cosine"


def test_the_contract_holds_for_a_list():
    check_analysis(Terms(n=4, half_width=2, realizations=40), sampler=["random", "jittered"])
