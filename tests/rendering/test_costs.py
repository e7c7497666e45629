"""Estimates of the size and time of work on scenes."""

import contextlib
import json
import time

import pytest

from mcspectra.cli.main import main
from mcspectra.core.analysis import Subject
from mcspectra.core.streams import Stream
from mcspectra.rendering import costs, load_mitsuba
from mcspectra.rendering.backend import compilations
from mcspectra.rendering.costs import SceneCost, timed_part, timed_work
from mcspectra.rendering.maps import Map
from mcspectra.samplers import sampler


class Clock:
    """A clock that advances by the time of simulated work.

    The first work also loads files, and compiles kernels, which later commands load from disk.
    """

    def __init__(self, fixed, each, loaded=0.0, compiled=0.0):
        self.now, self.runs = 0.0, []
        self.fixed, self.each, self.first = fixed, each, (loaded, compiled)

    def work(self, size):
        self.now += self.fixed + self.each * size + (0.0 if self.runs else sum(self.first))
        self.runs.append(size)

    @contextlib.contextmanager
    def compilations(self):
        found = []
        yield found
        found.append(self.first[1])

    def perf_counter(self):
        return self.now


@pytest.mark.parametrize(("fixed", "each"), [(0.1, 1e-3), (0.0, 1e-4), (0.5, 1e-2)])
def test_time_is_a_fixed_part_and_a_part_per_unit(monkeypatch, fixed, each):
    clock = Clock(fixed, each, loaded=2.0, compiled=50.0)
    monkeypatch.setattr(costs, "time", clock)
    monkeypatch.setattr(costs, "compilations", clock.compilations)
    found = timed_work(clock.work, 10**6, first=16, most=10**5)
    assert found.seconds == pytest.approx(2.0 + fixed + each * 10**6, rel=0.2)
    assert found.each == pytest.approx(each, rel=0.2)
    # All runs but the first take a few seconds
    assert clock.now - 52.0 < 4.0 + 2 * fixed
    assert clock.runs[0] == clock.runs[1] == 16


def test_small_work_is_run_whole(monkeypatch):
    clock = Clock(0.0, 0.01)
    monkeypatch.setattr(costs, "time", clock)
    monkeypatch.setattr(costs, "compilations", clock.compilations)
    assert timed_work(clock.work, 7, first=16).seconds == pytest.approx(0.07)
    assert clock.runs == [7, 7]


def test_a_time_per_unit_is_positive_if_a_longer_run_is_faster(monkeypatch):
    clock = Clock(0.3, -1e-3)
    monkeypatch.setattr(costs, "time", clock)
    monkeypatch.setattr(costs, "compilations", clock.compilations)
    found = timed_work(clock.work, 64, first=16)
    assert 0.0 < found.each < 1e-3
    assert found.seconds == pytest.approx(0.236)


@pytest.mark.parametrize(("total", "first"), [(200, 13), (10**9, 64)])
def test_a_part_of_any_size_is_timed_in_a_minute(monkeypatch, total, first):
    clock = Clock(0.2, 0.01)
    monkeypatch.setattr(costs, "time", clock)
    monkeypatch.setattr(costs, "compilations", clock.compilations)
    assert timed_part(clock.work, total).seconds == pytest.approx(0.2 + 0.01 * total)
    assert clock.runs[0] == clock.runs[1] == first
    assert clock.now < 60.0


def test_an_estimate_is_a_sentence():
    cost = SceneCost("a.xml", "4 renders", (4, 3), 12, 48_000, 1e6, 4000.0, 2_500_000)
    assert cost.text == (
        "a.xml, 4 × 3 pixels: 12 pixels, 4 renders, 0.048 million samples at 1 million per second: "
        "about 67 min; about 2.5 MB are stored."
    )
    large = SceneCost("a.xml", "4 renders", (4, 3), 12, 123_400_000, 2e8, 1.0, 300_000).text
    assert "123 million samples at 200 million per second" in large
    assert large.endswith("about 300 kB are stored.")
    assert "nothing is stored" in str(SceneCost("a", "b", (1, 1), 1, 1, 1.0, 1.0))
    assert json.loads(json.dumps(cost.to_dict()))["seconds"] == 4000.0
    search = SceneCost("a", "b", (1, 1), 1, 1, 1.0, 10.0, most=20.0).later(2.0)
    assert search.text.endswith("about 12 s, at most 22 s; nothing is stored.")
    long = SceneCost("a", "b", (1, 1), 1, 1, 1.0, 40 * 86_400.0)
    assert long.text.endswith("about 40 days; nothing is stored.")


def test_an_estimate_of_two_works_adds_times_and_samples():
    first = SceneCost("a", "4 renders", (9, 9), 1, 600, 100.0, 10.0, storage=7)
    then = first.then(SceneCost("a", "8 renders", (9, 9), 64, 1400, 350.0, 5.0, most=20.0))
    assert (then.pixels, then.samples, then.samples_per_second) == (1, 2000, 200.0)
    assert (then.seconds, then.most, then.storage) == (15.0, 30.0, 7)
    assert "1 pixel, 4 renders; then 64 pixels, 8 renders, 0.002 million" in then.text
    assert first.then(first).most is None


@pytest.mark.render
def test_compilations_are_those_of_new_kernels():
    load_mitsuba()
    import drjit

    kind, factor = load_mitsuba().Float, time.time() % 1000.0
    values = []
    for _ in range(2):
        with compilations() as found:
            drjit.eval(drjit.arange(kind, 64) * kind(factor) + 0.123 * factor)
        values.append(len(found))
    assert values == [1, 0]


@pytest.mark.render
def test_a_crop_of_the_whole_film_needs_the_same():
    scene, subject = "penumbra(width=40, height=30)", Subject(None, sampler("sobol | owen", 2))
    given = {"scene": scene, "integrator": "path(max_depth=2)", "chains": 0}
    need, same = (Map(**given, **more).need(subject) for more in ({}, {"crop": (0, 0, 40, 30)}))
    assert need == same
    small = Map(**given, pixels="10%").need(subject)
    assert small.cost == pytest.approx(0.1 * need.cost)
    cost = Map(**given, realizations=8).cost(subject, Stream.from_rng(0), seconds=0.2)
    assert (cost.size, cost.pixels) == ((40, 30), 1200)
    assert cost.samples == 1200 * 84 * 8
    part = Map(**given, realizations=8, pixels=120).cost(subject, Stream.from_rng(0), seconds=0.2)
    assert part.samples == cost.samples / 10


@pytest.mark.render
@pytest.mark.parametrize(
    ("command", "pixels"),
    [
        (["map", "--crop", "2,2,8,8", "-m", "4", "--counts", "4,9"], 64),
        (["render", "--spp", "16", "-o", "OUT/image.exr"], 432),
        (
            ["render", "--integrator", "path(max_depth=2)", "--spp", "16", "--sampler", "random"],
            432,
        ),
        (["pixel", "12", "14", "-n", "4,16", "-m", "4", "--sampler", "jittered", "-o", "OUT"], 1),
        (["pixel", "12", "14", "--integrator", "path(max_depth=2)", "-n", "4,16", "-m", "8"], 1),
        (["pixel", "9", "9", "--integrator", "path(max_depth=2)", "-n", "4,9", "--target", "5"], 1),
    ],
)
def test_dry_runs_write_nothing(command, pixels, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = [word.replace("OUT", str(tmp_path)) for word in command]
    begin = time.perf_counter()
    assert main([words[0], "penumbra(width=24, height=18)", *words[1:], "--dry-run", "--json"]) == 0
    spent = time.perf_counter() - begin
    data = json.loads(capsys.readouterr().out)
    assert data["pixels"] == pixels
    assert (data["storage"] > 0) == ("-o" in command or command[0] == "map")
    assert 0.0 < data["seconds"] < 10 * spent
    assert not list(tmp_path.iterdir())
