"""One page that stands alone: sections of text, facts, tables and figures, written in one step.

Every report is a `Page`, which is plain data; `write_page` draws its figures and makes the HTML.
Styles, scripts and pictures are inside, nothing is loaded. A figure is a picture and, where it is
`live`, an interactive plot that takes the picture's place once scripts run; on paper the picture
stands. All text is escaped, except `Markup` that our own code makes. The same page gives the same
bytes. Templates and interactive plots need the extra ``report``, all other modules of this package do
not: `check_page_packages`.
"""

from __future__ import annotations

import base64
import html
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, final

from mcspectra.core.checks import as_path
from mcspectra.core.display import printable
from mcspectra.core.errors import Parameter, ParameterError, StoreError, writing
from mcspectra.core.registry import optional_package
from mcspectra.core.results import strict_json
from mcspectra.plots.description import Plot
from mcspectra.plots.text import MISSING, slug

__all__ = [
    "Block",
    "Cell",
    "Facts",
    "Figure",
    "Figures",
    "Folded",
    "Markup",
    "Page",
    "Section",
    "Sentences",
    "Table",
    "Text",
    "anchors",
    "check_page_packages",
    "columns_of",
    "figures_of",
    "markup",
    "number_cell",
    "page_file",
    "provenance",
    "sections_of",
    "table_of",
    "versions_of",
    "write_json",
    "write_page",
]


@final
class Markup(str):
    """HTML that our own code makes, which the template inserts as it is."""

    __slots__ = ()

    def __html__(self) -> str:
        return str(self)

    def format(self, *values: object) -> Markup:  # type: ignore[override]
        """Insert values, escaped unless they are HTML themselves."""
        texts = (v if isinstance(v, Markup) else html.escape(str(v)) for v in values)
        return Markup(str(self).format(*texts))


@final
@dataclass(frozen=True, kw_only=True)
class Text:
    """A paragraph, a heading within a section, a quotation, code, or a formula as MathML."""

    text: str | Markup
    kind: Literal["", "soft", "heading", "quote", "code", "formula"] = ""


@final
@dataclass(frozen=True, kw_only=True)
class Facts:
    """Names and what is known of them, as a list; `code` sets the texts in a fixed width."""

    rows: tuple[tuple[str, str | Markup], ...]
    code: bool = False


@final
@dataclass(frozen=True, kw_only=True)
class Sentences:
    """What the numbers say, each with what it is about."""

    rows: tuple[tuple[str, str], ...]


@final
@dataclass(frozen=True, kw_only=True)
class Cell:
    """Text of a cell.

    Attributes
    ----------
    why
        Why there is no number, as a tooltip.
    numeric
        Whether its digits stand below one another.
    order
        The number that the cell is sorted by.
    link
        Where the text leads.
    mark
        ``yes``, ``no`` or ``none``: the color of a verdict, which the text says as well.
    """

    text: str
    why: str = ""
    numeric: bool = True
    order: float | None = None
    link: str = ""
    mark: Literal["", "yes", "no", "none"] = ""


@final
@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows of cells, the first `heads` of which are heads.

    Attributes
    ----------
    sortable
        Whether a click on a column's head sorts by it.
    stacked
        Whether a narrow screen sets the cells of a row below one another, for long texts.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    heads: int = 1
    sortable: bool = False
    stacked: bool = False


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Figure:
    """A plot in a page; where it has a name, its files in the folder of figures are named so.

    Attributes
    ----------
    live
        Whether it is interactive as well.
    """

    plot: Plot
    name: str = ""
    live: bool = False

    @property
    def is_broad(self) -> bool:
        """Whether it takes the whole width; half of it holds one column of panels that are live."""
        abreast = min(self.plot.columns, len(self.plot.panels))
        several_rows = 1 < abreast < len(self.plot.panels)
        return self.plot.wide or abreast > 2 or (self.live and several_rows)


@final
@dataclass(frozen=True, kw_only=True)
class Figures:
    """Figures, two abreast where there is room."""

    figures: tuple[Figure, ...]


@final
@dataclass(frozen=True, kw_only=True)
class Folded:
    """What is shown on a click on its summary, and on paper."""

    summary: str
    blocks: tuple[Block, ...]


Block: TypeAlias = Text | Facts | Sentences | Table | Figures | Folded


@final
@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of a page, which the contents lead to.

    Attributes
    ----------
    anchor
        Distinct within a page; `anchors` makes them.
    blocks
        A section without any is left out.
    beside
        Words beside its name in the contents, in the color of `mark`.
    fresh
        Whether it begins a new sheet on paper.
    """

    title: str
    anchor: str
    blocks: tuple[Block, ...]
    beside: str = ""
    mark: Literal["", "yes", "no", "none"] = ""
    code: bool = False
    fresh: bool = False


@final
@dataclass(frozen=True, kw_only=True)
class Page:
    """A report: title, what it is (``report``, ``map`` …), opening paragraphs and sections."""

    title: str
    what: str
    sections: tuple[Section, ...]
    lead: tuple[Block, ...] = ()


def anchors(names: Iterable[str], head: str = "") -> list[str]:
    """Return names for anchors and files: kebab-case and distinct."""
    found: list[str] = []
    for name in names:
        base = anchor = head + slug(name)
        repeat = 2
        while anchor in found:
            anchor, repeat = f"{base}-{repeat}", repeat + 1
        found.append(anchor)
    return found


def number_cell(text: str, order: float | None = None, *, why: str = "") -> Cell:
    """Return the cell of a number: why there is none where there is none, and what it is sorted by."""
    known = order is not None and math.isfinite(order)
    why = why if text.startswith(MISSING) else ""
    return Cell(text=text, why=why, order=order if known else None)


def table_of(
    caption: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str | Cell]],
    *,
    words: Iterable[int] = (0,),
    **options: Any,
) -> Table:
    """Return a table of texts, which are words in these columns (−1: the last) and else numbers.

    What is a cell already stays as it is; the options are those of `Table`.
    """
    places = {place % len(columns) for place in words}
    cells = tuple(
        tuple(
            each if isinstance(each, Cell) else Cell(text=each, numeric=k not in places)
            for k, each in enumerate(row)
        )
        for row in rows
    )
    return Table(caption=caption, columns=tuple(columns), rows=cells, **options)


def sections_of(blocks: Mapping[str, Sequence[Block]]) -> tuple[Section, ...]:
    """Return sections by their titles, which name their anchors."""
    return tuple(
        Section(title=title, anchor=slug(title), blocks=tuple(each))
        for title, each in blocks.items()
    )


def provenance(
    facts: Iterable[tuple[str, str]], attributes: Mapping[Any, Any], *, code: bool = False
) -> tuple[Facts]:
    """Return where a result comes from: facts, and the versions that its attributes name."""
    own = ("versions" if code else "Versions", versions_of(attributes))
    return (Facts(rows=(*facts, own), code=code),)


def columns_of(table: Table, names: Sequence[str]) -> Table:
    """Return the table with these columns only."""
    places = [table.columns.index(name) for name in names]
    rows = tuple(tuple(row[i] for i in places) for row in table.rows)
    return replace(table, columns=tuple(names), rows=rows)


def figures_of(
    plots: Mapping[str, Plot] | Iterable[Plot], *, live: bool = False
) -> tuple[Figures, ...]:
    """Return a block of plots, by the names of their files where they have any; nothing of none."""
    named = plots.items() if isinstance(plots, Mapping) else (("", plot) for plot in plots)
    figures = tuple(Figure(plot=plot, name=name, live=live) for name, plot in named)
    return (Figures(figures=figures),) if figures else ()


def versions_of(attributes: Mapping[Any, Any]) -> str:
    """Return the versions that a result was computed with, as its attributes ``version_*`` have them."""
    head = "version_"
    found = {str(key): value for key, value in attributes.items() if str(key).startswith(head)}
    return ", ".join(f"{key.removeprefix(head)} {found[key]}" for key in sorted(found))


def check_page_packages(extras: str = "report") -> None:
    """Refuse a page before anything is computed for it.

    Parameters
    ----------
    extras
        Extras that the error names: those of the page, and others that its caller needs.

    Raises
    ------
    MissingDependency
        The extra ``report`` is not installed.
    """
    for name in ("bokeh", "jinja2"):
        optional_package(name, extras, "An HTML page needs")


def page_file(folder: Path, name: str, out: object) -> Path:
    """Return where a page goes: to `out`, or to a file of this name in the folder, unless it is a store.

    Raises
    ------
    ParameterError
        `out` is no path, or missing with a store, which has a digest of all its files.
    """
    if out is not None:
        return as_path("out", out)
    if folder.suffix == ".zarr":
        raise ParameterError(
            f"{str(folder)!r} is a store, in which no page is written; give the path of a page, ",
            Parameter("out"),
            ".",
        )
    return folder / name


def write_page(page: Page, file: Path, figures: Path | None = None) -> Path:
    """Draw the figures of a page and write it.

    Parameters
    ----------
    page
        What it shows.
    file
        Replaced in one step, so that a reader never sees half of it; its folder is there.
    figures
        Folder, made if need be, for ``NAME.png`` and ``NAME.pdf`` of every figure that has a name.

    Raises
    ------
    StoreError
        It is no place for a file: the folder is not there, or not open to the user.
    StorageError
        The disk is full, or fails.
    MissingDependency
        The extra ``report`` is not installed.
    """
    check_page_packages()
    from jinja2 import Environment, PackageLoader, StrictUndefined

    page = replace(page, sections=tuple(section for section in page.sections if section.blocks))
    with writing(file, StoreError):
        if figures is not None:
            figures.mkdir(exist_ok=True)

        # Figures are drawn one at a time, as the template comes to them
        environment = Environment(
            loader=PackageLoader("mcspectra.report", ""),
            autoescape=True,
            undefined=StrictUndefined,
            finalize=_shown,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.globals["kind"] = lambda block: type(block).__name__
        seen: Counter[str] = Counter()

        def label(text: str) -> str:
            """Number the labels of regions that the page has already."""
            seen[text] += 1
            return text if seen[text] == 1 else f"{text} ({seen[text]})"

        environment.globals["label"] = label
        environment.globals["drawn"] = lambda figure: _drawn(figure, figures, file.parent)
        script = ""
        if any(figure.live for section in page.sections for figure in _figures_in(section.blocks)):
            from mcspectra.plots.backend_bokeh import script as bokeh_script

            script = bokeh_script()
        text = environment.get_template("page.html.j2").render(page=page, bokeh=script)
        partial = file.parent / f".{file.name}.partial"
        try:
            partial.unlink(missing_ok=True)  # else a link would be followed
            partial.write_text(text, encoding="utf-8")
            partial.replace(file)
        finally:
            partial.unlink(missing_ok=True)
    return file


def write_json(file: Path, value: Any) -> None:
    """Write numbers for programs: NaN is null, infinite ends are texts."""
    text = json.dumps(strict_json(value), indent=1, ensure_ascii=False, allow_nan=False)
    with writing(file, StoreError):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text + "\n", encoding="utf-8")


def markup(template: str, *texts: object) -> Markup:
    """Return a template of ours whose ``{}`` are replaced by texts of others, printable and escaped."""
    return Markup(template).format(*map(_shown, texts))


def _shown(value: Any) -> Any:
    """Text of others without controls; markup stays."""
    is_text = isinstance(value, str) and not hasattr(value, "__html__")
    return printable(value, lines=True) if is_text else value


def _figures_in(blocks: Iterable[Block]) -> Iterable[Figure]:
    for block in blocks:
        if isinstance(block, Figures):
            yield from block.figures
        elif isinstance(block, Folded):
            yield from _figures_in(block.blocks)


def _drawn(figure: Figure, folder: Path | None, root: Path) -> Mapping[str, Any]:
    """A figure as the template takes it: PNG in base 64 with its size, and the packed live plot."""
    from mcspectra.plots import backend_matplotlib

    plot, file, filed = figure.plot, "", folder is not None and bool(figure.name)
    png, pdf = backend_matplotlib.encode(backend_matplotlib.draw(plot), print_too=filed)
    if folder is not None and filed:
        for end, content in ((".png", png), (".pdf", pdf)):
            place = folder / f"{figure.name}{end}"
            place.unlink(missing_ok=True)
            place.write_bytes(content)
        file = (folder / f"{figure.name}.pdf").relative_to(root).as_posix()
    live = ""
    if figure.live:
        from mcspectra.plots import backend_bokeh

        live = backend_bokeh.packed(backend_bokeh.draw(plot).model)
    return {
        "png": base64.b64encode(png).decode("ascii"),
        # Bytes 16 to 24 of a PNG are its width and height
        "width": int.from_bytes(png[16:20], "big"),
        "height": int.from_bytes(png[20:24], "big"),
        "words": plot.words or plot.caption,
        "caption": plot.caption,
        "wide": figure.is_broad,
        "abreast": min(plot.columns, len(plot.panels)) > 1,
        "file": file,
        "live": live,
    }
