"""Signed scales: order, symmetry, ticks at their own places, odd values."""

import math

import numpy as np
import pytest

from mcspectra.report.interactive.signed import SignedScale, signed_scale

WIDE = np.array([-3e-4, -1e-9, 0.0, 2e-8, 0.7])


def value_of(text: str) -> float:
    """The number that a tick's text means."""
    plain = text.translate(str.maketrans("−⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "--0123456789"))
    if "10-" in plain:
        mantissa, exponent = plain.split("10-")
        return float({"": "1", "-": "-1"}.get(mantissa, mantissa)) * 10.0 ** -int(exponent)
    return float(plain)


def test_places_are_odd_and_in_order() -> None:
    scale = signed_scale([WIDE])
    positive = np.geomspace(1e-12, 1, 200)
    values = np.concatenate([-positive[::-1], [0.0], positive])
    places = scale.place(values)
    assert (np.diff(places) > 0).all()
    np.testing.assert_array_equal(places, -places[::-1])


def test_a_decade_beyond_the_threshold_is_a_unit() -> None:
    scale = SignedScale(low=-1.0, high=1.0, threshold=1e-3)
    np.testing.assert_allclose(
        scale.place(np.array([5e-4, 1e-3, 1e-2, -1.0])), [0.25, 0.5, 1.5, -3.5], rtol=1e-12
    )


def test_ticks_stand_where_their_values_are() -> None:
    scale = signed_scale([WIDE])
    ticks = scale.ticks()
    assert ticks[0.0] == "0"
    assert len(ticks) >= 4
    for place, text in ticks.items():
        assert place == pytest.approx(float(scale.place(np.array(value_of(text)))))
    assert scale.note == "   (log beyond ±10⁻⁷)"


def test_a_short_range_is_linear() -> None:
    scale = signed_scale([np.array([1.0, -4.0, 10.0])])
    assert scale.note == ""
    np.testing.assert_array_equal(scale.place(np.array([2.5, -3.0])), [2.5, -3.0])
    assert list(scale.ticks()) == [0.0, 5.0, 10.0]
    assert all(value_of(text) == place for place, text in scale.ticks().items())


def test_each_map_is_told_apart_below_its_own_largest_value() -> None:
    assert signed_scale([np.array([1.0, 1e-9])], 3).threshold == 1e-3
    assert signed_scale([np.array([1.0, 1e-9]), np.array([1e-2])], 3).threshold == 1e-5
    # A map of nothing but rounding does not stretch the scale of the others.
    assert signed_scale([np.array([1.0, 1e-9]), np.array([1e-20])], 3).threshold == 1e-3


@pytest.mark.parametrize("values", [[], [np.zeros(3)], [np.full(2, math.nan)], [np.zeros(0)]])
def test_nothing_to_show(values: list[np.ndarray]) -> None:
    scale = signed_scale(values)
    assert scale.ticks() == {0.0: "0"}
    assert scale.note == ""


def test_what_is_not_finite_has_no_place() -> None:
    places = signed_scale([WIDE]).place(np.array([math.nan, math.inf, -math.inf, 0.0]))
    assert np.isnan(places[:3]).all()
    assert places[3] == 0
