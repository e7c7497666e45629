"""Densities that are made of densities: their parts, as objects or as nested spec strings."""

from __future__ import annotations

import inspect
from typing import Any

from mcspectra.core.errors import ParameterError
from mcspectra.core.spec import parse
from mcspectra.densities.base import Density
from mcspectra.densities.registry import DENSITIES, as_density, density

__all__ = ["MAX_PARTS", "as_part", "as_parts", "with_dims"]

MAX_PARTS = 1024
"""Most parts of a mixture or product."""


def as_parts(given: Any, dims: int) -> tuple[Density, ...]:
    """Return densities from a list of densities and spec strings.

    Parameters
    ----------
    given
        The list, not empty.
    dims
        Number of dims of spec strings without ``dims``.

    Raises
    ------
    ParameterError
        Not a list, empty, more than 1024, or a part is not a density.
    """
    if not isinstance(given, list | tuple) or not 0 < len(given) <= MAX_PARTS:
        raise ParameterError(
            f"parts is {given!r:.80}; give a list of 1 to {MAX_PARTS} densities or spec strings."
        )
    return tuple(as_part(part, dims) for part in given)


def as_part(part: Any, dims: int) -> Density:
    """Return one density; a spec string without dims gets `dims`."""
    if isinstance(part, str):
        call = parse(part)
        takes = "dims" in inspect.signature(DENSITIES.load(call.name)).parameters
        return density(part, dims if takes and "dims" not in call.arguments else None)
    found = as_density(part)
    if found is None:
        raise ParameterError("parts hold None; write 'uniform' for a uniform density.")
    return found


def with_dims(part: Density, default: int = 1) -> str:
    """Spec string of a part, saying its dims where they are not `default` and the class takes any."""
    spec, takes = part.spec, "dims" in inspect.signature(type(part)).parameters
    if part.dims == default or not takes or part.name == "function":
        return spec
    name, bracket, rest = spec.partition("(")
    return f"{name}(dims={part.dims}{', ' + rest if bracket else ')'}"
