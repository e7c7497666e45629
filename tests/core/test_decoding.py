"""Files that are small on disk and huge in memory: rejected before decoding, in one sentence."""

import io
import json
import resource
import struct
import subprocess
import sys
import zipfile
import zlib

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from mcspectra.core import decoding
from mcspectra.core.errors import FileFormatError
from mcspectra.core.images import read_image
from mcspectra.core.pointfiles import read_points, write_points

MEMORY = 3 * 2**30  # bytes of address space for a reader

READ = """
import sys, mcspectra.core.images as i, mcspectra.core.pointfiles as p, OpenEXR
for path in sys.argv[1:]:
    try:
        (i.read_image if "image" in path else p.read_points)(path)
    except p.FileFormatError as error:
        print(error)
"""


def in_a_small_process(*paths):
    """Return the messages of a process with limited memory for each file."""
    limit = lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    command = [sys.executable, "-c", READ, *map(str, paths)]
    done = subprocess.run(
        command, capture_output=True, text=True, preexec_fn=limit, check=True, timeout=60
    )
    return done.stdout.splitlines()


def zeros_npy(stream, shape, dtype):
    """Write an array of zeros without allocating it."""
    head = {"descr": np.dtype(dtype).str, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, head)
    blocks, rest = divmod(int(np.prod(shape)) * np.dtype(dtype).itemsize, 2**22)
    for _ in range(blocks):
        stream.write(bytes(2**22))
    stream.write(bytes(rest))


def zeros_npz(path, member, shape, dtype, method=zipfile.ZIP_DEFLATED):
    with (
        zipfile.ZipFile(path, "w", method, compresslevel=1) as archive,
        archive.open(member, "w", force_zip64=True) as stream,
    ):
        zeros_npy(stream, shape, dtype)
    return path


def png(path, width, height, rows=b"", color=0):
    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, color, 0, 0, 0))
    data = chunk(b"IDAT", zlib.compress(rows))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + data + chunk(b"IEND", b""))
    return path


def exr(path, pixels, **header):
    kind = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File({**kind, **header}, {"RGB": pixels}).write(str(path))
    return path


def exr_window(path, *window):
    """Write an EXR whose header has another data window."""
    whole = exr(path, np.zeros((8, 8, 3), np.float16)).read_bytes()
    at = whole.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    path.write_bytes(whole[:at] + struct.pack("<4i", *window) + whole[at + 16 :])
    return path


def sparse_npy(path, shape, dtype):
    with path.open("wb") as stream:
        head = {"descr": np.dtype(dtype).str, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(stream, head)
        stream.truncate(stream.tell() + int(np.prod(shape)) * np.dtype(dtype).itemsize)
    return path


BOMBS = {
    "zip of points": lambda d: zeros_npz(d / "p.npz", "points.npy", (2**25, 2), "<f2"),
    "zip of an image": lambda d: zeros_npz(d / "image.npz", "image.npy", (2**12, 2**14), "<f8"),
    "half floats": lambda d: sparse_npy(d / "image.npy", (2**14, 2**15), "<f2"),
    "gray PNG": lambda d: png(d / "image.png", 40_000, 40_000, bytes(2**24)),
    "PNG that Pillow would warn of": lambda d: png(d / "image.png", 10_000, 10_000),
    "color PNG": lambda d: png(d / "image.png", 9_400, 9_400, bytes(2**24), color=2),
    "zeros in EXR": lambda d: exr(d / "image.exr", np.zeros((2**12, 2**12, 3), np.float16)),
    "wide EXR": lambda d: exr_window(d / "image.exr", 0, 0, 2**20, 2**20),
}
DAMAGED = {
    "tall EXR": lambda d: exr_window(d / "image.exr", 0, 0, 0, 2**31 - 2),
    "endless EXR": lambda d: exr_window(d / "image.exr", -(2**31), -(2**31), 2**31 - 1, 2**31 - 1),
    "bzip2": lambda d: zeros_npz(
        d / "p.npz", "points.npy", (2**22, 2), "<f8", method=zipfile.ZIP_BZIP2
    ),
}


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """Messages of one process with limited memory for all files."""
    makers = {**BOMBS, **DAMAGED}
    paths = [make(tmp_path_factory.mktemp("bomb")) for make in makers.values()]
    return dict(zip(makers, in_a_small_process(*paths), strict=True))


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_are_rejected_by_their_decoded_size(answers, name):
    assert "MB of memory to read; a file of this size may take" in answers[name]
    assert answers[name].endswith(".")


@pytest.mark.parametrize("name", DAMAGED)
def test_files_that_hide_their_size_are_rejected(answers, name):
    assert "Traceback" not in answers[name]
    assert answers[name].endswith(".")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("p.dat", b"0.5 0.25\n" * 2000),
        ("p.dat", b"0\n#\n" * 200),
        ("p.csv", b"0.5,0.25\n" * 2000),
        ("p.csv", b"0\n\n" * 200),
        ("p.csv", b"set,x\n" + b"".join(b"%d,0\n" % i for i in range(200))),
        ("p.bin", struct.pack("<5I", 0x214B5455, 4, 1, 2000, 2) + bytes(16_000)),
        ("p.bin", struct.pack("<5I", 0x214B5455, 4, 200, 1, 1) + bytes(800)),
    ],
)
def test_points_and_sets_count(tmp_path, monkeypatch, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    assert read_points(path)
    monkeypatch.setattr(decoding, "_MOST_BYTES", 30_000)
    with pytest.raises(FileFormatError, match="may take 0 MB: make a smaller version"):
        read_points(path)


def test_sets_count_in_tables_too(tmp_path, monkeypatch):
    path = tmp_path / "p.npz"
    write_points(path, [np.full((1, 1), 0.5)] * 200)
    assert len(read_points(path)) == 200
    monkeypatch.setattr(decoding, "_MOST_BYTES", 30_000)
    with pytest.raises(FileFormatError, match="make a smaller version"):
        read_points(path)


def test_the_limit_is_64_times_the_file_size_between_256_mib_and_2_gib():
    decoding.check_decoded_size("f", 1, 2**28)
    decoding.check_decoded_size("f", 2**23, 2**29)
    decoding.check_decoded_size("f", 2**40, 2**31)
    for size, decoded in ((1, 2**28 + 1), (2**23, 2**29 + 1), (2**40, 2**31 + 1)):
        with pytest.raises(FileFormatError, match=f"f, of {size} bytes, would take"):
            decoding.check_decoded_size("f", size, decoded)


def test_headers_are_limited(tmp_path):
    """A member whose header alone claims 4 GB, and negative shapes."""
    long = b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**32 - 1) + b" " * 2**20
    with zipfile.ZipFile(tmp_path / "p.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", long)
    with pytest.raises(FileFormatError, match="cannot be read as a point set"):
        read_points(tmp_path / "p.npz")
    head = io.BytesIO()
    shape = {"descr": "<f8", "fortran_order": False, "shape": (-1, 2)}
    np.lib.format.write_array_header_1_0(head, shape)
    (tmp_path / "a.npy").write_bytes(head.getvalue() + bytes(160))
    with pytest.raises(FileFormatError, match=r"announces an array of shape \(-1, 2\)"):
        read_image(tmp_path / "a.npy")


def test_large_tiles_and_deep_pixels(tmp_path):
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 2**14
    path = tmp_path / "image.exr"
    exr(path, np.zeros((4, 4, 3), np.float16), type=OpenEXR.tiledimage, tiles=tiles)
    with pytest.raises(FileFormatError, match="make a smaller version"):
        read_image(path)
    deep = np.empty((2, 2), dtype=object)
    for at in np.ndindex(2, 2):
        deep[at] = np.zeros(3, np.float32)
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline}
    OpenEXR.File(header, {"Y": deep}).write(str(path))
    with pytest.raises(FileFormatError, match="deep pixels; flatten"):
        read_image(path)


ORDINARY = {
    "p.dat": lambda x: write(x, 30_000, 2),
    "p.csv": lambda x: write(x, 20_000, 3),
    "p.bin": lambda x: write_points(x, [np.random.default_rng(0).random((400_000, 2))]),
    "p.npz": lambda x: np.savez(x, points=np.random.default_rng(0).random((9, 50_000, 2), "f4")),
    "image.npy": lambda x: np.save(x, np.random.default_rng(0).random((512, 512, 3), "f4")),
    "image.exr": lambda x: exr(x, np.random.default_rng(0).random((512, 512, 3), "f4")),
    "image.png": lambda x: Image.effect_noise((1024, 512), 50).convert("RGB").save(x),
    "image.jpg": lambda x: Image.effect_noise((1024, 512), 50).save(x),
}


def write(path, rows, columns):
    names = ",".join(["set", "x", "y"][:columns]) + "\n"
    separator = "," if path.suffix == ".csv" else " "
    row = separator.join(["0.123456789012345"] * columns) + "\n"
    path.write_text((names if path.suffix == ".csv" else "") + row * rows)


PEAKS = """
import json, sys, tracemalloc
from mcspectra.core import decoding, images, pointfiles

announced = []
for module in (decoding, images, pointfiles):
    module.check_decoded_size = lambda name, size, decoded: announced.append(decoded)
for path in sys.argv[1:]:
    read = images.read_image if "image" in path else pointfiles.read_points
    read(path)  # imports and tables
    announced.clear()
    peaks = []
    for _ in range(3):  # other work of the process may only add to what the reader needs
        tracemalloc.start()
        read(path)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    print(json.dumps([min(peaks), max(announced)]))
"""


def test_readers_use_at_most_the_announced_memory(tmp_path):
    """Ordinary files are read. A separate process runs, as other threads' memory also counts."""
    for name, make in ORDINARY.items():
        make(tmp_path / name)
    paths = [tmp_path / name for name in ORDINARY]
    said = subprocess.run(
        [sys.executable, "-c", PEAKS, *map(str, paths)], check=True, capture_output=True
    )
    for path, line in zip(paths, said.stdout.splitlines(), strict=True):
        peak, announced = json.loads(line)
        # lines become Python strings
        block = 20 * 2**20 if path.suffix in (".dat", ".csv") else 2**20
        assert peak < announced + block, path.name
        assert announced <= 64 * path.stat().st_size, path.name
