"""Numba kernels of pair correlations; arguments are not checked.

Notation: d axes; n points; N ≥ n points including periodic copies; bins of width 1/`per_unit`.
The number of bins is `most`, which is also the index of the bin for larger distances.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

Work = tuple[Array, Array]
"""Scratch space for one chunk of neighbors: squared distances (float64) and bins (int64)."""

__all__ = ["count_distances", "count_ordered_pairs"]

_CHUNK = 512  # number of neighbors per chunk: 8 KiB of scratch space fit into the first-level cache


@kernel
def _scratch() -> Work:
    return np.empty(_CHUNK), np.empty(_CHUNK, np.int64)


@kernel
def _squared_step(delta: float, wrap: bool) -> float:
    delta = abs(delta)
    if wrap:
        delta = min(delta, 1.0 - delta)
    return delta * delta


@kernel
def _fill_bins(
    coordinates: Array, a: int, start: int, stop: int, wrap: bool, per_unit: float, most: int,
    work: Work,
) -> Array:  # fmt: skip
    """Return the bins of the distances from point a to points start … stop − 1.

    Distances beyond the last bin get the number `most`.
    Bins are unsigned, because numba tests every signed index for a negative value.
    """
    squares, bins = work[0][: stop - start], work[1][: stop - start]
    last = coordinates.shape[0] - 1
    # Loop over one axis at a time, so that compilers vectorize the loops over neighbors in memory
    squares[:] = 0.0
    for axis in range(last):
        x, others = coordinates[axis, a], coordinates[axis, start:stop]
        for k in range(squares.size):
            squares[k] += _squared_step(others[k] - x, wrap)
    x, others = coordinates[last, a], coordinates[last, start:stop]
    for k in range(squares.size):
        square = squares[k] + _squared_step(others[k] - x, wrap)
        bins[k] = np.int64(min(np.sqrt(square) * per_unit, float(most)))
    return bins.view(np.uint64)


@kernel
def _add_bins(bins: Array, counts: Array) -> None:
    """Count the bins with four counters (4, …), because neighbors often fall into the same bin."""
    size = bins.size
    first, second, third, fourth = counts[0], counts[1], counts[2], counts[3]
    for k in range(0, size - 3, 4):
        first[bins[k]] += 1
        second[bins[k + 1]] += 1
        third[bins[k + 2]] += 1
        fourth[bins[k + 3]] += 1
    for k in range(size - size % 4, size):
        first[bins[k]] += 1


@kernel
def count_distances(
    coordinates: Array, n: int, per_unit: float, limit: float, counts: Array
) -> None:
    """Count the toroidal distances of all pairs of points.

    coordinates (d, N) holds the n points, in ascending order of the first coordinate.
    Copies of the first points follow, moved by one along the first axis.
    `limit` is the largest difference of two points along the first axis.
    The array counts (4, bins + 1) holds four partial histograms; their sum is the full histogram.
    The last bin of a histogram counts all distances that are larger than those of other bins.
    """
    total = coordinates.shape[1]
    work = _scratch()
    most = counts.shape[1] - 1
    end = 0
    for a in range(n):
        x = coordinates[0, a]
        while end < total and coordinates[0, end] - x <= limit:
            if end >= n and coordinates[0, end] - x == limit:
                # On the torus, two points at exactly this distance meet twice; count them once
                break
            end += 1
        for start in range(a + 1, end, _CHUNK):
            stop = min(start + _CHUNK, end)
            _add_bins(_fill_bins(coordinates, a, start, stop, True, per_unit, most, work), counts)


@kernel
def count_ordered_pairs(
    coordinates: Array, per_unit: float, limit: float, last: Array, counts: Array
) -> None:
    """Count non-toroidal distances of ordered pairs. Point a adds only to bins up to last[a].

    The n points, coordinates (d, n), ascend along the first axis. The result counts is (bins,).
    """
    n = coordinates.shape[1]
    work = _scratch()
    end = 0
    for a in range(n):
        while end < n and coordinates[0, end] - coordinates[0, a] <= limit:
            end += 1
        for start in range(a + 1, end, _CHUNK):
            stop = min(start + _CHUNK, end)
            _fill_bins(coordinates, a, start, stop, False, per_unit, counts.size, work)
            for k in range(stop - start):
                b = work[1][k]
                if b < counts.size:
                    counts[b] += (b < last[a]) + (b < last[start + k])
