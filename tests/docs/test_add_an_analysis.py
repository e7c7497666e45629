"""The page on adding an analysis: its one file is found in Python, study files, verbs and reports."""

from __future__ import annotations

import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mcspectra as mcs
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
    """A folder with the page's file and its entry point, as an installed package would have it."""
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


def mcspectra(package, *arguments, cwd=None):
    return subprocess.run(
        [sys.executable, "-m", "mcspectra", *arguments],
        env={**os.environ, "PYTHONPATH": str(package)},
        capture_output=True,
        text=True,
        cwd=cwd,
        check=False,
    )


def test_the_page_is_short():
    assert len(PAGE.read_text(encoding="utf-8").splitlines()) <= 80


def test_it_keeps_the_contract(quantiles):
    check_analysis(quantiles(n=16), "gaussian", "jittered")


def test_python_computes_it_with_the_same_bits_for_any_threads(quantiles):
    subject = as_subject("gaussian", "jittered")
    one, two = (compute(quantiles(n=16), subject, rng=3, workers=w) for w in (1, 2))
    assert one.identical(two)
    points = mcs.sampler("jittered", dims=2).draw(16, realizations=1000, rng=3)
    estimates = mcs.integrand("gaussian", dims=2)(points).mean(axis=1)
    np.testing.assert_allclose(one["quantile"], np.quantile(estimates, one["level"]))


def test_bad_options_are_one_sentence(quantiles):
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


def test_the_command_line_lists_runs_and_explains_it(package):
    listed = mcspectra(package, "list", "analyses", "--json")
    about = {each["name"]: each["summary"] for each in json.loads(listed.stdout)}
    assert about["quantiles"] == "Quantiles of the estimate over realisations."
    usage = mcspectra(package, "quantiles", "--help").stdout
    assert "--realizations" in usage
    assert "points of each technique" in usage
    done = mcspectra(
        package, "quantiles", "gaussian", "--sampler", "jittered", "-n", "16", "--json"
    )
    assert done.returncode == 0, done.stderr
    assert len(json.loads(done.stdout)["quantile"]) == 5
    shown = mcspectra(package, "quantiles", "gaussian", "--sampler", "jittered", "-n", "16")
    assert "0.95" in shown.stdout
    bad = mcspectra(package, "quantiles", "gaussian", "--sampler", "jittered", "-n", "0")
    assert (bad.returncode, bad.stderr.count("\n")) == (2, 1)


def test_a_study_runs_it_and_the_report_shows_it(package, tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    schema = json.loads(mcspectra(package, "schema").stdout)
    assert "quantiles" in schema["$defs"]["StudyConfig"]["properties"]
    run = mcspectra(package, "run", "study.toml", "--out", "out", "--quiet", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    tree = mcs.studies.open_results(tmp_path / "out")
    found = tree["bump/jittered/quantiles"]["quantile"]
    assert found.sizes == {"level": 5}
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Quantiles of the estimate over realisations" in page
    wrong = STUDY.replace("n = 16", "n = -1")
    (tmp_path / "wrong.toml").write_text(wrong)
    refused = mcspectra(package, "run", "wrong.toml", "--out", "no", cwd=tmp_path)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "quantiles" in refused.stderr
