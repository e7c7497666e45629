"""Point sets: strips in 1-D, the unit square in more dims."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.report.figures.groups import Group, as_group
from mcspectra.report.figures.panels import GivenAxes, blocks_of, rows_of
from mcspectra.report.style import (
    FAINT,
    NARROW,
    LineStyle,
    entitle,
    labels,
    outer_labels,
    sampler_styles,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["point_sets"]

_MOST_VECTORS = 5000  # points; more make a PDF large and slow to open
_MOST_STRATA = 64  # lines that are still told apart in a strip


def point_sets(
    data: Group, *, styles: Mapping[str, LineStyle] | None = None, axes: GivenAxes = None
) -> Figure:
    """Draw one realisation of every sampler's points.

    Parameters
    ----------
    data
        ``points(point, axis)`` in [0,1), by sampler.
    styles
        How each sampler is drawn.
    axes
        Axes to draw into; new ones by default.

    Raises
    ------
    ParameterError
        Nothing to draw, or the variable is missing.
    """
    group = as_group(data, "points")
    styles = styles or sampler_styles(list(group))
    if all(each.sizes["axis"] == 1 for each in group.values()):
        return _strips(axes, group, styles)
    figure, blocks = blocks_of(axes, len(group), 1, 1.0)
    names = labels(list(group), 26)
    for (name, each), (panel,) in zip(group.items(), blocks, strict=True):
        _square(panel, each["points"].values, styles[name])
        entitle(panel, names[name])
        outer_labels(panel)
    return figure


def _square(axes: Axes, points: np.ndarray, style: LineStyle) -> None:
    size = float(np.clip(2400.0 / len(points), 0.6, 9.0))
    axes.scatter(
        points[:, 0],
        points[:, 1],
        s=size,
        color=style.color,
        linewidths=0,
        rasterized=len(points) > _MOST_VECTORS,
    )
    axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[0, 1], yticks=[0, 1], aspect="equal")
    for spine in axes.spines.values():
        spine.set_visible(True)
    if points.shape[1] > 2:
        axes.set_xlabel(f"axes 0 and 1 of {points.shape[1]}")


def _strips(
    given: GivenAxes, group: dict[str, xr.Dataset], styles: Mapping[str, LineStyle]
) -> Figure:
    """Draw a strip for every sampler, with the borders of n equal strata behind the points."""
    names = labels(list(group), 26)
    figure, (axes,) = rows_of(given, 1, NARROW, 0.6 + 0.42 * len(group))
    for row, (name, each) in enumerate(group.items()):
        x = each["points"].values[:, 0]
        if len(x) <= _MOST_STRATA:
            axes.vlines(np.arange(len(x) + 1) / len(x), row - 0.4, row + 0.4, FAINT, lw=0.7)
        width = 1.2 if len(x) <= _MOST_STRATA else max(0.25, 60 / len(x))
        axes.vlines(x, row - 0.3, row + 0.3, styles[name].color, lw=width)
    axes.set(xlim=(0, 1), ylim=(len(group) - 0.4, -0.6), xlabel="x")
    axes.set_yticks(range(len(group)), [names[name] for name in group])
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    return figure
