"""States of reductions: flat records of arrays, with common rules for merging and storing.

A state is a dataclass whose fields are arrays, numbers or other records.
Two states are merged field by field.
A record with a method `merge` is merged by this method.
For example, the merged variance in a record of moments depends on the means of both records.
An array or a number is merged by one of three rules, which its type annotation contains.
The three rules are: add all (`SUM`), concatenate (`JOIN`), or keep one of equal values (`SAME`).
The stored form is one buffer: a MessagePack header with names, types and shapes, then the numbers.
The buffer contains no pickle and no code.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from types import UnionType
from typing import Annotated, Any, TypeAlias, Union, final, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.confidence import standard_error
from mcspectra.core.errors import FileFormatError

__all__ = [
    "JOIN",
    "SAME",
    "SUM",
    "Join",
    "MeanSums",
    "merged",
    "pack",
    "unpack",
]


@final
class Join:
    """Merge rule for arrays: they are concatenated along an axis."""

    def __init__(self, axis: int = 0) -> None:
        self.axis = axis


SUM: TypeAlias = Annotated[Array, "sum"]
"""Merge rule for arrays: they are added, in the memory of the left array."""

JOIN: TypeAlias = Annotated[Array, Join(0)]
"""Merge rule for arrays: they are concatenated along their first axis."""

SAME: TypeAlias = Annotated[Array, "same"]
"""Merge rule for arrays that are equal in all blocks: one of them is kept."""


@final
@dataclass
class MeanSums:
    """Sums over realizations of arrays and of their squares, for means and standard errors."""

    total: SUM
    squares: SUM
    count: int = 1

    @staticmethod
    def of(values: Array) -> MeanSums:
        """Return the sums for a single realization: its values and their squares."""
        return MeanSums(np.array(values), values * values)

    @staticmethod
    def zeros(size: int) -> MeanSums:
        """Return empty sums, all 0, for arrays of shape (size,)."""
        return MeanSums(np.zeros(size), np.zeros(size), 0)

    def mean_and_error(self, sets: int | None = None) -> tuple[Array, Array]:
        """Return the mean over realizations and its standard error (NaN for one realization).

        If the realizations use the same point sets repeatedly, `sets` is the number of these sets.
        All sets are used equally often. The standard error assumes `sets` independent values.
        """
        mean, count = self.total / self.count, self.count
        independent = count if sets is None else min(count, sets)
        return mean, standard_error(self.squares / count - mean * mean, independent)


_MAGIC = b"mcs1"
_Shape: TypeAlias = tuple[Annotated[int, msgspec.Meta(ge=0)], ...]
_Kind: TypeAlias = Annotated[str, msgspec.Meta(pattern=r"^[<>|][biufcU]\d{1,9}$")]
_HEADER = msgspec.msgpack.Decoder(tuple[msgspec.Raw, list[tuple[_Kind, _Shape]]])
_MOST_LETTER = 0x10FFFF  # largest code point in Unicode
_UNIONS = (Union, UnionType)


def merged(left: Any, right: Any) -> Any:
    """Return the merged state of two neighboring nodes. The memory of `left` may be reused."""
    own = getattr(left, "merge", None)
    if own is not None:
        return own(right)
    if isinstance(left, list | tuple):
        return type(left)(merged(a, b) for a, b in zip(left, right, strict=True))
    if not is_dataclass(left):
        raise TypeError(f"A {type(left).__name__} has no merge rule; make it a field of a record.")
    kind: Any = type(left)
    values = {}
    for name, rule in _rules(kind).items():
        a, b = getattr(left, name), getattr(right, name)
        if a is None or b is None:
            values[name] = b if a is None else a
        elif rule == "sum":
            values[name] = np.add(a, b, out=a) if isinstance(a, np.ndarray) else a + b
        elif isinstance(rule, Join):
            values[name] = np.concatenate([a, b], axis=rule.axis)
        else:
            values[name] = a if rule == "same" else merged(a, b)
    return kind(**values)


@functools.cache
def _rules(kind: Any) -> dict[str, Any]:
    """Return the merge rule of each field of a record. A field that holds a record has None."""
    hints = get_type_hints(kind, include_extras=True)
    rules: dict[str, Any] = {}
    for field in fields(kind):
        hint = hints[field.name]
        if get_origin(hint) in _UNIONS:
            hint = next(each for each in get_args(hint) if each is not type(None))
        annotated = get_origin(hint) is Annotated
        rules[field.name] = (
            get_args(hint)[1] if annotated else "sum" if hint in (int, float) else None
        )
    return rules


def pack(state: Any) -> bytes:
    """Return a record, a list of records, an array, a dict of arrays or a dataset as bytes.

    Raises
    ------
    TypeError
        If a state contains Python objects, or an attribute has a type that cannot be stored.
    """
    arrays: list[Array] = []

    def plain(value: Any) -> Any:
        """Replace each array by its index in `arrays`, and each dataset by names and indices."""
        if isinstance(value, np.ndarray):
            if value.dtype.kind not in "biufcU":
                raise TypeError(
                    f"An array holds {value.dtype}, not numbers; give an array of numbers."
                )
            arrays.append(value)
            return len(arrays) - 1
        if isinstance(value, np.generic):
            return value.item()
        if not hasattr(value, "data_vars"):
            raise TypeError(f"A {type(value).__name__} cannot be stored in a result.")
        variables = []
        for name, variable in value.variables.items():
            values = np.ascontiguousarray(variable.values).reshape(variable.shape)
            own = name in value.coords
            variables.append((name, own, variable.dims, values, _attributes(variable.attrs)))
        return {"attrs": _attributes(value.attrs), "variables": variables}

    tree = msgspec.Raw(msgspec.msgpack.encode(state, enc_hook=plain))
    header = msgspec.msgpack.encode((tree, [(a.dtype.str, a.shape) for a in arrays]))
    parts = [_MAGIC, len(header).to_bytes(8, "little"), header]
    parts += [a.tobytes() for a in arrays]
    return b"".join(parts)


def _attributes(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the attributes. Only numbers, texts and lists of these can be restored later."""
    for name, value in attributes.items():
        if not isinstance(value, str | int | float | list | tuple | dict | np.generic):
            raise TypeError(
                f"The attribute {name} is a {type(value).__name__}, which cannot be stored."
            )
    return {str(name): value for name, value in attributes.items()}


def unpack(kind: Any, payload: bytes) -> Any:
    """Return the state that `pack` stored.

    `kind` is the type of the state: a record, ``list[record]``, an array, or a dict of arrays.
    The function allocates nothing larger than the payload.

    Raises
    ------
    FileFormatError
        If the bytes are damaged, or contain a state of another type.
    """
    try:
        if payload[:4] != _MAGIC:
            raise ValueError("not a state")
        start = 12 + int.from_bytes(payload[4:12], "little")
        tree, described = _HEADER.decode(payload[12:start])
        arrays = []
        for text, shape in described:
            dtype, count = np.dtype(text), math.prod(shape)
            values = np.frombuffer(payload, dtype, count, start) if count else np.empty(0, dtype)
            if dtype.kind == "U" and np.max(values.view(f"{text[0]}u4"), initial=0) > _MOST_LETTER:
                raise ValueError("a text with invalid characters")
            arrays.append(values.reshape(shape).copy())
            start += count * dtype.itemsize
        if start != len(payload):
            raise ValueError("bytes are missing or left over")

        def made(wanted: Any, value: Any) -> Any:
            if getattr(wanted, "__name__", "") != "Dataset":
                return arrays[value]
            import xarray as xr

            variables = {
                name: (tuple(dims), arrays[place], attrs)
                for name, _, dims, place, attrs in value["variables"]
            }
            coords = [name for name, coord, *_ in value["variables"] if coord]
            return xr.Dataset(variables, attrs=value["attrs"]).set_coords(coords)

        return msgspec.msgpack.decode(tree, type=kind, dec_hook=made)
    except (
        ValueError,
        TypeError,
        LookupError,
        AttributeError,
        OverflowError,
        RecursionError,
    ) as error:
        raise FileFormatError(f"A stored result cannot be read: {error}.") from None
