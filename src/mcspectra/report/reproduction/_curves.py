"""Panels of variance against the number of points, and the slopes and distances they are judged by."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.axes import count_axis, log_axis
from mcspectra.report.formatting import number
from mcspectra.report.reproduction.base import Finding, Interval, rate_finding
from mcspectra.report.style import PALETTE, entitle, line_widths, quiet

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

__all__ = ["convergence_panel", "known_rate", "slope", "variance_ratio"]

_MARKERS = ("o", "s", "^", "D", "v")


def slope(counts: Sequence[int], variances: Array) -> float:
    """Return the exponent of variances at the counts, all weighing alike."""
    return float(np.polyfit(np.log(counts), np.log(variances), 1)[0])


def known_rate(statement: str, curve: xr.Dataset, expected: float, exact: Array) -> Finding:
    """Judge a rate whose limit is known, with the slope of the exact variances for a tolerance."""
    here = slope([int(n) for n in curve["n"].values], exact)
    return rate_finding(
        statement,
        curve,
        expected=expected,
        tolerance=abs(here - expected),
        note=f"Tolerance: the exact variances at these N have the slope {number(here, 5)}.",
    )


def variance_ratio(above: xr.Dataset, below: xr.Dataset) -> tuple[float, Interval]:
    """Return the ratio of two measured variances and its 95 % interval, as of independent ones.

    Common random numbers, which vary together, make the interval too wide.
    """
    value = float(above["variance"]) / float(below["variance"])
    spans = [np.ptp(np.log(each["variance_ci"].values)) / 2 for each in (above, below)]
    half = math.hypot(*map(float, spans))
    return value, (value * math.exp(-half), value * math.exp(half))


def convergence_panel(
    axes: Axes,
    curves: Mapping[str, xr.Dataset],
    exact: Mapping[str, Array],
    title: str,
) -> None:
    """Draw measured variances with 95 % intervals, and lines of the exact ones where known.

    Parameters
    ----------
    curves
        Of `mcspectra.convergence`, one estimator and sampler each, by label; colours follow their order.
    exact
        Variances at the same counts, for some of the labels.
    """
    quiet(axes, grid=True)
    values = []
    looks = zip(PALETTE, _MARKERS, line_widths(len(curves)), strict=False)
    for (label, curve), (color, marker, width) in zip(curves.items(), looks, strict=False):
        n, variance = curve["n"].values, curve["variance"].values
        low, high = curve["variance_ci"].values.T
        axes.errorbar(
            n, variance, [variance - low, high - variance],
            fmt=marker, ms=4, lw=1, color=color, label=label,
        )  # fmt: skip
        line = exact.get(label, variance)
        axes.plot(n, line, color=color, lw=width, ls="-" if label in exact else ":")
        values += [*low, *high, *line]
    count_axis(axes, "x", [int(n) for n in n])
    log_axis(axes, "y", min(values), max(values), most=5)
    axes.set_xlabel("number of points N")
    entitle(axes, title)
