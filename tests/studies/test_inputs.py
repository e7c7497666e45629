"""Changed input files: results are never mixed; they are refused or computed again."""

import hashlib
import os
import sys

import numpy as np
import pytest

from mcspectra.core.errors import StoreError
from mcspectra.studies import Trust, make_plan, open_results, run_study, study_status
from mcspectra.studies.files import decode_study
from mcspectra.studies.ledger import Ledger
from mcspectra.studies.run import CellFailed
from mcspectra.studies.tasks import StudyText
from mcspectra.studies.vetting import Vetting, changed_inputs, check_inputs

STUDY = """
title = "inputs"
samplers = ["random", "jittered"]
[convergence]
counts = [4, 16]
realizations = 10
[[estimators]]
name = "a"
integrand = "image(path='data/a.npy')"
[[estimators]]
name = "b"
integrand = "image(path='data/b.npy')"
[[estimators]]
name = "l"
integrand = "linear"
dims = 1
"""
CELLS = {f"{e}/{s}/convergence" for e in "abl" for s in ("random", "jittered")}


class _Stop(Exception):
    pass


@pytest.fixture
def folder(tmp_path):
    """The folder of a study with two images."""
    (tmp_path / "data").mkdir()
    for seed, name in enumerate("ab"):
        _image(tmp_path, name, seed)
    return tmp_path


def _image(folder, name, seed):
    values = np.random.default_rng(seed).random((4, 4))
    np.save(folder / "data" / f"{name}.npy", values)


def _run(folder, out="out", text=STUDY, **options):
    return run_study(decode_study(text), folder / out, folder=folder, workers=1, **options)


def _stopped(folder, cells):
    """Run some cells of the study, then stop."""

    def report(progress):
        if progress.done == cells:
            raise _Stop

    with pytest.raises(_Stop):
        _run(folder, report=report)


def test_files_are_named_from_the_studys_folder_with_the_cells_that_use_them(folder):
    plan = make_plan(decode_study(STUDY), folder)
    expected = {
        f"data/{name}.npy": hashlib.sha256((folder / f"data/{name}.npy").read_bytes()).hexdigest()
        for name in "ab"
    }
    assert plan.inputs == expected
    found = {cell.path[0]: cell.inputs for cell in plan.cells}
    assert found == {"a": ("data/a.npy",), "b": ("data/b.npy",), "l": ()}


def test_a_changed_file_is_refused_by_name_and_nothing_is_touched(folder):
    _stopped(folder, 3)
    before = _files(folder / "out")
    _image(folder, "b", 7)
    with pytest.raises(StoreError, match=r"another version of the file 'data/b\.npy'.*--retry"):
        _run(folder, resume=True)
    assert _files(folder / "out") == before
    _image(folder, "b", 1)  # Restore the file with another time stamp
    _run(folder, resume=True)
    status = study_status(folder / "out")
    assert (status.state, status.recorded) == ("finished", 0)


def test_retry_computes_only_cells_that_depend_on_a_changed_file(folder, stored_values):
    _stopped(folder, 5)
    kept = {path for path in study_status(folder / "out").done if path[0] != "b"}
    assert kept
    _image(folder, "b", 7)
    seen = []
    _run(folder, resume=True, retry=True, report=lambda progress: seen.append(progress.cell.path))
    assert set(seen) == CELLS - kept
    _run(folder, "straight")
    assert stored_values(folder / "out") == stored_values(folder / "straight")
    _run(folder, resume=True)  # The ledger now has the new file
    assert study_status(folder / "out", verify=True).state == "finished"


def test_a_changed_source_of_a_function_is_refused(misbehaving, tmp_path):
    text = STUDY.split("[[estimators]]")[0] + (
        "[[estimators]]\nname = 'a'\ndims = 1\nintegrand = "
        "\"python(function='misbehaving:good')\"\n"
    )
    trust = Trust(("misbehaving:good",))
    _run(tmp_path, text=text, trust=trust)
    with Ledger.read(tmp_path / "out") as ledger:
        assert [*ledger.study.inputs] == ["module misbehaving"]
    with (misbehaving / "misbehaving.py").open("a") as stream:
        stream.write("\n# changed\n")
    sys.modules.pop("misbehaving")
    with pytest.raises(StoreError, match="another version of the file 'module misbehaving'"):
        _run(tmp_path, text=text, trust=trust, resume=True)


def test_files_of_a_scene_are_inputs(tmp_path):
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
        '<string name="filename" value="wood.png"/></texture></bsdf></scene>'
    )
    (tmp_path / "wood.png").write_bytes(b"wood")
    (tmp_path / "other.png").write_bytes(b"other")
    vetting = Vetting(tmp_path, Trust())
    assert vetting.calls("pixel(scene='scene.xml', x=0, y=0)")[1] == ("scene.xml", "wood.png")
    assert vetting.calls("image(path='wood.png')")[1] == ("wood.png",)
    assert vetting.inputs["wood.png"] == hashlib.sha256(b"wood").hexdigest()
    assert "other.png" not in vetting.inputs


def test_inputs_are_files_that_can_be_read(tmp_path):
    inside, outside = tmp_path / "in" / "x", tmp_path / "y"
    inside.parent.mkdir()
    inside.write_bytes(b"1")
    outside.write_bytes(b"2")
    (tmp_path / "in" / "link").symlink_to(inside)
    os.mkfifo(tmp_path / "in" / "pipe")
    vetting = Vetting(tmp_path / "in", Trust(folders=(tmp_path,)))
    paths = ["x", "link", "../y", "../in", "none", "pipe"]
    assert vetting.calls(f"points(path={paths})")[1] == (str(outside), "x")
    assert vetting.inputs == {
        "x": hashlib.sha256(b"1").hexdigest(),
        str(outside): hashlib.sha256(b"2").hexdigest(),
    }


def test_a_cell_depends_on_its_own_sampler_and_no_other(folder):
    np.savetxt(folder / "set.dat", np.linspace(0, 0.9, 16)[:, None])
    text = STUDY.replace('"jittered"', "\"points(path='set.dat') | shift\"")
    text = text.replace("counts = [4, 16]", "counts = [16]").replace(
        "dims = 1", "dims = 1\nsamplers = ['random', \"points(path='set.dat')\"]"
    )
    text = text.split("[[estimators]]")[0] + "[[estimators]]" + text.split("[[estimators]]")[3]
    found = {each.path: each.inputs for each in make_plan(decode_study(text), folder).cells}
    assert found == {
        "l/random/convergence": (),
        "l/points-path-set.dat/convergence": ("set.dat",),
    }


def test_changed_added_and_removed_files_are_listed():
    before, now = {"a": "1", "b": "2", "c": "3"}, {"a": "1", "b": "0", "d": "4"}
    assert changed_inputs(before, now) == ("b", "c", "d")
    assert changed_inputs(now, now) == ()
    check_inputs(now, dict(now), "It is", "do")
    with pytest.raises(
        StoreError, match="It is from another version of the files '0', '1', '2' and 7 more"
    ):
        check_inputs({}, {str(i): "" for i in range(10)}, "It is", "do")


def test_a_worker_with_another_file_refuses(folder):
    config = decode_study(STUDY)
    plan = make_plan(config, folder)
    text = StudyText.of(config, folder, inputs=plan.inputs)
    assert text.cells().keys() == {cell.path for cell in plan.cells}
    _image(folder, "a", 5)
    with pytest.raises(StoreError, match=r"another version of the file 'data/a\.npy'.*on host"):
        text.cells()
    assert StudyText.of(config, folder).cells()


def test_another_time_limit_is_the_same_study(folder):
    text = STUDY.split("[[estimators]]")[0] + "[[estimators]]" + STUDY.split("[[estimators]]")[3]
    limited = "time_limit = {}\n" + text
    run_study(decode_study(text), folder / "out", workers=1)
    for change in (limited.format(60), limited.format(61)):
        config = decode_study(change)
        run_study(config, folder / "out", resume=True, workers=1, engine=_no_engine)
    with pytest.raises(StoreError, match="another study"):
        run_study(decode_study("seed = 2\n" + text), folder / "out", resume=True, workers=1)


def _no_engine(text):
    raise AssertionError(f"nothing is left to compute of {text}")


def test_a_study_is_not_finished_when_a_changed_function_fails(misbehaving, tmp_path):
    """The cell was finished once and is listed in the ledger; it is removed and now fails."""
    text = STUDY.split("[[estimators]]")[0] + (
        "[[estimators]]\nname = 'a'\ndims = 1\nintegrand = "
        "\"python(function='misbehaving:good')\"\n"
    )
    trust = Trust(("misbehaving:good",))
    _run(tmp_path, text=text, trust=trust)
    source = (misbehaving / "misbehaving.py").read_text()
    (misbehaving / "misbehaving.py").write_text(
        source.replace("def good(", "def good(x):\n    1 / 0\n\n\ndef _(")
    )
    sys.modules.pop("misbehaving")
    with pytest.raises(CellFailed, match="2 of 2 cells failed"):
        _run(tmp_path, text=text, trust=trust, resume=True, retry=True)
    status = study_status(tmp_path / "out", verify=True)
    assert (status.state, status.done, status.missing, status.damaged) == ("unfinished", (), (), {})
    assert set(status.failed.values()) == {"It raised ZeroDivisionError: division by zero."}
    assert not open_results(tmp_path / "out").children


def _files(folder):
    return {
        path.relative_to(folder): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "study.lock"
    }
