"""Pictures of point sets and nothing else: dots in a thin frame, a line that says what they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array, as_unit_points
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.report.formatting import shorten
from mcspectra.report.style import GRAY, INK, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PICTURE_EXTENSIONS", "point_picture", "write_point_picture"]

PICTURE_EXTENSIONS = (".svg", ".png", ".pdf")

MAX_SETS, MAX_AXES, MAX_POINTS = 6, 6, 2**20
_SIDE = 4.6  # inches, of a square that stands alone
_MARGIN, _CAPTION, _GAP = 0.12, 0.26, 0.1
_STRIP = 0.35
_LARGEST_DOT, _SMALLEST_DOT = 7.0, 0.5  # points
_DOT_SHARE = 0.3  # of the mean distance between points
_DPI = 200
_MOST_VECTORS = 2**14  # dots; more make a slow file: they become an image within it


def write_point_picture(path: str | PathLike[str], sets: object, caption: str = "") -> None:
    """Write a picture of point sets in the format of the file name's extension.

    Parameters
    ----------
    path
        Name of an .svg, .png or .pdf file; an existing one is replaced.
    sets, caption
        As for `point_picture`. The same picture has the same bytes.

    Raises
    ------
    FileFormatError
        Another extension, or a file that cannot be written.
    """
    file = Path(path)
    extension = file.suffix.lower()
    if extension not in PICTURE_EXTENSIONS:
        raise FileFormatError(f"{file} is no picture; give {', '.join(PICTURE_EXTENSIONS)}.")
    figure = point_picture(sets, caption)
    import matplotlib as mpl

    nothing: dict[str, Any] = {"Date": None} if extension == ".svg" else {"CreationDate": None}
    try:
        # Names of parts of an SVG are random without a salt.
        with mpl.rc_context({"svg.hashsalt": "mcspectra"}):
            figure.savefig(
                file,
                format=extension[1:],
                dpi=_DPI,
                metadata={} if extension == ".png" else nothing,
            )
    except OSError as error:
        raise FileFormatError(f"{file} cannot be written: {error.strerror or error}.") from None


def point_picture(sets: object, caption: str = "") -> Figure:
    """Draw point sets: strips in 1-D, squares in 2-D, all pairs of the first axes beyond.

    Parameters
    ----------
    sets
        Points of shape (n, d) or (R, n, d), in [0,1): the first 6 sets, of one in 3 dims or more
        the first 6 axes.
    caption
        What the line below the picture says; what is left out is added.

    Raises
    ------
    ParameterError
        Not points of the unit cube, or more than 2^20 of them.
    """
    points = _as_sets(sets)
    count, _, dims = points.shape
    shown = min(count, MAX_SETS) if dims <= 2 else 1
    axes_shown = min(dims, MAX_AXES)
    figure, panels = _panels(shown, axes_shown)
    for k, (axes, (i, j)) in enumerate(panels):
        one = points[k if dims <= 2 else 0]
        y = one[:, j] if dims > 1 else None
        _dots(axes, one[:, i], y, figure.get_size_inches()[0])
    left_out = _left_out(shown, count, axes_shown, dims)
    _write_caption(figure, ", ".join(part for part in (caption, left_out) if part))
    return figure


def _as_sets(sets: object) -> Array:
    points = as_unit_points(sets)
    if points.ndim not in (2, 3):
        raise ParameterError(f"points have shape {points.shape}; give (n, d) or (R, n, d).")
    points = points if points.ndim == 3 else points[None]
    if points.shape[1] > MAX_POINTS:
        raise ParameterError(f"{points.shape[1]} points are too many to see; draw {MAX_POINTS}.")
    return points


def _left_out(sets: int, all_sets: int, axes: int, dims: int) -> str:
    said = [f"{sets} of {all_sets} sets"] if sets < all_sets else []
    if axes < dims:
        said.append(f"axes 0 to {axes - 1} of {dims}")
    return ", ".join(said)


def _panels(sets: int, dims: int) -> tuple[Figure, list[tuple[Axes, tuple[int, int]]]]:
    """Make the figure and its panels, each with the axes of the points that it shows."""
    if dims == 1:
        places = [(0, k) for k in range(sets)]
        pairs = [(0, 0)] * sets
    elif dims == 2:
        columns = 2 if sets in (2, 4) else min(sets, 3)
        places = [(k % columns, k // columns) for k in range(sets)]
        pairs = [(0, 1)] * sets
    else:
        pairs = [(i, j) for j in range(1, dims) for i in range(j)]
        places = [(i, j - 1) for i, j in pairs]
    columns, rows = (max(place) + 1 for place in zip(*places, strict=True))
    width = _SIDE if columns == 1 else max(_SIDE, 2.6 * columns) if dims == 2 else 1.5 * _SIDE
    side = (width - 2 * _MARGIN - (columns - 1) * _GAP) / columns
    height = _STRIP if dims == 1 else side
    figure = _figure(width, _MARGIN + _CAPTION + rows * height + (rows - 1) * _GAP)
    boxes = [
        (_MARGIN + x * (side + _GAP), _CAPTION + (rows - 1 - y) * (height + _GAP), side, height)
        for x, y in places
    ]
    return figure, [(_frame(figure, box), pair) for box, pair in zip(boxes, pairs, strict=True)]


def _figure(width: float, height: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), facecolor="white", dpi=_DPI)
    FigureCanvasAgg(figure)
    return figure


def _frame(figure: Figure, box: Sequence[float]) -> Axes:
    """Add an empty square with a thin frame; `box` is left, bottom, width, height in inches."""
    width, height = figure.get_size_inches()
    x, y, w, h = box
    axes = figure.add_axes((x / width, y / height, w / width, h / height))
    axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(linewidth=0.5, color=GRAY)
    return axes


def _dots(axes: Axes, x: Array, y: Array | None, width: float) -> None:
    """Draw points in a figure of so many inches' width; strokes where there is no `y`."""
    raster = len(x) > _MOST_VECTORS
    if y is None:
        stroke = max(0.2, min(1.2, 150 / len(x)))
        axes.vlines(x, 0.15, 0.85, INK, linewidth=stroke, rasterized=raster)
        return
    side = 72.0 * width * axes.get_position().width
    dot = float(np.clip(_DOT_SHARE * side / math.sqrt(len(x)), _SMALLEST_DOT, _LARGEST_DOT))
    # Dots at the border are whole.
    dots = axes.scatter(x, y, s=dot**2, linewidths=0, rasterized=raster, clip_on=False)
    dots.set_facecolor([INK, INK])  # two, though equal: dots of one style go to whole pixels


def _write_caption(figure: Figure, text: str) -> None:
    width, height = figure.get_size_inches()
    figure.text(
        _MARGIN / width,
        0.5 * _CAPTION / height,
        plain(shorten(text, int(17 * width))),
        fontsize=7,
        color=INK,
        va="center",
    )
