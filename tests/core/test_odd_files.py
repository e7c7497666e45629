"""Point files as others write them: comments, indexes, names and numbers that mislead."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from mcspectra.core.errors import FileFormatError
from mcspectra.core.pointfiles import read_points

POINTS = [[0.1, 0.2], [0.3, 0.4]]


def csv(tmp_path, text):
    file = tmp_path / "points.csv"
    file.write_text(text)
    return file


def table(tmp_path, **columns):
    file = tmp_path / "points.parquet"
    parquet.write_table(pa.table(columns), file)
    return file


def test_a_semicolon_in_a_comment_changes_nothing(tmp_path):
    (points,) = read_points(csv(tmp_path, "# by me; v1\nx,y\n0.1,0.2\n0.3,0.4\n"))
    np.testing.assert_array_equal(points, POINTS)


def test_semicolons_between_numbers_make_commas_decimal(tmp_path):
    (points,) = read_points(csv(tmp_path, "# a, b\nx;y\n0,1;0,2\n0,3;0,4\n"))
    np.testing.assert_array_equal(points, POINTS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (",x,y\n0,0.1,0.2\n1,0.3,0.4\n", "a column without a name.*index=False"),
        ("set\n1\n2\n", "has no coordinates"),
        ("set,Set,x\n1,2,0.1\n", "two columns 'set'"),
        ("x,y\n0.1,1_0\n", "'1_0' is not a finite number"),
    ],
)
def test_csv_that_would_be_misread(tmp_path, text, words):
    with pytest.raises(FileFormatError, match=words):
        read_points(csv(tmp_path, text))


def test_numbers_of_python_in_text(tmp_path):
    file = tmp_path / "points.dat"
    file.write_text("0.1 1_0\n")
    with pytest.raises(FileFormatError, match="line 1: '1_0' is not a finite number"):
        read_points(file)


def test_columns_that_differ_in_case_are_two(tmp_path):
    (points,) = read_points(table(tmp_path, X=[0.1, 0.3], x=[0.2, 0.4]))
    np.testing.assert_array_equal(points, POINTS)


def test_the_index_of_pandas_is_no_coordinate(tmp_path):
    (points,) = read_points(table(tmp_path, x0=[0.1, 0.3], x1=[0.2, 0.4], __index_level_0__=[7, 8]))
    np.testing.assert_array_equal(points, POINTS)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"set": [1, 1], "Set": [1, 2], "x": [0.1, 0.2]}, "two columns of one name"),
        ({"set": [[1], [2]], "x": [0.1, 0.2]}, "column 'set' holds list"),
        ({"set": [b"\xff", b"\xfe"], "x": [0.1, 0.2]}, "column 'set' holds binary"),
    ],
)
def test_tables_that_would_be_misread(tmp_path, columns, words):
    with pytest.raises(FileFormatError, match=words):
        read_points(table(tmp_path, **columns))
