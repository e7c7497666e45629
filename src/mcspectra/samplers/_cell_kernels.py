"""Numba kernels that move points by their Voronoi cells or neighbors; arguments are not checked.

Farthest points: the center of a largest empty disk is a corner of a Voronoi cell.
Each cell starts as the square bounded by the bisectors between a point and its own images.
The bisectors with nearby points then cut the cell.
Removing or inserting a point changes only the adjacent cells.

Notation for farthest points: n points in 2 dims. Buckets are described in `_spacing_kernels`.
Voronoi cells are stored like the cells of power diagrams (below).
Each row of the array holes (n, 4) belongs to one point and its Voronoi cell.
Numbers 1 and 2 of each row are the coordinates of the cell's corner farthest from the point.
Number 3 of each row is the squared distance between the point and the farthest corner of its cell.
Number 4 of each row is the squared distance between the point and its nearest neighbor.

Power diagrams: the cell of site i contains all x that satisfy the inequality
|x − x_i|² − w_i ≤ |x − x_j|² − w_j for all sites j and their images.
Nearby sites, taken ring by ring from a grid, cut the cell.
No more sites are taken when the remaining sites are too far away to cut the cell.

Notation for power diagrams: n sites in 2 dims; points (n, 2) in [0,1), weights w (n,).
The array sites (n, 3) holds points and weights in the order of the grid.
A cell (K, 4) is a counterclockwise polygon relative to its site.
Each row of a cell has four numbers about one corner, and the edge from there to the next corner.
The first two numbers of each row of a cell are the coordinates x and y of the corner.
The third number of each row of a cell is the distance from its site to the site across the edge.
The fourth number of each row of a cell is the index of the site across the edge.
The index is −1 if the site across the edge is an image of the cell's own site.
While a cell is cut, the array `spare` (K, 4) holds a copy of its corners.

Gaussian blue noise: the energy of all pairs of points, and the gradient of the energy.
Notation: n points, d dims; `points` float64 in [0,1); `force` gets the gradient.
"""

from __future__ import annotations

from math import cos, exp, pi, sin
from typing import Any, NamedTuple

import numpy as np

from mcspectra.core.checks import BELOW_ONE, Array
from mcspectra.core.jit import kernel
from mcspectra.samplers._spacing_kernels import add_to_buckets, empty_buckets

__all__ = [
    "Diagram",
    "balance",
    "measure_all",
    "move_points",
    "near_energy",
    "power_diagram",
    "series_energy",
]

_CORNERS = 64  # largest number of corners of a Voronoi cell; six on average
_LOAD = 2.0  # number of sites per cell of the grid; 1 to 3 take the same time
_SOLVED = 1e-3  # relative residual of the linear equations; enough for Newton steps
# A Newton step is at most this factor longer than the step before it.
# A long trial step after a short step is usually rejected, because short steps follow one another.
_LONGER = 4.0
_HALVINGS = 40
_UNLIMITED = 2**62
_PRODUCTS = 4  # work per entry of a matrix-vector product; work per corner of a cell is 1


@kernel
def _sort_into_cells(cell: Array, cells: int) -> tuple[Array, Array]:
    # Counting sort: the points of cell c are order[start[c]:start[c + 1]].
    start, order = np.zeros(cells + 2, np.int64), np.empty(cell.size, np.int64)
    for i in range(cell.size):
        start[cell[i] + 2] += 1
    for c in range(2, cells + 2):
        start[c] += start[c - 1]
    for i in range(cell.size):
        order[start[cell[i] + 1]] = i
        start[cell[i] + 1] += 1
    return start[: cells + 1], order


@kernel
def _bucket(x: float, side: int) -> int:
    return min(int(x * side), side - 1)


@kernel
def _cut(
    dx: float, dy: float, level: float, label: int, cell: Array, size: int, spare: Array
) -> int:
    # Keep the part of the cell with x·d ≤ level; return the number of its corners.
    for k in range(size):
        for c in range(4):
            spare[k, c] = cell[k, c]
    count, v = 0, spare[0, 0] * dx + spare[0, 1] * dy - level
    for k in range(size):
        after = 0 if k + 1 == size else k + 1
        u, v = v, spare[after, 0] * dx + spare[after, 1] * dy - level
        if u <= 0.0:
            for c in range(4):
                cell[count, c] = spare[k, c]
            count += 1
        if (u <= 0.0) != (v <= 0.0):
            # Between corner k and the next corner, the cell's border crosses the line x·d = level.
            # The new edge of the cell starts where the border leaves the half-plane x·d ≤ level.
            # The new edge ends where the border enters the half-plane again
            t = u / (u - v)
            cell[count, 0] = spare[k, 0] + t * (spare[after, 0] - spare[k, 0])
            cell[count, 1] = spare[k, 1] + t * (spare[after, 1] - spare[k, 1])
            cell[count, 2] = np.sqrt(dx * dx + dy * dy) if u <= 0.0 else spare[k, 2]
            cell[count, 3] = label if u <= 0.0 else spare[k, 3]
            count += 1
    return count


@kernel
def _farthest_corner(cell: Array, size: int) -> tuple[int, float]:
    best, square = 0, -1.0
    for k in range(size):
        here = cell[k, 0] ** 2 + cell[k, 1] ** 2
        if here > square:
            best, square = k, here
    return best, square


@kernel
def _measure(i: int, points: Array, buckets: Any, cell: Array, spare: Array, holes: Array) -> int:
    # Compute Voronoi cell i and its row of `holes`; return the number of corners of the cell.
    side, _, head, chain = buckets
    size, near = 4, 1.0
    for k in range(4):
        cell[k, 0] = 0.5 if k in (0, 3) else -0.5
        cell[k, 1] = 0.5 if k < 2 else -0.5
        cell[k, 3] = -1.0

    # Cut the cell by the points (or their periodic images) in rings of buckets
    ring, far = 0, 0.5
    while ring == 0 or (ring - 1.0) ** 2 < 4.0 * far * side * side:
        for a in range(-ring, ring + 1):
            for b in range(-ring, ring + 1, 1 if abs(a) == ring else max(1, 2 * ring)):
                c0, c1 = _bucket(points[i, 0], side) + a, _bucket(points[i, 1], side) + b
                p = head[(c0 % side) * side + c1 % side]
                while p >= 0:
                    if p != i:
                        dx = points[p, 0] - points[i, 0] + c0 // side
                        dy = points[p, 1] - points[i, 1] + c1 // side
                        d2 = dx * dx + dy * dy
                        near = min(near, d2)
                        if d2 < 4.0 * _farthest_corner(cell, size)[1]:
                            size = _cut(dx, dy, 0.5 * d2, p, cell, size, spare)
                    p = chain[p]
        far = _farthest_corner(cell, size)[1]
        ring += 1
    best, far = _farthest_corner(cell, size)
    holes[i, 0], holes[i, 1] = points[i, 0] + cell[best, 0], points[i, 1] + cell[best, 1]
    holes[i, 2], holes[i, 3] = far, near
    return size


@kernel
def measure_all(points: Array) -> Any:
    """Return filled buckets, and an array (n, 4) with the farthest corner of every Voronoi cell."""
    n = points.shape[0]
    buckets, holes = empty_buckets(n, 2, max(1, int(np.sqrt(n)))), np.empty((n, 4))
    cell, spare = np.empty((_CORNERS, 4)), np.empty((_CORNERS, 4))
    for i in range(n):
        add_to_buckets(i, points[i], buckets)
    for i in range(n):
        _measure(i, points, buckets, cell, spare, holes)
    return buckets, holes


@kernel
def _measure_around(size: int, cell: Array, points: Array, buckets: Any, holes: Array) -> None:
    # Compute the cells of all neighbors of a cell again, and their farthest corners
    other, spare = np.empty((_CORNERS, 4)), np.empty((_CORNERS, 4))
    for k in range(size):
        if cell[k, 3] >= 0:
            _measure(int(cell[k, 3]), points, buckets, other, spare, holes)


@kernel
def move_points(start: int, stop: int, points: Array, buckets: Any, holes: Array) -> None:
    """Move points start … stop − 1, one by one, to the center of the largest empty disk."""
    side, _, head, chain = buckets
    cell, spare = np.empty((_CORNERS, 4)), np.empty((_CORNERS, 4))
    for i in range(start, stop):
        size = _measure(i, points, buckets, cell, spare, holes)

        # Remove the point from its bucket
        x, y = points[i]
        bucket = _bucket(x, side) * side + _bucket(y, side)
        if head[bucket] == i:
            head[bucket] = chain[i]
        else:
            before = head[bucket]
            while chain[before] != i:
                before = chain[before]
            chain[before] = chain[i]
        _measure_around(size, cell, points, buckets, holes)

        # Insert the point at the largest hole
        holes[i, 2] = -1.0
        best = np.argmax(holes[:, 2])
        for j in range(2):
            points[i, j] = min(holes[best, j] - np.floor(holes[best, j]), BELOW_ONE)
        add_to_buckets(i, points[i], buckets)
        size = _measure(i, points, buckets, cell, spare, holes)
        _measure_around(size, cell, points, buckets, holes)


class Diagram(NamedTuple):
    """Cells of a power diagram, and the faces between cells as rows of a sparse matrix.

    Attributes
    ----------
    areas, moments
        Integrals of 1 and of |x − x_i|² over each cell, (n,).
    offsets
        Offsets of the centroids from the sites, (n, 2).
    rows, neighbors, couplings
        The faces of cell i have the indices rows[i, 0] … rows[i, 1] − 1.
        The neighbor of a face is the site on the other side.
        The coupling of a face is its length, divided by twice the distance of the two sites.
        If the weight of the neighbor grows by ε, the area of cell i shrinks by ε · coupling.
    work
        Amount of work to compute all cells. Each visit to a square of the search grid adds 1.
        Each comparison of a cell with another site adds the cell's current number of corners.
    """

    areas: Array
    moments: Array
    offsets: Array
    rows: Array
    neighbors: Array
    couplings: Array
    work: int


@kernel
def _cut_by_bucket(
    s: int,
    sites: Array,
    bucket: Any,
    place: Any,
    radius2: float,
    size: int,
    cell: Array,
    spare: Array,
) -> Any:
    # Cut the cell of site s by the sites in a bucket that are near enough to reach the cell.
    # `place` is the position of site s relative to the bucket.
    # Return the squared distance of the farthest corner, and the number of corners.
    for t in range(bucket[0], bucket[1]):
        dx, dy = sites[t, 0] - place[0], sites[t, 1] - place[1]
        d2 = dx * dx + dy * dy
        level = 0.5 * (d2 + sites[s, 2] - sites[t, 2])
        if t == s or (level > 0.0 and level * level >= radius2 * d2):
            continue
        extent = -np.inf
        for k in range(size):
            extent = max(extent, cell[k, 0] * dx + cell[k, 1] * dy)
        if extent > level:
            size = _cut(dx, dy, level, t, cell, size, spare)
            radius2 = max(0.0, _farthest_corner(cell, size)[1])
    return radius2, size


@kernel
def _cut_cell(
    s: int, sites: Array, buckets: Any, heaviest: float, cell: Array, spare: Array
) -> tuple[int, int]:
    # Compute the cell of site s (in bucket order); return the number of its corners and the work.
    side, starts = buckets
    x, y, excess, width = sites[s, 0], sites[s, 1], heaviest - sites[s, 2], 1.0 / side
    row, column = _bucket(x, side), _bucket(y, side)
    margin = min(x - row * width, (row + 1) * width - x)
    margin = min(margin, y - column * width, (column + 1) * width - y)
    for k in range(4):
        cell[k, 0] = 0.5 if k in (1, 2) else -0.5
        cell[k, 1] = 0.5 if k >= 2 else -0.5
        cell[k, 2], cell[k, 3] = 1.0, -1.0
    size, radius2, ring, work = 4, 0.5, 0, 0
    while (ring - 1) * width + margin <= np.sqrt(radius2) + np.sqrt(max(0.0, radius2 + excess)):
        for a in range(row - ring, row + ring + 1):
            i, turns = a % side, float(a // side)
            step = 1 if abs(a - row) == ring else 2 * ring
            for b in range(column - ring, column + ring + 1, step):
                k = i * side + b % side
                bucket, place = (starts[k], starts[k + 1]), (x - turns, y - b // side)
                work += 1 + (bucket[1] - bucket[0]) * size
                radius2, size = _cut_by_bucket(s, sites, bucket, place, radius2, size, cell, spare)
        if size == 0:
            break
        ring += 1
    return size, work


@kernel
def power_diagram(points: Array, weights: Array) -> Diagram:
    """Return the power diagram of the sites; the Voronoi diagram if all weights are 0."""
    n = points.shape[0]
    side = max(1, int(np.sqrt(n / _LOAD)))
    bucket = np.empty(n, np.int64)
    for i in range(n):
        bucket[i] = _bucket(points[i, 0], side) * side + _bucket(points[i, 1], side)
    starts, order = _sort_into_cells(bucket, side * side)
    sites = np.empty((n, 3))
    for s in range(n):
        i = order[s]
        sites[s, 0], sites[s, 1], sites[s, 2] = points[i, 0], points[i, 1], weights[i]

    heaviest = weights.max()
    areas, moments, offsets = np.empty(n), np.empty(n), np.empty((n, 2))
    rows, used, work = np.zeros((n, 2), np.int64), 0, 0
    neighbors, couplings = np.empty(8 * n + 8, np.int64), np.empty(8 * n + 8)
    # A cell fits into a unit square, so at most 9 periodic images of another site are neighbors
    cell, spare = np.empty((10 * n + 10, 4)), np.empty((10 * n + 10, 4))
    for s in range(n):
        i = order[s]
        size, visits = _cut_cell(s, sites, (side, starts), heaviest, cell, spare)
        work += visits
        if used + size > len(neighbors):  # 6 n faces suffice for points in general position
            neighbors = np.append(neighbors, np.empty(used + size, np.int64))
            couplings = np.append(couplings, np.empty(used + size))

        # Compute area, centroid, second moment about the site, and faces with other sites
        area, x, y, moment = 0.0, 0.0, 0.0, 0.0
        rows[i, 0] = used
        for k in range(size):
            after = 0 if k + 1 == size else k + 1
            px, py, qx, qy = cell[k, 0], cell[k, 1], cell[after, 0], cell[after, 1]
            cross = px * qy - py * qx
            area += cross / 2
            x += cross * (px + qx) / 6
            y += cross * (py + qy) / 6
            moment += cross * (px * (px + qx) + qx * qx + py * (py + qy) + qy * qy) / 12
            length = np.hypot(qx - px, qy - py)
            if cell[k, 3] >= 0 and length > 0.0:
                neighbors[used] = order[int(cell[k, 3])]
                couplings[used] = length / (2 * cell[k, 2])
                used += 1
        rows[i, 1] = used
        scale = 1.0 / area if area > 0.0 else 0.0
        areas[i], offsets[i, 0], offsets[i, 1], moments[i] = area, x * scale, y * scale, moment
    return Diagram(areas, moments, offsets, rows, neighbors[:used], couplings[:used], work)


@kernel
def _divide(x: Array, diagonal: Array, out: Array) -> float:
    # Write x / diagonal to out; return x · out.
    product = 0.0
    for i in range(x.size):
        out[i] = x[i] / diagonal[i]
        product += x[i] * out[i]
    return product


@kernel
def _solve(diagram: Diagram, rest: Array) -> tuple[Array, int]:
    # Return the change of weights that changes the areas by `rest`, and the work done.
    # `rest` is overwritten.
    # The method is conjugate gradients for the Laplacian L of the neighbor graph with couplings.
    n = rest.size
    change, direction, image, diagonal = np.zeros(n), np.empty(n), np.empty(n), np.zeros(n)
    for i in range(n):
        for k in range(diagram.rows[i, 0], diagram.rows[i, 1]):
            diagonal[i] += diagram.couplings[k]
    rho = _divide(rest, diagonal, direction)
    goal, work = _SOLVED**2 * rho, 0
    for _ in range(4 * n):
        if rho <= goal:
            break
        work += _PRODUCTS * (n + diagram.couplings.size)

        # Multiply the search direction by the Laplacian L, and compute direction · L direction
        product = 0.0
        for i in range(n):
            total = 0.0
            for k in range(diagram.rows[i, 0], diagram.rows[i, 1]):
                total += diagram.couplings[k] * (direction[i] - direction[diagram.neighbors[k]])
            image[i] = total
            product += direction[i] * total
        length = rho / product
        for i in range(n):
            change[i] += length * direction[i]
            rest[i] -= length * image[i]
        before, rho = rho, _divide(rest, diagonal, image)
        for i in range(n):
            direction[i] = image[i] + rho / before * direction[i]
    return change, work


@kernel
def _compare(areas: Array, masses: Array, rest: Array) -> Any:
    # Write rest = masses − areas. Return the largest |rest| relative to a mass, and |rest|².
    worst, square = 0.0, 0.0
    for i in range(areas.size):
        rest[i] = masses[i] - areas[i]
        worst = max(worst, abs(rest[i]) / masses[i])
        square += rest[i] ** 2
    return worst, square


@kernel
def balance(
    points: Array,
    weights: Array,
    masses: Array,
    tolerance: float,
    steps: int,
    most_work: int = _UNLIMITED,
) -> Any:
    """Return weights for which the cells have areas `masses`, and the power diagram.

    Newton's method starts at `weights`, or at weights of 0 if `weights` leave a cell empty.
    The steps end after a given number, or when all areas are right within the tolerance.
    Newton's method also ends if the areas no longer improve, or the work exceeds `most_work`.
    The computations of the linear solver count as work; `Diagram` defines the unit of work.
    No step is taken if some sites are so close that a cell is empty with equal weights.

    The weights maximize a concave function, the dual of a transport cost (see `transport_cost`).
    Damped Newton steps find the maximum from any weights that leave no cell empty [Kitagawa2019]_.
    """
    weights, diagram = weights.copy(), power_diagram(points, weights)
    if diagram.areas.min() <= 0.0:
        weights[:] = 0.0
        diagram = power_diagram(points, weights)
    if diagram.areas.min() <= 0.0:
        return weights, diagram
    least = 0.5 * min(diagram.areas.min(), masses.min())
    rest, length = np.empty(weights.size), 1.0
    worst, square = _compare(diagram.areas, masses, rest)
    work = diagram.work
    for _ in range(steps):
        if worst <= tolerance or work > most_work:
            break
        (change, solving), length = _solve(diagram, rest), min(1.0, _LONGER * length)
        work += solving
        for _ in range(_HALVINGS):
            if work > most_work:
                return weights, diagram
            trial = power_diagram(points, weights + length * change)
            work += trial.work
            trial_worst, trial_square = _compare(trial.areas, masses, rest)
            if trial.areas.min() > least and trial_square <= (1.0 - length / 2) ** 2 * square:
                break
            length /= 2
        else:
            break  # because of rounding errors, a step of any length does not improve the areas
        weights += length * change
        diagram, worst, square = trial, trial_worst, trial_square
    return weights, diagram


@kernel
def _add_cell_pair(
    points: Array, a: Array, b: Array, image: Array, sigma: float, force: Array
) -> float:
    # Energy of points a with points b translated by `image`; if a is b, each pair counts once.
    factor, far = -0.5 / sigma**2, 72.0 * sigma**2 / 2.0
    same = image[0] == 0.0 and image[1] == 0.0 and image[2] == 0.0
    energy = 0.0
    for s in range(a.size):
        i = a[s]
        for t in range(b.size):
            k = b[t]
            if same and a[0] == b[0] and t <= s:
                continue
            x = points[i, 0] - points[k, 0] - image[0]
            y = points[i, 1] - points[k, 1] - image[1]
            z = points[i, 2] - points[k, 2] - image[2]
            square = x * x + y * y + z * z
            if square < far:
                e = exp(factor * square)
                energy += e
                pull = 2.0 * factor * e
                force[i, 0] += pull * x
                force[i, 1] += pull * y
                force[i, 2] += pull * z
                force[k, 0] -= pull * x
                force[k, 1] -= pull * y
                force[k, 2] -= pull * z
    return energy


@kernel
def near_energy(points: Array, cells: Array, offsets: Array, sigma: float, force: Array) -> float:
    """Return the energy of pairs of points (n, 3) up to 6 σ apart; unused dims are zeros.

    `offsets` (K, 3) are the steps from a cell to its neighbor cells. The first step is zero.
    Of two opposite steps, only one is listed, so each pair of cells is visited once.
    Steps may go around the torus several times, so that all periodic images of a point count.
    """
    n = points.shape[0]
    cell = np.empty(n, np.int64)
    for i in range(n):
        c = 0
        for j in range(3):
            c = c * cells[j] + min(int(points[i, j] * cells[j]), cells[j] - 1)
        cell[i] = c
    start, order = _sort_into_cells(cell, cells[0] * cells[1] * cells[2])

    force[:] = 0.0
    energy, image = 0.0, np.zeros(3)
    for c0 in range(cells[0]):
        for c1 in range(cells[1]):
            for c2 in range(cells[2]):
                a = (c0 * cells[1] + c1) * cells[2] + c2
                mine = order[start[a] : start[a + 1]]
                if mine.size == 0:
                    continue
                for o in range(offsets.shape[0]):
                    b0, b1, b2 = c0 + offsets[o, 0], c1 + offsets[o, 1], c2 + offsets[o, 2]
                    image[0], image[1] = b0 // cells[0], b1 // cells[1]
                    image[2] = b2 // cells[2]
                    b = ((b0 % cells[0]) * cells[1] + b1 % cells[1]) * cells[2] + b2 % cells[2]
                    others = order[start[b] : start[b + 1]]
                    energy += _add_cell_pair(points, mine, others, image, sigma, force)
    return energy


@kernel
def series_energy(points: Array, weights: Array, force: Array) -> float:
    """Return the energy Σ over pairs of Π_j (1 + Σ_m weights[m−1] cos 2πm(x_j − y_j)), any dims."""
    n, dims = points.shape

    # Tabulate cos and sin of 2π m x for m = 1, 2, …: (n, d, orders)
    shape = (n, dims, weights.size)
    c, s = np.empty(shape), np.empty(shape)
    for i in range(n):
        for j in range(dims):
            for m in range(weights.size):
                c[i, j, m] = cos(2.0 * pi * (m + 1) * points[i, j])
                s[i, j, m] = sin(2.0 * pi * (m + 1) * points[i, j])

    value, slope, after = np.empty(dims), np.empty(dims), np.empty(dims + 1)
    force[:] = 0.0
    energy = 0.0
    for i in range(n):
        for k in range(i):
            # Compute the factor 1 + Σ_m weights[m−1] cos 2πm(x_j − y_j) and its derivative
            for j in range(dims):
                value[j], slope[j] = 1.0, 0.0
                for m in range(weights.size):
                    w = weights[m]
                    value[j] += w * (c[i, j, m] * c[k, j, m] + s[i, j, m] * s[k, j, m])
                    turn = s[i, j, m] * c[k, j, m] - c[i, j, m] * s[k, j, m]
                    slope[j] -= 2.0 * pi * (m + 1) * w * turn

            # Compute the derivatives of the product over all axes j
            after[dims] = 1.0
            for j in range(dims - 1, -1, -1):
                after[j] = after[j + 1] * value[j]
            energy += after[0]
            before = 1.0
            for j in range(dims):
                pull = before * slope[j] * after[j + 1]
                before *= value[j]
                force[i, j] += pull
                force[k, j] -= pull
    return energy
