"""The Bokeh backend: every mark, axis and scale; updates; no network requests."""

import base64
import dataclasses
import gzip
import json
from typing import Any

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.models import ColumnDataSource, HoverTool, Legend, LinearColorMapper, Row
from bokeh.models.annotations import ColorBar
from bokeh.plotting import figure

from mcspectra.core.errors import ParameterError
from mcspectra.plots import scales
from mcspectra.plots.backend_bokeh import draw, packed, script
from mcspectra.plots.description import (
    Axis,
    BarChart,
    Dots,
    Heatmap,
    Line,
    Panel,
    Pixels,
    Plot,
    ReferenceLine,
    Scale,
    Segments,
    TextMark,
)
from mcspectra.plots.style import PALETTE

GRID = np.arange(-3.0, 4.0)
X = np.array([1.0, 2.0, 4.0, 8.0])
EVIL = r"$$x$$ \(y\) \[z\]"


def marks(factor):
    """Return one mark of each class, and variants; values are proportional to `factor`."""
    y = factor * np.array([0.5, np.nan, -2.0, 1e-4])
    hover = {"y": [f"{v:.3g}" for v in y], EVIL: ["a"] * 4}
    field = factor * np.add.outer(GRID, GRID**2)
    field[0, 0] = np.nan
    ends = {"low": y - 0.1, "high": y + 0.1}
    return {
        "line": Line(x=X, y=y, color=PALETTE[0], label=f"{EVIL} {factor}", hover=hover, **ends),
        "step": Line(x=X, y=y, color=PALETTE[1], step=True, dashes="--", hover=hover, **ends),
        "area": Line(x=X, y=y, color=PALETTE[1], width=0, **ends),
        "dots": Dots(x=X, y=y, color=PALETTE[6], marker="P", label="dots", **ends),
        "shaded": Dots(
            x=X, y=y, color=y, size=3 + X, scale=scales.signed_scale("y", [y]), hover=hover
        ),
        "across": Dots(x=X, y=y, color="#262626", across=True, low=X - 1, high=X + 1),
        "bars": BarChart(at=X, value=y, color=PALETTE[2], hover=hover, texts=list("abcd"), **ends),
        "lying": BarChart(at=X, value=y, color=PALETTE[:4], lying=True, texts=list("abcd"), **ends),
        "stems": BarChart(at=X, value=y, color=PALETTE[2], thickness=0, hover=hover),
        "image": Heatmap(
            values=field,
            x=GRID,
            y=GRID,
            scale=scales.signed_scale("c", [field]),
            hover={"m": field},
        ),
        "log image": Heatmap(
            values=np.abs(field),
            x=GRID,
            y=GRID,
            scale=scales.log_scale("power", 1e-3, 4.0 * factor),
        ),
        "beyond": Heatmap(
            values=field, x=GRID, y=GRID, scale=Scale(label="p", high=factor, beyond=True)
        ),
        "names": Heatmap(
            values=np.abs(field) // 1 % 2,
            x=GRID,
            y=GRID,
            scale=Scale(kind="names", names=("no", "yes"), colors=PALETTE[:2]),
        ),
        "pixels": Pixels(rgb=np.arange(24, dtype=np.uint8).reshape(2, 4, 3)),
        "segments": Segments(ends=factor * np.ones((3, 2, 2)), color="#DCDCDC", label="cuts"),
        "rule": ReferenceLine(at=factor, axis="x", label="rule"),
        "text": TextMark(x=1.0, y=factor, text=EVIL, side="above"),
    }


def plot(name, factor=1.0, y=None, **options):
    """Return a plot of one mark."""
    panel = Panel(marks=(marks(factor)[name],), y=y or Axis(label="y"), title="a panel")
    return Plot(kind="test", panels=(panel,), words=f"{name} {factor}", **options)


def content(model):
    return json.loads(gzip.decompress(base64.b64decode(packed(model))))


def data(model):
    """Return the data columns of all glyphs."""
    return [dict(source.data) for source in model.select({"type": ColumnDataSource})]


@pytest.mark.parametrize("name", marks(1.0))
def test_every_mark_is_drawn_without_warnings_and_described(name):
    model = draw(plot(name)).model
    assert isinstance(model, figure)
    assert model.toolbar.active_drag is None
    assert model.toolbar.active_scroll is None
    assert model.background_fill_color is None
    assert model.html_attributes == {"role": "figure", "aria-label": f"{name} 1.0"}
    document = Document()
    document.add_root(model)
    assert document.validate() is None
    assert "$$" not in str(document.to_json())
    assert "\\\\(" not in str(document.to_json())


@pytest.mark.parametrize("name", marks(1.0))
def test_an_update_equals_a_new_plot_without_new_models(name):
    first, second = plot(name, 1.0), plot(name, 3.0)
    drawn = draw(first)
    document = Document()
    document.add_root(drawn.model)
    before = set(document.models)
    assert drawn.fits(second)
    drawn.update(second)
    assert set(document.models) == before
    document.remove_root(drawn.model)
    assert content(drawn.model) == content(draw(second).model)


def test_an_update_with_another_structure_gives_an_error():
    drawn = draw(plot("line"))
    for other in (
        plot("dots"),
        plot("line", y=Axis(kind="log", low=0.1, high=2.0)),
        dataclasses.replace(plot("line"), columns=2),
        dataclasses.replace(plot("line"), panels=plot("line").panels * 2),
    ):
        assert not drawn.fits(other)
        with pytest.raises(ParameterError, match="draw it again"):
            drawn.update(other)


def test_signed_axes_have_correct_positions_and_ticks():
    values = np.array([-3e-4, 2e-8, 0.7])
    axis = scales.signed_axis("y", [values])
    bars = BarChart(
        at=np.arange(3.0), value=values, color=PALETTE[0], low=values / 2, high=values * 2
    )
    model: Any = draw(Plot(kind="t", panels=(Panel(marks=(bars,), y=axis),))).model
    found = next(each for each in data(model) if "top" in each)
    np.testing.assert_array_equal(found["top"], scales.signed_place(values, axis.threshold))
    np.testing.assert_array_equal(found["bottom"], 0.0)
    assert axis.ticks is not None
    expected = scales.signed_place(np.array(list(axis.ticks)), axis.threshold)
    np.testing.assert_array_equal(model.yaxis[0].ticker.ticks, expected)
    assert list(model.yaxis[0].major_label_overrides.values()) == list(axis.ticks.values())
    ends = scales.signed_place(np.array([axis.low, axis.high]), axis.threshold)
    assert [model.y_range.start, model.y_range.end] == ends.tolist()


def test_zero_is_not_drawn_on_logarithmic_axes():
    y = np.array([0.0, 1.0, -1.0])
    mark = Dots(x=y + 2, y=y, color=PALETTE[0], low=y - 1, high=y + 1)
    axis = Axis(kind="log", low=0.1, high=2.0)
    found = data(draw(Plot(kind="t", panels=(Panel(marks=(mark,), y=axis),))).model)
    dots, whiskers = sorted(found, key=lambda columns: "y0" in columns)
    np.testing.assert_array_equal(dots["y"], [np.nan, 1.0, np.nan])
    np.testing.assert_array_equal(whiskers["y0"], [0.1, 0.1, 0.1])


def test_gaps_interrupt_bands():
    y = np.array([1.0, 2.0, np.nan, 4.0, 5.0, 6.0])
    mark = Line(x=np.arange(6.0), y=y, low=y, high=y + 1, color=PALETTE[0])
    band = next(
        each
        for each in data(draw(Plot(kind="t", panels=(Panel(marks=(mark,)),))).model)
        if "xs" in each
    )
    assert [list(run) for run in band["xs"]] == [[0, 1, 1, 0], [3, 4, 5, 5, 4, 3]]
    assert [list(run) for run in band["ys"]] == [[1, 2, 3, 2], [4, 5, 6, 7, 6, 5]]


@pytest.mark.parametrize("name", ["image", "log image", "beyond"])
def test_shades_follow_the_values_and_nan_has_no_shade(name):
    mark: Any = marks(1.0)[name]
    (columns,) = data(draw(plot(name)).model)
    shades, values = columns["image"][0], mark.values
    assert shades.dtype == np.uint8
    assert shades[0, 0] == 0
    there = np.isfinite(values)
    assert shades[there].min() >= 1
    order = np.argsort(values[there], kind="stable")
    assert (np.diff(shades[there][order].astype(int)) >= 0).all()
    np.testing.assert_allclose(columns["h2"][0][there], values[there], rtol=2.0**-10)
    np.testing.assert_array_equal(columns["h0"][0][0], GRID)
    assert (columns["x"], columns["dw"]) == ([-3.5], [7.0])


def test_signed_maps_are_white_at_zero_with_ticks_at_their_shades():
    mark: Any = marks(1.0)["image"]
    model: Any = draw(plot("image")).model
    (columns,) = data(model)
    zeros = mark.values == 0
    assert set(columns["image"][0][zeros]) == {128}
    (bar,) = model.select({"type": ColorBar})
    assert bar.color_mapper.low == -bar.color_mapper.high
    assert 0.0 in bar.ticker.ticks


def test_names_are_in_the_legend_and_in_tooltips():
    model: Any = draw(plot("names")).model
    assert [item.label.value for item in model.select_one({"type": Legend}).items] == ["no", "yes"]
    columns = next(each for each in data(model) if "image" in each)
    assert set(columns["h2"][0]) == {"no", "yes", "–"}
    (mapper,) = {m for m in model.select({"type": LinearColorMapper}) if len(m.palette) == 2}
    assert (mapper.low, mapper.high) == (0.5, 2.5)


@pytest.mark.parametrize("flipped", [False, True])
def test_the_first_row_of_a_picture_is_on_top(flipped):
    (columns,) = data(draw(plot("pixels", y=Axis(low=0, high=2, flipped=flipped))).model)
    image = columns["image"][0].view(np.uint8).reshape(2, 4, 4)
    assert image[0 if flipped else 1, 0].tolist() == [0, 1, 2, 255]


def test_panels_share_a_bar_a_legend_and_the_zoom():
    image: Any = marks(1.0)["image"]
    panels = tuple(
        Panel(marks=(image, Dots(x=X, y=X, color=PALETTE[0], label="dots")), square=True)
        for _ in range(3)
    )
    model: Any = draw(Plot(kind="t", panels=panels, columns=3, share="both")).model
    assert isinstance(model, Row)
    assert len({id(each.x_range) for each in model.children}) == 1
    assert [len(each.select({"type": ColorBar})) for each in model.children] == [0, 0, 1]
    assert [len(each.select({"type": Legend})) for each in model.children] == [0, 0, 1]
    (item,) = model.children[2].select_one({"type": Legend}).items
    (drawn,) = item.renderers
    assert len(drawn.js_property_callbacks["change:visible"]) == 2
    document = Document()
    document.add_root(model)
    assert document.validate() is None


def test_one_button_turns_all_tooltips_off():
    both = (marks(1.0)["line"], marks(1.0)["bars"])
    model: Any = draw(Plot(kind="t", panels=(Panel(marks=both),))).model
    tools = model.select({"type": HoverTool})
    assert sorted(tool.visible for tool in tools) == [False, True]


def test_unchanged_limits_keep_the_zoom():
    axis = Axis(low=0.0, high=2.0)
    drawn = draw(plot("line", 1.0, y=axis))
    model: Any = drawn.model
    model.y_range.update(start=0.5, end=0.6)  # like the zoom of a reader
    drawn.update(plot("line", 3.0, y=axis))
    assert (model.y_range.start, model.y_range.end) == (0.5, 0.6)
    drawn.update(plot("line", 3.0, y=Axis(low=0.0, high=3.0)))
    assert (model.y_range.start, model.y_range.end) == (0.0, 3.0)


def test_the_same_plot_is_the_same_text():
    assert packed(draw(plot("line")).model) == packed(draw(plot("line")).model)


def test_the_script_is_self_contained():
    code = gzip.decompress(base64.b64decode(script())).decode()
    assert "embed_item" in code
    assert "sourceMappingURL" not in code or "http" not in code.split("sourceMappingURL")[-1][:200]


def test_colors_are_visible_on_dark_and_light_pages():
    def luminance(color):
        parts = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))

    for color in PALETTE:
        mark = Segments(ends=np.ones((1, 2, 2)), color=color)
        model: Any = draw(Plot(kind="t", panels=(Panel(marks=(mark,)),))).model
        seen = luminance(model.renderers[0].glyph.line_color) + 0.05
        assert seen / (luminance("#191817") + 0.05) > 3.0
        assert 1.05 / seen > 2.0
