"""Make exhibits and write the gallery: page, images, PDF and findings."""

from __future__ import annotations

import importlib
import importlib.metadata
import math
import platform
import textwrap
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast, final

from mcspectra.core.checks import as_integer
from mcspectra.core.display import shown
from mcspectra.core.errors import (
    McspectraError,
    ParameterError,
    StoreError,
    UnknownName,
    close_match_hint,
    writing,
)
from mcspectra.core.progress import report
from mcspectra.core.registry import optional_package
from mcspectra.plots.description import Plot
from mcspectra.plots.text import number, slug
from mcspectra.report import page as html
from mcspectra.reproduction.claims import GALLERY_FINDINGS, Exhibit, ExhibitFunction, Finding
from mcspectra.version import __version__

if TYPE_CHECKING:
    from matplotlib.backends.backend_pdf import PdfPages

__all__ = [
    "FINDINGS_NAME",
    "PAGE_NAME",
    "PDF_NAME",
    "Entry",
    "Reproduction",
    "Slide",
    "exhibit_names",
    "load_exhibit",
    "make_exhibit",
    "measured_text",
    "reproduce",
    "slides",
    "tally",
]

PAGE_NAME, PDF_NAME, FINDINGS_NAME = "index.html", "reproduce.pdf", "findings.json"
_FIGURES = "figures"
_PACKAGES = ("numpy", "scipy", "numba", "finufft", "xarray", "matplotlib", "mitsuba")
_SIGNS: dict[bool | None, tuple[str, Literal["yes", "no", "none"]]] = {
    True: ("✓ agrees", "yes"),
    False: ("✗ does not agree", "no"),
    None: ("– no verdict", "none"),
}
_SHEET = (8.27, 11.69)  # size of a sheet in inches, A4
_LINES, _COLUMNS = 62, 100  # lines and characters per line on a sheet
_PER_INCH = 14  # characters of a caption per inch


@final
@dataclass(frozen=True, kw_only=True)
class Slide:
    """Texts about the part of the slides that an exhibit reproduces.

    Attributes
    ----------
    title, summary
        A title, and a description in one line for lists.
    slide
        Quotation of the slide's statement or figure.
    caption
        Description of the result; names in braces are numbers of the exhibit.
    plots
        Caption, words and optional layout (fields of `Plot`) by kind of plot.
    formula
        LaTeX formula shown with the quotation, or empty.
    """

    title: str
    summary: str
    slide: str
    caption: str
    plots: Mapping[str, Mapping[str, Any]]
    formula: str = ""


@final
@dataclass(frozen=True, kw_only=True)
class Entry:
    """An exhibit in the gallery, or the error message of an exhibit that failed.

    Attributes
    ----------
    findings
        Findings of the exhibit. A failed exhibit has one finding that reports the failure.
    problem
        Error message of a failed exhibit, else empty.
    """

    name: str
    exhibit: Exhibit | None
    findings: tuple[Finding, ...]
    problem: str = ""
    seconds: float

    @property
    def tally(self) -> str:
        """Number of findings that agree, in words."""
        judged = [f.agrees for f in self.findings if f.agrees is not None]
        return "failed" if self.problem else f"{sum(judged)} of {len(judged)} agree"


@final
@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """A written gallery.

    Attributes
    ----------
    page
        Path of the page. The PDF and the findings are in the same folder.
    entries
        Entries in the order of the slides.
    """

    page: Path
    entries: tuple[Entry, ...]

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the exhibits that failed."""
        return tuple(entry.name for entry in self.entries if entry.problem)


@cache
def slides() -> dict[str, Slide]:
    """Return the texts of all exhibits by name, in the order of the slides."""
    text = resources.files(__package__).joinpath("slides.toml").read_text(encoding="utf-8")
    return {name: Slide(**values) for name, values in tomllib.loads(text).items()}


def exhibit_names(names: Sequence[str]) -> list[str]:
    """Return the distinct `names` in the order of the slides; all names if `names` is empty.

    Raises
    ------
    UnknownName
        If a name is unknown; the message suggests similar names.
    """
    for name in names:
        if name not in slides():
            hint, close = close_match_hint(name, slides(), "mcspectra reproduce --list")
            raise UnknownName(f"There is no figure called {shown(name)}.{hint}", close)
    return [name for name in slides() if name in names or not names]


def load_exhibit(name: str) -> ExhibitFunction:
    """Return the function that makes an exhibit, from the module of the same name."""
    (name,) = exhibit_names([name])
    module = importlib.import_module(f"mcspectra.reproduction.{name.replace('-', '_')}")
    return cast("ExhibitFunction", module.exhibit)


def make_exhibit(name: str, *, quick: bool, seed: int) -> Exhibit:
    """Make an exhibit and insert its numbers into the texts."""
    made, slide = load_exhibit(name)(quick=quick, seed=seed), slides()[name]

    def filled(text: str) -> str:
        return text.format(**made.numbers)

    plots = []
    for plot in made.plots:
        given = slide.plots[plot.kind]
        texts: dict[str, Any] = {name: filled(given[name]) for name in ("caption", "words")}
        plots.append(replace(plot, **texts, **given.get("layout", {})))
    return replace(made, plots=tuple(plots), caption=filled(slide.caption))


def reproduce(
    folder: str | Path,
    names: Sequence[str] = (),
    *,
    quick: bool = False,
    seed: int = 0,
    command: str = "mcspectra reproduce",
    done: Callable[[Entry], object] | None = None,
) -> Reproduction:
    """Reproduce the figures and statements of the slides.

    Parameters
    ----------
    folder
        Folder for ``index.html``, ``reproduce.pdf``, ``findings.json`` and ``figures``.
        Files with these names are replaced; other files are kept.
    names
        Names of exhibits. Default: all. The order is always the order of the slides.
    quick
        Whether to use fewer realizations, counts and pixels.
    seed
        Seed of all exhibits, an integer ≥ 0.
    command
        Command that the page shows.
    done
        Function called with each entry after it is made.

    Returns
    -------
    Reproduction
        The entries. A failed exhibit is listed in `failed` and does not stop the others.

    Raises
    ------
    UnknownName
        If a name is unknown.
    ParameterError
        If the folder name is empty, or the seed is out of range.
    StoreError
        If the folder cannot be written.
    MissingDependency
        If the extra ``report`` is not installed.
    """
    html.check_page_packages()
    optional_package("latex2mathml", "report", "The formulas of the slides need")
    chosen = exhibit_names(names)
    seed = as_integer("seed", seed, least=0)
    if not str(folder).strip():
        raise ParameterError(
            "The name of the output folder is empty; give one, such as out/reproduce."
        )
    root = Path(folder)
    with writing(root, StoreError):
        (root / _FIGURES).mkdir(parents=True, exist_ok=True)
        entries = []
        for i, name in enumerate(chosen):
            report("reproduce", i / len(chosen))
            entries.append(_entry(name, quick, seed))
            if done is not None:
                done(entries[-1])
        rows = [{"exhibit": e.name} | asdict(finding) for e in entries for finding in e.findings]
        html.write_json(root / FINDINGS_NAME, rows)
        _write_pdf(root / PDF_NAME, entries)
        html.write_page(_page(entries, command, quick, seed), root / PAGE_NAME, root / _FIGURES)
        report("reproduce", 1.0)
    return Reproduction(page=root / PAGE_NAME, entries=tuple(entries))


def _entry(name: str, quick: bool, seed: int) -> Entry:
    """Make an exhibit; any exception becomes the entry's problem."""
    start = time.perf_counter()
    try:
        made = make_exhibit(name, quick=quick, seed=seed)
        seconds = time.perf_counter() - start
        return Entry(name=name, exhibit=made, findings=made.findings, seconds=seconds)
    except Exception as error:  # noqa: BLE001 - a failed exhibit must not stop the others
        text = " ".join(str(error).split()) or "no message"
        problem = text if isinstance(error, McspectraError) else f"{type(error).__name__}: {text}"
    failed = Finding(
        statement=f"The figure {name} can be made.",
        expected="a figure",
        measured=None,
        interval=None,
        agrees=False,
        note=problem,
    )
    seconds = time.perf_counter() - start
    return Entry(name=name, exhibit=None, findings=(failed,), problem=problem, seconds=seconds)


def tally(entries: Sequence[Entry]) -> str:
    """Return the number of figures and of findings that agree, in words."""
    made = [entry for entry in entries if not entry.problem]
    judged = [f.agrees for entry in made for f in entry.findings if f.agrees is not None]
    figures = f"{len(entries)} figure{'' if len(entries) == 1 else 's'}"
    text = f"{figures}; {sum(judged)} of {len(judged)} findings agree"
    failed = len(entries) - len(made)
    return f"{text}; {failed} failed" if failed else text


def measured_text(finding: Finding) -> tuple[str, str]:
    """Format the measured value and its interval with the digits that the interval justifies."""
    value = finding.measured
    if value is None or isinstance(value, str):
        return value or number(None), ""
    if finding.interval is None:
        return number(value), ""
    # Choose 3 to 8 digits, so that half the interval has two digits
    low, high = finding.interval
    half, largest = (high - low) / 2, max(abs(value), abs(low), abs(high))
    digits = 3
    if 0 < half < math.inf and 0 < largest < math.inf:
        places = math.floor(math.log10(largest)) - math.floor(math.log10(half))
        digits = min(max(places + 2, 3), 8)
    return number(value, digits), f"{number(low, digits)} … {number(high, digits)}"


def _page(entries: Sequence[Entry], command: str, quick: bool, seed: int) -> html.Page:
    versions = {"mcspectra": __version__, "Python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    facts = {"Command": command, "Seed": str(seed), "Quality": "quick" if quick else "full"}
    how = html.FactList(rows=tuple((facts | versions).items()), code=True)
    return html.Page(
        title="The slides, reproduced",
        what="gallery",
        lead=(
            html.Paragraph(
                text="Every figure and statement of the slides of “Fourier Analysis of Correlated "
                "Monte Carlo Importance Sampling” (Singh, Subr, Coeurjolly, Ostromoukhov, Jarosz), "
                f"recomputed. {tally(entries)}."
            ),
            html.Paragraph(
                text=f"Intervals of {GALLERY_FINDINGS} true findings hold simultaneously with 95 % "
                "(each with 99.98 %, Šidák). Intervals in plots are 95 %. A finding agrees if the "
                "expected value is in the interval or within the tolerance given in the note.",
                kind="soft",
            ),
        ),
        sections=(
            *map(_section, entries),
            html.Section(title="How to reproduce this page", anchor="provenance", blocks=(how,)),
        ),
    )


def _section(entry: Entry) -> html.Section:
    slide = slides()[entry.name]
    blocks: list[html.Block] = [
        html.Paragraph(text=f"mcspectra reproduce {entry.name}", kind="code")
    ]
    if entry.exhibit is None:
        blocks.append(html.Paragraph(text=f"✗ This exhibit failed: {entry.problem}"))
    else:
        blocks.append(html.Paragraph(text=slide.slide, kind="quote"))
        if slide.formula:
            from latex2mathml.converter import convert

            formula = html.Markup(convert(" ".join(slide.formula.split()), display="block"))
            blocks.append(html.Paragraph(text=formula, kind="formula"))
        blocks.append(html.Paragraph(text=entry.exhibit.caption))
        plots = {slug(plot.kind): plot for plot in entry.exhibit.plots}
        named = {
            kind if kind.startswith(entry.name) else f"{entry.name}-{kind}": plot
            for kind, plot in plots.items()
        }
        blocks += html.figures_of(named)
        columns = ("Statement", "Verdict", "Expected", "Measured", "Interval", "Note")
        rows = []
        for each in entry.findings:
            sign, mark = _SIGNS[each.agrees]
            verdict = html.TableCell(text=sign, numeric=False, mark=mark)
            rows.append((each.statement, verdict, each.expected, *measured_text(each), each.note))
        blocks.append(html.table_of("", columns, rows, words=(0, -1), stacked=True))
    wrong = any(finding.agrees is False for finding in entry.findings)
    return html.Section(
        title=slide.title,
        anchor=entry.name,
        blocks=tuple(blocks),
        beside=entry.tally,
        mark="no" if wrong else "yes",
    )


def _write_pdf(path: Path, entries: Sequence[Entry]) -> None:
    """Write sheets of text for each entry, then one sheet per figure with its caption."""
    import matplotlib as mpl
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure as Drawing

    from mcspectra.plots.backend_matplotlib import escaped

    partial = path.with_name(f".{path.name}.partial")
    metadata = {"CreationDate": None, "Creator": "mcspectra"}
    try:
        with mpl.rc_context({"pdf.fonttype": 42}), PdfPages(partial, metadata=metadata) as pdf:
            for entry in entries:
                lines = list(_lines(entry))
                for start in range(0, len(lines), _LINES):
                    sheet = Drawing(figsize=_SHEET)
                    for row, (line, weight) in enumerate(lines[start : start + _LINES]):
                        at = (0.08, 0.95 - 0.0145 * row)
                        sheet.text(*at, escaped(line), va="top", fontsize=9, weight=weight)
                    pdf.savefig(sheet)
                for plot in entry.exhibit.plots if entry.exhibit else ():
                    _add_figure(pdf, plot)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)  # this file exists only after an interruption


def _lines(entry: Entry) -> Iterator[tuple[str, str]]:
    """Yield the lines of an entry's sheet and their font weights."""
    slide = slides()[entry.name]
    caption = entry.exhibit.caption if entry.exhibit else ""
    parts = [(slide.title, "bold"), (f"Slide: {slide.slide}", "normal"), (caption, "normal")]
    for finding in entry.findings:
        parts.append((f"{_SIGNS[finding.agrees][0][0]} {finding.statement}", "bold"))
        measured, interval = measured_text(finding)
        text = f"expected {finding.expected}; measured {measured}"
        text += f" ({interval})" if interval else ""
        parts.append((f"{text}. {finding.note}" if finding.note else text, ""))
    for text, weight in parts:
        if text and weight and text != slide.title:
            yield "", "normal"
        yield from ((line, weight or "normal") for line in textwrap.wrap(text, _COLUMNS))


def _add_figure(pdf: PdfPages, plot: Plot) -> None:
    """Add a figure with its caption below, on a larger sheet."""
    from mcspectra.plots.backend_matplotlib import draw, escaped

    figure = draw(replace(plot, caption=""))
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")
    for legend in figure.legends:  # else legends would move to the border of the sheet
        legend.set_bbox_to_anchor((0, 0, 1, 1), transform=figure.transFigure)
    caption = textwrap.fill(plot.caption, int(_PER_INCH * figure.get_figwidth()))
    figure.text(0.02, -0.02, escaped(caption), va="top", fontsize=8)
    pdf.savefig(figure, bbox_inches="tight", pad_inches=0.3)  # type: ignore[no-untyped-call]
