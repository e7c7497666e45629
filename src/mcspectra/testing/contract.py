"""Shared parts of the checks: their error, guarded calls of user code, sets of points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import McspectraError
from mcspectra.core.streams import Stream

__all__ = ["BrokenContract", "breaks_problem", "called", "demand", "mean_and_error", "point_sets"]

_SETS, _SET_SIZE = 32, 4096


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


def breaks_problem(breaks: Any, axes: int) -> str | None:
    """A sentence where `breaks` are not one ascending run within (0, 1) for each axis, else None."""
    if len(breaks) != axes:
        return f"has breaks for {len(breaks)} axes, not {axes}"
    for axis in breaks:
        if list(axis) != sorted(set(axis)) or not all(0.0 < b < 1.0 for b in axis):
            return f"has breaks {axis!r}, which do not ascend within (0, 1)"
    return None


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
