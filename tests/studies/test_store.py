"""The store: cells are whole or absent, damage is named, strangers' stores are only data."""

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr

from mcspectra.core.errors import StorageError, StoreError
from mcspectra.core.results import dataset
from mcspectra.studies import Store, decode_study, open_results, places, result_paths
from mcspectra.studies._zarr_cell import write_cell
from mcspectra.studies.checksums import checksum, damage_of
from mcspectra.studies.copying import copy_to_zip
from mcspectra.studies.lock import FolderLock
from mcspectra.studies.manifest import MANIFEST_NAME, CellLine, append_line, now, read_manifest

STUDY = (
    'title = "t"\nsamplers = ["random"]\n[convergence]\ncounts = [4]\n'
    '[[estimators]]\nname = "a"\nintegrand = "linear"\ndims = 1\n'
)
CONFIG = decode_study(STUDY)
PATHS = ("a/random/convergence", "a/random/terms", "b/jittered-shift/convergence")


def cell(seed: int = 0) -> xr.Dataset:
    """Numbers of all kinds that results have."""
    rng = np.random.default_rng(seed)
    found = dataset(
        {"variance": (("n",), rng.random(3)), "variance_ci": (("n", "bound"), rng.random((3, 2)))},
        {"n": [4, 16, 64], "bound": ["low", "high"]},
        sampler="random",
        seed=seed,
    )
    return found.assign(
        scalar=((), np.nan),
        flags=(("n",), np.array([True, False, True]), {"units": "1", "of": [1, 2]}),
        waves=(("m",), np.array([1 + 2j, np.nan, np.inf])),
        counts=(("m",), np.array([0, -(2**40), 3])),
        single=(("n",), np.float32([0.1, 0.0, -0.0])),
    ).assign_coords(half=("n", [0.5, np.nan, 1.5]))


@pytest.fixture
def filled(tmp_path: Path) -> Path:
    store = Store.create(tmp_path, CONFIG, paths=PATHS)
    for seed, path in enumerate(PATHS):
        store.write(path, cell(seed))
    store.finish()
    return tmp_path


def identical(found: xr.Dataset, expected: xr.Dataset) -> None:
    expected = expected.drop_vars("bound")
    xr.testing.assert_identical(found.drop_vars("bound", errors="ignore"), expected)
    for name in expected.variables:
        assert found[name].dtype == expected[name].dtype
        assert found[name].values.tobytes() == expected[name].values.tobytes()


def flip(file: Path, at: int = -1) -> None:
    content = bytearray(file.read_bytes())
    content[at] ^= 1
    file.write_bytes(content)


def test_what_is_written_is_read_bit_for_bit(filled: Path) -> None:
    tree = open_results(filled)
    for seed, path in enumerate(PATHS):
        identical(tree[path].to_dataset(inherit=False), cell(seed))
    assert tree.attrs["bound"] == ["low", "high"]
    assert tree.attrs["format"] == 2
    assert result_paths(filled) == PATHS


def test_xarray_and_zarr_alone_read_the_tree(filled: Path) -> None:
    for consolidated in (True, False):
        tree = xr.open_datatree(filled / "results.zarr", engine="zarr", consolidated=consolidated)
        identical(tree[PATHS[1]].to_dataset(inherit=False), cell(1))
    root = zarr.open_group(filled / "results.zarr", mode="r")
    assert root.metadata.consolidated_metadata is not None
    assert sorted(root.group_keys()) == ["a", "b"]
    assert root[f"{PATHS[2]}/counts"][:].tolist() == [0, -(2**40), 3]


def test_consolidated_metadata_are_those_that_zarr_writes(filled: Path) -> None:
    document = filled / "results.zarr" / "zarr.json"
    ours = json.loads(document.read_text())["consolidated_metadata"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        zarr.consolidate_metadata(str(filled / "results.zarr"))
    theirs = json.loads(document.read_text())["consolidated_metadata"]
    assert sorted(ours["metadata"]) == sorted(theirs["metadata"])
    for path, expected in theirs["metadata"].items():
        for key in ("shape", "attributes", "node_type", "codecs", "dimension_names"):
            assert ours["metadata"][path].get(key) == expected.get(key)


@pytest.mark.parametrize(
    "values",
    [np.zeros((0, 3)), np.zeros(2**23 + 1), np.zeros(3, dtype=np.float16)],
    ids=["empty", "large", "half"],
)
def test_unusual_arrays_are_written_too(tmp_path: Path, values: np.ndarray) -> None:
    found = xr.Dataset({"x": (tuple("ab"[: values.ndim]), values)})
    write_cell(tmp_path / "cell", found)
    xr.testing.assert_identical(xr.open_zarr(tmp_path / "cell", consolidated=False).load(), found)


def test_big_endian_and_strided_values_are_written_as_they_are(tmp_path: Path) -> None:
    values = np.arange(24.0).reshape(4, 6).astype(">f8")[::2, ::-3].T
    write_cell(tmp_path / "cell", xr.Dataset({"x": (("a", "b"), values)}))
    found = xr.open_zarr(tmp_path / "cell", consolidated=False)["x"]
    assert found.dtype == np.dtype("<f8")
    assert np.array_equal(found, values)


def test_a_resumed_store_knows_what_is_done(filled: Path) -> None:
    store = Store.create(filled, CONFIG, resume=True, paths=PATHS)
    assert all(store.done(path) for path in PATHS)
    assert not store.done("a/random/spectrum")
    assert store.damaged == {}
    root = json.loads((filled / "results.zarr" / "zarr.json").read_text())
    assert "consolidated_metadata" not in root
    store.write("a/random/spectrum", cell(7))
    store.finish()
    identical(open_results(filled)["a/random/spectrum"].to_dataset(inherit=False), cell(7))


def test_every_flipped_byte_of_a_cell_is_noticed_and_its_file_named(filled: Path) -> None:
    group = filled / "results.zarr" / PATHS[0]
    expected = checksum(group)
    assert damage_of(group, expected) is None
    for file in sorted(file for file in group.rglob("*") if file.is_file()):
        name = file.relative_to(group).as_posix()
        content = file.read_bytes()
        for at in {0, len(content) // 3, len(content) - 1}:
            flip(file, at)
            assert damage_of(group, expected) == f"{name} has changed"
            file.write_bytes(content)
        file.write_bytes(content[:-1])
        assert damage_of(group, expected) == f"{name} has changed"
        file.unlink()
        assert damage_of(group, expected) in (
            "it is gone",
            f"{len(expected.parts) // 8 - 1} of {len(expected.parts) // 8} files are there",
        )
        file.write_bytes(content)
    assert damage_of(group, expected) is None


def test_damaged_cells_are_removed_and_written_again(filled: Path) -> None:
    tree = filled / "results.zarr"
    flip(tree / PATHS[0] / "variance" / "c.0")
    (tree / PATHS[1] / "counts" / "c.0").unlink()
    store = Store.create(filled, CONFIG, resume=True, paths=PATHS)
    assert [store.done(path) for path in PATHS] == [False, False, True]
    assert store.damaged[PATHS[0]] == "variance/c.0 has changed"
    assert "files are there" in store.damaged[PATHS[1]]
    assert not (tree / PATHS[0]).exists()
    store.write(PATHS[0], cell(0))
    store.write(PATHS[1], cell(1))
    store.finish()
    identical(open_results(filled)[PATHS[0]].to_dataset(inherit=False), cell(0))


def test_cells_with_chunks_in_folders_are_read_and_resumed(filled: Path) -> None:
    """As earlier versions, and xarray, write them."""
    group = filled / "results.zarr" / PATHS[0]
    for file in group.glob("*/c.0*"):
        metadata = json.loads((file.parent / "zarr.json").read_text())
        metadata["chunk_key_encoding"]["configuration"]["separator"] = "/"
        (file.parent / "zarr.json").write_text(json.dumps(metadata))
        chunk = file.parent.joinpath(*file.name.split("."))
        chunk.parent.mkdir(parents=True)
        file.rename(chunk)
    found = checksum(group)
    append_line(filled, CellLine(PATHS[0], found.sha256, found.parts, found.bytes, now()))
    assert list(group.glob("*/c/0"))
    store = Store.create(filled, CONFIG, resume=True, paths=PATHS)
    assert all(store.done(path) for path in PATHS)
    store.finish()
    for i, path in enumerate(PATHS):
        identical(open_results(filled)[path].to_dataset(inherit=False), cell(i))


def test_a_damaged_chunk_is_noticed_by_plain_readers(filled: Path) -> None:
    flip(filled / "results.zarr" / PATHS[0] / "variance" / "c.0")
    with pytest.raises(RuntimeError):
        open_results(filled)[PATHS[0]]["variance"].load()


@pytest.mark.parametrize("number", range(5))
def test_a_damaged_line_of_the_manifest_costs_its_cell_at_most(filled: Path, number: int) -> None:
    file = filled / MANIFEST_NAME
    lines = file.read_bytes().splitlines(keepends=True)
    lines[number] = lines[number].replace(b'"', b"'", 1)
    file.write_bytes(b"".join(lines))
    manifest = read_manifest(filled)
    assert manifest is not None
    assert manifest.damaged == (number + 1,)
    store = Store.create(filled, CONFIG, resume=True, paths=PATHS)
    assert [store.done(path) for path in PATHS] == [number != 2 + i for i in range(3)]
    again = read_manifest(filled)
    assert again is not None
    assert again.study is not None
    assert again.paths == PATHS
    assert again.damaged == ()


def test_a_manifest_cut_at_any_byte_is_read_up_to_there(filled: Path) -> None:
    file = filled / MANIFEST_NAME
    content = file.read_bytes()
    ends = np.cumsum([len(line) for line in content.splitlines(keepends=True)])
    for cut in range(int(ends[1]), len(content), 7):
        file.write_bytes(content[:cut])
        manifest = read_manifest(filled)
        assert manifest is not None
        whole = int((ends <= cut).sum())
        assert list(manifest.cells) == list(PATHS[: max(whole - 2, 0)])
        assert manifest.damaged == ()
        assert manifest.end == ends[whole - 1]
    store = Store.create(filled, CONFIG, resume=True, paths=PATHS)
    store.write("c/x/terms", cell())
    manifest = read_manifest(filled)
    assert manifest is not None
    assert list(manifest.cells) == [*PATHS, "c/x/terms"]


def test_a_line_that_leads_out_of_the_store_is_damage(filled: Path) -> None:
    from mcspectra.studies.manifest import CellLine, append_line

    for path in ("../x", "/etc/passwd", "a/../../b", "a//b", "", ".hidden/x", "a\nb"):
        append_line(filled, CellLine(path, "", "", 0, ""))
    manifest = read_manifest(filled)
    assert manifest is not None
    assert set(manifest.cells) == set(PATHS)
    assert len(manifest.damaged) == 7


def test_without_its_manifest_nothing_of_a_store_is_trusted(filled: Path) -> None:
    (filled / MANIFEST_NAME).unlink()
    store = Store.create(filled, CONFIG, resume=True, paths=PATHS)
    assert not any(store.done(path) for path in PATHS)
    assert set(store.damaged.values()) == {"its checksum is not known"}


def test_finished_is_said_when_all_planned_cells_are_there(tmp_path: Path) -> None:
    store = Store.create(tmp_path, CONFIG, paths=PATHS)
    store.write(PATHS[0], cell())
    store.finish()
    manifest = read_manifest(tmp_path)
    assert manifest is not None
    assert manifest.finished is None
    store = Store.create(tmp_path, CONFIG, resume=True, paths=PATHS)
    for path in PATHS[1:]:
        store.write(path, cell())
    store.finish()
    manifest = read_manifest(tmp_path)
    assert manifest is not None
    assert manifest.finished is not None
    assert [line.state for line in manifest.states] == ["resumed", "finished"]
    assert manifest.study is not None
    assert manifest.study.seed == CONFIG.seed
    assert "mcspectra" in str(manifest.study.versions)


def test_a_store_that_another_process_writes_is_refused(filled: Path) -> None:
    with (
        FolderLock.take(filled),
        pytest.raises(StoreError, match=f"written by process {os.getpid()}"),
    ):
        Store.create(filled, CONFIG, resume=True)


def as_format(folder: Path, number: Any) -> None:
    file = folder / "results.zarr" / "zarr.json"
    document = json.loads(file.read_text())
    document["attributes"]["format"] = number
    file.write_text(json.dumps(document))


def test_format_1_can_be_read_and_not_resumed(filled: Path) -> None:
    as_format(filled, 1)
    (filled / MANIFEST_NAME).unlink()
    identical(open_results(filled)[PATHS[0]].to_dataset(inherit=False), cell(0))
    assert sorted(result_paths(filled)) == sorted(PATHS)
    with pytest.raises(StoreError, match="format 1; this version writes 2 and only reads 1"):
        Store.create(filled, CONFIG, resume=True)


@pytest.mark.parametrize("number", [0, 3, "2", None, [2]])
def test_unknown_formats_are_refused(filled: Path, number: Any) -> None:
    as_format(filled, number)
    with pytest.raises(StoreError, match="has store format"):
        open_results(filled)
    with pytest.raises(StoreError, match="has store format .*; this version writes 2:"):
        Store.create(filled, CONFIG, resume=True)


def test_a_part_of_the_tree_can_be_opened(filled: Path) -> None:
    tree = open_results(filled, "a/*")
    assert [node.path for node in tree.leaves] == ["/a/random/convergence", "/a/random/terms"]
    identical(tree[PATHS[1]].to_dataset(inherit=False), cell(1))
    assert tree.attrs == open_results(filled).attrs
    with pytest.raises(StoreError, match="No cell of .* matches 'x/"):
        open_results(filled, "x/*")


def test_zip_files_and_urls_are_read(filled: Path, tmp_path: Path) -> None:
    import fsspec

    packed = tmp_path / "packed.zarr.zip"
    copy_to_zip(filled, packed)
    memory = fsspec.filesystem("memory")
    memory.put(str(filled / "results.zarr"), "/study/results.zarr", recursive=True)
    try:
        for source in (
            packed,
            filled / "results.zarr",
            "memory://study",
            "memory://study/results.zarr",
        ):
            identical(open_results(source)[PATHS[2]].to_dataset(inherit=False), cell(2))
            assert sorted(result_paths(source)) == sorted(PATHS)
            part = open_results(source, "b/*")
            identical(part[PATHS[2]].to_dataset(inherit=False), cell(2))
        with pytest.raises(StoreError, match="no results in 'memory://elsewhere'"):
            open_results("memory://elsewhere")
    finally:
        memory.rm("/study", recursive=True)


def test_what_is_no_store_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bad.zip").write_bytes(b"PK\x03\x04 and no more")
    for source, sentence in {
        tmp_path: "no results",
        tmp_path / "none.zarr": "no results",
        tmp_path / "none.zip": "no results",
        tmp_path / "bad.zip": "not a zip file",
        "strange://host/x": "cannot be opened",
    }.items():
        with pytest.raises(StoreError, match=sentence):
            open_results(source)
    monkeypatch.setattr(places.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(ImportError, match="needs fsspec, which is not installed"):
        open_results("memory://x")


def stranger(folder: Path, **changes: Any) -> Path:
    """A store with one array whose metadata are changed."""
    write_cell(folder / "results.zarr" / "a" / "b" / "terms", xr.Dataset({"n": ("n", [1.0, 2.0])}))
    root = {"attributes": {"format": 2}, "zarr_format": 3, "node_type": "group"}
    for group in (folder / "results.zarr", *(folder / "results.zarr" / p for p in ("a", "a/b"))):
        (group / "zarr.json").write_text(json.dumps(root))
    file = folder / "results.zarr" / "a" / "b" / "terms" / "n" / "zarr.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))
    return folder


GRID = {"name": "regular", "configuration": {"chunk_shape": [10**13]}}
PLAIN = {"name": "bytes", "configuration": {"endian": "little"}}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"shape": [10**13]}, "claims 80 TB, more than the memory"),
        ({"chunk_grid": GRID}, "claims 80 TB, more than the memory"),
        ({"codecs": [PLAIN, {"name": "numcodecs.bz2", "configuration": {}}]}, "is coded with"),
        ({"codecs": [PLAIN, {"name": "pickle"}]}, "is damaged"),
        ({"data_type": "string", "fill_value": "", "codecs": [{"name": "vlen-utf8"}]}, "vlen-utf8"),
        ({"data_type": "object"}, "is damaged"),
        ({"shape": [-1]}, "damaged|claims|hold"),
        ({"node_type": "tree"}, "damaged|no results"),
    ],
)
@pytest.mark.filterwarnings("ignore:Numcodecs codecs")
def test_arrays_that_results_never_hold_are_refused(
    tmp_path: Path, changes: dict[str, Any], sentence: str
) -> None:
    stranger(tmp_path, **changes)
    for select in (None, "a/b/*"):
        with pytest.raises(StoreError, match=sentence):
            open_results(tmp_path, select)


def test_zarr_2_which_can_name_pickles_is_not_read(tmp_path: Path) -> None:
    store = tmp_path / "results.zarr"
    root = zarr.open_group(store, mode="w", zarr_format=2, attributes={"format": 2})
    root.create_array("x", shape=(1,), dtype="f8")
    with pytest.raises(StoreError, match="no results"):
        open_results(tmp_path)
    inner = stranger(tmp_path / "mixed") / "results.zarr"
    zarr.open_group(inner / "a" / "c", mode="w", zarr_format=2).create_array(
        "x", shape=(1,), dtype="f8"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert [node.path for node in open_results(tmp_path / "mixed").leaves] == ["/a/b/terms"]


LIMITED = """
import resource, sys
import numpy as np, xarray as xr
from pathlib import Path
from mcspectra.core.errors import StorageError
from mcspectra.studies import Store, decode_study

folder, limit = Path(sys.argv[1]), int(sys.argv[2])
config = decode_study(sys.argv[3])
paths = [f"a/{i}/terms" for i in range(20)]
store = Store.create(folder, config, resume=True, paths=paths)
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
for i, path in enumerate(paths):
    if not store.done(path):
        try:
            store.write(path, xr.Dataset({"x": ("n", np.arange(100.0) + i)}))
        except StorageError as error:
            print(error)
            sys.exit(1)
store.finish()
"""


def test_a_full_disk_is_one_sentence_and_loses_nothing(tmp_path: Path) -> None:
    done = 0
    for limit in (1_500, 3_000, 10**6):
        ended = subprocess.run(
            [sys.executable, "-c", LIMITED, str(tmp_path), str(limit), STUDY],
            capture_output=True,
            text=True,
            check=False,
        )
        assert ended.stderr == ""
        store = Store.create(tmp_path, CONFIG, resume=True)
        found = [path for path in result_paths(tmp_path) if store.done(path)]
        assert len(found) >= done
        assert store.damaged == {}
        assert not list(tmp_path.glob(".partial*"))
        done = len(found)
        assert ended.returncode == (0 if done == 20 else 1)
        assert (ended.stdout.count("\n") == 1) == (done < 20)
    assert done == 20
    assert open_results(tmp_path)["a/7/terms"]["x"].values[0] == 7.0


def test_a_store_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written: Not a directory"):
        Store.create(tmp_path / "file" / "out", CONFIG)


def test_a_manifest_of_a_hundred_thousand_cells_is_the_index(tmp_path: Path) -> None:
    from mcspectra.studies.manifest import CellLine, study_line, write_manifest

    paths = [f"e{i // 1000}/s{i % 1000}/terms" for i in range(100_000)]
    lines: Iterator[CellLine] = (CellLine(path, "0" * 64, "0" * 160, 9, "") for path in paths)
    write_manifest(tmp_path, study_line("h", 0, {}), paths, lines)
    manifest = read_manifest(tmp_path)
    assert manifest is not None
    assert list(manifest.cells) == list(manifest.paths) == paths
