"""Results for reading: from a folder, a zip file, or wherever fsspec reaches.

A store from a stranger is data. Only zarr v3 is read, with codecs that compress numbers: format 2 of
zarr could name one that unpickles. Sizes are checked against memory before anything is allocated.
"""

from __future__ import annotations

import fnmatch
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcspectra.core.display import register_accessor
from mcspectra.core.errors import MissingDependency, StoreError
from mcspectra.studies._consolidated import check_consolidated
from mcspectra.studies.links import check_tree_links
from mcspectra.studies.manifest import FORMAT, in_place, read_manifest
from mcspectra.studies.places import first_line, is_url, url_files
from mcspectra.core.memory import available_memory, shown_bytes
from mcspectra.studies.store import STORE_NAME, root_document

if TYPE_CHECKING:
    import xarray as xr

    from mcspectra.studies._bounded import BoundedStore

__all__ = ["check_format", "check_store", "open_results", "result_paths", "store_url"]

_FORMATS = (1, 2)
# Those whose output is bounded before they run: gzip has no size in its header, shards have codecs inside.
_CODECS = frozenset({"bytes", "zstd", "crc32c", "transpose"})


def open_results(source: str | Path, select: str | None = None) -> xr.DataTree:
    """Open the results of a study as a tree of datasets, loaded lazily.

    Parameters
    ----------
    source
        Output folder of a study, a ``.zarr`` folder, a ``.zarr.zip`` file, or a URL such as
        ``s3://bucket/out`` that fsspec opens.
    select
        Pattern of the paths of cells, such as ``"estimator/*"``; all by default. A tree takes some
        milliseconds for each cell, so that of large studies only a part should be opened.

    Raises
    ------
    StoreError
        There are no results, they are damaged or of a format that this version cannot read, no cell
        matches, or they hold what results never hold.
    MissingDependency
        A URL is given, and fsspec or what it needs for it is not installed.
    """
    import xarray as xr

    register_accessor()
    store, root = _opened(source)
    name = str(source)
    paths = None if select is None else _selected(source, root, select)
    if store.folder is not None and root.attrs.get("format") == FORMAT:  # zarr wrote those before
        check_consolidated(store.folder, root_document(store.folder), paths)
    for path in [""] if paths is None else paths:
        _check_group(root, path, name, store)
    whole = root.metadata.consolidated_metadata is not None
    try:
        if paths is None:
            opened: Any = store  # the stubs of xarray know no stores of zarr
            return xr.open_datatree(opened, engine="zarr", consolidated=whole, zarr_format=3)
        cells: dict[str, Any] = {path: _dataset(root, path) for path in paths}
    except (ValueError, KeyError, TypeError, OSError, RuntimeError) as error:
        raise _damaged(name, error) from None
    return xr.DataTree.from_dict({"/": xr.Dataset(attrs=dict(root.attrs)), **cells})


def result_paths(source: str | Path) -> tuple[str, ...]:
    """Paths of all cells that are there; of a folder by its manifest, without opening any.

    Raises
    ------
    StoreError
        There are no results, or they cannot be read.
    """
    _, root = _opened(source)
    return tuple(_paths(source, root))


def check_store(source: str | Path) -> None:
    """Refuse what `open_results` would refuse of a source, before its arrays are looked at.

    Raises
    ------
    StoreError, MissingDependency
        As of `open_results`.
    """
    _opened(source)


def check_format(attributes: Mapping[str, Any], source: str | Path) -> None:
    """Refuse a store of a format that this version does not read, by the attributes of its root.

    Raises
    ------
    StoreError
        It names the formats that are read.
    """
    found = attributes.get("format")
    if found not in _FORMATS:
        raise StoreError(
            f"{str(source)!r} has store format {found!r}; this version reads "
            f"{' and '.join(map(str, _FORMATS))}: open it with the version that wrote it."
        )


def _paths(source: str | Path, root: Any, select: str | None = None) -> list[str]:
    """Paths of cells, of those that match."""
    folder = Path(source)
    manifest = None if is_url(source) or not folder.is_dir() else read_manifest(folder)
    if manifest is None or not manifest.cells:
        paths = _leaves(root, str(source))
        return paths if select is None else fnmatch.filter(paths, select)
    matching = None if select is None else fnmatch.filter(manifest.cells, select)
    return list(in_place(folder / STORE_NAME, manifest, matching))


def _leaves(root: Any, name: str) -> list[str]:
    """Paths of groups that hold arrays."""
    from zarr import Array as ZarrArray

    try:
        members = root.members(max_depth=None)
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise _damaged(name, error) from None
    parents = (path.rpartition("/")[0] for path, m in members if isinstance(m, ZarrArray))
    return [path for path in dict.fromkeys(parents) if path]


def _selected(source: str | Path, root: Any, select: str) -> list[str]:
    paths = _paths(source, root, select)
    if not paths:
        raise StoreError(f"No cell of {str(source)!r} matches {select!r}; paths are a/b/analysis.")
    return paths


def _opened(source: str | Path) -> tuple[BoundedStore, Any]:
    """The zarr store of a source, and its root group."""
    import zarr

    from mcspectra.studies._bounded import BoundedStore

    store = BoundedStore(_store_of(source))
    try:
        root = zarr.open_group(store, mode="r", zarr_format=3)
    except FileNotFoundError:
        message = f"{str(source)!r} is damaged: its metadata name groups that are not there."
        raise StoreError(message) from None
    except (ValueError, KeyError, TypeError, OSError, RecursionError) as error:
        raise _damaged(str(source), error) from None
    check_format(root.attrs, source)
    return store, root


def _store_of(source: str | Path) -> Any:
    from zarr.storage import LocalStore

    if is_url(source):
        return _remote(str(source))
    path = Path(source)
    if path.suffix == ".zip":
        return _zip(path)
    folder = path if path.suffix == ".zarr" else path / STORE_NAME
    root_document(folder)
    return LocalStore(folder, read_only=True)


def _zip(path: Path) -> Any:
    import zipfile

    from zarr.storage import ZipStore

    from mcspectra.studies._bounded import check_zip

    if not path.is_file():
        raise StoreError(f"There are no results in {str(path)!r}.")
    if not zipfile.is_zipfile(path):
        raise StoreError(f"{str(path)!r} is damaged: it is not a zip file.")
    check_zip(path)
    with zipfile.ZipFile(path) as archive:
        if "zarr.json" not in archive.namelist():
            raise StoreError(f"There are no results in {str(path)!r}.")
    return ZipStore(path, mode="r")


def _remote(url: str) -> Any:
    from zarr.storage import FsspecStore

    return FsspecStore.from_url(store_url(url), read_only=True)


def store_url(url: str) -> str:
    """The URL of a store that fsspec opens: the one given, or ``results.zarr`` below it.

    Raises
    ------
    StoreError
        There is none, or it cannot be reached.
    MissingDependency
        As of `url_files`.
    """
    files, path = url_files(url)
    for end in ("", f"/{STORE_NAME}"):
        try:
            found = files.exists(f"{path}{end}/zarr.json")
        except ImportError as error:
            raise MissingDependency(f"Opening {url!r} needs more: {first_line(error)}.") from None
        except (OSError, ValueError) as error:
            raise StoreError(f"{url!r} cannot be opened: {first_line(error)}.") from None
        if found:
            return f"{url.rstrip('/')}{end}" if end else url
    raise StoreError(f"There are no results in {url!r}.")


def _dataset(root: Any, path: str) -> xr.Dataset:
    """A cell, opened from a root whose metadata, perhaps those of all cells, are read once."""
    import xarray as xr
    from xarray.backends import ZarrStore

    return xr.open_dataset(ZarrStore(root[path], mode="r"))


def _check_group(root: Any, path: str, name: str, store: BoundedStore) -> None:
    """Refuse arrays that results never hold, from their metadata alone."""
    from zarr import Array as ZarrArray

    if store.folder is not None:
        check_tree_links(store.folder, path)
    try:
        group = root[path] if path else root
        members = group.members(max_depth=None)
    except (ValueError, KeyError, TypeError, OSError, RecursionError) as error:
        raise _damaged(name, error) from None
    for inner, member in members:
        if isinstance(member, ZarrArray):
            store.allow(_check_array(member, f"{name}: the array {f'{path}/{inner}'.lstrip('/')}"))


def _check_array(array: Any, what: str) -> int:
    """Bytes of a chunk of an array that results can hold."""
    codecs = [codec["name"] for codec in array.metadata.to_dict()["codecs"]]
    strange = sorted(set(codecs) - _CODECS) or ["zstd twice"] * (codecs.count("zstd") > 1)
    if strange:
        raise StoreError(
            f"{what} is coded with {', '.join(strange)}; results are coded with "
            f"{', '.join(sorted(_CODECS))} only."
        )
    if array.dtype.kind not in "biufc":
        raise StoreError(f"{what} has the type {array.dtype}; results hold numbers only.")
    size = math.prod(array.shape) * array.dtype.itemsize
    chunk = math.prod(array.chunks) * array.dtype.itemsize
    if max(size, chunk) > available_memory():
        raise StoreError(
            f"{what} claims {shown_bytes(max(size, chunk))}, more than the memory of this machine."
        )
    return int(chunk)


def _damaged(name: str, error: Exception) -> StoreError:
    json_error = isinstance(error, json.JSONDecodeError)
    reason = "metadata that are not JSON" if json_error else first_line(error)
    return StoreError(f"{name!r} is damaged: {reason}.")
