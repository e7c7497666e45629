"""Formatting of numbers and names."""

import math

import pytest

from mcspectra.plots.text import (
    interval,
    number,
    number_beside,
    percent,
    power_of_ten,
    rate,
    shorten,
    slug,
    typeset,
    with_error,
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (math.nan, "–"),
        (math.inf, "∞"),
        (-math.inf, "−∞"),
        (0.0, "0"),
        (1.0, "1.00"),
        (-1.523, "−1.52"),
        (9.996, "10.0"),  # rounds to the next power of ten
        (0.00123, "0.00123"),
        (0.0009996, "0.00100"),
        (4.56e-6, "4.56×10⁻⁶"),
        (-4.56e-12, "−4.56×10⁻¹²"),
        (12345.0, "12345"),
        (1234567.0, "1.23×10⁶"),
        (5e-324, "4.94×10⁻³²⁴"),
    ],
)
def test_number(value, text):
    assert number(value) == text


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ((0.961, 0.11), "0.96 ± 0.11"),  # value and error have the same place
        ((1.00004, 0.0018), "1.0000 ± 0.0018"),
        ((9.996, 0.02), "9.996 ± 0.020"),
        ((39.7, 12.0), "40 ± 12"),
        ((-1.86e-6, 3.6e-6), "−1.9×10⁻⁶ ± 3.6×10⁻⁶"),
        ((-1.85e-4, 0.0019), "−2×10⁻⁴ ± 0.0019"),
        ((0.0, 0.1), "0 ± 0.10"),
        ((1e-20, 1e-21, 1.0), "≈ 0"),
        ((0.63, math.inf), "0.630"),
        ((0.63, None), "0.630"),
        ((math.inf, 1.0), "∞"),
        ((None, 1.0), "–"),
    ],
)
def test_with_error(values, text):
    assert with_error(*values) == text


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ((-1.5234, -1.55, -1.49), "−1.52 ± 0.03"),
        ((-1.5234, -1.5274, -1.5194), "−1.523 ± 0.004"),
        ((-1.5, -1.9, -1.1), "−1.50 ± 0.40"),
        ((-0.003, -0.043, 0.037), "0.00 ± 0.04"),
        ((-2.0, -2.0, -2.0), "−2.0000 ± <0.0001"),
        ((-2.0, -math.inf, math.inf), "unresolved"),
        ((-1.7, -4.38, 0.98), "unresolved"),
        ((-2.0, None, None), "−2.00"),
        ((None, None, None), "–"),
        ((math.nan, math.nan, math.nan), "–"),
    ],
)
def test_rate(values, text):
    assert rate(*values) == text


@pytest.mark.parametrize(
    ("fraction", "text"),
    [
        (0.97, "97 %"),
        (1.0, "100 %"),
        (0.0, "0 %"),
        (0.99968, "99.97 %"),  # never rounded to 100
        (0.0004, "0.04 %"),
        (-0.25, "−25 %"),
        (29.0, "2900 %"),
    ],
)
def test_percent(fraction, text):
    assert percent(fraction) == text


def test_number_beside__rounding_error_is_about_zero():
    assert number_beside(4e-17, 1e-3) == "≈ 0"
    assert number_beside(-4e-17, 1e-3) == "≈ 0"
    assert number_beside(0.0, 1e-3) == "0"
    assert number_beside(4e-11, 1e-3) == "4.00×10⁻¹¹"
    assert number_beside(1e-3, None) == number_beside(1e-3, 0.0) == "0.00100"
    assert number_beside(math.inf, 1.0) == number_beside(math.inf, math.inf) == "∞"


def test_interval():
    assert interval(1e-6, 2.5e-6) == "1.00×10⁻⁶ … 2.50×10⁻⁶"
    assert interval(None, 1.0) == interval(math.nan, 1.0) == "–"


def test_typeset__numbers_of_sentences_but_not_of_specs():
    text = "RMSE 6.6e-05 (-1e-05 to 2.5e+12) with gaussian(width=1e-06), power(1.0,2e-07)"
    expected = "RMSE 6.6×10⁻⁵ (−1×10⁻⁵ to 2.5×10¹²) with gaussian(width=1e-06), power(1.0,2e-07)"
    assert typeset(text) == expected


def test_power_of_ten():
    assert power_of_ten(-120) == "10⁻¹²⁰"


def test_shorten__one_line_of_at_most_the_length():
    assert shorten("a  b\nc", 10) == "a b c"
    long = shorten("x" * 50 + "end", 20)
    assert len(long) == 20
    assert long.endswith("end")


def test_shorten__words_stay_whole_if_little_is_lost():
    text = "stratified(jitter=uniform) | shift(kind=patterson) | homogenize"
    assert shorten(text, 50) == "stratified(jitter=uniform) |…) | homogenize"
    assert all(len(shorten(text, length)) <= length for length in range(2, 60))


def test_slug():
    assert slug('A <"b"> & c_1.5') == "a-b-c-1.5"
    assert slug("日本") == "x"
