"""Write the results of a study to one file (.csv, .parquet, .nc, .json, .zarr.zip) or as a .zarr store."""

from __future__ import annotations

import argparse
from pathlib import Path

from mcspectra.cli.common import print_json

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("source", metavar="DIR", help="output folder, .zarr.zip file or URL")
    parser.add_argument(
        "--to",
        required=True,
        metavar="FILE",
        help="its end chooses the format; a store, .zarr, may go to a URL",
    )
    parser.add_argument(
        "--select", metavar="PATTERN", help="cells to export, e.g. 'estimator/*' (default: all)"
    )


def run(options: argparse.Namespace) -> int:
    """Export, say where to."""
    from mcspectra.core.memory import shown_bytes
    from mcspectra.studies.results import export_results

    file = export_results(options.source, options.to, options.select)
    size = _size(file) if isinstance(file, Path) else None
    if options.json:
        print_json({"file": str(file), "bytes": size})
    elif not options.quiet:
        print(file if size is None else f"{file}: {shown_bytes(size)}")
    return 0


def _size(place: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    files = place.rglob("*") if place.is_dir() else [place]
    return sum(file.stat().st_size for file in files if file.is_file())
