"""Write results as values, tables (CSV, LaTeX), images or pages, depending on the extension."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core.decoding import path_to_write
from mcspectra.core.display import csv_cell, printable, shown
from mcspectra.core.errors import Parameter, ParameterError, writing
from mcspectra.core.fits import is_resolved
from mcspectra.core.spec import short_spec
from mcspectra.plots import backend_matplotlib
from mcspectra.plots.kinds import describe, kinds_of
from mcspectra.plots.text import (
    LATEX_TEXT,
    MISSING,
    interval,
    latex_maths,
    number,
    shorten,
    typeset,
)
from mcspectra.report import page as html

__all__ = [
    "RESULT_FILES",
    "check_result_file",
    "csv_text",
    "latex_table",
    "result_table",
    "write_result",
    "write_result_file",
]

RESULT_FILES = (".npz", ".csv", ".tex", *backend_matplotlib.FORMATS, ".html")
"""Extensions that `write_result_file` accepts."""

_SAID = ("answer", "diagnosis", "note")
# Combinations of dims. A page has one table for all variables with the same combination
_TABLES = (
    ("sampler",), ("method",), ("n",), ("sampler", "n"), ("method", "n"), ("sampler", "method"),
    ("sampler", "method", "n"),
)  # fmt: skip
_LONG = 300  # an attribute with at least this many characters is not listed among the facts
_MOST_TEX_ROWS = 500


def check_result_file(file: str, known: tuple[str, ...] = RESULT_FILES) -> None:
    """Check the extension of a file, and that it can be written, before anything is computed.

    Raises
    ------
    ParameterError
        If the extension is not one of `known`.
    MissingDependency
        If the file is a page and the extra ``report`` is not installed.
    """
    if Path(file).suffix not in known:
        allowed = " or ".join(filter(None, [", ".join(known[:-1]), known[-1]]))
        raise ParameterError(Parameter("out"), f" is {shown(file)}; it must end in {allowed}.")
    path_to_write(file, "a file", known)
    if Path(file).suffix == ".html":
        html.check_page_packages()


def write_result_file(result: xr.Dataset, file: str, title: str, kind: str = "") -> None:
    """Write the result of an analysis in the format of the file's extension.

    Parameters
    ----------
    result
        Result of the analysis.
    file
        Path of the file. With ``.npz``, all values are written; ``.html`` gives a page.
        ``.csv`` and ``.tex`` give the table of `result_table`.
        An image extension gives the first plot that fits the result.
    title
        Title of the page.
    kind
        Kind of plot for an image. A kind that does not fit the result is ignored.

    Raises
    ------
    ParameterError
        If no image or table shows this result, or the table is too long for LaTeX.
    FileFormatError, StoreError, StorageError
        If the file cannot be written.
    """
    path = Path(file)
    with writing(file):
        match path.suffix:
            case ".npz":
                np.savez(file, **{str(k): v.values for k, v in result.variables.items()})  # type: ignore[arg-type]
            case ".csv":
                single = {k: v.values.tolist() for k, v in result.data_vars.items() if v.size < 3}
                known = {**result.attrs, **single}
                about = {k: v for k, v in known.items() if "\n" not in str(v)}
                path.write_text(csv_text(*result_table(result), about), encoding="utf-8")
            case ".tex":
                columns, rows = result_table(result)
                named = [name.replace("_", " ") for name in columns]
                path.write_text(latex_table(named, rows), encoding="utf-8")
            case ".html":
                write_result(result, file, title)
            case _:
                kinds = kinds_of(result)
                if not kinds:
                    raise ParameterError(
                        Parameter("out"),
                        f" is {file!r}, but no image shows this result; give a .npz file.",
                    )
                backend_matplotlib.write(
                    describe(kind if kind in kinds else kinds[0], result), file
                )


def result_table(
    result: xr.Dataset, dims: tuple[str, ...] | None = None
) -> tuple[list[str], list[list[Any]]]:
    """Return the columns and rows of a table of a result.

    The table has all variables with the given `dims`, and one row per coordinate.
    By default, `dims` is the most common combination of dims among the variables.
    The values of a variable with fewer dims are repeated along the missing dims.
    An interval gives two columns, ``_low`` and ``_high``. Scalars alone give one row.
    """
    variables = {str(k): v for k, v in result.data_vars.items() if v.dtype.kind in "fiubUO"}
    if dims is None:
        shapes = [tuple(str(d) for d in v.dims if d != "bound") for v in variables.values()]
        many = [shape for shape in dict.fromkeys(shapes) if shape]
        dims = max(many, key=shapes.count, default=())

    columns: dict[str, Any] = {}
    sizes = {d: result.sizes[d] for d in dims}
    rows = math.prod(sizes.values())
    for dim, at in zip(map(str, dims), np.indices(tuple(sizes.values())), strict=True):
        places = result[dim].values if dim in result.coords else np.arange(sizes[dim])
        columns[dim] = places[at.ravel()]
    for name, values in variables.items():
        own = [d for d in values.dims if d != "bound"]
        if not set(own) <= set(dims) or (dims and not own):
            continue  # a variable with other dims belongs to another table
        missing = {d: sizes[d] for d in dims if d not in own}
        full = values.expand_dims(missing).transpose(*dims, ...).values.reshape(rows, -1)
        ends = ("_low", "_high") if "bound" in values.dims else ("",)
        head = name.removesuffix("_ci") if len(ends) == 2 else name
        columns |= {head + end: full[:, i] for i, end in enumerate(ends)}
    if not columns:
        raise ParameterError("This result has no table; give a .npz file.")
    cells = [[_plain(value) for value in column] for column in columns.values()]
    return list(columns), [list(row) for row in zip(*cells, strict=True)]


def csv_text(
    columns: Sequence[str], rows: Iterable[Sequence[Any]], about: dict[Any, Any] | None = None
) -> str:
    """Return comma-separated values with all digits, after comment lines ``# name: value``.

    `csv_cell` changes cells that a spreadsheet would run as formulas.
    """
    stream = io.StringIO()
    for name, value in (about or {}).items():
        # Add a space after commas and semicolons: spreadsheets may start a new cell after them
        text = printable(f"# {name}: {value}")
        stream.write(re.sub(r"([,;])(?=[^\w\s])", r"\1 ", text) + "\n")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(map(csv_cell, columns))
    writer.writerows(["" if each is None else csv_cell(each) for each in row] for row in rows)
    return stream.getvalue()


def latex_table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a LaTeX tabular of numbers, rounded to a few digits.

    Raises
    ------
    ParameterError
        If there are more than 500 rows.
    """
    if len(rows) > _MOST_TEX_ROWS:
        raise ParameterError(
            f"The table has {len(rows)} rows, but LaTeX files are limited to {_MOST_TEX_ROWS}; "
            "give a .csv file."
        )

    def cell(value: Any) -> str:
        if value is None:
            return "--"
        text = number(value) if isinstance(value, float) else short_spec(printable(value))
        return latex_maths(text.translate(LATEX_TEXT))

    words = [any(isinstance(row[i], str) for row in rows) for i in range(len(columns))]
    lines = [
        rf"\begin{{tabular}}{{{''.join('l' if w else 'r' for w in words)}}}",
        r"\hline",
        " & ".join(cell(name) for name in columns) + r" \\",
        r"\hline",
        *(" & ".join(map(cell, row)) + r" \\" for row in rows),
        r"\hline",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _plain(value: Any) -> Any:
    """Convert a NumPy scalar to a Python value; NaN becomes None."""
    plain = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(plain, float) and math.isnan(plain) else plain


def write_result(result: xr.Dataset, out: str | Path, title: str = "Result") -> Path:
    """Write the result of any analysis as one self-contained page.

    Parameters
    ----------
    result
        Dataset from an analysis such as `mcspectra.convergence`, or from `Profile.dataset`.
    out
        Path of the page.
    title
        Title of the page, to which the name of the estimator is added.

    Raises
    ------
    StoreError, StorageError
        If the page cannot be written.
    """
    attributes = {str(key): value for key, value in result.attrs.items()}
    said = [typeset(str(attributes[name])) for name in _SAID if attributes.get(name)]
    causes = tuple(
        (cause["name"], typeset(cause["sentence"]))
        for cause in json.loads(attributes.get("causes", "[]"))
    )

    # Figures, and scalars with their intervals
    shown = [kind for kind in kinds_of(result) if kind != "anything"]
    described = (describe(kind, result) for kind in shown)
    plots = dict(zip(html.anchors(shown), described, strict=True))
    single = [
        (str(name), *_value(result, str(name)), str(values.attrs.get("long_name", "")))
        for name, values in result.data_vars.items()
        if not values.ndim and not str(name).endswith(("_ci", "_se"))
    ]
    heads = ("number", "value", "95 % interval", "meaning")
    tables = [
        html.table_of("Numbers with their 95 % intervals", heads, single, words=(0, -1)),
        *(_curves(result, dims) for dims in _TABLES),
    ]
    facts = [
        (name, str(value))
        for name, value in attributes.items()
        if name not in (*_SAID, "causes", "best", "text")
        and not name.startswith("version_")
        and len(str(value)) < _LONG
    ]
    parts: dict[str, tuple[html.Block, ...]] = {
        "Causes": (html.Sentences(rows=causes),) if causes else (),
        "Figures": html.figures_of(plots, live=True),
        "Numbers": tuple(table for table in tables if table.rows),
        "Provenance": html.provenance(facts, attributes, code=True),
    }
    about = shorten(str(attributes.get("estimator", "")), 60)
    page = html.Page(
        title=f"{title}: {about}" if about else title,
        what="result",
        lead=tuple(html.Paragraph(text=sentence) for sentence in said),
        sections=html.sections_of(parts),
    )
    return html.write_page(page, Path(out))


def _value(result: xr.Dataset, name: str) -> tuple[str, str]:
    """Return a scalar and its interval as texts. A rate with a wide interval is "unresolved"."""
    value, ends = float(result[name]), f"{name}_ci"
    if ends not in result:
        return number(value), ""
    low, high = result[ends].values.tolist()
    resolved = not name.endswith("rate") or not low < high or is_resolved(low, high)
    return number(value) if resolved else "unresolved", interval(low, high)


def _curves(result: xr.Dataset, dims: tuple[str, ...]) -> html.Table:
    """Return a table of all variables over `dims`, with one row for each place on these dims.

    If there are several channels, the table shows the first channel.
    If the method behind each value is known, the table has columns for the method.
    """
    first = result.isel(channel=0) if "channel" in result.dims else result
    names = [
        str(name)
        for name, values in first.data_vars.items()
        if values.dims == dims and not str(name).endswith(("_ci", "_se"))
    ]
    said = [key for key in ("method", "how") if key in first.coords and key not in dims]
    said = [key for key in said if first[key].dims == dims]
    rows = []
    for place in np.ndindex(*(first.sizes.get(dim, 0) for dim in dims)):
        one = first.isel(dict(zip(dims, place, strict=True)))
        found = [_value(one, name) for name in names]
        if any(text != MISSING for text, _ in found):
            shown = [
                text if ends in ("", MISSING, f"{text} … {text}") else f"{text} ({ends})"
                for text, ends in found
            ]
            places, how = ([str(one[name].item()) for name in given] for given in (dims, said))
            rows.append((*places, *shown, *how))
    columns = (*dims, *(name.replace("_", " ") for name in (*names, *said)))
    caption = "Values; 95 % intervals in brackets unless they round to the value"
    return html.table_of(caption, columns, rows, words=range(len(columns)), heads=len(dims))
