"""The ledger of a study: the database ``DIR/study.sqlite``, with one writer and many readers.

One SQLite file holds all rows of a run: the study, its cells in order, and results with scalars.
The file also holds error sentences of failed cells, and partial sums of unfinished cells.
SQLite provides atomic commits and recovery after a crash.
This module adds the schema, the commit interval and the digests.
Each row has a SHA-256 of its contents, which is checked on every read.
The row ``tally`` has the number of finished cells and the bitwise XOR of all their digests.
A missing row is detected because the remaining rows do not match the ``tally``.
If the file is damaged, a resumed run keeps all sound rows on readable pages.
The run reports damaged rows and computes them again. `Ledger.verify` finds the same damaged rows.

The file has a rollback journal, which network file systems support.
A writer holds SQLite's lock on the empty file ``DIR/study.lock``.
The lock ends with its process, regardless of the holder noted in the ledger.
"""

from __future__ import annotations

import contextlib
import datetime as dt
import functools
import hashlib
import itertools
import json
import os
import socket
import sqlite3
import threading
import time
from collections.abc import Collection, Iterable, Iterator, KeysView, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeAlias, TypeVar, final

import msgspec
import numpy as np

from mcspectra.core.analysis import Chunk
from mcspectra.core.display import QUOTED, printable, shown
from mcspectra.core.errors import (
    FileFormatError,
    OtherVersionsWarning,
    StorageError,
    StoreError,
    warn,
)
from mcspectra.core.records import unpack
from mcspectra.core.results import package_versions
from mcspectra.studies.files import StudyConfig, plain_study
from mcspectra.studies.salvage import Leaves
from mcspectra.studies.vetting import check_inputs

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "FORMAT",
    "LEDGER_NAME",
    "STORE_NAME",
    "Holder",
    "Ledger",
    "StudyNote",
    "StudyTally",
    "Survey",
    "are_paths",
    "is_held",
    "lock_damage",
    "refuse_links",
    "scalars_of",
]

FORMAT = 7
"""Format number of ledgers and stores.

Formats 1 and 2 were zarr stores that grew during a run.
Format 3 had no scalars. In format 4, every query of failures had to read the study's text.
Format 5 stored the notes once; later formats store a second copy of the notes.
"""

LEDGER_NAME = "study.sqlite"
STORE_NAME = "results.zarr"
_LOCK_NAME = "study.lock"
_BESIDE = ("", "-journal", "-wal", "-shm")  # Suffixes of files that SQLite opens together
_PAGE = 8192  # Page size in bytes

_COMMIT_SECONDS = 1.0  # Seconds between commits. A crash may lose the results since the last one
_COMMIT_BYTES = 2**25
_BUSY_SECONDS = 60.0  # Seconds that commits wait for readers, and readers for commits
_NOTE_SECONDS = 0.5  # Maximum seconds between taking the lock and noting its holder
_MOST_SENTENCE = 10_000  # Maximum length in characters of a stored error sentence
_PATH_LETTERS = b"abcdefghijklmnopqrstuvwxyz0123456789.-/"
# Texts that a list of paths, one per line, must not contain
_NO_PATH = ("//", "/.", "\n.", "\n/", "/\n", "\n\n")

_SCHEMA = (
    "CREATE TABLE texts (kind TEXT, name TEXT, text TEXT, digest BLOB, PRIMARY KEY (kind, name))",
    "CREATE TABLE cells (place INTEGER PRIMARY KEY, path TEXT UNIQUE, digest BLOB)",
    "CREATE TABLE results (place INTEGER PRIMARY KEY, payload BLOB)",
    """CREATE TABLE tasks (path TEXT, run TEXT, first INTEGER, blocks INTEGER, digest BLOB,
    payload BLOB, PRIMARY KEY (path, run, first, blocks))""",
    # The notes are the study's description and its tally. This table has a second copy of them.
    # Recovery is impossible without notes, so their second copy is on another page of the file
    "CREATE TABLE notes (kind TEXT, name TEXT, text TEXT, digest BLOB, PRIMARY KEY (kind, name))",
)
# Tables for rows that are copied from a damaged file. These tables have no primary keys:
# if pages of the file contradict each other, several rows can have the same key
_COPIED = (
    "CREATE TABLE cells (place INTEGER, path TEXT, digest BLOB)",
    "CREATE TABLE results (place INTEGER, payload BLOB)",
    "CREATE TABLE texts (kind TEXT, name TEXT, text TEXT, digest BLOB)",
    (
        "CREATE TABLE tasks (path TEXT, run TEXT, first INTEGER, blocks INTEGER, digest BLOB, "
        "payload BLOB)"
    ),
    "CREATE VIEW notes AS SELECT * FROM texts",
    "CREATE INDEX cells_place ON cells (place)",
    "CREATE INDEX results_place ON results (place)",
    "CREATE INDEX texts_name ON texts (kind, name)",
)
_PUT_COPY = {
    3: "INSERT INTO cells VALUES (?, ?, ?)",
    2: "INSERT INTO results VALUES (?, ?)",
    4: "INSERT INTO texts VALUES (?, ?, ?, ?)",
    6: "INSERT INTO tasks VALUES (?, ?, ?, ?, ?, ?)",
}
"""Insert statements by number of columns, because tables have different numbers of columns."""

_PUT_TEXT = "INSERT OR REPLACE INTO {} VALUES (?, ?, ?, ?)"
_PUT_CELL = "INSERT INTO cells VALUES (?, ?, NULL)"
_PUT_RESULT = "INSERT OR REPLACE INTO results SELECT place, ? FROM cells WHERE path = ?"
_PUT_DIGEST = "UPDATE cells SET digest = ? WHERE path = ?"
_PUT_TASK = "INSERT OR REPLACE INTO tasks VALUES (?, ?, ?, ?, ?, ?)"
_RESULT = "SELECT path, digest, payload FROM cells LEFT JOIN results USING (place)"
_PAYLOADS = "SELECT payload FROM results WHERE place = ?"
_TEXTS = "SELECT name, text, digest FROM {} WHERE kind = ?"
# Names of two tables; all notes are stored twice, once in each table
_NOTED = ("texts", "notes")
_ONE_TASK = "SELECT * FROM tasks WHERE path = ? AND run = ? AND first = ? AND blocks = ?"

# SQLite errors that do not concern the contents of the file, by code, in words
_NOT_DAMAGE = {
    3: "permission is denied",
    5: "another process is using it",
    6: "another process is using it",
    7: "no memory is left",
    8: "permission is denied",
    9: "the reading was interrupted",
    10: "the device or its file system failed",
    13: "the disk is full",
    14: "it cannot be opened",
    15: "its file system has no locks",
}
_BAD_PAGES = "pages of the file are damaged or missing"
# A SQLite journal that names another file ends in these bytes
_SUPER_JOURNAL = bytes.fromhex("d9d505f920a163d7")

_DAMAGE = "its digest does not match"
_REMEDY = "`mcspectra run` with --resume keeps the sound parts and computes the rest again"
_REMEDY_NEW = "nothing is finished yet: free some space or give another --out, and run it again"
_RENEW = (
    "restore the old files, give another --out, or use --resume --retry to compute the affected "
    "results again"
)

_Step: TypeAlias = tuple[str, tuple[Any, ...]]
"""An SQL statement and its values."""

_Note = TypeVar("_Note", bound=msgspec.Struct)

# Types of fields of notes, checked when a note is read, because a forged note may hold anything
_Count: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
_Time: TypeAlias = Annotated[
    str, msgspec.Meta(pattern=r"\A[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}\+00:00\Z")
]
_Digest: TypeAlias = Annotated[str, msgspec.Meta(pattern=r"\A[0-9a-f]{64}\Z")]


class StudyNote(msgspec.Struct, frozen=True, kw_only=True):
    """Identification of the study that a ledger holds.

    Attributes
    ----------
    title, seed
        Title and seed of the study.
    config
        The study as JSON without its time limit. Empty after opening a ledger; see `Ledger.config`.
    study_hash
        SHA-256 of the study's canonical JSON, without keys that do not affect results.
    versions
        Versions of this package and of the packages that results depend on:
        `mcspectra.core.results.package_versions`.
    inputs
        SHA-256 of the files that the results depend on, by name.
    """

    title: str
    seed: int
    config: str
    study_hash: str
    versions: dict[str, str]
    inputs: dict[str, str]

    @staticmethod
    def of(config: StudyConfig, inputs: Mapping[str, str]) -> StudyNote:
        """Return a description of a study that this process computes, without its time limit.

        The time limit does not affect results, so the stored files do not depend on it either.
        """
        config = msgspec.structs.replace(config, time_limit=None)
        hashed = msgspec.json.encode(config, order="sorted")
        return StudyNote(
            title=config.title,
            seed=config.seed,
            config=msgspec.json.encode(plain_study(config)).decode(),
            study_hash=hashlib.sha256(hashed).hexdigest(),
            versions=package_versions(),
            inputs=dict(inputs),
        )


class Holder(msgspec.Struct, frozen=True):
    """Process that writes into a folder, or was killed while writing: host, id and start."""

    host: str
    pid: _Count
    since: _Time

    @property
    def in_words(self) -> str:
        """Description of the process in messages: ``process 12 on host 'a' since …``."""
        return f"process {self.pid} on host {shown(self.host)} since {self.since}"


class StudyTally(msgspec.Struct, frozen=True, kw_only=True):
    """Values that change with every commit.

    Attributes
    ----------
    done, size, digest
        Number of finished cells, size of their results in bytes, and bitwise XOR of their digests.
    started, finished
        Time when the study began and when its last cell finished: UTC, ISO 8601.
    hosts
        Hosts that began or resumed the study, or computed for it.
    holder
        Process that is writing; None after it has ended normally.
    """

    done: _Count = 0
    size: _Count = 0
    digest: _Digest = f"{0:064x}"
    started: _Time | None = None
    finished: _Time | None = None
    hosts: tuple[str, ...] = ()
    holder: Holder | None = None

    def plus(self, digest: bytes, size: int) -> StudyTally:
        """Return the tally (count, size and digest of finished cells) with one more cell added."""
        either = int(self.digest, 16) ^ int.from_bytes(digest, "big")
        return msgspec.structs.replace(
            self, done=self.done + 1, size=self.size + size, digest=f"{either:064x}"
        )


class _Header(msgspec.Struct, frozen=True, kw_only=True):
    """Note in the ledger with the study, the number of cells, and a digest of all paths.

    Runs of the study never change this note.
    """

    study: StudyNote
    # The number of cells is limited, because verifying a damaged file may list all cells
    cells: Annotated[int, msgspec.Meta(ge=0, le=2**26)]
    plan: str


class _Change(NamedTuple):
    """SQL statements that write a cell, and the cell's new state.

    The state is an error sentence, or the digest and size of a result.
    """

    path: str
    steps: Iterable[_Step]
    digest: bytes | None = None
    size: int = 0
    failure: str | None = None


class Survey(NamedTuple):
    """Sound and damaged parts of a ledger; a resumed run continues from the sound parts.

    Attributes
    ----------
    done
        Paths of finished cells, in order.
    failed
        Error sentences of failed cells, by path.
    recorded
        Number of tasks of unfinished cells that have a recorded result.
    missing
        Paths of cells that are neither finished, failed nor damaged.
    damaged
        Descriptions of damage, by path of a cell, key of a task, or name of a part of the file.
    """

    done: tuple[str, ...]
    failed: dict[str, str]
    recorded: int
    missing: tuple[str, ...]
    damaged: dict[str, str]


class _Damaged(StoreError):
    """Error about a damaged file, with the reason in a few words."""

    def __init__(self, sentence: str, reason: str = "") -> None:
        super().__init__(sentence)
        self.reason = reason or sentence


@final
class Ledger:
    """Database of a study, opened by `create`, `resume` or `read`; it is a context manager.

    A background thread commits the pending writes once a second; `close` commits the rest.

    Attributes
    ----------
    folder
        Folder of the ledger.
    tally
        Number and digest of the finished cells at the last commit, with times and hosts.
    damaged
        Descriptions of damage, by path of a cell, key of a task, or name of a part of the file.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.tally = StudyTally()
        self.damaged: dict[str, str] = {}
        self._file = folder / LEDGER_NAME
        self._lock: sqlite3.Connection | None = None
        self._connection: sqlite3.Connection | None = None
        self._guard = threading.RLock()
        self._pending: list[_Change] = []  # Changes that are not committed
        self._waiting = 0  # Bytes of the pending changes
        self._closed = threading.Event()
        self._broken: StoreError | None = None  # Error of a commit in the background thread
        self._holds = False
        self._salvaged = False  # Whether the rows were read page by page

    @staticmethod
    def create(folder: Path, study: StudyNote, paths: Sequence[str]) -> Ledger:
        """Begin the ledger of a study in a folder, which is created if necessary.

        Parameters
        ----------
        paths
            Paths of all cells, in order.

        Raises
        ------
        StoreError
            If the folder already has results, contains symbolic links, or cannot be written.
            If another process writes into the folder. A later write error is a StorageError.
        """
        with _given_free_if_it_fails(Ledger(folder)) as ledger:
            ledger._begin(study, paths, None)
        return ledger

    @staticmethod
    def resume(
        folder: Path, study: StudyNote, paths: Sequence[str], *, outdated: Collection[str] = ()
    ) -> Ledger:
        """Verify and continue the ledger of a folder; begin one if there is none.

        Parameters
        ----------
        outdated
            Paths of cells to compute again because their input files changed.
            If no paths are given, an input file that has changed is an error.

        Raises
        ------
        StoreError
            For the same reasons as in `create`.
            If the ledger belongs to another study, format or version of this package.
            If the ledger is too damaged to identify its study.

        Warns
        -----
        OtherVersionsWarning
            If the ledger was begun with other versions of packages that results depend on.
        """
        with _given_free_if_it_fails(Ledger(folder)) as ledger:
            ledger._begin(study, paths, outdated)
        return ledger

    @staticmethod
    def read(folder: str | Path, *, salvage: bool = False) -> Ledger:
        """Open the ledger of a folder, which may be in use, without changing anything.

        Parameters
        ----------
        salvage
            For `verify`: check the file for damage, and read a damaged file page by page.

        Raises
        ------
        StoreError
            If there is no ledger, or it has another format, or its study cannot be identified.
            Without `salvage`, this error is also raised for any other damage.
        """
        with _given_free_if_it_fails(Ledger(Path(folder))) as ledger:
            ledger._open(salvage=salvage)
        return ledger

    @property
    def study(self) -> StudyNote:
        """The description of the study from the start of the ledger; `config` has the full text."""
        return self._header.study

    @property
    def config(self) -> str:
        """The whole study as JSON text, which takes several megabytes for a large study.

        Raises
        ------
        StoreError
            If the text is damaged.
        """
        for _, text in self._texts("config"):
            if text is not None:
                return text
        raise _Damaged(f"The study in {str(self._file)!r} is damaged: {_DAMAGE}; {_REMEDY}.")

    @property
    def paths(self) -> Sequence[str]:
        """Paths of all cells of the study, in order."""
        return self._listing[0]

    @property
    def done(self) -> KeysView[str]:
        """Paths of the finished cells: cells of earlier runs in order, then new cells."""
        return self._listing[1].keys()

    def failures(self) -> dict[str, str]:
        """Return the error sentences of failed cells by path, in order."""
        self.commit()
        found = {}
        for path, text in self._texts("failure"):
            if text is None:
                self.damaged[f"failure of {path}"] = _DAMAGE
            else:
                found[path] = text
        return {path: found[path] for path in self.paths if path in found} if found else {}

    def tasks(self, path: str) -> list[tuple[str, Chunk]]:
        """Return which tasks of a cell have a result in the ledger.

        A task adds up a range of blocks of realizations; its sum over all blocks has a name.
        """
        with self._guard:
            rows = self._rows("SELECT run, first, blocks FROM tasks WHERE path = ?", (path,))
        return [(run, (first, blocks)) for run, first, blocks in rows]

    @property
    def recorded(self) -> int:
        """Number of tasks of unfinished cells that have a recorded result."""
        self.commit()
        ((count,),) = self._rows("SELECT count(*) FROM tasks")
        return int(count)

    def state(self, path: str, run: str, chunk: Chunk) -> bytes | None:
        """Return the recorded state of a task, or None if it was never recorded or is `damaged`."""
        with self._guard:
            self.commit()
            for row in self._rows(_ONE_TASK, (path, run, *chunk)):
                if self._is_sound("task", row[:4], row[5], row[4]):
                    return bytes(row[5])
            if (run, chunk) in self.tasks(path):
                self.damaged[_task_name(path, run, *chunk)] = _DAMAGE
            return None

    def result(self, path: str) -> bytes:
        """Return the result of a finished cell.

        Raises
        ------
        StoreError
            If the study has no such cell, it is not finished, or its result is damaged.
        """
        self.commit()
        rows = self._rows(f"{_RESULT} WHERE path = ?", (path,))
        if not rows:
            raise StoreError(f"The study in {str(self.folder)!r} has no cell {path!r}.")
        _, digest, payload = rows[0]
        if digest is None:
            reason = self.failures().get(path, "it is not finished.")
            raise StoreError(f"{str(self.folder)!r} has no result of {path}: {reason}")
        if not self._is_sound("result", (path,), payload, digest):
            raise StoreError(
                f"The cell {path} in {str(self._file)!r} is damaged: {_DAMAGE}; {_REMEDY}."
            )
        return bytes(payload)

    def scalars(self) -> dict[str, dict[str, float]]:
        """Return the scalars of all finished cells by path, in order.

        Raises
        ------
        StoreError
            If the scalars of a cell are damaged.
        """
        with self._guard:
            self.commit()
            done = tuple(self.done)  # List the finished cells before a commit adds more
            texts = dict(self._texts("scalars"))
        found: dict[str, dict[str, float]] = {}
        for path in done:
            with contextlib.suppress(
                ValueError, RecursionError
            ):  # An untrusted text may have any content
                given = json.loads(texts.get(path) or "null")
                found[path] = msgspec.convert(given, dict[str, float | int])
            if path not in found:
                raise StoreError(
                    f"The scalars of {path} in {str(self._file)!r} are damaged: {_DAMAGE}; "
                    f"{_REMEDY}."
                )
        return found

    def record(self, path: str, run: str, chunk: Chunk, payload: bytes, host: str = "") -> None:
        """Record the state of a task of an unfinished cell.

        Parameters
        ----------
        run, chunk
            A task adds up some blocks of realizations, which are a part of a longer sum.
            `run` names the sum over all blocks, and `chunk` is the range of blocks of this task.
        host
            Host that computed the task.

        Raises
        ------
        StorageError
            If pending changes cannot be written. All methods that write may raise this error.
        """
        values = (path, run, *chunk)
        row = (*values, self._digest("task", values, payload), payload)
        with self._guard:
            if host and host not in self.tally.hosts:
                self.tally = msgspec.structs.replace(self.tally, hosts=(*self.tally.hosts, host))
            self._tell(_Change(path, ((_PUT_TASK, row),), size=len(payload)))

    def finish(
        self, path: str, payload: bytes, scalars: Mapping[str, float] = MappingProxyType({})
    ) -> None:
        """Store the result of a cell, and drop its task states in the same transaction.

        Parameters
        ----------
        payload, scalars
            The result as bytes, and its scalar values by name.

        Raises
        ------
        StoreError
            If the cell is already finished.
        """
        text, digest = json.dumps(dict(scalars)), self._digest("result", (path,), payload)
        with self._guard:
            if path in self.done:
                raise StoreError(f"The cell {path} in {str(self.folder)!r} is finished already.")
            self._tell(self._result(path, payload, digest, text))
            self._listing[1][path] = None

    def fail(self, path: str, sentence: str) -> None:
        """Store the reason why a cell failed."""
        text = sentence[:_MOST_SENTENCE].encode("utf-8", "replace").decode()
        with self._guard:
            self._tell(_Change(path, [self._text("failure", path, text)]))

    def forget(self, paths: Iterable[str]) -> None:
        """Drop failures and task states of cells so that they are tried again."""
        with self._guard:
            for path in paths:
                self._tell(_Change(path, _forgetting(path)))
            self.commit()  # Later reads must not find the results of dropped tasks

    def commit(self) -> None:
        """Write all pending changes, or none of them."""
        with self._guard:
            if self._broken is not None:
                raise self._broken
            if self._pending:
                tally = self._write(self._pending, self.tally)
                # A signal cannot interrupt these three assignments, because no call is between them
                self.tally, self._pending, self._waiting = tally, [], 0

    def refusal(self, study: StudyNote, paths: Sequence[str]) -> str | None:
        """Return why this ledger cannot continue a study with these cells, or None if it can."""
        if (study.study_hash, _plan_digest(paths)) != (self.study.study_hash, self._header.plan):
            return "belongs to another study or another version of this one; give another --out"
        key = "version_mcspectra"
        old, new = self.study.versions.get(key, study.versions[key]), study.versions[key]
        if old != new:
            return (
                f"is from mcspectra {printable(old, QUOTED)}, but this is {new}, whose numbers may "
                "differ: resume it with the version that began it, or give another --out"
            )
        return None

    def verify(self, paths: Sequence[str] | None = None) -> Survey:
        """Read all rows of the ledger, and return its sound and its damaged parts.

        Parameters
        ----------
        paths
            Paths of all cells of the study; by default the paths in the ledger.
            A list that does not have the digest in the ledger is ignored.
        """
        self.commit()
        if paths is None or _plan_digest(paths) != self._header.plan:
            paths = self._listed_anyway() if self._salvaged else self.paths
        elif not self._salvaged:
            _ = self.paths  # Compare the list of paths with its stored digest
        return self._surveyed(paths)

    def close(self) -> None:
        """Commit, note the end of this process, and release the lock; later calls do nothing."""
        self._closed.set()
        try:
            if self._holds:
                self._holds = False
                self.commit()
                self._write((), msgspec.structs.replace(self.tally, holder=None))
        finally:
            with self._guard, contextlib.suppress(sqlite3.Error):
                for connection in (self._connection, self._lock):
                    if connection is not None:
                        connection.close()
                self._connection = self._lock = None

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        # The exception that ended the run matters more than an error during closing
        with contextlib.nullcontext() if kind is None else contextlib.suppress(StoreError):
            self.close()

    def _tell(self, change: _Change) -> None:
        if self._broken is not None:
            raise self._broken
        self._pending.append(change)
        self._waiting += change.size
        if self._waiting > _COMMIT_BYTES:
            self.commit()

    def _result(self, path: str, payload: bytes, digest: bytes, text: str) -> _Change:
        """Return a change that stores a cell's result and scalars and drops its task states."""
        put = (
            (_PUT_RESULT, (payload, path)),
            (_PUT_DIGEST, (digest, path)),
            self._text("scalars", path, text),
        )
        return _Change(path, (*put, *_forgetting(path)), digest, len(payload))

    def _begin(
        self, study: StudyNote, paths: Sequence[str], outdated: Collection[str] | None
    ) -> None:
        """Take the lock and begin to write. If `outdated` is None, the ledger must be new."""
        self._lock = _locked(self.folder)
        exists, old = self._file.exists(), (self.folder / STORE_NAME).exists()
        if (exists or old) and outdated is None:
            raise StoreError(
                f"{str(self.folder)!r} already holds results; "
                "give another --out, or --resume to continue them."
            )
        if exists:
            self._continue(study, paths, outdated or ())
        elif old:
            raise StoreError(
                f"{str(self.folder)!r} holds results without {LEDGER_NAME}: only the earlier "
                "version that wrote them can continue them; give another --out."
            )
        else:
            about = msgspec.structs.replace(study, config="")
            self._header = _Header(study=about, cells=len(paths), plan=_plan_digest(paths))
            self.tally = StudyTally(started=_now())
            self._replace(study.config, paths, ())
            # Keep the paths, so that up to a million of them need not be read from the file
            self.__dict__["_listing"] = list(paths), {}

        # Note this process as the writer, and commit pending changes once a second
        host = socket.gethostname()
        hosts = tuple(dict.fromkeys((*self.tally.hosts, host)))
        holder = Holder(host, os.getpid(), _now())
        self.tally = msgspec.structs.replace(self.tally, hosts=hosts, holder=holder)
        self.tally = self._write((), self.tally)
        self._holds = True
        threading.Thread(target=self._commit_in_time, daemon=True).start()

    def _continue(self, study: StudyNote, paths: Sequence[str], outdated: Collection[str]) -> None:
        """Continue the ledger of this study without its damaged or outdated parts."""
        self._open(salvage=True)
        reason = self.refusal(study, paths)
        if reason is not None:
            raise StoreError(f"{str(self._file)!r} {reason}.")
        whose = f"The results in {str(self.folder)!r} are"
        before = self.study.versions
        others = {
            name.removeprefix("version_"): (before[name], version)
            for name, version in study.versions.items()
            if before.get(name, version) != version
        }
        if others:
            changes = ", ".join(f"{name} {old} (now {new})" for name, (old, new) in others.items())
            warn(
                f"{whose} from {changes}: the last bits of new results may differ from "
                "those of an uninterrupted run.",
                OtherVersionsWarning,
            )
        if not outdated:
            check_inputs(self.study.inputs, study.inputs, whose, _RENEW)

        self.verify(paths)
        if self.damaged or outdated:
            changed = msgspec.structs.replace(self.study, inputs=study.inputs)
            self._header = msgspec.structs.replace(self._header, study=changed)
            kept = (change for change in self._sound(paths) if change.path not in outdated)
            self._replace(study.config, paths, kept)

    def _commit_in_time(self) -> None:
        while not self._closed.wait(_COMMIT_SECONDS):
            try:
                self.commit()
            except StoreError as error:
                self._broken = error
                return

    def _write(
        self, changes: Iterable[_Change], tally: StudyTally, into: sqlite3.Connection | None = None
    ) -> StudyTally:
        """Apply changes together with the new tally in one transaction."""
        connection = into or self._opened
        with _writing(self._file):
            try:
                connection.execute("BEGIN IMMEDIATE")
                for change in changes:
                    for statement, values in change.steps:
                        connection.execute(statement, values)
                    if change.digest is not None:
                        tally = tally.plus(change.digest, change.size)
                if tally.done == self._header.cells and tally.finished is None:
                    tally = msgspec.structs.replace(tally, finished=_now())
                note = msgspec.json.encode(tally).decode()
                for table in _NOTED:
                    connection.execute(*self._text("note", "tally", note, table))
                connection.execute("COMMIT")
            except BaseException:
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
                raise
        return tally

    def _replace(self, config: str, paths: Sequence[str], changes: Iterable[_Change]) -> None:
        """Write a new ledger with these changes next to the old one, then replace the old one."""
        partial = self.folder / f".{LEDGER_NAME}.partial"
        tally = msgspec.structs.replace(
            self.tally, done=0, size=0, digest=StudyTally().digest, finished=None
        )
        tables = ((statement, ()) for statement in _SCHEMA)
        cells = ((_PUT_CELL, each) for each in enumerate(paths))
        header = msgspec.json.encode(self._header).decode()
        notes = [self._text("note", "study", header, table) for table in _NOTED]
        notes.append(self._text("config", "", config))
        first = _Change("", itertools.chain(tables, cells, notes))
        with _writing(self._file):
            _remove_partial(partial)  # A killed run leaves this partial file
            try:
                with contextlib.closing(_connected(partial, "rwc")) as new:
                    new.execute(f"PRAGMA page_size = {_PAGE}")
                    new.execute(f"PRAGMA user_version = {FORMAT}")
                    self.tally = self._write(itertools.chain([first], changes), tally, new)
                if self._connection is not None:
                    self._connection.close()
                self._file.with_name(f"{LEDGER_NAME}-journal").unlink(missing_ok=True)
                partial.replace(self._file)
            except BaseException:
                _remove_partial(partial)
                raise
            self._connection, self._salvaged = _connected(self._file, "rw"), False
        self.__dict__.pop("_listing", None)

    def _open(self, *, salvage: bool = False) -> None:
        """Open the file and identify its study; with `salvage`, open a damaged file as well."""
        _refuse_strangers(self._file)
        if not self._file.is_file():
            raise StoreError(f"There are no results in {shown(str(self.folder))}.")
        broken = ""
        try:
            self._connect(thoroughly=salvage)
        except _Damaged as error:
            broken = error.reason
            self._read_pages(broken)
        header = self._note("study", _Header)
        if header is None:
            raise StoreError(
                f"{str(self._file)!r} does not identify its study: it is damaged, or it is not a "
                "ledger; give another folder."
            )
        if broken and not salvage:
            raise StoreError(f"{str(self._file)!r} is damaged: {broken}; {_REMEDY}.")
        self._header = header
        self.tally = self._noted_tally()

    def _connect(self, *, thoroughly: bool) -> None:
        """Open the file with SQLite.

        Raises
        ------
        _Damaged
            If it is not a ledger's database, or cannot be read completely.
        """
        # If the header asks for a write-ahead log, SQLite would create two further files
        with _reading(self._file), self._file.open("rb") as stream:
            head = stream.read(20)
        if head[:16] != b"SQLite format 3\0" or head[18:] != b"\1\1":
            raise _Damaged("its first page is not that of a ledger")
        try:
            # Without write permission, SQLite opens the file for reading only.
            # After a crash of the writer, SQLite rolls back the last transaction
            self._connection = _connected(self._file, "rw")
            if self._lock is None:
                self._connection.execute("PRAGMA query_only = ON")
        except sqlite3.Error as error:
            raise self._unreadable(error) from None
        ((version,),) = self._rows("PRAGMA user_version")
        if version not in (0, FORMAT):
            raise StoreError(
                f"{str(self._file)!r} has store format {version}, but this version reads "
                f"{FORMAT}: export it with the version that wrote it, or run the study again with "
                "another --out."
            )
        schema = self._rows("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY rowid")
        if tuple(text for (text,) in schema) != _SCHEMA:
            raise _Damaged("its tables are not those of a ledger")
        if thoroughly:
            ((first, *_), *_) = self._rows("PRAGMA integrity_check(1)")
            if first != "ok":
                raise _Damaged(_BAD_PAGES)

    def _read_pages(self, reason: str) -> None:
        """Copy the readable rows of a damaged file, page by page, and use the copy."""
        self.damaged["file"] = reason
        self._salvaged = True
        if self._connection is not None:
            self._connection.close()
        # A private file, which is deleted when it is closed
        self._connection = copy = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        try:
            with contextlib.closing(Leaves(self._file, _PAGE)) as leaves:
                copy.execute("BEGIN")
                for statement in _COPIED:
                    copy.execute(statement)
                # First read pages that SQLite uses, then pages that it has freed.
                # Freed pages may hold task states and failures that a run deleted: ignore them
                for wanted in (True, False):
                    for used, rowid, values in leaves.rows():
                        columns = len(values)
                        deleted = not used and (columns == 6 or values[:1] == ("failure",))
                        if used is wanted and not deleted and columns in _PUT_COPY:
                            row = (rowid, *values[1:]) if columns in (2, 3) else values
                            copy.execute(_PUT_COPY[columns], row)
                copy.execute("COMMIT")
        except (OSError, sqlite3.Error) as error:
            reason = _not_damage(error) or str(error)
            raise StoreError(f"{str(self._file)!r} cannot be read: {reason}.") from None

    def _note(self, name: str, kind: type[_Note]) -> _Note | None:
        """Return the note with this name from either of two tables; None if both are damaged."""
        for table in _NOTED:
            rows: list[tuple[Any, ...]] = []
            with contextlib.suppress(_Damaged):
                rows = self._rows(f"{_TEXTS.format(table)} AND name = ?", ("note", name))
            for _, text, digest in rows:
                with contextlib.suppress(
                    msgspec.MsgspecError, TypeError, AttributeError, ValueError, RecursionError
                ):
                    note = msgspec.json.decode(text, type=kind)
                    study = note.study if isinstance(note, _Header) else self.study
                    if digest == _digest(study, "note", (name,), text.encode()):
                        return note
        return None

    def _noted_tally(self) -> StudyTally:
        tally = self._note("tally", StudyTally)
        if tally is None:
            self.damaged["tally"] = _DAMAGE
        return tally or StudyTally()

    @functools.cached_property
    def _listing(self) -> tuple[list[str], dict[str, None]]:
        """Paths of all cells, and of finished cells, in order; checksums detect missing rows."""
        paths: list[str] = []
        done: dict[str, None] = {}
        digests, found = bytearray(), ("", "")
        with self._guard:
            # Read the tally and the cells in one transaction, without a commit between them
            self._rows("BEGIN")
            try:
                self.tally = self._noted_tally()
                for path, digest in self._each("SELECT path, digest FROM cells ORDER BY place"):
                    paths.append(path)
                    if digest is not None:
                        done[path] = None
                        digests += digest
                either = np.bitwise_xor.reduce(
                    np.frombuffer(digests, np.uint64).reshape(len(done), 4), axis=0
                )
                found = either.tobytes().hex(), _plan_digest(paths)
            except (TypeError, ValueError):  # A run writes paths as text and digests as bytes
                pass
            finally:
                self._opened.rollback()
        if not are_paths(paths) or found != (self.tally.digest, self._header.plan):
            self.damaged["list of cells"] = "it was changed after it was written"
        return paths, done

    def _listed_anyway(self) -> list[str]:
        """Return the paths of all cells in the order of the study.

        An unreadable path is replaced by ``cell PLACE`` with the number of the cell.
        """
        known = dict(self._each("SELECT place, path FROM cells"))
        return [str(known.get(place, f"cell {place}")) for place in range(self._header.cells)]

    def _surveyed(self, paths: Sequence[str]) -> Survey:
        """Read all rows of the ledger, and list rows with a wrong digest in `damaged`."""
        tally, before, recorded = StudyTally(), len(self.damaged), 0
        done, failed = set[str](), dict[str, str]()
        for change in self._sound(paths):
            if change.digest is not None:
                tally = tally.plus(change.digest, change.size)
                done.add(change.path)
            elif change.failure is not None:
                failed[change.path] = change.failure
            else:
                recorded += 1
        # Compare the tally with the finished cells that were found.
        # Readers skip this test, because they checked the tally when they read the list of cells.
        # After that check, a writer may have finished more cells and changed the tally
        still = self._lock is not None or self._salvaged
        if still and len(self.damaged) == before and tally.digest != self.tally.digest:
            self.damaged["list of cells"] = "finished cells are missing in it"
        known = {*done, *failed, *self.damaged}
        missing = tuple(path for path in paths if path not in known)
        return Survey(
            tuple(path for path in paths if path in done),
            {path: failed[path] for path in paths if path in failed},
            recorded,
            missing,
            dict(self.damaged),
        )

    def _sound(self, paths: Sequence[str]) -> Iterator[_Change]:
        """Yield, for each intact row, the change that would write this row again.

        All other rows are listed in `damaged`.
        This method alone decides which parts of a damaged ledger are kept.
        """
        try:
            _ = self.config
        except _Damaged:
            self.damaged["text of the study"] = _DAMAGE
        for table in _NOTED:
            for name in ("study", "tally"):
                if not any(text for _, text in self._texts("note", name, table)):
                    self.damaged[f"note of the {name}"] = _DAMAGE

        # Yield results with right digests. Results whose digests were lost may also be right.
        # Results without digests are tested by the tally, which holds the XOR of all digests
        left, unproven = int(self.tally.digest, 16), list[tuple[str, int, bytes]]()
        made = 0
        for place, path in enumerate(paths):
            cells, results = self._cell_rows(place)
            digests = [digest for found, digest in cells if found == path]
            payloads = [payload for (payload,) in results if isinstance(payload, bytes)]
            found = [(each, self._digest("result", (path,), each)) for each in payloads]
            sound = [each for each in found if each[1] in digests]
            if sound:
                left ^= int.from_bytes(sound[0][1], "big")
                change, again = self._with_scalars(path, *sound[0])
                made += again
                if change is not None:
                    yield change
            elif found and not any(digests):
                left ^= int.from_bytes(found[0][1], "big")
                unproven.append((path, place, found[0][1]))
            elif any(digests):
                self.damaged[path] = _DAMAGE
            elif not digests:
                self.damaged[path] = "its row cannot be read"
        for path, place, digest in unproven:
            change = None
            # If all results together have the digest in the tally, every result is right
            if left == 0:
                payloads = [payload for (payload,) in self._rows(_PAYLOADS, (place,))]
                sound = [
                    (p, digest) for p in payloads if self._digest("result", (path,), p) == digest
                ]
                change, again = self._with_scalars(path, *sound[0])
                made += again
            if change is None:
                self.damaged[path] = "its row cannot be read"
            else:
                self.damaged["list of cells"] = "some of its rows cannot be read"
                yield change
        if made:
            self.damaged["scalars"] = f"of {made} cells, recomputed from their results"

        # Yield the rows of task states, and the sentences of failed cells
        states = set[tuple[Any, ...]]()
        try:
            for (row,) in self._rows("SELECT rowid FROM tasks"):
                for task in self._rows("SELECT * FROM tasks WHERE rowid = ?", (row,)):
                    *values, digest, payload = task
                    if not self._is_sound("task", tuple(values), payload, digest):
                        self.damaged[_task_name(*values)] = _DAMAGE
                    elif tuple(values) not in states:
                        states.add(tuple(values))
                        yield _Change(values[0], ((_PUT_TASK, task),))
            for path, sentence in self._texts("failure"):
                if sentence is None:
                    self.damaged[f"failure of {path}"] = _DAMAGE
                else:
                    yield _Change(path, [self._text("failure", path, sentence)], failure=sentence)
        except _Damaged as error:
            self.damaged["recorded tasks and failures"] = error.reason

    def _cell_rows(self, place: int) -> tuple[list[tuple[Any, ...]], list[tuple[Any, ...]]]:
        """Return a cell's rows of tables ``cells`` and ``results``; none if a row is damaged."""
        with self._guard, contextlib.suppress(_Damaged):
            # Read both tables in one transaction: a commit between them would look like damage
            self._rows("BEGIN")
            try:
                cells = self._rows("SELECT path, digest FROM cells WHERE place = ?", (place,))
                return cells, self._rows(_PAYLOADS, (place,))
            finally:
                self._opened.rollback()
        return [], []

    def _with_scalars(
        self, path: str, payload: bytes, digest: bytes
    ) -> tuple[_Change | None, bool]:
        """Return a sound result with its scalars; also whether damaged scalars were recomputed."""
        text = None
        with contextlib.suppress(_Damaged):
            text = next((each for _, each in self._texts("scalars", path) if each), None)
        if text is not None:
            return self._result(path, payload, digest, text), False
        try:
            import xarray as xr

            text = json.dumps(scalars_of(unpack(xr.Dataset, payload)))
        except (FileFormatError, ValueError, TypeError):
            self.damaged[path] = _DAMAGE
            return None, False
        return self._result(path, payload, digest, text), True

    @property
    def _opened(self) -> sqlite3.Connection:
        if self._connection is None:
            raise StoreError(f"The ledger {str(self._file)!r} is closed.")
        return self._connection

    def _rows(self, statement: str, values: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
        """Return all rows that an SQL statement selects."""
        return list(self._each(statement, values))

    def _each(self, statement: str, values: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a statement one by one, because there may be a million.

        Raises
        ------
        StoreError
            If the file cannot be read, or is damaged.
        """
        try:
            yield from self._opened.execute(statement, values)
        except (sqlite3.Error, UnicodeError, MemoryError, OverflowError) as error:
            raise self._unreadable(error) from None

    def _unreadable(self, error: BaseException) -> StoreError:
        if reason := _not_damage(error):
            return StoreError(f"{str(self._file)!r} cannot be read: {reason}.")
        return _Damaged(f"{str(self._file)!r} is damaged: {_BAD_PAGES}; {_REMEDY}.", _BAD_PAGES)

    def _text(self, kind: str, name: str, text: str, table: str = "texts") -> _Step:
        """Return the statement that stores a text with its digest."""
        row = kind, name, text, self._digest(kind, (name,), text.encode())
        return _PUT_TEXT.format(table), row

    def _texts(
        self, kind: str, name: str | None = None, table: str = "texts"
    ) -> Iterator[tuple[str, str | None]]:
        """Yield name and text of rows with this `kind`; the text is None if it is damaged."""
        query = _TEXTS.format(table)
        chosen = (f"{query} AND name = ?", (kind, name)) if name else (query, (kind,))
        for found, text, digest in self._each(*chosen):
            content = text.encode() if isinstance(text, str) else None
            yield found, text if self._is_sound(kind, (found,), content, digest) else None

    def _digest(self, kind: str, key: tuple[Any, ...], content: bytes) -> bytes:
        return _digest(self.study, kind, key, content)

    def _is_sound(self, kind: str, key: tuple[Any, ...], content: Any, digest: Any) -> bool:
        return isinstance(content, bytes) and self._digest(kind, key, content) == digest


def _not_damage(error: BaseException) -> str:
    """Return why a file cannot be read or written; the text is empty if contents are damaged."""
    if isinstance(error, MemoryError):
        return _NOT_DAMAGE[7]
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return _NOT_DAMAGE.get(getattr(error, "sqlite_errorcode", 0) & 0xFF, "")


def _digest(study: StudyNote, kind: str, key: tuple[Any, ...], content: bytes) -> bytes:
    """Return the SHA-256 of a row of a study."""
    digest = hashlib.sha256(study.study_hash.encode())
    digest.update(repr((kind, *key)).encode("utf-8", "surrogatepass"))
    digest.update(content)
    return digest.digest()


def scalars_of(result: xr.Dataset) -> dict[str, float]:
    """Return the scalars of a result: its real variables without dims."""
    return {
        str(name): each.values.item()
        for name, each in result.variables.items()
        if each.ndim == 0 and each.dtype.kind in "biuf"
    }


def are_paths(paths: Iterable[str]) -> bool:
    """Whether all texts are valid paths of cells, which never leave a folder."""
    try:
        text = "\n".join(["", *paths, ""])
        strange = text.encode().translate(None, _PATH_LETTERS + b"\n")
    except (TypeError, UnicodeError):
        return False
    return not strange and not any(each in text for each in _NO_PATH)


def is_held(folder: Path) -> bool:
    """Whether a process writes into a folder and therefore holds SQLite's lock."""
    lock = folder / _LOCK_NAME
    if not lock.is_file():
        return False
    with contextlib.closing(_connected(lock, "ro", 0.0)) as connection:
        try:
            connection.execute("SELECT 1 FROM sqlite_master")
        except sqlite3.OperationalError as error:
            return error.sqlite_errorname == "SQLITE_BUSY"
        except sqlite3.DatabaseError:
            return False
    return False


def lock_damage(folder: Path) -> str | None:
    """Return why no run can lock a folder, or None if a run can lock it."""
    lock = folder / _LOCK_NAME
    if os.path.lexists(lock) and not (lock.is_file() and lock.stat().st_size == 0):
        return "it is not the empty file that a run locks; remove it while no run is active"
    return None


def _refuse_strangers(file: Path) -> None:
    """Refuse files that would make SQLite open files other than its own."""
    for end in _BESIDE:
        beside = file.with_name(file.name + end)
        refuse_links(str(beside))
        if os.path.lexists(beside) and not beside.is_file():
            raise StoreError(f"{str(beside)!r} is not a file; remove it, or use another folder.")
    journal = file.with_name(f"{file.name}-journal")
    if journal.exists():
        tail = b""  # A committing writer may delete the journal before it is opened
        with (
            _reading(journal),
            contextlib.suppress(FileNotFoundError),
            journal.open("rb") as stream,
        ):
            stream.seek(0, os.SEEK_END)
            stream.seek(max(0, stream.tell() - len(_SUPER_JOURNAL)))
            tail = stream.read()
        # SQLite would delete the file that the journal names
        if tail == _SUPER_JOURNAL:
            raise StoreError(
                f"{str(journal)!r} names another file, which a run never writes; remove it, or use "
                "another folder."
            )


@contextlib.contextmanager
def _reading(file: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise StoreError(f"{str(file)!r} cannot be read: {error.strerror}.") from None


def refuse_links(place: str) -> None:
    """Refuse a symbolic link, and a folder that contains one.

    Raises
    ------
    StoreError
        If there is a link; the message names it.
    """
    inside = (
        os.path.join(base, name)  # noqa: PTH118 - fast for many thousands of files
        for base, *names in os.walk(place)
        for name in itertools.chain(*names)
    )
    for each in itertools.chain([place], inside):
        if os.path.islink(each):  # noqa: PTH114
            raise StoreError(
                f"{each!r} is a symbolic link, which might lead to other files; results hold files "
                "only: remove it, or use another folder."
            )


@contextlib.contextmanager
def _given_free_if_it_fails(ledger: Ledger) -> Iterator[Ledger]:
    try:
        yield ledger
    except BaseException:
        ledger.close()
        raise


def _locked(folder: Path) -> sqlite3.Connection:
    """Lock a folder for writing with an exclusive transaction on an empty file."""
    with _writing(folder, StoreError, "give another --out"):
        folder.mkdir(parents=True, exist_ok=True)
        _refuse_strangers(folder / _LOCK_NAME)
        trouble = lock_damage(folder)
        if trouble is not None:
            raise StoreError(f"{str(folder / _LOCK_NAME)!r} cannot be locked: {trouble}.")
        lock = _connected(folder / _LOCK_NAME, "rwc", 1.0)  # Readers lock this file briefly
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.Error as error:
            lock.close()
            if getattr(error, "sqlite_errorname", "") != "SQLITE_BUSY":
                raise
            # Name the process that holds the lock; wait a moment until this process is noted
            end, holder = time.monotonic() + _NOTE_SECONDS, None
            while holder is None and time.monotonic() < end:
                with contextlib.suppress(StoreError), Ledger.read(folder) as ledger:
                    holder = ledger.tally.holder
                time.sleep(0.01)
            named = (
                "another process, or its file system has no locks"
                if holder is None
                else holder.in_words
            )
            raise StoreError(
                f"{str(folder)!r} is being written by {named}; wait for it, or give another --out."
            ) from None
    return lock


def _connected(file: Path, mode: str, patience: float = _BUSY_SECONDS) -> sqlite3.Connection:
    connection = sqlite3.connect(
        f"{file.absolute().as_uri()}?mode={mode}",
        uri=True,
        timeout=patience,
        isolation_level=None,
        check_same_thread=False,
    )
    # Do not run functions that the schema of a foreign file may call, and check the sizes of cells.
    # Keep changed pages in memory until the commit, so that readers are not blocked
    for pragma in ("trusted_schema = OFF", "cell_size_check = ON", "cache_spill = OFF"):
        connection.execute(f"PRAGMA {pragma}")
    return connection


@contextlib.contextmanager
def _writing(
    place: Path,
    kind: type[StoreError] = StorageError,
    remedy: str = "",
) -> Iterator[None]:
    """Turn a write error into one sentence with advice. The default advice is for a ledger."""
    try:
        yield
    except (OSError, sqlite3.Error, MemoryError) as error:
        reason = _not_damage(error) or str(error)
        if not remedy and place.exists():
            remedy = "finished work is stored, and --resume continues"
        raise kind(
            f"{str(place)!r} cannot be written: {reason}; {remedy or _REMEDY_NEW}."
        ) from None


def _remove_partial(partial: Path) -> None:
    for file in (partial, partial.with_name(f"{partial.name}-journal")):
        file.unlink(missing_ok=True)


def _forgetting(path: str) -> tuple[_Step, ...]:
    """Return statements that drop the failure and the task states of a cell."""
    tables = ("tasks WHERE path = ?", "texts WHERE kind = 'failure' AND name = ?")
    return tuple((f"DELETE FROM {each}", (path,)) for each in tables)


def _plan_digest(paths: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(paths).encode()).hexdigest()


def _task_name(path: str, run: str, first: int, blocks: int) -> str:
    return f"task {path}/{run}/{first}+{blocks}"


def _now() -> str:
    """Return the current time in UTC as ISO 8601, only for display."""
    return dt.datetime.now(dt.UTC).isoformat(timespec="seconds")
