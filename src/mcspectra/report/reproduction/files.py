"""What a gallery is written as beside its page: PNG files, findings as JSON, one PDF."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcspectra.report.formatting import number
from mcspectra.report.reproduction.base import Finding
from mcspectra.report.reproduction.entries import Entry, all_findings

if TYPE_CHECKING:
    from matplotlib.backends.backend_pdf import PdfPages

    from mcspectra.report.gallery import Picture

__all__ = ["add_pages", "findings_json", "measured_text", "open_pdf", "write_images"]

_PAGE = (8.27, 11.69)  # inches, A4
_LINES, _COLUMNS = 62, 100  # of text on a page
_PER_INCH = 14  # letters of a caption
_MARK = {True: "✓", False: "✗", None: "–"}


def write_images(folder: Path, entry: Entry) -> None:
    """Write the pictures of an entry as PNG files."""
    for image in entry.images:
        (folder / f"{image.name}.png").write_bytes(image.png)


def findings_json(entries: Iterable[Entry]) -> str:
    """Return all findings as a JSON list; numbers that are not finite are text or null."""
    rows = [
        {"exhibit": entry.name} | _plain(finding)
        for entry in entries
        for finding in all_findings(entry)
    ]
    return json.dumps(rows, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def measured_text(finding: Finding) -> tuple[str, str]:
    """Return the measured number and its interval with the digits that the interval has meaning for."""
    value = finding.measured
    if value is None or isinstance(value, str):
        return value or number(None), ""
    if finding.interval is None:
        return number(value), ""
    digits = _digits(value, finding.interval)
    low, high = (number(end, digits) for end in finding.interval)
    return number(value, digits), f"{low} … {high}"


def open_pdf(path: Path) -> PdfPages:
    """Open a PDF without time stamps."""
    from matplotlib.backends.backend_pdf import PdfPages

    return PdfPages(path, metadata={"CreationDate": None, "Creator": "mcspectra"})


def add_pages(pdf: PdfPages, entry: Entry, pictures: Sequence[Picture]) -> None:
    """Add an entry: a page (or more) of text, then each figure on a page with its caption below."""
    lines = list(_lines(entry))
    for start in range(0, len(lines), _LINES):
        _add_text(pdf, lines[start : start + _LINES])
    for picture in pictures:
        _add_figure(pdf, picture)


def _add_figure(pdf: PdfPages, picture: Picture) -> None:
    """Add a figure with its caption; the page grows by it."""
    figure = picture.figure
    for legend in figure.legends:  # or they would move to the border of the larger page
        legend.set_bbox_to_anchor((0, 0, 1, 1), transform=figure.transFigure)
    caption = textwrap.fill(picture.caption, int(_PER_INCH * figure.get_figwidth()))
    figure.text(0.02, -0.02, _plain_text(caption), va="top", fontsize=8)
    pdf.savefig(figure, bbox_inches="tight", pad_inches=0.3)  # type: ignore[no-untyped-call]


def _plain(finding: Finding) -> dict[str, Any]:
    row = asdict(finding)
    if isinstance(finding.measured, float) and not math.isfinite(finding.measured):
        row["measured"] = None if math.isnan(finding.measured) else number(finding.measured)
    if finding.interval is not None:
        row["interval"] = [end if math.isfinite(end) else None for end in finding.interval]
    return row


def _digits(value: float, interval: tuple[float, float]) -> int:
    """Significant digits that show half an interval with two digits, from 3 to 8."""
    half = (interval[1] - interval[0]) / 2
    largest = max(abs(value), *map(abs, interval))
    if not (0 < half < math.inf and 0 < largest < math.inf):
        return 3
    places = math.floor(math.log10(largest)) - math.floor(math.log10(half))
    return min(max(places + 2, 3), 8)


def _lines(entry: Entry) -> Iterator[tuple[str, str]]:
    """Lines of an entry's page, each with the weight of its font."""
    yield from _wrapped(entry.title, "bold")
    for text in (f"Slide: {entry.slide}", entry.caption, entry.problem):
        if text not in ("", "Slide: "):
            yield ("", "normal")
            yield from _wrapped(text, "normal")
    for finding in all_findings(entry):
        yield ("", "normal")
        yield from _wrapped(f"{_MARK[finding.agrees]} {finding.statement}", "bold")
        yield from _wrapped(_figures(finding), "normal")


def _figures(finding: Finding) -> str:
    measured, interval = measured_text(finding)
    text = f"expected {finding.expected}; measured {measured}"
    text += f" (95 %: {interval})" if interval else ""
    return f"{text}. {finding.note}" if finding.note else text


def _wrapped(text: str, weight: str) -> Iterator[tuple[str, str]]:
    return ((line, weight) for line in textwrap.wrap(text, _COLUMNS))


def _add_text(pdf: PdfPages, lines: Sequence[tuple[str, str]]) -> None:
    from matplotlib.figure import Figure

    page = Figure(figsize=_PAGE)
    for row, (line, weight) in enumerate(lines):
        page.text(0.08, 0.95 - 0.0145 * row, _plain_text(line), va="top", fontsize=9, weight=weight)
    pdf.savefig(page)  # type: ignore[no-untyped-call]


def _plain_text(text: str) -> str:
    return text.replace("$", r"\$")
