"""Low-discrepancy blue noise: a low-discrepancy set whose points follow those of a blue-noise set."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array, as_integer
from mcspectra.core.errors import ParameterError
from mcspectra.samplers import _ldbn_kernels
from mcspectra.samplers.base import Structure, check_dims
from mcspectra.samplers.optimised import OptimisedSampler, check_sets

__all__ = ["LowDiscrepancyBlueNoise"]

_REPORTS = 10
_LAST_STEP = 0.05  # cells


@final
@dataclass(frozen=True, kw_only=True)
class LowDiscrepancyBlueNoise(OptimisedSampler):
    """Low-discrepancy blue noise in s × s cells, s a power of two (2-D).

    Counts 4^k up to 65,536. Points come in row-major order of their cells. A set of 1024 points takes
    a quarter of a second, four times as many four times as long.

    Attributes
    ----------
    chunk
        Number of cells in line whose offsets follow the blue-noise set, a power of two up to 64:
        more of them give cleaner blue noise, fewer a lower discrepancy.
    sweeps
        Number of tries to move each point of the blue-noise set that is followed.
    sets
        Largest number of different sets, None for one for each realisation: see `OptimisedSampler`.

    Notes
    -----
    One point in each cell, and one in each n-th of either axis. An interval of area 1/n of any other
    shape has one if it is 2^j cells long with 2^j ≥ chunk (and a 2^j-th of one wide): chunk = 2 makes
    a (0,2)-net. The whole set is uniform over its cells and along each axis, but a bit less so within
    cells: follow it by shift where unbiased means are needed.

    The set followed is a jittered one, relaxed within its cells until Gaussians of half a cell's width
    around the points overlap least. It is made anew for every realisation, where the authors keep a
    table of one.

    References
    ----------
    Ahmed, Perrier, Coeurjolly, Ostromoukhov, Guo, Yan, Huang, Deussen (2016), "Low-discrepancy blue
    noise sampling", doi 10.1145/2980179.2980218.
    """

    name: ClassVar[str] = "ldbn"
    structure: ClassVar[Structure] = Structure.STRATA
    unbiased: ClassVar[bool] = False
    max_dims: ClassVar[int | None] = 2
    dims: int = 2
    chunk: int = 16
    sweeps: int = 100

    def __post_init__(self) -> None:
        if self.dims != 2:
            raise ParameterError(
                f"ldbn: dims is {self.dims!r}; it must be 2, "
                "for other dims use projective-blue-noise or sobol | owen."
            )
        check_dims(self)
        check_sets(self)
        chunk = as_integer("chunk", self.chunk, least=2, most=64)
        if chunk & (chunk - 1):
            raise ParameterError(f"chunk is {chunk}; give a power of two from 2 to 64.")
        object.__setattr__(self, "chunk", chunk)
        object.__setattr__(self, "sweeps", as_integer("sweeps", self.sweeps, least=1, most=10**5))

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        below = 1 << (n.bit_length() - 1) // 2 * 2
        return below, below if below == n else 4 * below

    def _optimize(self, n: int, keys: Array, report: Callable[[float], None]) -> Array:
        side = math.isqrt(n)
        followed = np.empty((side, side, 2))
        _ldbn_kernels.jittered_cells(keys[0], keys[1], followed)
        for sweep in range(self.sweeps):
            number = 2 * n * (sweep + 1)
            step = _LAST_STEP ** (sweep / self.sweeps)
            _ldbn_kernels.relax_in_cells(keys[0], keys[1], number, step, followed)
            if (sweep + 1) % max(1, self.sweeps // _REPORTS) == 0:
                report((sweep + 1) / self.sweeps)
        points = np.empty((side, side, 2))
        number = 2 * n * (self.sweeps + 1)
        chunk = min(self.chunk, side)
        _ldbn_kernels.snap_in_chunks(keys[0], keys[1], number, chunk, followed, points)
        return points.reshape(n, 2)
