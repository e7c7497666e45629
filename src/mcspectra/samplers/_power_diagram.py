"""Numba kernels of power diagrams on the 2-D torus: arrays only, nothing checked.

The cell of site i holds the x with |x − x_i|² − w_i ≤ |x − x_j|² − w_j for all sites j and their
images. It is cut from the square around the site (the bisectors with the site's own images) by the
sites in a grid of buckets, ring by ring, until those left are too far away to reach it.

Legend: n sites, 2 dims; points (n, 2) in [0,1), weights w (n,); sites (n, 3): both in the order of
the buckets; a cell (K, 4), counterclockwise and relative to its site: x and y of a corner, distance
of the site beyond the edge to the next corner, its number, −1 for an image of the site itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["Diagram", "power_diagram"]

_LOAD = 2.0  # sites in a bucket; 1 to 3 take the same time


class Diagram(NamedTuple):
    """Cells of a power diagram, and the faces between them as rows of a sparse matrix.

    Attributes
    ----------
    areas, moments
        ∫ 1 and ∫ |x − x_i|² over each cell, (n,).
    offsets
        Centroids minus sites, (n, 2).
    rows, neighbors, couplings
        Cell i has faces rows[i, 0] … rows[i, 1] − 1: the site beyond, and by how much the area of
        cell i falls with its weight, length / (2 distance).
    """

    areas: Array
    moments: Array
    offsets: Array
    rows: Array
    neighbors: Array
    couplings: Array


@kernel
def _bucket(x: float, side: int) -> int:
    return min(int(x * side), side - 1)


@kernel
def _sort_into_buckets(points: Array, weights: Array, side: int) -> Any:
    # Return the sites bucket by bucket, their numbers, and the first of each bucket and of the next.
    n = points.shape[0]
    starts, order = np.zeros(side * side + 2, np.int64), np.empty(n, np.int64)
    sites = np.empty((n, 3))
    for i in range(n):
        starts[_bucket(points[i, 0], side) * side + _bucket(points[i, 1], side) + 2] += 1
    for k in range(1, side * side + 2):
        starts[k] += starts[k - 1]
    for i in range(n):
        k = _bucket(points[i, 0], side) * side + _bucket(points[i, 1], side) + 1
        s = starts[k]
        order[s] = i
        sites[s, 0], sites[s, 1], sites[s, 2] = points[i, 0], points[i, 1], weights[i]
        starts[k] += 1
    return sites, order, starts


@kernel
def _set_square(corners: Array) -> None:
    for k in range(4):
        corners[k, 0] = 0.5 if k in (1, 2) else -0.5
        corners[k, 1] = 0.5 if k >= 2 else -0.5
        corners[k, 2], corners[k, 3] = 1.0, -1.0


@kernel
def _extent(dx: float, dy: float, cell: Array, size: int) -> float:
    # The largest x·d of all corners.
    most = -np.inf
    for k in range(size):
        most = max(most, cell[k, 0] * dx + cell[k, 1] * dy)
    return most


@kernel
def _cut(dx: float, dy: float, level: float, label: int, cell: Array, size: int, new: Array) -> int:
    # Keep in `new` the part of the cell with x·d ≤ level; return its number of corners.
    count, v = 0, cell[0, 0] * dx + cell[0, 1] * dy - level
    for k in range(size):
        after = 0 if k + 1 == size else k + 1
        u, v = v, cell[after, 0] * dx + cell[after, 1] * dy - level
        if u <= 0.0:
            for c in range(4):
                new[count, c] = cell[k, c]
            count += 1
        if (u <= 0.0) != (v <= 0.0):
            t = u / (u - v)
            new[count, 0] = cell[k, 0] + t * (cell[after, 0] - cell[k, 0])
            new[count, 1] = cell[k, 1] + t * (cell[after, 1] - cell[k, 1])
            new[count, 2] = np.sqrt(dx * dx + dy * dy) if u <= 0.0 else cell[k, 2]
            new[count, 3] = label if u <= 0.0 else cell[k, 3]
            count += 1
    return count


@kernel
def _copy_back(new: Array, size: int, cell: Array) -> float:
    # Return the square of the distance of the farthest corner.
    farthest = 0.0
    for k in range(size):
        for c in range(4):
            cell[k, c] = new[k, c]
        farthest = max(farthest, cell[k, 0] ** 2 + cell[k, 1] ** 2)
    return farthest


@kernel
def _cut_by_bucket(
    s: int,
    sites: Array,
    bucket: Any,
    place: Any,
    radius2: float,
    size: int,
    cell: Array,
    new: Array,
) -> Any:
    # Cut the cell of site s, which is at `place` as seen from the bucket, by the sites in there
    # near enough to reach it; return the new square of the farthest corner's distance, and size.
    for t in range(bucket[0], bucket[1]):
        dx, dy = sites[t, 0] - place[0], sites[t, 1] - place[1]
        d2 = dx * dx + dy * dy
        level = 0.5 * (d2 + sites[s, 2] - sites[t, 2])
        if t == s or (level > 0.0 and level * level >= radius2 * d2):
            continue
        if _extent(dx, dy, cell, size) > level:
            size = _cut(dx, dy, level, t, cell, size, new)
            radius2 = _copy_back(new, size, cell)
    return radius2, size


@kernel
def _cut_cell(s: int, sites: Array, buckets: Any, heaviest: float, cell: Array, new: Array) -> int:
    # Make the cell of site s (in the order of the buckets); return its number of corners.
    side, starts = buckets
    x, y, excess, width = sites[s, 0], sites[s, 1], heaviest - sites[s, 2], 1.0 / side
    row, column = _bucket(x, side), _bucket(y, side)
    margin = min(x - row * width, (row + 1) * width - x)
    margin = min(margin, y - column * width, (column + 1) * width - y)
    _set_square(cell)
    size, radius2, ring = 4, 0.5, 0
    while (ring - 1) * width + margin <= np.sqrt(radius2) + np.sqrt(max(0.0, radius2 + excess)):
        for a in range(row - ring, row + ring + 1):
            i, turns = a % side, float(a // side)
            step = 1 if abs(a - row) == ring else 2 * ring
            for b in range(column - ring, column + ring + 1, step):
                k = i * side + b % side
                bucket, place = (starts[k], starts[k + 1]), (x - turns, y - b // side)
                radius2, size = _cut_by_bucket(s, sites, bucket, place, radius2, size, cell, new)
        if size == 0:
            break
        ring += 1
    return size


@kernel
def _measure(cell: Array, size: int) -> Any:
    # Area, offset of the centroid and second moment about the site.
    area, x, y, moment = 0.0, 0.0, 0.0, 0.0
    for k in range(size):
        after = 0 if k + 1 == size else k + 1
        px, py, qx, qy = cell[k, 0], cell[k, 1], cell[after, 0], cell[after, 1]
        cross = px * qy - py * qx
        area += cross / 2
        x += cross * (px + qx) / 6
        y += cross * (py + qy) / 6
        moment += cross * (px * (px + qx) + qx * qx + py * (py + qy) + qy * qy) / 12
    scale = 1.0 / area if area > 0.0 else 0.0
    return area, x * scale, y * scale, moment


@kernel
def _add_faces(
    cell: Array, size: int, order: Array, used: int, neighbors: Array, couplings: Array
) -> int:
    for k in range(size):
        after = 0 if k + 1 == size else k + 1
        length = np.hypot(cell[after, 0] - cell[k, 0], cell[after, 1] - cell[k, 1])
        if cell[k, 3] >= 0 and length > 0.0:
            neighbors[used] = order[int(cell[k, 3])]
            couplings[used] = length / (2 * cell[k, 2])
            used += 1
    return used


@kernel
def power_diagram(points: Array, weights: Array) -> Diagram:
    """Return the power diagram of the sites; the Voronoi diagram if all weights are 0."""
    n = points.shape[0]
    side = max(1, int(np.sqrt(n / _LOAD)))
    sites, order, starts = _sort_into_buckets(points, weights, side)
    heaviest = weights.max()
    areas, moments, offsets = np.empty(n), np.empty(n), np.empty((n, 2))
    rows, used = np.zeros((n, 2), np.int64), 0
    neighbors, couplings = np.empty(8 * n + 8, np.int64), np.empty(8 * n + 8)
    # A cell lies within a unit square, where at most 9 images of a site can have a face with it
    cell, spare = np.empty((10 * n + 10, 4)), np.empty((10 * n + 10, 4))
    for s in range(n):
        i = order[s]
        size = _cut_cell(s, sites, (side, starts), heaviest, cell, spare)
        areas[i], offsets[i, 0], offsets[i, 1], moments[i] = _measure(cell, size)
        if used + size > len(neighbors):  # more faces than in general position: 6 n
            neighbors = np.append(neighbors, np.empty(used + size, np.int64))
            couplings = np.append(couplings, np.empty(used + size))
        rows[i, 0] = used
        used = _add_faces(cell, size, order, used, neighbors, couplings)
        rows[i, 1] = used
    return Diagram(areas, moments, offsets, rows, neighbors[:used], couplings[:used])
