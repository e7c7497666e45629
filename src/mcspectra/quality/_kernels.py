"""Loops over pairs of points; every pair is visited once."""

from __future__ import annotations

import math

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel

__all__ = ["diaphony_sum", "generalized_l2_sum", "star_discrepancy_2d", "torus_nearest"]

_MEAN = math.pi**2 / 6.0


@kernel
def diaphony_sum(x: Array) -> float:
    """Return the sum over pairs i < j of Π(1 + 2π² B2({x_ik − x_jk})) − 1 for points (n, d)."""
    n, dims = x.shape
    total = 0.0
    for i in range(n):
        row = 0.0  # a sum for each point keeps rounding to that of n, not n², terms
        for j in range(i):
            product = 1.0
            for k in range(dims):
                turn = 1.0 - 2.0 * abs(x[i, k] - x[j, k])
                product *= 1.0 - _MEAN + 3.0 * _MEAN * turn * turn
            row += product - 1.0
        total += row
    return total


@kernel
def generalized_l2_sum(x: Array) -> float:
    """Return the sum over pairs i < j of Π(2 − max(x_ik, x_jk)) for points (n, d)."""
    n, dims = x.shape
    total = 0.0
    for i in range(n):
        row = 0.0
        for j in range(i):
            product = 1.0
            for k in range(dims):
                product *= 2.0 - max(x[i, k], x[j, k])
            row += product
        total += row
    return total


@kernel
def torus_nearest(x: Array) -> Array:
    """Return each point's squared toroidal distance to its nearest neighbour."""
    n, dims = x.shape
    nearest = np.full(n, np.inf)
    for i in range(n):
        for j in range(i):
            square = 0.0
            for k in range(dims):
                step = abs(x[i, k] - x[j, k])
                step = min(step, 1.0 - step)
                square += step * step
            nearest[i] = min(nearest[i], square)
            nearest[j] = min(nearest[j], square)
    return nearest


@kernel
def star_discrepancy_2d(x: Array, y: Array) -> float:
    """Return D* of the points (x_i, y_i), x ascending.

    The supremum over boxes [0,a) × [0,b) is reached, or approached, where a and b are coordinates
    of points or 1: each column of the grid of all coordinates is scanned with the points left of
    it, kept in order of y.
    """
    n = len(x)
    heights = np.empty(n + 2)
    heights[0], heights[1] = 0.0, 1.0
    worst = 0.0
    for column in range(n + 1):
        left = x[column - 1] if column else 0.0
        right = x[column] if column < n else 1.0
        if column:
            k = column
            heights[column + 1] = 1.0
            while heights[k - 1] > y[column - 1]:
                heights[k] = heights[k - 1]
                k -= 1
            heights[k] = y[column - 1]
        for k in range(column + 1):
            share = k / n
            worst = max(worst, share - left * heights[k], right * heights[k + 1] - share)
    return worst
