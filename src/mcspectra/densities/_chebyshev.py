"""Functions on cells of an axis by Chebyshev interpolation: their integrals and the inverses of these.

Each cell holds values at 12 Chebyshev nodes. Matrices take them to the coefficients of the
interpolant, to those of its integral from the left end, and to the interpolant at the nodes of both
halves and at the ends, which tells whether the cell is resolved (Trefethen 2013, "Approximation Theory and
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
_LAST = float(np.nextafter(1.0, 0.0))
_PLACE = 0.381966011250105  # of a probe in its interval: on no dyadic border
_PROBED = 2**14  # probes a block
_OFF = 1e-7
_JUMP = 2.0**-24  # cells narrower than this close in a jump or a pole
_ADVICE = "give sample=, or move a pole to 0, where floats are dense"
_LEAST = 1e-290  # nearer to 0 an unbounded pdf may overflow

_NODES = -np.cos(np.pi * (np.arange(_ORDER) + 0.5) / _ORDER)
_TO_SERIES = np.linalg.inv(chebyshev.chebvander(_NODES, _ORDER - 1))
_TO_INTEGRAL = np.stack([chebyshev.chebint(c, lbnd=-1) for c in _TO_SERIES.T], axis=1)
_TO_HALVES = (
    chebyshev.chebvander(
        np.concatenate([0.5 * (_NODES - 1), 0.5 * (_NODES + 1), [-1.0, 1.0]]), _ORDER - 1
    )
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
    """Nodes (..., 12), below 1, of cells with left ends `low` (...) and `width` (...)."""
    nodes = low[..., None] + (0.5 * width)[..., None] * (_NODES + 1.0)
    return np.asarray(np.minimum(nodes, _LAST))


def refine(
    function: Callable[[Array], Array], *, start: int, most: int, subject: str, probes: int = 0
) -> Cells:
    """Split cells until the interpolants resolve a non-negative function.

    What lies between the nodes of all cells is not seen. Probes look there: where the interpolant
    misses the function at one of them, the cells that hold it are split until they are as narrow as
    the distance of the probes, and on from there.

    Parameters
    ----------
    function
        Nodes (C, 12) to values (C, 12, rows): functions that share the cells.
    start, most
        Number of cells to begin and to end with.
    subject
        Name of the function in messages.
    probes
        Number of further points, equally spaced, at which to compare function and interpolant.

    Raises
    ------
    DensityError
        A value is negative or not finite, or the function cannot be resolved by that many cells.
    """
    cells = _split(function, start, most, subject, np.empty(0), 1.0)
    if not probes:
        return cells
    points = (np.arange(probes) + _PLACE) / probes
    missed = _missed(function, cells, points, subject)
    if not missed.size:
        return cells
    cells = _split(function, start, most, subject, missed, 1.0 / probes)
    if _missed(function, cells, (points + 0.5 / probes) % 1.0, subject).size:
        raise DensityError(
            f"{subject} has details narrower than {1.0 / probes:.2g}, which a numerical inverse "
            "does not resolve; give sample=."
        )
    return cells


def _missed(function: Callable[[Array], Array], cells: Cells, points: Array, subject: str) -> Array:
    """Points at which the interpolants of any row are off; within jumps nothing is compared."""
    at_nodes = function(cells.nodes)
    total = _size(at_nodes, cells.width)
    off = np.zeros(points.size, bool)
    for start in range(0, points.size, _PROBED):
        part = slice(start, start + _PROBED)
        x = points[part]
        cell = cells.find(x)
        basis = chebyshev.chebvander(cells.local(cell, x), _ORDER - 1) @ _TO_SERIES
        fitted = np.einsum("pn,pnr->pr", basis, at_nodes[cell])
        gap = np.abs(fitted - _checked(function(x[:, None]), subject)[:, 0]).max(axis=1)
        allowed = _OFF * (total + np.abs(at_nodes[cell]).max(axis=(1, 2)))
        off[part] = (gap > allowed) & (cells.width[cell] > _JUMP)
    return points[off]


def _split(
    function: Callable[[Array], Array],
    start: int,
    most: int,
    subject: str,
    points: Array,
    narrow_enough: float,
) -> Cells:
    """Cells that resolve the function at the nodes, at most `narrow_enough` wide around points."""
    low, width = Cells.even(start).low, Cells.even(start).width
    values = _checked(function(spread(low, width)), subject)
    total = _size(values, width)
    kept: list[tuple[Array, Array]] = []
    unresolved = 0.0
    while low.size:
        found = _checked(function(_tested(low, width)), subject)
        off = np.abs(np.einsum("hn,cnr->chr", _TO_HALVES, values) - found)
        off[low == 0, -2] = 0.0  # not at the left end
        gap = off.max(axis=(1, 2)) * width
        narrow = width <= np.maximum(_NARROWEST * np.spacing(low + width), _LEAST)
        seen = np.searchsorted(points, low + width) == np.searchsorted(points, low)
        done = ((gap <= _TOLERANCE * total) & (seen | (width <= narrow_enough))) | narrow
        unresolved += float(gap[narrow].sum())
        kept.append((low[done], width[done]))
        low, width = _halved(low[~done], width[~done])
        values = found[~done, : 2 * _ORDER].reshape(low.size, _ORDER, values.shape[-1])
        if low.size + sum(len(part) for part, _ in kept) > most:
            raise DensityError(f"{subject} is too rough for a numerical inverse; {_ADVICE}.")
    if unresolved > _MOST_UNRESOLVED * total:
        raise DensityError(
            f"{subject} is too steep for a numerical inverse: {unresolved / total:.2g} of its "
            f"integral is not resolved; {_ADVICE}."
        )
    return _sorted(kept)


def _tested(low: Array, width: Array) -> Array:
    """Nodes of both halves, left end and right end of cells: (C, 26).

    What an end sees is a jump between it and the next node. 0 may be a pole: the next node instead.
    """
    nodes = spread(*_halved(low, width)).reshape(low.size, 2 * _ORDER)
    first = np.where(low > 0, low, nodes[:, 0])
    return np.concatenate(
        [nodes, np.stack([first, np.nextafter(low + width, 0.0)], axis=1)], axis=1
    )


def _halved(low: Array, width: Array) -> tuple[Array, Array]:
    """Left ends and widths (2C,) of the halves of cells."""
    half = 0.5 * width
    return np.stack([low, low + half], axis=1).ravel(), np.repeat(half, 2)


def _sorted(parts: list[tuple[Array, Array]]) -> Cells:
    low, width = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(low)
    return Cells(low[order], width[order])


def _size(values: Array, width: Array) -> float:
    """Largest integral among the rows; 1 where all vanish, so that zeros count as resolved."""
    total = float((values.mean(axis=1) * width[:, None]).sum(axis=0).max())
    return total or 1.0


def _checked(values: Array, subject: str) -> Array:
    if not np.isfinite(values).all():
        bad = values[~np.isfinite(values)][0]
        raise DensityError(
            f"{subject} is not finite ({bad:.6g}) within (0,1): a numerical inverse allows a pole "
            "at 0 only; give sample=."
        )
    if (values < 0).any():
        raise DensityError(
            f"{subject} is negative ({values[values < 0][0]:.6g}) within (0,1); a density is at "
            "least 0 everywhere."
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
