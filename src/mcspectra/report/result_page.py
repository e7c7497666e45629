"""One page for the result of an analysis: what it says first, then its figures, numbers and provenance."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import xarray as xr

from mcspectra.plots import kinds
from mcspectra.plots.text import MISSING, interval, number, shorten
from mcspectra.report import page as html
from mcspectra.variance.fit import is_resolved

__all__ = ["write_result"]

_SAID = ("answer", "recommendation", "diagnosis", "note")
_LONG = 300  # characters of a fact


def write_result(result: xr.Dataset, out: str | Path, title: str = "Result") -> Path:
    """Write the result of any analysis as one page that stands alone.

    Parameters
    ----------
    result
        What a function such as `mcspectra.convergence` returned, or `Profile.dataset`.
    out
        The file.
    title
        Of the page; the estimator is added.

    Raises
    ------
    StoreError, StorageError
        It cannot be written.
    """
    attributes = {str(key): value for key, value in result.attrs.items()}
    said = [str(attributes[name]) for name in _SAID if attributes.get(name)]
    causes = tuple(
        (cause["name"], cause["sentence"]) for cause in json.loads(attributes.get("causes", "[]"))
    )

    # Figures, and the single numbers with their intervals
    shown = [kind for kind in kinds.kinds_of(result) if kind != "anything"]
    described = (kinds.describe(kind, result) for kind in shown)
    plots = dict(zip(html.anchors(shown), described, strict=True))
    single = tuple(
        (
            *html.text_cells(str(name)),
            *(html.Cell(text=text) for text in _value(result, str(name))),
            *html.text_cells(str(values.attrs.get("long_name", ""))),
        )
        for name, values in result.data_vars.items()
        if not values.ndim and not str(name).endswith(("_ci", "_se"))
    )
    tables = [
        html.Table(
            caption="Numbers with their 95 % intervals",
            columns=("number", "value", "95 % interval", "meaning"),
            rows=single,
        ),
        *(_curves(result, dims) for dims in (("sampler",), ("n",), ("sampler", "n"))),
    ]
    facts = tuple(
        (name, str(value))
        for name, value in attributes.items()
        if name not in (*_SAID, "causes", "best", "text")
        and not name.startswith("version_")
        and len(str(value)) < _LONG
    )
    facts = (*facts, ("versions", html.versions_of(attributes)))
    parts: dict[str, tuple[html.Block, ...]] = {
        "Causes": (html.Sentences(rows=causes),) if causes else (),
        "Figures": html.figures_of(plots, live=True),
        "Numbers": tuple(table for table in tables if table.rows),
        "Provenance": (html.Facts(rows=facts, code=True),),
    }
    about = shorten(str(attributes.get("estimator", "")), 60)
    page = html.Page(
        title=f"{title}: {about}" if about else title,
        what="result",
        lead=tuple(html.Text(text=sentence) for sentence in said),
        sections=tuple(
            html.Section(title=name, anchor=name.lower(), blocks=blocks)
            for name, blocks in parts.items()
        ),
    )
    return html.write_page(page, Path(out))


def _value(result: xr.Dataset, name: str) -> tuple[str, str]:
    """A single number and its interval, empty if it has none; no rate that is no finding."""
    value, ends = float(result[name]), f"{name}_ci"
    if ends not in result:
        return number(value), ""
    low, high = result[ends].values.tolist()
    resolved = not name.endswith("rate") or not low < high or is_resolved(low, high)
    return number(value) if resolved else "unresolved", interval(low, high)


def _curves(result: xr.Dataset, dims: tuple[str, ...]) -> html.Table:
    """Values by sampler, by n or by both, where they are known, and the route; of the first channel."""
    first = result.isel(channel=0) if "channel" in result.dims else result
    names = [
        str(name)
        for name, values in first.data_vars.items()
        if values.dims == dims and not str(name).endswith(("_ci", "_se"))
    ]
    routes = ["route"] if "route" in first.coords and first["route"].dims == dims else []
    rows = []
    for place in np.ndindex(*(first.sizes.get(dim, 0) for dim in dims)):
        one = first.isel(dict(zip(dims, place, strict=True)))
        found = [_value(one, name) for name in names]
        if any(text != MISSING for text, _ in found):
            shown = [
                text if ends in ("", MISSING, f"{text} … {text}") else f"{text} ({ends})"
                for text, ends in found
            ]
            places, how = ([str(one[name].item()) for name in given] for given in (dims, routes))
            rows.append(html.text_cells(*places, *shown, *how))
    return html.Table(
        caption="Values, with 95 % intervals in brackets where they are wider",
        columns=(*dims, *(name.replace("_", " ") for name in (*names, *routes))),
        rows=tuple(rows),
        heads=len(dims),
    )
