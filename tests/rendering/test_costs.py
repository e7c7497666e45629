"""Estimates of the size and time of work on scenes."""

import json
import time

import pytest

from mcspectra.cli.main import main
from mcspectra.core.analysis import Subject
from mcspectra.core.streams import Stream
from mcspectra.rendering import costs
from mcspectra.rendering.costs import SceneCost, timed_work
from mcspectra.rendering.maps import Map
from mcspectra.samplers import sampler


class Clock:
    """A clock that advances by the time of simulated work."""

    def __init__(self, fixed, each, compiled):
        self.now, self.runs = 0.0, []
        self.fixed, self.each, self.compiled = fixed, each, compiled

    def work(self, size):
        self.now += self.fixed + self.each * size + (0.0 if self.runs else self.compiled)
        self.runs.append(size)

    def perf_counter(self):
        return self.now


@pytest.mark.parametrize(("fixed", "each"), [(0.1, 1e-3), (0.0, 1e-4), (0.5, 1e-2)])
def test_time_is_a_fixed_part_and_a_part_per_unit(monkeypatch, fixed, each):
    clock = Clock(fixed, each, compiled=2.0)
    monkeypatch.setattr(costs, "time", clock)
    found = timed_work(clock.work, 10**6, first=16, most=10**5)
    assert found.seconds == pytest.approx(2.0 + fixed + each * 10**6, rel=0.2)
    assert found.each == pytest.approx(each, rel=0.2)
    # All runs but the first take a few seconds
    assert clock.now - 2.0 < 4.0 + 2 * fixed
    assert clock.runs[0] == clock.runs[1] == 16


def test_small_work_is_run_whole(monkeypatch):
    clock = Clock(0.0, 0.01, compiled=0.0)
    monkeypatch.setattr(costs, "time", clock)
    assert timed_work(clock.work, 7, first=16).seconds == pytest.approx(0.07)
    assert clock.runs == [7, 7]


def test_an_estimate_is_a_sentence():
    cost = SceneCost("a.xml", "4 renders", (4, 3), 12, 48, 1e6, 4000.0, 2_500_000)
    assert cost.text == (
        "a.xml, 4 × 3 pixels: 12 pixels, 4 renders, 0.0 million samples at 1 million per second: "
        "about 67 min; about 2.5 MB are stored."
    )
    assert "nothing is stored" in str(SceneCost("a", "b", (1, 1), 1, 1, 1.0, 1.0))
    assert json.loads(json.dumps(cost.to_dict()))["seconds"] == 4000.0


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
    "command",
    [
        ["map", "--crop", "2,2,8,8", "-m", "4", "--counts", "4,9"],
        ["render", "--spp", "16", "-o", "OUT/image.exr"],
        ["render", "--integrator", "path(max_depth=2)", "--spp", "16", "--sampler", "sobol | owen"],
    ],
)
def test_dry_runs_write_nothing(command, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = [word.replace("OUT", str(tmp_path)) for word in command]
    begin = time.perf_counter()
    assert main([words[0], "penumbra(width=24, height=18)", *words[1:], "--dry-run", "--json"]) == 0
    spent = time.perf_counter() - begin
    data = json.loads(capsys.readouterr().out)
    assert data["pixels"] == (64 if command[0] == "map" else 432)
    assert 0.0 < data["seconds"] < 10 * spent
    assert not list(tmp_path.iterdir())
