"""Write the report of a finished (or interrupted) study again, or compare two studies.

Writes DIR/report.html and DIR/figures/; with --compare, DIR2/comparison.html: ratios of variances,
differences of rates, curves over each other. Nothing is measured.
"""

from __future__ import annotations

import argparse

from mcspectra.cli.common import Answer, adder

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add = adder(parser)
    add("DIR", "output folder of a study", dest="folder")
    add("--compare DIR2", "output folder of another study")
    add("--out FILE", "the page, .html (default: in the folder)")


def run(options: argparse.Namespace) -> Answer:
    """Write the page."""
    from mcspectra.report import write_comparison, write_report

    if options.compare is None:
        page = write_report(options.folder, options.out)
    else:
        page = write_comparison(options.folder, options.compare, options.out)
    return Answer(f"report: {page}", {"report": page})
