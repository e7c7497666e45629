"""Realizations that are the pixels of one image: a warning if their variance is requested."""

import warnings

import pytest

import mcspectra as mcs
from mcspectra.core.errors import DependentRealizationsWarning


@pytest.mark.parametrize("mask", ["blue-noise", "r2"])
def test_pixels_of_one_image_are_not_independent(mask):
    sampler = mcs.sampler(f"sobol | decorrelate(mask='{mask}', width=8)")
    assert not sampler.independent
    with pytest.warns(DependentRealizationsWarning, match="the pixels of one image"):
        mcs.convergence(mcs.Estimator("gaussian"), sampler, [4, 16], realizations=10)
    with pytest.warns(DependentRealizationsWarning):
        mcs.variance_terms("gaussian", sampler, 4, half_width=2, realizations=10)


@pytest.mark.parametrize("spec", ["sobol | owen", "sobol | decorrelate", "jittered | shift"])
def test_others_are(spec):
    assert mcs.sampler(spec).independent
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mcs.convergence(mcs.Estimator("gaussian"), spec, [4, 16], realizations=10)
