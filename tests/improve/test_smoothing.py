"""Bias and variance of smoothed edges, and the best width for a budget."""

import numpy as np
import pytest

import mcspectra as mcs

DISK = mcs.integrand("disk(center=[0.463, 0.517], radius=0.27)", dims=2)
WITHIN = 4.0


def test_the_measured_variance_of_a_ramp_equals_the_closed_form():
    d = mcs.improve.smoothing_scan(
        "step(at=0.437)", mcs.sampler("jittered", dims=1), 512, [0.125], rng=2
    )
    relative = float(d["variance"].squeeze()) * 12 * 0.125 * 512**3
    assert relative == pytest.approx(1.0, abs=WITHIN * np.sqrt(2 / 1000) + 2 / 64)
    assert d["rate"].isnull().all()


@pytest.fixture(scope="module")
def scan():
    widths = [0, 0.02, 0.1, 0.3]
    return mcs.improve.smoothing_scan(
        DISK, "jittered", [64, 256, 1024], widths, realizations=400, rng=3
    )


def test_rates_change_from_an_edge_to_a_smooth_integrand_with_the_width(scan):
    rates, ci = scan["rate"].values, scan["rate_ci"].values
    half = (ci[:, 1] - ci[:, 0]) / 2
    for i, rate in ((0, -1.5), (3, -2.0)):
        assert abs(rates[i] - rate) < WITHIN / 1.96 * half[i] + 0.06
    assert (np.diff(rates) < 0.05).all()


def test_the_mse_is_variance_plus_squared_bias(scan):
    """For a disk inside the domain, the bias is exactly πδ²/12."""
    width = scan["width"].values
    np.testing.assert_allclose(scan["smoothing_bias"], np.pi * width**2 / 12, atol=1e-12)
    np.testing.assert_allclose(
        scan["mse"], scan["variance"] + scan["smoothing_bias"] ** 2, rtol=1e-12
    )
    low, high = scan["mse_ci"].transpose("bound", "width", "n").values
    assert (low < scan["mse"].values).all()
    assert (scan["mse"].values < high).all()
    assert (scan["bias_squared_ci"][:, 0] <= scan["bias_squared"]).all()


def test_the_measured_bias_equals_the_difference_of_the_integrals():
    g = mcs.smoothed(DISK, 0.3)
    d = mcs.convergence(mcs.Estimator(g), "jittered", [256], realizations=2000, rng=1)
    biased = float(d["mean"][0]) - DISK.integral
    assert abs(biased - np.pi * 0.3**2 / 12) < WITHIN * float(d["mean_se"][0])


def test_the_best_width_has_the_smallest_error_and_shrinks_with_n(scan):
    best = scan["best_width"].values
    np.testing.assert_array_equal(best, scan["width"].values[scan["mse"].argmin("width")])
    assert best[-1] <= best[0]
    assert (scan["best_width_range"][:, 0] <= best).all()
    assert (best <= scan["best_width_range"][:, 1]).all()
    # V(δ) ~ c n^-2/δ and bias² = (πδ²/12)²: the best width exceeds 0.02 and shrinks with n
    assert best[0] > 0.02
    assert best[-1] < 0.3


def test_scans_with_channels_and_a_density_have_the_right_dims():
    rgb = mcs.Integrand.from_function(
        lambda x: np.stack([x[..., 0] < 0.4, x[..., 1] < 0.7], axis=-1).astype(float),
        dims=2,
        integral=[0.4, 0.7],
    )
    d = mcs.improve.smoothing_scan(
        rgb, "jittered", [16, 64], [0, 0.2], density="linear(slope=0.5)", realizations=30
    )
    assert d["variance"].dims == ("width", "n", "channel")
    assert d["smoothing_bias"].dims == ("width", "channel")
    assert d["bias_squared_ci"].dims == ("width", "channel", "bound")
    assert d["best_width"].dims == ("n",)
