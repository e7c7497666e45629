"""Images side by side: each panel has the very pixels of its image, at one exposure."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from mcspectra.core.errors import McspectraError, ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering.files import encode_srgb
from mcspectra.report.encode import encode_exact
from mcspectra.report.figures import strategy_images
from mcspectra.report.figures.strategy_images import rms_error


def image(seed: int, strategy: str, spp: int, batches: int = 1, shape: Any = (5, 7)) -> xr.Dataset:
    values = 1.5 * Stream.from_rng(seed).uniforms(0, 1, 3 * shape[0] * shape[1])
    arrays = {"image": (("y", "x", "channel"), values.reshape(*shape, 3))}
    if batches > 1:
        arrays["image_se"] = (("y", "x", "channel"), np.full((*shape, 3), 0.25))
    return xr.Dataset(arrays, attrs={"strategy": strategy, "spp": spp, "realizations": batches})


def images(**options: Any) -> dict[str, xr.Dataset]:
    return {
        "reference": image(1, "mis", 64, 16, **options),
        "light": image(2, "light", 4, **options),
        "bsdf": image(3, "bsdf", 4, **options),
        "mis": image(4, "mis", 2, **options),
    }


def panel(picture: np.ndarray, k: int, width: int, height: int) -> np.ndarray:
    """Panel k, from the frame of 12 pixels around and the strip of 60 above."""
    left = 12 + k * (width + 12)
    return picture[60 : 60 + height, left : left + width]


@pytest.mark.parametrize("exposure", [0.0, -1.5])
@pytest.mark.parametrize(("shape", "zoom"), [((5, 7), 35), ((3, 240), 1), ((11, 239), 2)])
def test_panels_are_the_images(shape: tuple[int, int], zoom: int, exposure: float) -> None:
    made = images(shape=shape)
    png = encode_exact(strategy_images(made, exposure=exposure))
    picture = np.asarray(Image.open(io.BytesIO(png)))
    height, width = zoom * shape[0], zoom * shape[1]
    assert picture.shape == (height + 60 + 12, 4 * (width + 12) + 12, 3)
    for k, data in enumerate(made.values()):
        expected = np.rint(255 * encode_srgb(data["image"].values * 2.0**exposure))
        whole = np.kron(expected, np.ones((zoom, zoom, 1)))
        np.testing.assert_array_equal(panel(picture, k, width, height), whole)


def test_labels_say_samples_and_errors() -> None:
    made = images()
    texts = [text.get_text().strip() for text in strategy_images(made).texts]
    assert texts[::2] == ["reference", "light sampling", "BSDF sampling", "MIS"]
    off = [f"rms error {rms_error(made[s], made['reference']):.3g}" for s in ("light", "mis")]
    assert texts[1] == "1024 + 1024 samples a pixel\nrms standard error 0.25"
    assert texts[3] == f"4 samples a pixel\n{off[0]}"
    assert texts[7] == f"2 + 2 samples a pixel\n{off[1]}"


def test_error_is_over_pixels_and_channels() -> None:
    a, b = image(1, "mis", 1), image(1, "mis", 1)
    assert rms_error(a, b) == 0.0
    b["image"][2, 3, 1] += 2.0
    assert rms_error(b, a) == pytest.approx(2.0 / np.sqrt(5 * 7 * 3), rel=1e-12)


def test_same_images_same_bytes() -> None:
    first, second = (encode_exact(strategy_images(images())) for _ in range(2))
    assert first == second


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"reference": image(1, "mis", 1)},
        {"light": image(1, "light", 1), "mis": image(1, "mis", 1)},
        {"reference": image(1, "mis", 1), "mis": image(1, "mis", 1, shape=(5, 8))},
        {"reference": xr.Dataset(), "mis": xr.Dataset()},
    ],
)
def test_what_is_no_comparison_is_refused(given: dict[str, xr.Dataset]) -> None:
    with pytest.raises(ParameterError, match="what compare_strategies returns"):
        strategy_images(given)


def test_pictures_beyond_all_bounds_are_refused() -> None:
    with pytest.raises(ParameterError, match="give a crop"):
        strategy_images(images(shape=(1, 9000)))


@pytest.mark.parametrize("exposure", [np.nan, np.inf, 65, "bright"])
def test_exposures_that_are_refused(exposure: Any) -> None:
    with pytest.raises(McspectraError, match="exposure"):
        strategy_images(images(), exposure=exposure)
