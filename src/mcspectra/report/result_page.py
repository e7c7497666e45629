"""One page for the result of an analysis: what it says first, then its figures, numbers and provenance."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from mcspectra.plots import kinds
from mcspectra.plots.text import interval, number
from mcspectra.report.page import (
    Block,
    Cell,
    Facts,
    Figure,
    Figures,
    Page,
    Section,
    Sentences,
    Table,
    Text,
    anchors,
    text_cells,
    versions_of,
    write_page,
)

if TYPE_CHECKING:
    import xarray as xr

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
        Of the page.

    Raises
    ------
    StoreError, StorageError
        It cannot be written.
    """
    attributes = {str(key): value for key, value in result.attrs.items()}
    said = [str(attributes[name]) for name in _SAID if attributes.get(name)]
    sections = []
    causes = json.loads(attributes.get("causes", "[]"))
    if causes:
        rows = tuple((cause["name"], cause["sentence"]) for cause in causes)
        sections.append(Section(title="Causes", anchor="causes", blocks=(Sentences(rows=rows),)))

    # Figures, and the single numbers with their intervals
    shown = [kind for kind in kinds.kinds_of(result) if kind != "anything"]
    names = anchors(shown)
    figures = tuple(
        Figure(plot=kinds.describe(kind, result), name=name, live=True)
        for kind, name in zip(shown, names, strict=True)
    )
    if figures:
        sections.append(
            Section(title="Figures", anchor="figures", blocks=(Figures(figures=figures),))
        )
    numbers = _numbers(result)
    if numbers.rows:
        sections.append(Section(title="Numbers", anchor="numbers", blocks=(numbers,)))
    facts = tuple(
        (name, str(value))
        for name, value in attributes.items()
        if name not in (*_SAID, "causes", "best", "text")
        and not name.startswith("version_")
        and len(str(value)) < _LONG
    )
    facts = (*facts, ("versions", versions_of(attributes)))
    sections.append(
        Section(title="Provenance", anchor="provenance", blocks=(Facts(rows=facts, code=True),))
    )
    lead: tuple[Block, ...] = tuple(Text(text=sentence) for sentence in said)
    page = Page(title=title, what="result", lead=lead, sections=tuple(sections))
    return write_page(page, Path(out))


def _numbers(result: xr.Dataset) -> Table:
    """Single numbers, with their intervals and meanings."""
    rows = []
    for name, values in result.data_vars.items():
        if values.ndim or str(name).endswith(("_ci", "_se")):
            continue
        ends = f"{name}_ci"
        between = interval(*result[ends].values.tolist()) if ends in result else ""
        meaning = str(values.attrs.get("long_name", ""))
        cells = (Cell(text=number(float(values))), Cell(text=between), *text_cells(meaning))
        rows.append((*text_cells(str(name)), *cells))
    return Table(
        caption="Numbers with their 95 % intervals",
        columns=("number", "value", "95 %", "meaning"),
        rows=tuple(rows),
    )
