"""Self-contained HTML pages of text, facts, tables and figures, and decks of slides.

Every report is a `Page`, and every lecture is a `Deck`. Both contain only plain data.
`write_page` draws the figures and writes the HTML.
Styles, scripts and images are embedded, so a page needs no other files.

Each figure is an image. A `live` figure also has an interactive plot.
The plot replaces the image once scripts run. When the page is printed, the image is used.

All text is escaped except `Markup`, which only our own code creates.
The same page always gives the same bytes.
Templates and interactive plots need the extra ``report`` (see `check_page_packages`).
The other modules of this package do not need this extra.
"""

from __future__ import annotations

import base64
import html
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from mcspectra.core.checks import as_path
from mcspectra.core.display import printable
from mcspectra.core.errors import Parameter, ParameterError, StoreError, writing
from mcspectra.core.parallel import Mapper
from mcspectra.core.registry import optional_package
from mcspectra.core.results import strict_json
from mcspectra.plots.description import Plot
from mcspectra.plots.text import MISSING, slug

__all__ = [
    "Block",
    "Collapsible",
    "Deck",
    "FactList",
    "Figure",
    "Figures",
    "Markup",
    "Page",
    "Paragraph",
    "Screen",
    "Section",
    "Sentences",
    "Slider",
    "Table",
    "TableCell",
    "anchors",
    "check_page_packages",
    "columns_of",
    "figures_of",
    "markup",
    "maths",
    "number_cell",
    "page_file",
    "powers",
    "provenance",
    "sections_of",
    "table_of",
    "versions_of",
    "write_json",
    "write_page",
]


@final
class Markup(str):
    """HTML created by our own code. The template inserts it without escaping."""

    __slots__ = ()

    def __html__(self) -> str:
        return str(self)

    def format(self, *values: object) -> Markup:  # type: ignore[override]
        """Insert values. All values except `Markup` are escaped."""
        texts = (v if isinstance(v, Markup) else html.escape(str(v)) for v in values)
        return Markup(str(self).format(*texts))


@final
@dataclass(frozen=True, kw_only=True)
class Paragraph:
    """A paragraph, an answer, a heading inside a section, a quotation, code, or a formula."""

    text: str | Markup
    kind: Literal["", "answer", "soft", "heading", "quote", "code", "formula"] = ""


@final
@dataclass(frozen=True, kw_only=True)
class FactList:
    """A list of names with descriptions. If `code` is true, descriptions use a monospace font."""

    rows: tuple[tuple[str, str | Markup], ...]
    code: bool = False


@final
@dataclass(frozen=True, kw_only=True)
class Sentences:
    """Findings in words: pairs of a subject and a sentence."""

    rows: tuple[tuple[str, str], ...]


@final
@dataclass(frozen=True, kw_only=True)
class TableCell:
    """A cell of a table, as text with optional properties.

    Attributes
    ----------
    why
        Tooltip with the reason for a missing number.
    numeric
        Whether the cell is right-aligned with digits of equal width.
    order
        Value by which rows are sorted.
    link
        Address of a hyperlink on the text.
    mark
        CSS class of a verdict: ``yes``, ``no`` or ``none``. The text also states the verdict.
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
    """A table as rows of cells. The first `heads` cells of each row are row headers.

    Attributes
    ----------
    sortable
        Whether clicking on a column header sorts the rows by that column.
    stacked
        Whether the cells of a row are stacked on narrow screens. Useful for long texts.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[TableCell, ...], ...]
    heads: int = 1
    sortable: bool = False
    stacked: bool = False


@final
@dataclass(frozen=True, eq=False)
class Slider:
    """Plots with the same layout, one for each value of a parameter.

    Attributes
    ----------
    label
        Name of the parameter.
    plots
        One plot for each value of the parameter. The keys are the values, written as text.
    start
        Value whose plot is shown at first, on paper, and in browsers without scripts.
    """

    label: str
    plots: Mapping[str, Plot]
    start: str


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Figure:
    """A plot on a page. If it has a name, PNG and PDF files with this name are written.

    Attributes
    ----------
    live
        Whether the page also has an interactive version.
    slider
        Plots that replace this plot when a slider is moved.
    """

    plot: Plot
    name: str = ""
    live: bool = False
    slider: Slider | None = None

    @property
    def is_broad(self) -> bool:
        """Whether the figure needs the full page width instead of half of it."""
        abreast = min(self.plot.columns, len(self.plot.panels))
        several_rows = 1 < abreast < len(self.plot.panels)
        return self.plot.wide or abreast > 2 or (self.live and several_rows)


@final
@dataclass(frozen=True, kw_only=True)
class Figures:
    """A group of figures, arranged in pairs if the page is wide enough.

    Attributes
    ----------
    small
        Whether the figures are small pictures, shown five per row if the page is wide enough.
    """

    figures: tuple[Figure, ...]
    small: bool = False


@final
@dataclass(frozen=True, kw_only=True)
class Collapsible:
    """Blocks that are shown after a click on the summary. They are always printed."""

    summary: str
    blocks: tuple[Block, ...]


Block: TypeAlias = Paragraph | FactList | Sentences | Table | Figures | Collapsible


@final
@dataclass(frozen=True, kw_only=True)
class Section:
    """A section of a page, linked from the table of contents.

    Attributes
    ----------
    anchor
        HTML id, unique within a page; see `anchors`.
    blocks
        Contents. A section without blocks is omitted.
    beside
        Words next to the section's entry in the table of contents, in the color of `mark`.
    fresh
        Whether the section starts on a new sheet when printed.
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
    """A report: title, type (``report``, ``map`` …), opening paragraphs and sections."""

    title: str
    what: str
    sections: tuple[Section, ...]
    lead: tuple[Block, ...] = ()


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Screen:
    """A slide of a lecture: a statement, one figure, a verdict and collapsed details.

    Attributes
    ----------
    number
        Number of the slide in the navigation.
    anchor
        HTML id, unique within a deck.
    statement, formula
        Quotation, and a formula that is shown above everything else.
    figure
        The figure, which fills the screen. None for a slide of words only.
    verdict, condition, mark
        Verdict on the statement in one or two words, its condition, and its color class.
    reason
        Reason for the verdict.
    link
        Address of the explorer that shows the figure's settings, or empty.
    folded
        Details below the figure. They are hidden until a reader opens them. They are not printed.
    """

    number: str
    title: str
    anchor: str
    statement: str = ""
    formula: Paragraph | None = None
    figure: Figure | None = None
    verdict: str = ""
    condition: str = ""
    mark: Literal["", "yes", "some", "no", "none"] = ""
    reason: str = ""
    link: str = ""
    folded: tuple[Block, ...] = ()


@final
@dataclass(frozen=True, kw_only=True)
class Deck:
    """A lecture: a title page, slides that are shown one at a time, and a last page.

    Without scripts, all slides are shown below each other. When printed, each slide is a sheet.
    """

    title: str
    what: str
    screens: tuple[Screen, ...]
    lead: tuple[Block, ...] = ()
    last: Section | None = None


def anchors(names: Iterable[str], head: str = "") -> list[str]:
    """Return distinct kebab-case names for anchors and files."""
    found: list[str] = []
    for name in names:
        base = anchor = head + slug(name)
        repeat = 2
        while anchor in found:
            anchor, repeat = f"{base}-{repeat}", repeat + 1
        found.append(anchor)
    return found


def number_cell(text: str, order: float | None = None, *, why: str = "") -> TableCell:
    """Return a table cell for a number, sorted by the number; `why` explains a missing number."""
    known = order is not None and math.isfinite(order)
    why = why if text.startswith(MISSING) else ""
    return TableCell(text=text, why=why, order=order if known else None)


def table_of(
    caption: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str | TableCell]],
    *,
    words: Iterable[int] = (0,),
    **options: Any,
) -> Table:
    """Return a table from rows of texts.

    Parameters
    ----------
    caption, columns
        Caption and column headers.
    rows
        Rows of texts or of finished table cells.
    words
        Indices of the columns that contain words (−1: the last). All other columns contain numbers.
    **options
        Further attributes of the `Table`, by name.
    """
    places = {place % len(columns) for place in words}
    cells = tuple(
        tuple(
            each if isinstance(each, TableCell) else TableCell(text=each, numeric=k not in places)
            for k, each in enumerate(row)
        )
        for row in rows
    )
    return Table(caption=caption, columns=tuple(columns), rows=cells, **options)


def sections_of(blocks: Mapping[str, Sequence[Block]]) -> tuple[Section, ...]:
    """Return one section per title, with ids made from the titles."""
    return tuple(
        Section(title=title, anchor=slug(title), blocks=tuple(each))
        for title, each in blocks.items()
    )


def provenance(
    facts: Iterable[tuple[str, str]], attributes: Mapping[Any, Any], *, code: bool = False
) -> tuple[FactList]:
    """Return the provenance of a result: facts and the package versions in its attributes."""
    own = ("versions" if code else "Versions", versions_of(attributes))
    return (FactList(rows=(*facts, own), code=code),)


def columns_of(table: Table, names: Sequence[str]) -> Table:
    """Return the table restricted to the columns `names`."""
    places = [table.columns.index(name) for name in names]
    rows = tuple(tuple(row[i] for i in places) for row in table.rows)
    return replace(table, columns=tuple(names), rows=rows)


def figures_of(
    plots: Mapping[str, Plot] | Iterable[Plot], *, live: bool = False
) -> tuple[Figures, ...]:
    """Return one block with all plots, which are given by file name; or nothing without plots."""
    named = plots.items() if isinstance(plots, Mapping) else (("", plot) for plot in plots)
    figures = tuple(Figure(plot=plot, name=name, live=live) for name, plot in named)
    return (Figures(figures=figures),) if figures else ()


def versions_of(attributes: Mapping[Any, Any]) -> str:
    """Return all package versions (attributes ``version_*``) of a result as one text."""
    head = "version_"
    found = {str(key): value for key, value in attributes.items() if str(key).startswith(head)}
    return ", ".join(f"{key.removeprefix(head)} {found[key]}" for key in sorted(found))


def check_page_packages(extras: str = "report") -> None:
    """Check that pages can be written, before anything is computed for them.

    Parameters
    ----------
    extras
        Names of package extras for the error message.

    Raises
    ------
    MissingDependency
        If the extra ``report`` is not installed.
    """
    for name in ("bokeh", "jinja2"):
        optional_package(name, extras, "An HTML page needs")


def page_file(folder: Path, name: str, out: object) -> Path:
    """Return the path of a page: `out`, or by default the file `name` in `folder`.

    Raises
    ------
    ParameterError
        If `out` is not a path, or if it is missing and `folder` is a Zarr store.
        A page cannot be added to a store, because the store has a checksum of all its files.
    """
    if out is not None:
        return as_path("out", out)
    if folder.suffix == ".zarr":
        raise ParameterError(
            f"{str(folder)!r} is a Zarr store, which cannot hold a page; give a path for the page, "
            "",
            Parameter("out"),
            ".",
        )
    return folder / name


def write_page(
    page: Page | Deck,
    file: Path,
    figures: Path | None = None,
    *,
    with_pdf: bool = True,
    mapped: Mapper = map,
) -> Path:
    """Draw the figures of a page or a deck and write it.

    Parameters
    ----------
    page
        The page to write, or the deck of slides.
    file
        Path of the HTML file, in an existing folder. The file is replaced atomically.
    figures
        Folder for ``NAME.png`` and ``NAME.pdf`` of every named figure; created if missing.
    with_pdf
        Whether PDF files are written; this takes half of the time of a figure.
    mapped
        Function that draws the figures in order: ``map``, or a parallel map from `process_map`.

    Raises
    ------
    StoreError
        If the folder does not exist or is not writable.
    StorageError
        If the disk is full or fails.
    MissingDependency
        If the extra ``report`` is not installed.
    """
    check_page_packages()
    from jinja2 import Environment, PackageLoader, StrictUndefined

    template = "deck.html.j2"
    if isinstance(page, Page):
        template = "page.html.j2"
        page = replace(page, sections=tuple(section for section in page.sections if section.blocks))
    shown = list(_figures_on(page))
    draw = partial(
        _images, lecture=isinstance(page, Deck), filed=figures is not None, with_pdf=with_pdf
    )
    with writing(file, StoreError):
        if figures is not None:
            figures.mkdir(exist_ok=True)
        # Figures are drawn one at a time in each process, which limits memory
        drawn = {
            figure: _embedded(figure, images, figures, file.parent)
            for figure, images in zip(shown, mapped(draw, shown), strict=True)
        }
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
            """Add a number to the label of a page region if an earlier region has this label."""
            seen[text] += 1
            return text if seen[text] == 1 else f"{text} ({seen[text]})"

        environment.globals["label"] = label
        environment.globals["maths"] = maths
        environment.globals["powers"] = powers
        environment.globals["drawn"] = drawn
        script = ""
        if any(each["live"] for each in drawn.values()):
            from mcspectra.plots.backend_bokeh import script as bokeh_script

            script = bokeh_script()
        text = environment.get_template(template).render(page=page, bokeh=script)
        unfinished = file.parent / f".{file.name}.partial"
        try:
            unfinished.unlink(missing_ok=True)  # removes a symbolic link itself, not its target
            unfinished.write_text(text, encoding="utf-8")
            unfinished.replace(file)
        finally:
            unfinished.unlink(missing_ok=True)
    return file


def write_json(file: Path, value: Any) -> None:
    """Write strict JSON. NaN becomes null, and infinite values become strings."""
    text = json.dumps(strict_json(value), indent=1, ensure_ascii=False, allow_nan=False)
    with writing(file, StoreError):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text + "\n", encoding="utf-8")


_JOINER = "\u2060"  # word joiner, an invisible character that prevents a line break


def markup(template: str, *texts: object) -> Markup:
    """Insert texts for ``{}`` in our own HTML template, after escaping them."""
    return Markup(template).format(*map(_shown, texts))


def maths(text: str) -> Markup:
    """Return HTML in which subscripts (``S_m``) and exponents (``N^(−3/2)``) are lowered or raised.

    A subscript follows a single letter, so names such as ``strata_shift`` do not change.
    """
    found = html.escape(_shown(text))
    found = re.sub(r"(?<![^\W\d_])([^\W\d_])_([^\W_]+)", r"\1<sub>\2</sub>", found)
    return Markup(re.sub(r"\^(?:\(([^()]+)\)|([^\W_]+))", r"<sup>\1\2</sup>", found))


def powers(text: str) -> Markup:
    """Return HTML in which numbers in exponents (``n^−1.5``) are raised.

    Names of files and specs are not formulas, so subscripts remain as they are.
    """
    if hasattr(text, "__html__"):
        return Markup(text)
    found = html.escape(_shown(text))
    return Markup(re.sub(r"\^([−-]?\d+(?:\.\d+)?)(?!\w)", r"<sup>\1</sup>", found))


def _shown(value: Any) -> Any:
    """Remove control characters from text, except word joiners. Return other values unchanged."""
    if not isinstance(value, str) or hasattr(value, "__html__"):
        return value
    return _JOINER.join(printable(part, lines=True) for part in value.split(_JOINER))


def _figures_on(page: Page | Deck) -> Iterator[Figure]:
    yield from _figures_in(page.lead)
    if isinstance(page, Page):
        for section in page.sections:
            yield from _figures_in(section.blocks)
        return
    for screen in page.screens:
        if screen.figure is not None:
            yield screen.figure
        yield from _figures_in(screen.folded)
    if page.last is not None:
        yield from _figures_in(page.last.blocks)


def _figures_in(blocks: Iterable[Block]) -> Iterator[Figure]:
    for block in blocks:
        if isinstance(block, Figures):
            yield from block.figures
        elif isinstance(block, Collapsible):
            yield from _figures_in(block.blocks)


_THUMBNAIL = (176, 112)  # largest width and height in pixels: twice the size on the page


@final
@dataclass(frozen=True, kw_only=True)
class _Images:
    """Image files of a figure: PNG, PDF if it is written, and PNG for each value of its slider."""

    png: bytes
    pdf: bytes
    frames: Mapping[str, bytes]
    thumbnail: bytes


def _images(figure: Figure, *, lecture: bool, filed: bool, with_pdf: bool) -> _Images:
    """Draw a figure. Figures of a lecture are cropped and have thumbnails."""
    from mcspectra.plots import backend_matplotlib

    look = backend_matplotlib.LECTURE if lecture else backend_matplotlib.Look()
    with_pdf = with_pdf and filed and bool(figure.name)
    pdf, palettes = b"", []
    pixels: list[NDArray[np.uint8]] = []
    like = None
    for plot in (figure.plot, *_others(figure).values()):
        drawn = backend_matplotlib.draw(plot, look=look)
        first = like is None
        found, file = backend_matplotlib.rasterize(
            drawn, with_pdf=with_pdf and first, dpi=look.dpi, like=like
        )
        like = drawn if first else like
        pdf = file if first else pdf
        pixels.append(found)
        palettes.append(backend_matplotlib.has_few_colors(drawn))
    if lecture:
        pixels = _cropped(pixels)
    png, *others = map(backend_matplotlib.png_of, pixels, palettes)
    pngs = dict(zip(_others(figure), others, strict=True))
    values = figure.slider.plots if figure.slider else {}
    return _Images(
        png=png,
        pdf=pdf,
        frames={value: pngs.get(value, png) for value in values},
        thumbnail=_thumbnail(pixels[0]) if lecture else b"",
    )


def _embedded(
    figure: Figure, images: _Images, folder: Path | None, root: Path
) -> Mapping[str, Any]:
    """Write the files of a figure, and return its images in base64 for the template."""
    plot, png, file = figure.plot, images.png, ""
    if folder is not None and figure.name:
        for end, content in ((".png", png), (".pdf", images.pdf)):
            place = folder / f"{figure.name}{end}"
            place.unlink(missing_ok=True)
            if content:
                place.write_bytes(content)
                file = place.relative_to(root).as_posix()
    live = ""
    if figure.live:
        from mcspectra.plots import backend_bokeh

        live = backend_bokeh.packed(backend_bokeh.draw(plot).model)
    return {
        "png": _base64(png),
        "thumbnail": _base64(images.thumbnail),
        # Bytes 16 to 24 of a PNG hold its width and height
        "width": int.from_bytes(png[16:20], "big"),
        "height": int.from_bytes(png[20:24], "big"),
        "words": plot.words or plot.caption,
        "caption": plot.caption,
        "wide": figure.is_broad,
        "abreast": min(plot.columns, len(plot.panels)) > 1,
        "file": file,
        "live": live,
        "frames": {value: _base64(frame) for value, frame in images.frames.items()},
    }


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")


def _others(figure: Figure) -> Mapping[str, Plot]:
    """Return the plots of a figure's slider, except for the plot that is shown at first."""
    slider = figure.slider
    return {v: p for v, p in slider.plots.items() if v != slider.start} if slider else {}


_MARGIN = 14  # pixels around a cropped figure


def _cropped(images: Sequence[NDArray[np.uint8]]) -> list[NDArray[np.uint8]]:
    """Remove the empty border that all images of equal size have, except for a margin."""
    if len({image.shape for image in images}) > 1:
        return list(images)
    drawn = np.logical_or.reduce([(image != image[0, 0]).any(axis=-1) for image in images])
    if not drawn.any():
        return list(images)
    within = []
    for axis in (1, 0):
        (places,) = np.nonzero(drawn.any(axis=axis))
        within.append(slice(max(places[0] - _MARGIN, 0), places[-1] + 1 + _MARGIN))
    rows, columns = within
    return [np.ascontiguousarray(image[rows, columns]) for image in images]


def _thumbnail(pixels: NDArray[np.uint8]) -> bytes:
    """Return a PNG that fits in the thumbnails of a deck."""
    import io

    from PIL import Image

    small, picture = io.BytesIO(), Image.fromarray(pixels)
    picture.thumbnail(_THUMBNAIL, Image.Resampling.LANCZOS)
    picture.quantize(64).save(small, format="PNG")
    return small.getvalue()
