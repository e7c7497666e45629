"""Write the report of a finished (or interrupted) study again, or compare two studies.

Writes DIR/report.html and DIR/figures/; with --compare, DIR2/comparison.html: ratios of variances,
differences of rates, curves over each other. Nothing is measured.
"""

from __future__ import annotations

import argparse

from mcspectra.cli.common import Answer

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("folder", metavar="DIR", help="output folder of a study")
    parser.add_argument("--compare", metavar="DIR2", help="output folder of another study")
    parser.add_argument("--out", metavar="FILE", help="the page, .html (default: in the folder)")


def run(options: argparse.Namespace) -> Answer:
    """Write the page."""
    from mcspectra.report import write_comparison, write_report

    if options.compare is None:
        page = write_report(options.folder, options.out)
    else:
        page = write_comparison(options.folder, options.compare, options.out)
    return Answer(f"report: {page}", {"report": page})
