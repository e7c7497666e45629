"""A store copied as it is, file by file: into a zip file, another folder, or to a URL.

The root's metadata come last, so that what was cut off on its way is no store to any reader.
"""

from __future__ import annotations

import contextlib
import shutil
import zipfile
from collections.abc import Callable, Generator
from functools import partial
from pathlib import Path
from typing import IO, Any, TypeAlias

from mcspectra.core.errors import MissingDependency, StorageError, StoreError
from mcspectra.studies.opening import check_store, store_url
from mcspectra.studies.places import first_line, is_url, url_files
from mcspectra.studies.store import STORE_NAME, root_document

__all__ = ["copy_to_folder", "copy_to_url", "copy_to_zip"]

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first that a zip file can hold: same results, same bytes
_ROOT = "zarr.json"
_PIECE = 2**20

Member: TypeAlias = tuple[str, Callable[[], IO[bytes]]]
"""Name of a file in a store, and what opens it."""

Members: TypeAlias = Generator[Member, None, None]


def copy_to_zip(source: str | Path, file: Path) -> None:
    """Put a store into a zip file that zarr and `open_results` read.

    Parameters
    ----------
    source
        What `open_results` takes.
    file
        It is written over.

    Raises
    ------
    StoreError
        There is no store, or a file of it leads elsewhere.
    OSError
        The file cannot be written.
    """
    with (
        contextlib.closing(_members(source)) as members,
        zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive,
    ):
        for name, opened in members:
            with opened() as stream, archive.open(zipfile.ZipInfo(name, _EPOCH), "w") as out:
                shutil.copyfileobj(stream, out, _PIECE)


def copy_to_folder(source: str | Path, folder: Path) -> None:
    """Copy a store to a folder, which is made; as `copy_to_zip` otherwise."""
    folder.mkdir()
    with contextlib.closing(_members(source)) as members:
        for name, opened in members:
            file = folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            with opened() as stream, file.open("wb") as out:
                shutil.copyfileobj(stream, out, _PIECE)


def copy_to_url(source: str | Path, url: str) -> None:
    """Copy a store to where fsspec writes.

    Raises
    ------
    StoreError
        There is no store, a file of it leads elsewhere, or something is at the URL already.
    StorageError
        It cannot be written there; what was written is removed, where that can be done.
    MissingDependency
        fsspec, or what it needs for such a URL, is not installed.
    """
    files, base = url_files(url)
    try:
        if files.exists(base):
            raise StoreError(f"There is something at {url!r} already; give another --to.")
        _write_all(source, files, base)
    except StoreError:
        raise
    except ImportError as error:
        raise MissingDependency(f"Writing to {url!r} needs more: {first_line(error)}.") from None
    except Exception as error:  # noqa: BLE001 - file systems of fsspec raise what their libraries do
        with contextlib.suppress(Exception):
            files.rm(base, recursive=True)
        raise StorageError(f"{url!r} cannot be written: {first_line(error)}.") from None


def _write_all(source: str | Path, files: Any, base: str) -> None:
    made: set[str] = set()
    with contextlib.closing(_members(source)) as members:
        for name, opened in members:
            parent = f"{base}/{name}".rpartition("/")[0]
            if parent not in made:
                files.makedirs(parent, exist_ok=True)
                made.add(parent)
            with opened() as stream, files.open(f"{base}/{name}", "wb") as out:
                shutil.copyfileobj(stream, out, _PIECE)


def _members(source: str | Path) -> Members:
    """All files of a store, in the order of their names, the root's metadata last."""
    check_store(source)
    if is_url(source):
        yield from _of_url(str(source))
    elif Path(source).suffix == ".zip":
        yield from _of_zip(Path(source))
    else:
        yield from _of_folder(Path(source))


def _of_folder(folder: Path) -> Members:
    tree = folder if folder.suffix == ".zarr" else folder / STORE_NAME
    root_document(tree)
    names = []
    for path in tree.rglob("*"):
        if path.is_symlink():
            raise StoreError(f"{str(path)!r} is a link; results hold files only.")
        if path.is_file():
            names.append(path.relative_to(tree).as_posix())
    for name in _ordered(names):
        yield name, partial(_opened, tree / name)


def _opened(file: Path) -> IO[bytes]:
    return file.open("rb")


def _of_zip(file: Path) -> Members:
    with zipfile.ZipFile(file) as archive:
        names = [info.filename for info in archive.infolist() if not info.is_dir()]
        for name in _ordered(names):
            yield name, partial(archive.open, name)


def _of_url(url: str) -> Members:
    files, base = url_files(store_url(url))
    names = [path.removeprefix(f"{base}/") for path in files.find(base)]
    for name in _ordered(names):
        yield name, partial(files.open, f"{base}/{name}", "rb")


def _ordered(names: list[str]) -> list[str]:
    """Names that lead nowhere else, the root's metadata last."""
    for name in names:
        parts = name.split("/")
        if any(part in ("", ".", "..") for part in parts) or "\\" in name or ":" in parts[0]:
            raise StoreError(f"The store has a file {name[:100]!r}, which is no path in a store.")
    return sorted(names, key=lambda name: (name == _ROOT, name))
