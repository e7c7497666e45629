"""Figures and tables of a result for a paper, as PDF, PGF, SVG and LaTeX."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from mcspectra.core.checks import as_choice
from mcspectra.core.errors import ParameterError, writing
from mcspectra.measure.bench import BENCH_QUALITY
from mcspectra.plots.groups import as_group, point_dims
from mcspectra.plots.kinds import describe, kinds_of
from mcspectra.plots.paper import SPECTRA, PaperStyle, paper_plot, write_paper_figure
from mcspectra.plots.points import QUALITY_HEADS
from mcspectra.plots.style import LineStyle
from mcspectra.plots.text import LATEX_TEXT, latex_maths
from mcspectra.plots.variance import BELOW_ROUNDING, below_rounding
from mcspectra.report.bench_page import BenchFigure, bench_labels, bench_plots
from mcspectra.report.result_files import latex_table, result_table

__all__ = ["write_paper"]

_COLUMN = 3.34  # inches; wider figures span both columns of the page
_MOST_ROWS = 60  # larger tables do not fit on a page and are only written as .csv files
_ROOT = re.compile(r"n\^\(([^)]*)\)")
_HEADS = QUALITY_HEADS | {"generalized_l2_discrepancy": "Generalized L2"}


class _Table(NamedTuple):
    """A table: its file name, the LaTeX source of its tabular, and its caption."""

    name: str
    source: str
    caption: str


def write_paper(
    result: xr.Dataset,
    folder: str | Path,
    *,
    width: str | float | None = None,
    font_size: float | None = None,
    spectra: str = "linear",
    colors: str | None = None,
) -> list[Path]:
    """Write the figures of a result as PDF, PGF and SVG files, its tables, and ``main.tex``.

    Parameters
    ----------
    result
        Result of `mcspectra.sampler_bench`, or of another analysis.
    folder
        Folder for the files. Existing files with the same names are replaced.
    width, font_size, colors
        Width of each figure, font size in points, and color map for spectra.
        See `mcspectra.plots.paper.PaperStyle.of`.
    spectra
        Color scale of spectra: ``"linear"`` or ``"log"``.

    Returns
    -------
    list of Path
        Paths of the figures, the tables and ``main.tex``, which is the last.

    Raises
    ------
    ParameterError
        If an option is not allowed, or no figure shows the result.
    FileFormatError, StoreError, StorageError
        If a file cannot be written.
    """
    style = PaperStyle.of(width, font_size, colors)
    as_choice("spectra", spectra, SPECTRA)
    bench = {"points_made", "integrand_dims"} <= set(map(str, result.variables))
    names = bench_labels(result) if bench else list(as_group(result)[0])
    styles = style.styles(names)
    drawn = bench_plots(result, styles, logarithmic=spectra == "log") if bench else None
    figures = list(drawn or _figures(result, styles))
    tables = list(_bench_tables(result) if bench else _tables(result))
    if not figures:
        raise ParameterError("No figure shows this result; write it to a .csv or .npz file.")

    root = Path(folder)
    with writing(root):
        root.mkdir(parents=True, exist_ok=True)
    written = list[Path]()
    for each in figures:
        plot = paper_plot(each.plot, style, styles)
        written += write_paper_figure(plot, root / each.name, style, each.sets)
    with writing(root):
        for table in tables:
            path = root / f"{table.name}.tex"
            path.write_text(table.source, encoding="utf-8")
            written.append(path)
        main = root / "main.tex"
        main.write_text(_main(figures, tables, style.look.width or 0.0), encoding="utf-8")
    return [*written, main]


def _figures(result: xr.Dataset, styles: Mapping[str, LineStyle]) -> Iterator[BenchFigure]:
    """Yield the figures of a result that is not a bench."""
    counted = [
        f"{key} = {result.attrs[key]}" for key in ("n", "realizations") if key in result.attrs
    ]
    for kind in kinds_of(result):
        yield BenchFigure(kind, kind, describe(kind, result, styles), ", ".join(counted))


def _tables(result: xr.Dataset) -> Iterator[_Table]:
    """Yield the table of a result that is not a bench, if it fits on a page."""
    columns, rows = result_table(result)
    if len(rows) <= _MOST_ROWS:
        heads = [name.replace("_", " ") for name in columns]
        yield _Table("values", latex_table(heads, rows), "Values of the result.")


def _bench_tables(bench: xr.Dataset) -> Iterator[_Table]:
    """Yield tables of rates, variances and quality. Columns are integrands or quality figures."""
    names = [_latex(name) for name in bench_labels(bench)]
    sets, last = bench.attrs["realizations"], int(bench["n"][-1])
    for d in dict.fromkeys(bench["integrand_dims"].values.tolist()):
        part = bench.isel(integrand=bench["integrand_dims"].values == d)
        titles = [str(title).rpartition(",")[0] for title in part["integrand"].values]
        best = part["rank_ci"].transpose("sampler", "integrand", "bound").values[..., 0] == 1.0
        cells = {"rates": list[list[str]](), "variances": list[list[str]]()}
        for i in range(part.sizes["sampler"]):
            one = part.isel(sampler=i)
            if not one["variance"].notnull().any():  # the sampler has no sets in d dims
                continue
            rates = []
            for k in range(one.sizes["integrand"]):
                curve = one.isel(integrand=k)
                text = _with_digits(float(curve["rate"]), *map(float, curve["rate_ci"].values))
                rates.append(BELOW_ROUNDING if text == "--" and below_rounding(curve) else text)
            at_last = one["variance"].isel(n=-1).values
            variances = [_scientific(float(value)) for value in at_last]
            cells["rates"].append([names[i], *rates])
            bold = [
                rf"$\mathbf{{{text[1:-1]}}}$" if first else text
                for text, first in zip(variances, best[i], strict=True)
            ]
            cells["variances"].append([names[i], *bold])
        captions = {
            "rates": (
                f"Rates: exponents of the variance in $n$ on integrands in {d}-D, from {sets} sets "
                r"per variance (random: $-1$). Digits in brackets are half the 95\,\% interval in "
                "units of the last digit; a rate in italics is not resolved."
            ),
            "variances": (
                f"Variances at $n = {last}$ (or the nearest count of a sampler) on integrands in "
                rf"{d}-D, from {sets} sets. Bold: no other sampler is significantly better "
                r"(95\,\%, all ranks together)."
            ),
        }
        for key, rows in cells.items():
            kinds = [title.partition(" (")[2].rstrip(")") for title in titles]
            heads = [_latex(title.partition(" (")[0]) for title in titles]
            yield _Table(f"{key}-{d}d", _grouped(kinds, ["Sampler", *heads], rows), captions[key])

    # Quality and speed at the largest n
    known = [key for key in BENCH_QUALITY if key in bench]
    speed = ["points_per_second"] if "points_per_second" in bench else []
    rows = []
    at_last_n = bench.isel(n=-1)
    for i, name in enumerate(names):
        values = [float(at_last_n[key][i]) for key in known + speed]
        cells_of = zip(known + speed, values, strict=True)
        rows.append([name, *(_quality(key, value) for key, value in cells_of)])
    if known:
        heads = ["Sampler", *(_HEADS[key] for key in known), *(["Points/s"] if speed else [])]
        many = bench["quality_sets"].values if "quality_sets" in bench else np.array([math.nan])
        told = f", means of {np.nanmax(many):.0f} sets" if np.isfinite(many).any() else ""
        yield _Table(
            "quality",
            _grouped([], heads, rows),
            f"Quality of {point_dims(bench)}-D sets at $n = {last}${told}. Minimum distances are "
            "relative to the densest packing; $t$ is the parameter of a $(t, m, d)$-net.",
        )


def _grouped(kinds: Sequence[str], heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a booktabs tabular of LaTeX cells; adjacent columns of one kind share a heading."""
    lines = [
        r"% needs \usepackage{booktabs}",
        rf"\begin{{tabular}}{{l{'r' * (len(heads) - 1)}}}",
        r"\toprule",
    ]
    if kinds:
        spans = [[k, k] for k in range(len(kinds)) if k == 0 or kinds[k] != kinds[k - 1]]
        for span, following in zip(spans, [*spans[1:], [len(kinds)]], strict=True):
            span[1] = following[0]
        above = [rf"\multicolumn{{{b - a}}}{{c}}{{{_latex(kinds[a])}}}" for a, b in spans]
        lines.append(" & ".join(["", *above]) + r" \\")
        lines.append(" ".join(rf"\cmidrule(lr){{{a + 2}-{b + 1}}}" for a, b in spans))
    lines += [" & ".join(heads) + r" \\", r"\midrule"]
    lines += [" & ".join(row) + r" \\" for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


def _main(figures: Sequence[BenchFigure], tables: Sequence[_Table], width: float) -> str:
    """Return a LaTeX page in two columns with all figures and tables."""
    star = "*" if width > _COLUMN else ""
    parts = []
    for each in figures:
        said = f"{each.plot.caption} {each.sets}." if each.sets else each.plot.caption
        caption = _latex(said)
        parts.append(
            f"\\begin{{figure{star}}}\n\\centering\n\\mcfigure{{{each.name}}}\n"
            f"\\caption{{{caption}}}\n\\label{{fig:{each.name}}}\n\\end{{figure{star}}}"
        )
    for table in tables:
        parts.append(
            "\\begin{table*}\n\\centering\\footnotesize\\setlength{\\tabcolsep}{4pt}\n"
            f"\\caption{{{table.caption}}}\n\\label{{tab:{table.name}}}\n"
            f"\\mctable{{{table.name}}}\n\\end{{table*}}"
        )
    body = "\n\n".join(parts)
    return _PAGE.replace("BODY", body)


_PAGE = r"""% Figures and tables for a paper. Compile: pdflatex main.tex
\documentclass[twocolumn]{article}
\usepackage[letterpaper,textwidth=7in,columnsep=0.33in,top=0.8in,bottom=0.8in]{geometry}
\usepackage{booktabs,graphicx,pgf}
% Figures as PDF; for texts in the fonts of the document replace this line by the next one
\newcommand{\mcfigure}[1]{\includegraphics{#1.pdf}}
%\newcommand{\mcfigure}[1]{\input{#1.pgf}}
\extrafloats{100}
\renewcommand{\topfraction}{0.9}
\renewcommand{\floatpagefraction}{0.7}
\renewcommand{\dblfloatpagefraction}{0.5}
% Tables shrink if they are wider than the text
\newsavebox{\mcbox}
\newcommand{\mctable}[1]{\sbox{\mcbox}{\input{#1.tex}\unskip}%
  \ifdim\wd\mcbox>\linewidth\resizebox{\linewidth}{!}{\usebox{\mcbox}}\else\usebox{\mcbox}\fi}
\begin{document}

BODY

\clearpage
\end{document}
"""


def _latex(text: str) -> str:
    """Return a text for LaTeX with signs, indices, exponents and roots as mathematics."""
    # In the list `words`, texts have even indices, and exponents of n have odd indices
    words = _ROOT.split(text)
    words[::2] = [latex_maths(word.translate(LATEX_TEXT)) for word in words[::2]]
    words[1::2] = [f"$n^{{{power.replace('−', '-')}}}$" for power in words[1::2]]
    return "".join(words)


def _quality(key: str, value: float) -> str:
    """Return a quality figure with three digits, or a speed with one digit, as LaTeX."""
    if math.isnan(value):
        return "--"
    if key == "t_value":
        return f"${value:.3g}$"
    return _scientific(value, 1 if key == "points_per_second" else 3)


def _scientific(value: float, digits: int = 2) -> str:
    """Return a number with a few digits as LaTeX: $0.12$ or $1.2\\cdot10^{-6}$."""
    if not math.isfinite(value):
        return "--" if math.isnan(value) else r"$\infty$"
    if value == 0.0 or 0.01 <= abs(value) < 100.0:
        return f"${value:#.{digits}g}$".replace(".$", "$")
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    return rf"${mantissa}{{\cdot}}10^{{{int(power)}}}$"


def _with_digits(value: float, low: float, high: float) -> str:
    """Return a rate with half of its interval in units of the last digit: $-1.52(3)$."""
    if not math.isfinite(value):
        return "--"
    half = 0.5 * (high - low)
    if not math.isfinite(half) or half <= 0.0:
        return f"${value:.2f}$"
    decimals = min(max(-math.floor(math.log10(half)), 0), 4)
    # The error should have one digit. If it is rounded up to 10, drop a decimal
    if round(half * 10**decimals) == 10:
        decimals = max(decimals - 1, 0)
    text = rf"{value:.{decimals}f}({max(round(half * 10**decimals), 1):.0f})"
    return rf"$\mathit{{{text}}}$" if half > 0.5 else f"${text}$"
