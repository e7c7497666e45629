"""Studies on a dask cluster: tasks go to its workers, results come back as bytes.

The scheduler resubmits tasks whose worker dies; this engine resubmits those that were under way when
the connection to the scheduler was lost and found again. A worker that dies takes tasks with it that
are not to blame; those that the scheduler gives up come again, one at a time. At most two tasks a worker thread are with
the scheduler, results that were not fetched yet among them, so that nothing grows with the study.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import itertools
import queue
import uuid
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple, final

from mcspectra.studies.connection import (
    ClusterError,
    ClusterLost,
    ClusterOptions,
    Connection,
    connect,
    killed_worker,
)
from mcspectra.studies.engines import Outcome, attempt
from mcspectra.studies.foreign_code import explain
from mcspectra.studies.remote import Compute, WorkerRefused, compute_remotely
from mcspectra.studies.tasks import StudyText, Task

__all__ = ["ClusterError", "ClusterLost", "ClusterOptions", "DaskEngine"]

_AHEAD = 2  # tasks with the scheduler for each worker thread
_RESUBMISSIONS = 5  # of a task that is lost with the connection
_POLL = 0.5  # seconds between looks at the connection


class _Pending(NamedTuple):
    """A task that has no outcome yet.

    Attributes
    ----------
    losses
        How often it was lost with the connection.
    deaths
        How many workers died while they had it, by the scheduler's count.
    """

    task: Task
    losses: int = 0
    deaths: int = 0


@final
class DaskEngine:
    """Computes tasks on the workers of a dask cluster.

    Parameters
    ----------
    text
        The study.
    options
        Where the workers are.
    compute
        What computes a task on a worker: a function that workers can import.

    Raises
    ------
    MissingDependency
        The package distributed is not installed.
    ClusterError
        The scheduler does not answer, or a worker has another version of this package.
    """

    def __init__(
        self, text: StudyText, options: ClusterOptions, compute: Compute = attempt
    ) -> None:
        self._text = text
        self._options = options
        self._compute = compute
        self._name = f"mcspectra-{uuid.uuid4().hex}"
        self._serials = itertools.count()
        self._waiting: deque[_Pending] = deque()
        self._suspects: deque[_Pending] = deque()
        self._sent: dict[int, tuple[Any, _Pending]] = {}
        self._finished: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._connection = connect(options)
        try:
            _refuse_other_versions(self._connection, text.version)
        except BaseException:
            self._connection.close()
            raise

    @property
    def workers(self) -> int:
        """Worker threads of the cluster; 1 while there are none, so that tasks wait for the first."""
        return max(1, self._connection.threads())

    @property
    def address(self) -> str:
        """The scheduler's."""
        return self._connection.address

    @property
    def dashboard(self) -> str:
        """Link to dask's dashboard; empty if it has none."""
        return self._connection.dashboard

    def submit(self, task: Task) -> None:
        """Have a task computed; returns at once."""
        self._waiting.append(_Pending(task))
        self._fill()

    def outcomes(self) -> Iterator[Outcome]:
        """Yield outcomes as tasks finish, until none is left.

        Raises
        ------
        ClusterLost
            The scheduler has gone and did not come back in time.
        ClusterError
            A worker that joined later has another version of this package.
        """
        while self._waiting or self._suspects or self._sent:
            outcome = self._next()
            if outcome is not None:
                yield outcome

    def close(self, cancel: bool) -> None:
        """Leave the cluster; with `cancel` tasks under way are given up first."""
        futures = [future for future, _ in self._sent.values()]
        if cancel and futures and self._connection.ready:
            self._connection.cancel(futures)
        self._waiting.clear()
        self._suspects.clear()
        self._sent.clear()
        self._connection.close()

    def _fill(self) -> None:
        """Send as many tasks as the cluster should have."""
        most = _AHEAD * self.workers
        while len(self._sent) < most and self._connection.ready:
            pending = self._pick()
            if pending is None:
                return
            self._send(pending)

    def _pick(self) -> _Pending | None:
        """The next task to send: a suspect if none is under way, so that they do not share a worker."""
        if self._suspects and not any(sent.deaths for _, sent in self._sent.values()):
            return self._suspects.popleft()
        return self._waiting.popleft() if self._waiting else None

    def _send(self, pending: _Pending) -> None:
        serial = next(self._serials)
        # Dask counts keys by the first entry for ever, so that it must be the same for all tasks.
        key = (self._name, pending.task.key, str(serial))
        arguments = (self._compute, self._text, pending.task, self._options.time_limit)
        future = self._connection.submit(key, compute_remotely, *arguments)
        self._sent[serial] = future, pending
        future.add_done_callback(lambda _: self._finished.put(serial))

    def _next(self) -> Outcome | None:
        """The next outcome; None if there was none for a moment, or a task was lost."""
        self._fill()
        try:
            serial = self._finished.get(timeout=_POLL)
        except queue.Empty:
            if not self._connection.alive:
                raise self._lost() from None
            return None
        future, pending = self._sent.pop(serial)
        try:
            return self._outcome(future, pending)
        finally:
            future.release()
            del future
            if self._connection.ready:
                self._fill()

    def _outcome(self, future: Any, pending: _Pending) -> Outcome | None:
        """What became of a task that is done in dask's eyes; None if it was lost."""
        try:
            # May wait: if the worker has died since, the task is computed again.
            outcome, occupied = future.result()
        except (concurrent.futures.CancelledError, asyncio.CancelledError):
            return self._resubmit(pending)
        except WorkerRefused as refusal:
            raise ClusterError(str(refusal)) from None
        except killed_worker() as error:
            return self._suspect(pending, getattr(error, "allowed_failures", 0) + 1)
        except OSError as error:
            if future.status == "error":
                return Outcome(key=pending.task.key, error=explain(error))
            return self._resubmit(pending)  # the connection broke while the result was fetched
        except Exception as error:  # noqa: BLE001 - whatever kept dask from computing it
            return Outcome(key=pending.task.key, error=explain(error))
        if occupied:
            self._connection.restart_worker(future)
        result: Outcome = outcome
        return result

    def _resubmit(self, pending: _Pending) -> Outcome | None:
        """Have a task computed again that was lost with the connection, unless it often was."""
        if pending.losses == _RESUBMISSIONS:
            reason = f"It was lost {pending.losses + 1} times with the connection to the scheduler."
            return Outcome(key=pending.task.key, error=reason)
        self._waiting.appendleft(pending._replace(losses=pending.losses + 1))
        return None

    def _suspect(self, pending: _Pending, deaths: int) -> Outcome | None:
        """Try a task once more whose workers died; the second time it is to blame."""
        total = pending.deaths + deaths
        if not pending.deaths:
            self._suspects.append(pending._replace(deaths=total))
            return None
        reason = (
            f"{total} workers died while computing it; it may need more memory than a worker has (the "
            "worker's log says more)."
        )
        return Outcome(key=pending.task.key, error=reason)

    def _lost(self) -> ClusterLost:
        return ClusterLost(
            f"The dask scheduler at {self.address} has gone and did not answer again within "
            f"{self._options.patience:g} s; finished work is stored, and --resume continues."
        )


def _refuse_other_versions(connection: Connection, version: str) -> None:
    """Raise `ClusterError` that names each worker with another version of this package."""
    others = {worker: found for worker, found in connection.versions().items() if found != version}
    if others:
        hosts = connection.hosts(list(others))
        named = ", ".join(f"{hosts[each]} ({each}) has {found}" for each, found in others.items())
        raise ClusterError(
            f"The study is run by mcspectra {version}, but of its workers {named}; install the same "
            "version there."
        )
