"""Tasks are chunks of a study's cells that any process can compute from text alone.

Every task carries the study's text to the worker.
Workers may therefore join, die and be replaced at any time.
A worker builds the plan once, and returns partial sums packed by `mcspectra.core.records`.
"""

from __future__ import annotations

import faulthandler
import functools
import importlib
import json
import os
import socket
import threading
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias, final

import msgspec

from mcspectra.core.analysis import Chunk, Reduction, compute_chunk
from mcspectra.core.display import shown
from mcspectra.core.errors import McspectraError, StoreError
from mcspectra.core.records import pack
from mcspectra.core.streams import Stream
from mcspectra.studies.files import StudyConfig, plain_study, study_of
from mcspectra.studies.foreign_code import TookTooLong, explain, within
from mcspectra.studies.plan import StudyCell, make_plan
from mcspectra.studies.vetting import Trust, check_inputs
from mcspectra.version import __version__

__all__ = [
    "WARM",
    "Compute",
    "Outcome",
    "StudyTask",
    "StudyText",
    "WorkerRefused",
    "attempt",
    "compute_elsewhere",
    "timed",
]

_PLANS = 2  # A process keeps the plans of the current and of the last study
_REDUCTIONS = 32  # Maximum number of sums over blocks that a process keeps
_HELD = 2.0  # Seconds beyond the time limit after which a blocked worker process is ended

WARM = "mcspectra.studies.warm"
"""Module that imports what most tasks need; workers import it in advance."""


class StudyTask(msgspec.Struct, frozen=True, kw_only=True):
    """A part of a study that one worker computes: some blocks of a cell, or a whole cell.

    Attributes
    ----------
    path
        Path of the cell.
    run
        Name of the sum over blocks; None to compute the whole cell and return its dataset.
    chunk
        Number of the first block of realizations, and number of blocks.
    cost
        Work of the task, in the units of `mcspectra.core.analysis.Need.cost`.
    """

    path: str
    run: str | None
    chunk: Chunk = (0, 1)
    cost: float = 1.0

    @property
    def key(self) -> str:
        """Unique name within the study: ``path/run/first+blocks``, or the path."""
        first, count = self.chunk
        return self.path if self.run is None else f"{self.path}/{self.run}/{first}+{count}"


@final
@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result or failure of a task.

    Attributes
    ----------
    task
        The task.
    state
        Result of a task that this process computed:
        the sum over the blocks of the task, or the dataset of the whole cell.
    payload
        Result of a task that another process computed, as bytes.
    error
        Sentence on why the task failed; then `state` and `payload` are None.
    seconds
        Run time of the task in seconds.
    host
        Name of the host that ran the task.
    """

    task: StudyTask
    state: Any = None
    payload: bytes | None = None
    error: str | None = None
    seconds: float = 0.0
    host: str = ""


def timed(task: StudyTask, compute: Callable[[], Any]) -> Outcome:
    """Compute a task in this thread; an exception becomes the `error` of the outcome."""
    start = time.perf_counter()
    state, error = None, None
    try:
        state = compute()
    # Ctrl-C reaches only the main thread, so a KeyboardInterrupt here was raised by user code
    except BaseException as raised:  # noqa: BLE001 - user code may raise anything
        error = explain(raised)
    seconds = time.perf_counter() - start
    return Outcome(task=task, state=state, error=error, seconds=seconds, host=_host())


@functools.cache
def _host() -> str:
    return socket.gethostname()


class StudyText(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that a worker needs to rebuild the plan of a study.

    Attributes
    ----------
    config_json
        The study as JSON, with overrides and grids applied.
    folder
        Folder from which relative paths in specs start.
    seed
        Seed of all realizations.
    version
        Version of this package; a worker with another version refuses the study.
    code, paths
        Functions that the study may call, and folders that it may read.
        See `mcspectra.studies.vetting.Trust`.
    force
        Whether the user allowed a study of this size.
    inputs
        Names and SHA-256 of the files that the study depends on; None skips the comparison.
    """

    config_json: str
    folder: str
    seed: int
    version: str
    code: tuple[str, ...] = ()
    paths: tuple[str, ...] = ()
    force: bool = False
    inputs: tuple[tuple[str, str], ...] | None = None

    @staticmethod
    def of(
        config: StudyConfig,
        folder: Path,
        trust: Trust | None = None,
        *,
        force: bool = False,
        inputs: Mapping[str, str] | None = None,
    ) -> StudyText:
        """Make the text of a study; folders become absolute, because workers may run elsewhere."""
        reach = trust or Trust()
        return StudyText(
            config_json=json.dumps(plain_study(config)),
            folder=str(folder.absolute()),
            seed=config.seed,
            version=__version__,
            code=tuple(reach.code),
            paths=tuple(str(path.absolute()) for path in reach.folders),
            force=force,
            inputs=None if inputs is None else tuple(inputs.items()),
        )

    def cells(self) -> dict[str, StudyCell]:
        """Build the plan and return its cells by path.

        Raises
        ------
        StoreError
            If files on this machine differ from those of the study.
        ConfigError
            If the study cannot be built here: see `mcspectra.studies.plan.make_plan`.
        """
        config = study_of(json.loads(self.config_json))
        trust = Trust(self.code, tuple(map(Path, self.paths)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # The command has already shown these warnings
            plan = make_plan(config, Path(self.folder), trust, force=self.force)
        if self.inputs is not None:
            remedy = f"make the files on host {_host()!r} equal to those, then resume"
            check_inputs(dict(self.inputs), plan.inputs, "The study that is run is", remedy)
        return {cell.path: cell for cell in plan.cells}


_lock = threading.Lock()
_kept = functools.lru_cache(maxsize=_PLANS)(StudyText.cells)


def _cells(text: StudyText) -> dict[str, StudyCell]:
    """Return the cells of a study; each process builds the plan only once."""
    with _lock:  # One thread builds the plan while the others wait
        return _kept(text)


def _cell(text: StudyText, path: str) -> StudyCell:
    cell = _cells(text).get(path)
    if cell is None:
        raise StoreError(
            f"The study has no cell {shown(path)}; its text or its files have changed."
        )
    return cell


@functools.lru_cache(maxsize=_REDUCTIONS)
def _reduction(text: StudyText, path: str, run: str) -> Reduction[Any]:
    """Return the sum over blocks `run` of a cell, from a cache if possible."""
    cell = _cell(text, path)
    return cell.analysis.part(cell.subject, Stream.from_rng(text.seed), run)


Compute: TypeAlias = Callable[[StudyText, StudyTask], Outcome]
"""A function that computes a task on a worker and raises nothing, such as `attempt`."""


def attempt(text: StudyText, task: StudyTask) -> Outcome:
    """Compute a task in this thread from text alone; return the result as bytes."""

    def compute() -> bytes:
        if task.run is None:
            return pack(_cell(text, task.path).compute(text.seed))
        return pack(compute_chunk(_reduction(text, task.path, task.run), task.chunk))

    outcome = timed(task, compute)
    return replace(outcome, state=None, payload=outcome.state)


class WorkerRefused(McspectraError, RuntimeError):
    """A worker cannot compute the study correctly, so none of its results could be kept."""


def compute_elsewhere(
    compute: Compute, text: StudyText, task: StudyTask, limit: float | None
) -> tuple[Outcome, bool]:
    """Compute a task on a worker of a cluster; the function does not depend on dask.

    Parameters
    ----------
    compute
        Function that is called with the study's text and the task.
    text, task
        The study, and the task to compute.
    limit
        Seconds after which the task fails, not counting imports and planning.
        The thread of the task continues, because threads cannot be stopped.
        The caller must therefore restart the worker.

    Returns
    -------
    Outcome
        Outcome of the task.
    bool
        Whether the task still occupies the worker.

    Raises
    ------
    WorkerRefused
        If this worker has another version of the package, or cannot build the study.
    """
    if text.version != __version__:
        raise WorkerRefused(
            f"The worker on {_host()} has mcspectra {__version__}, but the study was "
            f"started with {text.version}; install the same version on that host."
        )
    if compute is attempt:
        try:
            importlib.import_module(WARM)
            _cells(text)
        except BaseException as error:  # noqa: BLE001 - user code may raise anything
            raise WorkerRefused(
                f"The worker on {_host()} cannot build the study: {explain(error)}"
            ) from None
    if limit is None:
        return compute(text, task), False
    with Path(os.devnull).open("w") as nowhere:
        # The function `within` cannot stop code that holds the interpreter lock.
        # If code holds the lock for too long, the whole process is ended
        faulthandler.dump_traceback_later(limit + _HELD, exit=True, file=nowhere)
        try:
            return within(limit, functools.partial(compute, text, task)), False
        except TookTooLong:
            sentence = f"It took longer than the time limit of {limit:g} s and was stopped."
            return Outcome(task=task, error=sentence, seconds=limit, host=_host()), True
        finally:
            faulthandler.cancel_dump_traceback_later()
