"""Integrands of tests that misbehave, in a module that study files can name."""

import textwrap

import numpy as np
import pytest

from mcspectra.studies import open_results

MODULE = """
import multiprocessing
import os
import pathlib
import signal
import time

FOLDER = pathlib.Path({folder!r})


def good(x):
    return x[..., 0] ** 2


def raises(x):
    raise ZeroDivisionError("no such light")


def leaves(x):
    raise SystemExit(3)


def nan(x):
    return x[..., 0] * float("nan")


def infinite(x):
    return x[..., 0] + float("inf")


def hangs(x):
    while (FOLDER / "hang").exists():
        time.sleep(0.01)
    return x[..., 0]


def slow(x):
    if (FOLDER / "slow").exists():
        time.sleep(0.05)
    return x[..., 0]


def dies(x):
    if multiprocessing.parent_process() is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    return x[..., 0]


def dies_once(x):
    mark = FOLDER / "died"
    if multiprocessing.parent_process() is not None and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return x[..., 0] ** 2
"""


@pytest.fixture
def misbehaving(tmp_path, monkeypatch):
    """The module's functions by the names that studies give them; its folder holds the marks."""
    import sys

    folder = tmp_path / "modules"
    folder.mkdir()
    (folder / "misbehaving.py").write_text(textwrap.dedent(MODULE.format(folder=str(folder))))
    monkeypatch.syspath_prepend(str(folder))
    yield folder
    sys.modules.pop("misbehaving", None)


@pytest.fixture(scope="session")
def stored_values():
    """Every array of a store, by path."""

    def values(folder):
        tree = open_results(folder)
        return {
            f"{node.path}/{name}": np.asarray(variable.values)
            for node in tree.subtree
            for name, variable in node.to_dataset().variables.items()
        }

    return values
