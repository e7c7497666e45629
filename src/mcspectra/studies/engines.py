"""Engines: where tasks are computed. Threads of this process, or processes that can be killed.

An engine is given tasks and hands back outcomes in the order in which they finish. A failing task is an
outcome like any other; what the engine itself cannot go on after is raised.
"""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Protocol, final

import msgspec

from mcspectra.studies.foreign_code import explain
from mcspectra.studies.tasks import StudyText, Task, compute_task

__all__ = ["Engine", "LocalEngine", "Outcome", "attempt"]

_GRACE = 5.0  # seconds that a cancelled engine waits for tasks that run: most chunks take about 1 s


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """What became of a task.

    Attributes
    ----------
    key
        The task's.
    payload
        State of its chunk (`mcspectra.studies.tasks.unpack_payload`); None if it failed.
    error
        One sentence about why it failed.
    seconds
        How long it ran.
    host
        Where.
    """

    key: str
    payload: bytes | None = None
    error: str | None = None
    seconds: float = 0.0
    host: str = ""


class Engine(Protocol):
    """Computes tasks of one study, several at once."""

    @property
    def workers(self) -> int:
        """How many tasks it computes at once."""

    def submit(self, task: Task) -> None:
        """Have a task computed, now or later."""

    def outcomes(self) -> Iterator[Outcome]:
        """Wait for the next task that finishes, in any order; ends when none is under way."""

    def close(self, cancel: bool) -> None:
        """Stop the workers; with `cancel` without what has not begun."""


def attempt(text: StudyText, task: Task) -> Outcome:
    """Compute a task in this thread; whatever it raises becomes a sentence."""
    start = time.perf_counter()
    payload, error = None, None
    try:
        payload = compute_task(text, task)
    # An interrupt of the run reaches the main thread alone: here it is the integrand's own.
    except BaseException as raised:  # noqa: BLE001 - whatever the code of others does
        error = explain(raised)
    seconds = time.perf_counter() - start
    return Outcome(
        key=task.key, payload=payload, error=error, seconds=seconds, host=socket.gethostname()
    )


@final
class LocalEngine:
    """Threads of this process.

    Parameters
    ----------
    text
        The study.
    workers
        Number of threads.
    compute
        Computes a task of the study; `attempt` by default.
    """

    def __init__(
        self,
        text: StudyText,
        workers: int,
        compute: Callable[[StudyText, Task], Outcome] = attempt,
    ) -> None:
        self._text = text
        self._compute = compute
        self._tasks: queue.SimpleQueue[Task | None] = queue.SimpleQueue()
        self._finished: queue.SimpleQueue[Outcome] = queue.SimpleQueue()
        self._under_way = 0
        # Daemons: an integrand that hangs does not keep the program from ending.
        self._threads = [threading.Thread(target=self._work, daemon=True) for _ in range(workers)]
        for thread in self._threads:
            thread.start()

    @property
    def workers(self) -> int:
        """Number of threads."""
        return len(self._threads)

    def submit(self, task: Task) -> None:
        """Have a task computed by the next thread that is free."""
        self._under_way += 1
        self._tasks.put(task)

    def outcomes(self) -> Iterator[Outcome]:
        """Wait for the next task that finishes; ends when none is under way."""
        while self._under_way:
            outcome = self._finished.get()
            self._under_way -= 1
            yield outcome

    def close(self, cancel: bool) -> None:
        """Stop the threads; with `cancel` drop tasks that wait, and wait for those that run 5 s."""
        if cancel:
            self._drop_waiting()
        for _ in self._threads:
            self._tasks.put(None)
        end = time.monotonic() + _GRACE
        for thread in self._threads:
            thread.join(max(0.0, end - time.monotonic()) if cancel else None)

    def _drop_waiting(self) -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                self._tasks.get_nowait()

    def _work(self) -> None:
        while (task := self._tasks.get()) is not None:
            self._finished.put(self._compute(self._text, task))
