"""Metadata twice: in the files of the arrays, and together in the root's, which readers take.

Checksums are of the files, so that what the root says must be the same: else a reader sees other
shapes, types or attributes than those that were verified.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

from mcspectra.core.errors import StoreError

__all__ = ["check_consolidated", "disagreement"]

_KEY = "consolidated_metadata"


def check_consolidated(
    tree: Path, root: dict[str, Any], paths: Collection[str] | None = None
) -> None:
    """Refuse a store whose root says other things of its cells than their files do.

    Parameters
    ----------
    tree, root, paths
        As of `disagreement`.

    Raises
    ------
    StoreError
        They disagree.
    """
    reason = disagreement(tree, root, paths)
    if reason is not None:
        raise StoreError(
            f"{str(tree)!r} is damaged or not ours: {reason}; --resume writes them again."
        )


def disagreement(
    tree: Path, root: dict[str, Any], paths: Collection[str] | None = None
) -> str | None:
    """Compare the consolidated metadata of a store, or of some of its cells, with its files.

    Parameters
    ----------
    tree
        The store's folder.
    root
        Metadata of its root group; nothing is compared if they hold no others.
    paths
        Of the cells; all by default.

    Returns
    -------
    str or None
        What disagrees first, in words.
    """
    inline = root.get(_KEY)
    if inline is None:
        return None
    documents = inline.get("metadata") if isinstance(inline, dict) else None
    if not isinstance(documents, dict):
        return "its consolidated metadata cannot be read"
    chosen = frozenset(paths or ())
    for name, document in documents.items():
        if not _is_inside(name):
            return f"its metadata name {name[:100]!r}, which is no path in a store"
        asked = paths is None or name in chosen or name.rpartition("/")[0] in chosen
        if asked and _without(document) != _read(tree / name / "zarr.json"):
            return f"the metadata of {name} are others in the root's zarr.json"
    return None


def _is_inside(name: str) -> bool:
    """Whether a name cannot lead out of the store, on any system."""
    strange = "\\" in name or ":" in name or "\0" in name
    return not strange and all(part not in ("", ".", "..") for part in name.split("/"))


def _read(file: Path) -> Any:
    try:
        return _without(json.loads(file.read_bytes()))
    except (OSError, ValueError, RecursionError):
        return None


def _without(document: Any) -> Any:
    """A document without what it says of others."""
    if not isinstance(document, dict):
        return document
    return {key: value for key, value in document.items() if key != _KEY}
