"""Alias tables [Walker1977]_, built in linear time [Vose1991]_.

Bin i of n holds the cell i with the share `keep[i]` and, with the rest, the cell `other[i]`.
"""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.densities._kernels import below

__all__ = ["build", "jump"]


@kernel
def build(masses: Array) -> tuple[Array, Array]:
    """Shares `keep` (n,) and cells `other` (n,) of masses (n,) whose mean is 1.

    Each cell below the mean is filled up by one above it. Empty cells get the share 0 exactly: they
    are filled first while others are above the mean, and what rounding leaves over is near 1.
    """
    n = masses.size
    left = masses.copy()
    keep, other = np.ones(n), np.arange(n)
    stack = np.empty(n, np.int64)  # cells below the mean from the front, the others from the back
    low, high = 0, n
    for i in range(n):
        if left[i] < 1.0:
            stack[low] = i
            low += 1
        else:
            high -= 1
            stack[high] = i
    while low > 0 and high < n:
        low -= 1
        i, giver = stack[low], stack[high]
        keep[i], other[i] = left[i], giver
        left[giver] = (left[giver] + left[i]) - 1.0
        if left[giver] < 1.0:
            high += 1
            stack[low] = giver
            low += 1
    return keep, other


@kernel
def jump(keep: Array, other: Array, height: int, width: int, u: Array, x: Array) -> None:
    """Fill x (N, d) from u (N, d): u_0 chooses bin and cell, its remainder places along axis 0."""
    n = keep.size
    for k in range(u.shape[0]):
        scaled = u[k, 0] * n
        i = min(int(scaled), n - 1)
        rest = scaled - i
        if rest < keep[i]:
            cell, rest = i, rest / keep[i]
        else:
            cell, rest = other[i], (rest - keep[i]) / (1.0 - keep[i])
        row, column = divmod(cell, width)
        x[k, 0] = min((column + rest) / width, below((column + 1) / width))
        if u.shape[1] == 2:
            x[k, 1] = min((row + u[k, 1]) / height, below((row + 1) / height))
