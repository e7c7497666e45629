"""Common look of all plots: a palette for color-blind readers, and a style for each sampler.

The palette is from Okabe & Ito, with dark gray instead of black and brown instead of yellow.
For any kind of color blindness, all pairs of colors differ by at least ΔE = 16 (CIE 1976).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from mcspectra.plots.description import Dashes, Marker
from mcspectra.plots.text import shorten

__all__ = [
    "ACCENT",
    "FAINT",
    "GRADIENTS",
    "GRAY",
    "INK",
    "MARKERS",
    "PALETTE",
    "PAPER",
    "TERM_COLORS",
    "LineStyle",
    "labels",
    "line_widths",
    "sampler_styles",
]

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#4D4D4D", "#7F5733")
MARKERS: tuple[Marker, ...] = ("o", "s", "^", "D", "v", "P", "X", "*")
DASHES: tuple[Dashes, ...] = ("-", "--", "-.", ":")
INK, GRAY, FAINT, PAPER = "#262626", "#8A8A8A", "#DCDCDC", "#FCFCFA"
"""Colors for text and main marks, for minor marks, for grids and shapes, and for the background.

On dark pages, backends replace these colors."""
ACCENT = "#D55E00"
TERM_COLORS = {
    "dc_term": "#56B4E9",
    "power_term": "#0072B2",
    "cross_term": "#D55E00",
    "predicted_variance": "#B4B4B4",
    "measured_variance": "#757575",
}
"""Colors of the terms of the variance, their sum, and the measured variance, in all figures."""
GRADIENTS = {
    "sequential": "viridis",
    "diverging": ("#0B3A63", "#0072B2", "#8CC1E0", "#F7F7F7", "#F2B488", "#D55E00", "#6E2C00"),
    "gray": ("#000000", "#FFFFFF"),
    "paper": ("#FFFFFF", "#000000"),
}
"""Palettes of a `Scale`: evenly spaced colors, or a name that both plotting libraries have."""


@final
@dataclass(frozen=True, kw_only=True)
class LineStyle:
    """Style of one sampler, the same in all plots."""

    color: str = PALETTE[0]
    marker: Marker = "o"
    dashes: Dashes = "-"


def sampler_styles(
    samplers: Sequence[str], colors: Sequence[str] = PALETTE, *, gray: bool = False
) -> dict[str, LineStyle]:
    """Return a distinct style per sampler. After all colors and markers, dashes also differ.

    With `gray`, consecutive samplers have different dashes.
    Lines then differ in dashes and markers, in case a printer omits the colors.
    """
    distinct = list(dict.fromkeys(samplers))
    styles: dict[str, LineStyle] = {}
    for k, name in enumerate(distinct):
        turn, place = divmod(k, len(colors))
        styles[name] = LineStyle(
            color=colors[place],
            marker=MARKERS[place % len(MARKERS)],
            dashes=DASHES[(k + turn if gray else turn) % len(DASHES)],
        )
    return styles


def labels(names: Sequence[str], length: int = 32) -> dict[str, str]:
    """Return a short label for each name. All labels are distinct."""
    short: dict[str, str] = {}
    for name in names:
        label, repeat = shorten(name, length), 2
        while label in short.values():
            label, repeat = f"{shorten(name, length - 4)} ({repeat})", repeat + 1
        short[name] = label
    return short


def line_widths(count: int) -> list[float]:
    """Return widths of overlaid lines, thickest first: coinciding lines then stay visible."""
    return [1.1 + 0.5 * min(later, 3) for later in reversed(range(count))]
