"""Write the report of a finished (or interrupted) study again, or compare two studies.

Writes DIR/report.html and DIR/figures/; with --compare, DIR2/comparison.html: ratios of variances,
differences of rates, curves over each other. Nothing is measured.
"""

from __future__ import annotations

import argparse

from mcspectra.cli.common import one_sentence_warnings, print_json

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("folder", metavar="DIR", help="output folder of a study")
    parser.add_argument("--compare", metavar="DIR2", help="output folder of another study")
    parser.add_argument("--out", metavar="FILE", help="the page, .html (default: in the folder)")


def run(options: argparse.Namespace) -> int:
    """Write the page."""
    from mcspectra.report import write_comparison, write_report

    with one_sentence_warnings(options.quiet or options.json):
        if options.compare is None:
            page = write_report(options.folder, options.out)
        else:
            page = write_comparison(options.folder, options.compare, options.out)
    if options.json:
        print_json({"report": str(page)})
    elif not options.quiet:
        print(f"report: {page}")
    return 0
