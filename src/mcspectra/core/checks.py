"""Checks of user input. Each check returns the converted value, or raises one clear sentence."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from mcspectra.core.display import counted, shown
from mcspectra.core.errors import DomainError, Parameter, ParameterError, close_match_hint

__all__ = [
    "BELOW_ONE",
    "MAX_DIMS",
    "MAX_FREQUENCY",
    "MOST_JOINT_DIMS",
    "PROFILE_PIXELS",
    "SECONDS_LIMITS",
    "TARGET_LIMITS",
    "Array",
    "as_choice",
    "as_frequencies",
    "as_instance",
    "as_instances",
    "as_integer",
    "as_joint_dims",
    "as_path",
    "as_real",
    "as_real_array",
    "as_reals",
    "as_unit_points",
    "distinct_points",
    "in_unit_cube",
    "is_path",
]

Array = npt.NDArray[Any]

BELOW_ONE = 1.0 - 2.0**-53
"""Largest float64 below 1. It is the largest coordinate in [0,1), and the largest random number."""

MAX_DIMS = 1024
"""Largest number of dims, where no smaller limit applies."""

MOST_JOINT_DIMS = 64
"""Largest number of joint dims of a padded sampler."""

# Limits of options that the command line reads and that functions check
TARGET_LIMITS = {"above": 0.0, "most": 1e3}
"""Limits of a target, the relative error σ / mean of a pixel."""

SECONDS_LIMITS = {"least": 1.0, "most": 86_400.0}
"""Limits of the time for the renders of a scene's profile."""

PROFILE_PIXELS = {"least": 16, "most": 2**16}
"""Limits of the number of pixels of a scene's profile."""

_LONGEST_NAME, _LONGEST_PATH = 255, 4096

MAX_FREQUENCY = 2.0**40
"""Largest frequency m. At this frequency, phases m·x of 53-bit points still have 13 bits."""


def is_path(value: object) -> bool:
    """Whether a value can be the path of a file or a URL: a text that the system can write.

    Linux, macOS and Windows allow names of at most 255 bytes.
    Linux allows paths of at most 4096 bytes.
    """
    if not isinstance(value, str | os.PathLike):
        return False
    try:
        text = os.fspath(value)
        encoded = os.fsencode(text)
    except (TypeError, UnicodeEncodeError):
        return False
    short = len(encoded) < _LONGEST_PATH and max(map(len, encoded.split(b"/"))) <= _LONGEST_NAME
    return isinstance(text, str) and "\0" not in text and (short or "://" in text)


def as_path(name: str, value: object) -> Path:
    """Return `value` as a path."""
    if not is_path(value):
        raise ParameterError(Parameter(name), f" is {shown(value)}; give a path.")
    return Path(value)  # type: ignore[arg-type]


def as_instance(name: str, value: Any, kind: Any, what: str) -> Any:
    """Return a value if it has one of the types `kind`. Error messages call these types `what`."""
    if isinstance(value, kind):
        return value
    raise ParameterError(Parameter(name), f" is {shown(value)}; give {what}.")


def as_instances(name: str, value: Any, kind: Any, what: str) -> list[Any]:
    """Return a list or tuple as a list if all items have the type `kind`.

    Error messages call this type `what`.
    """
    as_instance(name, value, list | tuple, f"a list of {what}")
    return [as_instance(f"{name}[{k}]", each, kind, what) for k, each in enumerate(value)]


def as_integer(name: str, value: object, *, least: int, most: int | None = None) -> int:
    """Return `value` as an int in [least, most]. Booleans and fractions are rejected."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole and isinstance(value, float | np.floating) and float(value).is_integer():
        whole = True
    if whole and int(value) >= least and (most is None or int(value) <= most):  # type: ignore[call-overload]
        return int(value)  # type: ignore[call-overload, no-any-return]
    limit = f"a whole number of at least {least}"
    if most is not None:
        limit = f"a whole number from {least} to {most}" if least < most else str(most)
    raise ParameterError(Parameter(name), f" is {shown(value)}; give {limit}.")


def as_joint_dims(name: str, value: object) -> int:
    """Return a number of joint dims: 0 for none, or a whole number from 2 to the largest one."""
    with contextlib.suppress(ParameterError):
        number = as_integer(name, value, least=0, most=MOST_JOINT_DIMS)
        if number != 1:
            return number
    raise ParameterError(
        Parameter(name),
        f" is {shown(value)}; give 0 for none, or a whole number from 2 to {MOST_JOINT_DIMS}.",
    )


def as_real(
    name: str,
    value: object,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    below: float | None = None,
) -> float:
    """Return `value` as a finite float within the given limits.

    The limits `above` and `below` are strict. The values `least` and `most` are allowed.
    """
    rules = [f"greater than {above:g}"] if above is not None else []
    rules += [f"at least {least:g}"] if least is not None else []
    rules += [f"at most {most:g}"] if most is not None else []
    rules += [f"less than {below:g}"] if below is not None else []
    number = isinstance(value, int | float | np.integer | np.floating)
    if number and not isinstance(value, bool):
        try:
            x = float(value)  # type: ignore[arg-type]
        except OverflowError:
            x = math.inf
        enough = (above is None or x > above) and (least is None or x >= least)
        few = (most is None or x <= most) and (below is None or x < below)
        if math.isfinite(x) and enough and few:
            return x
    wanted = f" {' and '.join(rules)}" if rules else ""
    raise ParameterError(Parameter(name), f" is {shown(value)}; give a finite number{wanted}.")


def as_reals(name: str, value: object, length: int, **limits: float | None) -> tuple[float, ...]:
    """Return `length` finite floats, from a sequence or from one number that is repeated."""
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
        if len(value) != length:
            raise ParameterError(
                Parameter(name),
                f" has {counted(len(value), 'value')}; give one number, or one for each of the "
                f"{length} dims.",
            )
        return tuple(as_real(f"{name}[{i}]", v, **limits) for i, v in enumerate(value))
    return (as_real(name, value, **limits),) * length


def as_choice(name: str, value: object, allowed: Sequence[str]) -> str:
    """Return a value if it is one of the allowed values."""
    if isinstance(value, str) and value in allowed:
        return value
    hint, close = close_match_hint(value if isinstance(value, str) else shown(value), allowed)
    raise ParameterError(
        Parameter(name),
        f" is {shown(value)}; it must be one of {', '.join(allowed)}.{hint if close else ''}",
    )


def as_real_array(name: str, value: object) -> Array:
    """Return `value` as a float64 array, if it contains integers or floats and no masked values.

    Raises
    ------
    DomainError
        If it holds complex numbers, booleans, text, ragged lists or masked values.
        NumPy would convert booleans and text to floats, and their meaning would be lost.
    """
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        array = np.asarray("ragged")
    if np.ma.is_masked(value):
        raise DomainError(
            Parameter(name), " has masked values; fill them in or leave those points out."
        )
    if array.dtype.kind not in "iuf" and array.size:
        raise DomainError(
            Parameter(name), f" is not an array of real numbers (type {array.dtype}); give floats."
        )
    return array.astype(np.float64, copy=False)


def in_unit_cube(points: Array) -> bool:
    """Whether all coordinates lie in [0,1]. The result is False if one is NaN."""
    return not points.size or bool(points.min() >= 0.0 and points.max() <= 1.0)


def as_unit_points(points: object, *, dims: int | None = None, name: str = "points") -> Array:
    """Return float64 points of shape (..., d) after checking that they lie in [0,1)^d.

    Raises
    ------
    DomainError
        If points are empty, not numeric, not finite, outside [0,1), or have another number of dims.
    """
    x = as_real_array(name, points)
    if x.ndim == 0 or x.size == 0:
        raise DomainError(f"{name} have shape {x.shape}; give at least one point, shape (..., d).")
    if dims is not None and x.shape[-1] != dims:
        raise DomainError(
            f"{name} have shape {x.shape}, that is {x.shape[-1]} dims; {dims} are needed."
        )
    low, high = float(x.min()), float(x.max())
    if not (math.isfinite(low) and math.isfinite(high)):
        bad = int(np.count_nonzero(~np.isfinite(x)))
        raise DomainError(f"{name} hold {bad} NaN or infinite coordinates; give finite numbers.")
    if low < 0.0 or high >= 1.0:
        raise DomainError(
            f"{name} run from {low:.6g} to {high:.6g}; they must lie in [0,1): "
            "scale or wrap them first."
        )
    return x


def distinct_points(points: Array) -> tuple[Array, Array, Array]:
    """Return the distinct points of a set (n, d), the index of each given point, and the counts.

    The points are returned in ascending order of their coordinates.
    Coordinates below 2^-400 are rounded down to multiples of 2^-500.
    Otherwise squares of the distances between such small coordinates would underflow.
    """
    places = points
    if (tiny := points < 2.0**-400).any():
        places = np.where(tiny, np.ldexp(np.floor(np.ldexp(points, 500)), -500), points)
    order = np.lexsort(places.T[::-1])
    places = places[order]
    differs = np.ones(len(places), bool)
    differs[1:] = (places[1:] != places[:-1]).any(axis=1)
    index = np.empty(len(places), np.int64)
    index[order] = np.cumsum(differs) - 1
    return places[differs], index, np.bincount(index)


def as_frequencies(frequencies: object, dims: int) -> Array:
    """Return float64 frequencies of shape (..., d), in cycles per unit."""
    m = as_real_array("frequencies", frequencies)
    if m.ndim == 0 or m.shape[-1] != dims or m.size == 0:
        raise ParameterError(
            f"frequencies have shape {m.shape}; give shape (..., {dims}), one row per frequency."
        )
    if not np.isfinite(m).all():
        raise ParameterError("frequencies hold NaN or infinity; give finite numbers.")
    if np.abs(m).max() > MAX_FREQUENCY:
        raise ParameterError(
            f"frequencies reach {np.abs(m).max():.3g}; beyond {MAX_FREQUENCY:.3g} the phases of "
            "float64 points have no correct digits."
        )
    return m
