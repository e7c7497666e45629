"""Files that a scene's XML refers to, so that a change of any of them is noticed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

__all__ = ["referenced_files", "scene_state"]

_REFERENCE = re.compile(r"\$(\w+)")


def scene_state(scene: Path) -> dict[str, tuple[int, int]]:
    """Return size in bytes and time of change in nanoseconds of all files that a scene refers to.

    Parameters
    ----------
    scene
        The path of an XML file.

    Returns
    -------
    dict
        Paths relative to the scene's folder where they are below it, in order; without the scene.
    """
    root = scene.resolve().parent
    found = sorted(referenced_files(scene))
    states = [(path, path.stat()) for path in found]
    return {_relative(path, root): (s.st_size, s.st_mtime_ns) for path, s in states}


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


def _relative(path: Path, root: Path) -> str:
    return (path.relative_to(root) if path.is_relative_to(root) else path).as_posix()
