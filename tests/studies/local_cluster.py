"""Clusters for tests; their processes are forked from one that has imported the packages."""

import contextlib
import importlib
import os

import dask
import distributed
from distributed.utils import get_mp_context

from mcspectra.studies import executors
from mcspectra.studies.tasks import WARM

# As in runs of users, so that one fork server serves both
PRELOADED = ["dask.array", "distributed", executors.__name__, WARM]


@contextlib.contextmanager
def _forking():
    """Return dask's context for forking processes."""
    with dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}):
        context = get_mp_context()
        context.set_forkserver_preload(PRELOADED)
        yield context


@contextlib.contextmanager
def local_cluster(workers):
    """Start worker processes of one thread each, with nannies; wait half a minute for their end."""
    with _forking():
        cluster = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",
            silence_logs=60,
        )
        try:
            yield cluster
        finally:
            # dask waits for ever for a nanny whose worker dies while it is being started
            with contextlib.suppress(TimeoutError):
                cluster.close(timeout=30)


def scheduler(*options, settings=()):
    """Start the program ``dask scheduler`` with these settings of dask."""
    return _forked("scheduler", "--no-dashboard", *options, settings=settings)


def worker(*options):
    """Start the program ``dask worker`` with one thread and without a nanny."""
    return _forked("worker", "--nthreads", "1", "--no-nanny", *options)


def _forked(what, *options, settings=()):
    arguments = ("--host", "127.0.0.1", *options)
    with _forking() as context:
        process = context.Process(target=_run, args=(what, arguments, dict(settings)), daemon=True)
        process.start()
    return process


def _run(what, arguments, settings):
    """Run a program of dask and discard its log."""
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    with dask.config.set(settings):
        importlib.import_module(f"distributed.cli.dask_{what}").main(arguments)
