"""Numba kernels that look for the largest empty disk among points: arrays only, nothing checked.

`fill_holes` works in any dims, on the torus or in the cube, by branch and bound: in a box of centre c
no place is farther from all points than c is, plus half the diagonal. Boxes wait in a heap, that of
the largest bound on top; new points only lower bounds, so that stale ones are mended when they come up.

Legend: n points, d dims; buckets as in `_spacing_kernels`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.samplers._spacing_kernels import add_to_buckets, clearance, empty_buckets

__all__ = ["fill_holes"]

_BELOW_ONE = 1.0 - 2.0**-53
_FAR = 16.0  # squared distance beyond any in the domain, in up to 4 dims
_SHARP = 1e-10  # of the distance: how exactly the centre of a hole is found


@kernel
def _push(heap: Array, size: int, row: Array) -> None:
    # Put a row into the heap of `size` rows, the largest first column on top.
    i = size
    while i > 0 and heap[(i - 1) // 2, 0] < row[0]:
        heap[i] = heap[(i - 1) // 2]
        i = (i - 1) // 2
    heap[i] = row


@kernel
def _pop(heap: Array, size: int, row: Array) -> None:
    # Take the top of the heap of `size` rows into `row`.
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
    # box (d + 2,): bound, half the side, centre.
    center = box[2:]
    near = clearance(center, points, buckets, wrap, -1.0, _FAR)
    box[0] = np.sqrt(near) + box[1] * np.sqrt(center.size)


@kernel
def _first_boxes(side: int, points: Array, buckets: Any, wrap: bool) -> Array:
    # A heap of boxes, `side` an axis, with as much room again.
    dims = points.shape[1]
    heap = np.empty((2 * side**dims + 1024, dims + 2))
    box = np.empty(dims + 2)
    for i in range(side**dims):
        rest = i
        for j in range(dims):
            box[2 + j] = (rest % side + 0.5) / side
            rest //= side
        box[1] = 0.5 / side
        _set_bound(box, points, buckets, wrap)
        _push(heap, i, box)
    return heap


@kernel
def _split(
    heap: Array, size: int, box: Array, points: Array, buckets: Any, wrap: bool
) -> tuple[Array, int]:
    # Push the 2^d parts of a box; return the heap, a larger one if need be, and its size.
    dims = points.shape[1]
    if size + (1 << dims) > heap.shape[0]:
        larger = np.empty((2 * heap.shape[0], dims + 2))
        larger[:size] = heap[:size]
        heap = larger
    part = np.empty(dims + 2)
    for corner in range(1 << dims):
        part[1] = 0.5 * box[1]
        for j in range(dims):
            part[2 + j] = box[2 + j] + (2 * ((corner >> j) & 1) - 1) * part[1]
        _set_bound(part, points, buckets, wrap)
        _push(heap, size, part)
        size += 1
    return heap, size


@kernel
def fill_holes(points: Array, placed: int, wrap: bool) -> None:
    """Place the rest of points (n, d), the first `placed` given, each as far from all as can be."""
    n, dims = points.shape
    buckets = empty_buckets(n, dims, max(1, int(n ** (1.0 / dims))))
    for i in range(placed):
        add_to_buckets(i, points[i], buckets)
    side = 2 * buckets[0]
    heap, size = _first_boxes(side, points, buckets, wrap), side**dims
    box = np.empty(dims + 2)
    while placed < n:
        _pop(heap, size, box)
        size -= 1
        _set_bound(box, points, buckets, wrap)
        if size > 0 and box[0] < heap[0, 0]:  # the bound was stale: back into the heap
            _push(heap, size, box)
            size += 1
        elif box[1] > _SHARP * box[0]:
            heap, size = _split(heap, size, box, points, buckets, wrap)
        else:
            points[placed] = np.minimum(box[2:], _BELOW_ONE)
            add_to_buckets(placed, points[placed], buckets)
            placed += 1
            _push(heap, size, box)
            size += 1
