"""Plots of variances: against n, by term, method, technique or axis, and of remedies."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array
from mcspectra.core.confidence import CONFIDENCE_Z
from mcspectra.plots.description import (
    Axis,
    BarChart,
    Dots,
    Line,
    Mark,
    Panel,
    Plot,
    ReferenceLine,
    Segments,
    TextMark,
)
from mcspectra.plots.groups import (
    Group,
    Styles,
    abreast,
    for_each,
    intervals,
    lines_of,
    not_finite,
    numbers,
    shared,
)
from mcspectra.plots.scales import (
    count_axis,
    linear_axis,
    log_axis,
    name_axis,
    scaled_axis,
    signed_axis,
    whole_ticks,
)
from mcspectra.plots.style import (
    ACCENT,
    GRAY,
    INK,
    MARKERS,
    PALETTE,
    TERM_COLORS,
    LineStyle,
    labels,
    sampler_styles,
)
from mcspectra.plots.text import MISSING, NEGLIGIBLE, number, number_beside, percent, rate, shorten

__all__ = [
    "BELOW_ROUNDING",
    "anova",
    "below_rounding",
    "captured",
    "convergence",
    "estimates",
    "needed_samples",
    "overlaid",
    "prediction",
    "remedies",
    "shares",
    "task_curves",
    "technique_rates",
    "techniques",
    "terms",
    "usable_counts",
    "waterfall",
]

_OPEN = 2.0  # least visible length of an interval without upper end, as a factor
_TERMS = {
    "dc_term": "dc",
    "power_term": "power",
    "cross_term": "cross",
    "predicted_variance": "sum",
    "measured_variance": "measured",
}
_PARTS = 3  # number of terms (dc, power and cross) drawn before their sum
_LEAST_SHOWN = 1e-3  # smallest lower end of an interval that is drawn, relative to the value
_WIDE = 1.25  # the interval of a planned n is shown if its ends differ by more than this factor
_LINEAR_TOP = 4.0  # largest ratio predicted/measured that is shown on a linear axis
# Height of a line of text and width of a letter, as fractions of the size of a large panel
_TEXT_LINE, _TEXT_LETTER = 0.06, 0.018
_MOST_BINS = 60  # largest number of bars of a histogram; narrower bars would not be visible
_SMALLER = 2.1  # panels of small pictures are smaller by this factor
_BEYOND = 100.0  # largest factor by which the axis of ratios extends beyond the ratios
_VERDICTS = {"better": "#009E73", "worse": ACCENT, "given": INK}
BELOW_ROUNDING = "below rounding"
"""Text instead of a rate, for a curve whose variances are all at rounding level."""

_CURVE = ("variance", "variance_ci", "rate", "rate_ci")
_GUIDES = 3  # largest number of guide lines for slopes
_GUIDE_GAP = 0.11  # least distance between labels of slopes, relative to the height of the panel
_GUIDE_ROOM = 0.14  # part of the width of a small panel that is free for labels of slopes
_PREDICTED = ("predicted_variance", "predicted_variance_ci")


def convergence(group: Group, styles: Styles, *, small: bool = False) -> Plot:
    """Plot variance against n with intervals, fitted lines, rates and a dotted line n⁻¹.

    Variances that are not finite, zero or at rounding level are omitted. The legend counts them.
    If a result has `predicted_variance`, the predictions are shown as crosses.
    For a bench, there is a panel for each integrand.
    """
    if all("points_made" in each for each in group.values()):
        return _bench_curves(group)
    names = labels(list(group), 44)
    curves = [
        mark for name, each in group.items() for mark in _curve(each, styles[name], names[name])
    ]
    predicted = {name: each for name, each in group.items() if "predicted_variance" in each}
    for name, each in predicted.items():
        curves += _prediction_marks(each, styles[name], names[name])
    # Draw a line of the rate n⁻¹ through the largest variance at the smallest n
    starts = [
        float(d["n"].values[i]) * float(d["variance"].values[i])
        for d in group.values()
        for i in np.flatnonzero(usable_counts(d))[:1]
    ]
    counts = np.concatenate([each["n"].values for each in group.values()]).astype(float)
    at, label = np.array([counts.min(), counts.max()]), "n⁻¹, the rate of random sampling"
    if starts and at[0] < at[1]:
        y = max(starts) / at
        curves.insert(0, Line(x=at, y=y, color=GRAY, dashes=":", width=0.8, label=label))
    left_out = any(not usable_counts(each).all() for each in group.values())
    panel = _variance_panel(curves, group.values())
    return Plot(
        panels=(_with_slopes(panel, group, styles, small=small),),
        caption="Variance against the number of points, with 95 % intervals"
        + (
            ", fitted lines and rates. The dotted line has the rate of random sampling."
            if any(isinstance(mark, Line) for mark in curves)
            else "."
        )
        + (
            " Crosses are predictions with 95 % intervals; dash-dotted lines have theory's slope."
            if predicted
            else ""
        )
        + (
            " Variances that are not finite, zero or at rounding level are omitted."
            if left_out
            else ""
        ),
        words="Logarithmic plot of variance against n. " + for_each(group, _rate_words),
    )


def overlaid(measured: Group, predicted: Group) -> dict[str, xr.Dataset]:
    """Add the predictions of the same samplers to results of `convergence`.

    The plot ``convergence`` then shows the predictions and the theoretical slope as well.
    The counts of the two results may differ.
    If there are several methods, the most trusted with a value at the largest n is used.
    """
    both = dict(measured)
    for name in set(measured) & set(predicted):
        each = predicted[name]
        if "method" in each.dims:
            there = each["predicted_variance"].isel(n=-1).notnull().values
            each = each.isel(method=int(np.argmax(there)))
        kept = [key for key in ("limit_rate", *_PREDICTED) if key in each]
        each = each[kept].drop_vars(["method", "how"], errors="ignore")
        both[name] = both[name].assign(each.rename(n="predicted_n"))
    return both


def _bench_curves(group: Group) -> Plot:
    """Plot the variances of a bench, with a panel for each integrand."""
    tasks: dict[str, dict[str, xr.Dataset]] = {}
    for each in group.values():
        made = each.dropna("n", subset=["variance"])
        made = made.assign_coords(n=made["points_made"].values.astype(int))
        made = made.isel(n=np.unique(made["n"].values, return_index=True)[1])
        if made.sizes["n"]:
            name, title = (str(each[key].item()) for key in ("label", "integrand"))
            tasks.setdefault(title, {})[name] = made
    names = dict.fromkeys(name for task in tasks.values() for name in task)
    return task_curves(tasks, sampler_styles(list(names)))


def task_curves(
    tasks: Mapping[str, Group],
    styles: Styles,
    *,
    by: str = "on each integrand",
    x: str = "number of points n",
    alike: bool = False,
) -> Plot:
    """Plot variance against n, with a panel per task and a line per sampler.

    If `alike` is true, all panels have the same axes.
    """
    styled = {
        title: {shorten(name): (each, styles[name]) for name, each in curves.items()}
        for title, curves in tasks.items()
    }
    parts = [styled] if alike else [{title: curves} for title, curves in styled.items()]
    made = [_curve_panels(part, x, joined=True) for part in parts]
    panels = [panel for few, _ in made for panel in few]
    if not alike:
        panels = [
            _with_slope_guides(panel, [data for data, _ in curves.values()])
            for panel, curves in zip(panels, styled.values(), strict=True)
        ]
    guides = "" if alike else " Dotted lines are guides with the slopes at their ends."
    return Plot(
        panels=tuple(panels),
        kind="task-curves",
        columns=2 if alike else 3,
        caption=f"Variance against n {by}, with 95 % intervals.{guides}",
        words=" ".join(said for _, said in made),
        height=0.62 if alike else 0.8,
        share=shared(panels) if panels else "",
        wide=True,
    )


def prediction(group: Group, styles: Styles) -> Plot:
    """Plot predicted variances against n with rates and kinks, or by method at the largest n."""
    if any("method" in each.dims for each in group.values()):
        return _by_method(group, styles)
    caption = (
        "Predicted variance against the number of points, with 95 % intervals, the rate over these "
        "counts and its limit at large n. Dashed lines mark the n at which the rate changes."
    )
    if all("planned_n" in each for each in group.values()):
        caption = (
            "Predicted variance against the number of points, with 95 % intervals, and the "
            "smallest n that is predicted to reach the error. The dashed line is the square of the "
            "error."
        )
    return _known_curves(group, styles, "predicted variance", caption)


def _by_method(group: Group, styles: Styles) -> Plot:
    """Plot variances with intervals at the largest n, for all methods that have a value there."""
    last, limits = {}, {}
    for name, each in group.items():
        there = each["predicted_variance"].isel(n=-1).notnull().values
        last[name] = each.isel(n=-1, method=there)
        ends = last[name]["predicted_variance_ci"].transpose("method", "bound").values
        limits[name] = np.where(ends > 0, ends, np.nan)  # a logarithmic axis has no place for 0
    values = [each["predicted_variance"].values for each in last.values()]
    every = np.concatenate([*map(np.ravel, limits.values()), *values])
    axis = log_axis("variance", *_ends(every[every > 0]))
    panels = []
    for name, each in last.items():
        rows, value = each["method"].values.astype(str).tolist(), each["predicted_variance"].values
        dots = Dots(
            x=np.where(value > 0, value, np.nan),
            y=np.arange(float(len(rows))),
            color=styles[name].color,
            marker=styles[name].marker,
            size=5.0,
            low=limits[name][:, 0],
            high=limits[name][:, 1],
            across=True,
            hover={
                "sampler": [name] * len(rows),
                "method": rows,
                "how": each["how"].values.astype(str).tolist(),
                "variance": numbers(value),
                "95 %": intervals(limits[name]),
                "share of ∫f²": [percent(float(s)) for s in each["energy_share"].values],
            },
        )
        panels.append(Panel(marks=(dots,), x=axis, y=name_axis(rows), title=name, grid=True))
    most = max(len(panel.y.ticks or ()) for panel in panels)
    counts = sorted({int(each["n"]) for each in last.values()})
    return Plot(
        panels=tuple(panels),
        columns=min(2, abreast(len(panels))),
        caption=f"The variance at n = {', '.join(map(str, counts))} by each method that applies, "
        "with 95 % intervals. The most trusted method is at the top, the measurement at the "
        "bottom.",
        words="Variances by method. "
        + for_each(last, lambda d: _named_values(d, "method", "predicted_variance")),
        height=0.14 + 0.06 * most,
        share="x",
    )


def profile(group: Group, styles: Styles) -> Plot:
    """Plot the variances of all samplers of a profile, with 95 % intervals."""
    caption = "Variance against the number of points, with 95 % intervals."
    if any("sampler" in each.dims for each in group.values()):  # several profiles
        group = {
            f"{name}: {sampler}": each.sel(sampler=sampler)
            for name, each in group.items()
            for sampler in each["sampler"].values
        }
        styles = sampler_styles(list(group))
    return _known_curves(group, styles, "variance", caption)


def _known_curves(group: Group, styles: Styles, what: str, caption: str) -> Plot:
    """Plot variances of a prediction or a profile against n."""
    variable = what.replace(" ", "_")
    curves, bands = {}, {}
    for name, each in group.items():
        n, variance = each["n"].values.astype(float), each[variable].values
        there = (variance > 0) & np.isfinite(variance)
        curves[name] = (n[there], variance[there])
        if f"{variable}_ci" in each:
            low, high = each[f"{variable}_ci"].transpose("n", "bound").values[there].T
            least = variance[there] * _LEAST_SHOWN
            bands[name] = {"low": np.maximum(low, least), "high": np.maximum(high, least)}
    notes = {name: "" if n.size else f": no {what}" for name, (n, _) in curves.items()}
    notes |= {name: ": infinite" for name, each in group.items() if np.isinf(each[variable]).any()}
    marks: list[Mark] = []
    for name, each in group.items():
        if "limit_rate" in each and np.isfinite(each["predicted_rate"]):
            slope, limit, bend = (
                float(each[v]) for v in ("predicted_rate", "limit_rate", "bend_n")
            )
            ends = f", tends to {number(limit)}" if np.isfinite(limit) else ""
            notes[name] = f": rate {number(slope)}{ends}"
            if np.isfinite(bend):
                label = f"the rate changes at n = {bend:.3g}"
                marks.append(
                    ReferenceLine(
                        at=bend, axis="x", color=styles[name].color, dashes="--", label=label
                    )
                )
        if "planned_n" in each and np.isfinite(each["planned_n"]):
            notes[name] = f": n = {int(each['planned_n'])}"
            low, high = each["planned_n_ci"].values if "planned_n_ci" in each else (1.0, 1.0)
            notes[name] += f" ({low:.0f} … {high:.0f})" if high > _WIDE * low else ""
    for name, line in zip(curves, lines_of(curves, styles, ("n", what), notes=notes), strict=True):
        marker = styles[name].marker
        dots = Dots(x=line.x, y=line.y, color=line.color, marker=marker, label=line.label)
        marks += [replace(line, **bands.get(name, {})), dots]
    wanted = [
        np.ravel(each["target_variance"]) for each in group.values() if "target_variance" in each
    ]
    marks += [
        ReferenceLine(
            at=float(at), color=INK, dashes="--", label=f"error², for the RMSE {number(at**0.5)}"
        )
        for at in np.unique(wanted)
    ]
    values = np.concatenate([*(variance for _, variance in curves.values()), *wanted])
    # Use only counts that have values
    shown = np.concatenate([n for n, _ in curves.values()])
    counts = shown.astype(int).tolist() or [int(n) for each in group.values() for n in each["n"]]
    return Plot(
        panels=(
            Panel(
                marks=tuple(marks),
                x=count_axis("number of points n", counts),
                y=log_axis(what, *_ends(values)),
                grid=True,
                note="" if values.size else f"no finite {what}",
            ),
        ),
        caption=caption,
        words=f"Logarithmic plot of {what} against n. "
        + for_each(group, lambda each: ", ".join(numbers(each[variable].values))),
    )


def terms(group: Group, _: Styles) -> Plot:
    """Plot the dc, power and cross terms as a waterfall to their sum, and the measured variance."""
    panels = [waterfall(name, each) for name, each in group.items()]
    return Plot(
        panels=tuple(panels),
        caption="The terms of the variance up to the half width of the spectrum: "
        "dc + power + cross = sum. Each bar begins where the bar above it ends. The measured "
        "variance has all frequencies. Whiskers are 95 % intervals."
        + (" Each panel has its own scale." if len(panels) > 1 else ""),
        words="Bars of the three terms. " + for_each(group, _term_words),
        height=0.24,
    )


def waterfall(title: str, data: xr.Dataset) -> Panel:
    """Return a panel of the terms of one sampler. The axis is linear, to show that they add up.

    Parameters
    ----------
    title
        Title of the panel.
    data
        Result of `mcspectra.variance_terms` for one n. The measured variance is optional.
    """
    rows = {term: label for term, label in _TERMS.items() if term in data}
    values = np.array([float(data[term]) for term in rows])
    size = float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))
    texts = [number_beside(v, size) if math.isfinite(v) else not_finite(v) for v in values]
    # Set values to 0 that are rounding errors compared with the largest value
    values = np.where(np.abs(values) > NEGLIGIBLE * size, values, 0.0)
    parts = np.where(np.isfinite(values[:_PARTS]), values[:_PARTS], 0.0)
    base = np.zeros(len(values))
    base[1:_PARTS] = np.cumsum(parts)[:-1]
    ends = np.array([
        data[f"{term}_ci"].values if f"{term}_ci" in data else [math.nan] * 2 for term in rows
    ])  # fmt: skip
    whiskers = np.where((values != 0)[:, None], ends, np.nan) + base[:, None]

    # Limit the axis to twice the extent of the bars; longer whiskers are cut off
    places = np.concatenate([base, base + np.where(np.isfinite(values), values, 0.0)])
    low, high = float(places.min(initial=0.0)), float(places.max(initial=0.0))
    known = whiskers[np.isfinite(whiskers)]
    room = high - low
    low = min(low, max(float(known.min(initial=0.0)), low - room))
    high = max(high, min(float(known.max(initial=0.0)), high + room))
    panel = _bar_panel(
        title, [TERM_COLORS[term] for term in rows], list(rows.values()), base + values, whiskers,
        texts, scaled_axis("part of the variance", low, high, 5), base=base, said=ends,
    )  # fmt: skip

    # Connect the end of each bar with the start of the next bar
    steps = [np.array([[total, k], [total, k + 1.0]]) for k, total in enumerate(np.cumsum(parts))]
    joints = Segments(ends=np.stack(steps), color=GRAY, width=0.6)
    return replace(panel, marks=(joints, *panel.marks))


def captured(group: Group, styles: Styles) -> Plot:
    """Plot predicted divided by measured variance against the half width of the spectrum."""
    curves = {n: d["captured_by_half_width"].values for n, d in group.items()}
    every = np.concatenate(list(curves.values()))
    # At half width 0 only the dc term is summed, a rounding error (1e-20) for uniform weights
    positive = every[np.isfinite(every) & (every > NEGLIGIBLE)]
    logarithmic = float(positive.max(initial=1.0)) > _LINEAR_TOP
    shown = {
        name: (
            group[name]["half_width"].values.astype(float),
            np.where(curve > NEGLIGIBLE, curve, np.nan) if logarithmic else curve,
        )
        for name, curve in curves.items()
    }
    none = {n: "" if np.isfinite(c).any() else ": no finite prediction" for n, c in curves.items()}
    marks: list[Mark] = [
        ReferenceLine(at=1.0),
        *lines_of(shown, styles, ("half width", "share"), notes=none),
    ]
    label, top = "predicted / measured", float(positive.max(initial=1.0))
    axis = (
        log_axis(label, min(float(positive.min(initial=1.0)), 1.0), top)
        if logarithmic
        else Axis(label=label, low=0.0, high=max(1.1, 1.08 * top))
    )
    widest = max(float(each["half_width"].values[-1]) for each in group.values())
    ticks = whole_ticks(0.0, widest)
    below = Axis(label="half width of the spectrum", low=0.0, high=1.03 * widest, ticks=ticks)
    panel = Panel(marks=tuple(marks), x=below, y=axis, grid=True)
    return Plot(
        panels=(panel,),
        caption="Share of the measured variance that the spectrum predicts up to each half width; "
        "at 1 the sum is complete.",
        words="Predicted / measured variance against the half width. "
        + for_each(group, _captured_words),
        height=0.5,
    )


def techniques(group: Group, styles: Styles) -> Plot:
    """Plot the contributions of all techniques and pairs of techniques at the largest n."""
    panels = []
    group = {name: each.isel(n=-1) if "n" in each.dims else each for name, each in group.items()}
    values = {name: each["technique_covariance"].values for name, each in group.items()}
    axis = signed_axis("part of the variance", [2.0 * v for v in values.values()], 5)
    for name, each in group.items():
        matrix, ends = values[name], each["technique_variance_ci"].values
        places = [(i, j) for i in range(len(matrix)) for j in range(i, len(matrix))]
        places.sort(key=lambda place: place[0] != place[1])  # variances come before covariances
        shown = np.array([matrix[i, j] * (1 if i == j else 2) for i, j in places])
        whiskers = np.array([ends[i] if i == j else [math.nan] * 2 for i, j in places])
        texts = numbers(shown, 3)
        rows = [f"technique {i}" if i == j else f"2 Cov({i}, {j})" for i, j in places]
        color = styles[name].color
        panels.append(_bar_panel(name, color, rows, shown, whiskers, texts, axis))
    return Plot(
        panels=tuple(panels),
        caption="Contribution of each technique to the variance, and of each pair through its "
        "covariance. The bars sum to the measured variance. Whiskers are 95 % intervals.",
        words="Bars of the techniques' variances. "
        + for_each(
            group, lambda d: ", ".join(numbers(np.diag(d["technique_covariance"].values), 3))
        ),
        height=0.1 + 0.05 * max(len(panel.y.ticks or ()) for panel in panels),
        share="x" if len({v.shape for v in values.values()}) == 1 else "",
    )


def technique_rates(group: Group, _: Styles) -> Plot:
    """Plot the variance of each technique against n with its rate, with a panel per sampler."""
    curves: dict[str, dict[str, tuple[xr.Dataset, LineStyle]]] = {}
    for name, each in group.items():
        curves[name] = {
            f"technique {t}": (
                each[["mean"]].assign(
                    {k: each[f"technique_{k}"].isel(technique=t) for k in _CURVE}
                ),
                LineStyle(color=PALETTE[t % len(PALETTE)], marker=MARKERS[t % len(MARKERS)]),
            )
            for t in range(each.sizes["technique"])
        }
        measured = {k: each[k.replace("variance", "measured_variance")] for k in _CURVE}
        whole = (each[["mean"]].assign(measured), LineStyle(color=INK, marker="X", dashes="--"))
        curves[name]["all together"] = whole
    panels, said = _curve_panels(curves)
    return Plot(
        panels=panels,
        columns=min(2, len(panels)),
        caption="Variance of each technique's part of the estimate and of their sum against the "
        "number of points, with 95 % intervals and rates. The slowest technique determines the "
        "rate.",
        words=said,
        share="both",
    )


def anova(group: Group, styles: Styles) -> Plot:
    """Plot the variances of axes and sets of axes of primary space, in descending order."""
    most, panels = 12, []
    for name, each in group.items():
        variance, error = each["anova_variance"].values, each["anova_variance_se"].values
        # Omit parts that are rounding errors compared with the largest part
        size, order = np.abs(variance), np.argsort(-variance, kind="stable")
        seen = size > NEGLIGIBLE * size.max(initial=0.0)
        order = order[seen[order] | ~seen.any()][:most]
        rows = [str(each["subset_label"].values[k]) for k in order]
        low, high = (variance + sign * CONFIDENCE_Z * error for sign in (-1, 1))
        ends = np.stack([low, high], axis=-1)[order]
        texts = numbers(variance[order], 3)
        least, top = float(ends.min(initial=0.0)), float(ends.max(initial=0.0))
        color, axis = styles[name].color, linear_axis("part of the variance", least, top, 5)
        panels.append(_bar_panel(name, color, rows, variance[order], ends, texts, axis))
    shown = max(len(panel.y.ticks or ()) for panel in panels)
    more = max(each.sizes["subset"] for each in group.values()) - shown
    known = next(iter(group.values())).attrs
    axes, sets = known.get("axes", "axis of primary space"), known.get("order", 2) > 1
    return Plot(
        panels=tuple(panels),
        columns=min(2, abreast(len(panels))),
        caption=f"Part of the variance that comes from each {axes} alone (first-order)"
        + (" and from the interactions of each set" if sets else "")
        + ", the largest first; whiskers are 95 % intervals."
        + (f" {more} smaller parts are omitted." if more > 0 else ""),
        words="Bars of the axes' parts of the variance. "
        + for_each(
            group,
            lambda d: (
                "most from "
                + ", ".join(
                    str(d["subset_label"].values[k])
                    for k in np.argsort(-d["anova_variance"].values)[:3]
                )
            ),
        ),
        height=0.12 + 0.05 * shown,
    )


def remedies(group: Group, _: Styles) -> Plot:
    """Plot the variance of each change relative to the set-up as given, with intervals."""
    panels = []
    for name, each in group.items():
        # Every ratio is shown. If an interval is much wider than all ratios, its end is cut off.
        # Each set-up has its own axis, because its ratios may span many decades
        ratio, ends = each["error_ratio"].values, np.maximum(each["error_ratio_ci"].values, 1e-30)
        used = ratio[np.isfinite(ratio) & (ratio > 0)]
        least, most = float(used.min(initial=0.5)), float(used.max(initial=2.0))
        known = ends[(ends >= least / _BEYOND) & (ends <= most * _BEYOND)]
        low, high = float(known.min(initial=least)), float(known.max(initial=most))
        axis = log_axis("variance / variance as given", low, high)
        rows, verdicts = (each[key].values.astype(str) for key in ("remedy", "verdict"))
        marks: list[Mark] = [ReferenceLine(at=1.0, axis="x", color=GRAY, width=0.7)]
        for verdict in dict.fromkeys(verdicts):
            of = (verdicts == verdict) & (ratio > 0)
            shown = {
                "remedy": list(rows[of]),
                "ratio": numbers(ratio[of], 3),
                "interval": intervals(ends[of], 3),
            }
            marks.append(
                Dots(
                    x=ratio[of],
                    y=np.flatnonzero(of).astype(float),
                    color=_VERDICTS.get(verdict, GRAY),
                    low=ends[of, 0],
                    high=ends[of, 1],
                    across=True,
                    label="" if verdict == "given" else verdict,
                    hover=shown,
                )
            )
        names = name_axis([shorten(row, 44) for row in rows])
        panels.append(
            Panel(marks=tuple(marks), x=axis, y=names, title=name if len(group) > 1 else "")
        )
    return Plot(
        panels=tuple(panels),
        caption="Variance of each change (mean squared error if biased) divided by the variance of "
        "the set-up as given, with simultaneous 95 % intervals. Below 1 there is less noise.",
        words="Ratios of variances. "
        + for_each(group, lambda d: _named_values(d, "remedy", "error_ratio")),
        height=0.1 + 0.045 * max(each.sizes["remedy"] for each in group.values()),
    )


def shares(names: Sequence[str], values: Array, ends: Array) -> Plot:
    """Plot shares of the variance (K,) with their 95 % intervals (K, 2), in the given order."""
    top = float(np.nanmax(ends, initial=float(np.max(values, initial=0.1))))
    axis = linear_axis("share of the variance", min(float(np.nanmin(ends, initial=0.0)), 0.0), top)
    texts = [percent(float(value)) for value in values]
    return Plot(
        kind="shares",
        panels=(_bar_panel("", PALETTE[0], list(names), values, ends, texts, axis),),
        caption="Variance of a random path that first appears with a decision, as a share of the "
        "total: the increase of the cumulative Sobol' index; whiskers are 95 % intervals.",
        words="Bars of shares: "
        + ", ".join(f"{n} {text}" for n, text in zip(names, texts, strict=True))
        + ".",
        height=0.12 + 0.05 * max(len(names), 2),
    )


def needed_samples(
    needed: Mapping[str, Mapping[str, tuple[float, float, float]]], now: int
) -> Plot:
    """Plot the samples per pixel that shares of the pixels need, by sampler.

    Parameters
    ----------
    needed
        Samples per pixel with both ends of the interval, by sampler and share of the pixels.
    now
        Present number of samples per pixel of the scene; a vertical line marks it.
    """
    marks: list[Mark] = [
        ReferenceLine(at=float(now), axis="x", dashes="--", label=f"now: {now}"),
    ]
    rows: list[str] = []
    every = [float(now)]
    for color, (sampler, found) in zip(PALETTE, needed.items(), strict=False):
        values = np.array(list(found.values()))
        at = float(len(rows)) + np.arange(float(len(found)))
        rows += [f"{shorten(sampler, 34)}: {share}" for share in found]
        known = np.isfinite(values[:, 0])
        every += values[np.isfinite(values) & (values < _BEYOND * np.nanmax(values[:, 0]))].tolist()
        marks.append(
            Dots(
                x=values[known, 0],
                y=at[known],
                color=color,
                low=values[known, 1],
                high=values[known, 2],
                across=True,
                size=5.0,
                hover={
                    "samples per pixel": numbers(values[known, 0], 3),
                    "interval": intervals(values[known, 1:], 3),
                },
            )
        )
    return Plot(
        kind="needed-samples",
        panels=(
            Panel(
                marks=tuple(marks),
                x=log_axis("samples per pixel", max(min(every), 1.0), max(every)),
                y=name_axis(rows),
            ),
        ),
        caption="Samples per pixel that reach the target, with 95 % intervals. The dashed line "
        "is the scene as it is.",
        words="Samples per pixel: "
        + "; ".join(
            f"{sampler}: "
            + ", ".join(f"{share} {number(values[0])}" for share, values in found.items())
            for sampler, found in needed.items()
        )
        + ".",
        height=0.16 + 0.06 * max(len(rows), 2),
    )


def estimates(group: Group, styles: Styles) -> Plot:
    """Plot a histogram of estimates, with the normal curve of equal mean and variance."""
    panels, every = [], np.concatenate([each["estimate"].values for each in group.values()])
    every = every[np.isfinite(every)]
    low, high = float(every.min()), float(every.max())
    # Use a bar per value if the estimates have few distinct values, as for a step function
    auto = np.histogram_bin_edges(every, bins="auto")
    width = max((high - low) / _MOST_BINS, float(auto[1] - auto[0]))
    gaps = np.diff(np.unique(every))
    width = max(width, float(gaps[gaps > NEGLIGIBLE * (high - low)].min(initial=high - low)))
    edges = low - 0.5 * width + width * np.arange(math.floor((high - low) / width + 0.5) + 2)
    middle, width = 0.5 * (edges[:-1] + edges[1:]), float(edges[1] - edges[0])
    at, said = np.linspace(edges[0], edges[-1], 200), []
    for name, each in group.items():
        values = each["estimate"].values
        mean, deviation = float(values.mean()), float(values.std(ddof=1))
        share = np.histogram(values, edges)[0] / values.size
        hover = {"estimate": numbers(middle), "share": [percent(float(v)) for v in share]}
        marks: list[Mark] = [
            BarChart(
                at=middle, value=share, thickness=0.95 * width, color=styles[name].color,
                opacity=0.55, hover=hover,
            )
        ]  # fmt: skip
        if deviation > 0.0:
            density = np.exp(-0.5 * ((at - mean) / deviation) ** 2) / (
                deviation * math.sqrt(2.0 * math.pi)
            )
            marks.append(Line(x=at, y=width * density, color=INK, width=1.2, label="normal curve"))
        if (known := each.attrs.get("integral")) is not None:
            marks.append(ReferenceLine(at=float(known), axis="x", dashes="--", label="integral"))
        said.append(f"{name}: mean {number(mean, 5)}, standard deviation {number(deviation, 3)}")
        panels.append(
            Panel(
                marks=tuple(marks),
                x=linear_axis("estimate", float(edges[0]), float(edges[-1]), 4),
                y=Axis(label="share", low=0.0),
                title=f"{name}, σ = {number(deviation, 3)}",
            )
        )
    return Plot(
        panels=tuple(panels),
        columns=abreast(len(panels)),
        caption=f"Histogram of {every.size // len(group)} estimates, with the normal curve of the "
        "same mean and variance.",
        words=f"Histograms of estimates. {'; '.join(said)}.",
        height=0.7,
        share="x",
    )


def below_rounding(data: xr.Dataset) -> bool:
    """Whether a curve has no rate because its variances are rounding errors, but not all 0."""
    variance = data["variance"].values
    finite = variance[np.isfinite(variance)]
    return bool(finite.size > 1 and (finite > 0).any() and usable_counts(data).sum() < 2)


def usable_counts(curve: xr.Dataset) -> Array:
    """Return which counts (n,) have a variance above rounding level.

    The rounding level is the squared rounding error of a mean of n terms of size |I|.
    The fit of the rate also omits variances below the rounding level.
    The rounding error of a mean is a few units in the last place.
    """
    variance = curve["variance"].values
    floor = (16 * np.finfo(float).eps * np.abs(curve["mean"].values)) ** 2
    return np.asarray(np.isfinite(variance) & (variance > floor))


def _bar_panel(
    name: str,
    color: str | Sequence[str],
    rows: Sequence[str],
    values: Array,
    ends: Array,
    texts: Sequence[str],
    axis: Axis,
    *,
    base: Array | float = 0.0,
    said: Array | None = None,
) -> Panel:
    """Return a panel of horizontal bars, with their names on the left and values on the right.

    Bars extend from `base` to `values`, and whiskers to `ends`.
    Tooltips show the intervals of the whiskers, or the intervals `said` if given.
    """
    bars = BarChart(
        at=np.arange(float(len(rows))),
        value=np.where(np.isfinite(values), values, np.nan),
        base=base,
        color=color,
        thickness=0.68,
        low=ends[:, 0],
        high=ends[:, 1],
        lying=True,
        texts=texts,
        hover={
            "sampler": [name] * len(rows),
            "part": list(rows),
            "value": list(texts),
            "95 %": intervals(ends if said is None else said),
        },
    )
    marks = (bars, ReferenceLine(at=0.0, axis="x", color=GRAY, width=0.7))
    return Panel(marks=marks, x=axis, y=name_axis(rows), title=name)


def _variance_panel(marks: Sequence[Mark], results: Iterable[xr.Dataset]) -> Panel:
    """Return a panel of variances against n, with a note if all are at rounding level."""
    each = list(results)
    counts = [int(n) for data in each for n in data["n"].values]
    every = np.zeros(0)
    for data in each:
        used = usable_counts(data)
        variance, ends = data["variance"].values[used], data["variance_ci"].values[used]
        # An interval without upper end reaches the top of the panel: leave some length to see
        tops = np.where(np.isinf(ends[:, 1]), _OPEN * variance, variance)
        every = np.concatenate([every, variance, tops, ends.ravel()])
        if "predicted_n" in data:
            counts += data["predicted_n"].values.astype(int).tolist()
            every = np.append(every, data["predicted_variance"].values)
    every = every[np.isfinite(every) & (every > 0)]
    axis = log_axis("variance", *_ends(every))
    finite = any(np.isfinite(data["variance"].values).any() for data in each)
    return Panel(
        marks=tuple(marks),
        x=count_axis("number of points n", counts),
        y=axis if every.size else replace(axis, ticks={}),
        grid=True,
        note=""
        if every.size
        else f"no {'variance above rounding noise' if finite else 'finite variance'}",
    )


def _curve_panels(
    parts: Mapping[str, Mapping[str, tuple[xr.Dataset, LineStyle]]],
    label: str = "number of points n",
    *,
    joined: bool = False,
) -> tuple[tuple[Panel, ...], str]:
    """Return panels with equal axes for curves by title and name, and the rates in words."""
    every = [data for curves in parts.values() for data, _ in curves.values()]
    panels, said = [], []
    for title, curves in parts.items():
        marks = [m for name, each in curves.items() for m in _curve(*each, name, joined=joined)]
        panel = _variance_panel(marks, every)
        panels.append(replace(panel, x=replace(panel.x, label=label), title=title))
        said += [f"{title}, {name}: {_rate_text(data)}" for name, (data, _) in curves.items()]
    return tuple(panels), f"Logarithmic plots of variance against n. {'; '.join(said)}."


def _curve(data: xr.Dataset, style: LineStyle, name: str, *, joined: bool = False) -> list[Mark]:
    """Return points with whiskers, and a line through them, which is fitted unless `joined`."""
    used = usable_counts(data)
    n, variance = data["n"].values[used].astype(float), data["variance"].values[used]
    ends, text = data["variance_ci"].values[used], _rate_text(data)
    label = name if joined else f"{name}  {text}"
    dots = Dots(
        x=n,
        y=variance,
        color=style.color,
        marker=style.marker,
        low=np.maximum(ends[:, 0], np.finfo(float).tiny),
        high=ends[:, 1],
        label=label,
        hover={
            "sampler": [name] * n.size,
            "n": [f"{int(count)}" for count in n],
            "variance": numbers(variance, 6),
            "95 %": intervals(ends),
            "rate": [text] * n.size,
        },
    )
    slope = float(data["rate"])
    if joined or not math.isfinite(slope):
        line = [
            Line(x=n, y=variance, color=style.color, dashes=style.dashes, width=1.0, label=label)
        ]
        return [*(line if joined else ()), dots]
    # The fitted line passes through the weighted center of the points
    last = int(data.attrs.get("fit_last", used.size))
    fitted = used & (np.arange(used.size) >= used.size - last)
    x, y = np.log(data["n"].values[fitted]), np.log(data["variance"].values[fitted])
    low, high = np.log(data["variance_ci"].values[fitted]).T
    weight = np.nan_to_num((2 * CONFIDENCE_Z / np.maximum(high - low, 1e-12)) ** 2)
    if not weight.any():
        return [dots]
    centre, level = np.average(x, weights=weight), np.average(y, weights=weight)
    at = x[[0, -1]]
    return [
        Line(
            x=np.exp(at),
            y=np.exp(level + slope * (at - centre)),
            color=style.color,
            dashes=style.dashes,
            width=1.0,
            label=label,
        ),
        dots,
    ]


def _prediction_marks(data: xr.Dataset, style: LineStyle, name: str) -> list[Mark]:
    """Return crosses at the predictions, and a line with the theoretical slope for large n."""
    n, value = (data[key].values.astype(float) for key in ("predicted_n", "predicted_variance"))
    there = np.isfinite(value) & (value > 0)
    n, value, ends = n[there], value[there], data["predicted_variance_ci"].values[there]
    if not n.size:
        return []
    crosses = Dots(
        x=n,
        y=value,
        color=INK,
        marker="X",
        low=np.maximum(ends[:, 0], value * _LEAST_SHOWN),
        high=ends[:, 1],
        label="predicted",
        hover={
            "sampler": [name] * n.size,
            "n": [f"{int(count)}" for count in n],
            "predicted": numbers(value, 6),
            "95 %": intervals(ends),
        },
    )
    slope = float(data.get("limit_rate", math.nan))
    if n.size < 2 or not math.isfinite(slope):
        return [crosses]
    theory = Line(
        x=n,
        y=value[-1] * (n / n[-1]) ** slope,
        color=style.color,
        dashes="-.",
        width=0.8,
        label="theory's slope",
    )
    return [theory, crosses]


def _with_slopes(panel: Panel, group: Group, styles: Styles, *, small: bool) -> Panel:
    """Return a panel of curves, with their slopes at the right ends, and the theoretical slopes."""
    texts: list[tuple[float, float, str, str]] = []
    for name, each in group.items():
        used, slope = np.flatnonzero(usable_counts(each)), float(each["rate"])
        if not used.size or not math.isfinite(slope):
            continue
        text, limit = rate(slope, None, None), float(each.get("limit_rate", math.nan))
        theory = "" if small else "theory "
        text += f" ({theory}{rate(limit, None, None)})" if math.isfinite(limit) else ""
        last = each.isel(n=used[-1])
        end = (float(last["n"]), float(last["variance"]))
        if "predicted_n" in each:
            n, value = (each[key].values for key in ("predicted_n", "predicted_variance"))
            there = value > 0
            end = max([end, *zip(n[there].astype(float), value[there].astype(float), strict=True)])
        texts.append((*end, text, styles[name].color))
    low, high = panel.x.low, panel.x.high
    if not texts or not (low and high and panel.y.low and panel.y.high):
        return panel
    # Place the texts from bottom to top, at least one line apart
    line, letter = ((_SMALLER if small else 1.0) * size for size in (_TEXT_LINE, _TEXT_LETTER))
    height = math.log(panel.y.high / panel.y.low)
    below, marks = -math.inf, list(panel.marks)
    for x, y, text, color in sorted(texts, key=lambda each: each[1]):
        place = max(math.log(y), below + line * height)
        below = place
        marks.append(TextMark(x=x, y=math.exp(place), text=text, color=color))
    room = letter * max(len(text) for *_, text, _ in texts)
    top = max(panel.y.high, math.exp(below + 0.5 * line * height))
    across = high * (high / low) ** (room / (1.0 - room))
    return replace(
        panel, marks=tuple(marks), x=replace(panel.x, high=across), y=replace(panel.y, high=top)
    )


def _with_slope_guides(panel: Panel, results: Sequence[xr.Dataset]) -> Panel:
    """Return a panel with dotted guide lines, whose slopes are nearest to the rates.

    The available slopes are −1, −1.5, −2 and so on.
    The guide lines begin at the largest variance of the smallest n.
    """
    starts = [
        (float(each["n"].values[i]), float(each["variance"].values[i]))
        for each in results
        for i in np.flatnonzero(usable_counts(each))[:1]
    ]
    low, high, bottom = panel.x.low, panel.x.high, panel.y.low
    if not starts or not (low and high and bottom):
        return panel
    n, top = min(n for n, _ in starts), max(value for _, value in starts)
    last = max(float(each["n"].values[-1]) for each in results)
    rates = np.array([float(each["rate"]) for each in results])
    near = np.round(2.0 * rates[np.isfinite(rates) & (rates < -1.25)]) / 2.0
    slopes, counts = np.unique(near, return_counts=True)
    common = slopes[np.argsort(-counts, kind="stable")][: _GUIDES - 1]
    marks: list[Mark] = []
    lowest = math.inf
    for slope in (-1.0, *sorted(common, reverse=True)):
        end = min(last, n * (top / (1.2 * bottom)) ** (-1.0 / slope))
        if end <= 1.5 * n:
            continue
        at = np.array([n, end])
        y = top * (at / n) ** slope
        if end == last and lowest / y[1] < (top / bottom) ** _GUIDE_GAP:
            continue  # omit a line whose label would touch another label
        lowest = float(y[1])
        text = f"{slope:g}".replace("-", "−")
        marks.append(Line(x=at, y=y, color=GRAY, dashes=":", width=0.8))
        marks.append(TextMark(x=end, y=float(y[1]), text=text, color=GRAY))
    across = high * (high / low) ** (_GUIDE_ROOM / (1.0 - _GUIDE_ROOM))
    return replace(panel, marks=(*marks, *panel.marks), x=replace(panel.x, high=across))


def _rate_text(data: xr.Dataset) -> str:
    text, notes = rate(float(data["rate"]), *map(float, data["rate_ci"].values)), ""
    text = {MISSING: "(no rate)", "unresolved": "(rate unresolved)"}.get(text, text)
    used, finite = usable_counts(data), np.isfinite(data["variance"].values)
    for words, count in (
        ("not finite", int((~finite).sum())),
        ("at rounding level", int((finite & ~used).sum())),
    ):
        notes += f"; {count} of {used.size} {words}" if count else ""
    return text + notes


def _ends(values: Array) -> tuple[float, float]:
    found = values[np.isfinite(values)]
    return (float(found.min()), float(found.max())) if found.size else (math.nan, math.nan)


def _named_values(data: xr.Dataset, names: str, values: str) -> str:
    pairs = zip(data[names].values, data[values].values, strict=True)
    return ", ".join(f"{name} {number(float(value))}" for name, value in pairs)


def _rate_words(data: xr.Dataset) -> str:
    low, high = (float(end) for end in data["rate_ci"].values)
    counts, variance = data["n"].values, data["variance"].values
    return (
        f"rate {rate(float(data['rate']), low, high)}, variance {number(float(variance[0]))} at "
        f"n = {counts[0]} and {number(float(variance[-1]))} at n = {counts[-1]}"
    )


def _term_words(data: xr.Dataset) -> str:
    power = float(data["power_term"])
    values = (
        f"{t} {number_beside(float(data[f'{t}_term']), power)}" for t in ("dc", "power", "cross")
    )
    return f"{', '.join(values)}, measured {number(float(data['measured_variance']))}"


def _captured_words(data: xr.Dataset) -> str:
    curve = data["captured_by_half_width"].values
    last = float(curve[-1])
    return f"{percent(last) if np.isfinite(last) else MISSING} at half width {len(curve) - 1}"
