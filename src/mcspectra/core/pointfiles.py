"""Point-set files: UTK text and binary, npz, npy and csv. Each holds a list of point sets.

============  ====================================================================================
``.dat``      UTK text: one point per line, with coordinates separated by blanks.
              A line that begins with ``#`` starts the next set, or is a comment at the top
``.bin``      UTK binary: five 32-bit words, then all coordinates in order.
              The first two words are 0x214B5455 = "UTK!" and the type code.
              The other words are the numbers of sets, of points per set and of dims
``.npz``      array ``points`` of shape (n, d) or (R, n, d), text ``meta`` (JSON)
``.npy``      one array of shape (n, d) or (R, n, d)
``.csv``      commas or semicolons separate numbers, after an optional header line.
              A column ``set`` numbers the sets; otherwise blank lines separate the sets
============  ====================================================================================

UTK is the Uni{corn|form} toolkit, https://github.com/utk-team/utk.
The formats are defined in the file ``include/utk/utils/PointsetIO.hpp`` of UTK.
The type code is the first byte of the second word.
The codes 0 to 5 mean int32, int64, uint32, uint64, float and double.
The first word tells the byte order.
Integers mean fractions of the range of their type.

The sets of one file may differ in size. Samplers check whether coordinates lie in [0,1).
"""

from __future__ import annotations

import glob
import io
import itertools
import json
import math
import re
import struct
from array import array
from collections.abc import Iterable, Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.decoding import check_decoded_size, known_path, opened, read_npy, read_npz
from mcspectra.core.display import counted, shown
from mcspectra.core.errors import FileFormatError, writing

__all__ = [
    "EXTENSIONS",
    "format_dat",
    "matching_files",
    "parse_dat",
    "read_points",
    "write_points",
]

EXTENSIONS = (".dat", ".bin", ".npz", ".npy", ".csv")
"""Extensions of point-set files that can be read and written."""

# Bytes of memory that are counted for each set, in addition to its coordinates.
# The number is large because a file of many tiny sets takes long to read
_SET_BYTES = 4096

# UTK text and comma-separated values
_LONGEST_LINE = 2**22  # largest number of bytes in a line
_BLOCK = 2**20
# Texts of at least this number of bytes are read by a compiled kernel.
# Python reads a shorter text in less time than the compilation of the kernel takes
_COMPILED = 2**18
# Bytes of memory for each number of a text, which is stored three times as float64.
# Each number is in an array for its line, in an array for its point set, and in the final result
_VALUE_BYTES = 24

# UTK binary
_MAGIC = 0x214B5455
_HEADER_BYTES = 20
_TYPES = ("i4", "i8", "u4", "u8", "f4", "f8")


def read_points(path: str | PathLike[str]) -> list[Array]:
    """Read the point sets of a file as float64 arrays of shape (n, d), one for each set.

    Raises
    ------
    FileFormatError
        If the file is missing, empty, truncated or of an unknown format.
        If it takes too much memory (see `mcspectra.core.decoding`).
        If it contains anything except finite numbers. The message names the line or the byte.
    """
    with opened(path, "a point set", EXTENSIONS) as (stream, size, name, extension):
        match extension:
            case ".dat":
                return _read_dat(stream, size, name)
            case ".csv":
                return _read_csv(stream, size, name)
            case ".bin":
                points = _read_bin(stream, size, name)
            case _:
                npy = extension == ".npy"
                read = read_npy(stream, size, name) if npy else None
                points = read_npz(stream, size, name, "points") if read is None else read
                if points.dtype.kind not in "fiu" or points.ndim not in (2, 3) or points.size == 0:
                    raise FileFormatError(
                        f"{name} holds 'points' of type {points.dtype} and shape {points.shape}; "
                        "give numbers of shape (n, d) or (R, n, d)."
                    )
                points = points if points.ndim == 3 else points[None]
                check_decoded_size(name, size, len(points) * _SET_BYTES)

        # Split (R, n, d) into sets of float64. Before that, check for NaN and infinity
        points = points.astype(np.float64, copy=False)
        good = np.isfinite(points)
        if not good.all():
            where = [int(i) for i in np.argwhere(~good)[0]]
            raise FileFormatError(
                f"{name}: coordinate {where[2]} of point {where[1]} of set {where[0]} (from 0) is "
                f"{points[tuple(where)]}; give finite numbers."
            )
        return list(points)


def matching_files(path: str | PathLike[str]) -> list[tuple[Path, int | None]]:
    """Return the files of a path, sorted by name. Numbers in names are sorted by value.

    Parameters
    ----------
    path
        A file, a folder (for all its point-set files), or a pattern.
        In a pattern, ``*`` and ``?`` match any characters.
        ``{n}`` matches a whole number, which must be the same in all places.

    Returns
    -------
    list
        Each file with its number n. The number is None if the pattern has no ``{n}``.

    Raises
    ------
    FileFormatError
        If the folder contains no point-set file, or if no file matches the pattern.
    """
    text = str(path)
    pattern = any(mark in text for mark in ("*", "?", "{n}"))
    file = known_path(path, "a point set")
    if not (file.suffix or pattern or file.exists()):
        raise FileFormatError(f"There is no file or folder {shown(text)}; give a point set.")
    if file.is_file() or not (pattern or file.is_dir()):
        return [(file, None)]
    if file.is_dir():
        named = [(f, None) for f in file.iterdir() if f.suffix.lower() in EXTENSIONS]
        found: list[tuple[Path, int | None]] = [(f, n) for f, n in named if f.is_file()]
        said = f"The folder {file} holds no point set"
    else:
        # Keep the files that match the shell pattern and have the same number at each {n}
        words = re.escape(text).replace(r"\{n\}", r"(?P<n>[0-9]+)", 1).replace(r"\{n\}", r"(?P=n)")
        exact = re.compile(words.replace(r"\*", "[^/]*").replace(r"\?", "[^/]"))
        names = glob.glob(text.replace("[", "[[]").replace("{n}", "*"))  # noqa: PTH207 - the pattern is a whole path
        fits = [(Path(name), exact.fullmatch(name)) for name in names]
        found = [(f, int(m["n"]) if "{n}" in text else None) for f, m in fits if m and f.is_file()]
        said = f"No file matches {text!r}"
    if not found:
        raise FileFormatError(f"{said}; give files {', '.join(EXTENSIONS)}.")
    runs = re.compile(r"([0-9]+)")
    return sorted(
        found, key=lambda each: [int(w) if w.isdigit() else w for w in runs.split(str(each[0]))]
    )


def write_points(
    path: str | PathLike[str], sets: Iterable[object], *, meta: Mapping[str, Any] | None = None
) -> None:
    """Write point sets, arrays of shape (n, d). The extension of the file name selects the format.

    Parameters
    ----------
    path
        File to write. An existing file is replaced.
    sets
        One array (n, d) for each set. In ``.bin``, ``.npz`` and ``.npy`` all have the same shape.
    meta
        Description of the points, as JSON.
        ``.npz`` stores the description, ``.dat`` stores it as a comment. Other formats ignore it.

    Raises
    ------
    FileFormatError
        If the extension is unknown, the sets do not fit the format, or writing fails.
    """
    file = known_path(path, "a point set", EXTENSIONS)
    content = _content(file.suffix.lower(), sets, meta, str(file))
    with writing(file):
        file.write_bytes(content)


def parse_dat(text: str, name: str) -> list[Array]:
    """Read UTK text in the same way as `read_points`. Error messages call the text `name`."""
    if not isinstance(text, str):
        raise FileFormatError(f"{name} is {type(text).__name__}, not text; give lines of numbers.")
    # Keep invalid characters (surrogates) in the bytes. The parser of the bytes rejects them
    data = text.encode(errors="surrogatepass")
    return _read_dat(io.BytesIO(data), len(data), name)


def format_dat(sets: Iterable[object], meta: Mapping[str, Any] | None = None) -> str:
    """Write UTK text in the same way as `write_points`. Reading gives the same bits."""
    return _content(".dat", sets, meta, "UTK text").decode()


def _content(
    extension: str, sets: Iterable[object], meta: Mapping[str, Any] | None, name: str
) -> bytes:
    """Return the bytes of a file. Error messages call the file `name`."""
    # Convert the sets to float64 arrays (n, d), and their description to JSON
    try:
        numbered, text = enumerate(sets), json.dumps(dict(meta or {}), default=str)
    except (TypeError, ValueError):
        raise FileFormatError(
            f"The sets and the meta for {name} are {shown(sets)} and {shown(meta)}; give a list of "
            "arrays (n, d), and names with values that JSON can hold."
        ) from None
    clean: list[Array] = []
    for k, given in numbered:
        try:
            points = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            raise FileFormatError(f"Set {k} for {name} is not an array of numbers.") from None
        if points.ndim != 2 or points.size == 0 or not np.isfinite(points).all():
            raise FileFormatError(
                f"Set {k} for {name} has shape {points.shape}; give finite numbers of shape (n, d)."
            )
        clean.append(points)
    if not clean:
        raise FileFormatError(f"There are no sets to write to {name}; give at least one.")

    # Reject sets that the format cannot represent
    several = len(clean) > 1
    if extension in (".bin", ".npz", ".npy") and len({points.shape for points in clean}) > 1:
        raise FileFormatError(
            f"{name} can hold only sets of equal shape; write other sets as .dat or .csv."
        )
    if extension == ".csv" and len({points.shape[1] for points in clean}) > 1:
        raise FileFormatError(
            f"{name} can hold only sets of the same dims; write the sets to several files."
        )

    axes = [f"x{i}" for i in range(clean[0].shape[1])]
    buffer = io.BytesIO()
    match extension:
        case ".dat":
            comment = f"# {text}\n" if text != "{}" else ""
            return (comment + "#\n".join(_lines_of(points, " ") for points in clean)).encode()
        case ".bin":
            stack = np.stack(clean).astype("<f8")
            buffer.write(struct.pack("<5I", _MAGIC, _TYPES.index("f8"), *stack.shape))
            buffer.write(stack.tobytes())
        case ".npz":
            np.savez(buffer, points=np.stack(clean), meta=np.array(text))
        case ".npy":
            np.save(buffer, np.stack(clean))
        case ".csv":
            header = ",".join(["set", *axes] if several else axes)
            starts = [f"{k}," if several else "" for k in range(len(clean))]
            rows = map(_lines_of, clean, itertools.repeat(","), starts)
            return f"{header}\n{''.join(rows)}".encode()
    return buffer.getvalue()


def _lines_of(points: Array, blank: str, start: str = "") -> str:
    """Return lines of text, one for each point."""
    return "".join(start + blank.join(map(repr, row)) + "\n" for row in points.tolist())


# ---- Text: UTK's, or values separated by commas or semicolons


def _read_dat(stream: IO[bytes], size: int, name: str) -> list[Array]:
    def rows() -> Iterator[tuple[int, list[str] | Array | None]]:
        before = at = 0  # numbers of lines and of bytes in all earlier blocks
        for chunk in _chunks(stream, size, name):
            if size >= _COMPILED and (found := _numbers(chunk)) is not None:
                lines, runs = found
                for line, points in runs:
                    yield before + line, points
            else:  # lines with other text, which error messages may quote
                texts = _decoded(chunk, at, name)
                lines = len(texts)
                for number, text in enumerate(texts, before + 1):
                    if words := text.split():
                        yield number, None if words[0][0] == "#" else words
            before += lines
            at += len(chunk)

    return _sets_of_rows(rows(), size, name)


def _numbers(chunk: bytes) -> tuple[int, list[tuple[int, Array | None]]] | None:
    """Read lines that contain only numbers. Return None if there is any other line.

    The result is the number of lines, and a list of pairs.
    Successive lines of numbers become one pair: the number of the first line, and the points.
    A comment line becomes the pair of its line number and None. Line numbers start at 1.
    """
    from mcspectra.core._text_kernels import parse_lines

    text = np.frombuffer(chunk, np.uint8)
    most = len(chunk) // 2 + 1
    values, hard = np.empty(most), np.empty((most, 3), np.int64)
    runs = np.empty((2 * chunk.count(b"#") + 1, 4), np.int64)
    lines, _, used, left = parse_lines(text, values, runs, hard)
    if lines < 0:
        return None
    for index, start, end in hard[:left].tolist():
        values[index] = float(chunk[start:end])
        if not math.isfinite(values[index]):
            return None
    return lines, [
        (line + 1, values[start:end].reshape(-1, width) if width else None)
        for line, start, end, width in runs[:used].tolist()
    ]


def _read_csv(stream: IO[bytes], size: int, name: str) -> list[Array]:
    labels: dict[str, int] = {}
    set_of_row: list[int] = []

    def rows() -> Iterator[tuple[int, list[str] | None]]:
        separator, at_top, column = ",", True, None
        for number, line in _lines(stream, size, name):
            line = line.strip()
            if line[:1] == "#":
                continue
            # Spreadsheets with decimal commas write the two numbers 1.5 and 2.5 as "1,5;2,5"
            if at_top and ";" in line:
                separator = ";"
            fields = (line if separator == "," else line.replace(",", ".")).split(separator)
            # Elsewhere in the file, lines contain only numbers
            if at_top or column is not None or '"' in line:
                fields = [field.strip().strip('"') for field in fields]
            if not (fields[0] or any(map(str.strip, fields))):
                if column is None:
                    yield number, None
                continue
            if at_top:
                at_top = False
                if all(_number(field) is None for field in fields):
                    # This line names the columns. One of them may be the number of the set
                    names = [field.lower() for field in fields]
                    if "" in names:
                        raise FileFormatError(
                            f"{name} has a column without a name, such as the index that pandas "
                            "writes; write it with index=False, or name all columns."
                        )
                    if names.count("set") > 1:
                        raise FileFormatError(
                            f"{name} has two columns 'set'; name each column differently."
                        )
                    column = names.index("set") if "set" in names else None
                    continue
            if column is not None:
                label = fields.pop(column) if column < len(fields) else ""
                if label not in labels:
                    labels[label] = len(labels)
                    check_decoded_size(name, size, _SET_BYTES * len(labels))
                set_of_row.append(labels[label])
            yield number, fields

    sets = _sets_of_rows(rows(), size, name)
    return _split(sets[0], np.array(set_of_row)) if labels else sets


def _lines(stream: IO[bytes], size: int, name: str) -> Iterator[tuple[int, str]]:
    """Yield lines of text with their numbers, from 1.

    Only the first of several consecutive blank lines is returned: there may be millions of them.
    """
    number = at = 0
    blank = False
    for chunk in _chunks(stream, size, name):
        for line in _decoded(chunk, at, name):
            number += 1
            before, blank = blank, not line or line.isspace()
            if not (before and blank):
                yield number, line
        at += len(chunk)


def _decoded(chunk: bytes, at: int, name: str) -> list[str]:
    """Return the lines of the text that begins at byte `at` of the file."""
    try:
        return chunk.decode("utf-8" if at else "utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise FileFormatError(
            f"{name} is not text: byte {at + error.start} is no character."
        ) from None


def _chunks(stream: IO[bytes], size: int, name: str) -> Iterator[bytes]:
    """Yield whole lines of text, in blocks of about `_BLOCK` bytes, after a check of memory."""
    fields = lines = begun = 0
    while data := stream.read(_BLOCK):
        block = np.frombuffer(data, np.uint8)
        # Count the bytes of each line that ends in this block, and of the incomplete last line
        ends = np.flatnonzero(block == ord("\n")) + 1
        sizes = np.diff(ends, prepend=-begun, append=len(block))
        if sizes.max() > _LONGEST_LINE:
            number = lines + int(np.argmax(sizes > _LONGEST_LINE)) + 1
            raise FileFormatError(
                f"{name}, line {number}, is longer than {_LONGEST_LINE} bytes; split it."
            )
        lines, begun = lines + len(ends), int(sizes[-1])
        blank = (block <= ord(" ")) | (block == ord(",")) | (block == ord(";"))
        fields += 1 + int(np.count_nonzero(blank[:-1] & ~blank[1:]))
        check_decoded_size(name, size, _VALUE_BYTES * fields)
    stream.seek(0)
    rest = b""
    for data in itertools.chain(iter(lambda: stream.read(_BLOCK), b""), [b""]):
        # Take all complete lines. At the end of the file, also take the last line
        whole, end, rest = (rest + data).rpartition(b"\n") if data else (rest, b"\n", b"")
        if whole or (end and data):
            yield whole + end


def _sets_of_rows(
    rows: Iterable[tuple[int, list[str] | Array | None]], size: int, name: str
) -> list[Array]:
    """Convert rows to arrays, one for each set.

    A row is a line number and the fields of the line. If the fields are None, a new set begins.
    Instead of the fields of one line, a row may have an array with the points of several lines.
    The line number of such an array is the number of its first line.
    """
    sets: list[Array] = []
    points = array("d")
    start, width = 0, 0
    for number, fields in itertools.chain(rows, [(0, None)]):
        if fields is None:
            if points:
                sets.append(np.array(points).reshape(-1, width))
                points = array("d")
                check_decoded_size(name, size, _SET_BYTES * len(sets))
            continue
        numbers = fields.shape[1] if isinstance(fields, np.ndarray) else len(fields)
        if not points:
            start, width = number, numbers
        if not width:
            raise FileFormatError(f"{name} has no coordinates; give a column for each axis.")
        if numbers != width:
            raise FileFormatError(
                f"{name}, line {number}, has {counted(numbers, 'number')}, but the set began with "
                f"{width} on line {start}; give all points of a set the same number of dims."
            )
        if isinstance(fields, np.ndarray):
            points.frombytes(fields.tobytes())
            continue
        try:
            values = list(map(float, fields))
        except ValueError:
            values = []
        # Reject underscores: only Python reads 1_0 as 10
        if not (values and math.isfinite(sum(values))) or "_" in "".join(fields):
            for text in fields:
                value = _number(text)
                if value is None or not math.isfinite(value) or "_" in text:
                    raise FileFormatError(
                        f"{name}, line {number}: {text.strip()[:40]!r} is not a finite number."
                    )
        points.extend(values)
    if not sets:
        raise FileFormatError(f"{name} holds no points; give a line of coordinates for each.")
    return sets


def _number(text: str) -> float | None:
    """Return the number in a text, or None if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return None


def _split(points: Array, set_of_row: Array) -> list[Array]:
    """Split points into sets. `set_of_row` is the index of the set of each point, from 0."""
    order = np.argsort(set_of_row, kind="stable")
    return np.split(points[order], np.cumsum(np.bincount(set_of_row))[:-1])


# ---- Bytes: UTK binary


def _read_bin(stream: IO[bytes], size: int, name: str) -> Array:
    """Read all sets as an array of shape (R, n, d)."""
    data = stream.read(_HEADER_BYTES)
    if len(data) < _HEADER_BYTES:
        raise FileFormatError(f"{name} ends at byte {len(data)}, within the header of 20 bytes.")
    order = next((o for o in "<>" if struct.unpack_from(o + "I", data)[0] == _MAGIC), None)
    if order is None:
        raise FileFormatError(
            f"{name} begins with {data[:4].hex()}, not with the magic word 55544b21 (UTK!) of UTK "
            "binary files."
        )
    code, shape = data[4], struct.unpack_from(order + "3I", data, 8)
    if code >= len(_TYPES):
        raise FileFormatError(f"{name}, byte 4: the type code is {code}; UTK has 0 to 5.")
    announced = f"{name} announces {shape[0]} sets of {shape[1]} points in {shape[2]} dims"
    if 0 in shape:
        raise FileFormatError(f"{announced}; each must be at least 1.")
    dtype = np.dtype(order + _TYPES[code])
    count = shape[0] * shape[1] * shape[2]
    if size - _HEADER_BYTES != count * dtype.itemsize:
        raise FileFormatError(
            f"{announced}, that is {count * dtype.itemsize} bytes after the header, but has "
            f"{size - _HEADER_BYTES}."
        )
    # Files of integers need memory for two more copies of the numbers.
    # One copy has the integers in the byte order of this machine.
    # The other copy has the integers without the bits that do not fit into a double
    copies = 1 if dtype.kind == "f" else 3
    check_decoded_size(name, size, count * (copies * dtype.itemsize + 17) + shape[0] * _SET_BYTES)
    values = np.fromfile(stream, dtype, count).reshape(shape)
    if dtype.kind != "f":  # integers become fractions of the range of their type (UTK)
        bits = 8 * dtype.itemsize - (dtype.kind == "i")
        # Drop bits that do not fit into a double. Otherwise 2^64 - 1 would become 1.0
        spare = max(0, bits - 53)
        shifted = values.astype(dtype.newbyteorder("=")) >> spare
        values = np.ldexp(shifted.astype(np.float64), spare - bits)
    return values
