"""Engines hand back every task once, hold few, and survive what tasks do."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import msgspec
import pytest

from mcspectra.core.errors import NotPowerOfTwoWarning, ParameterError
from mcspectra.studies import processes
from mcspectra.studies.files import decode_study
from mcspectra.studies.engines import LocalEngine, Outcome, attempt
from mcspectra.studies.plan import make_plan
from mcspectra.studies.processes import EngineFailed, ProcessEngine, check_time_limit
from mcspectra.studies.tasks import StudyText, Task
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


def _task(key="a/random/convergence/0-0-10/0+1", blocks=1):
    return Task(
        key=key,
        path="a/random/convergence",
        run_part=-1,
        first=0,
        realizations=10,
        blocks_total=blocks,
        chunk_first=0,
        chunk_blocks=1,
        cost=1.0,
    )


def _text(name):
    trust = Trust((f"misbehaving:{name}",))
    return StudyText.of(decode_study(STUDY.format(name=name)), Path(), trust)


@pytest.mark.parametrize("workers", [1, 3])
def test_every_task_comes_back_once(workers):
    threads = set()

    def compute(text, task):
        threads.add(threading.current_thread())
        time.sleep(0.001)
        return Outcome(key=f"{text} {task.key}")

    engine = LocalEngine("study", workers, compute)
    assert engine.workers == workers
    assert list(engine.outcomes()) == []
    for i in range(20):
        engine.submit(_task(str(i)))
    found = []
    for outcome in engine.outcomes():
        found.append(outcome.key)
        if len(found) == 5:
            engine.submit(_task("late"))
    assert sorted(found) == sorted([f"study {i}" for i in range(20)] + ["study late"])
    engine.close(cancel=False)
    assert len(threads) <= workers
    assert not any(thread.is_alive() for thread in threads)


def test_cancelled_tasks_do_not_begin():
    begun = []
    gate = threading.Event()

    def compute(_, task):
        begun.append(task.key)
        gate.wait(10)
        return Outcome(key=task.key)

    engine = LocalEngine("study", 1, compute)
    for i in range(50):
        engine.submit(_task(str(i)))
    threading.Timer(0.1, gate.set).start()
    engine.close(cancel=True)
    assert begun in (["0"], [])


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("raises", "It raised ZeroDivisionError: no such light."),
        ("leaves", "It raised SystemExit: 3."),
        ("interrupts", "It raised KeyboardInterrupt."),
        ("cancels", "It raised CancelledError."),
        ("wordless", "It raised Wordless."),
        ("verbose", "It raised ValueError: [31mmuch much"),
        ("nan", "NaN or infinite"),
        ("infinite", "NaN or infinite"),
    ],
)
def test_whatever_an_integrand_does_becomes_a_sentence(misbehaving, name, sentence):
    outcome = attempt(_text(name), _task())
    assert outcome.payload is None
    assert sentence in outcome.error
    assert len(outcome.error) < 1000
    assert outcome.error.isprintable()
    assert outcome.host
    assert outcome.seconds > 0
    assert misbehaving.exists()


@pytest.mark.parametrize("value", [0, -1.0, float("nan"), float("inf"), "3", True, 1e10])
def test_time_limits_that_are_none(value):
    with pytest.raises(ParameterError, match="time_limit"):
        check_time_limit(value)


def test_time_limits():
    assert check_time_limit(None) is None
    assert check_time_limit(3) == 3.0


def test_workers_that_cannot_build_the_study_are_an_error(misbehaving):
    text = msgspec.structs.replace(_text("good"), code=())
    engine = ProcessEngine(text, 1)
    engine.submit(_task())
    try:
        with pytest.raises(EngineFailed, match="--allow-code misbehaving:good"):
            next(engine.outcomes())
    finally:
        engine.close(cancel=True)
    assert misbehaving.exists()


MASKS = """
import multiprocessing, signal, sys
from mcspectra.studies import interrupts

def masked():
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())

def tell(pipe):
    before = masked()
    interrupts.ignore()
    pipe.send((before, masked(), signal.getsignal(signal.SIGINT) is signal.SIG_IGN))

if __name__ == "__main__":
    context = multiprocessing.get_context("spawn")
    for _ in range(2):
        ours, theirs = context.Pipe()
        with interrupts.blocked():
            context.Process(target=tell, args=(theirs,), daemon=True).start()
        print(ours.recv())
    print(masked())
"""


def test_processes_begin_deaf_to_ctrl_c_and_then_ignore_it(tmp_path):
    """The first one too: before it, multiprocessing starts a process, and then unblocks Ctrl-C."""
    (tmp_path / "masks.py").write_text(MASKS)
    found = subprocess.run(
        [sys.executable, "masks.py"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert found.stdout.splitlines() == ["(True, False, True)"] * 2 + ["False"]


def test_processes_do_not_repeat_the_warnings_of_planning(capfd):
    study = STUDY.replace("python(function='misbehaving:{name}')", "gaussian")
    study = decode_study(study.replace('"random"', '"sobol | owen"').replace("[4]", "[100]"))
    with pytest.warns(NotPowerOfTwoWarning):
        make_plan(study, Path())
    engine = ProcessEngine(StudyText.of(study, Path()), 1)
    engine.submit(_task("a/sobol-owen/convergence/0-0-10/0+1"))
    next(engine.outcomes())
    engine.close(cancel=False)
    assert capfd.readouterr().err == ""


def test_a_process_that_is_stopped_or_dies_is_replaced(misbehaving, monkeypatch):
    """One worker: a task that hangs, one whose worker dies once, and one that just works."""
    study = decode_study(
        STUDY.format(name="hangs")
        + "".join(
            f"[[estimators]]\nname = '{name}'\ndims = 1\n"
            f"integrand = \"python(function='misbehaving:{name}')\"\n"
            for name in ("dies_once", "good", "dies")
        )
    )
    names = ("hangs", "dies_once", "good", "dies")
    text = StudyText.of(study, Path(), Trust(tuple(f"misbehaving:{name}" for name in names)))
    (misbehaving / "hang").touch()
    tasks = [
        msgspec.structs.replace(_task(name), path=f"{name.replace('_', '-')}/random/convergence")
        for name in names[1:]
    ]
    monkeypatch.setattr(processes, "_ATTEMPTS", 2)
    engine = ProcessEngine(text, 1, 5.0)
    engine.submit(_task("hangs"))
    for task in tasks:
        engine.submit(task)
    found = {outcome.key: outcome for outcome in engine.outcomes()}
    engine.close(cancel=False)
    assert found.keys() == set(names)
    assert found["hangs"].error == "It took longer than the time limit of 5 s and was stopped."
    assert found["dies"].error == "Its worker process ended 2 times (signal SIGKILL); gave up."
    assert (misbehaving / "died").exists()
    # dies_once and good have the same values, hence the same moments.
    assert found["dies_once"].error is found["good"].error is None
    local = attempt(text, tasks[1])
    assert found["good"].payload == local.payload
