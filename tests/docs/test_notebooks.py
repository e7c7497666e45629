"""The page on notebooks: every block runs, and IPython shows pictures."""

import re
from pathlib import Path

import matplotlib as mpl
import pytest
from IPython.core.formatters import DisplayFormatter

import mcspectra as mcs

PAGE = (Path(__file__).parents[2] / "docs" / "notebooks.md").read_text(encoding="utf-8")
CODE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(autouse=True)
def _no_window():
    with mpl.rc_context({"backend": "agg"}):
        yield


def test_every_block_runs():
    names = {"mcs": mcs}
    for block in CODE:
        exec(block, names)  # noqa: S102
    assert names["axes"].get_title() == "a title of your own"
    assert names["left"].get_ylabel() == "variance"
    assert names["right"].get_ylabel() == "predicted / measured"


@pytest.mark.parametrize("line", CODE[0].strip().splitlines())
def test_ipython_shows_a_picture(line):
    shown, _ = DisplayFormatter().format(eval(line, {"mcs": mcs}))
    assert "<svg" in shown["text/html"]
    assert shown["text/plain"]
