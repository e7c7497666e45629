"""Executors return every task once, hold few tasks, and survive failing tasks."""

import threading
import time
from pathlib import Path

import distributed  # noqa: F401 - its configuration must be loaded before it is changed
import msgspec
import pytest
from tests.processes import python

from mcspectra.core.errors import NotPowerOfTwoWarning, ParameterError
from mcspectra.studies import executors
from mcspectra.studies.executors import (
    Cluster,
    ClusterError,
    ClusterLost,
    Dask,
    Threads,
    check_time_limit,
)
from mcspectra.studies.files import decode_study
from mcspectra.studies.plan import make_plan
from mcspectra.studies.tasks import StudyTask, StudyText
from mcspectra.studies.vetting import Trust

STUDY = """
title = "t"
samplers = ["random"]
[convergence]
counts = [4]
realizations = 10
[[estimators]]
name = "a"
integrand = "python(function='misbehaving:{name}')"
dims = 1
"""


def _task(estimator="a"):
    return StudyTask(path=f"{estimator}/random/convergence", run=None)


def _text(name):
    trust = Trust((f"misbehaving:{name}",))
    return StudyText.of(decode_study(STUDY.format(name=name)), Path(), trust)


def _end_after(seconds, executor):
    """Remove the scheduler of an executor that hangs."""
    timer = threading.Timer(seconds, executor._client.close)
    timer.daemon = True
    timer.start()


@pytest.mark.parametrize("workers", [1, 3])
def test_every_task_comes_back_once(workers):
    threads = set()

    def compute():
        threads.add(threading.current_thread())
        time.sleep(0.001)
        return threads

    executor = Threads(workers)
    assert executor.workers == workers
    assert list(executor.outcomes()) == []
    for i in range(20):
        executor.submit(_task(str(i)), compute)
    found = []
    for outcome in executor.outcomes():
        assert outcome.state is threads  # An object instead of bytes
        assert outcome.payload is None
        found.append(outcome.task)
        if len(found) == 5:
            executor.submit(_task("late"), compute)
    assert len(found) == 21
    assert {task.path for task in found} == {_task(str(i)).path for i in (*range(20), "late")}
    executor.close(cancel=False)
    assert len(threads) <= workers
    assert not any(thread.is_alive() for thread in threads)


def test_cancelled_tasks_do_not_begin():
    begun = []
    gate = threading.Event()

    def compute():
        begun.append(True)
        gate.wait(10)

    executor = Threads(1)
    for i in range(50):
        executor.submit(_task(str(i)), compute)
    threading.Timer(0.1, gate.set).start()
    executor.close(cancel=True)
    assert len(begun) <= 1


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_ends_without_an_outcome_raises_an_error(monkeypatch):
    def without_memory(*_):
        raise MemoryError

    monkeypatch.setattr(executors, "timed", without_memory)
    executor = Threads(1)
    executor.submit(_task(), lambda: None)
    with pytest.raises(ClusterLost, match="A thread of this run ended .*--resume continues"):
        next(executor.outcomes())
    executor.close(cancel=True)


@pytest.mark.parametrize("value", [0, -1.0, float("nan"), float("inf"), "3", True, 1e10])
def test_invalid_time_limits_are_refused(value):
    with pytest.raises(ParameterError, match="time_limit"):
        check_time_limit(value)


def test_time_limits():
    assert check_time_limit(None) is None
    assert check_time_limit(3) == 3.0


def test_workers_that_cannot_build_the_study_are_an_error(misbehaving):
    text = msgspec.structs.replace(_text("good"), code=())
    executor = Dask(text, Cluster(workers=1))
    executor.submit(_task())
    try:
        with pytest.raises(ClusterError, match="--allow-code misbehaving:good"):
            next(executor.outcomes())
    finally:
        executor.close(cancel=True)
    assert misbehaving.exists()


MASKS = """
import multiprocessing, signal

def masked():
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())

def tell(pipe):
    pipe.send(masked())

if __name__ == "__main__":  # Only here, because the import takes a second
    from mcspectra.studies.executors import deaf

    context = multiprocessing.get_context("spawn")
    for _ in range(2):
        ours, theirs = context.Pipe()
        with deaf():
            context.Process(target=tell, args=(theirs,), daemon=True).start()
        print(ours.recv())
    print(masked())
"""


def test_worker_processes_ignore_ctrl_c(tmp_path):
    """This includes the first process: multiprocessing starts its tracker and unblocks Ctrl-C."""
    (tmp_path / "masks.py").write_text(MASKS)
    found = python("masks.py", cwd=tmp_path, check=True)
    assert found.stdout.splitlines() == ["True", "True", "False"]


def test_processes_do_not_repeat_the_warnings_of_planning(capfd):
    study = STUDY.replace("python(function='misbehaving:{name}')", "gaussian")
    study = decode_study(study.replace('"random"', '"sobol | owen"').replace("[4]", "[100]"))
    with pytest.warns(NotPowerOfTwoWarning):
        make_plan(study, Path())
    executor = Dask(StudyText.of(study, Path()), Cluster(workers=1))
    executor.submit(StudyTask(path="a/sobol-owen/convergence", run=None))
    assert next(executor.outcomes()).error is None
    executor.close(cancel=False)
    assert capfd.readouterr().err == ""


def test_a_local_cluster_without_workers_raises_cluster_lost(monkeypatch):
    monkeypatch.setattr(executors, "_DESERTED", 1.0)
    executor = Dask(_text("good"), Cluster(workers=1))
    _end_after(60.0, executor)
    executor._client.retire_workers()  # Also retires the nanny, as if it could not start a process
    executor.submit(_task())
    try:
        with pytest.raises(ClusterLost, match="within 1 s.*--resume"):
            next(executor.outcomes())
    finally:
        executor.close(cancel=True)
