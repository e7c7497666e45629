"""Functions on cells of an axis by Chebyshev interpolation: their integrals and the inverses of these.

Each cell holds values at 12 Chebyshev nodes. Matrices take them to the coefficients of the
interpolant, to those of its integral from the left end, and to the interpolant at the nodes of both
halves, which tells whether the cell is resolved (Trefethen 2013, "Approximation Theory and
Approximation Practice", ch. 3 and 19).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from mcspectra.core.checks import Array
from mcspectra.core.errors import DensityError
from mcspectra.core.jit import kernel

__all__ = ["Cells", "integral_at", "refine", "solve", "spread"]

_ORDER = 12
_TOLERANCE = 1e-14  # of the whole integral, a cell
_MOST_UNRESOLVED = 1e-10
_NARROWEST = 4.0  # floats a cell
_LEAST = 1e-290  # nearer to 0 an unbounded pdf may overflow

_NODES = -np.cos(np.pi * (np.arange(_ORDER) + 0.5) / _ORDER)
_TO_SERIES = np.linalg.inv(chebyshev.chebvander(_NODES, _ORDER - 1))
_TO_INTEGRAL = np.stack([chebyshev.chebint(c, lbnd=-1) for c in _TO_SERIES.T], axis=1)
_TO_HALVES = (
    chebyshev.chebvander(np.concatenate([0.5 * (_NODES - 1), 0.5 * (_NODES + 1)]), _ORDER - 1)
    @ _TO_SERIES
)


@dataclass(frozen=True)
class Cells:
    """Cells of [0,1], in order: left ends `low` and `width`, (K,)."""

    low: Array
    width: Array

    @staticmethod
    def even(count: int) -> Cells:
        """`count` cells of equal width."""
        return Cells(np.arange(count) / count, np.full(count, 1.0 / count))

    @cached_property
    def nodes(self) -> Array:
        """Nodes (K, 12)."""
        return spread(self.low, self.width)

    def find(self, x: Array) -> Array:
        """Index of the cell that holds x."""
        return np.maximum(np.searchsorted(self.low, x, side="right") - 1, 0)

    def local(self, cell: Array, x: Array) -> Array:
        """Position of x in its cell, from −1 to 1."""
        return np.clip(2.0 * (x - self.low[cell]) / self.width[cell] - 1.0, -1.0, 1.0)

    def series(self, values: Array, width: Array) -> tuple[Array, Array]:
        """Series of the function and of its integral over cells of `width`, from values (..., 12)."""
        scaled = values * (0.5 * width[..., None])
        return scaled @ _TO_SERIES.T, scaled @ _TO_INTEGRAL.T

    def masses(self, values: Array) -> Array:
        """Integrals over all cells, at least 0, of values (..., K, 12)."""
        weights = _TO_INTEGRAL.sum(axis=0)
        return np.asarray(np.maximum((values @ weights) * (0.5 * self.width), 0.0))


def spread(low: Array, width: Array) -> Array:
    """Nodes (..., 12) of cells with left ends `low` (...) and `width` (...)."""
    return np.asarray(low[..., None] + (0.5 * width)[..., None] * (_NODES + 1.0))


def refine(function: Callable[[Array], Array], *, start: int, most: int, subject: str) -> Cells:
    """Split cells until the interpolants resolve a non-negative function.

    Parameters
    ----------
    function
        Nodes (C, 12) to values (C, 12, rows): functions that share the cells.
    start, most
        Number of cells to begin and to end with.
    subject
        What messages call the function.

    Raises
    ------
    DensityError
        A value is negative or not finite, or the function cannot be resolved by that many cells.
    """
    low, width = Cells.even(start).low, Cells.even(start).width
    values = _checked(function(spread(low, width)), subject)
    total = _size(values, width)
    kept: list[tuple[Array, Array]] = []
    unresolved = 0.0
    while low.size:
        half = 0.5 * width
        lows = np.stack([low, low + half], axis=1)
        nodes = spread(lows, np.stack([half, half], axis=1)).reshape(len(low), -1)
        halves = _checked(function(nodes), subject)
        gap = np.abs(np.einsum("hn,cnr->chr", _TO_HALVES, values) - halves).max(axis=(1, 2)) * width
        narrow = width <= np.maximum(_NARROWEST * np.spacing(low + width), _LEAST)
        done = (gap <= _TOLERANCE * total) | narrow
        unresolved += float(gap[narrow].sum())
        kept.append((low[done], width[done]))
        low, width = lows[~done].ravel(), np.repeat(half[~done], 2)
        values = halves[~done].reshape(low.size, _ORDER, values.shape[-1])
        if low.size + sum(len(part) for part, _ in kept) > most:
            raise DensityError(f"{subject} is too rough for a numerical inverse; give sample=.")
    if unresolved > _MOST_UNRESOLVED * total:
        raise DensityError(
            f"{subject} is too steep for a numerical inverse: {unresolved:.2g} of its integral is "
            "not resolved; give sample=."
        )
    return _sorted(kept)


def _sorted(parts: list[tuple[Array, Array]]) -> Cells:
    low, width = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(low)
    return Cells(low[order], width[order])


def _size(values: Array, width: Array) -> float:
    """Largest integral among the rows; 1 where all vanish, so that zeros count as resolved."""
    total = float((values.mean(axis=1) * width[:, None]).sum(axis=0).max())
    return total or 1.0


def _checked(values: Array, subject: str) -> Array:
    for bad, what in ((~np.isfinite(values), "not finite"), (values < 0, "negative")):
        if bad.any():
            raise DensityError(
                f"{subject} is {what} ({values[bad][0]:.6g}) within (0,1); a density is finite and "
                "at least 0 there."
            )
    return values


@kernel
def integral_at(series: Array, t: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Values of series (N, k) at t (N,) in [−1, 1]."""
    for i in range(t.size):
        previous, current, total = 1.0, t[i], series[i, 0]
        for k in range(1, series.shape[1]):
            total += series[i, k] * current
            previous, current = current, 2.0 * t[i] * current - previous
        out[i] = total


@kernel
def solve(
    density: Array, integral: Array, mass: Array, out: Array
) -> None:  # pragma: no cover - compiled
    """Where the integral (N, 13) of the density (N, 12) reaches mass (N,): t in [−1, 1].

    Newton's method within a bracket that bisection shrinks where a step leaves it.
    """
    for i in range(mass.size):
        whole = 0.0
        for k in range(integral.shape[1]):
            whole += integral[i, k]
        low, high = -1.0, 1.0
        t = -1.0 + 2.0 * mass[i] / whole if whole > 0.0 else 0.0
        t = min(max(t, -1.0), 1.0)
        for _ in range(100):
            slope, excess = density[i, 0], integral[i, 0] - mass[i]
            previous, current = 1.0, t
            for k in range(1, integral.shape[1]):
                excess += integral[i, k] * current
                if k < density.shape[1]:
                    slope += density[i, k] * current
                previous, current = current, 2.0 * t * current - previous
            if excess > 0.0:
                high = t
            else:
                low = t
            step = t - excess / slope if slope > 0.0 else -2.0
            if not low <= step <= high:
                step = 0.5 * (low + high)
            if abs(step - t) <= 2e-16 or excess == 0.0:
                break
            t = step
        out[i] = t
