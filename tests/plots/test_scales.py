"""Axes and color scales from data."""

import itertools
import math

import numpy as np
import pytest

from mcspectra.plots.scales import (
    count_axis,
    linear_axis,
    log_axis,
    log_scale,
    log_ticks,
    name_axis,
    signed_axis,
    signed_place,
    signed_scale,
    tick_label,
    unit_axis,
)

NOTHING = np.array([math.nan, 0.0, math.inf])


@pytest.mark.parametrize("high", [1.0001, 1.3, 2.0, 9.0, 50.0, 1e3, 1e9, 1e60])
@pytest.mark.parametrize("low", [1e-30, 0.3, 1.0, 7e8])
def test_log_ticks__few_ticks_within_the_limits(low, high):
    ticks = log_ticks(low, low * high)
    assert all(low * (1 - 1e-8) <= t <= low * high * (1 + 1e-8) for t in ticks)
    assert len(ticks) <= 7
    if high >= 1.3:
        assert len(ticks) >= 2


@pytest.mark.parametrize("high", [0.0, 1e-6, 3.0, 1e5])
@pytest.mark.parametrize("low", [0.0, -1e-6, -3.0, -1e5])
def test_signed_axis__ticks_are_ordered_within_the_limits_and_include_zero(low, high):
    axis = signed_axis("v", [np.array([low, high, 1e-7])])
    ticks = list(axis.ticks)
    assert 0.0 in ticks
    assert ticks == sorted(ticks)
    assert len(set(ticks)) == len(ticks) <= 10
    assert axis.low <= ticks[0]
    assert ticks[-1] <= axis.high


def test_signed_axis__label_has_the_threshold():
    assert signed_axis("v", [np.array([1.0, -2.0, math.nan])]).label == "v"
    axis = signed_axis("v", [np.array([1.0, -1e-4])])
    assert (axis.kind, axis.label) == ("signed", "v   (log beyond ±10⁻⁴)")
    assert axis.threshold == pytest.approx(1e-4)
    far = signed_axis("v", [np.array([1e-30, 1.0])])
    assert far.threshold == pytest.approx(1e-6)


@pytest.mark.parametrize("high", [2e-6, 3e-5, 0.02, 1.0, 7e3])
@pytest.mark.parametrize("low", [-1e-6, -4e-6, -3e-4, -5.0])
def test_signed_axis__labels_on_both_sides_do_not_touch(low, high):
    axis = signed_axis("v", [np.array([low, high, 1e-6])])
    if axis.kind == "signed" and min(-low, high) > axis.threshold / 10:
        assert min(axis.ticks) < 0 < max(axis.ticks)
        places = signed_place(np.array(list(axis.ticks)), axis.threshold)
        # Values between 1 and 2 thresholds are at most half a decade from 0
        assert np.diff(places).min() >= (0.6 if min(-low, high) >= 2 * axis.threshold else 0.5)


@pytest.mark.parametrize("far", [-4e-5, -0.02, -1e9, -math.inf])
def test_signed_axis__includes_whiskers(far):
    bars = np.array([1e-4, 0.03])
    axis = signed_axis("v", [bars], whiskers=np.array([far, 0.05, math.nan]))
    assert (axis.kind, axis.threshold) == ("signed", pytest.approx(1e-4))
    assert axis.high > 0.05
    if math.isfinite(far):
        assert axis.low < max(far, -0.03)
        assert min(axis.ticks) < 0
    assert axis.low >= -0.06
    straight = signed_axis("v", [bars + 0.01], whiskers=np.array([0.02]))
    assert straight == signed_axis("v", [bars + 0.01])


def test_empty_data_give_an_axis_with_zero():
    assert list(signed_axis("v", [NOTHING]).ticks) == [0.0]
    assert (signed_scale("v", [NOTHING]).low, signed_scale("v", [NOTHING]).high) == (-1.0, 1.0)
    assert signed_axis("v", []).kind == "linear"


def test_signed_scale__is_symmetric_and_resolves_the_smaller_array():
    scale = signed_scale("v", [np.array([1e-3, -2e-5]), np.array([math.nan, 1e-6, 1e-12])])
    assert (scale.low, scale.high) == (-1e-3, 1e-3)
    assert scale.threshold == pytest.approx(1e-9)
    places = signed_place(np.array([0.0, 1e-5, -1e-5, 1e-9, math.nan]), scale.threshold)
    np.testing.assert_allclose(places, [0.0, 4.5, -4.5, 0.5, math.nan])


def test_count_axis__labels_do_not_touch():
    counts = [*range(1, 65), 1024]
    ticks = count_axis("n", counts).ticks
    assert set(ticks) <= set(counts)
    assert list(ticks)[-1] == 1024
    least = math.log(1024) / 6
    assert all(math.log(b / a) >= 0.99 * least for a, b in itertools.pairwise(ticks))
    assert ticks[1024.0] == "1024"
    alone = count_axis("n", [64, 64])
    assert alone.low < 64 < alone.high


@pytest.mark.parametrize("ends", [(1e-5, 1e-5), (math.nan, 1.0), (2.0, 1.0), (0.0, 0.0)])
def test_log_axes_with_invalid_ends(ends):
    for made in (log_axis("v", *ends), log_scale("v", *ends)):
        assert 0 < made.low < made.high


def test_linear_axis__round_ticks_inside():
    axis = linear_axis("v", -0.0005, 0.0033)
    assert list(axis.ticks.values()) == ["0", "10⁻³", "2×10⁻³", "3×10⁻³"]
    assert axis.low < -0.0005
    assert axis.high > 0.0033
    assert linear_axis("v", 0.0, 2.0).low == 0.0
    assert linear_axis("v", math.nan, 1.0).high > 1.0


def test_axes_of_names_and_of_the_unit_interval():
    axis = name_axis(["a", "b"])
    assert (axis.low, axis.high, axis.flipped) == (-0.6, 1.6, True)
    assert axis.ticks == {0.0: "a", 1.0: "b"}
    assert unit_axis("x").ticks == {0.0: "0", 1.0: "1"}


def test_tick_labels():
    values = (0.0, -20.0, 0.5, 1e-6, 2e-4, 1e5)
    assert [tick_label(v) for v in values] == ["0", "−20", "0.5", "10⁻⁶", "2×10⁻⁴", "10⁵"]
