"""Ctrl-C is for the command: a terminal sends it to the workers too, which are to go on until told."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from multiprocessing import resource_tracker

__all__ = ["blocked", "ignore"]

_MASKS = hasattr(signal, "pthread_sigmask")  # not on Windows


@contextlib.contextmanager
def blocked() -> Iterator[None]:
    """Processes, and threads, that are started here do not hear Ctrl-C: this one does afterwards."""
    if not _MASKS:
        yield
        return
    # Its start, which the first process would bring about, ends by unblocking Ctrl-C in its thread.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore() -> None:
    """Ignore Ctrl-C in this process, which was started `blocked`, and what it starts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if _MASKS:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
