"""Default half widths, and the estimated variance at higher frequencies."""

import math

import numpy as np
import pytest

import mcspectra as mcs


@pytest.mark.parametrize(
    ("integrand", "dims", "n", "width"),
    [
        ("gaussian", 1, 16, 64),
        ("disk", 1, 256, 512),  # twice the 256 strata
        ("disk", 2, 64, 64),
        ("disk", 2, 4096, 128),
        ("cosine(frequency=3)", 2, 64, 4),  # the integrand has no other frequencies
        ("polynomial", 3, 64, 16),
        ("polynomial", 4, 64, 8),  # 64 would be 2.8e8 frequencies
        ("polynomial", 8, 64, 1),
    ],
)
def test_half_widths_follow_dims_counts_and_integrand(integrand, dims, n, width):
    f = mcs.integrand(integrand, dims=dims)
    found = mcs.variance_terms(f, "random", n, realizations=2)
    assert found["half_width"].values[-1] == width


def test_energy_share_and_tail_of_the_disk_are_exact():
    f = mcs.integrand("disk(radius=0.3)", dims=2)
    found = mcs.variance_terms(f, "random", 16, half_width=5, realizations=2)
    held, whole = (np.abs(f.fourier_grid(5)) ** 2).sum(), math.pi * 0.3**2
    assert float(found["energy_share"]) == pytest.approx(held / whole, rel=1e-12)
    assert float(found["tail_term"]) == pytest.approx((whole - held) / 16, rel=1e-12)


@pytest.mark.parametrize(
    ("space", "f", "half_width"),
    [
        ("domain", "disk(radius=0.3)", 6),
        # A jump between opposite faces has a long tail, too, and its quadrature converges quickly
        ("primary", "linear", 2),
        pytest.param("primary", "disk(radius=0.3)", 6, marks=pytest.mark.slow),
    ],
)
def test_a_short_spectrum_plus_its_tail_predicts_random_points(space, f, half_width):
    f = mcs.integrand(f, dims=2)
    p = mcs.density("linear(slope=1)", dims=2)
    estimator = mcs.MultipleImportance(f, [p, "uniform"])
    found = mcs.variance_terms(
        estimator, "random", 16, half_width=half_width, realizations=2000, space=space
    )
    both = float(found["predicted_variance"] + found["tail_term"])
    # The three terms of a truncated sum have the same error as the measured variance
    low, high = found["measured_variance_ci"].values
    assert low < both < high
    assert float(found["tail_term"]) > 2 * (high - low) / 4  # without the tail, the test would fail
