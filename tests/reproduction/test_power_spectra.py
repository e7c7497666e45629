"""Power spectra: findings, standard error of the speckle, and wrong inputs that must disagree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from tests.reproduction.conftest import Disagreeing

from mcspectra.reproduction import power_spectra
from mcspectra.reproduction.claims import VERDICT_WIDENING, judge


def test_the_ring_of_the_closed_form_is_a_mean_over_its_frequencies() -> None:
    # |m| ≈ 1: (±1, 0), (0, ±1) and (±1, ±1), with 16 strata per side
    axis, both = 1 - np.sinc(1 / 16) ** 2, 1 - np.sinc(1 / 16) ** 4
    assert power_spectra.closed_ring(1) == pytest.approx((axis + both) / 2, rel=1e-9)


@pytest.mark.parametrize("realizations", [1, 4])
def test_the_error_of_the_speckle(realizations: int) -> None:
    """Means of exponential variables have the coefficient of variation 1/√R."""
    rng = np.random.default_rng(5)
    side, trials = 97, 200
    found = []
    for _ in range(trials):
        power = rng.exponential(size=(realizations, side, side)).mean(axis=0)
        data = xr.Dataset({"power": (("a", "b"), power)})
        found.append(judge(power_spectra._speckle("x", data, realizations)))
    values = np.array([f.measured for f in found], dtype=float)
    half = np.mean([(f.interval or (0, 0))[1] - (f.interval or (0, 0))[0] for f in found]) / 2
    # The standard deviation of 200 values has a relative error of 1/√400 = 5 %
    error = half / (1.96 * VERDICT_WIDENING)
    assert values.std(ddof=1) == pytest.approx(error, rel=4 * 0.05)
    assert np.mean([bool(f.agrees) for f in found]) == 1.0


def test_wrong_expectations_disagree(disagreeing: Disagreeing) -> None:
    right = power_spectra.measured_spectra

    def wrong(realizations: int, seed: int) -> Any:
        found = right(min(realizations, 100), seed)
        jittered = dict.fromkeys(("random", "poisson-disk"), found["jittered"])
        return found | jittered | {"jittered": found["random"]}

    found = disagreeing(power_spectra, measured_spectra=wrong)
    assert {2, 3, 5, 6, 7, 8} <= set(
        found
    )  # finding 4 (high frequencies) also agrees for random points
