"""The verb report: the page again, a comparison, and one sentence for bad input."""

import json
from pathlib import Path

import pytest

from mcspectra.cli.main import main
from mcspectra.core.errors import ParameterError
from mcspectra.report import write_report
from mcspectra.studies import decode_study, open_results, run_study

STUDY = """
title = "t"
samplers = ["random"]
[[estimators]]
name = "e"
integrand = "linear"
[estimators.terms]
n = 4
half_width = 2
realizations = 4
"""


@pytest.fixture(name="folders", scope="module")
def _folders(tmp_path_factory):
    """Two studies of one analysis."""
    both = [tmp_path_factory.mktemp(name) for name in "ab"]
    for folder in both:
        run_study(decode_study(STUDY), folder)
    return [str(folder) for folder in both]


def test_page_again(folders, capsys):
    assert main(["report", folders[0]]) == 0
    page = Path(folders[0]) / "report.html"
    assert page.is_file()
    assert capsys.readouterr().out == f"report: {page}\n"


@pytest.mark.usefixtures("undrawn")
def test_comparison_elsewhere(folders, tmp_path, capsys):
    page = str(tmp_path / "c.html")
    assert main(["report", folders[0], "--compare", folders[1], "--out", page, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"report": page}
    assert "Comparison" in Path(page).read_text(encoding="utf-8")


def test_bad_input(folders, tmp_path, capsys):
    for arguments in (
        [str(tmp_path)],
        [folders[0], "--compare", str(tmp_path)],
        [folders[0], "--compare", folders[0]],
        [folders[0], "--out", str(tmp_path / "nowhere" / "x.html")],
        [
            folders[0],
            "--out",
            str(tmp_path / "x"),
        ],  # Any path, such as a device
        [],
    ):
        assert main(["report", *arguments]) == 2
        error = capsys.readouterr().err
        assert error.startswith("mcspectra")
        assert error.count("\n") == 1


def test_a_run_of_very_many_cells_writes_no_report(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("mcspectra.studies.results.MOST_STORED", 1)
    (tmp_path / "s.toml").write_text(STUDY.replace('["random"]', '["random", "jittered"]'))
    assert main(["run", str(tmp_path / "s.toml"), "--out", str(tmp_path / "many")]) == 0
    assert "2 results are in" in capsys.readouterr().out
    assert not (tmp_path / "many" / "report.html").exists()
    assert not (tmp_path / "many" / "results.zarr").exists()


def test_no_page_is_written_into_a_store(folders, capsys):
    """A store has a digest of all its files, so a page in it would invalidate the store."""
    store = f"{folders[0]}/results.zarr"
    for arguments in (["report", store], ["report", str(folders[0]), "--compare", store]):
        assert main(arguments) == 2
        assert "is a Zarr store" in (said := capsys.readouterr().err)
        assert "--out" in said
    with pytest.raises(ParameterError, match="is a Zarr store, which cannot hold a page"):
        write_report(store)
    open_results(store)


@pytest.mark.usefixtures("undrawn")
def test_techniques_at_one_n_have_a_row(tmp_path):
    terms = "[estimators.terms]\nn = 4\nhalf_width = 2\n"
    study = STUDY.replace(terms, "[estimators.techniques]\ncounts = 4\nhalf_width = 2\n")
    run_study(decode_study(study), tmp_path)
    assert main(["report", str(tmp_path)]) == 0
    assert "Techniques" in (tmp_path / "report.html").read_text(encoding="utf-8")
