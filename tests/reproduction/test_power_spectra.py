"""Power spectra: findings, the error of the speckle's strength, and what would contradict them."""

import numpy as np
import pytest
import xarray as xr

from mcspectra.reproduction import power_spectra
from mcspectra.reproduction.claims import judge


def test_the_ring_of_the_closed_form_is_a_mean_over_its_frequencies():
    # |m| ≈ 1: (±1, 0), (0, ±1) and (±1, ±1), 16 strata a side
    axis, both = 1 - np.sinc(1 / 16) ** 2, 1 - np.sinc(1 / 16) ** 4
    assert power_spectra.closed_ring(1) == pytest.approx((axis + both) / 2, rel=1e-9)


@pytest.mark.parametrize("realizations", [1, 4])
def test_the_error_of_the_speckle(realizations):
    """Means of exponential variables have the coefficient of variation 1/√R, with that error."""
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
    assert values.std(ddof=1) == pytest.approx(half / 1.96, rel=4 * 0.05)
    assert np.mean([bool(f.agrees) for f in found]) == 1.0


def test_other_expectations_disagree():
    spectra = power_spectra.measured_spectra(100, 2)
    assert judge(power_spectra._exponent("jittered", spectra["jittered"], 1.0)).agrees is False
    assert judge(power_spectra._exponent("random", spectra["poisson-disk"], 1.0)).agrees is False
    assert judge(power_spectra._ring_level("random", spectra["jittered"], 1, 1.0)).agrees is False
    assert judge(power_spectra._below_random(spectra["random"])).agrees is False
    assert judge(power_spectra._peak(spectra["jittered"])).agrees is False
