"""Sobol' points: the digital sequence in base 2 with the direction numbers of Joe and Kuo."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import ClassVar, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.registry import DEFAULT_DIMS
from mcspectra.core.streams import Stream
from mcspectra.samplers import _kernels
from mcspectra.samplers.base import Sampler, Structure, check_dims

__all__ = ["Sobol"]


@final
@dataclass(frozen=True, kw_only=True)
class Sobol(Sampler):
    """Sobol' points 0 … n−1, 32 bits, the same every time; randomise with owen or digital-shift.

    Notes
    -----
    Natural order: dimension 0 is the van der Corput sequence of the index, not of its Gray code.
    Counts other than powers of two are made, with a `NotPowerOfTwoWarning`: the sets are then not
    balanced in elementary intervals.

    References
    ----------
    Joe, Kuo (2008), "Constructing Sobol sequences with better two-dimensional projections",
    doi 10.1137/070709359: table new-joe-kuo-6, its first 1,111 dims (data/SOURCES.md).
    """

    name: ClassVar[str] = "sobol"
    unbiased: ClassVar[bool] = False
    structure: ClassVar[Structure] = Structure.DIGITS
    max_dims: ClassVar[int | None] = 1111
    dims: int = DEFAULT_DIMS

    def __post_init__(self) -> None:
        check_dims(self)

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del stream, first  # the same points every time
        points = np.empty((n, self.dims))
        _kernels.fill_sobol(_directions()[: self.dims], points)
        return np.tile(points, (count, 1, 1))

    def _count_warning(self, n: int) -> str | None:
        if not n & (n - 1):
            return None
        below = 1 << (n.bit_length() - 1)
        return f"{n} Sobol' points are not balanced; {below} and {2 * below} would be."


@lru_cache
def _directions() -> Array:
    """Direction numbers of all dims: uint32 (1111, 32), 2^31 standing for ½."""
    table = files("mcspectra.samplers") / "data" / "sobol-joe-kuo-6.npz"
    with table.open("rb") as file, np.load(file, allow_pickle=False) as data:
        polynomials = data["polynomials"].astype(np.int64)
        initial = data["initial"].astype(np.int64)
    out = np.zeros((len(polynomials), 32), np.uint32)
    _kernels.direction_numbers(polynomials, initial, out)
    out.setflags(write=False)
    return out
