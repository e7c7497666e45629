"""Tuning numbers of algorithms are fields of settings with a comment that gives the reason."""

import ast
from pathlib import Path

import pytest

import mcspectra

ROOMS = ("measure", "explain", "improve", "improve/designs", "profiler")
# Numbers that are not tuned: limits of float64, levels of intervals, rates of theory, labels of
# streams, the tile of a kernel, a definition
FACTS = {
    *("_EDGE", "_LEVEL", "_SIDE", "_RATES", "_TILE", "_START", "_PARTNER", "_ORDER", "_UNIFORM"),
    *("EFFECTIVE_SHARE", "UNDECIDED", "SHARED_SETS", "_PILOTS", "_PARTS", "_VERSION", "_ENDLESS"),
}
MODULES = [
    path for room in ROOMS for path in sorted((Path(mcspectra.__file__).parent / room).glob("*.py"))
]


def is_number(node):
    """Return whether an expression consists of numbers alone."""
    leaves = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.Tuple, ast.operator, ast.unaryop, ast.Load)
    numbers = [each for each in ast.walk(node) if isinstance(each, ast.Constant)]
    return (
        bool(numbers)
        and all(isinstance(each, leaves) for each in ast.walk(node))
        and all(isinstance(each.value, int | float) for each in numbers)
    )


@pytest.mark.parametrize("path", MODULES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_numbers_of_a_module_are_fields_of_settings(path):
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and is_number(node.value):
            for target in node.targets:
                names = target.elts if isinstance(target, ast.Tuple) else [target]
                found |= {name.id for name in names}
    assert found <= FACTS


@pytest.mark.parametrize("path", MODULES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_fields_of_settings_are_frozen_and_have_a_comment(path):
    text = path.read_text()
    lines = text.splitlines()
    for node in ast.parse(text).body:
        if not (isinstance(node, ast.ClassDef) and node.name.endswith("Settings")):
            continue
        assert "dataclass(frozen=True)" in [ast.unparse(each) for each in node.decorator_list]
        fields = [each for each in node.body if isinstance(each, ast.AnnAssign)]
        assert fields
        # Fields with a common reason follow each other below one comment
        above = {each.end_lineno for each in fields}
        for each in fields:
            before = lines[each.lineno - 2].strip()
            assert before.startswith("# ") or each.lineno - 1 in above, each.target.id
