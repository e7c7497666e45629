"""Shared parts of the checks: their error, guarded calls of user code, sets of points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import McspectraError
from mcspectra.core.streams import Stream

__all__ = [
    "BrokenContract",
    "called",
    "check_breaks",
    "demand",
    "mean_and_error",
    "point_sets",
    "values_at",
]

_SETS, _SET_SIZE = 32, 4096
_ROUNDING = 1e-9


class BrokenContract(McspectraError, AssertionError):
    """A component breaks its contract; the message says how."""


def demand(holds: bool, who: str, sentence: str) -> None:
    """Raise BrokenContract ``who sentence`` unless `holds`."""
    if not holds:
        raise BrokenContract(f"{who} {sentence}.")


def called(who: str, what: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Return the function's value; an exception becomes a BrokenContract that names `what`."""
    try:
        with np.errstate(all="ignore"):  # what is not finite is looked at afterwards
            return function(*arguments)
    except BrokenContract:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()).rstrip(".") or "no message"
        raise BrokenContract(f"{who} fails in {what}: {type(error).__name__}: {reason}.") from error


def values_at(
    who: str, what: str, function: Callable[[Array], Any], points: Array, shape: tuple[int, ...]
) -> Array:
    """Return the values of a function, float64 of a shape, at points (sets, points, d).

    It leaves its input alone, and treats every point by itself.
    """
    before = points.copy()
    found = called(who, what, function, points)
    demand(np.array_equal(points, before), who, f"changes the points given to {what}")
    demand(
        isinstance(found, np.ndarray), who, f"gives {type(found).__name__} in {what}, not an array"
    )
    demand(found.shape == shape, who, f"gives shape {found.shape} in {what}, not {shape}")
    demand(found.dtype == np.float64, who, f"gives {found.dtype} in {what}, not float64")
    alone = called(who, what, function, points[1, 2])
    largest = float(np.max(np.abs(found), where=np.isfinite(found), initial=0.0))
    same = np.allclose(alone, found[1, 2], rtol=0.0, atol=_ROUNDING * largest, equal_nan=True)
    demand(same, who, f"gives different values in {what} for a point alone and among others")
    return np.asarray(found)


def check_breaks(who: str, breaks: Any, axes: int) -> None:
    """Demand one ascending run of breaks within (0, 1) for each axis."""
    demand(len(breaks) == axes, who, f"has breaks for {len(breaks)} axes, not {axes}")
    for axis in breaks:
        fits = list(axis) == sorted(set(axis)) and all(0.0 < b < 1.0 for b in axis)
        demand(fits, who, f"has breaks {axis!r}, which do not ascend within (0, 1)")


def point_sets(dims: int) -> Array:
    """Shifted additive recurrences (32, 4096, dims), float64 in [0,1): the same every time.

    The steps are powers of the root of g^(d+1) = g + 1 (M. Roberts 2018, "The unreasonable
    effectiveness of quasirandom sequences"). Each set is uniform under its random shift, so that
    the spread of means over the sets is the error of their mean.
    """
    root = 1.5
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dims + 1))
    steps = root ** -np.arange(1.0, dims + 1)
    shifts = Stream(1).uniforms(0, _SETS, dims).reshape(_SETS, 1, dims)
    points = (shifts + np.arange(_SET_SIZE)[:, None] * steps) % 1.0
    return np.asarray(np.minimum(points, np.nextafter(1.0, 0.0)))


def mean_and_error(values: Array) -> tuple[Array, Array]:
    """Mean of values (sets, points, ...) over both, and its standard error by the spread of sets."""
    means = values.mean(axis=1)
    return means.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(len(means))
