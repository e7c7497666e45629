"""Write a sampler bench as a page, sheets, tables or plots: HTML, PDF, LaTeX, PGF or CSV."""

from __future__ import annotations

import math
import os
import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import xarray as xr

from mcspectra.core.display import counted
from mcspectra.core.errors import FileFormatError, writing
from mcspectra.measure.bench import BENCH_QUALITY
from mcspectra.plots import backend_matplotlib
from mcspectra.plots.description import Plot
from mcspectra.plots.groups import Group, Styles, point_dims
from mcspectra.plots.kinds import describe
from mcspectra.plots.points import QUALITY_HEADS, point_sets
from mcspectra.plots.spectra import spectrum as describe_spectrum
from mcspectra.plots.style import INK, PAPER, labels, sampler_styles
from mcspectra.plots.text import MISSING, number, rate, slug
from mcspectra.plots.variance import BELOW_ROUNDING, below_rounding, task_curves
from mcspectra.report import page as html
from mcspectra.report.result_files import check_result_file, csv_text, latex_table, result_table
from mcspectra.report.sampler_cards import Card, card_sections
from mcspectra.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawn

__all__ = [
    "BENCH_FILES",
    "BenchFigure",
    "bench_labels",
    "bench_plots",
    "bench_table",
    "check_bench_file",
    "is_folder",
    "write_bench",
]

BENCH_FILES = (".html", ".pdf", ".csv", ".tex", ".pgf")
"""Extensions that `write_bench` accepts; a name without an extension is a folder."""

_HEADS = QUALITY_HEADS | {"generalized_l2_discrepancy": "Generalized L2 discrepancy"}
_ROWS = 44  # lines of text per PDF sheet
_ABREAST = 6  # with more samplers, each one is a row of a table instead of a column
_IN_OVERLAY = 10  # largest number of samplers per plot
_MOST_AXES = 10
_WINNERS = 3  # largest number of samplers that the first sentence names
# The caption states how many sets each sampler averages, and names samplers that differ.
# If more than two samplers differ from the usual number of sets, the caption states a range
_MOST_NAMED = 2
_CURVES = ["points_made", "variance", "variance_ci", "rate", "rate_ci", "rank", "rank_ci"]


def is_folder(file: str) -> bool:
    """Whether `file` names a folder: it ends in /, is a folder, or has no extension."""
    return file.endswith("/") or Path(file).is_dir() or not Path(file).suffix


def check_bench_file(file: str) -> None:
    """Check that `write_bench` can write to `file`, before anything is measured.

    Raises
    ------
    ParameterError, FileFormatError
        If the extension is not in `BENCH_FILES`, or the file cannot be written.
    """
    if not is_folder(file):
        check_result_file(file, BENCH_FILES)
        return
    known = next(each for each in (Path(file), *Path(file).absolute().parents) if each.exists())
    if not known.is_dir() or not os.access(known, os.W_OK):
        raise FileFormatError(
            f"{file!r} cannot be written; give a folder inside one that can be written."
        )


def write_bench(bench: xr.Dataset, file: str, cards: Sequence[Card] = ()) -> Path:
    """Write a bench in the format of the file's extension.

    Parameters
    ----------
    bench
        Result of `mcspectra.sampler_bench`.
    file
        A folder gets ``index.html`` and ``bench.csv``. ``.html`` is one self-contained page.
        ``.pdf`` has the table and all figures, one per sheet, with Type 42 fonts.
        ``.csv`` has variances, rates and ranks, with one row per sampler, integrand and n.
        ``.tex`` is the table as a LaTeX tabular. ``.pgf`` is the convergence plot for LaTeX.
    cards
        Cards in the same order as the samplers. Each card becomes a section of the page.

    Raises
    ------
    ParameterError
        If the extension is not in `BENCH_FILES`.
    FileFormatError, StoreError, StorageError
        If the file cannot be written.
    """
    check_bench_file(file)
    if is_folder(file):
        folder = Path(file)
        with writing(file):
            folder.mkdir(parents=True, exist_ok=True)
        write_bench(bench, str(folder / "bench.csv"))
        return write_bench(bench, str(folder / "index.html"), cards)
    path = Path(file)
    with writing(file):
        match path.suffix:
            case ".csv":
                head, lines = result_table(bench[_CURVES], ("sampler", "integrand", "n"))
                path.write_text(csv_text(head, lines, bench.attrs), encoding="utf-8")
            case ".tex":
                columns, rows = bench_table(bench)
                path.write_text(latex_table(columns, rows), encoding="utf-8")
            case ".pgf":
                backend_matplotlib.write(next(bench_plots(bench)).plot, file)
            case ".pdf":
                titled = [(f"{f.title} ({f.sets})", f.plot) for f in bench_plots(bench)]
                backend_matplotlib.write_pages([*_sheets(bench), *titled], file)
            case _:
                html.write_page(_page(bench, cards), path)
    return path


def bench_table(bench: xr.Dataset) -> tuple[list[str], list[list[str]]]:
    """Return the columns and rows of the summary: rates, with rank intervals in brackets.

    Rows are integrands, or samplers if there are more than six samplers.
    """
    rows = list[list[str]]()
    for title in bench["integrand"].values:
        of_task, cells = bench.sel(integrand=title), [str(title)]
        for k in range(bench.sizes["sampler"]):
            slope, rank = of_task["rate"][k], of_task["rank_ci"].values[k]
            low, high = rank
            place = f"{low:.0f}" if low == high else f"{low:.0f}–{high:.0f}"
            shown = rate(float(slope), *map(float, of_task["rate_ci"].values[k]))
            if shown == MISSING and below_rounding(of_task.isel(sampler=k)):
                shown = BELOW_ROUNDING
            cells.append(f"{shown} ({place})" if math.isfinite(low) else MISSING)
        rows.append(cells)
    columns = ["Integrand", *bench_labels(bench)]
    if bench.sizes["sampler"] <= _ABREAST:
        return columns, rows
    first, *others = map(list, zip(columns, *rows, strict=True))
    return ["Sampler", *first[1:]], others


def _sampler_table(bench: xr.Dataset) -> tuple[list[str], list[list[tuple[str, float]]]]:
    """Return randomization, n, quality at the largest n and speed of each sampler.

    Each table cell is a pair: the text that is shown, and a number by which rows are sorted.
    The first column header is for the names of samplers, which the rows do not contain.
    """
    names = [name for name in BENCH_QUALITY if name in bench]
    last, rows = bench.isel(n=-1), []
    for k in range(bench.sizes["sampler"]):
        values = [float(last[name][k]) for name in names]
        speed = float(last["points_per_second"][k]) if "points_per_second" in bench else math.nan
        n = float(bench["pictured_n"][k]) if "pictured_n" in bench else math.nan
        count = (f"{n:.0f}" if n > 0 else MISSING, n)
        applied = str(bench["randomization"].values[k]) or MISSING
        row = [(applied, math.nan), count, *((number(v), v) for v in values)]
        rows.append([*row, (number(speed, 2), speed)])
    return ["Sampler", "Randomized by", "n", *(_HEADS[name] for name in names), "Points/s"], rows


def bench_labels(bench: xr.Dataset) -> list[str]:
    """Return short and distinct names of the samplers of a bench."""
    return list(labels([str(label) for label in bench["label"].values], 26).values())


class BenchFigure(NamedTuple):
    """A figure of a bench: title, file name, plot, and a text about the averaged sets."""

    title: str
    name: str
    plot: Plot
    sets: str


def bench_plots(
    bench: xr.Dataset, styles: Styles | None = None, *, logarithmic: bool = False
) -> Iterator[BenchFigure]:
    """Yield the figures of a bench; each figure shows at most ten samplers.

    Parameters
    ----------
    bench
        Result of `mcspectra.sampler_bench`.
    styles
        Style of each label in `bench_labels`. Default: distinct styles.
    logarithmic
        Whether spectra have a logarithmic scale.
    """
    names = bench_labels(bench)
    whole = {name: bench.isel(sampler=k) for k, name in enumerate(names)}
    for start in range(0, len(names), _IN_OVERLAY):
        ones = {name: whole[name] for name in names[start : start + _IN_OVERLAY]}
        part = f"-{1 + start // _IN_OVERLAY}" if len(names) > _IN_OVERLAY else ""
        for each in _plots_of(bench, ones, styles or sampler_styles(names), logarithmic):
            yield each._replace(name=f"{each.name}{part}")


def _plots_of(
    bench: xr.Dataset, ones: dict[str, xr.Dataset], styles: Styles, logarithmic: bool
) -> Iterator[BenchFigure]:
    """Yield the figures of a few samplers of a bench."""

    # Plot convergence on one sheet per number of dims. Each sampler has its own counts
    for d in dict.fromkeys(bench["integrand_dims"].values.tolist()):
        tasks: dict[str, Group] = {}
        for title in bench["integrand"].values[bench["integrand_dims"].values == d]:
            for name, each in ones.items():
                curve = each.sel(integrand=title).dropna("n", subset=["variance"])
                curve = curve.assign_coords(n=curve["points_made"].values.astype(int))
                curve = curve.isel(n=np.unique(curve["n"].values, return_index=True)[1])
                if curve.sizes["n"]:
                    tasks.setdefault(str(title).rpartition(",")[0], {})[name] = curve  # type: ignore[index]
        if tasks:
            sets = f"{d}-D, {counted(bench.attrs['realizations'], 'set')} per variance"
            plot = task_curves(tasks, styles)
            yield BenchFigure(f"Convergence in {d}-D", f"convergence-{d}d", plot, sets)

    def of(*names: str, sets: str) -> tuple[dict[str, xr.Dataset], str]:
        """Return the named variables of each sampler whose `names[0]` is known, and a caption."""
        dims, kept = point_dims(bench), [*names, sets]
        found = {
            name: each[kept].assign_attrs(n=int(each["pictured_n"]), dims=dims)
            for name, each in ones.items()
            if names[0] in each and each[names[0]].notnull().any()
        }
        points = _range([each.attrs["n"] for each in found.values()])
        return found, f"{dims}-D, n = {points}, {_sets_of(found, sets)}"

    where = "Spectra and pairs"
    if "power" in bench:
        spectra, sets = of("power", "radial_power", sets="spectrum_sets")
        if spectra and "m1" in bench.dims and "m2" not in bench.dims:
            plot = describe_spectrum(spectra, styles, logarithmic=logarithmic)
            yield BenchFigure(f"{where}: spectra", "spectra", plot, sets)
        if spectra:
            plot = describe("radial", spectra, styles)
            yield BenchFigure(f"{where}: means over directions", "radial", plot, sets)
    if "anisotropy_db" in bench:
        rings, sets = of("anisotropy_db", sets="spectrum_sets")
        if rings:
            plot = describe("anisotropy", rings, styles)
            yield BenchFigure(f"{where}: anisotropy", "anisotropy", plot, sets)
    if "pair_correlation" in bench:
        pairs, sets = of("pair_correlation", "pair_correlation_ci", sets="pair_sets")
        if pairs:
            plot = describe("pair-correlation", pairs, styles)
            yield BenchFigure(f"{where}: pair correlation", "pair-correlation", plot, sets)
    if "quality_sets" in bench:
        least = {name: each.min() for name, each in ones.items()}
        sets = f"{point_dims(bench)}-D, means of {_sets_of(least, 'quality_sets')}"
        yield BenchFigure("Quality", "quality", describe("quality", ones, styles), sets)

    # Plot one set of each sampler, projected on all pairs of axes
    sampled = {
        name: each[["points"]].dropna("axis", how="all").dropna("point")
        for name, each in ones.items()
    }
    flat = {
        name: each.assign_attrs(n=1) for name, each in sampled.items() if each.sizes["axis"] <= 2
    }
    if flat:
        sets = f"n = {_range([each.sizes['point'] for each in flat.values()])}, one set each"
        yield BenchFigure("Points", "points", describe("points", flat, styles), sets)
    for name, each in sampled.items():
        if each.sizes["axis"] > 2:
            caption = f"{name}, n = {each.sizes['point']}"
            plot = point_sets(each["points"].values, caption, _MOST_AXES)
            columns = -(-len(plot.panels) // -(-len(plot.panels) // 5))
            plot = replace(plot, columns=columns, wide=True, caption="Projections on all axes.")
            stem = f"projections-{slug(name)}"
            yield BenchFigure(f"Projections: {name}", stem, plot, f"{caption}, one set")


def _sets_of(group: Group, key: str) -> str:
    """Return, as text, the number of averaged sets that is most common among the samplers.

    Samplers that average a different number of sets are listed in brackets.
    If there are many such samplers, the text gives the smallest and the largest number of sets.
    """
    counts = {name: int(each[key]) for name, each in group.items() if np.isfinite(each[key])}
    usual = Counter(counts.values()).most_common(1)[0][0] if counts else 0
    others = [f"{name}: {count}" for name, count in counts.items() if count != usual]
    if len(others) > _MOST_NAMED:
        return f"{_range(counts.values())} sets"
    return counted(usual, "set") + (f" ({', '.join(others)})" if others else "")


def _range(values: Iterable[float]) -> str:
    """Return one number as text, or the smallest and largest number: ``1021 to 1024``."""
    found = sorted({int(value) for value in values})
    return " to ".join(map(str, found[:1] + found[1:][-1:]))


def _answer(bench: xr.Dataset) -> str:
    """Return a sentence that names the samplers with the least variance, or "" for one sampler."""
    ranks = bench["rank_ci"].transpose("sampler", "integrand", "bound").values
    first = (ranks == 1.0).all(axis=-1).sum(axis=-1)
    total = bench.sizes["integrand"]
    if bench.sizes["sampler"] < 2:
        return ""
    if not first.any():
        return f"No sampler is significantly the best on any of the {total} integrands."
    wins = sorted(zip(first.tolist(), bench_labels(bench), strict=True), key=lambda each: -each[0])
    best, *others = [(name, count) for count, name in wins[:_WINNERS] if count]
    told = "".join(f", {name} on {count}" for name, count in others)
    open_ = total - int(first.sum())
    rest = f"; on {open_} no sampler is significantly the best" if open_ else ""
    return f"Of {total} integrands, {best[0]} has the least variance on {best[1]}{told}{rest}."


def _said(bench: xr.Dataset) -> list[str]:
    """Describe the measurement in sentences."""
    low, high = bench["n"].values[[0, -1]]
    how = (
        f"{bench.sizes['sampler']} samplers on {bench.sizes['integrand']} integrands, "
        f"n = {low} … {high}, {bench.attrs['realizations']} realizations, "
        f"seed {bench.attrs['seed']}; mcspectra {__version__}. "
        "Rates are exponents of the variance in n with 95 % intervals (random: −1). A rate is "
        "shown as unresolved if half its interval exceeds 0.5. Ranks are by n · variance at the "
        "largest n; their 95 % intervals hold simultaneously. Speeds are for one thread and sets "
        "of the largest n. A curve that you cannot see lies under a later one of the legend."
    )
    note = bench.attrs.get("note")
    return [how, f"Note: {note}."] if note else [how]


def _page(bench: xr.Dataset, cards: Sequence[Card]) -> html.Page:
    names = bench_labels(bench)
    anchors = html.anchors(names, "s-")
    linked = [
        html.TableCell(text=name, numeric=False, link=f"#{anchor}" if cards else "")
        for name, anchor in zip(names, anchors, strict=True)
    ]

    def cells(rows: Iterable[Iterable[tuple[str, float]]]) -> list[list[str | html.TableCell]]:
        """Return one row per sampler, with cells that can be sorted by their numbers."""
        return [
            [name, *(html.number_cell(text, value) for text, value in row)]
            for name, row in zip(linked, rows, strict=True)
        ]

    heads, own = _sampler_table(bench)
    columns, shown = bench_table(bench)
    rates: Sequence[Sequence[str | html.TableCell]] = shown
    if by_sampler := columns[0] == "Sampler":
        values = bench["rate"].transpose("sampler", "integrand").values.tolist()
        rates = cells(
            zip(row[1:], each, strict=True) for row, each in zip(shown, values, strict=True)
        )
    tables = (
        html.table_of("Quality and speed at the largest n", heads, cells(own), sortable=True),
        html.table_of(
            "Rate on each integrand, with the rank in brackets", columns, rates, sortable=by_sampler
        ),
    )
    sections = [html.Section(title="Summary", anchor="summary", blocks=tables)]
    plots: dict[str, list[Plot]] = {}
    for title, _, plot, sets in bench_plots(bench):
        told = replace(plot, caption=f"{plot.caption} Here: {sets}.")
        plots.setdefault(title.partition(":")[0], []).append(told)
    for k, (title, found) in enumerate(plots.items()):
        blocks = html.figures_of(found, live=title != "Projections")
        sections.append(html.Section(title=title, anchor=f"part-{k}", blocks=blocks))
    if cards:
        sections += card_sections(cards, anchors)
    answer, *how = [_answer(bench), *_said(bench)]
    lead = (
        *([html.Paragraph(text=answer, kind="answer")] if answer else []),
        *(html.Paragraph(text=sentence) for sentence in how),
    )
    return html.Page(title="Sampler bench", what="bench", lead=lead, sections=tuple(sections))


def _sheets(bench: xr.Dataset) -> Iterator[Drawn]:
    """Yield sheets that describe the measurement and show the tables."""
    from matplotlib.figure import Figure as MatplotlibFigure

    lines: list[tuple[str, bool]] = [("Sampler bench", True), ("", False)]
    lines += [
        (line, False)
        for text in (_answer(bench), *_said(bench))
        for line in textwrap.wrap(text, 108)
    ]
    alone, own = _sampler_table(bench)
    texts = [
        [name, *(text for text, _ in row)]
        for name, row in zip(bench_labels(bench), own, strict=True)
    ]
    for heads, rows in ((alone, texts), bench_table(bench)):
        # Wrap long column headers over several lines
        broken = [textwrap.wrap(head, 26 if k == 0 else 14) or [""] for k, head in enumerate(heads)]
        tall = max(map(len, broken))
        above = [[([""] * (tall - len(b)) + b)[line] for b in broken] for line in range(tall)]
        widths = [max(map(len, column)) for column in zip(*above, *rows, strict=True)]
        lines.append(("", False))
        for k, row in enumerate([*above, *rows]):
            first, *others = (t.rjust(w) for t, w in zip(row, widths, strict=True))
            lines.append(("  ".join([first.strip().ljust(widths[0]), *others]).rstrip(), k < tall))
    size = min(8.5, 9.6 * 72 / (0.61 * max(len(line) for line, _ in lines)))
    for start in range(0, len(lines), _ROWS):
        figure = MatplotlibFigure(figsize=(11.0, 8.5), facecolor=PAPER)
        for k, (line, bold) in enumerate(lines[start : start + _ROWS]):
            text, weight = backend_matplotlib.escaped(line), "bold" if bold else "normal"
            drawn = figure.text(0.04, 0.95 - 0.0205 * k, text, fontsize=size, color=INK)
            drawn.set(family="monospace", weight=weight)
        yield figure
