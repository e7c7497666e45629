"""Built-in scenes: each function returns a Mitsuba dictionary with named points."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from mcspectra.core.checks import as_choice, as_integer, as_real
from mcspectra.core.display import shown
from mcspectra.core.environments import synthetic_sky
from mcspectra.core.errors import ParameterError
from mcspectra.rendering.backend import load_mitsuba

__all__ = ["P", "Q", "figure1", "penumbra", "sky", "smooth_light", "veach"]

Point = tuple[float, float, float]

_LARGEST_FILM = 65_536
_Scene = TypeVar("_Scene", bound=Callable[..., dict[str, Any]])


def named_points(**points: Point) -> Callable[[_Scene], _Scene]:
    """Add named world points to a scene; `named_pixels` finds the pixels that show them."""

    def keep(scene: _Scene) -> _Scene:
        scene.named_points = points  # type: ignore[attr-defined]
        return scene

    return keep


def perspective(
    origin: Point, target: Point, fov: float, width: int, height: int
) -> dict[str, Any]:
    """Return a camera with +y up, a vertical field of view in degrees, and a film of box pixels.

    Raises
    ------
    ParameterError
        If the film has no pixels, or a side has more than 65536 pixels.
    """
    size = {
        name: as_integer(name, value, least=1, most=_LARGEST_FILM)
        for name, value in (("width", width), ("height", height))
    }
    transform = load_mitsuba().ScalarTransform4f()
    view = transform.look_at(origin=list(origin), target=list(target), up=[0.0, 1.0, 0.0])
    film = {"type": "hdrfilm", "filter": {"type": "box"}, **size}
    lens = {"type": "perspective", "fov": fov, "fov_axis": "y"}
    return {**lens, "to_world": view, "film": film}


def rectangle(
    center: Sequence[float], across: Sequence[float], along: Sequence[float]
) -> dict[str, Any]:
    """Return a parallelogram with the corners center ± across ± along.

    The vectors across and along are perpendicular. Each is half as long as a side.
    The normal has the direction of the cross product across × along.
    """
    normal = np.cross(across, along)
    columns = [across, along, normal / np.linalg.norm(normal), center]
    matrix = np.vstack([np.array(columns, dtype=float).T, [0.0, 0.0, 0.0, 1.0]])
    transform = load_mitsuba().ScalarTransform4f(matrix.tolist())
    return {"type": "rectangle", "to_world": transform}


def diffuse(reflectance: float | Sequence[float], *, both_sides: bool = False) -> dict[str, Any]:
    """Return a Lambertian BSDF, gray or in an RGB color; its back is black unless `both_sides`."""
    value = reflectance if isinstance(reflectance, float) else list(reflectance)
    bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}
    return {"type": "twosided", "bsdf": bsdf} if both_sides else bsdf


def area_light(radiance: float | dict[str, Any]) -> dict[str, Any]:
    """Return a shape with a black BSDF and an emitter of gray or textured radiance."""
    color = {"type": "rgb", "value": radiance} if isinstance(radiance, float) else radiance
    return {"bsdf": diffuse(0.0), "emitter": {"type": "area", "radiance": color}}


P: Point = (-1.2, 0.0, 0.7)
"""A floor point where the whole light is visible."""
Q: Point = (0.9, 0.0, 0.4)
"""A floor point where the occluder hides a part of the light."""

_HEIGHT, _HALF_SIDE, _RADIANCE = 2.0, 1.0, 9.0
_OCCLUDER: Point = (1.5, 1.0, 0.0)
_OCCLUDER_HALF_SIDE, _OCCLUDER_DEGREES = 0.7, 25.0
_FLOOR_HALF_SIDE, _REFLECTANCE = 6.0, 0.5
_TEXELS = 256


@named_points(P=P, Q=Q)
def figure1(*, edge: float = 0.0, width: int = 384, height: int = 256) -> dict[str, Any]:
    """A square light above a floor, and an occluder that hides part of it from one of two points.

    Parameters
    ----------
    edge
        Width of the light's soft border as a fraction of its half side.
        From the border inwards, the radiance rises from 0 as the smoothstep 3t² − 2t³.
        If `edge` is 0, the radiance is constant over the light.
    width, height
        Film size in pixels.

    Returns
    -------
    dict
        The scene for `mitsuba.load_dict`. Shapes: light, occluder, floor.

    Raises
    ------
    ParameterError
        If `edge` is not within [0, 1], or the film has no pixels.

    Notes
    -----
    The arrangement follows Figure 1 in [Singh2019]_. The figure has no numbers; we chose them.
    The floor is y = 0. The light is the square |x| ≤ 1, |z| ≤ 1 at y = 2 and faces down.
    The occluder is a square of half side 0.7 at y = 1 around x = 1.5, z = 0.
    The occluder is rotated by 25° so that its shadow's border is not parallel to strata.
    The named pixels P and Q show the floor points P and Q. From P, the whole light is visible.
    Neither P nor Q is below the light's center.
    At a point below the center, f is equal at opposite borders of the unit square.
    Shifted points would then meet no jump at the border of the square.

    With a soft border, the radiance is a texture of 256² texels with bilinear interpolation.
    Mitsuba samples such a light texel by texel, in proportion to the texture.
    With a soft border, the integrand of BSDF sampling has no jump at the outline of the light.
    With ``edge=1``, the rate of jittered points at P is −1.9 instead of −1.5.
    """
    radiance: Any = _RADIANCE
    if as_real("edge", edge, least=0.0, most=1.0):
        # Texture that rises from 0 at both ends of [0,1] to 1 at the distance edge / 2
        u = (np.arange(_TEXELS) + 0.5) / _TEXELS
        t = np.minimum(2.0 * np.minimum(u, 1.0 - u), edge) / edge
        profile = np.asarray(t * t * (3.0 - 2.0 * t))
        values = _RADIANCE * np.outer(profile, profile).astype(np.float32)
        bitmap = load_mitsuba().Bitmap(np.repeat(values[..., None], 3, axis=2))
        # Raw: radiance is linear and must not be decoded. Clamp: the texture does not repeat
        radiance = {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}
    angle = np.deg2rad(_OCCLUDER_DEGREES)
    across = _OCCLUDER_HALF_SIDE * np.array([np.cos(angle), 0.0, -np.sin(angle)])
    along = _OCCLUDER_HALF_SIDE * np.array([-np.sin(angle), 0.0, -np.cos(angle)])
    occluder = rectangle(_OCCLUDER, across.tolist(), along.tolist())
    light = rectangle((0, _HEIGHT, 0), (_HALF_SIDE, 0, 0), (0, 0, _HALF_SIDE))
    floor = rectangle((0, 0, 0), (_FLOOR_HALF_SIDE, 0, 0), (0, 0, -_FLOOR_HALF_SIDE))
    return {
        "type": "scene",
        "sensor": perspective((0.0, 1.6, 7.0), (0.0, 0.9, 0.0), 28.0, width, height),
        "light": {**light, **area_light(radiance)},
        "occluder": {**occluder, "bsdf": diffuse(0.2, both_sides=True)},
        "floor": {**floor, "bsdf": diffuse(_REFLECTANCE)},
    }


@named_points(P=P, Q=Q)
def smooth_light(*, edge: float = 0.5, width: int = 384, height: int = 256) -> dict[str, Any]:
    """The scene figure1 with a light whose radiance falls smoothly to 0 at its border.

    Parameters, errors and notes are the same as in `figure1`.
    """
    return figure1(edge=edge, width=width, height=height)


_LIGHT_Y, _LIGHT_HALF_SIDE, _PENUMBRA_RADIANCE = 3.0, 0.8, 16.0
_BALL, _BALL_RADIUS = (-1.2, 1.0, 0.3), 0.4
_ROD = ((-2.2, 0.7, 1.1), (0.2, 0.9, 1.3), 0.07)  # the rod is given by its two ends and its radius
_BLADES = (0.6, 1.15, 1.7)  # x coordinates of the centers of three parallel blades


@named_points(
    lit=(0.0, 0.0, 2.4),
    ball=(-2.3, 0.0, 0.5),
    both=(-1.5, 0.0, 1.28),
    rod=(-0.6, 0.0, 1.6),
    blades=(1.25, 0.0, 0.45),
)
def penumbra(*, width: int = 384, height: int = 256) -> dict[str, Any]:
    """A square light above a floor, behind a ball, a rod and three blades.

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
        If the film has no pixels.

    Notes
    -----
    The whole light is visible from the named pixel ``lit``.
    The pixel ``ball`` lies in the penumbra of the ball, ``rod`` in the penumbra of the rod,
    ``both`` in both penumbras, and ``blades`` in the penumbras of blade-0 and blade-1.
    """
    light = rectangle((0, _LIGHT_Y, 0), (_LIGHT_HALF_SIDE, 0, 0), (0, 0, _LIGHT_HALF_SIDE))
    floor = rectangle((0, 0, 0), (6, 0, 0), (0, 0, -6))
    gray = diffuse(0.5, both_sides=True)
    start, end, radius = _ROD
    scene = {
        "type": "scene",
        "sensor": perspective((0.0, 3.2, 7.5), (0.0, 0.7, 0.3), 28.0, width, height),
        "light": {**light, **area_light(_PENUMBRA_RADIANCE)},
        "ball": {"type": "sphere", "center": list(_BALL), "radius": _BALL_RADIUS, "bsdf": gray},
        "rod": {"type": "cylinder", "p0": list(start), "p1": list(end), "radius": radius},
        "floor": {**floor, "bsdf": diffuse(0.5)},
    }
    scene["rod"]["bsdf"] = gray  # type: ignore[index]
    # The blades are rotated by 20° about y and inclined by 30°
    turn, lean = math.radians(20.0), math.radians(30.0)
    along = (0.6 * math.sin(turn), 0.0, 0.6 * math.cos(turn))
    across = (
        0.12 * math.cos(lean) * math.cos(turn),
        0.12 * math.sin(lean),
        -0.12 * math.cos(lean) * math.sin(turn),
    )
    blades = (rectangle((x, 0.9, 0.3), across, along) for x in _BLADES)
    return scene | {f"blade-{i}": {**shape, "bsdf": gray} for i, shape in enumerate(blades)}


_MAP_SIZE = (64, 128)
_SKY_RADIUS = 0.8
_MATERIALS: dict[str, tuple[float, dict[str, Any]]] = {
    # Name of the sphere: x coordinate of its center, and its BSDF
    "diffuse": (-1.9, diffuse((0.25, 0.2, 0.15))),
    "plastic": (
        0.0,
        {
            "type": "roughplastic",
            "diffuse_reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.5]},
            "alpha": 0.15,
        },
    ),
    "metal": (1.9, {"type": "roughconductor", "distribution": "ggx", "alpha": 0.15}),
}
# Offset of the named points from a sphere's center, toward the camera and upwards
_FRONT = 0.6 * _SKY_RADIUS
_UP = _SKY_RADIUS + 0.8 * _SKY_RADIUS


@named_points(
    floor=(0.0, 0.0, 2.0),
    contact=(-1.9, 0.0, 0.75),
    diffuse=(-1.9, _UP, _FRONT),
    plastic=(0.0, _UP, _FRONT),
    metal=(1.9, _UP, _FRONT),
)
def sky(*, width: int = 384, height: int = 256) -> dict[str, Any]:
    """Diffuse, plastic and metal spheres on a floor under a synthetic sky with a sun.

    Parameters
    ----------
    width, height
        Film size in pixels.

    Returns
    -------
    dict
        The scene for `mitsuba.load_dict`. Shapes: diffuse, plastic, metal, floor; emitter: sky.

    Raises
    ------
    ParameterError
        If the film has no pixels.

    Notes
    -----
    The map is `mcspectra.integrands.synthetic_sky` with 64 × 128 pixels.
    The first row of the map lies in the direction +y.
    Nothing is downloaded. Mitsuba places the columns at atan2(x, −z) = 2π (column + ½) / 128.
    Mitsuba places the rows at acos(y) = π row / 63, from pole to pole, and interpolates linearly.
    The named pixels show the open floor and the upper front of each sphere.
    One named pixel shows the floor where the diffuse sphere touches it.
    The BSDF of plastic chooses between two lobes (``dims=3``).
    """
    pixels = synthetic_sky(*_MAP_SIZE).astype(np.float32)
    scene = {
        "type": "scene",
        "sensor": perspective((0.0, 2.2, 8.0), (0.0, 0.75, 0.0), 28.0, width, height),
        "sky": {"type": "envmap", "bitmap": load_mitsuba().Bitmap(pixels)},
        "floor": {**rectangle((0, 0, 0), (8, 0, 0), (0, 0, -8)), "bsdf": diffuse(0.15)},
    }
    for name, (x, bsdf) in _MATERIALS.items():
        ball = {"type": "sphere", "center": [x, _SKY_RADIUS, 0.0], "radius": _SKY_RADIUS}
        scene[name] = {**ball, "bsdf": bsdf}
    return scene


_SPHERES: dict[str, tuple[Point, float, float]] = {
    # Name of the sphere: its center, radius and radiance
    "light-0": ((-3.75, 0.0, 0.0), 0.03333, 901.803),
    "light-1": ((-1.25, 0.0, 0.0), 0.1, 100.0),
    "light-2": ((1.25, 0.0, 0.0), 0.3, 11.1111),
    "light-3": ((3.75, 0.0, 0.0), 0.9, 1.23457),
    "fill-light": ((10.0, 10.0, 4.0), 0.5, 800.0),
}
_PLATES: tuple[tuple[tuple[float, float], tuple[float, float], float], ...] = (
    # One row per plate: (y, z) of the front edge, (y, z) of the back edge, GGX roughness
    ((-2.70651, 0.25609), (-2.08375, -0.526323), 0.005),
    ((-3.28825, 1.36972), (-2.83856, 0.476536), 0.02),
    ((-3.73096, 2.70046), (-3.43378, 1.74564), 0.05),
    ((-3.99615, 4.0667), (-3.82069, 3.08221), 0.1),
)
_PLATE_HALF_WIDTH = 4.0
_FLOOR_Y, _WALL_Z = -4.14615, -2.0
# Sizes of floor and wall are our choice; both are larger than the camera's view
_HALF_WIDTH, _FRONT_Z, _WALL_TOP = 12.0, 15.0, 12.0
_GRAY = 0.4  # reflectance of floor and wall (our choice)


def _on_plate(i: int, x: float) -> Point:
    (y0, z0), (y1, z1), _ = _PLATES[i]
    return x, (y0 + y1) / 2, (z0 + z1) / 2


@named_points(
    **{
        "wall": (3.06, -0.73, _WALL_Z),
        "floor": (0.0, _FLOOR_Y, 4.6),
        # Each of these points lies where its plate shows the mirror image of the widest light
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
        Lights to keep: names among light-0 (smallest) … light-3 (widest) and fill-light.
        By default, all lights are kept.
    width, height
        Film size in pixels. The plates fill a 3:2 frame; a square frame crops them.

    Returns
    -------
    dict
        The scene for `mitsuba.load_dict`. Shapes: plate-0 (smoothest) … plate-3, floor, wall.

    Raises
    ------
    ParameterError
        If a light is unknown, the list of lights is empty, or the film has no pixels.

    Notes
    -----
    Positions, radii, radiances, roughness and camera come from [Veach1997]_.
    Several renderers publish scene files with the same positions, radii, radiances and camera.
    Copper plates, and a gray floor and wall, are our choice.
    """
    allowed: Any = tuple(_SPHERES)
    given: Any = (lights,) if isinstance(lights, str) else allowed if lights is None else lights
    if not isinstance(given, Sequence | set) or not given:
        raise ParameterError(
            f"lights is {shown(lights)}; give one or more of {', '.join(allowed)}."
        )
    kept = [as_choice("a light", name, allowed) for name in given]
    sensor = perspective((0.0, 2.0, 15.0), (0.0, -2.0, 2.5), 28.0, width, height)
    scene: dict[str, Any] = {"type": "scene", "sensor": sensor}
    for name, (center, radius, radiance) in _SPHERES.items():
        if name in kept:
            ball = {"type": "sphere", "center": list(center), "radius": radius}
            scene[name] = {**ball, **area_light(radiance)}
    for i, ((y0, z0), (y1, z1), alpha) in enumerate(_PLATES):
        along = (0.0, (y1 - y0) / 2, (z1 - z0) / 2)
        shape = rectangle(_on_plate(i, 0.0), (_PLATE_HALF_WIDTH, 0.0, 0.0), along)
        copper = {"type": "roughconductor", "distribution": "ggx", "material": "Cu"}
        scene[f"plate-{i}"] = {**shape, "bsdf": {**copper, "alpha": alpha}}
    across = (_HALF_WIDTH, 0.0, 0.0)
    depth, rise = (_FRONT_Z - _WALL_Z) / 2, (_WALL_TOP - _FLOOR_Y) / 2
    floor = rectangle((0, _FLOOR_Y, (_FRONT_Z + _WALL_Z) / 2), across, (0, 0, -depth))
    wall = rectangle((0, (_WALL_TOP + _FLOOR_Y) / 2, _WALL_Z), across, (0, rise, 0))
    gray = diffuse(_GRAY)
    return scene | {"floor": {**floor, "bsdf": gray}, "wall": {**wall, "bsdf": gray}}
