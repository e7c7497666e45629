"""Where a figure draws: panels of a new figure in the report's style, or axes that are given."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from mcspectra.core.errors import ParameterError
from mcspectra.report.style import new_figure, panel_blocks, quiet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["GivenAxes", "blocks_of", "figure_axes", "rows_of"]

GivenAxes: TypeAlias = "Axes | Iterable[Axes] | np.ndarray[Any, Any] | None"
"""Axes to draw into, one or as many as there are panels (an array is read row by row); None makes new ones."""


def rows_of(
    axes: GivenAxes, count: int, width: float, height: float, *, grid: bool = False
) -> tuple[Figure, list[Axes]]:
    """Return a figure and `count` panels below one another, with one horizontal axis.

    Parameters
    ----------
    axes
        Panels to take instead of new ones.
    count, width, height
        Number of panels, and the size of a new figure in inches.
    grid
        Whether panels have faint lines behind the data.

    Raises
    ------
    ParameterError
        `axes` are not so many matplotlib axes of one figure.
    """
    if axes is None:
        figure = new_figure(width, height)
        rows = list(figure.subplots(count, 1, squeeze=False, sharex=True)[:, 0])
    else:
        figure, rows = _given(axes, count)
        for each in rows[1:]:
            if not each.get_shared_x_axes().joined(rows[0], each):
                each.sharex(rows[0])
    for each in rows:
        quiet(each, grid=grid)
    return figure, rows


def blocks_of(
    axes: GivenAxes, count: int, parts: int, height: float
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure and its axes [item][part] as `panel_blocks` does, or the given ones in that order.

    Raises
    ------
    ParameterError
        `axes` are not count · parts matplotlib axes of one figure.
    """
    if axes is None:
        return panel_blocks(count, parts, height)
    figure, panels = _given(axes, count * parts)
    for each in panels:
        quiet(each)
    return figure, [panels[parts * item : parts * (item + 1)] for item in range(count)]


def figure_axes(figure: Figure) -> list[Axes]:
    """Axes of a figure in the order of drawing, colour bars left out."""
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


def _given(axes: Any, count: int) -> tuple[Figure, list[Axes]]:
    from matplotlib.axes import Axes

    if isinstance(axes, np.ndarray):
        axes = axes.ravel()
    panels = [axes] if isinstance(axes, Axes) else list(axes) if isinstance(axes, Iterable) else []
    figures: set[Any] = {each.figure if isinstance(each, Axes) else None for each in panels}
    if len(panels) != count or None in figures or len(figures) != 1:
        wanted = "one matplotlib Axes" if count == 1 else f"{count} matplotlib Axes of one figure"
        raise ParameterError(f"axes is {axes!r:.80}; this result takes {wanted}.")
    (figure,) = figures
    return figure, panels
