"""Stores of strangers decompress to what they claim, or are refused."""

import json
import struct
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from numcodecs.zstd import Zstd

from mcspectra.core.errors import StoreError
from mcspectra.studies import Store, decode_study, export_results, open_results
from mcspectra.studies import _bounded as bounded
from mcspectra.studies._bounded import content_size
from mcspectra.studies.copying import copy_to_zip

CONFIG = decode_study(
    'title = "bombs"\nsamplers = ["random"]\n[convergence]\ncounts = [4]\n'
    '[[estimators]]\nname = "a"\nintegrand = "linear"\ndims = 1\n'
)
CELL = "a/random/terms"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A store of one cell."""
    store = Store.create(tmp_path / "out", CONFIG, paths=[CELL])
    store.write(CELL, xr.Dataset({"x": ("n", np.arange(30.0))}))
    store.finish()
    return store.folder


@pytest.mark.parametrize("size", [0, 1, 255, 256, 257, 65_791, 65_792, 10**6])
def test_sizes_are_those_that_were_compressed(size: int) -> None:
    """All widths of the field: 1 byte below 256, then 2 from 256 on, 4 above 65,791."""
    assert content_size(Zstd().encode(bytes(size))[:18]) == size


@pytest.mark.parametrize(
    ("frame", "size"),
    [
        (b"\x28\xb5\x2f\xfd", None),  # cut off
        (b"\x28\xb5\x2f\xfd\x00\x58", None),  # a window, and no size
        (b"\x28\xb5\x2f\xfd\x20\x07", 7),
        (b"\x28\xb5\x2f\xfd\x21\xaa\x07", 7),  # after the identity of a dictionary of 1 byte
        (b"\x28\xb5\x2f\xfd\x63\xaa\xaa\xaa\xaa\x01\x00", 257),  # of 4 bytes
        (b"\x28\xb5\x2f\xfd\xc0\x58" + struct.pack("<Q", 2**50), 2**50),
        (b"\x28\xb5\x2f\xfd\xc0\x58\x01\x02", None),
    ],
)
def test_headers_as_rfc_8878_has_them(frame: bytes, size: int | None) -> None:
    assert content_size(frame) == size


BOMB = Zstd().encode(bytes(2**28))
STREAM = b"\x28\xb5\x2f\xfd\x00\x58\x4b\x00\x00\x00\xff\xff\x2f\x00"


@pytest.mark.parametrize(
    ("chunk", "words"),
    [(BOMB, "decompress to 268 MB, and its array has 240 B"), (STREAM, "an unknown size")],
)
@pytest.mark.parametrize("zipped", [False, True])
def test_a_chunk_that_decompresses_to_more_than_its_array_is_not_read(
    folder: Path, tmp_path: Path, chunk: bytes, words: str, zipped: bool
) -> None:
    (folder / "results.zarr" / CELL / "x/c.0").write_bytes(chunk)
    source = tmp_path / "x.zarr.zip" if zipped else folder
    if zipped:
        copy_to_zip(folder, source)  # an export refuses what is not as its checksum says
    assert len(BOMB) < 20_000
    tree = open_results(source)
    tracemalloc.start()
    with pytest.raises(StoreError, match=words):
        tree[CELL]["x"].load()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**26


def test_what_fits_is_read_by_all_ways(folder: Path, tmp_path: Path) -> None:
    sources = [folder, folder / "results.zarr", export_results(folder, tmp_path / "x.zarr.zip")]
    for source in sources:
        for select in (None, CELL):
            assert np.array_equal(open_results(source, select)[CELL]["x"], np.arange(30.0))


@pytest.mark.parametrize(
    ("codecs", "words"),
    [
        (["bytes", "gzip"], "coded with gzip"),
        (["bytes", "blosc"], "coded with blosc"),
        (["bytes", "zstd", "zstd"], "coded with zstd twice"),
    ],
)
def test_codecs_whose_output_has_no_bound_are_refused(
    folder: Path, codecs: list[str], words: str
) -> None:
    (folder / "results.zarr/zarr.json").write_text(
        json.dumps({"zarr_format": 3, "node_type": "group", "attributes": {"format": 2}})
    )
    file = folder / "results.zarr" / CELL / "x/zarr.json"
    document = json.loads(file.read_text())
    more = {"blosc": {"typesize": 8, "cname": "zstd", "shuffle": "noshuffle", "clevel": 1}}
    more |= {"bytes": {"endian": "little"}, "gzip": {"level": 1}, "zstd": {"level": 0}}
    more["blosc"]["blocksize"] = 0
    document["codecs"] = [{"name": name, "configuration": more[name]} for name in codecs]
    file.write_text(json.dumps(document))
    for select in (None, CELL):
        with pytest.raises(StoreError, match=words):
            open_results(folder, select)


@pytest.mark.parametrize("name", ["zarr.json", f"{CELL}/x/c.0"])
def test_a_zip_bomb_is_refused_by_the_sizes_in_its_index(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    file = tmp_path / "bomb.zarr.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, bytes(2**24))
        archive.write(folder / "results.zarr" / CELL / "x/zarr.json", "x/zarr.json")
    assert file.stat().st_size < 2**16
    monkeypatch.setattr(bounded, "available_memory", lambda: 2**23)
    with pytest.raises(StoreError, match=rf"holds '{name}' of 16.8 MB; at most 8.39 MB"):
        open_results(file)


def test_metadata_in_a_zip_file_are_bounded_whatever_memory_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bounded, "_MOST_METADATA", 1000)
    monkeypatch.setattr(bounded, "available_memory", lambda: 10**15)
    file = tmp_path / "bomb.zip"
    for size, words in ((1001, "at most 1"), (1000, "damaged|no results")):
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("zarr.json", b" " * size)
        with pytest.raises(StoreError, match=words):
            open_results(file)
