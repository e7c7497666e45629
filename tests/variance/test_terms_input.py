"""What variance_terms refuses, and how it labels what it returns."""

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import CountError, ParameterError

GAUSSIAN = mcs.Estimator("gaussian", dims=2)


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"n": 15}, CountError, "9 and 16"),
        ({"n": float("nan")}, ParameterError, "whole number"),
        ({"realizations": 1}, ParameterError, "from 2 to"),
        ({"half_width": -1}, ParameterError, "half_width"),
        ({"basis": "wavelet"}, ParameterError, "fourier, cosine, walsh, haar"),
        ({"space": "fourier"}, ParameterError, "domain, primary"),
        ({"bands": "rings"}, ParameterError, "radial, dyadic, anova, wedge"),
        ({"bands": np.zeros((3, 3), int)}, ParameterError, r"shape \(9, 9\)"),
        ({"bands": np.arange(81).reshape(9, 9)}, ParameterError, "same for m and −m"),
        ({"half_width": 40, "cross_matrix": True}, ParameterError, "GiB"),
        ({"rng": -1}, ParameterError, "rng"),
        ({"rng": "seed"}, ParameterError, "rng"),
        ({"workers": 0}, ParameterError, "workers"),
    ],
)
def test_bad_input(changes, error, words):
    arguments = {"n": 16, "half_width": 4, "realizations": 4, **changes}
    with pytest.raises(error, match=words):
        mcs.variance_terms(GAUSSIAN, "jittered", **arguments)


def test_dims_must_agree():
    with pytest.raises(ParameterError, match="2 dims"):
        mcs.variance_terms(GAUSSIAN, mcs.sampler("jittered", dims=1), 16)


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
