"""Power spectra, n times the power so that random sampling is 1: images, lines, radial means."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.report.axes import log_axis
from mcspectra.report.figures.groups import Group, as_group, frequency_dims
from mcspectra.report.figures.panels import GivenAxes, blocks_of, rows_of
from mcspectra.report.style import (
    GRAY,
    NARROW,
    LineStyle,
    entitle,
    labels,
    legend_below,
    line_widths,
    outer_labels,
    quiet_colorbar,
    sampler_styles,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "color_top",
    "power_images",
    "power_label",
    "power_lines",
    "radial_power",
    "random_level",
    "without_dc",
]

_FLOOR = 1e-4  # n·power shown at least: below it a set is as good as free of noise
_LINEAR_TOP = 12.0  # up to here lines are drawn on a linear axis


def power_images(data: Group, *, axes: GivenAxes = None) -> Figure:
    """Draw two-dimensional spectra side by side, on one colour scale, dc masked.

    Parameters
    ----------
    data
        ``power(m0, m1)`` by sampler, with attribute ``n``.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, or the spectra are not two-dimensional.
    """
    group = as_group(data, "power")
    images = {name: without_dc(each, 2) for name, each in group.items()}
    figure, blocks = blocks_of(axes, len(group), 1, 1.0)
    names = labels(list(group), 26)
    top = color_top(list(images.values()))
    for (name, each), (panel,) in zip(group.items(), blocks, strict=True):
        m0, m1 = each["m0"].values, each["m1"].values
        drawn = panel.imshow(
            images[name].T,
            origin="lower",
            extent=(*_edges(m0), *_edges(m1)),
            vmin=0.0,
            vmax=top,
            cmap="viridis",
            interpolation="nearest",
        )
        entitle(panel, names[name])
        panel.set(xlabel="m₀", ylabel="m₁")
        panel.set_xticks([m0[0], 0, m0[-1]])
        panel.set_yticks([m1[0], 0, m1[-1]])
        outer_labels(panel)
    bar = figure.colorbar(
        drawn, ax=[b[0] for b in blocks], extend="max", shrink=0.85, aspect=24, pad=0.02
    )
    quiet_colorbar(bar, power_label(group.values()))
    return figure


def power_lines(
    data: Group, *, styles: Mapping[str, LineStyle] | None = None, axes: GivenAxes = None
) -> Figure:
    """Draw one-dimensional spectra as lines over m, dc left out, with the level of random points.

    Parameters
    ----------
    data
        ``power(m0)`` by sampler, with attribute ``n``.
    styles
        How each sampler is drawn.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, or the spectra are not one-dimensional.
    """
    group = as_group(data, "power")
    curves = {n: (d["m0"].values, without_dc(d, 1)) for n, d in group.items()}
    figure, panel = _lines(axes, curves, styles or sampler_styles(list(group)), log_x=False)
    panel.set(xlabel="frequency m (cycles per unit)", ylabel=power_label(group.values()))
    return figure


def radial_power(
    data: Group, *, styles: Mapping[str, LineStyle] | None = None, axes: GivenAxes = None
) -> Figure:
    """Draw the mean power over directions against |m| in units of n^(1/d).

    Parameters
    ----------
    data
        ``radial_power(radius)`` by sampler, with attribute ``n`` and the dims m0, m1, …
    styles
        How each sampler is drawn.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, or a variable is missing.
    """
    group = as_group(data, "radial_power", "power")
    curves = {}
    for name, each in group.items():
        n, dims = int(each.attrs["n"]), len(frequency_dims(each))
        scale = n / random_level(each)
        curves[name] = (
            each["radius"].values / n ** (1 / dims),
            scale * each["radial_power"].values,
        )
    figure, panel = _lines(axes, curves, styles or sampler_styles(list(group)), log_x=True)
    root = {1: "n", 2: "√n", 3: "∛n"}.get(dims, f"n^(1/{dims})")
    panel.set(xlabel=f"|m| / {root}", ylabel=power_label(group.values()))
    return figure


def _lines(
    given: GivenAxes,
    curves: Mapping[str, tuple[Array, Array]],
    styles: Mapping[str, LineStyle],
    *,
    log_x: bool,
) -> tuple[Figure, Axes]:
    names = labels(list(curves), 40)
    height = 2.9 + 0.16 * ((len(curves) + 1) // 2)
    figure, (axes,) = rows_of(given, 1, NARROW, height, grid=True)
    axes.axhline(1.0, color=GRAY, lw=0.9, zorder=1)
    everything = np.concatenate([y[np.isfinite(y)] for _, y in curves.values()])
    top, low = float(everything.max(initial=1.5)), float(everything.min(initial=0.5))
    log_y = log_x or top > _LINEAR_TOP
    for (name, (x, y)), width in zip(curves.items(), line_widths(len(curves)), strict=True):
        style = styles[name]
        shown = np.maximum(y, _FLOOR) if log_y else y
        axes.plot(x, shown, color=style.color, ls=style.dashes, lw=width, label=names[name])
    if log_y:
        log_axis(axes, "y", max(low, _FLOOR), top)
    else:
        axes.set_ylim(0.0, 1.08 * top)
    if log_x:
        xs = np.concatenate([x[x > 0] for x, _ in curves.values()])
        log_axis(axes, "x", float(xs.min(initial=1.0)), float(xs.max(initial=1.0)))
    legend_below(figure, axes)
    return figure, axes


def random_level(data: xr.Dataset) -> float:
    """∫1/p of the points' density, what n · power is for random points; 1 where it diverges."""
    level = float(data.attrs.get("random_level", 1.0))
    return level if np.isfinite(level) else 1.0


def power_label(datasets: Iterable[xr.Dataset]) -> str:
    """Label of an axis of n · power, divided by ∫1/p where there is a density."""
    weighted = any(random_level(each) != 1.0 for each in datasets)
    return f"n · ⟨|Sₘ|²⟩{' / ∫1/p' if weighted else ''}   (random: 1)"


def without_dc(data: xr.Dataset, dims: int) -> Array:
    """Return n · power over that of random points, with NaN at m = 0."""
    names = frequency_dims(data)
    if len(names) != dims:
        raise ParameterError(
            f"The spectrum has {len(names)} frequency dims; this figure shows {dims}: "
            "use radial_power for any number of dims."
        )
    scale = int(data.attrs["n"]) / random_level(data)
    power = scale * data["power"].transpose(*names).values
    centre = tuple(size // 2 for size in power.shape)
    power[centre] = np.nan
    return np.asarray(power)


def _edges(m: Array) -> tuple[float, float]:
    half = float(m[1] - m[0]) / 2 if len(m) > 1 else 0.5
    return float(m[0]) - half, float(m[-1]) + half


def color_top(images: list[Array]) -> float:
    """End of the colour scale: 2, or what all but 1 % of the frequencies stay below."""
    return max(2.0, float(np.nanpercentile(np.concatenate([i.ravel() for i in images]), 99.0)))
