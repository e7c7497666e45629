"""One quiet look for all figures: palette, sizes, panels, thin axes.

Colours are those of Okabe & Ito, which stay apart for colour-blind readers, without the yellow and
with dark grey for the black. Figures are made with matplotlib's object interface and styled artist
by artist: nothing here reads or changes global settings.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, final

from mcspectra.report.formatting import shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure

__all__ = [
    "ACCENT",
    "FAINT",
    "GRAY",
    "INK",
    "LABEL_SIZE",
    "NARROW",
    "SMALL_SIZE",
    "WIDE",
    "LineStyle",
    "entitle",
    "figure_width",
    "labels",
    "legend_below",
    "line_widths",
    "new_figure",
    "outer_labels",
    "panel_blocks",
    "plain",
    "quiet",
    "quiet_colorbar",
    "sampler_styles",
    "say",
]

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#4D4D4D")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ("-", "--", ":", "-.")
INK, GRAY, FAINT, PAPER = "#262626", "#8A8A8A", "#DCDCDC", "#FCFCFA"
ACCENT = "#D55E00"

NARROW, WIDE = 4.9, 7.4
"""Widths of figures in inches: up to two panels abreast, and three."""
LABEL_SIZE, SMALL_SIZE = 8.5, 7.5
_MOST_COLUMNS = 3
_OWN = "mcspectra"  # label of figures made here


@final
@dataclass(frozen=True, kw_only=True)
class LineStyle:
    """How one sampler is drawn wherever it appears."""

    color: str = PALETTE[0]
    marker: str = MARKERS[0]
    dashes: str = DASHES[0]


def sampler_styles(samplers: Sequence[str]) -> dict[str, LineStyle]:
    """Give every sampler a style of its own: colour and marker first, dashes once those run out."""
    distinct = list(dict.fromkeys(samplers))
    cycle = itertools.product(DASHES, zip(PALETTE, MARKERS, strict=True))
    return {
        name: LineStyle(color=color, marker=marker, dashes=dashes)
        for name, (dashes, (color, marker)) in zip(distinct, itertools.cycle(cycle), strict=False)
    }


def labels(names: Sequence[str], length: int = 30) -> dict[str, str]:
    """Return a short label for every name, safe for matplotlib, different for different names."""
    short: dict[str, str] = {}
    for name in names:
        label, repeat = shorten(name, length), 2
        while label in short.values():
            label, repeat = f"{shorten(name, length - 4)} ({repeat})", repeat + 1
        short[name] = label
    return {name: plain(label) for name, label in short.items()}


def plain(text: str) -> str:
    """Escape dollar signs, which matplotlib would read as mathematics."""
    return text.replace("$", r"\$")


def figure_width(columns: int) -> float:
    """Width in inches of a figure with so many panels abreast."""
    return NARROW if columns <= 2 else WIDE


def new_figure(width: float, height: float) -> Figure:
    """Make an empty figure (inches) with a canvas of its own, unknown to pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = ConstrainedLayoutEngine(w_pad=0.07, h_pad=0.07)
    figure = Figure(figsize=(width, height), layout=layout, facecolor=PAPER)
    figure.set_label(_OWN)
    FigureCanvasAgg(figure)
    return figure


def panel_blocks(count: int, parts: int, height: float) -> tuple[Figure, list[list[Axes]]]:
    """Make a figure of `count` items with `parts` panels each, at most three items abreast.

    Parameters
    ----------
    count, parts
        Items stand side by side, the parts of an item below one another; one item alone has its
        parts side by side.
    height
        Height of a panel relative to its width.

    Returns
    -------
    tuple
        The figure and its axes [item][part].
    """
    if count == 1:
        columns, rows = min(parts, 2), math.ceil(parts / 2)
        places = [[divmod(part, columns) for part in range(parts)]]
    else:
        columns = math.ceil(count / math.ceil(count / _MOST_COLUMNS))  # 4 stand 2 by 2
        rows = parts * math.ceil(count / columns)
        places = [
            [(parts * (item // columns) + part, item % columns) for part in range(parts)]
            for item in range(count)
        ]
    width = figure_width(columns)
    # A fixed strip a row holds titles and tick labels.
    figure = new_figure(width, rows * (0.95 * width / max(columns, 1.35) * height + 0.35))
    grid = figure.subplots(rows, columns, squeeze=False)
    blocks = [[grid[place] for place in item] for item in places]
    used = {place for item in places for place in item}
    for place in itertools.product(range(rows), range(columns)):
        if place not in used:
            grid[place].remove()
    for axes in itertools.chain.from_iterable(blocks):
        quiet(axes)
    return figure, blocks


def quiet(axes: Axes, *, grid: bool = False) -> None:
    """Thin axes on two sides, small dark ticks; with `grid` faint lines behind the data."""
    axes.set_facecolor("white")
    for side, spine in axes.spines.items():
        spine.set_linewidth(0.6)
        spine.set_color(GRAY)
        spine.set_visible(side in ("left", "bottom"))
        spine.set_in_layout(False)  # it lies on the axes' frame, and is slow to measure
    axes.tick_params(
        which="both", width=0.6, length=2.5, labelsize=SMALL_SIZE, color=GRAY, labelcolor=INK
    )
    axes.xaxis.label.set(fontsize=LABEL_SIZE, color=INK)
    axes.yaxis.label.set(fontsize=LABEL_SIZE, color=INK)
    axes.set_axisbelow(True)
    axes.locator_params(nbins=4)  # few ticks read better, and are most of the time of drawing
    if grid:
        axes.grid(True, which="major", color=FAINT, linewidth=0.5)


def entitle(axes: Axes, text: str, side: Literal["left", "center"] = "center") -> None:
    """Set a panel's title in the size of the labels."""
    # A fixed y: looking for a free one takes longer than all the rest of the layout.
    axes.set_title(text, loc=side, fontsize=LABEL_SIZE, color=INK, pad=4, y=1.0)


def say(axes: Axes, text: str) -> None:
    """Write in the middle of a panel why it is empty."""
    axes.text(
        0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center",
        fontsize=SMALL_SIZE, color=INK, style="italic",
    )  # fmt: skip


def outer_labels(axes: Axes) -> None:
    """Leave the labels of a common vertical scale to the panels of the first column."""
    place = axes.get_subplotspec()
    if place is not None and not place.is_first_col():
        axes.set_ylabel("")
        axes.tick_params(labelleft=False)


def line_widths(count: int) -> list[float]:
    """Widths for lines drawn over one another, thickest first: one that coincides still shows."""
    return [1.1 + 0.5 * min(later, 3) for later in reversed(range(count))]


def quiet_colorbar(bar: Colorbar, label: str) -> None:
    """Style a colour bar like the axes, with its label."""
    bar.outline.set_visible(False)
    bar.ax.tick_params(
        which="both", width=0.6, length=2.5, labelsize=SMALL_SIZE, color=GRAY, labelcolor=INK
    )
    bar.set_label(label, fontsize=SMALL_SIZE, color=INK)


def legend_below(figure: Figure, axes: Axes, columns: int = 2) -> None:
    """Put the legend of `axes` under the figure, where it covers nothing.

    In a figure of somebody else, which has other axes perhaps, it goes into the axes.
    """
    handles, texts = axes.get_legend_handles_labels()
    if not handles:
        return
    if figure.get_label() != _OWN:
        axes.legend(handles, texts, frameon=False, fontsize=SMALL_SIZE, labelcolor=INK)
        return
    figure.legend(
        handles,
        texts,
        loc="outside lower center",
        ncols=min(columns, len(handles)),
        frameon=False,
        fontsize=SMALL_SIZE,
        labelcolor=INK,
        handlelength=1.8,
    )
