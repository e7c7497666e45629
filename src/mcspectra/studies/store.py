"""The result store: a zarr directory, one writer, whole cells or nothing.

Layout: ``/`` (attributes: the study's text and hash, versions, state), then
``/<estimator>/<sampler>/<analysis>``, a dataset each. A cell is written beside the store's tree and
renamed into place, so that a group that exists is complete: `--resume` skips those and nothing else.
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from mcspectra.core.errors import StoreError
from mcspectra.core.results import package_versions
from mcspectra.studies.config import StudyConfig

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["STORE_NAME", "Store", "config_hash", "open_results"]

STORE_NAME = "results.zarr"
_FORMAT = 1
_BOUND = ["low", "high"]


class Store:
    """Results of one study in a folder.

    Parameters
    ----------
    folder
        Output folder; the store is ``results.zarr`` inside.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / STORE_NAME

    @staticmethod
    def create(folder: Path, config: StudyConfig, *, resume: bool = False) -> Store:
        """Make a new store, or with `resume` open the one that is there.

        Raises
        ------
        StoreError
            A store exists and `resume` is not asked for, or it belongs to another study or format;
            or the folder cannot be written.
        """
        store = Store(folder)
        if store.path.exists():
            if not resume:
                raise StoreError(
                    f"{str(folder)!r} holds results already; "
                    "give another --out, or --resume to continue them."
                )
            store._check_same(config)
            store._remove_partial()
            store._forget_consolidation()
            return store
        try:
            folder.mkdir(parents=True, exist_ok=True)
            store._write_root(config)
        except OSError as error:
            raise StoreError(f"{str(folder)!r} cannot be written: {error.strerror}.") from None
        return store

    def done(self, path: str) -> bool:
        """Whether the cell at `path` is there and can be read; a damaged one is removed."""
        group = self.path / path
        if not group.exists():
            return False
        if _readable(group):
            return True
        shutil.rmtree(group, ignore_errors=True)
        return False

    def write(self, path: str, result: xr.Dataset) -> None:
        """Commit a cell: write beside the tree, then rename into place."""
        target = self.path / path
        partial = self.folder / f".partial-{hashlib.sha256(path.encode()).hexdigest()[:16]}"
        shutil.rmtree(partial, ignore_errors=True)
        try:
            # Zarr v3 has no stable type for fixed-width text; the root's attribute `bound` names them.
            result.drop_vars("bound", errors="ignore").to_zarr(
                partial, mode="w", zarr_format=3, consolidated=False, write_empty_chunks=True
            )
            self._make_parents(path)
            partial.replace(target)
        except OSError as error:
            shutil.rmtree(partial, ignore_errors=True)
            raise StoreError(f"The cell {path} cannot be written: {error.strerror}.") from None

    def finish(self) -> None:
        """Consolidate the metadata, so that the whole tree opens in one read."""
        import warnings

        import zarr

        with warnings.catch_warnings():
            # Consolidated metadata is outside the v3 specification; every reader can do without.
            warnings.simplefilter("ignore")
            zarr.consolidate_metadata(str(self.path))

    def _make_parents(self, path: str) -> None:
        import zarr

        *parents, _ = path.split("/")
        for depth in range(1, len(parents) + 1):
            group = self.path.joinpath(*parents[:depth])
            if not (group / "zarr.json").is_file():
                zarr.open_group(str(group), mode="a", zarr_format=3)

    def _write_root(self, config: StudyConfig) -> None:
        import zarr

        partial = self.folder / f".{STORE_NAME}.partial"
        shutil.rmtree(partial, ignore_errors=True)
        root = zarr.open_group(str(partial), mode="w", zarr_format=3)
        root.attrs.update(
            {
                "format": _FORMAT,
                "study": json.loads(msgspec.json.encode(config)),
                "study_hash": config_hash(config),
                "bound": _BOUND,
                **package_versions(),
            }
        )
        partial.replace(self.path)

    def _check_same(self, config: StudyConfig) -> None:
        attributes = root_attributes(self.path)
        if attributes.get("format") != _FORMAT:
            raise StoreError(
                f"{str(self.path)!r} has store format {attributes.get('format')!r}; this version "
                f"reads {_FORMAT}: give another --out."
            )
        if attributes.get("study_hash") != config_hash(config):
            raise StoreError(
                f"{str(self.path)!r} belongs to another study or another version of this one; "
                "give another --out."
            )

    def _forget_consolidation(self) -> None:
        """Drop consolidated metadata before cells are added: readers would not see those."""
        document = _root_document(self.path)
        if document.pop("consolidated_metadata", None) is not None:
            partial = self.folder / f".{STORE_NAME}.root"
            partial.write_text(json.dumps(document), encoding="utf-8")
            partial.replace(self.path / "zarr.json")

    def _remove_partial(self) -> None:
        for partial in self.folder.glob(".partial-*"):
            shutil.rmtree(partial, ignore_errors=True)


def _readable(group: Path) -> bool:
    """Whether every chunk of a cell is there and decodes; zarr reads missing ones as fill values."""
    import xarray as xr

    try:
        for array in group.glob("*/zarr.json"):
            document = json.loads(array.read_text(encoding="utf-8"))
            chunk = document["chunk_grid"]["configuration"]["chunk_shape"]
            expected = math.prod(-(-n // c) for n, c in zip(document["shape"], chunk, strict=True))
            folder = array.parent / "c"
            found = 1 if folder.is_file() else sum(f.is_file() for f in folder.rglob("*"))
            if found != expected:
                return False
        xr.open_zarr(group, consolidated=False).load()
    except (OSError, ValueError, KeyError, TypeError, RuntimeError):
        return False
    return True


def config_hash(config: StudyConfig) -> str:
    """SHA-256 of the study's canonical JSON."""
    return hashlib.sha256(msgspec.json.encode(config, order="sorted")).hexdigest()


def root_attributes(path: Path) -> dict[str, Any]:
    """Attributes of a store's root group.

    Raises
    ------
    StoreError
        There is no store, or it is damaged.
    """
    attributes: dict[str, Any] = _root_document(path)["attributes"]
    return attributes


def _root_document(path: Path) -> dict[str, Any]:
    try:
        document = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StoreError(f"There are no results in {str(path.parent)!r}.") from None
    except (OSError, ValueError):
        document = None
    if not isinstance(document, dict) or not isinstance(document.get("attributes"), dict):
        raise StoreError(f"{str(path)!r} is damaged: its zarr.json cannot be read.")
    return document


def open_results(folder: str | Path) -> xr.DataTree:
    """Open the results of a study as a tree of datasets, loaded lazily.

    Raises
    ------
    StoreError
        There are none in `folder`.
    """
    import xarray as xr

    path = Path(folder) / STORE_NAME
    consolidated = _root_document(path).get("consolidated_metadata") is not None
    return xr.open_datatree(path, engine="zarr", consolidated=consolidated)
