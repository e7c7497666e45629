"""Latitude-longitude environment maps. Pixels on the unit square hold radiance by direction.

Conventions
-----------
x_0 gives the azimuth φ = 2π x_0, and x_1 gives the polar angle θ = π x_1.
The first row of pixels is next to +z, and the last row is next to −z.
The direction is ω = (sin θ cos φ, sin θ sin φ, cos θ).
A solid angle is dω = sin θ dθ dφ = 2π² sin(π x_1) dx.
"""

from __future__ import annotations

import math

import numpy as np

from mcspectra.core.checks import Array, as_integer, as_real_array
from mcspectra.core.errors import DomainError, ParameterError

__all__ = ["directions", "environment_pixels", "row_solid_angles", "synthetic_sky"]

_MOST_VALUES = 2**28  # 2 GiB, the same limit as for picture files
# The sun: position x_0, x_1, sharpness (as in a von Mises-Fisher lobe), and radiance
_SUN = (0.62, 0.31, 14.0, 400.0)
_PATCHES = (  # for each patch: x_0, x_1, two half sizes, color
    (0.15, 0.30, 0.04, 0.06, (9.0, 1.0, 0.5)),
    (0.35, 0.45, 0.05, 0.04, (0.4, 7.0, 1.0)),
    (0.85, 0.40, 0.03, 0.08, (0.5, 1.5, 12.0)),
)


def synthetic_sky(height: int = 32, width: int = 64) -> Array:
    """Return a synthetic sky of high dynamic range: gradients, a warm sun and colored patches.

    Parameters
    ----------
    height, width
        Numbers of pixels along θ and φ, at least 1.

    Returns
    -------
    ndarray
        Linear radiance (height, width, 3), positive everywhere, evaluated at pixel centers.
        The sky is meant for tests and examples; it is not a physical model.
    """
    rows = as_integer("height", height, least=1, most=2**14)
    columns = as_integer("width", width, least=1, most=2**14)
    x_1, x_0 = np.meshgrid(
        (np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij"
    )
    up = np.cos(np.pi * x_1)[..., None]
    above = np.array([0.25, 0.5, 1.0]) + np.array([0.6, 0.4, 0.1]) * (1.0 - np.abs(up)) ** 4
    below = np.array([0.12, 0.1, 0.07]) * (1.0 + 0.5 * up)
    sky = np.where(up > 0, above, below)
    for a, b, half_0, half_1, color in _PATCHES:
        sky[(np.abs(x_0 - a) < half_0) & (np.abs(x_1 - b) < half_1)] = color
    a, b, sharpness, radiance = _SUN
    cosine = directions(np.stack([x_0, x_1], axis=-1)) @ directions(np.array([a, b]))
    sun = radiance * np.exp(sharpness**2 * (cosine - 1.0))
    return np.asarray(sky + sun[..., None] * [1.0, 0.85, 0.6])


def directions(x: Array) -> Array:
    """Return unit vectors (..., 3) of points x (..., 2)."""
    x = as_real_array("x", x)
    if x.shape[-1:] != (2,):
        raise ParameterError(f"x has shape {x.shape}; give points of shape (..., 2).")
    phi, theta = 2 * np.pi * x[..., 0], np.pi * x[..., 1]
    sine = np.sin(theta)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)


def row_solid_angles(height: int) -> Array:
    """Return the fraction of the sphere that each of `height` rows covers; their sum is 1.

    If θ is the polar angle at a row's center, ½ (cos θ_j − cos θ_{j+1}) = sin θ sin(π/2h).
    The product of two sines is accurate, because it does not subtract nearly equal numbers.
    """
    height = as_integer("height", height, least=1)
    centers = (np.arange(height) + 0.5) / height
    return np.asarray(np.sin(np.pi * centers) * math.sin(np.pi / (2 * height)))


def environment_pixels(path: object, values: object) -> Array:
    """Return radiance (h, w, channels) from a file or an array; by default, the synthetic sky.

    Raises
    ------
    ParameterError
        If both a path and values are given.
        If pixels have another shape, are negative, are not finite, or are too many.
    FileFormatError
        If the file is missing or cannot be read.
    """
    if path is None and values is None:
        return synthetic_sky()
    if path is not None and values is not None:
        raise ParameterError("environment has both path and values; give one of them.")
    if values is None:
        from mcspectra.core.images import read_image

        pixels = read_image(path)  # type: ignore[arg-type]
    else:
        try:
            given = as_real_array("values", np.asarray(values))
        except (DomainError, ValueError):
            raise ParameterError(
                "values are not an array of numbers; give (h, w) or (h, w, channels)."
            ) from None
        if given.ndim not in (2, 3) or not 0 < given.size <= _MOST_VALUES:
            raise ParameterError(
                f"values have shape {given.shape}; give pixels of shape (h, w) or (h, w, "
                f"channels); {_MOST_VALUES:.3g} numbers are the limit."
            )
        pixels = np.array(given).reshape(*given.shape[:2], -1)
    if not np.isfinite(pixels).all() or pixels.min() < 0:
        raise ParameterError(
            f"The radiance runs from {pixels.min():g} to {pixels.max():g}; "
            "it must be finite and at least 0."
        )
    return pixels
