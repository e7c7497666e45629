"""The ledger of a study: ``DIR/study.sqlite``, for one writer and any number of readers.

All that a run knows is rows of one SQLite file: which study it is, its cells in their order, states of
tasks whose cells are not finished, sentences of cells that failed, results and their scalars. SQLite gives atomic commits
and recovery after a crash; ours are the schema, the commit interval and the digests. Each row has a
SHA-256 over all that it says, which is checked whenever it is read, and the row ``tally`` has the
number of finished cells and the exclusive or of their digests, so that a row that damage makes vanish
is noticed too. Of a damaged file a resumed run keeps all rows that are sound, wherever pages can still be
read; it names the rest, and computes it again. `Ledger.verify` finds the same rows.

The file has a rollback journal, which network file systems support as well. The right to write is
SQLite's lock on ``DIR/study.lock``, an empty file: it ends with its process, whatever the ledger notes
of a holder.
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
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar, final

import msgspec
import numpy as np

from mcspectra.core.analysis import Chunk
from mcspectra.core.display import shown
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
"""Of ledgers and stores; 1 and 2 were stores of zarr that grew while their studies ran, 3 had no scalars, 4
read the text of a study at every look for a failure, 5 had its notes once."""

LEDGER_NAME = "study.sqlite"
STORE_NAME = "results.zarr"
_LOCK_NAME = "study.lock"
_BESIDE = ("", "-journal", "-wal", "-shm")  # ends of names of files that SQLite opens with one
_PAGE = 8192  # bytes

_COMMIT_SECONDS = 1.0  # so much work is lost by a kill or a power failure, at most
_COMMIT_BYTES = 2**25
_BUSY_SECONDS = 60.0  # for which commits wait for readers, and readers for commits
_NOTE_SECONDS = 0.5  # from a lock to the note of its holder, at most
_MOST_SENTENCE = 10_000  # characters
_PATH_LETTERS = b"abcdefghijklmnopqrstuvwxyz0123456789.-/"
_NO_PATH = ("//", "/.", "\n.", "\n/", "/\n", "\n\n")  # between the parts of paths, one per line

_SCHEMA = (
    "CREATE TABLE texts (kind TEXT, name TEXT, text TEXT, digest BLOB, PRIMARY KEY (kind, name))",
    "CREATE TABLE cells (place INTEGER PRIMARY KEY, path TEXT UNIQUE, digest BLOB)",
    "CREATE TABLE results (place INTEGER PRIMARY KEY, payload BLOB)",
    """CREATE TABLE tasks (path TEXT, run TEXT, first INTEGER, blocks INTEGER, digest BLOB,
    payload BLOB, PRIMARY KEY (path, run, first, blocks))""",
    # The notes again, on a page of their own: without them nothing can be recovered
    "CREATE TABLE notes (kind TEXT, name TEXT, text TEXT, digest BLOB, PRIMARY KEY (kind, name))",
)
# Rows of the pages of a damaged file, several of a key where pages contradict each other
_COPIED = (
    "CREATE TABLE cells (place INTEGER, path TEXT, digest BLOB)",
    "CREATE TABLE results (place INTEGER, payload BLOB)",
    "CREATE TABLE texts (kind TEXT, name TEXT, text TEXT, digest BLOB)",
    "CREATE TABLE tasks (path TEXT, run TEXT, first INTEGER, blocks INTEGER, digest BLOB, payload BLOB)",
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
"""Statements by the number of columns, which is different for each table."""

_PUT_TEXT = "INSERT OR REPLACE INTO {} VALUES (?, ?, ?, ?)"
_PUT_CELL = "INSERT INTO cells VALUES (?, ?, NULL)"
_PUT_RESULT = "INSERT OR REPLACE INTO results SELECT place, ? FROM cells WHERE path = ?"
_PUT_DIGEST = "UPDATE cells SET digest = ? WHERE path = ?"
_PUT_TASK = "INSERT OR REPLACE INTO tasks VALUES (?, ?, ?, ?, ?, ?)"
_RESULT = "SELECT path, digest, payload FROM cells LEFT JOIN results USING (place)"
_PAYLOADS = "SELECT payload FROM results WHERE place = ?"
_TEXTS = "SELECT name, text, digest FROM {} WHERE kind = ?"
_NOTED = ("texts", "notes")  # tables that have the notes, each
_ONE_TASK = "SELECT * FROM tasks WHERE path = ? AND run = ? AND first = ? AND blocks = ?"

# Codes of SQLite that are not about the contents of the file, in words
_NOT_DAMAGE = {
    3: "the rights do not allow it",
    5: "another process is using it",
    6: "another process is using it",
    7: "no memory is left",
    8: "the rights do not allow it",
    9: "the reading was interrupted",
    10: "the device or its file system failed",
    13: "the disk is full",
    14: "it cannot be opened",
    15: "its file system has no locks",
}
_BAD_PAGES = "pages of the file are damaged or missing"
_SUPER_JOURNAL = bytes.fromhex("d9d505f920a163d7")  # how a journal ends that names another file

_DAMAGE = "its digest does not match"
_REMEDY = "`mcspectra run` with --resume keeps what is sound and computes the rest again"
_REMEDY_NEW = "nothing is finished yet: make room or give another --out, and run it again"
_RENEW = (
    "put back what was, give another --out, or --resume --retry to compute what depends on it again"
)

_Step: TypeAlias = tuple[str, tuple[Any, ...]]
"""A statement of SQL and its values."""

_Note = TypeVar("_Note", bound=msgspec.Struct)


class StudyNote(msgspec.Struct, frozen=True, kw_only=True):
    """Which study a ledger holds.

    Attributes
    ----------
    title, seed
        Of the study.
    config
        All of it but its time limit, as JSON; empty in a ledger that was opened, which has it as `Ledger.config`.
    study_hash
        SHA-256 of its canonical JSON, without what results do not depend on.
    versions
        Of this package and of those that numbers depend on: `mcspectra.core.results.package_versions`.
    inputs
        SHA-256 of the files that its results depend on, by names for people.
    """

    title: str
    seed: int
    config: str
    study_hash: str
    versions: dict[str, str]
    inputs: dict[str, str]

    @staticmethod
    def of(config: StudyConfig, inputs: Mapping[str, str]) -> StudyNote:
        """The note of a study that this process computes, without its time limit.

        Results do not depend on that, so that they are the same files with it.
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
    """Who writes into a folder, or did when it ended without a word: host, process, since when."""

    host: str
    pid: int
    since: str

    @property
    def in_words(self) -> str:
        """For messages: ``process 12 on host 'a' since …``."""
        return f"process {self.pid} on host {self.host!r} since {self.since}"


class StudyTally(msgspec.Struct, frozen=True, kw_only=True):
    """What changes with every commit.

    Attributes
    ----------
    done, size, digest
        Finished cells: how many, bytes of their results, exclusive or of their digests.
    started, finished
        When the study was begun, and when its last cell was finished: UTC, ISO 8601.
    hosts
        Machines that began it, went on with it or computed for it.
    holder
        The process that writes; None once it has ended in good order.
    """

    done: int = 0
    size: int = 0
    digest: str = f"{0:064x}"
    started: str | None = None
    finished: str | None = None
    hosts: tuple[str, ...] = ()
    holder: Holder | None = None

    def plus(self, digest: bytes, size: int) -> StudyTally:
        """With a finished cell more."""
        either = int(self.digest, 16) ^ int.from_bytes(digest, "big")
        return msgspec.structs.replace(
            self, done=self.done + 1, size=self.size + size, digest=f"{either:064x}"
        )


class _Header(msgspec.Struct, frozen=True, kw_only=True):
    """What never changes but for inputs: the study, its number of cells, SHA-256 of their paths."""

    study: StudyNote
    cells: int
    plan: str


class _Change(NamedTuple):
    """Statements that write what is known of a cell; digest and size of its result, or why it failed."""

    path: str
    steps: Iterable[_Step]
    digest: bytes | None = None
    size: int = 0
    failure: str | None = None


class Survey(NamedTuple):
    """Sound parts of a ledger, from which a resumed run continues, and damaged parts.

    Attributes
    ----------
    done
        Paths of finished cells, in their order.
    failed
        Sentences of cells that failed, by their paths.
    recorded
        Number of recorded states.
    missing
        Paths of cells that are neither, nor damaged.
    damaged
        Descriptions of damage by paths of cells, keys of tasks, or names of parts.
    """

    done: tuple[str, ...]
    failed: dict[str, str]
    recorded: int
    missing: tuple[str, ...]
    damaged: dict[str, str]


class _Damaged(StoreError):
    """A sentence about a file that is damaged, and the reason in a few words."""

    def __init__(self, sentence: str, reason: str = "") -> None:
        super().__init__(sentence)
        self.reason = reason or sentence


@final
class Ledger:
    """What is known of a study: made by `create`, `resume` or `read`, a context manager.

    What a writer is told is committed once a second, by a thread of its own, and by `close`.

    Attributes
    ----------
    folder
        Where it lies.
    tally
        How far it was at the last commit.
    damaged
        What was found damaged, in words, by paths of cells, keys of tasks, or names of parts.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.tally = StudyTally()
        self.damaged: dict[str, str] = {}
        self._file = folder / LEDGER_NAME
        self._lock: sqlite3.Connection | None = None
        self._connection: sqlite3.Connection | None = None
        self._guard = threading.RLock()
        self._pending: list[_Change] = []  # not committed
        self._waiting = 0  # bytes of these
        self._closed = threading.Event()
        self._broken: StoreError | None = None  # what a commit of the thread has met
        self._holds = False
        self._salvaged = False  # whether rows are those of `_read_pages`

    @staticmethod
    def create(folder: Path, study: StudyNote, paths: Sequence[str]) -> Ledger:
        """Begin the ledger of a study in a folder, which is made if it is not there.

        Parameters
        ----------
        paths
            Of all cells, in the order in which they are listed.

        Raises
        ------
        StoreError
            There are results already, another process writes into the folder, it has symbolic links
            where a run writes, or it cannot be written; while it is (StorageError).
        """
        with _given_free_if_it_fails(Ledger(folder)) as ledger:
            ledger._begin(study, paths, None)
        return ledger

    @staticmethod
    def resume(
        folder: Path, study: StudyNote, paths: Sequence[str], *, outdated: Collection[str] = ()
    ) -> Ledger:
        """Go on with the ledger of a folder, all of which is verified; without one, begin it.

        Parameters
        ----------
        outdated
            Paths of cells to be computed again, as files that they depend on have changed; without
            any, changed files are refused.

        Raises
        ------
        StoreError
            As of `create`; the ledger is of another study, format or version of this package, or so
            damaged that it does not say of which.

        Warns
        -----
        OtherVersionsWarning
            It was begun with other versions of packages that numbers depend on.
        """
        with _given_free_if_it_fails(Ledger(folder)) as ledger:
            ledger._begin(study, paths, outdated)
        return ledger

    @staticmethod
    def read(folder: str | Path, *, salvage: bool = False) -> Ledger:
        """Look into the ledger of a folder, which may be in use; nothing is changed.

        Parameters
        ----------
        salvage
            Look for damage of the file, and read its pages one by one if there is any: for `verify`.

        Raises
        ------
        StoreError
            There is no ledger, it has another format, or its damage hides the study that it
            belongs to; without `salvage` also if it is damaged otherwise.
        """
        with _given_free_if_it_fails(Ledger(Path(folder))) as ledger:
            ledger._open(salvage=salvage)
        return ledger

    @property
    def study(self) -> StudyNote:
        """The study, as it was when the ledger was begun, without its `config`."""
        return self._header.study

    @property
    def config(self) -> str:
        """All of the study as JSON, megabytes of a large one.

        Raises
        ------
        StoreError
            It is damaged.
        """
        for _, text in self._texts("config"):
            if text is not None:
                return text
        raise _Damaged(f"The study in {str(self._file)!r} is damaged: {_DAMAGE}; {_REMEDY}.")

    @property
    def paths(self) -> Sequence[str]:
        """Paths of all cells of the study, in their order."""
        return self._listing[0]

    @property
    def done(self) -> KeysView[str]:
        """Paths of the finished cells: those of earlier runs in their order, then new ones."""
        return self._listing[1].keys()

    def failures(self) -> dict[str, str]:
        """Sentences of the cells that failed, by their paths in their order."""
        self.commit()
        found = {}
        for path, text in self._texts("failure"):
            if text is None:
                self.damaged[f"failure of {path}"] = _DAMAGE
            else:
                found[path] = text
        return {path: found[path] for path in self.paths if path in found} if found else {}

    def tasks(self, path: str) -> list[tuple[str, Chunk]]:
        """What is recorded, and committed, of a cell: keys of runs, and blocks of them."""
        with self._guard:
            rows = self._rows("SELECT run, first, blocks FROM tasks WHERE path = ?", (path,))
        return [(run, (first, blocks)) for run, first, blocks in rows]

    @property
    def recorded(self) -> int:
        """Number of recorded states."""
        self.commit()
        ((count,),) = self._rows("SELECT count(*) FROM tasks")
        return int(count)

    def state(self, path: str, run: str, chunk: Chunk) -> bytes | None:
        """The recorded state of a task; None if it was never recorded, or is `damaged`."""
        with self._guard:
            self.commit()
            for row in self._rows(_ONE_TASK, (path, run, *chunk)):
                if self._is_sound("task", row[:4], row[5], row[4]):
                    return bytes(row[5])
            if (run, chunk) in self.tasks(path):
                self.damaged[_task_name(path, run, *chunk)] = _DAMAGE
            return None

    def result(self, path: str) -> bytes:
        """The result of a finished cell.

        Raises
        ------
        StoreError
            The study has no such cell, it is not finished, or its result is damaged.
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
        """The scalars of all finished cells, by their paths in their order.

        Raises
        ------
        StoreError
            Those of a cell are damaged.
        """
        with self._guard:
            self.commit()
            done = tuple(self.done)  # first: there may be a commit in between
            texts = dict(self._texts("scalars"))
        found: dict[str, dict[str, float]] = {}
        for path in done:
            with contextlib.suppress(
                ValueError, RecursionError
            ):  # A stranger's text may be anything
                given = json.loads(texts.get(path) or "null")
                found[path] = msgspec.convert(given, dict[str, float | int])
            if path not in found:
                raise StoreError(
                    f"The scalars of {path} in {str(self._file)!r} are damaged: {_DAMAGE}; {_REMEDY}."
                )
        return found

    def record(self, path: str, run: str, chunk: Chunk, payload: bytes, host: str = "") -> None:
        """Keep the state of a task of a cell that is not finished.

        Parameters
        ----------
        run, chunk
            Key of the run, and which of its blocks.
        host
            Where it was computed.

        Raises
        ------
        StorageError
            What was told cannot be written; so of all that write.
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
        """Keep the result of a cell; what was recorded of it goes in the same transaction.

        Parameters
        ----------
        payload, scalars
            The result, and those numbers of it that stand alone, by their names.

        Raises
        ------
        StoreError
            It is finished already.
        """
        text, digest = json.dumps(dict(scalars)), self._digest("result", (path,), payload)
        with self._guard:
            if path in self.done:
                raise StoreError(f"The cell {path} in {str(self.folder)!r} is finished already.")
            self._tell(self._result(path, payload, digest, text))
            self._listing[1][path] = None

    def fail(self, path: str, sentence: str) -> None:
        """Note why a cell has failed."""
        text = sentence[:_MOST_SENTENCE].encode("utf-8", "replace").decode()
        with self._guard:
            self._tell(_Change(path, [self._text("failure", path, text)]))

    def forget(self, paths: Iterable[str]) -> None:
        """Drop failures and recorded states of cells, which are to be tried again."""
        with self._guard:
            for path in paths:
                self._tell(_Change(path, _forgetting(path)))
            self.commit()  # before anybody asks for their states

    def commit(self) -> None:
        """Write what was told since the last commit, all of it or nothing."""
        with self._guard:
            if self._broken is not None:
                raise self._broken
            if self._pending:
                tally = self._write(self._pending, self.tally)
                # No call stands between these, so that no signal can come between them.
                self.tally, self._pending, self._waiting = tally, [], 0

    def verify(self, paths: Sequence[str] | None = None) -> Survey:
        """Read everything, and return the sound and the `damaged` parts.

        Parameters
        ----------
        paths
            Paths of all cells of the study, by default those in the ledger; other cells are refused.
        """
        self.commit()
        if paths is None or _plan_digest(paths) != self._header.plan:
            paths = self._listed_anyway() if self._salvaged else self.paths
        elif not self._salvaged:
            _ = self.paths  # checked against the tally
        return self._surveyed(paths)

    def close(self) -> None:
        """Commit, note that this process has ended, give the folder free; again, do nothing."""
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
        # What ended the run is what there is to say.
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
        """The result of a cell with its scalars, in place of what was recorded of it."""
        put = (
            (_PUT_RESULT, (payload, path)),
            (_PUT_DIGEST, (digest, path)),
            self._text("scalars", path, text),
        )
        return _Change(path, (*put, *_forgetting(path)), digest, len(payload))

    def _begin(
        self, study: StudyNote, paths: Sequence[str], outdated: Collection[str] | None
    ) -> None:
        """Begin to write, into a new ledger alone if `outdated` is None."""
        self._lock = _locked(self.folder)
        exists, old = self._file.exists(), (self.folder / STORE_NAME).exists()
        if (exists or old) and outdated is None:
            raise StoreError(
                f"{str(self.folder)!r} holds results already; "
                "give another --out, or --resume to continue them."
            )
        if exists:
            self._continue(study, paths, outdated or ())
        elif old:
            raise StoreError(
                f"{str(self.folder)!r} holds results and no {LEDGER_NAME}: they are of an earlier "
                "version, which alone can continue them; give another --out."
            )
        else:
            about = msgspec.structs.replace(study, config="")
            self._header = _Header(study=about, cells=len(paths), plan=_plan_digest(paths))
            self.tally = StudyTally(started=_now())
            self._replace(study.config, paths, ())
            self.__dict__["_listing"] = list(paths), {}  # those of the plan: there may be a million

        # Note who writes from now on, and commit once a second what is told.
        host = socket.gethostname()
        hosts = tuple(dict.fromkeys((*self.tally.hosts, host)))
        holder = Holder(host, os.getpid(), _now())
        self.tally = msgspec.structs.replace(self.tally, hosts=hosts, holder=holder)
        self.tally = self._write((), self.tally)
        self._holds = True
        threading.Thread(target=self._commit_in_time, daemon=True).start()

    def _continue(self, study: StudyNote, paths: Sequence[str], outdated: Collection[str]) -> None:
        """Go on with the ledger of this study; without what is damaged or outdated."""
        self._open(salvage=True)
        whose = f"The results in {str(self.folder)!r} are"
        if (study.study_hash, _plan_digest(paths)) != (self.study.study_hash, self._header.plan):
            raise StoreError(
                f"{str(self._file)!r} belongs to another study or another version of this one; "
                "give another --out."
            )

        # Refuse results of another version of this package, warn of others of those it uses.
        before = self.study.versions
        others = {
            name.removeprefix("version_"): (before[name], version)
            for name, version in study.versions.items()
            if before.get(name, version) != version
        }
        if "mcspectra" in others:
            old, new = others["mcspectra"]
            raise StoreError(
                f"{whose} of mcspectra {old}, and this is {new}, whose numbers may differ: resume "
                "them with the version that began them, or give another --out."
            )
        if others:
            changes = ", ".join(f"{name} {old} (now {new})" for name, (old, new) in others.items())
            warn(
                f"{whose} begun with {changes}: the last bits of those to come may differ from an "
                "uninterrupted run's.",
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
        """Carry out changes and note the tally with them, all of it or nothing."""
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
        """Write the ledger anew beside its place, with what there is of it, and put it there."""
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
            _remove_partial(partial)  # of a run that was killed
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
        """Open the file, and read which study it holds; with `salvage` whatever damage it has."""
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
                f"{str(self._file)!r} is damaged where it says of which study it is, or it is no "
                "ledger: give another folder."
            )
        if broken and not salvage:
            raise StoreError(f"{str(self._file)!r} is damaged: {broken}; {_REMEDY}.")
        self._header = header
        self.tally = self._noted_tally()

    def _connect(self, *, thoroughly: bool) -> None:
        """Have SQLite open the file.

        Raises
        ------
        _Damaged
            It is no database of a ledger's tables, or not all of it can be read.
        """
        # SQLite would open, and write, two other files for a journal of another kind
        with _reading(self._file), self._file.open("rb") as stream:
            head = stream.read(20)
        if head[:16] != b"SQLite format 3\0" or head[18:] != b"\1\1":
            raise _Damaged("its first page is not that of a ledger")
        try:
            # Without the right to write SQLite opens it for reading; what a crash left it undoes.
            self._connection = _connected(self._file, "rw")
            if self._lock is None:
                self._connection.execute("PRAGMA query_only = ON")
        except sqlite3.Error as error:
            raise self._unreadable(error) from None
        ((version,),) = self._rows("PRAGMA user_version")
        if version not in (0, FORMAT):
            raise StoreError(
                f"{str(self._file)!r} has store format {version}; this version reads {FORMAT}: export "
                "it with the version that wrote it, or run the study again with another --out."
            )
        schema = self._rows("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY rowid")
        if tuple(text for (text,) in schema) != _SCHEMA:
            raise _Damaged("its tables are not those of a ledger")
        if thoroughly:
            ((first, *_), *_) = self._rows("PRAGMA integrity_check(1)")
            if first != "ok":
                raise _Damaged(_BAD_PAGES)

    def _read_pages(self, reason: str) -> None:
        """Go on with a copy of those rows of the damaged file that can be read, page by page."""
        self.damaged["file"] = reason
        self._salvaged = True
        if self._connection is not None:
            self._connection.close()
        # A private file, which is gone when it is closed
        self._connection = copy = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        try:
            with contextlib.closing(Leaves(self._file, _PAGE)) as leaves:
                copy.execute("BEGIN")
                for statement in _COPIED:
                    copy.execute(statement)
                # Pages in use come first; deleted rows are valid for results only
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
        """Contents of a note, which has two copies; None if both are damaged."""
        for table in _NOTED:
            rows: list[tuple[Any, ...]] = []
            with contextlib.suppress(_Damaged):
                rows = self._rows(f"{_TEXTS.format(table)} AND name = ?", ("note", name))
            for _, text, digest in rows:
                with contextlib.suppress(msgspec.MsgspecError, TypeError, AttributeError):
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
        """All paths, and those of finished cells, in their order: checked against the tally."""
        paths: list[str] = []
        done: dict[str, None] = {}
        digests, found = bytearray(), ("", "")
        with self._guard:
            self._rows("BEGIN")  # else a commit might come between
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
            except (TypeError, ValueError):  # values of other types than were written
                pass
            finally:
                self._opened.rollback()
        if not are_paths(paths) or found != (self.tally.digest, self._header.plan):
            self.damaged["list of cells"] = "it is not as it was written"
        return paths, done

    def _listed_anyway(self) -> list[str]:
        """Paths of all cells by their places; a name for people where the list is damaged."""
        known = dict(self._each("SELECT place, path FROM cells"))
        return [str(known.get(place, f"cell {place}")) for place in range(self._header.cells)]

    def _surveyed(self, paths: Sequence[str]) -> Survey:
        """Read everything; what is not sound goes to `damaged`."""
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
        # Of a reader's list it is known already; meanwhile there may have been a commit.
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
        """Rows that are as they were written, to be written again; other rows go to `damaged`.

        This alone decides what of a damaged ledger is kept.
        """
        try:
            _ = self.config
        except _Damaged:
            self.damaged["text of the study"] = _DAMAGE
        for table in _NOTED:
            for name in ("study", "tally"):
                if not any(text for _, text in self._texts("note", name, table)):
                    self.damaged[f"note of the {name}"] = _DAMAGE

        # Results whose digests are sound; those whose digests are lost wait for the tally
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
            if left == 0:  # the tally has the digests of all: that these are sound, too
                payloads = [payload for (payload,) in self._rows(_PAYLOADS, (place,))]
                sound = [
                    (p, digest) for p in payloads if self._digest("result", (path,), p) == digest
                ]
                change, again = self._with_scalars(path, *sound[0])
                made += again
            if change is None:
                self.damaged[path] = "its row cannot be read"
            else:
                self.damaged["list of cells"] = "rows of it cannot be read"
                yield change
        if made:
            self.damaged["scalars"] = f"those of {made} cells, which are taken from their results"

        # States of tasks, and failures
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
        """Rows of one cell in the tables ``cells`` and ``results``; none of either if one is damaged."""
        with self._guard, contextlib.suppress(_Damaged):
            self._rows("BEGIN")  # a commit between the two reads would look like damage
            try:
                cells = self._rows("SELECT path, digest FROM cells WHERE place = ?", (place,))
                return cells, self._rows(_PAYLOADS, (place,))
            finally:
                self._opened.rollback()
        return [], []

    def _with_scalars(
        self, path: str, payload: bytes, digest: bytes
    ) -> tuple[_Change | None, bool]:
        """A sound result with its scalars; whether these were damaged and are taken from it again."""
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
        """What a statement finds."""
        return list(self._each(statement, values))

    def _each(self, statement: str, values: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
        """What a statement finds, one by one: there may be a million.

        Raises
        ------
        StoreError
            The file cannot be read, or is damaged.
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
        """What keeps a text, with a digest."""
        row = kind, name, text, self._digest(kind, (name,), text.encode())
        return _PUT_TEXT.format(table), row

    def _texts(
        self, kind: str, name: str | None = None, table: str = "texts"
    ) -> Iterator[tuple[str, str | None]]:
        """Texts of a kind, or that of a name, with their names; None where they are damaged."""
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
    """Why a file cannot be read or written, in words; empty if its contents are the reason."""
    if isinstance(error, MemoryError):
        return _NOT_DAMAGE[7]
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return _NOT_DAMAGE.get(getattr(error, "sqlite_errorcode", 0) & 0xFF, "")


def _digest(study: StudyNote, kind: str, key: tuple[Any, ...], content: bytes) -> bytes:
    """SHA-256 of a row of a study."""
    digest = hashlib.sha256(study.study_hash.encode())
    digest.update(repr((kind, *key)).encode("utf-8", "surrogatepass"))
    digest.update(content)
    return digest.digest()


def scalars_of(result: xr.Dataset) -> dict[str, float]:
    """Numbers of a result that stand alone: its real variables without dims."""
    return {
        str(name): each.values.item()
        for name, each in result.variables.items()
        if each.ndim == 0 and each.dtype.kind in "biuf"
    }


def are_paths(paths: Iterable[str]) -> bool:
    """Whether texts can be paths of cells, as plans make them: none leads out of a folder."""
    try:
        text = "\n".join(["", *paths, ""])
        strange = text.encode().translate(None, _PATH_LETTERS + b"\n")
    except (TypeError, UnicodeError):
        return False
    return not strange and not any(each in text for each in _NO_PATH)


def is_held(folder: Path) -> bool:
    """Whether a process writes into a folder: SQLite's lock says so, which ends with it."""
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
    """Why no run can lock a folder, in words; None if one can."""
    lock = folder / _LOCK_NAME
    if os.path.lexists(lock) and not (lock.is_file() and lock.stat().st_size == 0):
        return "it is not the empty file that a run locks; remove it while no run writes there"
    return None


def _refuse_strangers(file: Path) -> None:
    """Refuse what would lead SQLite, when it opens a file, to other files than its own."""
    for end in _BESIDE:
        beside = file.with_name(file.name + end)
        refuse_links(str(beside))
        if os.path.lexists(beside) and not beside.is_file():
            raise StoreError(f"{str(beside)!r} is no file; remove it, or take another folder.")
    journal = file.with_name(f"{file.name}-journal")
    if journal.exists():
        tail = b""  # a writer that commits may delete the journal before it is opened
        with (
            _reading(journal),
            contextlib.suppress(FileNotFoundError),
            journal.open("rb") as stream,
        ):
            stream.seek(0, os.SEEK_END)
            stream.seek(max(0, stream.tell() - len(_SUPER_JOURNAL)))
            tail = stream.read()
        # SQLite deletes the file that is named there
        if tail == _SUPER_JOURNAL:
            raise StoreError(
                f"{str(journal)!r} names another file, which no run writes; remove it, or take another "
                "folder."
            )


@contextlib.contextmanager
def _reading(file: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise StoreError(f"{str(file)!r} cannot be read: {error.strerror}.") from None


def refuse_links(place: str) -> None:
    """Refuse a file that is a symbolic link, or a folder that is one or has one inside.

    Raises
    ------
    StoreError
        It names the link.
    """
    inside = (
        os.path.join(base, name)  # noqa: PTH118 - of many thousands
        for base, *names in os.walk(place)
        for name in itertools.chain(*names)
    )
    for each in itertools.chain([place], inside):
        if os.path.islink(each):  # noqa: PTH114
            raise StoreError(
                f"{each!r} is a symbolic link, and might lead to files of others; results hold files "
                "only: remove it, or take another folder."
            )


@contextlib.contextmanager
def _given_free_if_it_fails(ledger: Ledger) -> Iterator[Ledger]:
    try:
        yield ledger
    except BaseException:
        ledger.close()
        raise


def _locked(folder: Path) -> sqlite3.Connection:
    """The right to write into a folder: an exclusive transaction on an empty file, which never ends."""
    with _writing(folder, StoreError, "give another --out"):
        folder.mkdir(parents=True, exist_ok=True)
        _refuse_strangers(folder / _LOCK_NAME)
        trouble = lock_damage(folder)
        if trouble is not None:
            raise StoreError(f"{str(folder / _LOCK_NAME)!r} cannot be locked: {trouble}.")
        lock = _connected(folder / _LOCK_NAME, "rwc", 1.0)  # those who look hold it for a moment
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.Error as error:
            lock.close()
            if getattr(error, "sqlite_errorname", "") != "SQLITE_BUSY":
                raise
            # Say who has the lock: they may be about to note it
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
    # A schema is data; pages stay in memory until the commit, so that readers are not kept out.
    for pragma in ("trusted_schema = OFF", "cell_size_check = ON", "cache_spill = OFF"):
        connection.execute(f"PRAGMA {pragma}")
    return connection


@contextlib.contextmanager
def _writing(
    place: Path,
    kind: type[StoreError] = StorageError,
    remedy: str = "",
) -> Iterator[None]:
    """Make one sentence of what keeps a place from being written; `remedy` is that of a ledger."""
    try:
        yield
    except (OSError, sqlite3.Error, MemoryError) as error:
        reason = _not_damage(error) or str(error)
        if not remedy and place.exists():
            remedy = "what was finished is kept, and --resume continues it"
        raise kind(
            f"{str(place)!r} cannot be written: {reason}; {remedy or _REMEDY_NEW}."
        ) from None


def _remove_partial(partial: Path) -> None:
    for file in (partial, partial.with_name(f"{partial.name}-journal")):
        file.unlink(missing_ok=True)


def _forgetting(path: str) -> tuple[_Step, ...]:
    """What drops the failure and the recorded states of a cell."""
    tables = ("tasks WHERE path = ?", "texts WHERE kind = 'failure' AND name = ?")
    return tuple((f"DELETE FROM {each}", (path,)) for each in tables)


def _plan_digest(paths: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(paths).encode()).hexdigest()


def _task_name(path: str, run: str, first: int, blocks: int) -> str:
    return f"task {path}/{run}/{first}+{blocks}"


def _now() -> str:
    """The time, UTC, ISO 8601; for people, nothing depends on it."""
    return dt.datetime.now(dt.UTC).isoformat(timespec="seconds")
