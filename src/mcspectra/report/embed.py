"""Plots as text inside a page: bokeh's script once, each plot as JSON, all of it packed."""

from __future__ import annotations

import base64
import gzip
import json
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bokeh.models import LayoutDOM

__all__ = ["bokeh_script", "packed_plot"]


@cache
def bokeh_script() -> str:
    """Return bokeh's own script, without widgets, tables and WebGL, gzipped, in base 64."""
    from bokeh.resources import Resources

    script = Resources(mode="inline", components=["bokeh"], log_level="error").js_raw
    return _packed("\n".join(script))


def packed_plot(plot: LayoutDOM) -> str:
    """Return a plot's JSON for ``Bokeh.embed.embed_item``, gzipped, in base 64.

    The same plot gives the same text: bokeh counts its models through the life of a process, here
    they count from 0 in each plot.
    """
    from bokeh.core.json_encoder import serialize_json
    from bokeh.embed import json_item

    item = json.loads(serialize_json(json_item(plot)))
    numbers: dict[str, str] = {}
    document = _renumbered(item["doc"], numbers)
    kept = {"root_id": numbers[item["root_id"]], "doc": document, "version": item["version"]}
    text = json.dumps({"target_id": None, **kept}, ensure_ascii=False, separators=(",", ":"))
    return _packed(text)


def _packed(text: str) -> str:
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")


def _renumbered(node: Any, numbers: dict[str, str]) -> Any:
    """A copy with every model's id replaced by its place in the order of first mention."""
    if isinstance(node, list):
        return [_renumbered(each, numbers) for each in node]
    if not isinstance(node, dict):
        return node
    return {
        key: numbers.setdefault(value, f"m{len(numbers)}")
        if key == "id" and isinstance(value, str)
        else _renumbered(value, numbers)
        for key, value in node.items()
    }
