"""Images of one scene by each strategy, side by side, every pixel a square of whole pixels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mcspectra.core.checks import Array, as_real
from mcspectra.core.errors import ParameterError
from mcspectra.report.style import GRAY, INK, PAPER, SMALL_SIZE

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = ["STRATEGY_TITLES", "rms_error", "strategy_images"]

STRATEGY_TITLES = {
    "reference": "reference",
    "light": "light sampling",
    "bsdf": "BSDF sampling",
    "mis": "MIS",
}

_DPI = 120
_LEAST_WIDTH = 240  # of a panel, in pixels: its labels need that
_GAP, _STRIP = 12, 60  # between panels, and above them for the labels
_LARGEST_SIDE = 2**15  # of the picture, in pixels; matplotlib's own limit is twice that
_MOST_STOPS = 64.0


def strategy_images(images: Mapping[str, xr.Dataset], *, exposure: float = 0.0) -> Figure:
    """Draw what `mcspectra.rendering.compare_strategies` returns, all at the same exposure.

    Parameters
    ----------
    images
        ``reference`` and at least one strategy, all of one size.
    exposure
        Stops by which all are made brighter, from −64 to 64.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each, with its samples a pixel and the root mean square of its distance to the
        reference over pixels and channels; for the reference, of its standard error. In
        `mcspectra.report.encode.encode_exact` a pixel of the images is a square of whole pixels.

    Raises
    ------
    ParameterError
        The images are not those, too large for one picture, or the exposure is out of range.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    gain = 2.0 ** as_real("exposure", exposure, least=-_MOST_STOPS, most=_MOST_STOPS)
    height, width = _size(images)
    zoom = max(1, -(-_LEAST_WIDTH // width))
    panel, tall = width * zoom, height * zoom
    wide, high = _GAP + len(images) * (panel + _GAP), tall + _STRIP + _GAP
    if max(wide, high) > _LARGEST_SIDE:
        raise ParameterError(
            f"Images of {width} × {height} pixels side by side are {wide} × {high} pixels, more "
            f"than {_LARGEST_SIDE} along a side; give a crop."
        )
    figure = Figure(figsize=(wide / _DPI, high / _DPI), dpi=_DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    for k, name in enumerate(images):
        left = _GAP + k * (panel + _GAP)
        axes = figure.add_axes((left / wide, _GAP / high, panel / wide, tall / high))
        axes.set_axis_off()
        # Repeated here: matplotlib's own scaling may shift a row by half a pixel.
        shown = np.repeat(np.repeat(_srgb(images[name], gain), zoom, axis=0), zoom, axis=1)
        axes.imshow(shown, interpolation="nearest", aspect="auto")
        _label(figure, left / wide, 1.0 - 6 / high, name, images)
    return figure


def rms_error(image: xr.Dataset, reference: xr.Dataset) -> float:
    """Return the root mean square over pixels and channels of the distance of two images."""
    return float(np.sqrt(np.mean((image["image"].values - reference["image"].values) ** 2)))


def _size(images: Mapping[str, xr.Dataset]) -> tuple[int, int]:
    """Height and width that all images have."""
    shapes = {data["image"].shape for data in images.values() if "image" in data}
    if "reference" not in images or len(images) < 2 or len(shapes) != 1:
        raise ParameterError(
            "What is to be drawn has no reference with images of its size by strategy; give what "
            "compare_strategies returns."
        )
    height, width, _ = shapes.pop()
    return height, width


def _srgb(data: xr.Dataset, gain: float) -> Array:
    from mcspectra.rendering.files import encode_srgb

    encoded = encode_srgb(data["image"].values * gain)
    return np.asarray(np.rint(255.0 * encoded).astype(np.uint8))


def _label(
    figure: Figure, left: float, top: float, name: str, images: Mapping[str, xr.Dataset]
) -> None:
    """Write name, samples and error above a panel."""
    title = STRATEGY_TITLES.get(name, name)
    figure.text(left, top, title, va="top", color=INK, fontsize=SMALL_SIZE, fontweight="bold")
    more = f"\n{_samples(images[name])}\n{_error(name, images)}"
    figure.text(left, top, more, va="top", color=GRAY, fontsize=SMALL_SIZE)


def _samples(data: xr.Dataset) -> str:
    each = int(data.attrs["spp"]) * int(data.attrs["realizations"])
    count = f"{each} + {each}" if data.attrs["strategy"] == "mis" else f"{each}"
    return f"{count} samples a pixel"


def _error(name: str, images: Mapping[str, xr.Dataset]) -> str:
    data = images[name]
    if name != "reference":
        return f"rms error {rms_error(data, images['reference']):.3g}"
    if "image_se" not in data:
        return ""
    return f"rms standard error {np.sqrt(np.mean(data['image_se'].values ** 2)):.3g}"
