"""Results as one long table: a row for each number, with what it is and where it belongs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.checks import Array

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["FIXED", "VALUES", "cells_of", "coordinate_columns", "tidy"]

FIXED = ("estimator", "sampler", "analysis", "variable", "units")
"""Columns of text before those of the coordinates."""

VALUES = ("value", "imaginary")
"""Columns of numbers after those of the coordinates; the second is empty for real numbers."""


def cells_of(tree: xr.DataTree) -> Iterator[tuple[str, xr.Dataset]]:
    """Paths and datasets of the cells of a tree, not yet loaded."""
    for node in tree.leaves:
        if node.has_data:
            yield node.path.lstrip("/"), node.to_dataset(inherit=False)


def coordinate_columns(tree: xr.DataTree) -> dict[str, bool]:
    """Names of all dimensions of a tree, in order; whether any cell has texts along it."""
    columns: dict[str, bool] = {}
    for _, cell in cells_of(tree):
        for dim in map(str, cell.dims):
            columns[dim] = columns.get(dim, False) or _labels(tree, cell, dim) is not None
    return columns


def tidy(tree: xr.DataTree, cell: xr.Dataset) -> Iterator[dict[str, Any]]:
    """Tables of a cell, one for each variable: arrays of equal length by the names of columns."""
    attributes = cell.attrs
    names = (attributes.get("estimator_name"), attributes.get("sampler_spec"))
    for name, variable in cell.variables.items():
        if name in cell.dims:
            continue  # it is a column of the others
        values = np.asarray(variable.values)
        fixed = (*names, attributes.get("analysis"), name, variable.attrs.get("units"))
        table: dict[str, Any] = {
            column: [str(text or "")] * values.size
            for column, text in zip(FIXED, fixed, strict=True)
        }
        for axis, dim in enumerate(map(str, variable.dims)):
            shape = [-1 if i == axis else 1 for i in range(values.ndim)]
            along = _along(tree, cell, dim).reshape(shape)
            table[dim] = np.broadcast_to(along, values.shape).ravel()
        yield table | _numbers(values.ravel())


def _along(tree: xr.DataTree, cell: xr.Dataset, dim: str) -> Array:
    """Coordinates along a dimension: texts, numbers, or else indices."""
    labels = _labels(tree, cell, dim)
    if labels is not None:
        return np.array(labels, dtype=object)
    return np.asarray(cell[dim].values if dim in cell.coords else np.arange(cell.sizes[dim]))


def _labels(tree: xr.DataTree, cell: xr.Dataset, dim: str) -> list[str] | None:
    """Texts along a dimension: an attribute of the cell, or of the root for ``bound``."""
    labels = cell.attrs.get(f"labels_{dim}", tree.attrs.get(dim) if dim == "bound" else None)
    fits = isinstance(labels, list) and len(labels) == cell.sizes[dim]
    return [str(label) for label in labels] if isinstance(labels, list) and fits else None


def _numbers(values: Array) -> dict[str, Array]:
    if values.dtype.kind == "c":
        return {"value": values.real, "imaginary": values.imag}
    return {"value": values.astype(np.int8) if values.dtype.kind == "b" else values}
