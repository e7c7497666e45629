"""Colours and axes of the explorer's figures, on light and dark ground.

Lines and bars take the colours of Okabe & Ito, maps cividis or a blue-orange scale: all stay apart
for colour-blind readers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

from mcspectra.report.style import PALETTE

__all__ = [
    "LOOKS",
    "Look",
    "add_color_bar",
    "add_whiskers",
    "diverging",
    "legend_outside",
    "new_figure",
    "sequential",
    "text_block",
]

_PARAGRAPHS = "p { margin: 0 0 8px 0; }"
_TOOLS = "pan,box_zoom,wheel_zoom,reset,save"


@final
@dataclass(frozen=True)
class Look:
    """Colours of one theme; `middle` is that of 0 on diverging scales.

    `equal` are the ends of the scale of weights that are all 1, and `darkest` is the first colour of
    256 that points may have, so that they stand out.
    """

    paper: str
    ink: str
    faint: str
    middle: str
    equal: tuple[float, float]
    darkest: int
    series: tuple[str, ...]


LOOKS = {
    "light": Look("#FFFFFF", "#262626", "#DCDCDC", "#F7F7F7", (1.0, 2.0), 0, PALETTE),
    "dark": Look(
        "#1B1E23",
        "#E6E6E6",
        "#3A3F47",
        "#22262C",
        (0.0, 1.0),
        80,
        # Lighter for the ground; the grey of the light theme would not be seen.
        ("#56B4E9", "#FF8A3D", "#2FCB9A", "#E79AC4", "#F0B429", "#8AB4F8", "#BDBDBD"),
    ),
}
"""Looks by the name of the theme."""


def new_figure(title: str, x_label: str, y_label: str, look: Look, **options: Any) -> Any:
    """Return an empty figure in a look; options are bokeh's."""
    from bokeh.plotting import figure

    made: Any = figure(
        title=title,
        x_axis_label=x_label,
        y_axis_label=y_label,
        tools=_TOOLS,
        aspect_ratio=1.15,
        min_width=240,
        max_width=620,
        sizing_mode="scale_width",
        toolbar_location="above",
        **options,
    )
    made.toolbar.logo = None
    made.toolbar.autohide = True
    made.background_fill_color = made.border_fill_color = look.paper
    made.outline_line_color = None
    made.title.text_color = look.ink
    made.title.text_font_size = "11pt"
    for axis in made.axis:
        axis.axis_label_text_color = axis.major_label_text_color = look.ink
        axis.axis_line_color = axis.major_tick_line_color = look.ink
        axis.minor_tick_line_color = None
        axis.axis_label_text_font_style = "normal"
    made.grid.grid_line_color = look.faint
    return made


def add_color_bar(made: Any, mapper: Any, title: str, look: Look, **options: Any) -> Any:
    """Put the scale of a colour mapper at the right of a figure and return it."""
    from bokeh.models.annotations import ColorBar

    bar = ColorBar(
        color_mapper=mapper,
        title=title,
        width=12,
        padding=4,
        background_fill_color=look.paper,
        title_text_color=look.ink,
        title_text_font_size="9pt",
        title_text_font_style="normal",
        major_label_text_color=look.ink,
        major_tick_line_color=look.ink,
        bar_line_color=None,
        **options,
    )
    made.add_layout(bar, "right")
    return bar


def add_whiskers(made: Any, source: Any, x: str, look: Look) -> None:
    """Draw the columns low and high of a source as intervals at the column x.

    Glyphs, not bokeh's annotation, which axes do not reach out for.
    """
    made.segment(x, "low", x, "high", source=source, line_color=look.ink)
    for end in ("low", "high"):
        made.scatter(x, end, source=source, marker="dash", size=9, line_color=look.ink)


def legend_outside(made: Any, look: Look) -> None:
    """Style the legend: a click hides a line."""
    for legend in made.legend:
        legend.background_fill_color = look.paper
        legend.background_fill_alpha = 0.7
        legend.border_line_color = None
        legend.label_text_color = look.ink
        legend.label_text_font_size = "9pt"
        legend.click_policy = "hide"


def sequential() -> list[str]:
    """256 colours from dark to light."""
    from bokeh.palettes import Cividis256

    return list(Cividis256)


def diverging(look: Look) -> list[str]:
    """255 colours, blue below, the ground's own at 0, orange above."""
    from bokeh.palettes import interp_palette

    return [
        *interp_palette(("#56B4E9", "#0072B2", look.middle), 128)[:-1],
        *interp_palette((look.middle, "#D55E00", "#F0B429"), 128),
    ]


def text_block(css: str = "", margin: tuple[int, int] | tuple[int, int, int, int] = (0, 10)) -> Any:
    """Return an empty block for HTML, its ``text``.

    A model of bokeh: to change it takes a tenth of the time that a pane of Panel needs.
    """
    from bokeh.models import InlineStyleSheet
    from bokeh.models.widgets.markups import Div

    style = f"{_PARAGRAPHS} {css}"
    return Div(
        sizing_mode="stretch_width",
        margin=margin,
        disable_math=True,
        stylesheets=[InlineStyleSheet(css=style)],
    )
