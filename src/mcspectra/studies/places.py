"""Where results lie: folders of this machine, where studies run, and URLs, which fsspec reaches."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

from mcspectra.core.errors import MissingDependency, ParameterError, StoreError

__all__ = ["first_line", "is_url", "output_folder", "url_files"]

_EXPORTED = (".zarr", ".zip")


def is_url(place: str | Path) -> bool:
    """Whether a place is a URL, such as ``s3://bucket/out``, or a chain of them."""
    return isinstance(place, str) and ("://" in place or "::" in place)


def output_folder(out: str | Path) -> Path:
    """Check where a study is to run: its journal and its lock need a folder of a file system.

    Raises
    ------
    ParameterError
        It is a URL, a file, or named as a store that `export_results` makes.
    """
    if is_url(out):
        raise ParameterError(
            f"The output folder {str(out)!r} is a URL, and a study runs in a folder of this machine: "
            "give --out DIR, then `mcspectra export DIR --to URL/results.zarr`."
        )
    folder = Path(out)
    if folder.suffix.lower() in _EXPORTED:
        raise ParameterError(
            f"The output folder {str(out)!r} is named as an exported store: give --out DIR, then "
            f"`mcspectra export DIR --to {folder.name}`."
        )
    if folder.exists() and not folder.is_dir():
        raise ParameterError(f"The output folder {str(out)!r} is a file; give another --out.")
    return folder


def url_files(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it without a slash at its end.

    Raises
    ------
    MissingDependency
        fsspec, or what it needs for such a URL, is not installed.
    StoreError
        There is no such kind of URL, or it cannot be reached.
    """
    if importlib.util.find_spec("fsspec") is None:
        raise MissingDependency(
            f"Opening {url!r} needs fsspec, which is not installed: pip install 'mcspectra[remote]'."
        )
    import fsspec  # type: ignore[import-untyped]

    try:
        files, path = fsspec.core.url_to_fs(url)
    except ImportError as error:
        raise MissingDependency(f"Opening {url!r} needs more: {first_line(error)}.") from None
    except (OSError, ValueError) as error:
        raise StoreError(f"{url!r} cannot be opened: {first_line(error)}.") from None
    return files, path.rstrip("/")


def first_line(error: BaseException) -> str:
    """What an error says, in one line without its full stop."""
    return " ".join(str(error).split())[:200].rstrip(".") or type(error).__name__
