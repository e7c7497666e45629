"""Changes to a study from the command line: ``convergence.realizations=100``, values as in TOML."""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Sequence
from typing import Any

from mcspectra.core.errors import ConfigError

__all__ = ["apply_overrides"]

_STEP = re.compile(r"([A-Za-z][A-Za-z0-9_]*)((?:\[\d{1,6}\])*)")


def apply_overrides(table: dict[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Return a study's table with changes made to it, in their order.

    Parameters
    ----------
    table
        The study as TOML gives it; left as it is.
    overrides
        Texts ``path=value``: the path is keys between dots with indices from 0, such as
        ``estimators[0].density``; the value is one of TOML. A table that is missing is made.

    Raises
    ------
    ConfigError
        A path cannot be read or leads nowhere, or a value is not one of TOML. Whether a study has
        such a key is checked later, with the study.
    """
    changed = copy.deepcopy(table) if overrides else table
    for text in overrides:
        path, equals, value = text.partition("=")
        if not equals:
            raise ConfigError(f"--set {text!r} has no '='; write key=value.")
        _put(changed, _steps(path.strip(), text), _value(value.strip(), text), text)
    return changed


def _steps(path: str, text: str) -> list[str | int]:
    steps: list[str | int] = []
    for part in path.split("."):
        match = _STEP.fullmatch(part)
        if match is None:
            raise ConfigError(
                f"--set {text!r}: {path!r} is not a place in a study; write for example "
                "convergence.realizations or estimators[0].density."
            )
        steps += [match[1], *map(int, re.findall(r"\d+", match[2]))]
    return steps


def _value(value: str, text: str) -> Any:
    """A value of TOML, and nothing after it."""
    try:
        found = tomllib.loads(f"value = {value}\n")
    except (ValueError, RecursionError):
        found = {}
    if list(found) != ["value"]:
        raise ConfigError(
            f"--set {text!r}: {value!r} is not a value of TOML; strings need quotes: key='\"text\"'."
        )
    return found["value"]


def _put(table: dict[str, Any], steps: list[str | int], value: Any, text: str) -> None:
    place: Any = table
    for step, following in zip(steps, [*steps[1:], None], strict=True):
        last = following is None
        if isinstance(step, int):
            if not isinstance(place, list) or step >= len(place):
                raise ConfigError(f"--set {text!r}: {_lack(place, step)}; count from 0.")
        elif not isinstance(place, dict):
            raise ConfigError(f"--set {text!r}: there is no table that could hold {step!r}.")
        elif not last and step not in place:
            place[step] = {}
        if last:
            place[step] = value
        else:
            place = place[step]


def _lack(place: Any, index: int) -> str:
    """Why a place has nothing at an index."""
    if not isinstance(place, list):
        return f"there is no list that could hold [{index}]"
    entries = "1 entry" if len(place) == 1 else f"{len(place)} entries"
    return f"there is no [{index}], the list has {entries}"
