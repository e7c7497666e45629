"""Describe study files for readers: JSON Schema, tables of all keys, and a template.

The schema, the tables and the template are made from two sources:
the structs of `mcspectra.studies.files`, and the options of the installed analyses.
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import msgspec

from mcspectra.core.display import shown
from mcspectra.core.errors import ConfigError, McspectraError
from mcspectra.core.options import Option, options_of
from mcspectra.studies.files import (
    RESERVED,
    EstimatorConfig,
    SceneConfig,
    StudyConfig,
    analysis_tables,
)

__all__ = ["SCHEMA_ID", "key_tables", "study_schema", "template", "write_template"]

SCHEMA_ID = "urn:mcspectra:study:1"
"""Identifier of the schema; its number changes when older studies cannot be read any more."""

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_PLACEHOLDER = {"type": "string", "pattern": r"^\{[A-Za-z_][A-Za-z0-9_]*\}$"}
_NO_TEXT = ("integer", "number", "boolean")
_NO_PLACEHOLDER = ("grid", "seed", "time_limit")  # Keys that must not contain "{placeholder}"
# Example values of two required options, for the template of a study.
# Other options get their first choice; without choices, "16,64", 64, 0.5 and a name are tried.
_EXAMPLES = {"target_error": ("0.01",), "budget": ("4096",)}
_TEMPLATE = Path(__file__).with_name("template.toml")
# Line of the template that is replaced by a list of all analyses that are not in the template.
_OTHERS = "# {other analyses}\n"


def study_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of study files.

    A grid's ``"{placeholder}"`` may replace any number, list, choice or Boolean.
    """
    tables = _tables()
    schema: dict[str, Any] = {
        "$schema": _DIALECT,
        "$id": SCHEMA_ID,
        "title": "mcspectra study",
        "$ref": f"#/$defs/{tables[''][0]}",
        "$defs": {},
    }
    for name, table in tables.values():
        properties = {
            key: value if key in _NO_PLACEHOLDER else _or_placeholder(value)
            for key, value in table["properties"].items()
        }
        schema["$defs"][name] = {**table, "properties": properties}
    plain: dict[str, Any] = json.loads(json.dumps(schema))  # JSON turns tuples into lists
    return plain


def _tables() -> dict[str, tuple[str, dict[str, Any]]]:
    """Return the names and schemas of all tables by key; the top of the file has an empty key."""
    analyses = analysis_tables()
    own = {"": StudyConfig, "estimators": EstimatorConfig}
    kinds: list[Any] = [*own.values(), *analyses.values(), SceneConfig]
    references, components = msgspec.json.schema_components(kinds, ref_template="{name}")
    names = [str(reference["$ref"]) for reference in references]
    found = {key: (n, components[n]) for key, n in zip((*own, *analyses), names, strict=False)}
    for kind, (_, table) in zip(kinds, found.values(), strict=False):
        table["description"] = (kind.__doc__ or "").strip().partition("\n")[0]
        for option in options_of(kind):
            if option.choices and "anyOf" not in table["properties"][option.name]:
                table["properties"][option.name] |= {"type": "string", "enum": option.choices}

    # Tables of analyses may be at the top of a study and in an estimator.
    # An analysis of scenes has a list of tables at the top, such as [[maps]]
    scene = _public(components[names[-1]])
    study, estimator = _public(found[""][1]), _public(found["estimators"][1])
    study["properties"]["estimators"]["items"] = {"$ref": f"#/$defs/{names[1]}"}
    for key, kind in analyses.items():
        name, table = found[key]
        reference, about = {"$ref": f"#/$defs/{name}"}, {"description": kind.summary()}
        if kind.about == "scene":
            table["properties"] = {**scene["properties"], **table["properties"]}
            table["required"] = [*scene["required"], *table.get("required", ())]
            study["properties"][key] = {"type": "array", "items": reference, **about}
        else:
            for each in (study, estimator):
                each["properties"][key] = {**reference, **about}
    return found


def _public(table: dict[str, Any]) -> dict[str, Any]:
    """Remove the internal fields that a file cannot set."""
    for key in RESERVED:
        table["properties"].pop(key, None)
    return table


def _or_placeholder(value: dict[str, Any]) -> dict[str, Any]:
    """Extend the schema of a key to allow a placeholder, unless the schema already allows text."""
    about = {k: v for k, v in value.items() if k in ("description", "default")}
    found = {k: v for k, v in value.items() if k not in about}
    choices, taken = [], False
    for each in found.get("anyOf", [found]):
        items = each.get("items")
        listed = isinstance(items, dict)
        choices += [{**each, "items": _or_placeholder(items)} if listed else each]
        tables = listed and "$ref" in items
        # A placeholder may stand for a number, a choice, a Boolean or a list
        taken |= "enum" in each or (each.get("type") in (*_NO_TEXT, "array") and not tables)
    return {**about, "anyOf": [*choices, _PLACEHOLDER]} if taken else value


def key_tables() -> str:
    """Return types, defaults and meanings of all keys as Markdown, one table per TOML table."""
    lines = []
    for key, (_, table) in _tables().items():
        listed = key == "estimators" or "name" in table["properties"]
        title = f"`[[{key}]]`" if listed else f"`[{key}]`" if key else "Top of the file"
        lines += [f"### {title}\n", f"{table['description']}\n"]
        lines += ["| key | type | default | meaning |\n| --- | --- | --- | --- |"]
        required = table.get("required", ())
        for name, value in table["properties"].items():
            default = "required" if name in required else "–"
            if name not in required and value.get("default") not in (None, [], ()):
                default = f"`{json.dumps(value['default'], ensure_ascii=False)}`"
            meaning = value.get("description", "").replace("|", "\\|")
            lines += [f"| `{name}` | {_type(value)} | {default} | {meaning} |"]
        lines += [""]
    return "\n".join(lines)


def _type(value: dict[str, Any]) -> str:
    """Describe a type in words."""
    if "anyOf" in value:
        return " or ".join(_type(v) for v in value["anyOf"] if v.get("type") != "null")
    if "enum" in value:
        return " or ".join(f"`{json.dumps(v)}`" for v in value["enum"] if v is not None)
    if "$ref" in value:
        return "table"
    kind = str(value.get("type", "value"))
    if kind == "array":
        items: dict[str, Any] = value.get("items") or next(iter(value.get("prefixItems", ())), {})
        inner = _type(items) if items else "values"
        return f"list of ({inner})" if " or " in inner else f"list of {inner}"
    words = {"object": "table", "boolean": "true or false", "string": "text"}
    rules = [f"≥ {value['minimum']:g}"] if "minimum" in value else []
    rules += [f"> {value['exclusiveMinimum']:g}"] if "exclusiveMinimum" in value else []
    # Leave out limits of 2^31 or more, which only ensure that numbers fit into 64 bits
    high = value.get("maximum", 2**31)
    rules += [f"≤ {high:g}"] if high < 2**31 else []
    return " ".join([words.get(kind, kind), ", ".join(rules)]).rstrip()


def template() -> str:
    """Return a study to start from; it runs unchanged, and its comments show more options."""
    text, lines = _TEMPLATE.read_text(encoding="utf-8"), []
    for key, kind in analysis_tables().items():
        if kind.about != "scene" and f"[{key}]" not in text:
            lines += [f"{f'# [{key}]':<31}# {kind.summary()}"]
            needed = [option for option in options_of(kind) if option.required]
            lines += [f"# {option.name} = {_example(option)}" for option in needed] + [""]
    return text.replace(_OTHERS, "\n".join([*lines, ""]))


def _example(option: Option) -> str:
    """Return a valid value of an option."""
    own = _EXAMPLES.get(option.name, ())
    for text in (*own, *(option.choices[:1] or ("16,64", "64", "0.5", "name"))):
        with contextlib.suppress(McspectraError):
            value = option.read(text)
            return json.dumps(list(value) if isinstance(value, tuple) else value)
    return "..."


def write_template(path: str | Path) -> Path:
    """Write the template to a new file.

    Raises
    ------
    ConfigError
        If the file exists, or it cannot be written.
    """
    file = Path(path)
    if file.suffix != ".toml":
        raise ConfigError(f"{shown(str(file))} must end in .toml, as study files do.")
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(template())
    except FileExistsError:
        raise ConfigError(f"{shown(str(file))} already exists; give another name.") from None
    except OSError as error:
        raise ConfigError(f"{shown(str(file))} cannot be written: {error.strerror}.") from None
    return file
