"""Faults of the files of a study: lost pages, power, memory, clocks and locks.

``python -m tests.studies.trials KIND [TRIALS [SEED]]`` prints the numbers of passed and failed
trials. The kinds are: ``pages`` zeroes each page of a ledger, ``power`` drops writes that were not
synced, ``memory`` makes allocations fail, ``clocks`` makes the clock jump, ``locks`` removes locks
from the file system. A trial passes if the resumed run has exactly the results of an undisturbed
run. All kinds except the first need a C compiler and Linux: see faults.c.
"""

import contextlib
import ctypes
import functools
import hashlib
import itertools
import json
import os
import random
import shutil
import struct
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from pathlib import Path

import msgspec
from tests.processes import Fork, python
from tests.report.figures import without_figures
from tests.studies.killed_runs import all_trials, in_short_tasks

from mcspectra.cli.main import main
from mcspectra.core.errors import StoreError
from mcspectra.studies import decode_study, make_plan, run_study, study_status
from mcspectra.studies.ledger import LEDGER_NAME, Ledger
from mcspectra.studies.results import open_results

ROOT = Path(__file__).parents[2]
PAGE, SECTOR = 8192, 4096
LONGEST = 60  # Maximum duration of a run in seconds
MANY = """
title = "pages"
seed = 11
samplers = ["random", "jittered"]
[convergence]
counts = [4, 16]
realizations = 8
[predict]
counts = [4]
method = "exact"
[terms]
n = 16
half_width = 4
realizations = 8
[[estimators]]
name = "smooth {i}"
integrand = "gaussian"
dims = 1
grid = {i = NUMBERS}
"""
FEW = """
title = "few"
seed = 11
samplers = ["random", "jittered"]
[convergence]
counts = [16, 64]
realizations = 3000
[predict]
counts = [4]
method = "exact"
[[estimators]]
name = "smooth"
integrand = "gaussian"
dims = 2
"""


def values_of(folder):
    """Return all results of a folder as bytes, by names of cells and variables."""
    tree = open_results(folder)
    found = {}
    for node in tree.leaves:
        for name, variable in node.to_dataset(inherit=False).variables.items():
            found[f"{node.path}/{name}"] = variable.values.tobytes(), str(variable.attrs)
        found[node.path] = str(node.attrs)
    return found


def digest_of(folder):
    """Return the SHA-256 of the store, file by file."""
    digest, tree = hashlib.sha256(), folder / "results.zarr"
    for path in sorted(path for path in tree.rglob("*") if path.is_file()):
        digest.update(f"{path.relative_to(tree)}".encode() + path.read_bytes())
    return digest.hexdigest()


# Zeroed pages of a ledger


def pages(folder, step=1, estimators=24):
    """Zero each page of a ledger of real results; count cells outside the page that are lost.

    Six cells of each estimator are in the ledger; every `step`-th page is tried.
    """
    numbers = list(range(1, estimators + 1))
    config = decode_study(MANY.replace("NUMBERS", str(numbers)))
    paths = [cell.path for cell in make_plan(config, ".").cells]
    out, work = folder / "whole", folder / "work"
    run_study(config, out, workers=1)
    content, values = (out / LEDGER_NAME).read_bytes(), values_of(out)
    with Ledger.read(out) as ledger:
        note = msgspec.structs.replace(ledger.study, config=ledger.config)
        payloads = {path: ledger.result(path) for path in paths}
    places = {path: pages_of(content, payload) for path, payload in payloads.items()}
    whole = len(content) // PAGE
    found = Counter(pages=0, held=0, broken=0, cells_off_pages=0, recovered=0)
    for number in range(0, whole, step):
        zeroed = content[: number * PAGE] + bytes(PAGE) + content[(number + 1) * PAGE :]
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir()
        (work / LEDGER_NAME).write_bytes(zeroed)
        off = [path for path in paths if number not in places[path]]
        said = study_status(work, verify=True)
        with Ledger.resume(work, note, paths) as ledger:
            kept = tuple(ledger.done)
            sound = all(ledger.result(path) == payloads[path] for path in kept)
            scalars = ledger.scalars().keys() == set(kept)
        found["pages"] += 1
        found["cells_off_pages"] += len(off)
        found["recovered"] += len(set(off) & set(kept))
        good = set(off) <= set(kept) == set(said.done) and sound and scalars and said.damaged
        found["held" if good else "broken"] += 1
        if number % 16 == 0:  # The run itself computes the rest again
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                run_study(config, work, resume=True, workers=1)
            assert values_of(work) == values
    return found


def pages_of(content, payload):
    """Return the pages of a payload: where the pieces lie that no other payload has."""
    pieces = (payload[i : i + 64] for i in range(0, len(payload) - 63, 8))
    places = [content.find(piece) for piece in pieces if content.count(piece) == 1]
    assert places
    return {place // PAGE for place in places} | {(place + 63) // PAGE for place in places}


# Faults of the system


@functools.cache
def shim():
    """Compile the library that causes faults; None if that is not possible."""
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        return None
    file = Path(tempfile.mkdtemp()) / "faults.so"
    source = Path(__file__).with_name("faults.c")
    command = [compiler, "-shared", "-fPIC", "-O1", "-o", str(file), str(source), "-ldl"]
    made = subprocess.run([*command, "-lpthread"], capture_output=True, check=False)
    return file if made.returncode == 0 else None


def system(folder, trials, seed=1):
    """Try kinds of faults of the system; `trials` are the numbers of trials by kind.

    One process with the library loads all modules, and all runs are forks of it.
    """
    environment = os.environ | {"LD_PRELOAD": str(shim()), "OMP_NUM_THREADS": "1"}
    arguments = ("-m", "tests.studies.trials", "inside", folder, json.dumps(trials), seed)
    ended = python(*arguments, cwd=ROOT, env=environment)
    assert ended.returncode == 0, ended.stderr[-2000:]
    return {kind: Counter(found) for kind, found in json.loads(ended.stdout).items()}


@without_figures()
def inside(folder, trials, seed):
    """Try faults in forks of this process, which has the library of faults."""
    (folder / "study.toml").write_text(FEW)
    # This run loads all modules and kernels, which takes four times as long as the run itself
    with contextlib.redirect_stdout(None):
        assert main(["run", str(folder / "study.toml"), *options(folder / "straight")]) == 0
    return {kind: SYSTEM[kind](folder, count, seed) for kind, count in trials.items()}


def options(out):
    return ["--out", str(out), "--workers", "1", "--quiet"]


def ended(out, *more, begin=lambda: None, said=os.devnull):
    """Return the exit code of a run in a fork of this process."""

    def run():
        begin()
        return in_short_tasks("run", out.parent / "study.toml", *options(out), *more)

    return Fork(run, said=said).wait(LONGEST)


# Power


class Disk:
    """Files of a folder rebuilt from a log of their changes; a power loss keeps synced changes.

    Each sector of a write that was not synced is kept or lost. Of the changes of names that were
    not synced, all after a random one are lost, because file systems keep their order.
    """

    def __init__(self, log):
        self.changes = []
        content, at = log.read_bytes(), 0
        while at < len(content):
            kind, file, place, size = struct.unpack_from("4q", content, at)
            self.changes.append((chr(kind), file, place, content[at + 32 : at + 32 + size]))
            at += 32 + size

    def lost_at(self, change, chosen):
        """Return the contents by name after power was lost before a change."""
        synced, waiting, files, folders = {}, {}, {}, set()
        names, kept_names, renames = {}, {}, []
        count = 0

        def renamed(step):
            step(names)
            renames.append(step)

        for kind, file, place, data in self.changes[:change]:
            if kind in "OD":
                folders.discard(file)
            if kind == "D":
                folders.add(file)
            elif kind == "O":
                name = Path(data.decode()).name
                if name not in names:
                    count += 1
                    synced[count], waiting[count] = b"", []
                    renamed(lambda of, name=name, number=count: of.__setitem__(name, number))
                files[file] = names[name]
            elif kind in "WT":
                waiting[files[file]].append((kind, place, data))
            elif kind == "S" and file in folders:
                for step in renames:
                    step(kept_names)
                renames.clear()
            elif kind == "S":
                number = files[file]
                synced[number] = applied(synced[number], waiting[number])
                waiting[number] = []
            elif kind == "U":
                gone = Path(data.decode()).name
                renamed(lambda of, name=gone: of.pop(name, None))
            elif kind == "R" and file == 0:
                before = Path(data.decode()).name
            elif kind == "R":
                after = Path(data.decode()).name
                renamed(lambda of, a=after, b=before: b in of and of.__setitem__(a, of.pop(b)))
        for step in renames[: chosen.randint(0, len(renames))]:
            step(kept_names)
        return {
            name: applied(synced[number], partly(waiting[number], chosen))
            for name, number in kept_names.items()
        }


def applied(content, changes):
    """Return a file's content after changes."""
    found = bytearray(content)
    for kind, place, data in changes:
        if kind == "T":
            del found[place:]
        else:
            found.extend(bytes(max(0, place - len(found))))
            found[place : place + len(data)] = data
    return bytes(found)


def partly(changes, chosen):
    """Return unsynced changes of which all, some or no sectors are lost."""
    share = chosen.choice((0.0, 0.5, 0.5, 1.0))
    for kind, place, data in changes:
        if kind == "T":
            if chosen.random() < share:
                yield kind, place, data
            continue
        for start in range(0, len(data), SECTOR):
            if chosen.random() < share:
                yield kind, place + start, data[start : start + SECTOR]


def power(folder, trials, seed=1):
    """Lose power once or twice between changes of a run's files, then resume."""
    log, out, chosen = folder / "log", folder / "logged", random.Random(seed)
    assert ended(out, begin=lambda: LIBRARY.faults_log(bytes(log))) == 0
    disk, expected = Disk(log), digest_of(folder / "straight")
    assert digest_of(out) == expected
    found = Counter(changes=len(disk.changes), held=0, broken=0, nothing_there=0)
    for number in range(trials):
        work = folder / f"power{number}"
        work.mkdir()
        # Spread the trials over the changes: enough trials cover every change
        change = (number * len(disk.changes)) // trials + chosen.randrange(2)
        for name, content in disk.lost_at(change, chosen).items():
            (work / name).write_bytes(content)
        found["nothing_there"] += not (work / LEDGER_NAME).exists()
        good = ended(work, "--resume") == 0 and digest_of(work) == expected
        good = good and study_status(work, verify=True).state == "finished"
        found["held" if good else "broken"] += 1
        shutil.rmtree(work)
    return found


# Memory, clocks and locks


def memory(folder, trials, seed=1):
    """Make random allocations of a run fail, then resume."""
    expected, chosen = digest_of(folder / "straight"), random.Random(seed)
    found = Counter(held=0, broken=0)
    for number in range(trials):
        out = folder / f"memory{number}"
        # Start at the beginning, or at one of the commits
        commit = chosen.choice((None, *range(1, 12)))
        after = int(10 ** chosen.uniform(0.0, 4.0 if commit else 6.0))
        count = chosen.choice((1, 1, 10, 1000))

        def begin(commit=commit, after=after, count=count):
            write, seen = Ledger._write, itertools.count(1)

            def counted(*arguments):
                if next(seen) == commit:
                    LIBRARY.faults_memory(ctypes.c_long(after), ctypes.c_long(count))
                return write(*arguments)

            Ledger._write = counted
            if commit is None:
                LIBRARY.faults_memory(ctypes.c_long(after), ctypes.c_long(count))

        end = ended(out, begin=begin)
        found[f"ended with {end}"] += 1
        again = ["--resume", "--retry"] if (out / LEDGER_NAME).exists() else []
        resumed = ended(out, *again)
        good = resumed == 0 and digest_of(out) == expected
        found["held" if good else "broken"] += 1
        shutil.rmtree(out, ignore_errors=True)
    return found


def clocks(folder, trials, seed=1):
    """Let the clock jump by years while a run is killed and resumed."""
    (folder / "runs").mkdir()
    found = Fork(killed_under_jumps, folder, trials, seed).wait(LONGEST + 10 * trials)
    assert found == 0
    expected, found = digest_of(folder / "straight"), Counter(held=0, broken=0)
    for trial in json.loads((folder / "runs.json").read_text()):
        out = Path(trial["out"])
        good = trial["last"] == 0 and digest_of(out) == expected
        good = good and not study_status(out, verify=True).damaged
        found["held" if good else "broken"] += 1
    return found


def killed_under_jumps(folder, trials, seed):
    LIBRARY.faults_clock(ctypes.c_ulong(seed))
    found = all_trials(folder / "study.toml", folder / "runs", trials, seed)
    (folder / "runs.json").write_text(json.dumps(found))
    return 0


def locks(folder, trials=1, seed=1):
    """Check that a run on a file system without locks reports a sentence and writes nothing."""
    found = Counter(held=0, broken=0)
    for number in range(trials):
        out, said = folder / f"locks{number}", folder / f"said{number}"
        good = ended(out, begin=LIBRARY.faults_locks, said=said) == 2
        told = said.read_text()
        good = good and told.count("\n") == 1 and "locks" in told
        found["held" if good and not (out / LEDGER_NAME).exists() else "broken"] += 1
    return found


LIBRARY = ctypes.CDLL(None)  # Has the functions of faults.c in a process with that library
SYSTEM = {"power": power, "memory": memory, "clocks": clocks, "locks": locks}


def main_(kind, *more):
    if kind == "inside":
        found = inside(Path(more[0]), json.loads(more[1]), int(more[2]))
        print(json.dumps(found))
        return 0
    numbers = [int(number) for number in more]
    with tempfile.TemporaryDirectory() as name, contextlib.suppress(StoreError):
        if kind in SYSTEM:
            count, *seed = numbers or (200,)
            found = system(Path(name), {kind: count}, *seed)[kind]
        else:
            found = pages(Path(name), *numbers)
    print(json.dumps(dict(found)))
    return 0


if __name__ == "__main__":
    sys.exit(main_(*sys.argv[1:]))
