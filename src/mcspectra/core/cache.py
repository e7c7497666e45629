"""Arrays that take seconds to make, kept in the user's cache folder under a key that says it all.

An entry is one file: a line that names the format, a line of JSON (key, shape, SHA-256 of all),
the data as little-endian float64. What is read is checked against all of these; a damaged
entry is made again. The folder is the platform's cache folder, or ``MCSPECTRA_CACHE``.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import CacheWarning, ParameterError, warn

__all__ = ["cache_folder", "cache_size", "cached_array"]

_FORMAT = b"mcspectra cache 1\n"
_WORTH_KEEPING = 0.05  # seconds: what is made faster is not written
_LIMIT = 2**30  # bytes: beyond them the entries that are oldest go
_DATA = np.dtype("<f8")


def cache_folder() -> Path:
    """Return the folder of the cache: ``MCSPECTRA_CACHE`` if set, else the platform's own."""
    chosen = os.environ.get("MCSPECTRA_CACHE")
    if chosen:
        return Path(chosen)
    from platformdirs import user_cache_path

    return user_cache_path("mcspectra", appauthor=False)


def cache_size() -> tuple[int, int]:
    """Return the number of entries and their bytes."""
    entries = _entries(cache_folder())
    return len(entries), sum(size for _, size, _ in entries)


def cached_array(key: str, make: Callable[[], Array]) -> Array:
    """Return the float64 array kept under `key`; make it, and keep it if that took long.

    Parameters
    ----------
    key
        Everything the array depends on, the version of the method too.
    make
        What makes it, when there is no sound entry.

    Raises
    ------
    ParameterError
        The key is no text, or `make` cannot be called.

    Warns
    -----
    CacheWarning
        An entry is damaged (it is made again), or the folder cannot be written (once).
    """
    if not (isinstance(key, str) and callable(make)):  # type: ignore[redundant-expr]
        raise ParameterError(f"{key!r:.80} and {make!r:.80} are not a text and a function.")
    digest = hashlib.sha256(key.encode()).hexdigest()
    file = cache_folder() / digest[:2] / f"{digest[2:34]}.array"
    with suppress(OSError):  # there is no entry, or none that can be read
        found = _decoded(file.read_bytes(), key)
        if found is not None:
            return found
        warn(f"The cache entry {file} is damaged; it is made again.", CacheWarning)
    start = time.perf_counter()
    made = make()
    if time.perf_counter() - start > _WORTH_KEEPING:
        _keep(file, key, made)
    return made


def _decoded(content: bytes, key: str) -> Array | None:
    try:
        name, head, data = content.split(b"\n", 2)
        entry = json.loads(head)
        shape = tuple(int(size) for size in entry["shape"])
        sound = (
            name + b"\n" == _FORMAT
            and entry["key"] == key
            and math.prod(shape) * _DATA.itemsize == len(data)
            and entry["sha256"] == _digest(key, shape, data)
        )
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
    return np.frombuffer(data, _DATA).reshape(shape).astype(np.float64) if sound else None


def _keep(file: Path, key: str, made: Array) -> None:
    """Write an entry; other processes see all of it or nothing."""
    data = np.ascontiguousarray(made, _DATA).tobytes()
    digest = _digest(key, made.shape, data)
    head = json.dumps({"key": key, "shape": made.shape, "sha256": digest}).encode()
    part = file.with_suffix(f".{os.getpid()}-{time.monotonic_ns()}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(_FORMAT + head + b"\n" + data)
        part.replace(file)
        _drop_oldest(cache_folder())
    except OSError as error:
        part.unlink(missing_ok=True) if file.parent.is_dir() else None
        _say_once(f"Sets are not kept in {cache_folder()}: {error.strerror or error}.")


def _digest(key: str, shape: tuple[int, ...], data: bytes) -> str:
    return hashlib.sha256(f"{key} {shape}".encode() + data).hexdigest()


@lru_cache
def _drop_oldest(folder: Path) -> None:
    """Keep the cache below its limit; looked at once a process, at its first new entry."""
    total = 0
    for _, size, entry in sorted(_entries(folder), reverse=True):
        total += size
        if total > _LIMIT:
            entry.unlink(missing_ok=True)


def _entries(folder: Path) -> list[tuple[float, int, Path]]:
    """Time, bytes and file of each entry."""
    found = []
    for entry in folder.glob("*/*.array"):
        with suppress(OSError):  # another process has just removed it
            status = entry.stat()
            found.append((status.st_mtime, status.st_size, entry))
    return found


@lru_cache
def _say_once(sentence: str) -> None:
    warn(sentence, CacheWarning)
