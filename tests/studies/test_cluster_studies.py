"""Whole studies on dask: the same bits as on one thread, and resumed after a scheduler dies."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.studies.local_cluster import local_cluster, scheduler, worker

from mcspectra.cli.main import main
from mcspectra.core.errors import StoreError
from mcspectra.studies import Trust, run_study, schedule
from mcspectra.studies.executors import Cluster, ClusterLost, Dask
from mcspectra.studies.files import decode_study
from mcspectra.studies.ledger import Ledger

STUDY = """
title = "small"
seed = 3
samplers = ["random", "jittered | shift"]
[convergence]
counts = [16, 64]
realizations = 3000
[spectrum]
n = 16
half_width = 8
realizations = 50
[[estimators]]
name = "smooth"
integrand = "gaussian"
dims = 2
"""


@pytest.fixture(scope="module")
def expected(once, tmp_path_factory, stored_values):
    def computed():
        folder = tmp_path_factory.mktemp("threads")
        run_study(decode_study(STUDY), folder, workers=1)
        return stored_values(folder)

    return once("threads", computed)


@pytest.fixture(scope="module")
def cluster():
    with local_cluster(2) as cluster:
        yield cluster


def on(address, **options):
    return lambda text: Dask(text, Cluster(address=address, **options))


def test_same_bits_for_other_workers_and_chunks(
    expected, cluster, tmp_path, monkeypatch, stored_values
):
    monkeypatch.setattr(schedule, "_TARGET", 0.01)
    run_study(decode_study(STUDY), tmp_path, engine=on(cluster.scheduler_address))
    assert stored_values(tmp_path) == expected
    assert len(expected) > 20


def test_the_scheduler_is_killed_and_the_store_resumed(expected, tmp_path, stored_values):
    file = tmp_path / "scheduler.json"
    processes = [
        start("--scheduler-file", str(file), *options)
        for start, *options in ((scheduler, "--port", "0"), (worker,))
    ]
    try:
        deadline = time.monotonic() + 60
        while not file.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        with pytest.raises(ClusterLost, match="--resume continues"):
            run_study(
                decode_study(STUDY),
                tmp_path / "out",
                engine=_impatient(on(str(file))),
                report=lambda progress: processes[0].kill(),
            )
    finally:
        for process in processes:
            process.kill()
            process.join()
    stored = stored_values(tmp_path / "out")
    assert 0 < len(stored) < len(expected)
    run_study(decode_study(STUDY), tmp_path / "out", resume=True, workers=1)
    assert stored_values(tmp_path / "out") == expected


def _impatient(make):
    """Make an executor that waits long for the first connection, but 1 s for a lost one."""

    def engine(text):
        made = make(text)
        made._client._timeout = 1.0
        return made

    return engine


@pytest.mark.usefixtures("undrawn")
def test_the_command_runs_on_a_cluster(expected, cluster, tmp_path, capsys, stored_values):
    study = tmp_path / "small.toml"
    study.write_text(STUDY)
    out = str(tmp_path / "out")
    arguments = ["run", str(study), "--out", out, "--cluster", cluster.scheduler_address]
    assert main(arguments) == 0
    assert f"dask: {cluster.scheduler_address}, dashboard: http://127" in capsys.readouterr().err
    assert stored_values(tmp_path / "out") == expected


HANGS = """
title = "hangs"
seed = 3
samplers = ["random", "jittered"]
[convergence]
counts = [4, 16]
realizations = 10
[[estimators]]
name = "smooth"
integrand = "gaussian"
dims = 2
[[estimators]]
name = "hangs"
integrand = "python(function='misbehaving:hangs')"
dims = 1
samplers = ["random"]
"""


def test_ctrl_c_leaves_a_resumable_store_and_no_cluster(
    misbehaving, tmp_path, hear_interrupts, stored_values
):
    """One task hangs until it is interrupted, so that the signal always comes before the end."""
    (tmp_path / "study.toml").write_text(HANGS)
    (misbehaving / "hang").touch()
    out, allowed = tmp_path / "out", "misbehaving:hangs"
    command = [sys.executable, "-m", "tests.studies.undrawn", "run", str(tmp_path / "study.toml")]
    command += ["--out", str(out), "--cluster", "local", "--workers", "2"]
    modules = os.pathsep.join([str(misbehaving), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(
        [*command, "--allow-code", allowed],
        cwd=Path(__file__).parents[2],
        env={**os.environ, "PYTHONPATH": modules},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        end = time.monotonic() + 120
        while not ((misbehaving / "begun").exists() and _some_are_done(out)):
            assert process.poll() is None, process.communicate()[1]
            assert time.monotonic() < end
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)  # Like a terminal: signals it and its workers
        _, err = process.communicate(timeout=120)
    except BaseException:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        raise
    assert process.returncode == 130, err
    assert "Interrupted" in err
    assert "Traceback" not in err
    assert "distributed" not in err
    with pytest.raises(ProcessLookupError):
        _wait_for_group(process.pid)
    stored = stored_values(out)
    (misbehaving / "hang").unlink()
    config, trust = decode_study(HANGS), Trust((allowed,))
    run_study(config, out, resume=True, trust=trust, workers=1)
    run_study(config, tmp_path / "straight", trust=trust, workers=1)
    assert stored_values(out) == stored_values(tmp_path / "straight")
    assert 0 < len(stored) < len(stored_values(tmp_path / "straight"))


def _some_are_done(out):
    with contextlib.suppress(StoreError), Ledger.read(out) as ledger:
        return bool(ledger.done)
    return False


def _wait_for_group(group):
    """Raise ProcessLookupError when a process group is empty; wait up to 10 s."""
    for _ in range(100):
        os.killpg(group, 0)
        time.sleep(0.1)


@pytest.mark.usefixtures("undrawn")
def test_json_output_does_not_mention_dask(cluster, tmp_path, capsys):
    study = tmp_path / "small.toml"
    study.write_text(STUDY)
    arguments = ["run", str(study), "--out", str(tmp_path / "out"), "--json"]
    assert main([*arguments, "--cluster", cluster.scheduler_address]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["rows"]
    assert shown.err == ""
