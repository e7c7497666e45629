"""Executors: where tasks are computed. Threads of this process, or workers of a dask cluster.

An executor is given tasks and hands back outcomes in the order in which they finish. A failing task is
an outcome like any other; what the executor itself cannot go on after is raised.

Processes of this machine, which can be stopped (for time limits) and may crash, are a dask cluster too:
one rule says everywhere what becomes of tasks whose workers die. dask is imported when it is needed.
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
from pathlib import Path
from typing import Any, NamedTuple, Protocol, cast, final

import msgspec

from mcspectra.core.checks import as_integer, as_real
from mcspectra.core.display import shown
from mcspectra.core.errors import McspectraError, ParameterError
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

_GRACE = 5.0  # seconds that canceled threads have to finish: most chunks take about 1 s
_LONGEST_LIMIT = 1e9  # seconds, 30 years: clocks and waits take no more
_LOOPBACK = "127.0.0.1"
_ADDRESS = re.compile(
    r"(?:(tcp|tls)://)?[\w.-]+:\d{1,5}|(?:(tcp|tls)://)?\[[0-9a-fA-F:]+\]:\d{1,5}"
)
_AHEAD = 2  # tasks with the scheduler for each worker thread
_RESUBMISSIONS = 5  # of a task that is lost with the connection
_POLL = 0.5  # seconds between looks at the connection, or at threads
_FRESH = 2.0  # seconds for which the number of workers is believed
_DESERTED = 300.0  # seconds to wait for a worker of this machine, or for a result to arrive
_CLOSING = 5.0  # seconds to say goodbye


class Executor(Protocol):
    """Computes tasks of one study, several at once."""

    @property
    def workers(self) -> int:
        """How many tasks it computes at once."""

    def submit(self, task: StudyTask, compute: Callable[[], Any]) -> None:
        """Have a task computed, now or later; `compute` does so in a thread of this process."""

    def outcomes(self) -> Iterator[Outcome]:
        """Wait for the next task that finishes, in any order; ends when none is under way."""

    def close(self, cancel: bool) -> None:
        """Stop the workers; with `cancel` without what has not begun."""


def check_time_limit(value: float | None) -> float | None:
    """Return a time limit in seconds after checking it; None is none."""
    if value is None:
        return None
    return as_real("time_limit", value, above=0.0, most=_LONGEST_LIMIT)


@final
class Threads:
    """Threads of this process: states cross as objects."""

    def __init__(self, workers: int) -> None:
        self._tasks: queue.SimpleQueue[tuple[StudyTask, Callable[[], Any]] | None] = (
            queue.SimpleQueue()
        )
        self._finished: queue.SimpleQueue[Outcome] = queue.SimpleQueue()
        self._under_way = 0
        # Daemons: an integrand that hangs does not keep the program from ending.
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
        """Have a task computed by the next thread that is free."""
        self._under_way += 1
        self._tasks.put((task, compute))

    def outcomes(self) -> Iterator[Outcome]:
        """Yield each task when it finishes; end when no task is running.

        Raises
        ------
        ClusterLost
            A thread has ended, as without memory, so that its task has no outcome.
        """
        while self._under_way:
            try:
                outcome = self._finished.get(timeout=_POLL)
            except queue.Empty:
                if all(thread.is_alive() for thread in self._threads):
                    continue
                raise ClusterLost(
                    "A thread of this run has ended before its task, as it may where memory is short; "
                    "finished work is stored, and --resume continues."
                ) from None
            self._under_way -= 1
            yield outcome

    def close(self, cancel: bool) -> None:
        """Stop the threads; with `cancel` drop tasks that wait, and wait for those that run 5 s."""
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
    """A cluster cannot be reached, or its workers cannot run the study."""


class ClusterLost(ClusterError):
    """The scheduler or all workers went away while a study ran; what was finished is stored."""


@final
@dataclass(frozen=True, kw_only=True)
class Cluster:
    """Where dask's workers are. TLS is dask's own: ``distributed.comm`` in its configuration.

    Attributes
    ----------
    address
        ``local`` starts worker processes on this machine; ``tcp://HOST:PORT`` or ``tls://HOST:PORT``
        is a scheduler that runs already, a path that ends in .json the file that it wrote.
    workers
        Worker processes of one thread each, for ``local``; all processors by default.
    host
        Where the scheduler of ``local`` listens: this machine alone can reach the default.
    dashboard
        Port of dask's dashboard, for ``local``; 0 takes a free one.
    time_limit
        Seconds after which a task has failed and its worker is restarted. The compilation of a kernel
        that is used for the first time on a machine counts.
    patience
        Seconds to wait for the scheduler, at the start and when the connection is lost.

    Raises
    ------
    ParameterError
        A value is out of range, or two do not go together.
    """

    address: str = "local"
    workers: int | None = None
    host: str = _LOOPBACK
    dashboard: int = 0
    time_limit: float | None = None
    patience: float = 30.0

    def __post_init__(self) -> None:
        as_integer("dashboard", self.dashboard, least=0, most=65535)
        as_real("patience", self.patience, above=0.0)
        check_time_limit(self.time_limit)
        available_workers(self.workers)
        if self.local:
            return
        if self.workers is not None or self.host != _LOOPBACK or self.dashboard:
            raise ParameterError(
                f"The cluster at {self.address} has its own workers, host and dashboard; give those "
                "options with the cluster 'local' only."
            )
        if not self.address.endswith(".json") and not _ADDRESS.fullmatch(self.address):
            raise ParameterError(
                f"The cluster's address is {self.address!r}; give tcp://HOST:PORT, tls://HOST:PORT, "
                "the .json file that the scheduler wrote, or 'local'."
            )

    @property
    def local(self) -> bool:
        """Whether the cluster is started for this study, on this machine."""
        return self.address == "local"


class _Pending(NamedTuple):
    """A task that has no outcome yet.

    Attributes
    ----------
    losses
        How often it was lost with the connection.
    deaths
        How many workers died while they had it, by the scheduler's count.
    """

    task: StudyTask
    losses: int = 0
    deaths: int = 0


@final
class Dask:
    """Computes tasks on the workers of a dask cluster.

    The scheduler resubmits tasks whose worker dies; here those are resubmitted that were under way
    when the connection to the scheduler was lost and found again. A worker that dies takes tasks with
    it that are not to blame; those that the scheduler gives up come again, each alone. At most two
    tasks a worker thread are with the scheduler, results that were not fetched yet among them, so that
    nothing grows with the study.

    Parameters
    ----------
    text
        The study.
    cluster
        Where the workers are.
    compute
        What computes a task on a worker: a function that workers can import.

    Raises
    ------
    ClusterError
        The scheduler does not answer, or a worker has another version of this package.
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
        # Before its log is muted
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
        """Worker threads of the cluster; 1 while there are none, so that tasks wait for the first."""
        now = time.monotonic()
        if now - self._threads[1] >= _FRESH and self._ready:
            with contextlib.suppress(OSError):
                self._threads = (sum(self._client.nthreads().values()), now)
        return max(1, self._threads[0])

    def submit(self, task: StudyTask, compute: Callable[[], Any] | None = None) -> None:  # noqa: ARG002
        """Have a task computed; returns at once."""
        self._waiting.append(_Pending(task))
        self._fill()

    def outcomes(self) -> Iterator[Outcome]:
        """Yield outcomes as tasks finish, until none is left.

        Raises
        ------
        ClusterLost
            The scheduler, or all workers on this machine, went away and did not come back in time.
        ClusterError
            A worker that joined later has another version of this package, or cannot build the study.
        """
        while self._waiting or self._suspects or self._sent:
            self._fill()
            try:
                serial = self._finished.get(timeout=_POLL)
            except queue.Empty:
                if self._client.status not in ("running", "connecting", "newly-created"):
                    raise ClusterLost(
                        f"The dask scheduler at {self.address} has gone and did not answer again within "
                        f"{self._options.patience:g} s; finished work is stored, and --resume continues."
                    ) from None
                # Give up a cluster of this machine that cannot start workers; others may get some later
                self._deserted = 0.0 if self._threads[0] else self._deserted + _POLL
                if self._options.local and self._deserted >= _DESERTED:
                    raise ClusterLost(
                        "All worker processes on this machine have died, and none could be started again "
                        f"within {_DESERTED:g} s; finished work is stored, and --resume continues."
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
        """Leave the cluster; with `cancel` tasks under way are given up first."""
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
        """Whether the scheduler is there."""
        return bool(self._client.status == "running")

    def _fill(self) -> None:
        """Send as many tasks as the cluster should have; a suspect while it has no other."""
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
        # Dask counts keys by the first entry for ever, so that it must be the same for all tasks.
        key = (self._name, pending.task.key, str(serial))
        arguments = (self._compute, self._text, pending.task, self._options.time_limit)
        future = self._client.submit(compute_elsewhere, *arguments, key=key, pure=False, retries=0)
        self._sent[serial] = future, pending
        future.add_done_callback(lambda _: self._finished.put(serial))

    def _outcome(self, future: Any, pending: _Pending) -> Outcome | None:
        """What became of a task that is done in dask's eyes; None if it was lost."""
        from distributed import KilledWorker

        try:
            # May wait: if the worker has died since, the task is computed again.
            outcome, occupied = future.result(timeout=_DESERTED)
        except (concurrent.futures.CancelledError, asyncio.CancelledError):
            return self._resubmit(pending)
        except WorkerRefused as refusal:
            raise ClusterError(str(refusal)) from None
        except KilledWorker as error:
            # Try a task whose workers died once more, alone; if they die again it is to blame
            total = pending.deaths + getattr(error, "allowed_failures", 0) + 1
            if not pending.deaths:
                self._suspects.append(pending._replace(deaths=total))
                return None
            reason = (
                f"{total} workers died while computing it; it may need more memory than a worker has "
                "(the worker's log says more)."
            )
            return Outcome(task=pending.task, error=reason)
        except OSError as error:
            if future.status == "error":
                return Outcome(task=pending.task, error=explain(error))
            return self._resubmit(pending)  # the connection broke while the result was fetched
        except Exception as error:  # noqa: BLE001 - whatever kept dask from computing it
            return Outcome(task=pending.task, error=explain(error))
        if occupied:  # by the task that was given up: restart the worker that holds the result
            holders = self._client.who_has([future]).values()
            workers = [each for of in holders for each in of]

            def restart() -> None:
                with contextlib.suppress(Exception):  # a worker without a nanny, or gone
                    self._client.restart_workers(workers, timeout=60, raise_for_error=False)

            threading.Thread(target=restart, daemon=True).start()
        result: Outcome = outcome
        return result

    def _resubmit(self, pending: _Pending) -> Outcome | None:
        """Have a task computed again that was lost with the connection, unless it often was."""
        if pending.losses == _RESUBMISSIONS:
            reason = f"It was lost {pending.losses + 1} times with the connection to the scheduler."
            return Outcome(task=pending.task, error=reason)
        self._waiting.appendleft(pending._replace(losses=pending.losses + 1))
        return None

    def _refuse_other_versions(self) -> None:
        """Raise `ClusterError` that names each worker with another version of this package."""
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
                f"The study is run by mcspectra {self._text.version}, but of its workers {named}; "
                "install the same version there."
            )


class _SchedulerFile(msgspec.Struct):
    """What a dask scheduler writes, as far as it matters here."""

    address: str


def _connected(options: Cluster, opened: contextlib.ExitStack) -> Any:
    """A client of a cluster that is started here, or of one that runs; `opened` closes both."""
    import distributed

    make: Any = distributed.Client
    try:
        if options.local:
            target: Any = _local_cluster(options, opened)
        else:
            target = options.address
            if target.endswith(".json"):  # the file that the scheduler wrote
                try:
                    found = msgspec.json.decode(Path(target).read_bytes(), type=_SchedulerFile)
                    target = found.address
                except (OSError, msgspec.DecodeError) as error:
                    raise ParameterError(
                        f"{shown(target)} is not a file that a dask scheduler wrote (--scheduler-file): "
                        f"{error}."
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
            f"({reason}); check the address, dask's configuration of TLS, and that it runs."
        ) from error

    def close() -> None:
        with contextlib.suppress(Exception):
            client.close(timeout=_CLOSING)

    opened.callback(close)
    return client


def _greet_scheduler(address: str, patience: float) -> None:
    """Raise OSError where nothing, or no scheduler, answers: dask's client would wait there for ever."""
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
        raise OSError("what answers is no scheduler")


def _local_cluster(options: Cluster, opened: contextlib.ExitStack) -> Any:
    """Processes of one thread each, which are replaced when they die; `opened` closes them."""
    import dask
    import distributed
    from distributed import utils

    # As many threads of BLAS as in this process, whose number changes last digits; dask's own is 1.
    # A worker that starts slowly is waited for; dask's own is to give its nanny up after 15 s.
    configuration: dict[str, Any] = {
        "distributed.nanny.pre-spawn-environ": {"MALLOC_TRIM_THRESHOLD_": 65536},
        "distributed.deploy.lost-worker-timeout": _LONGEST_LIMIT,
    }
    make: Any = distributed.LocalCluster
    if sys.platform == "linux":
        # Workers are forked from a process that has imported once what all of them need
        configuration["distributed.worker.multiprocessing-method"] = "forkserver"
    # For as long as the cluster lives, which starts workers that replace others
    opened.enter_context(dask.config.set(configuration))
    if sys.platform == "linux":
        context: Any = utils
        context.get_mp_context().set_forkserver_preload(["distributed", __name__, *WARM])
    # The cluster's thread is deaf too, which starts workers that replace others.
    with deaf():
        cluster = make(
            n_workers=available_workers(options.workers),
            threads_per_worker=1,
            processes=True,
            host=options.host,
            dashboard_address=f"{options.host}:{options.dashboard}",
            memory_limit=0,  # the plan has been held against the machine's
            env=dict(os.environ),  # as it is now, not when the first cluster was started
            silence_logs=logging.CRITICAL,
        )
        opened.callback(cluster.close, timeout=_CLOSING)
    return cluster


def _muted(opened: contextlib.ExitStack) -> dict[logging.Handler, int]:
    """Keep dask's log off the terminal: what matters is said in sentences.

    `opened` gives back the levels that are left in what is returned. After an interruption it gives none
    back: dask goes on closing, and logging, until the process ends.
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
    """Processes, and threads, that are started here do not hear Ctrl-C: it is for the command."""
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    # Its start, which the first process would bring about, ends by unblocking Ctrl-C in its thread.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
