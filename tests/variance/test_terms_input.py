"""What variance_terms refuses, and how it labels what it returns."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import ParameterError

GAUSSIAN = mcs.Estimator("gaussian", dims=2)


def test_technique_sums_have_no_domain():
    estimator = mcs.TechniqueSum(["linear", "step(at=0.3)"], dims=1)
    with pytest.raises(ParameterError, match="space='primary'"):
        mcs.variance_terms(estimator, "jittered", 16, space="domain")
    found = mcs.variance_terms(estimator, "jittered", 16, half_width=2, realizations=4)
    assert found.attrs["space"] == "primary"


def test_own_bands_partition_the_variance():
    labels = np.zeros((9, 9), int)
    labels[:, 4] = 1  # frequencies with m1 = 0: the part of f that varies along x0 alone
    labels[4, :] = 2
    d = mcs.variance_terms(GAUSSIAN, "jittered", 16, half_width=4, realizations=64, bands=labels)
    assert d["band_covariance"].shape == (3, 3)
    assert float(d["band_covariance"].sum()) == pytest.approx(float(d["predicted_variance"]))


def test_variables_carry_units_and_meaning():
    d = mcs.variance_terms(GAUSSIAN, "jittered", 16, half_width=4, realizations=8, rng=9)
    for name, variable in d.data_vars.items():
        assert variable.attrs["long_name"], name
        assert variable.attrs["units"], name
    assert d.attrs["seed"] == 9
    assert d.attrs["estimator"].startswith("gaussian")
    assert d.attrs["coefficients"] == "exact"
