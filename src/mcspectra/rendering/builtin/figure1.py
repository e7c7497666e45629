"""The scene of the paper's Figure 1, and its variant with a soft-edged light."""

from __future__ import annotations

from typing import Any

import numpy as np

from mcspectra.core.checks import Array, as_real
from mcspectra.rendering.backend import load_mitsuba
from mcspectra.rendering.builtin.parts import (
    Point,
    area_light,
    diffuse,
    named_points,
    perspective,
    rectangle,
)

__all__ = ["P", "Q", "figure1", "smooth_light"]

P: Point = (-1.2, 0.0, 0.7)
"""A point of the floor that sees all of the light."""
Q: Point = (0.9, 0.0, 0.4)
"""A point of the floor from which the occluder hides a part of the light."""

_HEIGHT, _HALF_SIDE, _RADIANCE = 2.0, 1.0, 9.0
_OCCLUDER: Point = (1.5, 1.0, 0.0)
_OCCLUDER_HALF_SIDE, _OCCLUDER_DEGREES = 0.7, 25.0
_FLOOR_HALF_SIDE, _REFLECTANCE = 6.0, 0.5
_TEXELS = 256


@named_points(P=P, Q=Q)
def figure1(*, edge: float = 0.0, width: int = 384, height: int = 256) -> dict[str, Any]:
    """A square light over a floor, and an occluder that hides part of the light from one of two points.

    Parameters
    ----------
    edge
        Share of the light's half side, from its border inwards, on which radiance rises from 0 to
        full as a smoothstep, 3t² − 2t³; 0 is a light of constant radiance.
    width, height
        Film size in pixels.

    Returns
    -------
    dict
        The scene for `mitsuba.load_dict`. Shapes: light, occluder, floor.

    Raises
    ------
    ParameterError
        `edge` is not within [0, 1], or a film without pixels.

    Notes
    -----
    The arrangement is that of Figure 1 in [Singh2019]_, which gives no numbers; these are ours. The
    floor is y = 0. The light is the square |x| ≤ 1, |z| ≤ 1 at y = 2 and faces down; the occluder
    is a square of half side 0.7 at y = 1 around x = 1.5, z = 0, turned by 25° so that its shadow's
    border is not parallel to strata. The named pixels P and Q see the points `P`, which sees all of
    the light, and `Q`. Neither is below the light's centre, where the integrand would be the same
    at opposite borders and a shifted set would lose nothing.

    With an edge, radiance is a texture of 256² texels, interpolated bilinearly, and Mitsuba
    samples such a light texel by texel in proportion to it. For BSDF sampling the light has then no
    silhouette: at P, jittered, its rate goes from −1.5 to −1.9 with ``edge=1``.
    """
    radiance = _smooth_texture(edge) if as_real("edge", edge, least=0.0, most=1.0) else _RADIANCE
    light = rectangle((0, _HEIGHT, 0), (_HALF_SIDE, 0, 0), (0, 0, _HALF_SIDE))
    floor = rectangle((0, 0, 0), (_FLOOR_HALF_SIDE, 0, 0), (0, 0, -_FLOOR_HALF_SIDE))
    return {
        "type": "scene",
        "sensor": perspective((0.0, 1.6, 7.0), (0.0, 0.9, 0.0), 28.0, width, height),
        "light": {**light, **area_light(radiance)},
        "occluder": {**_turned_square(), "bsdf": diffuse(0.2, both_sides=True)},
        "floor": {**floor, "bsdf": diffuse(_REFLECTANCE)},
    }


@named_points(P=P, Q=Q)
def smooth_light(*, edge: float = 0.5, width: int = 384, height: int = 256) -> dict[str, Any]:
    """The scene figure1 with a light whose radiance falls smoothly to 0 at its border.

    Parameters, errors and notes are those of `figure1`.
    """
    return figure1(edge=edge, width=width, height=height)


def _turned_square() -> dict[str, Any]:
    angle = np.deg2rad(_OCCLUDER_DEGREES)
    across = _OCCLUDER_HALF_SIDE * np.array([np.cos(angle), 0.0, -np.sin(angle)])
    along = _OCCLUDER_HALF_SIDE * np.array([-np.sin(angle), 0.0, -np.cos(angle)])
    return rectangle(_OCCLUDER, across.tolist(), along.tolist())


def _smooth_texture(edge: float) -> dict[str, Any]:
    profile = _profile((np.arange(_TEXELS) + 0.5) / _TEXELS, edge)
    values = _RADIANCE * np.outer(profile, profile).astype(np.float32)
    bitmap = load_mitsuba().Bitmap(np.repeat(values[..., None], 3, axis=2))
    # Raw: radiance is linear, no colour to be decoded; clamp: no wrapping at the borders.
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}


def _profile(u: Array, edge: float) -> Array:
    """Rise from 0 at the ends of [0,1] to 1 at the distance `edge` / 2 as a smoothstep."""
    t = np.minimum(2.0 * np.minimum(u, 1.0 - u), edge) / edge
    return np.asarray(t * t * (3.0 - 2.0 * t))
