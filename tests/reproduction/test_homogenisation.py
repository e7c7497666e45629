"""Homogenization: findings, and wrong inputs that must disagree."""

from __future__ import annotations

import numpy as np
import pytest
from tests.reproduction.conftest import Disagreeing

from mcspectra.reproduction import homogenisation
from mcspectra.reproduction.homogenisation import PAIRS, Coefficients, before_and_after, grid_mean
from mcspectra.spectra.closed_forms import closed_form_covariance


def test_swapped_points_before_and_after_the_shift_disagree(disagreeing: Disagreeing) -> None:
    right = before_and_after
    swapped = lambda name, _, seed: right(name, 2000, seed)[::-1]
    assert disagreeing(homogenisation, before_and_after=swapped)[:2] == [3, 4]


def test_a_grid_that_is_not_shifted_has_a_mean() -> None:
    assert abs(grid_mean("regular", 10, 1).value) == pytest.approx(1.0)


def test_covariances_agree_with_the_closed_form() -> None:
    before, _ = before_and_after("jittered", 4000, 2)
    m, l = np.array(PAIRS)[:, 0], np.array(PAIRS)[:, 1]
    expected = closed_form_covariance("jittered", 64, m, l)
    # The products have standard deviation 1/64 and their mean 1/64/√4000; allow five of these
    assert np.abs(before.covariance - expected).max() < 5 / 64 / 4000**0.5


def test_the_limit_holds_simultaneously_for_parts_and_findings() -> None:
    """Uncorrelated normal coefficients exceed the limit once in 1950 times."""
    rng = np.random.default_rng(3)
    beyond = 0
    for _ in range(1000):
        parts = rng.standard_normal((2, 400, len(PAIRS), 2))
        distance, limit = Coefficients(parts[0] + 1j * parts[1]).farthest()
        beyond += distance > limit
    assert beyond <= 5  # Poisson with mean 0.5: six or more occur once in 70 000 times
