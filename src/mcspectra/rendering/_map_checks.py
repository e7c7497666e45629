"""Checks of what a map is asked for."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from mcspectra.core.checks import as_choice, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.rendering._map_tiles import MAP_STRATEGIES

__all__ = [
    "POINTS",
    "Window",
    "check_counts",
    "check_crop",
    "check_memory",
    "check_size",
    "check_smoothing",
    "check_strategies",
]

POINTS = ("shared", "own")

Window = tuple[int, int, int, int]
"""x0, y0, width and height of a crop."""

_MOST_NUMBERS = 2**27  # of a result: 1 GiB
_MOST_SMOOTHING = 31
_LONGEST_SIDE = 65_536


def check_counts(counts: Any) -> list[int]:
    """Return ascending counts, at least the two that a rate needs."""
    if not isinstance(counts, Sequence | np.ndarray) or isinstance(counts, str | bytes):
        raise ParameterError(f"counts is {counts!r}; give a list of ascending numbers of samples.")
    ns = [as_integer("counts", n, least=1) for n in counts]
    if len(ns) < 2 or any(b <= a for a, b in itertools.pairwise(ns)):
        raise ParameterError(
            f"counts is {list(counts)}; give two or more ascending numbers of samples."
        )
    return ns


def check_crop(crop: Any, size: tuple[int, int]) -> Window:
    """Return a crop within the grid, all of it by default."""
    if crop is None:
        return 0, 0, *size
    x0, y0, width, height = _integers("crop", crop, ("x0", "y0", "width", "height"), (0, 0, 1, 1))
    if x0 + width > size[0] or y0 + height > size[1]:
        raise ParameterError(
            f"crop is {[x0, y0, width, height]}, which leaves the grid of {size[0]} × {size[1]} "
            "pixels; give x0, y0, width and height within it."
        )
    return x0, y0, width, height


def check_size(size: Any) -> tuple[int, int]:
    """Return width and height of a grid."""
    width, height = _integers("size", size, ("width", "height"), (1, 1))
    return width, height


def check_memory(window: Window, strategies: int, counts: int) -> None:
    """Raise if the result would not fit."""
    numbers = 3 * window[2] * window[3] * strategies * counts
    if numbers > _MOST_NUMBERS:
        raise ParameterError(
            f"A map of {window[2]} × {window[3]} pixels, {strategies} strategies and {counts} "
            f"counts has {numbers:.3g} numbers, more than {_MOST_NUMBERS:.3g}; give a crop or a "
            "smaller size."
        )


def check_smoothing(smoothing: Any) -> int:
    """Return the side of a window that has a centre."""
    window = as_integer("smoothing", smoothing, least=1, most=_MOST_SMOOTHING)
    if window % 2 == 0:
        raise ParameterError(f"smoothing is {window}; give an odd number of pixels.")
    return window


def check_strategies(strategies: Any) -> tuple[str, ...]:
    """Return strategies in their usual order, with the shares of MIS where that is one of them."""
    given = (strategies,) if isinstance(strategies, str) else strategies
    if not isinstance(given, Sequence | set | frozenset) or not given:
        raise ParameterError(
            f"strategies is {strategies!r}; give some of {', '.join(MAP_STRATEGIES)}."
        )
    chosen = {as_choice("a strategy", s, MAP_STRATEGIES) for s in given}
    if "mis" in chosen:
        chosen |= {"mis-light", "mis-bsdf"}
    return tuple(s for s in MAP_STRATEGIES if s in chosen)


def _integers(
    name: str, values: Any, parts: tuple[str, ...], least: tuple[int, ...]
) -> tuple[int, ...]:
    listed = isinstance(values, Sequence | np.ndarray) and not isinstance(values, str | bytes)
    if not listed or len(values) != len(parts):
        raise ParameterError(f"{name} is {values!r}; give {', '.join(parts)}.")
    rows = zip(parts, values, least, strict=True)
    return tuple(as_integer(f"{name} {p}", v, least=k, most=_LONGEST_SIDE) for p, v, k in rows)
