"""Kill runs of a study at any moment and resume them: ``killed_runs STUDY FOLDER KILLS SEED``.

The first run is not killed and goes to FOLDER/straight. The others are killed at moments spread
over its duration and resumed; half of them are killed again, and all are resumed to the end. All
runs are ``mcspectra run`` in forks of this process, which has imported all modules. The program
prints one line of JSON per trial: the state of the killed run, and the result of the last run.
"""

import contextlib
import json
import random
import sys
import time
from pathlib import Path

from tests.processes import Fork, command
from tests.report.figures import without_figures

from mcspectra.cli.main import main
from mcspectra.studies import ledger, schedule


def run(study, out, moment=None, resume=False):
    """Run the command in a fork with tasks of one block, and kill it after `moment` seconds."""
    arguments = ["run", study, "--out", out, "--workers", "1", "--quiet"]
    child = Fork(in_short_tasks, *arguments, *["--resume"] * resume)
    if moment is not None:
        time.sleep(moment)
        child.kill()
    return child.wait()


def in_short_tasks(*arguments):
    """Run a command that records and commits often; for forks only."""
    schedule._TARGET, schedule._RECORDED_AFTER = 1e-9, 0.0
    ledger._COMMIT_SECONDS = 0.005
    return command(*arguments)


@without_figures()  # Pictures would take longer than all the rest
def all_trials(study, folder, kills, seed):
    """Return the result of each trial."""
    chosen, trials = random.Random(seed), []
    # This also imports all modules before the first fork.
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
        trials.append({"out": str(out), "ends": ends, "last": last})
    return trials


if __name__ == "__main__":
    for trial in all_trials(Path(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:5])):
        print(json.dumps(trial))
