"""Numba kernels of farthest-point optimisation on the 2-D torus: arrays only, nothing checked.

A largest empty disk is centred on a corner of a Voronoi cell. Each cell is cut from the square around
its point (the bisectors with the point's own images) by the bisectors with the points nearby; taking a
point away, or putting one in, changes only the cells next to it.

Legend: n points, 2 dims; buckets as in `_spacing_kernels`; corners (K, 2) and neighbours (K,) of a
cell, counterclockwise, neighbour k beyond the edge from corner k to the next, −1 for an image of the
point itself; holes (n, 4): coordinates of the corner of each cell that is farthest from its point, its
squared distance, and the squared distance of the nearest neighbour.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.samplers._spacing_kernels import add_to_buckets, empty_buckets

__all__ = ["measure_all", "move_points", "point_buckets"]

_CORNERS = 64  # most corners of a cell; six on average
_BELOW_ONE = 1.0 - 2.0**-53


@kernel
def point_buckets(points: Array) -> Any:
    """Return buckets with all points, about one a cell."""
    n = points.shape[0]
    buckets = empty_buckets(n, 2, max(1, int(np.sqrt(n))))
    for i in range(n):
        add_to_buckets(i, points[i], buckets)
    return buckets


@kernel
def _take_from_buckets(i: int, x: Array, buckets: Any) -> None:
    side, _, head, chain = buckets
    cell = min(int(x[0] * side), side - 1) * side + min(int(x[1] * side), side - 1)
    if head[cell] == i:
        head[cell] = chain[i]
        return
    before = head[cell]
    while chain[before] != i:
        before = chain[before]
    chain[before] = chain[i]


@kernel
def _cut(dx: float, dy: float, label: int, corners: Array, neighbors: Array, size: int) -> int:
    # Cut a convex polygon by the bisector of the origin and (dx, dy); return its new size.
    half = 0.5 * (dx * dx + dy * dy)
    old, labels = corners[:size].copy(), neighbors[:size].copy()
    count, outside = 0, 0
    for k in range(size):
        x, y = old[k]
        u, v = old[(k + 1) % size]
        here, there = x * dx + y * dy - half, u * dx + v * dy - half
        if here <= 0.0:
            corners[count, 0], corners[count, 1], neighbors[count] = x, y, labels[k]
            count += 1
        else:
            outside += 1
        if (here <= 0.0) != (there <= 0.0):
            t = here / (here - there)
            corners[count, 0], corners[count, 1] = x + t * (u - x), y + t * (v - y)
            # Leaving the polygon the new edge begins, entering it an old one goes on
            neighbors[count] = label if here <= 0.0 else labels[k]
            count += 1
    if outside == 0:
        corners[:size], neighbors[:size] = old, labels
        return size
    return count


@kernel
def _farthest_corner(corners: Array, size: int) -> tuple[int, float]:
    best, square = 0, -1.0
    for k in range(size):
        here = corners[k, 0] ** 2 + corners[k, 1] ** 2
        if here > square:
            best, square = k, here
    return best, square


@kernel
def _cut_by_cell(
    i: int, points: Array, buckets: Any, step: Any, corners: Array, neighbors: Array, size: int
) -> tuple[int, float]:
    # Cut cell i by the points of the bucket `step` away, or their images; return its size, and the
    # squared distance of the nearest of them.
    side, _, head, chain = buckets
    c0 = min(int(points[i, 0] * side), side - 1) + step[0]
    c1 = min(int(points[i, 1] * side), side - 1) + step[1]
    near = 2.0
    p = head[(c0 % side) * side + c1 % side]
    while p >= 0:
        if p != i:
            dx = points[p, 0] - points[i, 0] + c0 // side
            dy = points[p, 1] - points[i, 1] + c1 // side
            near = min(near, dx * dx + dy * dy)
            if dx * dx + dy * dy < 4.0 * _farthest_corner(corners, size)[1]:
                size = _cut(dx, dy, p, corners, neighbors, size)
        p = chain[p]
    return size, near


@kernel
def _measure(
    i: int, points: Array, buckets: Any, corners: Array, neighbors: Array, holes: Array
) -> int:
    # Make cell i and its row of `holes`; return its number of corners.
    side, size, near = buckets[0], 4, 1.0
    for k in range(4):
        corners[k, 0] = 0.5 if k in (0, 3) else -0.5
        corners[k, 1] = 0.5 if k < 2 else -0.5
        neighbors[k] = -1
    ring, far = 0, 0.5
    while ring == 0 or (ring - 1.0) ** 2 < 4.0 * far * side * side:
        for a in range(-ring, ring + 1):
            for b in range(-ring, ring + 1, 1 if abs(a) == ring else max(1, 2 * ring)):
                size, least = _cut_by_cell(i, points, buckets, (a, b), corners, neighbors, size)
                near = min(near, least)
        far = _farthest_corner(corners, size)[1]
        ring += 1
    best, far = _farthest_corner(corners, size)
    holes[i, 0], holes[i, 1] = points[i, 0] + corners[best, 0], points[i, 1] + corners[best, 1]
    holes[i, 2], holes[i, 3] = far, near
    return size


@kernel
def measure_all(points: Array, buckets: Any, holes: Array) -> None:
    """Fill `holes` (n, 4) for all cells."""
    corners, neighbors = np.empty((_CORNERS, 2)), np.empty(_CORNERS, np.int64)
    for i in range(points.shape[0]):
        _measure(i, points, buckets, corners, neighbors, holes)


@kernel
def _measure_around(size: int, neighbors: Array, points: Array, buckets: Any, holes: Array) -> None:
    # Measure the neighbours of a cell.
    corners, others = np.empty((_CORNERS, 2)), np.empty(_CORNERS, np.int64)
    for k in range(size):
        if neighbors[k] >= 0:
            _measure(neighbors[k], points, buckets, corners, others, holes)


@kernel
def move_points(start: int, stop: int, points: Array, buckets: Any, holes: Array) -> None:
    """Move each of the points start … stop−1 to the centre of the largest empty disk without it."""
    corners, neighbors = np.empty((_CORNERS, 2)), np.empty(_CORNERS, np.int64)
    for i in range(start, stop):
        size = _measure(i, points, buckets, corners, neighbors, holes)
        _take_from_buckets(i, points[i], buckets)
        _measure_around(size, neighbors, points, buckets, holes)
        holes[i, 2] = -1.0
        best = np.argmax(holes[:, 2])
        for j in range(2):
            points[i, j] = min(holes[best, j] - np.floor(holes[best, j]), _BELOW_ONE)
        add_to_buckets(i, points[i], buckets)
        size = _measure(i, points, buckets, corners, neighbors, holes)
        _measure_around(size, neighbors, points, buckets, holes)
