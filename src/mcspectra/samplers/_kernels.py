"""Numba kernels shared by the samplers; arguments are not checked.

Notation: R realizations, n points, d dims; ``keys`` uint64 (R, 2) from `Stream.keys`.
Arrays ``out`` are float64 (R, n, d) unless stated otherwise.
Random number i·d + j of a realization belongs to coordinate j of point i.
Shuffles use the random numbers that follow the n·d numbers of the coordinates.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_bits, mix_uniform

__all__ = [
    "fill_jittered",
    "fill_latin",
    "translated",
]

_S32 = np.uint64(32)
_LOW32 = np.uint64(0xFFFFFFFF)


@kernel
def _mix_below(k0: np.uint64, k1: np.uint64, i: int, bound: int) -> Any:
    # Random integer in [0, bound): upper word of bits · bound. The bias is below 2^-32.
    x, b = mix_bits(k0, k1, i), np.uint64(bound)
    return np.int64(((x >> _S32) * b + (((x & _LOW32) * b) >> _S32)) >> _S32)


@kernel
def _shuffle(k0: np.uint64, k1: np.uint64, start: int, order: Array) -> None:
    # Make `order` a uniform random permutation (Fisher and Yates, inside out).
    for i in range(order.size):
        j = _mix_below(k0, k1, start + i, i + 1)
        order[i] = order[j]
        order[j] = i


@kernel
def fill_jittered(keys: Array, corners: Array, side: float, out: Array) -> None:
    """Place one point in each cell, given corners (n·d,) and side of the cells; out (R, n·d)."""
    for r in range(out.shape[0]):
        k0, k1 = keys[r, 0], keys[r, 1]
        row = out[r]
        for i in range(row.size):
            row[i] = corners[i] + side * mix_uniform(k0, k1, i)


@kernel
def fill_latin(keys: Array, side: float, out: Array) -> None:
    """Fill a Latin hypercube: each coordinate permutes n strata, each with a jittered point."""
    count, n, dims = out.shape
    order = np.empty(n, np.int32)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        for j in range(dims):
            _shuffle(k0, k1, n * dims + j * n, order)
            for i in range(n):
                out[r, i, j] = order[i] / n + side * mix_uniform(k0, k1, i * dims + j)


def translated(points: Array, offsets: Array) -> Array:
    """Return sets (R or 1, n, d) translated on the torus by offsets (R or 1, d) in [0,1)."""
    out = np.empty((max(len(points), len(offsets)), *points.shape[1:]))
    _translate(points, offsets, out)
    return out


@kernel
def _translate(points: Array, offsets: Array, out: Array) -> None:
    # The sum x + δ is at most 2 − 2^-52, which is a float64.
    # If the sum is at least 1, subtracting 1 is exact, so the result is below 1.
    count, n, dims = out.shape
    for r in range(count):
        offset, one = offsets[r % offsets.shape[0]], points[r % points.shape[0]]
        for i in range(n):
            for j in range(dims):
                x = one[i, j] + offset[j]
                out[r, i, j] = x - 1.0 if x >= 1.0 else x
