"""Ranking of masks and screen-space samplers as a table, sentences, files and one page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core.errors import writing
from mcspectra.plots import backend_matplotlib
from mcspectra.plots.kinds import describe
from mcspectra.plots.screens import SCREENS, filter_names
from mcspectra.plots.style import labels
from mcspectra.plots.text import interval, number, with_error
from mcspectra.report import page as html
from mcspectra.report.bench_page import is_folder
from mcspectra.report.result_files import check_result_file, csv_text, result_table

__all__ = [
    "SCREEN_FILES",
    "check_screen_file",
    "screen_findings",
    "screen_summary",
    "screen_table",
    "write_screen",
]

_PICTURES = (".png", ".svg", ".pdf")
SCREEN_FILES = (".html", ".csv", *_PICTURES)
"""Extensions that `write_screen` accepts; a name without an extension is a folder."""

_AFTER = {"none": "As it is", "gaussian": "After blur", "ema": "After EMA", "both": "After both"}
# If the upper end of an interval exceeds the lower end by this factor, both ends are shown
_WIDE = 1.5
_CURVES = ["pixel_error", "pixel_error_ci", "low_share", "slow_share", "blocks"]


def screen_summary(result: xr.Dataset) -> dict[str, Any]:
    """Return the numbers of all samplers, and the names of the best ones, as data for JSON."""
    told = {
        key: json.loads(value) if isinstance(value, str) and value[:1] == "[" else value
        for key, value in result.attrs.items()
    }
    kinds = list(filter_names(result))
    samplers = []
    for k, name in enumerate(result["sampler"].values):
        one = result.isel(sampler=k)
        row = {
            "sampler": str(name),
            "blocks": int(one["blocks"]),
            "pixel_error": float(one["pixel_error"]),
            "pixel_error_ci": one["pixel_error_ci"].values.tolist(),
            "low_share": float(one["low_share"]),
            "slow_share": float(one["slow_share"]),
        }
        for kind in kinds:
            after = one.sel(filter=kind)
            row[f"ratio_{kind}"] = float(after["filtered_ratio"])
            row[f"ratio_{kind}_ci"] = after["filtered_ratio_ci"].values.tolist()
        samplers.append(row)
    best = {kind: _best(result, kind) for kind in kinds}
    return {**told, "samplers": samplers, "best": best, "findings": screen_findings(result)}


def _best(result: xr.Dataset, kind: str) -> str | None:
    place = int(result["best"].sel(filter=kind))
    return str(result["sampler"].values[place]) if place >= 0 else None


def screen_table(result: xr.Dataset) -> html.Table:
    """Return variance, low-frequency shares and filtered errors of each sampler, as table rows."""
    titles, frames = filter_names(result), result.sizes["frame"]
    names = list(labels([str(name) for name in result["sampler"].values], 60).values())
    columns = ["Sampler", "Variance", "Low", *(["Slow"] if frames > 1 else [])]
    columns += [_AFTER[kind] for kind in titles]
    rows = []
    for k, name in enumerate(names):
        one = result.isel(sampler=k)
        shares = ["low_share", "slow_share"][: 1 + (frames > 1)]
        row: list[str | html.TableCell] = [html.TableCell(text=name, numeric=False)]
        row += [
            html.number_cell(number(float(one[share])), float(one[share]))
            for share in ("pixel_error", *shares)
        ]
        for kind in titles:
            after = one.sel(filter=kind)
            value, (low, high) = float(after["filtered_ratio"]), after["filtered_ratio_ci"].values
            # The intervals are symmetric on a logarithmic scale, so show both ends of wide ones
            narrow = high < _WIDE * low
            text = with_error(value, (high - low) / 2) if narrow else number(value)
            text += "" if narrow else f" ({interval(low, high, 2)})"
            row.append(html.number_cell(text, value))
        rows.append(row)
    used = [titles[kind] for kind in ("gaussian", "ema") if kind in titles]
    return html.table_of(
        "Variance of a pixel; power below 1/8 cycle per pixel (low)"
        + (" and per frame (slow)" if frames > 1 else "")
        + " relative to white noise; variance relative to random points, as it is and after "
        + " and ".join(used)
        + ", with simultaneous 95 % intervals.",
        columns,
        rows,
        sortable=True,
    )


def screen_findings(result: xr.Dataset) -> list[str]:
    """Return sentences about the best sampler after each filter, and warnings."""
    titles, said = filter_names(result), []
    count = result.sizes["sampler"]
    for kind, title in titles.items():
        name = _best(result, kind)
        after = "Without a filter" if kind == "none" else f"After {title}"
        if name is not None:
            ratios = result["filtered_ratio"].sel(filter=kind).values
            next_best = float(np.sort(ratios)[1] / np.min(ratios))
            said.append(
                f"{after}, {name} is best: its error variance is {number(float(np.min(ratios)))} "
                f"times the variance of random points, and {number(next_best)} times less than "
                "the variance of the next."
            )
        elif count > 1:
            said.append(f"{after}, the best sampler is undecided: intervals overlap.")
    one = result.attrs.get("note")
    return [*said, f"Note: {one}."] if one else said


def check_screen_file(file: str) -> None:
    """Check that `write_screen` can write to `file`, before anything is measured.

    Raises
    ------
    ParameterError, FileFormatError
        If the extension is not in `SCREEN_FILES`, or the file cannot be written.
    """
    if is_folder(file):
        html.check_page_packages()
    else:
        check_result_file(file, SCREEN_FILES)


def write_screen(result: xr.Dataset, file: str) -> Path:
    """Write a ranking of masks in the format of the file's extension.

    Parameters
    ----------
    result
        Result of `mcspectra.rendering.screen_spectrum`.
    file
        A folder gets ``index.html``, ``screen.json`` and ``screen.csv``. ``.html`` is one page.
        ``.csv`` has one row per sampler and filter. Images show the spectra over space and time.

    Raises
    ------
    ParameterError
        If the extension is not in `SCREEN_FILES`.
    FileFormatError, StoreError, StorageError
        If the file cannot be written.
    """
    check_screen_file(file)
    if is_folder(file):
        folder = Path(file)
        with writing(file):
            folder.mkdir(parents=True, exist_ok=True)
        html.write_json(folder / "screen.json", screen_summary(result))
        write_screen(result, str(folder / "screen.csv"))
        return write_screen(result, str(folder / "index.html"))
    path = Path(file)
    with writing(file):
        if path.suffix == ".csv":
            kept = result[[*_CURVES, "filtered_error", "filtered_ratio", "filtered_ratio_ci"]]
            head, lines = result_table(kept, ("sampler", "filter"))
            path.write_text(csv_text(head, lines, result.attrs), encoding="utf-8")
        elif path.suffix in _PICTURES:
            kind = "screen-spectrum" if result.sizes["frequency"] > 1 else "screen-curves"
            backend_matplotlib.write(describe(kind, result), file)
        else:
            html.write_page(_page(result), path)
    return path


def _page(result: xr.Dataset) -> html.Page:
    attributes = result.attrs
    width, height, frames = json.loads(attributes["block"])
    plots = {
        kind: describe(kind, result)
        for kind in SCREENS
        if kind != "screen-spectrum" or result.sizes["frequency"] > 1
    }
    facts = (
        ("Integrand", str(attributes["integrand"])),
        ("Points", f"{attributes['n']} per pixel and frame"),
        ("Block", f"{width} × {height} pixels, {frames} frames, {attributes['seeds']} seeds"),
        ("White noise", f"variance {number(attributes['white_variance'])} of random points"),
    )
    said = screen_findings(result)
    return html.Page(
        title="Masks and screen-space samplers",
        what="screen",
        lead=tuple(html.Paragraph(text=text) for text in said),
        sections=html.sections_of(
            {
                "Ranking": (screen_table(result), *html.figures_of([plots["screen-filters"]])),
                "Spectra": html.figures_of(
                    [p for k, p in plots.items() if k in ("screen-spectrum", "screen-curves")]
                ),
                "Errors": html.figures_of([plots["screen-errors"]]),
                "Provenance": html.provenance(facts, attributes),
            }
        ),
    )
