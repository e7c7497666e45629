"""Command-line verbs for studies: run a study file, and inspect, report or export its results."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mcspectra.cli.common import (
    VerbOutput,
    group,
    one_sentence_warnings,
    option,
    out,
    page_table,
    real,
    text_table,
    verb,
    whole,
)
from mcspectra.core.display import QUOTED, counted, printable, shown
from mcspectra.core.errors import ParameterError
from mcspectra.core.fits import UNRESOLVED
from mcspectra.core.registry import optional_package

if TYPE_CHECKING:
    from mcspectra.studies import CellEstimate
    from mcspectra.studies.executors import Dask
    from mcspectra.studies.run import MakeExecutor
    from mcspectra.studies.tasks import StudyText

__all__ = ["estimate_text", "export_", "init_", "report_", "run_", "status_"]

_LONGEST_TITLE = 200  # maximum number of characters of a title that are shown
_LONGEST_REASON = 1000  # maximum number of characters of the line about one unfinished cell
_LISTED = 10  # maximum number of unfinished cells to list, per state


@verb(
    option("STUDY", "study file, .toml, or the name of a built-in study, such as tour"),
    option("-o, --out DIR", "output folder (default out/<name of the file>)", repeated="once"),
    option("--resume", "continue the study in the output folder"),
    option("--retry", "like --resume, and compute failed cells again"),
    option("--workers N", "threads (default: all processors)", whole()),
    option(
        "--time-limit SECONDS",
        "time limit of each task; longer tasks are stopped and their analyses fail; uses processes",
        real(least=0.01),
    ),
    option(
        "--set KEY=VALUE",
        "change the study, e.g. convergence.realizations=100; values as in TOML; repeatable",
        repeated="all",
        default=[],
    ),
    option("--dry-run", "estimate time, memory and storage, then stop"),
    option("--force", "run a study that exceeds the usual limits"),
    option(
        "--allow-path DIR",
        "a folder that the study may read files from, in addition to its own; repeatable",
        repeated="all",
        default=[],
    ),
    group(
        lambda parser: parser.add_argument_group(
            "dask", "configure TLS in dask's own configuration"
        ),
        option(
            "--cluster ADDRESS",
            "compute on dask: tcp://HOST:PORT or tls://HOST:PORT of a scheduler, its .json file, "
            "or 'local' for --workers N processes of this machine",
        ),
        option(
            "--listen HOST",
            "with --cluster local: address where the scheduler listens (default 127.0.0.1, this "
            "machine)",
        ),
        option(
            "--dashboard PORT",
            "with --cluster local: port of dask's dashboard (default: any free port)",
            whole(0),
        ),
    ),
)
def run_(options: argparse.Namespace) -> VerbOutput:
    """Run a study file: measure, predict and explain every estimator with every sampler.

    Writes DIR/study.sqlite, DIR/results.zarr, DIR/report.html and DIR/figures/.
    The page and its figures need the extra report (pip install 'mcspectra[report]').
    """
    import msgspec

    from mcspectra.core.errors import MissingDependency, MissingPackageWarning, StoreError, warn
    from mcspectra.core.parallel import available_workers
    from mcspectra.core.trust import process_trust
    from mcspectra.report import write_report
    from mcspectra.report.page import check_page_packages, columns_of
    from mcspectra.report.tables import summary_table
    from mcspectra.studies import (
        estimate_study,
        make_plan,
        open_results,
        read_study,
        results,
        run_study,
        study_file,
        summarize,
    )
    from mcspectra.studies.estimate import wall_time
    from mcspectra.studies.run import CellFailed

    study = study_file(options.study)
    target = results.output_folder(options.out or Path("out") / study.stem)
    config = read_study(study, options.set)
    if options.seed is not None:
        config = msgspec.structs.replace(config, seed=options.seed)
    limit = config.time_limit if options.time_limit is None else options.time_limit
    engine = _cluster_engine(options, limit)
    trust = process_trust()

    # Print an estimate and stop
    if options.dry_run:
        with one_sentence_warnings(quiet=True):
            plan = make_plan(config, study.parent, trust, force=options.force)
            estimates = estimate_study(plan)
        count = available_workers(options.workers)
        wall = wall_time(estimates, count)
        cells = [msgspec.to_builtins(each) for each in estimates]
        data = {"seconds": wall, "workers": count, "cells": cells}
        return VerbOutput(estimate_text(estimates, wall, count), data)

    # Warn before the run if the report could not be written
    reported = True
    try:
        check_page_packages()
    except MissingDependency as missing:
        reported = False
        warn(
            f"{missing}, then write the report with 'mcspectra report {out}'; this run leaves it "
            "out.",
            MissingPackageWarning,
        )

    # Run the cells. The report shows all finished cells, even if other cells fail
    code = 0
    try:
        run_study(
            config,
            target,
            folder=study.parent,
            resume=options.resume or options.retry,
            retry=options.retry,
            workers=options.workers,
            time_limit=options.time_limit,
            engine=engine,
            trust=trust,
            force=options.force,
        )
    except CellFailed as error:
        code = 1
        print(f"mcspectra: {error}", file=sys.stderr)
    except KeyboardInterrupt as stop:
        # Show the finished cells, unless the user interrupts again
        said = [str(each) for each in stop.args]
        told = "mcspectra: writing the report of finished work; interrupt again to stop at once"
        with contextlib.suppress(StoreError):
            if reported and results.result_paths(target):
                print(told, file=sys.stderr, flush=True)
                said.append(f"the report of finished work is {printable(write_report(target))}")
        raise KeyboardInterrupt(*said) from None
    stored = len(results.result_paths(target))
    if stored > results.MOST_STORED:
        text = (
            f"{stored:,} results are in {printable(target)}, but a report shows at most "
            f"{results.MOST_STORED:,}; 'mcspectra export {printable(target)} --select PATTERN -o "
            "FILE' writes a part of them"
        )
        return VerbOutput(text, {"report": None, "rows": []}, code)
    with results.showing(target):
        rows = summarize(open_results(target))
    page = write_report(target) if reported else None
    data = {"report": page, "rows": [msgspec.to_builtins(row) for row in rows]}
    # Show the first columns of the first table of the report: rates, variances and predictions
    summary = summary_table(rows)
    shown = page_table(columns_of(summary, summary.columns[:5]))
    if "unresolved" in shown:
        shown += f"\nunresolved: the rate is {UNRESOLVED}"
    place = f"report: {printable(page)}" if page else f"results: {printable(target)}"
    return VerbOutput(f"{shown}\n\n{place}" if rows else place, data, code)


def _cluster_engine(options: argparse.Namespace, time_limit: float | None) -> MakeExecutor | None:
    """Return a function that creates the executor for the given options; None without --cluster."""
    if options.cluster is not None or time_limit is not None:
        optional_package("distributed", "cluster", "Processes and clusters of dask need")
    if options.cluster is None:
        for name in ("listen", "dashboard"):
            if getattr(options, name) is not None:
                raise ParameterError(f"--{name} is for clusters; also give --cluster.")
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


def estimate_text(estimates: Sequence[CellEstimate], wall: float, workers: int) -> str:
    """Return a table of costs with a row for each pair of estimator and analysis.

    Each row is the total cost of an estimator and an analysis with all samplers.
    """
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
        f"{table}\n\n{known}about {wall:.3g} s with {counted(workers, 'worker')}; "
        f"{counted(tasks, 'task')}, {memory} of memory at most, {storage} of storage"
    )


@verb(
    option("DIR", "output folder of a study", dest="folder"),
    option("--compare DIR2", "output folder of another study"),
    out(".html: the page (default: in the folder)"),
)
def report_(options: argparse.Namespace) -> VerbOutput:
    """Write the report of a finished or interrupted study again, or compare two studies.

    Writes DIR/report.html and DIR/figures/.
    With --compare, the command writes DIR2/comparison.html.
    comparison.html has ratios of variances, differences of rates, and curves of both studies.
    Reports and comparisons use the stored results of the studies, and measure nothing again.
    """
    from mcspectra.report import write_comparison, write_report
    from mcspectra.report.result_files import check_result_file

    for file in options.out:
        check_result_file(file, (".html",))
    pages = [
        write_report(options.folder, file)
        if options.compare is None
        else write_comparison(options.folder, options.compare, file)
        for file in options.out or [None]
    ]
    data = {"report": pages[0]} | ({"files": pages} if len(pages) > 1 else {})
    return VerbOutput("\n".join(f"report: {printable(page)}" for page in pages), data)


@verb(
    option("DIR", "output folder of a study", dest="folder"),
    option("--verify", "check the digests of all stored results"),
)
def status_(options: argparse.Namespace) -> VerbOutput:
    """Count the done, failed, missing and damaged cells in the folder of a study.

    A cell is one analysis of one estimator with one sampler.
    The exit code is 1 if a cell failed, is missing or is damaged.
    The exit code is 0 if all cells are done, or the study is running.
    """
    import msgspec

    from mcspectra.core.memory import shown_bytes
    from mcspectra.studies.ledger import LEDGER_NAME
    from mcspectra.studies.results import study_status

    status = study_status(options.folder, verify=options.verify)
    lines = [f"{printable(status.title, _LONGEST_TITLE)}: {status.state}"]

    # Report when, on which machine and by which process the folder was written
    if status.started is not None:
        ended = "" if status.finished is None else f", finished {status.finished}"
        on = f" on {shown(status.hosts[0])}" if status.hosts else ""
        lines.append(f"started {status.started}{on}{ended}")
    version = printable(status.versions.get("mcspectra", "unknown"), QUOTED)
    lines.append(f"seed {shown(status.seed)}, mcspectra {version}, store format {status.format}")
    if status.holder is not None:
        ended = "" if status.state == "running" else ", which has ended"
        lines.append(f"written by {status.holder.in_words}{ended}")

    # Count the cells of each analysis, and the size of their results in bytes
    rows = [
        [name, str(of.done), str(of.failed), str(of.missing), str(of.damaged)]
        for name, of in status.analyses.items()
    ]
    others = len(status.damaged) - sum(of.damaged for of in status.analyses.values())
    if others:
        rows.append(["other parts", "", "", "", str(others)])
    table = text_table(["analysis", "done", "failed", "missing", "damaged"], rows)
    checked = "verified" if status.verified else "not verified; --verify checks all digests"
    held = (
        f"results {shown_bytes(status.results_bytes)}, ledger {shown_bytes(status.ledger_bytes)} "
        f"with {counted(status.recorded, 'recorded task')}; {checked}"
    )
    lines += ["", table, "", held]

    # List the first few cells that are not finished, with the reasons
    missing = dict.fromkeys(status.missing, "")
    listed = {"damaged": status.damaged, "failed": status.failed, "missing": missing}
    for kind, reasons in listed.items():
        for path, reason in list(reasons.items())[:_LISTED]:
            lines.append(
                printable(f"{kind}: {path}{': ' if reason else ''}{reason}", _LONGEST_REASON)
            )
        if len(reasons) > _LISTED:
            lines.append(f"{kind}: … {len(reasons) - _LISTED} more; --json lists all")
    lost = any(not name.startswith("the ") for name in status.damaged)
    if status.refusal is not None and (lost or status.missing):
        lines.append(f"--resume refuses this folder: {LEDGER_NAME} {status.refusal}")
    elif lost and "the header" not in status.damaged:
        kept = counted(len(status.done), "cell")
        lines.append(
            f"'mcspectra run STUDY --out {printable(options.folder)} --resume' keeps the results "
            f"of {kept} and computes the others again"
        )
    good = status.state in ("running", "finished") and not status.damaged
    data = msgspec.to_builtins(status) | {"analyses": msgspec.to_builtins(status.analyses)}
    return VerbOutput("\n".join(lines), data, 0 if good else 1)


@verb(
    option("DIR", "output folder of a study, or a .zarr store", dest="source"),
    out(
        ".csv: a table of all scalars; .zarr: a store of all results",
        required=True,
        default=None,
    ),
    option("--select PATTERN", "cells to export, e.g. 'estimator/*' (default: all)"),
)
def export_(options: argparse.Namespace) -> VerbOutput:
    """Write the results of a study to files; the extension of a file sets its format.

    A table has one row per number: estimator, sampler, analysis, n, variable, value,
    95 % interval (low, high), standard error (se) and unit.
    Spreadsheets and pandas can read a table; xarray reads a store.
    """
    from mcspectra.core.memory import shown_bytes
    from mcspectra.studies.results import check_export, export_results

    for target in options.out:
        check_export(target)
    written, lines = [], []
    for target in options.out:
        file = export_results(options.source, target, options.select)
        files = file.rglob("*") if file.is_dir() else [file]
        size = sum(each.stat().st_size for each in files if each.is_file())
        written.append({"file": file, "bytes": size})
        lines.append(f"{printable(file)}: {shown_bytes(size)}")
    return VerbOutput("\n".join(lines), written)


@verb(
    option("FILE", "name of the study file (default study.toml)", nargs="?"),
    option("--schema", "print the JSON Schema of study files for editors; write no file"),
    option("--markdown", "with --schema: print the keys as the tables of docs/studies.md"),
)
def init_(options: argparse.Namespace) -> VerbOutput:
    """Write a study file to start from; it has comments and runs as it is."""
    from mcspectra.studies.schema import key_tables, study_schema, write_template

    if options.markdown and not options.schema:
        raise ParameterError("--markdown is for --schema; also give --schema.")
    if options.schema:
        if options.file is not None:
            raise ParameterError(f"--schema writes no file; leave {options.file} out.")
        if options.markdown:
            return VerbOutput(key_tables())
        return VerbOutput(json.dumps(study_schema(), indent=2, ensure_ascii=False))
    file = write_template(options.file or "study.toml")
    return VerbOutput(
        f"{printable(file)}: run it with 'mcspectra run {printable(file)}'.", {"file": file}
    )
