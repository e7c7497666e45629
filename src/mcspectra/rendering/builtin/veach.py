"""Veach's scene for multiple importance sampling."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mcspectra.core.checks import as_choice
from mcspectra.core.errors import ParameterError
from mcspectra.rendering.builtin.parts import (
    Point,
    area_light,
    diffuse,
    named_points,
    perspective,
    rectangle,
)

__all__ = ["veach"]

_SPHERES: dict[str, tuple[Point, float, float]] = {
    # name: center, radius, radiance
    "light-0": ((-3.75, 0.0, 0.0), 0.03333, 901.803),
    "light-1": ((-1.25, 0.0, 0.0), 0.1, 100.0),
    "light-2": ((1.25, 0.0, 0.0), 0.3, 11.1111),
    "light-3": ((3.75, 0.0, 0.0), 0.9, 1.23457),
    "fill-light": ((10.0, 10.0, 4.0), 0.5, 800.0),
}
_PLATES: tuple[tuple[tuple[float, float], tuple[float, float], float], ...] = (
    # (y, z) of the lower edge at the front, (y, z) of the edge at the back, GGX roughness
    ((-2.70651, 0.25609), (-2.08375, -0.526323), 0.005),
    ((-3.28825, 1.36972), (-2.83856, 0.476536), 0.02),
    ((-3.73096, 2.70046), (-3.43378, 1.74564), 0.05),
    ((-3.99615, 4.0667), (-3.82069, 3.08221), 0.1),
)
_PLATE_HALF_WIDTH = 4.0
_FLOOR_Y, _WALL_Z = -4.14615, -2.0
_HALF_WIDTH, _FRONT_Z, _WALL_TOP = 12.0, 15.0, 12.0  # ours: larger than what the camera sees
_GRAY = 0.4  # ours too: reflectance of floor and wall


def _on_plate(i: int, x: float) -> Point:
    (y0, z0), (y1, z1), _ = _PLATES[i]
    return x, (y0 + y1) / 2, (z0 + z1) / 2


@named_points(
    **{
        "wall": (3.06, -0.73, _WALL_Z),
        "floor": (0.0, _FLOOR_Y, 4.6),
        # Where the mirror image of the widest light is seen in each plate.
        **{f"plate-{i}": _on_plate(i, x) for i, x in enumerate((3.3, 3.2, 3.1, 3.0))},
    }
)
def veach(
    *, lights: Sequence[str] | None = None, width: int = 768, height: int = 512
) -> dict[str, Any]:
    """Four glossy plates under four spheres of equal power, from Veach's thesis.

    Parameters
    ----------
    lights
        Which lights to keep: names among light-0 (smallest) … light-3 (widest) and fill-light.
        All by default.
    width, height
        Film size in pixels. The plates fill a 3:2 frame; a square one crops them.

    Returns
    -------
    dict
        The scene for `mitsuba.load_dict`. Shapes: plate-0 (smoothest) … plate-3, floor, wall.

    Raises
    ------
    ParameterError
        An unknown light, an empty list of lights, or a film without pixels.

    Notes
    -----
    Positions, radii, radiances, roughness and camera as in [Veach1997]_ and the scene files that
    several renderers publish. The plates are copper, floor and wall are gray: our choice.
    """
    kept = _check_lights(tuple(_SPHERES) if lights is None else lights)
    sensor = perspective((0.0, 2.0, 15.0), (0.0, -2.0, 2.5), 28.0, width, height)
    scene: dict[str, Any] = {"type": "scene", "sensor": sensor}
    scene |= {name: _sphere_light(*_SPHERES[name]) for name in _SPHERES if name in kept}
    scene |= {f"plate-{i}": _plate(*plate) for i, plate in enumerate(_PLATES)}
    across = (_HALF_WIDTH, 0.0, 0.0)
    depth, rise = (_FRONT_Z - _WALL_Z) / 2, (_WALL_TOP - _FLOOR_Y) / 2
    floor = rectangle((0, _FLOOR_Y, (_FRONT_Z + _WALL_Z) / 2), across, (0, 0, -depth))
    wall = rectangle((0, (_WALL_TOP + _FLOOR_Y) / 2, _WALL_Z), across, (0, rise, 0))
    gray = diffuse(_GRAY)
    return scene | {"floor": {**floor, "bsdf": gray}, "wall": {**wall, "bsdf": gray}}


def _check_lights(lights: object) -> tuple[str, ...]:
    allowed = tuple(_SPHERES)
    given = (lights,) if isinstance(lights, str) else lights
    if not isinstance(given, Sequence | set) or not given:
        raise ParameterError(f"lights is {lights!r}; give one or more of {', '.join(allowed)}.")
    return tuple(as_choice("a light", name, allowed) for name in given)


def _sphere_light(center: Point, radius: float, radiance: float) -> dict[str, Any]:
    sphere = {"type": "sphere", "center": list(center), "radius": radius}
    return {**sphere, **area_light(radiance)}


def _plate(front: tuple[float, float], back: tuple[float, float], alpha: float) -> dict[str, Any]:
    (y0, z0), (y1, z1) = front, back
    along = (0.0, (y1 - y0) / 2, (z1 - z0) / 2)
    center = (0.0, (y0 + y1) / 2, (z0 + z1) / 2)
    shape = rectangle(center, (_PLATE_HALF_WIDTH, 0.0, 0.0), along)
    copper = {"type": "roughconductor", "distribution": "ggx", "material": "Cu", "alpha": alpha}
    return {**shape, "bsdf": copper}
