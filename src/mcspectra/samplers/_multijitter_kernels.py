"""Kernels of multi-jittered sets: a × b cells, and strata of each axis, at once.

Legend: R realisations, n points; ``keys`` uint64 (R, 2) from `Stream.keys`; ``out`` (R, n, 2).
Numbers 2p and 2p + 1 of a realisation belong to point p; those of the shuffles come after them.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform
from mcspectra.samplers._kernels import _shuffle

__all__ = ["fill_correlated", "fill_multi_jittered"]


@kernel
def fill_multi_jittered(keys: Array, columns: int, rows: int, side: float, out: Array) -> None:
    """Multi-jittered: point (i, j) is in column i and row j, and alone in its n-th of each axis."""
    n = columns * rows
    down, across = np.empty(rows, np.int64), np.empty(columns, np.int64)
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        points = out[r]
        # The points of a column share it out among themselves, those of a row likewise.
        for i in range(columns):
            _shuffle(k0, k1, 2 * n + i * rows, down)
            for j in range(rows):
                p = i * rows + j
                points[p, 0] = (i * rows + down[j]) / n + side * mix_uniform(k0, k1, 2 * p)
        for j in range(rows):
            _shuffle(k0, k1, 3 * n + j * columns, across)
            for i in range(columns):
                p = i * rows + j
                y = (j * columns + across[i]) / n
                points[p, 1] = y + side * mix_uniform(k0, k1, 2 * p + 1)


@kernel
def fill_correlated(
    keys: Array, columns: int, rows: int, wide: float, high: float, out: Array
) -> None:
    """Correlated multi-jittered: one shuffle of the columns, one of the rows, for all points.

    Point p stays in the p-th of the n strata of the second axis, and so in row ⌊p / columns⌋; the
    last row may be incomplete. `wide` and `high` are the sides of the strata of either axis.
    """
    n, slots = out.shape[1], columns * rows
    across, down = np.empty(columns, np.int64), np.empty(rows, np.int64)
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        _shuffle(k0, k1, 2 * n, across)
        _shuffle(k0, k1, 2 * n + columns, down)
        for j in range(rows):
            start, share = j * columns, down[j]
            points = out[r, start : min(start + columns, n)]
            for i in range(len(points)):
                p = start + i
                x = (across[i] * rows + share) / slots
                points[i, 0] = x + wide * mix_uniform(k0, k1, 2 * p)
                points[i, 1] = p / n + high * mix_uniform(k0, k1, 2 * p + 1)
