"""Frames of renderers: how the errors of pixels go together, and maps of their noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core.checks import Array
from mcspectra.plots.description import Axis, Image, Line, Mark, Panel, Plot, Rule, Scale
from mcspectra.plots.groups import Group, Styles
from mcspectra.plots.maps import image_map, logarithmic, picture, rates, ratios
from mcspectra.plots.scales import log_axis
from mcspectra.plots.style import PALETTE
from mcspectra.plots.text import number

__all__ = ["FRAMES"]

_DARKEST = 1e-3  # power that is still told apart


def _only(group: Group) -> xr.Dataset:
    """The first of several results; each has a page of its own."""
    return next(iter(group.values()))


def _spectrum(group: Group, styles: Styles) -> Plot:
    """Radial power of the errors for every number of samples, white noise 1."""
    del styles
    data = _only(group)
    marks: list[Mark] = [Rule(at=1.0, dashes="--", label="white noise")]
    levels = []
    for k, n in enumerate(data["n"].values):
        power, ends = (
            data[name].isel(n=k).values for name in ("error_spectrum", "error_spectrum_ci")
        )
        low, high = (np.maximum(ends[:, i], _DARKEST) for i in (0, 1))
        levels += [power[power > _DARKEST], high[np.isfinite(high)]]
        color, label = PALETTE[k % len(PALETTE)], f"{n} samples a pixel"
        x = data["radius"].values
        marks.append(
            Line(x=x, y=np.maximum(power, _DARKEST), color=color, low=low, high=high, label=label)
        )
    every = np.concatenate([*levels, [0.5, 2.0]])
    return Plot(
        kind="frames-spectrum",
        panels=(
            Panel(
                marks=tuple(marks),
                x=Axis(label="frequency in cycles a pixel", low=0.0, high=0.5),
                y=log_axis(
                    "power / white noise", float(every.min()) / 1.5, float(every.max()) * 1.5
                ),
                grid=True,
            ),
        ),
        caption="Radial power of the errors between pixels, each over its pixel's standard deviation, "
        "with 95 % intervals. White noise has 1 everywhere, blue noise little at low frequencies.",
        words="Radial power of the errors, from "
        + ", ".join(number(float(v)) for v in data["error_spectrum"].isel(n=-1).values[[0, -1]])
        + " at the lowest and the highest frequency.",
    )


def _correlation(group: Group, styles: Styles) -> Plot:
    """Correlation of pixels at small lags, for the largest number of samples."""
    del styles
    found = _only(group)["error_correlation"].isel(n=-1)
    x, y = (found[dim].values.astype(float) for dim in ("lag_x", "lag_y"))
    values = found.transpose("lag_y", "lag_x").values.copy()
    values[y.size // 2, x.size // 2] = np.nan
    top = max(float(np.nanmax(np.abs(values))) if values.size > 1 else 0.0, 0.05)
    scale = Scale(label="correlation", low=-top, high=top, palette="diverging")
    image = Image(values=values, x=x, y=y, scale=scale, name="correlation")
    return Plot(
        kind="frames-correlation",
        panels=(
            Panel(
                marks=(image,),
                x=Axis(label="x to the right", low=x[0] - 0.5, high=x[-1] + 0.5),
                y=Axis(label="y down", low=y[0] - 0.5, high=y[-1] + 0.5, flipped=True),
                square=True,
            ),
        ),
        caption="Correlation of the errors of two pixels at this distance. A reconstruction filter or shared "
        "points make neighbours alike; a mask of blue noise makes them differ.",
        words=f"Correlations of errors of neighbouring pixels, at most {number(top)} in size.",
        height=1.0,
    )


def _picture(group: Group, styles: Styles) -> Plot:
    """The mean of the frames."""
    del styles
    values = _only(group)["image"].transpose("y", "x", "band").values
    caption = "Mean of the frames of the most samples."
    return picture(values, kind="frames-picture", caption=caption)


def _map(group: Group, styles: Styles, *, kind: str, **how: Any) -> Plot:
    """A number of every pixel, half as wide as maps that stand alone."""
    return replace(image_map(group, styles, kind=f"frames-{kind}", **how), wide=False)


def _deviates(values: Array) -> Scale:
    """The scale of normal deviates: 8 and more are alike."""
    finite = np.abs(values[np.isfinite(values)])
    top = float(np.clip(finite.max() if finite.size else 4.0, 4.0, 8.0))
    return Scale(label="standard errors", low=-top, high=top, palette="diverging")


_MAPS: tuple[tuple[str, str, Callable[[Array], Scale], str], ...] = (
    ("relative", "relative_rmse", logarithmic("σ / mean"), "Relative error of one frame, of the most samples."),
    ("variance", "variance", logarithmic("variance"), "Variance of one frame, of the most samples."),
    ("rate", "rate", rates, "Exponent of the variance in samples a pixel; random sampling is −1."),
    ("needed", "needed_spp", logarithmic("samples a pixel"), "Samples a pixel that the target needs."),
    ("flip", "flip", logarithmic("FLIP"), "FLIP of one frame of the most samples against the mean."),
    ("difference", "difference_z", _deviates, "Difference of the means of the two sets, in standard errors."),
    ("ratio", "variance_ratio", ratios("variance / that of the others"), "Variance of a frame over that of the others; below 1 these are better."),
)  # fmt: skip

FRAMES: Mapping[str, tuple[tuple[str, ...], Callable[[Group, Styles], Plot]]] = {
    "frames-picture": (("image", "relative_rmse"), _picture),
    "frames-spectrum": (("error_spectrum", "error_spectrum_ci"), _spectrum),
    "frames-correlation": (("error_correlation",), _correlation),
    **{
        f"frames-{kind}": (
            ("relative_rmse", variable),
            partial(_map, kind=kind, variable=variable, scale=scale, caption=caption),
        )
        for kind, variable, scale, caption in _MAPS
    },
}
"""Kinds of plots of frames: the variables of each, and what describes it."""
