"""A pixel: the light that arrives, variance against n of every strategy, and what would help."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.report.axes import count_axis, log_axis
from mcspectra.report.figures.panels import GivenAxes, rows_of
from mcspectra.report.figures.variance import usable_counts
from mcspectra.report.formatting import MISSING, rate, shorten
from mcspectra.report.style import (
    ACCENT,
    GRAY,
    INK,
    NARROW,
    SMALL_SIZE,
    WIDE,
    LineStyle,
    entitle,
    legend_below,
    new_figure,
    plain,
    quiet,
    quiet_colorbar,
    sampler_styles,
    say,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["incident_maps", "remedy_ratios", "strategy_curves"]

_DECADES = 4  # of radiance that are told apart
_BETTER, _WORSE = "#009E73", ACCENT
_TITLES = {
    "incident_radiance": "radiance of the lights seen",
    "reflected_radiance": "f: that, times BSDF and cosine",
}


def incident_maps(data: xr.Dataset) -> Figure:
    """Draw what `mcspectra.rendering.hemisphere.incident_light` returns, one map above the other."""
    figure = new_figure(WIDE, 4.3)
    rows = figure.subplots(2, 1, sharex=True)
    for axes, (name, title) in zip(rows, _TITLES.items(), strict=True):
        quiet(axes)
        entitle(axes, title, "left")
        _radiance_map(figure, axes, data[name])
        axes.set(ylabel="elevation / °", yticks=[0, 30, 60, 90])
    rows[1].set(xlabel="azimuth / °", xticks=range(0, 361, 60))
    return figure


def _radiance_map(figure: Figure, axes: Axes, values: xr.DataArray) -> None:
    """A map with a logarithmic scale; black where no light comes from."""
    from matplotlib.colors import LogNorm

    shown = values.transpose("elevation", "azimuth").values
    top = float(shown.max())
    if top <= 0.0:
        say(axes, "no light from the centre of any cell")
        axes.set(xlim=(0, 360), ylim=(0, 90))
        return
    positive = shown[shown > 0]
    low = max(float(positive.min()), top * 10.0**-_DECADES)
    low = min(low, 0.5 * top)
    axes.set_facecolor("black")
    drawn = axes.imshow(
        np.where(shown > 0, np.maximum(shown, low), np.nan),
        origin="lower",
        extent=(0, 360, 0, 90),
        norm=LogNorm(low * 0.5, top),
        cmap="gray",
        interpolation="nearest",
        aspect="auto",
    )
    bar = figure.colorbar(drawn, ax=axes, aspect=14, pad=0.015)
    quiet_colorbar(bar, str(values.attrs.get("units", "")))
    bar.minorticks_off()


def strategy_curves(curves: xr.Dataset, names: Mapping[str, str]) -> Figure:
    """Draw variance against n, a panel for each strategy, a line for each sampler.

    Parameters
    ----------
    curves
        Results of `convergence` on (strategy, sampler, n).
    names
        Titles of the strategies.
    """
    strategies = [str(s) for s in curves["strategy"].values]
    samplers = [str(s) for s in curves["sampler"].values]
    styles = sampler_styles(samplers)
    figure = new_figure(WIDE, 0.3 + 2.9 * ((len(strategies) + 1) // 2) + 0.1 * len(samplers))
    panels = figure.subplots((len(strategies) + 1) // 2, 2, sharex=True, sharey=True).ravel()
    for axes, strategy in zip(panels, strategies, strict=True):
        quiet(axes, grid=True)
        entitle(axes, names[strategy], "left")
        notes = [
            (_curve(axes, curves.sel(strategy=strategy, sampler=s), styles[s], s), styles[s])
            for s in samplers
        ]
        _write_rates(axes, notes)
    values = curves["variance_ci"].values
    used = values[np.isfinite(values) & (values > 0)]
    count_axis(panels[0], "x", [int(n) for n in curves["n"].values])
    if used.size:
        log_axis(panels[0], "y", float(used.min()), float(used.max()))
    for axes in panels:
        _frame(axes)
    legend_below(figure, panels[0], columns=min(4, len(samplers)))
    return figure


def _frame(axes: Axes) -> None:
    place = axes.get_subplotspec()
    if place is not None and place.is_first_col():
        axes.set_ylabel("variance")
    if place is not None and place.is_last_row():
        axes.set_xlabel("number of samples n of each technique")


def _curve(axes: Axes, data: xr.Dataset, style: LineStyle, name: str) -> str:
    """Draw one curve with intervals; returns its rate as text."""
    used = usable_counts(data)
    n, variance = data["n"].values[used].astype(float), data["variance"].values[used]
    low, high = data["variance_ci"].values[used].T
    axes.errorbar(
        n, variance, yerr=np.maximum([variance - low, high - variance], 0.0),
        fmt=style.marker, ls=style.dashes, ms=3.6, lw=1.0, color=style.color, elinewidth=0.8,
        capsize=1.5, label=plain(shorten(name)),
    )  # fmt: skip
    text = rate(float(data["rate"]), *(float(end) for end in data["rate_ci"].values))
    return "no rate" if text == MISSING else text


def _write_rates(axes: Axes, notes: list[tuple[str, LineStyle]]) -> None:
    """List the rates in the lower left corner, in the colours of their lines."""
    for row, (text, style) in enumerate(reversed(notes)):
        axes.annotate(
            text, (0.03, 0.03), xycoords="axes fraction", xytext=(0, 10 * row),
            textcoords="offset points", fontsize=SMALL_SIZE, color=style.color,
        )  # fmt: skip


def remedy_ratios(data: xr.Dataset, *, axes: GivenAxes = None) -> Figure:
    """Draw the error of every change relative to the set-up as given, with intervals.

    Parameters
    ----------
    data
        Results of `mcspectra.remedies`.
    axes
        One matplotlib axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        The data are another analysis.
    """
    if "error_ratio" not in getattr(data, "variables", ()):
        raise ParameterError(
            "What is to be drawn has no ratios of errors; give what mcspectra.remedies returns."
        )
    names = [str(name) for name in data["remedy"].values]
    figure, [panel] = rows_of(axes, 1, NARROW, 0.8 + 0.2 * len(names))
    ratio, interval = data["error_ratio"].values, data["error_ratio_ci"].values
    colors = {"better": _BETTER, "worse": _WORSE, "given": INK}
    for row, verdict in enumerate(data["verdict"].values):
        if not ratio[row] > 0:
            continue
        color = colors.get(str(verdict), GRAY)
        panel.hlines(row, *_clipped(interval[row]), color=color, lw=1.4)
        panel.plot(ratio[row], row, "o", ms=4, color=color)
    panel.axvline(1.0, color=GRAY, lw=0.7)
    panel.set_yticks(range(len(names)), [plain(shorten(name, 44)) for name in names])
    panel.set_ylim(len(names) - 0.4, -0.6)
    known = interval[np.isfinite(interval) & (interval > 0)]
    log_axis(panel, "x", float(known.min(initial=0.5)), float(known.max(initial=2.0)))
    panel.set_xlabel("error at the budget / that of the set-up as given")
    return figure


def _clipped(interval: Array) -> tuple[float, float]:
    """Ends that a logarithmic axis can show."""
    low, high = interval
    return max(float(low), 1e-12), float(high)
