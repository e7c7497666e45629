"""Grids: ``{placeholders}`` in a study stand for lists of values, and every combination is made.

Estimators, maps and samplers are repeated for each combination of the placeholders in them, and in
the study's tables of analyses that they take; a text that is nothing but a placeholder becomes the
value itself, a number for a number, a list for a list.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from mcspectra.core.errors import ConfigError, close_match_hint
from mcspectra.studies.tables import ANALYSIS_TABLES

__all__ = ["MOST_ENTRIES", "expand_grids"]

MOST_ENTRIES = 100_000
"""Most estimators, maps or samplers of one table that grids may make."""

_PLACEHOLDER = re.compile(r"\{([A-Za-z_][A-Za-z0-9_]*)\}")
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

_SINGLE = ("seed", "time_limit")

Values = Mapping[str, list[Any]]
Choice = Mapping[str, Any]


def expand_grids(table: dict[str, Any], source: str = "study") -> dict[str, Any]:
    """Return a study's table without grids: all combinations written out.

    Parameters
    ----------
    table
        The study as TOML gives it. A table ``grid`` at the top serves the whole study, one in an
        estimator that estimator, before the one at the top. A table of an analysis with placeholders
        at the top goes into each estimator that has none of its own.
    source
        What messages call the study.

    Raises
    ------
    ConfigError
        A grid is no table of lists, a placeholder is not in it, or where there can be one value only,
        or the grid has one that nothing uses, or there would be more than `MOST_ENTRIES` entries.
    """
    shared = _values(table.get("grid"), f"{source}: grid")
    used: set[str] = set()
    made = _inherited({key: value for key, value in table.items() if key != "grid"})
    _check_single(made, source)
    for key in ("estimators", "maps"):
        entries = made.get(key)
        if isinstance(entries, list):
            made[key] = _entries(entries, shared, used, f"{source}: {key}")
    if isinstance(made.get("samplers"), list):
        made["samplers"] = _listed(made["samplers"], shared, used, f"{source}: samplers")
    _check_used(shared, used, source)
    return made


def _inherited(table: dict[str, Any]) -> dict[str, Any]:
    """Move tables of analyses with placeholders into the estimators that have none of their own.

    So too a placeholder in place of the list of samplers, which maps take as well.
    """
    asked = {k: v for k, v in table.items() if k in ANALYSIS_TABLES and isinstance(v, dict)}
    takers = [each for each in _list(table.get("estimators")) if isinstance(each, dict)]
    moved = {key: value for key, value in asked.items() if takers and any(_placeholders(value))}
    takers += [each for each in _list(table.get("maps")) if isinstance(each, dict)]
    samplers = table.get("samplers") if takers else None
    listed = {"samplers": samplers} if isinstance(samplers, str) and _whole(samplers) else {}
    kept = {key: value for key, value in table.items() if key not in {**moved, **listed}}
    for key, given in (("estimators", {**moved, **listed}), ("maps", listed)):
        if entries := _list(kept.get(key)):
            kept[key] = [{**given, **each} if isinstance(each, dict) else each for each in entries]
    return kept


def _list(value: Any) -> list[Any]:
    """A list as it is; nothing of what is none, which the types of a study report."""
    return value if isinstance(value, list) else []


def _check_single(table: dict[str, Any], source: str) -> None:
    """Refuse placeholders where a study has one value for all of its estimators."""
    for key in _SINGLE:
        if any(_placeholders(table.get(key))):
            raise ConfigError(
                f"{source}: {key} is {table[key]!r}, and a study has one; take a study for each "
                f"value, as with --set {key}=..."
            )


def _check_used(values: Values, used: Collection[str], source: str) -> None:
    for key in values:
        if key not in used:
            _, close = close_match_hint(key, used)
            offer = f" Did you mean {' or '.join(map(repr, close))}?" if close else ""
            raise ConfigError(
                f"{source}: nothing uses grid.{key}; write {{{key}}} where its values go, or leave it "
                f"out.{offer}"
            )


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
    listed = isinstance(entry.get("samplers"), list)
    samplers = entry["samplers"] if listed else []
    apart = ("grid", "samplers") if listed else ("grid",)
    body = {key: value for key, value in entry.items() if key not in apart}
    keys = _keys_in(body, values, source)
    sampler_keys = _keys_in(samplers, values, source)
    _check_used(own, {*keys, *sampler_keys}, source)
    used |= {key for key in (*keys, *sampler_keys) if key not in own}
    for choice in _choices(keys, values, source):
        made = _filled(body, choice)
        if isinstance(body.get("name"), str):
            made["name"] = _name(body["name"], choice)
        if listed:
            chosen = {**values, **{key: [value] for key, value in choice.items()}}
            made["samplers"] = _listed(samplers, chosen, set(), source)
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
    whole = _whole(value)
    if whole is not None and whole[1] in choice:
        return choice[whole[1]]
    return _PLACEHOLDER.sub(lambda match: str(choice[match[1]]), value)


def _whole(text: str) -> re.Match[str] | None:
    """The placeholder that a text is, and nothing else."""
    return _PLACEHOLDER.fullmatch(text)


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
            _check_value(value, f"{source}.{key}")
    return grid


def _check_value(value: Any, source: str) -> None:
    if isinstance(value, list):
        for item in value:
            _check_value(item, source)
    elif not isinstance(value, str | int | float | bool):
        raise ConfigError(f"{source} holds {value!r}; give numbers, strings, or lists of them.")
    elif isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{source} holds {value!r}; give finite numbers.")
