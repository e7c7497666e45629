"""Exported files hold the numbers and attributes of the results, read by other libraries."""

import csv
import json
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest
import xarray as xr

from mcspectra.core.errors import MissingDependency, ParameterError, StorageError, StoreError
from mcspectra.studies import Store, decode_study, export, open_results
from mcspectra.studies.copying import copy_to_zip
from mcspectra.studies.export import export_results

STUDY = (
    'title = "t ü"\nsamplers = ["random"]\n[convergence]\ncounts = [4]\n'
    '[[estimators]]\nname = "a"\nintegrand = "linear"\ndims = 1\n'
)
VARIANCE = np.array([[0.1, 1 / 3, np.nan], [np.inf, -0.0, 1e-300]])
PATHS = ("a/random/convergence", "b/random/terms")


def convergence() -> xr.Dataset:
    return xr.Dataset(
        {
            "variance": (("n", "channel"), VARIANCE, {"units": "f²", "long_name": "variance"}),
            "variance_ci": (("n", "bound"), np.arange(4.0).reshape(2, 2)),
            "rate": ((), -1.5),
        },
        coords={"n": [4, 2**31 + 5]},
        attrs={
            "estimator_name": 'the, "a"',
            "sampler_spec": "random",
            "analysis": "convergence",
            "labels_channel": ["red", "green", "blue"],
            "seed": 3,
        },
    )


def terms() -> xr.Dataset:
    return xr.Dataset(
        {"coefficient": (("m",), np.array([1 + 2j, -0.5j])), "found": (("m",), [True, False])},
        coords={"m": [-1, 1]},
        attrs={"estimator_name": "b", "sampler_spec": "random", "analysis": "terms"},
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("study")
    store = Store.create(out, decode_study(STUDY), paths=PATHS)
    store.write(PATHS[0], convergence())
    store.write(PATHS[1], terms())
    store.finish()
    return out


@pytest.fixture
def memory() -> Iterator[str]:
    """A URL of memory, empty again afterwards."""
    yield "memory://export-test"
    files = fsspec.filesystem("memory")
    if files.exists("memory://export-test"):
        files.rm("memory://export-test", recursive=True)


def check_table(table: pd.DataFrame) -> None:
    """The long table against the datasets, a row at a time."""
    of = table[table["variable"] == "variance"]
    assert len(of) == 6
    for (i, j), expected in np.ndenumerate(VARIANCE):
        row = of[(of["n"] == [4, 2**31 + 5][i]) & (of["channel"] == ["red", "green", "blue"][j])]
        assert len(row) == 1
        assert np.float64(row["value"].iloc[0]).tobytes() == expected.tobytes()
        assert list(row[["estimator", "sampler", "analysis", "units"]].iloc[0]) == [
            'the, "a"',
            "random",
            "convergence",
            "f²",
        ]
    low = table[(table["variable"] == "variance_ci") & (table["bound"] == "low")]
    assert low["value"].tolist() == [0.0, 2.0]
    rate = table[table["variable"] == "rate"]
    assert rate["value"].tolist() == [-1.5]
    assert rate[["n", "bound", "channel", "m"]].isna().all(axis=None)
    waves = table[table["variable"] == "coefficient"]
    assert waves["m"].tolist() == [-1, 1]
    assert waves["value"].tolist() == [1.0, 0.0]
    assert waves["imaginary"].tolist() == [2.0, -0.5]
    assert table[table["variable"] == "found"]["value"].tolist() == [1, 0]
    assert len(table) == 6 + 4 + 1 + 2 + 2


def check_attributes(attributes: dict[str, Any]) -> None:
    assert attributes["study"]["study"]["title"] == "t ü"
    assert attributes["cells"][PATHS[0]]["seed"] == 3
    assert attributes["cells"][PATHS[0]]["labels_channel"] == ["red", "green", "blue"]


def test_csv(folder: Path, tmp_path: Path) -> None:
    file = export_results(folder, tmp_path / "out.csv")
    first = file.read_text(encoding="utf-8").partition("\n")[0]
    check_attributes(json.loads(first.removeprefix("# ")))
    table = pd.read_csv(file, skiprows=1, converters={"value": float})
    check_table(table)
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.reader(stream))[1:]
    values = {row[rows[0].index("value")] for row in rows[1:]}
    assert {"0.1", "0.3333333333333333", "nan", "inf", "-0.0", "1e-300"} <= values


def test_parquet(folder: Path, tmp_path: Path) -> None:
    file = export_results(str(folder), str(tmp_path / "out.parquet"))
    table = pyarrow.parquet.read_table(file)
    check_attributes(json.loads(table.schema.metadata[b"mcspectra"]))
    check_table(table.to_pandas())


def test_json(folder: Path, tmp_path: Path) -> None:
    def refuse(text: str) -> None:
        raise AssertionError(text)

    file = export_results(folder, tmp_path / "out.json")
    found = json.loads(file.read_text(encoding="utf-8"), parse_constant=refuse)
    assert found["attributes"]["study"]["title"] == "t ü"
    cells = {each["path"]: each for each in found["cells"]}
    assert sorted(cells) == sorted(PATHS)
    variance = cells[PATHS[0]]["variables"]["variance"]
    assert variance["dims"] == ["n", "channel"]
    assert variance["attributes"]["units"] == "f²"
    assert np.array(variance["values"], dtype=float).tobytes() == VARIANCE.tobytes()
    assert cells[PATHS[0]]["attributes"]["seed"] == 3
    assert cells[PATHS[1]]["variables"]["coefficient"]["values"] == [[1.0, 2.0], [0.0, -0.5]]
    assert cells[PATHS[1]]["variables"]["found"]["values"] == [True, False]


def test_netcdf(folder: Path, tmp_path: Path) -> None:
    file = export_results(folder, tmp_path / "out.nc")
    with xr.open_dataset(file, engine="scipy") as found:
        name = "a.random.convergence"
        variance = found[f"{name}.variance"]
        assert variance.values.tobytes() == VARIANCE.tobytes()
        assert variance.dims == (f"{name}.n", f"{name}.channel")
        assert variance.attrs["units"] == "f²"
        assert found[f"{name}.n"].values.tolist() == [4, 2**31 + 5]
        assert found["b.random.terms.coefficient.real"].values.tolist() == [1.0, 0.0]
        assert found["b.random.terms.coefficient.imag"].values.tolist() == [2.0, -0.5]
        assert found["b.random.terms.found"].values.tolist() == [1, 0]
        assert found.attrs["format"] == 2
        assert json.loads(found.attrs["study"])["title"] == "t ü"
        assert json.loads(found.attrs[name])["labels_channel"] == ["red", "green", "blue"]


def test_netcdf_refuses_whole_numbers_that_it_would_round(tmp_path: Path) -> None:
    store = Store.create(tmp_path, decode_study(STUDY))
    store.write("a/b/terms", xr.Dataset({"x": ("n", np.array([2**53 + 1]))}))
    with pytest.raises(StoreError, match="no whole numbers beyond"):
        export_results(tmp_path, tmp_path / "out.nc")
    assert not (tmp_path / "out.nc").exists()


def test_zip_is_the_store_and_the_same_bytes_each_time(folder: Path, tmp_path: Path) -> None:
    one = export_results(folder, tmp_path / "one.zarr.zip")
    two = export_results(folder, tmp_path / "two.zarr.zip")
    assert one.read_bytes() == two.read_bytes()
    tree, again = open_results(folder), open_results(one)
    for path in PATHS:
        xr.testing.assert_identical(tree[path].to_dataset(), again[path].to_dataset())
    with zipfile.ZipFile(one) as archive:
        assert archive.testzip() is None
    table = export_results(one, tmp_path / "from-zip.csv")
    assert table.read_bytes() == export_results(folder, tmp_path / "out.csv").read_bytes()


def test_a_part_can_be_exported(folder: Path, tmp_path: Path) -> None:
    found = json.loads(export_results(folder, tmp_path / "b.json", "b/*").read_text("utf-8"))
    assert [each["path"] for each in found["cells"]] == [PATHS[1]]
    with pytest.raises(ParameterError, match="holds all cells"):
        export_results(folder, tmp_path / "b.zarr.zip", "b/*")
    with pytest.raises(StoreError, match="matches"):
        export_results(folder, tmp_path / "b.csv", "c/*")


@pytest.mark.parametrize("name", ["out.txt", "out", "csv", "out.zip"])
def test_other_ends_are_refused(folder: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(ParameterError, match="has none of the ends"):
        export_results(folder, tmp_path / name)


def test_what_cannot_be_written_is_a_sentence_and_leaves_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(StorageError, match="cannot be written: No such file"):
        export_results(folder, tmp_path / "none" / "out.csv")
    with pytest.raises(StoreError, match="no results"):
        export_results(tmp_path, tmp_path / "out.csv")
    old = tmp_path / "out.json"
    old.write_text("old")

    def failing(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setitem(export._WRITERS, ".json", failing)
    with pytest.raises(StorageError, match="No space left"):
        export_results(folder, old)
    assert old.read_text() == "old"
    monkeypatch.setattr(export.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(MissingDependency, match="needs pyarrow"):
        export_results(folder, tmp_path / "out.parquet")
    assert [path.name for path in tmp_path.iterdir()] == ["out.json"]


def test_links_are_not_followed_into_a_zip(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "out", decode_study(STUDY))
    store.write(PATHS[1], terms())
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "out" / "results.zarr" / "link").symlink_to(tmp_path / "secret")
    with pytest.raises(StoreError, match="is a link"):
        export_results(tmp_path / "out", tmp_path / "x.zarr.zip")
    assert not (tmp_path / "x.zarr.zip").exists()


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    """The study's folder, to be damaged."""
    return Path(shutil.copytree(folder, tmp_path / "out"))


def same_results(found: str | Path, expected: str | Path) -> None:
    one, two = open_results(found), open_results(expected)
    assert one.attrs == two.attrs
    for path in PATHS:
        xr.testing.assert_identical(one[path].to_dataset(), two[path].to_dataset())


def test_a_store_goes_to_a_folder_and_to_a_url_and_back(
    folder: Path, tmp_path: Path, memory: str
) -> None:
    local = export_results(folder, tmp_path / "copy.zarr")
    assert local == tmp_path / "copy.zarr"
    same_results(local, folder)
    url = f"{memory}/deep/copy.zarr"
    assert export_results(folder, url) == url
    same_results(url, folder)
    for source in (url, f"{memory}/deep/copy.zarr/", local):
        back = export_results(source, tmp_path / "back.zarr.zip")
        same_results(back, folder)
        again = export_results(back, f"{memory}/from-zip.zarr")
        same_results(again, folder)
        fsspec.filesystem("memory").rm(f"{memory}/from-zip.zarr", recursive=True)
    table = export_results(url, tmp_path / "x.csv")
    assert Path(table).read_bytes() == export_results(folder, tmp_path / "y.csv").read_bytes()


def test_a_store_that_is_there_is_not_written_over(
    folder: Path, tmp_path: Path, memory: str
) -> None:
    (tmp_path / "x.zarr").mkdir()
    with pytest.raises(StorageError, match="exists already"):
        export_results(folder, tmp_path / "x.zarr")
    export_results(folder, f"{memory}/x.zarr")
    with pytest.raises(StoreError, match="something at .* already"):
        export_results(folder, f"{memory}/x.zarr")
    same_results(f"{memory}/x.zarr", folder)


def test_urls_take_stores_only(folder: Path, tmp_path: Path) -> None:
    for name in ("memory://x.csv", "s3://bucket/x.zarr.zip"):
        with pytest.raises(ParameterError, match="is a URL, where only a store can be written"):
            export_results(folder, name)
    with pytest.raises(StoreError, match="cannot be opened"):
        export_results(folder, "strange://x.zarr")
    with pytest.raises(ParameterError, match="A .zarr holds all cells"):
        export_results(folder, tmp_path / "b.zarr", "b/*")


def test_a_url_that_fails_has_no_half_of_a_store(
    folder: Path, memory: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = fsspec.filesystem("memory")
    opened, written = type(files).open, []

    def failing(self: Any, path: str, mode: str = "rb", **given: Any) -> Any:
        written.append(path)
        if len(written) > 3:
            raise RuntimeError("no space\nleft.")
        return opened(self, path, mode, **given)

    monkeypatch.setattr(type(files), "open", failing)
    with pytest.raises(StorageError, match=r"x.zarr' cannot be written: no space left\.$"):
        export_results(folder, f"{memory}/x.zarr")
    monkeypatch.undo()
    assert not files.exists(f"{memory}/x.zarr")


def test_the_roots_metadata_come_last(tmp_path: Path) -> None:
    """What is cut off before them is no store, whatever cells are called."""
    Store.create(tmp_path / "out", decode_study(STUDY)).write("zz/random/terms", terms())
    one = export_results(tmp_path / "out", tmp_path / "one.zarr.zip")
    two = tmp_path / "two.zarr.zip"
    copy_to_zip(one, two)
    for file in (one, two):
        with zipfile.ZipFile(file) as archive:
            names = archive.namelist()
        assert names[-1] == "zarr.json"
        assert names[:-1] == sorted(names[:-1])


@pytest.mark.parametrize("end", [".csv", ".json", ".nc", ".parquet", ".zarr.zip", ".zarr"])
def test_what_has_changed_since_it_was_written_is_not_exported(copy: Path, end: str) -> None:
    cell = copy / "results.zarr" / PATHS[0]
    target = copy.parent / f"x{end}"
    chunk = cell / "variance" / "c.0.0"
    content = chunk.read_bytes()
    chunk.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    words = f"{PATHS[0]} is damaged: variance/c.0.0 has changed; .* --resume"
    with pytest.raises(StoreError, match=words):
        export_results(copy, target)
    chunk.write_bytes(content)
    document = cell / "variance" / "zarr.json"
    document.write_text(document.read_text().replace('"units": "f', '"units": "g'))
    with pytest.raises(StoreError, match="damaged: variance/zarr.json has changed"):
        export_results(copy / "results.zarr", target)
    assert not target.exists()
    if end not in (".zarr.zip", ".zarr"):
        assert Path(export_results(copy, target, "b/*")).stat().st_size > 0


def test_a_damaged_chunk_of_a_zip_is_a_sentence_that_names_its_cell(copy: Path) -> None:
    chunk = copy / "results.zarr" / PATHS[0] / "variance" / "c.0.0"
    chunk.write_bytes(chunk.read_bytes()[:-6])
    source = copy.parent / "x.zarr.zip"
    copy_to_zip(copy, source)
    for end in (".csv", ".json", ".nc", ".parquet"):
        with pytest.raises(StoreError, match=f"The cell {PATHS[0]} is damaged"):
            export_results(source, copy.parent / f"x{end}")


@pytest.mark.parametrize("name", ["../evil", "/evil", "a//b", "c:/evil", "a\\..\\evil"])
def test_names_that_lead_out_of_a_zip_are_not_followed(
    folder: Path, tmp_path: Path, name: str
) -> None:
    source = tmp_path / "deep" / "x.zarr.zip"
    source.parent.mkdir()
    copy_to_zip(folder, source)
    with zipfile.ZipFile(source, "a") as archive:
        archive.writestr(name, "evil")
    with pytest.raises(StoreError, match="no path in a store"):
        export_results(source, tmp_path / "deep" / "x.zarr")
    assert not (tmp_path / "evil").exists()
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["x.zarr.zip"]
