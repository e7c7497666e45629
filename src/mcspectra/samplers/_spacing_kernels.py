"""Numba kernels of samplers that keep points apart; arguments are not checked.

There are three groups of kernels.
Dart throwing uses a grid whose cells contain at most one point; see `samplers.poisson`.
Buckets are cells over the first axes of the domain, each with a chain of its points.
Buckets help to find the distance from any place in the domain to the nearest point.
Darts, best candidates and largest empty disks are all found by distances to the nearest point.

Notation: R realizations, n points, d dims; ``out`` float64 (R, n, d), ``keys`` uint64 (R, 2).
The argument ``at`` is the index of the next random number of a realization.
If wrap is true, distances are on the torus.
Buckets are a tuple (side, axes, head, chain).
Here side is the number of cells along an axis, and axes the number of axes that are divided.
The array head (cells,) holds the last point put into each cell.
The array chain (n,) holds the point put in before each point, or −1 at the end.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform

__all__ = [
    "add_to_buckets",
    "empty_buckets",
    "fill_holes",
    "pick_candidates",
    "throw_darts",
    "throw_set",
]

_FINEST = 2**40
_NOWHERE = 9.0  # coordinate that marks an empty cell, farther away than any radius
_AXES = 3  # largest number of axes of buckets and grids; with more, cells are mostly empty
# Each cell has an upper bound of the distance from its places to the nearest point.
# A new point lowers the bounds of the cells up to 7 steps away, and of no others.
# The side of a cell is a quarter of the spacing of the points.
# Therefore the point nearest to a place is usually less than 7 cells away.
_REACH = 7
_ROUNDING = 1e-9  # fraction of a cell's side by which bounds are increased
_FAR = 16.0  # larger than any squared distance in the domain, in up to 4 dims
_SHARP = 1e-10  # tolerance of the center of a hole, relative to the hole's radius


@kernel
def empty_buckets(n: int, dims: int, side: int) -> Any:
    """Return empty buckets for up to n points, with `side` cells per axis."""
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
def _shell_cell(x: Array, code: int, ring: int, buckets: Any, wrap: bool) -> int:
    # The cells up to `ring` steps from the cell of x form a cube. Return cell number `code` of it.
    # Return −1 if the cell is outside the domain, or less than `ring` steps from the cell of x.
    # Cells less than `ring` steps away belong to smaller rings, which were visited before.
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
def _clearance(
    x: Array, points: Array, buckets: Any, wrap: bool, stop: float, most: float
) -> float:
    # Return the squared distance from x to the nearest point, or `most` if that is smaller.
    # The search ends as soon as a point is nearer than `stop` (squared), and returns its distance.
    side, axes, head, chain = buckets

    # Distance from x to the nearest wall of its cell, in units of cells
    edge = 0.5
    for j in range(axes):
        inside = x[j] * side - min(int(x[j] * side), side - 1)
        edge = min(edge, inside, 1.0 - inside)
    edge = max(edge, 0.0)

    # Visit the cells around x, shell by shell
    least = most
    for ring in range(side if not wrap else side // 2 + 1):
        if ring and (ring - 1.0 + edge) ** 2 >= least * side * side:
            break
        for code in range((2 * ring + 1) ** axes):
            cell = _shell_cell(x, code, ring, buckets, wrap)
            i = head[cell] if cell >= 0 else -1
            while i >= 0:
                square = 0.0
                for j in range(x.size):
                    gap = abs(x[j] - points[i, j])
                    if wrap and gap > 0.5:
                        gap = 1.0 - gap
                    square += gap * gap
                least = min(least, square)
                if least < stop:
                    return least
                i = chain[i]
    return least


@kernel
def _home(x: Array, side: int, reach: int) -> int:
    # Return the index of the cell of x in the padded grid.
    index = 0
    for j in range(x.size):
        index = index * (side + 2 * reach) + min(int(x[j] * side), side - 1) + reach
    return index


@kernel
def _is_covered(x: Array, half: float, home: int, radius: float, near: Array, grid: Array) -> bool:
    # Return whether the open disk around one of the points contains the whole box x ± half.
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
    # Put x and its periodic images within reach of the domain into the padded grid.
    dims = x.size
    turns = 1 + (reach - 1) // side if wrap else 0
    for image in range((2 * turns + 1) ** dims):
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
def throw_set(disks: Any, k0: Any, k1: Any, at: int, points: Array) -> tuple[int, int]:
    """Throw darts until `points` (n, d) are placed, or no further point fits.

    Return the number of points and the index of the next random number.
    See `poisson.Disks` for the data of the disks.
    """
    radius, side, reach, near, wrap, throws = disks
    n, dims = points.shape
    grid = np.full(((side + 2 * reach) ** dims, dims), _NOWHERE)
    scale, placed, x = side, 0, np.empty(dims)

    # All cells are candidates at first: their integer coordinates (side^d, d)
    active = np.empty((side**dims, dims), np.int64)
    for i in range(active.shape[0]):
        rest = i
        for j in range(dims):
            active[i, dims - 1 - j] = rest % side
            rest //= side

    while active.shape[0] > 0 and scale < _FINEST:
        # Throw darts into random cells; remove a cell from the list when it has its point
        m = active.shape[0]
        for _ in range(throws * m):
            pick = int(mix_uniform(k0, k1, at) * m)
            for j in range(dims):
                x[j] = min((active[pick, j] + mix_uniform(k0, k1, at + 1 + j)) / scale, BELOW_ONE)
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
            m -= 1
            for j in range(dims):
                active[pick, j] = active[m, j]
            if m == 0:
                break

        # Halve the remaining cells along every axis, and drop the new cells that a disk covers
        children = np.empty((m << dims, dims), np.int64)
        kept = 0
        for i in range(m):
            for corner in range(1 << dims):
                for j in range(dims):
                    children[kept, j] = 2 * active[i, j] + ((corner >> j) & 1)
                    x[j] = (children[kept, j] + 0.5) / (2 * scale)
                home = _home(x, side, reach)
                if not _is_covered(x, 0.25 / scale, home, radius, near, grid):
                    kept += 1
        active = children[:kept]
        scale *= 2
    return placed, at


@kernel
def throw_darts(
    limit: float, side: int, trials: int, k0: Any, k1: Any, at: int, points: Array
) -> tuple[int, int]:
    """Throw darts until n are accepted or `trials` darts in a row are rejected.

    Accepted darts have squared distances ≥ `limit`, and are written to points (n, d).
    Return the number of points and the index of the next random number.
    """
    n, dims = points.shape
    buckets = empty_buckets(n, dims, side)
    placed, missed = 0, 0
    while placed < n and missed < trials:
        x = points[placed]
        for j in range(dims):
            x[j] = mix_uniform(k0, k1, at + j)
        at += dims
        missed += 1
        if _clearance(x, points, buckets, True, limit, limit) >= limit:
            add_to_buckets(placed, x, buckets)
            placed += 1
            missed = 0
    return placed, at


@kernel
def _lower_ceilings(x: Array, side: int, ceilings: Array) -> None:
    # Update the cells around a new point at x.
    # The bound limits the squared distance from any place in the cell to the nearest point.
    # Every place in a cell is at most half a diagonal farther from x than the cell's center is.
    # Cells more than `reach` cells away from x keep their bounds.
    dims = x.size
    half = 0.5 * np.sqrt(dims) + _ROUNDING
    reach = min(_REACH, side // 2)
    for code in range((2 * reach + 1) ** dims if dims <= _AXES else 0):
        rest, cell, square = code, 0, 0.0
        for j in range(dims):
            c = int(x[j] * side) + rest % (2 * reach + 1) - reach
            square += (c + 0.5 - x[j] * side) ** 2
            cell = cell * side + c % side
            rest //= 2 * reach + 1
        ceilings[cell] = min(ceilings[cell], ((np.sqrt(square) + half) / side) ** 2)


@kernel
def _grids(points: Array, placed: int, room: int) -> Any:
    # Make buckets for about one point each, and add the points that are already placed.
    # Also make ceilings: upper bounds of the squared distance to the nearest point, in small cells.
    # In more than three dims, a single bound covers the domain and excludes no candidate.
    dims = points.shape[1]
    buckets = empty_buckets(room, dims, max(1, int(room ** (1.0 / min(dims, _AXES)))))
    side = 4 * buckets[0] if dims <= _AXES else 1
    ceilings = np.full(side ** min(dims, _AXES), 1.0 * dims)
    for i in range(placed):
        add_to_buckets(i, points[i], buckets)
        _lower_ceilings(points[i], side, ceilings)
    return buckets, side, ceilings


@kernel
def pick_candidates(keys: Array, candidates: int, out: Array) -> None:
    """Fill out (R, n, d) with points that are each the best of random candidates, on the torus.

    Point i is the one of candidates·i random points that is farthest from all earlier points.
    """
    count, n, dims = out.shape
    x = np.empty(dims)
    for r in range(count):
        points, at, room = out[r], 0, 1
        buckets, side, ceilings = _grids(points, 0, room)
        for i in range(n):
            if i == room:  # rebuild the buckets with smaller cells
                room *= 2
                buckets, side, ceilings = _grids(points, i, room)
            best = -1.0
            for _ in range(max(1, candidates * i)):
                for j in range(dims):
                    x[j] = mix_uniform(keys[r, 0], keys[r, 1], at + j)
                at += dims

                # Skip candidates in cells whose bound is below the best distance
                cell = 0
                for j in range(dims if side > 1 else 0):
                    cell = cell * side + min(int(x[j] * side), side - 1)
                if ceilings[cell] <= best:
                    continue
                near = _clearance(x, points, buckets, True, best, 1.0 * dims)
                if near > best:
                    best = near
                    points[i] = x
            add_to_buckets(i, points[i], buckets)
            _lower_ceilings(points[i], side, ceilings)


@kernel
def _push(heap: Array, size: int, row: Array) -> None:
    # Insert a row into the heap of `size` rows; the top row has the largest first column.
    i = size
    while i > 0 and heap[(i - 1) // 2, 0] < row[0]:
        heap[i] = heap[(i - 1) // 2]
        i = (i - 1) // 2
    heap[i] = row


@kernel
def _pop(heap: Array, size: int, row: Array) -> None:
    # Remove the top row of the heap, and copy it to `row`.
    row[:] = heap[0]
    last = heap[size - 1]
    i, child = 0, 1
    while child < size - 1:
        if child + 1 < size - 1 and heap[child + 1, 0] > heap[child, 0]:
            child += 1
        if last[0] >= heap[child, 0]:
            break
        heap[i] = heap[child]
        i, child = child, 2 * child + 1
    heap[i] = last


@kernel
def _set_bound(box: Array, points: Array, buckets: Any, wrap: bool) -> None:
    # A box is an array (d + 2,): bound, half the side length, center.
    near = _clearance(box[2:], points, buckets, wrap, -1.0, _FAR)
    box[0] = np.sqrt(near) + box[1] * np.sqrt(box.size - 2)


@kernel
def fill_holes(points: Array, placed: int, wrap: bool) -> None:
    """Place all points (n, d) but the first `placed`, each as far as possible from all others.

    The method is branch and bound, on the torus or in the cube.
    Every place in a box is at most half a diagonal farther from all points than the box's center.
    Boxes wait in a heap, with the largest bound on top.
    New points can only lower bounds, so outdated bounds are updated when their box is taken.
    """
    n, dims = points.shape
    buckets = empty_buckets(n, dims, max(1, int(n ** (1.0 / dims))))
    for i in range(placed):
        add_to_buckets(i, points[i], buckets)

    # Start with boxes of half the size of a bucket
    side, box, part = 2 * buckets[0], np.empty(dims + 2), np.empty(dims + 2)
    heap, size = np.empty((2 * side**dims + 1024, dims + 2)), side**dims
    for i in range(size):
        rest = i
        for j in range(dims):
            box[2 + j] = (rest % side + 0.5) / side
            rest //= side
        box[1] = 0.5 / side
        _set_bound(box, points, buckets, wrap)
        _push(heap, i, box)

    while placed < n:
        _pop(heap, size, box)
        size -= 1
        _set_bound(box, points, buckets, wrap)
        # If the updated bound is no longer the largest, put the box back into the heap
        if size > 0 and box[0] < heap[0, 0]:
            _push(heap, size, box)
            size += 1
        elif box[1] > _SHARP * box[0]:
            # Split the box into its 2^d parts
            if size + (1 << dims) > heap.shape[0]:
                larger = np.empty((2 * heap.shape[0], dims + 2))
                larger[:size] = heap[:size]
                heap = larger
            for corner in range(1 << dims):
                part[1] = 0.5 * box[1]
                for j in range(dims):
                    part[2 + j] = box[2 + j] + (2 * ((corner >> j) & 1) - 1) * part[1]
                _set_bound(part, points, buckets, wrap)
                _push(heap, size, part)
                size += 1
        else:
            points[placed] = np.minimum(box[2:], BELOW_ONE)
            add_to_buckets(placed, points[placed], buckets)
            placed += 1
            _push(heap, size, box)
            size += 1
