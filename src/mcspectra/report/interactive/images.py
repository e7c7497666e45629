"""Panels of images: values under the pointer, colour scales, as few bytes as they need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.report.interactive.frame import INK, add_hover, set_ticks
from mcspectra.report.interactive.signed import SignedScale

if TYPE_CHECKING:
    from bokeh.models import ColorMapper
    from bokeh.plotting import figure

__all__ = ["MAP_DECADES", "PANEL", "color_bar", "image", "shade_ticks", "shades", "signed_mapper"]

PANEL = 284
"""Width of a panel in pixels."""
MAP_DECADES = 3
"""Decades below its largest value that a signed map tells apart."""
_KEPT_BITS = 10  # of a value's mantissa: it is good to 0.1 %, three digits
_TOP, _NOWHERE = 127, -128  # shades of the largest value, and of what is not finite


def image(
    plot: figure,
    columns: Mapping[str, Array],
    shown: str,
    axes: Sequence[Array],
    mapper: ColorMapper,
    names: tuple[str, str] = ("m₀", "m₁"),
) -> None:
    """Draw columns[shown] [first, second axis]; the pointer reads places and the other columns."""
    from bokeh.models import ColumnDataSource

    grids = np.meshgrid(*axes, indexing="ij")
    source = {
        title: [np.ascontiguousarray(values.T, dtype=np.float32)]
        for title, values in zip(names, grids, strict=True)
    } | {
        title: [np.ascontiguousarray(values.T) if title == "shade" else _compact(values.T)]
        for title, values in columns.items()
    }
    (x, width), (y, height) = (_edges(each) for each in axes)
    place: dict[str, Any] = {"x": x, "y": y, "dw": width, "dh": height, "color_mapper": mapper}
    drawn = plot.image(shown, source=ColumnDataSource(source), **place)
    plot.x_range.update(start=x, end=x + width, bounds=(x, x + width))
    plot.y_range.update(start=y, end=y + height, bounds=(y, y + height))
    rows = {title: title for title in (*names, *columns) if title != "shade"}
    add_hover(plot, [drawn], rows)


def _edges(places: Array) -> tuple[float, float]:
    """Where the first cell begins, and the length of all cells."""
    step = float(places[1] - places[0]) if len(places) > 1 else 1.0
    return float(places[0]) - 0.5 * step, step * len(places)


def _compact(values: Array) -> Array:
    """float32 rounded to `_KEPT_BITS` of mantissa: zeros at the end compress to nothing."""
    mantissa, exponent = np.frexp(np.ascontiguousarray(values, dtype=np.float64))
    rounded = np.ldexp(np.round(mantissa * 2.0**_KEPT_BITS), exponent - _KEPT_BITS)
    return np.asarray(rounded, dtype=np.float32)


def shades(scale: SignedScale, values: Array) -> Array:
    """Colours of values, int8: −127 … 127 as `signed_mapper` has them, −128 for no colour."""
    places = np.rint(_TOP / _end(scale) * scale.place(values))
    return np.where(np.isfinite(places), places, _NOWHERE).astype(np.int8)


def shade_ticks(scale: SignedScale, most: int) -> dict[float, str]:
    """Texts of the ticks of a colour bar by their shades."""
    return {_TOP / _end(scale) * place: text for place, text in scale.ticks(most).items()}


def signed_mapper() -> ColorMapper:
    """Red above zero, blue below, white at zero; of `shades`, one colour each."""
    from bokeh.models import LinearColorMapper
    from bokeh.palettes import RdBu11, interp_palette

    return LinearColorMapper(
        palette=interp_palette(RdBu11, 2 * _TOP + 1),
        low=-_TOP - 0.5,
        high=_TOP + 0.5,
        low_color="#808080",
    )


def _end(scale: SignedScale) -> float:
    """Place of the largest size."""
    return float(scale.place(np.array(max(scale.high, -scale.low) or 1.0)))


def color_bar(
    plot: figure, mapper: ColorMapper, label: str, ticks: Mapping[float, str] | None = None
) -> None:
    from bokeh.models.annotations import ColorBar

    bar = ColorBar(
        color_mapper=mapper, title=label, height=8, title_text_color=INK,
        major_label_text_color=INK, title_text_font_style="normal", title_text_font_size="11px",
        background_fill_color=None, padding=4,
    )  # fmt: skip
    if ticks is not None:
        set_ticks(bar, ticks)
    plot.add_layout(bar, "below")
