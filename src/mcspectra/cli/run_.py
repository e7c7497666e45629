"""Run a study file: measure, predict and explain every estimator with every sampler.

Writes DIR/results.zarr (opened by xarray.open_datatree), DIR/report.html and DIR/figures/.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from mcspectra.cli.common import one_sentence_warnings, print_json, text_table, whole_number
from mcspectra.cli.progress import Bars, progress_bars

if TYPE_CHECKING:
    from mcspectra.studies import SummaryRow
    from mcspectra.studies.run import Progress

__all__ = ["add_arguments", "run"]

_FAR = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    parser.add_argument("study", help="study file, .toml")
    parser.add_argument(
        "--out", metavar="DIR", help="output folder (default: out/<name of the file>)"
    )
    parser.add_argument("--resume", action="store_true", help="continue what is in the folder")
    parser.add_argument("--workers", metavar="N", help="threads (default: all processors)")


def run(options: argparse.Namespace) -> int:
    """Run, report, print the summary."""
    import msgspec

    from mcspectra.report import write_report
    from mcspectra.studies import open_results, read_study, run_study, summarize

    study = Path(options.study)
    out = Path(options.out) if options.out else Path("out") / study.stem
    workers = None if options.workers is None else whole_number("--workers", options.workers)
    config = read_study(study)
    if options.seed is not None:
        config = msgspec.structs.replace(config, seed=whole_number("--seed", options.seed, least=0))
    silent = options.quiet or options.json
    try:
        with one_sentence_warnings(silent), progress_bars(silent) as bars:
            run_study(
                config,
                out,
                folder=study.parent,
                resume=options.resume,
                workers=workers,
                report=_reporter(bars),
            )
    except KeyboardInterrupt:
        print(
            f"mcspectra: Interrupted; finished cells are in {out}, --resume continues.",
            file=sys.stderr,
        )
        return 130
    tree = open_results(out)
    rows = summarize(tree)
    page = write_report(out)
    if options.json:
        print_json({"report": str(page), "rows": [msgspec.to_builtins(row) for row in rows]})
    elif not options.quiet:
        print(summary_text(rows))
        print(f"\nreport: {page}")
    return 0


def _reporter(bars: Bars | None) -> Callable[[Progress], None] | None:
    """What the study is to call after each cell."""
    if bars is None:
        return None

    def report(progress: Progress) -> None:
        cells = f"{progress.done}/{progress.cells} cells"
        bars.show("study", progress.done_cost / max(progress.total_cost, 1e-300), cells)

    return report


def summary_text(rows: list[SummaryRow]) -> str:
    """The table that a person reads: rate, predicted/measured, largest term."""
    header = ["estimator", "sampler", "rate", "±", "predicted/measured", "largest term"]
    table = text_table(header, [_summary_cells(row) for row in rows])
    far = any(_far(row) for row in rows)
    note = "* far from 1: the sum over frequencies has not converged at this half width (report)"
    return f"{table}\n{note}" if far else table


def _far(row: SummaryRow) -> bool:
    return row.captured is not None and abs(row.captured - 1.0) > _FAR


def _summary_cells(row: SummaryRow) -> list[str]:
    rate, half = "–", "–"
    if row.rate is not None and row.rate_low is not None and row.rate_high is not None:
        rate, half = f"{row.rate:+.2f}", f"{(row.rate_high - row.rate_low) / 2:.2f}"
    captured = "–" if row.captured is None else f"{row.captured:.3f}{'*' if _far(row) else ' '}"
    term = row.largest_term or ("infinite" if row.note else "–")
    if row.largest_term is not None:
        term = f"{row.largest_term} {getattr(row, row.largest_term):+.2e}"
    return [row.estimator, row.sampler, rate, half, captured, term]
