"""Exhibits as they are shown: pictures encoded, formula as MathML, figures let go of; or what failed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, final

from mcspectra.core.errors import McspectraError
from mcspectra.report.encode import encode, encode_exact
from mcspectra.report.formatting import slug
from mcspectra.report.reproduction.base import Exhibit, Finding
from mcspectra.report.reproduction.registry import SUMMARIES, load_exhibit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mcspectra.report.gallery import Picture

__all__ = ["Entry", "Image", "all_findings", "make_entry"]

_DPI = 120  # of photographs; other figures have that of `encode`


@final
@dataclass(frozen=True, kw_only=True)
class Image:
    """A picture of an exhibit: PNG bytes, the name of its file, and words."""

    name: str
    png: bytes
    caption: str
    alt: str
    wide: bool

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels: bytes 16 to 24 of a PNG."""
        width, height = (int.from_bytes(self.png[i : i + 4], "big") for i in (16, 20))
        return width, height


@final
@dataclass(frozen=True, kw_only=True)
class Entry:
    """An exhibit without its figures; one that failed has a problem instead of a caption."""

    name: str
    title: str
    slide: str = ""
    formula: str = ""
    caption: str = ""
    images: tuple[Image, ...] = ()
    findings: tuple[Finding, ...] = field(default=())
    problem: str = ""
    seconds: float = 0.0

    @property
    def tally(self) -> str:
        """How many findings agree, in words."""
        if self.problem:
            return "failed"
        judged = [f for f in self.findings if f.agrees is not None]
        agree = sum(bool(f.agrees) for f in judged)
        return f"{agree} of {len(judged)} agree"


def make_entry(name: str, *, quick: bool, seed: int) -> tuple[Entry, tuple[Picture, ...]]:
    """Make an exhibit; whatever goes wrong in it becomes the entry's problem.

    Returns
    -------
    tuple
        The entry and its pictures, whose figures can still be drawn elsewhere.
    """
    start = time.perf_counter()
    try:
        exhibit = load_exhibit(name)(quick=quick, seed=seed)
        entry = _entry(name, exhibit, start)
    except Exception as error:  # noqa: BLE001 - one exhibit must not take the others with it
        problem = _in_words(error)
        took = time.perf_counter() - start
        return Entry(name=name, title=SUMMARIES[name], problem=problem, seconds=took), ()
    return entry, exhibit.pictures


def all_findings(entry: Entry) -> tuple[Finding, ...]:
    """Return an entry's findings; of one that failed, that it did."""
    if not entry.problem:
        return entry.findings
    failed = Finding(
        statement=f"The figure {entry.name} can be made.",
        expected="a figure",
        measured=None,
        interval=None,
        agrees=False,
        note=entry.problem,
    )
    return (failed,)


def _entry(name: str, exhibit: Exhibit, start: float) -> Entry:
    return Entry(
        name=name,
        title=exhibit.title,
        slide=exhibit.slide,
        formula=_mathml(exhibit.formula),
        caption=exhibit.caption,
        images=tuple(_images(name, exhibit)),
        findings=exhibit.findings,
        seconds=time.perf_counter() - start,
    )


def _images(name: str, exhibit: Exhibit) -> Iterator[Image]:
    for picture in exhibit.pictures:
        kind = slug(picture.kind)
        yield Image(
            name=kind if kind.startswith(name) else f"{name}-{kind}",
            png=_png(picture.figure),
            caption=picture.caption,
            alt=picture.alt,
            wide=picture.wide,
        )


def _png(figure: Figure) -> bytes:
    """Encode a figure; one with photographs in full colour, which 256 colours would band."""
    if any(image.get_array().ndim == 3 for axes in figure.axes for image in axes.images):  # type: ignore[union-attr]
        figure.set_dpi(_DPI)
        return encode_exact(figure)
    return encode(figure)[0]


def _mathml(latex: str) -> str:
    if not latex:
        return ""
    from latex2mathml.converter import convert

    return str(convert(latex, display="block"))


def _in_words(error: Exception) -> str:
    text = " ".join(str(error).split()) or "no message"
    return text if isinstance(error, McspectraError) else f"{type(error).__name__}: {text}"
