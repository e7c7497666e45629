"""Weighted lines: exact lines are found exactly, others as in NumPy, with valid errors."""

import math

import numpy as np
import pytest

from mcspectra.core.fits import line_fit

X = np.array([0.0, 1.0, 2.5, 3.0, 7.0])
SE = np.array([0.1, 0.2, 0.1, 0.4, 0.3])


def test_a_line_is_found_exactly():
    fit = line_fit(X, 2.0 - 1.5 * X, SE**-2.0)
    assert fit.slope == pytest.approx(-1.5, rel=1e-14)
    assert float(fit.at(0.0)) == pytest.approx(2.0, rel=1e-14)
    np.testing.assert_allclose(fit.at(X), 2.0 - 1.5 * X, rtol=1e-13)
    assert fit.chi2 < 1e-25


def test_slope_level_and_error_agree_with_numpy():
    y = np.sin(X)
    fit = line_fit(X, y, SE**-2.0)
    (slope, level), covariance = np.polyfit(X, y, 1, w=1 / SE, cov="unscaled")
    assert fit.slope == pytest.approx(slope, rel=1e-12)
    assert float(fit.at(0.0)) == pytest.approx(level, rel=1e-12)
    assert 1 / fit.spread == pytest.approx(covariance[0, 0], rel=1e-12)
    np.testing.assert_allclose(fit.residuals, y - level - slope * X, atol=1e-14)
    assert fit.chi2 == pytest.approx((((y - level - slope * X) / SE) ** 2).sum() / 3, rel=1e-12)


def test_chi2_is_one_on_average_and_the_error_is_that_of_the_slopes():
    rng = np.random.default_rng(5)
    fits = [line_fit(X, SE * row, SE**-2.0) for row in rng.standard_normal((4000, len(X)))]
    chi2, slopes = np.array([f.chi2 for f in fits]), np.array([f.slope for f in fits])
    assert abs(chi2.mean() - 1.0) < 5 * math.sqrt(2 / 3 / len(fits))
    assert abs(slopes.var() * fits[0].spread - 1.0) < 5 * math.sqrt(2 / len(fits))


def test_two_points_show_no_lack_of_fit():
    fit = line_fit(X[:2], np.array([1.0, 3.0]), np.ones(2))
    assert fit.slope == 2.0
    assert math.isnan(fit.chi2)


def test_another_slope_passes_through_the_same_center():
    fit = line_fit(X, np.sin(X), SE**-2.0)
    assert float(fit.at(fit.centre, slope=3.0)) == fit.level
    assert float(fit.at(fit.centre + 1.0, slope=3.0)) == pytest.approx(fit.level + 3.0)
