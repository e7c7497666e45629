"""Plots of error images before rendering: after filters, over space and time, and as spectra."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array
from mcspectra.core.errors import SpecError
from mcspectra.core.spec import parse_chain
from mcspectra.plots.description import (
    Axis,
    Dots,
    Heatmap,
    Mark,
    Panel,
    Plot,
    ReferenceLine,
    Scale,
)
from mcspectra.plots.groups import Group, Styles, for_each, intervals, lines_of, numbers
from mcspectra.plots.scales import linear_axis, log_axis, log_scale, name_axis
from mcspectra.plots.style import labels
from mcspectra.plots.text import number

__all__ = ["SCREENS", "filter_names", "mask_names"]

_ABREAST = 4  # largest number of panels per row
_BANDS = 16  # spectra in time are averaged over 1/16 cycle per frame, for masks of 16 frames
_FLOOR = 1e-4  # smallest relative power that is shown
_LEAST, _MOST = 0.01, 10.0  # lowest and highest relative power on the color scale
_CLIPPED = 99.0  # percentile of the errors at both ends of their color scale


def filter_names(data: xr.Dataset) -> dict[str, str]:
    """Return a title for each filter in a result of `screen_spectrum`."""
    sigma, alpha = float(data.attrs["sigma"]), float(data.attrs["alpha"])
    space, time = f"Gaussian σ = {sigma:g}", f"EMA α = {alpha:g}"
    titles = {"none": "no filter", "gaussian": space, "ema": time, "both": f"{space}, {time}"}
    frames = data.sizes["frame"]
    return {k: v for k, v in titles.items() if frames > 1 or k in ("none", "gaussian")}


def mask_names(specs: Sequence[str], length: int = 40) -> dict[str, str]:
    """Return short and distinct names, which for masks look like ``sobol, blue-noise, golden``."""
    short = []
    for spec in specs:
        try:
            *before, last = parse_chain(spec)
        except SpecError:
            before, last = [], None
        if last is None or last.name != "decorrelate":
            short.append(spec)
            continue
        given = last.arguments
        words = [" | ".join(map(str, before)), str(given.get("mask", "white"))]
        words += [str(given[key]) for key in ("time", "mode") if key in given]
        words += [f"{given[key]} {key}" for key in ("width", "frames") if key in given]
        short.append(", ".join([*words, *(["advance"] if given.get("advance") else [])]))
    found = labels(short, length)
    if len(set(short)) < len(short):
        return labels(list(specs), length)
    return {spec: found[own] for spec, own in zip(specs, short, strict=True)}


def _columns(count: int) -> int:
    """Return the number of panels per row that leaves the least space empty."""
    return -(-count // -(-count // _ABREAST))


def _filters(group: Group, styles: Styles) -> Plot:
    """Plot the error after each filter, relative to random points."""
    first, names = next(iter(group.values())), mask_names(list(group))
    panels = []
    for k, (kind, title) in enumerate(filter_names(first).items()):
        marks: list[Mark] = [ReferenceLine(at=1.0, axis="x", dashes="--")]
        shown = []
        for row, (name, each) in enumerate(group.items()):
            one = each.sel(filter=kind)
            value = np.array([float(one["filtered_ratio"])])
            ends = one["filtered_ratio_ci"].values[None]
            shown += [value, ends[np.isfinite(ends)]]
            marks.append(
                Dots(
                    x=value,
                    y=np.array([float(row)]),
                    color=styles[name].color,
                    marker=styles[name].marker,
                    size=6.0,
                    low=ends[:, 0],
                    high=ends[:, 1],
                    across=True,
                    hover={
                        "sampler": [names[name]],
                        "error / random": numbers(value),
                        "interval": intervals(ends),
                    },
                )
            )
        every = np.concatenate([[0.5, 2.0], *shown])
        every = every[every > 0]
        axis = name_axis([names[name] for name in group])
        panels.append(
            Panel(
                marks=tuple(marks),
                x=log_axis("mean squared error / random points", every.min(), every.max(), 4),
                y=axis if k % 2 == 0 else name_axis([""] * len(group)),
                title=title,
                grid=True,
            )
        )
    return Plot(
        panels=tuple(panels),
        columns=2,
        height=max(0.25, 0.09 * len(group)),
        caption="Mean squared error of a pixel after filters, relative to random points after the "
        "same filter, with simultaneous 95 % intervals. Points left of the dashed line are better "
        "than white noise.",
        words="Error relative to random points after "
        + for_each(
            group,
            lambda each: ", ".join(
                f"{title} {number(float(each['filtered_ratio'].sel(filter=kind)))}"
                for kind, title in filter_names(each).items()
            ),
        ),
        wide=True,
    )


def _relative(data: xr.Dataset) -> Array:
    """Return the relative power (frequency, radius), averaged over 1/16 cycle per frame."""
    power = data["relative_power"].transpose("frequency", "radius").values
    frames = data.sizes["frame"]
    # Extend the power to negative frequencies, where it is the same as at positive frequencies.
    # If the moving average has an even width, its first and its last weight are halved
    whole = power[np.minimum(np.arange(frames), frames - np.arange(frames))]
    width = frames // _BANDS
    if width < 2:
        return np.asarray(power)
    weights = np.full(width + 1 - width % 2, 1.0 / width)
    if width % 2 == 0:
        weights[[0, -1]] /= 2.0
    shifts = range(-(weights.size // 2), weights.size // 2 + 1)
    found = sum(w * np.roll(whole, k, axis=0) for w, k in zip(weights, shifts, strict=True))
    return np.asarray(found)[: len(power)]


def _spectra(group: Group, _: Styles) -> Plot:
    """Map relative power over radius and temporal frequency, with one panel per sampler."""
    scale = log_scale("power / mean power", _LEAST, _MOST)
    names, panels = mask_names(list(group), 34), []
    for name, each in group.items():
        image = Heatmap(
            values=np.clip(_relative(each), _LEAST, _MOST),
            x=each["radius"].values,
            y=each["frequency"].values,
            scale=scale,
            name="power / mean power",
        )
        panels.append(
            Panel(
                marks=(image,),
                x=Axis(label="cycles per pixel", ticks={0.0: "0", 0.25: "0.25", 0.5: "0.5"}),
                y=Axis(label="cycles per frame", ticks={0.0: "0", 0.25: "0.25", 0.5: "0.5"}),
                title=names[name],
                framed=True,
            )
        )
    return Plot(
        panels=tuple(panels),
        columns=_columns(len(panels)),
        height=0.85,
        share="both",
        caption="Power of the errors over frequency in space (radial) and in time. White noise has "
        "1 everywhere. Blur removes the power at the right, and averages over frames remove the "
        "power at the top: a good mask is dark at the left and at the bottom. Frequencies in time "
        "are averaged over 1/16 cycle.",
        words="Relative power at the lowest frequencies: "
        + for_each(group, lambda each: number(float(each["relative_power"][0, 0]))),
        wide=True,
    )


def _curves(group: Group, styles: Styles) -> Plot:
    """Plot relative power over radius, and over temporal frequency."""
    first = next(iter(group.values()))
    times = first["frequency"].values
    # Each temporal frequency also stands for its negative, except the frequencies 0 and ½
    weight = np.where((times > 0) & (times < 0.5), 2.0, 1.0)
    area, names = first["radius"].values, mask_names(list(group))
    looks = {names[name]: styles[name] for name in group}
    panels = []
    for over, label in (("radius", "cycles per pixel"), ("frequency", "cycles per frame")):
        if over == "frequency" and times.size < 2:
            continue
        curves = {}
        for name, each in group.items():
            power = _relative(each)
            if over == "radius":
                known = np.average(power, axis=0, weights=weight)
            else:
                inside = np.isfinite(power[0])
                known = np.average(power[:, inside], axis=1, weights=area[inside])
            curves[names[name]] = (each[over].values, np.maximum(known, _FLOOR))
        every = np.concatenate([[0.5, 2.0], *(y for _, y in curves.values())])
        every = every[np.isfinite(every)]
        marks: tuple[Mark, ...] = (
            ReferenceLine(at=1.0, dashes="--"),
            *lines_of(curves, looks, (label, "power / mean power")),
        )
        panels.append(
            Panel(
                marks=marks,
                x=linear_axis(label, 0.0, 0.5),
                y=log_axis("power / mean power", every.min(), every.max()),
                title="over frequencies in space"
                if over == "radius"
                else "over frequencies in time",
                grid=True,
            )
        )
    return Plot(
        panels=tuple(panels),
        columns=len(panels),
        caption="Power of the errors, averaged over all frequencies in time (left) or in space "
        "(right). White noise has 1 everywhere. Frequencies in time are averaged over 1/16 cycle.",
        words="Power below 1/8 cycle per pixel relative to white noise: "
        + for_each(group, lambda each: number(float(each["low_share"]))),
        wide=True,
    )


def _errors(group: Group, _: Styles) -> Plot:
    """Show the errors of one frame, and of one row of pixels over the frames."""
    every = np.concatenate([np.ravel(each["error_image"].values) for each in group.values()])
    top = float(np.percentile(np.abs(every), _CLIPPED)) or 1.0
    scale = Scale(label="error", low=-top, high=top, palette="diverging")
    names, panels = mask_names(list(group), 34), []
    listed = list(group.items())
    kinds = [("error_image", "y", "x", "y down")]
    if listed[0][1].sizes["frame"] > 1:
        kinds.append(("error_slice", "frame", "x", "frame"))
    columns = _columns(len(listed))
    for start in range(0, len(listed), columns):
        for variable, down, across, label in kinds:
            for k in range(start, start + columns):
                if k >= len(listed):
                    panels.append(Panel(marks=(), x=Axis(ticks={}), y=Axis(ticks={}), note=" "))
                    continue
                name, each = listed[k]
                # Show as many frames as a row has pixels, for a square picture
                each = each.isel(frame=slice(each.sizes["x"]))
                image = Heatmap(
                    values=each[variable].transpose(down, across).values,
                    x=each[across].values.astype(float),
                    y=each[down].values.astype(float),
                    scale=scale,
                    name="error",
                )
                panels.append(
                    Panel(
                        marks=(image,),
                        x=Axis(label="x", ticks={}),
                        y=Axis(label=label, ticks={}, flipped=True),
                        title=names[name] if variable == "error_image" else "over time",
                        square=True,
                    )
                )
    return Plot(
        panels=tuple(panels),
        columns=columns,
        height=1.0,
        caption="Errors of the pixels of one frame, and below them the errors of one row of pixels "
        "over the frames.",
        words="Root mean square errors: "
        + for_each(group, lambda each: number(float(each["pixel_error"]) ** 0.5)),
        wide=True,
    )


_NEEDED = ("relative_power", "filtered_ratio", "error_image", "error_slice")

SCREENS: Mapping[str, tuple[tuple[str, ...], Callable[[Group, Styles], Plot]]] = {
    "screen-filters": (_NEEDED, _filters),
    "screen-spectrum": (_NEEDED, _spectra),
    "screen-curves": (_NEEDED, _curves),
    "screen-errors": (_NEEDED, _errors),
}
"""Kinds of plots for `mcspectra.rendering.screen_spectrum`, with variables and descriptions."""
