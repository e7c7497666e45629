"""Plots as text: the same plot, the same text; nothing that ends a script element."""

import base64
import gzip
import json
import re

from bokeh.plotting import figure

from mcspectra.report.embed import bokeh_script, packed_plot


def item(text: str) -> dict[str, object]:
    """What a page unpacks."""
    return dict(json.loads(gzip.decompress(base64.b64decode(text))))


def plot(name: str = "p1001"):  # type: ignore[no-untyped-def]
    """A plot whose data look like ids."""
    drawn = figure(height=200, width=300)
    drawn.scatter("x", "y", source={"x": [1, 2], "y": [3, 4], "id": [name, "</script>"]})
    return drawn


def test_same_plot_same_text() -> None:
    assert packed_plot(plot()) == packed_plot(plot())
    assert packed_plot(plot("p1001")) != packed_plot(plot("p1002"))


def test_every_reference_has_its_model() -> None:
    found = item(packed_plot(plot()))
    defined: set[str] = set()
    mentioned: set[str] = set()

    def walk(node: object) -> None:
        if isinstance(node, list):
            for each in node:
                walk(each)
        elif isinstance(node, dict):
            if isinstance(node.get("id"), str):
                (defined if node.get("type") == "object" else mentioned).add(node["id"])
            for each in node.values():
                walk(each)

    walk(found["doc"])
    assert mentioned <= defined
    assert found["root_id"] in defined
    assert "p1001" in json.dumps(found)  # data are left alone


def test_script_stays_in_its_element() -> None:
    text = bokeh_script()
    assert re.fullmatch(r"[A-Za-z0-9+/]+=*", text)
    assert len(gzip.decompress(base64.b64decode(text))) > 1_000_000
    assert len(text) < 600_000
