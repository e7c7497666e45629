"""Images from files, as float64 (height, width, channels). Row 0 is at the top.

Conventions
-----------
An image has h rows and w columns.
The pixel in row i and column j contains the points x that satisfy
``j/w <= x[..., 0] < (j+1)/w`` and ``i/h <= x[..., 1] < (i+1)/h``.
The coordinate x[..., 0] increases to the right.
The coordinate x[..., 1] increases *down* from the top row, as film coordinates do.

Radiometry needs linear values.
PNG and JPEG files contain values that are encoded for sRGB (IEC 61966-2-1).
`read_image` decodes these values. ``linear=True`` keeps the values of files with other data.
Values in EXR and NumPy files are already linear, and are never changed.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import math
import os
import re
import sys
import tempfile
import threading
from os import PathLike
from typing import IO, TYPE_CHECKING, Any, final

import numpy as np

from mcspectra.core.checks import Array, as_real_array
from mcspectra.core.decoding import check_decoded_size, opened, read_npy, read_npz
from mcspectra.core.display import shown
from mcspectra.core.errors import FileFormatError, ParameterError
from mcspectra.core.registry import optional_package

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

__all__ = [
    "ENCODED_EXTENSIONS",
    "IMAGE_EXTENSIONS",
    "LINEAR_EXTENSIONS",
    "REC709",
    "Rings",
    "check_picture_size",
    "exr_attributes",
    "exr_layer",
    "load_openexr",
    "luminance",
    "read_image",
]

ENCODED_EXTENSIONS = (".png", ".jpg", ".jpeg")
"""Extensions of sRGB pictures with 8 bits per channel."""

LINEAR_EXTENSIONS = (".exr", ".pfm", ".npy", ".npz")
"""Extensions of image files whose values are used unchanged."""

IMAGE_EXTENSIONS = (*ENCODED_EXTENSIONS, *LINEAR_EXTENSIONS)
"""Extensions that `read_image` can read."""

REC709 = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in the luminance (ITU-R BT.709)."""
_EXR_LINE = re.compile(rb"\(EXR_ERR_\w+\) |^Warning: Exception raised reading pixel data")
_PRINTING = threading.Lock()
_MOST_RINGS = 64
_ENTRIES = 2**20  # number of pixels that are converted at the same time


def read_image(
    path: str | PathLike[str],
    *,
    linear: bool = False,
    layer: str | None = None,
    finite: bool = True,
) -> Array:
    """Read a picture or an array as float64 (height, width, channels).

    Parameters
    ----------
    path
        A file with one of the extensions `IMAGE_EXTENSIONS`.

        * PNG, JPEG: gray images have 1 channel, color images have 3. Values run from 0 to 1.
          The alpha channel is dropped, and colors are not multiplied by it.
          For color PNG of 16 bits, Pillow reads only 8 bits. Gray PNG keeps its 16 bits.
        * EXR: the channels R, G, B of the first layer that has them.
          If no layer has R, G, B, the first channel Y is used.
          The layer without a name is the first. Only pixels of the data window are read.
        * PFM: 1 or 3 channels, unchanged.
        * ``.npy``, ``.npz``: shape (height, width) or (height, width, channels), values unchanged.
          A ``.npz`` file must hold an array called ``image`` or a single array.
    linear
        Whether to use the values of PNG and JPEG unchanged, as if they were linear.
    layer
        Layer of an EXR file to read: its R, G, B, or else its Y, or else its only channel.
    finite
        Whether to reject pixels that are NaN or infinite.

    Raises
    ------
    FileFormatError
        If the file does not exist, is a folder, is broken, or has an unknown extension.
        If it has no pixels or no such layer, or if pixels are NaN or infinite.
        If pixels need more memory than `mcspectra.core.decoding` allows for files of this size.
    MissingDependency
        If the file is an EXR file and OpenEXR is not installed.

    Notes
    -----
    Each file is opened only by the parser for its format. NumPy files are read without pickle.
    """
    with opened(path, "an image", IMAGE_EXTENSIONS) as (stream, size, file, extension):
        match extension:
            case ".exr":
                pixels = _read_exr(file, size, layer)
            case ".pfm":
                pixels = _read_pfm(stream, size, file)
            case ".npy":
                pixels = read_npy(stream, size, file)
            case ".npz":
                pixels = read_npz(stream, size, file, "image", or_only=True)
            case _:
                pixels = _read_pillow(stream, size, file, linear)
    if pixels.dtype.kind not in "fiub":
        raise FileFormatError(f"{file} holds {pixels.dtype} values; real numbers are needed.")
    if pixels.ndim not in (2, 3) or pixels.size == 0:
        raise FileFormatError(
            f"{file} holds an array of shape {pixels.shape}; it must be (height, width) or "
            "(height, width, channels), with no dimension of size 0."
        )
    image = np.asarray(pixels if pixels.ndim == 3 else pixels[..., None], np.float64)
    bad = image.size - int(np.count_nonzero(np.isfinite(image))) if finite else 0
    if bad:
        raise FileFormatError(
            f"{file} has {bad} NaN or infinite values; repair those pixels first."
        )
    return image


def check_picture_size(path: str | PathLike[str]) -> None:
    """Reject a PNG, JPEG or EXR file if its pixels would take too much memory in another library.

    Other files, and those whose header cannot be read, are accepted.

    Raises
    ------
    FileFormatError
        If `mcspectra.core.decoding.check_decoded_size` rejects the size.
    """
    decoded = 0
    try:
        with opened(path, "an image") as (stream, size, file, _):
            head = stream.read(4)
            stream.seek(0)
            if head == b"v/1\x01":
                decoded = _exr_head(file)[1]
            elif head[:2] in (b"\x89P", b"\xff\xd8"):
                image = _pillow_head(stream)
                decoded = 8 * image.width * image.height * len(image.getbands())
    except FileFormatError:
        return
    check_decoded_size(file, size, decoded)


def luminance(image: Array) -> Array:
    """Return the Rec. 709 luminance (height, width) of an image (height, width, 1 or 3).

    The luminance of linear values is Y = 0.2126 R + 0.7152 G + 0.0722 B (ITU-R BT.709).
    A single channel is returned unchanged.

    Raises
    ------
    ParameterError
        If the image has another number of channels.
    """
    image = as_real_array("image", image)
    if image.ndim != 3 or image.shape[2] not in (1, 3):
        raise ParameterError(
            f"Luminance is defined for images of shape (height, width, 1 or 3), not {image.shape}; "
            "choose a channel instead."
        )
    return np.asarray(image[..., 0] if image.shape[2] == 1 else image @ REC709)


def _pillow_head(stream: IO[bytes]) -> PillowImage:
    """Open a PNG or JPEG stream with Pillow, and read only the header."""
    from PIL.JpegImagePlugin import JpegImageFile
    from PIL.PngImagePlugin import PngImageFile

    # Image.open is not used, because it warns about large sizes or rejects them in its own words
    is_png = stream.read(1) == b"\x89"
    stream.seek(0)
    return (PngImageFile if is_png else JpegImageFile)(stream)


def _read_pillow(stream: IO[bytes], size: int, name: str, linear: bool) -> Array:
    """Return values in [0,1] of PNG and JPEG, (height, width, 1 or 3)."""
    image = _pillow_head(stream)
    mode, (width, height) = image.mode, image.size
    # Peak memory: Pillow's picture, its copy, one channel and its bytes, and all float64 channels
    channels = 3 if mode == "P" else len(image.getbands())
    check_decoded_size(name, size, width * height * (8 + 8 * channels))
    if mode not in ("L", "LA", "RGB", "RGBA") and not mode.startswith("I"):
        # Convert palettes to RGBA. Pillow would warn about their alpha if they became RGB
        image = image.convert({"1": "L", "P": "RGBA"}.get(mode, "RGB"))

    # Convert values with a table of all possible values.
    # Gray images may have values of 16 bits; other values have 8 bits
    most = 65535 if mode.startswith("I") else 255
    levels = np.arange(most + 1) / most
    if not linear:  # undo the sRGB transfer function (IEC 61966-2-1)
        power = ((levels + 0.055) / 1.055) ** 2.4
        levels = np.where(levels <= 0.04045, levels / 12.92, power)
    pixels = np.empty((height, width, 3 if image.mode.startswith("RGB") else 1))
    for i in range(pixels.shape[2]):
        channel = image if mode.startswith("I") else image.getchannel(i)
        codes, rows = np.asarray(channel), max(1, _ENTRIES // width)
        for top in range(0, height, rows):
            pixels[top : top + rows, :, i] = levels[codes[top : top + rows]]
    return pixels


def _read_pfm(stream: IO[bytes], size: int, name: str) -> Array:
    """Return values (height, width, 1 or 3) of a portable float map, which begins at the bottom."""
    kind, width, height, scale = b" ".join(stream.readline(99) for _ in range(3)).split()
    shape = int(height), int(width), {b"Pf": 1, b"PF": 3}[kind]
    count = math.prod(shape)
    if min(shape) < 1 or 4 * count > size:
        raise EOFError
    check_decoded_size(name, size, 12 * count)
    values = np.frombuffer(stream.read(4 * count), "<f4" if float(scale) < 0 else ">f4", count)
    return values.reshape(shape)[::-1].astype(np.float64)


def load_openexr() -> Any:
    """Return the package OpenEXR.

    Raises
    ------
    MissingDependency
        If OpenEXR is not installed.
    """
    return optional_package("OpenEXR", "frames", "EXR files need")


def exr_attributes(path: str | PathLike[str]) -> dict[str, object]:
    """Return the header attributes of an EXR file by name.

    If several parts of the file have the same attribute, the value of the first part is returned.

    Raises
    ------
    FileFormatError
        If the file does not exist or is broken.
    """
    with opened(path, "an image", (".exr",)) as (_, _, file, _):
        parts = _exr_file(file, header_only=True).parts
        return {key: part.header[key] for part in reversed(parts) for key in part.header}


def exr_layer(path: str | PathLike[str]) -> str:
    """Return the layer of an EXR file that `read_image` takes by default: '' if unnamed.

    Raises
    ------
    FileFormatError
        If the file does not exist, is broken or has no picture.
    """
    with opened(path, "an image", (".exr",)) as (_, _, file, _):
        parts = _exr_file(file, header_only=True).parts
        listed = {channel.name for part in parts for channel in part.header["channels"]}
        return _picture_channels(file, listed, None)[0].rpartition(".")[0]


def _exr_file(name: str, *, header_only: bool) -> Any:
    """Open an EXR file and suppress the messages that OpenEXR prints for a broken file.

    OpenEXR prints these messages to standard output, and partly through Python's stdout.
    The command line prints its results to standard output as well.
    The messages contain the file's name with its control characters.
    If other threads print lines during this time, these lines are printed afterwards.
    """
    OpenEXR = load_openexr()

    def read() -> Any:
        return OpenEXR.File(name, separate_channels=True, header_only=header_only)

    if os.name != "posix":
        return read()
    with _PRINTING, contextlib.ExitStack() as stack:
        for descriptor in (1, 2):
            try:
                saved = os.dup(descriptor)
            except OSError:  # if standard output is closed, nothing can be printed
                continue
            held = stack.enter_context(tempfile.TemporaryFile())
            os.dup2(held.fileno(), descriptor)
            stack.callback(_put_back, descriptor, saved, held, name)
        text = io.StringIO()
        try:
            with contextlib.redirect_stdout(text):
                return read()
        finally:
            stack.close()
            for line in text.getvalue().splitlines(keepends=True):
                if sys.stdout is not None and not _EXR_LINE.search(line.encode(errors="replace")):
                    sys.stdout.write(line)


def _put_back(descriptor: int, saved: int, held: IO[bytes], name: str) -> None:
    """Restore a file descriptor. Print the lines that were held back, except those of OpenEXR."""
    ctypes.CDLL(None).fflush(None)  # flush the buffers of C, which contain OpenEXR's lines
    os.dup2(saved, descriptor)
    held.seek(0)
    lines = held.read().replace(os.fsencode(name), b"").splitlines(keepends=True)
    with os.fdopen(saved, "wb") as stream:
        stream.writelines(line for line in lines if not _EXR_LINE.search(line))


def _exr_head(name: str) -> tuple[set[str], int, int]:
    """Read the header of an OpenEXR file, which may consist of several parts.

    Return the names of all channels, and the memory in bytes that the values of all parts need.
    Also return the number of pixels of the largest part.
    """
    OpenEXR = load_openexr()
    head = _exr_file(name, header_only=True)
    listed: set[str] = set()
    stored = largest = 0
    for part in head.parts:
        if part.type() in (OpenEXR.deepscanline, OpenEXR.deeptile):
            raise FileFormatError(f"{name} has deep pixels; flatten the image first.")
        low, high = (corner.tolist() for corner in part.header["dataWindow"])
        pixels = math.prod(b - a + 1 for a, b in zip(low, high, strict=True))
        tiles = part.header.get("tiles")
        tile = tiles.xSize * tiles.ySize if tiles else 0
        listed |= {channel.name for channel in part.header["channels"]}
        stored += 4 * len(part.header["channels"]) * (pixels + tile)  # a value has 2 or 4 bytes
        largest = max(largest, pixels)
    return listed, stored, largest


def _read_exr(name: str, size: int, layer: str | None) -> Array:
    listed, stored, largest = _exr_head(name)
    names = _picture_channels(name, listed, layer)
    # Reading needs memory for the float64 values of the image and for a mask of its pixels
    check_decoded_size(name, size, stored + 9 * len(names) * largest)
    parts = _exr_file(name, header_only=False).parts
    planes = {name: c.pixels for part in reversed(parts) for name, c in part.channels.items()}
    if any(planes.get(name) is None for name in names):
        raise EOFError
    return np.stack([planes[name] for name in names], axis=-1, dtype=np.float64)


def _picture_channels(name: str, listed: set[str], layer: str | None) -> list[str]:
    """Return R, G, B, or else Y, of the first layer that has them. Unnamed layers come first."""
    layers = sorted({channel.rpartition(".")[0] for channel in listed})
    if layer is not None and layer not in (*layers, *listed):
        raise FileFormatError(
            f"{name} has no layer {shown(layer)}, but "
            f"{', '.join(map(repr, (*layers, *sorted(listed))))}."
        )
    offers = [
        [f"{each}.{c}" if each else c for c in cs]
        for cs in ("RGB", "Y")
        for each in (layers if layer is None else [layer])
    ]
    if layer is not None:  # take the channel of this name, or the only channel of the layer
        own = [c for c in listed if c.rpartition(".")[0] == layer]
        offers += [[layer], own[:1] if len(own) == 1 else [""]]
    names = next((offer for offer in offers if listed.issuperset(offer)), None)
    if names is None:
        raise FileFormatError(
            f"{name} has the channels {', '.join(sorted(listed)) or 'none'}; "
            "R, G and B, or Y, are needed."
        )
    return names


@final
class Rings:
    """Rings of radial frequency for `numpy.fft.rfft2`, of equal widths, up to 1/2 cycle per pixel.

    Attributes
    ----------
    radius
        Central radius of each ring, in cycles per pixel.
    sizes
        Number of frequencies in each ring. It is NaN for a ring without frequencies.
    """

    def __init__(self, height: int, width: int) -> None:
        count = min(_MOST_RINGS, max(1, min(height, width) // 2))
        across = np.fft.rfftfreq(width)
        distance = np.hypot(np.fft.fftfreq(height)[:, None], across)
        self._ring = np.minimum((distance * 2 * count).astype(int), count).ravel()
        # Columns of positive frequencies also represent the frequencies of opposite sign
        both = np.where((across > 0) & (across < 0.5), 2.0, 1.0)
        self._weight = np.broadcast_to(both, distance.shape)
        sizes = np.bincount(self._ring, self._weight.ravel(), count + 1)
        self.sizes = np.where(sizes > 0, sizes, np.nan)[:-1]
        self.radius = (np.arange(count) + 0.5) / (2 * count)

    def mean(self, power: Array) -> Array:
        """Return the mean power over each ring of frequencies."""
        sums = np.bincount(self._ring, (power * self._weight).ravel(), self.sizes.size + 1)
        return np.asarray(sums[:-1] / self.sizes)

    def sums(self, power: Array, rows: slice) -> Array:
        """Return the sums of the power (…, rows, x) over each ring, for some rows of frequencies.

        The last entry of the result is the total power at 1/2 cycle per pixel and above.
        """
        width = self._weight.shape[1]
        ring = self._ring.reshape(-1, width)[rows].ravel()
        flat = (power * self._weight[rows]).reshape(-1, ring.size)
        sums = [np.bincount(ring, each, self.sizes.size + 1) for each in flat]
        return np.reshape(sums, (*power.shape[:-2], self.sizes.size + 1))
