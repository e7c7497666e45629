"""Curves to look into: variance against n, power against the length of the frequency."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.estimators.moments import CONFIDENCE_Z
from mcspectra.report.axes import far_apart
from mcspectra.report.figures.groups import Group, as_group, frequency_dims
from mcspectra.report.figures.spectra import power_label, random_level, without_dc
from mcspectra.report.figures.variance import fitted_line, usable_counts
from mcspectra.report.formatting import MISSING, interval, number, rate
from mcspectra.report.interactive.frame import (
    BOKEH_DASHES,
    BOKEH_MARKERS,
    INK,
    add_hover,
    in_words,
    legend_below,
    new_plot,
    plot_color,
    set_log_ticks,
    set_ticks,
)
from mcspectra.report.style import LineStyle, line_widths, sampler_styles
from mcspectra.report.words import for_each, low_power_words, rate_words

if TYPE_CHECKING:
    import xarray as xr
    from bokeh.models.renderers import GlyphRenderer
    from bokeh.plotting import figure

__all__ = ["convergence_plot", "radial_plot", "spectrum_lines"]

_FLOOR = 1e-4  # n · power shown at least: below it a set is as good as free of noise
_DIGITS = 6
_LINEAR_TOP = 12.0

Renderers = dict[str, list["GlyphRenderer[Any]"]]


def convergence_plot(data: Group, *, styles: Mapping[str, LineStyle] | None = None) -> figure:
    """Plot variance against n with intervals and fitted lines; dotted: n⁻¹ of random sampling.

    Variances that are zero or rounding noise have no place on the logarithmic axis.

    Parameters
    ----------
    data
        Results of `convergence`, by sampler; of several channels the first is shown.
    styles
        How each sampler is drawn.

    Raises
    ------
    ParameterError
        Nothing to draw, or a variable is missing.
    """
    group = as_group(data, "variance", "variance_ci", "mean", "rate", "rate_ci")
    styles = styles or sampler_styles(list(group))
    plot = new_plot("number of points n", "variance", x_axis_type="log", y_axis_type="log")
    entries = {name: _curve(plot, name, each, styles[name]) for name, each in group.items()}
    reference = _reference(plot, group)
    if reference is not None:
        entries["n⁻¹, the rate of random sampling"] = [reference]
    _curve_ticks(plot, group)
    legend_below(plot, entries, {name: f": {_rate_text(each)}" for name, each in group.items()})
    words = "Variance against n, both axes logarithmic. " + for_each(group, rate_words)
    return in_words(plot, words)  # type: ignore[no-any-return]


def radial_plot(data: Group, *, styles: Mapping[str, LineStyle] | None = None) -> figure:
    """Plot the mean power over directions against |m| in units of n^(1/d), both logarithmic.

    Parameters
    ----------
    data
        ``radial_power(radius)`` by sampler, with attribute ``n`` and the dims m0, m1, …
    styles
        How each sampler is drawn.

    Raises
    ------
    ParameterError
        Nothing to draw, or a variable is missing.
    """
    group = as_group(data, "radial_power", "power")
    styles = styles or sampler_styles(list(group))
    dims = len(frequency_dims(next(iter(group.values()))))
    root = {1: "n", 2: "√n", 3: "∛n"}.get(dims, f"n^(1/{dims})")
    plot = new_plot(
        f"|m| / {root}", power_label(group.values()), x_axis_type="log", y_axis_type="log"
    )
    sources = {name: _radial_source(name, each) for name, each in group.items()}
    widths = dict(zip(group, line_widths(len(group)), strict=True))
    entries = {n: _line(plot, source, styles[n], widths[n]) for n, source in sources.items()}
    _finish_power(plot, entries, "|m|")
    for axis, column in ((plot.xaxis, "x"), (plot.yaxis, "y")):
        every = np.concatenate([source[column] for source in sources.values()])
        set_log_ticks(axis, float(every.min(initial=np.inf)), float(every.max(initial=0.0)))
    words = "Mean power against the length of the frequency. " + for_each(group, low_power_words)
    return in_words(plot, words)  # type: ignore[no-any-return]


def _radial_source(name: str, data: xr.Dataset) -> dict[str, Any]:
    """Columns of the radial mean: |m| / n^(1/d), n · power over that of random points."""
    n, radius = int(data.attrs["n"]), data["radius"].values
    power = n / random_level(data) * data["radial_power"].values
    there = (radius > 0) & np.isfinite(power)
    length = radius[there] / n ** (1 / len(frequency_dims(data)))
    return _power_source(name, length, power[there], radius[there])


def spectrum_lines(group: Mapping[str, xr.Dataset], styles: Mapping[str, LineStyle]) -> figure:
    """Plot one-dimensional spectra over m; dc is left out."""
    curves = {name: (each["m0"].values, without_dc(each, 1)) for name, each in group.items()}
    top = max(float(np.nanmax(y, initial=1.0)) for _, y in curves.values())
    scale = "log" if top > _LINEAR_TOP else "linear"
    plot = new_plot("frequency m", power_label(group.values()), y_axis_type=scale)
    widths = line_widths(len(group))
    entries: Renderers = {}
    for (name, (m, power)), width in zip(curves.items(), widths, strict=True):
        source = _power_source(name, m, power, m, _power_errors(group[name]))
        entries[name] = _line(plot, source, styles[name], width)
    _finish_power(plot, entries, "m")
    return plot


def _finish_power(plot: figure, entries: Renderers, frequency: str) -> None:
    """Add the level of random points, what the pointer shows, and the legend."""
    from bokeh.models.annotations import Span

    plot.add_layout(Span(location=1.0, dimension="width", line_color=INK, line_width=1))
    lines = [line for each in entries.values() for line in each]
    rows = {"sampler": "name", frequency: "frequency", "power": "text"}
    add_hover(plot, lines, rows)
    legend_below(plot, entries)


def _power_source(
    name: str, x: Array, power: Array, frequency: Array, errors: Array | None = None
) -> dict[str, Any]:
    half = np.zeros_like(power) if errors is None else CONFIDENCE_Z * errors
    spread = [f" ± {number(h, 2)}" if h > 0 else "" for h in half]
    return {
        "x": x,
        "y": np.maximum(power, _FLOOR),
        "frequency": [number(float(m), _DIGITS) for m in frequency],
        "text": [number(float(p), 4) + s for p, s in zip(power, spread, strict=True)],
        "name": [name] * len(x),
    }


def _power_errors(data: xr.Dataset) -> Array | None:
    """Standard errors of n · power over that of random points, where the result has them."""
    if "power_se" not in data:
        return None
    scale = int(data.attrs["n"]) / random_level(data)
    return np.asarray(scale * data["power_se"].values)


def _line(
    plot: figure, source: dict[str, Any], style: LineStyle, width: float
) -> list[GlyphRenderer[Any]]:
    from bokeh.models import ColumnDataSource

    line = plot.line(
        "x", "y", source=ColumnDataSource(source), color=plot_color(style),
        line_dash=BOKEH_DASHES[style.dashes], line_width=width,
    )  # fmt: skip
    return [line]


def _rate_text(data: xr.Dataset) -> str:
    text = rate(float(data["rate"]), *(float(end) for end in data["rate_ci"].values))
    used = usable_counts(data)
    note = "" if used.all() else f"; {int((~used).sum())} of {used.size} at rounding level"
    return (text if text != MISSING else "(no rate)") + note


def _curve(plot: figure, name: str, data: xr.Dataset, style: LineStyle) -> list[GlyphRenderer[Any]]:
    """Draw points, whiskers and the fitted line of one sampler."""
    from bokeh.models import ColumnDataSource

    used = usable_counts(data)
    source = ColumnDataSource(_curve_source(name, data, used))
    color = plot_color(style)
    drawn: list[GlyphRenderer[Any]] = [
        plot.scatter(
            "n", "variance", source=source, marker=BOKEH_MARKERS[style.marker], size=8, color=color
        ),
        plot.segment("n", "low", "n", "high", source=source, color=color, line_width=1.5),
    ]
    slope = float(data["rate"])
    if math.isfinite(slope):
        x, y = fitted_line(data, used, slope)
        drawn.append(
            plot.line(x, y, color=color, line_dash=BOKEH_DASHES[style.dashes], line_width=1.5)
        )
    rows = {"sampler": "name", "n": "n", "variance": "text", "95 %": "interval", "rate": "rate"}
    add_hover(plot, drawn[:1], rows)
    return drawn


def _curve_ticks(plot: figure, group: Mapping[str, xr.Dataset]) -> None:
    """Put ticks at the counts themselves, as far as their labels do not touch."""
    counts = sorted({int(n) for each in group.values() for n in each["n"].values})
    set_ticks(plot.xaxis, {n: str(n) for n in far_apart(counts, 8)})
    # With the ends of intervals: a single variance has no range to put ticks into.
    names = ("variance", "variance_ci")
    values = [d[name].values[usable_counts(d)].ravel() for d in group.values() for name in names]
    every = np.concatenate(values)
    every = every[np.isfinite(every) & (every > 0.0)]
    set_log_ticks(plot.yaxis, float(every.min(initial=np.inf)), float(every.max(initial=0.0)))


def _curve_source(name: str, data: xr.Dataset, used: Array) -> dict[str, Any]:
    n, variance = data["n"].values[used], data["variance"].values[used]
    low, high = data["variance_ci"].values[used].T
    return {
        "n": n,
        "variance": variance,
        "low": np.maximum(low, np.finfo(float).tiny),
        "high": high,
        "text": [number(float(v), _DIGITS) for v in variance],
        "interval": [interval(float(a), float(b), 4) for a, b in zip(low, high, strict=True)],
        "rate": [_rate_text(data)] * len(n),
        "name": [name] * len(n),
    }


def _reference(plot: figure, group: Mapping[str, xr.Dataset]) -> GlyphRenderer[Any] | None:
    """Draw n⁻¹ through the noisiest start, from the smallest to the largest n."""
    starts = [
        float(d["n"].values[i]) * float(d["variance"].values[i])
        for d in group.values()
        for i in np.flatnonzero(usable_counts(d))[:1]
    ]
    counts = np.concatenate([d["n"].values for d in group.values()]).astype(float)
    ends = np.array([counts.min(), counts.max()])
    if not starts or ends[0] == ends[1]:
        return None
    return plot.line(ends, max(starts) / ends, color=INK, line_dash="dotted", line_width=1)
