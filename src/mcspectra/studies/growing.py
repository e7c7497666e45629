"""Threads that go over to processes once a run is long.

Threads begin at once, but share Python's lock: two are worth 1.6 on short NumPy calls, and more of
them gain less. A process has its own lock and takes seconds to start. So each thread of a long run gets
a process, starts it beside its own work, and hands its tasks over as soon as it is ready.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from typing import final

import msgspec

from mcspectra.studies.engines import LocalEngine, Outcome, attempt
from mcspectra.studies.processes import ATTEMPTS, Worker, ended
from mcspectra.studies.tasks import StudyText, Task

__all__ = ["GrowingEngine"]


@final
class GrowingEngine:
    """Threads of this process, each with a process of its own after a while.

    A process that cannot start leaves its thread to compute by itself. One that dies is replaced, and
    its task tried again, up to three times.

    Parameters
    ----------
    text
        The study.
    workers
        Number of threads, and of processes.
    after
        Seconds until processes are started.
    """

    def __init__(self, text: StudyText, workers: int, after: float) -> None:
        self._helpers = _Helpers(text, time.monotonic() + after)
        self._threads = LocalEngine(text, workers, self._helpers.compute)

    @property
    def workers(self) -> int:
        """Number of threads."""
        return self._threads.workers

    def submit(self, task: Task) -> None:
        """Have a task computed by the next thread that is free, or its process."""
        self._threads.submit(task)

    def outcomes(self) -> Iterator[Outcome]:
        """Wait for the next task that finishes; ends when none is under way."""
        return self._threads.outcomes()

    def close(self, cancel: bool) -> None:
        """Stop threads and processes; with `cancel` drop what waits, and what processes compute."""
        if cancel:
            self._helpers.stop()
        self._threads.close(cancel)
        self._helpers.end()


@final
class _Helpers:
    """The processes, one for each thread that asks."""

    def __init__(self, text: StudyText, begin: float) -> None:
        self._text = msgspec.json.encode(text)
        self._begin = begin
        self._own = threading.local()  # `worker`: a thread's process; None if it is to have none
        self._lock = threading.Lock()
        self._all: list[Worker] = []
        self._stopped = False

    def compute(self, text: StudyText, task: Task) -> Outcome:
        """Compute a task in this thread's process, if it has one that is ready; else in this thread."""
        return self._ask(task) if self._has_process() else attempt(text, task)

    def stop(self) -> None:
        """Kill all processes, and start no more: threads that wait for them go on."""
        with self._lock:
            self._stopped = True
            for worker in self._all:
                worker.kill()

    def end(self) -> None:
        """End all processes; no thread waits for one any more."""
        with self._lock:
            self._stopped = True
            for worker in self._all:
                worker.end()

    def _has_process(self) -> bool:
        """Whether this thread's process is ready; it is started when its time has come."""
        if not hasattr(self._own, "worker"):
            if time.monotonic() < self._begin:
                return False
            self._own.worker = self._started()
        worker: Worker | None = self._own.worker
        if worker is not None and not worker.ready and worker.pipe.poll():
            self._own.worker = worker if worker.hear_start() is None else None
        return self._own.worker is not None and self._own.worker.ready

    def _started(self) -> Worker | None:
        with self._lock:
            if self._stopped:
                return None
            with contextlib.suppress(OSError):  # no more processes, files or memory: threads go on
                worker = Worker(self._text)
                self._all.append(worker)
                return worker
            return None

    def _ask(self, task: Task) -> Outcome:
        """Send a task to this thread's process; to another one if that dies."""
        code = None
        for _ in range(ATTEMPTS):
            worker: Worker | None = self._own.worker
            if worker is None or (not worker.ready and worker.hear_start() is not None):
                break
            if worker.begin(task) and (outcome := worker.take()) is not None:
                return outcome
            code = worker.end()
            self._own.worker = self._started()
        return Outcome(key=task.key, error=f"Its worker process ended ({ended(code)}); gave up.")
