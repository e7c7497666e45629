"""Options: declared once, checked and read by common rules; each error is one sentence."""

import math
from typing import Annotated, Literal

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import Meta

from mcspectra.core.analysis import ANALYSES
from mcspectra.core.errors import MissingDependency, ParameterError
from mcspectra.core.options import (
    BASIS,
    COUNT,
    COUNTS,
    HALF_WIDTH,
    Counts,
    Positive,
    Text,
    Window,
    checked,
    options_of,
)

HALF = Meta(description="How far.", extra={"unit": "cycles per unit"})


class Kinds(msgspec.Struct, frozen=True, kw_only=True):
    """An option of every type."""

    n: Annotated[int, COUNT]
    counts: Annotated[Counts, COUNTS] = (4, 16)
    whole: Annotated[int, Meta(ge=-2, le=3, description="A whole number.")] = 0
    share: Annotated[float, Meta(gt=0.0, lt=1.0, description="A part.")] = 0.5
    width: Annotated[float | None, Meta(description="A width, if any.")] = None
    flag: Annotated[bool, Meta(description="Yes or no.")] = False
    space: Annotated[Literal["domain", "primary"] | None, Meta(description="Where.")] = None
    basis: Annotated[str, BASIS] = "auto"
    window: Annotated[Window, Meta(description="How many.")] = None
    half_width: Annotated[Annotated[int, HALF_WIDTH] | Literal["auto"], HALF] = 8
    several: Annotated[Positive | Counts, COUNTS] = 4
    texts: Annotated[tuple[Literal["a", "b"], ...], Meta(description="Some of them.")] = ("a",)
    pair: Annotated[tuple[int, int], Meta(description="Width and height.")] = (1, 2)
    name: Annotated[Text, Meta(description="Any text.")] = "x"
    free: Annotated[str, Meta(description="Also an array.", extra={"python": True})] = "x"


OPTIONS = {option.name: option for option in options_of(Kinds)}


def test_defaults_that_are_made_each_time_are_defaults():
    class Lists(msgspec.Struct, kw_only=True):
        names: list[str] = []
        table: dict[str, int] = msgspec.field(default_factory=lambda: {"a": 1})
        needed: int

    assert [each.default for each in options_of(Lists)] == [[], {"a": 1}, msgspec.NODEFAULT]
    assert [each.required for each in options_of(Lists)] == [False, False, True]


def test_an_option_has_the_fields_of_its_annotation():
    n, half_width = OPTIONS["n"], OPTIONS["half_width"]
    assert (n.required, n.meaning, n.flag) == (True, "Points of each technique.", "--n")
    assert n.extra == {"flag": "-n", "metavar": "N"}
    assert (half_width.required, half_width.default, half_width.flag) == (False, 8, "--half-width")
    assert half_width.extra["unit"] == "cycles per unit"
    choices = {name: option.choices for name, option in OPTIONS.items() if option.choices}
    assert choices == {
        "space": ("domain", "primary"),
        "basis": ("fourier", "cosine", "walsh", "haar", "auto"),
        "window": ("auto",),
        "half_width": ("auto",),
    }
    assert OPTIONS["texts"].item_choices == ("a", "b")
    assert [name for name, option in OPTIONS.items() if option.is_flag] == ["flag"]
    assert [name for name, option in OPTIONS.items() if option.lists_texts] == ["texts"]


CLEAN = [
    ("n", 16, 16),
    ("n", 16.0, 16),
    ("n", np.int32(16), 16),
    ("n", np.float64(16.0), 16),
    ("n", 2**62, 2**62),
    ("whole", -2, -2),
    ("share", 0.25, 0.25),
    ("share", np.float32(0.5), 0.5),
    ("width", None, None),
    ("width", 3, 3.0),
    ("flag", np.True_, True),
    ("space", None, None),
    ("space", "primary", "primary"),
    ("window", "auto", "auto"),
    ("window", 2, 2),
    ("half_width", 0, 0),
    ("half_width", "auto", "auto"),
    ("counts", [4, 16.0], (4, 16)),
    ("counts", np.array([4, 16]), (4, 16)),
    ("counts", range(1, 4), (1, 2, 3)),
    ("several", 7, 7),
    ("several", [4, 16], (4, 16)),
    ("texts", ["b", "a"], ("b", "a")),
    ("pair", [3, 4], (3, 4)),
    ("name", "β", "β"),
]


@pytest.mark.parametrize(("name", "value", "clean"), CLEAN)
def test_valid_values_are_converted(name, value, clean):
    found = OPTIONS[name].check(value)
    assert found == clean
    assert type(found) is type(clean)


WRONG = [
    ("n", 0, "give a whole number of at least 1"),
    ("n", 2**62 + 1, "give a whole number"),
    ("n", 2.5, "give a whole number"),
    ("n", True, "give a whole number"),
    ("n", "16", "give a whole number"),
    ("n", math.nan, "give a whole number"),
    ("n", math.inf, "give a whole number"),
    ("n", None, "give a whole number"),
    ("n", [16], "give a whole number"),
    ("whole", 4, "from -2 to 3"),
    ("share", 0.0, "greater than 0"),
    ("share", 1.0, "less than 1"),
    ("share", math.nan, "give a finite number"),
    ("width", 10**400, "give a finite number"),
    ("width", False, "give a finite number"),
    ("flag", 1, "give True or False"),
    ("flag", None, "give True or False"),
    ("space", "primal", "domain.*primary"),
    ("space", 3, "domain.*primary"),
    ("basis", "fourrier", "one of fourier, cosine.*Did you mean"),
    ("basis", None, "one of fourier"),
    ("window", 1, "at least 2"),
    ("window", "all", "give a whole number of at least ., or 'auto'"),
    ("half_width", "wide", "give a whole number of at least ., or 'auto'"),
    ("half_width", -1, "at least 0"),
    ("counts", [], "has no values; give one or more"),
    ("counts", [16, 4], "ascending"),
    ("counts", [4, 4], "ascending"),
    ("counts", [4, None], "give a whole number"),
    ("counts", [[4], [16]], "one flat list"),
    ("counts", [4, [16, 64]], "one flat list"),
    ("counts", np.zeros((2, 0)), "one flat list"),
    ("counts", "4,16", "one flat list"),
    ("counts", 4, "one flat list"),
    ("counts", {4, 16}, "one flat list"),
    ("counts", range(10**9), "10000 are allowed"),
    ("several", [16, 4], "ascending"),
    ("several", 0, "at least 1"),
    ("texts", ["c"], "one of a, b"),
    ("texts", "a", "one flat list"),
    ("pair", [1], "give 2"),
    ("pair", [1, 2, 3], "give 2"),
    ("name", "", "give a text"),
    ("name", b"x", "give a text"),
    ("name", "x" * 20_001, "20000"),
]


@pytest.mark.parametrize(("name", "value", "words"), WRONG)
def test_invalid_values_raise_one_sentence(name, value, words):
    with pytest.raises(ParameterError, match=words) as caught:
        OPTIONS[name].check(value)
    assert str(caught.value).startswith(name)
    with pytest.raises(ParameterError, match=r"^there"):
        OPTIONS[name].check(value, "there")


def test_python_objects_are_checked_by_the_analysis():
    function = OPTIONS["free"].check(print)
    assert function is print


READ = [
    ("n", "16", 16),
    ("share", "0.25", 0.25),
    ("space", "primary", "primary"),
    ("window", "auto", "auto"),
    ("window", "3", 3),
    ("half_width", "auto", "auto"),
    ("counts", "4, 16,64", (4, 16, 64)),
    ("counts", "4", (4,)),
    ("texts", "b,a", ("b", "a")),
    ("pair", "3,4", (3, 4)),
    ("name", "3", "3"),
]


@pytest.mark.parametrize(("name", "text", "clean"), READ)
def test_texts_are_read(name, text, clean):
    assert OPTIONS[name].read(text) == clean


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("n", "many", "^--n is 'many'; give a whole number"),
        ("n", "", "^--n is ''"),
        (
            "half_width",
            "wide",
            "^--half-width is 'wide'; give a whole number of at least 0, or 'auto'",
        ),
        ("share", "nan", "^--share is nan; give a finite number"),
        ("counts", "16,4", r"^--counts is \[16, 4\]; give ascending"),
        ("counts", "4,x", "^--counts is 'x'; give a whole number"),
        ("counts", "4,,16", "^--counts is ''"),
        ("pair", "1,2,3", "^--pair has 3 values; give 2"),
    ],
)
def test_invalid_texts_raise_one_sentence(name, text, words):
    with pytest.raises(ParameterError, match=words):
        OPTIONS[name].read(text)


def test_a_struct_is_checked_as_a_whole():
    struct = checked(Kinds(n=16.0, counts=[4, 16], share=np.float64(0.5)))
    assert (struct.n, struct.counts, type(struct.share)) == (16, (4, 16), float)
    with pytest.raises(ParameterError, match="^share is 2"):
        checked(Kinds(n=16, share=2))


# --- options of all analyses
# ------------------------------------------------------------------------


def _registered():
    for name in ANALYSES:
        try:
            yield from ((f"{name}.{o.name}", o) for o in options_of(ANALYSES.load(name)))
        except MissingDependency:
            continue


ALL = dict(_registered())
ODD = [
    None,
    True,
    0,
    -1,
    2.5,
    2**70,
    10**400,
    math.nan,
    -math.inf,
    1j,
    "",
    "nonsense",
    b"x",
    [],
    [1, "a"],
    [[1], [2, 3]],
    {},
    {1: 2},
    {3},
    np.zeros((2, 0)),
    np.array(3),
    np.array([None]),
    np.float64("nan"),
    range(3, 0, -1),
    object(),
    print,
    int,
]


@pytest.mark.parametrize("name", ALL)
def test_odd_values_of_every_option_are_accepted_or_one_sentence(name):
    for value in ODD:
        try:
            clean = ALL[name].check(value)
        except ParameterError as error:
            assert str(error).startswith(ALL[name].name)  # noqa: PT017
        else:
            again = ALL[name].check(clean)
            assert again is clean or again == clean


@settings(deadline=None, max_examples=30)
@given(st.text(max_size=12) | st.sampled_from(["nan", "1e999", "-0", "1,2", ",", "auto", "0x1"]))
def test_odd_texts_of_every_option_are_read_or_one_sentence(text):
    for option in ALL.values():
        try:
            option.read(text)
        except ParameterError as error:
            assert str(error).startswith(option.flag)  # noqa: PT017
