"""Create exhibits and write the lecture: a deck of slides, with images and findings.

An exhibit is computed once and appears on one or more slides.
The verdict on a slide is computed from the findings about it.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import math
import platform
import time
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any, Literal, TypeAlias, cast, final
from urllib.parse import parse_qsl, urlencode

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
from mcspectra.core.parallel import available_workers, process_map
from mcspectra.core.progress import report
from mcspectra.core.registry import optional_package
from mcspectra.plots.description import Plot
from mcspectra.plots.text import number, slug
from mcspectra.report import page as html
from mcspectra.reproduction.claims import GALLERY_FINDINGS, Exhibit, ExhibitFunction, Finding
from mcspectra.version import __version__

__all__ = [
    "FINDINGS_NAME",
    "PAGE_NAME",
    "Entry",
    "ExhibitTexts",
    "Mark",
    "Reproduction",
    "Slide",
    "exhibit_names",
    "load_exhibit",
    "make_exhibit",
    "measured_text",
    "reproduce",
    "tally",
    "texts",
    "verdict",
]

PAGE_NAME, FINDINGS_NAME = "index.html", "findings.json"
_FIGURES = "figures"
_PACKAGES = ("numpy", "scipy", "numba", "finufft", "xarray", "matplotlib", "mitsuba")
_SIGNS: dict[bool | None, tuple[str, Literal["yes", "no", "none"]]] = {
    True: ("✓ agrees", "yes"),
    False: ("✗ does not agree", "no"),
    None: ("– no verdict", "none"),
}
# The exhibits that take longest, in this order. They begin first, so that processes end together
_LONGEST = (
    "veach-pictures",
    "environment-channels",
    "variance-integral",
    "dimensionality",
    "mis-slowest",
    "homogenised-formula",
    "pair-correlation",
    "generalised-formula",
    "importance-terms",
    "importance-spectra",
    "phase",
)
_EXPLORER = "http://localhost:5006/"  # the address of ``mcspectra app --port 5006``


@final
@dataclass(frozen=True, kw_only=True)
class Slide:
    """A slide of the talk and our answer to it.

    Attributes
    ----------
    number
        Place in the talk. Slides are counted by title; the steps of an animation count once.
    title
        Title of the slide.
    statement
        Quotation of the slide's statement, or a description of its figure.
    reason
        Reason for the verdict. Names in braces stand for numbers of the exhibit.
    figure
        Kind of the plot that fills the screen.
    more
        Kinds of further plots, which are collapsed on the slide.
    formula
        LaTeX formula shown with the quotation, or empty.
    holds_if
        Condition under which the statement holds, or empty if it always holds.
    corrected
        The corrected statement in a few words, if findings correct the slide.
    answer
        Answer to a question on the slide, or empty.
    partly
        Answer that the figure's examples give to an open question of the slide, or empty.
    explorer
        Query string of the explorer's state (`mcspectra.app.state`), not yet encoded, or empty.
    """

    number: int
    title: str
    statement: str
    reason: str
    figure: str
    more: tuple[str, ...] = ()
    formula: str = ""
    holds_if: str = ""
    corrected: str = ""
    answer: str = ""
    partly: str = ""
    explorer: str = ""


@final
@dataclass(frozen=True, kw_only=True)
class ExhibitTexts:
    """Texts that describe an exhibit, its slides and its plots.

    Attributes
    ----------
    summary
        A description for lists, in one line.
    slides
        The slides that the exhibit reproduces.
    plots
        Attributes of `Plot` for each kind of plot: caption, words, and optionally a layout.
    """

    summary: str
    slides: tuple[Slide, ...]
    plots: Mapping[str, Mapping[str, Any]]


@final
@dataclass(frozen=True, kw_only=True)
class Entry:
    """An exhibit in the lecture, or the error message of an exhibit that failed.

    Attributes
    ----------
    slides
        The slides with their texts filled in.
    findings
        Findings of the exhibit. If it failed, the only finding reports the failure.
    problem
        Error message of a failed exhibit, else empty.
    """

    name: str
    exhibit: Exhibit | None
    slides: tuple[Slide, ...]
    findings: tuple[Finding, ...]
    problem: str = ""
    seconds: float

    @property
    def tally(self) -> str:
        """In words: how many findings agree with the slides, and how many correct them."""
        return "failed" if self.problem else _counted(self.findings)


@final
@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """A written lecture.

    Attributes
    ----------
    page
        Path of the page. The findings are in the same folder.
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
def texts() -> dict[str, ExhibitTexts]:
    """Return the texts of all exhibits by name, in the order of the slides."""
    text = resources.files(__package__).joinpath("slides.toml").read_text(encoding="utf-8")
    return {
        name: ExhibitTexts(
            summary=given["summary"],
            slides=tuple(
                Slide(**{**slide, "more": tuple(slide.get("more", ()))})
                for slide in given["slides"]
            ),
            plots=given["plots"],
        )
        for name, given in tomllib.loads(text).items()
    }


def exhibit_names(names: Sequence[str]) -> list[str]:
    """Return the distinct `names` in the order of the slides; all names if `names` is empty.

    Raises
    ------
    UnknownName
        If a name is unknown; the message suggests similar names.
    """
    for name in names:
        if name not in texts():
            hint, close = close_match_hint(name, texts(), "mcspectra reproduce --list")
            raise UnknownName(f"There is no figure called {shown(name)}.{hint}", close)
    return [name for name in texts() if name in names or not names]


def load_exhibit(name: str) -> ExhibitFunction:
    """Return the function that makes an exhibit, from the module of the same name."""
    (name,) = exhibit_names([name])
    module = importlib.import_module(f"mcspectra.reproduction.{name.replace('-', '_')}")
    return cast("ExhibitFunction", module.exhibit)


def make_exhibit(name: str, *, quick: bool, seed: int) -> tuple[Exhibit, tuple[Slide, ...]]:
    """Make an exhibit, and insert its numbers into the texts of its plots and slides."""
    made, given = load_exhibit(name)(quick=quick, seed=seed), texts()[name]

    def filled(text: str) -> str:
        return text.format(**made.numbers)

    def described(plot: Plot, kind: str) -> Plot:
        own = given.plots[kind]
        words: dict[str, Any] = {name: filled(own[name]) for name in ("caption", "words")}
        return replace(plot, kind=kind, **words, **own.get("layout", {}))

    plots = tuple(described(plot, plot.kind) for plot in made.plots)
    sliders = {
        kind: replace(slider, plots={v: described(p, kind) for v, p in slider.plots.items()})
        for kind, slider in made.sliders.items()
    }
    slides = tuple(
        replace(
            slide,
            reason=filled(slide.reason),
            holds_if=filled(slide.holds_if),
            corrected=filled(slide.corrected),
            answer=filled(slide.answer),
            partly=filled(slide.partly),
        )
        for slide in given.slides
    )
    return replace(made, plots=plots, sliders=sliders), slides


def reproduce(
    folder: str | Path,
    names: Sequence[str] = (),
    *,
    quick: bool = False,
    seed: int = 0,
    command: str = "mcspectra reproduce",
    done: Callable[[Entry], object] | None = None,
    workers: int = 1,
) -> Reproduction:
    """Reproduce the figures and statements of the slides.

    Parameters
    ----------
    folder
        Folder for ``index.html``, ``findings.json`` and ``figures``.
        Files with these names are replaced; other files are kept.
    names
        Names of exhibits. Default: all. The order is always the order of the slides.
    quick
        Whether to use fewer realizations, counts and pixels, and to write no PDF files.
    seed
        Seed of all exhibits, an integer ≥ 0.
    command
        Command that the page shows for repeating the run.
    done
        Function that is called with each entry once it is finished, the longest exhibits first.
    workers
        Number of processes, at least 1. The results do not depend on it.
        With several processes, the main part of a script needs ``if __name__ == "__main__":``.

    Returns
    -------
    Reproduction
        The entries. A failed exhibit is listed in `failed`, and does not stop the others.

    Raises
    ------
    UnknownName
        If a name is unknown.
    ParameterError
        If the folder name is empty, a number is out of range, or a process dies.
    StoreError
        If the folder cannot be written.
    MissingDependency
        If the extra ``report`` is not installed.
    """
    html.check_page_packages()
    optional_package("latex2mathml", "report", "The formulas of the slides need")
    chosen = exhibit_names(names)
    seed = as_integer("seed", seed, least=0)
    workers = available_workers(workers)
    if not str(folder).strip():
        raise ParameterError(
            "The name of the output folder is empty; give one, such as out/reproduce."
        )
    root = Path(folder)
    with writing(root, StoreError), process_map(workers) as mapped:
        (root / _FIGURES).mkdir(parents=True, exist_ok=True)
        report("reproduce", 0.0)
        entries = []
        longest = sorted(chosen, key=lambda name: (*_LONGEST, name).index(name))
        for entry in mapped(partial(_entry, quick=quick, seed=seed), longest):
            entries.append(entry)
            report("reproduce", len(entries) / (len(chosen) + 1))
            if done is not None:
                done(entry)
        entries.sort(key=lambda entry: chosen.index(entry.name))
        rows = [
            {"exhibit": entry.name, "slide": slide.number} | asdict(finding)
            for entry in entries
            for slide in entry.slides
            for finding in _findings_of(slide, entry)
        ]
        html.write_json(root / FINDINGS_NAME, rows)
        deck = _deck(entries, command, quick, seed)
        html.write_page(deck, root / PAGE_NAME, root / _FIGURES, with_pdf=not quick, mapped=mapped)
        report("reproduce", 1.0)
    return Reproduction(page=root / PAGE_NAME, entries=tuple(entries))


def _entry(name: str, quick: bool, seed: int) -> Entry:
    """Make an exhibit. If it raises an exception, the entry gets the error message."""
    start = time.perf_counter()
    try:
        made, slides = make_exhibit(name, quick=quick, seed=seed)
        return Entry(
            name=name,
            exhibit=made,
            slides=slides,
            findings=made.findings,
            seconds=time.perf_counter() - start,
        )
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
    return Entry(
        name=name,
        exhibit=None,
        slides=texts()[name].slides[:1],
        findings=(failed,),
        problem=problem,
        seconds=time.perf_counter() - start,
    )


def _findings_of(slide: Slide, entry: Entry) -> tuple[Finding, ...]:
    """Return the findings about a slide. Findings about no slide go to the first slide."""
    if entry.exhibit is None:
        return entry.findings
    figures = {each.figure for each in entry.slides}
    first = slide is entry.slides[0]
    return tuple(
        finding
        for claim, finding in zip(entry.exhibit.claims, entry.findings, strict=True)
        if claim.about == slide.figure or (first and claim.about not in figures)
    )


def _counted(findings: Sequence[Finding]) -> str:
    """Count the findings that agree with slides, that correct them, and that do not agree."""
    judged = [finding for finding in findings if finding.agrees is not None]
    agree, correct = (
        sum(f.agrees is True and f.corrects is kind for f in judged) for kind in (False, True)
    )
    parts = [f"{agree} agree"]
    parts += [f"{correct} limit or correct a slide"] if correct else []
    wrong, open_ = len(judged) - agree - correct, len(findings) - len(judged)
    parts += [f"{wrong} do not agree"] if wrong else []
    parts += [f"{open_} without verdict"] if open_ else []
    return ", ".join(parts)


def tally(entries: Sequence[Entry]) -> str:
    """Describe in words how many slides there are, and how many findings have each verdict."""
    made = [entry for entry in entries if not entry.problem]
    count = sum(len(entry.slides) for entry in made)
    text = f"{count} slide{'' if count == 1 else 's'}; findings: "
    text += _counted([finding for entry in made for finding in entry.findings])
    failed = len(entries) - len(made)
    return f"{text}; {failed} failed" if failed else text


Mark: TypeAlias = Literal["yes", "some", "no", "none"]
"""CSS class for the color of a verdict."""


def verdict(slide: Slide, findings: Sequence[Finding]) -> tuple[str, str, Mark]:
    """Return the verdict on a slide in one to three words, its condition, and its CSS class.

    If a finding does not agree with its expected value, the verdict is "Not reproduced".
    The verdict is "Corrected" only if a measurement confirms the correction of the slide.
    """
    if any(finding.agrees is False for finding in findings):
        return "Not reproduced", "a finding does not agree", "no"
    if not any(finding.agrees for finding in findings):
        return "No verdict", "the findings do not decide", "none"
    if slide.corrected and any(finding.corrects and finding.agrees for finding in findings):
        return "Corrected", slide.corrected, "no"
    if slide.answer:
        return "Answered", slide.answer, "some"
    if slide.partly:
        return "Answered in part", slide.partly, "some"
    if slide.holds_if:
        return "Holds if", slide.holds_if, "some"
    return "Holds", "", "yes"


def measured_text(finding: Finding) -> tuple[str, str]:
    """Format the measured value and its interval, with as many digits as the interval justifies."""
    value = finding.measured
    if value is None or isinstance(value, str):
        return value or number(None), ""
    if finding.interval is None:
        return number(value), ""
    # Choose 3 to 8 digits, so that the half width of the interval has two digits
    low, high = finding.interval
    half, largest = (high - low) / 2, max(abs(value), abs(low), abs(high))
    digits = 3
    if 0 < half < math.inf and 0 < largest < math.inf:
        places = math.floor(math.log10(largest)) - math.floor(math.log10(half))
        digits = min(max(places + 2, 3), 8)
    return number(value, digits), f"{number(low, digits)} … {number(high, digits)}"


def _deck(entries: Sequence[Entry], command: str, quick: bool, seed: int) -> html.Deck:
    versions = {"mcspectra": __version__, "Python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    facts = {"Command": command, "Seed": str(seed), "Quality": "quick" if quick else "full"}
    count = sum(len(entry.findings) for entry in entries if not entry.problem)
    how = html.FactList(rows=tuple((facts | versions).items()), code=True)
    pairs = sorted(
        ((slide, entry) for entry in entries for slide in entry.slides),
        key=lambda pair: pair[0].number,
    )
    return html.Deck(
        title="The slides, reproduced",
        what="lecture",
        lead=(
            html.Paragraph(
                text="“Fourier Analysis of Correlated Monte Carlo Importance Sampling” (Singh, "
                "Subr, Coeurjolly, Ostromoukhov, Jarosz): each slide with its statement, a figure "
                f"computed anew, and a verdict. {tally(entries)}."
            ),
            html.Paragraph(
                text="Holds: the findings agree with the slide. Holds if: they agree under this "
                "condition. Corrected: they contradict the slide. Answered: they answer a question "
                "of the slide; in part: by examples only. Arrow keys turn the pages. Links "
                "to the explorer need mcspectra app --port 5006.",
                kind="soft",
            ),
        ),
        screens=tuple(_screen(slide, entry) for slide, entry in pairs),
        last=html.Section(
            title="How the verdicts are found",
            anchor="provenance",
            blocks=(
                html.Paragraph(
                    text=f"This page has {count} findings. Each of their intervals has the level "
                    f"99.98 %. By Šidák's rule, up to {GALLERY_FINDINGS} intervals then hold "
                    "simultaneously with at least 95 %. Intervals in plots are 95 %. A finding "
                    "agrees if the expected value is in the interval or within the tolerance "
                    "given in the note. Findings that agree with our theory but limit or "
                    "contradict the slide as printed, such as counterexamples, are counted apart."
                ),
                html.Paragraph(
                    text="The slides are numbered by their titles in the talk. Steps of an "
                    "animation count once; closing slides are omitted."
                ),
                how,
            ),
        ),
    )


def _screen(slide: Slide, entry: Entry) -> html.Screen:
    formula = None
    if slide.formula:
        from latex2mathml.converter import convert

        text = html.Markup(convert(" ".join(slide.formula.split()), display="block"))
        formula = html.Paragraph(text=text, kind="formula")
    own = _findings_of(slide, entry)
    if entry.exhibit is None:
        return html.Screen(
            number=str(slide.number),
            title=slide.title,
            anchor=slide.figure,
            statement=slide.statement,
            formula=formula,
            verdict="Failed",
            mark="no",
            reason=f"This exhibit failed: {entry.problem}",
        )
    plots = {slug(plot.kind): plot for plot in entry.exhibit.plots}

    def figure(kind: str) -> html.Figure:
        name = kind if kind.startswith(entry.name) else f"{entry.name}-{kind}"
        slider = entry.exhibit.sliders.get(kind) if entry.exhibit else None
        return html.Figure(plot=plots[kind], name=name, slider=slider)

    folded: list[html.Block] = []
    if slide.more:
        more = html.Figures(figures=tuple(map(figure, slide.more)))
        folded.append(html.Collapsible(summary="More figures", blocks=(more,)))
    columns = ("Statement", "Verdict", "Expected", "Measured", "Interval", "Note")
    rows = []
    for each in own:
        sign, mark = _SIGNS[each.agrees]
        if each.corrects and each.agrees:
            sign, mark = "✎ limits or corrects the slide", "no"
        cell = html.TableCell(text=sign, numeric=False, mark=mark)
        rows.append((each.statement, cell, each.expected, *measured_text(each), each.note))
    table = html.table_of("", columns, rows, words=(0, -1), stacked=True)
    again = html.Paragraph(text=f"mcspectra reproduce {entry.name}", kind="code")
    numbers = html.Collapsible(summary=f"Numbers ({_counted(own)})", blocks=(table, again))
    word, rest, mark_of = verdict(slide, own)
    return html.Screen(
        number=str(slide.number),
        title=slide.title,
        anchor=slide.figure,
        statement=slide.statement,
        formula=formula,
        figure=figure(slide.figure),
        verdict=word,
        condition=rest,
        mark=mark_of,
        reason=slide.reason,
        link=f"{_EXPLORER}?{urlencode(parse_qsl(slide.explorer))}" if slide.explorer else "",
        folded=(*folded, numbers),
    )
