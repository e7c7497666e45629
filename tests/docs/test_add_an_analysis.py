"""The page on adding an analysis: its file works in Python, studies, verbs and reports."""

import importlib
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import mcspectra as mcs
from mcspectra.cli.main import main
from mcspectra.core.analysis import compute
from mcspectra.estimators import as_subject
from mcspectra.testing import BrokenContract, check_analysis

PAGE = Path(__file__).parents[2] / "docs" / "add-an-analysis.md"
STUDY = """\
title = "quantiles"
samplers = ["random", "jittered"]
[quantiles]
n = 16
realizations = 200
[[estimators]]
name = "bump"
integrand = "gaussian"
dims = 2
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """Return a folder with the page's file and its entry point, like an installed package."""
    text = PAGE.read_text(encoding="utf-8")
    code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    folder = tmp_path_factory.mktemp("own")
    (folder / "quantiles.py").write_text(code[0], encoding="utf-8")
    info = folder / "own-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1\n")
    group, entry = re.search(r'entry-points\."(.*?)"\]\n(.*)', text).groups()
    (info / "entry_points.txt").write_text(f"[{group}]\n{entry.replace(chr(34), '')}\n")
    return folder


@pytest.fixture
def quantiles(package):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(package)
        yield importlib.import_module("quantiles").Quantiles
        sys.modules.pop("quantiles")


@pytest.fixture
def mcspectra(quantiles, capsys):
    """Return a function that runs a command and returns its exit code, output and errors."""

    def call(*arguments):
        return main(list(arguments)), *capsys.readouterr()

    return call


def test_the_page_is_short():
    assert len(PAGE.read_text(encoding="utf-8").splitlines()) <= 85


def test_the_analysis_satisfies_the_contract(quantiles):
    check_analysis(quantiles(n=16), "gaussian", "jittered")


def test_python_computes_it_with_the_same_bits_for_any_threads(quantiles):
    subject = as_subject("gaussian", "jittered")
    one, two = (compute(quantiles(n=16), subject, rng=3, workers=w) for w in (1, 2))
    assert one.identical(two)
    points = mcs.sampler("jittered", dims=2).draw(16, realizations=1000, rng=3)
    estimates = mcs.integrand("gaussian", dims=2)(points).mean(axis=1)
    np.testing.assert_allclose(one["quantile"], np.quantile(estimates, one["level"]))


def test_bad_options_give_one_sentence(quantiles):
    subject = as_subject("gaussian", "jittered")
    with pytest.raises(mcs.McspectraError, match="n is 0; give a whole number of at least 1"):
        compute(quantiles(n=0), subject)
    with pytest.raises(mcs.McspectraError, match="17"):
        compute(quantiles(n=17), subject)


def test_an_undeclared_variable_is_a_broken_contract(quantiles):
    class Undeclared(quantiles, frozen=True, kw_only=True):
        """Quantiles, of which nothing is declared."""

        variables = ()

    with pytest.raises(BrokenContract, match="quantile"):
        check_analysis(Undeclared(n=16), "gaussian", "jittered")


def test_the_command_line_lists_runs_and_explains_the_analysis(mcspectra):
    about = {
        each["name"]: each["summary"]
        for each in json.loads(mcspectra("list", "analyses", "--json")[1])
    }
    assert about["quantiles"] == "Quantiles of the estimate over realizations."
    _, usage, _ = mcspectra("quantiles", "--help")
    assert "--realizations" in usage
    assert "points of each technique" in usage
    given = ("quantiles", "gaussian", "--sampler", "jittered", "-n")
    code, out, err = mcspectra(*given, "16", "--json")
    assert code == 0, err
    assert len(json.loads(out)["quantile"]) == 5
    assert "0.95" in mcspectra(*given, "16")[1]
    code, _, err = mcspectra(*given, "0")
    assert (code, err.count("\n")) == (2, 1)


def test_a_study_runs_the_analysis_and_its_report_shows_it(mcspectra, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("study.toml").write_text(STUDY)
    schema = json.loads(mcspectra("init", "--schema")[1])
    assert "quantiles" in schema["$defs"]["StudyConfig"]["properties"]
    code, _, err = mcspectra("run", "study.toml", "--out", "out", "--quiet")
    assert code == 0, err
    tree = mcs.studies.open_results("out")
    assert tree["bump/jittered/quantiles"]["quantile"].sizes == {"level": 5}
    page = Path("out/report.html").read_text(encoding="utf-8")
    assert "Quantiles of the estimate over realizations" in page
    Path("wrong.toml").write_text(STUDY.replace("n = 16", "n = -1"))
    code, _, err = mcspectra("run", "wrong.toml", "--out", "no")
    assert (code, err.count("\n")) == (2, 1)
    assert "quantiles" in err
