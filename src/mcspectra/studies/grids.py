"""Grids: ``{placeholders}`` in a study stand for lists of values, and every combination is made.

Estimators, maps and samplers are repeated for each combination of the placeholders in them; a text
that is nothing but a placeholder becomes the value itself, a number for a number.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

from mcspectra.core.errors import ConfigError, close_match_hint

__all__ = ["MOST_ENTRIES", "expand_grids"]

MOST_ENTRIES = 100_000
"""Most estimators, maps or samplers of one table that grids may make."""

_PLACEHOLDER = re.compile(r"\{([A-Za-z_][A-Za-z0-9_]*)\}")
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

Values = Mapping[str, list[Any]]
Choice = Mapping[str, Any]


def expand_grids(table: dict[str, Any], source: str = "study") -> dict[str, Any]:
    """Return a study's table without grids: all combinations written out.

    Parameters
    ----------
    table
        The study as TOML gives it. A table ``grid`` at the top serves the whole study, one in an
        estimator that estimator, before the one at the top.
    source
        What messages call the study.

    Raises
    ------
    ConfigError
        A grid is no table of lists, a placeholder is not in it or it has one that nothing uses, or
        there would be more than `MOST_ENTRIES` entries.
    """
    shared = _values(table.get("grid"), f"{source}: grid")
    used: set[str] = set()
    made = {key: value for key, value in table.items() if key != "grid"}
    for key in ("estimators", "maps"):
        entries = made.get(key)
        if isinstance(entries, list):
            made[key] = _entries(entries, shared, used, f"{source}: {key}")
    if isinstance(made.get("samplers"), list):
        made["samplers"] = _listed(made["samplers"], shared, used, f"{source}: samplers")
    unused = sorted(set(shared) - used)
    if unused:
        raise ConfigError(
            f"{source}: nothing uses grid.{unused[0]}; write {{{unused[0]}}} where its values go, or "
            "leave it out."
        )
    return made


def _entries(entries: list[Any], shared: Values, used: set[str], source: str) -> list[Any]:
    """Estimators or maps: each repeated over the placeholders outside its list of samplers."""
    made: list[Any] = []
    for index, entry in enumerate(entries):
        if not isinstance(entry, dict):
            made.append(entry)  # a wrong type, which the types of a study report
            continue
        made += _expanded(entry, shared, used, f"{source}[{index}]")
        _check_number(len(made), source)
    return made


def _expanded(entry: dict[str, Any], shared: Values, used: set[str], source: str) -> Iterator[Any]:
    own = _values(entry.get("grid"), f"{source}.grid")
    values = {**shared, **own}
    body = {key: value for key, value in entry.items() if key not in ("grid", "samplers")}
    keys = _keys_in(body, values, source)
    samplers = entry.get("samplers")
    sampler_keys = _keys_in(samplers, values, source)
    for key in own:
        if key not in keys and key not in sampler_keys:
            raise ConfigError(f"{source}: nothing uses grid.{key}; leave it out.")
    used |= {key for key in (*keys, *sampler_keys) if key not in own}
    for choice in _choices(keys, values, source):
        made = _filled(body, choice)
        if isinstance(body.get("name"), str):
            made["name"] = _name(body["name"], choice)
        if isinstance(samplers, list):
            rest = {key: choice.get(key, value) for key, value in values.items()}
            chosen = {k: v if isinstance(v, list) else [v] for k, v in rest.items()}
            made["samplers"] = _listed(samplers, chosen, set(), source)
        elif samplers is not None:
            made["samplers"] = samplers
        yield made


def _listed(texts: list[Any], values: Values, used: set[str], source: str) -> list[Any]:
    """Samplers: each repeated over its own placeholders."""
    made: list[Any] = []
    for text in texts:
        keys = _keys_in(text, values, source)
        used |= set(keys)
        made += [_filled(text, choice) for choice in _choices(keys, values, source)]
        _check_number(len(made), source)
    return made


def _choices(keys: list[str], values: Values, source: str) -> Iterator[dict[str, Any]]:
    _check_number(math.prod(len(values[key]) for key in keys), source)
    for chosen in itertools.product(*(values[key] for key in keys)):
        yield dict(zip(keys, chosen, strict=True))


def _check_number(number: int, source: str) -> None:
    if number > MOST_ENTRIES:
        raise ConfigError(
            f"{source}: the grid makes {number:,} entries; at most {MOST_ENTRIES:,} are made, so "
            "take fewer values, or several studies."
        )


def _keys_in(value: Any, values: Values, source: str) -> list[str]:
    """Placeholders in a value, in the order in which the grid lists them."""
    found = set(_placeholders(value))
    for key in sorted(found - set(values)):
        if values:
            offer, _ = close_match_hint(key, values)
            raise ConfigError(f"{source}: there is no grid.{key} for {{{key}}}.{offer}")
        raise ConfigError(f"{source}: {{{key}}} needs a grid: grid = {{ {key} = [...] }}.")
    return [key for key in values if key in found]


def _placeholders(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield from _PLACEHOLDER.findall(value)
    elif isinstance(value, dict):
        for item in value.values():
            yield from _placeholders(item)
    elif isinstance(value, list):
        for item in value:
            yield from _placeholders(item)


def _filled(value: Any, choice: Choice) -> Any:
    """The value with its placeholders replaced."""
    if isinstance(value, dict):
        return {key: _filled(item, choice) for key, item in value.items()}
    if isinstance(value, list):
        return [_filled(item, choice) for item in value]
    if not isinstance(value, str):
        return value
    whole = _PLACEHOLDER.fullmatch(value)
    if whole is not None and whole[1] in choice:
        return choice[whole[1]]
    return _PLACEHOLDER.sub(lambda match: str(choice[match[1]]), value)


def _name(name: str, choice: Choice) -> str:
    """The name with the values in it; those that it does not mention follow in brackets."""
    mentioned = set(_PLACEHOLDER.findall(name))
    rest = [f"{key}={value}" for key, value in choice.items() if key not in mentioned]
    filled = _PLACEHOLDER.sub(lambda match: str(choice[match[1]]), name)
    return f"{filled} ({', '.join(rest)})" if rest else filled


def _values(grid: Any, source: str) -> dict[str, list[Any]]:
    """Check a table ``grid``."""
    if grid is None:
        return {}
    if not isinstance(grid, dict):
        raise ConfigError(f"{source} is {grid!r}; give a table of lists, {{ width = [0.1, 0.2] }}.")
    for key, values in grid.items():
        if not _KEY.fullmatch(key):
            raise ConfigError(f"{source}: {key!r} is not a name of letters, digits and '_'.")
        if not isinstance(values, list) or not values:
            raise ConfigError(f"{source}.{key} is {values!r}; give a list of one or more values.")
        for value in values:
            if not isinstance(value, str | int | float | bool):
                raise ConfigError(f"{source}.{key} holds {value!r}; give numbers or strings.")
    return grid
