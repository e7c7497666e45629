"""Point sets to look into."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.report.figures.groups import Group, as_group
from mcspectra.report.formatting import number, shorten
from mcspectra.report.interactive.frame import (
    add_hover,
    in_words,
    new_plot,
    panel_row,
    plot_color,
    set_ticks,
)
from mcspectra.report.style import LineStyle, sampler_styles

if TYPE_CHECKING:
    import xarray as xr
    from bokeh.models import LayoutDOM
    from bokeh.plotting import figure

__all__ = ["points_plot"]

_SIDE = 284  # pixels of a panel


def points_plot(data: Group, *, styles: Mapping[str, LineStyle] | None = None) -> LayoutDOM:
    """Plot one realisation of every sampler's points: squares side by side, or in 1-D strips.

    Parameters
    ----------
    data
        ``points(point, axis)`` in [0,1), by sampler; with ``weights(point)``, the areas of the
        marks are in proportion to the sizes of the weights.
    styles
        How each sampler is drawn.

    Raises
    ------
    ParameterError
        Nothing to draw, or the variable is missing.
    """
    group = as_group(data, "points")
    styles = styles or sampler_styles(list(group))
    if all(each.sizes["axis"] == 1 for each in group.values()):
        drawn: LayoutDOM = _strips(group, styles)
    else:
        drawn = panel_row([_square(n, each, styles[n]) for n, each in group.items()])
    words = "; ".join(f"{name}: {each.sizes['point']} points" for name, each in group.items())
    return in_words(drawn, f"One realisation. {words}.")  # type: ignore[no-any-return]


def _square(name: str, data: xr.Dataset, style: LineStyle) -> figure:
    from bokeh.models import ColumnDataSource

    x = data["points"].values
    more = f" ({x.shape[1]} axes)" if x.shape[1] > 2 else ""
    plot = new_plot(
        f"x₀{more}", "x₁", height=_SIDE, width=_SIDE, sizing_mode="fixed",
        x_range=(0, 1), y_range=(0, 1), 
        title=name,
    )  # fmt: skip
    second = x[:, 1] if x.shape[1] > 1 else np.full(len(x), 0.5)
    columns = {"x": x[:, 0], "y": second, **_shared_columns(name, data, len(x))}
    marks = plot.scatter(
        "x", "y", size="size", source=ColumnDataSource(columns), color=plot_color(style), alpha=0.9
    )
    rows = {"point": "index", "x₀": "x", "x₁": "y"}
    add_hover(plot, [marks], rows | ({"weight": "weight"} if "weights" in data else {}))
    return plot


def _strips(group: Mapping[str, xr.Dataset], styles: Mapping[str, LineStyle]) -> figure:
    """Plot a strip of marks for every sampler."""
    from bokeh.models import ColumnDataSource, DataRange1d

    rows = DataRange1d(flipped=True)
    plot = new_plot("x", "", height=110 + 46 * len(group), x_range=(0, 1), y_range=rows)
    set_ticks(plot.yaxis, {row: shorten(name, 22) for row, name in enumerate(group)})
    plot.ygrid.grid_line_color = None
    marks = []
    for row, (name, each) in enumerate(group.items()):
        x = each["points"].values[:, 0]
        columns = {"x": x, "y": np.full(len(x), row), **_shared_columns(name, each, len(x))}
        marks.append(
            plot.scatter(
                "x", "y", source=ColumnDataSource(columns), marker="dash", angle=np.pi / 2,
                size=26, line_width=2, color=plot_color(styles[name]),
            )
        )  # fmt: skip
    add_hover(plot, marks, {"sampler": "name", "point": "index", "x": "x"})
    return plot


def _shared_columns(name: str, data: xr.Dataset, count: int) -> dict[str, Any]:
    size = float(np.clip(90.0 / np.sqrt(count), 1.5, 7.0))
    columns: dict[str, Any] = {
        "index": np.arange(count),
        "name": [name] * count,
        "size": np.full(count, size),
    }
    if "weights" in data:
        weights = np.abs(data["weights"].values)
        mean = float(weights.mean()) or 1.0
        columns["size"] = size * np.sqrt(np.minimum(weights / mean, 16.0))
        columns["weight"] = [number(float(w), 4) for w in data["weights"].values]
    return columns
