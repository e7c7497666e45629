"""Point-set files: our files are read back, other programs' files are read, others rejected."""

import io
import itertools
import json
import math
import struct
import time
import zipfile
from fractions import Fraction

import numpy as np
import pytest

from mcspectra.core.errors import FileFormatError, McspectraError
from mcspectra.core.pointfiles import (
    EXTENSIONS,
    format_dat,
    parse_dat,
    read_points,
    write_points,
)

MAGIC = 0x214B5455  # "UTK!"


def random_sets(count=3, n=8, dims=2):
    return list(np.random.default_rng(0).random((count, n, dims)))


@pytest.fixture
def save(tmp_path):
    """Return a function that writes bytes or text to a file and returns its path."""

    def write(name, content):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.mark.parametrize("extension", EXTENSIONS)
@pytest.mark.parametrize(("count", "n", "dims"), [(1, 1, 1), (1, 5, 3), (4, 7, 2)])
def test_written_points_are_read_back_bit_for_bit(tmp_path, extension, count, n, dims):
    sets = random_sets(count, n, dims)
    sets[0][0, 0] = np.nextafter(1.0, 0.0)
    path = tmp_path / f"points{extension}"
    write_points(path, sets, meta={"sampler": "random"})
    found = read_points(path)
    assert len(found) == count
    np.testing.assert_array_equal(found, sets)
    assert all(points.dtype == np.float64 for points in found)
    assert len(read_points(str(path))) == count


@pytest.mark.parametrize("extension", [".dat", ".csv"])
def test_text_and_tables_keep_sets_of_different_sizes(tmp_path, extension):
    sets = [np.full((n, 2), 0.1 * n) for n in (1, 3, 2)]
    write_points(tmp_path / f"p{extension}", sets)
    found = read_points(tmp_path / f"p{extension}")
    assert [points.shape for points in found] == [(1, 2), (3, 2), (2, 2)]


def test_meta_is_kept_by_npz_and_dat(tmp_path):
    meta = {"sampler": "jittered | shift", "seed": 7}
    write_points(tmp_path / "p.npz", random_sets(), meta=meta)
    with np.load(tmp_path / "p.npz", allow_pickle=False) as stored:
        assert json.loads(str(stored["meta"])) == meta
    write_points(tmp_path / "p.dat", random_sets(), meta=meta)
    first = (tmp_path / "p.dat").read_text().splitlines()[0]
    assert json.loads(first.removeprefix("#")) == meta


def test_utk_text_as_utk_writes_it():
    """Fixed notation, a '#' between sets, comments at the top, blanks at line ends, \\r\\n."""
    text = "# by UTK\n# 2\r\n0.250 0.500 \r\n0.000 0.125\n#\n0.75\t0.5\n\n#\n"
    found = parse_dat(text, "text")
    assert [points.tolist() for points in found] == [[[0.25, 0.5], [0.0, 0.125]], [[0.75, 0.5]]]


def test_dat_text_is_utk_text():
    assert format_dat([np.array([[0.5, 0.25]]), np.array([[0.0, 0.75]])]) == (
        "0.5 0.25\n#\n0.0 0.75\n"
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.5,0.25\n0.75,0\n", [[[0.5, 0.25], [0.75, 0.0]]]),
        ("x,y\n0.5,0.25\n", [[[0.5, 0.25]]]),
        ('"x", "y"\r\n"0.5", 0.25\r\n', [[[0.5, 0.25]]]),
        ("\ufeffx;y\n0,5;0,25\n", [[[0.5, 0.25]]]),
        ("# by me; v1\nx,y\n0.1,0.2\n", [[[0.1, 0.2]]]),
        ("# a, b\nx;y\n0,1;0,2\n", [[[0.1, 0.2]]]),
        ("0.5\r0.25\r\r0.75", [[[0.5], [0.25]], [[0.75]]]),
        ("# made by hand\n0.5\n\n0.25\n0.75\n\n\n", [[[0.5]], [[0.25], [0.75]]]),
        (
            "x,set,y\n0.5,a,0.1\n0.25,b,0.2\n0.75,a,0.3\n",
            [[[0.5, 0.1], [0.75, 0.3]], [[0.25, 0.2]]],
        ),
    ],
)
def test_csv_as_others_write_it(save, text, expected):
    assert [points.tolist() for points in read_points(save("p.csv", text))] == expected


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("code", range(6))
def test_utk_binary_of_all_types_in_both_byte_orders(save, order, code):
    """Codes of UTK's DATATYPE; integers are fractions of their range, the largest below 1."""
    kind = ("i4", "i8", "u4", "u8", "f4", "f8")[code]
    largest = 1 if kind[0] == "f" else int(np.iinfo(kind).max) + 1
    data = np.array([0, largest / 2, largest / 4, largest * 3 / 4], order + kind)
    if kind[0] != "f":
        data[3] = np.iinfo(kind).max
    header = struct.pack(order + "I", MAGIC) + bytes([code, 0, 0, 0])
    path = save("p.bin", header + struct.pack(order + "3I", 1, 2, 2) + data.tobytes())
    (points,) = read_points(path)
    np.testing.assert_array_equal(points[:, 0], [0.0, 0.25])
    assert points[0, 1] == 0.5
    assert 0.74 < points[1, 1] < 1.0


def test_binary_header_is_five_words_lowest_byte_first(tmp_path):
    write_points(tmp_path / "p.bin", random_sets(3, 8, 2))
    data = (tmp_path / "p.bin").read_bytes()
    assert data[:4] == b"UTK!"
    assert struct.unpack("<5I", data[:20]) == (MAGIC, 5, 3, 8, 2)
    assert len(data) == 20 + 3 * 8 * 2 * 8


def binary(code=5, sets=1, points=2, dims=2, data=bytes(32), magic=MAGIC):
    return struct.pack("<5I", magic, code, sets, points, dims) + data


def npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def npz_of(header, data=b""):
    """An archive with a hand-made points.npy."""
    text = header.encode() + b" " * 10 + b"\n"
    member = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("points.npy", member)
    return buffer.getvalue()


HUGE = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 1000), }"
PICKLED = "{'descr': '|O', 'fortran_order': False, 'shape': (1, 1), }"

BAD_FILES = [
    ("p.dat", "", "holds no points"),
    ("p.dat", "#\n\n#\n", "holds no points"),
    ("p.dat", "0.1 0.2\n0.3\n", "line 2, has 1 number, but the set began with 2 on line 1"),
    ("p.dat", "0.1 0.2\n0.3 x\n", "line 2: 'x' is not a finite number"),
    ("p.dat", "0.1 0.2\n#\n0.3 nan\n", "line 3: 'nan' is not a finite number"),
    ("p.dat", "inf 0.2\n", "line 1: 'inf' is not a finite number"),
    ("p.dat", "0.1 0.2 # here\n", "line 1: '#' is not a finite number"),
    ("p.dat", "0.1,0.2\n", "line 1: '0.1,0.2' is not"),
    ("p.dat", b"0.1 \xff\n", "byte 4"),
    ("p.dat", "0.1 " + "9" * 500 + "\n", "line 1"),
    ("p.csv", "", "holds no points"),
    ("p.csv", "x,y\n", "holds no points"),
    ("p.csv", "x,y\n1,2\n3\n", "line 3, has 1 number"),
    ("p.csv", "0.1,0.2\nx,y\n", "line 2: 'x'"),
    ("p.csv", "0.1,0.2\n,0.3\n", "line 2: ''"),
    ("p.csv", "nan,0.2\n", "line 1: 'nan'"),
    ("p.csv", ",x,y\n0,0.1,0.2\n1,0.3,0.4\n", "a column without a name.*index=False"),
    ("p.csv", "set\n1\n2\n", "has no coordinates"),
    ("p.csv", "set,Set,x\n1,2,0.1\n", "two columns 'set'"),
    ("p.csv", "x,y\n0.1,1_0\n", "'1_0' is not a finite number"),
    ("p.dat", "0.1 1_0\n", "line 1: '1_0' is not a finite number"),
    ("p.bin", b"", "ends at byte 0"),
    ("p.bin", binary()[:19], "ends at byte 19"),
    ("p.bin", binary()[:-1], "32 bytes after the header, but has 31"),
    ("p.bin", binary() + b"0", "but has 33"),
    ("p.bin", binary(magic=0x12345678), "begins with 78563412"),
    ("p.bin", binary(code=6), "byte 4: the type code is 6"),
    ("p.bin", binary(points=0, data=b""), "each must be at least 1"),
    ("p.bin", binary(sets=2**32 - 1, points=2**32 - 1, dims=2**32 - 1), "announces 4294967295"),
    ("p.bin", binary(data=struct.pack("<4d", 0, 1, np.nan, 0)), "coordinate 0 of point 1 of set 0"),
    ("p.npz", b"", "cannot be read as a point set"),
    ("p.npz", b"PK\x03\x04 and so on", "cannot be read as a point set"),
    ("p.npz", npz(points=np.zeros((2, 2)))[:-40], "cannot be read as a point set"),
    ("p.npz", npz(x=np.zeros((2, 2))), "no array 'points'; it holds 'x'"),
    ("p.npz", npz(points=np.zeros(4)), r"shape \(4,\)"),
    ("p.npz", npz(points=np.zeros((0, 2))), r"shape \(0, 2\)"),
    ("p.npz", npz(points=np.array([["a", "b"]])), "type <U1"),
    ("p.npz", npz(points=np.array([[1j, 0]])), "type complex128"),
    ("p.npz", npz(points=np.array([[0.5, np.inf]])), "coordinate 1 of point 0 of set 0"),
    ("p.npz", npz_of(HUGE), "announces an array of shape"),
    ("p.npz", npz_of(PICKLED, b"cos\nsystem\n" * 8), "allow_pickle"),
    ("p.npz", npz_of("{'descr': 'no type'}"), "cannot be read as a point set"),
    ("p.xyz", "0.1 0.2\n", "does not end in one of .dat, .bin, .npz, .npy, .csv"),
    ("points", "0.1 0.2\n", "does not end in one of"),
    ("p.dat", "0 " * 2**21 + "\n", "line 1, is longer than 4194304 bytes"),
    ("p.csv", "x,set,y\n0.1,1,0.2\n0.3,1\n", "line 3, has 1 number"),
]


@pytest.mark.parametrize(("name", "content", "words"), BAD_FILES)
def test_bad_files_are_refused_in_one_sentence(save, name, content, words):
    path = save(name, content)
    with pytest.raises(FileFormatError, match=words) as caught:
        read_points(path)
    assert str(path) in str(caught.value)
    assert_one_sentence(caught.value)


def assert_one_sentence(error):
    text = str(error)
    assert isinstance(error, McspectraError)
    assert "\n" not in text
    assert text.endswith(".")
    assert not text.endswith("..")
    assert "Traceback" not in text


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_missing_files_and_folders_are_refused(tmp_path, extension):
    missing = tmp_path / f"missing{extension}"
    with pytest.raises(FileFormatError, match="There is no file") as caught:
        read_points(missing)
    assert_one_sentence(caught.value)
    missing.mkdir()
    with pytest.raises(FileFormatError, match="is a folder") as caught:
        read_points(missing)
    assert_one_sentence(caught.value)
    with pytest.raises(FileFormatError, match="cannot be written"):
        write_points(missing, random_sets())
    with pytest.raises(FileFormatError, match="cannot be written"):
        write_points(tmp_path / "no" / f"p{extension}", random_sets())


@pytest.mark.parametrize("path", [5, None, b"p.dat", "a\0b.dat", ["p.dat"]])
def test_invalid_paths_are_rejected(path):
    with pytest.raises(FileFormatError, match="is not a path"):
        read_points(path)


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        ([], "no sets"),
        ([[0.5, 0.5]], r"shape \(2,\)"),
        ([np.zeros((0, 2))], r"shape \(0, 2\)"),
        ([[[0.5, np.nan]]], "finite"),
        ([[["a"]]], "not an array of numbers"),
        ([[[0.5], [0.5, 0.5]]], "not an array of numbers"),
    ],
)
@pytest.mark.parametrize("extension", EXTENSIONS)
def test_invalid_sets_are_not_written(tmp_path, extension, sets, words):
    with pytest.raises(FileFormatError, match=words) as caught:
        write_points(tmp_path / f"p{extension}", sets)
    assert_one_sentence(caught.value)
    assert not (tmp_path / f"p{extension}").exists()


def test_sets_of_different_sizes_do_not_fit_binary_formats(tmp_path):
    sets = [np.zeros((1, 2)), np.zeros((2, 2))]
    for name in ("p.bin", "p.npz"):
        with pytest.raises(FileFormatError, match="equal shape"):
            write_points(tmp_path / name, sets)
    with pytest.raises(FileFormatError, match="same dims"):
        write_points(tmp_path / "p.csv", [np.zeros((1, 2)), np.zeros((1, 3))])


@pytest.mark.parametrize(
    ("name", "head"), [("x.dat", b""), ("x.csv", b"x,y\n"), ("x.csv", b"set,x\n")]
)
def test_millions_of_blank_lines_are_skipped(save, name, head):
    point = b"0,0.5\n" if name == "x.csv" else b"0 0.5\n"
    path = save(name, head + b"\n" * (8 * 2**20) + point)
    (points,) = read_points(path)
    assert points.shape == ((1, 1) if b"set" in head else (1, 2))
    path.write_bytes(path.read_bytes() + b" \n" * 10 + point[:-2] + b"x\n")
    with pytest.raises(FileFormatError, match=f"line {8 * 2**20 + head.count(b'x') + 12}: "):
        read_points(path)


def test_cells_may_stand_between_blanks(save):
    text = 'a; "b" \n 1,5 ; "2"\n\n ; ; \n#\n3;4\n'
    found = [points.tolist() for points in read_points(save("x.csv", text.encode()))]
    assert found == [[[1.5, 2.0]], [[3.0, 4.0]]]


def test_long_sets_are_read_in_blocks(save):
    """A set that spans several blocks has a single width and is read completely."""
    points = np.random.default_rng(2).random((100_000, 3))
    text = format_dat([points[:70_000], points[70_000:]])
    first, second = read_points(save("p.dat", text))
    np.testing.assert_array_equal(np.concatenate([first, second]), points)
    assert len(first) == 70_000
    lines = text.splitlines()
    with pytest.raises(FileFormatError, match="line 70000, has 2 numbers, but .* 3 on line 1;"):
        parse_dat("\n".join([*lines[:69_999], "0.5 0.5", *lines[70_000:]]), "text")
    with pytest.raises(FileFormatError, match="line 99999: 'x' is not"):
        parse_dat("0.5\n" * 99_998 + "x\n", "text")


def test_numbers_of_long_texts_agree_with_python(save):
    """Bit for bit: printed numbers, 1 to 19 digits, and numbers between two float64."""
    rng = np.random.default_rng(3)
    tokens = [repr(x) for x in (rng.random(20_000) * 10.0 ** rng.integers(-12, 3, 20_000)).tolist()]
    for digits, places in itertools.product(range(1, 20), range(26)):
        whole = int(rng.integers(10**18, 2**63 - 1)) % 10**digits
        tokens += [f"{whole}e-{places}", f"-.{whole}", f"+{whole}.", f"{whole}E+1"]
    for places in range(23):
        for whole in rng.integers(10**18, 2**63 - 1, 200).tolist():
            x = whole / 10**places
            middle = (Fraction(x) + Fraction(math.nextafter(x, math.inf))) / 2
            near = round(middle * 10**places)
            tokens += [f"{near + step}e-{places}" for step in (-1, 0, 1)]
    tokens += ["0", "-0.0", "0e999", "1e-400", "9" * 19, "9" * 20, "0" * 30 + "1"]
    text = "".join(f"{token}\t\r\n" for token in tokens)
    assert len(text) > 2**18
    (points,) = read_points(save("p.dat", "# long\n" + text))
    assert points[:, 0].tobytes() == np.array([float(token) for token in tokens]).tobytes()


@pytest.mark.parametrize(
    "text", ["1e999", "1_0", "nan", "1-2", "1.2.3", "1e", "e5", "+", ".", "0x10", "1,2", "1#c"]
)
def test_long_texts_name_the_line_that_is_wrong(text):
    lines = ["# sets", *["0.25"] * 99_998, text]
    with pytest.raises(FileFormatError, match=r"text, line 100000: '.*' is not a finite number\."):
        parse_dat("\n".join(lines), "text")


def test_long_texts_of_many_sets_and_other_characters():
    text = "\ufeff#\n" + "0.5 0.25\n# é\n\n" * 50_000 + "0.5\v0.25\n" + "#\n0.5\u20090.25\n"
    sets = parse_dat(text, "text")
    assert len(sets) == 50_002
    assert {points.shape for points in sets[:50_000]} == {(1, 2)}
    assert sets[50_000].tolist() == [[0.5], [0.25]]  # line ends as in str.splitlines
    assert sets[50_001].tolist() == [[0.5, 0.25]]
    sets = parse_dat("#\n0.5 0.25\n" * 50_000, "text")
    assert len(sets) == 50_000
    assert np.array_equal(np.concatenate(sets), [[0.5, 0.25]] * 50_000)


def test_a_text_is_read_as_fast_as_numpy_reads_it(save):
    points = np.random.default_rng(4).random((100_000, 2))
    path = save("p.dat", format_dat([points]))
    np.testing.assert_array_equal(read_points(path)[0], points)  # compiles the kernel

    def seconds(read):
        begun = time.process_time()
        read(path)
        return time.process_time() - begun

    ours, numpy = (min(seconds(read) for _ in range(3)) for read in (read_points, np.loadtxt))
    assert ours < numpy


@pytest.mark.parametrize("call", [lambda x: parse_dat(x, "text"), read_points, format_dat])
@pytest.mark.parametrize("given", [None, 3, b"0.5", object(), ["a", 1], np.array(0.5)])
def test_helpers_given_something_else_raise_an_error_of_the_package(call, given):
    with pytest.raises(FileFormatError) as caught:
        call(given)
    assert_one_sentence(caught.value)


@pytest.mark.parametrize("sets", [3, None, np.array(0.5)])
def test_invalid_lists_of_sets_are_not_written(tmp_path, sets):
    with pytest.raises(FileFormatError, match="give a list of arrays"):
        write_points(tmp_path / "p.dat", sets)
    with pytest.raises(FileFormatError, match="JSON can hold"):
        write_points(tmp_path / "p.dat", random_sets(), meta=3)


def test_text_that_is_not_unicode_is_rejected():
    with pytest.raises(FileFormatError, match="byte 4 is no character"):
        parse_dat("0.1 \udcff\n", "standard input")
