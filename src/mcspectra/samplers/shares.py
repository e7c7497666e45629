"""Sets that share out the cells of a grid: each set is chosen for what it is, all of them are uniform."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from os import PathLike
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.decoding import opened, read_npz
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.core.fields import settle
from mcspectra.core.streams import Stream
from mcspectra.samplers.base import MAX_COUNT, Sampler

__all__ = ["SharedCells", "write_cells"]

_BELOW_ONE = 1.0 - 2.0**-53


@final
@dataclass(frozen=True, kw_only=True)
class SharedCells(Sampler):
    """One of W sets of n cells, chosen at random; together they hold each of W n cells of a grid once.

    A realisation draws one offset for all cells of its set, a uniform point of a cell, which each
    cell takes as it is or reflected along some axes. Every point is uniform on [0,1)^d, whatever the
    sets are, so that estimates are unbiased. `design` makes them.

    Attributes
    ----------
    path
        File .npz with an array ``cells`` of shape (W, n, d), integers: along each axis 1 + the number of the
        cell, negative where offsets are reflected. The grid has as many cells along an axis as
        the largest of these numbers.
    dims
        Number of coordinates; by default that of the file; a given number must agree with it.

    Raises
    ------
    FileFormatError
        The file holds no such array, or a cell of the grid is not in exactly one set.
    """

    path: str
    dims: int = None  # type: ignore[assignment]
    _cells: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        cells = _cells_of_file(self.path)
        settle(self, path=str(self.path), _cells=cells)
        given: Any = self.dims
        settle(self, dims=cells.shape[2] if given is None else given)
        Sampler.__post_init__(self)
        if self.dims != cells.shape[2]:
            raise ParameterError(
                f"The cells of {self.path} are in {cells.shape[2]} dims, but {self.dims} dims are needed."
            )

    @property
    def spec(self) -> str:
        """Spec string with the path."""
        return f"shared-cells(path={self.path!r})"

    def _points(self, n: int, stream: Stream, first: int, count: int) -> Array:
        del n
        numbers = stream.uniforms(first, count, 1 + self.dims)
        chosen = self._cells[(numbers[:, 0] * len(self._cells)).astype(np.int64)]
        sides = np.abs(self._cells).max(axis=(0, 1))
        offset = numbers[:, None, 1:]
        offset = np.where(chosen < 0, _BELOW_ONE - offset, offset)
        return np.ascontiguousarray(np.minimum((np.abs(chosen) - 1 + offset) / sides, _BELOW_ONE))

    def _counts_near(self, n: int) -> tuple[int | None, int]:
        size = self._cells.shape[1]
        return (size if n >= size else None), (size if n <= size else 2 * MAX_COUNT)


def _cells_of_file(path: str) -> Array:
    """Cells of a file, each of which must be in one set: int64 (W, n, d)."""
    with opened(path, "a file of cells", (".npz",)) as (stream, size, name, _):
        cells = read_npz(stream, size, name, "cells")
    if cells.ndim != 3 or cells.dtype.kind != "i" or not cells.all() or cells.size == 0:
        raise FileFormatError(
            f"{path} holds cells of type {cells.dtype} and shape {cells.shape}; give integers of shape "
            "(W, n, d), along each axis 1 + the number of the cell or minus that."
        )
    cells = cells.astype(np.int64)
    index = np.abs(cells).reshape(-1, cells.shape[2]) - 1
    sides = index.max(axis=0) + 1
    if math.prod(sides.tolist()) != len(index) or len(np.unique(index, axis=0)) != len(index):
        raise FileFormatError(
            f"{path} has {len(index)} cells for a grid of {' x '.join(map(str, sides))}; each cell "
            "of the grid must be in one set, or points are not uniform."
        )
    return cells


def write_cells(path: str | PathLike[str], cells: Array) -> None:
    """Write signed cells (W, n, d) as `SharedCells` reads them."""
    np.savez_compressed(path, cells=cells.astype(np.int16))
