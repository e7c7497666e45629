"""Plans: every study is planned within seconds, or refused with an estimate before it is built."""

import re
import resource
import subprocess
import sys
import time

import pytest

from mcspectra.core.errors import ConfigError, LargeStudyWarning
from mcspectra.studies import Trust, decode_study, make_plan, read_study
from mcspectra.studies import plan as plan_module
from mcspectra.studies.files import apply_overrides, plain_study, study_of

HEAD = 'title = "t"\nsamplers = ["random"]\n'
POINTS = "[points]\nn = 16\n"
ESTIMATOR = '[[estimators]]\nname = "a"\ndims = 2\nintegrand = "gaussian"\n'
COUNTS = f"convergence = {{ counts = {[*range(1, 10_000)]} }}"
MANY = [*range(10, 46)]
FEW = 10.0  # seconds of processor time; a busy machine needs up to twice as many


def _planned(text, folder, **options):
    """Return a plan or the refusal; check its time and memory."""
    start, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        return make_plan(decode_study(text), folder, **options)
    except ConfigError as error:
        return str(error)
    finally:
        assert time.process_time() - start < FEW
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 10**6  # kB


def _estimators(number):
    return "".join(
        f'[[estimators]]\nname = "e{i}"\ndims = 2\nintegrand = "gaussian(width={1 + i / 1000})"\n'
        for i in range(number)
    )


def _jitters(number):
    return ", ".join(f'"gaussian-jitter(width={(1 + i) / 10_000})"' for i in range(number))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            f"{HEAD}{POINTS}{ESTIMATOR}".replace(
                '"gaussian"', "\"gaussian(width=0.{a}, center=[0.{b}, 0.{c}])\""
            )
            + f"grid = {{ a = {MANY}, b = {MANY}, c = {MANY} }}",
            "46,656 estimators and 46,656 pairs of estimator and sampler, which take about",
        ),
        (
            f'title = "t"\nsamplers = [{_jitters(1000)}]\n{POINTS}{_estimators(1000)}',
            "1,000 estimators and 1,000,000 pairs of estimator and sampler, which take about",
        ),
        (
            f"{HEAD}{POINTS}{ESTIMATOR}".replace("dims = 2", "dims = 1")
            + f"densities = {['uniform'] * 10_000}",
            "1 estimators and 1 pairs of estimator and sampler, which take about 20 s",
        ),
        (
            f'title = "t"\nsamplers = [{_jitters(300)}]\n{_estimators(300)}{COUNTS}',
            "pairs of estimator and sampler, which take about",
        ),
        (
            HEAD + ESTIMATOR + "terms = { n = 16, half_width = 100000 }",
            "frequencies|memory",
        ),
        (HEAD + ESTIMATOR + "spectrum = { n = 16, half_width = 100000 }", "frequencies|memory"),
        (
            HEAD + ESTIMATOR + "pcf = { n = 2000000000, bins = 1000000 }",
            "memory|pairs|points",
        ),
    ],
    ids=["grid", "pairs", "densities", "counts", "terms", "spectrum", "pcf"],
)  # fmt: skip
def test_too_large_studies_are_refused_with_an_estimate(tmp_path, monkeypatch, text, words):
    monkeypatch.setattr(plan_module, "MOST_SECONDS", plan_module.NOTED_SECONDS)
    assert re.search(words, _planned(text, tmp_path))


@pytest.mark.parametrize(
    "text",
    [
        f'title = "t"\nsamplers = [{_jitters(200)}]\n{POINTS}{_estimators(200)}',
        f"{HEAD}[predict]\ncounts = [4]\n{ESTIMATOR}densities = {['linear(slope=1)'] * 1000}",
        f"{HEAD}{ESTIMATOR}convergence = {{ counts = [4], realizations = 1000000000 }}",
    ],
    ids=["pairs", "densities", "realizations"],
)
def test_large_studies_are_planned_within_seconds(tmp_path, text):
    assert len(_planned(text, tmp_path).cells) in (1, 40_000)


def test_planning_of_some_seconds_is_announced(tmp_path, monkeypatch):
    """This used to need --force."""
    assert plan_module.NOTED_SECONDS == 5 < plan_module.MOST_SECONDS
    monkeypatch.setattr(plan_module, "NOTED_SECONDS", 1e-9)
    with pytest.warns(LargeStudyWarning, match=r"has 1 estimators .* s to plan, before the first"):
        plan = make_plan(decode_study(HEAD + POINTS + ESTIMATOR), tmp_path)
    assert len(plan.cells) == 1


def test_force_allows_long_planning(tmp_path, monkeypatch):
    text = f'title = "t"\nsamplers = [{_jitters(3000)}]\n{POINTS}{_estimators(3000)}'
    with pytest.raises(
        ConfigError, match="s to plan; split it into several studies, or give --force"
    ):
        make_plan(decode_study(text), tmp_path)
    monkeypatch.setattr(plan_module, "NOTED_SECONDS", 1e-9)
    monkeypatch.setattr(plan_module, "MOST_SECONDS", 1e-9)
    with pytest.warns(LargeStudyWarning):
        plan = make_plan(decode_study(HEAD + POINTS + ESTIMATOR), tmp_path, force=True)
    assert len(plan.cells) == 1


MANY_CELLS = """
import resource
from pathlib import Path
from tests.studies.test_plan import POINTS, _estimators, _jitters
from mcspectra.studies import decode_study, make_plan
def plan(number):
    text = f'title = "t"\\nsamplers = [{_jitters(number)}]\\n{POINTS}{_estimators(number)}'
    cells = make_plan(decode_study(text), Path("."), force=True).cells
    return cells, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
few, many = plan(2), plan(400)
assert len(many[0]) == 160_000
print(1024 * (many[1] - few[1]) / 160_000)
"""


@pytest.mark.slow
def test_a_cell_takes_little_memory():
    """A million cells take 700 MB with the program: 600 bytes each."""
    command = [sys.executable, "-c", MANY_CELLS]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert float(done.stdout) < 600


def test_samplers_and_estimators_are_built_once(tmp_path):
    text = f'title = "t"\nsamplers = ["random", "jittered"]\n{POINTS}[pcf]\nn = 4\n{_estimators(3)}'
    cells = make_plan(decode_study(text), tmp_path).cells
    assert len(cells) == 12
    assert len({id(cell.subject.sampler) for cell in cells}) == 2
    assert len({id(cell.subject.estimator) for cell in cells}) == 3
    assert len({id(cell.analysis) for cell in cells}) == 2


def test_a_companion_joins_its_analysis_and_its_own_table_has_priority(tmp_path):
    text = HEAD + "[spectrum]\nn = 16\nhalf_width = 4\n" + ESTIMATOR
    cells = make_plan(decode_study(text), tmp_path).cells
    assert [(cell.analysis_name, cell.analysis.n) for cell in cells] == [
        ("spectrum", 16),
        ("points", 16),
    ]
    cells = make_plan(decode_study(text + "points = { n = 9 }"), tmp_path).cells
    assert [(cell.analysis_name, cell.analysis.n) for cell in cells] == [
        ("spectrum", 16),
        ("points", 9),
    ]


def test_a_study_as_plain_values_is_the_same_study(tmp_path):
    text = HEAD.replace("samplers", "time_limit = 3\nsamplers") + POINTS + ESTIMATOR
    config = decode_study(text + "spectrum = { n = 4 }\nsamplers = ['jittered']\n")
    plain = plain_study(config)
    assert plain["points"]["n"] == 16
    assert plain["estimators"][0]["spectrum"]["realizations"] == 100
    assert "density" not in plain["estimators"][0]
    assert study_of(plain) == config


@pytest.mark.parametrize(
    "call",
    [
        lambda: read_study("a\0b.toml"),
        lambda: decode_study("", overrides="seed=1"),
        lambda: apply_overrides({}, [3]),
        lambda: Trust(code="os:getcwd"),
        lambda: Trust(code=3),
        lambda: Trust(code=(3,)),
        lambda: Trust(folders=("a",)),
        lambda: Trust(folders="a"),
    ],
)
def test_wrong_argument_types_give_a_sentence(call):
    with pytest.raises(ConfigError, match=r"\.$"):
        call()
