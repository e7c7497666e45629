"""Links in a study's folder are followed neither for reading nor for writing."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mcspectra.core.errors import StoreError
from mcspectra.report import write_report
from mcspectra.studies import Store, decode_study, open_results
from mcspectra.studies.journal import Journal
from mcspectra.studies.links import check_folder_links
from mcspectra.studies.lock import FolderLock

CONFIG = decode_study(
    'title = "links"\nsamplers = ["random"]\n[convergence]\ncounts = [4]\n'
    '[[estimators]]\nname = "a"\nintegrand = "linear"\ndims = 1\n'
)
CELLS = ("a/random/convergence", "a/random/terms")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A store of two cells and a journal."""
    store = Store.create(tmp_path / "out", CONFIG, paths=CELLS)
    for path in CELLS:
        store.write(path, xr.Dataset({"x": ("n", np.arange(3.0))}))
    store.finish()
    Journal.create(store.folder, {}).close()
    return store.folder


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A folder of somebody, with files in it and below."""
    folder = tmp_path / "secret"
    (folder / "random" / "convergence").mkdir(parents=True)
    for file in ("zarr.json", "log", "random/convergence/zarr.json", "key"):
        (folder / file).write_text("mine")
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def replaced_by_link(path: Path, target: Path) -> None:
    """Put a link in place of a file or a folder, which stays beside it under another name."""
    if path.exists():
        path.rename(path.parent / f"{path.name}-before")
    path.symlink_to(target)


@pytest.mark.parametrize(
    ("link", "target"),
    [
        ("results.zarr", ""),
        ("results.zarr/a", ""),
        ("results.zarr/zarr.json", "key"),
        ("results.zarr/a/random/terms/x/c.0", "key"),
        ("journal", ""),
        ("journal/log", "log"),
        ("journal/log.partial", "key"),
        ("manifest.jsonl", "key"),
        (".manifest.jsonl.partial", "key"),
        (".partial-zarr.json", "key"),
        ("report.html", "key"),
        ("figures", ""),
        ("figures", "nothing-there"),
    ],
)
def test_a_folder_with_links_is_not_written(
    folder: Path, secret: Path, link: str, target: str
) -> None:
    replaced_by_link(folder / link, secret / target)
    before = contents(secret)
    for make in (
        lambda: Store.create(folder, CONFIG, resume=True, paths=CELLS),
        lambda: write_report(folder),
    ):
        with pytest.raises(StoreError, match=rf"{link}' is a symbolic link"):
            make()
    assert contents(secret) == before


def test_a_lock_that_is_a_link_is_not_written(folder: Path, secret: Path) -> None:
    (folder / "run.lock").symlink_to(secret / "key")
    with pytest.raises(StoreError, match=r"run\.lock' is a symbolic link"):
        FolderLock.take(folder)
    assert (secret / "key").read_text() == "mine"


@pytest.mark.parametrize("select", [None, "a/*", CELLS[1]])
@pytest.mark.parametrize("link", ["a", "a/random/terms", "a/random/terms/x/c.0"])
def test_links_inside_a_store_are_not_read(
    folder: Path, secret: Path, link: str, select: str | None
) -> None:
    tree = folder / "results.zarr"
    inside = tree / link
    elsewhere = secret / "copy"
    inside.rename(elsewhere)  # the same bytes: nothing else than the link can be the reason
    inside.symlink_to(elsewhere)
    with pytest.raises(StoreError, match=rf"{link}' is a symbolic link"):
        open_results(folder, select)


def test_cells_without_links_can_be_opened_beside_one_with(folder: Path, secret: Path) -> None:
    replaced_by_link(folder / "results.zarr/a/random/terms", secret)
    assert open_results(folder, CELLS[0])[CELLS[0]]["x"].values.tolist() == [0.0, 1.0, 2.0]


def test_what_whoever_runs_it_has_linked_is_fine(folder: Path, tmp_path: Path) -> None:
    """The output folder itself, a store that is named, and other files in the folder."""
    (tmp_path / "scratch").symlink_to(folder)
    (tmp_path / "some.zarr").symlink_to(folder / "results.zarr")
    (folder / "notes").symlink_to(tmp_path)
    (folder / ".venv").mkdir()
    (folder / ".venv" / "python").symlink_to(sys.executable)
    assert Store.create(tmp_path / "scratch", CONFIG, resume=True, paths=CELLS).done(CELLS[0])
    assert len(open_results(tmp_path / "some.zarr").leaves) == 2


def test_a_folder_that_is_not_there_or_no_folder_has_no_links(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    check_folder_links(tmp_path / "none")
    check_folder_links(tmp_path / "file")


def test_a_folder_that_cannot_be_read_is_a_sentence(tmp_path: Path) -> None:
    """In a user namespace without root's rights, as root may read everything."""
    script = (
        "import sys, os\nfrom pathlib import Path\n"
        "from mcspectra.studies.links import check_folder_links\n"
        "if os.getuid() == 0: os.setuid(65534)\n"
        "try: check_folder_links(Path(sys.argv[1]))\nexcept Exception as error: print(error)\n"
    )
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o000)
    command = [sys.executable, "-c", script, str(closed)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "cannot be read: Permission denied." in ended.stdout, ended.stderr
