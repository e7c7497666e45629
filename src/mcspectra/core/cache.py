"""A cache of arrays that take seconds to compute, in the user's cache folder.

The key of an entry contains everything on which the array depends.
An entry is a file with a SHA-256 digest, the key and the array (see `mcspectra.core.records`).
When an entry is read, the digest and the key are checked. A damaged entry is computed again.
The folder is the cache folder of the platform, or ``MCSPECTRA_CACHE``.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import CacheWarning, FileFormatError, ParameterError, warn
from mcspectra.core.records import pack, unpack

__all__ = ["cache_folder", "cache_size", "cached_array"]

_FORMAT = "2 "  # version of the file format; each key, and so each file name, contains it
_WORTH_KEEPING = 0.05  # in seconds; arrays that take less time to compute are not stored
_LIMIT = 2**30  # in bytes; if the cache is larger, the oldest entries are deleted
_warn_once = lru_cache(warn)


def cache_folder() -> Path:
    """Return the cache folder: ``MCSPECTRA_CACHE`` if it is set, otherwise the platform's."""
    chosen = os.environ.get("MCSPECTRA_CACHE")
    if chosen:
        return Path(chosen)
    from platformdirs import user_cache_path

    return user_cache_path("mcspectra", appauthor=False)


def cache_size() -> tuple[int, int]:
    """Return the number of entries and their total size in bytes."""
    entries = _entries(cache_folder())
    return len(entries), sum(size for _, size, _ in entries)


def cached_array(key: str, make: Callable[[], Array]) -> Array:
    """Return the float64 array stored under `key`, or compute it. Slow results are stored.

    Parameters
    ----------
    key
        Everything on which the array depends, including the version of the method.
    make
        Function that computes the array if the cache has no valid entry.

    Raises
    ------
    ParameterError
        If the key is not a string, or `make` cannot be called.

    Warns
    -----
    CacheWarning
        If an entry is damaged. Its array is then computed again.
        If the folder cannot be written. This warning appears only once.
    """
    if not (isinstance(key, str) and callable(make)):  # type: ignore[redundant-expr]
        raise ParameterError(
            f"{key!r:.80} and {make!r:.80} are not a key and a function; give a "
            "string and a function."
        )
    name = hashlib.sha256(f"{_FORMAT}{key}".encode()).hexdigest()
    file = cache_folder() / name[:2] / f"{name[2:34]}.array"

    # Use the entry in the file if it is valid
    with suppress(OSError):  # if the entry does not exist or cannot be read, continue
        content = file.read_bytes()
        with suppress(FileFormatError, KeyError):
            if content[:32] == hashlib.sha256(content[32:]).digest():
                found: Array = unpack(dict[str, Array], content[32:])[key]
                return found
        warn(f"The cache entry {file} is damaged; it is computed again.", CacheWarning)

    # Compute it
    start = time.perf_counter()
    made = make()
    if time.perf_counter() - start <= _WORTH_KEEPING:
        return made

    # Store a slow result atomically: other processes can read a whole entry or none, never a part
    packed = pack({key: np.asarray(made, np.float64)})
    part = file.with_suffix(f".{os.getpid()}-{time.monotonic_ns()}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(hashlib.sha256(packed).digest() + packed)
        part.replace(file)
        _drop_oldest(cache_folder())
    except OSError as error:
        part.unlink(missing_ok=True) if file.parent.is_dir() else None
        sentence = f"Point sets cannot be stored in {cache_folder()}: {error.strerror or error}."
        _warn_once(sentence, CacheWarning)
    return made


@lru_cache
def _drop_oldest(folder: Path) -> None:
    """Delete the oldest entries of the cache if their total size exceeds the limit.

    Each process deletes entries only once, after it has stored its first entry.
    """
    total = 0
    for _, size, entry in sorted(_entries(folder), reverse=True):
        total += size
        if total > _LIMIT:
            entry.unlink(missing_ok=True)


def _entries(folder: Path) -> list[tuple[float, int, Path]]:
    """Return the time, the size in bytes and the file of each entry."""
    found = []
    for entry in folder.glob("*/*.array"):
        with suppress(OSError):  # another process has just removed the entry
            status = entry.stat()
            found.append((status.st_mtime, status.st_size, entry))
    return found
