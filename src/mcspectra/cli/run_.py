"""Run a study file: measure, predict and explain every estimator with every sampler.

Writes DIR/results.zarr (opened by xarray.open_datatree), DIR/report.html and DIR/figures/.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcspectra.cli.common import Answer, adder, one_sentence_warnings, real, text_table, whole
from mcspectra.core.errors import ParameterError
from mcspectra.core.progress import report

if TYPE_CHECKING:
    from mcspectra.studies import CellEstimate, SummaryRow
    from mcspectra.studies.executors import Dask
    from mcspectra.studies.run import MakeExecutor, Progress
    from mcspectra.studies.tasks import StudyText

__all__ = ["add_arguments", "estimate_text", "run", "summary_text"]

_FAR = 0.5
_OF_CLUSTERS = ("listen", "dashboard")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options, those of clusters in a group of their own."""
    add = adder(parser)
    add("study", "study file, .toml")
    add("--out DIR", "output folder (default: out/<name of the file>)")
    add("--resume", "continue what is in the folder")
    add("--retry", "continue, and try what failed again")
    add("--workers N", "threads (default: all processors)", whole())
    add(
        "--time-limit SECONDS",
        "stop tasks that take longer, which fails their analysis; workers are processes then",
        real(above=0.0),
    )
    listed: dict[str, Any] = {"repeated": "all", "default": []}
    example = "change the study, e.g. convergence.realizations=100; values as in TOML"
    add("--set KEY=VALUE", example, **listed)
    add("--dry-run", "estimate time, memory and storage, and stop")
    add("--force", "run however much it is")
    add("--allow-code MODULE:FUNCTION", "a Python function that the study may name", **listed)
    beside = "a folder, beside the study's own, that it may read files from"
    add("--allow-path DIR", beside, **listed)
    add = adder(parser.add_argument_group("dask", "TLS is set in dask's own configuration"))
    add(
        "--cluster ADDRESS",
        "compute on dask: tcp://HOST:PORT or tls://HOST:PORT of a scheduler, the .json file that it "
        "wrote, or 'local' for --workers N processes of this machine",
    )
    add(
        "--listen HOST",
        "with --cluster local: where its scheduler listens (default: 127.0.0.1, this machine)",
    )
    add(
        "--dashboard PORT",
        "with --cluster local: port of dask's dashboard (default: any that is free)",
        whole(0),
    )


def run(options: argparse.Namespace) -> Answer:
    """Run, report, and give the summary."""
    import msgspec

    from mcspectra.report import write_report
    from mcspectra.studies import Trust, open_results, read_study, run_study, summarize
    from mcspectra.studies.results import output_folder
    from mcspectra.studies.run import CellFailed

    study = Path(options.study)
    out = output_folder(options.out or Path("out") / study.stem)
    config = read_study(study, options.set)
    if options.seed is not None:
        config = msgspec.structs.replace(config, seed=options.seed)
    limit = config.time_limit if options.time_limit is None else options.time_limit
    engine = _cluster_engine(options, limit)
    trust = Trust(tuple(options.allow_code), tuple(map(Path, options.allow_path)))
    if options.dry_run:
        return _dry_run(options, config, trust)
    failed = None

    def told(progress: Progress) -> None:
        share = progress.done_cost / max(progress.total_cost, 1e-300)
        done = 1.0 if progress.done == progress.cells else share
        report(f"study of {progress.cells} cells", done)

    try:
        run_study(
            config,
            out,
            folder=study.parent,
            resume=options.resume or options.retry,
            retry=options.retry,
            workers=options.workers,
            time_limit=options.time_limit,
            engine=engine,
            trust=trust,
            force=options.force,
            report=None if options.json else told,
        )
    except KeyboardInterrupt:
        print(
            f"mcspectra: Interrupted; what was finished is in {out}, --resume continues.",
            file=sys.stderr,
        )
        return Answer(code=130)
    except CellFailed as error:
        failed = error
    rows = summarize(open_results(out))
    page = write_report(out)
    if failed is not None:
        print(f"mcspectra: {failed}", file=sys.stderr)
    data = {"report": page, "rows": [msgspec.to_builtins(row) for row in rows]}
    return Answer(f"{summary_text(rows)}\n\nreport: {page}", data, 0 if failed is None else 1)


def _cluster_engine(options: argparse.Namespace, time_limit: float | None) -> MakeExecutor | None:
    """What makes the engine that the options ask for; None without --cluster."""
    if options.cluster is None:
        for name in _OF_CLUSTERS:
            if getattr(options, name) is not None:
                flag = name.replace("_", "-")
                raise ParameterError(f"--{flag} is for clusters; give --cluster too.")
        return None
    from mcspectra.studies.executors import Cluster, Dask

    cluster = Cluster(
        address=options.cluster,
        workers=options.workers,
        host=options.listen or "127.0.0.1",
        dashboard=options.dashboard or 0,
        time_limit=time_limit,
    )

    def make(text: StudyText) -> Dask:
        engine = Dask(text, cluster)
        if not (options.quiet or options.json):
            where = f", dashboard: {engine.dashboard}" if engine.dashboard else ""
            print(f"dask: {engine.address}{where}", file=sys.stderr)
        return engine

    return make


def _dry_run(options: argparse.Namespace, config: Any, trust: Any) -> Answer:
    """What the study would take."""
    import msgspec

    from mcspectra.core.parallel import available_workers
    from mcspectra.studies import estimate_study, make_plan
    from mcspectra.studies.estimate import wall_time

    with one_sentence_warnings(quiet=True):
        plan = make_plan(config, Path(options.study).parent, trust, force=options.force)
        estimates = estimate_study(plan)
    count = available_workers(options.workers)
    wall = wall_time(estimates, count)
    cells = [msgspec.to_builtins(each) for each in estimates]
    data = {"seconds": wall, "workers": count, "cells": cells}
    return Answer(estimate_text(estimates, wall, count), data)


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


def summary_text(rows: list[SummaryRow]) -> str:
    """The table that a person reads: rate, predicted/measured, largest term."""
    cells, any_far = [], False
    for row in rows:
        rate = half = captured = "–"
        if row.rate is not None and row.rate_low is not None and row.rate_high is not None:
            rate, half = f"{row.rate:+.2f}", f"{(row.rate_high - row.rate_low) / 2:.2f}"
        if row.captured is not None:
            far = abs(row.captured - 1.0) > _FAR
            any_far, captured = any_far or far, f"{row.captured:.3f}{'*' if far else ' '}"
        term = "infinite" if row.note else "–"
        if row.largest_term:
            term = f"{row.largest_term} {getattr(row, row.largest_term):+.2e}"
        cells.append([row.estimator, row.sampler, rate, half, captured, term])
    header = ["estimator", "sampler", "rate", "±", "predicted/measured", "largest term"]
    table = text_table(header, cells)
    note = "* far from 1: the sum over frequencies has not converged at this half width (report)"
    return f"{table}\n{note}" if any_far else table
