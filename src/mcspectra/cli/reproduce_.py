"""Make the figures and statements of the slides again, and say which of them agree.

Writes DIR/index.html (one page that stands alone), DIR/reproduce.pdf, DIR/findings.json and
DIR/figures/*.png. Without a FIGURE, all of them; --list names them. A figure that fails does not stop
the others; the exit code is then 1.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from typing import TYPE_CHECKING

from mcspectra.cli.common import Answer, adder

if TYPE_CHECKING:
    from mcspectra.report.reproduction.entries import Entry

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add = adder(parser)
    add("FIGURE", "figures; all by default", dest="figures", nargs="*")
    add("--list", "name the figures and stop")
    add("--quick", "fewer realisations; 3 minutes at most")
    add("--out DIR", "output folder", default="out/reproduce")


def run(options: argparse.Namespace) -> Answer:
    """Make the gallery, or list what it could hold."""
    from mcspectra.report.reproduction.page import tally
    from mcspectra.report.reproduction.registry import SUMMARIES, exhibit_names
    from mcspectra.report.reproduction.run import FINDINGS_NAME, PDF_NAME, reproduce

    if options.list:
        shown = {name: SUMMARIES[name] for name in exhibit_names(options.figures)}
        width = max(map(len, shown))
        lines = [f"{name.ljust(width)}  {text}" for name, text in shown.items()]
        return Answer(
            "\n".join(lines), [{"name": name, "summary": text} for name, text in shown.items()]
        )
    # The command that makes the same gallery; the folder is the reader's own matter
    seed = options.seed or 0
    words = ["mcspectra", "reproduce", *options.figures, *(["--quick"] if options.quick else [])]
    made = reproduce(
        options.out,
        options.figures,
        quick=options.quick,
        seed=seed,
        command=shlex.join([*words, "--seed", str(seed)]),
        done=None if options.quiet or options.json else _print_entry,
    )
    for entry in made.entries:
        if entry.problem:
            print(f"mcspectra: The figure {entry.name} failed: {entry.problem}", file=sys.stderr)
    judged = [f.agrees for e in made.entries for f in e.findings if f.agrees is not None]
    data = {
        "gallery": made.page,
        "pdf": made.page.parent / PDF_NAME,
        "findings": made.page.parent / FINDINGS_NAME,
        "figures": [entry.name for entry in made.entries],
        "agree": sum(judged),
        "judged": len(judged),
        "failed": list(made.failed),
    }
    return Answer(f"{tally(made.entries)}\ngallery: {made.page}", data, 1 if made.failed else 0)


def _print_entry(entry: Entry) -> None:
    print(f"{entry.name}: {entry.tally} ({entry.seconds:.1f} s)", flush=True)
    for finding in entry.findings:
        if finding.agrees is False:
            why = f": {finding.note}" if finding.note else ""
            print(f"  does not agree: {finding.statement}{why}", flush=True)
