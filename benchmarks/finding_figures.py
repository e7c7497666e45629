"""Panels of the figures of ``benchmarks/findings.py``, in the package's own style."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Dots, Line, Mark, Panel, Plot
from mcspectra.plots.scales import count_axis, log_axis
from mcspectra.plots.style import line_widths, sampler_styles

__all__ = ["Curve", "slopes", "variance_panels", "variance_plot", "with_interval"]


@dataclass(frozen=True)
class Curve:
    """Values (n,) along x, with intervals (n, 2) unless the values are exact."""

    x: Array
    values: Array
    interval: Array | None = None

    @staticmethod
    def of(data: Any, name: str = "variance", along: str = "n") -> Curve:
        """Make a curve from a variable of a dataset and its ``_ci``."""
        interval = data[f"{name}_ci"].transpose(along, "bound").values
        return Curve(data[along].values, data[name].values, interval)


def variance_plot(parts: Mapping[str, Mapping[str, Curve]], **options: Any) -> Plot:
    """Plot variances against counts on logarithmic axes, with one panel per title."""
    panels = variance_panels(parts, **options)
    return Plot(kind="findings", panels=panels, columns=min(3, len(panels)), wide=len(panels) > 1)


def variance_panels(
    parts: Mapping[str, Mapping[str, Curve]],
    *,
    x: str | Axis = "number of points n",
    y: str = "variance",
    limits: tuple[float, float] | None = None,
) -> tuple[Panel, ...]:
    """Return panels with points, intervals and lines between points.

    In each panel, the first curve has the thickest line.
    Curves of the same name look the same in all panels.
    """
    styles = sampler_styles([name for curves in parts.values() for name in curves])
    panels = []
    for title, curves in parts.items():
        marks: list[Mark] = []
        for (name, curve), width in zip(curves.items(), line_widths(len(curves)), strict=True):
            color, low, high = styles[name].color, None, None
            if curve.interval is not None:
                low, high = curve.interval.T
            at = np.asarray(curve.x, float)
            marks += [
                Line(x=at, y=curve.values, color=color, width=0.7 * width, label=name),
                Dots(x=at, y=curve.values, color=color, marker=styles[name].marker, size=3.4,
                     low=low, high=high, label=name),
            ]  # fmt: skip
        every = np.concatenate([c.values[c.values > 0] for c in curves.values()])
        counts = sorted({int(n) for c in curves.values() for n in c.x})
        below = x if isinstance(x, Axis) else count_axis(x, counts, most=5)
        beside = log_axis(y, *(limits or (float(every.min()), float(every.max()))))
        panels.append(Panel(marks=tuple(marks), x=below, y=beside, title=title, grid=True))
    return tuple(panels)


def with_interval(value: Any, interval: Any, form: str = ".2f") -> str:
    """Format a rate as ``−1.50 (−1.55 … −1.45)``."""
    low, high = np.asarray(interval, np.float64)
    return f"{float(value):{form}} ({low:{form}} … {high:{form}})"


def slopes(counts: Sequence[int] | Array, values: Array) -> Array:
    """Return rates between neighboring counts."""
    return np.diff(np.log(values)) / np.diff(np.log(counts))
