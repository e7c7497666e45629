"""Fields of frozen dataclasses. The fields check and convert their values.

A class declares, for example, ``strength: int = whole(1, least=1, most=2)``.
When an instance is created, `check_fields` replaces each given value by the checked value.
The base class `mcspectra.core.spec.Component` calls `check_fields`.
Samplers, densities, integrands and similar classes derive from this base class.
None stays None if it is the default of the field.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from mcspectra.core.checks import as_choice, as_integer, as_real
from mcspectra.core.display import shown
from mcspectra.core.errors import ParameterError

__all__ = ["check_fields", "checked", "choice", "each_axis", "flag", "real", "settle", "whole"]


def checked(
    check: Callable[..., object], default: object = dataclasses.MISSING, *, using: str | None = None
) -> Any:
    """Declare a field whose value is ``check(name, given)``.

    If `using` names an attribute such as ``dims``, the value is ``check(name, given, dims)``.
    """
    return dataclasses.field(default=default, metadata={"check": check, "using": using})


def whole(
    default: int | Any | None = dataclasses.MISSING, *, least: int, most: int | None = None
) -> Any:
    """Declare a field of whole numbers, with a smallest and a largest allowed number."""
    return checked(lambda name, given: as_integer(name, given, least=least, most=most), default)


def real(default: float | Any | None = dataclasses.MISSING, **limits: float) -> Any:
    """Declare a field of finite floats, with the same limits as in `core.checks.as_real`."""
    return checked(lambda name, given: as_real(name, given, **limits), default)


def choice(*allowed: str, default: str | None = None) -> Any:
    """Declare a field that holds one of several words. The first word is the default."""
    return checked(lambda name, given: as_choice(name, given, allowed), default or allowed[0])


def flag(*, default: bool) -> Any:
    """Declare a field of True or False."""
    return checked(_as_flag, default)


def _as_flag(name: str, given: object) -> bool:
    if not isinstance(given, bool):
        raise ParameterError(f"{name} is {shown(given)}; give True or False.")
    return given


def each_axis(parameter: str) -> Any:
    """Declare a property: the values (d,) of a parameter, given as one number or one per axis."""
    return property(
        lambda own: np.broadcast_to(np.asarray(getattr(own, parameter), float), own.dims)
    )


def check_fields(component: Any) -> None:
    """Check all declared fields of an instance, with `dims` first because others depend on it."""
    for field in sorted(dataclasses.fields(component), key=lambda field: field.name != "dims"):
        check, given = field.metadata.get("check"), getattr(component, field.name)
        if check and not (given is None and field.default is None):
            using = field.metadata["using"]
            more = [getattr(component, using)] if using else []
            settle(component, **{field.name: check(field.name.rstrip("_"), given, *more)})


def settle(component: object, **values: object) -> None:
    """Set attributes of a frozen dataclass while it is being created."""
    for name, value in values.items():
        object.__setattr__(component, name, value)
