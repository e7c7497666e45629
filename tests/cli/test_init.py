"""The verb init, and the options --set, --dry-run and allowances of run."""

import json
import re
from functools import partial

import pytest

from mcspectra.core.analysis import ANALYSES
from mcspectra.studies import decode_study, estimate_study, make_plan, study_schema
from mcspectra.studies.schema import template


@pytest.fixture
def file(run, tmp_path):
    path = tmp_path / "mine.toml"
    assert run("init", path)[0] == 0
    return path


@pytest.mark.usefixtures("undrawn")
def test_init_writes_a_study_that_runs(run, file, tmp_path):
    assert file.read_text(encoding="utf-8") == template()
    changes = ("convergence.realizations=20", "terms.realizations=20", 'samplers=["jittered"]')
    few = [part for change in changes for part in ("--set", change)]
    code, out, err = run("run", file, "--out", tmp_path / "o", "--json", *few)
    assert (code, err) == (0, "")
    assert [row["sampler"] for row in json.loads(out)["rows"]] == ["jittered"] * 3


def test_commented_lines_of_the_template_are_valid():
    """Every commented line of TOML after a table can be used."""
    offered = [
        line.removeprefix("# ") if line.startswith("# [") or " = " in line[:24] else line
        for line in template().splitlines()
    ]
    text = "\n".join(offered).replace("one_sample = true", "# one_sample = true")
    text = re.sub(r"\[anova-spectrum\].*\nn = 64", "", text)  # Not valid for weighted estimators
    plan = make_plan(decode_study(text, overrides=["terms.bands='radial'"]), ".")
    assert [cell.error for cell in plan.cells if cell.error] == []
    assert {cell.path.rpartition("/")[2] for cell in plan.cells} == {*ANALYSES} - {"anova-spectrum"}


def test_examples_of_the_template_are_of_the_size_of_their_options():
    assert "# target_error = 0.01\n" in template()
    assert "# budget = 4096\n" in template()


def test_init_refuses_to_overwrite(run, file):
    file.write_text("mine")
    code, out, err = run("init", file)
    assert (code, out) == (2, "")
    assert "already exists; give another name" in err
    assert file.read_text() == "mine"


@pytest.mark.parametrize(
    ("name", "words"), [("no/folder/x.toml", "cannot be written"), ("x.txt", "must end in .toml")]
)
def test_init_reports_an_unwritable_file(run, tmp_path, name, words):
    code, _, err = run("init", tmp_path / name)
    assert code == 2
    assert words in err


def test_init_prints_the_written_file(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert json.loads(run("init", "--json")[1]) == {"file": "study.toml"}
    assert run("init", "b.toml", "--quiet") == (
        0,
        "b.toml: run it with 'mcspectra run b.toml'.\n",
        "",
    )


def test_schema_prints_the_schema(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert json.loads(run("init", "--schema")[1]) == study_schema()
    assert "| `counts` |" in run("init", "--schema", "--markdown")[1]
    assert list(tmp_path.iterdir()) == []
    assert "--markdown is for --schema; also give --schema." in run("init", "--markdown")[2]
    assert "--schema writes no file; leave s.toml out." in run("init", "s.toml", "--schema")[2]


def test_whole_numbers_of_a_study_may_be_floats(run, file, monkeypatch):
    """1e3 is a float in TOML, which used to be refused for an integer."""
    untried = partial(estimate_study, probe_seconds=0)
    monkeypatch.setattr("mcspectra.studies.estimate_study", untried)
    few = ("--dry-run", "--json", "--set", "convergence.counts=[1.6e1, 6.4e1]", "--set", "seed=1e0")
    assert run("run", file, *few)[0] == 0
    code, _, err = run("run", file, "--dry-run", "--set", "convergence.realizations=1.5e0")
    assert code == 2
    assert "convergence.realizations is 1.5; give a whole number from 2 to " in err


def test_dry_run_writes_nothing(run, file, tmp_path, monkeypatch):
    found = []

    def once(plan):  # Trial runs take seconds, and both outputs show the same
        found[:] = found or estimate_study(plan, probe_seconds=1.0)
        return found

    monkeypatch.setattr("mcspectra.studies.estimate_study", once)
    code, out, _ = run("run", file, "--dry-run", "--out", tmp_path / "o", "--workers", 2)
    assert code == 0
    assert not (tmp_path / "o").exists()
    assert re.search(r"with 2 workers; \d\d+ tasks", out)  # 18, or more on a slow machine
    rows = [line for line in out.splitlines() if " convergence " in line]
    assert [row.split()[0] for row in rows] == ["plain", "importance-sampled", "multiple"]
    data = json.loads(run("run", file, "--dry-run", "--json")[1])
    assert len(data["cells"]) == 18
    assert all(cell["seconds"] >= 0 and cell["memory"] > 0 for cell in data["cells"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--set", "seed"), "has no '='"),
        (("--set", "convergence.realizations=1000000000", "--set", "convergence.counts=[1000000]"),
         "--force"),
        (("--set", "estimators[0].integrand=\"python(function='os:getcwd')\""),
         "--allow-code os:getcwd"),
        (("--allow-code", "os"), "module:function"),
    ],
)  # fmt: skip
def test_run_refuses_before_it_writes(run, file, tmp_path, options, words):
    code, out, err = run("run", file, "--out", tmp_path / "o", *options)
    assert (code, out) == (2, "")
    assert words in err
    assert not (tmp_path / "o").exists()


@pytest.mark.usefixtures("undrawn")
def test_allowed_functions_run(run, tmp_path, monkeypatch):
    (tmp_path / "allowed_functions.py").write_text("def first(x):\n    return x[..., 0]\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    file = tmp_path / "s.toml"
    file.write_text(
        "title = 't'\nsamplers = ['random']\nconvergence = { counts = [4], realizations = 10 }\n"
        "[[estimators]]\nname = 'a'\n"
        "integrand = \"python(function='allowed_functions:first')\"\n"
    )
    allowed = ("--allow-code", "allowed_functions:first")
    assert run("run", file, "--out", tmp_path / "o", "--quiet", *allowed)[0] == 0
