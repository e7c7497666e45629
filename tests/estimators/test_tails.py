"""The share of ∫f²/p that no sample reaches: closed forms, and notes that report it."""

import math

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.estimators.moments import Moments
from mcspectra.estimators.tails import tail_note, unsampled_note, unsampled_share

POINTS = 2**12  # Least number of probe points


@pytest.mark.parametrize("exponent", [0.3, 0.5, 0.7])
@pytest.mark.parametrize("samples", [10, 100, 2000])
def test_the_share_of_a_power(exponent, samples):
    """For p = (a + 1) x^a, the mass 1/N lies below N^(-1/(a+1)), with the share x^(1-a) of ∫1/p."""
    estimator = mcs.Estimator("constant", f"power(exponent={exponent})", dims=1)
    border = samples ** (-1 / (exponent + 1))
    # A mean over points of spacing 1/N has the error of the cell next to the pole, its own integral
    error = 2 * POINTS ** (exponent - 1) + 4 / (POINTS * border)
    assert unsampled_share(estimator, samples) == pytest.approx(border ** (1 - exponent), abs=error)


def test_a_density_that_fits_has_no_tail():
    estimator = mcs.Estimator("polynomial(coefficients=[0, 0, 1])", "linear(slope=2)", dims=1)
    # f²/p = x³/2, so the share below N^(-1/2) is N^-2
    assert unsampled_share(estimator, 100) == pytest.approx(1e-4, rel=1e-2)
    assert unsampled_note(estimator, 100) is None


@pytest.mark.parametrize("sigma", [0.02, 0.04])
def test_variances_out_of_reach_are_noted(sigma):
    estimator = mcs.Estimator("gaussian", f"truncated-normal(sigma={sigma})", dims=1)
    assert unsampled_share(estimator, 16 * 50) == pytest.approx(1, abs=1e-6)
    note = unsampled_note(estimator, 800)
    assert note is not None
    assert "100 % of ∫f²/p" in note
    assert "800 samples" in note


def test_others_have_no_share():
    assert unsampled_share(mcs.Estimator("gaussian", dims=2), 10) == 0
    mis = mcs.MultipleImportance("gaussian", ["uniform", "tent"], dims=1)
    assert unsampled_share(mis, 10) == 0
    zero = mcs.Integrand.from_function(lambda x: 0 * x[..., 0], dims=1, integral=0.0)
    assert unsampled_share(mcs.Estimator(zero, "tent"), 10) == 0


def test_the_worst_channel_counts():
    f = mcs.Integrand.from_function(
        lambda x: np.stack([x[..., 0], np.ones(x.shape[:-1])], axis=-1), dims=1
    )
    worst = mcs.Estimator("constant", "power(exponent=0.5)", dims=1)
    assert unsampled_share(mcs.Estimator(f, "power(exponent=0.5)"), 100) == pytest.approx(
        unsampled_share(worst, 100), rel=1e-12
    )


def test_results_carry_the_note():
    bad = mcs.Estimator("gaussian", "truncated-normal(sigma=0.02)", dims=1)
    good = mcs.Estimator("gaussian", "truncated-normal(sigma=0.3)", dims=1)
    terms = [
        mcs.variance_terms(e, "random", 16, half_width=4, realizations=50) for e in (bad, good)
    ]
    assert "100 % of ∫f²/p" in terms[0].attrs["note"]
    assert "note" not in terms[1].attrs
    curves = mcs.convergence([bad, good], "random", [8, 16], realizations=50)
    assert curves.attrs["note"].startswith(f"{bad.spec}: 100 % of ∫f²/p")
    assert good.spec not in curves.attrs["note"]
    assert math.isfinite(float(curves["variance"][0, 0]))


def test_tails_that_are_not_resolved_are_said():
    values = np.random.default_rng(1).standard_t(1.2, (1000, 2))
    assert "tail index k̂ = " in tail_note(Moments.of(values, tails=True))
    one = np.zeros(20)
    one[3] = 1.0
    assert tail_note(Moments.of(one)).startswith("tails not resolved (one or a few of 20 estimates")
    assert tail_note(Moments.of(values[:, 0] > 0, tails=True)) is None
