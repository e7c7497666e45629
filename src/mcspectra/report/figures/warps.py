"""Warps and primary-space integrands: images of a grid, stretch, and where they jump."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.report.axes import log_ticks
from mcspectra.report.figures.groups import Group, as_group
from mcspectra.report.figures.panels import GivenAxes, blocks_of
from mcspectra.report.style import (
    ACCENT,
    GRAY,
    INK,
    entitle,
    labels,
    legend_below,
    quiet_colorbar,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

__all__ = ["primary_pictures", "warp_maps"]

_LINES = 16  # of the grid whose image is drawn, along each axis
_MOST_STRETCH = 100.0
_BOUNDARY = "#0072B2"
_CLIPPED = 0.5  # per cent of the values at either end, where poles would hide the rest


def warp_maps(data: Group, *, axes: GivenAxes = None) -> Figure:
    """Draw how a warp distorts a grid and, on primary space, its stretch and its jumps.

    Parameters
    ----------
    data
        Results of `mcspectra.warp_quality`, one or several by name, all in 1-D or all in 2-D.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, a variable is missing, or results of different dims.
    """
    group = as_group(data, "warped", "stretch", "jump")
    group = _by_spec(group, "density")
    if _dims(group) == 1:
        return _curves(axes, group, "warped", "jump", "x = T(u)")[0]
    figure, blocks = blocks_of(axes, len(group), 2, 1.0)
    names = labels(list(group), 26)
    top = min(_MOST_STRETCH, max(2.0, *(_largest(each["stretch"]) for each in group.values())))
    for (name, each), (image, stretch) in zip(group.items(), blocks, strict=True):
        _warped_grid(image, each)
        entitle(image, names[name])
        _stretch_map(stretch, each, top)
        jumps = float(each["jump_length"])
        torn = f"jumps of length {jumps:.3g}" if jumps else "continuous"
        stretch.set_xlabel(f"u₀\n{torn}\nmean stretch {float(each['mean_stretch']):.3g}")
    bar = figure.colorbar(
        blocks[0][1].images[0], ax=[block[1] for block in blocks], shrink=0.85, aspect=24, pad=0.02
    )
    ticks = log_ticks(1.0, top)
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.minorticks_off()
    quiet_colorbar(bar, "stretch")
    return figure


def primary_pictures(data: Group, *, axes: GivenAxes = None) -> Figure:
    """Draw primary-space integrands g(u) with their jumps inside and between opposite sides.

    Parameters
    ----------
    data
        Results of `mcspectra.primary_picture`, one or several by name, all in 1-D or all in 2-D; of
        several channels the first is shown.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, a variable is missing, or results of different dims.
    """
    group = as_group(data, "primary_value", "primary_jump", "face_jump")
    group = _by_spec(group, "estimator")
    if _dims(group) == 1:
        figure, panels = _curves(axes, group, "primary_value", "primary_jump", "g(u)")
    else:
        figure, blocks = blocks_of(axes, len(group), 1, 1.0)
        panels = [block[0] for block in blocks]
        names = labels(list(group), 26)
        for (name, each), panel in zip(group.items(), panels, strict=True):
            _value_map(figure, panel, each)
            entitle(panel, names[name])
    for panel, each in zip(panels, group.values(), strict=True):
        panel.set_xlabel(f"{panel.get_xlabel()}\n{_jumps_in_words(each)}")
    panels[0].plot([], [], color=ACCENT, lw=1.4, label="jump inside")
    panels[0].plot([], [], color=_BOUNDARY, lw=3, label="jump between opposite sides")
    legend_below(figure, panels[0])
    return figure


def _by_spec(group: dict[str, xr.Dataset], attribute: str) -> dict[str, xr.Dataset]:
    """A single dataset is called by the spec that it carries."""
    if list(group) != ["sampler"]:
        return group
    (each,) = group.values()
    return {str(each.attrs.get(attribute, "")): each}


def _dims(group: dict[str, xr.Dataset]) -> int:
    found = {each.sizes["axis"] for each in group.values()}
    if len(found) > 1:
        raise ParameterError(
            "Results in 1-D and in 2-D go into different figures; draw each apart."
        )
    return found.pop()


def _curves(
    given: GivenAxes, group: dict[str, xr.Dataset], value: str, jump: str, label: str
) -> tuple[Figure, list[Axes]]:
    """Functions of one variable, interrupted where they jump."""
    figure, blocks = blocks_of(given, len(group), 1, 0.75)
    names = labels(list(group), 26)
    for (name, each), (axes,) in zip(group.items(), blocks, strict=True):
        u, y = each["u0"].values, each[value].values.reshape(each.sizes["u0"], -1)[:, 0]
        places = np.flatnonzero(each[jump].values[0])
        borders = 0.5 * (u[places] + u[np.minimum(places + 1, u.size - 1)])
        axes.plot(np.insert(u, places + 1, borders), np.insert(y, places + 1, np.nan), INK, lw=1.2)
        for border in borders:
            axes.axvline(border, color=ACCENT, lw=1.4)
        if "face_jump" in each and float(each["face_jump"].values[0]) > 0:
            for end in (0.0, 1.0):
                axes.axvline(end, color=_BOUNDARY, lw=3)
        axes.set(xlim=(0, 1), xlabel="u", ylabel=label)
        entitle(axes, names[name])
    return figure, [block[0] for block in blocks]


def _warped_grid(axes: Axes, data: xr.Dataset) -> None:
    """The images of a few grid lines of each axis, broken where T jumps along them."""
    x = data["warped"].transpose("u0", "u1", "coordinate").values
    torn = data["jump"].transpose("axis", "u0", "u1").values > 0
    rows = np.unique(np.linspace(0, len(x) - 1, _LINES + 1).astype(int))
    lines = [_broken(x[:, j], torn[0, :, j]) for j in rows]
    lines += [_broken(x[i], torn[1, i]) for i in rows]
    for k, line in enumerate(lines):
        color = INK if k < len(rows) else GRAY
        axes.plot(line[:, 0], line[:, 1], color=color, lw=0.6, solid_capstyle="round")
    _square(axes)
    axes.set(xlabel="x₀", ylabel="x₁")


def _broken(line: Array, torn: Array) -> Array:
    """Points (k, 2) of a line with a gap after those marked."""
    return np.insert(line, np.flatnonzero(torn[:-1]) + 1, np.nan, axis=0)


def _stretch_map(axes: Axes, data: xr.Dataset, top: float) -> None:
    from matplotlib.colors import LogNorm

    stretch = data["stretch"].transpose("u0", "u1").values
    axes.imshow(
        np.clip(stretch, 1.0, top).T,
        origin="lower",
        extent=(0, 1, 0, 1),
        norm=LogNorm(1.0, top),
        cmap="Greys",
        interpolation="nearest",
    )
    axes.add_collection(_segments(data["jump"].transpose("axis", "u0", "u1").values))
    _square(axes)
    axes.set_ylabel("u₁")


def _value_map(figure: Figure, axes: Axes, data: xr.Dataset) -> None:
    values = data["primary_value"].transpose("u0", "u1").values
    low, high = np.percentile(values, [_CLIPPED, 100 - _CLIPPED])
    drawn = axes.imshow(
        values.T,
        origin="lower",
        extent=(0, 1, 0, 1),
        vmin=low,
        vmax=high if high > low else low + 1.0,
        cmap="Greys_r",
        interpolation="nearest",
    )
    axes.add_collection(_segments(data["primary_jump"].transpose("axis", "u0", "u1").values))
    _square(axes)
    for axis, jumps in enumerate(data["face_jump"].transpose("axis", "along").values > 0):
        along = np.where(jumps, data["u0"].values, np.nan)
        for end in (0.0, 1.0):
            across = np.full(along.shape, end)
            line = (across, along) if axis == 0 else (along, across)
            axes.plot(*line, color=_BOUNDARY, lw=4, clip_on=False, solid_capstyle="butt")
    axes.set(xlabel="u₀", ylabel="u₁")
    bar = figure.colorbar(drawn, ax=axes, shrink=0.8, aspect=20, pad=0.03)
    bar.ax.locator_params(axis="y", nbins=4)
    quiet_colorbar(bar, "")


def _segments(heights: Array) -> LineCollection:
    """Sides of cells across which there is a jump, heights (2, N, N)."""
    from matplotlib.collections import LineCollection

    side = heights.shape[1]
    lines = []
    for axis, each in enumerate(heights):
        far = np.argwhere(each > 0) + 1
        near = far.copy()
        near[:, 1 - axis] -= 1
        lines.append(np.stack([near, far], axis=1))
    return LineCollection(
        list(np.concatenate(lines) / side), colors=ACCENT, linewidths=1.4, capstyle="round"
    )


def _square(axes: Axes) -> None:
    axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[0, 1], yticks=[0, 1], aspect="equal")
    for spine in axes.spines.values():
        spine.set_visible(True)


def _largest(stretch: xr.DataArray) -> float:
    values = stretch.values[np.isfinite(stretch.values)]
    return float(values.max(initial=1.0))


def _jumps_in_words(data: xr.Dataset) -> str:
    """``inside 1.89 × 1, sides none``: lengths times mean heights."""
    words = []
    for kind, word in (("interior", "inside"), ("boundary", "sides")):
        length = float(data["primary_jump_length"].sel(kind=kind))
        height = float(data["primary_jump_height"].sel(kind=kind))
        size = "unbounded" if np.isinf(height) else f"{length:.3g} × {height:.3g}"
        words.append(f"{word} {size if length or np.isinf(height) else 'none'}")
    return ", ".join(words)
