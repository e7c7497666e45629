"""Draw plots with Matplotlib, for files, notebooks and the accessor.

Each artist is styled separately, so no global settings are read or changed.
Texts are plain, and ticks have fixed positions and plain labels:
typesetting of formulas would take most of the time for a small figure.
The same plot always gives the same bytes.
"""

from __future__ import annotations

import io
import math
import textwrap
import threading
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from mcspectra.core.checks import Array
from mcspectra.core.display import printable
from mcspectra.core.errors import FileFormatError, ParameterError, writing
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
from mcspectra.plots.scales import log_ticks
from mcspectra.plots.style import FAINT, GRADIENTS, GRAY, INK, PAPER
from mcspectra.plots.text import LATEX_TEXT, latex_maths, shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

__all__ = [
    "FORMATS",
    "LECTURE",
    "GivenAxes",
    "Look",
    "draw",
    "encode",
    "escaped",
    "panel_axes",
    "write",
    "write_figure",
    "write_pages",
]

GivenAxes: TypeAlias = "Axes | Iterable[Axes] | np.ndarray[Any, Any] | None"
"""Axes to draw into, one per panel (an array is read row by row). None creates a new figure."""

FORMATS = (".svg", ".png", ".pdf", ".pgf")
"""Extensions of files that `write` accepts."""

# Widths of figures in inches. Figures with one or two columns of panels are narrow.
# Figures with more columns and wide plots have the largest width, and small pictures the smallest
_TINY, _NARROW, _WIDE = 2.35, 4.9, 7.4
# In inches: smallest side of one of several panels, and largest side of a square panel
_LEAST_SIDE, _LARGEST_SQUARE = 2.3, 3.4
_LETTER = 0.0083  # mean width of a letter in inches, per point of its size
_CLOSE_LETTER = 0.0076  # mean width of a letter without a margin for wide letters
_TITLE_LETTER = 0.0088  # mean width of a letter in titles, which may have many capitals
_DPI, _PDF_DPI = 120, 200  # resolution of PNG files, and of rasterized parts of a PDF
_MOST_VECTORS = 5000  # largest number of points drawn as vectors: more make files large and slow
_PGF_DPI = 400  # resolution of maps and dots that belong to a PGF file
_MOST_PGF = 1500  # largest number of dots in a PGF file: TeX runs out of memory at about 5000
# Number of colors of a PNG. Files become a third of the size, and flat colors do not change
_COLORS = 256
_LAYOUT_TABLES = ("GDEF", "GPOS", "GSUB")  # tables of a font that place and replace glyphs
_EMBEDDING = threading.Lock()  # one file at a time is written without these tables
_MOST_PIXELS = 2**15  # largest side of an image in pixels: half of Matplotlib's own limit
# Width of a legend symbol with its gaps, in letters, for a free and for a given figure width
_HANDLE, _TIGHT_HANDLE = 7.0, 5.5
_LINEAR = 0.45  # each side of the linear part of an axis takes half a decade
_SIDES = {
    "right": ((4, 0), "left", "center"),
    "left": ((-4, 0), "right", "center"),
    "above": ((0, 4), "center", "bottom"),
    "below": ((0, -4), "center", "top"),
    "middle": ((0, 0), "center", "center"),
}


@final
@dataclass(frozen=True, kw_only=True)
class Look:
    """Sizes and colors of a figure.

    Attributes
    ----------
    width
        Width of the figure in inches. None: computed from the numbers of panels and columns.
    label, small, title
        Font sizes in points for labels of axes, other small texts, and titles of panels.
    background
        Color behind the panels.
    colors
        Color map of the palette ``sequential``. None: viridis.
    zoom
        Factor by which texts, lines and marks are larger in relation to panels.
    dpi
        Resolution of PNG files in pixels per inch.
    """

    width: float | None = None
    label: float = 8.5
    small: float = 7.5
    title: float = 8.5
    background: str = PAPER
    colors: str | None = None
    zoom: float = 1.0
    dpi: float = _DPI

    @property
    def ticks(self) -> dict[str, Any]:
        """Arguments of Matplotlib's ``tick_params``."""
        look = {"labelsize": self.small, "color": GRAY, "labelcolor": INK}
        return {"which": "both", "width": 0.6, "length": 2.5, **look}

    @property
    def letter(self) -> float:
        """Mean width in inches of a letter in a small text."""
        return _LETTER * self.small


_PAGE = Look()
LECTURE = Look(zoom=1.35, dpi=220)
"""Sizes for a lecture hall: the figure fills a screen, and its texts can be read from afar."""


def draw(plot: Plot, axes: GivenAxes = None, *, pyplot: bool = False, look: Look = _PAGE) -> Figure:
    """Draw a plot.

    Parameters
    ----------
    plot
        The plot.
    axes
        Axes to draw into. Default: a new figure.
    pyplot
        Whether to register a new figure in pyplot.
        Notebooks show a registered figure, and ``plt.savefig`` writes it.
    look
        Sizes and colors of the figure. The default is for figures on pages.

    Raises
    ------
    ParameterError
        If `axes` is not one Matplotlib axes per panel, or if images side by side are too large.
    """
    figure: Figure
    if axes is not None:
        from matplotlib.axes import Axes

        given: Any = axes.ravel() if isinstance(axes, np.ndarray) else axes
        panels = list(given) if isinstance(given, Iterable) else [given]
        owners: set[Any] = {each.figure if isinstance(each, Axes) else None for each in panels}
        count = len(plot.panels)
        if len(panels) != count or None in owners or len(owners) != 1:
            one = "one matplotlib Axes" if count == 1 else f"{count} matplotlib Axes of one figure"
            raise ParameterError(f"axes is {given!r:.80}; this result needs {one}.")
        (figure,) = owners
        for each in panels[1:]:
            _share(each, panels[0], plot.share)
    elif pictures := [m.rgb for panel in plot.panels for m in panel.marks if isinstance(m, Pixels)]:
        figure, panels = _exact_figure(plot, pictures[0].shape, pyplot, look)
    else:
        figure, panels = _new_figure(plot, pyplot, look)
    bars: dict[Scale, tuple[ScalarMappable, list[Axes]]] = {}
    for panel, each in zip(plot.panels, panels, strict=True):
        for scale, drawn in _panel(each, panel, look):
            bars.setdefault(scale, (drawn, []))[1].append(each)
    for scale, (drawn, where) in bars.items():
        if not scale.label or scale.kind == "names":
            continue
        extend: Any = "max" if scale.beyond else "neither"
        # The color bar is right of the panels, or below them if the width of the figure is given
        below = look.width is not None
        place: dict[str, Any] = {"location": "bottom", "aspect": 32} if below else {"aspect": 24}
        bar = figure.colorbar(drawn, ax=where, shrink=0.85, pad=0.02, extend=extend, **place)
        bar.outline.set_visible(False)
        bar.ax.tick_params(**look.ticks)
        ticks = scale.ticks
        if ticks is None and scale.kind == "log":
            ticks = log_ticks(scale.low, scale.high)
        if ticks is None:
            bar.ax.locator_params(axis="x" if below else "y", nbins=5)
        else:
            bar.set_ticks(list(ticks), labels=[escaped(text) for text in ticks.values()])
        bar.minorticks_off()
        length = 0.85 * (look.width or bar.ax.get_window_extent().height / figure.dpi)
        label = escaped(_broken(scale.label, length, look))
        bar.set_label(label, fontsize=look.small, color=INK)
    _legend(figure, panels[0] if axes is not None else None, plot, look)
    return figure


def panel_axes(figure: Figure) -> list[Axes]:
    """Return the axes of a figure in the order of its panels, without color bars."""
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


def encode(figure: Figure, *, with_pdf: bool = True, dpi: float = _DPI) -> tuple[bytes, bytes]:
    """Return the PNG, with `dpi` pixels per inch, and the PDF of a figure without time stamps.

    If `with_pdf` is off, the bytes of the PDF are empty. Both files use one computed layout.
    """
    pixels, pdf = rasterize(figure, with_pdf=with_pdf, dpi=dpi)
    return png_of(pixels, has_few_colors(figure)), pdf


def rasterize(
    figure: Figure, *, with_pdf: bool, dpi: float, like: Figure | None = None
) -> tuple[NDArray[np.uint8], bytes]:
    """Return the pixels of a figure, shape (height, width, 3), and its PDF; see `encode`.

    If `like` has the same size and axes, the axes get the places of its axes.
    The pictures of a slider then differ only inside the axes.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    # Ignore warnings about characters that the font lacks: the text of the page has them
    with warnings.catch_warnings(), mpl.rc_context({"pdf.fonttype": 42}):
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        figure.set_dpi(dpi)  # hinted text has other widths at another dpi
        engine = figure.get_layout_engine()
        if engine is not None:
            if like is not None and _alike(figure, like):
                for own, other in zip(figure.axes, like.axes, strict=True):
                    own.set_position(other.get_position(original=True), which="original")
            else:
                engine.execute(figure)
            figure.set_layout_engine("none")
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])  # type: ignore[no-untyped-call]
        pdf = io.BytesIO()
        if with_pdf:
            # Write the PDF by the backend itself, because savefig would compute the layout again
            figure.set_dpi(_PDF_DPI)
            metadata = {"CreationDate": None, "Creator": "mcspectra"}
            with _lean_fonts():
                FigureCanvasPdf(figure).print_pdf(pdf, metadata=metadata)  # type: ignore[no-untyped-call]
            figure.set_dpi(dpi)
            figure.set_canvas(canvas)
    return pixels, pdf.getvalue()


@contextmanager
def _lean_fonts() -> Iterator[None]:
    """Embed fonts into PDF files without their tables for the layout of texts.

    A PDF has the place of each glyph, so its readers do not use these tables.
    To cut the tables to the glyphs of a file takes most of the time of the file.
    """
    from fontTools import subset

    with _EMBEDDING:
        usual = subset.load_font

        def load_font(*given: Any, **options: Any) -> Any:
            font = usual(*given, **options)
            for table in _LAYOUT_TABLES:
                if table in font:
                    del font[table]
            return font

        subset.load_font = load_font
        try:
            yield
        finally:
            subset.load_font = usual


def _alike(figure: Figure, other: Figure) -> bool:
    """Return whether two figures have the same size, axes, labels and ticks.

    Titles may differ, but take the same number of lines.
    """
    if len(figure.axes) != len(other.axes) or not np.array_equal(figure.bbox, other.bbox):
        return False
    return all(
        _lines(first.get_title()) == _lines(second.get_title())
        and all(
            one.get_label_text() == two.get_label_text()
            and np.array_equal(one.get_view_interval(), two.get_view_interval())
            for one, two in ((first.xaxis, second.xaxis), (first.yaxis, second.yaxis))
        )
        for first, second in zip(figure.axes, other.axes, strict=True)
    )


def _lines(text: str) -> int:
    return text.count("\n") + bool(text)


def has_few_colors(figure: Figure) -> bool:
    """Return whether a palette is enough. In maps and images, rounded colors would be visible."""
    return not any(axes.images for axes in figure.axes)


def png_of(pixels: NDArray[np.uint8], palette: bool) -> bytes:
    """Return a PNG with all colors, or with a palette of 256 colors.

    The first pixel has the color of the background.
    """
    from PIL import Image as Picture

    image, png = Picture.fromarray(pixels), io.BytesIO()
    if palette:
        octree, no_dither = Picture.Quantize.FASTOCTREE, Picture.Dither.NONE
        image = image.quantize(_COLORS, method=octree, dither=no_dither)
        # Reduction to a palette rounds colors. Restore the background, which must match the page
        rounded, paper = image.getpalette() or [], int(np.asarray(image)[0, 0])
        rounded[3 * paper : 3 * paper + 3] = pixels[0, 0].tolist()
        image.putpalette(rounded)
    image.save(png, format="PNG", compress_level=6)
    return png.getvalue()


def write(plot: Plot, path: str | PathLike[str], *, captioned: bool = False) -> None:
    """Write a plot to a file in the format of its extension.

    PDF files have Type 42 fonts. PGF files are for ``\\input`` in LaTeX, but LaTeX is not needed.

    Parameters
    ----------
    plot
        The plot.
    path
        Path of the file.
    captioned
        Whether to write the caption below the plot.

    Raises
    ------
    FileFormatError
        If the extension is not in `FORMATS`, or the file cannot be written.
    """
    file = Path(path)
    if file.suffix.lower() not in FORMATS:
        raise FileFormatError(
            f"{file} has no extension of an image file; give one of {', '.join(FORMATS)}."
        )
    figure = draw(plot)
    if captioned:
        text = escaped(shorten(plot.caption, int(17 * figure.get_figwidth())))
        figure.supxlabel(text, x=0.02, ha="left", fontsize=_PAGE.small, color=INK)
    write_figure(figure, file)


def write_figure(figure: Figure, file: Path) -> None:
    """Write a figure in its own size to a file in the format of its extension.

    A map in a PGF file becomes a PNG file with the same name and a number.

    Raises
    ------
    FileFormatError
        If the file cannot be written.
    """
    import matplotlib as mpl

    extension = file.suffix.lower()
    stamps: dict[str, Any] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    # A fixed salt makes the ids in an SVG reproducible. A tight box would change the width
    fixed: Any = {"svg.hashsalt": "mcspectra", "pdf.fonttype": 42, "savefig.bbox": None}
    with writing(file), mpl.rc_context(fixed), _lean_fonts():
        if extension == ".pgf":
            _write_pgf(figure, file)
        else:
            figure.savefig(file, format=extension[1:], dpi=_PDF_DPI, metadata=stamps[extension])


def write_pages(pages: Iterable[tuple[str, Plot] | Figure], path: str | PathLike[str]) -> None:
    """Write titled plots and finished figures to a PDF with Type 42 fonts, one per page.

    Raises
    ------
    FileFormatError
        If the file cannot be written.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_pdf import PdfPages

    about = {"CreationDate": None, "Creator": "mcspectra"}
    fonts = mpl.rc_context({"pdf.fonttype": 42})
    with writing(path), fonts, _lean_fonts(), PdfPages(path, metadata=about) as pdf:
        for page in pages:
            if isinstance(page, tuple):
                title, plot = page
                page = draw(plot)
                page.suptitle(escaped(title), x=0.02, ha="left", fontsize=11, color=INK)
            pdf.savefig(page, dpi=_PDF_DPI)


def _write_pgf(figure: Figure, file: Path) -> None:
    """Write PGF. Matplotlib measures the texts, because LaTeX may not be installed."""
    from matplotlib.backend_bases import RendererBase
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_mixed import MixedModeRenderer
    from matplotlib.backends.backend_pgf import RendererPgf
    from matplotlib.collections import PathCollection

    class Renderer(RendererPgf):
        def get_text_width_height_descent(self, s: str, prop: Any, ismath: Any) -> Any:
            return RendererBase.get_text_width_height_descent(self, s, prop, ismath)

        def draw_text(
            self, gc: Any, x: Any, y: Any, s: str, prop: Any, angle: Any, ismath: Any = False,
            mtext: Any = None,
        ) -> None:  # fmt: skip
            # Escape characters that LaTeX would read as commands
            plain = s if ismath else s.translate(LATEX_TEXT)
            super().draw_text(gc, x, y, plain, prop, angle, ismath, mtext)  # type: ignore[no-untyped-call]

        def draw_image(self, *given: Any, **_: Any) -> None:
            from PIL import Image as Picture

            _graphics, x, y, im, *_transform = given
            # PGF has only lines and points, so a map becomes a separate picture
            picture = file.with_name(f"{file.stem}-{self.image_counter}.png")
            Picture.fromarray(im[::-1]).save(picture)
            self.image_counter += 1
            across, down = (f"{size / self.dpi:f}in" for size in im.shape[1::-1])
            left, bottom = (f"{at / self.dpi:f}in" for at in (x, y))
            self.fh.write(
                f"\\pgftext[left,bottom,at=\\pgfqpoint{{{left}}}{{{bottom}}}]"
                f"{{\\includegraphics[width={across},height={down}]{{{picture.name}}}}}%\n"
            )

    figure.set_dpi(_PGF_DPI)
    marks = [each for axes in figure.axes for each in axes.collections]
    dots = [each for each in marks if isinstance(each, PathCollection)]
    if sum(len(np.asarray(each.get_offsets())) for each in dots) > _MOST_PGF:
        for each in dots:
            each.set_rasterized(True)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    figure.set_layout_engine("none")
    width, height = figure.get_size_inches()
    stream = io.StringIO()
    inner = Renderer(figure, stream)  # type: ignore[no-untyped-call]
    mixed: Any = MixedModeRenderer(figure, width, height, figure.dpi, inner)  # type: ignore[no-untyped-call]
    figure.draw(mixed)
    file.write_text(
        "% for LaTeX with the package pgf, and graphicx if there is a map\n"
        "\\begingroup\n\\makeatletter\n\\begin{pgfpicture}\n"
        f"\\pgfpathrectangle{{\\pgfpointorigin}}{{\\pgfqpoint{{{width:f}in}}{{{height:f}in}}}}\n"
        "\\pgfusepath{use as bounding box, clip}\n"
        f"{latex_maths(stream.getvalue())}\\end{{pgfpicture}}\n\\makeatother\n\\endgroup\n",
        encoding="utf-8",
    )


def _share(axes: Axes, first: Axes, share: str) -> None:
    for which in ("x", "y"):
        joined = getattr(axes, f"get_shared_{which}_axes")().joined(first, axes)
        if share in (which, "both") and not joined:
            getattr(axes, f"share{which}")(first)


def _empty(size: tuple[float, float], pyplot: bool, layout: Any, background: str = PAPER) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if pyplot:
        from matplotlib import pyplot as plt

        return plt.figure(figsize=size, facecolor=background, layout=layout)
    figure = Figure(figsize=size, facecolor=background, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def _new_figure(plot: Plot, pyplot: bool, look: Look) -> tuple[Figure, list[Axes]]:
    """Create a figure for the panels of a plot. Inner labels of shared axes are hidden."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    count, columns = len(plot.panels), min(plot.columns, len(plot.panels))
    rows = math.ceil(count / columns)
    width = max(_WIDE, _LEAST_SIDE * columns) if plot.wide or columns > 2 else _NARROW
    width = look.width or (_TINY if plot.small else width) / look.zoom
    bar = any(scale.label and scale.kind != "names" for p in plot.panels for scale in p.scales)
    labelled = 1 if plot.share in ("y", "both") else columns
    side = (width - 0.85 * (bar and not look.width) - 0.5 * labelled) / columns
    side = (
        min(side, _LARGEST_SQUARE / look.zoom)
        if columns == 1 and plot.height > 0.8 and not plot.wide
        else side
    )
    if look.width and all(panel.square for panel in plot.panels):
        side -= 0.028 * look.label  # labels of a square panel reduce its width and height
    heights = [side * plot.height * part for part in plot.rows or (1.0,) * rows]

    # Add the space for titles, tick labels, axis labels and the legend
    below, line = plot.share in ("x", "both"), look.small / _PAGE.small
    strips = 0.2
    for row in range(rows):
        panels = plot.panels[row * columns : (row + 1) * columns]
        strips += 0.12 + 0.19 * line * any(panel.title for panel in panels)
        if row == rows - 1 or not below:
            lines = (panel.x.label.count("\n") + bool(panel.x.label) for panel in panels)
            strips += (0.2 + 0.15 * max(lines)) * line
    strips += 0.55 * line * (bar and look.width is not None)
    if entries := _entries(plot):
        strips += 0.18 * line * math.ceil(len(entries) / _legend_columns(entries, width, look))

    layout = ConstrainedLayoutEngine(w_pad=0.07, h_pad=0.05)
    figure = _empty((width, sum(heights) + strips), pyplot, layout, look.background)
    grid = figure.add_gridspec(rows, columns, height_ratios=heights)
    made: list[Axes] = []
    for k in range(count):
        axes = figure.add_subplot(grid[divmod(k, columns)])
        if made:
            _share(axes, made[0], plot.share)
        # In each column, only the last panel has labels below.
        # If the width is given, only panels of the last row have labels
        if below and (k // columns < rows - 1 if look.width else k + columns < count):
            axes.tick_params(labelbottom=False)
            axes.xaxis.label.set_visible(False)
        if plot.share in ("y", "both") and k % columns:
            axes.tick_params(labelleft=False)
            axes.yaxis.label.set_visible(False)
        made.append(axes)
    return figure, made


def _exact_figure(
    plot: Plot, shape: tuple[int, ...], pyplot: bool, look: Look
) -> tuple[Figure, list[Axes]]:
    """Create a figure whose PNG shows each image pixel as a square of whole pixels."""
    # In pixels: least side, gap between panels, title height, and height of a line below
    fine = look.dpi / _DPI
    least, gap, strip, line = (round(fine * size) for size in (240, 12, 25, 16))
    height, width, _ = shape
    zoom, columns = max(1, -(-least // width)), min(plot.columns, len(plot.panels))
    foot = gap + line * max(panel.x.label.count("\n") + 1 for panel in plot.panels)
    across, down = gap + width * zoom, strip + height * zoom + foot
    wide, high = gap + columns * across, math.ceil(len(plot.panels) / columns) * down
    if max(wide, high) > _MOST_PIXELS:
        raise ParameterError(
            f"Images of {width} × {height} pixels side by side take {wide} × {high} pixels, more "
            f"than {_MOST_PIXELS} along a side; give a crop."
        )
    figure = _empty((wide / look.dpi, high / look.dpi), pyplot, "none")
    figure.set_dpi(look.dpi)
    made = []
    for row, column in (divmod(k, columns) for k in range(len(plot.panels))):
        left, top = gap + column * across, row * down + strip
        box = (left / wide, 1 - (top + height * zoom) / high)
        made.append(figure.add_axes((*box, width * zoom / wide, height * zoom / high)))
    return figure, made


def _panel(axes: Axes, panel: Panel, look: Look) -> Iterator[tuple[Scale, ScalarMappable]]:
    """Draw the marks of a panel. Yield its color scales with the artists that show them."""
    named = any(isinstance(mark, BarChart) and mark.lying for mark in panel.marks)
    # Draw thin axis lines on two or four sides, small dark ticks, and optional faint grid lines
    axes.set_facecolor("white")
    for side, spine in axes.spines.items():
        spine.set_linewidth(0.6)
        spine.set_color(GRAY)
        plain = side == "bottom" or (side == "left" and not named)
        spine.set_visible(panel.framed or plain)
        spine.set_in_layout(False)  # a spine needs no extra space, and measuring it is slow
    axes.tick_params(**look.ticks)
    if named:
        axes.tick_params(axis="y", length=0)
    axes.set_axisbelow(True)
    if panel.grid:
        axes.grid(True, which="major", color=FAINT, linewidth=0.5)
    for which, axis in (("x", panel.x), ("y", panel.y)):
        if axis.kind == "log":
            getattr(axes, f"set_{which}scale")("log")
        elif axis.kind == "signed":
            options = {"linthresh": axis.threshold, "linscale": _LINEAR}
            getattr(axes, f"set_{which}scale")("symlog", **options)
        if axis.low is not None and axis.high is not None:
            # Set the limits before the whiskers are drawn. On a logarithmic axis with one point,
            # whiskers would otherwise divide by a width of 0
            getattr(axes, f"set_{which}lim")(axis.low, axis.high)
    found: dict[Scale, ScalarMappable] = {}
    for k, mark in enumerate(panel.marks):
        drawn = _mark(axes, mark, 1.0 + 0.01 * k, look)
        scale = getattr(mark, "scale", None)
        if scale is not None and drawn is not None:
            found.setdefault(scale, drawn)
    if panel.square:
        axes.set_aspect("equal")
    for which, axis in (("x", panel.x), ("y", panel.y)):
        _finish_axis(axes, which, axis, look)
    room = axes.get_window_extent().width / axes.figure.dpi
    if panel.title:
        # Fix the position of the title: the search for a free place is slow.
        # If the width is given, letters are taken as narrower, so that fewer titles are shortened
        size = look.title * (_TITLE_LETTER if look.width is None else _CLOSE_LETTER)
        letters = max(int(room / size), 12 if look.width is None else 13)
        lines = textwrap.wrap(panel.title, letters, break_long_words=False)
        fits = len(lines) < 3 and max(map(len, lines)) <= letters
        text = escaped("\n".join(lines) if fits else shorten(panel.title, letters))
        left = room > 0.6 * _NARROW / look.zoom
        axes.set_title(
            text, loc="left" if left else "center", fontsize=look.title, color=INK, pad=4, y=1.0
        )
    if panel.note:
        axes.text(
            0.5, 0.5, escaped(panel.note), transform=axes.transAxes, ha="center", va="center",
            fontsize=look.small, color=INK, style="italic",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 2.0},
        )  # fmt: skip
    yield from found.items()


def _finish_axis(axes: Axes, which: str, given: Axis, look: Look) -> None:
    from matplotlib.ticker import MaxNLocator, NullLocator

    axis = getattr(axes, f"{which}axis")
    low, high = sorted(getattr(axes, f"get_{which}lim")())
    low = low if given.low is None else given.low
    high = high if given.high is None else given.high
    ticks = given.ticks
    if ticks is None and given.kind == "log":
        ticks = log_ticks(low, high)
    if which == "x" and ticks and look.width:
        # If the width is given, omit ticks whose labels would touch the next label on the right
        places = {
            tick: float(axis.get_transform().transform(np.array([tick]))[0]) for tick in ticks
        }
        first, last = axis.get_transform().transform(np.array([low, high]))
        inches = axes.get_window_extent().width / axes.figure.dpi / abs(last - first)
        kept: list[float] = []
        for tick in sorted(ticks, reverse=True):
            half = 0.5 * look.letter * (len(ticks[tick]) + len(ticks[kept[-1]]) if kept else 0)
            if not kept or inches * abs(places[kept[-1]] - places[tick]) > half:
                kept.append(tick)
        ticks = {tick: ticks[tick] for tick in sorted(kept)}
    if ticks is None:
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
    else:
        axis.set_ticks(list(ticks), labels=[escaped(text) for text in ticks.values()])
        axis.set_minor_locator(NullLocator())
    # Set limits after the ticks, which would extend them
    getattr(axes, f"set_{which}lim")(*((high, low) if given.flipped else (low, high)))
    room = axes.get_window_extent()
    length = (room.width if which == "x" else room.height) / axes.figure.dpi
    label = escaped(_broken(given.label, length, look))
    axis.set_label_text(label, fontsize=look.label, color=INK)
    if which == "x" and ticks and look.width is None:
        # Rotate labels that would touch each other
        at = np.sort(axis.get_transform().transform(np.array(list(ticks))))
        first, last = axis.get_transform().transform(np.array([low, high]))
        gap = length * np.diff(at).min(initial=np.inf) / (last - first)
        if look.letter * (max(map(len, ticks.values())) + 1) > gap:
            axes.tick_params(axis="x", rotation=90)


def _broken(label: str, length: float, look: Look) -> str:
    """Move the part of a label in parentheses to a second line, if the label is too long.

    The limit `length` is in inches.
    """
    return label.replace("   (", "\n(") if len(label) * look.letter * 1.15 > length else label


def _mark(axes: Axes, mark: Mark, depth: float, look: Look) -> ScalarMappable | None:
    """Draw a mark, such as a line or bars. Return its artist if the plot needs a color bar."""
    from matplotlib.collections import LineCollection

    paint: dict[str, Any] = {"color": getattr(mark, "color", INK), "zorder": depth}
    match mark:
        case Line():
            if mark.low is not None and mark.high is not None:
                opacity = 0.2 if mark.width else 1.0
                axes.fill_between(
                    mark.x, mark.low, mark.high, step="mid" if mark.step else None, alpha=opacity,
                    linewidth=0, **paint,
                )  # fmt: skip
            if mark.width:
                style: Any = "steps-mid" if mark.step else "default"
                axes.plot(
                    mark.x, mark.y, ls=mark.dashes, lw=mark.width, drawstyle=style,
                    solid_capstyle="round", **paint,
                )  # fmt: skip
        case Dots():
            plain = isinstance(mark.color, str)
            color = mark.color if isinstance(mark.color, str) else INK
            if mark.low is not None and mark.high is not None:
                at = mark.x if mark.across else mark.y
                reach = np.maximum([at - mark.low, mark.high - at], 0.0)
                _whiskers(axes, (mark.x, mark.y), reach, mark.across, color, depth)
            norm, colors = (None, None) if mark.scale is None else _norm(mark.scale, look)
            shown: dict[str, Any] = (
                {"color": color} if plain else {"c": mark.color, "norm": norm, "cmap": colors}
            )
            size, upright = (
                np.broadcast_to(np.square(mark.size), np.shape(mark.x)),
                mark.marker == "|",
            )
            stroke = float(np.clip(60.0 / max(len(mark.x), 1), 0.25, 1.2)) if upright else 0.0
            drawn = axes.scatter(
                mark.x, mark.y, s=size, marker=mark.marker, linewidths=stroke, zorder=depth,
                rasterized=len(mark.x) > _MOST_VECTORS, **shown,
            )  # fmt: skip
            return None if plain else drawn
        case BarChart():
            there = np.isfinite(mark.value)
            at, value = mark.at[there], mark.value[there]
            base = np.broadcast_to(mark.base, np.shape(mark.value))[there]
            if not isinstance(mark.color, str):
                pairs = zip(mark.color, there, strict=True)
                paint |= {"color": [each for each, present in pairs if present]}
            if mark.thickness:
                options = paint | {"alpha": mark.opacity, "linewidth": 0}
                if mark.lying:
                    axes.barh(at, value - base, mark.thickness, left=base, **options)
                else:
                    axes.bar(at, value - base, mark.thickness, bottom=base, **options)
            else:
                room = axes.get_window_extent()
                length = (room.height if mark.lying else room.width) * 72 / axes.figure.dpi
                width = float(np.clip(0.55 * length / max(len(mark.at), 1), 0.5, 5.0))
                stems = axes.hlines if mark.lying else axes.vlines
                stems(at, base, value, lw=width, alpha=mark.opacity, **paint)
            if mark.low is not None and mark.high is not None:
                # Omit the whisker of an end that is not finite
                low, high = (np.where(np.isfinite(e), e, mark.value) for e in (mark.low, mark.high))
                middle = 0.5 * (low + high)
                places = (middle, mark.at) if mark.lying else (mark.at, middle)
                _whiskers(axes, places, np.abs(0.5 * (high - low)), mark.lying, INK, depth + 0.005)
            for place, text in zip(mark.at, mark.texts, strict=False):
                end = (1.0, float(place)) if mark.lying else (float(place), 1.0)
                frame = axes.get_yaxis_transform() if mark.lying else axes.get_xaxis_transform()
                offset, across, up = _SIDES["right" if mark.lying else "above"]
                axes.annotate(
                    escaped(text), end, xycoords=frame, xytext=offset, textcoords="offset points",
                    ha=across, va=up, fontsize=look.small, color=INK,
                )  # fmt: skip
        case Heatmap():
            norm, colors = _norm(mark.scale, look)
            halves = [float(at[1] - at[0]) / 2 if len(at) > 1 else 0.5 for at in (mark.x, mark.y)]
            (left, right), (bottom, top) = (
                (float(at[0]) - half, float(at[-1]) + half)
                for at, half in zip((mark.x, mark.y), halves, strict=True)
            )
            return axes.imshow(
                np.ma.masked_invalid(mark.values), origin="lower", norm=norm, cmap=colors,
                extent=(left, right, bottom, top), interpolation="nearest", aspect="auto",
                zorder=depth,
            )  # fmt: skip
        case Pixels():
            height, width = mark.rgb.shape[:2]
            zoom = max(1, round(axes.get_window_extent().width / width))
            # Repeat pixels here, because Matplotlib's scaling may shift a row by half a pixel
            squares = np.repeat(np.repeat(mark.rgb, zoom, axis=0), zoom, axis=1)
            axes.imshow(
                squares, extent=(0, width, 0, height), interpolation="nearest", zorder=depth
            )
            axes.tick_params(bottom=False, left=False, labelbottom=False, labelleft=False)
            for spine in axes.spines.values():
                spine.set_visible(False)
        case Segments():
            lines = LineCollection(
                list(mark.ends), linewidths=mark.width, capstyle="round", **paint
            )
            axes.add_collection(lines)
        case ReferenceLine():
            line = axes.axvline if mark.axis == "x" else axes.axhline
            line(mark.at, ls=mark.dashes, lw=mark.width, **paint)
        case TextMark():
            offset, across, up = _SIDES[mark.side]
            axes.annotate(
                escaped(mark.text), (mark.x, mark.y), xytext=offset, textcoords="offset points",
                ha=across, va=up, fontsize=look.small, **paint,
            )  # fmt: skip
    return None


def _whiskers(
    axes: Axes, places: tuple[Array, Array], reach: Array, across: bool, color: str, depth: float
) -> None:
    options: dict[str, Any] = {"xerr" if across else "yerr": reach, "fmt": "none"}
    axes.errorbar(
        *places, **options, ecolor=color, elinewidth=0.9, capsize=1.8, capthick=0.9, zorder=depth
    )


def _norm(scale: Scale, look: Look) -> tuple[Any, Any]:
    """Return the norm and the color map of a scale. NaN becomes light gray."""
    from matplotlib import colormaps, colors

    if scale.kind == "names":
        chosen: Any = colors.ListedColormap(scale.colors)
        norm: Any = colors.Normalize(scale.low - 0.5, scale.low + len(scale.names) - 0.5)
    else:
        sequential = scale.palette == "sequential"
        gradient = (look.colors if sequential else None) or GRADIENTS[scale.palette]
        chosen = (
            colormaps[gradient]
            if isinstance(gradient, str)
            else colors.LinearSegmentedColormap.from_list(scale.palette, gradient)
        )
        ends = (scale.low, scale.high)
        if scale.kind == "signed":
            norm = colors.SymLogNorm(scale.threshold, _LINEAR, *ends, base=10)
        else:
            norm = (colors.LogNorm if scale.kind == "log" else colors.Normalize)(*ends)
    return norm, chosen.with_extremes(bad=FAINT)


def _entries(plot: Plot) -> dict[str, list[Mark | str]]:
    """Return the marks of each legend entry, and the color of each name of a scale."""
    found: dict[str, list[Mark | str]] = {label: [] for label in plot.labels}
    for panel in plot.panels:
        for mark in panel.marks:
            if label := getattr(mark, "label", ""):
                found[label].append(mark)
        for scale in panel.scales:
            found |= {n: [c] for n, c in zip(scale.names, scale.colors, strict=True)}
    return found


def _legend_columns(labels: Iterable[str], width: float, look: Look) -> int:
    """Return the largest number of columns, at most four, for which the texts fit in the width."""
    lengths, handle = list(map(len, labels)), _TIGHT_HANDLE if look.width else _HANDLE
    for columns in (4, 3, 2):
        # Matplotlib fills one column after the other
        rows = math.ceil(len(lengths) / columns)
        parts = [lengths[start : start + rows] for start in range(0, len(lengths), rows)]
        if sum(look.letter * (max(part) + handle) for part in parts) <= width:
            return math.ceil(len(lengths) / rows)
    return 1


def _legend(figure: Figure, given: Axes | None, plot: Plot, look: Look) -> None:
    """Draw the legend below a new figure, or inside axes given by the user."""
    from matplotlib.collections import LineCollection, PathCollection

    entries = _entries(plot)
    if not entries:
        return
    options: dict[str, Any] = {"frameon": False, "fontsize": look.small, "labelcolor": INK}
    handles = [_handle(marks) for marks in entries.values()]
    texts = [escaped(label) for label in entries]
    if given is not None:
        # If the legend overlaps lines, whiskers or dots, add space above, up to half of the axes
        box = given.legend(handles, texts, loc="best", **options).get_window_extent()
        drawn = [line.get_transform().transform_path(line.get_path()) for line in given.lines]
        for each in given.collections:
            if isinstance(each, LineCollection):
                drawn += [each.get_transform().transform_path(path) for path in each.get_paths()]
        dots = [
            given.transData.transform(each.get_offsets())
            for each in given.collections
            if isinstance(each, PathCollection)
        ]
        hidden = any(box.count_contains(places) for places in dots)
        if hidden or any(path.intersects_bbox(box, filled=False) for path in drawn):
            inches, scale = (
                (1.5 * len(handles) + 1.5) * look.small / 72,
                given.yaxis.get_transform(),
            )
            bottom, top = scale.transform(np.array(given.get_ylim()))
            kept = max(1.0 - inches * figure.dpi / given.get_window_extent().height, 0.5)
            given.set_ylim(top=float(scale.inverted().transform(bottom + (top - bottom) / kept)))
        return
    columns = min(_legend_columns(entries, figure.get_figwidth(), look), len(entries))
    if look.width:
        options |= {"columnspacing": 1.0, "handletextpad": 0.5, "borderaxespad": 0.2}
    options |= {"loc": "outside lower center", "ncols": columns, "handlelength": 1.8}
    figure.legend(handles, texts, **options)


def _handle(marks: list[Mark | str]) -> Any:
    """Return the legend symbol of an entry: a patch, or a line with the marker of its dots."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    first = marks[0]
    if isinstance(first, str):
        return Patch(facecolor=first, edgecolor=GRAY, linewidth=0.5)
    color = getattr(first, "color", INK)
    color = color if isinstance(color, str) else INK if isinstance(first, Dots) else color[0]
    lines = [m for m in marks if isinstance(m, Line | ReferenceLine | Segments) and m.width]
    dots = [m for m in marks if isinstance(m, Dots)]
    if not lines and not dots:
        opacity = first.opacity if isinstance(first, BarChart) else 1.0
        return Patch(facecolor=color, alpha=opacity, linewidth=0)
    # The marker "|" is a stroke without area, so only its edge is drawn
    stroke = bool(dots) and dots[0].marker == "|"
    return Line2D(
        [], [], color=color, ls=getattr(lines[0], "dashes", "-") if lines else "none",
        lw=lines[0].width if lines else 0.0, marker=dots[0].marker if dots else "none",
        ms=8 if stroke else 4, markeredgewidth=1.2 if stroke else 0,
    )  # fmt: skip


def escaped(text: str) -> str:
    """Return a printable text in which dollar signs do not start mathematics."""
    return printable(text, lines=True).replace("$", r"\$")
