"""The verbs status and export."""

import json
import os
from pathlib import Path

import fsspec
import numpy as np
import pytest
import xarray as xr

from mcspectra.cli.main import main
from mcspectra.studies import Store, decode_study
from mcspectra.studies.journal import Journal
from mcspectra.studies.lock import LOCK_NAME, FolderLock
from mcspectra.studies.manifest import CellLine, append_line

STUDY = (
    'title = "my study"\nseed = 5\nsamplers = ["random"]\n[convergence]\ncounts = [4]\n'
    '[[estimators]]\nname = "a"\nintegrand = "linear"\ndims = 1\n'
)
PATHS = tuple(f"{e}/random/{a}" for e in "abc" for a in ("convergence", "terms"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A study of six cells: four are done, one failed, one is missing."""
    store = Store.create(tmp_path, decode_study(STUDY), paths=PATHS)
    for i, path in enumerate(PATHS[:4]):
        store.write(path, xr.Dataset({"x": ("n", np.arange(3.0) + i)}))
    store.finish()
    with Journal.create(tmp_path, {"study": "x"}) as journal:
        journal.append("c/random/terms", None, "It gave NaN.", {})
        journal.append("c/random/convergence/0-0-10/0+1", b"half", None, {})
    return tmp_path


def status(folder: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[int, dict]:
    code = main(["status", str(folder), "--json", *more])
    return code, json.loads(capsys.readouterr().out)


def test_status_says_what_is_done_failed_and_missing(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = status(folder, capsys)
    assert code == 1
    assert found["state"] == "unfinished"
    assert found["done"] == list(PATHS[:4])
    assert found["failed"] == {"c/random/terms": "It gave NaN."}
    assert found["missing"] == ["c/random/convergence"]
    assert found["damaged"] == {}
    assert found["recorded"] == 1
    assert found["seed"] == 5
    assert found["format"] == 2
    assert found["holder"] is None
    assert found["started"] <= found["started"][:4] + "~"
    assert found["finished"] is None
    assert found["analyses"] == {
        "convergence": {"done": 2, "failed": 0, "missing": 1, "damaged": 0},
        "terms": {"done": 2, "failed": 1, "missing": 0, "damaged": 0},
    }
    size = sum(
        file.stat().st_size
        for path in PATHS[:4]
        for file in (folder / "results.zarr" / path).rglob("*")
        if file.is_file()
    )
    assert found["results_bytes"] == size
    assert found["journal_bytes"] == (folder / "journal" / "log").stat().st_size


def test_status_as_text(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", str(folder)]) == 1
    shown = capsys.readouterr().out
    assert shown.startswith("my study: unfinished\nstarted 20")
    assert ["terms", "2", "1", "0", "0"] in [line.split() for line in shown.splitlines()]
    assert "failed: c/random/terms: It gave NaN.\nmissing: c/random/convergence\n" in shown
    assert "not verified; --verify checks all files" in shown


def test_verify_finds_damage_and_names_the_file(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chunk = folder / "results.zarr" / PATHS[1] / "x" / "c.0"
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"!")
    log = folder / "journal" / "log"
    log.write_bytes(log.read_bytes()[:-1] + b"!")
    code, found = status(folder, capsys)
    assert (code, found["damaged"]) == (1, {})
    code, found = status(folder, capsys, "--verify")
    assert code == 1
    assert found["verified"]
    assert found["damaged"] == {
        PATHS[1]: "x/c.0 has changed",
        "journal: c/random/convergence/0-0-10/0+1": "it cannot be read",
    }
    assert found["analyses"]["terms"] == {"done": 1, "failed": 1, "missing": 0, "damaged": 1}


def test_a_finished_study_is_finished(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = Store.create(folder, decode_study(STUDY), resume=True, paths=PATHS)
    for path in PATHS[4:]:
        store.write(path, xr.Dataset({"x": ("n", np.arange(3.0))}))
    store.finish()
    code, found = status(folder, capsys, "--verify")
    assert (code, found["state"]) == (0, "finished")
    assert (found["failed"], found["missing"], found["damaged"]) == ({}, [], {})
    assert main(["status", str(folder)]) == 0
    assert ", finished 20" in capsys.readouterr().out


def test_status_names_who_writes_and_who_did(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with FolderLock.take(folder):
        code, found = status(folder, capsys)
        left = (folder / LOCK_NAME).read_text()
    assert (code, found["state"], found["holder"]["pid"]) == (0, "running", os.getpid())
    (folder / LOCK_NAME).write_text(left)
    code, found = status(folder, capsys)
    assert (code, found["state"], found["holder"]["pid"]) == (1, "unfinished", os.getpid())
    main(["status", str(folder)])
    assert f"written by process {os.getpid()} on host" in capsys.readouterr().out


def test_a_cell_that_was_never_put_in_place_is_missing(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    append_line(folder, CellLine(PATHS[4], "0" * 64, "", 0, ""))
    for more in ((), ("--verify",)):
        _, found = status(folder, capsys, *more)
        assert found["missing"] == [PATHS[4]]
        assert found["damaged"] == {}


def test_a_store_of_format_1_has_a_status(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "manifest.jsonl").unlink()
    root = folder / "results.zarr" / "zarr.json"
    document = json.loads(root.read_text())
    document["attributes"]["format"] = 1
    root.write_text(json.dumps(document))
    _, found = status(folder, capsys, "--verify")
    assert sorted(found["done"]) == sorted(PATHS[:4])
    assert (found["format"], found["seed"], found["missing"]) == (1, None, [])


def test_no_results_is_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"mcspectra: There are no results in {str(tmp_path)!r}.\n"


def test_export(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "out.csv"
    assert main(["export", str(folder), "--to", str(file), "--select", "a/*", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "file": str(file),
        "bytes": file.stat().st_size,
    }
    assert file.read_text().count("\n") == 2 + 2 * 3
    assert main(["export", str(folder), "--to", str(tmp_path / "out.zarr.zip")]) == 0
    assert capsys.readouterr().out.startswith(f"{tmp_path / 'out.zarr.zip'}: ")
    assert main(["export", str(folder), "--to", "x.txt"]) == 2
    assert "has none of the ends" in capsys.readouterr().err


@pytest.mark.parametrize("number", [3, 0, None, "2"])
def test_status_of_another_format_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], number: object
) -> None:
    root = folder / "results.zarr" / "zarr.json"
    document = json.loads(root.read_text())
    document["attributes"]["format"] = number
    root.write_text(json.dumps(document))
    assert main(["status", str(folder)]) == 2
    words = f"has store format {number!r}; this version reads 1 and 2"
    assert words in capsys.readouterr().err


def test_export_of_a_store_to_a_folder_and_to_a_url(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = folder / "x.zarr"
    assert main(["export", str(folder), "--to", str(target), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    sizes = [path.stat().st_size for path in target.rglob("*") if path.is_file()]
    assert found == {"file": str(target), "bytes": sum(sizes)}
    url = "memory://status-test/x.zarr"
    assert main(["export", str(target), "--to", url]) == 0
    assert capsys.readouterr().out == f"{url}\n"
    assert main(["export", "memory://status-test/x.zarr", "--to", str(folder / "x.csv")]) == 0
    fsspec.filesystem("memory").rm("/status-test", recursive=True)
