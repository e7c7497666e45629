"""Make the figures and statements of the slides again, and say which of them agree.

Writes DIR/index.html (one page that stands alone), DIR/reproduce.pdf, DIR/findings.json and
DIR/figures/*.png. Without a FIGURE, all of them; --list names them. A figure that fails does not stop
the others; the exit code is then 1.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from mcspectra.cli.common import one_sentence_warnings, print_json, seed_option
from mcspectra.cli.progress import progress_bars

if TYPE_CHECKING:
    from mcspectra.report.reproduction.entries import Entry
    from mcspectra.report.reproduction.run import Reproduction

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("figures", nargs="*", metavar="FIGURE", help="figures; all by default")
    parser.add_argument("--list", action="store_true", help="name the figures and stop")
    parser.add_argument(
        "--quick", action="store_true", help="fewer realisations; 3 minutes at most"
    )
    parser.add_argument("--out", default="out/reproduce", metavar="DIR", help="output folder")


def run(options: argparse.Namespace) -> int:
    """Make the gallery, or list what it could hold."""
    if options.list:
        return _list(options)
    from mcspectra.report.reproduction.run import reproduce

    silent = options.quiet or options.json
    seed = seed_option(options)
    with one_sentence_warnings(silent), progress_bars(silent):
        made = reproduce(
            options.out,
            options.figures,
            quick=options.quick,
            seed=seed,
            command=_command(options, seed),
            done=None if silent else _print_entry,
        )
    if options.json:
        print_json(_summary(made))
    elif not options.quiet:
        _print_end(made)
    return _exit_code(made)


def _list(options: argparse.Namespace) -> int:
    from mcspectra.report.reproduction.registry import SUMMARIES, exhibit_names

    shown = {name: SUMMARIES[name] for name in exhibit_names(options.figures)}
    if options.json:
        print_json([{"name": name, "summary": text} for name, text in shown.items()])
    else:
        width = max(map(len, shown))
        print("\n".join(f"{name.ljust(width)}  {text}" for name, text in shown.items()))
    return 0


def _command(options: argparse.Namespace, seed: int) -> str:
    """Return the command that makes the same gallery; the folder is the reader's own matter."""
    words = ["mcspectra", "reproduce", *options.figures]
    words += ["--quick"] if options.quick else []
    return shlex.join([*words, "--seed", str(seed)])


def _print_entry(entry: Entry) -> None:
    print(f"{entry.name}: {entry.tally} ({entry.seconds:.1f} s)", flush=True)
    for finding in entry.findings:
        if finding.agrees is False:
            why = f": {finding.note}" if finding.note else ""
            print(f"  does not agree: {finding.statement}{why}", flush=True)


def _print_end(made: Reproduction) -> None:
    from mcspectra.report.reproduction.page import tally

    print(f"{tally(made.entries)}\ngallery: {made.page}")


def _exit_code(made: Reproduction) -> int:
    """0, or 1 after naming what failed."""
    for entry in made.entries:
        if entry.problem:
            print(f"mcspectra: The figure {entry.name} failed: {entry.problem}", file=sys.stderr)
    return 1 if made.failed else 0


def _summary(made: Reproduction) -> dict[str, object]:
    from mcspectra.report.reproduction.run import FINDINGS_NAME, PDF_NAME

    folder = made.page.parent
    judged = [f.agrees for e in made.entries for f in e.findings if f.agrees is not None]
    return {
        "gallery": str(made.page),
        "pdf": str(folder / PDF_NAME),
        "findings": str(folder / FINDINGS_NAME),
        "figures": _names(made.entries),
        "agree": sum(judged),
        "judged": len(judged),
        "failed": list(made.failed),
    }


def _names(entries: Sequence[Entry]) -> list[str]:
    return [entry.name for entry in entries]
