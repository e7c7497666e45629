"""Rates of pixels: which of two they are, and whether the measurement tells them apart."""

from __future__ import annotations

import pytest
import xarray as xr

from mcspectra.report.reproduction._pixels import pixel_rate


def curve(rate: float, half: float) -> xr.Dataset:
    return xr.Dataset({"rate": rate, "rate_ci": ("bound", [rate - half, rate + half])})


@pytest.mark.parametrize("expected", [-1.5, -2.0])
def test_a_clear_rate_agrees_with_itself_alone(expected: float) -> None:
    other = -3.5 - expected
    clear = pixel_rate("s", curve(expected, 0.05), expected)
    assert clear.agrees is True
    assert "rule out" not in clear.note
    assert pixel_rate("s", curve(other, 0.05), expected).agrees is False


@pytest.mark.parametrize(("expected", "shown"), [(-1.5, "−2.0"), (-2.0, "−1.5")])
def test_where_the_other_rate_agrees_too_it_is_said(expected: float, shown: str) -> None:
    weak = pixel_rate("s", curve(-1.75, 0.2), expected)
    assert weak.agrees is True
    assert weak.note.endswith(f"So few realisations do not rule out {shown}.")
