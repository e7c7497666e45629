"""Metadata that the root repeats are those of the files, or the store is refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

from mcspectra.core.errors import StoreError
from mcspectra.studies import Store, decode_study, export_results, open_results
from mcspectra.studies.status import study_status

STUDY = (
    'title = "t"\nsamplers = ["random"]\n[convergence]\ncounts = [4]\n'
    '[[estimators]]\nname = "a"\nintegrand = "linear"\ndims = 1\n'
)
PATHS = ("a/random/convergence", "a/random/terms")
ARRAY = f"{PATHS[0]}/x"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    store = Store.create(tmp_path / "out", decode_study(STUDY), paths=PATHS)
    for path in PATHS:
        store.write(path, xr.Dataset({"x": ("n", [1.0, 2.0], {"units": "1"})}))
    store.finish()
    return tmp_path / "out"


def change(file: Path, edit: Callable[[dict[str, Any]], Any]) -> None:
    document = json.loads(file.read_text())
    edit(document)
    file.write_text(json.dumps(document))


def metadata(root: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = root["consolidated_metadata"]["metadata"]
    return found


@pytest.mark.parametrize(
    "changes",
    [
        {"codecs": [{"name": "numcodecs.pickle", "configuration": {}}]},
        {"data_type": "object"},
        {"shape": [-3]},
        {"attributes": {"units": "m"}},
    ],
)
@pytest.mark.parametrize("of_root", [False, True])
def test_metadata_that_disagree_are_named(
    folder: Path, changes: dict[str, Any], of_root: bool
) -> None:
    root = folder / "results.zarr" / "zarr.json"
    if of_root:
        change(root, lambda document: metadata(document)[ARRAY].update(changes))
    else:
        change(folder / "results.zarr" / ARRAY / "zarr.json", lambda d: d.update(changes))
    for select in (None, "*/convergence"):
        with pytest.raises(StoreError, match=f"damaged .*{ARRAY}|is damaged: "):
            open_results(folder, select)
    if not of_root:
        assert open_results(folder, "*/terms")[PATHS[1]]["x"].values.tolist() == [1.0, 2.0]
    found = study_status(folder, verify=True).damaged
    assert "metadata of the root" in found
    assert (PATHS[0] in found) != of_root
    for end in (".csv", ".zarr.zip"):
        with pytest.raises(StoreError, match="is damaged"):
            export_results(folder, folder.parent / f"x{end}")


def test_a_resumed_store_is_sound_again(folder: Path) -> None:
    root = folder / "results.zarr" / "zarr.json"
    change(root, lambda document: metadata(document)[ARRAY].update(shape=[1]))
    store = Store.create(folder, decode_study(STUDY), resume=True, paths=PATHS)
    assert all(map(store.done, PATHS))
    store.finish()
    assert open_results(folder)[PATHS[0]]["x"].values.tolist() == [1.0, 2.0]
    assert study_status(folder, verify=True).damaged == {}


@pytest.mark.parametrize(
    "name", ["../../../etc/passwd", "/etc/passwd", "a//b", "a/./b", "c:\\x", ""]
)
def test_names_that_lead_out_of_the_store_are_damage(folder: Path, name: str) -> None:
    root = folder / "results.zarr" / "zarr.json"
    change(root, lambda d: metadata(d).update({name: metadata(d)[ARRAY]}))
    for select in (None, "*/terms"):
        with pytest.raises(StoreError, match="is damaged"):
            open_results(folder, select)


@pytest.mark.parametrize("value", [[], {"metadata": 3}, {}, "x", 1])
def test_consolidated_metadata_that_are_none(folder: Path, value: Any) -> None:
    root = folder / "results.zarr" / "zarr.json"
    change(root, lambda document: document.update(consolidated_metadata=value))
    with pytest.raises(StoreError, match="is damaged"):
        open_results(folder)


def test_a_file_that_is_gone_is_damage(folder: Path) -> None:
    (folder / "results.zarr" / ARRAY / "zarr.json").unlink()
    with pytest.raises(StoreError, match=f"the metadata of {ARRAY} are others"):
        open_results(folder)
