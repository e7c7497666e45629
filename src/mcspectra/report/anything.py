"""What a report shows of an analysis that it has no table and no figure for, such as a stranger's.

Single numbers make a table with their meanings and intervals, variables of one dim are curves of all
samplers in one figure, those of two are images. Of several channels the first is drawn.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mcspectra.core.analysis import ANALYSES
from mcspectra.core.errors import McspectraError
from mcspectra.report.figures.panels import blocks_of, rows_of
from mcspectra.report.formatting import interval, number, slug
from mcspectra.report.further_pictures import with_labels
from mcspectra.report.picture import Picture
from mcspectra.report.style import (
    NARROW,
    LineStyle,
    entitle,
    labels,
    legend_below,
    quiet_colorbar,
)
from mcspectra.report.tables import Cell, Table

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["any_pictures", "any_table", "summary_of"]


def summary_of(analysis: str) -> str:
    """Summary of an analysis; its name where its package is not installed here."""
    try:
        return str(ANALYSES.load(analysis).summary())
    except McspectraError:
        return f"{analysis.capitalize()}."


def any_table(data: Mapping[str, xr.Dataset]) -> Table | None:
    """Table of the single numbers of an analysis, by sampler; None where it has none."""
    rows, drawn = [], {sampler: _first_channel(each) for sampler, each in data.items()}
    for sampler, each in drawn.items():
        for name in _names(drawn, 0):
            ends = each[f"{name}_ci"].values.tolist() if f"{name}_ci" in each else (None, None)
            known = each[name].attrs
            texts = (sampler, known.get("long_name", name), known.get("units", ""))
            shown = (number(float(each[name])), interval(*ends))
            cells = [Cell(text=str(text), numeric=False) for text in texts]
            rows.append((*cells, *(Cell(text=text) for text in shown)))
    columns = ("Sampler", "Quantity", "Unit", "Value", "95 % interval")
    caption = "Single numbers of the result; of several channels the first."
    return Table(caption=caption, columns=columns, rows=tuple(rows), heads=2) if rows else None


def any_pictures(
    analysis: str, data: Mapping[str, xr.Dataset], styles: Mapping[str, LineStyle]
) -> Iterator[Picture]:
    """Draw the variables of one dim, all samplers in a figure, and those of two, each in a panel."""
    drawn = {sampler: _first_channel(each) for sampler, each in data.items()}
    names = labels(list(drawn), 30)
    for name, values in next(iter(drawn.values())).data_vars.items():
        if name not in (*_names(drawn, 1), *_names(drawn, 2)):
            continue
        if values.ndim == 1:
            figure, panels = rows_of(None, 1, NARROW, 3.0 + 0.08 * len(drawn), grid=True)
        else:
            figure, blocks = blocks_of(None, len(drawn), 1, 1.0)
            panels = [panel for (panel,) in blocks]
        for (sampler, each), panel in zip(drawn.items(), itertools.cycle(panels), strict=False):
            if values.ndim == 2:
                image = each[name].plot.imshow(ax=panel, add_colorbar=False)
                quiet_colorbar(figure.colorbar(image, ax=panel), str(name))
                entitle(panel, names[sampler])
                continue
            style, curve = styles[sampler], with_labels(each, str(values.dims[0]))[name]
            x, y = curve[curve.dims[0]].values, curve.values
            ends = np.moveaxis(each[f"{name}_ci"].values, -1, 0) if f"{name}_ci" in each else None
            if ends is None and f"{name}_se" in each:
                ends = y + 2.0 * np.outer((-1.0, 1.0), each[f"{name}_se"].values)
            look: dict[str, Any] = {"color": style.color, "label": names[sampler]}
            if x.dtype.kind == "U":  # names are no axis that a line could run along
                panel.errorbar(x, y, None if ends is None else np.abs(ends - y), fmt="o", **look)
            else:
                panel.plot(x, y, ls=style.dashes, **look)
                if ends is not None:
                    panel.fill_between(x, *ends, color=style.color, alpha=0.2, linewidth=0)
            panel.set(xlabel=curve.dims[0], ylabel=values.attrs.get("long_name", name))
        if values.ndim == 1:
            legend_below(figure, panels[0])
        over = f"{values.attrs.get('long_name', name)}, over {' and '.join(map(str, values.dims))}"
        yield Picture(
            kind=slug(f"{analysis}-{name}"),
            caption=f"{summary_of(analysis)} {over[:1].upper()}{over[1:]}.",
            alt=f"{over}, for {', '.join(drawn)}.",
            figure=figure,
        )


def _first_channel(data: xr.Dataset) -> xr.Dataset:
    return data.isel(channel=0) if "channel" in data.dims else data


def _names(data: Mapping[str, xr.Dataset], dims: int) -> list[str]:
    """Variables of real numbers over so many dims; intervals and errors belong to others."""
    first = next(iter(data.values()))
    partners = {f"{name}{end}" for name in first.data_vars for end in ("_ci", "_se")}
    return [
        str(name)
        for name, values in first.data_vars.items()
        if values.ndim == dims and values.dtype.kind in "iufb" and name not in partners
    ]
