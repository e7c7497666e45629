"""Files that the results of a study depend on, known by their SHA-256: a changed one is another study."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, final

from mcspectra.core.errors import StoreError

__all__ = ["Digests", "changed_inputs", "check_inputs", "function_sources", "with_references"]

_NAMED = 3  # in a message


@final
class Digests:
    """SHA-256 of files, each read once, by names for people.

    Parameters
    ----------
    folder
        Files below it are named from there, others by their whole path; modules by their names, since
        they lie elsewhere on every machine.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()
        self._by_path: dict[Path, str] = {}
        self.by_name: dict[str, str] = {}

    def add(self, files: Mapping[Path, str]) -> tuple[str, ...]:
        """Names of those files that exist, in order; what is none is for its reader to refuse.

        Parameters
        ----------
        files
            Their own names, empty for those that are named by their paths.
        """
        return tuple(sorted({self._add(path, name) for path, name in _resolved(files)}))

    def _add(self, path: Path, name: str) -> str:
        if not name:
            inside = path.is_relative_to(self._folder)
            name = path.relative_to(self._folder).as_posix() if inside else str(path)
        if path not in self._by_path:
            with path.open("rb") as stream:
                self._by_path[path] = hashlib.file_digest(stream, "sha256").hexdigest()
        self.by_name[name] = self._by_path[path]
        return name


def with_references(file: Path) -> set[Path]:
    """A file, and if it is a scene's XML all that it refers to."""
    if file.suffix.lower() != ".xml":
        return {file}
    from mcspectra.rendering._scene_files import referenced_files

    return {file, *referenced_files(file)}


def function_sources(function: Callable[..., Any], module: str) -> dict[Path, str]:
    """Files of the module that a function was named in and of the one that defines it, with names.

    What these import is not followed.
    """
    names = sorted({module, str(getattr(function, "__module__", module))})
    found = {name: getattr(sys.modules.get(name), "__file__", None) for name in names}
    return {Path(file): f"module {name}" for name, file in found.items() if file is not None}


def changed_inputs(before: Mapping[str, str] | None, now: Mapping[str, str]) -> tuple[str, ...]:
    """Names of files that have changed, come or gone; none if it is not known what there was."""
    if before is None:
        return ()
    return tuple(name for name in sorted({*before, *now}) if before.get(name) != now.get(name))


def check_inputs(
    before: Mapping[str, str] | None, now: Mapping[str, str], whose: str, remedy: str
) -> None:
    """Refuse files that have changed.

    Parameters
    ----------
    whose
        What has, or had, the files of `before`.
    remedy
        What to do about it.

    Raises
    ------
    StoreError
        It names the first few of them.
    """
    changed = changed_inputs(before, now)
    if changed:
        more = f" and {len(changed) - _NAMED} more" if len(changed) > _NAMED else ""
        names = ", ".join(map(repr, changed[:_NAMED])) + more
        what = "the file" if len(changed) == 1 else "the files"
        raise StoreError(f"{whose} not of {what} {names} as found now: {remedy}.")


def _resolved(files: Mapping[Path, str]) -> Iterator[tuple[Path, str]]:
    """Files that can be read, by their paths without links, and names; pipes and devices are none."""
    for file, name in files.items():
        path = file.resolve()
        if path.is_file() and os.access(path, os.R_OK):
            yield path, name
