"""The pages of a bench: one table of all samplers, overlays, projections; HTML, PDF, LaTeX, PGF, CSV."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.plots import backend_matplotlib
from mcspectra.plots.bench import anisotropy, projections, quality_curves
from mcspectra.plots.description import Plot
from mcspectra.plots.kinds import describe
from mcspectra.plots.style import INK, PAPER, labels, sampler_styles
from mcspectra.plots.text import MISSING, number, rate
from mcspectra.plots.variance import task_curves
from mcspectra.report.page import (
    Cell,
    Figure,
    Figures,
    Page,
    Section,
    Table,
    Text,
    write_page,
)
from mcspectra.report.result_files import csv_text, latex_table, result_table
from mcspectra.variance.bench import Bench, Entry
from mcspectra.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawn

__all__ = [
    "BENCH_FILES",
    "bench_plots",
    "bench_table",
    "check_bench_file",
    "write_bench",
]

BENCH_FILES = (".html", ".pdf", ".csv", ".tex", ".pgf")
"""Extensions that `write_bench` knows."""

_TABLE_ROWS = 44  # on a sheet


def check_bench_file(file: str | None) -> None:
    """Refuse a file of another extension, before anything is measured."""
    if file is not None and Path(file).suffix not in BENCH_FILES:
        raise ParameterError(
            f"--out is {file!r}; it must end in {', '.join(BENCH_FILES[:-1])} or {BENCH_FILES[-1]}."
        )


def write_bench(bench: Bench, file: str) -> Path:
    """Write a bench in the format of the file's extension.

    Parameters
    ----------
    bench
        What was measured.
    file
        ``.html``: one page that stands alone; ``.pdf``: the table and all pictures, a sheet each, with
        fonts of Type 42; ``.csv``: variances, rates and ranks, a row for each sampler, integrand and
        n; ``.tex``: the table as a tabular; ``.pgf``: the convergence for LaTeX.

    Raises
    ------
    FileFormatError, StoreError, StorageError
        It cannot be written.
    """
    path, columns, rows = Path(file), *bench_table(bench)
    try:
        match path.suffix:
            case ".csv":
                data = bench.dataset()
                names = ["points_made", "variance", "variance_ci"]
                kept = data[[*names, "rate", "rate_ci", "rank", "rank_ci"]]
                head, lines = result_table(kept, ("sampler", "integrand", "n"))
                path.write_text(csv_text(head, lines, data.attrs), encoding="utf-8")
            case ".tex":
                text = latex_table(columns, [[each for each, _ in row] for row in rows])
                path.write_text(text, encoding="utf-8")
            case ".pgf":
                backend_matplotlib.write(next(plot for _, plot in bench_plots(bench)), file)
            case ".pdf":
                sheets = _sheets(bench, columns, rows)
                backend_matplotlib.write_pages(itertools.chain(sheets, bench_plots(bench)), file)
            case _:
                write_page(_page(bench, columns, rows), path)
    except OSError as error:
        raise FileFormatError(f"{file!r} cannot be written: {error.strerror}.") from None
    return path


def bench_table(bench: Bench) -> tuple[list[str], list[list[tuple[str, float]]]]:
    """Return the columns and rows of the summary: texts, each with the number that it is sorted by.

    A row for each integrand, a column for each sampler: rate, and in brackets the interval of its rank.
    """
    rank, ends = bench.ranks()
    rows = []
    for j, task in enumerate(bench.tasks):
        cells = [(task.title, float(j))]
        for i, entry in enumerate(bench.entries):
            low, high = ends[i, j]
            if math.isfinite(low):
                curve = entry.curves[task]
                slope = rate(float(curve["rate"]), *map(float, curve["rate_ci"].values))
                place = f"{low:.0f}" if low == high else f"{low:.0f}–{high:.0f}"
                cells.append((f"{slope} ({place})", float(rank[i, j])))
            else:
                cells.append((MISSING, math.nan))
        rows.append(cells)
    return ["Integrand", *_labels(bench)], rows


def _labels(bench: Bench) -> list[str]:
    return list(labels([entry.name for entry in bench.entries], 26).values())


def _sampler_rows(bench: Bench) -> tuple[list[str], list[list[tuple[str, float]]]]:
    """What is known of each sampler alone: speed and figures of quality at the largest n."""
    figures = list(dict.fromkeys(name for entry in bench.entries for name in entry.quality))
    rows = []
    for entry, label in zip(bench.entries, _labels(bench), strict=True):
        last = [
            entry.quality[name].means[-1] if name in entry.quality else math.nan for name in figures
        ]
        speed = math.nan if entry.speed is None else entry.speed.means[-1]
        n = MISSING if entry.speed is None else str(entry.speed.counts[-1])
        cells = [(number(mean), mean) for mean in last]
        rows.append([(label, 0.0), (n, 0.0), *cells, (number(speed, 2), speed)])
    heads = [name.replace("_", " ") for name in figures]
    return ["Sampler", "n", *heads, "points/s"], rows


def bench_plots(bench: Bench) -> Iterator[tuple[str, Plot]]:
    """Yield the pictures by the titles of their sections."""
    entries = bench.entries
    styles = sampler_styles([entry.name for entry in entries])
    for d in bench.dims:
        tasks = {
            task.title.rpartition(",")[0]: {
                e.name: e.curves[task] for e in entries if task in e.curves
            }
            for task in bench.tasks
            if task.dims == d
        }
        plot = task_curves({title: curves for title, curves in tasks.items() if curves}, styles)
        if plot.panels:
            yield f"Convergence in {d}-D", plot
    spectra = {e.name: e.spectrum for e in entries if e.spectrum is not None}
    if spectra:
        if bench.first_dims == 2:
            yield "Spectra and pairs", describe("spectrum", spectra, styles)
        yield "Spectra and pairs", describe("radial", spectra, styles)
        if bench.first_dims > 1:
            rings = {e.name: e.rings for e in entries if e.rings is not None}
            yield "Spectra and pairs", anisotropy(rings, styles)
    pairs = {e.name: e.pairs for e in entries if e.pairs is not None}
    if pairs:
        yield "Spectra and pairs", describe("pair-correlation", pairs, styles)
    names = dict.fromkeys(name for entry in entries for name in entry.quality)
    figures = {
        name: {e.name: e.quality[name] for e in entries if name in e.quality} for name in names
    }
    if figures:
        yield "Quality", quality_curves(figures, styles)
    for d in bench.dims:
        drawn = {e.name: _one_set(e, bench, d) for e in entries if d in e.source and d > 1}
        if not drawn:
            continue
        if d == 2:
            yield "Points", replace(projections(drawn, styles), columns=min(3, len(drawn)))
        for name, points in drawn.items() if d > 2 else ():
            yield f"Projections in {d}-D", projections({name: points}, styles)


def _one_set(entry: Entry, bench: Bench, dims: int) -> Any:
    source = entry.source[dims]
    return source.draw(source.nearest_count(min(1024, bench.counts[-1])), rng=bench.seed)[0]


def _said(bench: Bench) -> list[str]:
    """How it was measured, in sentences."""
    low, high = bench.counts[0], bench.counts[-1]
    how = (
        f"{len(bench.entries)} samplers on {len(bench.tasks)} integrands, n = {low} … {high}, "
        f"{bench.realizations} realisations, seed {bench.seed}; mcspectra {__version__}. Rates are "
        "exponents of the variance in n with 95 % intervals (random: −1), unresolved beyond 0.5. Ranks are "
        "by n · variance at the largest n, with 95 % intervals that hold for all ranks together; speeds are "
        "of one thread that makes the points."
    )
    return [how, *(f"{note[:1].upper()}{note[1:]}." for note in bench.notes())]


def _page(bench: Bench, columns: list[str], rows: list[list[tuple[str, float]]]) -> Page:
    def table(
        heads: list[str], lines: list[list[tuple[str, float]]], caption: str, words: int
    ) -> Table:
        cells = tuple(
            tuple(
                Cell(text=text, numeric=k >= words, order=order if math.isfinite(order) else None)
                for k, (text, order) in enumerate(line)
            )
            for line in lines
        )
        return Table(caption=caption, columns=tuple(heads), rows=cells, heads=words, sortable=True)

    summary = (
        table(*_sampler_rows(bench), "Samplers by themselves, at the largest n", 1),
        table(columns, rows, "Rates on each integrand, in brackets the rank", 1),
    )
    sections = [Section(title="Summary", anchor="summary", blocks=summary)]
    plots = itertools.groupby(bench_plots(bench), key=lambda each: each[0])
    for k, (title, found) in enumerate(plots):
        live = not title.startswith("Projections")
        block = Figures(figures=tuple(Figure(plot=plot, live=live) for _, plot in found))
        sections.append(Section(title=title, anchor=f"part-{k}", blocks=(block,)))
    lead = tuple(Text(text=sentence) for sentence in _said(bench))
    return Page(title="Sampler bench", what="bench", lead=lead, sections=tuple(sections))


def _sheets(
    bench: Bench, columns: list[str], rows: list[list[tuple[str, float]]]
) -> Iterator[Drawn]:
    """The table on sheets of paper, after what was measured."""
    import textwrap

    from matplotlib.figure import Figure as MatplotlibFigure

    heads, alone = _sampler_rows(bench)
    blocks = [(heads, alone), (columns, rows)]
    lines: list[tuple[str, bool]] = [("Sampler bench", True), ("", False)]
    lines += [(line, False) for text in _said(bench) for line in textwrap.wrap(text, 108)]
    for names, body in blocks:
        texts = [[text for text, _ in row] for row in body]
        wrapped = [name if len(name) < 14 else name.replace(" ", "\n", 1) for name in names]
        widths = [
            max(len(part) for part in (*name.split("\n"), *(row[k] for row in texts)))
            for k, name in enumerate(wrapped)
        ]
        tall = max(name.count("\n") for name in wrapped) + 1
        heading = [name.rjust(0).split("\n") for name in wrapped]
        heading = [[""] * (tall - len(parts)) + parts for parts in heading]
        table = [[parts[line] for parts in heading] for line in range(tall)]
        lines.append(("", False))
        for k, row in enumerate([*table, *texts]):
            cells = [
                text.rjust(width) if i else text.ljust(width)
                for i, (text, width) in enumerate(zip(row, widths, strict=True))
            ]
            lines.append(("  ".join(cells).rstrip(), k < tall))
    for start in range(0, len(lines), _TABLE_ROWS):
        figure = MatplotlibFigure(figsize=(11.0, 8.5), facecolor=PAPER)
        longest = max(len(line) for line, _ in lines)
        size = min(8.5, 10.2 * 72 / (0.61 * longest))
        for k, (line, bold) in enumerate(lines[start : start + _TABLE_ROWS]):
            figure.text(
                0.04, 0.95 - k * 0.0205, line.replace("$", r"\$"), family="monospace", fontsize=size,
                color=INK, weight="bold" if bold else "normal",
            )  # fmt: skip
        yield figure
