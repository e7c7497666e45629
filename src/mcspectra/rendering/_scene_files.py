"""Files that a scene's XML refers to, so that a change of any of them is noticed."""

from __future__ import annotations

import contextlib
import functools
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias
from xml.etree import ElementTree as ET

__all__ = ["referenced_files", "watched_state"]

State: TypeAlias = "tuple[tuple[Path, int, int], ...]"
"""Paths, sizes in bytes and times of change in nanoseconds."""

_REFERENCE = re.compile(r"\$(\w+)")


def watched_state(scene: Path) -> State:
    """Return the state of a scene's file and of all that it refers to, to be compared.

    The XML is read again only if one of the files has changed since the last call: otherwise this
    asks the file system for each, a few microseconds a file.
    """
    watch = _watch(scene.resolve())
    if not watch.state or _states(path for path, *_ in watch.state) != watch.state:
        watch.state = _states((watch.scene, *sorted(referenced_files(watch.scene))))
    return watch.state


def referenced_files(scene: Path) -> set[Path]:
    """Return the files that exist among those that a scene's XML names, included XML too.

    A name is looked for in the folders of the scene, of the file that names it, and of every
    ``<path>``. A file that is no XML refers to nothing.
    """
    first = scene.resolve()
    folders = [first.parent]
    found: set[Path] = set()
    waiting = [first]
    while waiting:
        file = waiting.pop()
        for name in _names(file, folders):
            places = {(folder / name).resolve() for folder in (*folders, file.parent)}
            new = {place for place in places if place.is_file()} - found - {first}
            found |= new
            waiting += [place for place in new if place.suffix.lower() == ".xml"]
    return found


@dataclass
class _Watch:
    """What is known of a scene's files."""

    scene: Path
    state: State = ()


_watch = functools.lru_cache(maxsize=64)(_Watch)


def _states(files: Iterable[Path]) -> State:
    """States of those files that exist."""
    found = []
    for file in files:
        with contextlib.suppress(OSError):
            status = file.stat()
            found.append((file, status.st_size, status.st_mtime_ns))
    return tuple(found)


def _names(file: Path, folders: list[Path]) -> Iterator[str]:
    """Values of strings and includes of one file; the folders of its ``<path>`` are added."""
    try:
        elements = list(ET.parse(file).iter())
    except (ET.ParseError, OSError):
        return
    defaults = {e.get("name", ""): e.get("value", "") for e in elements if e.tag == "default"}
    for element in elements:
        value = element.get("filename") or element.get("value") or ""
        value = _REFERENCE.sub(lambda match: defaults.get(match[1], match[0]), value)
        if element.tag == "path":
            folders.append(file.parent / value)
        elif value and element.tag in ("string", "include") and "\0" not in value:
            yield value
