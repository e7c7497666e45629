"""Results in other formats: tables (CSV, Parquet, JSON), netCDF, and the whole store in a zip file."""

from __future__ import annotations

import zipfile
from pathlib import Path

from mcspectra.core.errors import StoreError
from mcspectra.studies.store import STORE_NAME, root_document

__all__ = ["write_zip"]

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first that a zip file can hold: same results, same bytes


def write_zip(folder: Path, file: Path) -> Path:
    """Put the store of a folder into a zip file that zarr and `open_results` read.

    Raises
    ------
    StoreError
        There is no store, or a file of it leads elsewhere.
    """
    tree = folder / STORE_NAME
    root_document(tree)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for path in sorted(tree.rglob("*")):
            if path.is_symlink():
                raise StoreError(f"{str(path)!r} is a link; results hold files only.")
            if path.is_file():
                entry = zipfile.ZipInfo(path.relative_to(tree).as_posix(), _EPOCH)
                with path.open("rb") as source, archive.open(entry, "w", force_zip64=True) as out:
                    while piece := source.read(2**20):
                        out.write(piece)
    return file
