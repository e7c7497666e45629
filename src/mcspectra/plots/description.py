"""What a plot shows, without saying how it is drawn: panels with axes, marks and a color scale.

A `Plot` is plain data. Functions of this package make plots from results; both backends draw every
mark, scale and axis that is declared here. Places are data coordinates; sizes are points (1/72 inch).
Texts are plain: no TeX, no HTML.
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
"""What the pointer shows at each item of a mark: title → texts. Only bokeh has it."""

Dashes: TypeAlias = Literal["-", "--", ":", "-."]
Marker: TypeAlias = Literal["o", "s", "^", "D", "v", "P", "X", "|"]
"""Shapes of `Dots`; ``|`` is an upright stroke as long as the dots' size."""


@final
@dataclass(frozen=True, kw_only=True)
class Axis:
    """An axis of a panel; `mcspectra.plots.scales` makes those whose limits come from the data.

    Attributes
    ----------
    label
        Empty where the panel's title says it.
    kind
        ``signed`` is linear within ± `threshold` and logarithmic beyond (half a decade of room for
        the linear part on either side).
    low, high
        Limits; None leaves them to the marks with a small margin.
    ticks
        Places and their texts; None leaves them to the backend.
    threshold
        Of a ``signed`` axis.
    flipped
        Whether it runs downwards, or to the left.
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
    """How values become colors. Panels that hold the same scale share one color bar.

    Attributes
    ----------
    label
        Of the color bar; a scale of an empty label and no `names` has no bar.
    kind
        ``names``: values are whole numbers k, which mean ``names[k - low]``; a legend stands for
        the bar.
        ``signed``: symmetric, as of `Axis`.
    low, high
        Values of the ends; of a ``signed`` scale −high and high.
    ticks
        Places on the color bar and their texts; None leaves them to the backend.
    threshold
        Of a ``signed`` scale.
    palette
        ``sequential`` (dark to light), ``diverging`` (blue, white at the middle, orange), ``gray``
        (black to white), ``paper`` (white to black).
    names, colors
        Of a ``names`` scale, one each.
    beyond
        Whether values above `high` occur, which the bar then shows by an arrow.
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
    """A polyline with a band; NaN interrupts it. ``width=0`` draws the band alone, as an area.

    Attributes
    ----------
    x, y
        Places, (k,).
    low, high
        Ends of the band, (k,); None has no band.
    step
        Whether y holds for the cell around x rather than at x.
    label
        Entry in the legend; marks of the same label share one.
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
    """Markers, with whiskers where `low` and `high` are given.

    Attributes
    ----------
    color
        A color, or values (k,) of `scale`.
    size
        Diameter in points, one or (k,).
    low, high
        Ends of the whiskers along y, or along x where `across`, (k,); NaN has none.
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
    """Bars from `base` to `value` at places `at`, upright or lying, with whiskers where given.

    Attributes
    ----------
    at, value
        (k,); NaN has no bar.
    thickness
        In data coordinates; 0 draws stems.
    color
        One, or one each.
    lying
        Whether bars run along x, at places on the y axis.
    texts
        Written beside each bar's place at the far end of the panel; none by default.
    """

    at: Array
    value: Array
    color: str | Sequence[str]
    thickness: float = 0.8
    base: float = 0.0
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
    """Values on a regular grid; NaN is gray.

    Attributes
    ----------
    values
        (len(y), len(x)): row k stands at ``y[k]``.
    x, y
        Centers of the columns and rows, ascending.
    hover
        Further values of each cell that the pointer shows, of the shape of `values`, by title.
    name
        Title of `values` under the pointer.
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
    """A picture in true colors: uint8 (height, width, 3), the first row on top, in [0,w] × [0,h]."""

    rgb: Array


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Segments:
    """Straight segments (k, 2, 2): start and end, x and y."""

    ends: Array
    color: str
    width: float = 1.2
    label: str = ""


@final
@dataclass(frozen=True, kw_only=True)
class ReferenceLine:
    """A line across the panel at a place on the x or the y axis."""

    at: float
    axis: Literal["x", "y"] = "y"
    color: str = "#8A8A8A"
    dashes: Dashes = "-"
    width: float = 0.9
    label: str = ""


@final
@dataclass(frozen=True, kw_only=True)
class TextMark:
    """A short text at a place, ``side`` of it."""

    x: float
    y: float
    text: str
    color: str = "#262626"
    side: Literal["right", "left", "above", "below", "middle"] = "right"


Mark: TypeAlias = Line | Dots | BarChart | Heatmap | Pixels | Segments | ReferenceLine | TextMark


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """One pair of axes and the marks in it, the first at the back.

    Attributes
    ----------
    title
        Above the panel; a long one loses its middle.
    square
        Whether a unit is as long on both axes.
    framed
        Whether lines stand on all four sides rather than two.
    grid
        Whether faint lines stand behind the marks at the ticks.
    note
        Written in the middle: why the panel is empty.
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
        """The color scales of its marks, each once."""
        found = (getattr(mark, "scale", None) for mark in self.marks)
        return tuple(dict.fromkeys(scale for scale in found if scale is not None))


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Plot:
    """A figure: panels, what is said about it, and what they share.

    Attributes
    ----------
    panels
        In reading order.
    kind
        Kebab-case name of what it shows, such as ``convergence``; `mcspectra.plots.kinds` sets it.
    columns
        Panels abreast on paper; a narrow screen takes fewer.
    caption
        What is seen, and how to read it, in a sentence or two.
    words
        What it shows in numbers, for those who don't see it.
    height
        Height of a panel relative to its width.
    rows
        Relative heights of the rows; all the same by default.
    share
        Axes that all panels have in common: they zoom together, and inner labels are left out.
    wide
        Whether it takes the whole width of a page.
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

    @property
    def labels(self) -> tuple[str, ...]:
        """Entries of the legend, each once."""
        marks = (mark for panel in self.panels for mark in panel.marks)
        return tuple(dict.fromkeys(label for m in marks if (label := getattr(m, "label", ""))))
