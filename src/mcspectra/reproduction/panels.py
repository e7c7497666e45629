"""Panels that exhibits share: variances against N, maps over frequency, unit squares, and terms."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import xarray as xr
from scipy.optimize import isotonic_regression

from mcspectra.core.checks import Array
from mcspectra.plots.description import (
    Axis,
    BarChart,
    Dots,
    Heatmap,
    Line,
    Mark,
    Panel,
    Plot,
    ReferenceLine,
    Scale,
    Segments,
    TextMark,
)
from mcspectra.plots.scales import count_axis, log_axis, name_axis, signed_scale, unit_panel
from mcspectra.plots.style import (
    FAINT,
    GRAY,
    INK,
    MARKERS,
    PALETTE,
    TERM_COLORS,
    line_widths,
)
from mcspectra.plots.text import number
from mcspectra.reproduction.claims import Measured

__all__ = [
    "AXES",
    "at_ring",
    "frequency_panel",
    "in_columns",
    "interval_panel",
    "matrix_panel",
    "plot_of",
    "primary_panel",
    "ring_mean",
    "slope_labels",
    "strata",
    "term_panel",
    "variance_panel",
    "whiskers",
]

AXES: tuple[Literal["x", "y"], ...] = ("x", "y")

_TERMS = {"dc_term": "1st", "power_term": "2nd", "cross_term": "3rd", "predicted_variance": "sum"}
_RESOLUTION = 256
# Lengths as fractions of an axis: two lines look the same if they are closer than _COINCIDENT.
# _WIDE and _TALL are the width and the height of a label that shows the slope of a line.
# _GAP is the distance of a label from lines and markers.
# Distances above _FREE count as equally good when the place of a label is chosen.
_COINCIDENT, _WIDE, _TALL, _GAP, _FREE = 0.02, 0.27, 0.07, 0.035, 0.1
_END_GAP = 0.11  # least distance between slopes that are written to the right of their lines
# A variance term counts as a rounding error if it is smaller than this share of the largest term.
_ROUNDING = 1e-12


# Color scale for matrices of f(x) = x with 16 points. It covers four decades of each sign
_ENTRIES = signed_scale("conj(f_m) f_l C_ml", [np.array([-1e-4, 1e-8, 1e-4])], decades=4)


def whiskers(x: Array, y: Array, ends: Array, k: int, label: str, size: float = 4.0) -> Dots:
    """Return dots with intervals (…, 2) in color and marker number k."""
    return Dots(
        x=np.asarray(x, float), y=y, low=ends[..., 0], high=ends[..., 1],
        color=PALETTE[k], marker=MARKERS[k], size=size, label=label,
    )  # fmt: skip


def variance_panel(
    curves: Mapping[str, xr.Dataset],
    *,
    exact: Mapping[str, Array] | None = None,
    rates: Mapping[str, float] | None = None,
    relative: bool = False,
    title: str = "",
    x: str = "number of points N",
    limits: tuple[float, float] | None = None,
    letters: float = 1.0,
    beside: float = 0.0,
    first: int = 0,
) -> Panel:
    """Return measured variances with 95 % intervals against N, and exact and theoretical lines.

    Parameters
    ----------
    curves
        Results of `mcspectra.convergence` for one estimator and sampler, by label.
        Colors and markers are assigned to the labels in this order.
    exact
        Exact variances at the same counts, for labels where they are known.
    rates
        Theoretical rates, for labels where they are known. They are drawn as dashed lines.
        Each line goes through the last exact variance, or else through the last measured variance.
        Lines have a label with their slope: the theoretical rate, or else the slope of `exact`.
    relative
        Whether variances are divided by the squared mean at the largest N.
    title, x
        Title of the panel and label of the x axis.
    limits
        Limits of the variance axis. Default: the limits of the data.
    letters
        Size of the labels of slopes, relative to the panel.
        The size is 1 in figures with two panels side by side.
    beside
        Room to the right of the lines, relative to the length of the lines.
        If the room is not 0, slopes are written into it, so that they cover no line or marker.
    first
        Number of the first color and marker.
    """
    marks: list[Mark] = []
    values: list[float] = []
    counts: set[int] = set()
    widths = line_widths(len(curves))
    lines: list[tuple[Array, float, str]] = []
    dots: list[Array] = []
    for k, (label, curve) in enumerate(curves.items(), first):
        scale = float(curve["mean"][-1]) ** -2 if relative else 1.0
        n, ends = curve["n"].values.astype(float), scale * curve["variance_ci"].values
        line = (exact or {}).get(label)
        if line is not None:
            marks.append(Line(x=n, y=line, color=PALETTE[k], width=widths[k - first], label=label))
        last = scale * float(curve["variance"][-1]) if line is None else line[-1]
        if label in (rates or {}):
            theory = last * (n / n[-1]) ** (rates or {})[label]
            marks.append(Line(x=n, y=theory, color=PALETTE[k], dashes="--", width=1.0))
            values += [*theory]
            lines.append((theory, (rates or {})[label], PALETTE[k]))
        elif line is not None:
            lines.append((line, float(np.polyfit(np.log(n), np.log(line), 1)[0]), PALETTE[k]))
        marks.append(whiskers(n, scale * curve["variance"].values, ends, k, label))
        dots.append(scale * curve["variance"].values)
        values += [*ends.ravel(), *([] if line is None else line)]
        counts |= {int(v) for v in n}
    low, high = limits or (min(values), max(values))
    y = "variance / mean²" if relative else "variance"
    x_axis, y_axis = count_axis(x, counts, most=5), log_axis(y, low, high, most=5)
    if lines and beside:
        length = max(counts) / min(counts)
        marks += _end_slopes(lines, max(counts) * length**0.06, math.log(high / low))
        x_axis = replace(
            count_axis(x, counts, most=round(2 / beside)), high=max(counts) * length**beside
        )
    elif lines:
        marks += slope_labels(n, lines, (low, high), dots, letters)
    return Panel(marks=tuple(marks), x=x_axis, y=y_axis, title=title, grid=True)


def slope_labels(
    n: Array,
    lines: Sequence[tuple[Array, float, str]],
    limits: tuple[float, float],
    others: Sequence[Array] = (),
    letters: float = 1.0,
) -> list[TextMark]:
    """Label falling lines with their slopes, above or below them, where no line is in the way.

    Each of the `lines` is given by its variances, its slope and its color.
    The variance axis has the limits `limits`.
    Labels also do not cover the markers at the variances `others`.
    The size of the labels is multiplied by `letters`.
    Lines that coincide have one label, in black. A line without room has no label.
    """
    reach, wide, tall = math.log(limits[1] / limits[0]), _WIDE * letters, _TALL * letters
    u = np.log(n / n[0]) / math.log(n[-1] / n[0])
    with np.errstate(divide="ignore"):
        paths = [np.log(np.asarray(y) / limits[0]) / reach for y, _, _ in lines]
        beside = [np.log(np.asarray(y) / limits[0]) / reach for y in others]
    found = list[TextMark]()
    done = list[Array]()
    boxes = list[tuple[float, float]]()
    for k in np.argsort([-path.mean() for path in paths], kind="stable").tolist():
        same = [bool(np.abs(path - paths[k]).max() < _COINCIDENT) for path in paths]
        if any(np.abs(path - paths[k]).max() < _COINCIDENT for path in done):
            continue
        best, place = -math.inf, (0.0, 0.0)
        for left in np.linspace(0.0, 1.0 - wide, 16):
            across = np.linspace(left, left + wide, 9)
            own = np.interp(across, u, paths[k])
            away = [np.interp(across, u, path) for path in (*paths, *beside)]
            for below, height in (
                (0, own.max() + _GAP + tall / 2),
                (1, own.min() - _GAP - tall / 2),
            ):
                room = [np.abs(path - height).min() - tall / 2 for path in away]
                room += [abs(v - height) - tall for x, v in boxes if abs(x - left) < wide]
                room += [1.0 - tall / 2 - height + _GAP, height - tall / 2 + _GAP]
                if min(room) < 0.6 * _GAP:
                    continue
                score = min(*room, _FREE) - 0.1 * abs(left + wide / 2 - 0.5) - 0.01 * below
                if score > best:
                    best, place = score, (float(left), float(height))
        if best == -math.inf:
            continue
        _, rate, color = lines[k]
        boxes.append(place)
        done.append(paths[k])
        found.append(
            TextMark(
                x=float(n[0] * (n[-1] / n[0]) ** (place[0] + wide / 2)),
                y=limits[0] * math.exp(place[1] * reach),
                text=f"slope {number(rate, 2)}",
                color=INK if sum(same) > 1 else color,
                side="middle",
            )
        )
    return found


def _end_slopes(
    lines: Sequence[tuple[Array, float, str]], x: float, reach: float
) -> list[TextMark]:
    """Write the slopes of lines next to their last points.

    Labels keep a distance, and are otherwise as close to their lines as possible.
    """
    lines = sorted(lines, key=lambda line: -line[0][-1])
    ends = np.log([y[-1] for y, _, _ in lines])
    steps = _END_GAP * reach * np.arange(len(lines))
    places = isotonic_regression(ends + steps, increasing=False).x - steps
    return [
        TextMark(x=x, y=math.exp(place), text=f"slope {number(rate, 2)}", color=color)
        for (_, rate, color), place in zip(lines, places, strict=True)
    ]


def at_ring(spectrum: xr.Dataset, ring: int, scale: float) -> Measured:
    """Return the radial mean power at |m| ≈ `ring`, multiplied by the factor `scale`."""
    row = spectrum.isel(radius=ring - 1)
    return Measured.normal(
        scale * float(row["radial_power"]), scale * float(row["radial_power_se"])
    )


def ring_mean(power: Callable[[Array], Array], half_width: int, ring: int) -> float:
    """Return the mean power over the 2-D frequencies whose length |m| rounds to `ring`."""
    side = np.arange(-half_width, half_width + 1)
    m = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    return float(power(m[np.rint(np.hypot(m[:, 0], m[:, 1])) == ring]).mean())


def frequency_panel(values: Array, scale: Scale, title: str, *, y: bool = True) -> Panel:
    """Return a map of values (m₀, m₁) at frequencies −K … K without 0. `y` labels the m₁ axis."""
    half = len(values) // 2
    shown = np.array(values, float)
    shown[half, half] = np.nan
    side = np.arange(-half, half + 1.0)
    ticks = {float(v): number(float(v), 2 if half < 100 else 3) for v in (-half, 0, half)}
    image = Heatmap(values=shown.T, x=side, y=side, scale=scale, name="power")
    return Panel(
        marks=(image,),
        x=Axis(label="m₀ (cycles per unit)", ticks=ticks),
        y=Axis(label="m₁ (cycles per unit)" if y else "", ticks=ticks),
        title=title,
        square=True,
    )


def strata(side: int) -> tuple[ReferenceLine, ...]:
    """Return the borders of side × side strata of the unit square."""
    places = (np.arange(1, side) / side).tolist()
    return tuple(
        ReferenceLine(at=at, axis=axis, color=FAINT, width=0.7) for axis in AXES for at in places
    )


def primary_panel(integrand: Callable[[Array], Array], title: str) -> Panel:
    """Return a map of an integrand on the unit square, divided by its mean."""
    u = (np.arange(_RESOLUTION) + 0.5) / _RESOLUTION
    values = np.asarray(integrand(np.stack(np.meshgrid(u, u), axis=-1)))
    shown = values / values.mean()
    scale = Scale(label="f/p (over its mean)", high=float(shown.max()))
    image = Heatmap(values=shown, x=u, y=u, scale=scale, name="f/p over its mean")
    return unit_panel([image], title, "u₀", "u₁")


def plot_of(kind: str, *panels: Panel) -> Plot:
    """Return a plot. ``slides.toml`` contains its layout."""
    return Plot(kind=kind, panels=panels)


def matrix_panel(title: str, values: Array, *, y: bool = True) -> Panel:
    """Return a map of conj(f_m) f_l C_ml over m and l, without the entry at m = l = 0."""
    half = len(values) // 2
    side = np.arange(-half, half + 1.0)
    ticks = {float(v): number(float(v), 2) for v in (-half, 0, half)}
    image = Heatmap(values=values, x=side, y=side, scale=_ENTRIES, name="entry")
    return Panel(
        marks=(image,),
        x=Axis(label="l (cycles per unit)", ticks=ticks),
        y=Axis(label="m (cycles per unit)" if y else "", ticks=ticks),
        title=title,
        square=True,
    )


def in_columns(plot: Plot, first: int = 0) -> Plot:
    """Put the two panels of each sampler into one column; `first` (0 or 1) is the upper panel."""
    panels = (*plot.panels[first::2], *plot.panels[1 - first :: 2])
    return replace(plot, panels=panels, columns=len(panels) // 2, wide=True)


def interval_panel(
    rows: Mapping[str, Sequence[Measured]],
    labels: Sequence[str],
    x: str,
    at: float | None = None,
    *,
    ratio: bool = False,
) -> Panel:
    """Return a panel with one row for each name, and one horizontal interval for each label.

    With `ratio`, the axis is logarithmic.
    """
    marks: list[Mark] = (
        [] if at is None else [ReferenceLine(at=at, axis="x", color=INK, dashes="--")]
    )
    for k, label in enumerate(labels):
        found = [row[k] for row in rows.values()]
        away = 0.26 * (k - (len(labels) - 1) / 2)
        value, low, high = np.array([(each.value, each.low, each.high) for each in found]).T
        marks.append(
            Dots(
                x=value, y=np.arange(len(found)) + away, low=low, high=high, across=True,
                color=PALETTE[k], marker=MARKERS[k], size=5.0, label=label,
            )
        )  # fmt: skip
        if ratio:
            marks += [
                TextMark(x=each.high, y=place + away, text=number(each.value, 3), color=PALETTE[k])
                for place, each in enumerate(found)
            ]
    every = [each for row in rows.values() for each in row]
    high = max(each.high for each in every)
    axis = Axis(label=x, low=0.0, high=1.08 * high)
    if ratio:
        axis = log_axis(x, 0.9 * min(each.low for each in every), 1.6 * high)
    return Panel(marks=tuple(marks), x=axis, y=name_axis(list(rows)), grid=True)


def term_panel(
    terms: Sequence[float],
    variance: Measured,
    scale: float,
    title: str,
    y: str = "",
    *,
    digits: int = 3,
) -> Panel:
    """Return a waterfall of the three terms and their sum, beside the measured variance.

    All values are divided by `scale`. The measured variance has its 95 % interval.
    All numbers have the same number of decimals, so that the printed terms can be added.
    The largest number has `digits` significant digits.
    """
    value = np.array([*terms, sum(terms), variance.value]) / scale
    largest = np.abs(value).max()
    decimals = max(digits - 1 - math.floor(math.log10(largest)), 0)
    texts = [_decimal(v, decimals, _ROUNDING * largest) for v in value]
    at, base = np.arange(5.0), np.zeros(5)
    base[1:3] = np.cumsum(value[:2])
    value += base
    colors = [TERM_COLORS[name] for name in (*_TERMS, "measured_variance")]
    bars = BarChart(at=at, value=value, base=base, color=colors, thickness=0.72)
    ends = np.array([variance.low, variance.high]) / scale
    interval = Dots(x=at[4:], y=value[4:], low=ends[:1], high=ends[1:], color=INK, size=2.0)
    steps = [[[k, value[k]], [k + 1.0, value[k]]] for k in range(3)]
    joints = Segments(ends=np.array(steps), color=GRAY, width=0.6)
    tops = np.maximum(base, value)
    tops[4] = ends[1]
    above = (
        TextMark(x=float(place), y=float(end), text=text, side="above")
        for place, end, text in zip(at, tops, texts, strict=True)
    )
    bottom, top = min(value.min(), 0.0), max(tops.max(), 0.0)
    room = top - bottom
    names = (*_TERMS.values(), "Var")
    return Panel(
        marks=(joints, bars, interval, ReferenceLine(at=0.0, color=INK, width=0.7), *above),
        x=Axis(low=-0.6, high=4.6, ticks=dict(zip(at.tolist(), names, strict=True))),
        y=Axis(label=y, low=bottom - 0.05 * room * (bottom < 0), high=top + 0.17 * room),
        title=title,
    )


def _decimal(value: float, decimals: int, rounding: float) -> str:
    """Format a number with fixed decimals; a number that they would hide has two digits."""
    if abs(value) <= rounding:
        return "0"
    if abs(value) < 0.5 * 10.0**-decimals:
        return number(value, 2)
    return f"{value:.{decimals}f}".replace("-", "−")
