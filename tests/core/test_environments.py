"""Latitude-longitude geometry and the synthetic sky."""

import numpy as np
import pytest

from mcspectra.core.environments import (
    directions,
    environment_pixels,
    row_solid_angles,
    synthetic_sky,
)
from mcspectra.core.errors import FileFormatError, ParameterError


def test_directions_by_hand():
    x = np.array([[0.3, 0.0], [0.0, 0.5], [0.25, 0.5], [0.5, 0.5], [0.9, 1.0]])
    expected = [[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, -1]]
    np.testing.assert_allclose(directions(x), expected, atol=1e-15)


def test_directions_are_unit_vectors():
    x = np.random.default_rng(1).random((5, 7, 2))
    assert directions(x).shape == (5, 7, 3)
    np.testing.assert_allclose(np.linalg.norm(directions(x), axis=-1), 1, rtol=1e-14)


@pytest.mark.parametrize("height", [1, 2, 7, 1000])
def test_solid_angles_of_rows(height):
    found = row_solid_angles(height)
    expected = -np.diff(np.cos(np.pi * np.arange(height + 1) / height)) / 2
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert found.sum() == pytest.approx(1, rel=1e-13)


def test_the_sky_has_a_high_range_and_colors():
    sky = synthetic_sky(64, 128)
    assert sky.shape == (64, 128, 3)
    assert sky.min() > 0
    assert sky.max() / np.median(sky) > 100
    shares = sky / sky.sum(axis=-1, keepdims=True)
    assert (shares.max(axis=(0, 1)) > 0.6).all()  # each channel dominates in some place
    np.testing.assert_array_equal(sky, synthetic_sky(64, 128))
    assert synthetic_sky(1, 1).shape == (1, 1, 3)


@pytest.mark.parametrize("size", [(0, 4), (4, 0), (-1, 4), (2.5, 4), ("4", 4), (10**9, 1)])
def test_bad_sizes(size):
    with pytest.raises(ParameterError, match="give a whole number from 1 to 16384"):
        synthetic_sky(*size)


@pytest.mark.parametrize("x", [None, "ab", 0.5, [0.1, 0.2, 0.3], [[0.1, 0.2], [0.3]]])
def test_directions_of_invalid_points_raise(x):
    with pytest.raises(ParameterError, match="^x "):
        directions(x)


@pytest.mark.parametrize("height", [None, "4", 0, 2.5])
def test_invalid_rows_raise(height):
    with pytest.raises(ParameterError, match="height"):
        row_solid_angles(height)


@pytest.mark.parametrize("values", ["ab", 3, [[1, [2]]], np.ones(4), np.ones((0, 2)), [[-1.0]]])
def test_values_that_are_not_radiances_raise(values):
    with pytest.raises(ParameterError, match="values|radiance"):
        environment_pixels(None, values)
    for path in (3, b"a.png"):
        with pytest.raises(FileFormatError, match="is not a path"):
            environment_pixels(path, None)
