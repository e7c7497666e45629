"""The result store: a zarr directory, one writer, whole cells or nothing.

Layout: ``DIR/results.zarr`` is the tree: ``/`` (attributes: the study's text and hash, versions,
format), then ``/<estimator>/<sampler>/<analysis>``, a dataset each. ``DIR/manifest.jsonl`` has the
checksum of every cell. A cell is written beside the tree, entered into the manifest and renamed into
place: it counts if it is there with its checksum, and anything else is computed again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from mcspectra.core.errors import OtherVersionsWarning, StorageError, StoreError, warn
from mcspectra.core.results import package_versions
from mcspectra.studies._zarr_cell import array_documents, write_cell
from mcspectra.studies.checksums import Checksum, damage_of
from mcspectra.studies.config import StudyConfig
from mcspectra.studies.inputs import check_inputs
from mcspectra.studies.links import check_folder_links
from mcspectra.studies.lock import FolderLock, check_unlocked
from mcspectra.studies.manifest import (
    FORMAT,
    CellLine,
    Line,
    Manifest,
    StudyLine,
    append_line,
    now,
    read_manifest,
    state_line,
    study_line,
    write_manifest,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["STORE_NAME", "Store", "config_hash", "noted_inputs", "root_attributes", "root_document"]

STORE_NAME = "results.zarr"
_BOUND = ["low", "high"]
_RENEW = (
    "put back what was, give another --out, or --resume --retry to compute what depends on it again"
)
_MOST_CONSOLIDATED = 2000  # cells: readers take the metadata of all of them at once
_GROUP = {"attributes": {}, "zarr_format": 3, "node_type": "group"}


class Store:
    """Results of one study in a folder, for its one writer.

    Parameters
    ----------
    folder
        Output folder; the store is ``results.zarr`` inside.

    Attributes
    ----------
    damaged
        What was found damaged since the store was opened: a sentence for each cell, by its path.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / STORE_NAME
        self.damaged: dict[str, str] = {}
        self._paths: tuple[str, ...] = ()
        self._cells: dict[str, CellLine] = {}
        self._parents: set[str] = set()
        self._inputs: Mapping[str, str] | None = None

    @staticmethod
    def create(
        folder: Path,
        config: StudyConfig,
        *,
        resume: bool = False,
        paths: Sequence[str] = (),
        lock: FolderLock | None = None,
        inputs: Mapping[str, str] | None = None,
        outdated: Collection[str] | None = None,
    ) -> Store:
        """Make a new store, or with `resume` open the one that is there.

        Parameters
        ----------
        folder
            Output folder.
        config
            The study.
        resume
            Go on with the store of this study; without one, make it.
        paths
            Of all cells of the study, so that it can be said which are missing.
        lock
            The lock of the folder, if the caller holds it; else nobody may.
        inputs
            SHA-256 of the files that the study depends on (`mcspectra.studies.plan.Plan`); None if
            they do not matter.
        outdated
            With `resume`: paths of cells to remove first, as files that they depend on have changed;
            without it a changed file is refused.

        Raises
        ------
        StoreError
            A store exists and `resume` is not asked for, it belongs to another study, format or
            version of this package, files have changed, or another process writes into it; the
            folder cannot be written, or has symbolic links.

        Warns
        -----
        OtherVersionsWarning
            The store was begun with other versions of packages that numbers depend on.
        """
        check_folder_links(folder)
        store = Store(folder)
        exists = store.path.exists()
        if exists and not resume:
            raise StoreError(
                f"{str(folder)!r} holds results already; "
                "give another --out, or --resume to continue them."
            )
        if exists:
            if lock is None:
                check_unlocked(folder)
            store._check_same(config)
            if inputs is not None and outdated is None:
                check_inputs(
                    noted_inputs(folder), inputs, f"The results in {str(folder)!r} are", _RENEW
                )
            for path in outdated or ():
                shutil.rmtree(store.path / path, ignore_errors=True)
        store._inputs = inputs
        begin = store._continue if exists else store._begin
        try:
            begin(config, paths)
        except OSError as error:
            raise StorageError(f"{str(folder)!r} cannot be written: {error.strerror}.") from None
        return store

    def done(self, path: str) -> bool:
        """Whether the cell at `path` is there, as it was written; a damaged one is removed."""
        group = self.path / path
        line = self._cells.get(path)
        reason = "its checksum is not known" if line is None else damage_of(group, _expected(line))
        if reason is None:
            return True
        if group.exists():
            self.damaged[path] = reason
            shutil.rmtree(group, ignore_errors=True)
        self._cells.pop(path, None)
        return False

    def write(self, path: str, result: xr.Dataset) -> None:
        """Commit a cell: written beside the tree, entered into the manifest, renamed into place.

        Raises
        ------
        StorageError
            It cannot be written; what was committed before is kept.
        """
        partial = self.folder / f".partial-{hashlib.sha256(path.encode()).hexdigest()[:16]}"
        shutil.rmtree(partial, ignore_errors=True)
        try:
            # Zarr v3 has no stable type for fixed-width text; the root's attribute `bound` names them.
            found = write_cell(partial, result.drop_vars("bound", errors="ignore"))
            self._make_parents(path)
            line = CellLine(path, found.sha256, found.parts, found.bytes, now())
            append_line(self.folder, line)
            partial.replace(self.path / path)
        except OSError as error:
            raise StorageError(
                f"The cell {path} cannot be written: {error.strerror}; what was finished is kept, and "
                "--resume continues it."
            ) from None
        finally:
            shutil.rmtree(partial, ignore_errors=True)
        self._cells[path] = line

    def finish(self) -> None:
        """Note that all cells are there, if they are; let the tree be opened in one read.

        The metadata of the cells are consolidated up to 2,000 of them. Where neither can be written,
        as on a full disk, nothing is lost: readers can do without.
        """
        with contextlib.suppress(OSError, StorageError):
            if self._paths and all(path in self._cells for path in self._paths):
                append_line(self.folder, state_line("finished"))
            if len(self._cells) <= _MOST_CONSOLIDATED:
                document = root_document(self.path) | {"consolidated_metadata": self._inline()}
                self._replace(self.path / "zarr.json", document)

    def _begin(self, config: StudyConfig, paths: Sequence[str]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self._paths = tuple(paths)
        write_manifest(self.folder, self._study_line(config), paths)
        partial = self.folder / f".{STORE_NAME}.partial"
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        document = json.dumps({**_GROUP, "attributes": _root_attributes(config)})
        (partial / "zarr.json").write_text(document, encoding="utf-8")
        partial.replace(self.path)

    def _continue(self, config: StudyConfig, paths: Sequence[str]) -> None:
        for partial in self.folder.glob(".partial-*"):
            shutil.rmtree(partial) if partial.is_dir() else partial.unlink()
        manifest = read_manifest(self.folder) or Manifest(None, (), {}, (), (), 0)
        self._cells = manifest.cells
        self._paths = tuple(paths) or manifest.paths
        study = manifest.study or self._study_line(config)
        if self._inputs is not None:
            study = msgspec.structs.replace(study, inputs=dict(self._inputs))
        further: list[Line] = [*manifest.cells.values(), *manifest.states, state_line("resumed")]
        write_manifest(self.folder, study, self._paths, further)
        document = root_document(self.path)
        if document.pop("consolidated_metadata", None) is not None:
            self._replace(
                self.path / "zarr.json", document
            )  # readers would not see cells that are added

    def _study_line(self, config: StudyConfig) -> StudyLine:
        return study_line(config_hash(config), config.seed, package_versions(), self._inputs)

    def _make_parents(self, path: str) -> None:
        *parents, _ = path.split("/")
        for depth in range(1, len(parents) + 1):
            parent = "/".join(parents[:depth])
            file = self.path / parent / "zarr.json"
            if parent not in self._parents and not file.is_file():
                file.parent.mkdir(exist_ok=True)
                self._replace(file, _GROUP)
            self._parents.add(parent)

    def _replace(self, file: Path, document: dict[str, Any]) -> None:
        """Write metadata in place of other, as a whole or not at all."""
        partial = self.folder / f".partial-{file.name}"
        partial.write_text(json.dumps(document), encoding="utf-8")
        partial.replace(file)

    def _inline(self) -> dict[str, Any]:
        """Metadata of all groups and arrays, as zarr keeps them in the root's.

        Consolidated metadata is outside the specification of Zarr v3; it is what zarr-python writes.
        """
        found: dict[str, Any] = {}
        empty = {"kind": "inline", "must_understand": False, "metadata": {}}
        for path in sorted(self._cells):
            *parents, _ = path.split("/")
            for depth in range(1, len(parents) + 1):
                found["/".join(parents[:depth])] = {**_GROUP, "consolidated_metadata": empty}
            for name, document in array_documents(self.path / path).items():
                extra = {} if name else {"consolidated_metadata": empty}
                found[f"{path}/{name}".rstrip("/")] = document | extra
        return {**empty, "metadata": found}

    def _check_same(self, config: StudyConfig) -> None:
        attributes = root_attributes(self.path)
        if attributes.get("format") != FORMAT:
            earlier = attributes.get("format") == 1
            raise StoreError(
                f"{str(self.path)!r} has store format {attributes.get('format')!r}; this version "
                f"writes {FORMAT}{' and only reads 1' if earlier else ''}: give another --out."
            )
        if attributes.get("study_hash") != config_hash(config):
            raise StoreError(
                f"{str(self.path)!r} belongs to another study or another version of this one; "
                "give another --out."
            )
        _check_versions(self.folder, attributes)


def config_hash(config: StudyConfig) -> str:
    """SHA-256 of the study's canonical JSON, without the time limit: results do not depend on it."""
    study = msgspec.structs.replace(config, time_limit=None)
    return hashlib.sha256(msgspec.json.encode(study, order="sorted")).hexdigest()


def noted_inputs(folder: Path) -> dict[str, str] | None:
    """SHA-256 of the files that the results in a folder depend on; None if they were not noted."""
    manifest = read_manifest(folder)
    return None if manifest is None or manifest.study is None else manifest.study.inputs


def root_attributes(path: Path) -> dict[str, Any]:
    """Attributes of a store's root group.

    Raises
    ------
    StoreError
        There is no store, or it is damaged.
    """
    attributes: dict[str, Any] = root_document(path)["attributes"]
    return attributes


def root_document(path: Path) -> dict[str, Any]:
    """Metadata of a store's root group.

    Raises
    ------
    StoreError
        There is no store, or it is damaged.
    """
    try:
        document = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StoreError(f"There are no results in {str(path.parent)!r}.") from None
    except (OSError, ValueError, RecursionError):
        document = None
    if not isinstance(document, dict) or not isinstance(document.get("attributes"), dict):
        raise StoreError(f"{str(path)!r} is damaged: its zarr.json cannot be read.")
    return document


def _root_attributes(config: StudyConfig) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "study": json.loads(msgspec.json.encode(config)),
        "study_hash": config_hash(config),
        "bound": _BOUND,
        **package_versions(),
    }


def _check_versions(folder: Path, attributes: dict[str, Any]) -> None:
    """Refuse results of another version of this package, warn of other versions of those it uses."""
    others = {
        name.removeprefix("version_"): (attributes[name], version)
        for name, version in package_versions().items()
        if attributes.get(name, version) != version
    }
    if "mcspectra" in others:
        before, now = others["mcspectra"]
        raise StoreError(
            f"The results in {str(folder)!r} are of mcspectra {before}, and this is {now}, whose numbers "
            "may differ: resume them with the version that began them, or give another --out."
        )
    if others:
        changes = ", ".join(f"{name} {old} (now {new})" for name, (old, new) in others.items())
        warn(
            f"The results in {str(folder)!r} were begun with {changes}: the last bits of those to come "
            "may differ from an uninterrupted run's.",
            OtherVersionsWarning,
        )


def _expected(line: CellLine) -> Checksum:
    return Checksum(line.sha256, line.parts, line.bytes)
