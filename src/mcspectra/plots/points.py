"""Plots of point sets (strips in 1-D, unit squares in more dims) and cards of samplers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_unit_points
from mcspectra.core.errors import ParameterError
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
)
from mcspectra.plots.groups import Group, Styles, abreast, numbers
from mcspectra.plots.scales import (
    count_axis,
    linear_axis,
    log_axis,
    name_axis,
    scaled_axis,
    unit_axis,
    unit_panel,
)
from mcspectra.plots.spectra import frequency_map, relative_power
from mcspectra.plots.style import ACCENT, FAINT, GRAY, INK, PALETTE, PAPER, labels
from mcspectra.plots.text import SUBSCRIPTS

__all__ = [
    "QUALITY_HEADS",
    "integrand",
    "point_sets",
    "points",
    "quality",
    "sampler_card",
    "strata",
]

QUALITY_HEADS = {
    "relative_minimum_distance": "Minimum distance",
    "star_discrepancy": "Star discrepancy",
    "centered_discrepancy": "Centered discrepancy",
    "diaphony": "Diaphony",
    "transport_cost": "Transport cost",
    "t_value": "t",
}
"""Short names of quality figures."""

_MOST_NAMED = 2**14  # largest number of points that have tooltips
_MOST_STRATA = 64  # largest number of strata whose borders are drawn in a strip
_MOST_SETS, _MOST_AXES, _MOST_POINTS = 6, 6, 2**20  # largest numbers of sets, axes and points
_TICK_ROW = 0.09  # height of a row of ticks below the curves, relative to the curves
_RING = 1.6  # light rings make dots on a map larger by this size, in units of 1/72 inch
_SECTIONS = {"axis 0": (1, 0), "axis 1": (0, 1), "diagonal": (1, 1)}


def points(group: Group, styles: Styles) -> Plot:
    """Plot one realization of each sampler. The areas of dots are proportional to ``weights``."""
    sizes = {each.sizes["axis"] for each in group.values()}
    n = max(each.sizes["point"] for each in group.values())
    if sizes == {1}:
        short = labels(list(group), 26)
        strips = [each["points"].values[:, 0] for each in group.values()]
        colors, rows = [styles[name].color for name in group], [short[name] for name in group]
        panels = [_stroke_panel(strips, colors, rows, names=list(group))]
        shown = "Tick marks on a line, with the borders of n equal strata."
    else:
        panels = [
            _square(
                each["points"].values,
                styles[name].color,
                title=name,
                weights=each["weights"].values if "weights" in each else None,
                axes=(0, 1) if each.sizes["axis"] > 1 else (0, 0),
            )
            for name, each in group.items()
        ]
        shown = "The unit square." if max(sizes) == 2 else f"Axes 0 and 1 of {max(sizes)}."
    return Plot(
        panels=tuple(panels),
        columns=abreast(len(panels)),
        caption=f"One realization of n = {n} points of each sampler, after importance sampling if "
        f"there is a density. {shown}",
        words=f"Point sets of {n} points for {', '.join(group)}.",
        height=0.08 + 0.1 * len(group) if sizes == {1} else 1.0,
        share="both",
    )


def integrand(group: Group, styles: Styles) -> Plot:
    """Plot f and p with the points of each sampler: curves in 1-D, maps in more dims."""
    each = next(iter(group.values()))
    values = each["integrand_value"].values
    density = each["density_value"].values if "density_value" in each else None
    dims, n = each.sizes["axis"], max(d.sizes["point"] for d in group.values())
    f = str(each.attrs.get("function", "f"))  # a plot of a density shows p itself
    what = f"The {'density' if f == 'p' else 'integrand'} {f}"
    if n:
        what += f" with n = {n} points of each sampler"
    if values.ndim == 1:
        panels = [_curves(group, styles, values, density, f)]
        caption = f"{what}{' as ticks' if n else ''}."
        if density is not None:
            caption += " The density p is scaled to the mean of f."
    else:
        finite = values[np.isfinite(values)]
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
        shades = {"f": Scale(label=f, low=low, high=high if high > low else low + 1.0)}
        maps = {"f": values}
        if density is not None:
            shades["p"] = Scale(label="p", high=float(density.max()))
            maps["p"] = density
        shades = {key: replace(scale, palette="paper") for key, scale in shades.items()}
        shown = [("f", name) for name in group] + [("p", name) for name in list(group)[:1]]
        panels = []
        for key, name in shown[: len(group) + (density is not None)]:
            centers = [each[f"x{axis}"].values for axis in (0, 1)]
            shade = Heatmap(
                values=maps[key].T, x=centers[0], y=centers[1], scale=shades[key], name=key
            )
            at = group[name]["points"].values
            square = unit_panel((), name) if not n else _square(at, styles[name].color, title=name)
            title = name if key == "f" and len(group) > 1 else f"{key if key == 'p' else f}"
            title += f" and {name}" if n and title != name else ""
            # Draw a light ring around each dot, because a dark dot is not visible on a dark cell
            dots = [mark for mark in square.marks if isinstance(mark, Dots)]
            rings = [replace(m, color=PAPER, size=m.size + _RING, hover={}) for m in dots]
            panels.append(replace(square, marks=(shade, *rings, *dots), title=title))
        caption = f"{what}."
        caption += " Last: the density p with the same points." if density is not None else ""
        if dims > 2:
            caption += f" The map is the section through the center of {dims} dims."
    return Plot(
        panels=tuple(panels),
        columns=abreast(len(panels)),
        caption=caption,
        words=f"Integrand between {values.min():.3g} and {values.max():.3g}, "
        f"with points of {', '.join(group)}.",
        height=0.62 if values.ndim == 1 else 1.0,
    )


def quality(group: Group, styles: Styles) -> Plot:
    """Plot quality figures against n, with a panel per figure and a line per sampler."""
    heads = QUALITY_HEADS | {"generalized_l2_discrepancy": "Generalized L2 discrepancy"}
    short, panels = labels(list(group), 30), []
    for key, head in heads.items():
        marks: list[Mark] = []
        every, counts = [np.empty(0)], list[int]()
        for name, each in group.items():
            values = each[key].values if key in each else np.empty(0)
            there = np.isfinite(values)
            if not there.any():
                continue
            n, style = each["n"].values[there], styles[name]
            at, values = n.astype(float), values[there]
            look: dict[str, Any] = {"color": style.color, "label": short[name]}
            hover = {"sampler": [name] * n.size, "n": [str(m) for m in n], head: numbers(values)}
            marks.append(Line(x=at, y=values, dashes=style.dashes, width=1.0, **look))
            marks.append(Dots(x=at, y=values, marker=style.marker, hover=hover, **look))
            every.append(values)
            counts += n.tolist()
        found = np.concatenate(every)
        if not found.size:
            continue
        low, high = float(found.min()), float(found.max())
        y = log_axis(head, low, high, 5) if low > 0 else linear_axis(head, low, high, 4)
        x = count_axis("number of points n", counts, 4)
        panels.append(Panel(marks=tuple(marks), x=x, y=y, grid=True))
    return Plot(
        panels=tuple(panels),
        columns=3,
        caption="Figures of quality against n, as means over sets. Minimum distances are relative "
        "to the densest packing. A large minimum distance is good; other figures should be small.",
        words="Figures of quality against n. "
        + "; ".join(panel.y.label for panel in panels)
        + f", for {', '.join(group)}.",
        height=0.8,
        wide=True,
    )


def strata(group: Group, _: Styles) -> Plot:
    """Plot the strata over f with their variances, and the total variance against their offset."""
    panels = []
    for name, each in group.items():
        values, parts = each["integrand_value"].values, each["stratum_variance"].values
        share = parts / (parts.max() or 1.0)
        border = np.linspace(0.0, 1.0, len(parts) + 1)
        if values.ndim == 1:
            low, high = float(min(values.min(), 0.0)), float(values.max())
            middle = 0.5 * (border[:-1] + border[1:])
            bars = BarChart(
                at=middle, value=low + (high - low) * share, base=low, thickness=1.0 / len(parts),
                color=ACCENT, opacity=0.3, label="part of the variance",
                hover={"variance": numbers(parts)},
            )  # fmt: skip
            sides = np.stack(
                [np.stack([border, border], 1), np.tile([low, high], (len(border), 1))], 2
            )
            lines = Segments(ends=sides, color=FAINT, width=0.7)
            curve = Line(x=each["x0"].values, y=values, color=INK, label="f")
            panel = Panel(
                marks=(bars, lines, curve), x=unit_axis("x"), y=linear_axis("f(x)", low, high, 5),
                title=name,
            )  # fmt: skip
        else:
            at = 0.5 * (border[:-1] + border[1:])
            part = parts / (parts.sum() or 1.0)
            top = float(part.max()) or 1.0
            scale = Scale(label="share of the variance", high=top, palette="paper")
            cells = Heatmap(values=part.T, x=at, y=at, scale=scale, name="share")
            torn = np.stack([border, border], 1)
            ends = np.tile([0.0, 1.0], (len(border), 1))
            grid = [np.stack(pair, 2) for pair in ((torn, ends), (ends, torn))]
            lines = Segments(ends=np.concatenate(grid), color=FAINT, width=0.5)
            panel = unit_panel([cells, lines], name)
        slide, variance = each["offset"].values, each["sliding_variance"].values
        moved = Panel(
            marks=(
                Line(x=slide, y=variance, color=PALETTE[0], hover={"variance": numbers(variance)}),
            ),
            x=Axis(label="offset of the strata / width", low=0.0, high=1.0),
            y=scaled_axis("variance", 0.0, float(variance.max()) or 1.0, 4),
            title="as the strata slide",
            grid=True,
        )
        panels += [panel, moved]
    return Plot(
        panels=tuple(panels),
        columns=2,
        caption="Jittered strata over f: only strata in which f varies cause variance. "
        "Right: the variance if all strata slide along axis 0 by a fraction of their width.",
        words="Variance of strata. "
        + "; ".join(
            f"{name}: from {d['sliding_variance'].values.min():.3g} to "
            f"{d['sliding_variance'].values.max():.3g} as the strata slide"
            for name, d in group.items()
        )
        + ".",
        height=0.8,
        wide=True,
    )


def point_sets(sets: object, caption: str = "", most_axes: int = _MOST_AXES) -> Plot:
    """Plot point sets: strips in 1-D, squares in 2-D, and pairs of the first axes in more dims.

    Parameters
    ----------
    sets
        Points in [0,1), with shape (n, d), or (R, n, d) for R sets of n points in d dims.
        In 1-D and 2-D the first 6 sets are drawn. In more dims only the first set is drawn.
    caption
        Description of the points. If sets or axes are omitted, a note is added.
    most_axes
        Largest number of axes that are drawn.

    Raises
    ------
    ParameterError
        If the points are not in the unit cube, or there are more than 2^20 of them.
    """
    given = as_unit_points(sets)
    if given.ndim not in (2, 3):
        raise ParameterError(f"points have shape {given.shape}; give (n, d) or (R, n, d).")
    given = given if given.ndim == 3 else given[None]
    count, n, dims = given.shape
    if n > _MOST_POINTS:
        raise ParameterError(f"{n} points are too many for a plot; give at most {_MOST_POINTS}.")
    kept, axes = min(count, _MOST_SETS) if dims <= 2 else 1, min(dims, most_axes)
    said = [caption] if caption else []
    said += [f"{kept} of {count} sets"] if kept < count else []
    said += [f"axes 0 to {axes - 1} of {dims}"] if axes < dims else []
    if dims == 1:
        panels = [_stroke_panel([each[:, 0]], [INK], [""]) for each in given[:kept]]
    else:
        pairs = [(i, j) for j in range(1, axes) for i in range(j)]
        named = dims > 2
        panels = [
            _square(one, INK, axes=pair, named=named) for one in given[:kept] for pair in pairs
        ]
    return Plot(
        kind="point-sets",
        panels=tuple(panels),
        columns=1 if dims == 1 else abreast(len(panels)),
        caption=", ".join(said),
        words=f"{kept} sets of {n} points.",
        height=0.08 if dims == 1 else 1.0,
        share="both" if dims <= 2 else "",
    )


def sampler_card(group: Group, projected: Array | None = None) -> Plot:
    """Plot the points, spectrum, radial mean and sections of a sampler, and perhaps a projection.

    Parameters
    ----------
    group
        ``points`` is one realization. ``spectrum`` is the power in the same dims.
    projected
        Two coordinates of a set with more dims, with shape (n, 2).
    """
    x, data = group["points"]["points"].values, group["spectrum"]
    n, dims = x.shape
    title = f"points, n = {n}"
    panels = [
        _stroke_panel([x[:, 0]], [INK], [""], title) if dims == 1 else _square(x, INK, title=title)
    ]
    power = relative_power(data) if dims <= 2 else np.zeros(0)
    half = len(power) // 2
    if dims == 2:
        scale = Scale(high=2.0, beyond=True)
        panels.append(frequency_map("n · power, 0 to 2", data, power, scale, "power"))
    # Draw the radial mean. The axis is wide: noise near the level of random points looks small
    radius, mean = (
        data["radius"].values / n ** (1 / dims),
        np.maximum(n * data["radial_power"].values, 1e-8),
    )
    line = Line(x=radius, y=mean, color=PALETTE[0])
    root = {1: "n", 2: "√n"}.get(dims, f"n^(1/{dims})")
    x_axis = log_axis(f"|m| / {root}", float(radius.min()), float(radius.max()), 4)
    y_axis = log_axis("", min(0.05, float(mean.min())), max(2.0, float(mean.max())), 4)
    panels.append(
        Panel(
            marks=(ReferenceLine(at=1.0), line),
            x=x_axis,
            y=y_axis,
            title="n · radial mean",
            grid=True,
        )
    )
    if dims <= 2:
        # Draw the power along the axes, which shows 1-D projections, and along the diagonal
        at = np.arange(1, half + 1)
        steps = {"": (1,)} if dims == 1 else _SECTIONS
        sections: list[Mark] = [
            Line(
                x=at.astype(float),
                y=power[tuple(half + s * at for s in step)],
                color=color,
                width=1.0,
                label=name,
            )
            for (name, step), color in zip(
                steps.items(), (PALETTE[0], ACCENT, PALETTE[2]), strict=False
            )
        ]
        top = max(1.5, *(float(np.max(line.y)) for line in sections if isinstance(line, Line)))
        panels.append(
            Panel(
                marks=(ReferenceLine(at=1.0), *sections),
                x=Axis(label="m", low=0.0, high=float(half)),
                y=Axis(low=0.0, high=min(1.4 * top, 4.0)),
                title="n · power" if dims == 1 else "n · power, sections",
            )
        )
    if projected is not None:
        title = f"4-D, n = {len(projected)}"
        panels.append(_square(projected, INK, title=title, labels=("x₂", "x₃")))
    return Plot(
        kind="sampler-card",
        panels=tuple(panels),
        columns=len(panels),
        caption="Points, power spectrum, its mean over directions, and sections along the axes."
        + (" Last: axes 2 and 3 of points in 4-D." if projected is not None else ""),
        words=f"{n} points in {dims} dims and their power spectrum.",
        height=1.0,
        wide=True,
    )


def _curves(group: Group, styles: Styles, values: Array, density: Array | None, f: str) -> Panel:
    """Return a panel of f and the scaled p over x, with ticks at the points of each sampler."""
    x = next(iter(group.values()))["x0"].values
    marks: list[Mark] = [Line(x=x, y=values, color=INK, label=f, hover={f: numbers(values)})]
    every = [values[np.isfinite(values)], np.zeros(1)]
    if density is not None:
        scaled = density * float(np.mean(values))
        hover = {"p": numbers(density)}
        marks.append(
            Line(x=x, y=scaled, color=GRAY, dashes="--", label="p · mean of f", hover=hover)
        )
        every.append(scaled)
    low, high = (float(end(np.concatenate(every))) for end in (np.min, np.max))
    step, short = _TICK_ROW * ((high - low) or 1.0), labels(list(group), 26)
    group = {name: each for name, each in group.items() if each.sizes["point"]}
    for row, (name, each) in enumerate(group.items()):
        at = each["points"].values[:, 0]
        marks.append(
            Dots(
                x=at,
                y=np.full(len(at), low - (row + 1) * step),
                color=styles[name].color,
                marker="|",
                size=9.0,
                label=short[name],
                hover={"sampler": [name] * len(at), "x": numbers(at)},
            )
        )
    bottom = low - (len(group) + 0.8 * bool(group)) * step
    axis = linear_axis(f"{f}(x)", low, high, 5)
    return Panel(marks=tuple(marks), x=unit_axis("x"), y=replace(axis, low=bottom))


def _square(
    x: Array,
    color: str,
    *,
    title: str = "",
    weights: Array | None = None,
    axes: tuple[int, int] = (0, 1),
    named: bool = True,
    labels: tuple[str, str] = ("", ""),
) -> Panel:
    size: float | Array = float(np.clip(50.0 / np.sqrt(len(x)), 0.4, 5.0))
    first, second = x[:, axes[0]], x[:, axes[1]] if axes[0] != axes[1] else np.full(len(x), 0.5)
    shown = {} if len(x) > _MOST_NAMED else {"x": numbers(first), "y": numbers(second)}
    if weights is not None:
        mean = float(np.abs(weights).mean()) or 1.0
        size = size * np.sqrt(np.minimum(np.abs(weights) / mean, 16.0))
        shown |= {"weight": numbers(weights)} if shown else {}
    said = [
        label or (f"x{axis}".translate(SUBSCRIPTS) if named else "")
        for label, axis in zip(labels, axes, strict=True)
    ]
    return unit_panel([Dots(x=first, y=second, color=color, size=size, hover=shown)], title, *said)


def _stroke_panel(
    sets: Sequence[Array],
    colors: Sequence[str],
    rows: Sequence[str],
    title: str = "",
    names: Sequence[str] = (),
) -> Panel:
    """Return a panel with a strip per set. If `names` are given, borders of n strata are drawn."""
    marks: list[Mark] = []
    for row, (x, color) in enumerate(zip(sets, colors, strict=True)):
        if len(x) <= _MOST_STRATA and names:
            border = np.arange(len(x) + 1) / len(x)
            reach = np.broadcast_to([row - 0.4, row + 0.4], (len(border), 2))
            ends = np.stack([np.stack([border, border], axis=1), reach], axis=2)
            marks.append(Segments(ends=ends, color=FAINT, width=0.7))
        shown = {"sampler": [names[row]] * len(x), "x": numbers(x)} if names else {}
        marks.append(
            Dots(
                x=x, y=np.full(len(x), float(row)), color=color, marker="|", size=20.0, hover=shown
            )
        )
    return Panel(
        marks=tuple(marks),
        x=unit_axis("x"),
        y=name_axis(rows) if names else Axis(low=-0.6, high=0.6, ticks={}),
        title=title,
        framed=not names,
    )
