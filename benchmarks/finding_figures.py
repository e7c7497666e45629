"""Panels of the figures of ``benchmarks/findings.py``, in the package's own style."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.axes import count_axis, log_axis
from mcspectra.report.style import (
    ACCENT,
    GRAY,
    INK,
    NARROW,
    SMALL_SIZE,
    WIDE,
    entitle,
    labels,
    line_widths,
    new_figure,
    quiet,
    sampler_styles,
)

__all__ = [
    "Curve",
    "draw_curves",
    "panels",
    "remedy_panel",
    "slopes",
    "small_legend",
    "variance_panel",
    "with_interval",
]

VERDICT_COLORS = {"better": "#009E73", "worse": ACCENT, "undecided": GRAY, "given": INK}


@dataclass(frozen=True)
class Curve:
    """Values (n,) along x with intervals (n, 2), or exact ones with none."""

    x: Array
    values: Array
    interval: Array | None = None

    @property
    def bars(self) -> Array | None:
        """Lengths of the intervals below and above the values, (2, n)."""
        if self.interval is None:
            return None
        low, high = self.interval.T
        return np.maximum([self.values - low, high - self.values], 0.0)

    @staticmethod
    def of(data: Any, name: str = "variance", along: str = "n") -> Curve:
        """Make one of a dataset's variable and its ``_ci``."""
        interval = data[f"{name}_ci"].transpose(along, "bound").values
        return Curve(data[along].values, data[name].values, interval)


def panels(rows: int, columns: int, height: float = 2.4) -> tuple[Any, list[Any]]:
    """Make a figure with so many quiet panels, left to right and top to bottom."""
    figure = new_figure(WIDE if columns > 1 else NARROW, height * rows)
    every = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for axes in every:
        quiet(axes, grid=True)
    return figure, every


def variance_panel(
    axes: Any,
    curves: dict[str, Curve],
    title: str,
    *,
    x: str = "number of points n",
    limits: tuple[float, float] | None = None,
) -> None:
    """Draw variances against counts on logarithmic axes."""
    draw_curves(axes, curves)
    every = np.concatenate([c.values[c.values > 0] for c in curves.values()])
    log_axis(axes, "y", *(limits or (float(every.min()), float(every.max()))))
    count_axis(axes, "x", sorted({int(n) for c in curves.values() for n in c.x}), most=5)
    axes.set(xlabel=x, ylabel="variance")
    entitle(axes, title)
    small_legend(axes)


def draw_curves(axes: Any, curves: dict[str, Curve]) -> None:
    """Draw points with intervals and lines between them, the first lines thickest."""
    styles, widths = sampler_styles(list(curves)), line_widths(len(curves))
    for (name, curve), width in zip(curves.items(), widths, strict=True):
        axes.errorbar(
            curve.x, curve.values, yerr=curve.bars, fmt=styles[name].marker + "-", ms=3.4,
            lw=0.7 * width, elinewidth=0.8, capsize=1.5, color=styles[name].color, label=name,
        )  # fmt: skip


def small_legend(axes: Any) -> None:
    """Put a legend without a frame where it covers least."""
    axes.legend(frameon=False, fontsize=SMALL_SIZE, labelcolor=INK, handlelength=1.4)


def remedy_panel(axes: Any, data: Any) -> None:
    """Draw one row a remedy: its error ratio with its interval, coloured by verdict."""
    names = [str(name) for name in data["remedy"].values]
    ratio, interval = data["error_ratio"].values, data["error_ratio_ci"].values
    for row, verdict in enumerate(data["verdict"].values):
        axes.hlines(row, *interval[row], color=VERDICT_COLORS[verdict], lw=1.6)
        axes.plot(ratio[row], row, "o", ms=3.4, color=VERDICT_COLORS[verdict])
    axes.axvline(1.0, color=GRAY, lw=0.8)
    short = labels(names, 30)
    axes.set_yticks(range(len(names)), [short[name] for name in names])
    axes.set_ylim(len(names) - 0.5, -0.5)
    log_axis(axes, "x", float(interval.min()), float(interval.max()), most=5)
    axes.set_xlabel("error / error as given")


def with_interval(value: Any, interval: Any, form: str = ".2f") -> str:
    """``−1.50 (−1.55 … −1.45)``."""
    low, high = np.asarray(interval, np.float64)
    return f"{float(value):{form}} ({low:{form}} … {high:{form}})"


def slopes(counts: Sequence[int] | Array, values: Array) -> Array:
    """Rates between neighbouring counts."""
    return np.diff(np.log(values)) / np.diff(np.log(counts))
