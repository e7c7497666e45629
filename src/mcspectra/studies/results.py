"""Open, count and export the results of studies.

A study's folder is read from its ledger.
At its end, a run writes the store ``results.zarr``.
This store and exported stores are meant for other programs.
The attribute ``tree_sha256`` of a store's root is the SHA-256 of all its files.
The digest is checked before any file is used.
A store may come from a stranger, so it is treated as data:
each array must be one chunk of uncompressed numbers.
An array then needs as much memory as its file, and numpy reads it without zarr's codecs.
"""

from __future__ import annotations

import contextlib
import csv
import fnmatch
import hashlib
import json
import math
import os
import shutil
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mcspectra.core.analysis import ANALYSES
from mcspectra.core.checks import as_path
from mcspectra.core.display import QUOTED, csv_cell, printable, register_accessor, shown
from mcspectra.core.errors import (
    McspectraError,
    MissingDependency,
    ParameterError,
    StoreError,
    UnknownName,
    reason_of,
    writing,
)
from mcspectra.core.memory import available_memory, shown_bytes
from mcspectra.core.records import unpack
from mcspectra.core.results import check_variables
from mcspectra.studies.files import Names, planned_groups, study_of
from mcspectra.studies.ledger import (
    FORMAT,
    LEDGER_NAME,
    STORE_NAME,
    Holder,
    Ledger,
    StudyNote,
    Survey,
    are_paths,
    is_held,
    lock_damage,
    refuse_links,
    scalars_of,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "FORMATS",
    "MOST_STORED",
    "AnalysisCount",
    "StudyStatus",
    "check_export",
    "export_results",
    "open_results",
    "output_folder",
    "result_paths",
    "result_scalars",
    "showing",
    "study_status",
    "write_zarr",
]

FORMATS = (".csv", ".zarr")
"""Extensions of the files that results can be exported to."""

MOST_STORED = 2000
"""Maximum number of cells for a store or a report; each cell takes 28 files and 8 ms."""

_FIRST = ("estimator", "sampler", "analysis", "n")
_LAST = ("variable", "value", "low", "high", "se", "unit")
_DIGEST = "tree_sha256"
_DOCUMENT = "zarr.json"
# Exceptions raised for a text that is not a study
_MALFORMED = (AttributeError, LookupError, TypeError, ValueError, McspectraError)
# Maximum number of metadata documents in the root of a store, because readers load the whole root
_MOST_DOCUMENTS = 100_000


class AnalysisCount(msgspec.Struct, frozen=True):
    """Numbers of finished, failed, missing and damaged cells of one analysis."""

    done: int = 0
    failed: int = 0
    missing: int = 0
    damaged: int = 0


class StudyStatus(msgspec.Struct, frozen=True, kw_only=True):
    """State of a study's folder.

    Attributes
    ----------
    title, study_hash, seed
        Title, hash and seed of the study.
    versions
        Versions of the packages that computed the study.
    format
        Format of the ledger.
    state
        ``running`` while a process writes into the folder, ``finished`` if all cells are computed,
        otherwise ``unfinished``.
    holder
        Process that writes into the folder, or that ended without a note.
    hosts, started, finished
        Hosts that computed the study, and the times of its beginning and of its last cell.
        Times are in UTC, as ISO 8601.
    done, missing
        Paths of finished and of missing cells.
    failed, damaged
        Sentences that describe errors or damage, by path of the cell.
        Damaged parts that are not cells have names with blanks, such as ``list of cells``.
    recorded
        Number of recorded tasks of unfinished cells.
    results_bytes, ledger_bytes
        Size in bytes of the results, and of the ledger's file.
    verified
        Whether the ledger and ``results.zarr`` were checked completely against their digests.
    refusal
        Why this version cannot resume the study, or None if it can or if this was not verified.
    """

    title: str
    study_hash: str
    seed: int
    versions: dict[str, str]
    format: int
    state: str
    holder: Holder | None
    hosts: tuple[str, ...]
    started: str | None
    finished: str | None
    done: tuple[str, ...]
    failed: dict[str, str]
    missing: tuple[str, ...]
    damaged: dict[str, str]
    recorded: int
    results_bytes: int
    ledger_bytes: int
    verified: bool
    refusal: str | None = None

    @property
    def analyses(self) -> dict[str, AnalysisCount]:
        """Numbers of cells by analysis, which is the last part of a cell's path."""
        counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
        for kind in ("done", "failed", "missing", "damaged"):
            for path in getattr(self, kind):
                if are_paths([path]) and "/" in path:
                    counts[path[path.rfind("/") + 1 :]][kind] += 1
        return {name: AnalysisCount(**of) for name, of in sorted(counts.items())}


def open_results(source: str | Path, select: str | None = None) -> xr.DataTree:
    """Open the results of a study as a tree of datasets.

    Parameters
    ----------
    source
        Output folder of a study, whose ledger is read even during a run, or a ``.zarr`` folder.
    select
        Path of a cell, or a pattern such as ``"estimator/*"``; all cells by default.
        Only selected cells are read from a ledger; a store is always read and checked completely.
        If a single cell of a ledger is selected, the tree lacks the attribute ``study``.
        Reading the text of the study would take longer than reading the cell.

    Raises
    ------
    ParameterError
        If the source is not a path, or the selection is not a text.
    StoreError
        If there are no results, or no cell matches.
        If the results are damaged, changed, in another format, or contain unexpected arrays.
    """
    import xarray as xr

    attributes, cells = _opened(source, select, whole=False)
    return xr.DataTree.from_dict({"/": xr.Dataset(attrs=attributes), **cells})


def _opened(
    source: str | Path, select: str | None, *, whole: bool = True
) -> tuple[dict[str, Any], dict[str, xr.Dataset]]:
    """Return root attributes and cells; for a single cell without `whole`, ``study`` is omitted."""
    register_accessor()
    ledger = _ledger(source, select)
    if ledger is None:
        files = _files(source)
        root = json.loads(files[_DOCUMENT])["attributes"]
        root.pop(_DIGEST)
        cells = _read_store(files, str(source), select)
    else:
        with ledger:
            root = _root_attributes(ledger, whole=whole or not _is_path(select))
            paths = list(_selected(ledger, select))
            if "study" in root:
                stranger = _unplanned(root["study"], paths)
                if stranger is not None:
                    raise StoreError(
                        f"The ledger in {str(ledger.folder)!r} has the cell {shown(stranger)}, "
                        "which its study does not have, so no run wrote it; give another folder."
                    )
            cells = {path: _read_cell(ledger, path) for path in paths}
    if select is not None and not cells:
        raise StoreError(
            f"No cell of {str(source)!r} matches {shown(select)}; paths have the form "
            "estimator/sampler/analysis."
        )
    return root, cells


def result_paths(source: str | Path) -> tuple[str, ...]:
    """Return the paths of all finished cells, in the order of the study.

    Raises
    ------
    StoreError
        If there are no results, or they cannot be read.
    """
    ledger = _ledger(source)
    if ledger is None:
        return tuple(_read_store(_files(source), str(source), None))
    with ledger:
        return tuple(_selected(ledger, None))


def result_scalars(source: str | Path, select: str | None = None) -> dict[str, dict[str, float]]:
    """Return scalars of results, such as rates, by path. Scalars are variables without dims.

    The scalars of a study's folder are read by one query, without reading any result.

    Parameters
    ----------
    source, select
        Same as in `open_results`.

    Raises
    ------
    ParameterError, StoreError
        Same as in `open_results`, except that a pattern that matches no cell is not an error.
    """
    ledger = _ledger(source, select)
    if ledger is None:
        cells = _read_store(_files(source), str(source), select)
        return {path: scalars_of(cell) for path, cell in cells.items()}
    with ledger:
        found = ledger.scalars()
        return {path: found[path] for path in _selected(ledger, select) if path in found}


def study_status(folder: str | Path, *, verify: bool = False) -> StudyStatus:
    """Return the state of a study's folder, which may be in use, without changing it.

    Parameters
    ----------
    verify
        Check the ledger and ``results.zarr`` completely against their digests.
        The lock file of the folder is always checked.

    Raises
    ------
    StoreError
        If there are no results, or if they have another format.
        If the results are too damaged to identify their study.
    """
    root = as_path("folder", folder)
    if root.is_file():
        raise StoreError(
            f"{str(folder)!r} is not the output folder of a run; only such a folder has a status."
        )
    ledger = _ledger(folder, salvage=verify)
    if ledger is None:
        _files(folder)
        raise StoreError(
            f"{str(folder)!r} is an exported store; only a study's folder has a status."
        )
    refusal = None
    with ledger:
        if verify:  # The checks are the same as for --resume
            study: Any = {}
            # If the stored text of the study is damaged, `ledger.verify` reports this
            with contextlib.suppress(StoreError, ValueError, RecursionError):
                study = json.loads(ledger.config)
            parts = _planned(study).items()
            paths = [f"{e}/{s}/{a}" for e, (own, asked) in parts for s in own for a in asked]
            found = ledger.verify(paths)
            stranger = _unplanned(study, ledger.paths) if "file" not in found.damaged else None
            if stranger is not None and "text of the study" not in found.damaged:
                sentence = f"it has {stranger!r:.120}, which the study does not have"
                found.damaged["list of cells"] = sentence
            if "text of the study" not in found.damaged:
                with contextlib.suppress(*_MALFORMED, RecursionError):
                    note = StudyNote.of(study_of(study), ledger.study.inputs)
                    refusal = ledger.refusal(note, paths)
                    # The hashes differ if someone changed the text of the study, or its stored hash
                    if note.study_hash != ledger.study.study_hash:
                        found.damaged["the header"] = (
                            "it names another study than the stored text, so that --resume may "
                            "refuse the folder"
                        )
                        refusal = None
        else:
            done, failed = tuple(ledger.done), ledger.failures()
            missing = tuple(
                path for path in ledger.paths if path not in ledger.done and path not in failed
            )
            found = Survey(done, failed, ledger.recorded, missing, dict(ledger.damaged))
        tally, damaged = ledger.tally, found.damaged
    if verify and (root / STORE_NAME).exists():
        try:
            _files(root / STORE_NAME)
        except StoreError as error:
            damaged[f"the store {STORE_NAME}"] = str(error)
    trouble = lock_damage(root)
    if trouble is not None:
        damaged["the lock study.lock"] = trouble
    running, lacking = is_held(root), found.failed or found.missing or damaged
    return StudyStatus(
        title=ledger.study.title,
        study_hash=ledger.study.study_hash,
        seed=ledger.study.seed,
        versions={
            name.removeprefix("version_"): text for name, text in ledger.study.versions.items()
        },
        format=FORMAT,
        state="running" if running else "unfinished" if lacking else "finished",
        holder=tally.holder,
        hosts=tally.hosts,
        started=tally.started,
        finished=tally.finished,
        done=found.done,
        failed=found.failed,
        missing=found.missing,
        damaged=damaged,
        recorded=found.recorded,
        results_bytes=tally.size,
        ledger_bytes=(root / LEDGER_NAME).stat().st_size,
        verified=verify,
        refusal=refusal,
    )


def write_zarr(folder: Path) -> Path | None:
    """Write ``results.zarr`` in a study's folder from its ledger, and replace an earlier store.

    Returns
    -------
    Path or None
        The store; None for a study of more than 2,000 cells, which would take minutes.
        The function `export_results` writes a store of any size, or of selected cells.

    Raises
    ------
    StorageError
        If the store cannot be written; the ledger still has all results.
    """
    target = folder / STORE_NAME
    with Ledger.read(folder) as ledger:
        if len(ledger.done) > MOST_STORED:
            with contextlib.suppress(FileNotFoundError):
                shutil.rmtree(target)  # Remove the outdated store
            return None
        cells = ((path, _read_cell(ledger, path)) for path in _selected(ledger, None))
        attributes = _root_attributes(ledger)
        return _replaced(target, lambda partial: _write_store(attributes, cells, partial))


def export_results(source: str | Path, file: str | Path, select: str | None = None) -> Path:
    """Write results to a file; its extension sets the format.

    A ``.csv`` file is one table. It contains single numbers, and arrays over the counts n.
    The table also contains arrays over dims whose labels are names, such as the channels.
    The columns are estimator, sampler, analysis, n, the named dims, variable, value and unit.
    The columns low and high are the ends of the 95 % interval, and se is the standard error.
    A ``.zarr`` store has all results with their attributes.

    Parameters
    ----------
    source
        Same as in `open_results`.
    file
        Path of the file. An existing ``.csv`` is replaced; a ``.zarr`` must not exist.
    select
        Path of a cell, or a pattern; all cells by default.

    Returns
    -------
    Path
        Path of the written file.

    Raises
    ------
    ParameterError
        If the name has another extension, its folder does not exist, or a ``.zarr`` exists.
    StoreError
        If the results cannot be read, are damaged, or have no scalars for ``.csv``.
    StorageError
        If the file cannot be written.
    """
    target = check_export(file)
    attributes, cells = _opened(source, select)
    if target.suffix.lower() == ".zarr":
        return _replaced(target, lambda part: _write_store(attributes, cells.items(), part))
    rows = [row for cell in cells.values() for row in _scalar_rows(cell)]
    if not rows:
        raise StoreError(
            f"The results of {str(source)!r} have no scalars for a table; export to a .zarr store, "
            "which also holds arrays."
        )
    return _replaced(target, lambda part: _write_csv(rows, part))


def check_export(file: str | Path) -> Path:
    """Check, before anything is read, that `export_results` can write a file; return its path.

    Raises
    ------
    ParameterError
        If the name has another extension, its folder does not exist, or a ``.zarr`` exists.
    """
    target = as_path("file", file)
    if target.suffix.lower() not in FORMATS:
        raise ParameterError(
            f"{str(file)!r} has none of the extensions {' and '.join(FORMATS)}, which set the "
            "format: give .csv for a table of all scalars, .zarr for all results."
        )
    if not target.parent.is_dir():
        raise ParameterError(
            f"{str(target)!r} cannot be written: its folder does not exist; create it first."
        )
    if target.suffix.lower() == ".zarr" and target.exists():
        raise ParameterError(f"{str(target)!r} already exists; give another name.")
    return target


def output_folder(out: str | Path) -> Path:
    """Check the output folder of a study, because its ledger needs a local file system.

    Raises
    ------
    ParameterError
        If `out` is not a path, or is a URL, a file, or a name with an export extension.
    """
    folder = as_path("out", out)
    if "://" in str(out):
        raise ParameterError(
            f"The output folder {str(out)!r} is a URL; a study runs in a folder of this machine: "
            "give another --out."
        )
    if folder.suffix.lower() in FORMATS:
        raise ParameterError(
            f"The output folder {str(out)!r} is named like an exported file: give --out DIR, then "
            f"`mcspectra export DIR -o {folder.name}`."
        )
    if folder.exists() and not folder.is_dir():
        raise ParameterError(f"The output folder {str(out)!r} is a file; give another --out.")
    return folder


def _ledger(
    source: str | Path, select: str | None = None, *, salvage: bool = False
) -> Ledger | None:
    """Check `select`; open the ledger of a study's folder, or return None for a store."""
    root = as_path("source", source)
    given: Any = select
    if given is not None and not (isinstance(given, str) and given):
        raise ParameterError(
            f"select is {shown(select)}; give the path of a cell, or a pattern such as 'a/*'."
        )
    if not os.path.lexists(root / LEDGER_NAME):
        return None
    return Ledger.read(source, salvage=salvage)


def _is_path(select: str | None) -> bool:
    """Whether `select` is the path of one cell, not a pattern."""
    return select is not None and not any(sign in select for sign in "*?[")


def _selected(ledger: Ledger, select: str | None) -> Iterable[str]:
    """Return the paths of matching finished cells; refuse a damaged list of cells."""
    if select is not None and _is_path(select):
        return [select]
    done = ledger.done
    if ledger.damaged:
        name, reason = next(iter(ledger.damaged.items()))
        raise StoreError(
            f"The ledger in {str(ledger.folder)!r} is damaged, {name}: {reason}; `mcspectra run` "
            "with --resume keeps the sound parts and computes the rest again."
        )
    if select is None and ledger.tally.size > available_memory():
        raise StoreError(
            f"The results in {str(ledger.folder)!r} are {shown_bytes(ledger.tally.size)}, more "
            "than the memory of this machine: select a part."
        )
    return done if select is None else fnmatch.filter(done, select)


def _planned(study: Any) -> dict[str, tuple[Names, Names]]:
    """Return the names of samplers and analyses for each estimator of a study.

    The cells of the study have paths estimator/sampler/analysis with these names.
    The result is empty if `study` is not a study.
    """
    try:
        return planned_groups(study)
    except _MALFORMED:
        return {}


def _unplanned(study: Any, paths: Iterable[str]) -> str | None:
    """Return the first path that is not a cell of the study, or None if all are cells."""
    groups = _planned(study)
    for path in map(str, paths):  # In a forged store, paths may have any form
        first, _, rest = path.partition("/")
        sampler, _, analysis = rest.partition("/")
        samplers, analyses = groups.get(first, ({}, {}))
        if sampler not in samplers or analysis not in analyses:
            return path
    return None


@contextlib.contextmanager
def showing(source: str | Path) -> Iterator[None]:
    """Turn any exception while showing untrusted results into one sentence.

    Digests and variables were checked before, but not the consistency of numbers and attributes.
    """
    try:
        yield
    except (McspectraError, OSError):
        raise
    except Exception as error:
        raise StoreError(
            f"The results in {str(source)!r} cannot be shown ({type(error).__name__}: "
            f"{reason_of(error, 200)}): they do not have the form of this version; run the study "
            "again with another --out."
        ) from error


def _read_cell(ledger: Ledger, path: str) -> xr.Dataset:
    """Read a cell in the form of a store; texts become attributes, as Zarr v3 lacks a text type.

    The labels of a coordinate are stored as the attribute ``labels_<name>``.
    The labels of the dim ``bound`` are equal in all cells, and are stored once for all cells.
    """
    import xarray as xr

    try:
        cell: xr.Dataset = unpack(xr.Dataset, ledger.result(path))
        if not are_paths([path]):
            raise StoreError(
                f"The cell {shown(path)} was not written by a run; give another folder."
            )
        with contextlib.suppress(MissingDependency, UnknownName):  # The package is not installed
            name = path.rpartition("/")[2]
            check_variables(cell, ANALYSES.load(name).variables, name)
    except StoreError:
        raise
    except McspectraError as error:
        raise StoreError(f"The cell {path} in {str(ledger.folder)!r} is damaged: {error}") from None
    texts = [str(name) for name, values in cell.variables.items() if values.dtype.kind in "UOT"]
    labels = {f"labels_{name}": cell[name].values.tolist() for name in texts if name != "bound"}
    return cell.drop_vars(texts).assign_attrs(labels)


def _root_attributes(ledger: Ledger, *, whole: bool = True) -> dict[str, Any]:
    try:
        study = {"study": msgspec.json.decode(ledger.config)} if whole else {}
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        raise StoreError(
            f"The study in {str(ledger.folder)!r} was not written by a run; give another folder."
        ) from None
    return {
        "format": FORMAT,
        **study,
        "study_hash": ledger.study.study_hash,
        "bound": ["low", "high"],
        **ledger.study.versions,
    }


def _write_store(
    attributes: Mapping[str, Any], cells: Iterable[tuple[str, xr.Dataset]], folder: Path
) -> None:
    """Write a Zarr v3 store cell by cell. The root comes last, with the digest of all files.

    Files from xarray and zarr have the same bytes but take five times as long (decisions/0016).
    """
    from xarray.conventions import encode_dataset_coordinates

    documents: dict[str, dict[str, Any]] = {}
    digests: dict[str, str] = {}
    for path, cell in cells:
        if "\\" in path or ":" in path or not {"", ".", ".."}.isdisjoint(path.split("/")):
            raise StoreError(
                f"The results have a cell {path[:100]!r}, which is not a valid path in a store."
            )
        variables, own = encode_dataset_coordinates(cell)
        above = {str(parent): _group() for parent in Path(path).parents[-2::-1]}
        made = {name: each for name, each in above.items() if name not in documents}
        made[path] = _group(own)
        made |= {f"{path}/{name}": _array_document(each) for name, each in variables.items()}
        files = {
            f"{name}/{_DOCUMENT}": json.dumps(e, indent=2).encode() for name, e in made.items()
        }
        for name, each in variables.items():
            if each.size:
                numbers = np.asarray(each.values, each.dtype.newbyteorder("<"))
                files["/".join([path, str(name), "c", *"0" * each.ndim])] = numbers.tobytes()
        for name, content in files.items():
            digests[name] = hashlib.sha256(content).hexdigest()
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        documents |= made

    # Copy all documents into the root, if they are not too many: readers then need one file
    root: dict[str, Any] = _group(attributes)
    if len(documents) < _MOST_DOCUMENTS:
        inline = {"kind": "inline", "must_understand": False}
        for name, document in documents.items():
            if document["node_type"] == "group":
                documents[name] = {**document, "consolidated_metadata": {**inline, "metadata": {}}}
        root["consolidated_metadata"] = {**inline, "metadata": documents}
    root["attributes"][_DIGEST] = _tree_digest(root, digests)
    folder.mkdir(exist_ok=True)
    (folder / _DOCUMENT).write_bytes(json.dumps(root).encode())


def _group(attributes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the content of the file ``zarr.json`` that describes a group of a Zarr store."""
    return {"attributes": dict(attributes or {}), "zarr_format": 3, "node_type": "group"}


def _array_document(variable: xr.Variable) -> dict[str, Any]:
    """Return the metadata document of an array of a store: one chunk without compression."""
    kind, shape = variable.dtype, list(variable.shape)
    chunk = {"chunk_shape": [max(1, size) for size in shape]}
    return {
        "shape": shape,
        "data_type": kind.name,
        "chunk_grid": {"name": "regular", "configuration": chunk},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": {"f": "NaN", "c": [0.0, 0.0], "b": False}.get(kind.kind, 0),
        "codecs": _codecs(kind),
        "attributes": dict(variable.attrs),
        **({"dimension_names": list(variable.dims)} if shape else {}),
        "zarr_format": 3,
        "node_type": "array",
        "storage_transformers": [],
    }


def _codecs(kind: np.dtype[Any]) -> list[dict[str, Any]]:
    """Return the only allowed codecs of a store, which write numbers as their bytes."""
    order = {"configuration": {"endian": "little"}} if kind.itemsize > 1 else {}
    return [{"name": "bytes", **order}]


def _tree_digest(root: Mapping[str, Any], digests: Mapping[str, str]) -> str:
    """Return the SHA-256 of a store's files and of its root's metadata, except the digest."""
    attributes = {key: value for key, value in root["attributes"].items() if key != _DIGEST}
    whole = {"root": {**root, "attributes": attributes}, "files": dict(digests)}
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()


def _read_store(
    files: Mapping[str, bytes], source: str, select: str | None
) -> dict[str, xr.Dataset]:
    """Return the matching cells of a store; refuse unexpected arrays.

    An array must be one chunk of uncompressed numbers.
    An array with one chunk needs no more memory than its file.
    """
    import xarray as xr

    cells: dict[str, dict[str, Any]] = {}
    try:
        # The root lists arrays in the order of writing, unless there are too many arrays
        root = json.loads(files[_DOCUMENT]).get("consolidated_metadata", {"metadata": {}})
        end = f"/{_DOCUMENT}"
        found = sorted(name.removesuffix(end) for name in files if name.endswith(end))
        for path in dict.fromkeys([*root["metadata"], *found]):
            document = json.loads(files[path + end])
            cell, _, array = path.rpartition("/")
            if document["node_type"] != "array" or (select and not fnmatch.fnmatch(cell, select)):
                continue
            kind, shape = np.dtype(document["data_type"]), document["shape"]
            content = files.get("/".join([path, "c", *("0" for _ in shape)]), b"")
            size = math.prod(shape) * kind.itemsize
            # Accept arrays of numbers or Booleans only, not arrays of Python objects
            plain = kind.kind in "biufc" and document["codecs"] == _codecs(kind)
            chunk = [max(1, length) for length in shape]
            whole = document["chunk_grid"]["configuration"]["chunk_shape"] == chunk
            if not (plain and whole and len(content) == size):
                raise StoreError(
                    f"{source}: the array {path} is not one uncompressed chunk of "
                    f"{shown_bytes(size)}, which results require."
                )
            values = np.frombuffer(content, kind.newbyteorder("<")).astype(kind).reshape(shape)
            dims = document.get("dimension_names") or ()
            cells.setdefault(cell, {})[array] = (dims, values, document["attributes"])
        return {
            cell: xr.decode_cf(
                xr.Dataset(variables, attrs=json.loads(files[cell + end])["attributes"]),
                mask_and_scale=False,
                decode_times=False,
            )
            for cell, variables in cells.items()
        }
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        if isinstance(error, StoreError):
            raise
        raise StoreError(f"{source!r} is damaged: {reason_of(error, 200)}.") from None


def _files(source: str | Path) -> dict[str, bytes]:
    """Read all files of a store, by name.

    Raises
    ------
    StoreError
        If there is no store, or if it has links, exceeds the memory, is unreadable or was changed.
    """
    shown, place = str(source), Path(source)
    root = place if place.suffix == ".zarr" else place / STORE_NAME
    if not (root / _DOCUMENT).exists():
        raise StoreError(f"There are no results in {printable(shown, QUOTED)!r}.")
    try:
        for inner in root.iterdir():
            refuse_links(str(inner))
        inside = [path for path in root.rglob("*") if path.is_file()]
        size = sum(path.stat().st_size for path in inside)
        if size > available_memory():
            raise StoreError(
                f"{shown!r} has {shown_bytes(size)}, more than the memory of this machine."
            )
        files = {path.relative_to(root).as_posix(): path.read_bytes() for path in inside}
    except OSError as error:
        raise StoreError(f"{shown!r} cannot be read: {error.strerror}.") from None

    # Check that the files are complete and unchanged
    try:
        document = json.loads(files[_DOCUMENT])
        digest = document["attributes"].get(_DIGEST)
        version = document["attributes"].get("format")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise StoreError(f"{shown!r} is damaged: its {_DOCUMENT} cannot be read.") from None
    if version != FORMAT:
        raise StoreError(
            f"{shown!r} has store format {version!r:.80}, but this version reads {FORMAT}. "
            "xarray.open_datatree reads stores of earlier formats; for reports and exports use the "
            "version that wrote them, or run the study again with another --out."
        )
    digests = {name: hashlib.sha256(files[name]).hexdigest() for name in files if name != _DOCUMENT}
    if digest != _tree_digest(document, digests):
        raise StoreError(
            f"{shown!r} was changed after it was written: files were modified, removed or added. "
            "`mcspectra export` of the study's folder writes it again."
        )
    return files


def _replaced(target: Path, write: Callable[[Path], Any]) -> Path:
    """Write a file or folder under a temporary name, and rename it once it is complete."""
    partial = target.with_name(f".{target.name}.partial")
    with writing(target, StoreError):
        try:
            _remove(partial)
            write(partial)
            if partial.is_dir():
                _remove(target)
            partial.replace(target)
        finally:
            _remove(partial)
    return target


def _remove(place: Path) -> None:
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        if place.is_dir() and not place.is_symlink():
            shutil.rmtree(place)
        else:
            place.unlink()


def _scalar_rows(cell: xr.Dataset) -> Iterator[dict[str, Any]]:
    """Yield a cell's rows of the table of scalars; each row has texts and numbers by column."""
    about = cell.attrs
    names = ("estimator_name", "sampler_spec", "analysis")
    fixed: dict[str, Any] = {
        column: str(about.get(name) or "") for column, name in zip(_FIRST, names, strict=False)
    }
    fixed["n"] = about["n"] if isinstance(about.get("n"), int) else ""
    labels: dict[Hashable, list[Any]] = {}
    for dim, size in cell.sizes.items():
        texts = about.get(f"labels_{dim}")
        if isinstance(texts, list) and len(texts) == size:
            labels[dim] = [str(text) for text in texts]
        elif dim == "n" and dim in cell.variables:
            labels[dim] = cell[dim].values.tolist()
        elif dim == "channel":
            labels[dim] = list(range(size))

    for name, variable in cell.variables.items():
        # Find the dims of the variable; its interval and standard error become columns of its rows
        interval = variable.dims[-1:] == ("bound",) and variable.shape[-1] == 2
        dims = variable.dims[:-1] if interval else variable.dims
        stem, end = str(name)[:-3], str(name)[-3:]
        owner = cell.variables.get(stem) if end in ("_ci", "_se") else None
        if name in cell.dims or not labels.keys() >= set(dims):
            continue
        if owner is not None and owner.dims == dims and owner.dtype.kind != "c":
            continue
        ends, error = cell.variables.get(f"{name}_ci"), cell.variables.get(f"{name}_se")
        parts = {str(name): variable.values}
        if interval:
            parts, ends = {stem if end == "_ci" else str(name): np.empty(0)}, variable
        elif variable.dtype.kind == "c":
            parts = {f"{name}.real": variable.values.real, f"{name}.imag": variable.values.imag}
            ends = error = None
        unit = str(variable.attrs.get("units", ""))
        for part, values in parts.items():
            for place in np.ndindex(variable.shape[: len(dims)]):
                along = {str(dim): labels[dim][i] for dim, i in zip(dims, place, strict=True)}
                row = {**fixed, **along, "variable": part, "unit": unit}
                if not interval:
                    row["value"] = values[place].item()
                if ends is not None and ends.dims == (*dims, "bound") and ends.shape[-1] == 2:
                    row["low"], row["high"] = ends.values[place].tolist()
                if error is not None and error.dims == dims:
                    row["se"] = error.values[place].item()
                yield row


def _write_csv(rows: list[dict[str, Any]], file: Path) -> None:
    """Write a table; an apostrophe protects texts that a spreadsheet would run as formulas."""
    named = dict.fromkeys(column for row in rows for column in row)
    columns = [*_FIRST, *(each for each in named if each not in (*_FIRST, *_LAST)), *_LAST]
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        for row in [dict(zip(columns, columns, strict=True)), *rows]:
            writer.writerow(_plain(row.get(column, "")) for column in columns)


def _plain(cell: Any) -> Any:
    """Return a number, or a printable text that is not a formula."""
    return int(cell) if isinstance(cell, bool) else csv_cell(cell)
