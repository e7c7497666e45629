"""The verbs status and export."""

import json
import os
import re

import numpy as np
import pytest
import xarray as xr
from tests.studies.made import admit, text_of

from mcspectra.cli.main import main
from mcspectra.core.records import pack
from mcspectra.core.results import package_versions
from mcspectra.studies.ledger import FORMAT, LEDGER_NAME, Ledger, StudyNote
from mcspectra.studies.results import write_zarr

PATHS = tuple(f"{e}/random/{a}" for e in "abd" for a in ("convergence", "terms"))
NOTE = StudyNote(
    title="my study",
    seed=5,
    config=text_of(PATHS, "my study"),
    study_hash="ab" * 32,
    versions=package_versions(),
    inputs={},
)


def cell(first=0.0):
    return pack(xr.Dataset({"x": ("n", np.arange(3.0) + first)}))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A study of six cells: four are done, one failed, one is missing."""
    admit(monkeypatch, "x")
    with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
        for i, path in enumerate(PATHS[:4]):
            ledger.finish(path, cell(i))
        ledger.fail("d/random/terms", "It gave NaN.")
        ledger.record("d/random/convergence", "0-0-10", (0, 1), b"half")
    write_zarr(tmp_path)
    return tmp_path


def status(folder, capsys, *more):
    code = main(["status", str(folder), "--json", *more])
    return code, json.loads(capsys.readouterr().out)


def damage(folder, content):
    """Change a byte of the ledger where it has `content`."""
    file = folder / LEDGER_NAME
    whole = file.read_bytes()
    at = whole.index(content) + len(content) - 1
    file.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])


def test_status_lists_done_failed_and_missing_cells(folder, capsys):
    code, found = status(folder, capsys)
    assert code == 1
    assert found["state"] == "unfinished"
    assert found["done"] == list(PATHS[:4])
    assert found["failed"] == {"d/random/terms": "It gave NaN."}
    assert found["missing"] == ["d/random/convergence"]
    assert found["damaged"] == {}
    assert found["recorded"] == 1
    assert found["seed"] == 5
    assert found["format"] == FORMAT
    assert found["holder"] is None
    assert found["started"] <= found["started"][:4] + "~"
    assert found["finished"] is None
    assert found["analyses"] == {
        "convergence": {"done": 2, "failed": 0, "missing": 1, "damaged": 0},
        "terms": {"done": 2, "failed": 1, "missing": 0, "damaged": 0},
    }
    assert found["results_bytes"] == 4 * len(cell())
    assert found["ledger_bytes"] == (folder / LEDGER_NAME).stat().st_size


def test_status_as_text(folder, capsys):
    assert main(["status", str(folder)]) == 1
    shown = capsys.readouterr().out
    assert shown.startswith("my study: unfinished\nstarted 20")
    assert ["terms", "2", "1", "0", "0"] in [line.split() for line in shown.splitlines()]
    assert "failed: d/random/terms: It gave NaN.\nmissing: d/random/convergence\n" in shown
    assert "with 1 recorded task; not verified; --verify checks all digests" in shown


def test_verify_finds_damage_and_names_it(folder, capsys):
    damage(folder, cell(1))
    damage(folder, b"half")
    code, found = status(folder, capsys)
    assert (code, found["damaged"]) == (1, {})
    code, found = status(folder, capsys, "--verify")
    assert code == 1
    assert found["verified"]
    assert found["damaged"] == {
        PATHS[1]: "its digest does not match",
        "task d/random/convergence/0-0-10/0+1": "its digest does not match",
    }
    assert found["analyses"]["terms"] == {"done": 1, "failed": 1, "missing": 0, "damaged": 1}


def test_an_invalid_lock_is_counted_and_fails(folder, capsys):
    (folder / "study.lock").write_bytes(b"junk")
    for verify in ((), ("--verify",)):
        assert main(["status", str(folder), *verify]) == 1
        lines = capsys.readouterr().out.splitlines()
        assert ["other", "parts", "1"] in [line.split() for line in lines]
        assert any(line.startswith("damaged: the lock study.lock: it is not") for line in lines)
        assert not any("--resume" in line for line in lines)


def test_damage_of_the_file_is_reported_in_plain_words(folder, capsys):
    file = folder / LEDGER_NAME
    page = 8192
    content = bytearray(file.read_bytes())
    content[2 * page : 2 * page + 600] = 600 * b"\x55"
    file.write_bytes(content)
    assert main(["status", str(folder), "--verify"]) == 1
    shown = capsys.readouterr().out
    assert "damaged: file: pages of the file are damaged or missing\n" in shown
    assert "--resume' keeps the results of " in shown
    assert not re.search("btree|database|malformed|in main", shown)


def test_a_finished_study_is_finished(folder, capsys):
    with Ledger.resume(folder, NOTE, PATHS) as ledger:
        code, found = status(folder, capsys)
        assert (code, found["state"], found["holder"]["pid"]) == (0, "running", os.getpid())
        ledger.forget(PATHS[4:])
        for path in PATHS[4:]:
            ledger.finish(path, cell())
    code, found = status(folder, capsys, "--verify")
    assert (code, found["state"]) == (0, "finished")
    assert (found["failed"], found["missing"], found["damaged"]) == ({}, [], {})
    assert main(["status", str(folder)]) == 0
    assert ", finished 20" in capsys.readouterr().out


def test_status_names_a_process_that_did_not_end_normally(folder, capsys):
    with Ledger.resume(folder, NOTE, PATHS):
        left = (folder / LEDGER_NAME).read_bytes()
    (folder / LEDGER_NAME).write_bytes(left)
    code, found = status(folder, capsys)
    assert (code, found["state"], found["holder"]["pid"]) == (1, "unfinished", os.getpid())
    main(["status", str(folder)])
    shown = capsys.readouterr().out
    assert f"written by process {os.getpid()} on host" in shown
    assert "which has ended" in shown


def test_export(tmp_path, capsys, monkeypatch):
    admit(monkeypatch, "x", "y")
    scalars = pack(xr.Dataset({"x": ("n", np.arange(3.0)), "y": ((), 2.0)}, {"n": [4, 16, 64]}))
    out, table, store = tmp_path / "out", tmp_path / "x.csv", tmp_path / "x.zarr"
    with Ledger.create(out, NOTE, PATHS) as ledger:
        for path in PATHS:
            ledger.finish(path, scalars)
    files = ["-o", str(table), "--out", str(store)]
    assert main(["export", str(out), *files, "--select", "a/*", "--json"]) == 0
    sizes = [path.stat().st_size for path in store.rglob("*") if path.is_file()]
    assert json.loads(capsys.readouterr().out) == [
        {"file": str(table), "bytes": table.stat().st_size},
        {"file": str(store), "bytes": sum(sizes)},
    ]
    assert table.read_text().count("\n") == 1 + 2 * 4
    assert main(["export", str(store), "-o", str(tmp_path / "again.csv")]) == 0
    assert capsys.readouterr().out.startswith(f"{tmp_path / 'again.csv'}: ")
    assert (tmp_path / "again.csv").read_bytes() == table.read_bytes()
    assert main(["export", str(out), "-o", "x.nc"]) == 2
    assert "has none of the extensions" in capsys.readouterr().err
