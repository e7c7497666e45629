"""Plots of scenes: maps over an image, frames of renderers, strategies, and light at a pixel."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array, as_real
from mcspectra.core.errors import ParameterError
from mcspectra.plots.description import (
    Axis,
    BarChart,
    Heatmap,
    Line,
    Mark,
    Panel,
    Pixels,
    Plot,
    ReferenceLine,
    Scale,
    Segments,
)
from mcspectra.plots.groups import Group, Styles, abreast, shared
from mcspectra.plots.scales import log_axis, log_scale
from mcspectra.plots.style import ACCENT, GRAY, PALETTE
from mcspectra.plots.text import number, percent

__all__ = [
    "MAPS",
    "STRATEGIES",
    "bounce_name",
    "incident_maps",
    "located",
    "rms_error",
    "strategy_images",
    "worst_pixels",
]

STRATEGIES = {
    "light": "light sampling",
    "bsdf": "BSDF sampling",
    "mis-light": "MIS, light share",
    "mis-bsdf": "MIS, BSDF share",
    "mis": "MIS",
    "path": "whole paths",
}
"""Names of the strategies in maps and images."""

_MIDDLE = 0.18  # displayed value of the geometric mean radiance [Reinhard2002]_
_SPREAD = (1.0, 99.0)  # percentiles at the ends of a color scale, so that outliers are clipped
_DECADES, _LIGHT_DECADES = 6, 4  # largest ranges in decades: for a map, and for radiance
_LARGEST_RATIO = 8.0  # largest ratio at the end of a color scale
_RATIOS = (0.125, 0.25, 0.5, 0.8, 1.0, 1.25, 2.0, 4.0, 8.0)
_MOST_STOPS = 64.0
_DARKEST = 1e-3  # smallest relative power that is shown
_UNCERTAIN = "the variance is 0, or its standard error exceeds half of it"
_GRAY = {
    # For each variable, the reason why some pixels have no value
    "variance": "the variance is 0",
    "rate": "too little variance, or too few realizations, for a rate",
    "rate_se": "too little variance, or too few realizations, for a rate",
    "bottleneck": "a share of MIS has no rate",
    "dominant_technique": "a share of MIS has no variance",
    "mis_gain": "a strategy has no variance that is certain",
    "predicted_ratio": "no prediction, or no measured variance",
    "bounce_share": _UNCERTAIN,
    "decision_share": _UNCERTAIN,
    "largest_bounce": _UNCERTAIN,
    "largest_decision": _UNCERTAIN,
    "best_sampler": "a sampler has no variance",
    "relative_rmse": "the mean or the variance is 0",
    "needed_spp": "the mean or the variance is 0, or the rate is unknown",
    "pixel_effective_frames": "the variance is 0",
    "variance_ratio": "a variance is 0",
    "mean": "the mean is 0",
}
_NO_SURFACE = "no lit surface is seen (a light, a mirror or nothing)"
_WORST = 5  # number of noisy pixels that are listed and marked
_RING = 0.02  # radius of the ring around a pixel, relative to the longer side of the picture
# Variables whose values are averaged over windows of pixels
_SMOOTHED = ("rate", "rate_se", "bottleneck")


def _image_map(
    group: Group,
    _: Styles,
    *,
    variable: str,
    scale: Callable[[Array], Scale],
    caption: str,
    once: bool = False,
    wide: bool = True,
) -> Plot:
    """Map a quantity over the image, with a panel per sampler and strategy, and one color scale.

    If `once` is true, the quantity does not depend on the sampler and is shown once.
    """
    # Show the largest number of samples. Predictions exist only at some of the pixels
    shown = {name: each[variable] for name, each in group.items()}
    shown = {name: data.isel(n=-1) if "n" in data.dims else data for name, data in shown.items()}
    if variable == "predicted_ratio" and all(np.isfinite(d.values).any() for d in shown.values()):
        shown = {name: d.dropna("x", how="all").dropna("y", how="all") for name, d in shown.items()}
    if once:
        shown = dict(itertools.islice(shown.items(), 1))
    if variable in ("bounce_share", "decision_share"):
        shown, nothing = _without_zeros(shown, variable.removesuffix("_share"))
        caption += f" Not shown, because all shares are 0: {nothing}." if nothing else ""
    window = next(iter(group.values())).attrs.get("smoothing", 1)
    if window > 1 and variable in _SMOOTHED:
        caption += f" Over windows of {window} × {window} pixels."
    every = np.concatenate([np.ravel(each.values) for each in shown.values()])
    found, panels = scale(every), []
    if gray := _gray(every, found, variable, next(iter(group.values()))):
        caption += f" {gray}"
    for name, data in shown.items():
        outer = next((str(dim) for dim in data.dims if dim not in ("y", "x")), None)
        for k, label in enumerate(data[outer].values if outer else [""]):
            own = data.isel({outer: k}) if outer else data
            title = bounce_name(int(label)) if outer == "bounce" else str(label)
            title = STRATEGIES.get(title, title) if outer == "strategy" else title
            alone = outer and data.sizes[outer] == 1 and len(shown) > 1
            parts = (name if len(shown) > 1 else "", "" if alone else title)
            x, y = (own[dim].values.astype(float) for dim in ("x", "y"))
            values, called = own.transpose("y", "x").values, variable.replace("_", " ")
            title = ": ".join(part for part in parts if part)
            panels.append(_over_pixels(values, x, y, found, called, title=title))
    return Plot(
        panels=tuple(panels),
        columns=abreast(len(panels)),
        caption=caption,
        words=f"Map of {x.size} × {y.size} pixels for {', '.join(group)}: "
        f"{_map_words(every[np.isfinite(every)], found)}. {caption}",
        height=float(np.clip(y.size / x.size, 0.1, 2.0)),
        share=shared(panels),
        wide=wide,
    )


def _without_zeros(
    shown: Mapping[str, xr.DataArray], outer: str
) -> tuple[dict[str, xr.DataArray], str]:
    """Omit bounces or decisions whose shares are 0 at all pixels; also return their names."""
    used = np.any([(d.fillna(0.0) != 0.0).any(("y", "x")).values for d in shown.values()], axis=0)
    if not used.any():
        return dict(shown), ""
    labels = next(iter(shown.values()))[outer].values[~used].tolist()
    names = [bounce_name(v) if outer == "bounce" else str(v) for v in labels]
    return {name: data.isel({outer: used}) for name, data in shown.items()}, ", ".join(names)


def _gray(values: Array, scale: Scale, variable: str, data: xr.Dataset) -> str:
    """Explain why some pixels of a map have no color. The text is empty if all have one."""
    lacking = ~np.isfinite(values)
    if scale.kind == "log":
        lacking |= values <= 0.0
    share = float(lacking.mean()) if lacking.size else 0.0
    if not share:
        return ""
    direct = "strategy" in data.coords and "path" not in data["strategy"].values
    why = [*([_NO_SURFACE] if direct else []), *([_GRAY[variable]] if variable in _GRAY else [])]
    reason = f": {', or '.join(why)}" if why else ""
    return f"Gray pixels ({percent(share)}) have no value{reason}."


def _over_pixels(
    values: Array,
    x: Array,
    y: Array,
    scale: Scale,
    name: str,
    *,
    labels: tuple[str, str] = ("x (pixels)", "y (pixels)"),
    title: str = "",
) -> Panel:
    """Return a panel of values per pixel, with the first row on top and limits at pixel borders."""
    return Panel(
        marks=(Heatmap(values=values, x=x, y=y, scale=scale, name=name),),
        x=Axis(label=labels[0], low=x[0] - 0.5, high=x[-1] + 0.5),
        y=Axis(label=labels[1], low=y[0] - 0.5, high=y[-1] + 0.5, flipped=True),
        title=title,
        square=True,
    )


def bounce_name(bounce: int) -> str:
    """Return the name of a bounce in titles and tables."""
    return f"bounce {bounce}" if bounce else "camera"


def _map_words(values: Array, scale: Scale) -> str:
    if not values.size:
        return "no number"
    if scale.names:
        shares = [float(np.mean(values == k + scale.low)) for k in range(len(scale.names))]
        return ", ".join(f"{n} {percent(s)}" for n, s in zip(scale.names, shares, strict=True))
    middle, low, high = (number(float(v)) for v in np.percentile(values, [50, 0, 100]))
    return f"median {middle}, from {low} to {high}"


def _logarithmic(label: str) -> Callable[[Array], Scale]:
    """Return a function that makes a logarithmic scale for positive values, without outliers."""

    def scale(values: Array) -> Scale:
        found = values[np.isfinite(values) & (values > 0)]
        low, high = (float(v) for v in np.percentile(found, _SPREAD)) if found.size else (0.1, 1.0)
        low = max(low, high * 10.0**-_DECADES)
        return log_scale(label, *((low, high) if low < high else (low / 2, high * 2)))

    return scale


def _rates(values: Array) -> Scale:
    """Return the color scale of a map of convergence exponents."""
    found = values[np.isfinite(values)]
    low, high = np.percentile(found, _SPREAD) if found.size else (-2.0, -1.0)
    # The scale includes at least −2 … −1 (smooth to random): otherwise noise looks like structure.
    # A wide scale is useless, because extreme rates come from variances of few realizations.
    low, high = max(min(low, -2.0), -3.0), min(max(high, -1.0), -0.5)
    return Scale(label="exponent of variance", low=float(low), high=float(high))


def _ratios(label: str) -> Callable[[Array], Scale]:
    """Return a function that makes a scale of ratios, which is symmetric about 1."""

    def scale(values: Array) -> Scale:
        sizes = np.abs(np.log(values[np.isfinite(values) & (values > 0)]))
        reach = float(np.exp(np.percentile(sizes, _SPREAD[1]))) if sizes.size else 2.0
        reach = min(max(reach, 1.5), _LARGEST_RATIO)
        ticks = {t: f"{t:.3g}" for t in _RATIOS if max(t, 1 / t) <= reach}
        return Scale(
            label=label, kind="log", low=1 / reach, high=reach, ticks=ticks, palette="diverging"
        )

    return scale


def _factors(values: Array) -> Scale:
    """Return a logarithmic scale of factors from 1, without outliers."""
    found = values[np.isfinite(values)]
    top = float(np.percentile(found, _SPREAD[1])) if found.size else 2.0
    ticks = {t: f"{t:g}" for t in (1.0, 1.25, 1.5, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0, 1000.0)}
    top = max(top, 1.5)
    label = "factor of the 95 % interval"
    ticks = {t: text for t, text in ticks.items() if t <= top}
    return Scale(label=label, kind="log", low=1.0, high=top, ticks=ticks, palette="sequential")


def _which(values: Array) -> Scale:
    """Return the color scale for the better of two techniques. One color means undecided."""
    del values
    names, colors = ("undecided", "light", "BSDF"), ("#FFFFFF", *PALETTE[:2])
    return Scale(kind="names", names=names, colors=colors, low=-1.0)


def _shares(values: Array) -> Scale:
    """Return a scale for shares, at least from 0 to 1. It is wider if estimates are outside."""
    found = values[np.isfinite(values)]
    low, high = np.percentile(found, _SPREAD) if found.size else (0.0, 1.0)
    return Scale(
        label="share of the variance", low=min(float(low), 0.0), high=max(float(high), 1.0)
    )


def _choice(
    group: Group, styles: Styles, *, variable: str, of: str, none: str, caption: str
) -> Plot:
    """Show which bounce, decision or sampler is chosen at each pixel; white means no choice."""
    data = next(iter(group.values()))
    labels: list[Any] = list(group) if of == "sampler" else data[of].values.tolist()
    names = (none, *(bounce_name(v) if of == "bounce" else str(v) for v in labels))
    colors = ("#FFFFFF", *(PALETTE[k % len(PALETTE)] for k in range(len(labels))))
    scale = Scale(kind="names", names=names, colors=colors, low=-1.0)
    about: dict[str, Any] = {"variable": variable, "caption": caption, "once": True}
    return _image_map(group, styles, scale=lambda _: scale, **about)


def _picture(group: Group, _: Styles, *, caption: str) -> Plot:
    """Show the mean image of frames or of the last strategy, with the noisiest pixels of a map."""
    data = next(iter(group.values()))
    if "image" in data:
        image = np.atleast_3d(data["image"].transpose("y", "x", ...).values)
        return located(image, np.zeros((0, 2)), caption=caption)
    image = data["mean"].isel(strategy=-1).transpose("y", "x").values[..., None]
    rows, columns = worst_pixels(data).T
    if rows.size:
        caption += f" Rings: the {rows.size} pixels with the largest variance."
    return located(image, np.stack([columns, rows], axis=-1), caption=caption)


def worst_pixels(data: xr.Dataset) -> Array:
    """Return rows and columns (K, 2) of at most five pixels with the largest positive variance.

    The variances are those of the last strategy with the largest n.
    In a map of a subset, only measured pixels count: around one of them, all interpolated pixels
    have a large variance.
    """
    variance = data["variance"].isel(strategy=-1, n=-1).transpose("y", "x").values
    if "measured" in data:
        variance = np.where(data["measured"].transpose("y", "x").values == 1.0, variance, np.nan)
    order = np.argsort(np.nan_to_num(variance, nan=-1.0), axis=None, kind="stable")[::-1]
    places = np.stack(np.unravel_index(order[:_WORST], variance.shape), axis=-1)
    return np.asarray(places[variance[tuple(places.T)] > 0])


def located(
    image: Array, pixels: Array, *, size: tuple[int, int] | None = None, caption: str = ""
) -> Plot:
    """Show a picture exposed to a middle gray, with rings around pixels.

    Parameters
    ----------
    image
        Linear radiance (height, width, 1) or (height, width, 3), first row on top.
    pixels
        Columns and rows (K, 2) of the marked pixels.
    size
        Width and height of the film whose pixels are marked; by default those of the image.
    """
    from mcspectra.rendering.files import encode_srgb

    values = np.clip(np.broadcast_to(np.nan_to_num(image), (*image.shape[:2], 3)), 0.0, None)
    lit = values.max(axis=-1)
    level = float(np.exp(np.log(lit[lit > 0]).mean())) if (lit > 0).any() else 1.0
    shown = np.rint(255.0 * encode_srgb(values * (_MIDDLE / level))).astype(np.uint8)
    height, width, _ = shown.shape
    columns, rows = size or (width, height)
    marks: list[Mark] = [Pixels(rgb=shown)]
    across = (pixels[:, 0] + 0.5) * width / columns
    up = height - (pixels[:, 1] + 0.5) * height / rows
    radius = _RING * max(width, height)
    turn = np.linspace(0.0, 2.0 * np.pi, 33)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=-1) * radius
    for color, thickness in (("#FFFFFF", 3.0), (ACCENT, 1.4)):
        marks += [
            Segments(
                ends=np.stack([ring[:-1], ring[1:]], axis=1) + np.array([x, y]),
                color=color,
                width=thickness,
            )
            for x, y in zip(across, up, strict=True)
        ]
    return Plot(
        panels=(
            Panel(
                marks=tuple(marks),
                square=True,
                x=Axis(low=0.0, high=width, ticks={}),
                y=Axis(low=0.0, high=height, ticks={}),
            ),
        ),
        caption=caption,
        words=f"Image of {width} × {height} pixels.",
        height=float(np.clip(height / width, 0.1, 2.0)),
    )


def _spectrum(group: Group, _: Styles) -> Plot:
    """Plot the radial power of the errors for each number of samples, relative to white noise."""
    data = next(iter(group.values()))  # the group contains a single result
    marks: list[Mark] = [ReferenceLine(at=1.0, dashes="--", label="white noise")]
    levels = []
    for k, n in enumerate(data["n"].values):
        power, ends = (
            data[name].isel(n=k).values for name in ("error_spectrum", "error_spectrum_ci")
        )
        low, high = (np.maximum(ends[:, i], _DARKEST) for i in (0, 1))
        levels += [power[power > _DARKEST], high[np.isfinite(high)]]
        color, label = PALETTE[k % len(PALETTE)], f"{n} samples per pixel"
        x = data["radius"].values
        marks.append(
            Line(x=x, y=np.maximum(power, _DARKEST), color=color, low=low, high=high, label=label)
        )
    every = np.concatenate([*levels, [0.5, 2.0]])
    return Plot(
        panels=(
            Panel(
                marks=tuple(marks),
                x=Axis(label="frequency in cycles per pixel", low=0.0, high=0.5),
                y=log_axis(
                    "power / white noise", float(every.min()) / 1.5, float(every.max()) * 1.5
                ),
                grid=True,
            ),
        ),
        caption="Radial power of the pixels' errors, each divided by the pixel's standard "
        "deviation, with 95 % intervals. White noise has 1 everywhere; blue noise has little power "
        "at low frequencies.",
        words="Radial power of the errors, from "
        + ", ".join(number(float(v)) for v in data["error_spectrum"].isel(n=-1).values[[0, -1]])
        + " at the lowest and the highest frequency.",
    )


def _correlation(group: Group, _: Styles) -> Plot:
    """Plot the correlation of errors at small lags in pixels, at the largest number of samples."""
    found = next(iter(group.values()))["error_correlation"].isel(n=-1)
    x, y = (found[dim].values.astype(float) for dim in ("lag_x", "lag_y"))
    values = found.transpose("lag_y", "lag_x").values.copy()
    values[y.size // 2, x.size // 2] = np.nan
    top = max(float(np.nanmax(np.abs(values))) if values.size > 1 else 0.0, 0.05)
    scale = Scale(label="correlation", low=-top, high=top, palette="diverging")
    return Plot(
        panels=(
            _over_pixels(
                values,
                x,
                y,
                scale,
                "correlation",
                labels=("x to the right (pixels)", "y down (pixels)"),
            ),
        ),
        caption="Correlation of the errors of two pixels by their distance. A reconstruction "
        "filter or shared points make it positive for neighbors; a blue-noise mask makes it "
        "negative.",
        words=f"Correlations of errors of neighboring pixels, at most {number(top)} in size.",
        height=1.0,
    )


def _after_filters(group: Group, _: Styles, *, name: str) -> Plot:
    """Plot the error after filtering against the parameter of the filter, next to white noise."""
    data = next(iter(group.values())).isel(n=-1)
    dim, label, words = _CURVES[name]
    x = data[dim].values.astype(float)
    order = np.argsort(x)
    x = x[order]
    variance, ends, ratio = (
        data[f"{name}_{part}"].values[order] for part in ("variance", "variance_ci", "ratio")
    )
    whole = float(data["picture_variance"])
    error, white = np.sqrt(variance / whole), np.sqrt(variance / ratio / whole)
    low, high = (np.sqrt(np.where(np.isfinite(e), e, np.nan) / whole) for e in ends.T)
    marks: list[Mark] = [
        Line(x=x, y=white, color=GRAY, dashes="--", label="white noise"),
        Line(x=x, y=error, color=PALETTE[0], low=low, high=high, label="these frames"),
    ]
    every = [error, white, low, high]
    if f"{name}_picture_ratio" in data:
        others = np.sqrt(variance / data[f"{name}_picture_ratio"].values[order] / whole)
        marks.append(Line(x=x, y=others, color=PALETTE[1], label="the other frames"))
        every.append(others)
    values = np.concatenate(every)
    values = values[np.isfinite(values) & (values > 0)]
    return Plot(
        panels=(
            Panel(
                marks=tuple(marks),
                x=log_axis(label, float(x[0]), float(x[-1])),
                y=log_axis(
                    "error / error of a frame", float(values.min()) / 1.2, float(values.max()) * 1.2
                ),
                grid=True,
            ),
        ),
        caption=f"Standard deviation after {words}, relative to that of these frames without "
        "a filter, with its 95 % interval.",
        words=f"Error after {words}, from {number(float(error[0]))} to "
        f"{number(float(error[-1]))} of the error of a frame.",
    )


_CURVES = {
    "gaussian": ("sigma", "σ in pixels", "a Gaussian filter of width σ"),
    "average": ("alpha", "weight α of the new frame", "an exponential moving average over frames"),
}


def _joint(group: Group, _: Styles) -> Plot:
    """Show the power of errors by radial and temporal frequency, relative to white noise."""
    found = next(iter(group.values()))["joint_spectrum"].isel(n=-1)
    across, along = found["frame_frequency"].values, found["radius"].values
    scale = _ratios("power / white noise")(found.values)
    return Plot(
        panels=(
            Panel(
                marks=(Heatmap(values=found.values, x=across, y=along, scale=scale, name="power"),),
                x=Axis(label="cycles per frame", low=0.0, high=0.5),
                y=Axis(label="cycles per pixel", low=0.0, high=0.5),
            ),
        ),
        caption="Power of the errors by frequency over time and between pixels, relative to white "
        "noise. Much power at the left means noise that changes slowly (boiling); much power at "
        "the bottom means blotches.",
        words="Power of the errors by temporal and spatial frequency, from "
        f"{number(float(np.nanmin(found.values)))} to {number(float(np.nanmax(found.values)))}.",
        height=0.8,
    )


def _over_time(group: Group, _: Styles) -> Plot:
    """Plot the correlation of the errors of two frames, against their distance in time."""
    data = next(iter(group.values())).isel(n=-1)
    x, y = (data[name].values.astype(float) for name in ("lag_t", "frame_correlation"))
    low, high = data["frame_correlation_ci"].values.T
    reach = float(np.nanmin([low.min(), -0.1]))
    return Plot(
        panels=(
            Panel(
                marks=(
                    ReferenceLine(at=0.0, dashes="--", label="independent frames"),
                    Line(x=x, y=y, color=PALETTE[0], low=low, high=high, label="these frames"),
                ),
                x=Axis(label="distance in frames", low=0.0, high=float(x[-1])),
                y=Axis(label="correlation of errors", low=max(reach, -1.0), high=1.05),
                grid=True,
            ),
        ),
        caption="Correlation of the errors of two frames of a sequence, with 95 % intervals.",
        words=f"Correlation of errors over time: {number(float(y[1]))} for consecutive frames.",
    )


def _frame_errors(group: Group, _: Styles) -> Plot:
    """Plot the bias and relMSE of each frame of the sequences."""
    data = next(iter(group.values())).isel(n=-1)
    x = data["frame"].values.astype(float)
    bias, square = (data[f"frame_{name}"].values * 100.0 for name in ("bias", "relmse"))
    ends, square_ends = (data[f"frame_{name}_ci"].values.T * 100.0 for name in ("bias", "relmse"))
    across = Axis(label="frame", low=float(x[0]), high=float(x[-1]))
    # With few sequences, intervals are long. Limit the axis, because long intervals hide the values
    far = 4.0 * max(float(np.nanmax(np.abs(bias))), 1e-3)
    reach = 1.1 * float(np.clip(np.nanmax(np.abs(ends)), None, far))
    top = 1.1 * float(np.clip(np.nanmax(square_ends), None, 4.0 * np.nanmax(square)))
    return Plot(
        panels=(
            Panel(
                marks=(
                    ReferenceLine(at=0.0, dashes="--"),
                    Line(x=x, y=bias, color=PALETTE[0], low=ends[0], high=ends[1]),
                ),
                x=across,
                y=Axis(label="bias in % of the mean", low=-reach, high=reach),
                grid=True,
            ),
            Panel(
                marks=(
                    Line(x=x, y=square, color=PALETTE[0], low=square_ends[0], high=square_ends[1]),
                ),
                x=across,
                y=Axis(label="relMSE in %", low=0.0, high=top or 1.0),
                grid=True,
            ),
        ),
        columns=2,
        caption="Bias and relMSE of each frame against its reference, with 95 % intervals.",
        words=f"Bias of {x.size} frames, from {number(float(np.nanmin(bias)))} % to "
        f"{number(float(np.nanmax(bias)))} %; relMSE up to {number(float(np.nanmax(square)))} %.",
        height=0.62,
    )


def _deviates(values: Array) -> Scale:
    """Return the color scale for normal deviates, clipped at ± 8."""
    finite = np.abs(values[np.isfinite(values)])
    top = float(np.clip(finite.max() if finite.size else 4.0, 4.0, 8.0))
    return Scale(label="standard errors", low=-top, high=top, palette="diverging")


def _tile_map(
    group: Group, _: Styles, *, variable: str, scale: Callable[[Array], Scale], caption: str
) -> Plot:
    """Draw a map with one value for each tile of a compared image."""
    data = next(iter(group.values()))  # the group contains a single result
    values = data[variable].transpose("y", "x").values.astype(float)
    x, y = (data[dim].values.astype(float) for dim in ("x", "y"))
    if variable == "difference":
        mean = np.abs(data["mean"].transpose("y", "x").values)
        least = 0.01 * float(np.nanmedian(mean)) if np.isfinite(mean).any() else 0.0
        if data.attrs["finest"] == 1:
            caption = caption.replace(".", ", both averaged over 5 × 5 pixels.")
            values, mean = _averaged(values), _averaged(mean)
        values = values / (np.maximum(mean, least) + 1e-300)
    size = data.attrs["finest"]
    found = scale(values)
    panel = _over_pixels(values, x, y, found, variable.replace("_", " "))
    half = size / 2
    across, down = (
        replace(axis, low=at[0] - half, high=at[-1] + half)
        for axis, at in ((panel.x, x), (panel.y, y))
    )
    if size > 1:
        caption += f" Tiles of {size} × {size} pixels."
    return Plot(
        panels=(replace(panel, x=across, y=down),),
        caption=caption,
        words=f"Map of {x.size} × {y.size} tiles: "
        f"{_map_words(values[np.isfinite(values)], found)}. {caption}",
        height=float(np.clip(y.size / x.size, 0.1, 2.0)),
    )


def _averaged(values: Array) -> Array:
    """Return means over squares of 5 × 5 pixels; pixels that are not finite are left out."""
    from scipy.ndimage import uniform_filter

    known = np.isfinite(values)
    near, count = uniform_filter(np.stack([np.where(known, values, 0.0), known]), (0, 5, 5))
    return np.asarray(np.divide(near, count, out=np.full_like(near, np.nan), where=known))


def _p_values(values: Array) -> Scale:
    """Return a logarithmic color scale for p-values. White means 1."""
    finite = values[np.isfinite(values) & (values > 0)]
    low = float(np.clip(finite.min() if finite.size else 1e-3, 1e-6, 1e-3))
    return replace(log_scale("p-value", low, 1.0), palette="sequential")


def _relative(values: Array) -> Scale:
    """Return a symmetric color scale for relative differences."""
    sizes = np.abs(values[np.isfinite(values)])
    top = float(np.percentile(sizes, _SPREAD[1])) if sizes.size else 0.0
    top = top or 1e-3
    return Scale(label="difference / reference", low=-top, high=top, palette="diverging")


def _p_histogram(group: Group, _: Styles) -> Plot:
    """Plot a histogram of the p-values of tiles. If the images are equal, it is nearly flat."""
    data = next(iter(group.values()))
    share, at = data["p_share"].values, data["bin"].values
    width = 1.0 / share.size
    top = max(float(share.max()) * 1.15, 2.0 * width)
    what = "pixels" if data.attrs["finest"] == 1 else "tiles"
    return Plot(
        panels=(
            Panel(
                marks=(
                    BarChart(at=at, value=share, color=PALETTE[0], thickness=0.9 * width),
                    ReferenceLine(at=width, dashes="--", label="equal images"),
                ),
                x=Axis(label=f"p-value of single {what}", low=0.0, high=1.0),
                y=Axis(label=f"share of the {what}", low=0.0, high=top),
                grid=True,
            ),
        ),
        caption=f"Histogram of the p-values of single {what}, without correction. Equal "
        "images give nearly equal bars, and a bias raises the bars at the left.",
        words=f"Histogram of p-values; the first bar holds {percent(float(share[0]))}.",
    )


MAPS: Mapping[str, tuple[tuple[str, ...], Callable[[Group, Styles], Plot]]] = {
    "frames-picture": (
        ("image", "relative_rmse"),
        partial(_picture, caption="Mean of the frames with the most samples."),
    ),
    "frames-spectrum": (("error_spectrum", "error_spectrum_ci"), _spectrum),
    "frames-correlation": (("error_correlation",), _correlation),
    "frames-filter": (("gaussian_variance",), partial(_after_filters, name="gaussian")),
    "frames-average": (
        ("average_variance",),
        partial(_after_filters, name="average"),
    ),
    "frames-joint": (("joint_spectrum",), _joint),
    "frames-time": (("frame_correlation", "frame_correlation_ci"), _over_time),
    "frames-errors": (("frame_bias", "frame_relmse"), _frame_errors),
    **{
        f"frames-{kind}": (
            ("relative_rmse", variable),
            partial(_image_map, variable=variable, scale=scale, caption=caption, wide=False),
        )
        for kind, variable, scale, caption in (
            (
                "relative",
                "relative_rmse",
                _logarithmic("σ / mean"),
                "Relative error of one frame with the most samples.",
            ),
            (
                "variance",
                "variance",
                _logarithmic("variance"),
                "Variance of one frame with the most samples.",
            ),
            (
                "rate",
                "rate",
                _rates,
                "Exponent of the variance in samples per pixel; random sampling has −1.",
            ),
            (
                "needed",
                "needed_spp",
                _logarithmic("samples per pixel"),
                "Samples per pixel needed for the target.",
            ),
            (
                "flip",
                "flip",
                _logarithmic("FLIP"),
                "FLIP between one frame with the most samples and the mean.",
            ),
            (
                "effective",
                "pixel_effective_frames",
                _logarithmic("independent frames"),
                (
                    "Number of independent frames whose mean is as noisy as that of a sequence, "
                    "averaged over up to 15 × 15 pixels."
                ),
            ),
            (
                "bias",
                "bias_z",
                _deviates,
                "Difference of the mean from the reference, in standard errors.",
            ),
            (
                "difference",
                "difference_z",
                _deviates,
                "Difference between the means of the two sets, in standard errors.",
            ),
            (
                "ratio",
                "variance_ratio",
                _ratios("variance / variance of the others"),
                (
                    "Variance of a frame divided by the variance of the others; below 1, these "
                    "frames are better."
                ),
            ),
        )
    },
    "gate-p": (
        ("smallest_p",),
        partial(
            _tile_map,
            variable="smallest_p",
            scale=_p_values,
            caption="Smallest p-value of all tiles around a point, corrected for all tests "
            "together. Dark regions differ from the reference.",
        ),
    ),
    "gate-difference": (
        ("difference", "smallest_p"),
        partial(
            _tile_map,
            variable="difference",
            scale=_relative,
            caption="Difference of the new frames relative to the reference.",
        ),
    ),
    "gate-histogram": (("p_share",), _p_histogram),
    "gate-single": (
        ("single_p",),
        partial(
            _tile_map,
            variable="single_p",
            scale=_p_values,
            caption="p-value of each tile alone, without correction: about 1 in 100 is below 0.01 "
            "even for equal images.",
        ),
    ),
    **{
        f"map-{kind}": (
            ("x", "y", "rate", variable),
            partial(
                _image_map, variable=variable, scale=scale, caption=caption, once=scale is _shares
            ),
        )
        for kind, variable, scale, caption in (
            (
                "mean",
                "mean",
                _logarithmic("mean estimate"),
                "Mean estimate at the largest number of samples.",
            ),
            (
                "variance",
                "variance",
                _logarithmic("variance"),
                "Variance of the estimate at the largest number of samples.",
            ),
            (
                "rate",
                "rate",
                _rates,
                "Fitted exponent of variance in the number of samples; random sampling has −1.",
            ),
            (
                "rate-se",
                "rate_se",
                _logarithmic("standard error of the rate"),
                "Standard error of the exponent.",
            ),
            (
                "bottleneck",
                "bottleneck",
                _which,
                (
                    "Technique whose share of MIS has the slower rate, by the 95 % interval of the "
                    "difference."
                ),
            ),
            (
                "dominant",
                "dominant_technique",
                _which,
                (
                    "Technique whose share of MIS has the larger variance, at the largest number "
                    "of samples."
                ),
            ),
            (
                "gain",
                "mis_gain",
                _ratios("variance of the better strategy / of MIS"),
                (
                    "Variance of the better single strategy divided by the variance of MIS, at "
                    "equal total samples. Above 1, MIS is better."
                ),
            ),
            (
                "predicted",
                "predicted_ratio",
                _ratios("predicted / measured variance"),
                "Predicted divided by measured variance, at the largest number of samples.",
            ),
            (
                "interpolation",
                "interpolation_factor",
                _factors,
                (
                    "Factor within which 95 % of the variances of interpolated pixels are, by "
                    "leaving measured pixels out. Measured pixels have 1."
                ),
            ),
            (
                "bounces",
                "bounce_share",
                _shares,
                (
                    "Variance that first appears with the random numbers of a bounce, as a share "
                    "of the total: the increase of the cumulative Sobol' index. Estimates of small "
                    "shares may be negative."
                ),
            ),
            (
                "decisions",
                "decision_share",
                _shares,
                (
                    "Variance that first appears with a decision, summed over all bounces, as a "
                    "share of the total: increases of the cumulative Sobol' index."
                ),
            ),
        )
    },
    **{
        f"map-{kind}": (
            ("x", "y", "rate", variable),
            partial(_choice, variable=variable, of=of, none=none, caption=caption),
        )
        for kind, variable, of, none, caption in (
            (
                "largest-bounce",
                "largest_bounce",
                "bounce",
                "undecided",
                (
                    "Bounce with the largest share, if the 95 % intervals of its differences from "
                    "all other bounces are above 0."
                ),
            ),
            (
                "largest-decision",
                "largest_decision",
                "decision",
                "undecided",
                (
                    "Decision with the largest share, if the 95 % intervals of its differences "
                    "from all other decisions are above 0."
                ),
            ),
            (
                "best-sampler",
                "best_sampler",
                "sampler",
                "no difference",
                (
                    "Sampler with the least variance at the largest number of samples, if the 95 % "
                    "intervals of its ratios to all other samplers are below 1."
                ),
            ),
        )
    },
    "map-picture": (
        ("x", "y", "rate", "mean"),
        partial(_picture, caption="The mean estimate as an image."),
    ),
}
"""Kinds of maps and of frame plots, with required variables and the function for the plot."""


def incident_maps(data: xr.Dataset) -> Plot:
    """Plot both maps of a result of `mcspectra.rendering.pixel.incident_light`."""
    titles = {
        "incident_radiance": "radiance of the visible lights",
        "reflected_radiance": "f: radiance × BSDF × cosine",
    }
    panels = []
    for name, title in titles.items():
        shown = data[name].transpose("elevation", "azimuth").values
        top = float(shown.max())
        # Use a logarithmic scale on which directions without light are black
        low = float(np.min(shown, where=shown > 0, initial=np.inf))
        low = min(max(low, top * 10.0**-_LIGHT_DECADES), 0.5 * top) / 2
        scale = replace(log_scale(str(data[name].attrs.get("units", "")), low, top), palette="gray")
        image = Heatmap(
            values=np.maximum(shown, low),
            x=data["azimuth"].values.astype(float),
            y=data["elevation"].values.astype(float),
            scale=scale,
            name=title,
        )
        azimuth = {float(t): f"{t}" for t in range(0, 361, 60)}
        elevation = {float(t): f"{t}" for t in (0, 30, 60, 90)}
        panels.append(
            Panel(
                marks=(image,) if top > 0 else (),
                x=Axis(label="azimuth / °", low=0.0, high=360.0, ticks=azimuth),
                y=Axis(label="elevation / °", low=0.0, high=90.0, ticks=elevation),
                title=title,
                note="" if top > 0 else "no light from the center of any cell",
            )
        )
    return Plot(
        kind="incident-light",
        panels=tuple(panels),
        caption=(
            "Incident light over the hemisphere at the surface point behind the pixel's center."
        ),
        words="Maps of radiance over azimuth and elevation, largest "
        + " and ".join(number(float(data[name].max())) for name in titles)
        + ".",
        height=0.25,
        share="both",
        wide=True,
    )


def strategy_images(images: Group, *, exposure: float = 0.0) -> Plot:
    """Plot images of one scene by each strategy at equal exposure, with their errors.

    Parameters
    ----------
    images
        Result of `mcspectra.rendering.compare_strategies`: a ``reference`` and other strategies.
        At least one strategy is needed, and all images have the same size.
    exposure
        Exposure in stops, −64 to 64. Positive values brighten all images.

    Raises
    ------
    ParameterError
        If `images` does not come from `compare_strategies`, or the exposure is out of range.
    """
    from mcspectra.rendering.files import encode_srgb

    gain = 2.0 ** as_real("exposure", exposure, least=-_MOST_STOPS, most=_MOST_STOPS)
    shapes = {data["image"].shape for data in images.values() if "image" in data}
    if "reference" not in images or len(images) < 2 or len(shapes) != 1:
        raise ParameterError(
            "images lacks a reference and at least one strategy of the same size; give the result "
            "of compare_strategies."
        )
    panels, said = [], []
    for name, data in images.items():
        each = int(data.attrs["spp"]) * int(data.attrs["realizations"])
        count = f"{each} + {each}" if data.attrs["strategy"] == "mis" else f"{each}"
        error = f"rms error {number(rms_error(data, images['reference']))}"
        if name == "reference":
            known = "image_se" in data
            error = (
                f"rms standard error {number(np.sqrt(np.mean(data['image_se'].values ** 2)))}"
                if known
                else ""
            )
        title, label = STRATEGIES.get(name, name), f"{count} samples per pixel\n{error}".strip()
        shown = np.rint(255.0 * encode_srgb(data["image"].values * gain)).astype(np.uint8)
        height, width, _ = shown.shape
        panels.append(
            Panel(
                marks=(Pixels(rgb=shown),),
                x=Axis(label=label, low=0.0, high=width, ticks={}),
                y=Axis(low=0.0, high=height, ticks={}),
                title=title,
                square=True,
            )
        )
        said.append(f"{title}: {label}".replace("\n", ", "))
    return Plot(
        kind="strategies",
        panels=tuple(panels),
        columns=len(panels),
        caption="The scene by each strategy at equal exposure. Errors are root mean squares over "
        "pixels and channels: differences from the reference, and the reference's own standard "
        "error.",
        words="; ".join(said) + ".",
        height=height / width,
        share="both",
        wide=True,
    )


def rms_error(image: xr.Dataset, reference: xr.Dataset) -> float:
    """Return the root mean square difference of two images over pixels and channels."""
    return float(np.sqrt(np.mean((image["image"].values - reference["image"].values) ** 2)))
