"""Multi-jittered sets in 2-D: cells of a grid and fine strata of both axes, one point in each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.samplers import _multijitter_kernels
from mcspectra.samplers._grid import cell_side
from mcspectra.samplers.base import Sampler, Structure, check_dims

__all__ = ["CorrelatedMultiJittered", "MultiJittered"]


@final
@dataclass(frozen=True, kw_only=True)
class MultiJittered(Sampler):
    """Jittered in a × b cells, with one point in each of n strata of either axis too (2-D).

    2-D. The counts are those n = a·b with a ≤ b ≤ 2a; the most nearly square such a × b is taken.

    Notes
    -----
    The shares of a column (or row) are shuffled independently of those of the others;
    correlated-multi-jittered repeats one shuffle in all of them.

    References
    ----------
    Chiu, Shirley, Wang (1994), "Multi-jittered sampling", Graphics Gems IV, 370–374.
    """

    name: ClassVar[str] = "multi-jittered"
    structure: ClassVar[Structure] = Structure.STRATA
    max_dims: ClassVar[int | None] = 2
    dims: int = 2

    def __post_init__(self) -> None:
        _check_two_dims(self)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        columns = _nearly_square(n)
        out = np.empty((count, n, 2))
        _multijitter_kernels.fill_multi_jittered(
            stream.keys(first, count), columns, n // columns, cell_side(n), out
        )
        return out

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        below = above = n
        while not _nearly_square(below):
            below -= 1
        while not _nearly_square(above):
            above += 1
        return below, above


@final
@dataclass(frozen=True, kw_only=True)
class CorrelatedMultiJittered(Sampler):
    """Multi-jittered with one shuffle for all columns and one for all rows, any count (2-D).

    2-D, any count.

    Notes
    -----
    Counts n = a·b with a ≤ b ≤ 2a take the most nearly square such a × b: each of the a × b cells
    and each n-th of either axis holds one point. Other counts follow the memo's code: a = ⌊√n⌋
    columns and b = ⌈n/a⌉ rows of height a/n, of which the last is incomplete. Each n-th of the
    second axis then holds one point, and each (a·b)-th of the first and each cell at most one; digit
    scrambles are for rectangles only. Shuffles are true
    random permutations, where the memo hashes indices. Points come in the order of their second
    coordinate; shuffle gives them another.

    References
    ----------
    Kensler (2013), "Correlated multi-jittered sampling", Pixar technical memo 13-01.
    """

    name: ClassVar[str] = "correlated-multi-jittered"
    structure: ClassVar[Structure] = Structure.STRATA
    max_dims: ClassVar[int | None] = 2
    dims: int = 2

    def __post_init__(self) -> None:
        _check_two_dims(self)

    def digit_strata(self, n: int, base: int) -> bool:
        """Whether n is a rectangle of columns and rows that are powers of the base."""
        columns = _nearly_square(n)
        return columns > 0 and base ** round(math.log(columns, base)) == columns

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        columns = _nearly_square(n) or math.isqrt(n)
        rows = -(-n // columns)
        sides = cell_side(columns * rows), cell_side(n)
        out = np.empty((count, n, 2))
        _multijitter_kernels.fill_correlated(stream.keys(first, count), columns, rows, *sides, out)
        return out


def _check_two_dims(sampler: Any) -> None:
    if sampler.dims != 2:
        raise ParameterError(
            f"{sampler.name}: dims is {sampler.dims!r}; it must be 2, "
            "for other dims use orthogonal-array, jittered or latin-hypercube."
        )
    check_dims(sampler)


def _nearly_square(n: int) -> int:
    """Largest divisor a of n with n/2 ≤ a² ≤ n, 0 if there is none."""
    candidates = np.arange(math.isqrt(n), math.isqrt((n - 1) // 2), -1)
    found = candidates[n % candidates == 0]
    return int(found[0]) if found.size else 0
