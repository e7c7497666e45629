"""The journal of a running study: results of its tasks, in one file that is only added to.

``DIR/journal/log`` begins with a line that names the format; then come records
(`mcspectra.studies._records`), the first with the header of the study. A task's result is there as
soon as `append` returns, whatever happens to the process then; what a crash tore is cut off when the
journal is resumed, what is damaged is named and forgotten, so that it is computed again. Records are
reached through an index in memory; payloads stay in the file until they are asked for.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, final

import msgspec

from mcspectra.core.errors import StorageError, StoreError
from mcspectra.studies._records import MOST_PAYLOAD, Head, Record, encode_record
from mcspectra.studies._survey import MAGIC, OtherRun, study_digest, survey
from mcspectra.studies.lock import FolderLock

__all__ = ["JOURNAL_NAME", "Journal", "JournalState", "read_journal"]

JOURNAL_NAME = "journal"
_LOG = "log"
_SYNC_SECONDS = 1.0  # a power failure loses the results of this long; a crash of the process none
_WORTH_REWRITING = 2**20  # bytes of forgotten records
_MOST_SENTENCE = 10_000  # characters
_PIECE = 2**20


@final
@dataclass(frozen=True)
class JournalState:
    """What a journal holds, for those who only look.

    Attributes
    ----------
    done
        Keys with a payload.
    failures
        Sentences of the tasks that failed, by their keys.
    damaged
        Names of damaged records.
    size
        Bytes of the file.
    """

    done: tuple[str, ...]
    failures: dict[str, str]
    damaged: tuple[str, ...]
    size: int


@final
class Journal:
    """Results of the tasks of one study, for one writer: made by `create` or `resume`.

    Attributes
    ----------
    damaged
        Names of records that were found damaged and are forgotten: the key, or where it lay.
    """

    def __init__(self, folder: Path, header: dict[str, Any], lock: FolderLock | None) -> None:
        self.damaged: tuple[str, ...] = ()
        self._path = folder / JOURNAL_NAME / _LOG
        self._header = header
        self._study = study_digest(header)
        self._lock = lock
        self._index: dict[str, Record] = {}
        self._file: BinaryIO | None = None
        self._end = 0
        self._live = 0  # bytes of the records that count
        self._synced = time.monotonic()

    @staticmethod
    def create(
        folder: str | Path, header: dict[str, Any], *, lock: FolderLock | None = None
    ) -> Journal:
        """Begin a journal in ``folder/journal``.

        Parameters
        ----------
        folder
            Output folder of the study.
        header
            What says which study it is, as JSON can hold it: hash, seed, versions.
        lock
            The lock of the folder, if the caller holds it; the journal takes one otherwise.

        Raises
        ------
        StoreError
            There is a journal already, another process writes into the folder, or it cannot be
            written.
        """
        return _opened(Path(folder), header, lock, Journal._begin)

    @staticmethod
    def resume(
        folder: str | Path,
        header: dict[str, Any],
        *,
        lock: FolderLock | None = None,
        renew: bool = False,
    ) -> Journal:
        """Go on with the journal of a folder; all of it is verified. Without one, begin it.

        Parameters
        ----------
        folder, header, lock
            As of `create`.
        renew
            Replace a journal with another header by an empty one.

        Raises
        ------
        StoreError
            It belongs to another study or format, another process writes into the folder, or it
            cannot be read or written.
        """
        begin = Journal._renew if renew else Journal._continue
        return _opened(Path(folder), header, lock, begin)

    def append(
        self, key: str, payload: bytes | None, error: str | None, info: dict[str, Any]
    ) -> None:
        """Add the result of a task; the last one of a key counts.

        Parameters
        ----------
        payload, error
            What came of it, or the sentence that says why nothing did: one of the two.
        info
            What else is to be known of it, as JSON can hold it.

        Raises
        ------
        StorageError
            It cannot be written, as when the disk is full; all earlier records are kept.
        StoreError
            Both or neither of payload and error are given, or the payload is too large.
        """
        if (payload is None) == (error is None):
            raise StoreError(f"Task {key!r} needs a result or an error, and not both.")
        data = payload or b""
        if len(data) > MOST_PAYLOAD:
            raise StoreError(
                f"The result of {key!r} has {len(data):,} bytes; a record holds {MOST_PAYLOAD:,} at "
                "most: take smaller tasks."
            )
        sentence = (
            None if error is None else error[:_MOST_SENTENCE].encode("utf-8", "replace").decode()
        )
        record = self._write(Head(key, hashlib.sha256(data).hexdigest(), sentence, info), data)
        self._drop(key)
        self._index[key] = record
        self._live += _length(record)

    def done(self, key: str) -> bool:
        """Whether there is a payload of the task."""
        record = self._index.get(key)
        return record is not None and record.head.error is None

    def payload(self, key: str) -> bytes:
        """The payload of a task that is done.

        Raises
        ------
        StoreError
            There is none, or it has been damaged since: then it is forgotten.
        """
        if not self.done(key):
            raise StoreError(f"The journal {str(self._path)!r} holds no result of {key!r}.")
        record = self._index[key]
        data = b"".join(_pieces(self._open_file(), record.payload, record.end))
        if hashlib.sha256(data).hexdigest() != record.head.sha256:
            self._drop(key)
            self.damaged += (key,)
            raise StoreError(
                f"The result of {key!r} in {str(self._path)!r} is damaged; --resume computes it again."
            )
        return data

    def keys(self) -> Iterator[str]:
        """Keys of the tasks that are done."""
        return (key for key, record in self._index.items() if record.head.error is None)

    def info(self, key: str) -> dict[str, Any]:
        """What was noted with the last record of a task, done or failed; empty without one."""
        record = self._index.get(key)
        return {} if record is None else dict(record.head.info)

    def failures(self) -> dict[str, str]:
        """Sentences of the tasks that failed, by their keys."""
        return _failures(self._index)

    def forget(self, keys: Iterable[str]) -> None:
        """Drop records: of cells that are in the store, or of failures that are tried again.

        The file is rewritten when most of it is forgotten; until then a resumed journal holds them.
        """
        for key in keys:
            self._drop(key)
        if self._end - self._live > max(self._live, _WORTH_REWRITING):
            self._rewrite()

    def compact(self) -> None:
        """Cut out of the file what is forgotten; where that cannot be written, it stays."""
        with contextlib.suppress(StorageError):
            self._rewrite()

    def close(self) -> None:
        """Make sure that all is on the disk, and give the folder free; a second call does nothing."""
        if self._file is not None:
            _sync(self._file)
            self._file.close()
            self._file = None
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _drop(self, key: str) -> None:
        record = self._index.pop(key, None)
        self._live -= 0 if record is None else _length(record)

    def _begin(self) -> None:
        if self._path.exists():
            raise StoreError(
                f"{str(self._path.parent)!r} holds a journal already; give another --out, or "
                "--resume to continue it."
            )
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._rewrite()

    def _continue(self) -> None:
        if not self._path.exists():
            self._begin()
            return
        found = survey(self._path, self._header, verify=True)
        self._index, self.damaged, self._end = found.index, found.damaged, found.size
        self._live = sum(map(_length, found.index.values()))
        if self.damaged:
            self._rewrite()
        elif found.torn is not None:
            self._cut(found.torn)

    def _renew(self) -> None:
        try:
            self._continue()
        except OtherRun:
            self._rewrite()

    def _write(self, head: Head, data: bytes) -> Record:
        """Add a record at the end; a part of one is taken back."""
        file = self._open_file()
        start = self._end
        text = encode_record(self._study, head, len(data))
        try:
            file.seek(start)
            _write_all(file, text)
            _write_all(file, data)
            if time.monotonic() - self._synced > _SYNC_SECONDS:
                _sync(file)
                self._synced = time.monotonic()
        except OSError as error:
            self._cut(start)
            raise _unwritable(self._path, error) from None
        self._end = start + len(text) + len(data)
        return Record(self._study, head, start, start + len(text), self._end)

    def _cut(self, end: int) -> None:
        self._open_file().truncate(end)
        self._end = end

    def _open_file(self) -> BinaryIO:
        if self._file is None:
            # Without a buffer: what is written is the system's, and outlives the process.
            self._file = self._path.open("r+b", buffering=0)
        return self._file

    def _rewrite(self) -> None:
        """Write the header and the records that count into a new file, and put it in place."""
        partial = self._path.with_suffix(".partial")
        head = Head("", hashlib.sha256(b"").hexdigest(), None, self._header)
        try:
            with partial.open("wb") as out:
                out.write(MAGIC + encode_record(self._study, head, 0))
                index = dict(self._copied(out))
                end = out.tell()
                out.flush()
                _sync(out)
            partial.replace(self._path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            if self._file is None:
                raise _unwritable(self._path, error) from None
            return  # the old file holds all that the new one would
        if self._file is not None:
            self._file.close()
            self._file = None
        self._index, self._end = index, end
        _sync_folder(self._path.parent)

    def _copied(self, out: BinaryIO) -> Iterator[tuple[str, Record]]:
        for key, record in self._index.items():
            start = out.tell()
            out.writelines(_pieces(self._open_file(), record.start, record.end))
            shift = start - record.start
            yield (
                key,
                msgspec.structs.replace(
                    record, start=start, payload=record.payload + shift, end=record.end + shift
                ),
            )


def read_journal(
    folder: str | Path, header: dict[str, Any] | None = None, *, verify: bool = False
) -> JournalState | None:
    """Look into the journal of a folder, which may be in use; None if there is none.

    Parameters
    ----------
    header
        As it was given to `Journal.create`; by default the one that the journal has.
    verify
        Check the payloads too, which reads all of the file.

    Raises
    ------
    StoreError
        It is of another study or format, or cannot be read.
    """
    path = Path(folder) / JOURNAL_NAME / _LOG
    try:
        found = survey(path, header, verify=verify)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise StoreError(f"{str(path)!r} cannot be read: {error.strerror}.") from None
    done = tuple(key for key, record in found.index.items() if record.head.error is None)
    return JournalState(done, _failures(found.index), found.damaged, found.size)


def _opened(
    folder: Path,
    header: dict[str, Any],
    lock: FolderLock | None,
    begin: Callable[[Journal], None],
) -> Journal:
    """A journal whose file is there and whose folder is locked."""
    journal = Journal(folder, header, FolderLock.take(folder) if lock is None else None)
    try:
        begin(journal)
    except OSError as error:
        journal.close()
        raise _unwritable(folder / JOURNAL_NAME, error) from None
    except BaseException:
        journal.close()
        raise
    return journal


def _failures(index: dict[str, Record]) -> dict[str, str]:
    return {key: r.head.error for key, r in index.items() if r.head.error is not None}


def _length(record: Record) -> int:
    return record.end - record.start


def _unwritable(path: Path, error: OSError) -> StorageError:
    return StorageError(
        f"{str(path)!r} cannot be written: {error.strerror}; what was finished is kept, and --resume "
        "continues it."
    )


def _write_all(file: BinaryIO, data: bytes) -> None:
    """Write all of it; the system may take a part at a time."""
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]


def _pieces(file: BinaryIO, start: int, end: int) -> Iterator[bytes]:
    """A part of a file, piece by piece; less if the file has become shorter."""
    file.seek(start)
    while start < end and (piece := file.read(min(end - start, _PIECE))):
        yield piece
        start += len(piece)


def _sync(file: BinaryIO) -> None:
    os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """Make a renaming last; where folders cannot be opened the system does it."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
