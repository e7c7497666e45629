"""Plots of warps and primary-space integrands: mapped grids, stretch and jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.plots.description import (
    Axis,
    Heatmap,
    Line,
    Mark,
    Panel,
    Plot,
    ReferenceLine,
    Scale,
    Segments,
)
from mcspectra.plots.groups import Group, Styles, abreast, for_each, numbers
from mcspectra.plots.scales import log_scale, unit_axis, unit_panel
from mcspectra.plots.style import ACCENT, GRAY, INK
from mcspectra.plots.text import number

__all__ = ["primary", "warp"]

_LINES = 16  # grid lines along each axis that are drawn with the warp
_MOST_STRETCH = 100.0
_BOUNDARY = "#0072B2"
_CLIPPED = 0.5  # percentage of the values that is clipped at each end: poles would hide the rest
_INSIDE, _SIDES = "jump inside", "jump between opposite sides"


def warp(group: Group, _: Styles) -> Plot:
    """Plot the image of a grid under a warp, and its stretch and jumps over primary space."""
    group, dims = _by_spec(group, "density")
    caption = "A grid under the warp, and the warp's stretch and jumps on primary space."
    if dims == 1:
        panels = [_curve(n, d, "warped", "jump", "x = T(u)") for n, d in group.items()]
        caption = "The warp T(u), with its jumps."
    else:
        stretches = {n: d["stretch"].transpose("u0", "u1").values for n, d in group.items()}
        largest = max(
            float(np.max(s, where=np.isfinite(s), initial=1.0)) for s in stretches.values()
        )
        scale = log_scale("stretch", 1.0, min(_MOST_STRETCH, max(2.0, largest)))
        scale = replace(scale, palette="paper")
        panels = []
        for name, each in group.items():
            # Map a few grid lines of each axis by the warp T, and interrupt them where T jumps
            x = each["warped"].transpose("u0", "u1", "coordinate").values
            torn = each["jump"].transpose("axis", "u0", "u1").values
            rows, lines = np.unique(np.linspace(0, len(x) - 1, _LINES + 1).astype(int)), []
            for color, of_axis in (
                (INK, [(x[:, j], torn[0, :, j] > 0) for j in rows]),
                (GRAY, [(x[i], torn[1, i] > 0) for i in rows]),
            ):
                # Draw all lines of an axis as a single polyline with gaps
                broken = [np.insert(at, np.flatnonzero(t[:-1]) + 1, np.nan, 0) for at, t in of_axis]
                apart = [np.concatenate([line, np.full((1, 2), np.nan)]) for line in broken]
                across, up = np.concatenate(apart).T
                lines.append(Line(x=across, y=up, color=color, width=0.6))
            panels.append(unit_panel(lines, name))
            marks = (
                _cells(np.clip(stretches[name], 1.0, scale.high), scale, "stretch"),
                Segments(ends=_torn_sides(torn), color=ACCENT, width=1.4),
            )
            below = "u₀\n" + _warp_words(each).replace(", ", "\n")
            panels.append(unit_panel(marks, f"{name}: stretch", below, "u₁"))
    return Plot(
        panels=tuple(panels),
        columns=abreast(len(panels)) if dims == 1 else 2 if len(group) <= 3 else 4,
        caption=caption,
        words="Warps. " + for_each(group, _warp_words),
        height=0.75 if dims == 1 else 1.0,
    )


def primary(group: Group, _: Styles) -> Plot:
    """Plot primary-space integrands g(u) with their jumps, inside and between opposite sides."""
    group, dims = _by_spec(group, "estimator")
    panels = []
    for name, each in group.items():
        words = _jump_words(each)
        if dims == 1:
            panels.append(_curve(name, each, "primary_value", "primary_jump", "g(u)", words))
            continue
        values = each["primary_value"].transpose("u0", "u1").values
        low, high = (float(end) for end in np.percentile(values, [_CLIPPED, 100 - _CLIPPED]))
        scale = Scale(label="g(u)", low=low, high=high if high > low else low + 1.0, palette="gray")
        torn = each["primary_jump"].transpose("axis", "u0", "u1").values
        marks: list[Mark] = [
            _cells(values, scale, "g"),
            Segments(ends=_torn_sides(torn), color=ACCENT, width=1.4, label=_INSIDE),
        ]
        for axis, jumps in enumerate(each["face_jump"].transpose("axis", "along").values > 0):
            along = np.where(jumps, each["u0"].values, np.nan)
            for end in (0.0, 1.0):
                across = np.full(along.shape, end)
                x, y = (across, along) if axis == 0 else (along, across)
                marks.append(Line(x=x, y=y, color=_BOUNDARY, width=4.0, label=_SIDES))
        panels.append(unit_panel(marks, name, "u₀\n" + words.replace(", ", "\n"), "u₁"))
    return Plot(
        panels=tuple(panels),
        columns=abreast(len(panels)),
        caption="The integrand on primary space, g(u), with its jumps inside and between opposite "
        "sides, each given as length × mean height.",
        words="Integrands on primary space. " + for_each(group, _jump_words),
        height=0.75 if dims == 1 else 1.0,
    )


def _by_spec(group: Group, attribute: str) -> tuple[Group, int]:
    """Return the named results and their number of dims. A single result has its spec as name."""
    found = {each.sizes["axis"] for each in group.values()}
    if len(found) > 1:
        raise ParameterError(
            "Results in 1-D and in 2-D cannot share a figure; draw them separately."
        )
    if list(group) == ["sampler"]:
        (each,) = group.values()
        group = {str(each.attrs.get(attribute, "")): each}
    return group, found.pop()


def _curve(
    name: str, data: xr.Dataset, value: str, jump: str, label: str, words: str = ""
) -> Panel:
    """Return a panel of a function of one variable. Its line is interrupted at jumps."""
    u, y = data["u0"].values, data[value].values.reshape(data.sizes["u0"], -1)[:, 0]
    places = np.flatnonzero(data[jump].values[0])
    borders = 0.5 * (u[places] + u[np.minimum(places + 1, u.size - 1)])
    x, y = np.insert(u, places + 1, borders), np.insert(y, places + 1, np.nan)
    marks: list[Mark] = [
        Line(x=x, y=y, color=INK, width=1.2, hover={"u": numbers(x), label: numbers(y)})
    ]
    inside = _INSIDE if words else ""
    marks += [
        ReferenceLine(at=float(b), axis="x", color=ACCENT, width=1.4, label=inside) for b in borders
    ]
    if "face_jump" in data and float(data["face_jump"].values[0]) > 0:
        marks += [
            ReferenceLine(at=end, axis="x", color=_BOUNDARY, width=3.0, label=_SIDES)
            for end in (0.0, 1.0)
        ]
    below = f"u\n{words}" if words else "u"
    return Panel(
        marks=tuple(marks),
        x=unit_axis(below),
        y=Axis(label=label),
        title=name,
    )


def _cells(values: Array, scale: Scale, name: str) -> Heatmap:
    centres = (np.arange(len(values)) + 0.5) / len(values)
    return Heatmap(values=values.T, x=centres, y=centres, scale=scale, name=name)


def _torn_sides(heights: Array) -> Array:
    """Return the sides of cells at which the function jumps, (k, 2, 2), from heights (2, N, N)."""
    found = []
    for axis, each in enumerate(heights):
        far = np.argwhere(each > 0) + 1
        near = far.copy()
        near[:, 1 - axis] -= 1
        found.append(np.stack([near, far], axis=1))
    return np.asarray(np.concatenate(found) / heights.shape[1])


def _warp_words(data: xr.Dataset) -> str:
    jumps = float(data["jump_length"])
    torn = f"jumps of length {number(jumps)}" if jumps else "continuous"
    return f"{torn}, mean stretch {number(float(data['mean_stretch']))}"


def _jump_words(data: xr.Dataset) -> str:
    """Return the size of two kinds of jumps in words, such as ``inside 1.89 × 1.00, sides none``.

    The size ``1.89 × 1.00`` stands for jumps of length 1.89 with the mean height 1.00.
    """
    words = []
    for kind, word in (("interior", "inside"), ("boundary", "sides")):
        length = float(data["primary_jump_length"].sel(kind=kind))
        height = float(data["primary_jump_height"].sel(kind=kind))
        size = "unbounded" if np.isinf(height) else f"{number(length)} × {number(height)}"
        words.append(f"{word} {size if length or np.isinf(height) else 'none'}")
    return ", ".join(words)
