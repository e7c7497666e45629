"""What a study lacks: failures with their reasons, what was not done, and a page that says it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mcspectra.core.errors import StoreError
from mcspectra.report import gaps, write_report
from mcspectra.report.gaps import gaps_of
from mcspectra.studies import StudyStatus

Make = dict[str, Callable[..., Any]]


@pytest.fixture(name="folder")
def _folder(make: Make, tmp_path: Path) -> Path:
    """A finished study of one cell."""
    study: Path = make["study"](tmp_path, {("e", "random"): {"convergence": make["curve"]()}})
    return study


def lacking(failed: dict[str, str], missing: tuple[str, ...] = ()) -> StudyStatus:
    """A status with one finished cell beside these."""
    return StudyStatus(
        title="t", study_hash="", seed=1, versions={}, format=3, state="unfinished", holder=None,
        hosts=(), started=None, finished=None, done=("e/random/points",), failed=failed,
        missing=missing, damaged={}, recorded=0, results_bytes=0, ledger_bytes=0, verified=False,
    )  # fmt: skip


def texts(found: gaps.Gaps | None) -> list[tuple[str, ...]]:
    assert found is not None
    assert found.table is not None
    return [tuple(cell.text for cell in row) for row in found.table.rows]


def test_a_finished_study_lacks_nothing(folder: Path) -> None:
    assert gaps_of(folder) is None
    text = write_report(folder).read_text(encoding="utf-8")
    assert "What is missing" not in text


def test_analyses_of_one_reason_share_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    failed = {
        "e/random/terms": "It raised.",
        "e/random/spectrum": "It raised.",
        "a/b/exact": "NaN.",
    }
    monkeypatch.setattr(gaps, "study_status", lambda _: lacking(failed, ("e/shift/terms",)))
    found = gaps_of(Path())
    assert texts(found) == [
        ("a", "b", "exact", "NaN."),
        ("e", "random", "spectrum, terms", "It raised."),
        ("e", "shift", "terms", "not computed yet"),
    ]
    assert found is not None
    assert "Of 5 analyses, 3 failed and 1 not computed yet;" in found.sentence
    assert "--resume --retry" in found.sentence


def test_only_missing_ones_need_no_retry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gaps, "study_status", lambda _: lacking({}, ("e/shift/terms",)))
    found = gaps_of(Path())
    assert found is not None
    assert "--resume" in found.sentence
    assert "--retry" not in found.sentence


def test_thousands_are_not_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    failed = {f"e{i:05}/random/terms": "It raised." for i in range(3000)}
    monkeypatch.setattr(gaps, "study_status", lambda _: lacking(failed))
    found = gaps_of(Path())
    assert len(texts(found)) == 50
    assert found is not None
    assert found.table is not None
    assert "2950 more rows" in found.table.caption


def test_an_unreadable_ledger_is_said(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Path) -> StudyStatus:
        raise StoreError("The ledger has format 9 <x>.")

    monkeypatch.setattr(gaps, "study_status", refuse)
    text = write_report(folder).read_text(encoding="utf-8")
    assert "Whether analyses failed is unknown. The ledger has format 9 &lt;x&gt;." in text


def test_the_page_has_the_reasons(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    status = lacking({"e/random/terms": "It raised ValueError: <b>."})
    monkeypatch.setattr(gaps, "study_status", lambda _: status)
    text = write_report(folder).read_text(encoding="utf-8")
    assert "What is missing" in text
    assert "It raised ValueError: &lt;b&gt;." in text
