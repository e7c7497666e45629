"""The verbs of studies: run a study file, and what can be done with its folder."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mcspectra.cli.common import (
    Answer,
    group,
    one_sentence_warnings,
    option,
    page_table,
    real,
    text_table,
    verb,
    whole,
)
from mcspectra.core.errors import ParameterError
from mcspectra.variance.fit import UNRESOLVED

if TYPE_CHECKING:
    from mcspectra.studies import CellEstimate
    from mcspectra.studies.executors import Dask
    from mcspectra.studies.run import MakeExecutor
    from mcspectra.studies.tasks import StudyText

__all__ = ["estimate_text", "export_", "init_", "report_", "run_", "schema_", "status_"]

_LISTED = 10  # paths of cells that are not done


@verb(
    option("study", "study file, .toml, or the name of a built-in study, such as tour"),
    option("--out DIR", "output folder (default: out/<name of the file>)"),
    option("--resume", "continue what is in the folder"),
    option("--retry", "continue, and try what failed again"),
    option("--workers N", "threads (default: all processors)", whole()),
    option(
        "--time-limit SECONDS",
        "stop tasks that take longer, which fails their analysis; workers are processes then",
        real(above=0.0),
    ),
    option(
        "--set KEY=VALUE",
        "change the study, e.g. convergence.realizations=100; values as in TOML",
        repeated="all",
        default=[],
    ),
    option("--dry-run", "estimate time, memory and storage, and stop"),
    option("--force", "run however much it is"),
    option(
        "--allow-path DIR",
        "a folder, beside the study's own, that it may read files from",
        repeated="all",
        default=[],
    ),
    group(
        lambda parser: parser.add_argument_group("dask", "TLS is set in dask's own configuration"),
        option(
            "--cluster ADDRESS",
            "compute on dask: tcp://HOST:PORT or tls://HOST:PORT of a scheduler, the .json file that it "
            "wrote, or 'local' for --workers N processes of this machine",
        ),
        option(
            "--listen HOST",
            "with --cluster local: where its scheduler listens (default: 127.0.0.1, this machine)",
        ),
        option(
            "--dashboard PORT",
            "with --cluster local: port of dask's dashboard (default: any that is free)",
            whole(0),
        ),
    ),
)
def run_(options: argparse.Namespace) -> Answer:
    """Run a study file: measure, predict and explain every estimator with every sampler.

    Writes DIR/results.zarr (opened by xarray.open_datatree), DIR/report.html and DIR/figures/.
    """
    import msgspec

    from mcspectra.core.parallel import available_workers
    from mcspectra.report import write_report
    from mcspectra.report.page import columns_of
    from mcspectra.report.tables import summary_table
    from mcspectra.studies import (
        Trust,
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
    out = results.output_folder(options.out or Path("out") / study.stem)
    config = read_study(study, options.set)
    if options.seed is not None:
        config = msgspec.structs.replace(config, seed=options.seed)
    limit = config.time_limit if options.time_limit is None else options.time_limit
    engine = _cluster_engine(options, limit)
    trust = Trust(tuple(options.allow_code), tuple(map(Path, options.allow_path)))

    # Say what it would take
    if options.dry_run:
        with one_sentence_warnings(quiet=True):
            plan = make_plan(config, study.parent, trust, force=options.force)
            estimates = estimate_study(plan)
        count = available_workers(options.workers)
        wall = wall_time(estimates, count)
        cells = [msgspec.to_builtins(each) for each in estimates]
        data = {"seconds": wall, "workers": count, "cells": cells}
        return Answer(estimate_text(estimates, wall, count), data)

    # Run the cells; the report is written of what is there, even if some fail
    code = 0
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
        )
    except CellFailed as error:
        code = 1
        print(f"mcspectra: {error}", file=sys.stderr)
    stored = len(results.result_paths(out))
    if stored > results.MOST_STORED:
        text = (
            f"{stored:,} results are in {out}; a report is for {results.MOST_STORED:,} at most: "
            f"'mcspectra export {out} --select PATTERN' writes a part of them"
        )
        return Answer(text, {"report": None, "rows": []}, code)
    with results.showing(out):
        rows = summarize(open_results(out))
    page = write_report(out)
    data = {"report": page, "rows": [msgspec.to_builtins(row) for row in rows]}
    # Show the first columns of its first table: rates, variances, predictions
    summary = summary_table(rows)
    shown = page_table(columns_of(summary, summary.columns[:5]))
    if "unresolved" in shown:
        shown += f"\nunresolved: the rate is {UNRESOLVED}"
    return Answer(f"{shown}\n\nreport: {page}" if rows else f"report: {page}", data, code)


def _cluster_engine(options: argparse.Namespace, time_limit: float | None) -> MakeExecutor | None:
    """What makes the engine that the options ask for; None without --cluster."""
    if options.cluster is None:
        for name in ("listen", "dashboard"):
            if getattr(options, name) is not None:
                raise ParameterError(f"--{name} is for clusters; give --cluster too.")
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


@verb(
    option("DIR", "output folder of a study", dest="folder"),
    option("--compare DIR2", "output folder of another study"),
    option("--out FILE", "the page, .html (default: in the folder)"),
)
def report_(options: argparse.Namespace) -> Answer:
    """Write the report of a finished (or interrupted) study again, or compare two studies.

    Writes DIR/report.html and DIR/figures/; with --compare, DIR2/comparison.html: ratios of variances,
    differences of rates, curves over each other. Nothing is measured.
    """
    from mcspectra.report import write_comparison, write_report

    if options.out is None and str(options.folder).endswith((".zarr", ".zip")):
        raise ParameterError(
            f"{str(options.folder)!r} is a store, in which no page is written; give --out FILE.html."
        )
    if options.out is not None and not options.out.lower().endswith(".html"):
        raise ParameterError(f"--out is {options.out!r}; the page is a file .html.")
    if options.compare is None:
        page = write_report(options.folder, options.out)
    else:
        page = write_comparison(options.folder, options.compare, options.out)
    return Answer(f"report: {page}", {"report": page})


@verb(
    option("DIR", "output folder of a study", dest="folder"),
    option("--verify", "check all that is stored against its digests"),
)
def status_(options: argparse.Namespace) -> Answer:
    """Show what the folder of a study holds: done, failed, missing and damaged cells.

    Exit code 0 if all cells are there or the study is running, 1 if cells failed, are missing or damaged.
    """
    import msgspec

    from mcspectra.core.memory import shown_bytes
    from mcspectra.studies.results import study_status

    status = study_status(options.folder, verify=options.verify)
    lines = [f"{status.title}: {status.state}"]

    # Say when, where and by whom it was written
    if status.started is not None:
        ended = "" if status.finished is None else f", finished {status.finished}"
        lines.append(f"started {status.started} on {status.hosts[0]!r}{ended}")
    version = status.versions.get("mcspectra", "unknown")
    lines.append(f"seed {status.seed}, mcspectra {version}, store format {status.format}")
    if status.holder is not None:
        ended = "" if status.state == "running" else ", which has ended"
        lines.append(f"written by {status.holder.in_words}{ended}")

    # Count the cells of each analysis, and the bytes
    rows = [
        [name, str(of.done), str(of.failed), str(of.missing), str(of.damaged)]
        for name, of in status.analyses.items()
    ]
    table = text_table(["analysis", "done", "failed", "missing", "damaged"], rows)
    checked = "verified" if status.verified else "not verified; --verify checks all digests"
    held = (
        f"results {shown_bytes(status.results_bytes)}, ledger {shown_bytes(status.ledger_bytes)} "
        f"with {status.recorded} recorded tasks; {checked}"
    )
    lines += ["", table, "", held]

    # List the first few cells that are not done, with the reasons
    missing = dict.fromkeys(status.missing, "")
    listed = {"damaged": status.damaged, "failed": status.failed, "missing": missing}
    for kind, reasons in listed.items():
        for path, reason in list(reasons.items())[:_LISTED]:
            lines.append(f"{kind}: {path}{': ' if reason else ''}{reason}")
        if len(reasons) > _LISTED:
            lines.append(f"{kind}: … {len(reasons) - _LISTED} more; --json lists all")
    good = status.state in ("running", "finished") and not status.damaged
    data = msgspec.to_builtins(status) | {"analyses": msgspec.to_builtins(status.analyses)}
    return Answer("\n".join(lines), data, 0 if good else 1)


@verb(
    option("DIR", "output folder, .zarr.zip file or URL", dest="source"),
    option(
        "--to FILE", "its end chooses the format; a store, .zarr, may go to a URL", required=True
    ),
    option("--select PATTERN", "cells to export, e.g. 'estimator/*' (default: all)"),
)
def export_(options: argparse.Namespace) -> Answer:
    """Write the results of a study to one file (.csv, .parquet, .nc, .json, .zarr.zip) or as a .zarr store."""
    from mcspectra.core.memory import shown_bytes
    from mcspectra.studies.results import export_results

    file = export_results(options.source, options.to, options.select)
    if not isinstance(file, Path):
        return Answer(str(file), {"file": file, "bytes": None})
    files = file.rglob("*") if file.is_dir() else [file]
    size = sum(each.stat().st_size for each in files if each.is_file())
    return Answer(f"{file}: {shown_bytes(size)}", {"file": file, "bytes": size})


@verb(option("FILE", "default study.toml", nargs="?", default="study.toml"))
def init_(options: argparse.Namespace) -> Answer:
    """Write a study file to begin with: commented, and it runs as it is."""
    from mcspectra.studies.schema import write_template

    file = write_template(options.file)
    return Answer(f"{file}: run it with 'mcspectra run {file}'.", {"file": file})


@verb(option("--markdown", "print all keys as tables of docs/studies.md"))
def schema_(options: argparse.Namespace) -> Answer:
    """Print the JSON Schema of study files, for editors and checkers."""
    from mcspectra.studies.schema import key_tables, study_schema

    if options.markdown:
        return Answer(key_tables())
    return Answer(json.dumps(study_schema(), indent=2, ensure_ascii=False))
