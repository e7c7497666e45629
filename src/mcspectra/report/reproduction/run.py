"""Make exhibits one after the other and write the gallery: page, pictures, PDF, findings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, final

from mcspectra.core.checks import as_integer
from mcspectra.core.errors import ParameterError, StoreError
from mcspectra.core.progress import report
from mcspectra.report.reproduction.entries import Entry, make_entry
from mcspectra.report.reproduction.files import (
    add_pages,
    findings_json,
    open_pdf,
    write_images,
)
from mcspectra.report.reproduction.page import Provenance, gallery_page
from mcspectra.report.reproduction.registry import exhibit_names

if TYPE_CHECKING:
    from matplotlib.backends.backend_pdf import PdfPages

__all__ = ["FINDINGS_NAME", "PAGE_NAME", "PDF_NAME", "Reproduction", "reproduce"]

PAGE_NAME, PDF_NAME, FINDINGS_NAME = "index.html", "reproduce.pdf", "findings.json"
_FIGURES = "figures"


@final
@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """What was written, and the entries in it.

    Attributes
    ----------
    page
        The gallery's page; the PDF and the findings lie beside it.
    entries
        In the order of the slides.
    """

    page: Path
    entries: tuple[Entry, ...]

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of exhibits that could not be made."""
        return tuple(entry.name for entry in self.entries if entry.problem)


def reproduce(
    folder: str | Path,
    names: Sequence[str] = (),
    *,
    quick: bool = False,
    seed: int = 0,
    command: str = "mcspectra reproduce",
    done: Callable[[Entry], object] | None = None,
) -> Reproduction:
    """Make the figures and statements of the slides again.

    Parameters
    ----------
    folder
        Where ``index.html``, ``reproduce.pdf``, ``findings.json`` and ``figures/*.png`` go. What has
        these names is replaced, all else stays.
    names
        Exhibits; all by default. They come in the order of the slides.
    quick
        Fewer realisations, counts and pixels.
    seed
        Of all exhibits; a whole number of at least 0.
    command
        What the page names as the command that made it.
    done
        Called with each entry when it is made.

    Returns
    -------
    Reproduction
        An exhibit that fails is in `failed`, and takes no other with it.

    Raises
    ------
    UnknownName
        There is no such exhibit.
    ParameterError
        The folder has no name, or the seed is out of range.
    StoreError
        The folder cannot be written.
    """
    chosen = exhibit_names(names)
    seed = as_integer("seed", seed, least=0)
    if not str(folder).strip():
        raise ParameterError("The output folder has no name; give one, such as out/reproduce.")
    root = Path(folder)
    try:
        (root / _FIGURES).mkdir(parents=True, exist_ok=True)
        entries = _make_all(root, chosen, quick, seed, done)
        provenance = Provenance(command=command, seed=seed, quick=quick)
        _write(root / FINDINGS_NAME, findings_json(entries))
        _write(root / PAGE_NAME, gallery_page(entries, provenance))
    except OSError as error:
        raise StoreError(
            f"The figures cannot be written to {str(root)!r}: {error.strerror or error}."
        ) from None
    return Reproduction(page=root / PAGE_NAME, entries=tuple(entries))


def _make_all(
    root: Path,
    names: Sequence[str],
    quick: bool,
    seed: int,
    done: Callable[[Entry], object] | None,
) -> list[Entry]:
    """Make the entries and write what needs their figures, so that these need not stay."""
    partial = root / f".{PDF_NAME}.partial"
    try:
        with open_pdf(partial) as pdf:
            entries = list(_entries(root, pdf, names, quick, seed, done))
        partial.replace(root / PDF_NAME)
    finally:
        partial.unlink(missing_ok=True)  # where it was interrupted
    report("reproduce", 1.0)
    return entries


def _entries(
    root: Path,
    pdf: PdfPages,
    names: Sequence[str],
    quick: bool,
    seed: int,
    done: Callable[[Entry], object] | None,
) -> Iterator[Entry]:
    for i, name in enumerate(names):
        report("reproduce", i / len(names))
        entry, pictures = make_entry(name, quick=quick, seed=seed)
        write_images(root / _FIGURES, entry)
        add_pages(pdf, entry, pictures)
        if done is not None:
            done(entry)
        yield entry


def _write(path: Path, text: str) -> None:
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
