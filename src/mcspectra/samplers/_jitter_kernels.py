"""Kernel of antithetic pairs in the cells of a grid."""

from __future__ import annotations

from mcspectra.core.checks import Array
from mcspectra.core.jit import kernel
from mcspectra.core.streams import mix_uniform

__all__ = ["fill_antithetic"]

_MOST = 1.0 - 2.0**-53  # largest uniform number


@kernel
def fill_antithetic(keys: Array, corners: Array, side: float, out: Array) -> None:
    """A point in each cell and its reflection through the centre of the cell.

    Corners (cells, d), out (R, cells, 2, d); `side` as from `cell_side`.
    """
    count, cells, _, dims = out.shape
    for r in range(count):
        k0, k1 = keys[r, 0], keys[r, 1]
        for i in range(cells):
            for j in range(dims):
                u = mix_uniform(k0, k1, i * dims + j)
                out[r, i, 0, j] = corners[i, j] + side * u
                # The numbers k/2^53 reflected: exact, and as evenly spread as they are
                out[r, i, 1, j] = corners[i, j] + side * (_MOST - u)
