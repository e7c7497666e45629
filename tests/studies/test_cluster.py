"""Dask as an executor: every task has one outcome after any failure, within bounded memory."""

import contextlib
import gc
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import dask
import distributed
import psutil
import pytest
from tests.studies import cut_off
from tests.studies.local_cluster import local_cluster, scheduler, worker

from mcspectra.core.errors import ParameterError
from mcspectra.studies.executors import Cluster, ClusterError, ClusterLost, Dask, Threads
from mcspectra.studies.tasks import Outcome, StudyTask, StudyText
from mcspectra.version import __version__

TEXT = StudyText(config_json="{}", folder="/", seed=0, version=__version__)


def task(name):
    return StudyTask(path=str(name), run=None)


def squares():
    """Task for workers with a nested function, which is sent by value."""

    def compute(text, task):
        number = int(task.key)
        if number < 0:
            return Outcome(task=task, error="It is negative.")
        return Outcome(task=task, payload=b"%d" % number**2, seconds=0.5, host="here")

    return compute


def all_outcomes(engine, tasks):
    for each in tasks:
        engine.submit(each)
    return {outcome.task.key: outcome for outcome in engine.outcomes()}


@pytest.fixture(scope="module")
def cluster():
    """Two worker processes with nannies; the scheduler gives up a task whose worker dies."""
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        dask.config.set({"distributed.deploy.lost-worker-timeout": 1e9}),  # Nannies stay
        local_cluster(2) as cluster,
    ):
        yield cluster


@pytest.fixture
def engine_on(cluster):
    """Make executors on that cluster, closed at the end."""
    engines = []

    def make(compute, **options):
        options = Cluster(address=cluster.scheduler_address, **options)
        engines.append(Dask(TEXT, options, compute))
        return engines[-1]

    yield make
    for engine in engines:
        engine.close(cancel=True)


def test_every_task_has_one_outcome_as_computed(engine_on):
    engine = engine_on(squares())
    assert engine.workers == 2
    found = all_outcomes(engine, [task(i) for i in range(-1, 20)])
    assert found.pop("-1") == Outcome(task=task(-1), error="It is negative.")
    assert found == {
        str(i): Outcome(task=task(i), payload=b"%d" % i**2, seconds=0.5, host="here")
        for i in range(20)
    }
    assert list(engine.outcomes()) == []
    assert set(all_outcomes(engine, [task(3)])) == {"3"}  # The same key is computed again later


def test_tasks_may_follow_from_outcomes(engine_on):
    engine = engine_on(squares())
    engine.submit(task(2))
    seen = []
    for outcome in engine.outcomes():
        seen.append(int(outcome.payload))
        if len(seen) < 4:
            engine.submit(task(seen[-1]))
    assert seen == [4, 16, 256, 65536]


def marking(folder, size):
    def compute(text, task):
        (folder / task.key).touch()
        return Outcome(task=task, payload=bytes(size))

    return compute


def test_at_most_two_tasks_per_thread_are_submitted(engine_on, tmp_path):
    engine = engine_on(marking(tmp_path, 8))
    for index in range(50):
        engine.submit(task(index))
    deadline = time.monotonic() + 10
    while len(list(tmp_path.iterdir())) < 4 and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(0.2)
    assert len(list(tmp_path.iterdir())) == 4
    assert len(list(engine.outcomes())) == 50


def test_memory_of_outcomes_is_released(engine_on, cluster, tmp_path):
    engine = engine_on(marking(tmp_path, 500_000))
    sizes = []
    for index in range(100):
        engine.submit(task(index))
    for outcome in engine.outcomes():
        assert len(outcome.payload) == 500_000
        sizes.append(sum(state.nbytes for state in cluster.scheduler.workers.values()))
    # 50 MB went through; at most two tasks per thread and the last released ones are in memory.
    assert max(sizes) <= 10 * 510_000
    deadline = time.monotonic() + 10
    while cluster.scheduler.tasks and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not cluster.scheduler.tasks
    assert (
        len(cluster.scheduler.task_prefixes) == 1
    )  # Dask keeps prefixes for ever, so all studies share one
    assert not engine._client.futures


def suicidal(folder, always):
    """Task 0 kills its worker, either always or only the first time."""

    def compute(text, task):
        import os
        import signal

        if task.key == "0" and (always or not (folder / "died").exists()):
            (folder / "died").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return Outcome(task=task, payload=b"done")

    return compute


def test_tasks_of_a_killed_worker_are_computed_by_others(engine_on, tmp_path):
    found = all_outcomes(engine_on(suicidal(tmp_path, False)), [task(i) for i in range(10)])
    assert len(found) == 10
    assert {outcome.payload for outcome in found.values()} == {b"done"}


def test_a_task_that_kills_every_worker_fails_alone(engine_on, tmp_path):
    found = all_outcomes(engine_on(suicidal(tmp_path, True)), [task(i) for i in range(10)])
    failed = found.pop("0")
    assert failed.payload is None
    assert failed.error == (
        "2 workers died while computing it; it may need more memory than a worker has (see the "
        "worker's log)."
    )
    assert {outcome.payload for outcome in found.values()} == {b"done"}  # Including other tasks


def hanging():
    def compute(text, task):
        import os
        import time

        while task.key == "0":
            time.sleep(0.01)
        return Outcome(task=task, payload=b"%d" % os.getpid())

    return compute


def both(cluster):
    """Return the addresses of both workers, once both are connected."""
    deadline = time.monotonic() + 30
    while len(cluster.scheduler.workers) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    return set(cluster.scheduler.workers)


def test_a_task_that_hangs_fails_alone_and_its_worker_is_replaced(engine_on, cluster):
    before = both(cluster)
    engine = engine_on(hanging(), time_limit=0.5)
    found = all_outcomes(engine, [task(i) for i in range(6)])
    assert found["0"].error == "It took longer than the time limit of 0.5 s and was stopped."
    assert 0.5 <= found["0"].seconds < 5.0
    assert all(found[str(i)].payload for i in range(1, 6))
    deadline = time.monotonic() + 20
    while before <= set(cluster.scheduler.workers) and time.monotonic() < deadline:
        time.sleep(0.02)
    after = both(cluster)
    assert (len(after), len(after & before)) == (2, 1)


def holding():
    def compute(text, task):
        import itertools

        if task.key == "0":
            sum(itertools.repeat(0))
        return Outcome(task=task, payload=b"done")

    return compute


def test_code_that_holds_the_interpreter_lock_fails_alone(engine_on):
    """The worker cannot notice its time limit; it ends itself and is replaced."""
    found = all_outcomes(engine_on(holding(), time_limit=0.2), [task(i) for i in range(6)])
    assert found.pop("0").error.startswith("2 workers died while computing it")
    assert {outcome.payload for outcome in found.values()} == {b"done"}


def raising():
    def compute(text, task):
        raise ValueError("no number")

    return compute


def test_an_exception_of_a_task_is_its_error(engine_on):
    found = all_outcomes(engine_on(raising()), [task(0)])
    assert found["0"].error == "It raised ValueError: no number."


def test_a_worker_of_another_version_that_joins_later_ends_the_run(engine_on, monkeypatch):
    monkeypatch.setattr(Dask, "_refuse_other_versions", lambda self: None)
    monkeypatch.setattr(sys.modules[__name__], "TEXT", _other_version())
    engine = engine_on(squares())
    with pytest.raises(ClusterError, match=f"has mcspectra {__version__}, but the study was start"):
        all_outcomes(engine, [task(0)])


def _other_version():
    return StudyText(config_json="{}", folder="/", seed=0, version="99.0")


def test_workers_of_another_version_are_refused_by_name_before_anything_runs(cluster, tmp_path):
    metadata = tmp_path / "mcspectra-99.0.dist-info" / "METADATA"
    metadata.parent.mkdir()
    metadata.write_text("Metadata-Version: 2.1\nName: mcspectra\nVersion: 99.0\n")
    options = ["--nthreads", "1", "--no-nanny", "--host", "127.0.0.1"]
    process = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", cluster.scheduler_address, *options],
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        deadline = time.monotonic() + 30
        while len(cluster.scheduler.workers) < 3 and time.monotonic() < deadline:
            time.sleep(0.05)
        with pytest.raises(ClusterError) as caught:
            Dask(TEXT, Cluster(address=cluster.scheduler_address), squares())
    finally:
        process.kill()
        process.wait()
    message = str(caught.value)
    assert message.startswith(f"The study is run by mcspectra {__version__}, but ")
    assert f"{socket.gethostname()} (tcp://127.0.0.1:" in message
    assert message.endswith(" has 99.0; install the same version on every worker.")
    assert message.count("has") == 1  # The two other workers are not named


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return str(probe.getsockname()[1])


def slow():
    def compute(text, task):
        import time

        time.sleep(0.05)
        return Outcome(task=task, payload=b"done")

    return compute


def test_a_scheduler_that_dies_may_come_back_or_ends_the_run():
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    processes = [scheduler("--port", port), worker(address)]
    engine = Dask(TEXT, Cluster(address=address, patience=60.0), slow())
    try:
        for index in range(40):
            engine.submit(task(index))
        outcomes = engine.outcomes()
        found = [next(outcomes) for _ in range(3)]
        processes[0].kill()
        processes += [scheduler("--port", port), worker(address)]
        found += list(outcomes)
        assert {outcome.payload for outcome in found} == {b"done"}
        assert sorted(int(outcome.task.key) for outcome in found) == list(range(40))

        engine._client._timeout = 1.0
        engine.submit(task(0))
        processes[2].kill()
        for index in range(5):
            engine.submit(task(index))
        start = time.monotonic()
        with pytest.raises(ClusterLost, match=f"The dask scheduler at {address} went away and did"):
            list(engine.outcomes())
        assert time.monotonic() - start < 15
    finally:
        engine.close(cancel=True)
        for process in processes:
            process.kill()
            process.join()


@pytest.fixture
def encrypted(tmp_path):
    """Dask's TLS configuration: a certificate that is its own authority, and its key."""
    made = distributed.Security.temporary()
    names = {"ca": made.tls_ca_file, "cert": made.tls_ca_file, "key": made.tls_client_key}
    for name, text in names.items():
        (tmp_path / f"{name}.pem").write_text(text)
    tls = {"distributed.comm.require-encryption": True}
    tls["distributed.comm.tls.ca-file"] = str(tmp_path / "ca.pem")
    for role in ("client", "scheduler", "worker"):
        for name in ("cert", "key"):
            tls[f"distributed.comm.tls.{role}.{name}"] = str(tmp_path / f"{name}.pem")
    with dask.config.set(tls):
        yield


def listening():
    """Return the addresses at which this process and its children listen."""
    here = psutil.Process()
    family = [here, *here.children(recursive=True)]
    sockets = [each for process in family for each in process.net_connections()]
    return {each.laddr.ip for each in sockets if each.status == psutil.CONN_LISTEN}


def workers_here():
    """Return the worker processes forked by Python's fork server, without the server itself."""
    family = psutil.Process().children(recursive=True)
    return {each.pid for each in family if each.ppid() != os.getpid()}


def test_a_cluster_of_this_machine_is_on_loopback_encrypted_and_gone_afterwards(encrypted):
    before = workers_here()
    engine = Dask(TEXT, Cluster(workers=1), squares())
    try:
        assert engine.workers == 1
        assert workers_here() > before
        assert engine.address.startswith("tls://127.0.0.1:")
        assert engine.dashboard.startswith("http://127.0.0.1:")
        assert listening() == {"127.0.0.1"}
        assert all_outcomes(engine, [task(5)])["5"].payload == b"25"
        plain = Cluster(address=engine.address.replace("tls", "tcp"), patience=1.0)
        with pytest.raises(ClusterError, match="No dask scheduler answers at tcp://127"):
            Dask(TEXT, plain, squares())
    finally:
        engine.close(cancel=True)
    assert workers_here() == before


def test_a_cluster_can_be_left_while_tasks_run(engine_on, cluster):
    engine = engine_on(slow())
    for index in range(100):
        engine.submit(task(index))
    next(engine.outcomes())
    start = time.monotonic()
    engine.close(cancel=True)
    assert time.monotonic() - start < 10
    deadline = time.monotonic() + 10
    while cluster.scheduler.tasks and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not cluster.scheduler.tasks


ISOLATED = ["unshare", "--user", "--map-root-user", "--net"]


def _can_make_networks():
    """Whether this user may create network namespaces, as root or through user namespaces."""
    command = [*ISOLATED, "ip", "link", "add", "near", "type", "veth", "peer", "name", "far"]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


def assert_complete(outcomes):
    """Check the outcomes of a run whose worker 0 was cut off after its first task."""
    assert {key: payload for key, payload, _, _ in outcomes} == {
        str(index): str(index**2) for index in range(len(outcomes))
    }
    hosts = [host for _, _, _, host in outcomes]
    first = hosts.index("worker0")
    assert len(hosts) >= first + 21
    # One more result may have been in transit when the worker was cut off.
    assert hosts[first + 1 :].count("worker0") <= 1


def test_a_run_completes_without_a_worker_that_is_stopped():
    """A stopped worker keeps its connections and answers nothing."""
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    # Dask gives up a worker after ten heartbeats, 5 s
    settings = {"distributed.scheduler.worker-ttl": "1s"}
    names = ("worker0", "worker1")
    processes = [scheduler("--port", port, settings=settings)]
    processes += [worker(address, "--name", name) for name in names]
    try:
        outcomes = cut_off.run(address, lambda: os.kill(processes[1].pid, signal.SIGSTOP))
    finally:
        for process in processes:
            process.kill()
            process.join()
    assert_complete(outcomes)


@pytest.mark.slow  # The test above is quick
@pytest.mark.skipif(not _can_make_networks(), reason="needs network namespaces")
def test_a_run_completes_without_a_worker_that_is_cut_off():
    command = [*ISOLATED, sys.executable, cut_off.__file__]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert_complete(json.loads(done.stdout))


ADDRESSES = ["", "here", "tcp://", "tcp://host", "tcp://host:port", "http://host:80", "host:1:2"]
ADDRESSES += ["tcp://a b:1", "pickle://x:1", "tcp://host:123456", "\x00:1"]


@pytest.mark.parametrize("address", ADDRESSES)
def test_invalid_addresses_are_refused(address):
    with pytest.raises(ParameterError, match="give tcp://HOST:PORT"):
        Cluster(address=address)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"workers": 0}, "workers is 0"),
        ({"workers": 10**9}, "workers is 1000000000"),
        ({"workers": 1.5}, "workers is 1.5"),
        ({"workers": "2"}, "workers is '2'"),
        ({"dashboard": -1}, "dashboard is -1"),
        ({"dashboard": 65536}, "dashboard is 65536"),
        ({"time_limit": float("nan")}, "time_limit is nan"),
        ({"patience": 0.0}, "patience is 0.0"),
        ({"address": "tcp://host:1", "workers": 2}, "has its own workers"),
        ({"address": "tcp://host:1", "host": "0.0.0.0"}, "has its own workers"),
        ({"address": "tcp://host:1", "dashboard": 80}, "has its own workers"),
    ],
)
def test_contradicting_options_are_refused(options, match):
    with pytest.raises(ParameterError, match=match):
        Cluster(**options)


def test_a_tls_address_needs_dasks_tls_configuration():
    with pytest.raises(ClusterError, match="No dask scheduler answers at tls://.*TLS"):
        Dask(TEXT, Cluster(address="tls://127.0.0.1:1", patience=0.5), squares())


def test_an_address_without_a_server_is_an_error():
    options = Cluster(address=f"127.0.0.1:{free_port()}", patience=0.5)
    start = time.monotonic()
    with pytest.raises(ClusterError, match="No dask scheduler answers at 127.0.0.1:"):
        Dask(TEXT, options, squares())
    assert time.monotonic() - start < 10


@pytest.mark.parametrize("answer", [None, bytes, lambda data: data])
def test_a_server_that_is_not_a_scheduler_is_refused(answer):
    """Servers that send nothing, hang up, or echo, as a port connected to itself does."""

    def serve(connection):
        with connection:
            while answer is not bytes and (data := connection.recv(65536)):
                if answer is not None:
                    connection.sendall(answer(data))

    def accept():
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            threading.Thread(target=serve, args=(connection,), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=accept, daemon=True).start()
        options = Cluster(address=f"127.0.0.1:{server.getsockname()[1]}", patience=0.5)
        with pytest.raises(ClusterError, match="No dask scheduler answers at 127.0.0.1:"):
            Dask(TEXT, options, squares())


def test_the_address_of_a_worker_is_refused(cluster):
    options = Cluster(address=next(iter(cluster.scheduler_info["workers"])), patience=5.0)
    with pytest.raises(ClusterError, match="another program answers, not a scheduler"):
        Dask(TEXT, options, squares())


@pytest.mark.parametrize("content", [None, "pipe", "", "{}", "[1]", "\x00", '{"address": 3}'])
def test_invalid_scheduler_files_are_refused(tmp_path, content):
    """A pipe blocked forever."""
    file = tmp_path / "scheduler.json"
    if content == "pipe":
        os.mkfifo(file)
    elif content is not None:
        file.write_text(content)
    with pytest.raises(ParameterError, match="is not a file written by a dask scheduler"):
        Dask(TEXT, Cluster(address=str(file)), squares())


def test_a_scheduler_file_gives_the_address(cluster, tmp_path):
    file = tmp_path / "scheduler.json"
    file.write_text(json.dumps({"address": cluster.scheduler_address}))
    engine = Dask(TEXT, Cluster(address=str(file)), squares())
    try:
        assert all_outcomes(engine, [task(4)])["4"].payload == b"16"
    finally:
        engine.close(cancel=False)


def pipes():
    """Return the number of pipes that this process has open."""
    count = 0
    for file in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):
            count += str(file.readlink()).startswith("pipe:")
    return count


@pytest.mark.skipif(sys.platform != "linux", reason="descriptors are listed by Linux")
@pytest.mark.parametrize("cancel", [False, True])
@pytest.mark.parametrize("kind", ["threads", "processes", "cluster"])
def test_all_executors_close_their_pipes_at_the_end(cluster, kind, cancel):
    made = {
        "threads": lambda: Threads(2),
        "processes": lambda: Dask(TEXT, Cluster(workers=1), squares()),
        "cluster": lambda: Dask(TEXT, Cluster(address=cluster.scheduler_address), squares()),
    }[kind]
    seen = []
    for _ in range(3):  # Pipes opened once for all executors may stay
        engine = made()
        for number in range(4):
            engine.submit(task(number), lambda: None)
        outcomes = engine.outcomes()
        next(outcomes)
        if not cancel:
            assert len(list(outcomes)) == 3
        engine.close(cancel)
        del engine, outcomes
        end = time.monotonic() + 30
        while seen and pipes() > seen[0] and time.monotonic() < end:
            gc.collect()
            time.sleep(0.05)
        seen.append(pipes())
    assert seen[2] <= seen[0], seen
