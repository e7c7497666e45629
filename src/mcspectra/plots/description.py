"""Backend-independent description of a plot: panels with axes, marks and color scales.

A `Plot` is plain data. The functions of this package create plots from results.
Both backends draw every mark, scale and axis that is declared here.
Positions are data coordinates, and sizes are in points (1/72 inch).
Texts are plain, without TeX or HTML.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias, final

from mcspectra.core.checks import Array

__all__ = [
    "Axis",
    "BarChart",
    "Dots",
    "Heatmap",
    "Hover",
    "Line",
    "Mark",
    "Panel",
    "Pixels",
    "Plot",
    "ReferenceLine",
    "Scale",
    "Segments",
    "TextMark",
]

Hover: TypeAlias = Mapping[str, Sequence[str]]
"""Tooltips of a mark: from each title to one text per item. Only Bokeh shows them."""

Dashes: TypeAlias = Literal["-", "--", ":", "-."]
Marker: TypeAlias = Literal["o", "s", "^", "D", "v", "P", "X", "*", "|"]
"""Shapes of `Dots`. The shape ``|`` is a vertical stroke of length `size`."""


@final
@dataclass(frozen=True, kw_only=True)
class Axis:
    """Axis of a panel. The functions of `mcspectra.plots.scales` choose limits for given data.

    Attributes
    ----------
    label
        Label of the axis; empty if the panel's title describes it.
    kind
        A ``signed`` axis is linear within ± `threshold` and logarithmic beyond.
        Each half of the linear part of a signed axis takes as much space as half a decade.
    low, high
        Limits. None: the limits of the marks, with a small margin.
    ticks
        Positions and texts of the ticks. None: the backend chooses them.
    threshold
        End of the linear part of a ``signed`` axis.
    flipped
        Whether the axis runs down or to the left.
    """

    label: str = ""
    kind: Literal["linear", "log", "signed"] = "linear"
    low: float | None = None
    high: float | None = None
    ticks: Mapping[float, str] | None = None
    threshold: float = 0.0
    flipped: bool = False


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Scale:
    """A mapping of values to colors. Panels with the same scale have one color bar.

    Attributes
    ----------
    label
        Label of the color bar. A scale with an empty label and no `names` has no bar.
    kind
        In a ``names`` scale, the integer value k stands for ``names[k - low]``.
        A legend replaces the color bar of a ``names`` scale.
        A ``signed`` scale is symmetric, linear within ± `threshold` and logarithmic beyond.
    low, high
        Values at the two ends of the scale; for a ``signed`` scale, −high and high.
    ticks
        Positions and texts of the ticks on the color bar. None: the backend chooses them.
    threshold
        End of the linear part of a ``signed`` scale.
    palette
        ``sequential`` runs from dark to light, and ``diverging`` from blue through white to orange.
        ``gray`` runs from black to white, and ``paper`` from white to black.
    names, colors
        Names and colors of a ``names`` scale, one per value.
    beyond
        Whether some values are above `high`. An arrow at the end of the bar shows this.
    """

    label: str = ""
    kind: Literal["linear", "log", "signed", "names"] = "linear"
    low: float = 0.0
    high: float = 1.0
    ticks: Mapping[float, str] | None = None
    threshold: float = 0.0
    palette: Literal["sequential", "diverging", "gray", "paper"] = "sequential"
    names: tuple[str, ...] = ()
    colors: tuple[str, ...] = ()
    beyond: bool = False


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """A polyline, perhaps with a band. NaN interrupts the line; width 0 draws only the band.

    Attributes
    ----------
    x, y
        Coordinates of the vertices, with shape (k,).
    low, high
        Lower and upper ends of the band, with shape (k,). None: no band.
    step
        Whether the line is a step function: y is the value in a whole cell around x.
    label
        Entry in the legend. Marks with the same label share an entry.
    """

    x: Array
    y: Array
    color: str
    dashes: Dashes = "-"
    width: float = 1.3
    low: Array | None = None
    high: Array | None = None
    step: bool = False
    label: str = ""
    hover: Hover = field(default_factory=dict)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Dots:
    """Markers, with whiskers if both `low` and `high` are given.

    Attributes
    ----------
    color
        A color, or values (k,) that `scale` maps to colors.
    size
        Diameter in points, a scalar or one per dot.
    low, high
        Ends of the whiskers, with shape (k,). NaN means no whisker.
    across
        Whether the whiskers run along x instead of y.
    """

    x: Array
    y: Array
    color: str | Array
    marker: Marker = "o"
    size: float | Array = 4.0
    low: Array | None = None
    high: Array | None = None
    across: bool = False
    scale: Scale | None = None
    label: str = ""
    hover: Hover = field(default_factory=dict)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class BarChart:
    """Vertical or horizontal bars from `base` to `value`, with whiskers if given.

    Attributes
    ----------
    at, value
        Positions and values, with shape (k,). NaN means no bar.
    thickness
        Thickness in data coordinates. With 0, stems are drawn.
    color
        One color, or one per bar.
    base
        Value at which bars begin: one number, or one per bar.
    lying
        Whether the bars are horizontal, with positions on the y axis.
    texts
        One text per bar at the far end of the panel. Default: no texts.
    """

    at: Array
    value: Array
    color: str | Sequence[str]
    thickness: float = 0.8
    base: float | Array = 0.0
    low: Array | None = None
    high: Array | None = None
    lying: bool = False
    opacity: float = 1.0
    label: str = ""
    texts: Sequence[str] = ()
    hover: Hover = field(default_factory=dict)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Heatmap:
    """Values on a regular grid as colors; NaN is gray.

    Attributes
    ----------
    values
        Values of shape (len(y), len(x)); row k is at ``y[k]``.
    x, y
        Centers of the columns and rows, ascending.
    hover
        Further values for the tooltip by title: arrays of the same shape as `values`.
    name
        Title of `values` in the tooltip.
    """

    values: Array
    x: Array
    y: Array
    scale: Scale
    name: str = "value"
    hover: Mapping[str, Array] = field(default_factory=dict)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Pixels:
    """An RGB image, uint8 (height, width, 3), drawn in [0, width] × [0, height]; row 0 on top."""

    rgb: Array


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Segments:
    """Straight line segments. `ends` (k, 2, 2) has the x and y of both ends of each segment."""

    ends: Array
    color: str
    width: float = 1.2
    label: str = ""


@final
@dataclass(frozen=True, kw_only=True)
class ReferenceLine:
    """A straight line across the panel at a fixed x or y."""

    at: float
    axis: Literal["x", "y"] = "y"
    color: str = "#8A8A8A"
    dashes: Dashes = "-"
    width: float = 0.9
    label: str = ""


@final
@dataclass(frozen=True, kw_only=True)
class TextMark:
    """A short text next to a point. `side` is the position relative to the point."""

    x: float
    y: float
    text: str
    color: str = "#262626"
    side: Literal["right", "left", "above", "below", "middle"] = "right"


Mark: TypeAlias = Line | Dots | BarChart | Heatmap | Pixels | Segments | ReferenceLine | TextMark


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """One pair of axes with marks. The first mark is drawn behind the others.

    Attributes
    ----------
    title
        Title above the panel. If it is too long, its middle is omitted.
    square
        Whether both axes have the same scale.
    framed
        Whether the panel has axis lines on all four sides, instead of on two.
    grid
        Whether there are faint lines at the ticks, behind the marks.
    note
        Text in the middle of a panel without marks, which gives the reason.
    """

    marks: tuple[Mark, ...]
    x: Axis = field(default_factory=Axis)
    y: Axis = field(default_factory=Axis)
    title: str = ""
    square: bool = False
    framed: bool = False
    grid: bool = False
    note: str = ""

    @property
    def scales(self) -> tuple[Scale, ...]:
        """The distinct color scales of all marks."""
        found = (getattr(mark, "scale", None) for mark in self.marks)
        return tuple(dict.fromkeys(scale for scale in found if scale is not None))


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Plot:
    """A figure: panels, their layout, and texts about them.

    Attributes
    ----------
    panels
        Panels in reading order.
    kind
        Kebab-case name of the kind of plot, such as ``convergence``.
        For plots of results, the function `mcspectra.plots.kinds.describe` sets the name.
    columns
        Number of panels per row when printed. Narrow screens show fewer.
    caption
        One or two sentences on what the figure shows and how to read it.
    words
        Description of the contents in numbers, for screen readers.
    height
        Height of a panel relative to its width.
    rows
        Relative heights of the rows. Default: equal.
    share
        Axes that all panels share. They zoom together, and inner labels are omitted.
    wide
        Whether the figure takes the full width of a page.
    small
        Whether the figure is one of a row of small pictures. Its texts keep their size.
    """

    panels: tuple[Panel, ...]
    kind: str = ""
    columns: int = 1
    caption: str = ""
    words: str = ""
    height: float = 0.62
    rows: tuple[float, ...] = ()
    share: Literal["", "x", "y", "both"] = ""
    wide: bool = False
    small: bool = False

    @property
    def labels(self) -> tuple[str, ...]:
        """The distinct entries of the legend."""
        marks = (mark for panel in self.panels for mark in panel.marks)
        return tuple(dict.fromkeys(label for m in marks if (label := getattr(m, "label", ""))))
