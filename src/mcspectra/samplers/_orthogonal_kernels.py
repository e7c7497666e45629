"""Kernels of orthogonal arrays and of the point sets made of them."""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform
from mcspectra.samplers._kernels import _shuffle

__all__ = ["bush_levels", "fill_orthogonal"]


@kernel
def bush_levels(s: int, strength: int, out: Array) -> None:
    """Bush's array: row i are the values of a polynomial, its digits in base s the coefficients.

    Out int32 (s^strength, d), d ≤ s + 1: column 0 is the leading coefficient ("the value at
    infinity"), column j + 1 the value at j modulo the prime s.
    """
    n, dims = out.shape
    for i in range(n):
        out[i, 0] = i // (n // s)
        for j in range(dims - 1):
            value, rest, base = 0, i, n // s
            for _ in range(strength):  # Horner, the leading coefficient first
                value = (value * j + rest // base) % s
                rest, base = rest % base, base // s
            out[i, j + 1] = value


@kernel
def fill_orthogonal(
    keys: Array, slots: Array, levels: int, shared: bool, side: float, out: Array
) -> None:
    """Point i in stratum slots[i, j] of axis j, after a shuffle; jittered within it.

    A level is a run of equally many strata. Levels are shuffled, and the strata within each: in all
    levels alike if `shared`. Slots int32 (n, d); out (R, n, d); `side` of a stratum.
    """
    count, n, dims = out.shape
    strata = slots[:, 0].max() + 1
    width = strata // levels
    order = np.empty(strata, np.int32)
    places, within = np.empty(levels, np.int64), np.empty(width, np.int64)
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        for j in range(dims):
            number = n * dims + j * (levels + strata)
            _shuffle(k0, k1, number, places)
            for a in range(levels):
                if a == 0 or not shared:
                    _shuffle(k0, k1, number + levels + a * width, within)
                for q in range(width):
                    order[a * width + q] = places[a] * width + within[q]
            for i in range(n):
                x = order[slots[i, j]] / strata
                out[r, i, j] = x + side * mix_uniform(k0, k1, i * dims + j)
