"""Tasks: chunks of a study's cells that any process can compute from text alone.

A worker is sent the study's text once and then tasks, small records of numbers and names. It builds the
plan itself and sends back arrays of numbers; neither way is anything pickled.
"""

from __future__ import annotations

import functools
import io
import math
import socket
import threading
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import FileFormatError, StoreError
from mcspectra.core.staged import Chunk, Run, Staged, Whole, compute, compute_chunk
from mcspectra.studies.cells import staged_cell
from mcspectra.studies.vetting import check_inputs
from mcspectra.studies.plan import Cell, Plan, make_plan
from mcspectra.studies.files import StudyConfig
from mcspectra.studies.vetting import Trust
from mcspectra.version import __version__

__all__ = [
    "WHOLE",
    "StudyText",
    "Task",
    "analysis_of",
    "compute_task",
    "keep_plan",
    "pack_payload",
    "prepare",
    "task_of",
    "unpack_payload",
]

WHOLE = -1
"""Part of the run that stands for all of a cell: one task computes it to its dataset."""

_PLANS = 2  # kept in a process: the one that runs, and one that has just ended
_ANALYSES = 32  # kept in a process; those under way are few


class Task(msgspec.Struct, frozen=True, kw_only=True):
    """One chunk of one run of one cell.

    Attributes
    ----------
    key
        Unique within the study, for people and for the journal: ``path/run/first+blocks``.
    path
        The cell's.
    run_part, first, realizations, blocks_total
        The run: see `mcspectra.core.staged.Run`.
    chunk_first, chunk_blocks
        Which of its atomic blocks.
    cost
        Work of the chunk in the units of the run.
    """

    key: str
    path: str
    run_part: int
    first: int
    realizations: int
    blocks_total: int
    chunk_first: int
    chunk_blocks: int
    cost: float

    @property
    def run(self) -> Run:
        """The run it is a chunk of."""
        return Run(
            part=self.run_part,
            first=self.first,
            realizations=self.realizations,
            blocks=self.blocks_total,
            cost=self.cost * self.blocks_total / self.chunk_blocks,
        )

    @property
    def chunk(self) -> Chunk:
        """First block and number of blocks."""
        return self.chunk_first, self.chunk_blocks


def task_of(path: str, run: Run, chunk: Chunk) -> Task:
    """The task that computes a chunk of a run of the cell at `path`."""
    return Task(
        key=f"{path}/{run.key}/{chunk[0]}+{chunk[1]}",
        path=path,
        run_part=run.part,
        first=run.first,
        realizations=run.realizations,
        blocks_total=run.blocks,
        chunk_first=chunk[0],
        chunk_blocks=chunk[1],
        cost=run.cost * chunk[1] / run.blocks,
    )


class StudyText(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that a worker needs to rebuild a plan.

    Attributes
    ----------
    config_json
        The study, with overrides and grids applied.
    folder
        Where relative paths in spec strings start.
    seed
        Of all realisations.
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
            config_json=msgspec.json.encode(config).decode(),
            folder=str(folder.absolute()),
            seed=config.seed,
            version=__version__,
            code=tuple(reach.code),
            paths=tuple(str(path.absolute()) for path in reach.folders),
            force=force,
            inputs=None if inputs is None else tuple(inputs.items()),
        )

    def plan(self) -> Plan:
        """Build the plan.

        Raises
        ------
        StoreError
            The text is of another version of this package, or files differ here.
        ConfigError
            The study cannot be built here: see `mcspectra.studies.plan.make_plan`.
        """
        if self.version != __version__:
            raise StoreError(
                f"The study is run by mcspectra {self.version}, and this worker has {__version__}; "
                "install the same version on all machines."
            )
        config = msgspec.json.decode(self.config_json, type=StudyConfig)
        trust = Trust(self.code, tuple(map(Path, self.paths)))
        plan = make_plan(config, Path(self.folder), trust, force=self.force)
        if self.inputs is not None:
            host = socket.gethostname()
            remedy = f"bring those on host {host!r} in line, and resume"
            check_inputs(dict(self.inputs), plan.inputs, "The study that is run is", remedy)
        return plan


_plans: dict[StudyText, dict[str, Cell]] = {}
_lock = threading.Lock()


def keep_plan(text: StudyText, plan: Plan) -> None:
    """Have tasks of this process take `plan`, which `text` gives now: its files may have changed."""
    _plans.pop(text, None)
    analysis_of.cache_clear()
    while len(_plans) >= _PLANS:
        _plans.pop(next(iter(_plans)))
    _plans[text] = {cell.path: cell for cell in plan.cells}


def prepare(text: StudyText) -> dict[str, Cell]:
    """Cells of a study by their paths: the plan is built once in a process.

    Raises
    ------
    StoreError, ConfigError
        As of `StudyText.plan`.
    """
    with _lock:  # one thread builds the plan, the others wait for it
        if text not in _plans:
            keep_plan(text, text.plan())
        return _plans[text]


@functools.lru_cache(maxsize=_ANALYSES)
def analysis_of(text: StudyText, path: str) -> Staged[Any]:
    """The analysis of the cell at `path`, the same object each time while it is in use.

    Raises
    ------
    StoreError
        The study has no such cell, or is run by another version of this package.
    """
    cell = prepare(text).get(path)
    if cell is None:
        raise StoreError(f"The study has no cell {path!r}; its text or its files have changed.")
    return staged_cell(cell, text.seed)


def compute_task(text: StudyText, task: Task) -> bytes:
    """Compute a task in this thread: the state of its chunk as `pack_payload` writes it.

    Raises
    ------
    Exception
        Whatever the estimator raises: `mcspectra.studies.foreign_code.explain` makes a sentence of it.
    """
    analysis = analysis_of(text, task.path)
    if task.run_part == WHOLE:
        analysis = Whole(functools.partial(compute, analysis, 1))
    return pack_payload(analysis.pack(compute_chunk(analysis, task.run, task.chunk)))


def pack_payload(arrays: Mapping[str, Array]) -> bytes:
    """Named numeric arrays as the bytes of an .npz file, the same bytes for the same arrays.

    Raises
    ------
    FileFormatError
        An array holds Python objects.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            if array.dtype.hasobject:
                raise FileFormatError(f"The array {name!r} holds Python objects, not numbers.")
            # ZipInfo has a fixed date, where ZipFile.write would put the time of day.
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
    return buffer.getvalue()


def unpack_payload(payload: bytes) -> dict[str, Array]:
    """Inverse of `pack_payload`; nothing larger than the payload is allocated.

    Raises
    ------
    FileFormatError
        The bytes are damaged, or hold anything but plain arrays.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(payload)) as archive:
            return {
                info.filename.removesuffix(".npy"): _array(_member(archive, info, len(payload)))
                for info in archive.infolist()
            }
    except FileFormatError:
        raise
    except (zipfile.BadZipFile, ValueError, OSError, EOFError, RuntimeError) as error:
        raise FileFormatError(f"The result of a task cannot be read: {error}.") from None


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, limit: int) -> bytes:
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > limit:
        raise FileFormatError(f"The array {info.filename!r} is compressed or larger than its file.")
    return archive.read(info)


def _array(raw: bytes) -> Array:
    """The array of a .npy file: its header must fit the bytes that follow."""
    stream = io.BytesIO(raw)
    if np.lib.format.read_magic(stream) != (1, 0):
        raise FileFormatError("The result of a task is in another version of the .npy format.")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    if dtype.hasobject:
        raise FileFormatError("The result of a task holds Python objects; only numbers are read.")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(raw) - stream.tell():
        raise FileFormatError(f"The result of a task claims shape {shape}, which it does not hold.")
    values = (
        np.frombuffer(raw, dtype, offset=stream.tell()) if math.prod(shape) else np.empty(0, dtype)
    )
    return values.reshape(shape, order="F" if fortran else "C").copy(order="K")
