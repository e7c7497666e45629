"""Show what the folder of a study holds: done, failed, missing and damaged cells.

Exit code 0 if all cells are there or the study is running, 1 if cells failed, are missing or damaged.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from mcspectra.cli.common import Answer, adder, text_table

if TYPE_CHECKING:
    from mcspectra.studies.results import StudyStatus

__all__ = ["add_arguments", "run"]

_SHOWN = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's options."""
    add = adder(parser)
    add("DIR", "output folder of a study", dest="folder")
    add("--verify", "check all that is stored against its digests")


def run(options: argparse.Namespace) -> Answer:
    """Give the status."""
    import msgspec

    from mcspectra.studies.results import study_status

    status = study_status(options.folder, verify=options.verify)
    good = status.state in ("running", "finished") and not status.damaged
    data = msgspec.to_builtins(status) | {"analyses": msgspec.to_builtins(status.analyses)}
    return Answer("\n".join(_lines(status)), data, 0 if good else 1)


def _lines(status: StudyStatus) -> Iterator[str]:
    """The status as people read it."""
    from mcspectra.core.memory import shown_bytes

    yield f"{status.title}: {status.state}"
    yield from _when(status)
    if status.holder is not None:
        ended = "" if status.state == "running" else ", which has ended"
        yield f"written by {status.holder.in_words}{ended}"
    yield ""
    yield _table(status)
    yield ""
    checked = "verified" if status.verified else "not verified; --verify checks all digests"
    yield (
        f"results {shown_bytes(status.results_bytes)}, ledger {shown_bytes(status.ledger_bytes)} "
        f"with {status.recorded} recorded tasks; {checked}"
    )
    yield from _listed("damaged", status.damaged)
    yield from _listed("failed", status.failed)
    yield from _listed("missing", dict.fromkeys(status.missing, ""))


def _when(status: StudyStatus) -> Iterator[str]:
    version = status.versions.get("mcspectra", "unknown")
    if status.started is not None:
        ended = "" if status.finished is None else f", finished {status.finished}"
        yield f"started {status.started} on {status.hosts[0]!r}{ended}"
    yield f"seed {status.seed}, mcspectra {version}, store format {status.format}"


def _table(status: StudyStatus) -> str:
    rows = [
        [name, str(of.done), str(of.failed), str(of.missing), str(of.damaged)]
        for name, of in status.analyses.items()
    ]
    return text_table(["analysis", "done", "failed", "missing", "damaged"], rows)


def _listed(kind: str, reasons: dict[str, str]) -> Iterator[str]:
    """The first few paths with their reasons."""
    for path, reason in list(reasons.items())[:_SHOWN]:
        yield f"{kind}: {path}{': ' if reason else ''}{reason}"
    if len(reasons) > _SHOWN:
        yield f"{kind}: … {len(reasons) - _SHOWN} more; --json lists all"
