"""The triangular lattice, fitted to the unit torus."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers.base import Sampler, Structure, check_dims, repeated

__all__ = ["Hexagonal"]


@final
@dataclass(frozen=True, kw_only=True)
class Hexagonal(Sampler):
    """Triangular lattice (hexagonal cells) stretched to fit the torus; randomise with shift.

    2-D; counts n = 2ab for a = 1, 2, 3, … and b the whole number nearest to a/√3, at least 1:
    2, 4, 12, 16, 30, 36, 56, 80, …

    Notes
    -----
    The points are 2b rows of a points, every other row moved by half a step; nothing is random.
    On a square torus no such array is quite regular: that takes b = a/√3. The chosen b is off by ½
    at most, and the longer of the two distances between neighbours is then 1.41, 1.12, 1.11, 1.12,
    1.03 and 1.12 times the shorter one at the first six counts, at most 1.06 from n = 56 and 1.02
    from n = 780 on.

    References
    ----------
    Petersen, Middleton (1962), "Sampling and reconstruction of wave-number-limited functions in
    N-dimensional Euclidean spaces", doi 10.1016/S0019-9958(62)90633-2.
    """

    name: ClassVar[str] = "hexagonal"
    structure: ClassVar[Structure] = Structure.TORUS
    unbiased: ClassVar[bool] = False
    fixed: ClassVar[bool] = True
    max_dims: ClassVar[int | None] = 2
    dims: int = 2

    def __post_init__(self) -> None:
        if self.dims != 2:
            raise ParameterError(
                f"hexagonal: dims is {self.dims!r}; it must be 2, "
                "for other dims use rank1-lattice or regular."
            )
        check_dims(self)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        across = _largest_across(n)
        rows = n // across
        row, step = np.divmod(np.arange(n), across)
        x = (4 * step + 1 + 2 * (row % 2)) / (4 * across)
        y = (2 * row + 1) / (2 * rows)
        return repeated(np.stack([x, y], axis=-1), count)

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        across = _largest_across(n)
        if not across:
            return None, _count(1)
        below = _count(across)
        return below, below if below == n else _count(across + 1)


def _count(across: int) -> int:
    """Number of points in rows of `across`: twice that times the best half of the rows."""
    return 2 * across * max(1, round(across / math.sqrt(3.0)))


def _largest_across(n: int) -> int:
    """Largest a of which the count is at most `n`, 0 if there is none."""
    across = math.isqrt(n) + 2  # the count is at least a² for a > 1
    while across and _count(across) > n:
        across -= 1
    return across
