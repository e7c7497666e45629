"""Homogenisation and the alignment of strata change the rate (Ramamoorthi et al. 2012; the slides)."""

import numpy as np
import pytest

import mcspectra as mcs

COUNTS = (64, 256, 1024, 4096)


def _exact_rate(f, sampler, counts):
    variances = [mcs.exact_variance(f, sampler, n) for n in counts]
    return float(np.log(variances[-1] / variances[-2]) / np.log(counts[-1] / counts[-2]))


@pytest.mark.parametrize(
    ("sampler", "rate"),
    [
        ("jittered", -3.0),
        ("jittered | shift", -2.0),
        ("jittered | strata-shift(offset=0.5)", -2.0),
        ("regular | shift", -2.0),
        ("sobol | owen", -3.0),
        ("sobol | digital-shift", -2.0),
        ("random", -1.0),
    ],
)
def test_a_ramp_in_1d(sampler, rate):
    """One stratum across the seam of the torus, where f(1) ≠ f(0), has variance ¼: 1/(4n²) of the sum."""
    f = mcs.integrand("linear", dims=1)
    found = _exact_rate(f, mcs.sampler(sampler, dims=1), (256, 1024))
    assert found == pytest.approx(rate, abs=0.01)  # lower-order terms: 1/(2n) of the variance


@pytest.mark.parametrize(
    ("sampler", "rate"),
    [
        ("jittered", -2.0),
        ("jittered | strata-shift(offset=[0.5, 0])", -1.5),
        ("jittered | shift", -1.5),
    ],
)
def test_an_edge_on_the_borders_of_strata(sampler, rate):
    """A smooth function cut off at x = ½: strata that end there do not see the jump, moved ones do.

    Terms of lower order: n^-1/2 of the variance, 4 % at n = 625, in the rate of the last two counts.
    """
    cut = mcs.Integrand.from_function(
        lambda x: np.where(x[..., 0] < 0.5, np.exp(-(x**2).sum(axis=-1)), 0.0), dims=2
    )
    curve = mcs.convergence(cut, sampler, COUNTS, realizations=1500, rng=6)
    low, high = curve["rate_ci"].values
    middle, half = (low + high) / 2, (high - low) / 2
    assert abs(middle - rate) < 2 * half + 0.04


def test_edges_off_the_borders_have_the_slow_rate_whatever_the_offset():
    for offset in (0.0, 0.5):
        sampler = f"jittered | strata-shift(offset={offset})" if offset else "jittered"
        curve = mcs.convergence(
            "disk(center=[0.463, 0.517], radius=0.27)", sampler, COUNTS, realizations=1500, rng=6
        )
        low, high = curve["rate_ci"].values
        assert low - 0.05 < -1.5 < high + 0.05


def test_homogenization_costs_what_the_seam_has():
    """Periodic f: a shift leaves the rate; f = x: it takes it from −3 to −2 and the variance times 2n."""
    wave = mcs.integrand("cosine(frequency=1)", dims=1)
    for sampler in ("jittered", "jittered | shift"):
        assert _exact_rate(wave, sampler, (256, 1024)) == pytest.approx(-3.0, abs=0.01)
    ramp, n = mcs.integrand("linear", dims=1), 64
    ratio = mcs.exact_variance(ramp, "jittered | shift", n) / mcs.exact_variance(
        ramp, "jittered", n
    )
    assert ratio == pytest.approx(2 * n - 1, rel=1e-6)


@pytest.mark.parametrize(
    ("sampler", "decay"),
    [("jittered | shift", "jump"), ("poisson-disk", "jump"), ("jittered | shift", "smooth")],
)
def test_from_the_exponent_to_the_rate(sampler, decay):
    """b of the spectrum and γ of the integrand predict the rate that is measured.

    min(b, γ − d)/d with b fitted in a window: jittered 1.8 to 2 of 2, which counts for smooth f only.
    """
    f = "cosine(frequency=[2, 1])" if decay == "smooth" else "christensen-gaussian"
    spectrum = mcs.power_spectrum(sampler, 1024, half_width=16, realizations=200, rng=2)
    b = float(mcs.low_frequency_exponent(spectrum, up_to=8)["low_frequency_exponent"])
    counts = [256, 1024] if sampler == "poisson-disk" else [256, 1024, 4096]
    curve = mcs.convergence(f, sampler, counts, realizations=400, rng=4)
    low, high = curve["rate_ci"].values
    predicted = mcs.predicted_rate(max(b, 0.0), decay, 2)
    assert low - 0.1 < predicted < high + 0.1
