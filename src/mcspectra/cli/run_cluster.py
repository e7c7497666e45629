"""Options of the verb `run` that send a study to a dask cluster."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from mcspectra.cli.common import whole_number

if TYPE_CHECKING:
    from mcspectra.studies.run import MakeExecutor

__all__ = ["add_cluster_arguments", "cluster_engine"]

_OPTIONS = ("listen", "dashboard")


def add_cluster_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options, in a group of their own."""
    group = parser.add_argument_group("dask", "TLS is as dask's own configuration says")
    group.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="compute on dask: tcp://HOST:PORT or tls://HOST:PORT of a scheduler, the .json file "
        "that it wrote, or 'local' for --workers N processes of this machine",
    )
    group.add_argument(
        "--listen",
        metavar="HOST",
        help="with --cluster local: where its scheduler listens (default: 127.0.0.1, this machine)",
    )
    group.add_argument(
        "--dashboard",
        metavar="PORT",
        help="with --cluster local: port of dask's dashboard (default: any that is free)",
    )


def cluster_engine(
    options: argparse.Namespace, workers: int | None, time_limit: float | None
) -> MakeExecutor | None:
    """What makes the engine that the options ask for; None without --cluster.

    Raises
    ------
    ParameterError
        Options that do not go together, or only with --cluster.
    """
    from mcspectra.core.errors import ParameterError

    if options.cluster is None:
        for name in _OPTIONS:
            if getattr(options, name) is not None:
                option = name.replace("_", "-")
                raise ParameterError(f"--{option} is for clusters; give --cluster too.")
        return None
    from mcspectra.studies.executors import Cluster, Dask
    from mcspectra.studies.tasks import StudyText

    port = (
        0 if options.dashboard is None else whole_number("--dashboard", options.dashboard, least=0)
    )
    settings = Cluster(
        address=options.cluster,
        workers=workers,
        host="127.0.0.1" if options.listen is None else options.listen,
        dashboard=port,
        time_limit=time_limit,
    )
    silent = options.quiet or options.json

    def make(text: StudyText) -> Dask:
        engine = Dask(text, settings)
        if not silent:
            print(_greeting(engine.address, engine.dashboard), file=sys.stderr)
        return engine

    return make


def _greeting(address: str, dashboard: str) -> str:
    return f"dask: {address}{f', dashboard: {dashboard}' if dashboard else ''}"
