"""Pixel numbers and channels from arrays: NumPy's integers work like Python's."""

import numpy as np
import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.rendering import Pixel, describe_pixel, pixel_mis, variance_map
from mcspectra.rendering.pixel import incident_light
from mcspectra.studies.path import analyse_path
from mcspectra.studies.pixel import analyse_pixel

pytestmark = pytest.mark.render

WALL = {"scene": "veach", "light": "light-3"}
PLACE = {"x": 568, "y": 100}
U = np.array([[0.3, 0.7], [0.9, 0.1]])


@pytest.mark.parametrize("kind", [np.int64, np.int32, np.uint16])
def test_pixels_and_channels_of_numpy(kind):
    given = {name: kind(value) for name, value in PLACE.items()}
    pixel = Pixel(**WALL, **given, channel=kind(1), dims=kind(2))
    same = Pixel(**WALL, **PLACE, channel=1)
    assert pixel == same
    assert pixel.spec == same.spec
    assert {type(getattr(pixel, name)) for name in ("x", "y", "channel", "dims")} == {int}
    assert np.array_equal(pixel(U), same(U))


def test_positions_in_the_pixel():
    u = np.concatenate([U, U], axis=1)
    given = {name: np.int64(value) for name, value in PLACE.items()}
    assert np.array_equal(Pixel(**WALL, **given, dims=4)(u), Pixel(**WALL, **PLACE, dims=4)(u))


def test_other_views_of_numpy():
    x, y, green = (np.int64(value) for value in (*PLACE.values(), 1))
    assert describe_pixel("veach", x, y) == describe_pixel("veach", **PLACE)
    mis = pixel_mis("veach", x, y, light="light-3", channel=green)
    assert mis.spec == pixel_mis("veach", **PLACE, light="light-3", channel=1).spec
    sky = incident_light("veach", x, y, resolution=4, channel=green)
    assert [type(sky.attrs[name]) for name in ("x", "y", "channel")] == [int, int, int]


def test_maps_take_a_channel_of_numpy():
    small = {"counts": [1, 4], "realizations": 2, "crop": (30, 5, 2, 2), "size": (48, 32)}
    one, other = (variance_map("veach", ["light"], channel=c, **small) for c in (np.int64(1), 1))
    assert one.identical(other.assign_attrs(one.attrs))
    assert type(one.attrs["channel"]) is int


@pytest.mark.parametrize("channel", [np.int64(3), np.float64(1.5), np.True_, np.array([1]), None])
def test_other_channels_are_refused(channel):
    with pytest.raises(ParameterError, match="give 'luminance', 'rgb', 0, 1 or 2"):
        Pixel(**WALL, **PLACE, channel=channel)
    with pytest.raises(ParameterError, match="give 'luminance', 0, 1 or 2"):
        variance_map("veach", channel=channel)


@pytest.mark.parametrize("channel", ["rgb", 7])
@pytest.mark.parametrize("analyse", [analyse_pixel, analyse_path])
def test_analyses_of_a_pixel_offer_only_channels_that_they_take(analyse, channel):
    with pytest.raises(ParameterError, match=f"channel is {channel!r}; give 'luminance', 0, 1"):
        analyse("veach", 1, 1, channel=channel)
