"""Verdicts of claims, and the frequency of wrong verdicts for true statements."""

import numpy as np
import pytest
import xarray as xr
from scipy.special import ndtr, ndtri

from mcspectra.estimators.moments import Measured
from mcspectra.reproduction.claims import (
    GALLERY_FINDINGS,
    VERDICT_WIDENING,
    Claim,
    judge,
    pixel_rate,
    rate_claim,
)


def test_verdicts_have_the_sidak_level():
    z = VERDICT_WIDENING * ndtri(0.975)
    assert (2 * ndtr(z) - 1) ** GALLERY_FINDINGS == pytest.approx(0.95, rel=1e-9)


def test_true_statements_agree_with_the_nominal_frequency():
    # All of 100 agree with probability 0.95; the frequency over 4000 galleries has σ = 0.0034.
    z = np.random.default_rng(1).standard_normal((4000, GALLERY_FINDINGS))
    within = np.abs(z) <= VERDICT_WIDENING * ndtri(0.975)
    assert within.all(axis=1).mean() == pytest.approx(0.95, abs=4 * 0.0034)


def test_an_expected_number_at_the_ends_of_the_interval():
    measured = Measured.normal(2.0, 0.1)
    low, high = measured.widened(VERDICT_WIDENING)

    def agrees(expected, tolerance=0.0):
        return judge(Claim("s", measured, expected=expected, tolerance=tolerance)).agrees

    assert all(map(agrees, (low + 1e-9, high - 1e-9)))
    assert not any(map(agrees, (low - 1e-9, high + 1e-9)))
    assert agrees(high + 0.05, tolerance=0.06)
    assert not agrees(high + 0.05, tolerance=0.04)


def test_a_number_without_an_interval_is_judged_by_its_tolerance():
    found = judge(Claim("s", 1.5, expected=1.0, tolerance=0.5))
    assert (found.agrees, found.measured, found.interval, found.expected) == (
        True,
        1.5,
        None,
        "1.00",
    )
    assert judge(Claim("s", 1.5, expected=1.0, tolerance=0.4)).agrees is False
    assert judge(Claim("s", 1.0 + 1e-15, expected=1.0)).agrees is False


def test_intervals_of_variances_widen_on_a_log_scale():
    low, high = Measured(2.0, 1.0, 4.0, log=True).widened(VERDICT_WIDENING)
    assert low == pytest.approx(2.0 * 0.5**VERDICT_WIDENING)
    assert high == pytest.approx(2.0 * 2.0**VERDICT_WIDENING)
    # The scale is linear if the logarithm is undefined
    log, linear = (Measured(0.0, -1.0, 1.0, log=log) for log in (True, False))
    assert log.widened(VERDICT_WIDENING) == linear.widened(VERDICT_WIDENING)


def _curve(rate, half):
    return xr.Dataset({"rate": rate, "rate_ci": ("bound", [rate - half, rate + half])})


def test_rates_are_judged_by_their_own_interval():
    assert judge(rate_claim("s", _curve(-3.0, 0.5), -3.0)).agrees
    wrong = judge(rate_claim("s", _curve(-3.0, 0.5), -1.0))
    assert wrong.agrees is False
    half = 0.5 * VERDICT_WIDENING
    assert (wrong.expected, wrong.measured) == ("−1.0", -3.0)
    assert wrong.interval == pytest.approx((-3.0 - half, -3.0 + half))


@pytest.mark.parametrize("expected", [-1.5, -2.0])
def test_a_clear_pixel_rate_agrees_with_one_theory_only(expected):
    clear = judge(pixel_rate("s", _curve(expected, 0.05), expected))
    assert clear.agrees is True
    assert "are needed to exclude" not in clear.note
    assert judge(pixel_rate("s", _curve(-3.5 - expected, 0.05), expected)).agrees is False


@pytest.mark.parametrize(("expected", "shown"), [(-1.5, "−2.0"), (-2.0, "−1.5")])
def test_the_note_says_if_the_other_rate_also_agrees(expected, shown):
    weak = judge(pixel_rate("s", _curve(-1.75, 0.2), expected))
    assert weak.agrees is True
    assert weak.note.endswith(f"More realizations are needed to exclude {shown}.")


@pytest.mark.parametrize(
    ("limits", "agrees"),
    [
        ({"below": 2.0}, True),
        ({"above": 0.0}, True),
        ({"above": 0.0, "below": 2.0}, True),
        ({"below": 1.17}, None),  # outside the 95 % interval, but inside the verdict interval
        ({"above": 0.83}, None),
        ({"above": 1.17}, None),
        ({"above": 1.3}, False),
        ({"below": 0.7}, False),
    ],
)
def test_bounds_need_the_whole_interval(limits, agrees):
    found = judge(Claim("s", Measured(1.0, 0.9, 1.1), **limits))
    assert found.agrees is agrees
    assert ("are needed to decide" in found.note) == (agrees is None)


def test_the_interval_that_is_shown_decides():
    """A measured 1.271 (95 %: 1.115 to 1.449) must not be shown as contradicting a bound of 1."""
    found = judge(Claim("s", Measured(1.271, 1.115, 1.449, log=True), above=1.0))
    assert found.interval is not None
    assert found.interval[0] < 1.0
    assert found.agrees is None
    for expected in np.linspace(0.8, 1.8, 101):
        each = judge(Claim("s", Measured(1.271, 1.115, 1.449, log=True), expected=float(expected)))
        assert each.agrees == (found.interval[0] <= expected <= found.interval[1])


def test_identities_have_a_limit_and_no_interval():
    exact = judge(Claim("s", -3e-13, at_most=1e-12))
    assert (exact.agrees, exact.expected, exact.interval) == (True, "≤ 10⁻¹²", None)
    assert judge(Claim("s", 2e-12, at_most=1e-12)).agrees is False


@pytest.mark.parametrize(
    ("at_most", "shown"),
    [
        (1e-15, "10⁻¹⁵"),
        (0.01, "10⁻²"),
        (1 / 256, "4×10⁻³"),
        (1.2207e-3, "1.3×10⁻³"),
        (9.96e-3, "10⁻²"),
    ],
)
def test_shown_limits_are_rounded_up(at_most, shown):
    assert judge(Claim("s", at_most, at_most=at_most)).expected == f"≤ {shown}"


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_nan_never_agrees(value):
    measured = Measured(value, value, value)
    assert judge(Claim("s", measured, expected=1.0)).agrees is False
    assert judge(Claim("s", measured, below=2.0)).agrees is False
    assert judge(Claim("s", value, at_most=1.0)).agrees is False


@pytest.mark.parametrize("holds", [True, False, None])
def test_exhibits_can_give_their_own_verdict(holds):
    found = judge(Claim("s", "words", holds=holds, shown="other words", note="why"))
    assert (found.agrees, found.measured, found.expected) == (holds, "words", "other words")
