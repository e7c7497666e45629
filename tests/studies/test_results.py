"""Results are opened, counted and exported as in the ledger, or refused with a sentence."""

import csv
import json
import os
import random
import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd
import pytest
import xarray as xr
import zarr
from tests.studies.made import admit, text_of

from mcspectra.core.display import csv_cell
from mcspectra.core.errors import ParameterError, StorageError, StoreError
from mcspectra.core.records import pack
from mcspectra.core.results import dataset, package_versions
from mcspectra.studies import results
from mcspectra.studies.ledger import FORMAT, LEDGER_NAME, Ledger, StudyNote, scalars_of
from mcspectra.studies.results import (
    export_results,
    open_results,
    output_folder,
    result_paths,
    result_scalars,
    study_status,
    write_zarr,
)

PATHS = ("a/random/convergence", "b/random/terms", "b/jittered/terms")
NOTE = StudyNote(
    title="t ü",
    seed=5,
    config=text_of(PATHS, "t ü"),
    study_hash="ab" * 32,
    versions=package_versions(),
    inputs={},
)
VARIANCE = np.array([[0.1, 1 / 3, np.nan], [np.inf, -0.0, 1e-300]])


def convergence():
    return xr.Dataset(
        {
            "variance": (("n", "channel"), VARIANCE, {"units": "f²", "long_name": "variance"}),
            "spread": (("n",), np.array([0.5, 1.5])),
            "spread_ci": (("n", "bound"), np.arange(4.0).reshape(2, 2)),
            "spread_se": (("n",), np.array([0.25, 0.75])),
            "rate": ((), -1.5),
        },
        coords={
            "n": [4, 2**31 + 5],
            "bound": ["low", "high"],
            "channel": ["red", "green", "blue"],
        },
        attrs={
            "estimator_name": 'the, "a"',
            "sampler_spec": "random",
            "analysis": "convergence",
            "seed": 3,
        },
    )


def terms():
    return xr.Dataset(
        {"coefficient": (("m",), np.array([1 + 2j, -0.5j])), "found": (("m",), [True, False])},
        coords={"m": [-1, 1]},
        attrs={"estimator_name": "b", "sampler_spec": "random", "analysis": "terms"},
    )


def numbers(seed=0):
    """Return numbers of all types that results have."""
    rng = np.random.default_rng(seed)
    found = dataset({"variance": (("n",), rng.random(3))}, {"n": [4, 16, 64]}, seed=seed)
    return found.assign(
        scalar=((), np.nan),
        flags=(("n",), np.array([True, False, True]), {"units": "1", "of": [1, 2]}),
        waves=(("m",), np.array([1 + 2j, np.nan, np.inf])),
        counts=(("m",), np.array([0, -(2**40), 3])),
        single=(("n",), np.float32([0.1, 0.0, -0.0])),
        half=(("n",), np.float16([0.1, 0.0, -0.0])),
        none=(("a", "b"), np.zeros((0, 3))),
        zeros=(("b",), np.zeros(3)),
        days=(("b",), np.arange(3.0), {"units": "days"}),
    ).assign_coords(alone=("n", [0.5, np.nan, 1.5]))


_TYPES = "float16 float32 float64 int8 int16 int32 int64 uint8 uint16 uint32 uint64 bool complex64"
DECLARED = (
    *[
        "coefficient",
        "found",
        "scalar",
        "flags",
        "waves",
        "counts",
        "single",
        "half",
        "none",
        "zeros",
        "days",
        "x",
        "variance",
    ],
    *["spread", "spread_ci", "spread_se", "share_ci", "known", "curve", "of_complex128"],
    *(f"of_{kind}" for kind in _TYPES.split()),
)
"""Variables of the datasets of these tests, which no analysis gives."""


@pytest.fixture(autouse=True, scope="module")
def declared():
    with pytest.MonkeyPatch.context() as patch:
        admit(patch, *DECLARED)
        yield


def written(folder, cells, paths=()):
    """Write a study's folder with these cells, and its store."""
    note = msgspec.structs.replace(NOTE, config=text_of(paths or cells, "t ü"))
    with Ledger.create(folder, note, paths or tuple(cells)) as ledger:
        for path, cell in cells.items():
            ledger.finish(path, pack(cell))
    write_zarr(folder)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    cells = {PATHS[0]: convergence(), PATHS[1]: terms()}
    return written(tmp_path_factory.mktemp("study"), cells, PATHS)


@pytest.fixture
def copy(folder, tmp_path):
    """A copy of the study's folder, which tests may damage."""
    return Path(shutil.copytree(folder, tmp_path / "out"))


def same_results(found, expected):
    one, two = open_results(found), open_results(expected)
    assert one.attrs == two.attrs
    assert sorted(node.path for node in one.leaves) == sorted(node.path for node in two.leaves)
    for node in one.leaves:
        identical(node.to_dataset(), two[node.path].to_dataset())


def identical(found, expected):
    xr.testing.assert_identical(found, expected)
    for name in expected.variables:
        assert found[name].dtype == expected[name].dtype
        assert found[name].values.tobytes() == expected[name].values.tobytes()


def test_numbers_are_read_bit_for_bit_from_the_ledger_and_from_the_store(tmp_path):
    cells = {f"a/s{seed}/terms": numbers(seed) for seed in range(3)}
    out = written(tmp_path, cells)
    for source in (out, out / "results.zarr"):
        tree = open_results(source)
        assert tree.attrs["format"] == FORMAT
        assert tree.attrs["bound"] == ["low", "high"]
        assert tree.attrs["study"]["title"] == "t ü"
        for path, cell in cells.items():
            identical(tree[path].to_dataset(), cell)
    assert result_paths(out) == tuple(cells)
    plain = xr.open_datatree(out / "results.zarr", mask_and_scale=False, decode_times=False)
    for path, cell in cells.items():  # Each cell has the same form
        xr.testing.assert_identical(plain[path].to_dataset().load(), cell)


@pytest.mark.parametrize("consolidated", [True, False])
def test_xarray_and_zarr_alone_read_the_store(folder, consolidated):
    store = folder / "results.zarr"
    tree = xr.open_datatree(store, engine="zarr", consolidated=consolidated)
    found = tree[PATHS[0]].to_dataset()
    assert found["variance"].values.tobytes() == VARIANCE.tobytes()
    assert found.attrs["labels_channel"] == ["red", "green", "blue"]
    assert found["variance"].attrs["units"] == "f²"
    assert xr.open_datatree(store).attrs["study_hash"] == NOTE.study_hash
    root = zarr.open_group(store, mode="r", use_consolidated=consolidated)
    assert sorted(root.group_keys()) == ["a", "b"]
    assert root[f"{PATHS[1]}/found"].shape == (2,)


def test_consolidated_metadata_equal_those_of_zarr(copy):
    document = copy / "results.zarr" / "zarr.json"
    ours = json.loads(document.read_text())["consolidated_metadata"]["metadata"]
    with warnings.catch_warnings(action="ignore"):
        zarr.consolidate_metadata(str(copy / "results.zarr"))
    theirs = json.loads(document.read_text())["consolidated_metadata"]["metadata"]
    assert sorted(ours) == sorted(theirs)
    for path, expected in theirs.items():
        for key in ("shape", "attributes", "node_type", "codecs", "dimension_names"):
            assert ours[path].get(key) == expected.get(key)


def test_files_equal_those_of_xarray_and_zarr(tmp_path):
    kinds = ("?", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8", "c8", "c16")
    cell = numbers().assign({f"of_{kind}": ("b", np.zeros(3, kind)) for kind in kinds})
    results._write_store({}, [("a/b/terms", cell)], tmp_path / "x.zarr")
    ours = files_of(tmp_path / "x.zarr")
    for variable in cell.variables.values():
        chunks = tuple(max(1, size) for size in variable.shape)
        variable.encoding = {"compressors": None, "chunks": chunks, "_FillValue": None}
    theirs: dict[str, Any] = {}
    with warnings.catch_warnings(action="ignore"):  # Zarr does not specify some types
        store = zarr.storage.MemoryStore(theirs)
        cell.to_zarr(
            store, group="a/b/terms", zarr_format=3, consolidated=False, write_empty_chunks=True
        )
    assert ours.keys() == theirs.keys()
    for name in ours.keys() - {"zarr.json"}:
        assert ours[name] == theirs[name].to_bytes(), name


def test_texts_become_labels(folder):
    cell = open_results(folder)[PATHS[0]].to_dataset()
    assert sorted(cell.coords) == ["n"]
    assert cell.attrs["labels_channel"] == ["red", "green", "blue"]
    assert "labels_bound" not in cell.attrs


def test_a_part_can_be_opened(folder):
    for source in (folder, folder / "results.zarr"):
        for select in ("b/*", PATHS[1], "b/random/terms"):
            tree = open_results(source, select)
            assert [node.path for node in tree.leaves] == [f"/{PATHS[1]}"]
        with pytest.raises(StoreError, match="No cell of .* matches 'x/"):
            open_results(source, "x/*")
    with pytest.raises(StoreError, match="has no cell 'x/y'"):
        open_results(folder, "x/y")
    with pytest.raises(StoreError, match=f"no result of {PATHS[2]}: it is not finished"):
        open_results(folder, PATHS[2])


def test_scalars_of_all_results_are_a_table(folder, tmp_path):
    with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
        for path, cell in ((PATHS[0], convergence()), (PATHS[1], numbers())):
            ledger.finish(path, pack(cell), scalars_of(cell))
    write_zarr(tmp_path)
    for source in (tmp_path, tmp_path / "results.zarr"):
        found = result_scalars(source)
        assert list(found) == list(PATHS[:2])
        assert found[PATHS[0]] == {"rate": -1.5}
        assert np.isnan(found[PATHS[1]]["scalar"])
        assert result_scalars(source, "a/*") == {PATHS[0]: {"rate": -1.5}}


def test_a_cell_by_its_path_comes_without_the_text_of_the_study(folder, copy):
    tree = open_results(folder, PATHS[0])
    assert (tree.attrs["study_hash"], "study" in tree.attrs) == (NOTE.study_hash, False)
    store = export_results(folder, copy / "x.zarr", PATHS[0])
    assert open_results(store).attrs["study"]["title"] == "t ü"


def test_results_of_a_running_study_are_read(tmp_path):
    with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
        ledger.finish(PATHS[1], pack(terms()))
        ledger.commit()
        assert result_paths(tmp_path) == (PATHS[1],)
        identical(open_results(tmp_path)[PATHS[1]].to_dataset(), terms())
        assert study_status(tmp_path).state == "running"


def test_opening_a_damaged_ledger_reports_the_damage(copy):
    content = (copy / LEDGER_NAME).read_bytes()
    at = content.index(np.float64(1 / 3).tobytes())
    (copy / LEDGER_NAME).write_bytes(content[:at] + b"!" + content[at + 1 :])
    with pytest.raises(StoreError, match=f"The cell {PATHS[0]} .* is damaged: .*--resume"):
        open_results(copy)
    identical(open_results(copy, PATHS[1])[PATHS[1]].to_dataset(), terms())
    with pytest.raises(StoreError, match="is damaged"):
        export_results(copy, copy / "x.csv")
    (copy / LEDGER_NAME).write_bytes(b"SQLite format 3\0" + bytes(5000))
    with pytest.raises(StoreError, match="study.sqlite"):
        open_results(copy)


def changed(tree, chosen):
    """Change, remove, add or exchange a file of a store; return the kind of change."""
    files = sorted(file for file in tree.rglob("*") if file.is_file())
    file, other = chosen.sample(files, 2)
    content, kind = (
        bytearray(file.read_bytes()),
        chosen.choice(["change", "cut", "gone", "new", "swap"]),
    )
    if kind == "change":
        at = chosen.randrange(len(content))
        content[at] ^= 1 << chosen.randrange(8)
        if file == tree / "zarr.json":  # Blanks, and the case of \u00fc, carry no information
            old = json.loads(file.read_bytes())
            try:
                if json.loads(bytes(content)) == old:
                    return "nothing"
            except ValueError:
                pass
        file.write_bytes(content)
    elif kind == "cut":
        file.write_bytes(content[: chosen.randrange(len(content))])
    elif kind == "gone":
        file.unlink()
    elif kind == "new":
        file.with_name("more").write_bytes(b"")
    elif content == other.read_bytes():
        return "nothing"
    else:
        file.write_bytes(other.read_bytes())
        other.write_bytes(content)
    return f"{kind} {file.relative_to(tree)}"


@pytest.mark.parametrize("number", [30, pytest.param(1000, marks=pytest.mark.endurance)])
def test_every_change_of_a_store_is_detected(folder, tmp_path, number):
    work, chosen = tmp_path / "x.zarr", random.Random(number)
    for _ in range(number):
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(folder / "results.zarr", work)
        done = changed(work, chosen)
        if done != "nothing":
            try:
                open_results(work)
            except StoreError:
                continue
            pytest.fail(done)


def test_a_flipped_number_is_detected_and_written_again(copy):
    chunk = copy / "results.zarr" / PATHS[0] / "variance" / "c" / "0" / "0"
    content = chunk.read_bytes()
    chunk.write_bytes(b"!" + content[1:])
    with pytest.raises(StoreError, match="was changed after it was written"):
        open_results(copy / "results.zarr")
    assert study_status(copy).damaged == {}
    assert list(study_status(copy, verify=True).damaged) == ["the store results.zarr"]
    write_zarr(copy)  # Writes the store again from the ledger
    assert chunk.read_bytes() == content
    assert study_status(copy, verify=True).damaged == {}


def files_of(folder):
    """Return the files of a store by name."""
    inside = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in inside}


def stranger(folder, change):
    """Return a forged store of one array with a digest, after `change` of its files."""
    cell = xr.Dataset({"x": ("n", np.arange(30.0))})
    results._write_store({"format": FORMAT}, [("a/b/terms", cell)], folder)
    files = files_of(folder)
    change(files)
    root = json.loads(files["zarr.json"])
    digests = {
        name: results.hashlib.sha256(content).hexdigest()
        for name, content in files.items()
        if name != "zarr.json"
    }
    root["attributes"]["tree_sha256"] = results._tree_digest(root, digests)
    files["zarr.json"] = json.dumps(root).encode()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder


def with_metadata(**more):
    def change(files):
        name = "a/b/terms/x/zarr.json"
        files[name] = json.dumps(json.loads(files[name]) | more).encode()

    return change


GRID = {"name": "regular", "configuration": {"chunk_shape": [10**13]}}
PLAIN = {"name": "bytes", "configuration": {"endian": "little"}}
ZSTD = {"name": "zstd", "configuration": {"level": 0, "checksum": True}}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"shape": [10**13]}, "not one uncompressed chunk of 80 TB"),
        ({"shape": [10**13], "chunk_grid": GRID}, "not one uncompressed chunk of 80 TB"),
        ({"chunk_grid": GRID}, "damaged|not one uncompressed chunk"),
        ({"codecs": [PLAIN, ZSTD]}, "not one uncompressed chunk of 240 B"),
        ({"codecs": [PLAIN, {"name": "pickle"}]}, "not one uncompressed chunk"),
        ({"codecs": 3}, "not one uncompressed chunk"),
        (
            {"codecs": [{"name": "bytes", "configuration": {"endian": "big"}}]},
            "not one uncompressed chunk",
        ),
        ({"data_type": "object"}, "damaged|not one uncompressed chunk"),
        ({"data_type": "string"}, "damaged|not one uncompressed chunk"),
        ({"shape": [-1]}, "damaged|not one uncompressed chunk"),
        ({"shape": [31]}, "not one uncompressed chunk"),
        ({"dimension_names": 3}, "is damaged"),
    ],
)
def test_unexpected_arrays_are_refused(tmp_path, changes, sentence):
    open_results(stranger(tmp_path / "sound.zarr", lambda _: None))
    with pytest.raises(StoreError, match=sentence):
        open_results(stranger(tmp_path / "x.zarr", with_metadata(**changes)))


@pytest.mark.parametrize("number", [3, "4", None, [2]])
def test_other_formats_are_refused_with_advice(copy, number):
    file = copy / "results.zarr" / "zarr.json"
    document = json.loads(file.read_text())
    document["attributes"]["format"] = number
    file.write_text(json.dumps(document))
    (copy / LEDGER_NAME).unlink()
    for look in (open_results, study_status, result_paths):
        with pytest.raises(
            StoreError, match=f"has store format .*, but this version reads {FORMAT}"
        ):
            look(copy)
    with pytest.raises(StoreError, match="only the earlier version that wrote them can continue"):
        Ledger.resume(copy, NOTE, PATHS)


def test_an_invalid_store_gives_a_sentence(tmp_path):
    (tmp_path / "bad.zarr").mkdir()
    (tmp_path / "bad.zarr" / "zarr.json").write_text("[")
    (tmp_path / "x.zip").write_bytes(b"PK")
    for source, sentence in {
        tmp_path: "no results",
        tmp_path / "none.zarr": "no results",
        tmp_path / "x.zip": "no results",
        tmp_path / "bad.zarr": "zarr.json cannot be read",
        "s3://bucket/x.zarr": "no results in 's3://bucket/x.zarr'",
    }.items():
        with pytest.raises(StoreError, match=sentence):
            open_results(source)


def test_results_larger_than_memory_are_refused(folder, monkeypatch):
    monkeypatch.setattr(results, "available_memory", lambda: 100)
    for source in (folder, folder / "results.zarr"):
        with pytest.raises(StoreError, match="more than the memory of this machine"):
            open_results(source)
    assert open_results(folder, PATHS[1]).leaves


@pytest.mark.parametrize("link", ["a", "b/random/terms", "b/random/terms/m/c/0", "zarr.json"])
def test_links_inside_a_store_are_not_read(copy, tmp_path, link):
    inside = copy / "results.zarr" / link
    inside.rename(tmp_path / "elsewhere")  # The bytes are equal: only the link can be the reason
    inside.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StoreError, match=rf"{link}' is a symbolic link"):
        open_results(copy / "results.zarr")
    (tmp_path / "some.zarr").symlink_to(copy / "results.zarr")  # The user names this link
    with pytest.raises(StoreError, match=rf"{link}' is a symbolic link"):
        open_results(tmp_path / "some.zarr")


def test_a_study_of_many_cells_has_no_store_at_its_end(folder, copy, monkeypatch):
    monkeypatch.setattr(results, "MOST_STORED", 1)
    assert write_zarr(copy) is None
    assert not (copy / "results.zarr").exists()
    same_results(export_results(copy, copy / "x.zarr"), folder)


def test_a_store_that_cannot_be_written_leaves_the_earlier_one(copy, monkeypatch):
    def failing(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", failing)
    with pytest.raises(StorageError, match="results.zarr' cannot be written: No space left"):
        write_zarr(copy)
    assert open_results(copy / "results.zarr").leaves


def test_csv_is_a_table_of_all_scalars(folder, tmp_path):
    file = export_results(str(folder), str(tmp_path / "out.csv"))
    table = pd.read_csv(file, converters={"value": float})
    assert list(table.columns) == [
        "estimator", "sampler", "analysis", "n", "channel",
        "variable", "value", "low", "high", "se", "unit",
    ]  # fmt: skip
    assert set(table["variable"]) == {"variance", "spread", "rate"}
    assert set(map(tuple, table[["estimator", "sampler", "analysis"]].values)) == {
        ('the, "a"', "random", "convergence")
    }
    of = table[table["variable"] == "variance"]
    assert len(of) == 6
    for (i, j), expected in np.ndenumerate(VARIANCE):
        row = of[(of["n"] == [4, 2**31 + 5][i]) & (of["channel"] == ["red", "green", "blue"][j])]
        assert np.float64(row["value"].item()).tobytes() == expected.tobytes()
        assert row["unit"].item() == "f²"
    spread = table[table["variable"] == "spread"]
    assert spread[["n", "value", "low", "high", "se"]].values.tolist() == [
        [4, 0.5, 0.0, 1.0, 0.25],
        [2**31 + 5, 1.5, 2.0, 3.0, 0.75],
    ]
    rate = table[table["variable"] == "rate"]
    assert rate["value"].item() == -1.5
    assert rate[["n", "channel", "low", "high", "se", "unit"]].isna().all(axis=None)
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert {"0.1", "0.3333333333333333", "nan", "inf", "-0.0", "1e-300"} <= {
        row["value"] for row in rows
    }


def test_scalars_without_a_count_of_their_own_have_that_of_the_analysis(tmp_path):
    cell = xr.Dataset(
        {"share_ci": ("bound", [0.1, 0.9]), "known": ((), True), "curve": ("m", [1.0, 2.0])},
        coords={"m": [0, 1]},
        attrs={"n": 64, "analysis": "terms"},
    )
    written(tmp_path / "out", {"a/b/terms": cell})
    file = export_results(tmp_path / "out", tmp_path / "x.csv")
    assert file.read_text("utf-8").splitlines() == [
        "estimator,sampler,analysis,n,variable,value,low,high,se,unit",
        ",,terms,64,share,,0.1,0.9,,",
        ",,terms,64,known,1,,,,",
    ]


@pytest.mark.parametrize("first", ["=", "+", "-", "@", "\t"])
def test_texts_that_a_spreadsheet_would_run_are_quoted(tmp_path, first):
    text = f"{first}cmd|' /C calc'!A0\r\n, 'b'"
    cell = convergence().assign_attrs(estimator_name=text, sampler_spec=text)
    cell = cell.assign_coords(channel=[text, "b", "c"])
    written(tmp_path / "out", {"a/b/convergence": cell})
    file = export_results(tmp_path / "out", tmp_path / "x.csv")
    shown = csv_cell(text)
    assert shown.startswith("'")
    assert "\r" not in shown
    with file.open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            assert (row["estimator"], row["sampler"]) == (shown, shown)
            assert row["channel"] in (shown, "b", "c", "")
            assert row["value"] != "'-1.5"  # Numbers stay numbers


def test_results_without_scalars_make_no_table(folder, tmp_path):
    with pytest.raises(StoreError, match="have no scalars for a table; export to a .zarr store"):
        export_results(folder, tmp_path / "x.csv", PATHS[1])
    assert not (tmp_path / "x.csv").exists()


def test_a_table_is_the_same_from_the_ledger_and_from_a_store(folder, tmp_path):
    one = export_results(folder, tmp_path / "one.csv")
    two = export_results(folder / "results.zarr", tmp_path / "two.csv")
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize("select", ["", 5, b"a/*", ["a/*"]])
@pytest.mark.parametrize("inside", ["", "results.zarr"])
def test_a_selection_without_cells_is_refused(folder, tmp_path, inside, select):
    for call in (
        lambda: open_results(folder / inside, select),
        lambda: result_scalars(folder / inside, select),
        lambda: export_results(folder / inside, tmp_path / "out.csv", select),
    ):
        with pytest.raises(ParameterError, match="^select is .*; give the path of a cell"):
            call()


def test_a_part_can_be_exported(folder, tmp_path):
    part = export_results(folder, tmp_path / "b.zarr", "b/*")
    assert result_paths(part) == (PATHS[1],)
    with pytest.raises(StoreError, match="matches"):
        export_results(folder, tmp_path / "b.csv", "c/*")


@pytest.mark.parametrize(
    "name",
    ["out.txt", "out", "csv", "x.zarr.zip", "x.parquet", "x.nc", "x.json", "s3://bucket/x.nc"],
)
def test_other_extensions_are_refused(folder, tmp_path, name):
    with pytest.raises(ParameterError, match=r"has none of the extensions \.csv and \.zarr"):
        export_results(folder, name if "://" in name else tmp_path / name)


def test_a_write_error_gives_a_sentence_and_leaves_nothing(folder, tmp_path, monkeypatch):
    with pytest.raises(ParameterError, match="cannot be written: its folder does not exist"):
        export_results(folder, tmp_path / "none" / "out.csv")
    with pytest.raises(ParameterError, match="cannot be written: its folder does not exist"):
        export_results(folder, "s3://bucket/x.zarr")
    with pytest.raises(StoreError, match="no results"):
        export_results(tmp_path, tmp_path / "out.csv")
    old = tmp_path / "out.csv"
    old.write_text("old")

    def failing(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(results, "_write_csv", failing)
    with pytest.raises(StorageError, match="No space left"):
        export_results(folder, old)
    assert old.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out.csv"]


def test_a_store_goes_to_a_folder_and_back(folder, tmp_path):
    one = export_results(folder, tmp_path / "one.zarr")
    assert one == tmp_path / "one.zarr"
    same_results(one, folder)
    two = export_results(one, tmp_path / "two.zarr")
    assert files_of(one) == files_of(two)


def test_a_store_is_the_same_bytes_each_time(folder, tmp_path):
    """The bytes are also the same in a process with another hash seed."""
    write = (
        "import sys, pytest; from tests.studies.made import admit; "
        f"admit(pytest.MonkeyPatch(), *{DECLARED!r}); "
        "from mcspectra.studies import export_results as e; e(*sys.argv[1:])"
    )
    seed = "1" if os.environ.get("PYTHONHASHSEED") != "1" else "2"
    command = [sys.executable, "-c", write, str(folder), str(tmp_path / "x.zarr")]
    subprocess.run(command, check=True, env={**os.environ, "PYTHONHASHSEED": seed})
    assert files_of(tmp_path / "x.zarr") == files_of(folder / "results.zarr")


def test_an_existing_store_is_not_overwritten(folder, tmp_path):
    (tmp_path / "x.zarr").mkdir()
    with pytest.raises(ParameterError, match="already exists"):
        export_results(folder, tmp_path / "x.zarr")


def test_very_many_arrays_have_no_consolidated_metadata(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(results, "_MOST_DOCUMENTS", 1)
    store = export_results(folder, tmp_path / "x.zarr")
    assert "consolidated_metadata" not in json.loads((store / "zarr.json").read_text())
    same_results(store, folder)


@pytest.mark.parametrize("path", ["../evil/terms", "a/../../evil", "c:/evil", "a\\..\\evil/x"])
def test_names_that_lead_out_of_a_store_are_not_followed(tmp_path, path):
    with Ledger.create(tmp_path / "out", NOTE, (path,)) as ledger:
        ledger.finish(path, pack(terms()))
    for look in (write_zarr, open_results, lambda out: open_results(out, path)):
        with pytest.raises(
            StoreError, match="list of cells: it was changed|was not written by a run"
        ):
            look(tmp_path / "out")
    assert sorted(file.name for file in tmp_path.rglob("*")) == ["out", "study.lock", LEDGER_NAME]


def test_a_link_in_the_place_of_the_store_is_not_followed(copy, tmp_path):
    secret = tmp_path / "secret"
    secret.mkdir()
    (secret / "zarr.json").write_text("mine")
    shutil.rmtree(copy / "results.zarr")
    for name in ("results.zarr", ".results.zarr.partial"):
        (copy / name).symlink_to(secret)
    write_zarr(copy)
    assert (secret / "zarr.json").read_text() == "mine"
    assert not (copy / "results.zarr").is_symlink()
    assert open_results(copy / "results.zarr").leaves


def test_the_status_lists_done_failed_and_missing_cells(tmp_path):
    with Ledger.create(tmp_path, NOTE, PATHS) as ledger:
        ledger.finish(PATHS[0], pack(convergence()))
        ledger.fail(PATHS[1], "It gave NaN.")
        ledger.record(PATHS[2], "0-0-10", (0, 1), b"half")
    status = study_status(tmp_path)
    assert (status.title, status.seed, status.format) == ("t ü", 5, FORMAT)
    assert (status.state, status.holder, status.finished) == ("unfinished", None, None)
    assert (status.done, status.missing) == (PATHS[:1], PATHS[2:])
    assert status.failed == {PATHS[1]: "It gave NaN."}
    assert (status.recorded, status.damaged, status.verified) == (1, {}, False)
    assert status.results_bytes == len(pack(convergence()))
    assert status.ledger_bytes == (tmp_path / LEDGER_NAME).stat().st_size
    assert status.versions["mcspectra"]
    assert status.analyses["terms"] == results.AnalysisCount(failed=1, missing=1)
    with Ledger.resume(tmp_path, NOTE, PATHS) as ledger:
        running = study_status(tmp_path)
        assert running.state == "running"
        assert running.holder is not None
        assert running.holder.pid == os.getpid()
        for path in PATHS[1:]:
            ledger.forget([path])
            ledger.finish(path, pack(terms()))
    status = study_status(tmp_path, verify=True)
    assert (status.state, status.missing, status.failed) == ("finished", (), {})
    assert status.finished is not None


def test_damage_is_counted_by_verification(copy):
    content = (copy / LEDGER_NAME).read_bytes()
    at = content.index(np.float64(1 / 3).tobytes())
    (copy / LEDGER_NAME).write_bytes(content[:at] + b"!" + content[at + 1 :])
    assert study_status(copy).damaged == {}
    status = study_status(copy, verify=True)
    assert status.damaged == {PATHS[0]: "its digest does not match"}
    assert (status.done, status.missing) == (PATHS[1:2], PATHS[2:])
    assert status.analyses["convergence"] == results.AnalysisCount(damaged=1)


def test_only_a_studys_folder_has_a_status(folder, tmp_path):
    file = export_results(folder, tmp_path / "x.csv")
    store = export_results(folder, tmp_path / "x.zarr")
    for place in (file, store):
        with pytest.raises(StoreError, match="folder of a run|only a study's folder has a status"):
            study_status(place)
    with pytest.raises(StoreError, match="There are no results in"):
        study_status(tmp_path)


@pytest.mark.parametrize(
    ("out", "sentence"),
    [
        ("s3://bucket/x.zarr", "is a URL; a study runs in a folder of this machine"),
        ("x.zarr", "export DIR -o x.zarr"),
        ("x.CSV", "export DIR -o x.CSV"),
        (__file__, r"is a file; give another --out\."),
    ],
)
def test_studies_run_in_folders(out, sentence):
    with pytest.raises(ParameterError, match=sentence):
        output_folder(out)
    assert output_folder("out/some.thing") == Path("out/some.thing")


_MILLION = """
import re, sys, time
from pathlib import Path
import pytest
from mcspectra.studies import open_results, study_status
from tests.studies.made import admit
admit(pytest.MonkeyPatch(), *sys.argv[2:])
open_results(sys.argv[1], "e0/s0/terms")
begun = time.process_time()
open_results(sys.argv[1], "e777/s777/terms")
opened, begun = time.process_time() - begun, time.process_time()
status = study_status(sys.argv[1])
listed = time.process_time() - begun
# The peak of this program: that of `getrusage` is at least that of the process which started it
peak = re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1]
print(len(status.done), opened, listed, peak)
"""


@pytest.mark.endurance
def test_a_million_cells_are_listed_and_opened_by_one(tmp_path):
    paths = [f"e{i // 1000}/s{i % 1000}/terms" for i in range(10**6)]
    content = pack(terms())
    with Ledger.create(tmp_path, NOTE, paths) as ledger:
        for path in paths:
            ledger.finish(path, content)
    # Use a new process, because the peak of this one includes other tests
    command = [sys.executable, "-c", _MILLION, str(tmp_path), *DECLARED]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    done, opened, listed, peak = map(float, printed.split())
    print(f"opened {opened:.4f} s, status {listed:.2f} s, {peak / 1e6:.2f} GB")
    assert done == 10**6
    assert opened < 0.06
    assert listed < 6.0  # It took 2.8 s while other tests ran
    assert peak < 1e6
