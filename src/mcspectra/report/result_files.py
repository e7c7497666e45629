"""Results as files: values, tables for spreadsheets and LaTeX, pictures, pages; the extension says which."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from mcspectra.core.errors import ParameterError, writing
from mcspectra.core.spec import short_spec
from mcspectra.plots import backend_matplotlib
from mcspectra.plots.kinds import describe, kinds_of
from mcspectra.plots.text import latex_maths, number
from mcspectra.report.result_page import write_result

__all__ = [
    "RESULT_FILES",
    "check_result_file",
    "csv_text",
    "latex_table",
    "result_table",
    "write_result_file",
]

RESULT_FILES = (".npz", ".csv", ".tex", *backend_matplotlib.FORMATS, ".html")
"""Extensions that `write_result_file` knows."""

_MOST_TEX_ROWS = 500
_TEX = str.maketrans({
    **{c: f"\\{c}" for c in "&%$#_{}"},
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
})  # fmt: skip


def check_result_file(file: str | None, known: tuple[str, ...] = RESULT_FILES) -> None:
    """Refuse a file of another extension than those known, before anything is computed."""
    if file is not None and Path(file).suffix not in known:
        allowed = f"{', '.join(known[:-1])} or {known[-1]}"
        raise ParameterError(f"--out is {file!r}; it must end in {allowed}.")


def write_result_file(result: xr.Dataset, file: str, title: str) -> None:
    """Write the result of an analysis in the format of the file's extension.

    Parameters
    ----------
    result
        What the analysis returned.
    file
        ``.npz`` holds all values, ``.csv`` and ``.tex`` the table of `result_table`, a picture the
        first kind of plot that shows the result, ``.html`` a page.
    title
        Of the page.

    Raises
    ------
    ParameterError
        No picture or table shows this result, or the table is too long for LaTeX.
    FileFormatError, StoreError, StorageError
        The file cannot be written.
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
                        f"--out is {file!r}; no picture shows this result, give a .npz file."
                    )
                backend_matplotlib.write(describe(kinds[0], result), file)


def result_table(
    result: xr.Dataset, dims: tuple[str, ...] | None = None
) -> tuple[list[str], list[list[Any]]]:
    """Return the columns and rows of the largest curve of a result.

    That is all variables over `dims`, by default those that most variables have, a row for each place,
    with what has fewer dims repeated; intervals are two columns, ``_low`` and ``_high``. Results of
    single numbers make one row.
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
            continue  # over other dims, or a single number: it belongs to another table
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
    """Return comma-separated values, numbers in full, after lines ``# name: value`` of what they are."""
    stream = io.StringIO()
    for name, value in (about or {}).items():
        stream.write(f"# {name}: {value}\n")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(["" if each is None else each for each in row] for row in rows)
    return stream.getvalue()


def latex_table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a tabular of LaTeX, numbers in four digits.

    Raises
    ------
    ParameterError
        It has more than 500 rows.
    """
    if len(rows) > _MOST_TEX_ROWS:
        raise ParameterError(
            f"The table has {len(rows)} rows, more than {_MOST_TEX_ROWS}; give a .csv file."
        )

    def cell(value: Any) -> str:
        if value is None:
            return "--"
        text = number(value) if isinstance(value, float) else short_spec(str(value))
        return latex_maths(text.translate(_TEX))

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
    """A number or text of Python; None where there is none."""
    plain = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(plain, float) and math.isnan(plain) else plain
