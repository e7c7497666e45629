"""The JSON Schema of study files, and their keys as Markdown tables, both made of the structs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import msgspec

from mcspectra.studies.tables import (
    ANALYSIS_TABLES,
    EstimatorConfig,
    MapConfig,
    StudyConfig,
)

__all__ = ["SCHEMA_ID", "key_tables", "study_schema"]

SCHEMA_ID = "urn:mcspectra:study:1"
"""Identifier of the schema; the number changes when an older study would no longer be read."""

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_PLACEHOLDER = {"type": "string", "pattern": r"^\{[A-Za-z_][A-Za-z0-9_]*\}$"}
_NO_TEXT = ("integer", "number", "boolean")
_NO_PLACEHOLDER = ("grid", "seed", "time_limit")  # a study has one


def study_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of study files.

    Where a number, a list, a choice, true or false stands, so may a grid's ``"{placeholder}"``.
    """
    (root,), components = msgspec.json.schema_components(
        [StudyConfig], ref_template="#/$defs/{name}"
    )
    definitions = {name: _with_placeholders(each) for name, each in components.items()}
    schema = {
        "$schema": _DIALECT,
        "$id": SCHEMA_ID,
        "title": "mcspectra study",
        **root,
        "$defs": definitions,
    }
    plain: dict[str, Any] = json.loads(json.dumps(schema))  # lists where msgspec has tuples
    return plain


def _with_placeholders(table: dict[str, Any]) -> dict[str, Any]:
    """A table's schema in which a placeholder may stand where text could not."""
    properties = {
        key: value if key in _NO_PLACEHOLDER else _or_placeholder(value)
        for key, value in table.get("properties", {}).items()
    }
    return {**table, "properties": properties}


def _or_placeholder(value: dict[str, Any]) -> dict[str, Any]:
    found = {k: v for k, v in value.items() if k not in ("description", "default")}
    about = {k: v for k, v in value.items() if k in ("description", "default")}
    choices = [_of_values(each) for each in found.get("anyOf", [found])]
    if any(_is_value(each) for each in choices):
        return {**about, "anyOf": [*choices, _PLACEHOLDER]}
    return value


def _is_value(found: dict[str, Any]) -> bool:
    """Whether it is a number, a choice, true or false, or a list of values."""
    items = found.get("items")
    tables = isinstance(items, dict) and "$ref" in items
    return (found.get("type") in (*_NO_TEXT, "array") and not tables) or "enum" in found


def _of_values(found: dict[str, Any]) -> dict[str, Any]:
    """A list's schema with placeholders for its items, any other as it is."""
    items = found.get("items")
    return {**found, "items": _or_placeholder(items)} if isinstance(items, dict) else found


def key_tables() -> str:
    """Return all keys with types, defaults and meanings as Markdown, a table for each table."""
    tables: dict[str, type[Any]] = {
        "Top of the file": StudyConfig,
        "`[[estimators]]`": EstimatorConfig,
        **{f"`[{name}]`": table for name, table in ANALYSIS_TABLES.items()},
        "`[[maps]]`": MapConfig,
    }
    return "\n".join(line for title, each in tables.items() for line in _key_table(title, each))


def _key_table(title: str, table: type[Any]) -> Iterator[str]:
    yield f"### {title}\n\n{(table.__doc__ or '').strip().splitlines()[0]}\n"
    yield "| key | type | default | meaning |\n| --- | --- | --- | --- |"
    (_,), components = msgspec.json.schema_components([table], ref_template="{name}")
    own = components[table.__name__]
    required = own.get("required", ())
    for key, value in own["properties"].items():
        default = "required" if key in required else _default(value.get("default"))
        meaning = value.get("description", "").replace("|", "\\|")
        yield f"| `{key}` | {_type(value)} | {default} | {meaning} |"
    yield ""


def _default(value: Any) -> str:
    return "–" if value in (None, [], ()) else f"`{json.dumps(value, ensure_ascii=False)}`"


def _type(value: dict[str, Any]) -> str:
    """A type in words."""
    if "anyOf" in value:
        return " or ".join(_type(v) for v in value["anyOf"] if v.get("type") != "null")
    if "enum" in value:
        return " or ".join(f"`{json.dumps(v)}`" for v in value["enum"] if v is not None)
    if "$ref" in value:
        return "table"
    kind = str(value.get("type", "value"))
    if kind == "array":
        items: dict[str, Any] = value.get("items") or next(iter(value.get("prefixItems", ())), {})
        return f"list of {_type(items) if items else 'values'}"
    words = {"object": "table", "boolean": "true or false", "string": "text"}
    return words.get(kind, kind) + _range(value)


def _range(value: dict[str, Any]) -> str:
    low = [f"≥ {value['minimum']:g}"] if "minimum" in value else []
    low += [f"> {value['exclusiveMinimum']:g}"] if "exclusiveMinimum" in value else []
    # A limit that only keeps numbers within 64 bits is no news to a reader.
    high = value.get("maximum", 2**31)
    rules = [*low, *([f"≤ {high:g}"] if high < 2**31 else [])]
    return f" {', '.join(rules)}" if rules else ""
