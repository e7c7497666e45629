"""The figure on a sampler's card: points, spectrum, its radial mean and its sections, a projection."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.axes import log_axis
from mcspectra.report.figures.groups import frequency_dims
from mcspectra.report.style import ACCENT, GRAY, INK, PALETTE, entitle, new_figure, quiet

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["sampler_card"]

_PANEL = 2.3  # inches
_FLOOR = 1e-8
_SECTIONS = {"axis 0": (1, 0), "axis 1": (0, 1), "diagonal": (1, 1)}


def sampler_card(points: Array, spectrum: xr.Dataset, projected: Array | None = None) -> Figure:
    """Draw what a sampler looks like.

    Parameters
    ----------
    points
        One realisation, (n, d).
    spectrum
        Result of `power_spectrum` in the same dims.
    projected
        Two coordinates of a set in more dims, (n, 2).
    """
    dims = points.shape[1]
    panels = 3 if dims == 1 else 4 + (projected is not None)
    figure = new_figure(panels * _PANEL, _PANEL + 0.25)
    rest = list(figure.subplots(1, panels))
    for axes in rest:
        quiet(axes)
    _points(rest.pop(0), points)
    if dims == 2:
        _image(rest.pop(0), spectrum)
    _radial(rest.pop(0), spectrum, dims)
    if dims <= 2:
        _sections(rest.pop(0), spectrum, dims)
    if projected is not None and rest:
        _points(rest.pop(0), projected)
        figure.axes[-1].set(xlabel="x₂", ylabel="x₃")
        entitle(figure.axes[-1], f"4-D: axes 2, 3 (n = {len(projected)})")
    for axes in rest:
        axes.remove()
    return figure


def _points(axes: Axes, points: Array) -> None:
    n, dims = points.shape
    x, y = points[:, 0], points[:, 1] if dims > 1 else np.zeros(n)
    if dims == 1:
        axes.vlines(x, 0.25, 0.75, color=INK, linewidth=max(0.3, 20.0 / n))
        axes.set(xlim=(0, 1), ylim=(0, 1), yticks=[], xlabel="x₀")
    else:
        size = float(np.clip(1000.0 / n, 0.5, 7.0))
        axes.scatter(x, y, s=size, color=INK, linewidths=0)
        axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[0, 1], yticks=[0, 1], xlabel="x₀", ylabel="x₁")
        axes.set_aspect("equal")
        axes.xaxis.labelpad = axes.yaxis.labelpad = -6
    for spine in axes.spines.values():
        spine.set_visible(True)
    entitle(axes, f"points, n = {n}")


def _image(axes: Axes, spectrum: xr.Dataset) -> None:
    power = _scaled(spectrum)
    half = len(power) // 2
    power[half, half] = np.nan
    axes.imshow(
        power.T, origin="lower", extent=(-half - 0.5, half + 0.5, -half - 0.5, half + 0.5),
        vmin=0.0, vmax=2.0, cmap="viridis", interpolation="nearest",
    )  # fmt: skip
    axes.set(xticks=[-half, 0, half], yticks=[-half, 0, half], xlabel="m₀", ylabel="m₁")
    axes.xaxis.labelpad, axes.yaxis.labelpad = -1, -8
    entitle(axes, "n · power, 0 to 2")


def _radial(axes: Axes, spectrum: xr.Dataset, dims: int) -> None:
    n = int(spectrum.attrs["n"])
    radius = spectrum["radius"].values / n ** (1.0 / dims)
    power = np.maximum(n * spectrum["radial_power"].values, _FLOOR)
    axes.grid(True, which="major", color="#DCDCDC", linewidth=0.5)
    axes.axhline(1.0, color=GRAY, lw=0.9)
    axes.plot(radius, power, color=PALETTE[0], lw=1.3)
    low = min(0.05, float(power.min()))  # the level of random points is not to look like noise
    log_axis(axes, "y", low, max(2.0, float(power.max())), 4)
    log_axis(axes, "x", float(radius.min()), float(radius.max()), 4)
    axes.set(xlabel="|m| / " + {1: "n", 2: "√n"}.get(dims, f"n^(1/{dims})"))
    entitle(axes, "n · radial mean")


def _sections(axes: Axes, spectrum: xr.Dataset, dims: int) -> None:
    """Power along the axes, where projections on them show, and along the diagonal."""
    power = _scaled(spectrum)
    half = len(power) // 2
    m = np.arange(1, half + 1)
    axes.axhline(1.0, color=GRAY, lw=0.9)
    colors = (PALETTE[0], ACCENT, PALETTE[2])
    if dims == 1:
        axes.plot(m, power[half + m], color=colors[0], lw=1.0)
        top = float(power[half + m].max())
    else:
        top = 1.5
        for (name, (a, b)), color in zip(_SECTIONS.items(), colors, strict=True):
            line = power[half + a * m, half + b * m]
            axes.plot(m, line, color=color, lw=1.0, label=name)
            top = max(top, float(line.max()))
        axes.legend(fontsize=6.0, frameon=False, handlelength=1.2, loc="upper left")
    axes.set(ylim=(0, min(1.4 * top, 4.0)), xlim=(0, half), xlabel="m")
    entitle(axes, "n · power" if dims == 1 else "n · power along")


def _scaled(spectrum: xr.Dataset) -> Array:
    names = frequency_dims(spectrum)
    return np.array(int(spectrum.attrs["n"]) * spectrum["power"].transpose(*names).values)
