"""Findings on the three terms of a variance, and bars of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.report.formatting import number
from mcspectra.report.reproduction.base import Finding, Interval, comparison
from mcspectra.report.style import PALETTE, entitle, quiet

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["TERMS", "interval_of", "quotient", "term_bars", "term_finding"]

_ROUNDING = 1e-12  # terms that small beside the largest are rounding errors

TERMS = {"dc_term": "first", "power_term": "second", "cross_term": "third"}


def interval_of(data: xr.Dataset, name: str) -> Interval:
    """Return the 95 % interval of a variable."""
    low, high = data[f"{name}_ci"].values
    return float(low), float(high)


def term_finding(
    statement: str, data: xr.Dataset, name: str, expected: float, *, note: str = ""
) -> Finding:
    """Judge a term, or the predicted variance, of `mcspectra.variance_terms`."""
    return comparison(
        statement,
        expected=expected,
        measured=float(data[name]),
        interval=interval_of(data, name),
        text=number(expected, 4),
        note=note,
    )


def quotient(data: xr.Dataset, name: str, scale: float) -> tuple[float, Interval]:
    """Return a variable over a number without error, and its interval."""
    low, high = interval_of(data, name)
    return float(data[name]) / scale, (low / scale, high / scale)


def term_bars(axes: Axes, data: xr.Dataset, scale: float, title: str) -> None:
    """Draw the three terms and their sum over `scale`, with 95 % intervals."""
    quiet(axes)
    names: Mapping[str, str] = {**TERMS, "predicted_variance": "sum"}
    drawn = {name: quotient(data, name, scale) for name in names}
    rounding = _ROUNDING * max(abs(value) for value, _ in drawn.values())
    for place, (value, (low, high)) in enumerate(drawn.values()):
        axes.bar(place, value, color=PALETTE[place], width=0.72)
        axes.vlines(place, low, high, color="#262626", lw=1)
        label = number(value, 2) if abs(value) > rounding else "0"
        axes.text(place, max(high, 0.0), label, ha="center", va="bottom", fontsize=7)
    axes.axhline(0.0, color="#262626", lw=0.7)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.12 * (high - low))
    axes.set_xticks(np.arange(len(names)), list(names.values()), fontsize=7.5)
    entitle(axes, title)
