"""The Matplotlib backend: marks, axes, scales, legends, given axes, reproducible bytes."""

import io
import math
import re
import zlib

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text as MplText
from PIL import Image as Picture

from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.plots.backend_matplotlib import FORMATS, draw, encode, panel_axes, write
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
from mcspectra.plots.scales import log_scale, name_axis, signed_axis, signed_scale
from mcspectra.plots.style import FAINT

X = np.array([1.0, 2.0, 4.0, 8.0])
GRID = np.arange(-3.0, 4.0)


def plot(*panels, **options):
    return Plot(kind="test", panels=tuple(panels), **options)


def drawn(*marks, **options):
    """Return the axes and the figure of a panel with the given marks."""
    figure = draw(plot(Panel(marks=marks, **options)))
    figure.canvas.draw()
    return figure.axes[0], figure


def texts(figure):
    figure.canvas.draw()
    return [t.get_text() for t in figure.findobj(MplText) if t.get_visible() and t.get_text()]


def field(values=None):
    return np.add.outer(GRID, GRID**2) if values is None else values


def test_lines_have_gaps_bands_and_steps():
    y = np.array([1.0, math.nan, 2.0, 3.0])
    axes, _ = drawn(
        Line(x=X, y=y, color="#0072B2", dashes="--", low=y - 1, high=y + 1),
        Line(x=X, y=X, color="#D55E00", step=True),
        Line(x=X, y=X, low=0 * X, high=X, color=FAINT, width=0.0),
    )
    first, second = axes.lines
    np.testing.assert_array_equal(first.get_ydata(), y)
    assert (first.get_linestyle(), second.get_drawstyle()) == ("--", "steps-mid")
    band, area = axes.collections
    assert band.get_alpha() == 0.2
    assert area.get_alpha() == 1.0


@pytest.mark.parametrize("across", [False, True])
def test_dots_have_whiskers_and_sizes(across):
    low, high = X - 0.5, np.array([2.0, math.nan, 5.0, 9.0])
    axes, _ = drawn(Dots(x=X, y=X, color="#0072B2", size=X, low=low, high=high, across=across))
    whiskers, dots = (
        next(c for c in axes.collections if isinstance(c, kind))
        for kind in (mpl.collections.LineCollection, mpl.collections.PathCollection)
    )
    ends = np.array([s[:, 0 if across else 1] for s in whiskers.get_segments() if len(s)])
    assert ends[0] == pytest.approx([0.5, 2.0])
    np.testing.assert_array_equal(dots.get_sizes(), X**2)


def test_dots_show_values_of_a_scale():
    axes, figure = drawn(Dots(x=X, y=X, color=X, scale=log_scale("weight", 1.0, 8.0)))
    assert axes.collections[0].get_clim() == (1.0, 8.0)
    assert "weight" in texts(figure)


@pytest.mark.parametrize("lying", [False, True])
def test_nan_draws_no_bar(lying):
    value = np.array([1.0, -2.0, math.nan, 3.0])
    bars = BarChart(at=X, value=value, color=["red", "green", "blue", "black"], lying=lying,
                low=value - 1, high=value + 1, texts=["a", "b", "c", "d"])  # fmt: skip
    axes, figure = drawn(bars)
    sizes = [p.get_width() if lying else p.get_height() for p in axes.patches]
    assert sizes == [1.0, -2.0, 3.0]
    assert axes.patches[2].get_facecolor() == (0.0, 0.0, 0.0, 1.0)
    assert {"a", "b", "c", "d"} <= set(texts(figure))


@pytest.mark.parametrize("lying", [False, True])
def test_bars_without_thickness_are_stems(lying):
    axes, _ = drawn(BarChart(at=X, value=X, color="#0072B2", thickness=0.0, lying=lying))
    ends = np.array([s[:, 0 if lying else 1] for s in axes.collections[0].get_segments()])
    np.testing.assert_array_equal(ends, np.stack([0 * X, X], axis=1))


@pytest.mark.parametrize(
    "scale",
    [
        Scale(label="v", low=0.0, high=2.0, beyond=True),
        log_scale("v", 0.1, 10.0),
        signed_scale("v", [field()]),
        signed_scale("v", [np.array([1e-4, 1.0])]),
        Scale(label="v", low=0.0, high=1.0, palette="paper"),
    ],
)
def test_heatmaps_have_correct_positions(scale):
    values = field()
    values[0, 0] = math.nan
    axes, figure = drawn(Heatmap(values=values, x=GRID, y=GRID, scale=scale), square=True)
    (image,) = axes.images
    assert image.get_extent() == [-3.5, 3.5, -3.5, 3.5]
    assert image.origin == "lower"
    assert np.ma.getmaskarray(image.get_array())[0, 0]
    assert image.get_clim() == (scale.low, scale.high)
    assert axes.get_aspect() == 1.0
    assert scale.label in " ".join(texts(figure)).replace("\n", "   ")
    nothing = image.cmap(np.ma.masked_invalid([math.nan]))[0]
    assert mpl.colors.to_hex(nothing).upper() == FAINT


def test_each_side_of_the_linear_part_takes_half_a_decade():
    """Positions agree with `signed_place`, which the Bokeh backend uses."""
    scale = signed_scale("v", [np.array([1e-3, 1.0])])
    axes, _ = drawn(Heatmap(values=field(), x=GRID, y=GRID, scale=scale))
    norm = axes.images[0].norm
    top = 0.5 + math.log10(scale.high / scale.threshold)
    assert norm(scale.threshold) == pytest.approx(0.5 + 0.5 * 0.5 / top)
    assert norm(0.0) == pytest.approx(0.5)


def test_names_of_a_scale_are_in_the_legend():
    scale = Scale(kind="names", names=("no", "yes"), colors=("#0072B2", "#D55E00"))
    values = np.array([[0.0, 1.0], [math.nan, 0.0]])
    at = np.arange(2.0)
    axes, figure = drawn(Heatmap(values=values, x=at, y=at, scale=scale))
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["no", "yes"]
    shown = axes.images[0].to_rgba(axes.images[0].get_array())
    assert mpl.colors.to_hex(shown[0, 1]).upper() == "#D55E00"
    assert len(figure.axes) == 1


def test_panels_with_one_scale_share_a_labeled_color_bar():
    scale = Scale(label="v")
    image = Heatmap(values=field(), x=GRID, y=GRID, scale=scale)
    bare = Heatmap(values=field(), x=GRID, y=GRID, scale=Scale())
    figure = draw(
        plot(Panel(marks=(image,)), Panel(marks=(image,)), Panel(marks=(bare,)), columns=3)
    )
    assert len(panel_axes(figure)) == 3
    assert len(figure.axes) == 4


def test_segments_rules_texts_and_notes():
    ends = np.array([[[0.0, 0.0], [1.0, 2.0]]])
    axes, figure = drawn(
        Segments(ends=ends, color="#D55E00"),
        ReferenceLine(at=1.0, axis="x"),
        ReferenceLine(at=2.0),
        TextMark(x=0.5, y=0.5, text="here $x$", side="below"),
        note="nothing to see",
    )
    np.testing.assert_array_equal(axes.collections[0].get_segments()[0], ends[0])
    assert [list(line.get_xdata()) for line in axes.lines] == [[1.0, 1.0], [0, 1]]
    assert {r"here \$x\$", "nothing to see"} <= set(texts(figure))


def test_axes_have_the_limits_ticks_and_direction_of_the_description():
    x = Axis(label="x", low=1.0, high=9.0, ticks={2.0: "two", 50.0: "beyond"}, flipped=True)
    y = signed_axis("y", [np.array([1e-5, 1.0])])
    axes, _ = drawn(Line(x=X, y=X, color="#0072B2"), x=x, y=y, grid=True, framed=True)
    assert axes.get_xlim() == (9.0, 1.0)
    assert axes.get_yscale() == "symlog"
    assert [t.get_text() for t in axes.get_xticklabels()] == ["two", "beyond"]
    assert all(spine.get_visible() for spine in axes.spines.values())
    log, _ = drawn(Line(x=X, y=X, color="#0072B2"), x=Axis(kind="log"))
    assert all("$" not in t.get_text() for t in log.get_xticklabels())


def test_labels_that_would_touch_are_rotated():
    names = [f"a long name {k}" for k in range(9)]
    axis = name_axis(names, flipped=False)
    axes, _ = drawn(Dots(x=np.arange(9.0), y=np.arange(9.0), color="#0072B2"), x=axis)
    assert {t.get_rotation() for t in axes.get_xticklabels()} == {90.0}


def test_the_legend_has_an_entry_per_label():
    line = Line(x=X, y=X, color="#0072B2", dashes=":", label="both")
    dots = Dots(x=X, y=X, color="#0072B2", marker="s", label="both")
    bars = BarChart(at=X, value=X, color="#D55E00", label="bars")
    _, figure = drawn(line, dots, bars)
    (legend,) = figure.legends
    assert [t.get_text() for t in legend.get_texts()] == ["both", "bars"]
    (sign,) = (h for h in legend.legend_handles if isinstance(h, mpl.lines.Line2D))
    assert (sign.get_linestyle(), sign.get_marker()) == (":", "s")


def test_dollar_signs_do_not_start_mathematics():
    name = r"from-file(path='$a_{$\frac')"
    line = Line(x=X, y=X, color="#0072B2", label=name)
    figure = draw(
        plot(Panel(marks=(line,), x=Axis(label=name), y=Axis(ticks={1.0: name}), title=name))
    )
    assert sum("$a" in text for text in texts(figure)) >= 3


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7])
def test_panels_are_in_reading_order(count):
    panels = [
        Panel(marks=(), title=f"p{k}", x=Axis(label="x"), y=Axis(label="y")) for k in range(count)
    ]
    figure = draw(plot(*panels, columns=3, share="both"))
    axes = panel_axes(figure)
    assert [a.get_title() + a.get_title(loc="left") for a in axes] == [
        f"p{k}" for k in range(count)
    ]
    columns = min(3, count)
    for k, each in enumerate(axes):
        assert each.yaxis.label.get_visible() == (k % columns == 0)
        assert each.xaxis.label.get_visible() == (k + columns >= count)
        assert each is axes[0] or each.get_shared_x_axes().joined(axes[0], each)


def test_figures_are_registered_in_pyplot_only_on_request():
    from matplotlib import pyplot as plt

    before = dict(mpl.rcParams)
    one = plot(Panel(marks=(Line(x=X, y=X, color="#0072B2"),)))
    assert draw(one).canvas.manager is None
    assert not plt.get_fignums()
    figure = draw(one, pyplot=True)
    assert plt.gcf() is figure
    plt.close(figure)
    encode(draw(one))
    assert dict(mpl.rcParams) == before


def test_given_axes_keep_their_figure_and_get_the_legend():
    figure = Figure()
    axes = figure.subplots(1, 2)
    line = Line(x=X, y=X, color="#0072B2", label="a")
    both = plot(Panel(marks=(line,)), Panel(marks=(line,)), share="x")
    assert draw(both, axes) is figure
    assert not figure.legends
    assert axes[0].get_legend() is not None
    assert axes[0].get_shared_x_axes().joined(*axes)


@pytest.mark.parametrize("axes", ["here", 3, [], [1], np.zeros(1), Figure().subplots(1, 3)])
def test_invalid_axes_give_an_error(axes):
    with pytest.raises(ParameterError, match="this result needs one matplotlib Axes"):
        draw(plot(Panel(marks=())), axes)
    with pytest.raises(ParameterError, match="2 matplotlib Axes of one figure"):
        draw(plot(Panel(marks=()), Panel(marks=())), [Figure().subplots(), Figure().subplots()])


def test_encoded_bytes_are_reproducible_without_time_stamps():
    line = Line(x=X, y=X, color="#D55E00", width=6.0, label="推定 $x")
    one = plot(Panel(marks=(line,), title="a title"))
    with np.testing.assert_no_warnings():
        png, pdf = encode(draw(one))
    assert (png, pdf) == encode(draw(one))
    assert (png, b"") == encode(draw(one), with_pdf=False)
    assert png.startswith(b"\x89PNG")
    assert pdf.startswith(b"%PDF")
    assert b"CreationDate" not in pdf
    assert b"Type3" not in pdf
    image = Picture.open(io.BytesIO(png)).convert("RGB")
    assert image.getpixel((0, 0)) == (0xFC, 0xFC, 0xFA)  # same color as the frame on the page
    away = np.abs(np.asarray(image).astype(int) - (0xD5, 0x5E, 0x00)).max(axis=2)
    # The line covers 6 pt x ~4 in, so far more than 1 % of the pixels have its color
    assert (away <= 16).mean() > 0.01


def test_embedded_fonts_have_outlines_but_no_tables_for_layout():
    """Text is shaped before it is embedded. Afterwards, fontTools is as before."""
    from fontTools import subset
    from fontTools.ttLib import TTFont

    before = subset.load_font
    pdf = encode(draw(plot(Panel(marks=(), title="fi"))))[1]
    assert subset.load_font is before
    streams = re.findall(rb"stream\n(.*?)\nendstream", pdf, re.DOTALL)
    found = [zlib.decompress(each) for each in streams if each[:1] == b"\x78"]
    fonts = [TTFont(io.BytesIO(each)) for each in found if each.startswith(b"\0\1\0\0")]
    assert fonts
    for font in fonts:
        assert {"glyf", "cmap"} <= {*font.keys()}
        assert {"GSUB", "GPOS", "GDEF"}.isdisjoint(font.keys())


@pytest.mark.parametrize("shape", [(5, 7), (3, 240), (11, 239)])
def test_images_keep_their_exact_pixels(shape):
    rgb = np.random.default_rng(0).integers(0, 256, (2, *shape, 3)).astype(np.uint8)
    panels = [Panel(marks=(Pixels(rgb=each),), title="a", x=Axis(label="one\ntwo")) for each in rgb]
    found = np.asarray(Picture.open(io.BytesIO(encode(draw(plot(*panels, columns=2)))[0])))
    zoom = -(-240 // shape[1])
    height, width = zoom * shape[0], zoom * shape[1]
    for k, each in enumerate(rgb):
        left = 12 + k * (width + 12)
        shown = found[25 : 25 + height, left : left + width]
        np.testing.assert_array_equal(shown, each.repeat(zoom, axis=0).repeat(zoom, axis=1))


def test_images_that_are_too_large_give_an_error():
    panels = [Panel(marks=(Pixels(rgb=np.zeros((1, 9000, 3), np.uint8)),))] * 4
    with pytest.raises(ParameterError, match="give a crop"):
        draw(plot(*panels, columns=4))


@pytest.mark.parametrize("extension", FORMATS)
def test_files_have_the_same_bytes(tmp_path, extension):
    one = plot(Panel(marks=(Dots(x=X, y=X, color="#0072B2"),)), caption="random | $shift, ünïcode")
    files = [tmp_path / f"{k}{extension}" for k in "ab"]
    for file in files:
        write(one, file, captioned=True)
    assert files[0].read_bytes() == files[1].read_bytes()
    assert len(files[0].read_bytes()) > 1000


def test_many_dots_are_rasterized_in_the_svg(tmp_path):
    for n, inside in ((5000, 0), (5001, 1)):
        x = np.random.default_rng(0).random(n)
        write(plot(Panel(marks=(Dots(x=x, y=x, color="#0072B2"),))), tmp_path / "p.svg")
        assert len(re.findall("<image", (tmp_path / "p.svg").read_text())) == inside


def test_unknown_extensions_and_unwritable_files_give_errors(tmp_path):
    one = plot(Panel(marks=()))
    with pytest.raises(FileFormatError, match="give one of .svg, .png, .pdf"):
        write(one, tmp_path / "p.gif")
    with pytest.raises(FileFormatError, match="cannot be written"):
        write(one, tmp_path / "no" / "p.png")


def test_titles_of_narrow_panels_have_two_lines_before_they_are_shortened():
    names = ["relative minimum distance", "points(path='a-very-long-name-without-any-gaps')"]
    panels = [Panel(marks=(Line(x=X, y=X, color="#0072B2"),), title=names[k % 2]) for k in range(6)]
    shown = texts(draw(plot(*panels, columns=3)))
    assert "relative minimum\ndistance" in shown
    assert not any(names[1] in text for text in shown)
    assert any(text.startswith("points(") and "…" in text for text in shown)


def test_whiskers_at_a_single_point_of_logarithmic_axes_are_drawn_without_a_warning():
    n, measured, predicted = (
        np.array([256.0]),
        np.array([1.56231299e-05]),
        np.array([1.50162976e-05]),
    )
    panel = Panel(
        marks=(
            Dots(x=n, y=measured, color=FAINT, low=0.9 * measured, high=1.1 * measured),
            Dots(x=n, y=predicted, color=FAINT, low=predicted - 4e-13, high=predicted + 4e-13),
        ),
        x=Axis(label="n", kind="log", low=128.0, high=512.0),
        y=Axis(label="variance", kind="log", low=1.3e-5, high=1.8e-5),
    )
    encode(draw(plot(panel, height=0.95, small=True)))
