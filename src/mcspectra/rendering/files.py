"""Files of rendered images: EXR with all measurements, PNG for viewing."""

from __future__ import annotations

import json
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array, as_real
from mcspectra.core.errors import FileFormatError, ParameterError, writing
from mcspectra.core.images import load_openexr

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "RENDER_EXTENSIONS",
    "check_image_path",
    "encode_srgb",
    "write_comparison",
    "write_exr",
    "write_png",
    "write_render",
]

RENDER_EXTENSIONS = (".exr", ".png")
_MOST_STOPS = 64.0


def write_render(
    path: str | PathLike[str], result: xr.Dataset, *, exposure: float = 0.0
) -> list[str]:
    """Write the result of `render` to a file.

    Parameters
    ----------
    path
        An EXR file stores ``image`` as the channels R, G and B, and the provenance as a comment.
        An EXR file also stores the layers ``variance`` and ``image_se`` if they exist.
        A PNG file stores only ``image``.
    result
        A rendered image, as returned by `render` or `reference`.
    exposure
        Number of stops by which a PNG is brightened; EXR stores radiance unchanged.

    Returns
    -------
    list of str
        Names of the written layers; the layer of the image has the empty name.

    Raises
    ------
    FileFormatError
        If the extension is neither .exr nor .png, or the file cannot be written.
    ParameterError
        If the exposure is not a number from −64 to 64, or the result is not a rendered image.
    """
    _check_result(path, result)
    file = check_image_path(path)
    if file.suffix.lower() == ".png":
        write_png(file, result["image"].values, exposure=exposure)
        return [""]
    layers = {"": result["image"].values}
    layers |= {n: result[n].values for n in ("variance", "image_se") if n in result}
    write_exr(file, layers, comment=json.dumps(result.attrs))
    return list(layers)


def write_comparison(path: str | PathLike[str], images: Mapping[str, xr.Dataset]) -> list[str]:
    """Write a result of `compare_strategies` as one EXR file. Each image becomes a layer.

    Parameters
    ----------
    path
        File name that ends in ``.exr``.
    images
        Images of equal size by name: ``reference``, ``light``, …

    Returns
    -------
    list of str
        Names of the layers: those of the images, and ``reference.image_se`` for the standard error.
        The comment in the file holds the provenance of all images.

    Raises
    ------
    FileFormatError
        If the extension is not .exr, or the file cannot be written.
    ParameterError
        If an image is not a result of `render`, or the sizes of images differ.
    """
    file = check_image_path(path, (".exr",))
    layers: dict[str, Array] = {}
    for name, result in images.items():
        _check_result(path, result)
        layers[name] = result["image"].values
        if name == "reference" and "image_se" in result:
            layers["reference.image_se"] = result["image_se"].values
    told = {name: result.attrs for name, result in images.items()}
    write_exr(file, layers, comment=json.dumps(told))
    return list(layers)


def write_exr(path: str | PathLike[str], layers: Mapping[str, Array], *, comment: str = "") -> None:
    """Write layers as float32 channels of one EXR file (ZIP, scan lines).

    Finite numbers beyond the range of float32 are replaced by its largest number.

    Parameters
    ----------
    path
        File name that ends in ``.exr``.
    layers
        Arrays (height, width) or (height, width, 3) by name, all of the same size.
        Channels are called ``name.R`` and so on, or ``name.Y`` for a gray layer.
        Channels of the unnamed layer have no prefix.
    comment
        Text for the file's header.

    Raises
    ------
    FileFormatError
        If the file cannot be written.
    ParameterError
        If there are no layers, or their shapes are invalid or differ.
    """
    OpenEXR = load_openexr()
    file = check_image_path(path, (".exr",))
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {}
    largest = float(np.finfo(np.float32).max)
    for name, plane in _checked(layers).items():
        finite = np.where(np.isfinite(plane), np.clip(plane, -largest, largest), plane)
        for i, letter in enumerate("Y" if plane.ndim == 2 else "RGB"):
            values = finite if plane.ndim == 2 else finite[..., i]
            full = f"{name}.{letter}" if name else letter
            channels[full] = np.ascontiguousarray(values, np.float32)
    with writing(file), file.open("ab"):
        pass  # OpenEXR does not report why it could not open a file
    try:
        OpenEXR.File({**header, "comments": comment}, channels).write(str(file))
    except (OSError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise FileFormatError(f"{str(file)!r} cannot be written: {reason}.") from None


def write_png(path: str | PathLike[str], image: Array, *, exposure: float = 0.0) -> None:
    """Write radiance (height, width) or (height, width, 3) as an sRGB picture of 8 bits.

    Parameters
    ----------
    path
        File name that ends in ``.png``.
    image
        Radiance. Negative values become black, and values of at least 1 become white.
        The exposure is applied before values are clipped.
    exposure
        Brightness in stops: radiance is multiplied by 2^exposure.

    Raises
    ------
    FileFormatError
        If the file cannot be written.
    ParameterError
        If `exposure` is not a number from −64 to 64, or the image has another shape.
    """
    from PIL import Image

    file = check_image_path(path, (".png",))
    stops = as_real("exposure", exposure, least=-_MOST_STOPS, most=_MOST_STOPS)
    plane = next(iter(_checked({"": image}).values()))
    encoded = encode_srgb(plane * 2.0**stops)
    with writing(file):
        Image.fromarray(np.rint(255.0 * encoded).astype(np.uint8)).save(file, format="PNG")


def encode_srgb(linear: Array) -> Array:
    """Clip values to [0,1], and apply the sRGB transfer function (IEC 61966-2-1)."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def check_image_path(path: object, extensions: tuple[str, ...] = RENDER_EXTENSIONS) -> Path:
    """Check the extension of `path`, and that its folder exists; return the path."""
    if not isinstance(path, str | PathLike) or not str(path):
        given = (
            repr(path)
            if isinstance(path, str | bytes | int | float)
            else f"A {type(path).__name__}"
        )
        raise FileFormatError(f"{given} is not the path of an image; give a file name.")
    file = Path(path)
    if file.suffix.lower() not in extensions:
        raise FileFormatError(f"{str(file)!r} must end in {' or '.join(extensions)}.")
    try:
        problem = "is a folder" if file.is_dir() else ""
        problem = problem or ("" if file.parent.is_dir() else "is in a folder that does not exist")
    except OSError:  # raised if the name is too long for the file system
        problem = "is not a possible file name"
    if "\0" in str(file):
        problem = "is not a possible file name"
    if problem:
        raise FileFormatError(f"{str(file)!r} {problem}; give another file name.")
    return file


def _check_result(path: object, result: object) -> None:
    """Raise an error if a result has no image, for example if path and result are swapped."""
    if "image" in getattr(result, "data_vars", ()):
        return
    swapped = "image" in getattr(path, "data_vars", ())
    raise ParameterError(
        f"The result to write is a {type(result).__name__} without an image; give "
        + ("the path first, then the result." if swapped else "the result of render.")
    )


def _checked(layers: Mapping[str, Array]) -> dict[str, Array]:
    planes = {name: np.asarray(plane) for name, plane in layers.items()}
    sizes = {plane.shape[:2] for plane in planes.values()}
    fits = all(p.ndim == 2 or (p.ndim == 3 and p.shape[2] == 3) for p in planes.values())
    if len(sizes) != 1 or not fits or 0 in next(iter(sizes)):
        shapes = ", ".join(str(plane.shape) for plane in planes.values()) or "nothing"
        raise ParameterError(
            f"The image to write is {shapes}; give arrays (height, width) or (height, width, 3), "
            "all of one size."
        )
    return planes
