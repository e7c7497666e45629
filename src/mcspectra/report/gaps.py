"""What a study lacks: analyses that failed, with their reasons, and those that were not done."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import final

from mcspectra.core.errors import StoreError
from mcspectra.report.tables import Cell, Table
from mcspectra.studies import StudyStatus, study_status

__all__ = ["Gaps", "gaps_of"]

_SHOWN = 50  # rows; a page of 10,000 failures helps nobody
_NOT_DONE = "not computed yet"


@final
@dataclass(frozen=True, kw_only=True)
class Gaps:
    """A sentence about what a study lacks, and a table of it, if it can be listed."""

    sentence: str
    table: Table | None = None


def gaps_of(root: Path) -> Gaps | None:
    """Return what the study in a folder lacks; None where every analysis is there.

    Parameters
    ----------
    root
        Folder of a study's results.

    Notes
    -----
    A store alone, without its ledger, does not say which analyses failed: that is said.
    """
    try:
        status = study_status(root)
    except StoreError as error:
        return Gaps(sentence=f"Whether analyses failed is unknown. {error}")
    lacking = {**dict.fromkeys(status.missing, _NOT_DONE), **status.failed}
    if not lacking:
        return None
    rows = list(_rows(sorted(lacking.items())))
    return Gaps(sentence=_sentence(status), table=_table(rows))


def _sentence(status: StudyStatus) -> str:
    """How many are lacking, and what computes them."""
    failed, missing = len(status.failed), len(status.missing)
    total = len(status.done) + failed + missing
    counts = [
        f"{count} {what}" for count, what in ((failed, "failed"), (missing, _NOT_DONE)) if count
    ]
    again = "--resume --retry tries" if failed else "--resume computes"
    return (
        f"Of {total} analyses, {' and '.join(counts)}; mcspectra run with {again} them. All others "
        "are here."
    )


def _rows(lacking: Iterable[tuple[str, str]]) -> Iterator[tuple[Cell, ...]]:
    """A row for each estimator, sampler and reason, with the analyses that share it."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for path, reason in lacking:
        estimator, sampler, analysis = path.split("/", 2)
        found.setdefault((estimator, sampler, reason), []).append(analysis)
    for (estimator, sampler, reason), analyses in found.items():
        texts = (estimator, sampler, ", ".join(analyses), reason)
        yield tuple(Cell(text=text, numeric=False) for text in texts)


def _table(rows: list[tuple[Cell, ...]]) -> Table:
    more = len(rows) - _SHOWN
    note = f" {more} more rows: mcspectra status FOLDER --json lists all." if more > 0 else ""
    return Table(
        caption="Estimators and samplers by their names in the store." + note,
        columns=("Estimator", "Sampler", "Analyses", "Why"),
        rows=tuple(rows[:_SHOWN]),
        heads=2,
    )
