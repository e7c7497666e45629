"""Run a study again and again, killed at any moment: ``killed_runs STUDY FOLDER KILLS SEED``.

The first run, which nothing stops, goes to FOLDER/straight; the others are killed at moments spread
over its duration, resumed, half of them killed again on the way, and resumed to the end. All are
``mcspectra run``, in forks of this process, which have all modules imported. Prints a line of JSON for
each: what the killed ones came to, and what the last one did.
"""

import contextlib
import json
import os
import random
import signal
import sys
import time
from pathlib import Path

from tests.report.conftest import words_alone

from mcspectra.cli.main import main
from mcspectra.report import page
from mcspectra.studies import ledger, schedule


def run(study, out, moment=None, resume=False):
    """Run the command in a fork, in tasks of one block, and kill it after `moment` seconds."""
    child = os.fork()
    if child == 0:
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        schedule._TARGET, schedule._RECORDED_AFTER = 1e-9, 0.0
        ledger._COMMIT_SECONDS = 0.005
        page._drawn = words_alone  # pictures would take longer than all that is stored
        arguments = ["run", str(study), "--out", str(out), "--workers", "1", "--quiet"]
        os._exit(main(arguments + ["--resume"] * resume))
    if moment is not None:
        time.sleep(moment)
        os.kill(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def all_trials(study, folder, kills, seed):
    """Print what came of each trial."""
    chosen = random.Random(seed)
    # Also imports all modules, before anything is forked.
    with contextlib.redirect_stdout(None):
        main(["run", str(study), "--out", str(folder / "straight"), "--workers", "1", "--quiet"])
    begun = time.monotonic()
    run(study, folder / "timed")
    duration = time.monotonic() - begun
    for index in range(kills):
        out = folder / str(index)
        ends = [
            run(study, out, duration * (index + chosen.random()) / kills),
            *(run(study, out, duration * chosen.random(), resume=True) for _ in range(index % 2)),
        ]
        last = run(study, out, resume=True)
        print(json.dumps({"out": str(out), "ends": ends, "last": last}), flush=True)


if __name__ == "__main__":
    all_trials(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
