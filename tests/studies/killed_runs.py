"""Run a study again and again, killed at its steps: ``killed_runs.py STUDY FOLDER KILLS SEED``.

A step is a call that changes or opens something in the output folder. The first run, which nothing
stops, goes to FOLDER/straight; the others are killed before a random step, resumed, half of them killed
again on the way, and resumed to the end. All are ``mcspectra run``, in forks of this process, which have
all modules imported. Prints a line of JSON for each: the steps where it was killed, and what the last
one came to.
"""

import json
import os
import random
import signal
import sys
from pathlib import Path

from mcspectra.cli.main import main
from mcspectra.studies import run as run_module

STEPS = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate"}
KILLED = -signal.SIGKILL


def count_steps(out, last, report):
    """Kill this process before its step number `last`; tell `report` the number of each other one."""
    done = 0

    def step(event, arguments):
        nonlocal done
        if event in STEPS and str(arguments[0]).startswith(str(out)):
            done += 1
            if done == last:
                os.kill(os.getpid(), signal.SIGKILL)
            report(done)

    sys.addaudithook(step)


def run(study, out, last=0, resume=False, target=1e-9):
    """Run the command in a fork, in tasks of `target` seconds; its exit code and number of steps."""
    inner, outer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(inner)
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        run_module._TARGET = target
        count_steps(out, last, lambda done: os.write(outer, b"."))
        arguments = ["run", str(study), "--out", str(out), "--workers", "1", "--quiet"]
        os._exit(main(arguments + ["--resume"] * resume))
    os.close(outer)
    steps = 0
    while data := os.read(inner, 4096):
        steps += len(data)
    os.close(inner)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), steps


def trial(study, out, steps, chosen, twice):
    """Kill a run, perhaps its first resumption too, and resume it to the end."""
    ends, killed = [], []
    for resume in (False, True)[: 1 + twice]:
        killed.append(chosen.randint(1, steps))
        code, _ = run(study, out, killed[-1], resume)
        ends.append(code)
    last, _ = run(study, out, resume=True)
    return {"out": str(out), "killed": killed, "ends": ends, "last": last}


def all_trials(study, folder, kills, seed):
    """Print what came of each trial."""
    chosen = random.Random(seed)
    # Also imports all modules, before anything is forked.
    main(["run", str(study), "--out", str(folder / "straight"), "--workers", "1", "--quiet"])
    code, steps = run(study, folder / "counted")
    print(json.dumps({"out": str(folder / "counted"), "last": code, "steps": steps}))
    for index in range(kills):
        result = trial(study, folder / str(index), steps, chosen, index % 2 == 1)
        print(json.dumps(result), flush=True)


if __name__ == "__main__":
    all_trials(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
