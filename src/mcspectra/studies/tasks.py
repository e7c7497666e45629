"""Tasks: chunks of a study's cells that any process can compute from text alone.

A worker elsewhere is sent the study's text with every task, so that workers may join, die and be
replaced at any time without having been told about the study. It builds the plan itself, once, and
sends back states as `mcspectra.core.records` packs them.
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

_PLANS = 2  # kept in a process: the one that runs, and one that has just ended
_REDUCTIONS = 32  # kept in a process; those under way are few
_HELD = 2.0  # seconds beyond its time limit that a task may keep the worker from noticing

WARM = ("numba", "scipy.stats", "xarray")
"""Packages that every task needs."""


class StudyTask(msgspec.Struct, frozen=True, kw_only=True):
    """One chunk of a reduction of a cell, or all of a cell.

    Attributes
    ----------
    path
        The cell's.
    run
        Key of the reduction; None for all of the cell, which gives its dataset.
    chunk
        Which of its atomic blocks.
    cost
        Its work in the units of `mcspectra.core.analysis.Need.cost`.
    """

    path: str
    run: str | None
    chunk: Chunk = (0, 1)
    cost: float = 1.0

    @property
    def key(self) -> str:
        """Unique within the study: ``path/run/first+blocks``, or the path."""
        first, count = self.chunk
        return self.path if self.run is None else f"{self.path}/{self.run}/{first}+{count}"


@final
@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a task.

    Attributes
    ----------
    task
        Which.
    state
        State of its chunk, or the dataset of its cell, if it was computed in this process.
    payload
        The same as bytes, if it was computed in another.
    error
        One sentence about why it failed; then there is neither.
    seconds
        How long it ran.
    host
        Where.
    """

    task: StudyTask
    state: Any = None
    payload: bytes | None = None
    error: str | None = None
    seconds: float = 0.0
    host: str = ""


def timed(task: StudyTask, compute: Callable[[], Any]) -> Outcome:
    """Compute a task in this thread; whatever it raises becomes a sentence."""
    start = time.perf_counter()
    state, error = None, None
    try:
        state = compute()
    # An interrupt of the run reaches the main thread alone: here it is the integrand's own.
    except BaseException as raised:  # noqa: BLE001 - whatever the code of others does
        error = explain(raised)
    seconds = time.perf_counter() - start
    return Outcome(task=task, state=state, error=error, seconds=seconds, host=_host())


@functools.cache
def _host() -> str:
    return socket.gethostname()


class StudyText(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that a worker needs to rebuild a plan.

    Attributes
    ----------
    config_json
        The study, with overrides and grids applied.
    folder
        Where relative paths in spec strings start.
    seed
        Of all realizations.
    version
        Of this package; a worker of another refuses.
    code, paths
        What the study may name and read: see `mcspectra.studies.vetting.Trust`.
    force
        Whether its size was allowed.
    inputs
        Names and SHA-256 of the files that it depends on; None if any will do.
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
        """The text of a study; folders become absolute, as a worker may run elsewhere."""
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
        """Build the plan: its cells by their paths.

        Raises
        ------
        StoreError
            Files differ here.
        ConfigError
            The study cannot be built here: see `mcspectra.studies.plan.make_plan`.
        """
        config = study_of(json.loads(self.config_json))
        trust = Trust(self.code, tuple(map(Path, self.paths)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the command has planned, and warned, already
            plan = make_plan(config, Path(self.folder), trust, force=self.force)
        if self.inputs is not None:
            remedy = f"bring those on host {_host()!r} in line, and resume"
            check_inputs(dict(self.inputs), plan.inputs, "The study that is run is", remedy)
        return {cell.path: cell for cell in plan.cells}


_lock = threading.Lock()
_kept = functools.lru_cache(maxsize=_PLANS)(StudyText.cells)


def _cells(text: StudyText) -> dict[str, StudyCell]:
    """Cells of a study, whose plan is built once in a process."""
    with _lock:  # one thread builds the plan, the others wait for it
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
    """A reduction of a cell, the same object each time while it is in use."""
    cell = _cell(text, path)
    return cell.analysis.part(cell.subject, Stream.from_rng(text.seed), run)


Compute: TypeAlias = Callable[[StudyText, StudyTask], Outcome]
"""What computes a task on a worker, and raises nothing: `attempt`."""


def attempt(text: StudyText, task: StudyTask) -> Outcome:
    """Compute a task from text alone, in this thread: the outcome has bytes, as for other processes."""

    def compute() -> bytes:
        if task.run is None:
            return pack(_cell(text, task.path).compute(text.seed))
        return pack(compute_chunk(_reduction(text, task.path, task.run), task.chunk))

    outcome = timed(task, compute)
    return replace(outcome, state=None, payload=outcome.state)


class WorkerRefused(McspectraError, RuntimeError):
    """A worker cannot compute the study as it is meant: nothing it gave could be kept."""


def compute_elsewhere(
    compute: Compute, text: StudyText, task: StudyTask, limit: float | None
) -> tuple[Outcome, bool]:
    """What a worker of a cluster does with a task; nothing here knows dask.

    Parameters
    ----------
    compute
        Called with the study's text and the task.
    text, task
        The study and the part of it.
    limit
        Seconds after which the task has failed, its imports and the plan excepted. Its thread goes
        on, as threads cannot be stopped: the worker is to be restarted.

    Returns
    -------
    Outcome
        The task's.
    bool
        Whether it still occupies the worker.

    Raises
    ------
    WorkerRefused
        This worker has another version of the package, or cannot build the study.
    """
    if text.version != __version__:
        raise WorkerRefused(
            f"The worker on {_host()} has mcspectra {__version__}, but the study was "
            f"started with {text.version}; install the same version there."
        )
    if compute is attempt:
        try:
            for name in WARM:
                importlib.import_module(name)
            _cells(text)
        except BaseException as error:  # noqa: BLE001 - whatever the code of others does
            raise WorkerRefused(
                f"The worker on {_host()} cannot build the study: {explain(error)}"
            ) from None
    if limit is None:
        return compute(text, task), False
    with Path(os.devnull).open("w") as nowhere:
        # Ends the process where code holds Python's lock, so that nothing here would notice.
        faulthandler.dump_traceback_later(limit + _HELD, exit=True, file=nowhere)
        try:
            return within(limit, functools.partial(compute, text, task)), False
        except TookTooLong:
            sentence = f"It took longer than the time limit of {limit:g} s and was stopped."
            return Outcome(task=task, error=sentence, seconds=limit, host=_host()), True
        finally:
            faulthandler.cancel_dump_traceback_later()
