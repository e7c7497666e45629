"""One look for all plots: a palette that color-blind readers tell apart, and a style for each sampler.

Colors are those of Okabe & Ito, without the yellow and with dark gray for the black.
"""

from __future__ import annotations

import itertools
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

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#4D4D4D")
MARKERS: tuple[Marker, ...] = ("o", "s", "^", "D", "v", "P", "X")
DASHES: tuple[Dashes, ...] = ("-", "--", ":", "-.")
INK, GRAY, FAINT, PAPER = "#262626", "#8A8A8A", "#DCDCDC", "#FCFCFA"
"""Text and main marks, marks of lesser weight, grids and shapes behind, the ground. Backends turn them about on dark pages."""
ACCENT = "#D55E00"
TERM_COLORS = {
    "dc_term": "#56B4E9",
    "power_term": "#0072B2",
    "cross_term": "#D55E00",
    "predicted_variance": "#B4B4B4",
    "measured_variance": "#757575",
}
"""Colors of the terms of the variance, their sum and the measured variance in every figure."""
GRADIENTS = {
    "sequential": "viridis",
    "diverging": ("#0B3A63", "#0072B2", "#8CC1E0", "#F7F7F7", "#F2B488", "#D55E00", "#6E2C00"),
    "gray": ("#000000", "#FFFFFF"),
    "paper": ("#FFFFFF", "#000000"),
}
"""Colors of the palettes of a `Scale`, evenly spaced, or the name that both libraries know it by."""


@final
@dataclass(frozen=True, kw_only=True)
class LineStyle:
    """How one sampler is drawn wherever it appears."""

    color: str = PALETTE[0]
    marker: Marker = "o"
    dashes: Dashes = "-"


def sampler_styles(samplers: Sequence[str]) -> dict[str, LineStyle]:
    """Give every sampler a style of its own: color and marker first, dashes once those run out."""
    distinct = list(dict.fromkeys(samplers))
    cycle = itertools.product(DASHES, zip(PALETTE, MARKERS, strict=True))
    return {
        name: LineStyle(color=color, marker=marker, dashes=dashes)
        for name, (dashes, (color, marker)) in zip(distinct, itertools.cycle(cycle), strict=False)
    }


def labels(names: Sequence[str], length: int = 32) -> dict[str, str]:
    """Return a short label for every name, different for different names."""
    short: dict[str, str] = {}
    for name in names:
        label, repeat = shorten(name, length), 2
        while label in short.values():
            label, repeat = f"{shorten(name, length - 4)} ({repeat})", repeat + 1
        short[name] = label
    return short


def line_widths(count: int) -> list[float]:
    """Widths for lines drawn over one another, thickest first: one that coincides still shows."""
    return [1.1 + 0.5 * min(later, 3) for later in reversed(range(count))]
