"""Clusters of the tests, whose end is not waited for longer than half a minute."""

import contextlib

import distributed


@contextlib.contextmanager
def local_cluster(workers):
    """Worker processes of one thread each, with nannies."""
    cluster = distributed.LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=60
    )
    try:
        yield cluster
    finally:
        # dask waits for good for a nanny whose worker dies while it is being started
        with contextlib.suppress(TimeoutError):
            cluster.close(timeout=30)
