"""Fits of rates: intervals cover the rate, bends are detected and excluded."""

import numpy as np
import pytest
from scipy import stats

from mcspectra.core.errors import ParameterError
from mcspectra.core.fits import CURVATURE, LACK_OF_FIT, check_window, fit_rate
from mcspectra.core.options import checked
from mcspectra.estimators import as_subject
from mcspectra.measure.converge import Convergence

NS = np.array([4, 16, 64, 256, 1024, 4096])
SE = np.array([0.05, 0.1, 0.05, 0.2, 0.05, 0.05])
NONE = np.zeros(6)


def _fits(window, expected, trials=1000, se=SE):
    rng = np.random.default_rng(6)
    noise = np.exp(se * rng.standard_normal((trials, 6)))
    return [fit_rate(NS, expected * row, se, NONE, window) for row in noise]


def test_interval_covers_the_slope_of_a_line():
    """At least 95 %, because widening for lack of fit only adds; binomial 5 σ below."""
    fits = _fits(None, 3.0 * NS**-1.5)
    covered = np.mean([low <= -1.5 <= high for low, high in (f.interval for f in fits)])
    assert covered > 0.95 - 5 * np.sqrt(0.05 * 0.95 / len(fits))


def test_chi2_of_a_line_is_one_on_average():
    chi2 = np.array([f.chi2 for f in _fits(None, 3.0 * NS**-1.5)])
    assert abs(chi2.mean() - 1.0) < 5 * np.sqrt(2 / 4 / len(chi2))


def test_auto_keeps_straight_lines_whole():
    """Except for the levels of both tests, which reject at least the larger one; binomial 5 σ."""
    fits = _fits("auto", 3.0 * NS**-1.5)
    whole = np.mean([f.first_n == 4 for f in fits])
    low, high = 1 - LACK_OF_FIT - CURVATURE, 1 - max(LACK_OF_FIT, CURVATURE)
    assert low - 5 * np.sqrt(low * (1 - low) / 1000) < whole
    assert whole < high + 5 * np.sqrt(high * (1 - high) / 1000)
    assert _coverage(fits, -1.5) > 0.95 - 5 * np.sqrt(0.05 * 0.95 / 1000)


def _coverage(fits, rate):
    return np.mean([low <= rate <= high for low, high in (f.interval for f in fits)])


BENT = {
    # exact variances at n = 4, 16, … 1024; normal intervals cover 0.78 and 0.70
    "disk(center=[0.463, 0.517], radius=0.27), jittered": (
        [-1.908, -1.287, -1.447, -1.542],
        0.93,
    ),
    "christensen-gaussian, jittered | shift": ([-1.424, -1.478, -1.493, -1.498], 0.82),
}
"""Local slopes of exact variances, and the least coverage required of the intervals of "auto"."""


@pytest.mark.parametrize("name", BENT)
def test_auto_covers_the_asymptotic_rate_of_bent_curves(name):
    """Rate −1.5, errors of 500 realizations (6 %); binomial with 500 trials, 2.5 σ below."""
    slopes, least = BENT[name]
    ns = NS[:5]
    exact = np.exp(np.cumsum([0.0, *np.array(slopes) * np.diff(np.log(ns))]))
    se = np.full(5, np.sqrt(2 / 500))
    noise = np.exp(se * np.random.default_rng(1).standard_normal((500, 5)))
    fits = [fit_rate(ns, exact * row, se, np.zeros(5), "auto") for row in noise]
    assert _coverage(fits, -1.5) > least


def test_scatter_about_the_line_has_students_interval():
    """For equal errors, the interval of scipy.stats.linregress uses the scatter alone."""
    y = np.array([0.0, -1.2, -1.7, -3.3])
    ns, se = NS[:4], np.full(4, 0.01)
    fit = fit_rate(ns, np.exp(y), se, np.zeros(4))
    expected = stats.linregress(np.log(ns), y)
    half = stats.t.ppf(0.975, 2) * expected.stderr
    np.testing.assert_allclose(fit.interval, [expected.slope - half, expected.slope + half])
    loose = fit_rate(ns, np.exp(y), np.full(4, 10.0), np.zeros(4))  # errors far above the scatter
    spread = 10.0 / np.sqrt(((np.log(ns) - np.log(ns).mean()) ** 2).sum())
    assert loose.interval[1] - loose.rate == pytest.approx(stats.norm.ppf(0.975) * spread)


def test_auto_leaves_out_the_bend():
    """n^-1 + 200 n^-3: within 5 % of −1 above n = 64, 100 σ off below; no bias remains."""
    se = np.full(6, 0.02)
    bent = 1.0 / NS + 200.0 / NS**3
    whole = np.mean([f.rate for f in _fits(None, bent, 200, se)])
    guarded = _fits("auto", bent, 200, se)
    assert whole < -1.3
    assert all(f.first_n in (64, 256) for f in guarded)
    exact = fit_rate(NS, bent, se, NONE, 4).rate
    assert abs(exact + 1.0) < 0.02
    assert abs(np.mean([f.rate for f in guarded]) + 1.0) < abs(exact + 1.0) + 0.005


def test_auto_widens_intervals_that_never_fit():
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
    assert fit_rate(NS, exact, SE, floor, 3).first_n != 256  # one remaining count gives no fit
    assert fit_rate(NS, exact, SE, floor, "auto").rate == pytest.approx(-1.5)


@pytest.mark.parametrize("window", [None, 2, "auto"])
@pytest.mark.parametrize("kept", [0, 1, 2])
def test_few_counts(window, kept):
    floor = np.where(np.arange(2) < kept, 0.0, 10.0)
    fit = fit_rate(NS[:2], NS[:2] ** -1.0, SE[:2], floor, window)
    assert np.isnan(fit.chi2)
    assert (fit.rate == pytest.approx(-1.0)) if kept == 2 else np.isnan(fit.rate)


def test_valid_windows():
    for window in (None, "auto", 3, 5):
        check_window(window, 5)
    whole = fit_rate(NS, NS**-1.5, SE, np.zeros(len(NS)))
    assert fit_rate(NS, NS**-1.5, SE, np.zeros(len(NS)), len(NS)) == whole


@pytest.mark.parametrize("window", [0, 1, 6, 2.5, True, "all", [3], float("nan")])
def test_invalid_windows_raise(window):
    analysis = Convergence(counts=(4, 16, 64, 256, 1024), fit_last=window)
    with pytest.raises(ParameterError, match="fit_last"):
        checked(analysis).need(as_subject("gaussian", "jittered"))
