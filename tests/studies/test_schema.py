"""The schema agrees with the reader, and the page on study files agrees with the schema."""

import re
import tomllib
from pathlib import Path

import msgspec
import pytest

from mcspectra.core.errors import ConfigError
from mcspectra.core.options import options_of
from mcspectra.studies import make_plan, read_study, study_schema
from mcspectra.studies.files import (
    BUILT_IN,
    EstimatorConfig,
    StudyConfig,
    analysis_tables,
    decode_study,
)
from mcspectra.studies.schema import SCHEMA_ID, key_tables

ROOT = Path(__file__).parents[2]


def _errors(schema, value, root, place="$"):
    """Return the errors of a small validator for the JSON Schema keywords that msgspec writes."""
    if "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rpartition("/")[2]]
    if "anyOf" in schema:
        tries = [list(_errors(s, value, root, place)) for s in schema["anyOf"]]
        if all(tries):
            yield f"{place}: none of {len(tries)}"
        return
    if "enum" in schema:
        if value not in schema["enum"]:
            yield f"{place}: {value!r} is no choice"
        return
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool, "integer": int,
             "number": (int, float), "null": type(None)}  # fmt: skip
    wrong = isinstance(value, bool) and schema.get("type") in ("integer", "number")
    if "type" in schema and (wrong or not isinstance(value, kinds[schema["type"]])):
        yield f"{place}: {value!r} is no {schema['type']}"
        return
    if isinstance(value, dict):
        known = schema.get("properties", {})
        extra = schema.get("additionalProperties", True)
        yield from (f"{place}: lacks {k}" for k in schema.get("required", ()) if k not in value)
        for key, item in value.items():
            if key not in known and extra is False:
                yield f"{place}: {key}?"
            rule = known.get(key, extra if isinstance(extra, dict) else {})
            yield from _errors(rule, item, root, f"{place}.{key}")
    elif isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            yield f"{place}: {len(value)} items"
        for i, item in enumerate(value):
            yield from _errors(schema.get("items") or {}, item, root, f"{place}[{i}]")
    elif isinstance(value, str):
        if not re.search(schema.get("pattern", ""), value) or len(value) < schema.get(
            "minLength", 0
        ):
            yield f"{place}: {value!r}"
    elif isinstance(value, int | float) and (
        value < schema.get("minimum", value)
        or value > schema.get("maximum", value)
        or value <= schema.get("exclusiveMinimum", value - 1)
    ):
        yield f"{place}: {value!r} is out of range"


def _complaints(text):
    schema = study_schema()
    return list(_errors(schema, tomllib.loads(text), schema))


@pytest.mark.parametrize("file", BUILT_IN.values(), ids=BUILT_IN)
def test_ready_made_studies_are_valid(file):
    assert _complaints(file.read_text(encoding="utf-8")) == []
    assert make_plan(read_study(file), file.parent).cells


def test_there_are_ready_made_studies():
    assert {"tour", "veach", "widths", "remedies", "colour", "penumbra"} <= set(BUILT_IN)


STUDY = """
title = "t"
samplers = ["random"]
[terms]
n = 4
[[estimators]]
name = "a"
integrand = "linear"
dims = 1
"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("n = 4", "n = 0"),
        ("n = 4", "m = 4"),
        ("n = 4", "n = 4.5"),
        ("n = 4", "n = true"),
        ("n = 4", 'n = 4\nspace = "time"'),
        ("dims = 1", "dims = 1025"),
        ("dims = 1", "dims = 1\nsmoothed = 0"),
        ('title = "t"', "titel = 3"),
        ('title = "t"', ""),
        ('"linear"', '""'),
        ('["random"]', '"random"'),
    ],
)
def test_schema_and_reader_refuse_the_same(old, new):
    assert _complaints(STUDY) == []
    decode_study(STUDY)
    assert _complaints(STUDY.replace(old, new))
    with pytest.raises(ConfigError):
        decode_study(STUDY.replace(old, new))


def test_placeholders_may_replace_numbers():
    text = STUDY.replace("dims = 1", 'dims = "{d}"\nsmoothed = "{s}"')
    text += "grid = { d = [1], s = [0.1, 0.2] }\n"
    assert _complaints(text) == []
    assert [each.smoothed for each in decode_study(text).estimators] == [0.1, 0.2]
    assert _complaints(text.replace('"{d}"', '"d"'))


def test_placeholders_may_replace_lists_but_not_single_values():
    text = STUDY.replace("n = 4", 'n = "{n}"\n[predict]\ncounts = "{c}"')
    text = text.replace('["random"]', '"{s}"')
    text += 'grid = { n = [4, 8], c = [[4, 8], [16]], s = [["random"], ["jittered"]] }\n'
    assert _complaints(text) == []
    assert len(decode_study(text).estimators) == 8
    for key in ("seed", "time_limit"):
        varied = f'{key} = "{{n}}"\n{text}'
        assert _complaints(varied)
        with pytest.raises(ConfigError, match=f"{key} is '{{n}}', but a study has a single value"):
            decode_study(varied)
    assert _complaints(f'maps = "{{n}}"\n{text}')


def test_the_schema_describes_itself_and_its_keys():
    schema = study_schema()
    assert schema["$id"] == SCHEMA_ID
    for own in schema["$defs"].values():
        assert all(each.get("description") for each in own["properties"].values()), own
        assert own["additionalProperties"] is False
    assert msgspec.json.decode(msgspec.json.encode(schema)) == schema


def test_tables_of_analyses_are_the_registered_analyses():
    schema = study_schema()
    study, estimator = (schema["$defs"][each.__name__] for each in (StudyConfig, EstimatorConfig))
    for key, kind in analysis_tables().items():
        about = study["properties"][key]
        own = schema["$defs"][about.get("$ref", about.get("items", {}).get("$ref"))[8:]]
        assert about["description"] == own["description"] == kind.summary()
        assert (key in estimator["properties"]) == (kind.about != "scene")
        for option in options_of(kind):
            found = own["properties"][option.name]
            assert found["description"] == option.meaning
            assert (option.name in own.get("required", ())) == option.required
            if not option.required:
                wanted = (
                    list(option.default) if isinstance(option.default, tuple) else option.default
                )
                assert found["default"] == wanted


def test_the_page_has_all_keys():
    page = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8")
    assert key_tables().strip() in page, "run: mcspectra init --schema --markdown"


def test_the_studies_in_the_page_are_studies():
    page = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    plan = make_plan(decode_study(text), ROOT)
    assert [cell.estimator_name for cell in plan.cells[::2]] == [
        "gaussian of width 0.1", "gaussian of width 0.2"
    ]  # fmt: skip
