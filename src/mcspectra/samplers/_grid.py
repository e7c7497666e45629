"""Grids of cells: how many a side for n points, which n there are, where the cells begin."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.samplers.base import MAX_COUNT

__all__ = ["cell_side", "check_sides", "corners", "grid_counts_near", "grid_sides", "root"]

_SLACK = 2.0**-52


def check_sides(sampler: Any) -> None:
    """Make a sampler's `sides_` None or a tuple of `dims` whole numbers; for `__post_init__`."""
    given = sampler.sides_
    if given is None:
        return
    if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray):
        raise ParameterError(
            f"{sampler.name}: sides is {given!r}; give a list of {sampler.dims} whole numbers."
        )
    sides = tuple(as_integer(f"sides[{i}]", s, least=1) for i, s in enumerate(given))
    if len(sides) != sampler.dims:
        raise ParameterError(
            f"{sampler.name}: sides has {len(sides)} numbers; give one for each of the "
            f"{sampler.dims} dims."
        )
    if math.prod(sides) > MAX_COUNT:
        raise ParameterError(
            f"{sampler.name}: sides give {float(math.prod(sides)):.3g} cells; "
            f"at most {MAX_COUNT:.3g} are possible."
        )
    object.__setattr__(sampler, "sides_", sides)


def grid_sides(n: int, dims: int, sides: Sequence[int] | None) -> tuple[int, ...]:
    """Return the number of cells along each axis for `n` points: as given, else s for n = s^d."""
    return (root(n, dims),) * dims if sides is None else tuple(sides)


def grid_counts_near(
    n: int, dims: int, sides: Sequence[int] | None = None
) -> tuple[int | None, int]:
    """Return the possible counts next to `n`: s^d, or the only one that `sides` allow.

    Without a possible count above `n`, the second number is too large to be made.
    """
    if sides is not None:
        only = math.prod(sides)
        return (only if only <= n else None), (only if only >= n else MAX_COUNT + 1)
    s = root(n, dims)
    return s**dims, n if s**dims == n else (s + 1) ** dims


def root(n: int, dims: int) -> int:
    """Largest s with s^dims ≤ n, in exact integers (64 ** (1 / 3) is 3.9999…)."""
    s: int = round(n ** (1.0 / dims)) + 1
    while s**dims > n:
        s -= 1
    return s


@lru_cache(maxsize=2)  # analyses draw block after block of one n; no more memory than the points
def corners(sides: tuple[int, ...]) -> Array:
    """Lower corners of the cells in row-major order: float64 (cells, dims), read-only."""
    out = np.zeros((math.prod(sides), len(sides)))
    for j, s in enumerate(sides):
        steps = (np.arange(s) / s)[:, None]
        out[:, j].reshape(math.prod(sides[:j]), s, -1)[:] = steps
    out.setflags(write=False)
    return out


def cell_side(s: int) -> float:
    """Return 1/s, shorter by 2^-52: then k/s + side·u stays below (k + 1)/s for all u < 1.

    k/s, the product, the sum and (k + 1)/s are each rounded by at most 2^-54 below 1, and what is
    taken off is four times that.
    """
    return 1.0 / s - _SLACK
