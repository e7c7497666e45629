"""Kronecker points: the multiples exactly, three gaps, the golden numbers, discrepancy, a rate."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import qmc

import mcspectra as mcs
from mcspectra.core.errors import ParameterError
from mcspectra.samplers import Kronecker
from mcspectra.samplers.lattice import golden_steps


@pytest.mark.parametrize("dims", [1, 2, 3, 10, 100])
def test_steps_are_the_powers_of_the_golden_ratio_of_their_dims(dims):
    """x = 1/phi solves x^(d+1) + x^d = 1 between x ± 2^-64, in whole numbers."""
    steps = [Fraction(int(s), 2**64) for s in golden_steps(dims)]
    below, above = steps[0], steps[0] + Fraction(1, 2**64)
    assert below ** (dims + 1) + below**dims <= 1 < above ** (dims + 1) + above**dims
    for j, step in enumerate(steps, start=1):
        assert below**j - Fraction(1, 2**64) < step < above**j


def test_golden_steps_of_one_dim_are_those_of_fibonacci_hashing():
    assert int(golden_steps(1)[0]) == 0x9E3779B97F4A7C15  # floor(2^64/phi)


def test_points_are_the_multiples_to_the_last_bit():
    alpha = [2**0.5, -(3**0.5), 1e-3]
    points = Kronecker(dims=3, alpha=alpha).draw(1000)[0]
    for j, a in enumerate(alpha):
        step = round(Fraction(a) % 1 * 2**64)
        expected = [(k * step % 2**64 >> 11) / 2**53 for k in range(1000)]
        np.testing.assert_array_equal(points[:, j], expected)


def test_differences_hang_on_those_of_the_indices():
    points = Kronecker(dims=3).draw(2000)[0]
    for lag in (1, 7, 500):
        difference = (points[lag:] - points[:-lag]) % 1.0
        np.testing.assert_allclose(difference, difference[:1] + 0 * difference, atol=2.0**-52)


@pytest.mark.parametrize("alpha", [None, [0.41421356237309503], [0.1234567]])
@pytest.mark.parametrize("n", [2, 10, 100, 1000])
def test_three_gaps(alpha, n):
    """Steinhaus: n multiples cut the circle into gaps of at most three lengths."""
    x = np.sort(Kronecker(dims=1, alpha=alpha).draw(n)[0, :, 0] * 2.0**53).astype(np.int64)
    gaps = np.sort(np.diff(x, append=x[0] + 2**53))
    assert 1 + np.count_nonzero(np.diff(gaps) > 2) <= 3


@pytest.mark.parametrize("n", [13, 100, 1000])
def test_golden_points_are_evenly_spaced(n):
    """The gaps of the golden ratio differ by a factor phi² at most: none below 1/(phi² n)."""
    x = np.sort(Kronecker(dims=1).draw(n)[0, :, 0])
    phi = (1 + 5**0.5) / 2
    assert np.diff(x, append=x[0] + 1).min() > 1 / (phi**2 * n)


@pytest.mark.parametrize("dims", [2, 3, 5])
def test_discrepancy_is_far_below_that_of_random_points(dims):
    """The expected squared centred L2 discrepancy of n random points is ((5/4)^d − (13/12)^d)/n."""
    n = 512
    squared = qmc.discrepancy(Kronecker(dims=dims).draw(n)[0], method="CD")
    assert squared < 0.2 * (1.25**dims - (13 / 12) ** dims) / n


def test_rate_on_the_disk():
    """n^-1.5 as for lattices (badly approximable α), but its constant wobbles with log n.

    A factor 2 from one end to the other tilts the fit by log 2 / log(n_last/n_first).
    """
    f = mcs.Estimator("disk(center=[0.463, 0.517], radius=0.27)", dims=2)
    counts = [16, 64, 256, 1024, 4096]
    d = mcs.convergence(f, "kronecker | shift", counts, realizations=400, rng=2)
    low, high = d["rate_ci"].values
    assert abs(float(d["rate"]) + 1.5) < 2 * (high - low) / 1.96 + np.log(2) / np.log(256)


@pytest.mark.parametrize(
    ("alpha", "words"),
    [
        ([0.3], "1 values"),
        ([0.3, 0.2, 0.1], "3 values"),
        ([], "0 values"),
        (0.3, "one for each dim"),
        ("0.3", "one for each dim"),
        ([0.3, "x"], r"alpha\[1\]"),
        ([0.3, float("nan")], r"alpha\[1\]"),
        ([0.3, float("inf")], r"alpha\[1\]"),
        ([0.3, True], r"alpha\[1\]"),
        ([0.3, 2.0], "whole number"),
        ([0, 0.3], "whole number"),
    ],
)
def test_bad_alpha(alpha, words):
    with pytest.raises(ParameterError, match=words):
        Kronecker(dims=2, alpha=alpha)


def test_one_number_will_do_in_one_dim():
    np.testing.assert_array_equal(
        Kronecker(dims=1, alpha=0.3).draw(9), Kronecker(dims=1, alpha=[0.3]).draw(9)
    )
