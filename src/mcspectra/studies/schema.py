"""What a study file may say, for readers: JSON Schema, tables of all keys, a study to begin with.

All are made of the structs of `mcspectra.studies.files` and of the analyses that are installed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from mcspectra.core.errors import ConfigError
from mcspectra.core.options import options_of
from mcspectra.studies.files import (
    EstimatorConfig,
    SceneConfig,
    StudyConfig,
    analysis_tables,
)

__all__ = ["SCHEMA_ID", "key_tables", "study_schema", "template", "write_template"]

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
    root, definitions = _definitions()
    schema = {
        "$schema": _DIALECT,
        "$id": SCHEMA_ID,
        "title": "mcspectra study",
        **root,
        "$defs": {name: _with_placeholders(each) for name, each in definitions.items()},
    }
    plain: dict[str, Any] = json.loads(json.dumps(schema))  # lists where msgspec has tuples
    return plain


def _definitions() -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Reference to the study's schema, and schemas of all tables by the names they are referred by."""
    tables = analysis_tables()
    kinds: list[Any] = [StudyConfig, EstimatorConfig, SceneConfig, *tables.values()]
    references, components = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    of = dict(zip(kinds, references, strict=True))
    names = {kind: str(each["$ref"]).rpartition("/")[2] for kind, each in of.items()}
    definitions = {name: components[name] for name in names.values()}
    for kind, name in names.items():
        definitions[name]["description"] = (kind.__doc__ or "").strip().partition("\n")[0]
    study, estimator, scene = (definitions[names[kind]] for kind in kinds[:3])
    own = scene["properties"]
    for table in (study, estimator, scene):
        for key in ("analyses", "scenes", "kind", "analysis"):
            table["properties"].pop(key, None)

    # Tables of analyses at the top, in estimators, and as entries of lists
    for key, kind in tables.items():
        about = {"description": kind.summary()}
        if kind.about == "scene":
            analysis = definitions[names[kind]]
            analysis["properties"] = {**own, **analysis["properties"]}
            analysis["required"] = [*scene["required"], *analysis.get("required", ())]
            study["properties"][key] = {"type": "array", "items": of[kind], **about}
        else:
            for table in (study, estimator):
                table["properties"][key] = {**of[kind], **about}
    del definitions[names[SceneConfig]]
    return of[StudyConfig], definitions


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
    root, definitions = _definitions()
    names = [str(root["$ref"]).rpartition("/")[2], "EstimatorConfig"]
    titles = ["Top of the file", "`[[estimators]]`"]
    for key, kind in analysis_tables().items():
        ...
    return ""


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
