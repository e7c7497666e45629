"""The gallery's page: one file that stands alone, with every picture, formula and finding inside."""

from __future__ import annotations

import base64
import importlib.metadata
import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, final

from mcspectra.report.html import page_template
from mcspectra.report.reproduction.base import GALLERY_FINDINGS, Finding
from mcspectra.report.reproduction.entries import Entry, Image, all_findings
from mcspectra.report.reproduction.files import measured_text
from mcspectra.version import __version__

__all__ = ["Provenance", "gallery_page", "tally"]

_PACKAGES = ("numpy", "scipy", "numba", "finufft", "xarray", "matplotlib", "mitsuba")
_VERDICTS = {
    True: ("✓", "agrees", "yes"),
    False: ("✗", "does not agree", "no"),
    None: ("–", "no verdict", "none"),
}


@final
@dataclass(frozen=True, kw_only=True)
class Provenance:
    """What it takes to make the same gallery again."""

    command: str
    seed: int
    quick: bool

    def facts(self) -> dict[str, str]:
        """What the page lists, by its name."""
        return {
            "Command": self.command,
            "Seed": str(self.seed),
            "Quality": "quick" if self.quick else "full",
            "mcspectra": __version__,
            "Python": platform.python_version(),
            **dict(_versions()),
        }


def gallery_page(entries: Sequence[Entry], provenance: Provenance) -> str:
    """Return the page as HTML text.

    Parameters
    ----------
    entries
        In the order in which they are shown.
    provenance
        Shown at the end.
    """
    return page_template("reproduction/reproduction.html.j2").render(
        entries=[_shown(entry) for entry in entries],
        tally=tally(entries),
        gallery_findings=GALLERY_FINDINGS,
        provenance=provenance.facts(),
    )


def tally(entries: Sequence[Entry]) -> str:
    """Say how many figures there are, and how many of their findings agree."""
    findings = [f for entry in entries for f in entry.findings if f.agrees is not None]
    agree = sum(bool(f.agrees) for f in findings)
    failed = sum(bool(entry.problem) for entry in entries)
    figures = f"{len(entries)} figure{'' if len(entries) == 1 else 's'}"
    text = f"{figures}; {agree} of {len(findings)} findings agree"
    return f"{text}; {failed} failed" if failed else text


def _shown(entry: Entry) -> dict[str, Any]:
    return {
        "name": entry.name,
        "title": entry.title,
        "slide": entry.slide,
        "formula": entry.formula,
        "caption": entry.caption,
        "problem": entry.problem,
        "tally": entry.tally,
        "agrees": all(f.agrees is not False for f in all_findings(entry)),
        "images": [_image(image) for image in entry.images],
        "findings": [_row(finding) for finding in entry.findings],
    }


def _image(image: Image) -> dict[str, Any]:
    width, height = image.size
    return {
        "data": base64.b64encode(image.png).decode("ascii"),
        "width": width,
        "height": height,
        "caption": image.caption,
        "alt": image.alt,
        "wide": image.wide,
    }


def _row(finding: Finding) -> dict[str, str]:
    sign, verdict, style = _VERDICTS[finding.agrees]
    measured, interval = measured_text(finding)
    return {
        "sign": sign,
        "verdict": verdict,
        "style": style,
        "statement": finding.statement,
        "expected": finding.expected,
        "measured": measured,
        "interval": interval,
        "note": finding.note,
    }


def _versions() -> Iterator[tuple[str, str]]:
    for name in _PACKAGES:
        try:
            yield name, importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            yield name, "not installed"
