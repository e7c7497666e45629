"""Run a study on two workers, cut one of them off, and print the result as JSON.

Each worker is its own host, a network namespace connected to the scheduler's by a pair of virtual
Ethernet devices, of which one is taken down. The program itself must run in its own network
namespace, which ends with it (``unshare --net``).
"""

import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from mcspectra.studies.executors import Cluster, Dask
from mcspectra.studies.tasks import Outcome, StudyTask, StudyText
from mcspectra.version import __version__

LONGEST = 100  # Seconds after which all processes end
HOST = "10.77.9.1"  # The scheduler's address in the network of each worker
AFTERWARDS = 20  # Number of tasks that begin when only one worker is left
TIMEOUTS = {
    "DASK_DISTRIBUTED__COMM__TIMEOUTS__TCP": "12s",
    "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "1s",  # Dask waits at least ten heartbeats, 5 s
    "OMP_NUM_THREADS": "1",
}


def free_port():
    with socket.socket() as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


PORT = free_port()


def started(*command, **options):
    """Start a process and discard its log."""
    environment = os.environ | TIMEOUTS
    null = subprocess.DEVNULL
    return subprocess.Popen(command, env=environment, stdout=null, stderr=null, **options)


def dask(what, *arguments):
    return [sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments]


def worker(address, host, name):
    arguments = ["--host", host, "--nthreads", "1", "--no-nanny", "--name", name]
    return dask("worker", address, *arguments)


def scheduler(host):
    return started(
        *dask(
            "scheduler", "--host", host, "--port", str(PORT), "--dashboard-address", "127.0.0.1:0"
        )
    )


def ip(*arguments):
    subprocess.run(["ip", *arguments], check=True)


def namespace(process):
    return Path(f"/proc/{process}/ns/net").readlink()


def isolated_worker(index):
    """Start a worker in its own network namespace, connected by the device ``near<index>``."""
    near, far, net = f"near{index}", f"far{index}", f"10.77.{index}"
    up = (
        f"read go; ip link set lo up; ip addr add {net}.2/24 dev {far}; ip link set {far} up; "
        f"ip route add default via {net}.1"
    )
    run = " ".join(worker(f"tcp://{HOST}:{PORT}", f"{net}.2", f"worker{index}"))
    process = started("unshare", "--net", "sh", "-c", f"{up}; exec {run}", stdin=subprocess.PIPE)
    while namespace(process.pid) == namespace("self"):
        time.sleep(0.01)
    ip("link", "add", near, "type", "veth", "peer", "name", far)
    ip("link", "set", far, "netns", str(process.pid))
    ip("addr", "add", f"{net}.1/24", "dev", near)
    ip("link", "set", near, "up")
    process.stdin.write(b"\n")
    process.stdin.close()
    return process


def computation():
    """Return a task of 50 ms that returns the name of its worker; it is sent by value."""

    def compute(text, task):
        import time

        from distributed import get_worker

        time.sleep(0.05)
        name = get_worker().name
        return Outcome(task=task, payload=b"%d" % int(task.key) ** 2, host=name)

    return compute


def run(address, cut):
    """Run tasks until worker 0 has computed one, cut it off, and run more tasks."""
    text = StudyText(config_json="{}", folder="/", seed=0, version=__version__)
    engine = Dask(text, Cluster(address=address), computation())
    engine._client.wait_for_workers(2, timeout=30)
    serials = itertools.count()
    outcomes, isolated = [], False

    def submit(count):
        for _ in range(count):
            engine.submit(StudyTask(path=str(next(serials)), run=None))

    submit(4)
    for outcome in engine.outcomes():
        outcomes.append(
            [outcome.task.key, (outcome.payload or b"").decode(), outcome.error, outcome.host]
        )
        if not isolated:
            submit(1)
        if not isolated and outcome.host == "worker0":
            cut()
            isolated = True
            submit(AFTERWARDS)
    engine.close(cancel=True)
    return outcomes


def main():
    ip("link", "set", "lo", "up")
    ip("addr", "add", f"{HOST}/32", "dev", "lo")
    processes = [scheduler(HOST), isolated_worker(0), isolated_worker(1)]
    try:
        address = f"tcp://{HOST}:{PORT}"
        print(json.dumps(run(address, lambda: ip("link", "set", "near0", "down"))))
    finally:
        for process in processes:
            process.kill()


if __name__ == "__main__":
    signal.signal(signal.SIGALRM, lambda *_: sys.exit("It took too long."))
    signal.alarm(LONGEST)
    main()
