"""Finished tiles of a map in a folder, so that a run that was stopped can go on.

``manifest.json`` holds the settings and their hash; each tile is one ``tile-….npz``, whose members
carry checksums. Files are written beside their place and renamed, so that one that is there is
whole; one that was damaged since is found by its checksum and computed again.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, final

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import CacheWarning, StoreError, warn

__all__ = ["TileStore"]

_MANIFEST = "manifest.json"
_DAMAGE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error)


@final
class TileStore:
    """A folder of tiles that belong to one set of settings.

    Parameters
    ----------
    folder
        Made if need be.
    settings
        All that the tiles depend on, as JSON can hold it.
    resume
        Whether to go on with what is there.

    Raises
    ------
    StoreError
        The folder holds tiles and `resume` is False, they are of other settings, its manifest
        cannot be read, or the folder cannot be written.
    """

    def __init__(self, folder: str | Path, settings: Mapping[str, Any], *, resume: bool) -> None:
        self.folder = Path(folder)
        self._hash = _digest(settings)
        manifest = self.folder / _MANIFEST
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if manifest.exists():
                self._check_manifest(manifest, resume)
                return
            text = json.dumps({"hash": self._hash, "settings": settings}, indent=1)
            _write(manifest, text.encode())
        except OSError as error:
            raise StoreError(f"{str(folder)!r} cannot be written: {error.strerror}.") from None

    def load(self, tile: int) -> dict[str, Array] | None:
        """Return the arrays of a tile; None if it is not there, or (with a warning) damaged."""
        path = self._path(tile)
        if not path.exists():
            return None
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                if str(stored["hash"]) == self._hash:
                    return {name: stored[name] for name in stored.files if name != "hash"}
        except _DAMAGE:
            pass
        warn(f"The tile {path.name} is damaged; it is computed again.", CacheWarning)
        return None

    def save(self, tile: int, arrays: Mapping[str, Array]) -> None:
        """Keep the arrays of a tile."""
        path = self._path(tile)
        draft = _draft(path)
        try:
            with draft.open("wb") as file:
                np.savez(file, hash=np.array(self._hash), **arrays)  # type: ignore[arg-type]
            draft.replace(path)
        except OSError as error:
            draft.unlink(missing_ok=True)
            raise StoreError(f"{str(path)!r} cannot be written: {error.strerror}.") from None

    def _path(self, tile: int) -> Path:
        return self.folder / f"tile-{tile:06d}.npz"

    def _check_manifest(self, manifest: Path, resume: bool) -> None:
        if not resume:
            raise StoreError(
                f"{str(self.folder)!r} holds a map already; give another folder, or resume it."
            )
        try:
            known = json.loads(manifest.read_text(encoding="utf-8"))["hash"]
        except (ValueError, KeyError, TypeError):
            raise StoreError(f"{str(manifest)!r} is damaged; give another folder.") from None
        if known != self._hash:
            raise StoreError(
                f"{str(self.folder)!r} belongs to a map with other settings or of another version; "
                "give another folder."
            )


def _digest(settings: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def _draft(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.partial")


def _write(path: Path, content: bytes) -> None:
    draft = _draft(path)
    draft.write_bytes(content)
    draft.replace(path)
