"""The base of optimized samplers: cache, progress, reuse of sets, descent."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
import pytest

from mcspectra.core import cache
from mcspectra.core.errors import ParameterError
from mcspectra.core.progress import listening
from mcspectra.core.streams import Stream, mix_uniform
from mcspectra.samplers.optimised import OptimisedSampler, minimize, random_points, wrap

CALLS = []


@final
@dataclass(frozen=True, kw_only=True)
class Slow(OptimisedSampler):
    """Uniform points that count how often they are computed."""

    name: ClassVar[str] = "slow"
    dims: int = 2
    strength: float = 1.0
    table: object = ()

    def _optimize(self, n, keys, report):
        CALLS.append(n)
        report(0.5)
        return np.array([mix_uniform(keys[0], keys[1], i) for i in range(n * 2)]).reshape(n, 2)


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MCSPECTRA_CACHE", str(tmp_path))
    monkeypatch.setattr(cache, "_WORTH_KEEPING", -1.0)
    CALLS.clear()


def test_each_realization_is_made_once_and_kept():
    first = Slow().draw(8, realizations=3, rng=1)
    np.testing.assert_array_equal(Slow().draw(8, realizations=3, rng=1), first)
    assert len(CALLS) == 3
    assert len(np.unique(first[:, 0, 0])) == 3
    np.testing.assert_array_equal(Slow().draw(8, rng=1, first=2)[0], first[2])
    assert len(CALLS) == 3


@pytest.mark.parametrize(
    ("sampler", "n", "rng"),
    [
        (Slow(strength=2.0), 8, 1),
        (Slow(), 9, 1),
        (Slow(), 8, 2),
        (Slow(table=tuple(range(2000))), 8, 1),
        (Slow(table=np.arange(2000)), 8, 1),
    ],
)
def test_the_cache_key_contains_everything_a_set_depends_on(sampler, n, rng):
    Slow().draw(8, rng=1)
    Slow(table=(*range(1999), 0)).draw(8, rng=1)
    Slow(table=np.arange(2000) % 1999).draw(8, rng=1)
    before = len(CALLS)
    sampler.draw(n, rng=rng)
    assert len(CALLS) == before + 1


def test_another_version_of_the_method_is_another_set(monkeypatch):
    Slow().draw(8, rng=1)
    monkeypatch.setattr(Slow, "version", 2)
    Slow().draw(8, rng=1)
    assert len(CALLS) == 2


def test_a_changed_source_of_an_external_sampler_gives_another_set(monkeypatch):
    from mcspectra.samplers import optimised

    Slow().draw(8, rng=1)
    optimised._source.cache_clear()
    monkeypatch.setattr(optimised.inspect, "getsource", lambda module: "edited")
    Slow().draw(8, rng=1)
    optimised._source.cache_clear()
    assert len(CALLS) == 2


def test_reused_sets_are_translated_and_equal_for_every_seed():
    points = Slow(sets=2).draw(8, realizations=5, rng=1)
    other = Slow(sets=2).draw(8, realizations=2, rng=2)
    assert len(CALLS) == 2
    assert len(np.unique(points[:, 0, 0])) == 5

    def shape(x):  # translations preserve differences on the torus
        away = (x - x[0] + 0.5) % 1.0
        return np.round(away, 12)

    np.testing.assert_allclose(shape(points[0]), shape(points[2]))
    np.testing.assert_allclose(shape(points[1]), shape(other[1]))
    assert not np.allclose(shape(points[0]), shape(points[1]))
    np.testing.assert_array_equal(Slow(sets=2).draw(8, rng=1, first=4)[0], points[4])


def test_progress_is_reported_unless_the_set_is_cached():
    heard = []
    with listening(lambda *what: heard.append(what)):
        Slow().draw(8, rng=1)
        Slow().draw(8, rng=1)
    assert heard == [("slow, 8 points, set 0", done) for done in (0.0, 0.5, 1.0)]


def test_threads_do_not_change_the_sets(monkeypatch):
    monkeypatch.setattr(cache, "_WORTH_KEEPING", 3600.0)
    whole = Slow().draw(8, realizations=6, rng=3)
    alone = [Slow().draw_stream(8, Stream.from_rng(3), r, 1)[0] for r in range(6)]
    np.testing.assert_array_equal(whole, alone)


@pytest.mark.parametrize("sets", [0, 1.5, "x"])
def test_impossible_numbers_of_sets(sets):
    with pytest.raises(ParameterError, match="^sets is "):
        Slow(sets=sets)


def test_minimize_finds_the_least_value_and_stops_there():
    target = np.array([[0.3, 0.4], [0.1, 0.9]])
    scales = np.array([[1.0, 10.0], [100.0, 1000.0]])
    calls, reports = [], []

    def bowl(x):
        calls.append(x)
        return float(np.sum(scales * (x - target) ** 2)), 2 * scales * (x - target)

    start = random_points(np.array([1, 2], np.uint64), 2, 2)
    found = minimize(bowl, start, iterations=500, longest=0.1, report=reports.append, goal=1e-20)
    np.testing.assert_allclose(found, target, atol=1e-9)
    assert len(calls) < 100
    assert max(np.abs(np.diff(calls[:2], axis=0)).ravel()) <= 0.1 + 1e-15
    assert reports == sorted(reports)


def test_minimize_leaves_a_stationary_point():
    start = np.full((2, 2), 0.5)
    same = minimize(
        lambda x: (1.0, np.zeros_like(x)), start, iterations=9, longest=1.0, report=print
    )
    np.testing.assert_array_equal(same, start)


def test_wrap_stays_below_one():
    np.testing.assert_array_equal(wrap(np.array([-1e-20, 1.0, -0.25, 3.5])), [0, 0, 0.75, 0.5])
