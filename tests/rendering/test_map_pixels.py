"""Maps of a subset of the pixels: the choice, the interpolation and its intervals."""

from typing import Any

import numpy as np
import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.core.streams import Stream
from mcspectra.rendering import variance_map
from mcspectra.rendering.map_pixels import (
    chosen_pixels,
    nearest_pixels,
    number_of_pixels,
    spread,
)

WINDOW = (5, 3, 120, 90)
SMALL: dict[str, Any] = {
    "integrator": "path(max_depth=2)",
    "counts": (4, 16),
    "realizations": 16,
    "chains": 0,
    "rng": 3,
}
SCENE = "penumbra(width=24, height=18)"


def surface(seed=1, background=0):
    """A smooth variance with one edge and noise of 18 %, (1, 2, y, x), and a background."""
    x0, y0, width, height = WINDOW
    y, x = np.mgrid[y0 : y0 + height, x0 : x0 + width]
    rng = np.random.default_rng(seed)
    log = np.sin(x / 20) + np.cos(y / 15) + 2.0 * (x + y > 110)
    noise = 0.18 * rng.standard_normal((2, height, width))
    variance = np.exp(log + noise) * np.array([1.0, 0.25])[:, None, None]
    variance[:, :, :background] = np.nan
    return variance[None]


def at_pixels(variance, count=1000, seed=2):
    pixels = chosen_pixels(WINDOW, count, Stream.from_rng(seed))
    column, row = (pixels - WINDOW[:2]).T
    own = variance[..., row, column][..., None, :]
    found = {"variance": own, "variance_relative_se": np.full_like(own, 0.18)}
    return pixels, row, column, found


def test_pixels_are_chosen_one_per_stratum():
    pixels = chosen_pixels(WINDOW, 100, Stream.from_rng(0))
    x0, y0, width, height = WINDOW
    assert 80 <= len(pixels) <= 125
    assert len(np.unique(pixels, axis=0)) == len(pixels)
    assert (pixels >= (x0, y0)).all()
    assert (pixels < (x0 + width, y0 + height)).all()
    # No quarter of the window has fewer than a fifth of the pixels
    right, low = (pixels >= (x0 + width / 2, y0 + height / 2)).T
    assert np.bincount(2 * right + low).min() > len(pixels) / 5
    assert np.array_equal(pixels, chosen_pixels(WINDOW, 100, Stream.from_rng(0)))


def test_intervals_hold_95_percent_of_the_pixels():
    variance = surface()
    pixels, row, column, found = at_pixels(variance)
    whole = spread(found, pixels, WINDOW)
    measured = whole["measured"] == 1.0
    assert measured.sum() == len(pixels)
    np.testing.assert_array_equal(whole["variance"][..., row, column], found["variance"][..., 0, :])
    away = np.abs(np.log(whole["variance"][0, -1] / variance[0, -1]))[~measured]
    factor = whole["interpolation_factor"][0]
    inside = away <= np.log(factor[~measured])
    # The quantile of 1000 residuals and 10,000 pixels has a standard error of 0.7 %
    assert inside.mean() > 0.95 - 4 * 0.007
    assert (factor[measured] == 1.0).all()
    # Near the edge intervals are wider than elsewhere
    x0, y0, width, height = WINDOW
    y, x = np.mgrid[y0 : y0 + height, x0 : x0 + width]
    edge = np.abs(x + y - 110) < 4
    assert np.median(factor[edge & ~measured]) > 1.5 * np.median(factor[~edge & ~measured])
    se = whole["variance_relative_se"][0, -1]
    assert np.allclose(se[~measured], np.hypot(0.18, np.log(factor[~measured]) / 1.96), rtol=1e-3)


def test_background_and_black_pixels_stay():
    variance = surface(background=40)
    variance[..., 60:, :] = 0.0
    pixels, _, _, found = at_pixels(variance)
    whole = spread(found, pixels, WINDOW)["variance"][0, -1]
    inside = np.s_[4:56, 44:]
    assert (whole[inside] > 0.0).all()
    assert np.isnan(whole[:56, :36]).all()
    assert (whole[64:, 44:] == 0.0).all()


def test_other_variables_are_interpolated_or_nearest():
    variance = surface()
    pixels, _, _, found = at_pixels(variance)
    rate = (-1.0 - (pixels[:, 0] - 60) / 200.0)[None, None]
    which = (pixels[:, 0] > 60).astype(float)[None]
    wide = np.stack([rate - 0.1, rate + 0.1], axis=-1)
    more = {"rate": rate, "rate_ci": wide, "bottleneck": which}
    whole = spread({**found, **more}, pixels, WINDOW)
    x = WINDOW[0] + np.arange(WINDOW[2])
    middle = whole["rate"][0, 10:-10, 10:-10]
    assert np.allclose(middle, (-1.0 - (x[10:-10] - 60) / 200.0), atol=0.02)
    low, high = np.moveaxis(whole["rate_ci"], -1, 0)
    assert ((high - low)[0] >= 0.2 - 1e-12).all()
    assert set(np.unique(whole["bottleneck"])) == {0.0, 1.0}
    rows, columns = nearest_pixels(whole["measured"] == 1.0)
    assert np.array_equal(whole["bottleneck"], whole["bottleneck"][rows, columns])


def test_few_known_pixels_have_open_intervals():
    variance = surface()
    pixels, _, _, found = at_pixels(variance)
    found["variance"][..., 50:] = np.nan
    factor = spread(found, pixels, WINDOW)["interpolation_factor"]
    assert np.isinf(factor).any()
    assert not (np.isfinite(factor) & (factor > 1.0)).any()


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ("1", "give a number of pixels, or a share such as '1%'"),
        ("0%", "give a number of pixels, or a share such as '1%'"),
        ("101%", "give a number of pixels, or a share such as '1%'"),
        ("nan%", "give a number of pixels, or a share such as '1%'"),
        ("1%", "which is 5 of 432 pixels; give at least 64 pixels"),
        (63, "give at least 64 pixels"),
    ],
)
def test_bad_numbers_of_pixels_are_one_sentence(asked, sentence):
    with pytest.raises(ParameterError, match=sentence) as caught:
        number_of_pixels(asked, 432)
    assert "\n" not in str(caught.value)


def test_numbers_of_pixels():
    assert number_of_pixels("1%", 2_073_600) == 20_736
    assert number_of_pixels(".5 %", 20_000) == 100
    assert number_of_pixels(100, 100) == 100
    assert number_of_pixels("100%", 12) == 12
    with pytest.raises(ParameterError, match="pixels is 20, more than the 12 pixels"):
        number_of_pixels(20, 12)


@pytest.mark.render
def test_measured_pixels_have_the_bits_of_a_full_map():
    full = variance_map(SCENE, crop=(2, 1, 20, 16), **SMALL)
    part = variance_map(SCENE, crop=(2, 1, 20, 16), pixels=80, **SMALL)
    measured = part["measured"].values == 1.0
    assert 60 <= measured.sum() <= 110
    for name in ("variance", "mean", "rate"):
        one, other = (each[name].values[..., measured] for each in (part, full))
        assert np.array_equal(one, other, equal_nan=True), name
    assert part.sizes == full.sizes
    assert np.array_equal(part["x"], full["x"])
    assert (part["interpolation_factor"].values[0][measured] == 1.0).all()
    whole = variance_map(SCENE, crop=(2, 1, 20, 16), pixels="100%", **SMALL)
    assert "measured" not in whole
    with pytest.raises(ParameterError, match="smoothing is for maps that measure all pixels"):
        variance_map(SCENE, pixels=80, smoothing=3, **SMALL)
