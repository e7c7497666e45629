"""Integer frequencies by their norm."""

from __future__ import annotations

import math

import numpy as np

from mcspectra.core.checks import Array

__all__ = ["frequencies_within", "half_shells", "nearest_frequencies"]


def frequencies_within(square: int, dims: int) -> Array:
    """Return all integer vectors with |m|² ≤ `square`, int64 (K, dims), ordered by |m|², then m."""
    reach = math.isqrt(square)
    axis = np.arange(-reach, reach + 1)
    found, norms = np.zeros((1, 0), np.int64), np.zeros(1, np.int64)
    for _ in range(dims):
        total = norms[:, None] + axis**2
        row, column = np.nonzero(total <= square)
        found = np.column_stack([found[row], axis[column]])
        norms = total[row, column]
    order = np.argsort(norms, kind="stable")
    return found[order]


def nearest_frequencies(count: int, dims: int) -> Array:
    """Return the `count` integer vectors of least norm, of equal norms the first in order of m."""
    square = _least_square(count, dims)
    while len(found := frequencies_within(square, dims)) < count:
        square += 1
    nearest: Array = found[:count]
    return nearest


def half_shells(most: int, dims: int) -> Array:
    """Return half the vectors of 0 < |m|² ≤ K², one of each ±m: all shells that `most` vectors hold.

    Of each pair it is the one whose first component that is not 0 is positive.
    """
    found = nearest_frequencies(2 * most + 2, dims)
    norms = np.sum(found**2, axis=1)
    inside = found[norms < norms[-1]]  # the last shell may be cut short
    first = np.argmax(inside != 0, axis=1)
    half: Array = inside[inside[np.arange(len(inside)), first] > 0]
    return half


def _least_square(count: int, dims: int) -> int:
    """Return a squared radius somewhat below that of the ball of volume `count`."""
    log_volume = 0.5 * dims * math.log(math.pi) - math.lgamma(0.5 * dims + 1)
    square = math.exp(2.0 / dims * (math.log(count) - log_volume))
    return int(0.8 * square) if dims <= 3 else 0
