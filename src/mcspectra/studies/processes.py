"""Tasks in processes of their own, which can be stopped: for time limits, and for code that crashes.

One thread does all: it waits for what workers send, for their ends and for the next deadline at once.
Tasks and outcomes cross as MessagePack, arrays in them as plain numbers.
"""

from __future__ import annotations

import importlib
import math
import multiprocessing
import os
import signal
import threading
import time
import warnings
from collections import deque
from collections.abc import Iterator
from multiprocessing.connection import Connection, wait
from typing import Any, final

import msgspec

from mcspectra.core.checks import as_real
from mcspectra.core.errors import McspectraError
from mcspectra.studies import interrupts
from mcspectra.studies.engines import Outcome, attempt
from mcspectra.studies.foreign_code import explain
from mcspectra.studies.tasks import StudyText, Task, prepare

__all__ = ["EngineFailed", "ProcessEngine", "check_time_limit"]

_ATTEMPTS = 3  # of a task whose worker dies; the first and two more
_STARTS = 3  # workers in succession that may die before they are ready
_STARTING = 600.0  # seconds that a worker may take until it is ready
_DYING = 1.0  # seconds from the end of a worker's pipe to its exit code
_LONGEST_LIMIT = 1e9  # seconds, 30 years: clocks and waits take no more


class EngineFailed(McspectraError, RuntimeError):
    """The workers cannot go on; what was finished is kept."""


def check_time_limit(value: float | None) -> float | None:
    """Return a time limit in seconds after checking it; None is none."""
    if value is None:
        return None
    return as_real("time_limit", value, above=0.0, most=_LONGEST_LIMIT)


@final
class ProcessEngine:
    """Worker processes, replaced when they die or are stopped.

    Parameters
    ----------
    text
        The study.
    workers
        Number of processes.
    time_limit
        Seconds that a task may take; None is no limit. The compilation of a kernel that is used for the
        first time on a machine counts.
    """

    def __init__(self, text: StudyText, workers: int, time_limit: float | None = None) -> None:
        self._text = msgspec.json.encode(text)
        self._limit = check_time_limit(time_limit)
        self._waiting: deque[Task] = deque()
        self._lost: dict[str, int] = {}  # how often the worker of a task has died
        self._failed_starts = 0
        self._workers = [_Worker(self._text) for _ in range(workers)]

    @property
    def workers(self) -> int:
        """Number of processes."""
        return len(self._workers)

    def submit(self, task: Task) -> None:
        """Have a task computed by the next worker that is free."""
        self._waiting.append(task)
        self._dispatch()

    def outcomes(self) -> Iterator[Outcome]:
        """Wait for the next task that finishes; ends when none is under way.

        Raises
        ------
        EngineFailed
            Workers die, or cannot build the study, before they compute anything.
        """
        while self._waiting or any(worker.task for worker in self._workers):
            self._dispatch()
            for place in self._events():
                outcome = self._attend(place)
                if outcome is not None:
                    self._lost.pop(outcome.key, None)
                    yield outcome

    def close(self, cancel: bool) -> None:  # noqa: ARG002
        """Stop the processes at once; with or without `cancel`, as outcomes are taken before."""
        self._waiting.clear()
        for worker in self._workers:
            worker.end()

    def _dispatch(self) -> None:
        for worker in self._workers:
            if self._waiting and worker.ready and worker.task is None:
                task = self._waiting.popleft()
                if not worker.begin(task):  # it has died: seen at the next wait
                    self._waiting.appendleft(task)

    def _events(self) -> list[int]:
        """Places of workers that have something to say, have ended or are over the limit."""
        ends = [worker.deadline(self._limit) for worker in self._workers]
        first = min(ends)
        timeout = None if math.isinf(first) else max(0.0, first - time.monotonic())
        heard = wait([worker.pipe for worker in self._workers], timeout)
        now = time.monotonic()
        pairs = enumerate(zip(self._workers, ends, strict=True))
        return [place for place, (worker, end) in pairs if worker.pipe in heard or now >= end]

    def _attend(self, place: int) -> Outcome | None:
        """What has become of a worker: its answer, its start, its end, or the end of its time."""
        worker = self._workers[place]
        if not worker.pipe.poll():
            return self._stop(place)
        try:
            message = worker.pipe.recv_bytes()
        except (EOFError, OSError):
            return self._bury(place)
        if worker.task is None:
            self._started(worker, message)
            return None
        worker.task = None
        return msgspec.msgpack.decode(message, type=Outcome)

    def _started(self, worker: _Worker, message: bytes) -> None:
        """A worker says that it is ready, or why it cannot be."""
        if message:
            raise EngineFailed(f"The workers cannot build the study: {message.decode()}")
        worker.ready = True
        self._failed_starts = 0

    def _stop(self, place: int) -> Outcome | None:
        """Stop a worker that takes too long."""
        task = self._workers[place].task
        self._replace(place)
        if task is None or self._limit is None:
            self._fail_start(f"take more than {_STARTING:g} s")
            return None
        error = f"It took longer than the time limit of {self._limit:g} s and was stopped."
        return Outcome(key=task.key, error=error, seconds=self._limit)

    def _bury(self, place: int) -> Outcome | None:
        """A worker has died: its task is tried again, unless that has happened too often."""
        worker = self._workers[place]
        task = worker.task
        code = self._replace(place, _DYING)
        if task is None:
            if not worker.ready:
                self._fail_start(f"end with {_end(code)}")
            return None
        self._lost[task.key] = lost = self._lost.get(task.key, 0) + 1
        if lost < _ATTEMPTS:
            self._waiting.appendleft(task)
            return None
        return Outcome(
            key=task.key, error=f"Its worker process ended {lost} times ({_end(code)}); gave up."
        )

    def _fail_start(self, what: str) -> None:
        """A worker was not ready in time, or ended before: a few in succession may."""
        self._failed_starts += 1
        if self._failed_starts >= _STARTS:
            raise EngineFailed(f"Worker processes {what} before they are ready to compute.")

    def _replace(self, place: int, patience: float = 0.0) -> int | None:
        code = self._workers[place].end(patience)
        self._workers[place] = _Worker(self._text)
        return code


@final
class _Worker:
    """A process and what it does."""

    def __init__(self, text: bytes) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, inner = context.Pipe()
        self.ready = False
        self.task: Task | None = None
        self.since = time.monotonic()
        self._process = context.Process(target=_serve, args=(inner, text), daemon=True)
        with interrupts.blocked():
            self._process.start()
        inner.close()  # only the worker's copy is left, so that its end is the pipe's end

    def begin(self, task: Task) -> bool:
        """Hand over a task; False if the process has ended."""
        try:
            self.pipe.send_bytes(msgspec.msgpack.encode(task))
        except OSError:
            return False
        self.task, self.since = task, time.monotonic()
        return True

    def deadline(self, limit: float | None) -> float:
        """When its start or its task must be done, on the monotonic clock; else never."""
        if not self.ready:
            return self.since + _STARTING
        return math.inf if limit is None or self.task is None else self.since + limit

    def end(self, patience: float = 0.0) -> int | None:
        """End the process, if it has not by itself; returns its exit code, or minus its signal."""
        self._process.join(patience)
        self._process.kill()
        self._process.join()
        self.pipe.close()
        return self._process.exitcode


def _serve(pipe: Connection, encoded: bytes) -> None:
    """What a worker process does: build the study, then a task after another."""
    interrupts.ignore()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        text = msgspec.json.decode(encoded, type=StudyText)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the command has planned, and warned, already
            prepare(text)
        _warm_up()
    except BaseException as error:  # noqa: BLE001 - whatever the code of others does
        pipe.send_bytes(explain(error).encode())
        return
    pipe.send_bytes(b"")
    try:
        while True:
            task = msgspec.msgpack.decode(pipe.recv_bytes(), type=Task)
            pipe.send_bytes(msgspec.msgpack.encode(attempt(text, task)))
    except (EOFError, OSError):
        return


def _warm_up() -> None:
    """Import what every task needs, so that it does not count as the time of the first one."""
    for name in ("numba", "scipy.stats", "xarray"):
        importlib.import_module(name)


def _end_with_parent() -> None:
    """End this process, whatever it does, once the one that began it has ended."""
    parent: Any = multiprocessing.parent_process()
    parent.join()
    os._exit(1)


def _end(code: int | None) -> str:
    """How a process ended, in words."""
    if code is None or code >= 0:
        return f"exit code {code}"
    known = -code in list(map(int, signal.Signals))
    return f"signal {signal.Signals(-code).name if known else -code}"
