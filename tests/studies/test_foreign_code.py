"""User code runs in its own thread with a time limit, and its failures become sentences."""

import threading
import time

import numpy as np
import pytest

from mcspectra.studies import foreign_code
from mcspectra.studies.foreign_code import FunctionFailed, TookTooLong, probed, within


def _raiser(error):
    def function(_):
        raise error

    return function


def test_a_job_runs_in_another_thread_and_gives_its_result():
    assert within(60.0, threading.current_thread) is not threading.current_thread()


@pytest.mark.parametrize("raised", [KeyboardInterrupt, SystemExit, GeneratorExit, TimeoutError])
def test_an_exception_of_a_job_is_raised_again(raised):
    def job():
        raise raised("mine")

    with pytest.raises(raised, match="mine"):
        within(60.0, job)


def test_a_job_beyond_its_time_limit_is_abandoned():
    gate = threading.Event()
    start = time.perf_counter()
    with pytest.raises(TookTooLong):
        within(0.05, lambda: gate.wait(60))
    gate.set()
    assert 0.05 <= time.perf_counter() - start < 30


def test_a_function_that_works_is_an_integrand():
    made = probed(lambda x: x, dims=3, limit=1e9)
    assert (made.dims, made.channels) == (3, 3)


@pytest.mark.parametrize(
    ("function", "sentence"),
    [
        (lambda x: 1 // 0, "It raised ZeroDivisionError: integer division or modulo by zero."),
        (lambda x: x[..., 0] * np.inf, "The function is NaN or infinite at 28 of 28 points"),
        (lambda x: x[..., 0] * 1j, "The function gave complex numbers; it must give real numbers."),
        (lambda x: float(x[0]), "The function takes one point at a time; write it for arrays"),
        (_raiser(KeyboardInterrupt()), "It raised KeyboardInterrupt."),
        (_raiser(SystemExit(3)), "It raised SystemExit: 3."),
    ],
)
def test_a_failing_function_gives_a_sentence(function, sentence):
    with pytest.raises(FunctionFailed) as caught:
        probed(function, dims=1)
    assert str(caught.value).startswith(sentence)


def test_a_function_gets_at_most_the_time_limit(monkeypatch):
    gate = threading.Event()
    for patience, limit, said in ((60.0, 0.1, "0.1 s"), (0.2, 60.0, "0.2 s"), (0.2, None, "0.2 s")):
        monkeypatch.setattr(foreign_code, "_PATIENCE", patience)
        with pytest.raises(
            FunctionFailed, match=f"no values at its first few points within {said}"
        ):
            probed(lambda x: gate.wait(60), dims=1, limit=limit)
    gate.set()
