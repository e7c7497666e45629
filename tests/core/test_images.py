"""Reading pictures: values, orientation, alpha, layers, and all kinds of broken files."""

import io
import os
import struct
import threading
import zlib

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.core.images import luminance, read_image

RAMP = np.arange(2 * 3 * 4, dtype=np.uint8).reshape(2, 3, 4) * 10  # 2 high, 3 wide, RGBA
EXR_HEADER = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}


def srgb_to_linear(v):
    """The definition, for one number at a time."""
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


def write_png(path, pixels, mode):
    Image.frombytes(mode, pixels.shape[1::-1], np.ascontiguousarray(pixels).tobytes()).save(path)
    return path


def write_exr(path, channels):
    OpenEXR.File(dict(EXR_HEADER), channels).write(str(path))
    return path


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_bytes(width, height, rows=b""):
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        [
            png_chunk(b"IHDR", head),
            png_chunk(b"IDAT", zlib.compress(rows)),
            png_chunk(b"IEND", b""),
        ]
    )


def exr_bytes(tmp_path):
    pixels = np.random.default_rng(1).random((8, 8, 3)).astype(np.float32)
    return write_exr(tmp_path / "whole.exr", {"RGB": pixels}).read_bytes()


def npy_bytes(values, **options):
    stream = io.BytesIO()
    np.save(stream, values, **options)
    return stream.getvalue()


CLAIM = npy_bytes(np.ones((9, 9))).replace(b"(9, 9), }        ", b"(99999, 99999), }")


def test_color_png_is_decoded_from_srgb_and_alpha_dropped(tmp_path):
    image = read_image(write_png(tmp_path / "a.png", RAMP, "RGBA"))
    assert image.shape == (2, 3, 3)
    assert image.dtype == np.float64
    expected = np.vectorize(srgb_to_linear)(RAMP[..., :3] / 255)
    np.testing.assert_allclose(image, expected, rtol=1e-14)


def test_linear_leaves_values_alone(tmp_path):
    image = read_image(write_png(tmp_path / "a.png", RAMP, "RGBA"), linear=True)
    np.testing.assert_array_equal(image, RAMP[..., :3] / 255)


def test_nothing_is_printed_for_a_broken_exr(tmp_path, capfd):
    """OpenEXR printed a warning to standard output, and the raw file name to standard error."""
    path = tmp_path / "a\x1b[2J\nFORGED.exr"
    write_exr(
        path, {c: np.random.default_rng(1).random((16, 16)).astype(np.float32) for c in "RGB"}
    )
    whole = path.read_bytes()
    for size in range(300, len(whole), 97):
        path.write_bytes(whole[:size])
        with pytest.raises(FileFormatError):
            read_image(path)
    assert capfd.readouterr() == ("", "")


def test_other_threads_print_while_an_exr_is_read(tmp_path, capfd):
    path = tmp_path / "a.exr"
    write_exr(path, {"Y": np.ones((256, 256), np.float32)})
    stop = threading.Event()

    def tell():
        for k in range(10_000):
            os.write(1, b"line %d\n" % k)
            if stop.is_set():
                return

    teller = threading.Thread(target=tell)
    teller.start()
    for _ in range(50):
        read_image(path)
    stop.set()
    teller.join()
    lines = capfd.readouterr().out.splitlines()
    assert lines
    assert sorted(int(line.split()[1]) for line in lines) == list(range(len(lines)))


@pytest.mark.parametrize(("mode", "planes"), [("L", 1), ("LA", 2)])
def test_gray_has_one_channel(tmp_path, mode, planes):
    pixels = RAMP[..., 0] if planes == 1 else RAMP[..., :2]
    image = read_image(write_png(tmp_path / "g.png", pixels, mode), linear=True)
    np.testing.assert_array_equal(image, RAMP[..., :1] / 255)


def test_gray_of_16_bits_keeps_them(tmp_path):
    pixels = np.array([[0, 1, 256], [257, 40_000, 65_535]], np.uint16)
    image = read_image(write_png(tmp_path / "g.png", pixels, "I;16"), linear=True)
    np.testing.assert_array_equal(image[..., 0], pixels / 65535)


def test_palette_with_alpha(tmp_path):
    path = tmp_path / "p.png"
    picture = Image.new("P", (2, 1))
    picture.putpalette([255, 0, 0, 0, 0, 255])
    picture.putpixel((1, 0), 1)
    picture.save(path, transparency=bytes([255, 0]))
    np.testing.assert_array_equal(read_image(path)[0], [[1, 0, 0], [0, 0, 1]])


@pytest.mark.parametrize("suffix", [".jpg", ".JPEG"])
def test_jpeg(tmp_path, suffix):
    path = tmp_path / f"flat{suffix}"
    Image.new("RGB", (16, 8), (188, 188, 188)).save(path, "JPEG", quality=100)
    image = read_image(path)
    assert image.shape == (8, 16, 3)
    # The values of a flat block are its mean; JPEG may round it by one step of 255
    np.testing.assert_allclose(image, srgb_to_linear(188 / 255), atol=1 / 100)


def test_first_row_is_the_top(tmp_path):
    picture = Image.new("L", (3, 2))
    picture.putpixel((2, 0), 255)  # Pillow uses (x, y) with y down
    picture.save(tmp_path / "top.png")
    image = read_image(tmp_path / "top.png")
    assert image[0, 2, 0] == 1
    assert image.sum() == 1


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
@pytest.mark.parametrize("name", ["RGB", "RGBA"])
def test_exr_of_plain_channels(tmp_path, dtype, name):
    pixels = np.random.default_rng(1).random((4, 6, len(name))).astype(dtype)
    image = read_image(write_exr(tmp_path / "a.exr", {name: pixels}))
    np.testing.assert_array_equal(image, pixels[..., :3].astype(np.float64))


def test_exr_layers_and_luminance(tmp_path):
    plane = np.random.default_rng(1).random((4, 6)).astype(np.float32)
    layered = {"Z": plane, "b.light.R": plane, "b.light.G": plane + 1, "b.light.B": plane + 2}
    image = read_image(write_exr(tmp_path / "layered.exr", layered))
    np.testing.assert_array_equal(image, np.stack([plane, plane + 1, plane + 2], -1))
    gray = read_image(write_exr(tmp_path / "y.exr", {"Y": plane, "Z": plane + 1}))
    np.testing.assert_array_equal(gray, plane[..., None])


@pytest.mark.parametrize("shape", [(2, 3), (2, 3, 1), (2, 3, 5)])
def test_numpy_arrays_are_read_unchanged(tmp_path, shape):
    values = np.arange(np.prod(shape), dtype=np.int16).reshape(shape) - 3
    np.save(tmp_path / "a.npy", values)
    np.savez(tmp_path / "a.npz", other=np.zeros(2), image=values)
    for name in ("a.npy", "a.npz"):
        image = read_image(tmp_path / name)
        assert image.dtype == np.float64
        np.testing.assert_array_equal(image, values.reshape(2, 3, -1))


def test_luminance_is_rec709():
    assert luminance(np.ones((1, 1, 3)))[0, 0] == pytest.approx(1, rel=1e-15)
    assert luminance(np.array([[[0.0, 1.0, 0.0]]]))[0, 0] == 0.7152
    np.testing.assert_array_equal(luminance(np.full((2, 3, 1), 0.5)), np.full((2, 3), 0.5))
    for shape in [(2, 3), (2, 3, 2), (2, 3, 4)]:
        with pytest.raises(ParameterError, match="height, width, 1 or 3"):
            luminance(np.ones(shape))


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("none.png", None, "no file"),
        ("nul\0l.png", None, "is not a path"),
        ("x" * 4000 + ".png", None, "too long"),
        ("folder.png", "folder", "a folder"),
        ("picture.tiff", b"II*\0", "does not end in"),
        ("picture", b"", "does not end in"),
        ("empty.png", b"", "cannot be read"),
        ("text.png", b"hello", "cannot be read"),
        ("gif.png", b"GIF89a\1\0\1\0", "cannot be read"),
        ("cut.png", png_bytes(64, 64, bytes(100)), "cannot be read"),
        ("half.png", png_bytes(4, 4, bytes(20))[:45], "cannot be read"),
        ("empty.jpg", b"", "cannot be read"),
        ("cut.jpg", b"\xff\xd8\xff\xe0\x00\x10JFIF", "cannot be read"),
        ("empty.exr", b"", "cannot be read"),
        ("text.exr", b"hello", "cannot be read"),
        ("empty.npy", b"", "cannot be read"),
        ("text.npy", b"hello", "cannot be read"),
        ("cut.npy", npy_bytes(np.ones((9, 9)))[:-8], "cannot be read"),
        ("claim.npy", CLAIM, "announces an array of shape"),
        ("pickle.npy", npy_bytes(np.array([{}]), allow_pickle=True), "cannot be read"),
        ("empty.npz", b"", "cannot be read"),
        ("text.npz", b"hello", "cannot be read"),
        ("line.npy", npy_bytes(np.ones(4)), r"\(4,\)"),
        ("block.npy", npy_bytes(np.ones((2, 2, 2, 2))), "shape"),
        ("zero.npy", npy_bytes(np.ones((0, 4))), r"\(0, 4\)"),
        ("complex.npy", npy_bytes(np.ones((2, 2), complex)), "real numbers"),
        ("words.npy", npy_bytes(np.full((2, 2), "a")), "real numbers"),
        ("nan.npy", npy_bytes(np.array([[1, np.nan]])), "1 NaN"),
        ("inf.npy", npy_bytes(np.array([[np.inf, np.inf]])), "2 NaN or inf"),
    ],
)
def test_bad_files_are_one_sentence(tmp_path, name, content, says):
    path = tmp_path / name
    if content == "folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    with pytest.raises(FileFormatError, match=says) as caught:
        read_image(path)
    assert "\n" not in str(caught.value)
    assert caught.value.__suppress_context__ or caught.value.__context__ is None


@pytest.mark.parametrize("keep", [4, 40, 200, -9])
def test_truncated_exr(tmp_path, keep, capfd):
    (tmp_path / "cut.exr").write_bytes(exr_bytes(tmp_path)[:keep])
    with pytest.raises(FileFormatError, match="truncated"):
        read_image(tmp_path / "cut.exr")


def test_exr_without_a_picture(tmp_path):
    path = write_exr(tmp_path / "z.exr", {"Z": np.ones((2, 2), np.float32)})
    with pytest.raises(FileFormatError, match="channels Z; R, G and B, or Y"):
        read_image(path)


def test_npz_with_several_arrays(tmp_path):
    np.savez(tmp_path / "two.npz", a=np.ones((2, 2)), b=np.ones((2, 2)))
    with pytest.raises(FileFormatError, match="'image'"):
        read_image(tmp_path / "two.npz")


@pytest.mark.parametrize("path", [None, 3, "", b"a.png", ["a.png"]])
def test_paths_of_the_wrong_type(path):
    with pytest.raises(FileFormatError, match="is not a path"):
        read_image(path)


@pytest.mark.parametrize("image", [None, "text", 3, [[1, [2]]], np.ones((2, 2, 3), complex)])
def test_luminance_of_invalid_images_raises(image):
    with pytest.raises(ParameterError, match="image|images"):
        luminance(image)
