"""Measure samplers and show them side by side: points, spectrum, projections, rates, quality, cost.

Writes DIR/index.html (one page that stands alone) or, with --markdown, DIR/index.md and pictures;
DIR/gallery.json holds the numbers. Without a SPEC, all samplers that can be named.
"""

from __future__ import annotations

import argparse

from mcspectra.cli.common import Answer, adder

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add = adder(parser)
    example = "samplers, e.g. pmj02 \"points(path='mine.dat') | shift\""
    add("SPEC", example, dest="specs", nargs="*")
    add("--out DIR", "output folder", default="out/gallery")
    add("--quick", "fewer points and realisations")
    add("--markdown", "write Markdown and PNG files")


def run(options: argparse.Namespace) -> Answer:
    """Measure and write."""
    from mcspectra.report.sampler_cards import FULL, QUICK
    from mcspectra.report.sampler_gallery import write_gallery

    page = write_gallery(
        options.out,
        options.specs or None,
        effort=QUICK if options.quick else FULL,
        format="markdown" if options.markdown else "html",
        rng=options.seed or 0,
    )
    return Answer(f"gallery: {page}", {"gallery": page})
