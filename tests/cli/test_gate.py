"""The verb gate: exit codes, the stored reference, JUnit, GitHub, the page, and bad input."""

import json
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from mcspectra.cli.main import main
from mcspectra.testing import ImagesDiffer, ImagesUndecided, assert_same_image

SIZE = 24


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Folders of frames: a and b are alike, dark is darker, and one has a single frame."""
    root, rng = tmp_path_factory.mktemp("frames"), np.random.default_rng(1)
    for name, count, mean in (("a", 6, 1.0), ("b", 6, 1.0), ("dark", 6, 0.9), ("one", 1, 1.0)):
        (root / name).mkdir()
        for k in range(count):
            image = mean * (1 + 0.2 * rng.standard_normal((SIZE, SIZE)))
            np.save(root / name / f"v_16spp_{k}.npy", image.astype(np.float32))
    return root


def run(capsys, *arguments):
    code = main(["gate", "--quiet", *map(str, arguments)])
    out, err = capsys.readouterr()
    return code, out, err


def test_exit_codes_say_the_verdict(capsys, folders):
    code, out, _ = run(capsys, folders / "a", folders / "b")
    assert code == 0
    assert out.startswith("Pass: ")
    code, out, _ = run(capsys, folders / "dark", folders / "b")
    assert code == 3
    assert out.startswith("Fail: the image mean is")
    assert "lower than in the reference" in out
    code, out, _ = run(capsys, folders / "one", folders / "one" / "v_16spp_0.npy", "--json")
    assert code == 0
    assert json.loads(out)["copy"] == 1
    single = folders / "a" / "v_16spp_0.npy"
    code, out, _ = run(capsys, folders / "one", single)
    assert code == 4
    assert out.startswith("Undecided: ")
    code, out, _ = run(capsys, folders / "a", folders / "b", "--target", "1e-4")
    assert code == 4


def test_json_has_the_verdict_and_the_tests(capsys, folders):
    code, out, _ = run(capsys, folders / "dark", folders / "b", "--json")
    data = json.loads(out)
    assert code == 3
    assert data["verdict"] == "fail"
    assert data["p"] <= 0.01
    assert {"image", "noise", "filter"} <= {test["test"] for test in data["tests"]}
    assert data["findings"][0].startswith("Fail")


def test_junit_github_and_the_page(capsys, folders, tmp_path, monkeypatch):
    summary = tmp_path / "summary.md"
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(summary))
    file, page = tmp_path / "gate.xml", tmp_path / "page"
    code, out, _ = run(
        capsys, folders / "dark", folders / "b", "--junit", file, "--github", "--out", page
    )
    assert code == 3
    assert "::error title=mcspectra gate::Fail: the image mean is 1" in out
    assert " %25 lower" in out
    suite = ET.fromstring(file.read_text(encoding="utf-8")).find("testsuite")
    cases = suite.findall("testcase")
    failures = [case.get("name") for case in cases if case.find("failure") is not None]
    assert int(suite.get("tests")) == len(cases)
    assert int(suite.get("failures")) == len(failures)
    assert {"verdict", "mean of the image"} <= set(failures)
    text = summary.read_text(encoding="utf-8")
    assert "### mcspectra gate: fail" in text
    assert "| mean of the image |" in text
    html = (page / "report.html").read_text(encoding="utf-8")
    assert "Fail: the image mean is" in html
    assert (page / "gate_p.png").exists()
    assert json.loads((page / "gate.json").read_text(encoding="utf-8"))["verdict"] == "fail"


def test_junit_of_undecided_is_skipped(capsys, folders, tmp_path):
    file = tmp_path / "gate.xml"
    code, *_ = run(
        capsys, folders / "one", folders / "a" / "v_16spp_0.npy", "--junit", file, "--github"
    )
    assert code == 4
    suite = ET.fromstring(file.read_text(encoding="utf-8")).find("testsuite")
    assert suite.get("skipped") == "1"
    assert suite.find("testcase").find("skipped") is not None


def test_a_reference_is_made_and_used(capsys, folders, tmp_path):
    pytest.importorskip("OpenEXR")
    file = tmp_path / "reference.exr"
    assert run(capsys, folders / "b", "--make-reference", file)[0] == 0
    assert run(capsys, folders / "a", file)[0] == 0
    assert run(capsys, folders / "dark", file)[0] == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["a"], "give NEW and REFERENCE"),
        (["a", "b", "--level", "2"], "--level is 2"),
        (["a", "b", "--make-reference", "r.exr"], "leave REFERENCE out"),
        (["a", "b", "--out", "page.html"], "give a folder"),
        (["a", "--make-reference", "r.png"], "must end in .exr"),
        (["a", "nothing"], "There is no"),
    ],
)
def test_bad_input_is_one_sentence(capsys, folders, monkeypatch, arguments, words):
    monkeypatch.chdir(folders)
    code, _, err = run(capsys, *arguments)
    assert code == 2
    assert words in err
    assert err.count("\n") == 1


def test_the_helper_for_test_suites(folders):
    assert assert_same_image(folders / "a", folders / "b").attrs["verdict"] == "pass"
    with pytest.raises(ImagesDiffer, match="the image mean is") as caught:
        assert_same_image(folders / "dark", folders / "b")
    assert caught.value.result.attrs["verdict"] == "fail"
    with pytest.raises(ImagesUndecided, match="wanted"):
        assert_same_image(folders / "a", folders / "b", target=1e-4)
