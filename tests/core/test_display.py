"""Display in notebooks: hooks load no higher layers and never raise."""

import itertools
import re
import unicodedata

import pytest
from tests.processes import python

import mcspectra as mcs
from mcspectra.core.display import (
    between,
    csv_cell,
    escape_html,
    html_of,
    printable,
    register_accessor,
)
from mcspectra.core.errors import ParameterError, warn

ESCAPE = r"\\(?:[abfnrtv0]|x[0-9a-f]{2}|u[0-9a-f]{4}|U[0-9a-f]{8})"


@pytest.mark.parametrize("step", [257, pytest.param(1, marks=pytest.mark.slow)])
def test_every_character_of_one_width_or_none_is_kept_or_escaped(step):
    """For all of Unicode: printable characters stay, spaces become plain, the rest ASCII.

    Long runs without a printable character have both ends and every 257th character here.
    They are characters for private use, surrogates, and numbers that are not assigned.
    """
    for kind, run in itertools.groupby(map(chr, range(0x110000)), unicodedata.category):
        text = "".join(run)
        if kind in ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"):
            text = text[:256] + text[256:-256:step] + text[256:][-256:]
            shown = printable(text)
            assert shown.isascii()
            assert re.fullmatch(f"({ESCAPE})+", shown)
            assert len(re.findall(ESCAPE, shown)) == len(text)
        elif kind == "Zs":
            assert printable(text) == " " * len(text)
        elif printable(text) != text:
            changed = [c for c in text if printable(c) != c]
            assert changed
            assert kind == "Mn" or set(changed) <= set("\u034f\u115f\u1160\u17b4\u17b5\u3164\uffa0")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain, é, 中, ² and 🎲", "plain, é, 中, ² and 🎲"),
        ("\x1b]52;c;aGk=\x07", r"\x1b]52;c;aGk=\x07"),
        ("a\nb\tc\r\x7f\x85", r"a\nb\tc\r\x7f\x85"),
        ("\u202eevil\u2069\u200d\u2028", r"\u202eevil\u2069\u200d\u2028"),
        ("a\u00a0b\u2009c", "a b c"),
        ("\udc80\ue000\U000e0041", r"\udc80\ue000\U000e0041"),
    ],
)
def test_text_from_outside_is_printable(text, shown):
    assert printable(text) == printable(printable(text)) == shown
    assert printable(text, lines=True) == shown.replace(r"\n", "\n")


def test_equal_ends_are_one_number():
    assert between("28", "28") == "28"
    assert between("28", "29") == "28 to 29"


def test_long_text_loses_its_middle():
    shown = printable("b" + 10**6 * "x" + "e", 100)
    assert len(shown) == 100
    assert shown.startswith("bxx")
    assert shown.endswith("xxe")
    message = str(ParameterError(f"{'k' * 10**6} is no key; give another."))
    assert len(message) == 1000
    assert message.endswith("is no key; give another.")


def test_messages_are_one_printable_line():
    assert str(ParameterError("a\x1b[2J\nb")) == r"a\x1b[2J\nb"
    with pytest.warns(UserWarning, match=r"^a\\x1b\[2J$"):
        warn("a\x1b[2J", UserWarning)


H = 10**5000


@pytest.mark.parametrize(
    "call",
    [
        lambda: mcs.convergence("linear(dims=1)", "random", [4, H]),
        lambda: mcs.convergence("linear(dims=1)", "random", {H}),
        lambda: mcs.convergence("linear(dims=1)", "random", [4, 8], realizations=-H),
        lambda: mcs.convergence("linear(dims=1)", "random", [4, 8], rng=H),
        lambda: mcs.convergence("linear(dims=1)", "random", [4, 8], workers=H),
        lambda: mcs.convergence(H, "random", [4, 8]),
        lambda: mcs.convergence("linear(dims=1)", H, [4, 8]),
        lambda: mcs.sampler("random", H),
        lambda: mcs.sampler("random").draw(H),
        lambda: mcs.quality_figures("random", 4, figures=[H]),
        lambda: mcs.integrands.Gaussian(width=H),
    ],
)
def test_numbers_that_python_does_not_print_are_a_sentence(call):
    """These messages ended with Python's own text about the limit of digits."""
    with pytest.raises(mcs.McspectraError, match="an integer of ") as caught:
        call()
    assert str(caught.value).endswith(".")
    assert len(str(caught.value)) < 300


def test_html_has_no_controls_and_no_markup():
    assert escape_html("<b>'\x1b\u202e\n&") == r"&lt;b&gt;&#x27;\x1b\u202e" + "\n&amp;"


@pytest.mark.parametrize(
    "text", ["=1+1", "@SUM(A1)", "-cmd|' /C calc'!A0", "+a", "\t=1", "-", "＝1"]
)
def test_cells_that_a_spreadsheet_would_compute_are_text(text):
    assert csv_cell(text) == printable(f"'{text}")


@pytest.mark.parametrize("value", ["-1.5", "+2e3", "-inf", "a=1", "", 1.5, None, True])
def test_other_cells_stay(value):
    assert csv_cell(value) is value or csv_cell(value) == value


def test_displaying_an_object_never_raises():
    class Broken(mcs.Integrand):
        dims = 1

        @property
        def spec(self):
            raise RuntimeError("no spec")

        def _evaluate(self, x):
            return x

    assert Broken()._repr_html_() is None
    assert html_of(object()) is not None


@pytest.mark.parametrize("make", ["mcs.sampler('random')", "mcs.Estimator('linear', dims=1)"])
def test_higher_layers_are_loaded_at_the_first_display(make):
    code = (
        f"import sys; import mcspectra as mcs; c = {make}; x = 'mcspectra.report' in sys.modules; "
    )
    code += "assert c._repr_html_(); print(x, 'mcspectra.report' in sys.modules, "
    code += "any(m in sys.modules for m in ('matplotlib', 'xarray')))"
    done = python("-c", code, check=True)
    assert done.stdout.split() == ["False", "True", "False"]


def test_results_have_the_accessor_and_it_is_registered_once():
    import xarray as xr

    register_accessor()
    before = xr.Dataset.mcspectra
    register_accessor.cache_clear()
    register_accessor()  # a second registration would warn, which is an error here
    assert xr.Dataset.mcspectra is before
