"""Records and datasets as named numeric arrays and back, bit for bit: no pickle, no code.

What crosses from one process to another, or waits in a file, is a flat dict of arrays of numbers. Text
(names, dims, attributes) goes along as JSON in an array of bytes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_type_hints

import numpy as np

from mcspectra.core.checks import Array

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["pack_dataset", "pack_record", "unpack_dataset", "unpack_record"]

Record = TypeVar("Record")

_HEADER = "header"


def pack_record(record: Any, prefix: str = "") -> dict[str, Array]:
    """Arrays and numbers of a dataclass by field name, those of records in it as ``field.name``.

    Fields that are None are left out.
    """
    packed: dict[str, Array] = {}
    for field in fields(record):
        name, value = prefix + field.name, getattr(record, field.name)
        if is_dataclass(value):
            packed |= pack_record(value, f"{name}.")
        elif value is not None:
            packed[name] = np.asarray(value)
    return packed


def unpack_record(kind: type[Record], arrays: Mapping[str, Array], prefix: str = "") -> Record:
    """Inverse of `pack_record`: fields annotated as int or float become plain numbers again.

    Fields that are not there are None if that is what they are annotated to be; else KeyError.
    """
    hints = get_type_hints(kind)
    return kind(**{name: _field(hints[name], arrays, prefix + name) for name in _names(kind)})


def _names(kind: Any) -> list[str]:
    return [field.name for field in fields(kind)]


def _field(kind: Any, arrays: Mapping[str, Array], name: str) -> Any:
    if isinstance(kind, UnionType):  # what may be None
        kind = get_args(kind)[0]
        if not any(key == name or key.startswith(f"{name}.") for key in arrays):
            return None
    if is_dataclass(kind):
        return unpack_record(kind, arrays, f"{name}.")  # type: ignore[arg-type]
    return kind(arrays[name]) if kind in (int, float) else arrays[name]


def pack_dataset(data: xr.Dataset) -> dict[str, Array]:
    """Values of all variables by their place, and a header with names, dims, types and attributes.

    Raises
    ------
    TypeError
        A variable holds Python objects, or an attribute is no number, text or list of them.
    """
    packed, described = {}, []
    for place, (name, variable) in enumerate(data.variables.items()):
        values = variable.values
        if values.dtype.kind not in "biufcU":
            raise TypeError(f"The variable {name} holds {values.dtype}, which has no numbers.")
        packed[str(place)] = _numbers(values)
        described.append(
            {
                "name": name,
                "coord": name in data.coords,
                "dims": variable.dims,
                "shape": values.shape,
                "type": values.dtype.str,
                "attrs": _plain(variable.attrs),
            }
        )
    header = json.dumps({"attrs": _plain(data.attrs), "variables": described})
    packed[_HEADER] = np.frombuffer(header.encode(), np.uint8)
    return packed


def unpack_dataset(arrays: Mapping[str, Array]) -> xr.Dataset:
    """Inverse of `pack_dataset`."""
    import xarray as xr

    header = json.loads(arrays[_HEADER].tobytes())
    variables: dict[str, Any] = {}
    for place, about in enumerate(header["variables"]):
        values = arrays[str(place)].view(about["type"]).reshape(about["shape"])
        variables[about["name"]] = (tuple(about["dims"]), values, about["attrs"])
    coords = [about["name"] for about in header["variables"] if about["coord"]]
    return xr.Dataset(variables, attrs=header["attrs"]).set_coords(coords)


def _numbers(values: Array) -> Array:
    """The values in a row; text as the code points of its characters."""
    flat = np.ascontiguousarray(values).reshape(-1)
    return flat.view(np.uint32) if values.dtype.kind == "U" else flat


def _plain(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes with NumPy's scalars as plain numbers."""
    return {
        str(name): value.item() if isinstance(value, np.generic) else value
        for name, value in attributes.items()
    }
