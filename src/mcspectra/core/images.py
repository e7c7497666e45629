"""Images from files: float64 (height, width, channels), row 0 at the top.

Conventions
-----------
Pixel (row i, column j) of an image of h rows and w columns covers the points x with
``j/w <= x[..., 0] < (j+1)/w`` and ``i/h <= x[..., 1] < (i+1)/h``: x[..., 0] runs to the right along
the width, x[..., 1] runs *down* from the top row, like film coordinates.

Radiometry needs linear values. PNG and JPEG files hold values encoded by the sRGB transfer
function (IEC 61966-2-1), which is undone unless ``linear=True`` says that a file holds data of
another kind. EXR and NumPy files are linear already and are never changed.
"""

from __future__ import annotations

import math
import struct
import warnings
import zipfile
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from mcspectra.core.checks import Array
from mcspectra.core.errors import FileFormatError, ParameterError

__all__ = ["IMAGE_EXTENSIONS", "REC709", "luminance", "read_image"]

IMAGE_EXTENSIONS = (".png", ".jpg", ".jpeg", ".exr", ".npy", ".npz")
"""Names that `read_image` knows."""

_MAX_VALUES = 2**28  # 2 GiB of float64: far above any film, far below a decompression bomb
REC709 = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in the luminance (ITU-R BT.709)."""
_BROKEN = (
    OSError,
    SyntaxError,  # Pillow's word for a broken PNG
    ValueError,
    EOFError,
    RuntimeError,  # OpenEXR's word
    LookupError,
    MemoryError,
    struct.error,
    zipfile.BadZipFile,
)


def read_image(path: str | PathLike[str], *, linear: bool = False) -> Array:
    """Read a picture or an array as float64 (height, width, channels).

    Parameters
    ----------
    path
        A file with one of the names `IMAGE_EXTENSIONS`.

        * PNG, JPEG: gray gives 1 channel, color 3; alpha is dropped, not multiplied in. Values run
          from 0 to 1. Pillow reads color PNG of 16 bits with 8 (gray keeps its 16).
        * EXR: the R, G, B of the first layer that has them (the nameless layer first), else the
          first Y, in the data window.
        * ``.npy``, ``.npz``: shape (height, width) or (height, width, channels), values as they
          are; in ``.npz`` the array called ``image``, or the only one.
    linear
        Take the values of PNG and JPEG as they are, without undoing the sRGB transfer function.

    Raises
    ------
    FileFormatError
        No such file, a folder, an unknown name, broken or truncated, too large (2^28 values), no
        pixels, or pixels that are NaN or infinite.

    Notes
    -----
    The image file is opened with parsers for these formats only, and NumPy files without pickle.
    """
    file = _existing(path)
    try:
        pixels = _pixels(file, linear)
    except FileFormatError:
        raise
    except _BROKEN as error:
        system = error.strerror if isinstance(error, OSError) and error.errno else None
        reason = system or "it is truncated, damaged or of another format"
        raise FileFormatError(
            f"{file} cannot be read as {file.suffix.lower()}: {reason}."
        ) from None
    return _checked(pixels, file)


def luminance(image: Array) -> Array:
    """Return the Rec. 709 luminance (height, width) of an image (height, width, 1 or 3).

    Y = 0.2126 R + 0.7152 G + 0.0722 B of linear values (ITU-R BT.709); one channel is itself.

    Raises
    ------
    ParameterError
        The image has another number of channels.
    """
    if image.ndim != 3 or image.shape[2] not in (1, 3):
        raise ParameterError(
            f"Luminance is defined for images of shape (height, width, 1 or 3), not {image.shape}; "
            "choose a channel instead."
        )
    return np.asarray(image[..., 0] if image.shape[2] == 1 else image @ REC709)


def _existing(path: object) -> Path:
    if not isinstance(path, str | PathLike) or not str(path):
        raise FileFormatError(f"{path!r} is not the path of an image; give a file name.")
    file = Path(path)
    if file.suffix.lower() not in IMAGE_EXTENSIONS:
        raise FileFormatError(
            f"{file} does not end in one of {', '.join(IMAGE_EXTENSIONS)}; convert the image."
        )
    try:
        kind = "" if file.is_file() else "a folder" if file.is_dir() else "no file"
    except (OSError, ValueError):  # a name too long, or with a null character
        kind = "no file"
    if kind:
        raise FileFormatError(f"{file} is {kind}; give the path of an image.")
    return file


def _pixels(file: Path, linear: bool) -> Array:
    suffix = file.suffix.lower()
    if suffix == ".exr":
        return _read_exr(file)
    if suffix in (".npy", ".npz"):
        return _read_numpy(file)
    stored = _read_pillow(file)
    return stored if linear else _decode_srgb(stored)


def _read_pillow(file: Path) -> Array:
    """Values in [0,1] as stored, (height, width, 1 or 3)."""
    from PIL import Image

    with warnings.catch_warnings():
        # Pillow warns from 2^26 pixels and refuses from twice that; here both are refused.
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        try:
            with Image.open(file, formats=("PNG", "JPEG")) as image:
                return _normalized(image)
        except (Image.DecompressionBombError, Image.DecompressionBombWarning):
            raise _too_large(file) from None


def _normalized(image: Any) -> Array:
    if image.mode.startswith("I"):  # 16-bit gray; "I" holds the same numbers in 32 bits
        return np.asarray(image, np.float64)[..., None] / 65535.0
    if image.mode in ("1", "L", "LA"):
        return np.asarray(image.convert("LA"), np.float64)[..., :1] / 255.0
    # By way of RGBA, as palettes may hold alpha that RGB alone complains about
    mode = "RGBA" if image.mode in ("P", "PA") else "RGB"
    return np.asarray(image.convert(mode), np.float64)[..., :3] / 255.0


def _decode_srgb(encoded: Array) -> Array:
    """Undo the sRGB transfer function (IEC 61966-2-1)."""
    power = ((encoded + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, encoded / 12.92, power)


def _read_exr(file: Path) -> Array:
    import OpenEXR

    head = OpenEXR.File(str(file), separate_channels=True, header_only=True)
    for part in head.parts:
        low, high = (corner.tolist() for corner in part.header["dataWindow"])
        pixels = math.prod(b - a + 1 for a, b in zip(low, high, strict=True))
        if pixels * len(part.header["channels"]) > _MAX_VALUES:
            raise _too_large(file)
    listed = {channel.name for part in head.parts for channel in part.header["channels"]}
    names = _exr_channels(listed, file)
    found = OpenEXR.File(str(file), separate_channels=True)
    planes = {name: c.pixels for part in reversed(found.parts) for name, c in part.channels.items()}
    if any(planes.get(name) is None for name in names):
        raise EOFError
    return np.stack([np.asarray(planes[name], np.float64) for name in names], axis=-1)


def _exr_channels(names: set[str], file: Path) -> tuple[str, ...]:
    """Names of R, G, B, else of Y, in the first layer that has them; the nameless layer first."""
    layers = sorted({name.rpartition(".")[0] for name in names})
    for wanted in ("RGB", "Y"):
        for layer in layers:
            found = tuple(f"{layer}.{c}" if layer else c for c in wanted)
            if all(name in names for name in found):
                return found
    raise FileFormatError(
        f"{file} has the channels {', '.join(sorted(names)) or 'none'}; "
        "R, G and B, or Y, are needed."
    )


def _read_numpy(file: Path) -> Array:
    if file.suffix.lower() == ".npy":
        # Mapped, so that a header that claims more than the file holds is an error, not memory
        return np.asarray(np.load(file, mmap_mode="r", allow_pickle=False))
    with zipfile.ZipFile(file) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > 8 * _MAX_VALUES:
            raise _too_large(file)
    with np.load(file, allow_pickle=False) as arrays:
        names = list(arrays)
        name = "image" if "image" in names else names[0] if len(names) == 1 else None
        if name is None:
            raise FileFormatError(
                f"{file} holds {len(names)} arrays ({', '.join(names) or 'none'}); "
                "call the one to read 'image'."
            )
        return np.asarray(arrays[name])


def _checked(pixels: Array, file: Path) -> Array:
    if pixels.dtype.kind not in "fiub":
        raise FileFormatError(f"{file} holds {pixels.dtype} values; real numbers are needed.")
    if pixels.ndim not in (2, 3) or pixels.size == 0:
        raise FileFormatError(
            f"{file} holds an array of shape {pixels.shape}; it must be (height, width) or "
            "(height, width, channels), none of them 0."
        )
    if pixels.size > _MAX_VALUES:
        raise _too_large(file)
    image = np.array(pixels if pixels.ndim == 3 else pixels[..., None], np.float64)
    bad = int(np.count_nonzero(~np.isfinite(image)))
    if bad:
        raise FileFormatError(
            f"{file} has {bad} NaN or infinite values; repair those pixels first."
        )
    return image


def _too_large(file: Path) -> FileFormatError:
    return FileFormatError(
        f"{file} says that it holds more pixels than are read ({_MAX_VALUES:.3g} values); "
        "make a smaller version."
    )
