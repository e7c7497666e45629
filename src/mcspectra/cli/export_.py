"""Write the results of a study to one file (.csv, .parquet, .nc, .json, .zarr.zip) or as a .zarr store."""

from __future__ import annotations

import argparse
from pathlib import Path

from mcspectra.cli.common import Answer, adder

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add = adder(parser)
    add("DIR", "output folder, .zarr.zip file or URL", dest="source")
    add("--to FILE", "its end chooses the format; a store, .zarr, may go to a URL", required=True)
    add("--select PATTERN", "cells to export, e.g. 'estimator/*' (default: all)")


def run(options: argparse.Namespace) -> Answer:
    """Export, say where to."""
    from mcspectra.core.memory import shown_bytes
    from mcspectra.studies.results import export_results

    file = export_results(options.source, options.to, options.select)
    if not isinstance(file, Path):
        return Answer(str(file), {"file": file, "bytes": None})
    files = file.rglob("*") if file.is_dir() else [file]
    size = sum(each.stat().st_size for each in files if each.is_file())
    return Answer(f"{file}: {shown_bytes(size)}", {"file": file, "bytes": size})
