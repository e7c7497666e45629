"""Tasks are computed from text alone within a time limit, and return plain numbers."""

import pickle
import threading
from pathlib import Path

import msgspec
import pytest
import xarray as xr

import mcspectra as mcs
from mcspectra.core.analysis import MergeTree, chunks
from mcspectra.core.errors import ConfigError, ParameterError
from mcspectra.core.records import unpack
from mcspectra.core.streams import Stream
from mcspectra.studies.files import decode_study
from mcspectra.studies.foreign_code import explain
from mcspectra.studies.tasks import (
    Outcome,
    StudyTask,
    StudyText,
    WorkerRefused,
    attempt,
    compute_elsewhere,
)
from mcspectra.studies.vetting import Trust
from mcspectra.version import __version__

STUDY = """
title = "t"
seed = 5
samplers = ["jittered | shift"]
[pcf]
n = 1024
realizations = 64
[[estimators]]
name = "a"
integrand = "linear"
dims = 1
"""
PATH = "a/jittered-shift/pcf"
TEXT = StudyText(config_json="{}", folder="/", seed=0, version=__version__)
TASK = StudyTask(path="a", run="r")


def _text(study=STUDY, **changes):
    text = StudyText.of(decode_study(study), Path())
    return msgspec.structs.replace(text, **changes)


def test_keys_identify_tasks():
    task = StudyTask(path="a/b/convergence", run="2-100-25", chunk=(4, 2))
    assert task.key == "a/b/convergence/2-100-25/4+2"
    assert StudyTask(path="a/b/exact", run=None).key == "a/b/exact"
    assert pickle.loads(pickle.dumps(task)) == task


def test_a_worker_needs_only_text():
    """The text is converted to JSON and back; the result equals that of the function."""
    text = msgspec.json.decode(msgspec.json.encode(_text()), type=StudyText)
    wanted = mcs.pair_correlation(mcs.sampler("jittered | shift", 1), 1024, realizations=64, rng=5)
    outcome = attempt(text, StudyTask(path=PATH, run=None))
    found = unpack(xr.Dataset, outcome.payload)
    assert found["pair_correlation"].identical(wanted["pair_correlation"])
    assert found.attrs["estimator_name"] == "a"
    assert outcome.error is None
    assert outcome.host
    assert outcome.seconds > 0

    # The chunks of the reduction, which the worker finds by its key, give the same result
    cell = text.cells()[PATH]
    run = cell.analysis.reduction(cell.subject, Stream.from_rng(5))
    assert run.blocks > 9
    tasks = [StudyTask(path=PATH, run=run.key, chunk=chunk) for chunk in chunks(run.blocks, 1)]
    tree = MergeTree()
    for task in tasks:
        tree.add(unpack(run.kind, attempt(text, task).payload))
    assert run.result(tree.total())["pair_correlation"].identical(wanted["pair_correlation"])


def test_unknown_cells_are_refused():
    assert "no cell 'a/b'" in attempt(_text(), StudyTask(path="a/b", run=None)).error


def test_trust_is_sent_with_the_text():
    study = STUDY.replace('"linear"', "\"python(function='strangers:f')\"")
    trust = Trust(("a:b",), (Path("elsewhere"),))
    text = StudyText.of(decode_study(study), Path(), trust)
    assert text.code == ("a:b",)
    assert text.paths == (str(Path("elsewhere").absolute()),)
    assert text.folder == str(Path().absolute())
    with pytest.raises(ConfigError, match="--allow-code strangers:f"):
        text.cells()


FUNCTION = STUDY.replace('"linear"', "\"python(function='misbehaving:{}')\"").replace(
    "[pcf]\nn = 1024\nrealizations = 64", "[convergence]\ncounts = [4]\nrealizations = 10"
)


def _misbehaving(name):
    return StudyText.of(
        decode_study(FUNCTION.format(name)), Path(), Trust((f"misbehaving:{name}",))
    )


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("raises", "failed on points of shape (10, 4, 1): ZeroDivisionError: no such light."),
        ("leaves", "It raised SystemExit: 3."),
        ("interrupts", "It raised KeyboardInterrupt."),
        ("cancels", "It raised CancelledError."),
        ("wordless", "Wordless."),
        ("verbose", "ValueError: \\x1b[31mmuch much"),
        ("nan", "NaN or infinite"),
        ("infinite", "NaN or infinite"),
    ],
)
def test_whatever_an_integrand_does_becomes_a_sentence(misbehaving, name, sentence):
    outcome = attempt(_misbehaving(name), StudyTask(path="a/jittered-shift/convergence", run=None))
    assert outcome.payload is None
    assert sentence in outcome.error
    assert len(outcome.error) < 1000
    assert outcome.error.isprintable()
    assert outcome.host
    assert outcome.seconds > 0
    assert misbehaving.exists()


def test_failures_are_sentences():
    assert explain(ParameterError("n is 3; give 4.")) == "n is 3; give 4."
    assert explain(ZeroDivisionError("division by zero")) == (
        "It raised ZeroDivisionError: division by zero."
    )
    assert explain(KeyError()) == "It raised KeyError."
    assert explain(ValueError("two\nlines.")) == "It raised ValueError: two lines."
    assert len(explain(ValueError("x" * 10**6))) < 1000


def _done(_, task):
    return Outcome(task=task, payload=b"x")


@pytest.mark.parametrize("limit", [None, 60.0])
def test_an_outcome_leaves_the_worker_free(limit):
    assert compute_elsewhere(_done, TEXT, TASK, limit) == (_done(TEXT, TASK), False)


def test_a_task_beyond_its_time_limit_is_abandoned():
    gate = threading.Event()

    def waits(_, task):
        gate.wait(60)
        return Outcome(task=task)

    outcome, occupied = compute_elsewhere(waits, TEXT, TASK, 0.05)
    gate.set()
    assert occupied
    assert outcome.payload is None
    assert "0.05 s" in outcome.error
    assert outcome.seconds >= 0.05


def test_a_worker_of_another_version_computes_nothing():
    text = msgspec.structs.replace(TEXT, version="0.0.0.none")
    with pytest.raises(WorkerRefused, match=r"started with 0\.0\.0\.none; install the same"):
        compute_elsewhere(lambda *_: pytest.fail("computed"), text, TASK, None)


def test_a_worker_that_cannot_build_the_study_computes_nothing(misbehaving):
    text = msgspec.structs.replace(_misbehaving("good"), code=())
    with pytest.raises(WorkerRefused, match=r"cannot build the study: .*--allow-code misbehaving"):
        compute_elsewhere(attempt, text, TASK, None)
    assert misbehaving.exists()
