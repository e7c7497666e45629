"""Symbolic links in a study's folder: none is followed, as a stranger's could lead anywhere.

Reading through one shows files that nobody meant to show; writing or removing through one changes
them. Folders that a run writes and trees that are opened are therefore searched for links first.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from mcspectra.core.errors import StoreError

__all__ = ["check_folder_links", "check_tree_links"]

_WRITTEN = frozenset(
    {"run.lock", "manifest.jsonl", "results.zarr", "journal", "report.html", "figures"}
)
_PARTIAL = (".partial-", *(f".{name}" for name in _WRITTEN))


def check_folder_links(folder: Path) -> None:
    """Refuse an output folder in which what a run writes is a link, or has one inside.

    The folder itself may be one, and so may files of others in it.

    Raises
    ------
    StoreError
        It names the link.
    """
    for entry in _entries(str(folder)):
        if entry.name in _WRITTEN or entry.name.startswith(_PARTIAL):
            _refuse(entry.path if entry.is_symlink() else _link_below(entry))


def check_tree_links(tree: Path, path: str = "") -> None:
    """Refuse a store, or one of its groups, with a link inside or on the way to it.

    The tree itself may be a link: whoever opens it has named it.

    Raises
    ------
    StoreError
        It names the link.
    """
    if path:
        way = str(tree)
        for name in ("zarr.json", *path.split("/")):
            inner = f"{way}/{name}"
            _refuse(inner if os.path.islink(inner) else None)  # noqa: PTH114 - of thousands of cells
            way = way if name == "zarr.json" else inner
    _refuse(next(_links(f"{tree}/{path}"), None))


def _link_below(entry: os.DirEntry[str]) -> str | None:
    return next(_links(entry.path), None) if entry.is_dir(follow_symlinks=False) else None


def _links(folder: str) -> Iterator[str]:
    """Paths of links below a folder, which are not followed."""
    waiting = [folder]
    while waiting:
        for entry in _entries(waiting.pop()):
            if entry.is_symlink():
                yield entry.path
            elif entry.is_dir(follow_symlinks=False):
                waiting.append(entry.path)


def _entries(folder: str) -> Iterator[os.DirEntry[str]]:
    """What a folder holds; nothing if it is not there."""
    try:
        with os.scandir(folder) as entries:
            yield from entries
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise StoreError(f"{folder!r} cannot be read: {error.strerror}.") from None


def _refuse(link: str | None) -> None:
    if link is not None:
        raise StoreError(
            f"{link!r} is a symbolic link, and might lead to files of others; results hold files only: "
            "remove it, or take another folder."
        )
