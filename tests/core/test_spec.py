"""Spec strings: accepted forms, rejection without evaluation, and conversion back to text."""

import re
import warnings
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcspectra.core.errors import SpecError
from mcspectra.core.spec import Call, Component, format_call, parse, parse_chain


@dataclass(frozen=True, kw_only=True)
class Sample(Component):
    """First line.

    Second line.
    """

    name: ClassVar[str] = "sample-2d"
    dims: int = 2
    width: Any = 1.0
    scale_: Any = None
    values: Any = field(default_factory=list)


@pytest.mark.parametrize(
    ("text", "calls"),
    [
        ("jittered", [("jittered", {})]),
        ("  jittered ( ) ", [("jittered", {})]),
        ("rank1-lattice(vector=[1, 3])", [("rank1-lattice", {"vector": [1, 3]})]),
        ("a(x=1,)", [("a", {"x": 1})]),
        ("a(x=-1.5e-3, y='s')", [("a", {"x": -0.0015, "y": "s"})]),
        ("a(x=None, y=True)", [("a", {"x": None, "y": True})]),
        ("a(x=(1, [2, (3,)]))", [("a", {"x": (1, [2, (3,)])})]),
        ("a|b|c", [("a", {}), ("b", {}), ("c", {})]),
        ("a\n| b(\nx=1\n)", [("a", {}), ("b", {"x": 1})]),
        ("a(p='x|y') | b", [("a", {"p": "x|y"}), ("b", {})]),
        ("a(p='x)(') | b", [("a", {"p": "x)("}), ("b", {})]),
        ('a(p="it\'s|") | b', [("a", {"p": "it's|"}), ("b", {})]),
        (r"a(p='\'|[') | b", [("a", {"p": "'|["}), ("b", {})]),
        ("a(f='b(x=[1|2])')", [("a", {"f": "b(x=[1|2])"})]),
        ("a(f='b(f=\"c | d\")', g=2) | e", [("a", {"f": 'b(f="c | d")', "g": 2}), ("e", {})]),
        ("a(x={'k': [1]})", [("a", {"x": {"k": [1]}})]),
    ],
)
def test_valid_specs_are_read(text, calls):
    assert parse_chain(text) == [Call(name, arguments) for name, arguments in calls]


def test_a_nested_spec_is_parsed_in_its_turn():
    outer = parse("outer(inner='mid(inner=\"core(x=[1, 2])\")')")
    middle = parse(outer.arguments["inner"])
    assert parse(middle.arguments["inner"]) == Call("core", {"x": [1, 2]})


@pytest.mark.parametrize(
    "value",
    [
        "__import__('os').getpid()",
        "open('x')",
        "lambda: 1",
        "f'{1}'",
        "[x for x in (1, 2)]",
        "name",
        "nan",
        "a.b",
        "[1, 2][0]",
        "9**9**9",
        "1 if True else 2",
        "not 1",
        "'a' * 3",
        "(y := 1)",
        "*[1]",
        "`1`",
        "yield",
        "1; 2",
        "$HOME",
    ],
)
def test_nothing_is_evaluated(value):
    with pytest.raises(SpecError) as caught:
        parse_chain(f"a(x={value})")
    assert_one_sentence(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "does not start with a name"),
        ("  ", "does not start with a name"),
        ("|", "does not start with a name"),
        ("a|", "does not start with a name"),
        ("a||b", "does not start with a name"),
        ("Jittered", "names in lower case"),
        ("2d", "does not start with a name"),
        ("-a", "does not start with a name"),
        ("é", "does not start with a name"),
        ("a--b", "not of the form"),
        ("a_b", "not of the form"),
        ("a b", "not of the form"),
        ("a()b", "not of the form"),
        ("a()(x=1)", "not of the form"),
        ("a.b(x=1)", "not of the form"),
        ("a[x=1]", "not of the form"),
        ("a(", "opens a bracket"),
        ("a(x=[1)", "opens a bracket|not key=value"),
        ("a(x='1)", "opens a quote"),
        ("a)", "closes a bracket that it did not open, at character 2"),
        ("a(x=1))", "at character 7"),
        ("a(x=(1]))", "closes a bracket|not key=value"),
        ("a(1)", "was given 1 without a name; write parameter=1, with the name of"),
        ("a(x)", "was given x without a name"),
        ("a(*[1])", "without a name"),
        ("a(**{'x': 1})", r"'\*\*'"),
        ("a(x=1, x=2)", "x twice"),
        ("a(x==1)", "without a name"),
        ("a(x=)", "not key=value"),
        ("a(,)", "not key=value"),
        ("a(x=1 y=2)", "not key=value"),
        ("a(2x=1)", "not key=value"),
        ("a(x='\0')", "not key=value|not a literal"),
        ("a(x='\ud800')", "not key=value"),
        ("a(x=" + "9" * 5000 + ")", "not key=value"),
    ],
)
def test_invalid_specs_are_rejected(text, words):
    with pytest.raises(SpecError, match=words) as caught:
        parse_chain(text)
    assert_one_sentence(caught.value)


@pytest.mark.parametrize("text", [None, 5, b"jittered", ["jittered"], object()])
def test_specs_that_are_not_strings_are_rejected(text):
    with pytest.raises(SpecError, match="give a string such as"):
        parse_chain(text)


def test_one_call_where_one_is_wanted():
    assert parse("a(x=1)") == Call("a", {"x": 1})
    with pytest.raises(SpecError, match="chains 2 parts"):
        parse("a | b")


@pytest.mark.parametrize("depth", [50, 150, 400, 900, 9000])
@pytest.mark.parametrize(
    "pattern",
    ["a(x={0}1)", "a({0}1)", "a(x=1{1})", "a(1{1})", "a(x={2}{3})", "a({2}{3})", "{2}", "{3}"],
)
def test_deep_input_is_read_or_refused(pattern, depth):
    """Neither the parser's nor Python's recursion limit may appear in the message."""
    text = pattern.format("-" * depth, "+1" * depth, "[" * depth, "]" * depth)
    try:
        calls = parse_chain(text)
    except SpecError as error:
        assert_one_sentence(error)
    else:
        assert [call.name for call in calls] == ["a"]


def test_huge_input_is_refused_before_it_is_read():
    with pytest.raises(SpecError, match="at most 20000"):
        parse_chain("a(x=[" + "1," * 10**6 + "])")
    assert len(parse_chain(" | ".join(["a"] * 1000))) == 1000


def assert_one_sentence(error):
    text = str(error)
    assert "\n" not in text
    assert text.endswith(".")
    assert len(text) < 400, "the message repeats too much of the input"


LITERALS = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**80), 2**80)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text("ab|(", max_size=3), inner, max_size=2)
    ),
    max_leaves=8,
)


@settings(derandomize=True, deadline=None, max_examples=200)
@given(width=LITERALS, scale=LITERALS, values=LITERALS)
def test_a_component_is_made_again_from_its_spec(width, scale, values):
    made = Sample(width=width, scale_=scale, values=values)
    (call,) = parse_chain(made.spec)
    assert call.name == "sample-2d"
    renamed = {{"scale": "scale_"}.get(k, k): v for k, v in call.arguments.items()}
    assert Sample(**renamed) == made


@settings(derandomize=True, deadline=None, max_examples=300)
@given(st.text("ab1-_ |()[]{}'\"\\=,.\n#*:", max_size=40))
def test_any_text_is_read_or_refused_in_a_sentence(text):
    with warnings.catch_warnings():
        # While parsing, Python warns about escapes such as '\a' and numbers such as 1or 2.
        warnings.simplefilter("ignore")
        try:
            calls = parse_chain(text)
        except SpecError as error:
            assert_one_sentence(error)
        else:
            assert calls
            assert all(isinstance(call, Call) for call in calls)


def test_the_spec_leaves_out_defaults_and_dims():
    assert Sample().spec == "sample-2d"
    assert Sample(dims=5).spec == "sample-2d"
    # the default is a float, and the value an int
    assert Sample(width=1).spec == "sample-2d(width=1)"
    assert Sample(width=2.0, scale_=3).spec == "sample-2d(width=2.0, scale=3)"
    assert Sample(values=(1, 2)).spec == "sample-2d(values=[1, 2])"


def test_the_spec_nests_components_and_names_arrays():
    inner = Sample(width="a'|b")
    outer = Sample(values=[inner, 1])
    (call,) = parse_chain(outer.spec)
    assert call.arguments["values"] == [inner.spec, 1]
    assert parse(call.arguments["values"][0]).arguments == {"width": "a'|b"}
    assert Sample(values=np.zeros((2, 3))).spec == "sample-2d(values=<array 2x3>)"
    assert format_call(outer) == outer.spec


def test_the_summary_is_the_first_line():
    assert Sample.summary() == "First line."


@pytest.mark.parametrize(
    ("value", "advice"),
    [
        ("hilbert", "write 'hilbert' in quotes"),
        ("sobol-owen", "write 'sobol-owen' in quotes"),
        ("a.png", "write 'a.png' in quotes"),
        ("true", "write True"),
        ("none", "write None"),
        ("nan", "give a finite number"),
        ("-inf", "give a finite number"),
        ("1 + x", "give a number"),
        ("f(2)", "give a number"),
    ],
)
def test_values_that_are_not_literals_raise_with_advice(value, advice):
    with pytest.raises(SpecError, match=f"not a literal; {re.escape(advice)}") as caught:
        parse(f"density(warp={value})")
    assert_one_sentence(caught.value)
