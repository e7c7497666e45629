"""Runs that are killed, run out of disk space, are damaged or run twice end like undisturbed runs.

Stores are compared file by file, byte for byte: names, metadata, attributes and chunks.
"""

import contextlib
import ctypes
import json
import os
import re
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.processes import Fork, command
from tests.studies.killed_runs import all_trials

from mcspectra.cli.main import main
from mcspectra.core.errors import DamagedResultsWarning, StoreError
from mcspectra.studies import decode_study, run_study, schedule, study_status
from mcspectra.studies import ledger as ledger_module
from mcspectra.studies import run as run_module
from mcspectra.studies.executors import Threads
from mcspectra.studies.ledger import LEDGER_NAME, Ledger, is_held

STUDY = """
title = "killed"
seed = 11
samplers = ["random", "jittered"]
[convergence]
counts = [16, 64]
realizations = 40000
[predict]
counts = [4]
method = "exact"
[[estimators]]
name = "smooth"
integrand = "gaussian"
dims = 2
"""
CONFIG = decode_study(STUDY)
CELLS = 4
ONE_THREAD = {**os.environ, "OMP_NUM_THREADS": "1"}


def stored(folder):
    """Return every file of a store."""
    tree = folder / "results.zarr"
    files = (path for path in tree.rglob("*") if path.is_file())
    return {str(path.relative_to(tree)): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    file = tmp_path_factory.mktemp("study") / "study.toml"
    file.write_text(STUDY)
    return file


@pytest.fixture(scope="module")
def straight(once, tmp_path_factory):
    """The store of an undisturbed run."""

    def computed():
        out = tmp_path_factory.mktemp("straight")
        run_study(CONFIG, out, workers=1)
        return stored(out)

    return once("straight", computed)


PROGRAM = [sys.executable, "-m", "tests.studies.undrawn"]
ROOT = Path(__file__).parents[2]


def asked(study, out, *more):
    return ["run", str(study), "--out", str(out), "--workers", "1", "--quiet", *more]


def assert_finished(out, straight):
    """Check that the store is complete and correct, and that no other files are left."""
    found = stored(out)
    assert found.keys() == straight.keys()
    assert [name for name in found if found[name] != straight[name]] == []
    status = study_status(out, verify=True)
    assert status.state == "finished"
    assert len(status.done) == CELLS
    for lacking in (status.failed, status.missing, status.damaged, status.holder):
        assert not lacking
    leftover = {path.name for path in out.iterdir()}
    assert leftover <= {"results.zarr", LEDGER_NAME, "study.lock", "report.html", "figures"}


@pytest.mark.parametrize("kills", [2, pytest.param(150, marks=pytest.mark.endurance)])
def test_killed_at_any_moment_and_resumed(study, tmp_path, straight, kills):
    """Uses forks with imported modules: see killed_runs.py."""
    trials = all_trials(study, tmp_path, kills, 1)
    assert len(trials) == kills
    ends = [end for trial in trials for end in trial["ends"]]
    assert ends.count(-signal.SIGKILL) >= kills // 2
    # A resumed run is shorter, so it may end before the chosen moment.
    assert set(ends) <= {-signal.SIGKILL, 0}
    for trial in trials:
        assert trial["last"] == 0
        assert_finished(Path(trial["out"]), straight)


class Interrupted:
    """Threads that raise KeyboardInterrupt after some outcomes."""

    def __init__(self, outcomes):
        self._inner = Threads(1)
        self._outcomes = outcomes
        self.workers = 1
        self.submit = self._inner.submit
        self.close = self._inner.close

    def outcomes(self):
        for count, outcome in enumerate(self._inner.outcomes()):
            if count == self._outcomes:
                raise KeyboardInterrupt
            yield outcome


def interrupted_run(out, outcomes=12, **options):
    """Compute some tasks of one block each, then stop."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(schedule, "_TARGET", 1e-9)
        with pytest.raises(KeyboardInterrupt):
            run_study(CONFIG, out, engine=lambda _: Interrupted(outcomes), **options)


@pytest.fixture(scope="module")
def half(tmp_path_factory):
    """An interrupted run with one stored cell and some recorded tasks."""
    out = tmp_path_factory.mktemp("half")
    interrupted_run(out)
    status = study_status(out, verify=True)
    assert 0 < len(status.done) < CELLS
    assert status.recorded > 0
    return out


def damaged(out, query, at=100):
    """Change one byte of the payloads that a query finds in the ledger."""
    with contextlib.closing(sqlite3.connect(out / LEDGER_NAME)) as connection:
        payloads = [payload for (payload,) in connection.execute(query)]
    content = bytearray((out / LEDGER_NAME).read_bytes())
    for payload in payloads:
        content[content.index(payload) + at] ^= 1
    (out / LEDGER_NAME).write_bytes(content)


@pytest.mark.parametrize("at", [3, 100, 1000])
def test_a_damaged_result_is_named_and_computed_again(half, tmp_path, straight, at):
    out = shutil.copytree(half, tmp_path / "out")
    (path, *_) = study_status(out).done
    damaged(out, "SELECT payload FROM results LIMIT 1", at)
    with pytest.warns(DamagedResultsWarning, match=f"^1 part of .*{path} .its digest does not"):
        run_study(CONFIG, out, resume=True, workers=1)
    assert_finished(out, straight)


def test_a_damaged_record_is_named_and_computed_again(half, tmp_path, straight):
    out = shutil.copytree(half, tmp_path / "out")
    damaged(out, "SELECT payload FROM tasks LIMIT 1", 30)
    (key,) = study_status(out, verify=True).damaged
    with pytest.warns(DamagedResultsWarning) as caught:
        run_study(CONFIG, out, resume=True, workers=1)
    assert key in str(caught[0].message)
    assert_finished(out, straight)


def test_the_sound_half_of_a_truncated_ledger_is_kept(half, tmp_path, straight):
    out = shutil.copytree(half, tmp_path / "out")
    size = (out / LEDGER_NAME).stat().st_size
    os.truncate(out / LEDGER_NAME, size // 2)
    with pytest.raises(StoreError, match=r"is damaged: pages .* missing; .*--resume keeps"):
        study_status(out)
    said = study_status(out, verify=True)
    assert said.damaged["file"] == "pages of the file are damaged or missing"
    with pytest.warns(
        DamagedResultsWarning, match="(is|are) damaged, and lost results are computed"
    ):
        run_study(CONFIG, out, resume=True, workers=1)
    assert_finished(out, straight)
    os.truncate(out / LEDGER_NAME, 8192)
    for look in (study_status, lambda out, **_: run_study(CONFIG, out, resume=True)):
        with pytest.raises(StoreError, match="does not identify its study"):
            look(out, verify=True)


def test_only_the_first_damaged_parts_are_named(half, tmp_path, straight, monkeypatch):
    monkeypatch.setattr(run_module, "_NAMED", 1)
    out = shutil.copytree(half, tmp_path / "out")
    run_study(CONFIG, out, resume=True, workers=1)
    damaged(out, "SELECT payload FROM results")
    with pytest.warns(DamagedResultsWarning, match=r"4 parts .* and 3 more\."):
        run_study(CONFIG, out, resume=True, workers=1)
    assert_finished(out, straight)


def test_results_do_not_depend_on_clocks_and_host_names(tmp_path, straight, monkeypatch):
    """Begin on host a in 2091 and continue on host b in 1999, with clocks that run backwards."""
    clock = {"now": 3.8e9}

    def backwards():
        clock["now"] -= 1000.0
        return clock["now"]

    monkeypatch.setattr(time, "time", backwards)
    for host, now in (("a", 3.8e9), ("b", 9.4e8)):
        clock["now"] = now
        monkeypatch.setattr(socket, "gethostname", lambda host=host: host)
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S+00:00", time.gmtime(now))
        monkeypatch.setattr(ledger_module, "_now", lambda stamp=stamp: stamp)
        if host == "a":
            interrupted_run(tmp_path)
    run_study(CONFIG, tmp_path, resume=True, workers=1)
    assert_finished(tmp_path, straight)
    status = study_status(tmp_path)
    assert {"a", "b"} <= set(status.hosts)
    assert (status.started[:4], status.finished[:4]) == ("2090", "1999")


def test_the_folder_is_locked_from_the_first_change_to_the_last(tmp_path, straight, monkeypatch):
    """Two runs started at once cannot both read the results before one of them has the lock."""
    seen = []

    def noted(name, function):
        def call(*arguments, **options):
            seen.append((name, is_held(tmp_path)))
            return function(*arguments, **options)

        return call

    for name in ("_replace", "finish", "close"):
        monkeypatch.setattr(Ledger, name, noted(name, getattr(Ledger, name)))
    monkeypatch.setattr(run_module, "write_zarr", noted("write", run_module.write_zarr))
    run_study(CONFIG, tmp_path, workers=1)
    assert {name for name, _ in seen} == {"_replace", "finish", "write", "close"}
    assert all(held for _, held in seen)
    assert not is_held(tmp_path)
    assert_finished(tmp_path, straight)


def test_a_refused_run_releases_the_lock(half, tmp_path):
    out = shutil.copytree(half, tmp_path / "out")
    with pytest.raises(StoreError, match="already holds results"):
        run_study(CONFIG, out)
    assert not is_held(out)


FUNCTION = """
title = "waits"
samplers = ["random"]
[convergence]
counts = [4, 16]
realizations = 10
[[estimators]]
name = "waits"
integrand = "python(function='misbehaving:hangs')"
dims = 1
"""


def waiting(misbehaving, folder, limit=""):
    """Return a command whose integrand hangs while a file exists; a time limit adds a process."""
    study = folder / "study.toml"
    study.write_text(limit + FUNCTION)
    (misbehaving / "hang").touch()
    return asked(study, folder / "out", "--allow-code", "misbehaving:hangs")


def wait_for(condition, process, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.usefixtures("undrawn")
def test_a_second_run_is_refused_and_the_first_goes_on(misbehaving, tmp_path, capsys):
    arguments = waiting(misbehaving, tmp_path)
    process = Fork(command, *arguments)
    try:
        wait_for((tmp_path / "out" / LEDGER_NAME).exists, process)
        assert main([*arguments, "--resume"]) == 2
        said = capsys.readouterr().err
        assert f"is being written by process {process.pid}" in said
        assert said.count("\n") == 1
        (misbehaving / "hang").unlink()
        assert process.wait(60) == 0
    finally:
        process.kill()
    status = study_status(tmp_path / "out", verify=True)
    assert status.state == "finished"
    assert len(status.done) == 1


def process_env(misbehaving):
    paths = [str(misbehaving), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**ONE_THREAD, "PYTHONPATH": os.pathsep.join(paths)}


def children(pid):
    """Return the child processes of a process, from /proc."""
    found = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            # The second field is the name in parentheses, which may contain blanks.
            fields = file.read_text().rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(fields[1]) == pid and fields[0] != "Z":
            found.append(int(file.parent.name))
    return found


@pytest.mark.usefixtures("undrawn")
def test_no_worker_outlives_a_run_that_is_killed(misbehaving, tmp_path):
    """This holds even if a worker's task hangs; the store can be resumed at once."""
    arguments = waiting(misbehaving, tmp_path, "time_limit = 1000\n")
    process = subprocess.Popen(
        [*PROGRAM, *arguments], cwd=ROOT, env=process_env(misbehaving), stderr=subprocess.DEVNULL
    )
    try:
        wait_for((misbehaving / "begun").exists, process)
        workers = children(process.pid)
        assert workers
        process.kill()
        process.wait()
        end = time.monotonic() + 30
        while any(Path(f"/proc/{pid}").exists() for pid in workers):
            assert time.monotonic() < end, "a worker is left"
            time.sleep(0.05)
    finally:
        process.kill()
        process.wait()
    (misbehaving / "hang").unlink()
    assert main([*arguments, "--resume"]) == 0
    assert study_status(tmp_path / "out").state == "finished"


NAMESPACE = ["unshare", "--user", "--map-root-user", "--mount"]


def _can_mount():
    try:
        made = subprocess.run(
            [*NAMESPACE, "mount", "-t", "tmpfs", "none", "/tmp"], capture_output=True, check=False
        )
    except FileNotFoundError:
        return False
    return made.returncode == 0


def on_small_disk(folder, size, arguments):
    """Run on a file system of `size` and resume on a larger one; write the exit codes to a file.

    The file systems are mounted in the namespaces of this process, which should be a fork.
    """
    disk, kept, said = folder / "disk", folder / "kept", folder / "said"
    user, group = os.getuid(), os.getgid()
    if ctypes.CDLL(None).unshare(CLONE_NEWUSER | CLONE_NEWNS):
        return 1
    for name, line in (("setgroups", "deny"), ("uid", f"0 {user} 1"), ("gid", f"0 {group} 1")):
        Path("/proc/self", name if name == "setgroups" else f"{name}_map").write_text(line)

    def mount(*options):
        subprocess.run(["mount", *options, disk], check=True)

    mount("-t", "tmpfs", "-o", f"size={size}", "tmpfs")
    first = Fork(command, *arguments, said=said).wait()
    shutil.copytree(disk, kept)
    mount("-o", "remount,size=64m")
    second = Fork(command, *arguments, "--resume", said=said).wait()
    shutil.copytree(disk, folder / "after")
    (folder / "codes").write_text(json.dumps([first, second]))
    return 0


CLONE_NEWNS, CLONE_NEWUSER = 0x20000, 0x10000000  # As in linux/sched.h
SIZES = ["200k"] if _can_mount() else []


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("size", SIZES)
def test_a_full_disk_is_one_sentence_and_loses_nothing(study, tmp_path, straight, size):
    disk, kept, errors = tmp_path / "disk", tmp_path / "kept", tmp_path / "errors"
    disk.mkdir()
    ended = Fork(on_small_disk, tmp_path, size, asked(study, disk), said=errors).wait(200.0)
    assert ended == 0, errors.read_text()
    assert json.loads((tmp_path / "codes").read_text()) == [1, 0]
    said = (tmp_path / "said").read_text()
    assert "cannot be written: " in said
    assert re.search("disk is full|No space left|its file system failed", said)
    assert said.count("\n") == 1
    if (kept / LEDGER_NAME).exists():  # Everything that the ledger lists is present and sound
        assert study_status(kept, verify=True).damaged == {}
    assert_finished(tmp_path / "after", straight)
