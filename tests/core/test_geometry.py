"""Vectors, degenerate lights, and the solid angle of a triangle."""

import math

import numpy as np
import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.core.geometry import as_vector, check_light, norm, triangle_angle


def test_vectors():
    assert as_vector("v", [1, 2.5, -3]) == (1.0, 2.5, -3.0)
    assert as_vector("v", np.arange(3)) == (0.0, 1.0, 2.0)
    for bad in (1, None, "abc", [1, 2], [1, 2, math.nan], [1, 2, 1e10], [1, 2, True], [[1, 2, 3]]):
        with pytest.raises(ParameterError, match="^v"):
            as_vector("v", bad)


def test_norm():
    np.testing.assert_array_equal(norm(np.array([[3.0, 4, 0], [1, 2, 2]])), [5, 3])


def test_the_height_of_a_light():
    corner, e0, e1 = np.array([5.0, 1, 2]), np.array([1.0, 0, 0]), np.array([1.0, 3, 0])
    assert check_light("light", corner, e0, e1) == pytest.approx(2.0)
    assert check_light("light", -corner, e0, e1) == pytest.approx(2.0)
    for broken in ((corner, e0, 2 * e0), (corner * [1, 1, 0], e0, e1), (corner * 1e12, e0, e1)):
        with pytest.raises(ParameterError, match="light"):
            check_light("light", *broken)


def test_solid_angles():
    """Girard's theorem for well-shaped triangles; the flat limit, area/r², for tiny ones."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        a, b, c = rng.normal(size=(3, 3))
        normals = [np.cross(p, q) for p, q in ((a, b), (b, c), (c, a))]
        units = [n / np.linalg.norm(n) for n in normals]
        angles = [math.acos(-units[i] @ units[(i + 1) % 3]) for i in range(3)]
        volume = np.array(abs(a @ np.cross(b, c)))
        expected = sum(angles) - math.pi
        assert triangle_angle(volume, a, b, c) == pytest.approx(expected, abs=1e-12)
    a, b, c = np.array([[1.0, 0, 0], [1, 1e-9, 0], [1, 0, 1e-9]])
    assert triangle_angle(np.array(1e-18), a, b, c) == pytest.approx(0.5e-18, rel=1e-15)


@pytest.mark.parametrize("given", [None, "abc", 3.0, [1, 2], [[1, 2, 3], [1]], np.ones(3, complex)])
def test_invalid_vectors_raise(given):
    good = np.eye(3)
    for call in (
        lambda: norm(given),
        lambda: check_light("light", good[0], given, good[2]),
        lambda: triangle_angle(np.array(1.0), good[0], given, good[2]),
    ):
        with pytest.raises(ParameterError, match="[Vv]ectors"):
            call()
