"""The variance itself: three terms, convergence with fitted rates, captured share."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.estimators.moments import CONFIDENCE_Z
from mcspectra.report.axes import count_axis, log_axis, signed_axis
from mcspectra.report.figures.groups import Group, as_group
from mcspectra.report.figures.panels import GivenAxes, rows_of
from mcspectra.report.formatting import MISSING, NEGLIGIBLE, number_beside, rate
from mcspectra.report.style import (
    GRAY,
    INK,
    NARROW,
    SMALL_SIZE,
    LineStyle,
    entitle,
    labels,
    legend_below,
    line_widths,
    sampler_styles,
    say,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "TERMS",
    "captured_curves",
    "convergence_curves",
    "fitted_line",
    "interval_of",
    "three_terms",
    "usable_counts",
]

TERMS = ("dc_term", "power_term", "cross_term", "predicted_variance", "measured_variance")
_LINEAR_TOP = 4.0  # captured shares up to here are drawn on a linear axis


def three_terms(
    data: Group, *, styles: Mapping[str, LineStyle] | None = None, axes: GivenAxes = None
) -> Figure:
    """Draw dc, power and cross term, their sum and the measured variance as signed bars.

    Parameters
    ----------
    data
        Results of `variance_terms`, by sampler; of several channels the first is shown.
    styles
        How each sampler is drawn.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, or a variable is missing.
    """
    group = as_group(data, *TERMS, "predicted_variance_ci", "measured_variance_ci")
    styles = styles or sampler_styles(list(group))
    names = labels(list(group), 40)
    figure, rows = rows_of(axes, len(group), NARROW, 0.5 + 1.25 * len(group))
    for row, (name, each) in zip(rows, group.items(), strict=True):
        _term_bars(row, each, styles[name])
        entitle(row, names[name], "left")
    every = [[float(each[term]) for term in TERMS] for each in group.values()]
    scale = signed_axis(rows[0], "x", _above_rounding(np.array(every)))
    _show_whiskers(rows[0], group)
    rows[-1].set_xlabel("part of the variance" + (f"   ({scale})" if scale else ""))
    for row in rows[:-1]:
        row.tick_params(labelbottom=False)
    return figure


def convergence_curves(
    data: Group, *, styles: Mapping[str, LineStyle] | None = None, axes: GivenAxes = None
) -> Figure:
    """Draw variance against n with intervals, fitted lines and rates; faint: n⁻¹.

    Variances that are zero or rounding noise are left out and counted in the legend.

    Parameters
    ----------
    data
        Results of `convergence`, by sampler; of several channels the first is shown.
    styles
        How each sampler is drawn.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, or a variable is missing.
    """
    group = as_group(data, "variance", "variance_ci", "mean", "rate", "rate_ci")
    styles = styles or sampler_styles(list(group))
    names = labels(list(group), 44)
    figure, (panel,) = rows_of(axes, 1, NARROW, 3.1 + 0.17 * (len(group) + 1), grid=True)
    for name, each in group.items():
        _curve(panel, each, styles[name], names[name])
    counts = [int(n) for each in group.values() for n in each["n"].values]
    values = np.concatenate(
        [d["variance_ci"].values[usable_counts(d)].ravel() for d in group.values()]
    )
    count_axis(panel, "x", counts)
    if values.size:
        _reference(panel, group)
        log_axis(panel, "y", float(values.min()), float(values.max()))
    else:
        say(panel, "no variance above rounding noise")
        panel.set_yticks([])
    panel.set(xlabel="number of points n", ylabel="variance")
    legend_below(figure, panel, columns=1)
    return figure


def captured_curves(
    data: Group, *, styles: Mapping[str, LineStyle] | None = None, axes: GivenAxes = None
) -> Figure:
    """Draw predicted over measured variance against the half width of the spectrum.

    Parameters
    ----------
    data
        ``captured_by_half_width(half_width)`` by sampler; of several channels the first is shown.
    styles
        How each sampler is drawn.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, or the variable is missing.
    """
    group = as_group(data, "captured_by_half_width")
    styles = styles or sampler_styles(list(group))
    names = labels(list(group), 40)
    curves = {n: d["captured_by_half_width"].values for n, d in group.items()}
    everything = np.concatenate(list(curves.values()))
    # Half width 0 is the dc term alone: rounding (1e-20) where weights are uniform.
    positive = everything[np.isfinite(everything) & (everything > NEGLIGIBLE)]
    logarithmic = float(positive.max(initial=1.0)) > _LINEAR_TOP
    height = 2.7 + 0.16 * ((len(curves) + 1) // 2)
    figure, (panel,) = rows_of(axes, 1, NARROW, height, grid=True)
    panel.axhline(1.0, color=GRAY, lw=0.9)
    for (name, curve), thickness in zip(curves.items(), line_widths(len(curves)), strict=True):
        style = styles[name]
        shown = np.where(curve > NEGLIGIBLE, curve, np.nan) if logarithmic else curve
        width = group[name]["half_width"].values
        label = names[name] + ("" if np.isfinite(curve).any() else ": no finite prediction")
        panel.plot(width, shown, color=style.color, ls=style.dashes, lw=thickness, label=label)
    if logarithmic:
        log_axis(panel, "y", min(float(positive.min(initial=1.0)), 1.0), float(positive.max()))
    else:
        panel.set_ylim(0.0, max(1.1, 1.08 * float(positive.max(initial=1.0))))
    panel.set(xlabel="half width of the spectrum", ylabel="predicted / measured")
    legend_below(figure, panel)
    return figure


def usable_counts(curve: xr.Dataset) -> Array:
    """Which counts have a variance above rounding noise: bool (n,).

    The floor is that of the fit: a mean of n terms of size |I| is good to a few ulps.
    """
    variance = curve["variance"].values
    floor = (16 * np.finfo(float).eps * np.abs(curve["mean"].values)) ** 2
    return np.asarray(np.isfinite(variance) & (variance > floor))


def _above_rounding(values: Array) -> Array:
    """Values with those set to 0 that are rounding beside the largest of their row."""
    largest = np.max(np.abs(values), axis=1, where=np.isfinite(values), initial=0.0)
    return np.where(np.abs(values) > NEGLIGIBLE * largest[:, None], values, 0.0)


def _term_bars(axes: Axes, data: xr.Dataset, style: LineStyle) -> None:
    values = [float(data[name]) for name in TERMS]
    scale = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    shades = (0.35, 0.35, 0.35, 0.75, 1.0)
    for row, (value, shade) in enumerate(zip(values, shades, strict=True)):
        if math.isfinite(value):
            axes.barh(row, value, 0.68, color=style.color, alpha=shade, linewidth=0)
        note = "infinite: ∫1/p diverges" if math.isinf(value) else number_beside(value, scale)
        axes.annotate(
            note, (1.0, row), xycoords=axes.get_yaxis_transform(), xytext=(4, 0),
            textcoords="offset points", va="center", fontsize=SMALL_SIZE, color=INK,
        )  # fmt: skip
    for row, name in enumerate(TERMS):
        low, high = interval_of(data, name)
        shown = abs(values[row]) > NEGLIGIBLE * scale
        if shown and math.isfinite(low) and math.isfinite(high):
            axes.hlines(row, low, high, INK, lw=1.0)
            axes.vlines([low, high], row - 0.2, row + 0.2, INK, lw=1.0)
    axes.axvline(0.0, color=GRAY, lw=0.7)
    axes.set_yticks(range(5), ["dc", "power", "cross", "sum: predicted", "measured"])
    axes.set_ylim(4.6, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)


def interval_of(data: xr.Dataset, name: str) -> tuple[float, float]:
    """95 % interval of a term; NaN where a result has none."""
    low, high = data[f"{name}_ci"].values if f"{name}_ci" in data else (math.nan, math.nan)
    return float(low), float(high)


def _show_whiskers(axes: Axes, group: Mapping[str, xr.Dataset]) -> None:
    """Make room for the ends of intervals, but no more than as much again as the bars take."""
    ends = np.array([interval_of(each, name) for each in group.values() for name in TERMS])
    finite = ends[np.isfinite(ends)]
    low, high = axes.get_xlim()
    reach = high - low
    axes.set_xlim(
        max(min(low, 1.05 * float(finite.min(initial=0.0))), low - reach),
        min(max(high, 1.05 * float(finite.max(initial=0.0))), high + reach),
    )


def _curve(axes: Axes, data: xr.Dataset, style: LineStyle, name: str) -> None:
    used = usable_counts(data)
    n, variance = data["n"].values[used].astype(float), data["variance"].values[used]
    low, high = data["variance_ci"].values[used].T
    slope = float(data["rate"])
    text = rate(slope, *(float(end) for end in data["rate_ci"].values))
    label = f"{name}  {text}" if text != MISSING else f"{name}  (no rate)"
    if not used.all():
        label += f"; {int((~used).sum())} of {used.size} at rounding level"
    axes.errorbar(
        n, variance, yerr=np.maximum([variance - low, high - variance], 0.0),
        fmt=style.marker, ms=3.6, color=style.color, elinewidth=0.8, capsize=1.5,
        capthick=0.8, label=label, zorder=3,
    )  # fmt: skip
    if math.isfinite(slope):
        x, y = fitted_line(data, used, slope)
        axes.plot(x, y, color=style.color, ls=style.dashes, lw=1.0, zorder=2)


def fitted_line(data: xr.Dataset, used: Array, slope: float) -> tuple[Array, Array]:
    """Ends of the fitted line: through the fit's weighted centre, with its slope."""
    last = int(data.attrs.get("fit_last", used.size))
    fitted = used & (np.arange(used.size) >= used.size - last)
    x, y = np.log(data["n"].values[fitted]), np.log(data["variance"].values[fitted])
    low, high = np.log(data["variance_ci"].values[fitted]).T
    weight = (2 * CONFIDENCE_Z / np.maximum(high - low, 1e-12)) ** 2
    centre, level = np.average(x, weights=weight), np.average(y, weights=weight)
    ends = x[[0, -1]]
    return np.exp(ends), np.exp(level + slope * (ends - centre))


def _reference(axes: Axes, group: Mapping[str, xr.Dataset]) -> None:
    """Draw n⁻¹ through the largest variance at the smallest n."""
    starts = [
        (int(d["n"].values[i]), float(d["variance"].values[i]))
        for d in group.values()
        for i in np.flatnonzero(usable_counts(d))[:1]
    ]
    n, variance = max(starts, key=lambda start: start[1] * start[0])
    ends = np.array([min(int(d["n"].values[0]) for d in group.values()),
                     max(int(d["n"].values[-1]) for d in group.values())])  # fmt: skip
    if ends[0] == ends[1]:
        return
    axes.plot(ends, variance * n / ends, color=GRAY, lw=0.8, ls=(0, (1, 2)), zorder=1,
              label="n⁻¹, the rate of random sampling")  # fmt: skip
