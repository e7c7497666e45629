"""Ticks and scales of signed and logarithmic axes."""

import itertools
import math

import numpy as np
import pytest

from mcspectra.report.axes import (
    count_axis,
    linear_threshold,
    log_axis,
    log_ticks,
    signed_axis,
    signed_norm,
    signed_ticks,
    threshold_note,
)
from mcspectra.report.style import new_figure


@pytest.mark.parametrize("high", [1.0001, 1.3, 2.0, 9.0, 50.0, 1e3, 1e9, 1e60])
@pytest.mark.parametrize("low", [1e-30, 0.3, 1.0, 7e8])
def test_log_ticks__few_and_inside(low: float, high: float) -> None:
    ticks = log_ticks(low, low * high)
    assert all(low * (1 - 1e-8) <= t <= low * high * (1 + 1e-8) for t in ticks)
    assert len(ticks) <= 7
    if high >= 1.3:
        assert len(ticks) >= 2


@pytest.mark.parametrize("high", [0.0, 1e-6, 3.0, 1e5])
@pytest.mark.parametrize("low", [0.0, -1e-6, -3.0, -1e5])
def test_signed_ticks__zero_in_order_and_inside(low: float, high: float) -> None:
    ticks = signed_ticks(low, high, 1e-7)
    assert 0.0 in ticks
    assert ticks == sorted(ticks)
    assert len(set(ticks)) == len(ticks) <= 10
    assert ticks[0] >= low * (1 + 1e-9)
    assert ticks[-1] <= high * (1 + 1e-9)


def test_linear_threshold__at_the_smallest_but_not_too_far_down() -> None:
    assert linear_threshold([0.0, 3e-3, -20.0]) == pytest.approx(1e-3)
    assert linear_threshold([1e-30, 1.0]) == pytest.approx(1e-6)
    assert linear_threshold([0.0, math.nan, math.inf]) == 0.0


def test_signed_axis__says_when_it_is_logarithmic() -> None:
    axes = new_figure(3, 3).subplots()
    assert signed_axis(axes, "x", np.array([1.0, -2.0, math.nan])) == ""
    assert axes.get_xscale() == "linear"
    assert signed_axis(axes, "y", np.array([1.0, -1e-4])) == "log beyond ±10⁻⁴"
    assert axes.get_yscale() == "symlog"


def test_signed_axis__nothing_to_show() -> None:
    axes = new_figure(3, 3).subplots()
    assert signed_axis(axes, "x", np.array([math.nan, 0.0, math.inf])) == ""
    assert list(axes.get_xticks()) == [0.0]


def test_signed_norm__symmetric_and_zero_in_the_middle() -> None:
    norm = signed_norm([np.array([1e-3, -2e-5]), np.array([math.nan, 1e-6])])
    assert norm(0.0) == pytest.approx(0.5)
    assert norm(1e-3) == pytest.approx(1.0)
    assert norm(1e-5) + norm(-1e-5) == pytest.approx(1.0)
    assert norm.linthresh == pytest.approx(1e-9)


def test_signed_norm__all_zero_or_infinite() -> None:
    assert signed_norm([np.zeros(3), np.full(2, math.nan)])(0.0) == pytest.approx(0.5)


def test_count_axis__labels_are_counts_apart_from_one_another() -> None:
    axes = new_figure(3, 3).subplots()
    counts = [*range(1, 65), 1024]
    count_axis(axes, "x", counts)
    ticks = [int(t) for t in axes.get_xticks()]
    assert set(ticks) <= set(counts)
    assert ticks[-1] == 1024
    least = math.log(1024) / 6
    assert all(math.log(b / a) >= 0.99 * least for a, b in itertools.pairwise(ticks))
    assert [t.get_text() for t in axes.get_xticklabels()][-1] == "1\u2009024"


def test_log_axis__one_value() -> None:
    axes = new_figure(3, 3).subplots()
    log_axis(axes, "y", 1e-5, 1e-5)
    low, high = axes.get_ylim()
    assert low < 1e-5 < high


def test_threshold_note() -> None:
    assert threshold_note(1e-6) == "log beyond ±10⁻⁶"
