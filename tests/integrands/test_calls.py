"""Calls of an expensive function: counted, limited, cached by point, and parallel."""

import sqlite3

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.core.errors import BudgetError, DomainError, FileFormatError, ParameterError
from mcspectra.core.progress import listening
from mcspectra.integrands import Calls, FunctionIntegrand

X = np.random.default_rng(1).random((300, 2))


class Counting:
    """A function that counts the points at which it is called."""

    __name__ = "counting"

    def __init__(self, factor=1.0, stops_after=None):
        self.factor, self.stops_after, self.points = factor, stops_after, 0

    def __call__(self, x):
        self.points += x.size // 2
        if self.stops_after is not None and self.points > self.stops_after:
            raise KeyboardInterrupt
        return self.factor * x[..., 0] * np.exp(x[..., 1])


TRUE = Counting()(X)


@pytest.mark.parametrize("vectorized", [True, False])
def test_every_point_is_one_call(vectorized):
    f = Counting()
    with Calls(f, dims=2, budget=400, vectorized=vectorized) as calls:
        assert np.array_equal(calls(X), TRUE)
        assert (f.points, calls.made, calls.left) == (300, 300, 100)
        assert np.array_equal(calls(X[:100].reshape(4, 25, 2)), TRUE[:100].reshape(4, 25))
        assert (f.points, calls.made, calls.left) == (400, 400, 0)


def test_beyond_the_budget_nothing_is_called():
    f = Counting()
    calls = Calls(f, dims=2, budget=299)
    with pytest.raises(BudgetError, match=r"give a budget of at least 300\."):
        calls(X)
    assert (f.points, calls.made, calls.left) == (0, 0, 299)


def test_processes_give_the_same_bits():
    factor = 3.0
    with Calls(
        lambda x: factor * x[:, 0] * np.exp(x[:, 1]), dims=2, budget=300, workers=2
    ) as calls:
        assert np.array_equal(calls(X), 3.0 * X[:, 0] * np.exp(X[:, 1]))
        assert calls.made == 300


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path):
    stopped = Counting(stops_after=150)
    with Calls(stopped, dims=2, budget=300, vectorized=False, cache=tmp_path / "f") as calls:
        with pytest.raises(KeyboardInterrupt):
            calls(X)
        kept = calls.made
    assert 140 <= kept <= 150
    f = Counting()
    with Calls(f, dims=2, budget=300, vectorized=False, cache=tmp_path / "f") as calls:
        assert np.array_equal(calls(X), TRUE)
        assert calls.left == 0  # Same as without a cache
        assert f.points == calls.made == 300 - kept + 1  # One call checks that f has not changed


def test_a_cache_of_another_function_is_refused(tmp_path):
    with Calls(Counting(), dims=2, budget=300, cache=tmp_path / "f") as calls:
        calls(X)
    changed = pytest.raises(ParameterError, match="it has changed or is random")
    with Calls(Counting(2.0), dims=2, budget=300, cache=tmp_path / "f") as calls, changed:
        calls(X)
    with pytest.raises(ParameterError, match="is of counting in 2 dims, not of counting in 3"):
        Calls(Counting(), dims=3, budget=300, cache=tmp_path / "f")
    (tmp_path / "text").write_text("no database " * 100)
    with pytest.raises(FileFormatError, match="give a new path"):
        Calls(Counting(), dims=2, budget=300, cache=tmp_path / "text")
    with pytest.raises(FileFormatError, match="unable to open"):
        Calls(Counting(), dims=2, budget=300, cache=tmp_path / "no" / "f")


def test_the_cache_is_a_table_of_digests_and_values(tmp_path):
    with Calls(Counting(), dims=2, budget=300, cache=tmp_path / "f") as calls:
        calls(X)
    with sqlite3.connect(tmp_path / "f") as file:
        rows = file.execute("SELECT length(point), value FROM calls").fetchall()
    assert sorted(value for _, value in rows) == sorted(TRUE)
    assert {size for size, _ in rows} == {16}


def test_progress_is_calls_asked_for_of_the_budget():
    seen = []
    with (
        listening(lambda what, done: seen.append((what, done))),
        Calls(Counting(), dims=2, budget=600) as calls,
    ):
        calls(X)
    assert {what for what, _ in seen} == {"600 calls of counting"}
    assert [done for _, done in seen] == [128 / 600, 256 / 600, 300 / 600, 1.0]


@pytest.mark.parametrize(
    ("f", "options", "sentence"),
    [
        (7, {}, "not a callable"),
        (Counting(), {"budget": 0}, "budget is 0"),
        (Counting(), {"dims": 0}, "dims is 0"),
        (Counting(), {"workers": 0}, "workers is 0"),
        (Counting(), {"cache": 7}, "cache is 7"),
        (sqlite3.connect(":memory:").execute, {"workers": 2}, "cannot be sent to other processes"),
    ],
)
def test_what_cannot_be_is_refused(f, options, sentence):
    with pytest.raises(ParameterError, match=sentence):
        Calls(f, **{"dims": 2, "budget": 10} | options)


@pytest.mark.parametrize(
    ("f", "vectorized", "sentence"),
    [
        (lambda x: x, True, r"give one component at a time, such as lambda x: f\(x\)\[\.\.\., 0\]"),
        (lambda x: x, False, "gave 2 values at one point"),
        (lambda x: np.nan, False, "is NaN or infinite"),
        (lambda x: 1j, False, "complex"),
    ],
)
def test_values_must_be_one_finite_number_a_point(f, vectorized, sentence):
    with pytest.raises(ParameterError, match=sentence):
        Calls(f, dims=2, budget=10, vectorized=vectorized)(X[:5])
    with pytest.raises(DomainError, match="unit cube"):
        Calls(f, dims=2, budget=10)(X[:5, :1])


def test_an_analysis_counts_its_calls_once():
    f = Counting()
    with Calls(f, dims=2, budget=1600) as calls:
        found = mcs.convergence(
            FunctionIntegrand(function=calls, dims=2), "random", [16, 64], realizations=20
        )
    assert f.points == calls.made == found.attrs["evaluations"] == 1600
