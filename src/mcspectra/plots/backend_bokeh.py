"""Draw plots with Bokeh for pages. Readers can zoom, see tooltips, and hide marks in the legend.

Plots load nothing from a network and are readable on light and dark pages.
The description of a plot in words becomes its ARIA label.

A `Drawn` can be updated to show another plot, if only data, limits and texts differ.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, assert_never, final

import numpy as np
from bokeh.core.json_encoder import serialize_json
from bokeh.core.properties import value
from bokeh.embed import json_item
from bokeh.models import (
    Column,
    ColumnDataSource,
    DataRange1d,
    FixedTicker,
    HoverTool,
    LayoutDOM,
    LinearAxis,
    LinearColorMapper,
    Range1d,
    Row,
)
from bokeh.models.annotations import ColorBar, Label, Legend, LegendItem
from bokeh.palettes import Viridis256, interp_palette
from bokeh.plotting import figure
from bokeh.resources import Resources

from mcspectra.core.checks import Array
from mcspectra.core.display import printable
from mcspectra.core.errors import ParameterError
from mcspectra.plots.description import (
    Axis,
    BarChart,
    Dots,
    Heatmap,
    Line,
    Mark,
    Panel,
    Pixels,
    Plot,
    ReferenceLine,
    Scale,
    Segments,
    TextMark,
)
from mcspectra.plots.scales import log_ticks, signed_place
from mcspectra.plots.style import FAINT, GRADIENTS, GRAY, INK
from mcspectra.plots.text import shorten

__all__ = ["Drawn", "draw", "packed", "script"]

_INK = "#767676"  # gray with contrast 4.5 on white pages and 3.9 on dark pages
_GRID = "rgba(128, 128, 128, 0.25)"
_SEEN = {
    INK: _INK,
    GRAY: "#ABABAB",
    FAINT: _GRID,
    "#4D4D4D": "#8A8A8A",
    "#7F5733": "#9C6B41",
}  # colors that are readable on light and dark pages
_NOWHERE = "#808080"
_MARKERS = {
    "o": "circle",
    "s": "square",
    "^": "triangle",
    "D": "diamond",
    "v": "inverted_triangle",
    "P": "plus",
    "X": "x",
    "*": "star",
    "|": "dash",  # Bokeh's dash is horizontal, so it is rotated by 90°
}
_DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dashdot"}
_SIDES = {
    "right": ("left", "middle", 5, 0),
    "left": ("right", "middle", -5, 0),
    "above": ("center", "bottom", 0, -5),
    "below": ("center", "top", 0, 5),
    "middle": ("center", "middle", 0, 0),
}
_SHADES = 255  # number of colors of a palette; color 0 means no value
_KEPT_BITS = 10  # mantissa bits of values in tooltips, enough for three digits
_PIXELS = 4 / 3  # pixels per point
_ALONE, _WIDE, _ABREAST, _PAIR = 260, 300, 216, 260  # widths of frames in pixels
_USUAL = 560  # assumed width of a full-width figure in pixels, from which its height follows
_TOOLS = "pan,box_zoom,wheel_zoom,reset,save"


def draw(plot: Plot) -> Drawn:
    """Draw a plot."""
    return Drawn(plot)


def packed(model: LayoutDOM) -> str:
    """Return a model's JSON for ``Bokeh.embed.embed_item``, compressed with gzip, in base64.

    Bokeh counts models over the life of a process.
    Here, the models of each plot are numbered from 0, so the same plot gives the same text.
    """
    item = json.loads(serialize_json(json_item(model)))
    numbers: dict[str, str] = {}
    document = _renumbered(item["doc"], numbers)
    kept = {"root_id": numbers[item["root_id"]], "doc": document, "version": item["version"]}
    text = json.dumps({"target_id": None, **kept}, ensure_ascii=False, separators=(",", ":"))
    return _compressed(text)


@cache
def script() -> str:
    """Return Bokeh's own script without widgets, tables and WebGL, as gzip in base64."""
    resources = Resources(mode="inline", components=["bokeh"], log_level="error")
    return _compressed("\n".join(resources.js_raw))


@final
class Drawn:
    """A plot as Bokeh models.

    Attributes
    ----------
    model
        A figure, or the layout with the figures of several panels.
    """

    model: LayoutDOM

    def __init__(self, plot: Plot) -> None:
        self._shown: Plot | None = None
        self._structure = _structure(plot)
        self._figures = [_figure(panel, _options(plot, k)) for k, panel in enumerate(plot.panels)]
        # If each panel has tools, show the tools only while the pointer is over the panel
        for each in self._figures:
            each.toolbar.autohide = len(self._figures) > 1 and not _stacked(plot)
        if _stacked(plot):
            for frame in self._figures[:-1]:
                frame.below[0].visible = False
        self._sources: list[Any] = []
        entries: dict[str, dict[int, list[Any]]] = {}
        for k, panel in enumerate(plot.panels):
            for mark in panel.marks:
                drawn = [_add(self._figures[k], layer) for layer in _layers(mark, panel)]
                self._sources += [each.data_source for each in drawn]
                if label := getattr(mark, "label", ""):
                    entries.setdefault(label, {}).setdefault(k, []).extend(drawn)
        # Add color bars. For a scale of names, list the names with their colors below the figure
        self._bars: list[Any] = []
        for scale, k in _bars(plot).items():
            frame = self._figures[k]
            if scale.kind == "names":
                squares = {"x": [np.nan], "y": [np.nan], "marker": "square", "size": 10}
                named = zip(scale.names, scale.colors, strict=True)
                _legend(frame, {n: [frame.scatter(**squares, color=c)] for n, c in named})
                self._bars.append(None)
                continue
            mapper = LinearColorMapper(palette=list(_palette(scale)), low=0.0, high=1.0)
            bar = ColorBar(
                color_mapper=mapper, height=8, title_text_color=_INK, major_label_text_color=_INK,
                title_text_font_size="11px", title_text_font_style="normal",
                background_fill_color=None, padding=4,
            )  # fmt: skip
            frame.add_layout(bar, "below")
            self._bars.append(bar)
        # Put each legend entry below the last figure with this entry. A click hides its marks
        items: dict[str, Any] = {}
        for k, frame in enumerate(self._figures):
            own = {label: drawn[k] for label, drawn in entries.items() if max(drawn) == k}
            if own:
                items |= dict(zip(own, _legend(frame, own), strict=True))
        for places in entries.values():
            *others, last = [each for _, several in sorted(places.items()) for each in several]
            for other in others:
                last.js_link("visible", other, "visible")
        self._items = [items[label] for label in entries]
        # Place panels in rows that wrap on narrow pages, or stack them
        for other in self._figures[1:]:
            if plot.share in ("x", "both"):
                other.x_range = self._figures[0].x_range
            if plot.share in ("y", "both"):
                other.y_range = self._figures[0].y_range
        self.model = self._figures[0]
        if len(self._figures) > 1 and plot.columns == 1:
            self.model = Column(children=self._figures, sizing_mode="stretch_width")
        elif len(self._figures) > 1:
            wrap: Any = {"flex-wrap": "wrap", "justify-content": "center", "gap": "8px"}
            self.model = Row(children=self._figures, sizing_mode="stretch_width", styles=wrap)
        self._say(plot)

    def fits(self, plot: Plot) -> bool:
        """Whether `update` can show this plot."""
        return _structure(plot) == self._structure

    def update(self, plot: Plot) -> None:
        """Show another plot of the same structure. If limits are equal, the reader's zoom is kept.

        Raises
        ------
        ParameterError
            If the other plot has different marks, colors, kinds of axes or panels.
        """
        if not self.fits(plot):
            raise ParameterError(
                "The structure of the plot differs from the drawn one; draw it again."
            )
        layers = (each for p in plot.panels for mark in p.marks for each in _layers(mark, p))
        for source, layer in zip(self._sources, layers, strict=True):
            source.data = layer.data
        self._say(plot)

    def _say(self, plot: Plot) -> None:
        """Set limits, ticks and texts of the figures."""
        before = self._shown.panels if self._shown else (None,) * len(plot.panels)
        for frame, panel, old in zip(self._figures, plot.panels, before, strict=True):
            frame.title.text = _plain(shorten(panel.title, 34))
            for axis, name in ((frame.below[0], "x"), (frame.left[0], "y")):
                limits = getattr(frame, f"{name}_range") if panel.marks or not plot.share else None
                _set_axis(axis, limits, getattr(panel, name), getattr(old, name, None))
            for side, texts in _texts(panel).items():
                _set_ticks(getattr(frame, side)[0], list(texts), texts.values())
        for bar, scale in zip(self._bars, _bars(plot), strict=True):
            if bar is None:
                continue
            start, end = (float(limit) for limit in _along(scale, _limits(scale)))
            bar.color_mapper.update(low=start, high=end)
            bar.title = _plain(f"{scale.label}   (▶ and above)" if scale.beyond else scale.label)
            ticks = scale.ticks
            if ticks is None and scale.kind == "log":
                ticks = log_ticks(scale.low, scale.high)
            if ticks is not None:
                _set_ticks(bar, _along(scale, list(ticks)), ticks.values())
        for item, label in zip(self._items, plot.labels, strict=True):
            item.label = value(_plain(shorten(label, 60)))
        words = plot.words or plot.caption or plot.kind.replace("-", " ")
        self.model.html_attributes = {"role": "figure", "aria-label": words}
        self._shown = plot


def _structure(plot: Plot) -> list[Any]:
    """Return all properties of a plot that an update cannot change."""
    found: list[Any] = [plot.columns, plot.share]
    for k, panel in enumerate(plot.panels):
        ticks = [axis.ticks is None for axis in (panel.x, panel.y)]
        found.append((_options(plot, k), ticks, panel.x.flipped, panel.y.flipped, panel.note))
        for mark in panel.marks:
            label = getattr(mark, "label", "")
            found.append(plot.labels.index(label) if label else None)
            for each in _layers(mark, panel):
                found.append((each.glyph, each.fixed, list(each.columns), list(each.hover)))
    bars = ((s.names, s.ticks is None and s.kind != "log", k) for s, k in _bars(plot).items())
    return [*found, *bars]


def _bars(plot: Plot) -> dict[Scale, int]:
    """Return the color scales that need a bar or a legend.

    The result maps each color scale to the index of the last panel that uses the scale.
    """
    found = {scale: k for k, panel in enumerate(plot.panels) for scale in panel.scales}
    return {scale: k for scale, k in found.items() if scale.label or scale.names}


@dataclass(frozen=True)
class _Layer:
    """One Bokeh glyph, with its data properties, constant properties and tooltips."""

    glyph: str
    columns: Mapping[str, Any]
    fixed: Mapping[str, Any] = field(default_factory=dict)
    hover: Mapping[str, Any] = field(default_factory=dict)

    @property
    def data(self) -> dict[str, Any]:
        return {**self.columns, **{f"h{k}": v for k, v in enumerate(self.hover.values())}}


def _layers(mark: Mark, panel: Panel) -> list[_Layer]:
    """Return the glyphs that draw a mark."""
    match mark:
        case Line():
            xy = {"x": _place(panel.x, mark.x), "y": _place(panel.y, mark.y)}
            color = _seen(mark.color)
            found = []
            if mark.low is not None:
                paint = {"color": color, "fill_alpha": 0.2 if mark.width else 1.0, "line_width": 0}
                found.append(_Layer("patches", _band(mark, panel), paint))
            if mark.width:
                mode = {"mode": "center"} if mark.step else {}
                line = {"line_color": color, **_stroke(mark), **mode}
                found.append(_Layer("step" if mark.step else "line", xy, line))
            if mark.hover:  # steps have no tooltips, so add invisible dots
                unseen = {"size": 9, "fill_alpha": 0, "line_alpha": 0}
                found.append(_Layer("scatter", xy, unseen, mark.hover))
            return found
        case Dots():
            size = np.broadcast_to(_PIXELS * np.asarray(mark.size, dtype=float), len(mark.x))
            xy = {"x": _place(panel.x, mark.x), "y": _place(panel.y, mark.y), "size": size}
            width = 2 if mark.marker in "PX|" else 0.5
            fixed: dict[str, Any] = {"marker": _MARKERS[mark.marker], "line_width": width}
            if mark.marker == "|":
                fixed["angle"] = np.pi / 2
            if isinstance(mark.color, str):
                color = fixed["color"] = _seen(mark.color)
            else:
                assert mark.scale is not None
                color, fixed["palette"] = _INK, _palette(mark.scale)
                xy["color"] = _shade(mark.scale, mark.color)
            dots = _Layer("scatter", xy, fixed, mark.hover)
            at, along = (xy["y"], panel.x) if mark.across else (xy["x"], panel.y)
            return [dots, *_whiskers(mark, at, along, color, mark.across)]
        case BarChart():
            along, other = (panel.x, panel.y) if mark.lying else (panel.y, panel.x)
            base = np.broadcast_to(mark.base, np.shape(mark.at)).astype(float)
            if along.kind == "log":
                base = np.where(base <= 0, along.low or 0.0, base)
            at, end = _place(other, mark.at), _place(along, mark.value)
            start = _place(along, base)
            several = [mark.color] * len(at) if isinstance(mark.color, str) else mark.color
            colors, paint = [_seen(each) for each in several], {"alpha": mark.opacity}
            if mark.thickness:
                near, far = at - mark.thickness / 2, at + mark.thickness / 2
                sides = ("left", "right", "bottom", "top")
                places = (start, end, near, far) if mark.lying else (near, far, start, end)
                box = {**dict(zip(sides, places, strict=True)), "color": colors}
                found = [_Layer("quad", box, paint, mark.hover)]
            else:
                stems = {**_segments(at, start, end, mark.lying), "color": colors}
                x, y = (end, at) if mark.lying else (at, end)
                tips = {"x": x, "y": y, "color": colors}
                found = [
                    _Layer("segment", stems, {**paint, "line_width": 1.5}),
                    _Layer("scatter", tips, {**paint, "size": 4}, mark.hover),
                ]
            return [*found, *_whiskers(mark, at, along, _INK, mark.lying)]
        case Heatmap():
            left, width = _extent(mark.x)
            low, height = _extent(mark.y)
            across, up = np.meshgrid(mark.x, mark.y)
            shown = {panel.x.label or "x": across, panel.y.label or "y": up, mark.name: mark.values}
            shown |= mark.hover
            hover: dict[str, Any] = {title: [_compact(each)] for title, each in shown.items()}
            if mark.scale.names:
                kinds = np.nan_to_num(np.ravel(mark.values) - mark.scale.low, nan=-1.0)
                hover[mark.name] = [[(*mark.scale.names, "–")[int(k)] for k in kinds]]
            columns = {"image": [_shade(mark.scale, mark.values)], "x": [left], "y": [low]}
            columns |= {"dw": [width], "dh": [height]}
            palette = {"palette": _palette(mark.scale)}
            return [_Layer("image", columns, palette, hover)]
        case Pixels():
            rows, count = mark.rgb.shape[:2]
            rgba = np.full((rows, count, 4), 255, np.uint8)
            rgba[..., :3] = mark.rgb if panel.y.flipped else mark.rgb[::-1]
            image = [np.ascontiguousarray(rgba).view(np.uint32)[..., 0]]
            columns = {"image": image, "x": [0], "y": [0], "dw": [count], "dh": [rows]}
            return [_Layer("image_rgba", columns)]
        case Segments():
            pairs = np.moveaxis(np.asarray(mark.ends, dtype=float), 0, -1)
            columns = {f"x{k}": _place(panel.x, pairs[k, 0]) for k in (0, 1)}
            columns |= {f"y{k}": _place(panel.y, pairs[k, 1]) for k in (0, 1)}
            paint = {"line_color": _seen(mark.color), "line_width": mark.width * _PIXELS}
            return [_Layer("segment", columns, paint)]
        case ReferenceLine():
            place = _place(panel.x if mark.axis == "x" else panel.y, [mark.at])
            stroke = {"line_color": _seen(mark.color), **_stroke(mark)}
            glyph = "vspan" if mark.axis == "x" else "hspan"
            return [_Layer(glyph, {mark.axis: place}, stroke)]
        case TextMark():
            align, baseline, *away = _SIDES[mark.side]
            spot = {"x": _place(panel.x, [mark.x]), "y": _place(panel.y, [mark.y])}
            fixed = {
                "text_color": _seen(mark.color), "text_font_size": "11px", "text_align": align,
                "text_baseline": baseline, "x_offset": away[0], "y_offset": away[1],
            }  # fmt: skip
            return [_Layer("text", {**spot, "text": [_plain(mark.text)]}, fixed)]
        case _:
            assert_never(mark)


def _stroke(mark: Line | ReferenceLine) -> dict[str, Any]:
    return {"line_dash": _DASHES[mark.dashes], "line_width": mark.width * _PIXELS}


def _whiskers(
    mark: Dots | BarChart, at: Array, axis: Axis, color: str, lying: bool
) -> list[_Layer]:
    if mark.low is None or mark.high is None:
        return []
    ends = _segments(at, *_ends(axis, mark.low, mark.high), lying)
    return [_Layer("segment", ends, {"line_color": color, "line_width": 1.7})]


def _segments(at: Array, start: Array, end: Array, lying: bool) -> dict[str, Any]:
    first, second = ("y", "x") if lying else ("x", "y")
    return {f"{first}0": at, f"{first}1": at, f"{second}0": start, f"{second}1": end}


def _band(mark: Line, panel: Panel) -> dict[str, Any]:
    """Return the outlines of a band. Gaps in the values divide the band into several outlines."""
    x, (low, high) = _place(panel.x, mark.x), _ends(panel.y, mark.low, mark.high)
    if mark.step and len(x) > 1:
        middle = (x[1:] + x[:-1]) / 2
        edges = np.concatenate([[2 * x[0] - middle[0]], middle, [2 * x[-1] - middle[-1]]])
        x = np.stack([edges[:-1], edges[1:]], axis=1).ravel()
        low, high = np.repeat(low, 2), np.repeat(high, 2)
    there = np.isfinite(x + low + high)
    bounds = np.flatnonzero(np.diff(there, prepend=False, append=False)).reshape(-1, 2)
    runs = [slice(*bound) for bound in bounds]
    return {
        "xs": [np.concatenate([x[run], x[run][::-1]]) for run in runs],
        "ys": [np.concatenate([low[run], high[run][::-1]]) for run in runs],
    }


def _ends(axis: Axis, low: Any, high: Any) -> tuple[Array, Array]:
    """Return where intervals end. On a log axis, a low end at 0 moves to the limit of the axis."""
    low = np.asarray(low, dtype=float)
    if axis.kind == "log" and axis.low is not None:
        low = np.where(low <= 0, axis.low, low)
    return _place(axis, low), _place(axis, high)


def _place(axis: Axis, values: Any) -> Array:
    """Return values in Bokeh's coordinates; NaN for values that the axis cannot show."""
    given = np.asarray(values, dtype=float)
    if axis.kind == "signed":
        return signed_place(given, axis.threshold)
    there = np.isfinite(given) & ((given > 0) | (axis.kind != "log"))
    return np.where(there, given, np.nan)


def _shade(scale: Scale, values: Array) -> Array:
    """Return color indices of values: 1 to 255 along the palette, 0 if not finite."""
    given = np.asarray(values, dtype=float)
    if scale.kind == "names":
        shades = 1.0 + given - scale.low
    else:
        low, high = _along(scale, _limits(scale))
        share = np.clip((_along(scale, given) - low) / ((high - low) or 1.0), 0.0, 1.0)
        shades = 1.0 + np.rint((_SHADES - 1) * share)
    return np.where(np.isfinite(given) & np.isfinite(shades), shades, 0.0).astype(np.uint8)


def _limits(scale: Scale) -> tuple[float, float]:
    return -scale.high if scale.kind == "signed" else scale.low, scale.high


def _along(scale: Scale, values: Any) -> Array:
    """Return the positions of values along a color scale."""
    given = np.asarray(values, dtype=float)
    if scale.kind == "signed":
        return signed_place(given, scale.threshold)
    return np.log10(np.maximum(given, 1e-300)) if scale.kind == "log" else given


def _extent(places: Array) -> tuple[float, float]:
    """Return the start and the length of a row of cells from the positions of their centers."""
    step = float(places[1] - places[0]) if len(places) > 1 else 1.0
    return float(places[0]) - 0.5 * step, step * len(places)


def _compact(values: Array) -> Array:
    """Round to float32 with few mantissa bits, because trailing zeros compress well."""
    mantissa, exponent = np.frexp(np.asarray(values, dtype=np.float64))
    rounded = np.ldexp(np.round(mantissa * 2.0**_KEPT_BITS), exponent - _KEPT_BITS)
    return np.ascontiguousarray(rounded, dtype=np.float32)


# The next functions make figures, legends and color bars. Updates of a plot keep these objects


def _options(plot: Plot, k: int) -> dict[str, Any]:
    """Return the options of a panel's figure."""
    panel = plot.panels[k]
    stretched = plot.columns == 1 and not panel.square
    if stretched:
        width = _USUAL
    elif len(plot.panels) == 1:
        width = _WIDE if plot.wide else _ALONE
    else:
        width = _PAIR if plot.columns <= 2 and not panel.square else _ABREAST
    ratio = plot.height * (plot.rows[k // plot.columns] / max(plot.rows) if plot.rows else 1.0)
    if panel.square:
        x, y = ((axis.high or 0.0) - (axis.low or 0.0) for axis in (panel.x, panel.y))
        known = None not in (panel.x.low, panel.x.high, panel.y.low, panel.y.high)
        ratio = y / x if known else 1.0
    return {
        "x_axis_type": "log" if panel.x.kind == "log" else "linear",
        "y_axis_type": "log" if panel.y.kind == "log" else "linear",
        "frame_width": None if stretched else width,
        "frame_height": round(width * ratio),
        "width_policy": "max" if stretched else "min",
        "width": None,
        "height": None,
        "outline_line_color": _INK if panel.framed else None,
        # If panels are stacked, only the first has tools. Narrow panels have no space above
        "toolbar_location": None
        if _stacked(plot) and k
        else ("above" if stretched or not panel.title else "right"),
    }


def _stacked(plot: Plot) -> bool:
    """Whether the panels are stacked and share an axis, which is labeled only at the last panel."""
    return plot.columns == 1 and plot.share in ("x", "both")


def _figure(panel: Panel, options: dict[str, Any]) -> Any:
    """Create an empty figure without active tools, which would capture scroll gestures."""
    padding = 0.0 if any(isinstance(mark, Heatmap | Pixels) for mark in panel.marks) else 0.06
    ranges: Any = {
        name: DataRange1d(flipped=axis.flipped, range_padding=padding)
        if axis.low is None or axis.high is None
        else Range1d()
        for name, axis in (("x_range", panel.x), ("y_range", panel.y))
    }
    made: Any = figure(
        tools=_TOOLS, active_drag=None, active_scroll=None,
        background_fill_color=None, border_fill_color=None, min_border_right=12, **ranges,
        **options,
    )  # fmt: skip
    made.toolbar.logo = None
    made.title.update(text_color=_INK, text_font_style="normal")
    made.grid.grid_line_color = _GRID if panel.grid else None
    for side in _texts(panel):
        made.add_layout(LinearAxis(major_tick_line_color=None, axis_line_alpha=0), side)
    for axis in made.axis:
        axis.axis_label_text_color = axis.major_label_text_color = _INK
        axis.axis_label_text_font_style = "normal"
        axis.axis_line_color = _INK
        axis.major_tick_line_color = axis.major_tick_line_color and _INK
        axis.minor_tick_line_color = None
    if panel.note:
        middle = {"x": (options["frame_width"] or _USUAL) / 2, "y": options["frame_height"] / 2}
        note = Label(
            **middle, x_units="screen", y_units="screen", text=_plain(panel.note), text_color=_INK,
            text_align="center", text_baseline="middle",
        )  # fmt: skip
        made.add_layout(note)
    return made


def _texts(panel: Panel) -> dict[str, dict[float, str]]:
    """Return the texts of bars as ticks of a second axis at the right or at the top."""
    found: dict[str, dict[float, str]] = {}
    for mark in panel.marks:
        if isinstance(mark, BarChart) and mark.texts:
            at = _place(panel.y if mark.lying else panel.x, mark.at).tolist()
            here = found.setdefault("right" if mark.lying else "above", {})
            here |= dict(zip(at, mark.texts, strict=True))
    return found


def _add(frame: Any, layer: _Layer) -> Any:
    """Add a layer to a figure."""
    options: dict[str, Any] = {**layer.fixed, **{name: name for name in layer.columns}}
    if colors := options.pop("palette", ()):
        mapper = LinearColorMapper(
            palette=list(colors), low=0.5, high=len(colors) + 0.5, low_color=_NOWHERE
        )
        paint = {"color": {"field": "color", "transform": mapper}}
        options |= {"color_mapper": mapper} if layer.glyph == "image" else paint
    drawn = getattr(frame, layer.glyph)(**options, source=ColumnDataSource(layer.data))
    if layer.hover:
        tips = [(_plain(title), f"@h{k}") for k, title in enumerate(layer.hover)]
        # Show one toolbar button for all tooltips, instead of one per hover tool
        visible = not any(isinstance(tool, HoverTool) for tool in frame.tools)
        frame.add_tools(HoverTool(renderers=[drawn], tooltips=tips, visible=visible, limit=6))
    return drawn


@cache
def _gradient(palette: str) -> tuple[str, ...]:
    colors = GRADIENTS[palette]
    return tuple(interp_palette(Viridis256 if colors == "viridis" else tuple(colors), _SHADES))


def _palette(scale: Scale) -> tuple[str, ...]:
    """Return the color of each color index."""
    return scale.colors or _gradient(scale.palette)


def _set_axis(axis: Any, limits: Any, new: Axis, old: Axis | None) -> None:
    """Set the label, the ticks, and the limits (if they changed) of an axis."""
    axis.axis_label = _plain(new.label)
    if new.ticks is not None:
        _set_ticks(axis, _place(new, list(new.ticks)), [shorten(t, 24) for t in new.ticks.values()])
    ends = [None if end is None else float(_place(new, end)) for end in (new.low, new.high)]
    same = old and (new.low, new.high, new.threshold) == (old.low, old.high, old.threshold)
    if limits is None or same:
        return
    start, end = reversed(ends) if new.flipped else ends
    known = {name: at for name, at in (("start", start), ("end", end)) if at is not None}
    if isinstance(limits, Range1d):
        known |= {f"reset_{name}": at for name, at in known.items()}
    limits.update(**known)


def _set_ticks(axis: Any, places: Iterable[float], texts: Iterable[str]) -> None:
    ticks = [float(place) for place in places]
    if isinstance(axis.ticker, FixedTicker):
        axis.ticker.ticks = ticks
    else:
        axis.ticker = FixedTicker(ticks=ticks)
    axis.major_label_overrides = dict(zip(ticks, map(_plain, texts), strict=True))


def _legend(frame: Any, entries: Mapping[str, list[Any]]) -> list[Any]:
    """Add a legend below a figure, one row per entry. A click hides or shows the entry's marks."""
    items = [LegendItem(label=_plain(label), renderers=drawn) for label, drawn in entries.items()]
    legend = Legend(
        items=items, click_policy="hide", location="top_left", background_fill_color=None,
        border_line_color=None, label_text_color=_INK, label_text_font_size="12px",
        inactive_fill_color="rgba(128, 128, 128, 0.35)", spacing=0, margin=0,
    )  # fmt: skip
    frame.add_layout(legend, "below")
    return items


def _seen(color: str) -> str:
    """Return a similar color that is readable on light and dark pages."""
    return _SEEN.get(color, color)


def _plain(text: str) -> str:
    """Make a text printable, and split TeX delimiters in it: Bokeh would load TeX for them."""
    text = printable(text, lines=True)
    joiner = "\u2060"  # an invisible character without width
    for mark in ("$$", r"\(", r"\["):
        text = text.replace(mark, f"{mark[0]}{joiner}{mark[1]}")
    return text


def _compressed(text: str) -> str:
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")


def _renumbered(node: Any, numbers: dict[str, str]) -> Any:
    """Return a copy in which model ids are numbers, in the order of their first mention."""
    if isinstance(node, list):
        return [_renumbered(each, numbers) for each in node]
    if not isinstance(node, dict):
        return node
    return {
        key: numbers.setdefault(value, f"m{len(numbers)}")
        if key == "id" and isinstance(value, str)
        else _renumbered(value, numbers)
        for key, value in node.items()
    }
