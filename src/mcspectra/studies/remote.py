"""What a worker of a cluster does with a task; nothing here knows dask.

A task travels with the study's text, so that workers may join, die and be replaced at any time
without having been told about the study.
"""

from __future__ import annotations

import contextlib
import functools
import socket
import time
from collections.abc import Callable
from typing import TypeAlias

from mcspectra.core.errors import McspectraError
from mcspectra.studies.engines import Outcome
from mcspectra.studies.foreign_code import TookTooLong, within
from mcspectra.studies.tasks import StudyText, Task
from mcspectra.version import __version__

__all__ = ["Compute", "WorkerRefused", "compute_remotely"]

Compute: TypeAlias = Callable[[StudyText, Task], Outcome]
"""What computes a task, and raises nothing: `mcspectra.studies.engines.attempt`."""


class WorkerRefused(McspectraError, RuntimeError):
    """A worker has another version of the package: its results could differ."""


def compute_remotely(
    compute: Compute, text: StudyText, task: Task, time_limit: float | None
) -> tuple[Outcome, bool]:
    """Compute a task on a worker.

    Parameters
    ----------
    compute
        Called with the study's text and the task.
    text, task
        The study and the part of it.
    time_limit
        Seconds after which the task has failed. Its thread goes on, as threads cannot be stopped:
        the worker is to be restarted.

    Returns
    -------
    Outcome
        The task's.
    bool
        Whether it still occupies the worker.

    Raises
    ------
    WorkerRefused
        If this worker has another version of the package.
    """
    if text.version != __version__:
        raise WorkerRefused(
            f"The worker on {socket.gethostname()} has mcspectra {__version__}, but the study was "
            f"started with {text.version}; install the same version there."
        )
    if time_limit is None:
        return compute(text, task), False
    start = time.perf_counter()
    with contextlib.suppress(TookTooLong):
        return within(time_limit, functools.partial(compute, text, task)), False
    error = f"It was stopped after {time_limit:g} s, the time limit of a task."
    seconds = time.perf_counter() - start
    return Outcome(key=task.key, error=error, seconds=seconds, host=socket.gethostname()), True
