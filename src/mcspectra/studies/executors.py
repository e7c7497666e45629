"""Executors compute tasks in threads of this process or on workers of a dask cluster.

An executor accepts tasks and yields outcomes in the order in which they finish.
A failed task is an ordinary outcome. An executor raises an exception only if it cannot continue.

Worker processes on this machine also form a dask cluster.
Worker processes can be stopped at a time limit, and they may crash.
Tasks of dead workers are therefore handled in the same way on all clusters.
The package dask is imported only when it is needed.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import itertools
import logging
import os
import queue
import re
import signal
import socket
import sys
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from multiprocessing import resource_tracker
from typing import Any, NamedTuple, Protocol, cast, final

import msgspec

from mcspectra.core import decoding
from mcspectra.core.checks import as_integer, as_real
from mcspectra.core.display import shown
from mcspectra.core.errors import FileFormatError, McspectraError, ParameterError
from mcspectra.core.parallel import available_workers
from mcspectra.core.registry import optional_package
from mcspectra.studies.foreign_code import explain
from mcspectra.studies.tasks import (
    WARM,
    Compute,
    Outcome,
    StudyTask,
    StudyText,
    WorkerRefused,
    attempt,
    compute_elsewhere,
    timed,
)

__all__ = [
    "Cluster",
    "ClusterError",
    "ClusterLost",
    "Dask",
    "Executor",
    "Threads",
    "check_time_limit",
]

# Seconds that canceled threads get to finish; most chunks take about 1 s
_GRACE = 5.0
# Largest time limit, in seconds (30 years), because clocks and waits overflow above it
_LONGEST_LIMIT = 1e9
_MOST_SCHEDULER = 2**20  # Maximum number of bytes read from a scheduler file
_LOOPBACK = "127.0.0.1"
_ADDRESS = re.compile(
    r"(?:(tcp|tls)://)?[\w.-]+:\d{1,5}|(?:(tcp|tls)://)?\[[0-9a-fA-F:]+\]:\d{1,5}"
)
_AHEAD = 2  # Number of tasks submitted to the scheduler per worker thread
_RESUBMISSIONS = 5  # Maximum number of resubmissions of a lost task
_POLL = 0.5  # Seconds between checks of the connection or of the threads
_FRESH = 2.0  # Minimum seconds between two counts of the workers
_DESERTED = 300.0  # Seconds to wait for a new local worker, or for a result to arrive
_CLOSING = 5.0  # Seconds to wait for the cluster to close


class Executor(Protocol):
    """Computes tasks of one study, several at once."""

    @property
    def workers(self) -> int:
        """Number of tasks that are computed at once."""

    def submit(self, task: StudyTask, compute: Callable[[], Any]) -> None:
        """Queue a task; `compute` computes it in a thread of this process."""

    def outcomes(self) -> Iterator[Outcome]:
        """Yield outcomes of tasks in the order in which they finish, until no task is pending."""

    def close(self, cancel: bool) -> None:
        """Stop the workers; with `cancel`, drop the tasks that have not started."""


def check_time_limit(value: float | None) -> float | None:
    """Check a time limit in seconds and return it; None means no limit."""
    if value is None:
        return None
    return as_real("time_limit", value, above=0.0, most=_LONGEST_LIMIT)


@final
class Threads:
    """Compute tasks in threads of this process; results need no serialization."""

    def __init__(self, workers: int) -> None:
        self._tasks: queue.SimpleQueue[tuple[StudyTask, Callable[[], Any]] | None] = (
            queue.SimpleQueue()
        )
        self._finished: queue.SimpleQueue[Outcome] = queue.SimpleQueue()
        self._under_way = 0
        # Daemon threads, so that an integrand that hangs cannot keep the program from ending
        self._threads = [
            threading.Thread(target=self._work, name="mcspectra-tasks", daemon=True)
            for _ in range(workers)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def workers(self) -> int:
        """Number of threads."""
        return len(self._threads)

    def submit(self, task: StudyTask, compute: Callable[[], Any]) -> None:
        """Queue a task for the next free thread."""
        self._under_way += 1
        self._tasks.put((task, compute))

    def outcomes(self) -> Iterator[Outcome]:
        """Yield each task when it finishes; end when no task is running.

        Raises
        ------
        ClusterLost
            If a thread died, for example for lack of memory, before its task had an outcome.
        """
        while self._under_way:
            try:
                outcome = self._finished.get(timeout=_POLL)
            except queue.Empty:
                if all(thread.is_alive() for thread in self._threads):
                    continue
                raise ClusterLost(
                    "A thread of this run ended before its task, possibly for lack of memory; "
                    "finished work is stored, and --resume continues."
                ) from None
            self._under_way -= 1
            yield outcome

    def close(self, cancel: bool) -> None:
        """Stop the threads; with `cancel`, drop waiting tasks and wait 5 s for running tasks."""
        with contextlib.suppress(queue.Empty):
            while cancel:
                self._tasks.get_nowait()
        for _ in self._threads:
            self._tasks.put(None)
        end = time.monotonic() + _GRACE
        for thread in self._threads:
            thread.join(max(0.0, end - time.monotonic()) if cancel else None)

    def _work(self) -> None:
        while (work := self._tasks.get()) is not None:
            self._finished.put(timed(*work))


class ClusterError(McspectraError, RuntimeError):
    """The cluster cannot be reached, or its workers cannot run the study."""


class ClusterLost(ClusterError):
    """The scheduler or all workers were lost during a study; finished work is stored."""


@final
@dataclass(frozen=True, kw_only=True)
class Cluster:
    """Address and options of a dask cluster. For TLS, configure dask's ``distributed.comm``.

    Attributes
    ----------
    address
        ``local`` starts worker processes on this machine.
        ``tcp://HOST:PORT`` or ``tls://HOST:PORT`` connects to a running scheduler.
        A path ending in .json is a scheduler file written by dask.
    workers
        Number of one-thread worker processes for ``local``; all processors by default.
    host
        Address where the scheduler of ``local`` listens; by default only this machine can reach it.
    dashboard
        Port of dask's dashboard, for ``local``; 0 picks a free port.
        None starts no dashboard, because its packages take as long to load as all others.
    time_limit
        Seconds after which a task fails and its worker is restarted.
        The time includes compiling a kernel at its first use on a machine.
    patience
        Seconds to wait for the scheduler, at the start and after a lost connection.

    Raises
    ------
    ParameterError
        If a value is out of range, or two values exclude each other.
    """

    address: str = "local"
    workers: int | None = None
    host: str = _LOOPBACK
    dashboard: int | None = 0
    time_limit: float | None = None
    patience: float = 30.0

    def __post_init__(self) -> None:
        if self.dashboard is not None:
            as_integer("dashboard", self.dashboard, least=0, most=65535)
        as_real("patience", self.patience, above=0.0)
        check_time_limit(self.time_limit)
        available_workers(self.workers)
        if self.local:
            return
        if self.workers is not None or self.host != _LOOPBACK or self.dashboard:
            raise ParameterError(
                f"The cluster at {self.address} has its own workers, host and dashboard; give "
                "those options with the cluster 'local' only."
            )
        if not self.address.endswith(".json") and not _ADDRESS.fullmatch(self.address):
            raise ParameterError(
                f"The cluster's address is {self.address!r}; give tcp://HOST:PORT, "
                "tls://HOST:PORT, the .json file that the scheduler wrote, or 'local'."
            )

    @property
    def local(self) -> bool:
        """Whether the cluster is started for this study, on this machine."""
        return self.address == "local"


class _Pending(NamedTuple):
    """A submitted task that has no outcome yet.

    Attributes
    ----------
    losses
        Number of times that the task was lost with the connection.
    deaths
        Number of workers that died while computing the task, counted by the scheduler.
    """

    task: StudyTask
    losses: int = 0
    deaths: int = 0


@final
class Dask:
    """Compute tasks on the workers of a dask cluster.

    The scheduler resubmits the tasks of a worker that dies.
    This class resubmits tasks that were lost when the connection to the scheduler broke.
    A dying worker also loses tasks that did not cause its death.
    Tasks that the scheduler gives up are therefore tried again, one at a time.
    At most two tasks per worker thread are submitted at once.
    Memory therefore does not grow with the size of the study.
    A task counts as submitted until its result is fetched.

    Parameters
    ----------
    text
        The study in the form that is sent to workers.
    cluster
        Address and options of the cluster.
    compute
        Function that computes a task on a worker; workers must be able to import it.

    Raises
    ------
    ClusterError
        If the scheduler does not answer, or a worker has a different version of this package.
    """

    def __init__(self, text: StudyText, cluster: Cluster, compute: Compute = attempt) -> None:
        self._text = text
        self._options = cluster
        self._compute = compute
        self._name = f"mcspectra-{uuid.uuid4().hex}"
        self._serials = itertools.count()
        self._waiting: deque[_Pending] = deque()
        self._suspects: deque[_Pending] = deque()
        self._sent: dict[int, tuple[Any, _Pending]] = {}
        self._finished: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._threads = (0, -_FRESH)
        self._deserted = 0.0
        # Report a missing package before dask's log is muted
        optional_package("distributed", "cluster", "Processes and clusters of dask need")
        with contextlib.ExitStack() as opened:
            self._levels = _muted(opened)
            self._client = _connected(cluster, opened)
            self.address = str(self._client.scheduler.address)
            self.dashboard = str(self._client.dashboard_link or "")
            self._refuse_other_versions()
            self._closing = opened.pop_all()

    @property
    def workers(self) -> int:
        """Number of worker threads, at least 1.

        If there is no worker, one task is submitted and waits for a worker.
        """
        now = time.monotonic()
        if now - self._threads[1] >= _FRESH and self._ready:
            with contextlib.suppress(OSError):
                self._threads = (sum(self._client.nthreads().values()), now)
        return max(1, self._threads[0])

    def submit(self, task: StudyTask, compute: Callable[[], Any] | None = None) -> None:  # noqa: ARG002
        """Queue a task and return at once."""
        self._waiting.append(_Pending(task))
        self._fill()

    def outcomes(self) -> Iterator[Outcome]:
        """Yield outcomes as tasks finish, until no task is left.

        Raises
        ------
        ClusterLost
            If the scheduler or all local workers were lost and did not come back in time.
        ClusterError
            If a worker that joined later has another package version or cannot build the study.
        """
        while self._waiting or self._suspects or self._sent:
            self._fill()
            try:
                serial = self._finished.get(timeout=_POLL)
            except queue.Empty:
                if self._client.status not in ("running", "connecting", "newly-created"):
                    raise ClusterLost(
                        f"The dask scheduler at {self.address} went away and did not answer again "
                        f"within {self._options.patience:g} s; finished work is stored, and "
                        "--resume continues."
                    ) from None
                # Give up a local cluster that cannot start workers.
                # A cluster that this process did not start may get workers later
                self._deserted = 0.0 if self._threads[0] else self._deserted + _POLL
                if self._options.local and self._deserted >= _DESERTED:
                    raise ClusterLost(
                        "All worker processes on this machine died, and none could be started "
                        f"again within {_DESERTED:g} s; finished work is stored, and --resume "
                        "continues."
                    ) from None
                continue
            future, pending = self._sent.pop(serial)
            try:
                outcome = self._outcome(future, pending)
            finally:
                future.release()
                del future
                if self._ready:
                    self._fill()
            if outcome is not None:
                yield outcome

    def close(self, cancel: bool) -> None:
        """Leave the cluster; with `cancel`, first give up the running tasks."""
        futures = [future for future, _ in self._sent.values()]
        if cancel and futures and self._ready:
            with contextlib.suppress(Exception):
                self._client.cancel(futures, force=True)
        if cancel:
            self._levels.clear()
        self._waiting.clear()
        self._suspects.clear()
        self._sent.clear()
        self._closing.close()

    @property
    def _ready(self) -> bool:
        """Whether the client is connected to the scheduler."""
        return bool(self._client.status == "running")

    def _fill(self) -> None:
        """Submit tasks up to the limit.

        A task that may have killed its worker is submitted only while no other task runs.
        """
        most = _AHEAD * self.workers
        while len(self._sent) < most and self._ready:
            if self._suspects:
                if not self._sent:
                    self._send(self._suspects.popleft())
                return
            if not self._waiting or any(sent.deaths for _, sent in self._sent.values()):
                return
            self._send(self._waiting.popleft())

    def _send(self, pending: _Pending) -> None:
        serial = next(self._serials)
        # Dask groups tasks by the first entry of their keys, and keeps statistics of each group.
        # All tasks of a study have the same first entry, so dask has only one group of tasks
        key = (self._name, pending.task.key, str(serial))
        arguments = (self._compute, self._text, pending.task, self._options.time_limit)
        future = self._client.submit(compute_elsewhere, *arguments, key=key, pure=False, retries=0)
        self._sent[serial] = future, pending
        future.add_done_callback(lambda _: self._finished.put(serial))

    def _outcome(self, future: Any, pending: _Pending) -> Outcome | None:
        """Return the outcome of a task that dask reports as done, or None if the task was lost."""
        from distributed import KilledWorker

        try:
            # Fetching a result may take long: if the worker has died, the task is computed again
            outcome, occupied = future.result(timeout=_DESERTED)
        except (concurrent.futures.CancelledError, asyncio.CancelledError):
            return self._resubmit(pending)
        except WorkerRefused as refusal:
            raise ClusterError(str(refusal)) from None
        except KilledWorker as error:
            # A task whose workers died is retried alone; if its workers die again, the task fails
            total = pending.deaths + getattr(error, "allowed_failures", 0) + 1
            if not pending.deaths:
                self._suspects.append(pending._replace(deaths=total))
                return None
            reason = (
                f"{total} workers died while computing it; it may need more memory than a worker "
                "has (see the worker's log)."
            )
            return Outcome(task=pending.task, error=reason)
        except OSError as error:
            if future.status == "error":
                return Outcome(task=pending.task, error=explain(error))
            return self._resubmit(pending)  # the connection broke while the result was fetched
        except Exception as error:  # noqa: BLE001 - dask may raise anything
            return Outcome(task=pending.task, error=explain(error))
        if occupied:  # An abandoned task still occupies this worker: restart the worker
            holders = self._client.who_has([future]).values()
            workers = [each for of in holders for each in of]

            def restart() -> None:
                with contextlib.suppress(Exception):  # The worker may have ended
                    self._client.restart_workers(workers, timeout=60, raise_for_error=False)

            threading.Thread(target=restart, daemon=True).start()
        result: Outcome = outcome
        return result

    def _resubmit(self, pending: _Pending) -> Outcome | None:
        """Resubmit a task that was lost with the connection; after too many losses it fails."""
        if pending.losses == _RESUBMISSIONS:
            reason = f"It was lost with the connection to the scheduler {pending.losses + 1} times."
            return Outcome(task=pending.task, error=reason)
        self._waiting.appendleft(pending._replace(losses=pending.losses + 1))
        return None

    def _refuse_other_versions(self) -> None:
        """Raise a `ClusterError` that names each worker with another version of this package."""
        found = self._client.run(metadata.version, "mcspectra", on_error="return")
        others = {
            worker: "no version" if isinstance(version, Exception) else version
            for worker, version in found.items()
            if version != self._text.version
        }
        if others:
            hosts = self._client.run(socket.gethostname, workers=list(others))
            named = ", ".join(f"{hosts[each]} ({each}) has {has}" for each, has in others.items())
            raise ClusterError(
                f"The study is run by mcspectra {self._text.version}, but {named}; "
                "install the same version on every worker."
            )


class _SchedulerFile(msgspec.Struct):
    """The part of a dask scheduler file that is used here."""

    address: str


def _connected(options: Cluster, opened: contextlib.ExitStack) -> Any:
    """Return a client of a new local cluster or of a running one; `opened` closes both."""
    import distributed

    make: Any = distributed.Client
    try:
        if options.local:
            target: Any = _local_cluster(options, opened)
        else:
            target = options.address
            if target.endswith(".json"):
                try:
                    with decoding.opened(target, "a file of a dask scheduler") as (
                        stream,
                        *_,
                    ):
                        text = stream.read(_MOST_SCHEDULER)
                    target = msgspec.json.decode(text, type=_SchedulerFile).address
                except (FileFormatError, msgspec.DecodeError) as error:
                    raise ParameterError(
                        f"{shown(target)} is not a file written by a dask scheduler "
                        f"(--scheduler-file): {str(error).rstrip('.')}."
                    ) from error
            _greet_scheduler(target, options.patience)
        client = make(target, timeout=options.patience, set_as_default=False)
    except (OSError, RuntimeError, ValueError, TypeError) as error:
        if isinstance(error, McspectraError):
            raise
        reason = " ".join(str(error).split()).rstrip(".")
        raise ClusterError(
            f"No cluster can be started on {options.host}: {reason}."
            if options.local
            else f"No dask scheduler answers at {options.address} within {options.patience:g} s "
            f"({reason}); check the address, dask's TLS configuration, and that the scheduler runs."
        ) from error

    def close() -> None:
        with contextlib.suppress(Exception):
            client.close(timeout=_CLOSING)

    opened.callback(close)
    return client


def _greet_scheduler(address: str, patience: float) -> None:
    """Raise OSError if no scheduler answers, because dask's client would wait forever."""
    from distributed import security, utils
    from distributed.comm import core

    connect, runner, safe = cast("Any", (core.connect, utils.LoopRunner, security.Security))

    async def identity() -> Any:
        arguments = safe().get_connection_args("client")
        stream = await connect(address, timeout=patience, **arguments)
        try:
            await stream.write({"op": "identity", "reply": True})
            return await stream.read()
        finally:
            stream.abort()

    found = runner().run_sync(identity, callback_timeout=2 * patience)
    if not isinstance(found, dict) or found.get("type") != "Scheduler":
        raise OSError("another program answers, not a scheduler")


def _local_cluster(options: Cluster, opened: contextlib.ExitStack) -> Any:
    """Start one-thread processes, and replace dead ones; `opened` closes all processes."""
    import dask
    import distributed
    from distributed import utils

    # Use as many BLAS threads as this process; dask's default of 1 would change last digits.
    # Wait for slow workers: by default, dask gives up a worker's nanny after 15 s
    configuration: dict[str, Any] = {
        "distributed.nanny.pre-spawn-environ": {"MALLOC_TRIM_THRESHOLD_": 65536},
        "distributed.deploy.lost-worker-timeout": _LONGEST_LIMIT,
    }
    make: Any = distributed.LocalCluster
    if sys.platform == "linux":
        # Fork workers from a process that has already imported the common packages
        configuration["distributed.worker.multiprocessing-method"] = "forkserver"
    # Keep this configuration while the cluster lives: replacement workers need it as well
    opened.enter_context(dask.config.set(configuration))
    if sys.platform == "linux":
        context: Any = utils
        context.get_mp_context().set_forkserver_preload(
            ["dask.array", "distributed", __name__, WARM]
        )
    # The cluster's thread also blocks Ctrl-C, because this thread starts replacement workers
    with deaf():
        cluster = make(
            n_workers=available_workers(options.workers),
            threads_per_worker=1,
            processes=True,
            host=options.host,
            # Without a dashboard, the scheduler's pages of text still need an address
            dashboard_address=f"{options.host}:{options.dashboard or 0}",
            scheduler_kwargs={"dashboard": options.dashboard is not None},
            memory_limit=0,  # The plan has already checked the memory
            env=dict(os.environ),  # Do not use the environment of an earlier cluster
            silence_logs=logging.CRITICAL,
        )
        opened.callback(cluster.close, timeout=_CLOSING)
    return cluster


def _muted(opened: contextlib.ExitStack) -> dict[logging.Handler, int]:
    """Keep dask's log off the terminal, because this package reports problems in its own messages.

    The log levels are restored when the context stack `opened` closes.
    After Ctrl-C the log remains off, because dask writes messages until the process ends.
    """
    levels = {each: each.level for each in logging.getLogger("distributed").handlers}

    def restore(kind: type[BaseException] | None, *_: object) -> None:
        if kind is None or issubclass(kind, Exception):
            for handler, level in levels.items():
                handler.setLevel(level)

    opened.push(restore)
    for handler in levels:
        handler.setLevel(logging.CRITICAL + 1)
    return levels


@contextlib.contextmanager
def deaf() -> Iterator[None]:
    """Make processes and threads that start in this context ignore Ctrl-C."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows has no pthread_sigmask
        yield
        return
    # Starting Python's resource tracker unblocks Ctrl-C in the current thread.
    # Start the tracker first, so that it does not undo the blocking of Ctrl-C
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
