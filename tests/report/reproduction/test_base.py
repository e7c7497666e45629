"""Verdicts: what agrees, what does not, and how often chance would contradict a true statement."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.special import ndtr, ndtri

from mcspectra.report.reproduction.base import (
    GALLERY_FINDINGS,
    VERDICT_WIDENING,
    agreement,
    comparison,
    identity,
    normal_interval,
    rate_finding,
    verdict_interval,
)


def test_verdicts_take_the_level_of_sidak() -> None:
    z = VERDICT_WIDENING * ndtri(0.975)
    assert (2 * ndtr(z) - 1) ** GALLERY_FINDINGS == pytest.approx(0.95, rel=1e-9)


def test_true_statements_agree_as_often_as_they_should() -> None:
    # Pr(all of 100 agree) = 0.95; of 4000 galleries the frequency has σ = 0.0034.
    z = np.random.default_rng(1).standard_normal((4000, GALLERY_FINDINGS))
    within = np.abs(z) <= VERDICT_WIDENING * ndtri(0.975)
    assert within.all(axis=1).mean() == pytest.approx(0.95, abs=4 * 0.0034)


def test_comparison_at_the_ends_of_its_interval() -> None:
    low, high = verdict_interval(2.0, normal_interval(2.0, 0.1))

    def agrees(expected: float, tolerance: float = 0.0) -> bool | None:
        return comparison(
            "s",
            expected=expected,
            measured=2.0,
            interval=normal_interval(2.0, 0.1),
            tolerance=tolerance,
        ).agrees

    assert all(map(agrees, (low + 1e-9, high - 1e-9)))
    assert not any(map(agrees, (low - 1e-9, high + 1e-9)))
    assert agrees(high + 0.05, tolerance=0.06)
    assert not agrees(high + 0.05, tolerance=0.04)


def test_intervals_of_variances_widen_as_ratios() -> None:
    low, high = verdict_interval(2.0, (1.0, 4.0), "log")
    assert low == pytest.approx(2.0 * 0.5**VERDICT_WIDENING)
    assert high == pytest.approx(2.0 * 2.0**VERDICT_WIDENING)
    # Where a logarithm has no meaning the scale is linear
    assert verdict_interval(0.0, (-1.0, 1.0), "log") == verdict_interval(0.0, (-1.0, 1.0))


def test_rates_are_judged_by_their_own_interval() -> None:
    curve = xr.Dataset({"rate": -2.9, "rate_ci": ("bound", [-3.0, -2.8])})
    assert rate_finding("s", curve, expected=-3.0).agrees
    wrong = rate_finding("s", curve, expected=-2.0)
    assert wrong.agrees is False
    assert (wrong.expected, wrong.measured, wrong.interval) == ("−2.0", -2.9, (-3.0, -2.8))


@pytest.mark.parametrize(
    ("limits", "agrees"),
    [
        ({"below": 2.0}, True),
        ({"above": 0.0}, True),
        ({"above": 0.0, "below": 2.0}, True),
        ({"below": 1.17}, False),  # beyond the 95 % interval, not beyond that of verdicts
        ({"above": 0.83}, False),
    ],
)
def test_beyond_a_bound_with_the_whole_interval(limits: dict[str, float], agrees: bool) -> None:
    assert agreement("s", measured=1.0, interval=(0.9, 1.1), **limits).agrees is agrees


def test_identities_have_an_error_and_no_interval() -> None:
    exact = identity("s", error=-3e-13, at_most=1e-12)
    assert (exact.agrees, exact.expected, exact.interval) == (True, "≤ 1e-12", None)
    assert identity("s", error=2e-12, at_most=1e-12).agrees is False


@pytest.mark.parametrize(
    ("at_most", "shown"),
    [(1e-15, "1e-15"), (0.01, "1e-2"), (1 / 256, "4e-3"), (1.2207e-3, "1.3e-3"), (9.96e-3, "1e-2")],
)
def test_limits_are_not_shown_smaller_than_they_are(at_most: float, shown: str) -> None:
    assert identity("s", error=at_most, at_most=at_most).expected == f"≤ {shown}"
    assert float(shown) >= at_most


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_is_no_number_agrees_with_nothing(value: float) -> None:
    assert comparison("s", expected=1.0, measured=value, interval=(value, value)).agrees is False
    assert agreement("s", measured=value, interval=(value, value), below=2.0).agrees is False
    assert identity("s", error=value, at_most=1.0).agrees is False
