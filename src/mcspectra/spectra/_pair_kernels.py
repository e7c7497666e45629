"""Numba kernels of pair correlations: arrays only, no checks.

Legend: d axes, n points, N ≥ n points with copies; bins of width 1/`per_unit`;
`most` is the number of bins, and the bin of what is further.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

Work = tuple[Array, Array]
"""Scratch space for squared distances, float64 (N,), and bins, int32 (N,)."""

__all__ = ["count_distances", "count_ordered_pairs"]


@kernel
def _fill_bins(
    coordinates: Array, a: int, end: int, wrap: bool, per_unit: float, most: int, work: Work
) -> None:
    """Bins, `most` beyond the last, of the distances of point a to points a + 1 … end − 1."""
    # Several loops over neighbours in memory instead of one: compilers vectorise these.
    size = end - a - 1
    squares, bins = work
    squares[:size] = 0.0
    for axis in range(coordinates.shape[0]):
        x = coordinates[axis, a]
        others = coordinates[axis, a + 1 : end]
        for k in range(size):
            delta = abs(others[k] - x)
            if wrap:
                delta = min(delta, 1.0 - delta)
            squares[k] += delta * delta
    for k in range(size):
        bins[k] = np.int32(min(np.sqrt(squares[k]) * per_unit, float(most)))


@kernel
def _add_bins(bins: Array, size: int, counts: Array) -> None:
    """Count the first `size` bins; neighbours often meet in one, hence four counters (4, …)."""
    for k in range(0, size - 3, 4):
        counts[0, bins[k]] += 1
        counts[1, bins[k + 1]] += 1
        counts[2, bins[k + 2]] += 1
        counts[3, bins[k + 3]] += 1
    for k in range(size - size % 4, size):
        counts[0, bins[k]] += 1


@kernel
def count_distances(
    coordinates: Array, n: int, per_unit: float, limit: float, counts: Array
) -> None:
    """Count the toroidal distances of all pairs of points.

    coordinates (d, N), the first axis ascending: n points, and behind them copies of those at its
    start, one further; `limit` is the largest difference along the first axis. counts (4, bins + 1):
    to be added up; the last bin takes what is further.
    """
    total = coordinates.shape[1]
    work = np.empty(total), np.empty(total, np.int32)
    most = counts.shape[1] - 1
    end = 0
    for a in range(n):
        x = coordinates[0, a]
        while end < total and coordinates[0, end] - x <= limit:
            if end >= n and coordinates[0, end] - x == limit:
                break  # half way around: the same pair is met from the other side
            end += 1
        _fill_bins(coordinates, a, end, True, per_unit, most, work)
        _add_bins(work[1], end - a - 1, counts)


@kernel
def count_ordered_pairs(
    coordinates: Array, per_unit: float, limit: float, last: Array, counts: Array
) -> None:
    """Count the distances, not around the torus, of ordered pairs; point a up to bin last[a].

    coordinates (d, n), the first axis ascending; counts (bins,).
    """
    n = coordinates.shape[1]
    work = np.empty(n), np.empty(n, np.int32)
    end = 0
    for a in range(n):
        while end < n and coordinates[0, end] - coordinates[0, a] <= limit:
            end += 1
        _fill_bins(coordinates, a, end, False, per_unit, counts.size, work)
        for k in range(end - a - 1):
            b = work[1][k]
            if b < counts.size:
                counts[b] += (b < last[a]) + (b < last[a + 1 + k])
