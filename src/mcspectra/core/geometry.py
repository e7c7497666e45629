"""Checks of vectors and lights in 3-D space, their lengths, and the solid angle of a triangle."""

from __future__ import annotations

import numpy as np

from mcspectra.core.checks import Array, as_real_array, as_reals
from mcspectra.core.errors import ParameterError

__all__ = ["as_vector", "check_light", "norm", "triangle_angle"]

_LARGEST = 1e9
# If the sine of the angle between the edges of a light is below this limit, the light has no area.
# Edges shorter than 1e-9 of the largest distance from the point to the light are not allowed
_FLAT = 1e-9
# Smallest allowed height of a point above the plane of a light.
# The height is divided by the largest distance from the point to the light
_GRAZING = 1e-6


def as_vector(name: str, value: object) -> tuple[float, float, float]:
    """Return three finite floats, of at most 1e9 in magnitude, from a sequence of three.

    Raises
    ------
    ParameterError
        If `value` does not hold three finite numbers.
    """
    if not isinstance(value, list | tuple | np.ndarray) or np.shape(value) != (3,):
        raise ParameterError(f"{name} is {value!r:.80}; give three numbers [x, y, z].")
    x, y, z = as_reals(name, value, 3, least=-_LARGEST, most=_LARGEST)
    return x, y, z


def norm(v: Array) -> Array:
    """Length of vectors (..., 3)."""
    v = _vectors(v)
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", v, v)))


def _vectors(v: Array) -> Array:
    """Return vectors (..., 3) as float64."""
    vectors = as_real_array("vectors", v)
    if vectors.shape[-1:] != (3,):
        raise ParameterError(f"Vectors have shape {vectors.shape}; give shape (..., 3).")
    return vectors


def check_light(what: str, corner: Array, edge0: Array, edge1: Array) -> float:
    """Return the height of the origin above the plane of a light. The vectors have shape (3,).

    Parameters
    ----------
    what
        Name of the light for error messages.
    corner
        One corner, relative to the illuminated point.
    edge0, edge1
        The two edges of the light that begin at `corner`.

    Raises
    ------
    ParameterError
        If the light has no area or is too small for its distance.
        If the point lies in the light's plane: its height is below 1e-6 of the largest distance.
    """
    corner, edge0, edge1 = map(_vectors, (corner, edge0, edge1))
    lengths = norm(np.stack([edge0, edge1]))
    normal = np.cross(edge0, edge1)
    if not norm(normal) > _FLAT * lengths.prod():
        raise ParameterError(f"The {what} has no area; give corners that are not on one line.")
    reach = float(norm(corner + np.stack([0 * edge0, edge0, edge1, edge0 + edge1])).max())
    if lengths.min() < _FLAT * reach:
        raise ParameterError(
            f"The {what} has an edge of {lengths.min():.3g} at a distance of {reach:.3g}, too "
            f"small for float64; edges must be at least {_FLAT:g} of the distance."
        )
    height = abs(float(corner @ (normal / norm(normal))))
    if height < _GRAZING * reach:
        raise ParameterError(
            f"The origin lies in the plane of the {what} (height {height:.3g}, distance "
            f"{reach:.3g}), where it subtends no solid angle; move it out of the plane."
        )
    return height


def triangle_angle(volume: Array, a: Array, b: Array, c: Array) -> Array:
    """Return the solid angle at the origin of triangles with corners (..., 3), in steradians.

    Parameters
    ----------
    volume
        |a · (b × c)|, which callers can compute without the cancellation of that formula.
    a, b, c
        Corners.

    References
    ----------
    A. van Oosterom, J. Strackee (1983), "The solid angle of a plane triangle", eq. 8.
    """
    volume, (a, b, c) = as_real_array("volume", volume), map(_vectors, (a, b, c))
    la, lb, lc = norm(a), norm(b), norm(c)
    ab, bc, ca = (np.einsum("...i,...i->...", *pair) for pair in ((a, b), (b, c), (c, a)))
    return np.asarray(2.0 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb))
