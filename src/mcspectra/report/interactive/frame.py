"""What all interactive figures share: tools, quiet axes, legends that hide lines, words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from mcspectra.report.axes import log_ticks, tick_label
from mcspectra.report.formatting import shorten
from mcspectra.report.style import LineStyle

if TYPE_CHECKING:
    from bokeh.models import LayoutDOM
    from bokeh.models.renderers import GlyphRenderer
    from bokeh.plotting import figure

__all__ = [
    "BOKEH_DASHES",
    "BOKEH_MARKERS",
    "GRID",
    "INK",
    "add_hover",
    "alt_text",
    "in_words",
    "legend_below",
    "new_plot",
    "panel_row",
    "plain_text",
    "plot_color",
    "set_log_ticks",
    "set_ticks",
]

INK = "#767676"
"""Text and axes: this grey has a contrast of 4.5 to white and of 3.9 to the dark page."""
GRID = "rgba(128, 128, 128, 0.25)"
BOKEH_MARKERS = {
    "o": "circle",
    "s": "square",
    "^": "triangle",
    "D": "diamond",
    "v": "inverted_triangle",
    "P": "plus",
    "X": "x",
}
BOKEH_DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dashdot"}
_ON_DARK = {"#4D4D4D": "#8A8A8A"}  # the palette's near-black would vanish on a dark page
_LEGEND_ROW = 21  # pixels
_TOOLS = "pan,box_zoom,wheel_zoom,reset,save"


def new_plot(
    x_label: str, y_label: str, *, title: str = "", height: int = 340, **options: Any
) -> figure:
    """Make an empty plot as wide as its place, with tools but none active.

    An active drag or wheel tool would take the gestures that scroll the page.

    Parameters
    ----------
    x_label, y_label
        Labels of the axes, plain text.
    title
        Title, plain text; a long one loses its middle.
    height
        Height in pixels.
    **options
        Further arguments of `bokeh.plotting.figure`, such as axis types and ranges.
    """
    from bokeh.models.annotations import Title
    from bokeh.plotting import figure

    chosen = {"sizing_mode": "stretch_width", "height": height, **options}
    plot = figure(
        tools=_TOOLS,
        active_drag=None,
        active_scroll=None,
        toolbar_location="above",
        background_fill_color=None,
        border_fill_color=None,
        outline_line_color=None,
        **chosen,
    )
    plot.toolbar.logo = None
    for axis, label in ((plot.xaxis, x_label), (plot.yaxis, y_label)):
        axis.axis_label = plain_text(label)
        _quiet(axis)
    plot.grid.grid_line_color = GRID
    if title:
        short = plain_text(shorten(title, 34))
        plot.title = Title(text=short, text_color=INK, text_font_style="normal")
    return plot


def _quiet(axis: Any) -> None:
    axis.axis_label_text_color = axis.major_label_text_color = INK
    axis.axis_label_text_font_style = "normal"
    axis.axis_line_color = axis.major_tick_line_color = INK
    axis.minor_tick_line_color = None


def set_ticks(axis: Any, ticks: Mapping[float, str]) -> None:
    """Put ticks at given places, with given texts."""
    from bokeh.models import FixedTicker

    axis.ticker = FixedTicker(ticks=list(ticks))
    axis.major_label_overrides = {place: plain_text(text) for place, text in ticks.items()}


def set_log_ticks(axis: Any, low: float, high: float) -> None:
    """Put ticks on a logarithmic axis, also where it spans less than a decade."""
    if math.isfinite(low) and 0.0 < low <= high:
        set_ticks(axis, {tick: tick_label(tick) for tick in log_ticks(low, high)})


def add_hover(
    plot: figure,
    renderers: Sequence[GlyphRenderer[Any]],
    rows: Mapping[str, str],
    mode: Literal["mouse", "hline", "vline"] = "mouse",
) -> None:
    """Show a column of each renderer's source under the pointer: `rows` is title → column."""
    from bokeh.models import HoverTool

    tips = [(title, f"@{{{column}}}") for title, column in rows.items()]
    # One button in the toolbar turns tooltips off; more hover tools would each show their own.
    visible = not any(isinstance(tool, HoverTool) for tool in plot.tools)
    plot.add_tools(HoverTool(renderers=list(renderers), tooltips=tips, mode=mode, visible=visible))


def legend_below(
    plot: figure,
    entries: Mapping[str, Sequence[GlyphRenderer[Any]]],
    notes: Mapping[str, str] | None = None,
) -> None:
    """Put a legend under the plot, a row for each entry; a click hides or shows its marks.

    A long name loses its middle; the `notes` that follow names are kept in full.
    """
    from bokeh.models.annotations import Legend, LegendItem

    items = [
        LegendItem(
            label=plain_text(shorten(name, 32) + (notes or {}).get(name, "")),
            renderers=list(renderers),
        )
        for name, renderers in entries.items()
    ]
    legend = Legend(
        items=items,
        click_policy="hide",
        location="top_left",
        orientation="vertical",
        background_fill_color=None,
        border_line_color=None,
        label_text_color=INK,
        label_text_font_size="12px",
        inactive_fill_color="rgba(128, 128, 128, 0.35)",
        spacing=0,
        margin=0,
    )
    plot.add_layout(legend, "below")
    if plot.height is not None:
        plot.height += _LEGEND_ROW * len(items)


def panel_row(plots: Sequence[figure]) -> LayoutDOM:
    """Set plots side by side, in as many rows as the page is narrow; one plot stays as it is."""
    from bokeh.models import Row

    if len(plots) == 1:
        return plots[0]
    for plot in plots[1:]:
        plot.x_range, plot.y_range = plots[0].x_range, plots[0].y_range
    return Row(
        children=list(plots),
        sizing_mode="stretch_width",
        styles={"flex-wrap": "wrap", "justify-content": "center", "gap": "8px"},
    )


def in_words(plot: LayoutDOM, text: str) -> Any:
    """Attach what the plot shows in words, for `alt_text`; returns the plot."""
    plot.tags = [text]
    return plot


def alt_text(plot: LayoutDOM) -> str:
    """What a plot of this package shows, in words: the label of the element that holds it."""
    return str(plot.tags[0]) if plot.tags else ""


def plot_color(style: LineStyle) -> str:
    """A style's colour as it is seen on light and dark pages."""
    return _ON_DARK.get(style.color, style.color)


def plain_text(text: str) -> str:
    r"""Keep bokeh from reading ``$$…$$``, ``\(…\)`` or ``\[…\]`` as TeX, which it would load."""
    joiner = "\u2060"  # invisible, no width
    for mark in ("$$", r"\(", r"\["):
        text = text.replace(mark, f"{mark[0]}{joiner}{mark[1]}")
    return text
