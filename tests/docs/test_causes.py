"""The page of causes: every cause is on it, with the thresholds and remedies of the code."""

import ast
import re
from dataclasses import fields
from pathlib import Path
from typing import get_args

import pytest

from mcspectra.estimators.tails import TAIL_SETTINGS
from mcspectra.explain import causes
from mcspectra.explain.causes import CAUSE_SETTINGS, Name
from mcspectra.explain.probing import LINE_SETTINGS, POLE_SETTINGS
from mcspectra.improve.candidates import KINDS
from mcspectra.measure.chains import CHAIN_SETTINGS

PAGE = (Path(__file__).parents[2] / "docs" / "causes.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^### ([\w-]+)\n\n((?:[*] .*\n|  .*\n)+)", PAGE, re.MULTILINE))
SETTINGS = {
    type(each).__name__: each
    for each in (CAUSE_SETTINGS, LINE_SETTINGS, POLE_SETTINGS, CHAIN_SETTINGS, TAIL_SETTINGS)
}


def kinds_of_code():
    """Return the kinds of remedies by cause, from calls of ``Cause``."""
    found = {}
    tree = ast.parse(Path(causes.__file__).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Cause":
            names = [n.value for n in ast.walk(node.args[0]) if isinstance(n, ast.Constant)]
            kinds = [
                n.value
                for each in node.args[3:]
                for n in ast.walk(each)
                if isinstance(n, ast.Constant)
            ]
            for name in names:
                found.setdefault(name, set()).update(
                    k for k in kinds if k in KINDS or k == "sampler"
                )
    return found


def test_each_cause_has_a_section_with_all_parts():
    assert set(SECTIONS) == set(get_args(Name))
    for name, text in SECTIONS.items():
        parts = re.findall(r"^[*] (\w+): \S", text, re.MULTILINE)
        assert parts == ["Test", "Threshold", "Rate", "Remedy", "Picture"], name


@pytest.mark.parametrize("name", get_args(Name))
def test_thresholds_match_the_settings(name):
    for kind, field, value in re.findall(r"`(\w+)\.(\w+) = ([\d.e-]+)`", SECTIONS[name]):
        assert field in {each.name for each in fields(SETTINGS[kind])}, field
        assert getattr(SETTINGS[kind], field) == float(value), field


def test_remedies_match_the_detectors():
    for name, kinds in kinds_of_code().items():
        remedy = re.search(r"^[*] Remedy: ([^*]*)", SECTIONS[name], re.MULTILINE)[1]
        named = set(re.findall(r"`([\w-]+)`", remedy))
        assert kinds <= named, name
