"""Integrands that misbehave, in a module that study files can name."""

import textwrap

import numpy as np
import pytest
from tests.report.drawing import undrawn

import mcspectra as mcs
from mcspectra.studies import open_results

__all__ = ["of_a_bell", "predicted_bell", "undrawn"]


def of_a_bell(analysis):
    """Run the analysis on a bell, under the name of a slow estimator of a pixel.

    The analysis runs once for all estimators with the same options.
    """
    known = {}

    def call(estimator, *given, **options):
        key = repr((estimator.dims, given, options))
        if key not in known:
            bell = mcs.integrand("gaussian", dims=estimator.dims)
            known[key] = analysis(bell, *given, **options)
        return known[key].assign_attrs(given=estimator.spec)

    return call


predicted_bell = of_a_bell(mcs.predict)


MODULE = '''
import asyncio
import itertools
import multiprocessing
import os
import pathlib
import signal
import time

FOLDER = pathlib.Path({folder!r})


def sampled(x):
    """Whether it is a sample of an estimator, not one of the probes when the integrand is made."""
    return x[..., 0].size != 28


def good(x):
    return x[..., 0] ** 2


def raises(x):
    if sampled(x):
        raise ZeroDivisionError("no such light")
    return x[..., 0]


def leaves(x):
    if sampled(x):
        raise SystemExit(3)
    return x[..., 0]


def interrupts(x):
    if sampled(x):
        raise KeyboardInterrupt
    return x[..., 0]


def cancels(x):
    if sampled(x):
        raise asyncio.CancelledError
    return x[..., 0]


class Wordless(BaseException):
    def __str__(self):
        raise RuntimeError("no words")


def wordless(x):
    if sampled(x):
        raise Wordless
    return x[..., 0]


def verbose(x):
    if sampled(x):
        raise ValueError("\\x1b[31m" + "much " * 10**6)
    return x[..., 0]


def nan(x):
    return x[..., 0] * (float("nan") if sampled(x) else 1.0)


def infinite(x):
    return x[..., 0] + (float("inf") if sampled(x) else 0.0)


def hangs(x):
    if sampled(x):
        (FOLDER / "begun").touch()
    while sampled(x) and (FOLDER / "hang").exists():
        time.sleep(0.01)
    return x[..., 0]


def holds_the_lock(x):
    if sampled(x):
        sum(itertools.repeat(0))
    return x[..., 0]


def slow(x):
    if sampled(x) and (FOLDER / "slow").exists():
        time.sleep(0.5)
    return x[..., 0]


def raises_at_once(x):
    raise ZeroDivisionError("no light at all")


def nan_at_once(x):
    return x[..., 0] * float("nan")


def leaves_at_once(x):
    raise SystemExit(3)


def interrupts_at_once(x):
    raise KeyboardInterrupt


def hangs_at_once(x):
    while (FOLDER / "hang").exists():
        time.sleep(0.01)
    return x[..., 0]


def dies(x):
    if sampled(x) and multiprocessing.parent_process() is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    return x[..., 0]


def dies_once(x):
    mark = FOLDER / "died"
    if sampled(x) and multiprocessing.parent_process() is not None and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return x[..., 0] ** 2
'''


@pytest.fixture
def misbehaving(tmp_path, monkeypatch):
    """Return the module's functions by their names in studies; its folder holds the mark files."""
    import sys

    folder = tmp_path / "modules"
    folder.mkdir()
    (folder / "misbehaving.py").write_text(textwrap.dedent(MODULE.format(folder=str(folder))))
    monkeypatch.syspath_prepend(str(folder))
    yield folder
    sys.modules.pop("misbehaving", None)


@pytest.fixture(scope="session")
def stored_values():
    """Return every array of a store as bytes, by path."""

    def values(folder):
        tree = open_results(folder)
        return {
            f"{node.path}/{name}": np.asarray(variable.values).tobytes()
            for node in tree.subtree
            for name, variable in node.to_dataset().variables.items()
        }

    return values
