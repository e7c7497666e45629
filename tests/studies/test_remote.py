"""What a worker does with a task: within its time, and whatever the task does."""

import threading

import pytest

from mcspectra.studies.engines import Outcome
from mcspectra.studies.remote import WorkerRefused, compute_remotely
from mcspectra.studies.tasks import StudyText, Task
from mcspectra.version import __version__

TEXT = StudyText(config_json="{}", folder="/", seed=0, version=__version__)
TASK = Task(
    key="a/0-0-1/0+1",
    path="a",
    run_part=0,
    first=0,
    realizations=1,
    blocks_total=1,
    chunk_first=0,
    chunk_blocks=1,
    cost=1.0,
)


def _done(_, task):
    return Outcome(key=task.key, payload=b"x")


@pytest.mark.parametrize("limit", [None, 60.0])
def test_an_outcome_leaves_the_worker_free(limit):
    assert compute_remotely(_done, TEXT, TASK, limit) == (_done(TEXT, TASK), False)


def test_what_takes_too_long_is_left_behind():
    gate = threading.Event()

    def waits(_, task):
        gate.wait(60)
        return Outcome(key=task.key)

    outcome, occupied = compute_remotely(waits, TEXT, TASK, 0.05)
    gate.set()
    assert occupied
    assert outcome.payload is None
    assert "0.05 s" in outcome.error
    assert outcome.seconds >= 0.05


@pytest.mark.parametrize("raised", [KeyboardInterrupt, SystemExit, ValueError])
def test_what_raises_is_not_taken_for_what_takes_too_long(raised):
    def raises(_, task):
        raise raised(task.key)

    with pytest.raises(raised, match=TASK.key.replace("+", r"\+")):
        compute_remotely(raises, TEXT, TASK, 60.0)


def test_a_worker_of_another_version_computes_nothing():
    text = StudyText(config_json="{}", folder="/", seed=0, version="0.0.0.none")
    with pytest.raises(WorkerRefused, match=r"started with 0\.0\.0\.none; install the same"):
        compute_remotely(lambda *_: pytest.fail("computed"), text, TASK, None)
