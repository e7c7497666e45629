"""One writer a folder: a lock file that names who holds it, and outlives nobody.

The file holds the writer's host, process and boot id. While the writer lives, the operating system
locks the file too (flock), so that on one machine a lock of a dead process is told from a held one,
whatever process has its number today. Between machines only the file's words count: it is refused.
"""

from __future__ import annotations

import contextlib
import datetime as dt
import errno
import importlib
import os
import socket
import time
from pathlib import Path
from typing import Any, final

import msgspec

from mcspectra.core.errors import StaleLockWarning, StoreError, warn

__all__ = ["LOCK_NAME", "FolderLock", "LockHolder", "check_unlocked", "is_held", "lock_holder"]

LOCK_NAME = "run.lock"
_MOST_BYTES = 4096
_LOOKING = 5.0  # seconds for which others may look at a lock, one after another
_WORDS = 0.5  # seconds from a lock to the words of its holder, at most
_PAUSE = 0.005
_fcntl: Any
try:
    _fcntl = importlib.import_module("fcntl")
except ImportError:  # Windows: without flock a lock that is left behind must be removed by hand
    _fcntl = None
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)  # else words of ours would go into a file of others
_BOOT = Path("/proc/sys/kernel/random/boot_id")


class LockHolder(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Who holds, or held, a folder.

    Attributes
    ----------
    host, pid
        Name of the machine and number of the process there.
    boot
        Boot id of the machine; empty where the system has none.
    since
        When it was taken, UTC, ISO 8601.
    """

    host: str
    pid: int
    boot: str
    since: str

    @staticmethod
    def this_process() -> LockHolder:
        """The holder that this process is, from now on."""
        now = dt.datetime.now(dt.UTC).isoformat(timespec="seconds")
        return LockHolder(socket.gethostname(), os.getpid(), _boot_id(), now)

    @property
    def in_words(self) -> str:
        """For messages: ``process 12 on host 'a' since …``."""
        return f"process {self.pid} on host {self.host!r} since {self.since}"

    def on(self, other: LockHolder) -> bool:
        """Whether both are, or were, on one machine: the same host, or one boot of a machine."""
        return self.host == other.host or (self.boot != "" and self.boot == other.boot)


@final
class FolderLock:
    """The right to write into a folder, held until `release` or the end of the process.

    Use as a context manager, or call `release`.
    """

    def __init__(self, file: Path, descriptor: int) -> None:
        self._file = file
        self._descriptor: int | None = descriptor

    @staticmethod
    def take(folder: Path) -> FolderLock:
        """Take the lock of a folder, which is made if it is not there.

        Raises
        ------
        StoreError
            Another process holds it, or a process of another machine did and may still, or the
            folder cannot be written.

        Warns
        -----
        StaleLockWarning
            The process that held it has ended without releasing it; the lock is taken over.
        """
        file = folder / LOCK_NAME
        try:
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = _locked_descriptor(file)
        except OSError as error:
            raise _unlockable(file, error) from None
        try:
            _check_left_behind(file, descriptor)
            _write_holder(file, descriptor)
        except BaseException:
            os.close(descriptor)
            raise
        return FolderLock(file, descriptor)

    def release(self) -> None:
        """Give the folder free; a second call does nothing."""
        if self._descriptor is not None:
            self._file.unlink(missing_ok=True)  # while it is locked: nobody else's file goes
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def lock_holder(folder: Path) -> LockHolder | None:
    """Who holds a folder according to its lock file; None without one, or if it cannot be read."""
    try:
        with (folder / LOCK_NAME).open("rb") as stream:
            return _decoded(stream.read(_MOST_BYTES))
    except OSError:
        return None


def check_unlocked(folder: Path) -> None:
    """Refuse a folder that another process holds.

    Raises
    ------
    StoreError
        It names the holder.
    """
    holder = lock_holder(folder)
    if holder is not None and is_held(folder):
        raise _refusal(folder / LOCK_NAME, holder)


def is_held(folder: Path) -> bool:
    """Whether the lock of a folder is held; that of another machine counts as held.

    It only looks: a shared lock for a moment, which those who take the folder wait for.
    """
    holder = lock_holder(folder)
    if holder is None or not holder.on(LockHolder.this_process()):
        return holder is not None
    try:
        descriptor = os.open(folder / LOCK_NAME, os.O_RDONLY)
    except OSError:
        return False
    try:
        return not _flock(descriptor, shared=True)
    finally:
        os.close(descriptor)


def _locked_descriptor(file: Path) -> int:
    """Open the lock file and lock it."""
    while True:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o644)
        if not _flock_patiently(descriptor):
            holder = _new_holder(descriptor)
            os.close(descriptor)
            raise _refusal(file, holder)
        # The holder may have removed the file between the two calls: then ours is no one's.
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), file.stat()):
                return descriptor
        os.close(descriptor)


def _new_holder(descriptor: int) -> LockHolder | None:
    """Who has just locked a file: they may be about to write their words."""
    end = time.monotonic() + _WORDS
    while (holder := _decoded(os.pread(descriptor, _MOST_BYTES, 0))) is None:
        if time.monotonic() > end:
            break
        time.sleep(_PAUSE)
    return holder


def _unlockable(file: Path, error: OSError) -> StoreError:
    if error.errno == errno.ELOOP:
        return StoreError(
            f"{str(file)!r} is a symbolic link; a lock is a file of its own: remove it."
        )
    return StoreError(f"{str(file.parent)!r} cannot be written: {error.strerror}.")


def _flock_patiently(descriptor: int) -> bool:
    """Lock an open file that others may look at for a moment; False at once if another writes."""
    end = time.monotonic() + _LOOKING
    while not _flock(descriptor):
        if not _flock(descriptor, shared=True) or time.monotonic() > end:
            return False
        _fcntl.flock(descriptor, _fcntl.LOCK_UN)
        time.sleep(_PAUSE)
    return True


def _flock(descriptor: int, *, shared: bool = False) -> bool:
    """Lock an open file; False if another has it. Without flock a file with words is another's."""
    if _fcntl is None:
        return os.fstat(descriptor).st_size == 0
    kind = _fcntl.LOCK_SH if shared else _fcntl.LOCK_EX
    try:
        _fcntl.flock(descriptor, kind | _fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without flock
        return os.fstat(descriptor).st_size == 0
    return True


def _check_left_behind(file: Path, descriptor: int) -> None:
    """Warn of a lock that was left behind on this machine, refuse one of another."""
    content = os.pread(descriptor, _MOST_BYTES, 0)
    if not content:
        return
    holder = _decoded(content)
    if holder is not None and not holder.on(LockHolder.this_process()):
        raise _refusal(file, holder)
    who = "a process that cannot be read" if holder is None else holder.in_words
    warn(
        f"{str(file)!r} was left behind by {who}, which has ended; it is taken over.",
        StaleLockWarning,
    )


def _write_holder(file: Path, descriptor: int) -> None:
    try:
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, msgspec.json.encode(LockHolder.this_process()), 0)
    except OSError as error:
        raise StoreError(f"{str(file)!r} cannot be written: {error.strerror}.") from None


def _refusal(file: Path, holder: LockHolder | None) -> StoreError:
    who = "another process" if holder is None else holder.in_words
    return StoreError(
        f"{str(file.parent)!r} is being written by {who}; wait for it, give another --out, or remove "
        f"{file.name} there if that process has ended."
    )


def _decoded(content: bytes) -> LockHolder | None:
    try:
        return msgspec.json.decode(content, type=LockHolder)
    except msgspec.DecodeError:
        return None


def _boot_id() -> str:
    try:
        return _BOOT.read_text(encoding="ascii").strip()
    except (OSError, ValueError):
        return ""
