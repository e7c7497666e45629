"""An area light behind several occluders."""

from __future__ import annotations

import math
from typing import Any

from mcspectra.rendering.builtin.parts import (
    area_light,
    diffuse,
    named_points,
    perspective,
    rectangle,
)

__all__ = ["penumbra"]

_LIGHT_Y, _LIGHT_HALF_SIDE, _RADIANCE = 3.0, 0.8, 16.0
_BALL, _BALL_RADIUS = (-1.2, 1.0, 0.3), 0.4
_ROD = ((-2.2, 0.7, 1.1), (0.2, 0.9, 1.3), 0.07)  # ends and radius
_BLADES = (0.6, 1.15, 1.7)  # x of three parallel blades


@named_points(
    lit=(0.0, 0.0, 2.4),
    ball=(-2.3, 0.0, 0.5),
    both=(-1.5, 0.0, 1.28),
    rod=(-0.6, 0.0, 1.6),
    blades=(1.25, 0.0, 0.45),
)
def penumbra(*, width: int = 384, height: int = 256) -> dict[str, Any]:
    """A square light over a floor, behind a ball, a rod and three blades.

    Parameters
    ----------
    width, height
        Film size in pixels.

    Returns
    -------
    dict
        The scene for `mitsuba.load_dict`. Shapes: light, ball, rod, blade-0 … blade-2, floor.

    Raises
    ------
    ParameterError
        A film without pixels.

    Notes
    -----
    The named pixel ``lit`` sees all of the light; ``ball`` and ``rod`` lie in the penumbra of the
    one, ``both`` in those of both, and ``blades`` in those of blade-0 and blade-1.
    """
    light = rectangle((0, _LIGHT_Y, 0), (_LIGHT_HALF_SIDE, 0, 0), (0, 0, _LIGHT_HALF_SIDE))
    floor = rectangle((0, 0, 0), (6, 0, 0), (0, 0, -6))
    gray = diffuse(0.5, both_sides=True)
    start, end, radius = _ROD
    scene = {
        "type": "scene",
        "sensor": perspective((0.0, 3.2, 7.5), (0.0, 0.7, 0.3), 28.0, width, height),
        "light": {**light, **area_light(_RADIANCE)},
        "ball": {"type": "sphere", "center": list(_BALL), "radius": _BALL_RADIUS, "bsdf": gray},
        "rod": {"type": "cylinder", "p0": list(start), "p1": list(end), "radius": radius},
        "floor": {**floor, "bsdf": diffuse(0.5)},
    }
    scene["rod"]["bsdf"] = gray  # type: ignore[index]
    return scene | {f"blade-{i}": {**_blade(x), "bsdf": gray} for i, x in enumerate(_BLADES)}


def _blade(x: float) -> dict[str, Any]:
    """Make a blade at x, turned by 20° about y and leaning by 30°."""
    turn, lean = math.radians(20.0), math.radians(30.0)
    along = (0.6 * math.sin(turn), 0.0, 0.6 * math.cos(turn))
    across = (
        0.12 * math.cos(lean) * math.cos(turn),
        0.12 * math.sin(lean),
        -0.12 * math.cos(lean) * math.sin(turn),
    )
    return rectangle((x, 0.9, 0.3), across, along)
