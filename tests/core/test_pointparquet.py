"""Parquet files of points: what others write is read, the rest is refused in one sentence."""

import json
import sys

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from mcspectra.core.errors import FileFormatError, MissingDependency
from mcspectra.core.pointfiles import read_points, write_points


def save(path, **columns):
    parquet.write_table(pa.table(columns), path)
    return path


def test_columns_and_meta_are_those_that_were_said(tmp_path):
    sets = np.random.default_rng(0).random((2, 3, 2))
    write_points(tmp_path / "p.parquet", sets, meta={"sampler": "random", "seed": 3})
    table = parquet.read_table(tmp_path / "p.parquet")
    assert table.column_names == ["set", "x0", "x1"]
    assert table.column("set").to_pylist() == [0, 0, 0, 1, 1, 1]
    np.testing.assert_array_equal(table.column("x1"), sets[..., 1].ravel())
    assert json.loads(table.schema.metadata[b"mcspectra"]) == {"sampler": "random", "seed": 3}
    write_points(tmp_path / "one.parquet", sets[:1])
    assert parquet.read_table(tmp_path / "one.parquet").column_names == ["x0", "x1"]


def test_tables_of_others_are_read(tmp_path):
    path = save(
        tmp_path / "p.parquet",
        u=np.float32([0.5, 0.25, 0.75]),
        Set=["b", "a", "b"],
        v=[0, 0, 0],
    )
    assert [x.tolist() for x in read_points(path)] == [[[0.5, 0], [0.75, 0]], [[0.25, 0]]]


@pytest.mark.parametrize(
    "columns",
    [
        {"X": [0.1, 0.3], "x": [0.2, 0.4]},  # two that differ in case
        {"x0": [0.1, 0.3], "x1": [0.2, 0.4], "__index_level_0__": [7, 8]},  # the index of pandas
    ],
)
def test_columns_of_coordinates_are_told_from_others(tmp_path, columns):
    (points,) = read_points(save(tmp_path / "p.parquet", **columns))
    np.testing.assert_array_equal(points, [[0.1, 0.2], [0.3, 0.4]])


def test_sets_come_in_the_order_of_their_first_rows(tmp_path):
    path = save(tmp_path / "p.parquet", set=[10, 9, 10], x=[0.1, 0.2, 0.3])
    assert [x.ravel().tolist() for x in read_points(path)] == [[0.1, 0.3], [0.2]]


def test_sets_of_several_row_groups_and_dictionaries(tmp_path):
    """Each row group has its own dictionary, and one may name a label twice."""
    labels = ["b", "a", "a", "c", "b", "c"]
    table = pa.table({"x": np.arange(6) / 8, "set": labels})
    parquet.write_table(table, tmp_path / "p.parquet", row_group_size=2)
    expected = [[0.0, 0.5], [0.125, 0.25], [0.375, 0.625]]
    assert [x.ravel().tolist() for x in read_points(tmp_path / "p.parquet")] == expected
    twice = pa.DictionaryArray.from_arrays([0, 1, 2, 1], ["b", "a", "b"])
    path = save(tmp_path / "q.parquet", x=[0.0, 0.25, 0.5, 0.75], set=twice)
    assert [x.ravel().tolist() for x in read_points(path)] == [[0.0, 0.5], [0.25, 0.75]]


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"x": ["a", "b"]}, "column 'x' holds string"),
        ({"x": [True, False]}, "column 'x' holds bool"),
        ({"x": [0.5, None]}, "column 'x', row 1 .* is empty or not finite"),
        ({"x": [0.5, float("nan")]}, "row 1"),
        ({"x": [[0.5], [0.2]]}, "column 'x' holds list"),
        ({"x": [0.5, 0.2], "set": [1, None]}, "column 'set' is empty in a row"),
        ({"set": [1, 2]}, "holds no points"),
        ({"x": pa.array([], "float64")}, "holds no points"),
        ({"set": [1, 1], "Set": [1, 2], "x": [0.1, 0.2]}, "two columns of one name"),
        ({"set": [[1], [2]], "x": [0.1, 0.2]}, "column 'set' holds list"),
        ({"set": [b"\xff", b"\xfe"], "x": [0.1, 0.2]}, "column 'set' holds binary"),
    ],
)
def test_tables_that_are_no_points(tmp_path, columns, words):
    with pytest.raises(FileFormatError, match=words):
        read_points(save(tmp_path / "p.parquet", **columns))


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.6, 0.9, 0.999])
def test_truncated_files_are_one_sentence(tmp_path, share):
    path = tmp_path / "p.parquet"
    write_points(path, [np.random.default_rng(0).random((500, 3))])
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(FileFormatError, match="cannot be read as a point set") as caught:
        read_points(path)
    assert "\n" not in str(caught.value)


def test_damaged_bytes_never_escape_as_other_errors(tmp_path):
    path = tmp_path / "p.parquet"
    write_points(path, [np.random.default_rng(0).random((50, 2))])
    sound = bytearray(path.read_bytes())
    rng = np.random.default_rng(1)
    sentences = []
    for _ in range(150):
        damaged = sound.copy()
        for place in rng.integers(0, len(sound), 4):
            damaged[place] = rng.integers(0, 256)
        path.write_bytes(damaged)
        try:
            read_points(path)
        except FileFormatError as error:
            sentences.append(str(error))
    assert len(sentences) > 10
    assert not any("\n" in sentence for sentence in sentences)


def test_a_missing_package_is_one_sentence(tmp_path, monkeypatch):
    path = save(tmp_path / "p.parquet", x=[0.5])
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.delitem(sys.modules, "pyarrow.parquet")
    for call in (lambda: read_points(path), lambda: write_points(path, [np.ones((1, 1))])):
        with pytest.raises(MissingDependency, match=r"pip install 'mcspectra\[parquet\]'"):
            call()
