"""Run a study file: measure, predict and explain every estimator with every sampler.

Writes DIR/results.zarr (opened by xarray.open_datatree), DIR/report.html and DIR/figures/.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mcspectra.cli.common import (
    one_sentence_warnings,
    print_json,
    real_number,
    text_table,
    whole_number,
)
from mcspectra.cli.progress import Bars, progress_bars
from mcspectra.cli.run_cluster import add_cluster_arguments, cluster_engine

if TYPE_CHECKING:
    from mcspectra.studies import CellEstimate, StudyConfig, SummaryRow, Trust
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
    parser.add_argument("--retry", action="store_true", help="continue, and try what failed again")
    parser.add_argument("--workers", metavar="N", help="threads (default: all processors)")
    parser.add_argument(
        "--time-limit",
        metavar="SECONDS",
        help="stop tasks that take longer, which fails their analysis; workers are processes then",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change the study, e.g. convergence.realizations=100; values as in TOML",
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="estimate time, memory and storage, and stop"
    )
    parser.add_argument("--force", action="store_true", help="run however much it is")
    parser.add_argument(
        "--allow-code",
        action="append",
        default=[],
        metavar="MODULE:FUNCTION",
        help="a Python function that the study may name",
    )
    parser.add_argument(
        "--allow-path",
        action="append",
        default=[],
        metavar="DIR",
        help="a folder, beside the study's own, that it may read files from",
    )
    add_cluster_arguments(parser)


def run(options: argparse.Namespace) -> int:
    """Run, report, print the summary."""
    import msgspec

    from mcspectra.studies import Trust, read_study, run_study
    from mcspectra.studies.results import output_folder
    from mcspectra.studies.run import CellFailed

    study = Path(options.study)
    out = output_folder(options.out or Path("out") / study.stem)
    workers = None if options.workers is None else whole_number("--workers", options.workers)
    limit = None if options.time_limit is None else real_number("--time-limit", options.time_limit)
    config = read_study(study, options.set)
    if options.seed is not None:
        config = msgspec.structs.replace(config, seed=whole_number("--seed", options.seed, least=0))
    engine = cluster_engine(options, workers, config.time_limit if limit is None else limit)
    trust = Trust(tuple(options.allow_code), tuple(map(Path, options.allow_path)))
    silent = options.quiet or options.json
    if options.dry_run:
        return _dry_run(config, study.parent, trust, workers, options)
    failed = None
    try:
        with one_sentence_warnings(silent), progress_bars(silent) as bars:
            run_study(
                config,
                out,
                folder=study.parent,
                resume=options.resume or options.retry,
                retry=options.retry,
                workers=workers,
                time_limit=limit,
                engine=engine,
                trust=trust,
                force=options.force,
                report=_reporter(bars),
            )
    except KeyboardInterrupt:
        print(
            f"mcspectra: Interrupted; what was finished is in {out}, --resume continues.",
            file=sys.stderr,
        )
        return 130
    except CellFailed as error:
        failed = error
    _show(out, options)
    if failed is not None:
        print(f"mcspectra: {failed}", file=sys.stderr)
        return 1
    return 0


def _show(out: Path, options: argparse.Namespace) -> None:
    """Write the report, print the summary."""
    import msgspec

    from mcspectra.report import write_report
    from mcspectra.studies import open_results, summarize

    rows = summarize(open_results(out))
    page = write_report(out)
    if options.json:
        print_json({"report": str(page), "rows": [msgspec.to_builtins(row) for row in rows]})
    elif not options.quiet:
        print(summary_text(rows))
        print(f"\nreport: {page}")


def _dry_run(
    config: StudyConfig,
    folder: Path,
    trust: Trust,
    workers: int | None,
    options: argparse.Namespace,
) -> int:
    """Print what the study would take."""
    import msgspec

    from mcspectra.core.parallel import available_workers
    from mcspectra.studies import estimate_study, make_plan
    from mcspectra.studies.estimate import wall_time

    with one_sentence_warnings(quiet=True):
        estimates = estimate_study(make_plan(config, folder, trust, force=options.force))
    count = available_workers(workers)
    wall = wall_time(estimates, count)
    if options.json:
        cells = [msgspec.to_builtins(each) for each in estimates]
        print_json({"seconds": wall, "workers": count, "cells": cells})
    elif not options.quiet:
        print(estimate_text(estimates, wall, count))
    return 0


def estimate_text(estimates: Sequence[CellEstimate], wall: float, workers: int) -> str:
    """A row for each analysis of each estimator, all samplers together, and the sums."""
    from mcspectra.core.memory import shown_bytes

    groups: dict[tuple[str, str], list[CellEstimate]] = {}
    for each in estimates:
        groups.setdefault((each.estimator, each.analysis), []).append(each)
    rows = [
        [
            *names,
            str(sum(each.tasks for each in group)),
            f"{sum(each.seconds for each in group):.3g}",
            shown_bytes(max(each.memory for each in group)),
            shown_bytes(sum(each.storage for each in group)),
        ]
        for names, group in groups.items()
    ]
    table = text_table(["estimator", "analysis", "tasks", "seconds", "memory", "storage"], rows)
    memory = shown_bytes(sum(sorted((each.memory for each in estimates), reverse=True)[:workers]))
    tasks = sum(each.tasks for each in estimates)
    storage = shown_bytes(sum(each.storage for each in estimates))
    failing = {each.estimator: each.error for each in estimates if each.error is not None}
    known = "".join(f"estimator {name!r} will fail: {error}\n" for name, error in failing.items())
    return (
        f"{table}\n\n{known}about {wall:.3g} s with {workers} workers; {tasks} tasks, {memory} of memory "
        f"at most, {storage} of storage"
    )


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
