"""Figures for a paper, with a given width and font size, on white, and readable in gray.

Options that are not given follow the user's rcParams of Matplotlib if those were changed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.core.checks import as_choice, as_real
from mcspectra.core.display import shown
from mcspectra.core.errors import Parameter, ParameterError
from mcspectra.plots import backend_matplotlib
from mcspectra.plots.backend_matplotlib import Look
from mcspectra.plots.description import Dots, Line, Mark, Panel, Plot, ReferenceLine, Segments
from mcspectra.plots.style import GRAY, INK, PALETTE, LineStyle, sampler_styles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "COLORS",
    "FORMATS",
    "SPECTRA",
    "PaperStyle",
    "inches",
    "paper_plot",
    "write_paper_figure",
]

SPECTRA = ("linear", "log")
"""Color scales of spectra."""

COLORS = ("gray", "viridis")
"""Color maps of spectra."""

FORMATS = (".pdf", ".pgf", ".svg")
"""Extensions of the files of each figure."""

_INCHES = {"in": 1.0, "mm": 1.0 / 25.4, "cm": 1.0 / 2.54, "pt": 1.0 / 72.27, "bp": 1.0 / 72.0}
_WIDTH, _FONT, _LINE = 3.33, 8.0, 1.0  # figure width in inches; font size and line width in points
_THIN = 0.6  # line width in points of guides and reference lines
_DOT = 3.2  # largest diameter of markers in points
_USUAL = 2.3  # width of a panel on an HTML page in inches
_MARKERS = 6  # number of markers on a curve without dots
# Least width of a panel in units of the font size, so that labels of ticks do not touch
_SQUARE, _WIDE = 9.5, 14.0


@final
@dataclass(frozen=True, kw_only=True)
class PaperStyle:
    """Look of figures for a paper.

    Attributes
    ----------
    look
        Width, font sizes and color map.
    line
        Line width of all curves in points.
    colors
        Colors of the samplers, in order.
    """

    look: Look
    line: float = _LINE
    colors: tuple[str, ...] = PALETTE

    @classmethod
    def of(
        cls,
        width: str | float | None = None,
        font_size: float | None = None,
        colors: str | None = None,
    ) -> PaperStyle:
        """Return the style for the options. Missing options come from rcParams that the user set.

        Parameters
        ----------
        width
            Width of a figure: inches, or a text such as ``"3.33in"``, ``"84mm"`` or ``"240pt"``.
            Default: the width of ``figure.figsize``, or 3.33 inches.
        font_size
            Size of all texts in points.
            By default, labels, ticks, titles and legends have the sizes in rcParams, or 8 points.
        colors
            Color map of spectra, one of `COLORS`. Default: ``image.cmap``, or viridis.

        Raises
        ------
        ParameterError
            If an option is not allowed.
        """
        import matplotlib as mpl
        from matplotlib.font_manager import font_scalings

        changed: dict[str, Any] = {
            key: value for key, value in mpl.rcParams.items() if value != mpl.rcParamsDefault[key]
        }
        if colors is not None:
            as_choice("colors", colors, COLORS)
        if font_size is None:
            base = float(changed.get("font.size", _FONT))

            def size(*keys: str) -> float:
                given = next((changed[key] for key in keys if key in changed), base)
                return base * font_scalings[given] if isinstance(given, str) else float(given)

            label, title = size("axes.labelsize"), size("axes.titlesize")
            small = size("xtick.labelsize", "ytick.labelsize", "legend.fontsize")
        else:
            label = small = title = as_real("font_size", font_size, least=3.0, most=30.0)
        if width is None and "figure.figsize" in changed:
            width = float(changed["figure.figsize"][0])
        cycle = changed["axes.prop_cycle"].by_key() if "axes.prop_cycle" in changed else {}
        look = Look(
            width=inches("width", _WIDTH if width is None else width),
            label=label,
            small=small,
            title=title,
            background=str(changed.get("figure.facecolor", "white")),
            colors=colors or changed.get("image.cmap"),
        )
        return cls(
            look=look,
            line=float(changed.get("lines.linewidth", _LINE)),
            colors=tuple(cycle.get("color", PALETTE)),
        )

    def styles(self, names: Iterable[str]) -> dict[str, LineStyle]:
        """Return a style per sampler. Styles differ in dashes and markers, not only in color."""
        return sampler_styles(list(names), self.colors, gray=True)


def inches(name: str, length: str | float) -> float:
    """Return the width of a figure in inches.

    Raises
    ------
    ParameterError
        If `length` is not a number with a unit, or is not between 1 and 20 inches.
    """
    text, factor = str(length).strip(), 1.0
    for unit, size in _INCHES.items():
        if text.endswith(unit):
            text, factor = text.removesuffix(unit).strip(), size
    try:
        value = factor * float(text)
    except ValueError:
        value = math.nan
    if not 1.0 <= value <= 20.0:
        units = ", ".join(_INCHES)
        raise ParameterError(
            Parameter(name),
            f" is {shown(str(length))}; give 1 to 20 inches, as a number with one of the units "
            f"{units}, such as 3.33in.",
        )
    return value


def paper_plot(plot: Plot, style: PaperStyle, styles: Mapping[str, LineStyle]) -> Plot:
    """Return a version of a plot for a paper.

    All curves have the same width. Curves without values are omitted, also in the legend.
    Curves without dots get a few markers. Panels are arranged so that they fit the width.

    Parameters
    ----------
    plot
        The plot, made with `styles`.
    style
        Look of the figures.
    styles
        Style of each sampler.
    """
    # Choose the columns. Dots of point sets are designed for panels of 2.3 inches
    square = all(panel.square for panel in plot.panels)
    least = (_SQUARE if square else _WIDE) * style.look.label / 72.0
    whole, count = style.look.width or _WIDTH, len(plot.panels)
    most = max(1, int(whole / least))
    columns = 1 if plot.columns == 1 else min(most, count)
    columns = math.ceil(count / math.ceil(count / columns))
    shrunk = min(1.0, whole / columns / _USUAL)

    markers = {(each.color, each.dashes): each.marker for each in styles.values()}
    panels = []
    for panel in plot.panels:
        dotted = {mark.label for mark in panel.marks if isinstance(mark, Dots)}
        marks: list[Mark] = []
        curves = 0
        for mark in panel.marks:
            match mark:
                case Line() if (mark.color, mark.dashes) in markers:
                    if not np.isfinite(mark.y).any():
                        continue
                    marks.append(replace(mark, width=style.line))
                    if mark.label not in dotted and not mark.step:
                        marker = markers[mark.color, mark.dashes]
                        at = _places(mark, panel, curves)
                        marks.append(
                            Dots(
                                x=mark.x[at], y=mark.y[at], color=mark.color, marker=marker,
                                size=_DOT, label=mark.label,
                            )
                        )  # fmt: skip
                    curves += 1
                case Line() | ReferenceLine() | Segments():
                    thin = mark.color in (GRAY, INK)
                    marks.append(replace(mark, width=_THIN) if thin else mark)
                case Dots():
                    if np.isfinite(np.asarray(mark.y, float)).any():
                        size: Any = mark.size if panel.square else np.minimum(mark.size, _DOT)
                        size = np.asarray(size) * (shrunk if panel.square else 1.0)
                        marks.append(replace(mark, size=float(size) if size.ndim == 0 else size))
                case _:
                    marks.append(mark)
        panels.append(replace(panel, marks=tuple(marks)))

    # Omit labels of axes that also appear on the panel below or on the left
    for k, panel in enumerate(panels):
        x, y = panel.x, panel.y
        if k + columns < len(panels) and x.label == panels[k + columns].x.label:
            x = replace(x, label="")
        if k % columns and y.label == panels[k - k % columns].y.label:
            y = replace(y, label="")
        panels[k] = replace(panel, x=x, y=y)
    return replace(plot, panels=tuple(panels), columns=columns)


def _places(line: Line, panel: Panel, turn: int) -> Any:
    """Return indices of vertices for markers: spread along the axis, and shifted for each curve."""
    known = np.flatnonzero(np.isfinite(line.y))
    x = np.log(line.x[known]) if panel.x.kind == "log" else line.x[known]
    if x.size <= _MARKERS:
        return known
    shift = (0.5 + 0.37 * turn) % 1.0
    wanted = x[0] + (x[-1] - x[0]) * (np.arange(_MARKERS) + shift) / _MARKERS
    return known[np.unique(np.abs(x[None] - wanted[:, None]).argmin(axis=1))]


def _spare_height(figure: Figure) -> float:
    """Return the empty height in inches above and below the rows of square panels.

    A square panel is smaller than its place in the layout if its width limits its size.
    """
    rows: dict[int, float] = {}
    for axes in figure.axes:
        if (place := axes.get_subplotspec()) is None:
            continue  # a color bar
        empty = axes.get_position(original=True).height - axes.get_position().height
        rows[place.rowspan.start] = min(rows.get(place.rowspan.start, 1.0), empty)
    return sum(rows.values()) * float(figure.get_figheight())


def write_paper_figure(plot: Plot, stem: Path, style: PaperStyle, heading: str = "") -> list[Path]:
    """Write a plot as PDF, PGF and SVG, and return the paths.

    Parameters
    ----------
    plot
        Result of `paper_plot`.
    stem
        Path of the files without an extension.
    style
        Look of the figure.
    heading
        Text above the figure, for instance with n and the number of sets.

    Raises
    ------
    FileFormatError
        If a file cannot be written.
    """
    figure = backend_matplotlib.draw(plot, look=style.look)
    if heading:
        width, height = figure.get_size_inches()
        figure.set_size_inches(width, height + 1.6 * style.look.title / 72.0)
        figure.suptitle(heading, fontsize=style.look.title, color=INK)
    figure.canvas.draw()
    if all(panel.square for panel in plot.panels):
        spare = _spare_height(figure)
        width, height = figure.get_size_inches()
        figure.set_size_inches(width, height - spare)
        figure.canvas.draw()
    figure.set_layout_engine("none")  # computing the layout again would take most of the time
    written = []
    for extension in FORMATS:
        path = stem.with_name(stem.name + extension)
        backend_matplotlib.write_figure(figure, path)
        written.append(path)
    return written
