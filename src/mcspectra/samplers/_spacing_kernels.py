"""Numba kernels of samplers that keep points apart: arrays only, nothing checked.

Dart throwing on a grid of cells that hold one point each (method: `samplers.poisson`), and buckets:
cells over the first axes of the domain, each with a chain of the points in it, for distances to
points that stand anywhere.

Legend: n points, d dims; ``out`` float64 (R, n, d), ``keys`` uint64 (R, 2); `at` numbers the random
numbers of a realisation; `wrap`: distances go round the edges. Buckets are a tuple (side, axes, head,
chain): `side` cells along each of the first `axes` axes, head (cells,) the last point put into each
cell, chain (n,) the one before it, −1 at the end.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform

__all__ = ["add_to_buckets", "clearance", "empty_buckets", "throw_set", "throw_sets"]

_BELOW_ONE = 1.0 - 2.0**-53
_FINEST = 2**40
_NOWHERE = 9.0  # coordinate of an empty cell, farther away than any radius
_AXES = 3  # of buckets: more would be visits to empty cells


@kernel
def empty_buckets(n: int, dims: int, side: int) -> Any:
    """Return buckets without points, `side` cells an axis, for up to n points."""
    axes = min(dims, _AXES)
    return side, axes, np.full(side**axes, -1), np.full(n, -1)


@kernel
def add_to_buckets(i: int, x: Array, buckets: Any) -> None:
    """Put point number i, at x (d,), into its bucket."""
    side, axes, head, chain = buckets
    cell = 0
    for j in range(axes):
        cell = cell * side + min(int(x[j] * side), side - 1)
    chain[i] = head[cell]
    head[cell] = i


@kernel
def _square(a: Array, b: Array, wrap: bool) -> float:
    # Squared distance of two points, the short way round if `wrap`.
    total = 0.0
    for j in range(a.size):
        gap = abs(a[j] - b[j])
        if wrap and gap > 0.5:
            gap = 1.0 - gap
        total += gap * gap
    return total


@kernel
def _shell_cell(x: Array, code: int, ring: int, buckets: Any, wrap: bool) -> int:
    # Cell number `code` of the cube of cells within `ring` of x; −1 for those inside the shell (they
    # have been visited) and outside the domain.
    side, axes = buckets[0], buckets[1]
    cell, reach = 0, 0
    for j in range(axes):
        step = code % (2 * ring + 1) - ring
        code //= 2 * ring + 1
        reach = max(reach, abs(step))
        c = min(int(x[j] * side), side - 1) + step
        if c < 0 or c >= side:
            if not wrap:
                return -1
            c = c % side
        cell = cell * side + c
    return cell if reach == ring else -1


@kernel
def _edge(x: Array, buckets: Any) -> float:
    # Distance from x to the nearest wall of its cell, in cells.
    side, nearest = buckets[0], 0.5
    for j in range(buckets[1]):
        inside = x[j] * side - min(int(x[j] * side), side - 1)
        nearest = min(nearest, inside, 1.0 - inside)
    return max(nearest, 0.0)


@kernel
def clearance(x: Array, points: Array, buckets: Any, wrap: bool, stop: float, most: float) -> float:
    """Return the squared distance from x to the nearest point, `most` if that is smaller.

    As soon as a point is nearer than `stop` (squared), the search ends with its distance.
    """
    side, axes, head, chain = buckets
    least, edge = most, _edge(x, buckets)
    for ring in range(side if not wrap else side // 2 + 1):
        if ring and (ring - 1.0 + edge) ** 2 >= least * side * side:
            break
        for code in range((2 * ring + 1) ** axes):
            cell = _shell_cell(x, code, ring, buckets, wrap)
            i = head[cell] if cell >= 0 else -1
            while i >= 0:
                least = min(least, _square(x, points[i], wrap))
                if least < stop:
                    return least
                i = chain[i]
    return least


@kernel
def _home(x: Array, side: int, reach: int) -> int:
    # Index of the cell of x in the padded grid.
    index = 0
    for j in range(x.size):
        index = index * (side + 2 * reach) + min(int(x[j] * side), side - 1) + reach
    return index


@kernel
def _is_covered(x: Array, half: float, home: int, radius: float, near: Array, grid: Array) -> bool:
    # Whether the open disk around one of the points holds the whole box x ± half.
    limit = radius * radius
    for k in range(near.size):
        point = grid[home + near[k]]
        square = 0.0
        for j in range(x.size):
            square += (abs(x[j] - point[j]) + half) ** 2
        if square < limit:
            return True
    return False


@kernel
def _place(x: Array, side: int, reach: int, wrap: bool, grid: Array) -> None:
    # Put x, and its periodic images within reach of the domain, into the padded grid.
    dims = x.size
    turns = 1 + (reach - 1) // side if wrap else 0
    images = (2 * turns + 1) ** dims
    for image in range(images):
        rest, index, inside = image, 0, True
        for j in range(dims):
            c = min(int(x[j] * side), side - 1) + reach + (rest % (2 * turns + 1) - turns) * side
            inside = inside and 0 <= c < side + 2 * reach
            index = index * (side + 2 * reach) + c
            rest //= 2 * turns + 1
        if inside:
            rest = image
            for j in range(dims):
                grid[index, j] = x[j] + rest % (2 * turns + 1) - turns
                rest //= 2 * turns + 1


@kernel
def _halved(
    active: Array, scale: int, side: int, reach: int, radius: float, near: Array, grid: Array
) -> Array:
    # Children, at twice the scale, of the active cells, but those that a disk covers.
    m, dims = active.shape
    children = np.empty((m << dims, dims), np.int64)
    center = np.empty(dims)
    kept = 0
    for i in range(m):
        for corner in range(1 << dims):
            for j in range(dims):
                children[kept, j] = 2 * active[i, j] + ((corner >> j) & 1)
                center[j] = (children[kept, j] + 0.5) / (2 * scale)
            home = _home(center, side, reach)
            if not _is_covered(center, 0.25 / scale, home, radius, near, grid):
                kept += 1
    return children[:kept]


@kernel
def _all_cells(side: int, dims: int) -> Array:
    # Integer coordinates (side^d, d) of the grid.
    active = np.empty((side**dims, dims), np.int64)
    for i in range(active.shape[0]):
        rest = i
        for j in range(dims):
            active[i, dims - 1 - j] = rest % side
            rest //= side
    return active


@kernel
def throw_set(k0: Any, k1: Any, at: int, disks: Any, points: Array) -> tuple[int, int]:
    """Throw until `points` (n, d) are placed or none fits any more.

    Returns their number, and where the random numbers go on. `disks`: see `poisson`.
    """
    radius, side, reach, near, wrap, throws = disks
    n, dims = points.shape
    grid = np.full(((side + 2 * reach) ** dims, dims), _NOWHERE)
    active = _all_cells(side, dims)
    scale, placed = side, 0
    x = np.empty(dims)
    while active.shape[0] > 0 and scale < _FINEST:
        m = active.shape[0]
        for _ in range(throws * m):
            pick = int(mix_uniform(k0, k1, at) * m)
            for j in range(dims):
                x[j] = min((active[pick, j] + mix_uniform(k0, k1, at + 1 + j)) / scale, _BELOW_ONE)
            at += dims + 1
            home = _home(x, side, reach)
            if grid[home, 0] == _NOWHERE:
                if _is_covered(x, 0.0, home, radius, near, grid):
                    continue
                for j in range(dims):
                    points[placed, j] = x[j]
                _place(x, side, reach, wrap, grid)
                placed += 1
                if placed == n:
                    return placed, at
            # The cell has its point: take it off the list.
            m -= 1
            for j in range(dims):
                active[pick, j] = active[m, j]
            if m == 0:
                break
        active = _halved(active[:m], scale, side, reach, radius, near, grid)
        scale *= 2
    return placed, at


@kernel
def throw_sets(keys: Array, disks: Any, attempts: int, out: Array) -> bool:
    """Fill out (R, n, d); False if a realisation jams in every attempt."""
    n = out.shape[1]
    for r in range(out.shape[0]):
        at: Any = np.int64(0)  # a literal 0 would compile throw_set twice
        placed, attempt = 0, 0
        while placed < n:
            if attempt == attempts:
                return False
            placed, at = throw_set(keys[r, 0], keys[r, 1], at, disks, out[r])
            attempt += 1
    return True
