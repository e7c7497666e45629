"""Fits of rates: intervals cover, bends are found and left out."""

import numpy as np
import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.variance.fit import LACK_OF_FIT, check_window, fit_rate

NS = np.array([4, 16, 64, 256, 1024, 4096])
SE = np.array([0.05, 0.1, 0.05, 0.2, 0.05, 0.05])
NONE = np.zeros(6)


def _fits(window, expected, trials=1000, se=SE):
    rng = np.random.default_rng(6)
    noise = np.exp(se * rng.standard_normal((trials, 6)))
    return [fit_rate(NS, expected * row, se, NONE, window) for row in noise]


def test_interval_covers_the_slope_of_a_line():
    """At least 95 % (widening for lack of fit only adds); binomial 5 σ below."""
    fits = _fits(None, 3.0 * NS**-1.5)
    covered = np.mean([low <= -1.5 <= high for low, high in (f.interval for f in fits)])
    assert covered > 0.95 - 5 * np.sqrt(0.05 * 0.95 / len(fits))


def test_chi2_of_a_line_is_one_on_average():
    chi2 = np.array([f.chi2 for f in _fits(None, 3.0 * NS**-1.5)])
    assert abs(chi2.mean() - 1.0) < 5 * np.sqrt(2 / 4 / len(chi2))


def test_auto_keeps_straight_lines_whole():
    """All but the level of the test: binomial 5 σ."""
    whole = np.mean([f.first_n == 4 for f in _fits("auto", 3.0 * NS**-1.5)])
    spread = 5 * np.sqrt(LACK_OF_FIT * (1 - LACK_OF_FIT) / 1000)
    assert abs(whole - (1 - LACK_OF_FIT)) < spread


def test_auto_leaves_out_the_bend():
    """n^-1 + 200 n^-3: −1 beyond n = 64 to 5 %, 100 σ off below. The guard removes the bias."""
    se = np.full(6, 0.02)
    bent = 1.0 / NS + 200.0 / NS**3
    whole = np.mean([f.rate for f in _fits(None, bent, 200, se)])
    guarded = _fits("auto", bent, 200, se)
    assert whole < -1.3
    assert all(f.first_n in (64, 256) for f in guarded)
    exact = fit_rate(NS, bent, se, NONE, 4).rate
    assert abs(exact + 1.0) < 0.02
    assert abs(np.mean([f.rate for f in guarded]) + 1.0) < abs(exact + 1.0) + 0.005


def test_auto_widens_what_never_fits():
    zigzag = NS**-1.0 * np.array([1, 3, 1, 3, 1, 3])
    fit = fit_rate(NS, zigzag, np.full(6, 0.01), NONE, "auto")
    assert fit.first_n == 256
    assert fit.chi2 > 100
    assert fit.interval[0] < -1 < fit.interval[1]


def test_window_counts_from_the_end_and_noise_is_left_out():
    exact = 3.0 * NS**-1.5
    fit = fit_rate(NS, exact, SE, NONE, 3)
    assert (fit.first_n, fit.rate) == (256, pytest.approx(-1.5))
    floor = np.where(NS >= 1024, 1.0, 0.0)
    assert fit_rate(NS, exact, SE, floor, 3).first_n != 256  # one is left: none
    assert fit_rate(NS, exact, SE, floor, "auto").rate == pytest.approx(-1.5)


@pytest.mark.parametrize("window", [None, 2, "auto"])
@pytest.mark.parametrize("kept", [0, 1, 2])
def test_few_counts(window, kept):
    floor = np.where(np.arange(2) < kept, 0.0, 10.0)
    fit = fit_rate(NS[:2], NS[:2] ** -1.0, SE[:2], floor, window)
    assert np.isnan(fit.chi2)
    assert (fit.rate == pytest.approx(-1.0)) if kept == 2 else np.isnan(fit.rate)


def test_windows_that_are_taken():
    assert check_window(None, 5) == 5
    assert check_window("auto", 5) == "auto"
    assert check_window(3, 5) == 3


@pytest.mark.parametrize("window", [0, 1, 6, 2.5, True, "all", [3], float("nan")])
def test_windows_that_are_refused(window):
    with pytest.raises(ParameterError, match="fit_last"):
        check_window(window, 5)
