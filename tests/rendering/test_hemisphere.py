"""Light that arrives at a pixel: the integral of f equals the estimate of every strategy."""

from typing import Any

import numpy as np
import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.rendering import Pixel, named_pixels
from mcspectra.rendering.pixel import incident_light

pytestmark = [pytest.mark.render, pytest.mark.usefixtures("coarse_pixels")]


def solid_angles(data):
    """Solid angle of each cell, from the elevations of its borders."""
    half = np.radians(90.0 / data.sizes["elevation"] / 2)
    up = np.radians(data["elevation"])
    return (np.sin(up + half) - np.sin(up - half)) * (2 * np.pi / data.sizes["azimuth"])


@pytest.mark.parametrize(
    ("scene", "name", "light"),
    [("figure1", "P", None), ("figure1", "Q", None), ("veach", "wall", "light-3"),
     ("veach", "plate-3", "light-3"), ("sky", "floor", None)],
)  # fmt: skip
def test_the_integral_of_f_is_the_pixels_value(scene, name, light):
    x, y = named_pixels(scene)[name]
    data = incident_light(scene, x, y, light=light, resolution=256)
    total = float((data["reflected_radiance"] * solid_angles(data)).sum())
    # The light's border is wrong by at most half a cell, far below 1 %.
    assert total == pytest.approx(Pixel(scene=scene, x=x, y=y, light=light).integral, rel=0.01)


def test_a_constant_light_shows_its_radiance():
    x, y = named_pixels("figure1")["P"]
    radiance = incident_light("figure1", x, y, resolution=64)["incident_radiance"].values
    assert set(np.unique(radiance)) == {0.0, 9.0}


def test_a_diffuse_floor_reflects_by_the_cosine():
    x, y = named_pixels("figure1")["P"]
    data = incident_light("figure1", x, y, resolution=64)
    cosine = np.sin(np.radians(data["elevation"]))
    expected = data["incident_radiance"] * cosine * (0.5 / np.pi)
    assert np.allclose(data["reflected_radiance"], expected, rtol=1e-5)


def test_light_comes_only_from_the_directions_of_the_light():
    """From P (-1.2, 0, 0.7), the corners of the light at height 2 span these elevations."""
    x, y = named_pixels("figure1")["P"]
    data = incident_light("figure1", x, y, resolution=180)
    lit = data["elevation"].values[(data["incident_radiance"] > 0).any("azimuth").values]
    corners = np.array([(a, 2.0, b) for a in (-1, 1) for b in (-1, 1)]) - (-1.2, 0.0, 0.7)
    flat = np.hypot(corners[:, 0], corners[:, 2])
    lowest = np.degrees(np.arctan2(2.0, flat)).min()
    assert abs(lit.min() - lowest) < 1.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"channel": "rgb"}, "channel is 'rgb'; give 'luminance', 0, 1 or 2"),
        ({"channel": 3}, "channel is 3"),
        ({"resolution": 3}, "resolution"),
        ({"resolution": 10**9}, "resolution"),
        ({"resolution": float("nan")}, "resolution"),
        ({"light": "moon"}, "no light"),
        ({"x": 384}, "outside the film"),
        ({"y": -1}, "outside the film"),
    ],
)
def test_bad_input_is_one_sentence(changes, words):
    x, y = named_pixels("figure1")["P"]
    given: dict[str, Any] = {"scene": "figure1", "x": x, "y": y} | changes
    with pytest.raises(ParameterError, match=words):
        incident_light(**given)
