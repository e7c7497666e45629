"""A study has the same bits for any executor, chunks and interruptions; failures stay local."""

import contextlib
import os
import signal
import sys
import time
import tracemalloc
from dataclasses import dataclass
from pathlib import Path

import dask
import distributed  # noqa: F401 - its configuration must be loaded before it is changed
import msgspec
import numpy as np
import psutil
import pytest
import xarray as xr
from tests.processes import Fork, command

import mcspectra as mcs
from mcspectra.core.analysis import Analysis, Need, Reduction
from mcspectra.core.errors import StoreError
from mcspectra.core.records import SUM, unpack
from mcspectra.studies import (
    Trust,
    export_results,
    foreign_code,
    make_plan,
    open_results,
    run_study,
)
from mcspectra.studies import schedule as schedule_module
from mcspectra.studies.executors import Threads
from mcspectra.studies.files import decode_study
from mcspectra.studies.ledger import Ledger
from mcspectra.studies.run import CellFailed, drive
from mcspectra.studies.schedule import Schedule

STUDY = """
title = "bits"
seed = 3
samplers = ["random", "jittered | shift"]
[convergence]
counts = [64, 256]
realizations = 1500
[[estimators]]
name = "smooth"
integrand = "gaussian"
dims = 2
predict = { counts = [1], method = "exact" }
terms = { n = 64, half_width = 4, realizations = 1500 }
[[estimators]]
name = "mis"
integrand = "linear"
dims = 1
densities = ["uniform", "linear(slope=1)"]
convergence = { counts = [16, 64], realizations = 8000, relative_error = 0.1 }
"""
FUNCTIONS = """
title = "failures"
samplers = ["random"]
[convergence]
counts = [4, 16]
realizations = 10
"""


def _functions(*names):
    text = FUNCTIONS + "".join(
        f"[[estimators]]\nname = '{name}'\ndims = 1\n"
        f"integrand = \"python(function='misbehaving:{name}')\"\n"
        for name in names
    )
    return text, Trust(tuple(f"misbehaving:{name}" for name in names))


def _path(name):
    return f"{name.replace('_', '-')}/random/convergence"


@pytest.fixture(scope="module")
def folder(once, tmp_path_factory):
    """The results of the study, which tests only read."""

    def computed():
        folder = tmp_path_factory.mktemp("study")
        run_study(decode_study(STUDY), folder, workers=1)
        return folder

    return once("run", computed)


@pytest.fixture(scope="module")
def finished(folder, stored_values):
    return stored_values(folder)


def files_of(folder):
    """Return every file of a store."""
    tree = folder / "results.zarr"
    files = (path for path in tree.rglob("*") if path.is_file())
    return {path.relative_to(tree): path.read_bytes() for path in files}


def test_the_same_study_and_seed_give_the_same_store(folder, tmp_path):
    """Values, attributes and order agree, also for another number of workers."""
    run_study(decode_study(STUDY), tmp_path, workers=2)
    assert files_of(tmp_path) == files_of(folder)
    first = STUDY[: STUDY.index("predict")]  # The cells of one analysis are enough
    run_study(decode_study(first.replace("seed = 3", "seed = 4")), tmp_path / "4", workers=2)
    other = open_results(tmp_path / "4")["smooth/random/convergence"]
    assert not other["variance"].equals(open_results(folder)[other.path]["variance"])


def test_a_seed_of_128_bits_is_stored(tmp_path):
    """Such seeds come from numpy's SeedSequence and exceed the numbers of stores and ledgers."""
    seed = 2**127 + 1
    config = msgspec.structs.replace(
        decode_study(FUNCTIONS + "[[estimators]]\nname = 'a'\nintegrand = 'disk'\n"), seed=seed
    )
    run_study(config, tmp_path, workers=1)
    cells = [node for node in open_results(tmp_path).subtree if "seed" in node.attrs]
    assert {int(cell.attrs["seed"]) for cell in cells} == {seed}
    assert export_results(tmp_path, tmp_path / "x.zarr").is_dir()


def test_stored_results_equal_the_functions(finished):
    smooth, mis = (
        mcs.Estimator("gaussian", dims=2),
        mcs.MultipleImportance("linear", ["uniform", "linear(slope=1)"], dims=1),
    )
    expected = {
        "/smooth/jittered-shift/convergence": mcs.convergence(
            smooth, "jittered | shift", [64, 256], realizations=1500, rng=3
        ),
        "/smooth/random/terms": mcs.variance_terms(
            smooth, "random", 64, half_width=4, realizations=1500, rng=3
        ),
        "/mis/random/convergence": mcs.convergence(
            mis, "random", [16, 64], realizations=8000, relative_error=0.1, rng=3
        ),
    }
    for path, data in expected.items():
        for name in data.data_vars:
            assert finished[f"{path}/{name}"] == data[name].values.tobytes(), name


def test_chunks_of_one_block_give_the_same_bits(finished, tmp_path, stored_values, monkeypatch):
    """Each chunk is recorded here for a while; normally threads record no state of short work."""
    keys = []
    record = Ledger.record

    def noted(self, path, run, chunk, *rest):
        keys.append((path, run, chunk))
        record(self, path, run, chunk, *rest)

    monkeypatch.setattr(Ledger, "record", noted)
    monkeypatch.setattr(schedule_module, "_TARGET", 1e-9)
    monkeypatch.setattr(schedule_module, "_RECORDED_AFTER", 60.0)
    run_study(decode_study(STUDY), tmp_path / "short", workers=2)
    assert not keys
    monkeypatch.setattr(schedule_module, "_RECORDED_AFTER", 0.0)
    run_study(decode_study(STUDY), tmp_path / "out", workers=2)
    for out in ("short", "out"):
        assert stored_values(tmp_path / out) == finished
    assert len(keys) == len(set(keys)) > 10


def test_processes_under_a_time_limit_give_the_same_store(folder, tmp_path):
    run_study(decode_study(STUDY), tmp_path, workers=2, time_limit=1000.0)
    assert files_of(tmp_path) == files_of(folder)


@pytest.mark.endurance  # the load of the machine determines the moments of the kills
def test_killing_workers_one_after_another_fails_no_task(finished, tmp_path, stored_values):
    """After each cell, kill one worker with its running and waiting tasks."""
    killed = set()

    def kill(progress):
        workers = []
        for child in psutil.Process().children(recursive=True):
            with contextlib.suppress(psutil.Error):  # The process has just ended
                if child.parent().pid != os.getpid():  # Skip the fork server and the tracker
                    workers.append(child.pid)
        if progress.done < progress.cells and workers:
            killed.add(workers[progress.done % len(workers)])
            with contextlib.suppress(ProcessLookupError):
                os.kill(workers[progress.done % len(workers)], signal.SIGKILL)

    run_study(decode_study(STUDY), tmp_path, workers=2, time_limit=100.0, report=kill)
    assert stored_values(tmp_path) == finished
    assert len(killed) > 3


def test_interrupted_and_resumed_in_other_chunks_gives_the_same_bits(
    finished, tmp_path, stored_values, monkeypatch
):
    """Stop after every few tasks, each time with other chunks; no block is computed twice."""
    tasks = []

    class Stopping:
        """An executor that is interrupted after some outcomes."""

        def __init__(self, left):
            self._inner = Threads(1)
            self._left = left
            self.workers = 1
            self.submit = self._inner.submit

        def outcomes(self):
            for outcome in self._inner.outcomes():
                if self._left == 0:
                    raise KeyboardInterrupt
                self._left -= 1
                tasks.append(outcome.task)
                yield outcome

        def close(self, cancel):
            assert cancel or self._left >= 0
            self._inner.close(cancel)

    monkeypatch.setattr(schedule_module, "_RECORDED_AFTER", 0.0)
    for attempt in range(100):
        monkeypatch.setattr(schedule_module, "_TARGET", 1e-9 if attempt % 2 else 0.05)
        try:
            run_study(
                decode_study(STUDY),
                tmp_path,
                resume=attempt > 0,
                engine=lambda text: Stopping(5),
            )
            break
        except KeyboardInterrupt:
            continue
    assert 1 < attempt < 99
    assert stored_values(tmp_path) == finished
    computed = [
        (task.path, task.run, block)
        for task in tasks
        for block in range(task.chunk[0], sum(task.chunk))
    ]
    assert len(computed) == len(set(computed))


def test_failures_stay_in_their_cells(misbehaving, tmp_path, stored_values):
    """Failed cells are not computed on resume until they are retried."""
    text, trust = _functions("good", "raises", "nan", "hangs")
    study = decode_study(text)
    with pytest.raises(CellFailed, match="2 of 4 cells failed.*--retry") as caught:
        run_study(study, tmp_path / "out", trust=trust, workers=2)
    assert "ZeroDivisionError: no such light." in caught.value.failures[_path("raises")]
    assert "NaN or infinite" in caught.value.failures[_path("nan")]
    assert set(open_results(tmp_path / "out").children) == {"good", "hangs"}
    with pytest.raises(CellFailed) as again:
        run_study(study, tmp_path / "out", trust=trust, resume=True, engine=_no_engine)
    assert again.value.failures == caught.value.failures
    (misbehaving / "misbehaving.py").write_text(
        (misbehaving / "misbehaving.py")
        .read_text()
        .replace('raise ZeroDivisionError("no such light")', "return x[..., 0]")
    )
    sys.modules.pop("misbehaving")
    with pytest.raises(CellFailed) as last:
        run_study(study, tmp_path / "out", trust=trust, resume=True, retry=True, workers=1)
    assert list(last.value.failures) == [_path("nan")]
    values = stored_values(tmp_path / "out")
    assert values[f"/{_path('raises')}/variance"] == values[f"/{_path('hangs')}/variance"]


@pytest.mark.parametrize("limit", [None, 120.0])
def test_integrands_that_interrupt_cancel_or_exit_do_not_stop_the_run(
    misbehaving, tmp_path, capfd, limit
):
    """An interrupt that does not come from the user is a failure, in threads and processes."""
    text, trust = _functions("interrupts", "cancels", "leaves", "good")
    with pytest.raises(CellFailed) as caught:
        run_study(decode_study(text), tmp_path / "out", trust=trust, workers=2, time_limit=limit)
    assert caught.value.failures == {
        _path("interrupts"): "It raised KeyboardInterrupt.",
        _path("cancels"): "It raised CancelledError.",
        _path("leaves"): "It raised SystemExit: 3.",
    }
    assert set(open_results(tmp_path / "out").children) == {"good"}
    assert "Traceback" not in capfd.readouterr().err


AT_ONCE = {
    "raises_at_once": "It raised ZeroDivisionError: no light at all.",
    "nan_at_once": "The function is NaN or infinite at 28 of 28 points",
    "leaves_at_once": "It raised SystemExit: 3.",
    "interrupts_at_once": "It raised KeyboardInterrupt.",
    "hangs_at_once": "The function gave no values at its first few points within 0.3 s.",
}


def test_integrands_that_fail_while_the_study_is_planned_fail_their_cells_only(
    misbehaving, tmp_path, monkeypatch
):
    (misbehaving / "hang").touch()
    monkeypatch.setattr(foreign_code, "_PATIENCE", 0.3)
    text, trust = _functions("good", *AT_ONCE)
    study = decode_study(text)
    with pytest.raises(CellFailed, match="5 of 6 cells failed") as caught:
        run_study(study, tmp_path / "out", trust=trust, workers=2)
    assert list(caught.value.failures) == [_path(name) for name in AT_ONCE]
    for name, sentence in AT_ONCE.items():
        assert caught.value.failures[_path(name)].startswith(sentence)
    assert set(open_results(tmp_path / "out").children) == {"good"}
    with pytest.raises(CellFailed) as again:
        run_study(study, tmp_path / "out", trust=trust, resume=True, engine=_no_engine)
    assert again.value.failures == caught.value.failures
    (misbehaving / "hang").unlink()  # Only this has changed: now the function returns
    with pytest.raises(CellFailed, match="4 of 6 cells failed"):
        run_study(study, tmp_path / "out", trust=trust, resume=True, retry=True, workers=1)
    assert set(open_results(tmp_path / "out").children) == {"good", "hangs-at-once"}


def _no_engine(text):
    raise AssertionError(f"nothing is left to compute of {text}")


HANGS = {_path("hangs"): "It took longer than the time limit of 5 s and was stopped."}


@pytest.mark.parametrize("hangs", [{}, pytest.param(HANGS, marks=pytest.mark.slow)])
def test_a_process_that_dies_or_is_stopped_is_replaced(misbehaving, tmp_path, stored_values, hangs):
    """A task whose worker dies once, one that works, one that kills all, and one that may hang.

    The quick test of a task that hangs is in test_cluster.py.
    """
    (misbehaving / "hang").touch()
    text, trust = _functions(*["hangs"] * len(hangs), "dies_once", "good", "dies")
    study = decode_study(f"time_limit = {5 if hangs else 100}\n" + text)
    # dask's own patience with a starting worker ends at once, as under load
    impatient = {"distributed.deploy.lost-worker-timeout": 0}
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1} | impatient),
        pytest.raises(CellFailed) as caught,
    ):
        run_study(study, tmp_path, trust=trust, workers=2)
    assert caught.value.failures == hangs | {
        _path(
            "dies"
        ): "4 workers died while computing it; it may need more memory than a worker has "
        "(see the worker's log).",
    }
    assert (misbehaving / "died").exists()
    values = stored_values(tmp_path)
    assert values[f"/{_path('good')}/variance"] == values[f"/{_path('dies_once')}/variance"]


def _is_done(out, path):
    with contextlib.suppress(StoreError), Ledger.read(out) as ledger:
        return path in ledger.done
    return False


@pytest.mark.usefixtures("undrawn")
def test_interrupting_the_command_exits_130_and_loses_nothing(
    misbehaving, tmp_path, stored_values, hear_interrupts
):
    """Ctrl-C while a slow cell runs: the fast cell is stored, and --resume completes the rest."""
    text, trust = _functions("good", "slow")
    study = tmp_path / "study.toml"
    study.write_text(text.replace("[4, 16]", "[4, 8, 16, 32]").replace("= 10", "= 200"))
    (misbehaving / "slow").touch()
    asked = ["run", study, "--out", tmp_path / "out", "--workers", "2"]
    asked += [item for name in trust.code for item in ("--allow-code", name)]
    process = Fork(command, *asked, said=tmp_path / "said")
    try:
        while not _is_done(tmp_path / "out", _path("good")):
            assert process.poll() is None, (tmp_path / "said").read_text()
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        process.wait(60)
    finally:
        process.kill()
    message = (tmp_path / "said").read_text()
    assert process.returncode == 130
    assert "--resume continues" in message
    assert "Traceback" not in message
    (misbehaving / "slow").unlink()
    config = decode_study(study.read_text())
    run_study(config, tmp_path / "out", trust=trust, resume=True, workers=1)
    run_study(config, tmp_path / "straight", trust=trust, workers=1)
    assert stored_values(tmp_path / "out") == stored_values(tmp_path / "straight")


@dataclass
class Numbers:
    """A state of 8 kB that is merged by addition."""

    total: SUM


class Sums(Analysis, frozen=True, kw_only=True):
    """Trivial analysis of many blocks: the sum of their numbers."""

    def reduction(self, subject, stream):
        return Reduction(
            kind=Numbers,
            block=lambda index: Numbers(np.full(1000, float(index))),
            blocks=4_000,
            cost=4e3,
            result=lambda state: xr.Dataset({"x": ("n", state.total)}),
        )


@dataclass
class OneCell:
    """The part of a plan's cell that the schedule uses."""

    path: str
    analysis: Analysis
    need: Need
    error: None = None
    subject: None = None

    def finished(self, result, seed):
        return result


def test_memory_is_flat_over_thousands_of_tasks():
    """4,000 tasks of 8 kB each: at most 2 × workers are running, and states merge at once."""
    under_way = []

    class Empty:
        def tasks(self, path):
            return []

    class Watched:
        def __init__(self):
            self._inner = Threads(3)
            self.workers, self.outcomes = 3, self._inner.outcomes
            self.close = self._inner.close

        def submit(self, task, compute):
            assert task.chunk[1] == 1
            under_way.append(schedule.under_way)
            self._inner.submit(task, compute)

    for _ in range(2):  # The first run includes imports
        under_way.clear()
        schedule = Schedule([OneCell("a/s/k", Sums(), Need())], 0, Empty(), 1e-12)
        executor = Watched()
        tracemalloc.start()
        (settled,) = drive(schedule, executor)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        executor.close(cancel=False)
    assert unpack(xr.Dataset, settled.payload)["x"][0] == 4_000 * 3_999 / 2
    assert len(under_way) == 4_000
    assert max(under_way) <= 6
    # At most log2(4,000) states, six running tasks with their data, and a list of 4,000 numbers.
    assert peak < 2e6


def test_paths_of_the_test_are_those_of_the_plan(misbehaving):
    text, trust = _functions("dies_once")
    (cell,) = make_plan(decode_study(text), Path(), trust).cells
    assert cell.path == _path("dies_once")
    assert misbehaving.exists()
