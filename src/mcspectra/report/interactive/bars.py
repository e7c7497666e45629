"""The three terms as bars to look into."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.figures.groups import Group, as_group
from mcspectra.report.figures.variance import TERMS, interval_of
from mcspectra.report.formatting import NEGLIGIBLE, interval, number_beside
from mcspectra.report.interactive.frame import (
    INK,
    add_hover,
    in_words,
    legend_below,
    new_plot,
    plot_color,
    set_ticks,
)
from mcspectra.report.interactive.signed import SignedScale, signed_scale
from mcspectra.report.style import LineStyle, sampler_styles
from mcspectra.report.words import for_each, term_words

if TYPE_CHECKING:
    import xarray as xr
    from bokeh.models.renderers import GlyphRenderer
    from bokeh.plotting import figure

__all__ = ["terms_plot"]

_NAMES = ("dc", "power", "cross", "predicted", "measured")
_SPREAD = 0.8  # of the room of a term that its bars take together
_BAR_PIXELS = 15


def terms_plot(data: Group, *, styles: Mapping[str, LineStyle] | None = None) -> figure:
    """Plot dc, power and cross term, their sum and the measured variance as signed bars.

    Parameters
    ----------
    data
        Results of `variance_terms`, by sampler; of several channels the first is shown.
    styles
        How each sampler is drawn.

    Raises
    ------
    ParameterError
        Nothing to draw, or a variable is missing.
    """
    group = as_group(data, *TERMS, "predicted_variance_ci", "measured_variance_ci")
    styles = styles or sampler_styles(list(group))
    values = {name: _values(each) for name, each in group.items()}
    scale = signed_scale(list(values.values()))
    plot = _empty(f"part of the variance{scale.note}", len(group))
    set_ticks(plot.xaxis, scale.ticks())
    size = _SPREAD / len(group)
    entries = {}
    for row, (name, each) in enumerate(group.items()):
        places = np.arange(5) + (row + 0.5) * size - 0.5 * _SPREAD
        source = _source(name, each, values[name], scale) | {"y": places}
        entries[name] = _bars(plot, source, styles[name], 0.9 * size)
    add_hover(
        plot,
        [drawn[0] for drawn in entries.values()],
        {"sampler": "name", "term": "term", "value": "text", "95 %": "interval"},
    )
    legend_below(plot, entries)
    words = "Bars of the three terms. " + for_each(group, term_words)
    return in_words(plot, words)  # type: ignore[no-any-return]


def _values(data: xr.Dataset) -> Array:
    """The five bars, with what is rounding beside the largest set to 0."""
    values = np.array([float(data[name]) for name in TERMS])
    largest = np.max(np.abs(values), where=np.isfinite(values), initial=0.0)
    return np.where(np.abs(values) > NEGLIGIBLE * largest, values, 0.0)


def _source(name: str, data: xr.Dataset, values: Array, scale: SignedScale) -> dict[str, Any]:
    ends = np.array([interval_of(data, term) for term in TERMS])
    # Whiskers on what is drawn as zero would be rounding.
    shown = (values != 0) & np.isfinite(ends).all(axis=1)
    largest = float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))
    low, high = scale.place(np.where(shown[:, None], ends, np.nan)).T
    return {
        "x": np.nan_to_num(scale.place(values)),
        "low": low,
        "high": high,
        "term": list(_NAMES),
        "text": [_text(float(data[term]), largest) for term in TERMS],
        "interval": [interval(float(a), float(b), 4) for a, b in ends],
        "name": [name] * 5,
        "mark": ["∞: ∫1/p diverges" if math.isinf(v) else "" for v in values],
    }


def _text(value: float, largest: float) -> str:
    if math.isinf(value):
        return "infinite: ∫1/p diverges"
    return number_beside(value, largest)


def _bars(
    plot: figure, columns: dict[str, Any], style: LineStyle, height: float
) -> list[GlyphRenderer[Any]]:
    from bokeh.models import ColumnDataSource

    source = ColumnDataSource(columns)
    color = plot_color(style)
    return [
        plot.hbar("y", height, "x", 0.0, source=source, color=color, alpha=0.85),
        plot.segment("low", "y", "high", "y", source=source, color=INK, line_width=2),
        plot.text(
            0.0, "y", "mark", source=source, color=color, text_baseline="middle", x_offset=4,
            text_font_size="11px",
        ),
    ]  # fmt: skip


def _empty(label: str, bars: int) -> figure:
    """Make a plot with a row for each term, from the top, and a line at zero."""
    from bokeh.models import DataRange1d
    from bokeh.models.annotations import Span

    plot = new_plot(
        label, "", height=90 + 5 * (_BAR_PIXELS * bars + 8), y_range=DataRange1d(flipped=True)
    )
    set_ticks(plot.yaxis, dict(enumerate(_NAMES)))
    plot.ygrid.grid_line_color = None
    plot.add_layout(Span(location=0.0, dimension="height", line_color=INK, line_width=1))
    return plot
