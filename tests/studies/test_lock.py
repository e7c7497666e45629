"""Who only looks at a lock keeps nobody from taking it, and is not taken for a writer."""

import contextlib
import fcntl
import os
import threading
import time
import warnings

import pytest

from mcspectra.core.errors import StaleLockWarning, StoreError
from mcspectra.studies import lock
from mcspectra.studies.lock import LOCK_NAME, FolderLock, is_held


@pytest.fixture
def left(tmp_path):
    """A folder whose last writer ended without releasing its lock."""
    with FolderLock.take(tmp_path):
        words = (tmp_path / LOCK_NAME).read_bytes()
    (tmp_path / LOCK_NAME).write_bytes(words)
    return tmp_path


@contextlib.contextmanager
def _looking(folder):
    """Somebody who looks at the lock of a folder meanwhile, as `is_held` does."""
    descriptor = os.open(folder / LOCK_NAME, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_SH)
    try:
        yield
    finally:
        os.close(descriptor)


def test_a_lock_that_somebody_looks_at_is_taken_as_soon_as_they_are_gone(left):
    looked, gone = threading.Event(), threading.Event()

    def look():
        with _looking(left):
            looked.set()
            time.sleep(0.2)
        gone.set()

    thread = threading.Thread(target=look)
    thread.start()
    looked.wait(10)
    with pytest.warns(StaleLockWarning):
        taken = FolderLock.take(left)
    assert gone.wait(10)
    assert is_held(left)
    taken.release()
    thread.join()


def test_who_looks_for_ever_is_not_waited_for_for_ever(left, monkeypatch):
    monkeypatch.setattr(lock, "_LOOKING", 0.1)
    with _looking(left), pytest.raises(StoreError, match="being written"):
        FolderLock.take(left)
    with pytest.warns(StaleLockWarning):
        FolderLock.take(left).release()


def test_a_writer_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(lock, "_LOOKING", 1000.0)
    with FolderLock.take(tmp_path), pytest.raises(StoreError, match="being written by process"):
        FolderLock.take(tmp_path)


def test_a_writer_that_has_just_come_is_named(tmp_path):
    """It has locked the file, and writes its name a moment later."""
    with FolderLock.take(tmp_path):
        words = (tmp_path / LOCK_NAME).read_bytes()
        (tmp_path / LOCK_NAME).write_bytes(b"")
        writing = threading.Timer(0.1, (tmp_path / LOCK_NAME).write_bytes, [words])
        writing.start()
        with pytest.raises(StoreError, match=f"written by process {os.getpid()} on host"):
            FolderLock.take(tmp_path)
        writing.join()


def test_who_looks_is_not_seen_by_others_who_look(left):
    assert not is_held(left)
    with _looking(left):
        assert not is_held(left)
    with pytest.warns(StaleLockWarning):
        taken = FolderLock.take(left)
    assert is_held(left)
    taken.release()
    assert not is_held(left)


def test_polling_never_keeps_a_writer_out(left):
    """A thread that asks all the time; descriptors of one process are strangers to each other."""
    over = threading.Event()
    words = (left / LOCK_NAME).read_bytes()

    def poll():
        while not over.is_set():
            is_held(left)

    thread = threading.Thread(target=poll)
    thread.start()
    try:
        for _ in range(200):
            (left / LOCK_NAME).write_bytes(words)
            with warnings.catch_warnings(action="ignore"), FolderLock.take(left):
                pass
    finally:
        over.set()
        thread.join()
