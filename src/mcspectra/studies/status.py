"""What a study's folder holds: done, failed, missing and damaged cells, and who writes into it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

from mcspectra.core.errors import StoreError
from mcspectra.studies._consolidated import disagreement
from mcspectra.studies.checksums import Checksum, damage_of
from mcspectra.studies.journal import JOURNAL_NAME, JournalState, read_journal
from mcspectra.studies.lock import LockHolder, is_held, lock_holder
from mcspectra.studies.manifest import FORMAT, CellLine, Manifest, in_place, read_manifest
from mcspectra.studies.opening import check_format, result_paths
from mcspectra.studies.places import is_url
from mcspectra.studies.store import STORE_NAME, root_attributes, root_document

__all__ = ["AnalysisCount", "StudyStatus", "study_status"]


class AnalysisCount(msgspec.Struct, frozen=True):
    """Numbers of cells of one analysis."""

    done: int = 0
    failed: int = 0
    missing: int = 0
    damaged: int = 0


class StudyStatus(msgspec.Struct, frozen=True, kw_only=True):
    """State of a study's folder.

    Attributes
    ----------
    title, study_hash, seed, versions
        Of the study, and of what computed it.
    format
        Of the store.
    state
        ``running`` while a process writes into it, ``finished`` when all cells are there,
        ``unfinished`` otherwise.
    holder
        Who writes into it, or did when it ended without a word.
    host, started, finished
        Where and when it was begun, and when all cells were there: UTC, ISO 8601.
    done, missing
        Paths of cells; those missing are known of stores of format 2.
    failed, damaged
        Sentences by the paths of cells, and by records of the journal and lines of the manifest.
    recorded
        Number of results of tasks that wait in the journal for their cells.
    results_bytes, journal_bytes
        Sizes; that of the results by the manifest.
    verified
        Whether all cells were checked against their checksums.
    """

    title: str
    study_hash: str
    seed: int | None
    versions: dict[str, str]
    format: int
    state: str
    holder: LockHolder | None
    host: str | None
    started: str | None
    finished: str | None
    done: tuple[str, ...]
    failed: dict[str, str]
    missing: tuple[str, ...]
    damaged: dict[str, str]
    recorded: int
    results_bytes: int
    journal_bytes: int
    verified: bool

    @property
    def analyses(self) -> dict[str, AnalysisCount]:
        """Numbers by the analysis: the last part of a cell's path."""
        counts: dict[str, dict[str, int]] = {}
        for kind in ("done", "failed", "missing", "damaged"):
            for path in _cells_of(getattr(self, kind)):
                of = counts.setdefault(path.rpartition("/")[2], {})
                of[kind] = of.get(kind, 0) + 1
        return {name: AnalysisCount(**of) for name, of in sorted(counts.items())}


def study_status(folder: str | Path, *, verify: bool = False) -> StudyStatus:
    """Look at a study's folder, which may be in use; nothing in it is changed.

    Parameters
    ----------
    verify
        Check every cell and every record against its checksum, which reads all files.

    Raises
    ------
    StoreError
        There are no results, the store is of a format that this version cannot read, or it or its
        journal are damaged.
    """
    root = Path(folder)
    if is_url(folder) or root.is_file():
        raise StoreError(
            f"{str(folder)!r} is not the output folder of a run; only such a folder has a status."
        )
    attributes = root_attributes(root / STORE_NAME)
    check_format(attributes, folder)
    manifest = read_manifest(root) or _of_tree(root)
    journal = read_journal(root, verify=verify) or JournalState((), {}, (), 0)
    tree = root / STORE_NAME
    damaged = _damaged_cells(tree, manifest, verify) | _damaged_records(manifest, journal)
    damaged |= _damaged_root(tree) if verify and attributes["format"] == FORMAT else {}
    done = tuple(path for path in in_place(tree, manifest) if path not in damaged)
    known = {*done, *damaged}
    failed = {path: error for path, error in journal.failures.items() if path not in known}
    missing = tuple(path for path in manifest.paths if path not in known and path not in failed)
    study, study_text = manifest.study, attributes.get("study")
    running = is_held(root)
    return StudyStatus(
        title=str(study_text.get("title", "")) if isinstance(study_text, dict) else "",
        study_hash=str(attributes.get("study_hash", "")),
        seed=None if study is None else study.seed,
        versions=_versions(attributes),
        format=attributes["format"] if isinstance(attributes.get("format"), int) else 0,
        state=_state(running, manifest, bool(failed or missing or damaged)),
        holder=lock_holder(root),
        host=None if study is None else study.host,
        started=None if study is None else study.at,
        finished=manifest.finished,
        done=done,
        failed=failed,
        missing=missing,
        damaged=damaged,
        recorded=len(journal.done),
        results_bytes=sum(manifest.cells[path].bytes for path in done),
        journal_bytes=journal.size,
        verified=verify,
    )


def _versions(attributes: dict[str, Any]) -> dict[str, str]:
    start = "version_"
    return {k.removeprefix(start): str(v) for k, v in attributes.items() if k.startswith(start)}


def _state(running: bool, manifest: Manifest, lacking: bool) -> str:
    if running:
        return "running"
    return "unfinished" if lacking or not (manifest.finished or not manifest.paths) else "finished"


def _of_tree(root: Path) -> Manifest:
    """What stands for a manifest in a store of format 1: the cells of the tree, without checksums."""
    cells = {path: CellLine(path, "", "", 0, "") for path in result_paths(root)}
    return Manifest(None, (), cells, (), (), 0)


def _damaged_cells(tree: Path, manifest: Manifest, verify: bool) -> dict[str, str]:
    """What is wrong with cells that are in the tree."""
    found: dict[str, str] = {}
    for path in in_place(tree, manifest) if verify else ():
        line = manifest.cells[path]
        expected = Checksum(line.sha256, line.parts, line.bytes)
        reason = damage_of(tree / path, expected) if line.sha256 else None
        if reason is not None:
            found[path] = reason
    return found


def _damaged_root(tree: Path) -> dict[str, str]:
    reason = disagreement(tree, root_document(tree))
    return {} if reason is None else {"metadata of the root": reason}


def _damaged_records(manifest: Manifest, journal: JournalState) -> dict[str, str]:
    lines = {f"manifest line {number}": "it cannot be read" for number in manifest.damaged}
    records = {f"{JOURNAL_NAME}: {name}": "it cannot be read" for name in journal.damaged}
    return lines | records


def _cells_of(names: Iterable[str]) -> Iterable[str]:
    """Paths of cells; records and lines have a blank in their names."""
    return (name for name in names if " " not in name)
