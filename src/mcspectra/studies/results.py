"""Results of studies for reading: opened, counted, and written for others.

A study's folder is read from its ledger. ``results.zarr``, which a run writes at its end, and exported
stores are for other programs; each has the SHA-256 of its whole tree as the attribute ``tree_sha256``
of its root, which is checked here before anything of it is looked at. A store from a stranger is data:
its arrays are one chunk of bytes as they are, so that nothing decompresses, and what is claimed to be
there is there.
"""

from __future__ import annotations

import contextlib
import csv
import fnmatch
import hashlib
import importlib
import importlib.util
import itertools
import json
import math
import os
import shutil
import zipfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import google_crc32c
import msgspec
import numpy as np

from mcspectra.core.analysis import ANALYSES
from mcspectra.core.checks import Array, as_path
from mcspectra.core.display import register_accessor
from mcspectra.core.errors import (
    McspectraError,
    MissingDependency,
    ParameterError,
    StorageError,
    StoreError,
    UnknownName,
    reason_of,
    writing,
)
from mcspectra.core.memory import available_memory, check_memory, shown_bytes
from mcspectra.core.records import unpack
from mcspectra.core.results import check_variables
from mcspectra.studies.files import Names, planned_groups
from mcspectra.studies.ledger import (
    FORMAT,
    LEDGER_NAME,
    STORE_NAME,
    Holder,
    Ledger,
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
    "export_results",
    "open_results",
    "output_folder",
    "result_paths",
    "result_scalars",
    "showing",
    "study_status",
    "write_zarr",
]

FORMATS = (".csv", ".parquet", ".nc", ".json", ".zarr.zip", ".zarr")
"""Ends of names of files that results are exported to."""

MOST_STORED = 2000
"""Most cells that a run writes as a store and a report at its end: thirty files, and 6 ms, for each."""

_FIXED = ("estimator", "sampler", "analysis", "variable", "units")  # columns before the coordinates
_VALUES = ("value", "imaginary")  # columns after them
_KEY = "mcspectra"  # of metadata of Parquet
_DIGEST = "tree_sha256"
_DOCUMENT = "zarr.json"
_MOST_DOCUMENTS = 100_000  # that readers take all at once, from the root
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first that a zip file can hold: same results, same bytes
_GROUP = {"attributes": {}, "zarr_format": 3, "node_type": "group"}
_INLINE = {"kind": "inline", "must_understand": False}


class AnalysisCount(msgspec.Struct, frozen=True):
    """Numbers of cells of one analysis."""

    done: int = 0
    failed: int = 0
    missing: int = 0
    damaged: int = 0


class StudyStatus(msgspec.Struct, frozen=True, kw_only=True):
    """State of a study's folder.

    Attributes
    ----------
    title, study_hash, seed, versions
        Of the study, and of what computed it.
    format
        Of the ledger.
    state
        ``running`` while a process writes into it, ``finished`` when all cells are there,
        ``unfinished`` otherwise.
    holder
        Who writes into it, or did when it ended without a word.
    hosts, started, finished
        Where it was computed, when it was begun, and when all cells were there: UTC, ISO 8601.
    done, missing
        Paths of cells.
    failed, damaged
        Sentences by the paths of cells; damage of tasks and other parts too, whose names have blanks.
    recorded
        Number of states of tasks that wait for their cells.
    results_bytes, ledger_bytes
        Sizes: of the results, and of the file.
    verified
        Whether all of the ledger, and ``results.zarr``, were checked against their digests.
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

    @property
    def analyses(self) -> dict[str, AnalysisCount]:
        """Numbers by the analysis: the last part of a cell's path."""
        counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
        for kind in ("done", "failed", "missing", "damaged"):
            for path in getattr(self, kind):
                if " " not in path:
                    counts[path[path.rfind("/") + 1 :]][kind] += 1
        return {name: AnalysisCount(**of) for name, of in sorted(counts.items())}


def open_results(source: str | Path, select: str | None = None) -> xr.DataTree:
    """Open the results of a study as a tree of datasets.

    Parameters
    ----------
    source
        Output folder of a study, whose ledger is read, running or not; a ``.zarr`` folder, a
        ``.zarr.zip`` file, or a URL such as ``s3://bucket/x.zarr`` that fsspec opens.
    select
        Path of a cell, or a pattern such as ``"estimator/*"``; all cells by default. Those alone are
        read from a ledger; of stores, which are checked as a whole, all is. With the path of a cell of
        a ledger the root has no attribute ``study``, whose text takes longer to read than the cell.

    Raises
    ------
    ParameterError
        The source is no path, or `select` no text.
    StoreError
        There are no results, they are damaged, changed or of a format that this version does not read,
        no cell matches, or they hold what results never hold.
    MissingDependency
        A URL is given, and fsspec or what it needs for it is not installed.
    """
    return _opened(source, select, whole=False)


def _opened(source: str | Path, select: str | None, *, whole: bool = True) -> xr.DataTree:
    """Open results, with the study as an attribute: of a cell by its path only if `whole`."""
    import xarray as xr

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
                        f"The ledger in {str(ledger.folder)!r} has the cell {stranger!r:.120}, which its "
                        "study does not have: it is not as a run wrote it; give another folder."
                    )
            cells = {path: _read_cell(ledger, path) for path in paths}
    if select is not None and not cells:
        raise StoreError(f"No cell of {str(source)!r} matches {select!r}; paths are a/b/analysis.")
    return xr.DataTree.from_dict({"/": xr.Dataset(attrs=root), **cells})


def result_paths(source: str | Path) -> tuple[str, ...]:
    """Paths of all cells that are there, of a study's folder in their order.

    Raises
    ------
    StoreError
        There are no results, or they cannot be read.
    """
    ledger = _ledger(source)
    if ledger is None:
        return tuple(_read_store(_files(source), str(source), None))
    with ledger:
        return tuple(_selected(ledger, None))


def result_scalars(source: str | Path, select: str | None = None) -> dict[str, dict[str, float]]:
    """Numbers of results that stand alone, such as rates: variables without dims, by cells' paths.

    One query of a study's folder, which reads none of the results themselves.

    Parameters
    ----------
    source, select
        As of `open_results`.

    Raises
    ------
    ParameterError, StoreError
        As of `open_results`, but for cells that are not there.
    """
    ledger = _ledger(source, select)
    if ledger is None:
        cells = _read_store(_files(source), str(source), select)
        return {path: scalars_of(cell) for path, cell in cells.items()}
    with ledger:
        found = ledger.scalars()
        return {path: found[path] for path in _selected(ledger, select) if path in found}


def study_status(folder: str | Path, *, verify: bool = False) -> StudyStatus:
    """Look at a study's folder, which may be in use; nothing in it is changed.

    Parameters
    ----------
    verify
        Check all of the ledger, and ``results.zarr``, against their digests.

    Raises
    ------
    StoreError
        There are no results, they are of a format that this version does not read, or so damaged that
        they do not say of which study they are.
    """
    root = as_path("folder", folder)
    if _is_url(folder) or root.is_file():
        raise StoreError(
            f"{str(folder)!r} is not the output folder of a run; only such a folder has a status."
        )
    ledger = _ledger(folder, salvage=verify)
    if ledger is None:
        _files(folder)
        raise StoreError(
            f"{str(folder)!r} is an exported store; only a study's folder has a status."
        )
    with ledger:
        if verify:  # as --resume does
            study: Any = {}
            with contextlib.suppress(StoreError, ValueError, RecursionError):  # named below
                study = json.loads(ledger.config)
            parts = _planned(study).items()
            paths = [f"{e}/{s}/{a}" for e, (own, asked) in parts for s in own for a in asked]
            found = ledger.verify(paths)
            stranger = _unplanned(study, ledger.paths) if "file" not in found.damaged else None
            if stranger is not None and "text of the study" not in found.damaged:
                sentence = f"it has {stranger!r:.120}, which the study does not have"
                found.damaged["list of cells"] = sentence
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
    trouble = lock_damage(root) if verify else None
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
    )


def write_zarr(folder: Path) -> Path | None:
    """Write ``results.zarr`` of a study's folder from its ledger, in place of an earlier one.

    Returns
    -------
    Path or None
        The store; None for a study of more than 2,000 cells, which a tree of some thirty files a cell
        is no help for: `export_results` writes it, or a part, for who wants it.

    Raises
    ------
    StorageError
        It cannot be written; the ledger has all of it.
    """
    target = folder / STORE_NAME
    with Ledger.read(folder) as ledger:
        if len(ledger.done) > MOST_STORED:
            with contextlib.suppress(FileNotFoundError):
                shutil.rmtree(target)  # of fewer cells
            return None
        cells = ((path, _read_cell(ledger, path)) for path in _selected(ledger, None))
        attributes = _root_attributes(ledger)
        return _replaced(
            target, lambda partial: _write_folder(_store_files(attributes, cells), partial)
        )


def export_results(source: str | Path, file: str | Path, select: str | None = None) -> Path | str:
    """Write results to a file whose format its name's end tells.

    ``.csv`` and ``.parquet`` are one long table, a row for each number; ``.json`` has a list of cells
    with their arrays; ``.nc`` is netCDF 3 with variables ``<path of the cell>.<variable>``, slashes
    as dots; ``.zarr.zip`` and ``.zarr`` are stores in a zip file, in a folder, or at a URL that fsspec
    writes to. Numbers are written exactly, attributes are kept: in CSV as a first line that is a
    comment, in Parquet as metadata.

    Parameters
    ----------
    source
        What `open_results` takes.
    file
        A file is replaced if it is there, as a whole or not at all; a ``.zarr`` must not be there.
    select
        Path of a cell, or a pattern; all by default.

    Returns
    -------
    Path or str
        What was written; a str if it is a URL.

    Raises
    ------
    ParameterError
        The name has another end, a URL is given for something else than ``.zarr``, the file's folder
        is not there, or a ``.zarr`` is.
    StoreError
        The results cannot be read, are damaged, or a netCDF file cannot hold them.
    StorageError
        The file cannot be written.
    MissingDependency
        Parquet without pyarrow, URLs without fsspec.
    """
    as_path("file", file)
    name = str(file).lower()
    end = next((end for end in FORMATS if name.endswith(end)), None)
    if end is None:
        raise ParameterError(
            f"{str(file)!r} has none of the ends {', '.join(FORMATS)}; the end chooses the format."
        )
    if _is_url(file) and end != ".zarr":
        raise ParameterError(
            f"{str(file)!r} is a URL, where only a store can be written, with the end .zarr; export "
            "to a file of this machine, and copy it."
        )
    if _is_url(file):
        tree = _opened(source, select)
        with _remote(str(file), writing=True) as (files, base):
            if files.exists(base):
                raise StoreError(f"There is something at {str(file)!r} already; give another --to.")
            try:
                for name, content in _store_files(tree.attrs, _cells(tree)):
                    files.makedirs(f"{base}/{name}".rpartition("/")[0], exist_ok=True)
                    files.pipe(f"{base}/{name}", content)
            except BaseException:
                with contextlib.suppress(Exception):  # leave no half of a store
                    files.rm(base, recursive=True)
                raise
        return str(file)
    target = Path(file)
    if end == ".zarr" and target.exists():
        raise ParameterError(f"{str(target)!r} exists already; give another name.")
    if not target.parent.is_dir():
        raise ParameterError(
            f"{str(target)!r} cannot be written: there is no such folder; make it."
        )
    tree = _opened(source, select)
    return _replaced(target, lambda partial: _WRITERS[end](tree, partial))


def output_folder(out: str | Path) -> Path:
    """Check where a study is to run: its ledger needs a folder of a file system.

    Raises
    ------
    ParameterError
        It is no path, a URL, a file, or named as a store that `export_results` makes.
    """
    folder = as_path("out", out)
    if _is_url(out):
        raise ParameterError(
            f"The output folder {str(out)!r} is a URL, and a study runs in a folder of this machine: "
            "give --out DIR, then `mcspectra export DIR --to URL/results.zarr`."
        )
    if folder.suffix.lower() in (".zarr", ".zip"):
        raise ParameterError(
            f"The output folder {str(out)!r} is named as an exported store: give --out DIR, then "
            f"`mcspectra export DIR --to {folder.name}`."
        )
    if folder.exists() and not folder.is_dir():
        raise ParameterError(f"The output folder {str(out)!r} is a file; give another --out.")
    return folder


def _ledger(
    source: str | Path, select: str | None = None, *, salvage: bool = False
) -> Ledger | None:
    """The ledger of a source, if that is a study's folder, after a check of what is asked for."""
    root = as_path("source", source)
    given: Any = select
    if given is not None and not (isinstance(given, str) and given):
        raise ParameterError(
            f"select is {select!r:.80}; give the path of a cell, or a pattern such as 'a/*'."
        )
    if _is_url(source) or not os.path.lexists(root / LEDGER_NAME):
        return None
    return Ledger.read(source, salvage=salvage)


def _is_path(select: str | None) -> bool:
    """Whether cells are selected by a path, of one, and not by a pattern."""
    return select is not None and not any(sign in select for sign in "*?[")


def _selected(ledger: Ledger, select: str | None) -> Iterable[str]:
    """Paths of finished cells that match; a list that damage has changed is refused."""
    if select is not None and _is_path(select):
        return [select]
    done = ledger.done
    if ledger.damaged:
        name, reason = next(iter(ledger.damaged.items()))
        raise StoreError(
            f"The ledger in {str(ledger.folder)!r} is damaged, {name}: {reason}; `mcspectra run` with "
            "--resume keeps what is sound and computes the rest again."
        )
    if select is None and ledger.tally.size > available_memory():
        raise StoreError(
            f"The results in {str(ledger.folder)!r} are {shown_bytes(ledger.tally.size)}, more than "
            "the memory of this machine: select a part."
        )
    return done if select is None else fnmatch.filter(done, select)


def _planned(study: Any) -> dict[str, tuple[Names, Names]]:
    """Parts of the paths of a study's cells; none if a text is none of a study."""
    try:
        return planned_groups(study)
    except (AttributeError, LookupError, TypeError, ValueError, McspectraError):
        return {}


def _unplanned(study: Any, paths: Iterable[str]) -> str | None:
    """The first path that is none of a study's cells; None if all are."""
    groups = _planned(study)
    for path in paths:
        first, _, rest = path.partition("/")
        sampler, _, analysis = rest.partition("/")
        samplers, analyses = groups.get(first, ({}, {}))
        if sampler not in samplers or analysis not in analyses:
            return path
    return None


@contextlib.contextmanager
def showing(source: str | Path) -> Iterator[None]:
    """Make one sentence of whatever is raised as results are shown that a stranger may have made.

    Digests and variables are checked before; that numbers and attributes belong together is not.
    """
    try:
        yield
    except (McspectraError, OSError):
        raise
    except Exception as error:
        raise StoreError(
            f"The results in {str(source)!r} cannot be shown ({type(error).__name__}: "
            f"{reason_of(error, 200)}): they are not as this version computes them; run the study again "
            "with another --out."
        ) from error


def _read_cell(ledger: Ledger, path: str) -> xr.Dataset:
    """A cell as it is in a store too: texts as attributes, for which Zarr v3 has no stable type.

    Labels of a coordinate become ``labels_<name>``; those of ``bound``, in all cells the same, are the
    root's.
    """
    import xarray as xr

    try:
        cell: xr.Dataset = unpack(xr.Dataset, ledger.result(path))
        if not are_paths([path]):
            raise StoreError(
                f"The cell {path!r:.120} is none that a run writes; give another folder."
            )
        with contextlib.suppress(MissingDependency, UnknownName):  # of a package that is not here
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
            f"The study in {str(ledger.folder)!r} is not as a run writes it; give another folder."
        ) from None
    return {
        "format": FORMAT,
        **study,
        "study_hash": ledger.study.study_hash,
        "bound": ["low", "high"],
        **ledger.study.versions,
    }


def _store_files(
    attributes: Mapping[Any, Any], cells: Iterable[tuple[str, xr.Dataset]]
) -> Iterator[tuple[str, bytes]]:
    """Files of a store, cell by cell; those of the root come last."""
    from xarray.conventions import encode_dataset_coordinates

    documents: dict[str, Any] = {}
    digests: dict[str, str] = {}
    for path, cell in cells:
        variables, own = encode_dataset_coordinates(cell)
        made = {path: {"attributes": own, "zarr_format": 3, "node_type": "group"}}
        made |= {f"{path}/{name}": _array_document(each) for name, each in variables.items()}
        files = {
            f"{name}/{_DOCUMENT}": json.dumps(each, indent=2).encode()
            for name, each in made.items()
        }
        for name, variable in variables.items():
            if variable.size:
                content = np.asarray(variable.values, variable.dtype.newbyteorder("<")).tobytes()
                checksum = google_crc32c.value(content).to_bytes(4, "little")
                files["/".join([path, str(name), "c", *"0" * variable.ndim])] = content + checksum
        for parent in map(str, Path(path).parents):
            if parent != "." and parent not in documents:
                files[f"{parent}/{_DOCUMENT}"] = json.dumps(_GROUP).encode()
        for name, content in files.items():
            if "\\" in name or ":" in name or not {"", ".", ".."}.isdisjoint(name.split("/")):
                raise StoreError(
                    f"The results have a cell {path[:100]!r}, which is no path in a store."
                )
            digests[name] = hashlib.sha256(content).hexdigest()
            if name.endswith(_DOCUMENT):
                documents[name.removesuffix(f"/{_DOCUMENT}")] = json.loads(content)
            yield name, content
    root: dict[str, Any] = {**_GROUP, "attributes": dict(attributes)}
    if len(documents) < _MOST_DOCUMENTS:
        for document in documents.values():
            if document["node_type"] == "group":
                document["consolidated_metadata"] = {**_INLINE, "metadata": {}}
        root["consolidated_metadata"] = {**_INLINE, "metadata": documents}
    root["attributes"][_DIGEST] = _tree_digest(root, digests)
    yield _DOCUMENT, json.dumps(root).encode()


def _array_document(variable: xr.Variable) -> dict[str, Any]:
    """What Zarr says of an array: one chunk as it is, whose checksum shows changes to plain readers."""
    kind, shape = variable.dtype, list(variable.shape)
    order = {"configuration": {"endian": "little"}} if kind.itemsize > 1 else {}
    return {
        "shape": shape,
        "data_type": kind.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": shape}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": {"f": "NaN", "c": [0.0, 0.0], "b": False}.get(kind.kind, 0),
        "codecs": [{"name": "bytes", **order}, {"name": "crc32c"}],
        "attributes": dict(variable.attrs),
        **({"dimension_names": list(variable.dims)} if shape else {}),
        "zarr_format": 3,
        "node_type": "array",
        "storage_transformers": [],
    }


def _write_folder(files: Iterable[tuple[str, bytes]], folder: Path) -> None:
    made: set[Path] = set()
    for name, content in files:
        file = folder / name
        if file.parent not in made:
            file.parent.mkdir(parents=True, exist_ok=True)
            made.add(file.parent)
        file.write_bytes(content)


def _tree_digest(root: Mapping[str, Any], digests: Mapping[str, str]) -> str:
    """SHA-256 of a store: of its root's metadata without this, and of all other files."""
    attributes = {key: value for key, value in root["attributes"].items() if key != _DIGEST}
    whole = {"root": {**root, "attributes": attributes}, "files": dict(digests)}
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()


def _read_store(
    files: Mapping[str, bytes], source: str, select: str | None
) -> dict[str, xr.Dataset]:
    """Cells of a store that match; refuses arrays that results never hold.

    An array is one chunk of its numbers as they are, with a checksum of four bytes, so that it takes no
    more memory than its file.
    """
    import xarray as xr

    cells: dict[str, dict[str, Any]] = {}
    try:
        # The root has all arrays in the order in which they were written, if they are not too many.
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
            codecs = [codec["name"] for codec in document["codecs"]]
            plain = kind.kind in "biufc" and codecs == ["bytes", "crc32c"]  # numbers, no objects
            whole = document["chunk_grid"]["configuration"]["chunk_shape"] == shape
            if not (plain and whole and len(content) == size + 4 * (size > 0)):
                raise StoreError(
                    f"{source}: the array {path} is not one chunk of {shown_bytes(size)}, with a "
                    "checksum and without compression, as results are written."
                )
            values = np.frombuffer(content or bytes(16), kind.newbyteorder("<"), math.prod(shape))
            values = values.astype(kind).reshape(shape)
            dims = document.get("dimension_names", ())
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
    """All files of a store in a folder, a zip file, or at a URL, by their names in it.

    Raises
    ------
    StoreError
        There is none, it has links, is compressed or larger than memory, cannot be read, or is not
        as it was written.
    """
    shown, place = str(source), Path(source)
    files: dict[str, bytes] = {}
    if _is_url(source):
        with _remote(shown) as (remote, base):
            for tree in (base, f"{base}/{STORE_NAME}"):
                if not files and remote.exists(f"{tree}/{_DOCUMENT}"):
                    sizes = remote.find(tree, detail=True)
                    _check_size(sum(about.get("size") or 0 for about in sizes.values()), shown)
                    found = remote.cat(list(sizes)).items()
                    files = {name.removeprefix(f"{tree}/"): content for name, content in found}
        if not files:
            raise StoreError(f"There are no results in {shown!r}.")
    elif place.suffix == ".zip" and place.is_file():
        try:
            with zipfile.ZipFile(place) as archive:
                members = [info for info in archive.infolist() if not info.is_dir()]
                if any(info.compress_type != zipfile.ZIP_STORED for info in members):
                    raise StoreError(
                        f"{shown!r} is compressed, as `mcspectra export` does not: what it holds "
                        "might take any memory."
                    )
                _check_size(sum(info.file_size for info in members), shown)
                files = {info.filename: archive.read(info) for info in members}
        except StoreError:
            raise
        except Exception as error:  # noqa: BLE001 - zipfile raises much else for damaged directories
            raise StoreError(f"{shown!r} is damaged: {reason_of(error, 200)}.") from None
    else:
        root = place if place.suffix == ".zarr" else place / STORE_NAME
        if not (root / _DOCUMENT).exists():
            raise StoreError(f"There are no results in {shown!r}.")
        try:
            for inner in root.iterdir():
                refuse_links(str(inner))
            inside = [path for path in root.rglob("*") if path.is_file()]
            _check_size(sum(path.stat().st_size for path in inside), shown)
            files = {path.relative_to(root).as_posix(): path.read_bytes() for path in inside}
        except OSError as error:
            raise StoreError(f"{shown!r} cannot be read: {error.strerror}.") from None

    # Are they those that were written, all of them?
    try:
        document = json.loads(files[_DOCUMENT])
        digest = document["attributes"].get(_DIGEST)
        version = document["attributes"].get("format")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise StoreError(f"{shown!r} is damaged: its {_DOCUMENT} cannot be read.") from None
    if version != FORMAT:
        raise StoreError(
            f"{shown!r} has store format {version!r}; this version reads {FORMAT}. "
            "xarray.open_datatree reads stores of earlier formats as they are; for reports and exports "
            "of them take the version that wrote them, or run the study again into another folder."
        )
    digests = {name: hashlib.sha256(files[name]).hexdigest() for name in files if name != _DOCUMENT}
    if digest != _tree_digest(document, digests):
        raise StoreError(
            f"{shown!r} is not as it was written: files of it are changed, gone or new. "
            "`mcspectra export` of the study's folder writes it anew."
        )
    return files


def _is_url(place: str | Path) -> bool:
    """Whether a place is a URL, such as ``s3://bucket/out``, or a chain of them."""
    return isinstance(place, str) and ("://" in place or "::" in place)


@contextlib.contextmanager
def _remote(url: str, *, writing: bool = False) -> Iterator[tuple[Any, str]]:
    """The file system of a URL, and the path in it; what goes wrong there becomes a sentence."""
    if importlib.util.find_spec("fsspec") is None:
        raise MissingDependency(
            f"Opening {url!r} needs fsspec, which is not installed: pip install 'mcspectra[remote]'."
        )
    import fsspec  # type: ignore[import-untyped]

    opening, opened, kind = "Opening", "opened", StoreError
    try:
        files, path = fsspec.core.url_to_fs(url)
        if writing:
            opening, opened, kind = "Writing to", "written", StorageError
        yield files, path.rstrip("/")
    except StoreError:
        raise
    except ImportError as error:
        raise MissingDependency(f"{opening} {url!r} needs more: {reason_of(error, 200)}.") from None
    except Exception as error:  # noqa: BLE001 - file systems of fsspec raise what their libraries do
        raise kind(f"{url!r} cannot be {opened}: {reason_of(error, 200)}.") from None


def _check_size(size: int, source: str) -> None:
    if size > available_memory():
        raise StoreError(
            f"{source!r} has {shown_bytes(size)}, more than the memory of this machine."
        )


def _replaced(target: Path, write: Callable[[Path], Any]) -> Path:
    """Write a file, or a folder, beside its place and put it there when it is whole."""
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


def _cells(tree: xr.DataTree) -> Iterator[tuple[str, xr.Dataset]]:
    for node in tree.leaves:
        if node.has_data:
            yield node.path.lstrip("/"), node.to_dataset(inherit=False)


def _write_zip(tree: xr.DataTree, file: Path) -> None:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, content in _store_files(tree.attrs, _cells(tree)):
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), content)


def _write_csv(tree: xr.DataTree, file: Path) -> None:
    columns = (*_FIXED, *_columns(tree), *_VALUES)
    with file.open("w", encoding="utf-8", newline="") as stream:
        stream.write(f"# {_json(_attributes(tree), ascii_only=True)}\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        for table in _tables(tree):
            given = [np.asarray(table[c]).tolist() if c in table else None for c in columns]
            length = len(table["value"])
            writer.writerows(zip(*(g or itertools.repeat("", length) for g in given), strict=True))


def _write_parquet(tree: xr.DataTree, file: Path) -> None:
    if importlib.util.find_spec("pyarrow") is None:
        raise MissingDependency(
            "Parquet needs pyarrow, which is not installed: pip install 'mcspectra[parquet]'."
        )
    pa, parquet = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    texts = dict.fromkeys(_FIXED, True) | _columns(tree) | dict.fromkeys(_VALUES, False)
    schema = pa.schema(
        [(name, pa.string() if text else pa.float64()) for name, text in texts.items()],
        metadata={_KEY: _json(_attributes(tree), ascii_only=True)},
    )
    with parquet.ParquetWriter(file, schema) as writer:
        for table in _tables(tree):
            # Text or float64; None where a variable has no such coordinate.
            columns = {
                name: [None] * len(table["value"])
                if name not in table
                else [str(v) for v in table[name]]
                if text
                else np.asarray(table[name], dtype=np.float64)
                for name, text in texts.items()
            }
            writer.write_table(pa.table(columns, schema=schema))


def _write_json(tree: xr.DataTree, file: Path) -> None:
    with file.open("w", encoding="utf-8") as stream:
        stream.write(f'{{"attributes": {_json(dict(tree.attrs))}, "cells": [')
        for i, (path, cell) in enumerate(_cells(tree)):
            variables = {
                str(name): {
                    "dims": list(map(str, variable.dims)),
                    "attributes": dict(variable.attrs),
                    "values": _nested(np.asarray(variable.values)),
                }
                for name, variable in cell.variables.items()
            }
            document = {"path": path, "attributes": dict(cell.attrs), "variables": variables}
            stream.write(f"{',' if i else ''}\n{_json(document)}")
        stream.write("\n]}\n")


def _nested(values: Array) -> Any:
    """Lists of numbers: NaN and infinities as texts, complex numbers as pairs."""
    if values.dtype.kind == "c":
        return _nested(np.stack([values.real, values.imag], axis=-1))
    if values.dtype.kind != "f" or np.isfinite(values).all():
        return values.tolist()
    plain = values.astype(object)
    plain[~np.isfinite(values)] = [str(v) for v in values[~np.isfinite(values)]]
    return plain.tolist()


def _write_netcdf(tree: xr.DataTree, file: Path) -> None:
    import xarray as xr

    check_memory(2 * sum(cell.nbytes for _, cell in _cells(tree)), "The netCDF file")
    attributes = {key: _netcdf_attribute(value) for key, value in tree.attrs.items()}
    variables: dict[str, Any] = {}
    paths: dict[str, str] = {}
    for path, cell in _cells(tree):
        prefix = path.replace("/", ".")
        if paths.setdefault(prefix, path) != path:
            raise StoreError(
                f"The cells {paths[prefix]!r} and {path!r} would both be {prefix!r} in netCDF 3; "
                "select one of them, or export to another format."
            )
        attributes[prefix] = _json(dict(cell.attrs))
        for name, variable in cell.variables.items():
            dims = [f"{prefix}.{dim}" for dim in variable.dims]
            own = {key: _netcdf_attribute(value) for key, value in variable.attrs.items()}
            for end, values in _netcdf_arrays(np.asarray(variable.values)):
                variables[f"{prefix}.{name}{end}"] = (dims, values, own)
    xr.Dataset(variables, attrs=attributes).to_netcdf(
        file,
        engine="scipy",
        format="NETCDF3_64BIT",
        encoding={name: {"_FillValue": None} for name in variables},
    )


def _netcdf_arrays(values: Array) -> Iterator[tuple[str, Array]]:
    """Values in the types that netCDF 3 has, with the ends of their names."""
    if values.dtype.kind == "c":
        yield ".real", values.real.astype(np.float64)
        yield ".imag", values.imag.astype(np.float64)
    elif values.dtype.kind == "b":
        yield "", values.astype(np.int8)
    elif values.dtype.kind in "iu":
        low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
        small = low >= -(2**31) and high < 2**31
        if max(-low, high) > 2**53:
            raise StoreError("netCDF 3 holds no whole numbers beyond 2⁵³; export to .json instead.")
        yield "", values.astype(np.int32 if small else np.float64)
    else:
        yield "", values.astype(np.float64 if values.dtype.itemsize > 4 else np.float32)


def _netcdf_attribute(value: Any) -> Any:
    """Texts, floats and whole numbers of 32 bits as they are, all else as JSON."""
    whole = isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**31
    return value if whole or isinstance(value, str | float) else _json(value)


def _attributes(tree: xr.DataTree) -> dict[str, Any]:
    """Attributes of the study and of its cells."""
    return {"study": dict(tree.attrs), "cells": {p: dict(c.attrs) for p, c in _cells(tree)}}


def _labelled(tree: xr.DataTree) -> Iterator[xr.Dataset]:
    """Cells with a coordinate along each dimension: its texts, its numbers, or numbers from 0."""
    for _, cell in _cells(tree):
        labelled = cell
        for dim, size in cell.sizes.items():
            texts = cell.attrs.get(f"labels_{dim}", tree.attrs.get(dim) if dim == "bound" else None)
            if isinstance(texts, list) and len(texts) == size:
                labelled = labelled.assign_coords({dim: np.array(list(map(str, texts)), object)})
            elif dim not in cell.coords:
                labelled = labelled.assign_coords({dim: range(size)})
        yield labelled


def _columns(tree: xr.DataTree) -> dict[str, bool]:
    """Names of all dimensions of a tree, in order; whether any cell has texts along it."""
    columns: dict[str, bool] = {}
    for cell in _labelled(tree):
        for dim in map(str, cell.dims):
            columns[dim] = columns.get(dim, False) or cell[dim].dtype == object
    return columns


def _tables(tree: xr.DataTree) -> Iterator[dict[str, Any]]:
    """Long tables, one for each variable of each cell: arrays of equal length by columns' names."""
    for cell in _labelled(tree):
        about = cell.attrs
        names = (about.get("estimator_name"), about.get("sampler_spec"), about.get("analysis"))
        for name, variable in cell.variables.items():
            if name in cell.dims:
                continue  # it is a column of the others
            flat = np.asarray(variable.values).ravel()
            fixed = (*names, name, variable.attrs.get("units"))
            table: dict[str, Any] = {
                column: [str(text or "")] * flat.size
                for column, text in zip(_FIXED, fixed, strict=True)
            }
            dims = list(map(str, variable.dims))
            grid = np.meshgrid(*(cell[dim].values for dim in dims), indexing="ij")
            table |= {dim: along.ravel() for dim, along in zip(dims, grid, strict=True)}
            if flat.dtype.kind == "c":
                yield table | {"value": flat.real, "imaginary": flat.imag}
            else:
                yield table | {"value": flat.astype(np.int8) if flat.dtype.kind == "b" else flat}


def _json(value: Any, *, ascii_only: bool = False) -> str:
    return json.dumps(value, ensure_ascii=ascii_only)


_WRITERS: dict[str, Callable[[xr.DataTree, Path], None]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
    ".json": _write_json,
    ".nc": _write_netcdf,
    ".zarr.zip": _write_zip,
    ".zarr": lambda tree, folder: _write_folder(_store_files(tree.attrs, _cells(tree)), folder),
}
